"""A hydraulic crane as data: geometry, joints, linkages, cylinders, bodies, pump.

Everything here is SI, immutable and free of behaviour beyond checked and trivially derived values. Files become
these types in `io.loading`; `crane` puts them and the formulas together.

The cranes covered have an optional slewing base, a lift joint, a tilt joint with an optional offset and
a telescoping extension, the redundant joint. Joint order is always base (if any), lift, tilt, extension.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from leanboom.components.friction import Friction
from leanboom.components.linkages import Linkage
from leanboom.components.pumps import Pump
from leanboom.components.valves import Connection, Valve
from leanboom.errors import InputError
from leanboom.quantities import ranges
from leanboom.quantities.ranges import hold

STANDARD_GRAVITY = 9.80665  # g_n, CGPM 1901 [m/s^2]


@dataclass(frozen=True, slots=True)
class Geometry:
    """Lengths of the boom in its own vertical plane [m]; DH Table 2 (4-DOF paper), Table 1 (3-DOF paper)."""

    base_x: float  # o_x, slewing axis to lift joint, horizontally
    base_z: float  # o_y of the papers, base to lift joint, vertically
    boom: float  # L1, lift joint to tilt joint
    offset: float  # L2 of the 4-DOF paper: tilt joint to extension axis; 0 for the 3-DOF crane
    outer: float  # L3 (L2 of the 3-DOF paper): tilt joint to tool at zero extension
    slewing: bool  # whether joint `base` exists; without it the tool stays in the plane y = 0

    def __post_init__(self) -> None:
        hold(
            self, "geometry", base_x=ranges.LENGTH, base_z=ranges.LENGTH, boom=ranges.POSITIVE_LENGTH,
            offset=ranges.LENGTH, outer=ranges.POSITIVE_LENGTH,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Joint:
    """One joint and its range: [rad], or [m] for the extension."""

    name: str  # base, lift, tilt, extension
    lower: float
    upper: float

    def __post_init__(self) -> None:
        hold(self, f"joints.{self.name}", lower=ranges.NUMBER, upper=ranges.NUMBER)
        if self.lower >= self.upper:
            raise InputError(
                f"joints.{self.name} = [{self.lower:.6g}, {self.upper:.6g}]; the lower end must be below the upper end"
            )


@dataclass(frozen=True, slots=True)
class Cylinder:
    """One hydraulic cylinder, its linkage, its connection and its limits."""

    name: str  # name of the joint it moves
    piston_area: float  # A_A [m^2]
    rod_side_area: float  # A_B [m^2]
    stroke: float  # [m]
    linkage: Linkage
    connection: Connection
    friction: Friction
    velocity_limit: float  # [m/s], both ways
    acceleration_limit: float  # [m/s^2], both ways

    def __post_init__(self) -> None:
        hold(
            self, f"cylinders.{self.name}", piston_area=ranges.AREA, rod_side_area=ranges.AREA,
            stroke=ranges.POSITIVE_LENGTH, velocity_limit=ranges.VELOCITY, acceleration_limit=ranges.ACCELERATION,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Body:
    """A rigid body: where its mass sits and what carries it.

    `along` is measured on the carrying link's line (lift: from the lift joint towards the tilt joint;
    tilt: from the tilt joint along the extension axis direction), `above` perpendicular to it, upwards.
    """

    name: str
    carrier: str  # base, lift, tilt (outer boom, which also carries what telescopes)
    mass: float  # [kg]
    along: float  # [m]
    above: float  # [m]
    inertia: float  # about the own centre of mass, in the boom plane (vertical axis for `base`) [kg m^2]
    extension_share: float = 0.0  # moves along by this share of the extension joint: 0, 1/2, 1

    def __post_init__(self) -> None:
        hold(
            self, f"bodies.{self.name}", mass=ranges.LEAST_MASS, along=ranges.LENGTH, above=ranges.LENGTH,
            inertia=ranges.INERTIA, extension_share=ranges.SHARE,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Circuit:
    """What the closed-loop simulation needs to know of the hydraulics, beyond what planning does.

    The defaults are those of a mobile valve; `METERING` are those of independent metering.
    """

    bulk_modulus: float = 1e9  # B_eff of eqs. (18)-(19), hoses included [Pa]
    dead_volume: float = 1e-3  # V_0A, V_0B: chamber and hose with the piston at its end [m^3]
    line_volume: float = 3e-3  # between pump and valves [m^3]
    pump_time_constant: float = 0.2  # of the supply pressure [s]
    edge_flow: float = 170e-3 / 60  # of a fully open edge at `edge_drop` [m^3/s]
    edge_drop: float = 0.7e6  # over a compensated edge; a mobile valve's own drop counts instead [Pa]
    spool_bandwidth: float = 8.0  # where the spool's amplitude has fallen by 3 dB [Hz]
    delay: float = 0.16  # from a command to the spool's first movement [s]
    dead_zone: float = 0.53  # share of the spool's travel that opens nothing
    counter_pressure: float = 0.3e6  # of the return line above the tank [Pa]
    seal_friction: float = 0.0  # Coulomb, beside planning's friction, as a share of the force at constant pressure
    seal_damping: float = 0.0  # viscous at the velocity limit, beside planning's, as a share of the same force

    def __post_init__(self) -> None:
        hold(
            self, "simulation", bulk_modulus=ranges.POSITIVE_PRESSURE, dead_volume=ranges.VOLUME,
            line_volume=ranges.VOLUME, pump_time_constant=ranges.PUMP_TIME, edge_flow=ranges.FLOW,
            edge_drop=ranges.POSITIVE_PRESSURE, spool_bandwidth=ranges.FREQUENCY, delay=ranges.DELAY,
            dead_zone=ranges.DEAD_ZONE, counter_pressure=ranges.PRESSURE, seal_friction=ranges.SHARE,
            seal_damping=ranges.SHARE,
        )  # fmt: skip


METERING = Circuit(
    dead_volume=0.5e-3, line_volume=1e-3, edge_flow=80e-3 / 60, edge_drop=0.5e6, spool_bandwidth=25.0, delay=0.002,
    dead_zone=0.0, counter_pressure=0.0, seal_friction=0.02,
    seal_damping=0.02,
)  # fmt: skip


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
    description: str
    geometry: Geometry
    joints: tuple[Joint, ...]
    cylinders: tuple[Cylinder, ...]
    bodies: tuple[Body, ...]
    payload_along: float  # where a payload hangs, on the outer link at zero extension [m]
    payload_above: float  # [m]
    valve: Valve
    pump: Pump
    driven_velocity: float  # epsilon of eq. (41): slower cylinders count as not driven [m/s]
    coriolis: bool = False  # centrifugal and Coriolis forces in planning (omitted in both papers)
    slewing_inertia: bool = False  # whether planning adds M11 q1'' to the base force (constant in the paper)
    gravity: float = STANDARD_GRAVITY  # [m/s^2]
    circuit: Circuit = Circuit()
    provenance: tuple[Provenance, ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        hold(
            self, "", payload_along=ranges.LENGTH, payload_above=ranges.LENGTH, driven_velocity=ranges.VELOCITY,
            gravity=ranges.GRAVITY,
        )  # fmt: skip
        wanted = ("base", "lift", "tilt", "extension") if self.geometry.slewing else ("lift", "tilt", "extension")
        for key in ("joints", "cylinders"):
            names = tuple(part.name for part in getattr(self, key))
            if names != wanted:
                raise InputError(f"{key} = {', '.join(names) or 'none'}; must be {', '.join(wanted)}, in this order")

    @property
    def names(self) -> tuple[str, ...]:
        """Joint names in order."""
        return tuple(joint.name for joint in self.joints)

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
