"""What machine and task files hold: their sections, in the order in which they are written.

Most sections are the parts of a machine as they stand. Declared here is what a file says otherwise than `Machine` and
`Task` do: parts under their names, sizes of cylinders, paths, and what may be left out. What several values must agree
on is in `checks`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, Any

from leanboom.components.circuits import Circuit
from leanboom.components.cylinders import Cylinder
from leanboom.components.paths import RISING, rises
from leanboom.components.pumps import Pump
from leanboom.components.valves import VALVES, Valve
from leanboom.model.machine import STANDARD_GRAVITY, Body, Geometry
from leanboom.model.task import START, start_of
from leanboom.quantities import ranges
from leanboom.quantities.declarations import Section, Variant, derived
from leanboom.quantities.ranges import Refused, Rule
from leanboom.quantities.rules import Listing, OneOrTwo, ordered
from leanboom.quantities.types import (
    Angle,
    Bool,
    Coordinate,
    Cutoff,
    Duration,
    Gravity,
    Identifier,
    LeastLength,
    LeastMass,
    Length,
    PositiveLength,
    Time,
    Velocity,
    Words,
)
from leanboom.quantities.units import KINDS, Kind

AngleRange = Annotated[
    tuple[Angle, Angle], Listing("two angles, lower and upper end", ranges.ANGLE, 2, 2, order=ordered)
]
LengthRange = Annotated[
    tuple[LeastLength, LeastLength],
    Listing("two lengths, lower and upper end", ranges.LEAST_LENGTH, 2, 2, order=ordered),
]


@dataclass(frozen=True, slots=True, kw_only=True)
class JointKeys:
    """Ranges of the joints, lower and upper end."""

    base: AngleRange | None = None
    """Slewing angle, from x towards y; only if the machine slews."""
    lift: AngleRange
    """Boom against the horizontal."""
    tilt: AngleRange
    """Outer boom against the boom, negative when folded down."""
    extension: LengthRange
    """How far the tool is telescoped out."""


@dataclass(frozen=True, slots=True)
class Size:
    """Diameters that give a cylinder's areas."""

    bore: PositiveLength | None = None
    """Piston diameter; with rod."""
    rod: PositiveLength | None = None
    """Rod diameter, below the bore."""
    plunger: PositiveLength | None = None
    """Diameter of two opposed plungers on one rack, in place of bore and rod."""
    racks: Annotated[int, OneOrTwo()] | None = None
    """How many racks with two plungers each: 1 (if not given) or 2."""


AREAS = ("piston_area", "rod_side_area")
SIZE_KEYS = (*(field.name for field in fields(Size)), *AREAS)
CylinderKeys = derived("CylinderKeys", Size, Cylinder, without=("name",), optional=(*AREAS, "stroke"), empty=AREAS)
BodyKeys = derived("BodyKeys", Body, without=("name",))
_ALL = tuple(field.name for field in fields(Circuit))
CircuitKeys = derived("CircuitKeys", Circuit, optional=_ALL, empty=_ALL)


@dataclass(frozen=True, slots=True, kw_only=True)
class CylinderSet:
    """The cylinders, by the joint they move."""

    base: Annotated[Any, Section(CylinderKeys)] | None = None
    """Only if the machine slews."""
    lift: Annotated[Any, Section(CylinderKeys)]
    tilt: Annotated[Any, Section(CylinderKeys)]
    extension: Annotated[Any, Section(CylinderKeys)]


@dataclass(frozen=True, slots=True, kw_only=True)
class PayloadKeys:
    """Where a payload hangs on the outer boom."""

    along: Length
    """From the tilt joint along the extension's axis, at zero extension."""
    above: Length
    """Perpendicular to it, upwards."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DynamicsKeys:
    """What planning takes into account."""

    coriolis: Bool = False
    """Centrifugal and Coriolis forces."""
    slewing_inertia: Bool = False
    """Inertia about the slewing axis in the base cylinder's force."""


_BODY = Section(BodyKeys)


