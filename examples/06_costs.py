"""What to minimise: every cost leanboom knows, on one path, and what its motion takes from either pump."""

from dataclasses import replace

import leanboom as lb
from leanboom.components.costs import COSTS
from leanboom.components.paths import Lines

LIFT = Lines(points=((2.6, 0.0, 0.5), (3.2, 0.0, 1.2)), durations=(5.0,))
GRID, STEP, EFFORT = (41, 31), 0.2, "quick"  # all quicker than the defaults


def main():
    task = replace(lb.load_task("loader-triangle-small"), name="lift", path=LIFT, start="middle")
    print(f"{'minimised':>14} {'LS [kJ]':>8} {'CP [kJ]':>8} {'extension [m]':>14}  status")
    for cost in COSTS:
        # The cost says what is minimised; the pump only says whose energy `plan.evaluation.energy` would be asked for.
        plan = lb.run(task, cost=cost, grid=GRID, step=STEP, effort=EFFORT, baseline=False, check=False)
        judged, moved = plan.evaluation, plan.motion.position[-1] - plan.motion.position[0]
        print(f"{cost:>14} {judged.energy_ls / 1e3:8.2f} {judged.energy_cp / 1e3:8.2f} {moved:+14.3f}  {judged.status}")
    today = lb.run(task, method="sns-actuator", baseline=False, check=False).evaluation
    print(f"{'(sns-actuator)':>14} {today.energy_ls / 1e3:8.2f} {today.energy_cp / 1e3:8.2f}")


if __name__ == "__main__":
    main()
