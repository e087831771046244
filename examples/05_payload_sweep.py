"""How much a payload costs, and how much planning saves with it: one path with rising payloads."""

from dataclasses import replace

import leanboom as lb
from leanboom.components.paths import Lines

LIFT = Lines(points=((2.6, 0.0, 0.5), (3.2, 0.0, 1.2)), durations=(5.0,))
GRID, STEP, EFFORT = (41, 31), 0.2, "quick"  # all quicker than the defaults


def main():
    task = replace(lb.load_task("loader-triangle-small"), name="lift", path=LIFT, start="middle")
    print(f"{'payload [kg]':>12} {'LS [kJ]':>8} {'pseudo-inverse':>15} {'saved':>6} {'highest LS supply [MPa]':>24}")
    for payload in (0.0, 250.0, 500.0):
        plan = lb.run(replace(task, payload=payload), pump="ls", grid=GRID, step=STEP, effort=EFFORT)
        mine, today = plan.evaluation, plan.baseline
        supply = mine.supply_ls.max() / 1e6
        saved = plan.saving()
        print(f"{payload:12.0f} {mine.energy_ls / 1e3:8.2f} {today.energy_ls / 1e3:15.2f} {saved:6.0%} {supply:24.1f}")
        for note in mine.notes:
            print("   ", note)


if __name__ == "__main__":
    main()
