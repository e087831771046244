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
from leanboom.quantities.declarations import Variant, hold_declared
from leanboom.quantities.ranges import Refused
from leanboom.quantities.rules import Listing, counted
from leanboom.quantities.types import Coefficient, Coordinate, Duration, Time

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

Values = tuple[np.ndarray, np.ndarray, np.ndarray]  # tool position, velocity, acceleration, (samples, 3) each

AXIS_DISTANCE = 0.1  # [m], a path nearer to the slewing axis may turn the base within some samples


def rising_from_zero(times: tuple[float, ...]) -> tuple[float, ...]:
    """The times [s], if they begin with 0 and every one is above the one before it."""
    if times[0] != 0.0 or any(b - a < 0.99 * ranges.MOMENT for a, b in pairwise(times)):
        raise Refused("times must begin with 0 and every one be above the one before it, by at least 0.0001 s")
    return times


def moving(rates: tuple[float, ...]) -> tuple[float, ...]:
    """The rates, if one of them is above 0: else the path would never be followed."""
    if not any(rates):
        raise Refused("one of the rates must be above 0")
    return rates


_POINT = Listing("three lengths x, y, z", ranges.COORDINATE, 3, 3, bare=True)
Point = Annotated[tuple[Coordinate, Coordinate, Coordinate], _POINT]
Points = Annotated[tuple[Point, ...], Listing("at least two points [x, y, z]", _POINT, 2, bare=True)]
Durations = Annotated[tuple[Duration, ...], Listing("at least one time", ranges.DURATION, 1)]
Times = Annotated[tuple[Time, ...], Listing("at least two times", ranges.TIME, 2, order=rising_from_zero)]
Rates = Annotated[tuple[Coefficient, ...], Listing("at least two rates", ranges.COEFFICIENT, 2, order=moving)]


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
        ends, segment = np.cumsum(self.durations), pieces(self.breaks, time)
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


OWN: dict[str, type] = {"lines": Lines, "spline": Spline}  # paths with a timing of their own


@dataclass(frozen=True, slots=True)
class Retimed:
    """A path followed at another speed: its own timing runs faster and slower, and the tool passes the same points."""

    # A cubic from rest to rest leaves a corner at once; a quintic's acceleration is zero there, and a law that
    # accelerates from the corner on would have to run it infinitely fast.
    path: Annotated[Lines | Spline, Variant(OWN)]
    """Where the tool goes; segments of `lines` count as cubics from rest to rest in their durations."""
    rates: Rates
    """How many times as fast as by its own timing, at equally spaced times from start to end, linear between them."""

    def __post_init__(self) -> None:
        if not isinstance(self.path, Lines | Spline):
            raise InputError(f"path.path = {ranges.shown(self.path)}; must be lines or a spline")
        hold_declared(self, "path")
        if not self.duration >= ranges.MOMENT:
            raise InputError(f"path.rates make the path last {self.duration:.3g} s; must be at least 0.0001 s")

    @property
    def duration(self) -> float:
        """Total time [s]."""
        return float(self.path.duration / np.mean(_between(self.rates)))

    @property
    def nodes(self) -> np.ndarray:
        """Times of the rates [s]."""
        return np.linspace(0.0, self.duration, len(self.rates))

    @property
    def breaks(self) -> np.ndarray:
        """Times where pieces meet, both ends included [s]."""
        nodes = self.nodes
        times = self.when(self.path.breaks[1:-1])
        apart = np.abs(times[:, None] - nodes).min(axis=1, initial=np.inf) > 1e-9 * self.duration
        return _within(np.append(nodes, times[apart]), self.duration)

    def when(self, own: np.ndarray) -> np.ndarray:
        """Times at which times of the path's own timing are passed [s]."""
        nodes, passed, rates = self.nodes, self._passed, np.asarray(self.rates)
        k = np.clip(np.searchsorted(passed, own, side="right") - 1, 0, len(nodes) - 2)
        left, slope = own - passed[k], (rates[k + 1] - rates[k]) / nodes[1]
        root = np.sqrt(np.maximum(rates[k] ** 2 + 2.0 * slope * left, 0.0))
        return nodes[k] + 2.0 * left / np.maximum(rates[k] + root, 1e-300)

    @property
    def degree(self) -> int:
        """Degree of the polynomials in time."""
        return 6

    @property
    def _passed(self) -> np.ndarray:
        """Times of the path's own timing that are passed at the nodes [s]."""
        passed = np.concatenate([[0.0], np.cumsum(_between(self.rates))])
        return passed * (self.path.duration / passed[-1])

    def slower(self, factor: float) -> Retimed:
        """The same path taking `factor` times as long."""
        return Retimed(self.path.slower(factor), self.rates)

    def own(self, time: np.ndarray) -> Values:
        """Time of the path's own timing [s] at times within [0, duration], its rate, and the rate of that [1/s]."""
        rates, step = np.asarray(self.rates), self.duration / (len(self.rates) - 1)
        k = np.clip((time / step + 1e-9).astype(int), 0, rates.size - 2)
        since, slope = time - k * step, (rates[k + 1] - rates[k]) / step
        passed = self._passed[k] + since * (rates[k] + 0.5 * slope * since)
        return np.clip(passed, 0.0, self.path.duration), rates[k] + slope * since, slope

    def values(self, time: np.ndarray) -> Values:
        """Tool position [m], velocity [m/s] and acceleration [m/s^2] at times within [0, duration]."""
        passed, rate, slope = self.own(time)
        position, first, second = geometry(self.path, passed)
        rate, slope = rate[:, None], slope[:, None]
        return position, first * rate, second * rate**2 + first * slope


