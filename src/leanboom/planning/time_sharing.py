"""Time shared among legs whose duration is a range: for least energy in a given total, or at a price of time.

Between given extensions the legs are independent, so what the whole costs is a sum of curves, cost over duration, one a
leg. Each is followed from a planned motion to shorter and longer times by the polish. On a fine grid of times the least
sum for a total is exact, whatever the curves' shapes; then the cycle is planned again and the curves are looked at
closer.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from leanboom.components.costs import PUMPS
from leanboom.errors import InputError
from leanboom.evaluation.evaluate import Evaluation, judged_cost
from leanboom.fixed_mode import modes
from leanboom.methods.registry import Method, Settings
from leanboom.model import motion
from leanboom.model.legs import Leg, span
from leanboom.model.task import Task
from leanboom.planning import junctions, leg_search
from leanboom.problem import stages
from leanboom.progress import Progress

SAMPLES = (7, 5)  # of each curve, in a first and in a second round
CLOSER = 0.2  # how much of a range the second round looks at, around what the first one chose
BISECTIONS = 3  # towards the shortest feasible duration
TIMES = 300  # of the grid on which time is shared

Curve = tuple[np.ndarray, np.ndarray]  # durations of a leg [s], and what it costs in them


def share(
    task: Task, cost: str, method: Method, tell: Progress, settings: Settings, given: dict[int, Evaluation]
) -> Task:
    """The task with a duration chosen for every leg that has a range.

    Args:
        task: The task; nothing but ranges is left to choose.
        cost: What to minimise, a name of `costs.COSTS`, in [J] where time has a price.
        method: How each leg is planned.
        tell: Called with what happens and the share done.
        settings: Of the plan; the curves are made of quick ones.
        given: Legs, by their number from 0, whose motion is given.

    Raises:
        InputError: The total is out of reach of the legs as they are.
    """
    if not any(isinstance(leg.duration, tuple) for leg in task.legs):
        return task
    if task.time_price is not None and cost not in PUMPS:
        raise InputError(f"time_price = {task.time_price:g} W; needs a cost that is an energy: {' or '.join(PUMPS)}")
    spans = [span(leg) for leg in task.legs]
    check_total(task, spans)
    quick = replace(settings, effort="quick", seeds=(), prover=None)
    times = _evenly(task, spans)
    for count, part in zip(SAMPLES, (1.0, CLOSER), strict=True):
        tell("time of the legs", 0.01)
        known = leg_search.legs(_lasting(task, times), cost, method, tell, quick, given)
        near = [
            (max(low, t - 0.5 * part * (high - low)), min(high, t + 0.5 * part * (high - low)))
            if part < 1.0 else (low, high)
            for t, (low, high) in zip(times, spans, strict=True)
        ]  # fmt: skip
        curves = [_curve(leg, each, cost, ends, count) for leg, each, ends in zip(task.legs, known, near, strict=True)]
        times = _shared(task, curves, near, times)
    return _lasting(task, times)


def check_total(task: Task, spans: list[tuple[float, float]]) -> None:
    """Raise InputError where legs of known shortest and longest durations [s] do not make up the task's total."""
    if task.total is None:
        return
    waits = sum(leg.dwell for leg in task.legs)
    least, most = (waits + sum(ends[i] for ends in spans) for i in (0, 1))
    if task.total < least - 1e-9:
        allowed = f"at least {least:.6g} s, the sum of the shortest legs and waiting"
    elif task.total > most + 1e-9:
        allowed = f"at most {most:.6g} s, the sum of the longest legs and waiting"
    else:
        return
    raise InputError(f"total = {task.total:g} s; must be {allowed}")


def _lasting(task: Task, times: list[float]) -> Task:
    """The task with durations of its legs [s] in place of their ranges."""
    legs = [
        leg.lasting(time) if isinstance(leg.duration, tuple) else leg
        for leg, time in zip(task.legs, times, strict=True)
    ]
    return replace(task, legs=tuple(legs), total=None, time_price=None)


def _evenly(task: Task, spans: list[tuple[float, float]]) -> list[float]:
    """Durations to begin with [s]: the nearest to the legs' own ones, or the same share of each range for a total."""
    if task.total is None:
        return [leg.timed.duration for leg in task.legs]
    least, most = (sum(ends[i] for ends in spans) for i in (0, 1))
    left = task.total - sum(leg.dwell for leg in task.legs) - least
    part = left / (most - least) if most > least else 0.0
    return [low + part * (high - low) for low, high in spans]


