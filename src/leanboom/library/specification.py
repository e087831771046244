"""Specification of a motion library: places, path shape, durations, payloads, pumps and starts, in all combinations.

Motions that differ in the start of the redundant cylinder alone are a `Sweep`: one dynamic program serves them all.
Sweeps along the same line with the same pump are a `Family`: neighbours in it begin with each other's motions.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from leanboom.components.costs import PUMPS
from leanboom.components.paths import Lines, Path, Spline
from leanboom.errors import InfeasibleError, InputError
from leanboom.io import loading
from leanboom.model.machine import Machine
from leanboom.model.task import End, Start, Task
from leanboom.problem import stages
from leanboom.quantities import ranges
from leanboom.quantities.declarations import Variant
from leanboom.quantities.rules import Listing, Word
from leanboom.quantities.types import Bool, Coordinate, Duration, Identifier, LeastMass, PositiveLength, Words

if TYPE_CHECKING:
    from leanboom.io.yaml_source import Source

SECONDS = 2.5  # that a motion takes on one core, roughly
MOST = 20_000  # motions that are built without being asked for by number
APART = 1e-3  # [m], nearer places are one: there is no motion between them
SHOWN = 3  # places named one by one

_POINT = Listing("three lengths x, y, z", ranges.COORDINATE, 3, 3, bare=True)
_COORDINATES = Listing("at least one length", ranges.COORDINATE, 1, bare=True)
Point = Annotated[tuple[Coordinate, Coordinate, Coordinate], _POINT]
Coordinates = Annotated[tuple[Coordinate, ...], _COORDINATES]


@dataclass(frozen=True, slots=True)
class PointList:
    """Places one by one."""

    points: Annotated[tuple[Point, ...], Listing("at least one point [x, y, z]", _POINT, 1, bare=True)]
    """Of the tool, [x, y, z]."""

    @property
    def places(self) -> tuple[tuple[float, float, float], ...]:
        """The places [m]."""
        return self.points


@dataclass(frozen=True, slots=True)
class PointGrid:
    """All combinations of coordinates; places that the crane cannot reach are left out."""

    x: Coordinates
    """Forward."""
    y: Coordinates
    """To the left."""
    z: Coordinates
    """Upward."""

    @property
    def places(self) -> tuple[tuple[float, float, float], ...]:
        """The places [m]."""
        return tuple(itertools.product(self.x, self.y, self.z))


@dataclass(frozen=True, slots=True)
class Straight:
    """The straight line, a quintic from rest to rest."""

    def path(self, origin: tuple, goal: tuple, duration: float) -> Path:
        """The path between two places [m] in a time [s]."""
        return Lines((origin, goal), (duration,))


@dataclass(frozen=True, slots=True)
class Arch:
    """A clamped cubic spline over two points above the line, in the machine's own directions of turning and reach."""

    height: PositiveLength
    """Of the two points, above the higher end."""

    def path(self, origin: tuple, goal: tuple, duration: float) -> Path:
        """The path between two places [m] in a time [s]."""
        radius = np.hypot(*origin[:2]), np.hypot(*goal[:2])
        angle = np.unwrap([np.arctan2(*origin[1::-1]), np.arctan2(*goal[1::-1])])
        top = max(origin[2], goal[2]) + self.height
        between = []
        for share in (0.25, 0.75):
            r, a = radius[0] + share * (radius[1] - radius[0]), angle[0] + share * (angle[1] - angle[0])
            between.append((float(r * np.cos(a)), float(r * np.sin(a)), top))
        return Spline((origin, *between, goal), (0.0, 0.32 * duration, 0.68 * duration, duration))


def shape_of(text: str) -> Straight | Arch:
    """A shape as the store keeps it.

    Args:
        text: JSON, with the name of its type under "".
    """
    given = json.loads(text)
    kind = {each.__name__: each for each in SHAPES.values()}[given.pop("")]
    return kind(**given)


PLACES: dict[str, type] = {"points": PointList, "grid": PointGrid}
SHAPES: dict[str, type] = {"straight": Straight, "arch": Arch}

