"""A task: which machine moves its tool along which path, and the sampled reference that results.

Paths are given in the machine's frame (x forward, y left, z up) and always start and end at rest.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np

from leanboom.components.paths import PATHS, Braking, Lines, Moved, Part, Path, Retimed, Spline
from leanboom.errors import InputError
from leanboom.model.machine import Machine
from leanboom.quantities import ranges
from leanboom.quantities.declarations import Section, Variant, hold_declared
from leanboom.quantities.ranges import Refused, Rule
from leanboom.quantities.rules import Word
from leanboom.quantities.types import Bool, Cutoff, LeastMass
from leanboom.quantities.units import Kind, slip

__all__ = [
    "Braking", "Limits", "Lines", "Moved", "Part", "Path", "Reference", "Retimed", "Spline", "Start", "Task", "sample",
    "written",
]  # fmt: skip

STARTS = ("smallest", "middle", "best")
ENDS = ("free", "same", "smallest", "middle")
TIMINGS = ("fixed", "free", "shortest")
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
    """A machine, a payload at its tool, a path in time and where the redundant cylinder starts."""

    name: str
    machine: Machine
    path: Annotated[Path, Variant(PATHS)]
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
    source: str = field(default="", repr=False, compare=False)  # the file's text

    def __post_init__(self) -> None:
        if not isinstance(self.machine, Machine):
            raise InputError(f"machine = {ranges.shown(self.machine)}; must be a machine: leanboom.load_machine(NAME)")
        if not isinstance(self.path, Path):
            raise InputError(f"path = {ranges.shown(self.path)}; must be a path such as leanboom.model.task.Lines")
        if not isinstance(self.limits, Limits):
            raise InputError(f"limits = {ranges.shown(self.limits)}; must be limits: leanboom.model.task.Limits()")
        hold_declared(self, "")
        ranges.one_of("timing", self.timing, TIMINGS)
        if found := faults(self.path, self.machine, self.start, self.end, self.smooth, self.timing):
            raise InputError(
                "\n".join(f"{'.'.join(map(str, key))} = {ranges.shown(v)}; {what}" for key, v, what in found)
            )

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

    def __repr__(self) -> str:
        start = self.start if isinstance(self.start, str) else f"{self.start:g} m"
        end = self.end if isinstance(self.end, str) else f"{self.end:g} m"
        end = "" if end == "free" else f", end {end}"
        path = self.path
        shape = path.path if isinstance(path, Retimed) else path
        points = f" through {len(shape.points)} points" if isinstance(shape, Lines | Spline) else ""
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
    return not isinstance(path, Lines | Spline) and not isinstance(path, Braking) and _cut_short(path.path)


def faults(
    path: Path | None, machine: Machine, start: Start, end: End, smooth: float | None, timing: str = "fixed"
) -> list[tuple[Key, object, str]]:
    """Contradictions in a task: keys of a file, their values, and what these must be.

    Args:
        path: The path; None if it is wrong in itself.
        machine: The machine.
        start: The start.
        end: The end.
        smooth: Cut-off of the low pass [Hz]; None: none.
        timing: A word of `TIMINGS`.
    """
    found: list[tuple[Key, object, str]] = []
    shape, where = (path.path, ("path", "path")) if isinstance(path, Retimed) else (path, ("path",))
    if isinstance(shape, Lines | Spline) and not machine.geometry.slewing:
        flat = f"y must be 0, since machine {machine.name} does not slew"
        found += [((*where, "points", i), point, flat) for i, point in enumerate(shape.points) if abs(point[1]) > 1e-9]
    longest = machine.redundant.stroke
    for key, place in (("start", start), ("end", end)):
        if isinstance(place, float) and place > longest:
            found.append(((key,), place, f"must be from 0 to {longest:.6g} m, the stroke of the extension cylinder"))
    if path is not None and smooth is not None and path.duration < FILTERED:
        found.append((("smooth",), smooth, f"needs a path of at least {FILTERED:g} s"))
    if timing != "fixed" and smooth is not None:
        found.append(
            (("smooth",), smooth, f"must be left out with timing: {timing}, whose motions are planned as they are")
        )
    if timing != "fixed" and path is not None and not isinstance(path, Lines | Spline):
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


def written(task: Task) -> Lines | Spline | Retimed:
    """The path of a task as a file can hold it.

    Raises:
        InputError: If the path is made in Python out of others: a part of one, one that moves, one that is left.
    """
    if isinstance(task.path, Lines | Spline | Retimed):
        return task.path
    kind = type(task.path).__name__.lower()
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
