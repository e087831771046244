"""A task: which machine moves its tool along which path, and the sampled reference that results.

Paths are given in the machine's frame (x forward, y left, z up) and always start and end at rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, cast

import numpy as np

from leanboom.components.paths import PATHS, Braking, Joined, Lines, Moved, Part, Path, Retimed, Spline
from leanboom.errors import InputError
from leanboom.model import legs as leg_rules
from leanboom.model.legs import Leg, Stretch
from leanboom.model.machine import Machine
from leanboom.quantities import ranges
from leanboom.quantities.declarations import Section, Variant, hold_declared
from leanboom.quantities.ranges import Refused, Rule
from leanboom.quantities.rules import Listing, Word
from leanboom.quantities.types import Bool, Cutoff, Duration, LeastMass, Price
from leanboom.quantities.units import Kind, slip

__all__ = [
    "Braking", "Joined", "Leg", "Limits", "Lines", "Moved", "Part", "Path", "Reference", "Retimed", "Spline", "Start",
    "Stretch", "Task", "sample", "written",
]  # fmt: skip

STARTS = ("smallest", "middle", "best")
ENDS = ("free", "same", "smallest", "middle")
TIMINGS = ("fixed", "free", "shortest")
ROUNDING = 1e-9  # [m], of a length that is read off a motion
FILTERED = 0.02  # [s], the shortest path with enough samples for a low pass

Key = tuple[str | int, ...]  # where a value is in a task file


class _WordOr(Rule):
    """A word out of a few, or a quantity."""

    def __init__(self, words: tuple[str, ...], quantity: ranges.Range, what: str):
        self.words, self.quantity, self._allowed = words, quantity, f"must be {', '.join(words)}, or {what}"

    @property
    def kind(self) -> Kind:
        """The kind of quantity, if it is no word."""
        return self.quantity.kind

    def check(self, value: Any) -> str | float:
        """The word, or the quantity in SI units."""
        if isinstance(value, str) and value in self.words:
            return value
        try:
            return self.quantity.number(value)
        except Refused:
            raise Refused(self.allowed + (slip(value, self.kind) if isinstance(value, str) else "")) from None

    def kept(self, key: str, value: Any) -> str | float:
        """The word, or the quantity in SI units."""
        try:
            return self.check(value)
        except Refused as error:
            raise InputError(f"{key} = {ranges.shown(value)}; {error}") from None


_LENGTH = "a length of the redundant cylinder such as 0.3 m"
Start = Annotated[str | float, _WordOr(STARTS, ranges.LEAST_LENGTH, _LENGTH)]
End = Annotated[str | float, _WordOr(ENDS, ranges.LEAST_LENGTH, _LENGTH)]
Lasting = Annotated[str | float, _WordOr(("shortest",), ranges.DURATION, "a time from 0.0001 s to 3600 s such as 8 s")]


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of the pump that a motion must keep, as it keeps those of joints and cylinders."""

    pump_flow: Bool = False
    """Whether the flow of all cylinders together may at no time be above the pump's `max_flow`."""

    def __post_init__(self) -> None:
        hold_declared(self, "limits")


