"""A hydraulic crane as data: geometry, joints, linkages, cylinders, bodies, pump.

Everything here is SI, immutable and free of behaviour beyond checked and trivially derived values. Files become
these types in `io.loading`; `crane` puts them and the formulas together.

The cranes covered have an optional slewing base, a lift joint, a tilt joint with an optional offset and
a telescoping extension, the redundant joint. Joint order is always base (if any), lift, tilt, extension.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from leanboom.components.circuits import Circuit
from leanboom.components.cylinders import Cylinder
from leanboom.components.pumps import Pump
from leanboom.components.valves import VALVES, Drive, Valve
from leanboom.errors import InputError
from leanboom.quantities import ranges
from leanboom.quantities.declarations import Section, Variant, declared, hold_declared
from leanboom.quantities.rules import Listing, Word, ordered
from leanboom.quantities.types import (
    Angle,
    Bool,
    Gravity,
    Inertia,
    LeastLength,
    Length,
    Mass,
    PositiveLength,
    Share,
    Velocity,
    Words,
)

STANDARD_GRAVITY = 9.80665  # g_n, CGPM 1901 [m/s^2]


@dataclass(frozen=True, slots=True)
class Geometry:
    """Lengths of the boom in its own vertical plane."""

    # DH Table 2 (4-DOF paper), Table 1 (3-DOF paper); o_x, o_y, L1, L2 and L3 of the former. Without an offset,
    # `outer` is L2 of the latter.
    base_x: Length
    """Slewing axis (or origin) to lift joint, horizontally."""
    base_z: Length
    """Origin to lift joint, vertically."""
    boom: PositiveLength
    """Lift joint to tilt joint."""
    offset: Length
    """Tilt joint to the extension's axis, perpendicular to it."""
    outer: PositiveLength
    """Tilt joint to tool along the extension's axis, at zero extension."""
    slewing: Bool  # without it the tool stays in the plane y = 0
    """Whether the machine has a slewing base."""

    def __post_init__(self) -> None:
        hold_declared(self, "geometry")


AngleRange = Annotated[
    tuple[Angle, Angle], Listing("two angles, lower and upper end", ranges.ANGLE, 2, 2, order=ordered)
]
LengthRange = Annotated[
    tuple[LeastLength, LeastLength],
    Listing("two lengths, lower and upper end", ranges.LEAST_LENGTH, 2, 2, order=ordered),
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Joints:
    """Ranges of the joints, lower and upper end, in their order."""

    base: AngleRange | None = None
    """Slewing angle, from x towards y; only if the machine slews."""
    lift: AngleRange
    """Boom against the horizontal."""
    tilt: AngleRange
    """Outer boom against the boom, negative when folded down."""
    extension: LengthRange
    """How far the tool is telescoped out."""


JOINTS = tuple(declared(Joints))


@dataclass(frozen=True, slots=True)
class Joint:
    """One joint and its range: [rad], or [m] for the extension."""

    name: str  # one of JOINTS
    lower: float
    upper: float

    def __post_init__(self) -> None:
        ranges.one_of("joint", self.name, JOINTS)
        ends = declared(Joints)[self.name].rule.kept(f"joints.{self.name}", (self.lower, self.upper))
        for name, end in zip(("lower", "upper"), ends, strict=True):
            object.__setattr__(self, name, end)


_CARRIER = Word("base", "lift", "tilt", column="base", boom="lift", outer="tilt", extension="tilt")


@dataclass(frozen=True, slots=True)
class Body:
    """A rigid body."""

    name: str
    carrier: Annotated[str, _CARRIER]
    """The joint that moves it; tilt also carries what telescopes."""
    mass: Mass
    along: Length
    """Centre of mass from the carrying joint, along its link, at zero extension."""
    above: Length
    """Centre of mass perpendicular to the link, upwards."""
    inertia: Inertia
    """About its own centre of mass, in the boom plane; about the vertical for carrier base."""
    extension_share: Share = 0.0
    """Share of the extension it moves along with."""

    def __post_init__(self) -> None:
        hold_declared(self, f"bodies.{self.name}")


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where one value of a machine file comes from."""

    key: str  # dotted path in the file, e.g. cylinders.lift.bore
    value: str  # as written
    status: str  # printed | derived | assumed | identified
    note: str = ""


@dataclass(frozen=True, slots=True)
class Machine:
    """A crane. Sequences are in joint order: base (if slewing), lift, tilt, extension."""

    name: str
    description: Words
    geometry: Annotated[Geometry, Section(Geometry)]
    """Lengths of the boom in its own vertical plane."""
    joints: tuple[Joint, ...]
    cylinders: tuple[Cylinder, ...]
    bodies: tuple[Body, ...]
    payload_along: Length
    """Where a payload hangs: from the tilt joint along the extension's axis, at zero extension."""
    payload_above: Length
    """Perpendicular to it, upwards."""
    valve: Annotated[Valve, Variant(VALVES)]
    """The valves of all cylinders."""
    pump: Pump
    driven_velocity: Velocity  # epsilon of eq. (41)
    """Slower cylinders count as not driven."""
    coriolis: Bool = False  # omitted in both papers
    """Whether planning counts centrifugal and Coriolis forces."""
    slewing_inertia: Bool = False  # M11 q1'', constant in the paper
    """Whether planning counts the inertia about the slewing axis in the base cylinder's force."""
    gravity: Gravity = STANDARD_GRAVITY
    circuit: Circuit = Circuit()
    provenance: tuple[Provenance, ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        hold_declared(self, "")
        wanted = JOINTS if self.geometry.slewing else JOINTS[1:]
        for key in ("joints", "cylinders"):
            names = tuple(part.name for part in getattr(self, key))
            if names != wanted:
                raise InputError(f"{key} = {', '.join(names) or 'none'}; must be {', '.join(wanted)}, in this order")

    @property
    def names(self) -> tuple[str, ...]:
        """Joint names in order."""
        return tuple(joint.name for joint in self.joints)

    @property
    def drives(self) -> tuple[Drive, ...]:
        """The steady states of all cylinders on their valves, in joint order."""
        return tuple(self.valve.steady(cylinder, self.pump) for cylinder in self.cylinders)

    def full_force(self, cylinder: Cylinder) -> float:
        """Force of a cylinder under the constant-pressure system's supply [N]."""
        return cylinder.push(self.pump.constant_pressure)

    @property
    def redundant(self) -> Cylinder:
        """The cylinder whose motion is planned: the extension."""
        return self.cylinders[-1]

    def __repr__(self) -> str:
        pump = self.pump
        return (
            f"Machine({self.name}: joints {', '.join(self.names)}; {sum(body.mass for body in self.bodies):g} kg; pump "
            f"{6e4 * pump.max_flow:g} l/min, {1e-6 * pump.max_pressure:g} MPa)"
        )
