"""Where the 3-DOF paper's largest triangle was, inferred from its printed tables: `python -m benchmarks.triangle`.

Order of the edges (diagonal, vertical, horizontal) and durations are printed, corners are not. A triangle has four free
numbers, corners A and B: C is under or above B at the height of A, so its direction of travel and the side of the
diagonal are free as well. Each is judged by coarse dynamic programs and pseudo-inverses: the rows of Tables 2 and 3
that global methods or pseudo-inverses determine (the weighted one as `weights.signed` reads it), and what sections 6.2
and 6.3 say of other cylinders. The misfit is the root mean square of all differences, percents as shares; rows that
need no reading count twice, "well over 5 %" is missed only from below, and "negligible" by what is beyond 1 %.

First samples over the reach, on a coarse grid and left early where the tables are far off; the best are refined by
Nelder and Mead's simplex on a finer one. `--corners xA,zA,xB,zB` or `--bundled` show one triangle beside the printed
values, `--weights` with all readings of the weighted pseudo-inverse; `--profile` says how much the misfit grows when
one coordinate is held off its place and the others are free.

A quarter of an hour of one core for samples and refinement (`LEANBOOM_THREADS=1`), half an hour for the profile.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize
from scipy.stats import qmc

import leanboom as lb
from leanboom.dynamic_programming import grids, value_function
from leanboom.errors import InfeasibleError, LeanboomError
from leanboom.evaluation.evaluate import Evaluation, evaluate
from leanboom.methods import pseudo_inverse
from leanboom.model.task import Lines, Task
from leanboom.problem import stages, starts
from leanboom.study.papers import printed_values, weights
from leanboom.study.papers.experiments import CHANGES
from leanboom.study.papers.variations import EARLIER_TRIANGLE, cornered, resized
from leanboom.study.papers.weights import SIGNED

REACH = np.array([0.5, -2.3, 0.5, -2.3]), np.array([3.95, 4.2, 3.95, 4.2])  # bounds of xA, zA, xB, zB [m]
EDGE = 0.7  # [m], the shortest edge that is tried
DIAGONAL = 2.2, 5.6  # [m], 10 s at "roughly 0.5 m/s": at most at its peak, or on the mean
SMOOTH = 5.0  # [Hz], as the paper filters
SIMPLEX = 0.12  # [m], first edge of the simplex
STEPS = -0.1, 0.1  # [m], of the profile
EARLY = 0.06, 0.13  # root mean square and largest difference of the first rows from which a sample is left


@dataclass(frozen=True)
class Effort:
    """How finely a triangle is judged."""

    grid: tuple[int, int]  # positions and velocities of the dynamic programs
    stage: float  # [s]
    step: float  # of the pseudo-inverse [s]


COARSE, FINE = Effort((41, 21), 0.2, 0.1), Effort((81, 41), 0.1, 0.05)


@dataclass(frozen=True)
class Printed:
    """A printed value, how a value of ours differs from it, and how often that counts."""

    value: float
    short: Callable[[float], float]  # ours to difference
    weight: float = 1.0


def _printed() -> dict[str, Printed]:
    found = {}
    for table, rows in (("Table 2", printed_values.TABLE2), ("Table 3", printed_values.TABLE3)):
        for row in rows[1:]:
            if row.method in ("dp", "sns-actuator", SIGNED):
                assert row.value is not None
                weight = 1.0 if row.method == SIGNED else 2.0
                found[f"{table}, {row.name}"] = Printed(row.value, lambda ours, at=row.value: ours - at, weight)
    for change, said in (("tilt 80/56", printed_values.TILT_ROD), ("extension 45/30", printed_values.EXTENSION_BORE)):
        for what, by_size in said.items():
            at = by_size["large"]
            short: Callable[[float], float] = lambda ours, at=at: 0.01 * (ours - at)  # noqa: E731
            if what == "pressure" and at:  # "well over"
                short = lambda ours, at=at: 0.01 * min(ours - at, 0.0)  # noqa: E731
            elif what == "pressure":  # "negligible"
                short = lambda ours: 0.01 * max(abs(ours) - 1.0, 0.0)  # noqa: E731
            found[f"{change}, {what} [%]"] = Printed(at, short)
    return found


PRINTED = _printed()


def triangle(corners: np.ndarray) -> Task:
    """The task along a triangle; corners are xA, zA, xB, zB [m]."""
    xa, za, xb, zb = (float(value) for value in corners)
    return cornered(lb.load_task("loader-triangle-large", start="smallest"), (xa, za), (xb, zb))


def best(task: Task, start: float, cost: str, effort: Effort) -> Evaluation:
    """The filtered motion of a coarse dynamic program."""
    problem = stages.discretise(task, effort.stage)
    policy = value_function.solve(problem, grids.full_grid(problem, *effort.grid), cost)
    return followed(task, value_function.rollout(policy, start))


def followed(task: Task, motion) -> Evaluation:
    judged = evaluate(replace(task, smooth=SMOOTH), motion)
    if not judged.followed:
        raise InfeasibleError(f"the motion leaves its path: {judged.status}")
    return judged


def values(task: Task, effort: Effort, early: tuple[float, float] | None = None) -> dict[str, float]:
    """What a triangle gives for every entry of `PRINTED`.

    Raises:
        LeanboomError: The triangle cannot be followed, or is further off than `early` after the first rows.
    """
    start = starts.start_position(stages.discretise(task, effort.stage), "smallest")
    if start is None:
        raise InfeasibleError("no start")
    costs = ("cp", "ls", "velocity", "actuator")
    optimum = {cost: best(task, start, cost, effort) for cost in costs}
    found: dict[str, float] = {}

    def enter(method: str, cost: str, judged: Evaluation) -> None:
        for table, rows, pump in (("2", printed_values.TABLE2, "cp"), ("3", printed_values.TABLE3, "ls")):
            for row in rows[1:]:
                if (row.method, row.cost) == (method, cost):
                    found[f"Table {table}, {row.name}"] = judged.energy(pump) / optimum[pump].energy(pump)

    for cost in costs:
        enter("dp", cost, optimum[cost])
    if early is not None:
        off = np.array([PRINTED[name].short(value) for name, value in found.items()])
        if np.sqrt(np.mean(off**2)) > early[0] or np.abs(off).max() > early[1]:
            raise InfeasibleError("far from the tables")
    for method, rule in (("sns-actuator", None), (SIGNED, weights.signed())):
        motion = pseudo_inverse.resolve(task, start, step=effort.step, rule=rule)
        enter(method, "velocity", followed(task, motion))
    for change, cylinder in CHANGES.items():
        other = replace(task, machine=resized(task.machine, *cylinder))
        cp, ls = (best(other, start, pump, effort) for pump in ("cp", "ls"))
        old = optimum["cp"]
        found[f"{change}, flow [%]"] = 100.0 * (cp.energy_cp / old.energy_cp - 1.0)
        found[f"{change}, ls [%]"] = 100.0 * (ls.energy_ls / optimum["ls"].energy_ls - 1.0)
        found[f"{change}, pressure [%]"] = 100.0 * (float(cp.pressure.max()) / float(old.pressure.max()) - 1.0)
    return found


def misfit(found: Mapping[str, float]) -> float:
    """Weighted root mean square of the differences from the printed values."""
    squares = [PRINTED[name].short(value) ** 2 for name, value in found.items()]
    return float(np.sqrt(np.average(squares, weights=[PRINTED[name].weight for name in found])))


def refined(
    corners: np.ndarray, free: tuple[int, ...], evaluations: int, effort: Effort = FINE
) -> tuple[np.ndarray, float]:
    """The corners of least misfit near given ones, and their misfit.

    Args:
        corners: Where the search begins.
        free: Which of the four numbers may change.
        evaluations: At most so many triangles are judged.
        effort: How finely.
    """

    def at(x: np.ndarray) -> np.ndarray:
        whole = corners.copy()
        whole[list(free)] = x
        return whole

    def off(x: np.ndarray) -> float:
        try:
            return misfit(values(triangle(at(x)), FINE))
        except LeanboomError:
            return 1.0

    first = corners[list(free)]
    simplex = np.vstack([first, first + SIMPLEX * np.diag((-1.0) ** np.arange(first.size))])
    options = {"initial_simplex": simplex, "maxfev": evaluations, "xatol": 4e-3, "fatol": 2e-5}
    answer = minimize(off, first, method="Nelder-Mead", options=options)
    return at(answer.x), float(answer.fun)


def sampled(count: int, seed: int) -> list[tuple[float, np.ndarray]]:
    """Misfits and corners of the samples that are not left early, the best first."""
    kept = []
    for corners in qmc.scale(qmc.Sobol(4, rng=seed).random(count), *REACH):
        width, height = abs(corners[2] - corners[0]), abs(corners[3] - corners[1])
        if min(width, height) < EDGE or not DIAGONAL[0] < np.hypot(width, height) < DIAGONAL[1]:
            continue
        try:
            kept.append((misfit(values(triangle(corners), COARSE, EARLY)), corners))
        except LeanboomError:
            continue
    return sorted(kept, key=lambda entry: entry[0])


def show(corners: np.ndarray) -> None:
    """A triangle beside the printed values."""
    found = values(triangle(corners), FINE)
    print(
        f"\nA ({corners[0]:.3f}, {corners[1]:.3f}), B ({corners[2]:.3f}, {corners[3]:.3f}), misfit {misfit(found):.4f}"
    )
    for name, value in found.items():
        printed = PRINTED[name].value
        print(f"  {name:45s} printed {printed:7.3f}  ours {value:7.3f}  difference {PRINTED[name].short(value):+.3f}")


def readings(corners: np.ndarray) -> None:
    """What every reading of the weighted pseudo-inverse gives on a triangle, relative to dynamic programs."""
    task = triangle(corners)
    start = starts.start_position(stages.discretise(task, FINE.stage), "smallest")
    assert start is not None
    cp, ls = best(task, start, "cp", FINE).energy_cp, best(task, start, "ls", FINE).energy_ls
    print("\n| weights | CP | LS |\n| --- | ---: | ---: |")
    rules = {"none, v'v": ("actuator", None), "A, directions of the solution": ("weighted", None)}
    for name, (variant, rule) in (
        rules | {name: ("actuator", rule) for name, rule in weights.READINGS.items()}
    ).items():
        judged = followed(task, pseudo_inverse.resolve(task, start, variant, rule=rule))
        print(f"| {name} | {judged.energy_cp / cp:.3f} | {judged.energy_ls / ls:.3f} |", flush=True)


def profile(corners: np.ndarray, evaluations: int) -> None:
    """How much the misfit grows when one coordinate is held off its place and the others are free."""
    print("\n| held | off by m | misfit | xA | zA | xB | zB |\n| --- | ---: | ---: | ---: | ---: | ---: | ---: |")
    for i, name in enumerate(("xA", "zA", "xB", "zB")):
        for step in STEPS:
            held = corners.copy()
            held[i] += step
            found, off = refined(held, tuple(j for j in range(4) if j != i), evaluations)
            text = " | ".join(f"{value:.2f}" for value in found)
            print(f"| {name} | {step:+.1f} | {off:.4f} | {text} |", flush=True)


def bundled() -> np.ndarray:
    """Corners A and B of the bundled triangle."""
    path = lb.load_task("loader-triangle-large").path
    assert isinstance(path, Lines)
    (xa, _, za), (xb, _, zb), *_ = path.points
    return np.array([xa, za, xb, zb])


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.triangle", description="Infer the triangle.")
    parser.add_argument("--samples", type=int, default=4096, help="of the search")
    parser.add_argument("--refine", type=int, default=3, help="how many of the best samples are refined")
    parser.add_argument("--evaluations", type=int, default=60, help="triangles judged in a refinement")
    parser.add_argument("--seed", type=int, default=1, help="of the samples")
    parser.add_argument("--corners", help="xA,zA,xB,zB in m: show this triangle instead of searching")
    parser.add_argument("--bundled", action="store_true", help="show the bundled triangle and the earlier guess")
    parser.add_argument("--weights", action="store_true", help="with all readings of the weighted pseudo-inverse")
    parser.add_argument("--profile", action="store_true", help="with the profile of the misfit")
    options = parser.parse_args()
    began = time.process_time()
    if options.corners:
        chosen = np.array([float(value) for value in options.corners.split(",")])
        show(chosen)
    elif options.bundled:
        show(np.array([value for corner in EARLIER_TRIANGLE for value in corner]))
        chosen = bundled()
        show(chosen)
    else:
        kept = sampled(options.samples, options.seed)
        print(f"{len(kept)} of {options.samples} samples judged to the end, {time.process_time() - began:.0f} s")
        ends = [refined(corners, (0, 1, 2, 3), options.evaluations) for _, corners in kept[: options.refine]]
        chosen = min(ends, key=lambda end: end[1])[0]
        for corners, _ in ends:
            show(corners)
    if options.weights:
        readings(chosen)
    if options.profile:
        profile(chosen, options.evaluations // 3)
    print(f"\n{time.process_time() - began:.0f} s of processor time")


if __name__ == "__main__":
    main()