@dataclass(frozen=True, slots=True)
class Task:
    """A machine, a payload at its tool, a path in time and where the redundant cylinder starts.

    With legs in place of path and payload, `path` is all of them joined, waiting included, and `payload` the heaviest.
    """

    name: str
    machine: Machine
    path: Annotated[Path, Variant(PATHS)] = cast(Any, None)
    """What the tool does."""
    payload: LeastMass = 0.0
    """Hangs at the machine's payload point."""
    start: Start = "smallest"
    """Where the redundant cylinder starts: smallest, middle, best, or a length."""
    end: End = "free"
    """Where it ends: free, same (as the start), smallest, middle, or a length."""
    smooth: Cutoff | None = None
    """Low-pass cut-off for the redundant motion before it is judged; none if not given."""
    limits: Annotated[Limits, Section(Limits)] = Limits()
    """What else a motion must keep."""
    timing: Annotated[str, Word(*TIMINGS)] = "fixed"
    """Whether the path keeps its timing: fixed; free, its speed is planned for the same duration; or shortest."""
    legs: Annotated[tuple[Annotated[Leg, Section(Leg)], ...], Listing("legs, at least one", Section(Leg), 1)] = ()
    """In place of path and payload: one path after the other, from rest to rest, each with its payload."""
    total: Duration | None = None
    """Time that all legs take with all waiting, shared among those whose duration is a range."""
    time_price: Price | None = None
    """What a second costs beside energy, where durations are ranges; nothing if not given."""
    source: str = field(default="", repr=False, compare=False)  # the file's text

    def __post_init__(self) -> None:
        if not isinstance(self.machine, Machine):
            raise InputError(f"machine = {ranges.shown(self.machine)}; must be a machine: leanboom.load_machine(NAME)")
        if self.legs:
            self._join()
        if not isinstance(self.path, Path):
            raise InputError(f"path = {ranges.shown(self.path)}; must be a path such as leanboom.model.task.Lines")
        if not isinstance(self.limits, Limits):
            raise InputError(f"limits = {ranges.shown(self.limits)}; must be limits: leanboom.model.task.Limits()")
        hold_declared(self, "")
        ranges.one_of("timing", self.timing, TIMINGS)
        found = faults(paths(self.path, self.legs), self.machine, self.start, self.end, self.smooth, self.timing)
        found += leg_rules.faults(self.legs, self.total, self.time_price)
        if found:
            raise InputError("\n".join(f"{dotted(key)} = {ranges.shown(value)}; {what}" for key, value, what in found))

    def _join(self) -> None:
        """Path and payload of all legs; InputError where these are given besides."""
        wrong = [f"legs[{i}] = {ranges.shown(leg)}; must be a leg: leanboom.model.task.Leg(path=..., payload=...)"
                 for i, leg in enumerate(self.legs) if not isinstance(leg, Leg)]  # fmt: skip
        if not isinstance(self.path, Joined | None):
            wrong.append(f"path = {ranges.shown(self.path)}; must be left out, since each of the legs has its own")
        if self.timing != "fixed":
            wrong.append(f"timing = {self.timing}; must be left out, since each of the legs has its own")
        if wrong:
            raise InputError("\n".join(wrong))
        object.__setattr__(self, "path", leg_rules.joined(self.legs))
        object.__setattr__(self, "payload", max(leg.payload for leg in self.legs))

    @property
    def duration(self) -> float:
        """Time the path takes [s]."""
        return self.path.duration

    @property
    def flow_limit(self) -> float:
        """Largest pump flow that a motion may ask for [m^3/s]; infinite where flow is no limit."""
        return self.machine.pump.max_flow if self.limits.pump_flow else np.inf

    @property
    def whole(self) -> bool:
        """Whether the task goes on to the end of its path, where the crane rests; not so where more is to follow."""
        return not _cut_short(self.path)

    @property
    def stretches(self) -> tuple[Stretch, ...]:
        """The legs and the waiting between them, in order; none of a task that has a path."""
        return leg_rules.stretches(self.legs)

    def at(self, time: float) -> Stretch:
        """The leg under way at a time [s], or the waiting before it, of a task with legs."""
        return leg_rules.at(self.legs, time)

    def stretch(self, part: Stretch, start: float | str = "middle", end: float | str = "free") -> Task:
        """One leg, or the waiting before it, as a task of its own.

        Args:
            part: Which of `stretches`.
            start, end: Of the redundant cylinder.
        """
        return replace(
            self, name=f"{self.name}-{'wait' if part.waits else 'leg'}-{part.leg + 1}", path=part.path,
            payload=self.legs[part.leg].payload, start=start, end=end, legs=(), total=None, time_price=None,
            smooth=None if part.waits else self.smooth,
        )  # fmt: skip

    def __repr__(self) -> str:
        start = self.start if isinstance(self.start, str) else f"{self.start:g} m"
        end = self.end if isinstance(self.end, str) else f"{self.end:g} m"
        end = "" if end == "free" else f", end {end}"
        path = self.path
        shape = path.path if isinstance(path, Retimed) else path
        points = f" through {len(shape.points)} points" if isinstance(shape, Lines | Spline) else ""
        points = f" {len(self.legs)} legs" if self.legs else points
        return (
            f"Task({self.name}: {self.machine.name}, {type(path).__name__.lower()}{points} in {path.duration:g} s, "
            f"payload {self.payload:g} kg, start {start}{end}{', pump flow limited' if self.limits.pump_flow else ''}"
            + ("" if self.timing == "fixed" else f", timing {self.timing}")
            + (f", smooth {self.smooth:g} Hz)" if self.smooth else ")")
        )


