"""The start of the best closed cycle: the extension from which a motion that comes back to it takes least energy.

From a closed motion at a middle start, the start is moved step by step over all that are feasible, the motion polished
anew at each (see `fixed_mode`): a continuation in one parameter. A search begins at the best of these starts, whose
motion moves its start once more: with its modes fixed, its cost is smooth in it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from leanboom.components.costs import COSTS
from leanboom.errors import InputError
from leanboom.evaluation import ranking
from leanboom.evaluation.evaluate import Evaluation, judged_cost
from leanboom.fixed_mode import modes
from leanboom.fixed_mode.modes import Polisher
from leanboom.methods.dp_refined import Search
from leanboom.methods.registry import EFFORTS
from leanboom.model.motion import Motion
from leanboom.model.task import Task
from leanboom.problem import stages
from leanboom.problem.stages import Problem
from leanboom.progress import Progress

STARTS = 9  # of the continuation
FOLLOWED = (1, 2)  # of them, refined: without loads costs are nearly convex; with loads
ACCURACY, TRIALS = 0.02, 4  # of the start, as a share of the distance between two that are tried; evaluations


def best_cycle(task: Task, cost: str, grid: tuple[int, int], step: float, tell: Progress) -> Evaluation:
    """A judged closed motion from about the best start, of a task with start `best` and end `same`.

    Args:
        task: The task.
        cost: What to minimise, a name of `costs.COSTS`.
        grid: Coarse grid of the search from a start.
        step: Length of a stage [s].
        tell: Called with what happens and the share done.

    Raises:
        InputError: If no extension is feasible both at the beginning and at the end of the path.
    """
    problem = stages.discretise(task, step)
    lengths = common_lengths(problem, problem)
    tell(f"closed cycles from {lengths.size} starts", 0.02)
    middle = _search(task, float(lengths[STARTS // 2]), cost, grid, step)
    polisher = modes.build(stages.discretise(middle.task, step), cost)
    tried = [middle, *_continued(polisher, middle.motion, lengths[STARTS // 2 + 1 :])]
    tried += _continued(polisher, middle.motion, lengths[: STARTS // 2][::-1])
    tried.sort(key=lambda each: ranking.rank(each, judged_cost(each, cost)))
    best = tried[0]
    for each in tried[: FOLLOWED[COSTS[cost].loads]]:
        tell("the start of the closed cycle", 0.1)
        found = each if each is middle else _search(task, float(each.motion.position[0]), cost, grid, step)
        best = ranking.better(_moved_start(polisher, found, lengths), best, cost)
    return best


def common_lengths(first: Problem, last: Problem) -> np.ndarray:
    """Extensions to try [m]: evenly spaced over those feasible at the beginning of a path and at the end of another.

    Args:
        first, last: The discretised paths, of the first and the last leg; of a task without legs, its own twice.

    Raises:
        InputError: There are none.
    """
    low, high = max(first.lower[0], last.lower[-1]), min(first.upper[0], last.upper[-1])
    if low > high:
        ends = (f"{p.lower[k]:.4f} m to {p.upper[k]:.4f} m" for p, k in ((first, 0), (last, -1)))
        raise InputError("end = same; at the beginning of the path {} are feasible, at its end {}".format(*ends))
    return np.linspace(low, high, STARTS)


def _search(task: Task, start: float, cost: str, grid: tuple[int, int], step: float) -> Evaluation:
    """The best closed motion from a start [m], by a quick search."""
    return Search(replace(task, start=start), cost, grid, step, EFFORTS["quick"]).run()


def _continued(polisher: Polisher, first: Motion, lengths: np.ndarray) -> list[Evaluation]:
    """Judged closed motions from one start after the other [m], each polished from the one before."""
    at, found = stages.on_stages(polisher.problem, first), []
    for start in lengths.tolist():
        judged = modes.between(polisher, at, start, start)
        if judged is None:
            break
        found.append(judged)
        at = judged.motion
    return found


def _moved_start(polisher: Polisher, found: Evaluation, lengths: np.ndarray) -> Evaluation:
    """The best closed motion with the modes of a given one, its start moved by at most the distance of two tried."""
    from scipy.optimize import minimize_scalar

    cost, at = polisher.cost, stages.on_stages(polisher.problem, found.motion)
    switches = modes.modes(polisher, at)
    best, first = found, float(at.position[0])
    apart = float(lengths[1] - lengths[0])

    def closed(start: float) -> float:
        nonlocal best
        judged = modes.between(polisher, at, start, start, switches)
        if judged is None:
            return 10.0 * abs(judged_cost(found, cost))
        best = ranking.better(best, judged, cost)
        return judged_cost(judged, cost) * (1.0 if judged.feasible else 10.0)

    if apart > 0.0:
        low, high = max(first - apart, lengths[0]), min(first + apart, lengths[-1])
        minimize_scalar(
            closed, bounds=(low, high), method="bounded", options={"xatol": ACCURACY * apart, "maxiter": TRIALS}
        )
    return best
