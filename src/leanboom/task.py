"""A task: which machine moves its tool along which path, and the sampled reference that results.

Paths are given in the machine's frame (x forward, y left, z up) and always start and end at rest.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from leanboom.machine import Machine


@dataclass(frozen=True, slots=True)
class Lines:
    """Straight segments, each a quintic rest-to-rest motion (Jazar 2010, as both papers use)."""

    points: tuple[tuple[float, float, float], ...]  # [m], one more than durations
    durations: tuple[float, ...]  # [s]

    @property
    def duration(self) -> float:
        """Total time [s]."""
        return float(sum(self.durations))


@dataclass(frozen=True, slots=True)
class Spline:
    """Clamped cubic spline through via points: zero velocity at both ends."""

    points: tuple[tuple[float, float, float], ...]  # [m]
    times: tuple[float, ...]  # [s], increasing from 0

    @property
    def duration(self) -> float:
        """Total time [s]."""
        return float(self.times[-1])


Path = Lines | Spline
Start = str | float  # "smallest" | "middle" | "best" | length of the redundant cylinder [m]


@dataclass(frozen=True, slots=True)
class Task:
    """A machine, a payload at its tool, a path in time and where the redundant cylinder starts."""

    name: str
    machine: Machine
    path: Path
    payload: float = 0.0  # [kg]
    start: Start = "smallest"
    smooth: float | None = None  # low-pass cut-off for the judged redundant motion [Hz]; None: none
    source: str = field(default="", repr=False, compare=False)  # the file's text

    @property
    def duration(self) -> float:
        """Time the path takes [s]."""
        return self.path.duration


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """The tool path sampled in time, in the boom's own coordinates (radius from the slewing axis, height).

    All arrays are float64, (samples,), read-only.
    """

    time: np.ndarray  # [s]
    point: np.ndarray  # tool position [m], (samples, 3)
    velocity: np.ndarray  # [m/s], (samples, 3)
    acceleration: np.ndarray  # [m/s^2], (samples, 3)


def sample(task: Task, time: np.ndarray) -> Reference:
    """Tool position, velocity and acceleration at the given times.

    Args:
        task: The task whose path is sampled.
        time: Times [s], (samples,), within [0, duration]; values outside are held at the ends.

    Returns:
        The reference at those times.
    """
    time = np.asarray(time, dtype=np.float64)
    clamped = np.clip(time, 0.0, task.duration)
    path = task.path
    points = np.asarray(path.points, dtype=np.float64)
    if isinstance(path, Spline):
        from scipy.interpolate import CubicSpline  # half a second that loading a task does not need

        spline = CubicSpline(np.asarray(path.times), points, bc_type="clamped")
        values = [spline(clamped, order) for order in range(3)]
    else:
        ends = np.cumsum(path.durations)
        segment = np.minimum(np.searchsorted(ends, clamped, side="right"), len(ends) - 1)
        length = np.asarray(path.durations)[segment]
        s = np.clip((clamped - (ends[segment] - length)) / length, 0.0, 1.0)
        step = points[segment + 1] - points[segment]
        # Quintic rest-to-rest: s(0)=0, s(1)=1, zero velocity and acceleration at both ends.
        shape = (
            s**3 * (10 - 15 * s + 6 * s**2),
            30 * s**2 * (1 - s) ** 2 / length,
            60 * s * (1 - 3 * s + 2 * s**2) / length**2,
        )
        values = [shape[order][:, None] * step for order in range(3)]
        values[0] = values[0] + points[segment]
    arrays = [time.copy(), *values]
    for array in arrays:
        array.setflags(write=False)
    return Reference(*arrays)
