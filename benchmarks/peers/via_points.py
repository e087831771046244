"""A stochastic global optimiser: CMA-ES over via-points of the redundant cylinder, the judge as its model.

The cylinder follows a clamped cubic spline from the start at rest through `POINTS` via-points, equally far apart in
time; the last of them is the end, at rest. A via-point is a share in [0, 1] of the feasible extensions at its time.
CMA-ES (Hansen's package `cma`, restarts with small and large populations in turn, BIPOP) needs no derivatives, so
every candidate is judged as it is: energy over a typical energy, plus `PENALTY` for every unit of limit use above 1.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from leanboom.evaluation import ranking
from leanboom.evaluation.evaluate import Evaluation, evaluate
from leanboom.methods import pseudo_inverse
from leanboom.methods.registry import Settings
from leanboom.model import motion
from leanboom.model.motion import Motion
from leanboom.model.task import Task
from leanboom.problem import cost_scale, feasible_strokes, stages
from leanboom.problem.stages import Problem

METHOD = "via-points"
POINTS = 12
STEP = 0.01  # [s], of the motion
EVALUATIONS, SECONDS = 20_000, 60.0  # whichever is used up first; seconds of the processor
SPREAD = 0.2  # first standard deviation, in shares
RESTARTS = 9
SEED = 20170506
PENALTY = 10.0
UNREACHED = 1e3  # cost of a motion that leaves the reach, before its distance

Progress = Callable[[str, float], None]


def plan(task: Task, cost: str, start: float, tell: Progress, settings: Settings) -> Motion:
    """The best judged motion of all candidates, of the feasible ones where there are any.

    Args:
        task: The task.
        cost: "ls" or "cp".
        start: Where the redundant cylinder starts [m].
        tell: Called with what happens and the share done.
        settings: Not used.
    """
    import cma

    began = time.process_time()
    problem = stages.discretise(task, STEP)
    scale = cost_scale.energy_scale(problem, cost)
    rng = np.random.default_rng(SEED)
    best: Evaluation | None = None
    count = 0

    def price(shares: np.ndarray) -> float:
        nonlocal best, count
        count += 1
        judged = evaluate(task, spline_motion(problem, start, shares, cost))
        if best is None or ranking.beats(judged, best, cost):
            best = judged
        return priced(problem, judged, cost, scale)

    first = [shares_of(problem, pseudo_inverse.resolve(task, start, "actuator"))]

    def guess() -> np.ndarray:
        return first.pop() if first else rng.uniform(size=POINTS)

    def used_up(search) -> bool:
        share = max(count / EVALUATIONS, (time.process_time() - began) / SECONDS)
        tell(f"evaluation {count}", min(1.0, share))
        return share >= 1.0

    options = {"bounds": [0.0, 1.0], "seed": SEED, "verbose": -9, "termination_callback": used_up}
    cma.fmin2(price, guess, SPREAD, options, restarts=RESTARTS, bipop=True)
    assert best is not None
    return replace(best.motion, log=(f"{count} evaluations",))


def via_times(problem: Problem) -> np.ndarray:
    """Times of start and via-points [s], (POINTS + 1,)."""
    return np.linspace(0.0, problem.task.duration, POINTS + 1)


def spline_motion(problem: Problem, start: float, shares: np.ndarray, cost: str) -> Motion:
    """The motion from a start [m] through via-points.

    Args:
        problem: The task on stages of `STEP`.
        start: Where it starts [m].
        shares: Via-points as shares of the feasible extensions at their times, (POINTS,).
        cost: What it is to minimise.
    """
    at = via_times(problem)
    low, high = np.interp(at[1:], problem.time, problem.lower), np.interp(at[1:], problem.time, problem.upper)
    spline = CubicSpline(at, np.append(start, low + shares * (high - low)), bc_type="clamped")
    velocity = spline(problem.time, 1)
    velocity[[0, -1]] = 0.0
    return motion.from_velocities(problem.step, start, velocity, METHOD, cost)


def shares_of(problem: Problem, guess: Motion) -> np.ndarray:
    """Via-points on a motion, as shares of the feasible extensions, (POINTS,)."""
    at = via_times(problem)[1:]
    low, high = np.interp(at, problem.time, problem.lower), np.interp(at, problem.time, problem.upper)
    return np.clip((guess.at(at)[0] - low) / np.maximum(high - low, feasible_strokes.STROKE_ACCURACY), 0.0, 1.0)


def priced(problem: Problem, judged: Evaluation, cost: str, scale: float) -> float:
    """What the search minimises: relative energy and a penalty for limits used above 1."""
    use = judged.limit_use
    excess = sum(max(0.0, value - 1.0) for value in (use.position, use.velocity, use.acceleration))
    if judged.followed:
        return judged.energy(cost) / scale + PENALTY * excess
    c = judged.motion.position
    return UNREACHED + float(np.sum(np.maximum(0.0, np.maximum(problem.lower - c, c - problem.upper))))
