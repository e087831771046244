"""Whether any method beats the planner on random tasks of both machines: `python -m benchmarks.random_tasks`.

A task is drawn by its number: the machine, two or three tool points reached by random joint positions, straight
segments or a spline, 2.5 s to 7 s, a payload, a start. Tasks without a feasible motion are counted and left out.
`--direct` adds the collocation and shooting methods (minutes a task). Prints every task that another method wins by
more than 0.05 %, and the smallest lead of all.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import leanboom as lb
from leanboom.dynamic_programming import grids, value_function
from leanboom.formulas import kinematics
from leanboom.methods.registry import METHODS
from leanboom.model.task import Lines, Spline, Task
from leanboom.planning import planner
from leanboom.problem import stages, starts

OURS = METHODS.find("dp")
OTHERS = {name: METHODS.find(name) for name in METHODS.own if METHODS.find(name) is not OURS}
QUICK = tuple(name for name, method in OTHERS.items() if method.weight < OURS.weight)
DIRECT = tuple(name for name, method in OTHERS.items() if method.weight > OURS.weight and not method.slow)
LEVEL = 5e-4  # a lead smaller than this share counts as level


def random_task(number: int) -> Task:
    """Task of a number: the same on every machine."""
    rng = np.random.default_rng(number)
    machine = lb.load_machine(("forwarder", "loader")[number % 2])
    points = [_reachable(machine, rng) for _ in range(2 + int(rng.integers(2)))]
    legs = [float(np.hypot(*np.subtract(a, b))) for a, b in zip(points[:-1], points[1:], strict=True)]
    total = rng.uniform(2.5, 7.0)
    durations = [total * (leg + 0.1) / (sum(legs) + 0.1 * len(legs)) for leg in legs]
    corners = tuple((x, 0.0, z) for x, z in points)
    if rng.random() < 0.5:
        path = Lines(corners, tuple(durations))
    else:
        path = Spline(corners, (0.0, *(float(t) for t in np.cumsum(durations))))
    payload = float(rng.choice([0.0, 0.0, 200.0, 500.0])) * (1.0 if machine.name == "forwarder" else 0.2)
    return Task(f"random-{number}", machine, path, payload, str(rng.choice(["smallest", "middle"])))


def _reachable(machine, rng) -> tuple[float, float]:
    """Radius and height of the tool at random joint positions, above the ground and beside the pillar."""
    g = machine.geometry
    while True:
        q2, q3, q4 = (rng.uniform(j.lower, j.upper) for j in machine.joints[-3:])
        r, z = kinematics.tool_point(q2, q3, q4, g.base_x, g.base_z, g.boom, g.offset, g.outer)
        if r > 1.5 and -1.0 < z < 6.0:
            return float(r), float(z)


def has_motion(task: Task) -> bool:
    """Whether a coarse program or the pseudo-inverse finds a motion inside all limits."""
    try:
        problem = stages.discretise(task, 0.05)
        policy = value_function.solve(problem, grids.full_grid(problem, 101, 51), "cp")
        start = starts.start_position(problem, task.start)
        coarse = lb.evaluate(task, value_function.rollout(policy, problem.lower[0] if start is None else start))
        return (
            coarse.feasible or planner.run(task, method="sns-actuator", baseline=False, check=False).evaluation.feasible
        )
    except lb.InfeasibleError:
        return False


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tasks", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--direct", action="store_true", help="also collocation and shooting")
    arguments = parser.parse_args()
    value_function.prepare()
    began, compared, empty, lost, lead = time.perf_counter(), 0, 0, 0, np.inf
    methods = QUICK + (DIRECT if arguments.direct else ())
    number = arguments.first
    while compared < arguments.tasks:
        task, number = random_task(number), number + 1
        if not has_motion(task):
            empty += 1
            continue
        for pump in ("ls", "cp"):
            plan = planner.run(task, pump=pump, baseline=False, check=False)
            ours = plan.evaluation.energy(pump) if plan.evaluation.feasible else np.inf
            best, winner = np.inf, ""
            for method in methods:
                try:
                    other = planner.run(task, pump=pump, method=method, baseline=False, check=False).evaluation
                except lb.LeanboomError:
                    continue
                if other.feasible and other.energy(pump) < best:
                    best, winner = other.energy(pump), method
            lead = min(lead, best / ours - 1.0)
            if best < (1.0 - LEVEL) * ours:
                lost += 1
                print(f"{task.name} {pump}: {winner} {best:.1f} J, dp {ours:.1f} J", flush=True)
        compared += 1
        if compared % 10 == 0:
            print(f"{compared} tasks, {time.perf_counter() - began:.0f} s", flush=True)
    print(
        f"{compared} tasks x 2 pumps, {empty} more without a feasible motion; another method ahead by more than "
        f"{100 * LEVEL:g} %: {lost}; smallest lead of dp: {100 * lead:+.3f} %"
    )


if __name__ == "__main__":
    main()
