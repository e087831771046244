"""The start of the redundant cylinder that a task asks for."""

from __future__ import annotations

import numpy as np

from leanboom.errors import InputError
from leanboom.problem.stages import Problem


def start_position(problem: Problem, start: str | float) -> float | None:
    """The start of the redundant cylinder [m] that a task asks for; None for `best`.

    Raises:
        InputError: If a given length is outside the feasible extensions at the start of the path.
    """
    intervals = problem.intervals[0]
    if start == "smallest":
        return float(problem.lower[0])
    if start == "middle":
        # Between the smallest and the largest feasible length; beside a gap, its nearest end.
        middle = 0.5 * (problem.lower[0] + problem.upper[0])
        nearest = np.clip(middle, intervals[:, 0], intervals[:, 1])
        return float(nearest[np.abs(nearest - middle).argmin()])
    if start == "best":
        return None
    length = float(start)
    if not np.any((intervals[:, 0] - 1e-9 <= length) & (length <= intervals[:, 1] + 1e-9)):
        allowed = " or ".join(f"{low:.4f} m to {high:.4f} m" for low, high in intervals)
        raise InputError(f"start = {length:g} m; feasible at the beginning of this path: {allowed}")
    return length
