"""Paths of the tool in time: straight lines, splines, and paths made out of others.

Every path is a polynomial in time on each of its pieces; `breaks` says where the pieces meet and `degree` how high the
polynomials go. Whatever has to hold between samples is decided on these pieces.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.polynomial import chebyshev

from leanboom.errors import InputError
from leanboom.quantities import ranges
from leanboom.quantities.declarations import hold_declared
from leanboom.quantities.ranges import Refused
from leanboom.quantities.rules import Listing, counted
from leanboom.quantities.types import Coordinate, Duration, Time

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

Values = tuple[np.ndarray, np.ndarray, np.ndarray]  # tool position, velocity, acceleration, (samples, 3) each

AXIS_DISTANCE = 0.1  # [m], a path nearer to the slewing axis may turn the base within some samples


def rising_from_zero(times: tuple[float, ...]) -> tuple[float, ...]:
    """The times [s], if they begin with 0 and every one is above the one before it."""
    if times[0] != 0.0 or any(b - a < 0.99 * ranges.MOMENT for a, b in pairwise(times)):
        raise Refused("times must begin with 0 and every one be above the one before it, by at least 0.0001 s")
    return times


_POINT = Listing("three lengths x, y, z", ranges.COORDINATE, 3, 3, bare=True)
Point = Annotated[tuple[Coordinate, Coordinate, Coordinate], _POINT]
Points = Annotated[tuple[Point, ...], Listing("at least two points [x, y, z]", _POINT, 2, bare=True)]
Durations = Annotated[tuple[Duration, ...], Listing("at least one time", ranges.DURATION, 1)]
Times = Annotated[tuple[Time, ...], Listing("at least two times", ranges.TIME, 2, order=rising_from_zero)]


@dataclass(frozen=True, slots=True)
class Lines:
    """Straight segments, each a quintic motion from rest to rest."""

    # Jazar 2010, as both papers use.
    points: Points
    """Corners [x, y, z], one more than durations."""
    durations: Durations
    """Of each segment."""

    def __post_init__(self) -> None:
        hold_declared(self, "path")
        counted("path.durations", self.durations, len(self.points) - 1, "one less than points")

    @property
    def duration(self) -> float:
        """Total time [s]."""
        return float(sum(self.durations))

    @property
    def breaks(self) -> np.ndarray:
        """Times where pieces meet, both ends included [s]."""
        return np.concatenate([[0.0], np.cumsum(self.durations)])

    @property
    def degree(self) -> int:
        """Degree of the polynomials in time."""
        return 5

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

    points: Points
    """Via points [x, y, z], as many as times."""
    times: Times
    """When each point is passed, rising from 0."""

    def __post_init__(self) -> None:
        hold_declared(self, "path")
        counted("path.times", self.times, len(self.points), "as many as points")

    @property
    def duration(self) -> float:
        """Total time [s]."""
        return float(self.times[-1])

    @property
    def breaks(self) -> np.ndarray:
        """Times where pieces meet, both ends included [s]."""
        return np.asarray(self.times)

    @property
    def degree(self) -> int:
        """Degree of the polynomials in time."""
        return 3

    def slower(self, factor: float) -> Spline:
        """The same path taking `factor` times as long."""
        return Spline(self.points, tuple(factor * t for t in self.times))

    def values(self, time: np.ndarray) -> Values:
        """Tool position [m], velocity [m/s] and acceleration [m/s^2] at times within [0, duration]."""
        spline = _cubic(self.points, self.times)
        return spline(time), spline(time, 1), spline(time, 2)


@dataclass(frozen=True, slots=True)
class Part:
    """A path between two of its times, its own time from 0: the rest of a task, or its known part."""

    path: Path
    since: Time
    until: Time

    def __post_init__(self) -> None:
        _hold(self)
        last = self.path.duration
        if not self.since < self.until <= last * (1.0 + 1e-9):
            raise InputError(
                f"path.since, path.until = {self.since:.6g} s, {self.until:.6g} s; the second must be above the first "
                f"and at most {last:.6g} s, the duration of the path"
            )

    @property
    def duration(self) -> float:
        """Total time [s]."""
        return self.until - self.since

    @property
    def breaks(self) -> np.ndarray:
        """Times where pieces meet, both ends included [s]."""
        return _within(self.path.breaks - self.since, self.duration)

    @property
    def degree(self) -> int:
        """Degree of the polynomials in time."""
        return self.path.degree

    def slower(self, factor: float) -> Part:
        """The same part taking `factor` times as long."""
        return Part(self.path.slower(factor), factor * self.since, factor * self.until)

    def values(self, time: np.ndarray) -> Values:
        """Tool position [m], velocity [m/s] and acceleration [m/s^2] at times within [0, duration]."""
        return self.path.values(np.clip(self.since + time, 0.0, self.path.duration))


@dataclass(frozen=True, slots=True)
class Moved:
    """A path blended, from `since` over `over` seconds by a quintic, into a copy of itself shifted by `offset`."""

    path: Path
    offset: Point
    """How far the rest of the path moves."""
    since: Time
    """Until then the path is as it was."""
    over: Duration
    """Time that leading over takes, by a quintic."""

    def __post_init__(self) -> None:
        _hold(self)

    @property
    def duration(self) -> float:
        """Total time [s]."""
        return self.path.duration

    @property
    def breaks(self) -> np.ndarray:
        """Times where pieces meet, both ends included [s]."""
        return _within(np.append(self.path.breaks, (self.since, self.since + self.over)), self.duration)

    @property
    def degree(self) -> int:
        """Degree of the polynomials in time."""
        return max(5, self.path.degree)

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
    """A path with a stop: from a time on the tool slows down evenly along it to rest."""

    path: Path
    since: Time
    over: Duration
    """Time that stopping takes."""

    def __post_init__(self) -> None:
        _hold(self)

    @property
    def duration(self) -> float:
        """Total time [s]."""
        return self.over

    @property
    def breaks(self) -> np.ndarray:
        """Times where pieces meet, both ends included [s]."""
        left = 1.0 - 2.0 * (self.path.breaks - self.since) / self.over  # of the way, when each is reached
        reached = self.over * (1.0 - np.sqrt(left[(left > 0.0) & (left < 1.0)]))
        return _within(reached, self.over)

    @property
    def degree(self) -> int:
        """Degree of the polynomials in time."""
        return 2 * self.path.degree

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
PATHS: dict[str, type] = {"lines": Lines, "spline": Spline}  # those that files hold


@lru_cache(maxsize=64)
def approaches(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """When a path is nearest to the slewing axis.

    The squared distance is a polynomial on every piece, so nothing falls between samples. Pieces that stay farther
    away than `AXIS_DISTANCE` are left out.

    Args:
        path: The path.

    Returns:
        Times at which the distance is smallest or stationary [s], and the distances [m].
    """
    ends = path.breaks
    middle, half = 0.5 * (ends[1:] + ends[:-1]), 0.5 * np.diff(ends)
    nodes = chebyshev.chebpts1(path.degree + 1)
    time = middle[:, None] + half[:, None] * nodes
    point = path.values(time.ravel())[0][:, :2].reshape(*time.shape, 2)
    series = np.einsum("nk,pni->pki", chebyshev.chebvander(nodes, path.degree), point) * (2.0 / nodes.size)
    series[:, 0] *= 0.5
    size = np.linalg.norm(series, axis=2)
    near = np.nonzero(size[:, 0] - size[:, 1:].sum(axis=1) <= AXIS_DISTANCE)[0]
    times, distances = [np.empty(0)], [np.empty(0)]
    for piece in near:
        x, y = series[piece].T
        square = chebyshev.chebadd(chebyshev.chebmul(x, x), chebyshev.chebmul(y, y))
        slope = chebyshev.chebtrim(chebyshev.chebder(square), 1e-13 * max(square[0], 1e-300))
        roots = chebyshev.chebroots(slope) if slope.size > 1 else np.empty(0)
        roots = roots.real[(np.abs(roots.imag) < 1e-6) & (np.abs(roots.real) < 1.0)]
        shares = np.concatenate([[-1.0], np.sort(roots), [1.0]])
        times.append(middle[piece] + half[piece] * shares)
        distances.append(np.hypot(chebyshev.chebval(shares, x), chebyshev.chebval(shares, y)))
    found = np.concatenate(times), np.concatenate(distances)
    for array in found:
        array.setflags(write=False)
    return found


def quintic(s: np.ndarray, duration: np.ndarray | float) -> Values:
    """The quintic from rest to rest, 0 to 1, at shares s of a duration [s]; also its rate and the rate of that."""
    return (
        s**3 * (10 - 15 * s + 6 * s**2),
        30 * s**2 * (1 - s) ** 2 / duration,
        60 * s * (1 - 3 * s + 2 * s**2) / duration**2,
    )


@lru_cache(maxsize=16)
def _cubic(points: tuple[tuple[float, float, float], ...], times: tuple[float, ...]) -> CubicSpline:
    """The clamped cubic through points [m] at times [s]."""
    from scipy.interpolate import CubicSpline  # half a second that loading a task does not need

    return CubicSpline(np.asarray(times), np.asarray(points, dtype=np.float64), bc_type="clamped")


def _within(times: np.ndarray, duration: float) -> np.ndarray:
    """Times inside a duration, in order, and its ends [s]."""
    return np.concatenate([[0.0], np.unique(times[(times > 0.0) & (times < duration)]), [duration]])


def _hold(made: Part | Moved | Braking) -> None:
    """Check the fields of a path made of another and keep them as floats."""
    if not isinstance(made.path, Path):
        raise InputError(f"path.path = {ranges.shown(made.path)}; must be a path")
    hold_declared(made, "path")
