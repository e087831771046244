"""Feedback, re-planning and receding horizon, measured: `python -m benchmarks.replanning`.

Sections: time of a control query, of a re-plan and its parts, how good re-plans from disturbed states are, and energy
against the length of the horizon beside the whole path's. `--quick` leaves out the last one, which takes minutes.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

import leanboom as lb
from benchmarks.certificate import SINGLE
from benchmarks.run import machine, title
from leanboom.dynamic_programming import grids, value_function
from leanboom.evaluation import safe_stop
from leanboom.planning import planner, receding_horizon, replanning
from leanboom.problem import feasible_strokes, stages

TASK = "forwarder-half-cycle"
HORIZONS = (1.0, 2.0, 3.0, 5.0)  # [s]
PUMPS = ("ls", "cp")
SEED = 20170506


def measured(work: Callable[..., object], *arguments: object, **named: object) -> tuple[float, float]:
    """Wall and processor time of a piece of work [s]."""
    wall, own = time.perf_counter(), time.process_time()
    work(*arguments, **named)
    return time.perf_counter() - wall, time.process_time() - own


def spread(seconds: list[float], scale: float, unit: str) -> str:
    """Least, median and 99th percentile."""
    least, median, most = scale * np.percentile(seconds, [0, 50, 99])
    return f"{least:.1f} / {median:.1f} / {most:.1f} {unit}"


def states(motion: lb.Motion, count: int, last: float) -> list[tuple[float, float, float]]:
    """Times up to `last` [s] and disturbed states of a motion, the same in every run."""
    rng = np.random.default_rng(SEED)
    times = rng.uniform(0.0, last, count)
    c, w, _ = motion.at(times)
    c = c + rng.uniform(0.0, 0.02, count)  # inwards of a start on the smallest extension
    w = w + rng.uniform(-0.02, 0.02, count)
    return [(float(t), float(a), float(b)) for t, a, b in zip(times, c, w, strict=True)]


def queries(problem: stages.Problem) -> None:
    title(f"Policy.control on {TASK}, 201 x 101 nodes: least / median / 99th percentile")
    for cost in PUMPS:
        policy = value_function.solve(problem, grids.full_grid(problem, 201, 101), cost)
        motion = value_function.rollout(policy, float(problem.lower[0]))
        asked = states(motion, 4000, problem.time[-1] - 0.1)
        policy.control(*asked[0])
        wall, own = zip(*(measured(policy.control, *state) for state in asked), strict=True)
        print(f"{cost}: wall {spread(wall, 1e6, 'us')}, processor {spread(own, 1e6, 'us')}")


def replans(task: lb.Task, plans: dict[str, lb.Motion], count: int) -> None:
    title(f"Re-planning the rest of {TASK} from disturbed states: least / median / 99th percentile")
    for cost, motion in plans.items():
        asked = states(motion, count, 12.0)
        for name, around in (("around the plan", motion), ("from nothing", None)):
            found, wall, own = [], [], []
            for state in asked:
                began = time.perf_counter(), time.process_time()
                found.append(replanning.replan(task, *state, pump=cost, around=around))
                wall.append(time.perf_counter() - began[0])
                own.append(time.process_time() - began[1])
            stops = sum(answer.stopping for answer in found)
            print(f"{cost}, {name}: wall {spread(wall, 1e3, 'ms')}, processor {spread(own, 1e3, 'ms')}; {stops} stops")
            loss = [answer.evaluation.energy(cost) for answer in found]
            if around is not None:
                best = loss
            else:
                print(f"    from nothing costs {100 * (np.sum(loss) / np.sum(best) - 1):+.1f} % more over all states")


def parts(task: lb.Task, plans: dict[str, lb.Motion]) -> None:
    title("Parts of a re-plan of the whole half-cycle around its plan, processor time: median of 30 [ms]")
    for cost, motion in plans.items():
        problem = stages.discretise(safe_stop.rest(task, 0.0), replanning.STEP)
        search = replanning.Search(problem, cost, float(motion.position[0]), 0.0)
        seed = replanning.track(search, motion, 0.0)
        low, high = feasible_strokes.stroke_range(task)
        limit = problem.crane.machine.redundant.velocity_limit
        widths = replanning.WIDTH * (high - low), replanning.SPREAD * limit
        grid = grids.tube_grid(problem, seed.position, seed.velocity, *widths, *replanning.TUBE)
        policy = value_function.solve(problem, grid, cost)
        work: dict[str, tuple[Callable[..., object], tuple]] = {
            "feasible extensions": (stages.discretise, (problem.task, replanning.STEP)),
            "tables": (grids.tables, (problem, grid, cost)),
            "tables and sweep": (value_function.solve, (problem, grid, cost)),
            "rollout": (value_function.rollout, (policy, float(seed.position[0]))),
            "judge, called twice": (lb.evaluate, (problem.task, seed)),
        }
        values = {
            name: np.median([measured(part, *arguments)[1] for _ in range(30)])
            for name, (part, arguments) in work.items()
        }
        print(f"{cost}: " + ", ".join(f"{name} {1e3 * value:.1f}" for name, value in values.items()))


def horizons() -> None:
    title("Judged energy against the horizon, a plan every 0.5 s: loss against the whole path [%], (!) breaks a limit")
    print(
        f"{'task':<24}{'start':<10}{'pump':<5}{'whole kJ':>9}"
        + "".join(f"{f'{h:g} s':>9}" for h in HORIZONS)
        + "  pinv"
    )
    for start in ("smallest", "middle"):
        for name in SINGLE:
            task = replace(lb.load_task(name), start=start)
            for pump in PUMPS:
                plan = planner.run(task, pump=pump, check=False)
                whole = plan.evaluation.energy(pump)
                cells = []
                for length in HORIZONS:
                    motion = receding_horizon.plan_receding(task, pump=pump, horizon=length, check=False)
                    judged = lb.evaluate(task, motion)
                    cells.append(f"{100 * (judged.energy(pump) / whole - 1):+.1f}{'' if judged.feasible else '(!)'}")
                today = "x" if plan.baseline is None else f"{100 * (plan.baseline.energy(pump) / whole - 1):+.0f}"
                print(
                    f"{name:<24}{start:<10}{pump:<5}{whole / 1e3:>9.2f}"
                    + "".join(f"{cell:>9}" for cell in cells)
                    + f"{today:>6}",
                    flush=True,
                )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="leave out energies against the horizon")
    parser.add_argument("--count", type=int, default=200, help="re-plans that are timed")
    arguments = parser.parse_args()
    machine()
    value_function.prepare()
    task = lb.load_task(TASK)
    queries(stages.discretise(task, 0.05))
    plans = {pump: lb.plan(task, pump=pump) for pump in PUMPS}
    parts(task, plans)
    replans(task, plans, arguments.count)
    if not arguments.quick:
        horizons()


if __name__ == "__main__":
    main()
