"""Plans of whole cycles: tasks with legs, their timing planned where they leave it open.

Fastest legs come first, since next to nothing is left to choose in them, then the durations of others by
`time_sharing`, then all legs together by `leg_search`; at last the speed along legs of a free timing, between the
extensions found.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from leanboom.evaluation import ranking
from leanboom.evaluation.evaluate import Evaluation
from leanboom.methods.registry import Method, Settings
from leanboom.model.motion import Motion
from leanboom.model.task import Task
from leanboom.planning import junctions, leg_search, time_sharing
from leanboom.progress import Progress
from leanboom.timing import shortest

Freed = Callable[[Task, Motion], Evaluation]  # task of a free timing and a motion in its own -> the best with that


def plan(task: Task, cost: str, method: Method, tell: Progress, settings: Settings, freed: Freed) -> Evaluation:
    """The judged motion of a task with legs, its task with the durations and the timings that were planned.

    Args:
        task: The task.
        cost: What to minimise, a name of `costs.COSTS`.
        method: How each leg is planned.
        tell: Called with what happens and the share done.
        settings: As for a single task; seeds are motions of the whole task.
        freed: Plans the speed along a leg, whose start and end are given.

    Raises:
        InputError: Starts, ends and a total that are not feasible.
        InfeasibleError: The tool cannot follow a leg, whatever the extension.
    """
    fast = fastest(task, cost, tell)
    for i, leg in fast.items():
        task = _retimed(task, i, leg)
    task = time_sharing.share(task, cost, method, tell, settings, fast)
    found = leg_search.legs(task, cost, method, tell, settings, fast)
    for i, leg in enumerate(task.legs):
        if leg.timing == "free" and i not in fast:
            known = found[i]
            with junctions.named(i):
                found[i] = ranking.better(known, freed(replace(known.task, timing="free"), known.motion), cost)
        if leg.timing == "free":
            task = _retimed(task, i, found[i])
    return leg_search.whole(task, found)


def fastest(task: Task, cost: str, tell: Progress) -> dict[int, Evaluation]:
    """The judged motions of the legs whose duration is `shortest`, by their numbers from 0; arguments as in `plan`."""
    found: dict[int, Evaluation] = {}
    for i, leg in enumerate(task.legs):
        if leg.duration == "shortest":
            with junctions.named(i):
                found[i] = shortest.plan(_alone(task, i, found), cost, tell)
    return found


def _alone(task: Task, i: int, fast: dict[int, Evaluation]) -> Task:
    """A leg by itself, its extensions given where the legs before and after it, as far as known, say them."""
    part = [each for each in task.stretches if not each.waits][i]
    first, last = i == 0, i == len(task.legs) - 1
    ends = {k: (float(each.motion.position[0]), float(each.motion.position[-1])) for k, each in fast.items()}
    start = ends[i - 1][1] if i - 1 in ends else task.start if first else "best"
    end = "free" if not last else ends[0][0] if task.end == "same" and 0 in ends else task.end
    if end == "same" and not first:  # the start of the whole, which is that of another leg
        end = "free" if task.start == "best" else task.start
    return task.stretch(part, start, end)


def _retimed(task: Task, i: int, planned: Evaluation) -> Task:
    """The task with a leg in the timing of a motion of it."""
    leg = replace(task.legs[i], path=planned.task.path, duration=None, timing="fixed")
    return replace(task, legs=(*task.legs[:i], leg, *task.legs[i + 1 :]))