def _cut_short(path: Path) -> bool:
    """Whether a path is, or is made of, a part that ends before its path does."""
    if isinstance(path, Part) and path.until < path.path.duration - ranges.MOMENT:
        return True
    if isinstance(path, Joined):
        return _cut_short(path.paths[-1])
    return not isinstance(path, Lines | Spline) and not isinstance(path, Braking) and _cut_short(path.path)


def take_single(task: Task, what: str) -> None:
    """Raise InputError where a task has legs and something takes single paths alone.

    Args:
        task: The task.
        what: The thing, as a subject.
    """
    if task.legs:
        raise InputError(
            f"task {task.name} has {counted_legs(task)}; {what} takes a task with one path and one payload: "
            "make one of each leg"
        )


def counted_legs(task: Task) -> str:
    """The number of legs in words."""
    return "1 leg" if len(task.legs) == 1 else f"{len(task.legs)} legs"


def dotted(key: Key) -> str:
    """A key as messages have it: legs[1].path."""
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in key).removeprefix(".")


def paths(path: Path | None, legs: Sequence[Leg | None]) -> dict[Key, Path]:
    """Paths of a task that are right in themselves, by where they are: that of the task, or those of its legs."""
    if not legs:
        return {} if path is None else {("path",): path}
    return {("legs", i, "path"): leg.path for i, leg in enumerate(legs) if leg is not None}


def faults(
    given: dict[Key, Path], machine: Machine, start: Start, end: End, smooth: float | None, timing: str = "fixed"
) -> list[tuple[Key, object, str]]:
    """Contradictions in a task: keys of a file, their values, and what these must be.

    Args:
        given: The paths that are right in themselves, see `paths`.
        machine: The machine.
        start: The start.
        end: The end.
        smooth: Cut-off of the low pass [Hz]; None: none.
        timing: A word of `TIMINGS`.
    """
    found: list[tuple[Key, object, str]] = []
    for where, path in given.items():
        shape, there = (path.path, (*where, "path")) if isinstance(path, Retimed) else (path, where)
        if isinstance(shape, Lines | Spline) and not machine.geometry.slewing:
            flat = f"y must be 0, since machine {machine.name} does not slew"
            wrong = [(i, point) for i, point in enumerate(shape.points) if abs(point[1]) > 1e-9]
            found += [((*there, "points", i), point, flat) for i, point in wrong]
    longest = machine.redundant.stroke
    for key, place in (("start", start), ("end", end)):
        if isinstance(place, float) and place > longest + ROUNDING:
            found.append(((key,), place, f"must be from 0 to {longest:.6g} m, the stroke of the extension cylinder"))
    if smooth is not None and any(path.duration < FILTERED for path in given.values()):
        found.append((("smooth",), smooth, f"needs a path of at least {FILTERED:g} s"))
    if timing != "fixed" and smooth is not None:
        found.append(
            (("smooth",), smooth, f"must be left out with timing: {timing}, whose motions are planned as they are")
        )
    if timing != "fixed" and not all(isinstance(path, Lines | Spline) for path in given.values()):
        found.append((("timing",), timing, "must be fixed unless the path is lines or a spline"))
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """The tool path sampled in time, in the boom's own coordinates (radius from the slewing axis, height).

    All arrays are float64, (samples,), read-only.
    """

    time: np.ndarray  # [s]
    point: np.ndarray  # tool position [m], (samples, 3)
    velocity: np.ndarray  # [m/s], (samples, 3)
    acceleration: np.ndarray  # [m/s^2], (samples, 3)


def written(task: Task, leg: Leg | None = None) -> Lines | Spline | Retimed:
    """The path of a task, or of one of its legs, as a file can hold it.

    Raises:
        InputError: If the path is made in Python out of others: a part of one, one that moves, one that is left.
    """
    path = task.path if leg is None else leg.path
    if isinstance(path, Lines | Spline | Retimed):
        return path
    kind = type(path).__name__.lower()
    raise InputError(
        f"the path of task {task.name} is a {kind} path; files and tables hold lines and splines, retimed ones too"
    )


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
