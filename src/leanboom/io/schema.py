"""What machine and task files say otherwise than `Machine` and `Task` do, in the order in which it is written.

Parts stand under their names, cylinders have sizes, and what may be left out is not the same. Everything else is taken
from the parts, from `Machine` and from `Task` as they declare it. What several values must agree on is in `checks`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, Any

from leanboom.components.circuits import Circuit
from leanboom.components.cylinders import Cylinder
from leanboom.components.pumps import Pump
from leanboom.model.machine import STANDARD_GRAVITY, Body, Joints, Machine
from leanboom.model.task import Lasting, Limits, Task
from leanboom.quantities.declarations import Section, declared, derived, file_of
from leanboom.quantities.ranges import Refused, Rule
from leanboom.quantities.rules import OneOrTwo
from leanboom.quantities.types import Identifier, PositiveLength, Words


@dataclass(frozen=True, slots=True)
class Size:
    """Diameters that determine a cylinder's areas."""

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


@file_of(Machine, "payload_")
class PayloadKeys:
    """Where a payload hangs on the outer boom."""

    along: Any
    above: Any


@file_of(Machine)
class DynamicsKeys:
    """What planning takes into account."""

    coriolis: Any = False
    slewing_inertia: Any = False


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


@file_of(Machine)
class MachineKeys:
    """A machine file."""

    name: Identifier | None = None
    """By default made of the file's name without its ending."""
    description: Any = ""
    geometry: Any
    joints: Annotated[Joints, Section(Joints)]
    """Their ranges, [lower, upper]."""
    cylinders: Annotated[CylinderSet, Section(CylinderSet)]
    """One for each joint."""
    bodies: Annotated[dict[Identifier, Annotated[Any, _BODY]], Bodies()]
    """Rigid bodies, each under a name of its own."""
    payload: Annotated[Any, Section(PayloadKeys)]
    """Where a task's payload hangs on the outer boom."""
    valve: Any
    pump: Annotated[Pump, Section(Pump, stated=True)]
    driven_velocity: Any
    dynamics: Annotated[Any, Section(DynamicsKeys)] = DynamicsKeys()
    """What planning takes into account."""
    simulation: Annotated[Any, Section(CircuitKeys)] = CircuitKeys()
    """The hydraulics of the closed-loop simulation."""
    gravity: Any = STANDARD_GRAVITY


SHARED = tuple(name for name in declared(MachineKeys) if name in declared(Machine))  # as they stand in `Machine`


@file_of(Task)
class TaskKeys:
    """A task file."""

    name: Identifier | None = None
    """By default made of the file's name without its ending."""
    machine: Words
    """A bundled machine's name, or a machine file, relative to the task file."""
    payload: Any = None
    path: Any = None
    start: Any
    end: Any = "free"
    smooth: Any = None
    limits: Any = Limits()
    timing: Any = "fixed"
    duration: Lasting | None = None
    """Of the whole path, whose timing is scaled to it; or shortest, which is `timing: shortest`."""
    legs: Any = ()
    total: Any = None
    time_price: Any = None