def _curve(
    leg: Leg, known: Evaluation, cost: str, ends: tuple[float, float], count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Durations [s] and what a leg costs in them, polished one from the other; infinite where none keeps its limits."""
    low, high = ends
    own = known.task.duration
    times = np.unique(np.clip([*np.linspace(low, high, count), own], low, high)) if high > low else np.array([own])
    costs = np.full(times.size, np.inf)
    first = int(np.abs(times - own).argmin())
    costs[first] = judged_cost(known, cost) if known.feasible else np.inf
    at = known
    for k in range(first + 1, times.size):
        found = _in_time(leg, at, cost, float(times[k]))
        if found is None:
            break
        at, costs[k] = found, judged_cost(found, cost) if found.feasible else np.inf
    at = known
    for k in range(first - 1, -1, -1):
        found = _in_time(leg, at, cost, float(times[k]))
        if found is None or not found.feasible:
            return _towards_shortest(leg, at, cost, (times, costs), k)
        at, costs[k] = found, judged_cost(found, cost)
    return times, costs


def _towards_shortest(leg: Leg, at: Evaluation, cost: str, curve: Curve, k: int) -> Curve:
    """A curve with more points between a duration that is too short, by its index, and the next one, of a motion."""
    times, costs = (list(values) for values in curve)
    bad, good = times[k], times[k + 1]
    for _ in range(BISECTIONS):
        middle = 0.5 * (bad + good)
        found = _in_time(leg, at, cost, middle)
        if found is None or not found.feasible:
            bad = middle
        else:
            at, good = found, middle
            times.insert(k + 1, middle)
            costs.insert(k + 1, judged_cost(found, cost))
    return np.array(times), np.array(costs)


def _in_time(leg: Leg, beside: Evaluation, cost: str, duration: float) -> Evaluation | None:
    """A leg in another duration [s], polished from a motion of it; None where nothing is found."""
    moved = beside.motion
    task = replace(beside.task, path=leg.lasting(duration).timed)
    problem = junctions.ended(stages.discretise(task, duration / moved.acceleration.size))
    polisher = modes.build(problem, cost)
    slower = duration / moved.duration
    seed = motion.from_velocities(problem.step, moved.position[0], moved.velocity / slower, moved.method, cost)
    ends = float(moved.position[0]), float(moved.position[-1])
    return modes.between(polisher, seed, *ends, modes.modes(polisher, seed))


def _shared(task: Task, curves: list[Curve], spans: list[tuple[float, float]], now: list[float]) -> list[float]:
    """The durations of least cost [s]: with time's price, or so that they make up the task's total.

    Args:
        task: The task.
        curves: Durations and costs of each leg.
        spans: Durations to choose from.
        now: Durations of the known motions, kept where no curve is known.
    """
    if any(not np.isfinite(costs).any() for _, costs in curves):
        return now
    if task.total is None:
        price = task.time_price or 0.0
        fine = [np.linspace(low, high, TIMES + 1) for low, high in spans]
        return [
            float(times[(_between(curve, times) + price * times).argmin()])
            for curve, times in zip(curves, fine, strict=True)
        ]
    left = task.total - sum(leg.dwell for leg in task.legs) - sum(low for low, _ in spans)
    step = left / TIMES
    if step <= 0.0:
        return [low for low, _ in spans]
    # least[k]: of the legs so far, with k steps of time beyond their shortest; choice: how many the last of them takes
    least, choices = np.where(np.arange(TIMES + 1) == 0, 0.0, np.inf), []
    for curve, (low, high) in zip(curves, spans, strict=True):
        most = min(TIMES, int((high - low) / step + 1e-9))
        own = _between(curve, np.minimum(low + step * np.arange(most + 1), high))
        sums = np.full((TIMES + 1, most + 1), np.inf)
        for j in range(most + 1):
            sums[j:, j] = least[: TIMES + 1 - j] + own[j]
        choices.append(sums.argmin(axis=1))
        least = sums.min(axis=1)
    if not np.isfinite(least[-1]):
        return now
    taken, k = [], TIMES
    for choice in reversed(choices):
        taken.append(int(choice[k]))
        k -= taken[-1]
    return [low + step * j for (low, _), j in zip(spans, reversed(taken), strict=True)]


def _between(curve: Curve, times: np.ndarray) -> np.ndarray:
    """A curve's costs at times [s], smooth between its points; infinite beyond those that are feasible."""
    from scipy.interpolate import PchipInterpolator

    known = np.isfinite(curve[1])
    at, costs = curve[0][known], curve[1][known]
    inside = (times >= at[0] - 1e-9) & (times <= at[-1] + 1e-9)
    smooth = (
        PchipInterpolator(at, costs)(np.clip(times, at[0], at[-1])) if at.size > 1 else np.full(times.size, costs[0])
    )
    return np.where(inside, smooth, np.inf)