_PUMP, _START = Word(*PUMPS), Start.__metadata__[0]  # type: ignore[attr-defined]


@dataclass(frozen=True, slots=True, kw_only=True)
class LibraryKeys:
    """A file of a motion library."""

    name: Identifier | None = None
    """By default made of the file's name without its ending."""
    machine: Words
    """A bundled machine's name, or a machine file, relative to this file."""
    origins: Annotated[Any, Variant(PLACES)]
    """Where motions begin."""
    goals: Annotated[Any, Variant(PLACES)]
    """Where they end."""
    and_back: Bool = False
    """Whether to plan the ways back as well."""
    shape: Annotated[Any, Variant(SHAPES)]
    """Of the tool's path."""
    durations: Annotated[tuple[Duration, ...], Listing("at least one time", ranges.DURATION, 1)]
    payloads: Annotated[tuple[LeastMass, ...], Listing("at least one mass", ranges.LEAST_MASS, 1)] = (0.0,)
    pumps: Annotated[tuple[Annotated[str, _PUMP], ...], Listing("at least one of ls, cp", _PUMP, 1)] = ("ls",)  # type: ignore[arg-type]
    starts: Annotated[tuple[Start, ...], Listing("at least one start", _START, 1)] = ("smallest",)  # type: ignore[arg-type]
    end: End = "free"
    """Where the redundant cylinder ends in all motions, as in a task."""

    @property
    def each(self) -> int:
        """Motions along one line."""
        lists = self.durations, self.payloads, self.pumps, self.starts
        return math.prod(len(set(each)) for each in lists)


@dataclass(frozen=True, slots=True)
class Sweep:
    """Tasks that differ in the start of the redundant cylinder alone, and the pump whose energy counts."""

    tasks: tuple[Task, ...]
    pump: str


@dataclass(frozen=True, slots=True)
class Family:
    """Sweeps along the same line with the same pump."""

    origin: tuple[float, float, float]
    goal: tuple[float, float, float]
    sweeps: tuple[Sweep, ...]
    parents: tuple[int | None, ...]  # of each sweep, the one before it whose motions it begins with


@dataclass(frozen=True, slots=True)
class Specification:
    """Which motions a library holds."""

    name: str
    machine: Machine
    keys: LibraryKeys
    text: str  # of its file
    unreachable: tuple[tuple[float, float, float], ...]  # places of grids that no extension reaches [m]

    @property
    def ways(self) -> tuple[tuple[tuple, tuple], ...]:
        """Pairs of places that motions lead between [m], in their order and each once."""
        left_out = set(self.unreachable)
        found: dict[tuple[tuple, tuple], None] = {}
        for pair in itertools.product(self.keys.origins.places, self.keys.goals.places):
            if not left_out.intersection(pair) and np.linalg.norm(np.subtract(*pair)) > APART:
                found[pair] = None
                if self.keys.and_back:
                    found[pair[::-1]] = None
        return tuple(found)

    @property
    def total(self) -> int:
        """Number of motions."""
        return len(self.ways) * self.keys.each

    def families(self) -> Iterator[Family]:
        """All motions: slow ones first, since fast ones are harder to find; then with more and more payload."""
        keys = self.keys
        durations, payloads = sorted(set(keys.durations), reverse=True), sorted(set(keys.payloads))
        wide = len(durations)
        places = range(wide * len(payloads))
        parents = tuple(k - 1 if k % wide else k - wide if k else None for k in places)
        for origin, goal in self.ways:
            paths = [keys.shape.path(origin, goal, duration) for duration in durations]
            for pump in dict.fromkeys(keys.pumps):
                sweeps = tuple(self._sweep(path, payload, pump) for payload in payloads for path in paths)
                yield Family(origin, goal, sweeps, parents)

    def _sweep(self, path: Path, payload: float, pump: str) -> Sweep:
        starts = dict.fromkeys(self.keys.starts)
        end = self.keys.end
        return Sweep(tuple(asked(self.name, self.machine, path, payload, start, end) for start in starts), pump)


