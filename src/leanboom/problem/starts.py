"""The start and the end of the redundant cylinder that a task asks for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from leanboom.errors import InputError
from leanboom.model import motion
from leanboom.model.motion import Motion
from leanboom.model.task import Task
from leanboom.problem import stages
from leanboom.problem.stages import Problem


def start_position(problem: Problem, start: str | float) -> float | None:
    """The start of the redundant cylinder [m] that a task asks for; None for `best`.

    Raises:
        InputError: If a given length is outside the feasible extensions at the start of the path.
    """
    if start == "best":
        return None
    length = _length(problem.intervals[0], start)
    if not _feasible(problem.intervals[0], length):
        allowed = _allowed(problem.intervals[0])
        raise InputError(f"start = {length:g} m; feasible at the beginning of this path: {allowed}")
    return length


def end_position(problem: Problem, start: float | None) -> float | None:
    """The end of the redundant cylinder [m] that a task asks for; None for `free`, and for that of an open start.

    Args:
        problem: The discretised task.
        start: Where it starts [m]; None for `best`.

    Raises:
        InputError: If a given length, or the start to come back to, is outside the feasible extensions at the end.
    """
    end = problem.task.end
    if end == "free" or (end == "same" and start is None):
        return None
    length = start if end == "same" and start is not None else _length(problem.intervals[-1], end)
    if not _feasible(problem.intervals[-1], length):
        allowed = _allowed(problem.intervals[-1])
        said = f"end = same, and the start is {length:.4f} m" if end == "same" else f"end = {length:g} m"
        raise InputError(f"{said}; feasible at the end of this path: {allowed}")
    return length


def ended(problem: Problem, seed: Motion) -> Motion:
    """A motion on a problem's stages that ends where the task asks."""
    at = stages.on_stages(problem, seed)
    end = end_position(problem, float(at.position[0]))
    return at if end is None else motion.ending_at(at, end)


def settled(task: Task, step: float) -> Task:
    """A task with its end as a length; itself where the end is free, or that of an open start.

    Raises:
        InputError: As in `start_position` and `end_position`.
    """
    if not isinstance(task.end, str) or task.end == "free":
        return task
    problem = stages.discretise(task, step)
    end = end_position(problem, start_position(problem, task.start))
    return task if end is None else replace(task, end=end)


def _length(intervals: np.ndarray, place: str | float) -> float:
    """A length of the feasible ones, (intervals, 2) [m], by its word."""
    low, high = intervals[0, 0], intervals[-1, 1]
    if place == "smallest":
        return float(low)
    if place == "middle":
        # Between the smallest and the largest feasible length; beside a gap, its nearest end.
        middle = 0.5 * (low + high)
        nearest = np.clip(middle, intervals[:, 0], intervals[:, 1])
        return float(nearest[np.abs(nearest - middle).argmin()])
    return float(place)


def _feasible(intervals: np.ndarray, length: float) -> bool:
    return bool(np.any((intervals[:, 0] - 1e-9 <= length) & (length <= intervals[:, 1] + 1e-9)))


def _allowed(intervals: np.ndarray) -> str:
    return " or ".join(f"{low:.4f} m to {high:.4f} m" for low, high in intervals)