class Bodies(Rule):
    """Bodies by name."""

    _allowed = "must be a mapping with at least one body: name: {carrier, mass, along, above, inertia}"

    def check(self, value: Any) -> Any:
        """The mapping."""
        if not isinstance(value, dict) or not value:
            raise Refused(self.allowed)
        return value

    def section_of(self, value: Any) -> Section | None:
        """A body's section; None for all of them."""
        return None if isinstance(value, dict) else _BODY


@dataclass(frozen=True, slots=True, kw_only=True)
class MachineKeys:
    """A machine file."""

    name: Identifier | None = None
    """By default made of the file's name without its ending."""
    description: Words = ""
    geometry: Annotated[Geometry, Section(Geometry)]
    """Lengths of the boom in its own vertical plane."""
    joints: Annotated[JointKeys, Section(JointKeys)]
    """Their ranges, [lower, upper]."""
    cylinders: Annotated[CylinderSet, Section(CylinderSet)]
    """One for each joint."""
    bodies: Annotated[dict[Identifier, Annotated[Any, _BODY]], Bodies()]
    """Rigid bodies, each under a name of its own."""
    payload: Annotated[PayloadKeys, Section(PayloadKeys)]
    """Where a task's payload hangs on the outer boom."""
    valve: Annotated[Valve, Variant(VALVES)]
    """The valves of all cylinders."""
    pump: Annotated[Pump, Section(Pump, stated=True)]
    driven_velocity: Velocity
    """Slower cylinders count as not driven."""
    dynamics: Annotated[DynamicsKeys, Section(DynamicsKeys)] = DynamicsKeys()
    """What planning takes into account."""
    simulation: Annotated[Any, Section(CircuitKeys)] = CircuitKeys()
    """The hydraulics of the closed-loop simulation."""
    gravity: Gravity = STANDARD_GRAVITY


_POINT = Listing("three lengths x, y, z", ranges.COORDINATE, 3, 3, bare=True)
Point = Annotated[tuple[Coordinate, Coordinate, Coordinate], _POINT]
Points = Annotated[tuple[Point, ...], Listing("at least two points [x, y, z]", _POINT, 2, bare=True)]
Durations = Annotated[tuple[Duration, ...], Listing("at least one time", ranges.FILE_DURATION, 1)]


def rising_from_zero(values: tuple[float, ...]) -> tuple[float, ...]:
    """The times, if they begin with 0 and rise."""
    if not rises(values):
        raise Refused(RISING)
    return values


Times = Annotated[tuple[Time, ...], Listing("at least two times", ranges.FILE_TIME, 2, order=rising_from_zero)]


@dataclass(frozen=True, slots=True, kw_only=True)
class LinesKeys:
    """Straight segments, each from rest to rest."""

    points: Points
    """Corners [x, y, z], one more than durations."""
    durations: Durations
    """Of each segment."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SplineKeys:
    """A cubic spline through via points, at rest at both ends."""

    points: Points
    """Via points [x, y, z], as many as times."""
    times: Times
    """When each point is passed, rising from 0."""


PATHS: dict[str, type] = {"lines": LinesKeys, "spline": SplineKeys}


class Start(Rule):
    """Where the redundant cylinder starts."""

    _allowed = START

    @property
    def kind(self) -> Kind:
        """What it measures, if it is no word."""
        return KINDS["length"]

    def check(self, value: Any) -> str | float:
        """One of the words, or a length [m]."""
        try:
            return start_of(value)
        except ValueError as error:
            raise Refused(str(error)) from None


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskKeys:
    """A task file."""

    name: Identifier | None = None
    """By default made of the file's name without its ending."""
    machine: Words
    """A bundled machine's name, or a machine file, relative to the task file."""
    payload: LeastMass
    """Hangs at the machine's payload point."""
    path: Annotated[LinesKeys | SplineKeys, Variant(PATHS)]
    """What the tool does."""
    start: Annotated[str | float, Start()]
    """Where the redundant cylinder starts: smallest, middle, best, or a length."""
    smooth: Cutoff | None = None
    """Low-pass cut-off for the redundant motion before it is judged; none if not given."""
