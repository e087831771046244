"""The shortest duration of a task: the least factor on the times of its path at which a motion is found."""

from __future__ import annotations

from dataclasses import replace

from leanboom.methods.dp_refined import Search
from leanboom.methods.registry import EFFORTS
from leanboom.model.task import Task
from leanboom.problem import stages, starts


def slower(task: Task, factor: float) -> Task:
    """The same task taking `factor` times as long."""
    return replace(task, path=task.path.slower(factor))


def shortest_duration(
    task: Task, grid: tuple[int, int], step: float, accuracy: float = 0.01, most: float = 16.0, least: float = 1.0
) -> float | None:
    """Smallest factor on a task's duration, from `least` on, at which a feasible motion is found; None up to `most`.

    Args:
        task: The task.
        grid: Position and velocity nodes.
        step: Length of a stage [s].
        accuracy: Relative accuracy of the factor, and the margin added to it.
        most: Largest factor tried.
        least: Smallest factor tried.

    Returns:
        The factor, margin included; `least` where that is feasible.
    """

    def feasible(factor: float) -> bool:
        slow = slower(task, factor)
        problem = stages.discretise(slow, step)
        start = starts.start_position(problem, task.start)
        quick = (Search(slow, cost, grid, step, EFFORTS["quick"]) for cost in ("cp", "velocity"))
        return any(search.run_once(problem, start).feasible for search in quick)

    if feasible(least):
        return least
    bad, good = least, 2.0 * least
    while not feasible(good):
        bad, good = good, 2.0 * good
        if good > most:
            return None
    while good - bad > accuracy * good:
        middle = 0.5 * (good + bad)
        good, bad = (middle, bad) if feasible(middle) else (good, middle)
    return good * (1.0 + accuracy)