def pieces(breaks: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Numbers of the pieces in which times are, from 0; where two pieces meet, that of the later one.

    Args:
        breaks: Times where pieces meet, both ends included [s].
        time: The times [s].
    """
    return np.searchsorted(breaks[1:-1], time, side="right")


def geometry(path: Lines | Spline, passed: np.ndarray) -> Values:
    """Tool position [m] and its two derivatives over a path's own time [s], as `Retimed` follows the path."""
    begins, coefficients = cubics(path)
    piece = pieces(path.breaks, passed)
    c = coefficients[piece]
    since = (passed - begins[piece])[:, None]
    position = c[:, 0] + since * (c[:, 1] + since * (c[:, 2] + since * c[:, 3]))
    return position, c[:, 1] + since * (2.0 * c[:, 2] + 3.0 * since * c[:, 3]), 2.0 * c[:, 2] + 6.0 * since * c[:, 3]


@lru_cache(maxsize=16)
def cubics(path: Lines | Spline) -> tuple[np.ndarray, np.ndarray]:
    """The pieces of a path over its own time, as `Retimed` follows it.

    Returns:
        When they begin [s], (pieces,), and their coefficients in powers of the time since, (pieces, 4, 3).
    """
    if isinstance(path, Spline):
        coefficients = np.ascontiguousarray(np.swapaxes(_cubic(path.points, path.times).c, 0, 1)[:, ::-1])
    else:
        points, length = np.asarray(path.points, dtype=np.float64), np.asarray(path.durations)[:, None]
        step = np.diff(points, axis=0)
        powers = (points[:-1], np.zeros_like(step), 3.0 * step / length**2, -2.0 * step / length**3)
        coefficients = np.stack(powers, axis=1)
    begins = path.breaks[:-1]
    for array in (begins, coefficients):
        array.setflags(write=False)
    return begins, coefficients


def _between(rates: tuple[float, ...]) -> np.ndarray:
    """The mean of every two rates that follow each other."""
    values = np.asarray(rates)
    return 0.5 * (values[1:] + values[:-1])


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


@dataclass(frozen=True, slots=True)
class Joined:
    """Paths one after the other, each from rest to rest and from where the one before it ends."""

    paths: tuple[Path, ...]

    @property
    def duration(self) -> float:
        """Total time [s]."""
        return float(self._ends[-1])

    @property
    def breaks(self) -> np.ndarray:
        """Times where pieces meet, both ends included [s]."""
        begins = self._ends - [path.duration for path in self.paths]
        later = [begin + path.breaks[1:] for begin, path in zip(begins, self.paths, strict=True)]
        return np.concatenate([[0.0], *later])

    @property
    def degree(self) -> int:
        """Degree of the polynomials in time."""
        return max(path.degree for path in self.paths)

    @property
    def _ends(self) -> np.ndarray:
        """When each path ends [s]."""
        return np.cumsum([path.duration for path in self.paths])

    def slower(self, factor: float) -> Joined:
        """The same paths taking `factor` times as long."""
        return Joined(tuple(path.slower(factor) for path in self.paths))

    def values(self, time: np.ndarray) -> Values:
        """Tool position [m], velocity [m/s] and acceleration [m/s^2] at times within [0, duration]."""
        time, ends = np.asarray(time, dtype=np.float64), self._ends
        at = pieces(np.append(0.0, ends), time)
        found = tuple(np.empty((time.size, 3)) for _ in range(3))
        for i, path in enumerate(self.paths):
            here = at == i
            begin = ends[i] - path.duration
            for rows, values in zip(found, path.values(np.clip(time[here] - begin, 0.0, path.duration)), strict=True):
                rows[here] = values
        return found[0], found[1], found[2]


Path = Lines | Spline | Retimed | Part | Moved | Braking | Joined
PATHS: dict[str, type] = {**OWN, "retimed": Retimed}  # those that files hold


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
