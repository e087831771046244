"""A task: which machine moves its tool along which path, and the sampled reference that results.

Paths are given in the machine's frame (x forward, y left, z up) and always start and end at rest.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from leanboom.errors import InputError
from leanboom.machine import Machine

Values = tuple[np.ndarray, np.ndarray, np.ndarray]  # tool position, velocity, acceleration, (samples, 3) each


@dataclass(frozen=True, slots=True)
class Lines:
    """Straight segments, each a quintic rest-to-rest motion (Jazar 2010, as both papers use)."""

    points: tuple[tuple[float, float, float], ...]  # [m], one more than durations
    durations: tuple[float, ...]  # [s]

    @property
    def duration(self) -> float:
        """Total time [s]."""
        return float(sum(self.durations))

    def slower(self, factor: float) -> Lines:
        """The same path taking `factor` times as long."""
        return Lines(self.points, tuple(factor * d for d in self.durations))

    def values(self, time: np.ndarray) -> Values:
        """Tool position [m], velocity [m/s] and acceleration [m/s^2] at times within [0, duration]."""
        points = np.asarray(self.points, dtype=np.float64)
        ends = np.cumsum(self.durations)
        segment = np.minimum(np.searchsorted(ends, time, side="right"), len(ends) - 1)
        length = np.asarray(self.durations)[segment]
        s = np.clip((time - (ends[segment] - length)) / length, 0.0, 1.0)
        step = points[segment + 1] - points[segment]
        position, velocity, acceleration = (rate[:, None] * step for rate in quintic(s, length))
        return position + points[segment], velocity, acceleration


@dataclass(frozen=True, slots=True)
class Spline:
    """Clamped cubic spline through via points: zero velocity at both ends."""

    points: tuple[tuple[float, float, float], ...]  # [m]
    times: tuple[float, ...]  # [s], increasing from 0

    @property
    def duration(self) -> float:
        """Total time [s]."""
        return float(self.times[-1])

    def slower(self, factor: float) -> Spline:
        """The same path taking `factor` times as long."""
        return Spline(self.points, tuple(factor * t for t in self.times))

    def values(self, time: np.ndarray) -> Values:
        """Tool position [m], velocity [m/s] and acceleration [m/s^2] at times within [0, duration]."""
        from scipy.interpolate import CubicSpline  # half a second that loading a task does not need

        points = np.asarray(self.points, dtype=np.float64)
        spline = CubicSpline(np.asarray(self.times), points, bc_type="clamped")
        return spline(time), spline(time, 1), spline(time, 2)


@dataclass(frozen=True, slots=True)
class Part:
    """A path between two of its times, on a clock of its own: what is left to do, or what is known of it."""

    path: Path
    since: float  # [s]
    until: float  # [s]

    @property
    def duration(self) -> float:
        """Total time [s]."""
        return self.until - self.since

    def slower(self, factor: float) -> Part:
        """The same part taking `factor` times as long."""
        return Part(self.path.slower(factor), factor * self.since, factor * self.until)

    def values(self, time: np.ndarray) -> Values:
        """Tool position [m], velocity [m/s] and acceleration [m/s^2] at times within [0, duration]."""
        return self.path.values(np.clip(self.since + time, 0.0, self.path.duration))


@dataclass(frozen=True, slots=True)
class Moved:
    """A path whose target moves on the way: from a time on the tool is led over, smoothly, to a path beside it."""

    path: Path
    offset: tuple[float, float, float]  # how far the rest of the path moves [m]
    since: float  # until then the path is as it was [s]
    over: float  # time that leading over takes, by a quintic [s]

    @property
    def duration(self) -> float:
        """Total time [s]."""
        return self.path.duration

    def slower(self, factor: float) -> Moved:
        """The same path taking `factor` times as long."""
        return Moved(self.path.slower(factor), self.offset, factor * self.since, factor * self.over)

    def values(self, time: np.ndarray) -> Values:
        """Tool position [m], velocity [m/s] and acceleration [m/s^2] at times within [0, duration]."""
        s = np.clip((time - self.since) / self.over, 0.0, 1.0)
        offset = np.asarray(self.offset, dtype=np.float64)
        pairs = zip(self.path.values(time), quintic(s, self.over), strict=True)
        position, velocity, acceleration = (values + rate[:, None] * offset for values, rate in pairs)
        return position, velocity, acceleration


@dataclass(frozen=True, slots=True)
class Braking:
    """A path left early: from a time on the tool slows down evenly along it until it stands."""

    path: Path
    since: float  # [s]
    over: float  # time that stopping takes [s]

    @property
    def duration(self) -> float:
        """Total time [s]."""
        return self.over

    def slower(self, factor: float) -> Braking:
        """The same path taking `factor` times as long."""
        return Braking(self.path.slower(factor), factor * self.since, factor * self.over)

    def values(self, time: np.ndarray) -> Values:
        """Tool position [m], velocity [m/s] and acceleration [m/s^2] at times within [0, duration]."""
        rate = (1.0 - time / self.over)[:, None]
        reached = self.since + time * (1.0 - 0.5 * time / self.over)
        position, velocity, acceleration = self.path.values(np.clip(reached, 0.0, self.path.duration))
        return position, rate * velocity, rate**2 * acceleration - velocity / self.over


Path = Lines | Spline | Part | Moved | Braking
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

    def __repr__(self) -> str:
        start = self.start if isinstance(self.start, str) else f"{self.start:g} m"
        path = self.path
        points = f" through {len(path.points)} points" if isinstance(path, Lines | Spline) else ""
        return (
            f"Task({self.name}: {self.machine.name}, {type(path).__name__.lower()}{points} in {path.duration:g} s, "
            f"payload {self.payload:g} kg, start {start}" + (f", smooth {self.smooth:g} Hz)" if self.smooth else ")")
        )


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """The tool path sampled in time, in the boom's own coordinates (radius from the slewing axis, height).

    All arrays are float64, (samples,), read-only.
    """

    time: np.ndarray  # [s]
    point: np.ndarray  # tool position [m], (samples, 3)
    velocity: np.ndarray  # [m/s], (samples, 3)
    acceleration: np.ndarray  # [m/s^2], (samples, 3)


def written(task: Task) -> Lines | Spline:
    """The path of a task as a file can hold it.

    Raises:
        InputError: If the path is made in Python out of others: a part of one, one that moves, one that is left.
    """
    if isinstance(task.path, Lines | Spline):
        return task.path
    kind = type(task.path).__name__.lower()
    raise InputError(f"the path of task {task.name} is a {kind} path; files and tables hold lines and splines alone")


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
    values = task.path.values(clamped)
    arrays = [time.copy(), *values]
    for array in arrays:
        array.setflags(write=False)
    return Reference(*arrays)


def quintic(s: np.ndarray, duration: np.ndarray | float) -> Values:
    """The quintic from rest to rest, 0 to 1, at shares s of a duration [s]; also its rate and the rate of that."""
    return (
        s**3 * (10 - 15 * s + 6 * s**2),
        30 * s**2 * (1 - s) ** 2 / duration,
        60 * s * (1 - 3 * s + 2 * s**2) / duration**2,
    )