def asked(
    name: str, machine: Machine, path: Path, payload: float = 0.0, start: Start = "smallest", end: End = "free"
) -> Task:
    """The task of a motion of a library; all tasks of libraries are made here.

    Args:
        name: Its name.
        machine: The machine.
        path: What the tool does.
        payload: What it carries [kg].
        start, end: Where the redundant cylinder starts and ends, as in a task.
    """
    return Task(name, machine, path, payload, start, end)


def load(name_or_path: str | FilePath, workers: int = 1, most: int = MOST) -> Specification:
    """Load the specification of a library and check that it can be built.

    Args:
        name_or_path: Name of a bundled specification, or a file.
        workers: Motions that are planned at a time.
        most: Motions that may be built.

    Returns:
        The specification.

    Raises:
        InputError: There is no such file, it asks for too many motions, or it has problems; all of them are named.
    """
    unreachable: list[tuple] = []

    def check(source: Source, keys: LibraryKeys | None, machine: Machine | None) -> None:
        if keys is None or machine is None:
            return
        _check_amount(source.name, keys, workers, most)
        for key in ("origins", "goals"):
            unreachable.extend(_check_places(source, key, getattr(keys, key), machine))
        longest = machine.redundant.stroke
        for key, place in (*((("starts", i), start) for i, start in enumerate(keys.starts)), (("end",), keys.end)):
            if isinstance(place, float) and place > longest:
                source.refuse(key, f"must be from 0 to {longest:.6g} m, the stroke of the extension cylinder")

    name, keys, machine, text = loading.load_keys("library", name_or_path, LibraryKeys, check)
    made = Specification(name, machine, keys, text, tuple(unreachable))
    if not made.total:
        raise InputError(f"{name}: origins and goals hold no two places apart that the crane reaches; give others")
    return made


def _check_places(source: Source, key: str, given: PointList | PointGrid, machine: Machine) -> list[tuple]:
    """The places of a grid that cannot be reached; points that cannot, or no place at all, are noted as problems."""
    flat = not machine.geometry.slewing
    if flat and any(abs(place[1]) > 0.0 for place in given.places):
        source.refuse((key,), f"every y must be 0, since machine {machine.name} does not slew")
        return []
    reasons = {place: reason for place in given.places if (reason := out_of_reach(machine, place))}
    if isinstance(given, PointList):
        for i, place in enumerate(given.places):
            if place in reasons:
                source.refuse((key, "points", i), f"must be a place that the crane reaches: {reasons[place]}")
    elif len(reasons) == len(set(given.places)):
        source.refuse((key,), f"must hold a place that the crane reaches: {next(iter(reasons.values()))}")
    return list(reasons)


def out_of_reach(machine: Machine, place: tuple[float, float, float]) -> str:
    """Why the tool cannot be at a place [m], whatever the extension; empty if it can.

    Args:
        machine: The machine.
        place: The place [m].
    """
    near = (*place[:2], place[2] + 1e-6)
    try:
        stages.discretise(asked("reach", machine, Lines((place, near), (1.0,))), 1.0)
    except InfeasibleError as error:
        return str(error).replace(" at 0.000 s (stage 0)", "")
    except InputError as error:
        return str(error)
    return ""


def expected(count: int, workers: int) -> str:
    """A number of motions, and about how long they take.

    Args:
        count: The number.
        workers: Motions that are planned at a time.
    """
    return f"{count:,} motions, about {lasting(SECONDS * count / max(1, workers))} with {workers} at a time"


def _check_amount(name: str, keys: LibraryKeys, workers: int, most: int) -> None:
    """Raise InputError for more motions than may be built, before the crane's reach is looked at place by place."""
    count = len(keys.origins.places) * len(keys.goals.places) * (2 if keys.and_back else 1) * keys.each
    if count > most:
        raise InputError(
            f"{name} asks for {expected(count, workers)}, more than {most:,}; give fewer places, durations, payloads, "
            f"pumps or starts, or say --most {count}"
        )


def lasting(seconds: float) -> str:
    """A time in words.

    Args:
        seconds: The time [s].
    """
    for unit, size in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * size:
            return f"{seconds / size:,.0f} {unit}"
    return f"{seconds:.0f} s"
