"""What machine and task files may hold: pydantic models of their keys, in the order in which they are written.

The models check one value at a time, by the rules of `rules`, and give every refusal the same shape; what several
values must agree on is in `checks`. The module is long because it names every key there is.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    ModelWrapValidatorHandler,
    Tag,
    ValidationError,
    model_validator,
)
from pydantic_core import InitErrorDetails

from leanboom.io.fields import (
    Listing,
    Name,
    OneOrTwo,
    OrMapping,
    Quantity,
    Rule,
    Start,
    Switch,
    Text,
    Variant,
    Word,
    ordered,
    refusal,
    rising,
    rising_from_zero,
    rule_of,
    suggestion,
)
from leanboom.model.machine import STANDARD_GRAVITY
from leanboom.quantities import ranges

EFFICIENCY_MAP = "(map)"  # pydantic's word for that kind of efficiency; no key of a file

Length = Annotated[float, Quantity(ranges.LENGTH)]
Coordinate = Annotated[float, Quantity(ranges.LENGTH, any_bare=True)]
PositiveLength = Annotated[float, Quantity(ranges.POSITIVE_LENGTH)]
LeastLength = Annotated[float, Quantity(ranges.LEAST_LENGTH)]
Angle = Annotated[float, Quantity(ranges.ANGLE)]
Area = Annotated[float, Quantity(ranges.AREA)]
Volume = Annotated[float, Quantity(ranges.VOLUME)]
Number = Annotated[float, Quantity(ranges.NUMBER)]
PositiveNumber = Annotated[float, Quantity(ranges.POSITIVE_NUMBER)]
Coefficient = Annotated[float, Quantity(ranges.COEFFICIENT)]
Share = Annotated[float, Quantity(ranges.SHARE)]
DeadZone = Annotated[float, Quantity(ranges.DEAD_ZONE)]
Efficiency = Annotated[float, Quantity(ranges.EFFICIENCY)]
Mass = Annotated[float, Quantity(ranges.MASS)]
Payload = Annotated[float, Quantity(ranges.LEAST_MASS)]
Inertia = Annotated[float, Quantity(ranges.INERTIA)]
Velocity = Annotated[float, Quantity(ranges.VELOCITY)]
Acceleration = Annotated[float, Quantity(ranges.ACCELERATION)]
Gravity = Annotated[float, Quantity(ranges.GRAVITY)]
Force = Annotated[float, Quantity(ranges.FORCE)]
Sharpness = Annotated[float, Quantity(ranges.SHARPNESS)]
Viscous = Annotated[float, Quantity(ranges.VISCOUS)]
Pressure = Annotated[float, Quantity(ranges.PRESSURE)]
PositivePressure = Annotated[float, Quantity(ranges.POSITIVE_PRESSURE)]
Flow = Annotated[float, Quantity(ranges.FLOW)]
Speed = Annotated[float, Quantity(ranges.SPEED)]
Displacement = Annotated[float, Quantity(ranges.DISPLACEMENT)]
Frequency = Annotated[float, Quantity(ranges.FREQUENCY)]
Cutoff = Annotated[float, Quantity(ranges.CUTOFF)]
Duration = Annotated[float, Quantity(ranges.FILE_DURATION)]
Time = Annotated[float, Quantity(ranges.FILE_TIME)]
PumpTime = Annotated[float, Quantity(ranges.PUMP_TIME)]
Delay = Annotated[float, Quantity(ranges.DELAY)]
Bool = Annotated[bool, Switch()]
Words = Annotated[str, Text()]
Identifier = Annotated[str, Name()]
Racks = Annotated[int, OneOrTwo()]

AngleRange = Annotated[
    tuple[Angle, Angle], Listing("two angles, lower and upper end", "angle", 2, 2), AfterValidator(ordered)
]
LengthRange = Annotated[
    tuple[LeastLength, LeastLength],
    Listing("two lengths, lower and upper end", "length", 2, 2),
    AfterValidator(ordered),
]
Steps = Annotated[
    tuple[Length, Length, Length, Length], Listing("four lengths", "length", 4, 4), AfterValidator(rising)
]
Coefficients = Annotated[tuple[Number, ...], Listing("2 to 12 numbers, highest power first", "number", 2, 12)]
Speeds = Annotated[tuple[Speed, ...], Listing("at least one speed", "rotational speed", 1), AfterValidator(rising)]
Displacements = Annotated[
    tuple[Displacement, ...], Listing("at least two displacements", "displacement", 2), AfterValidator(rising)
]
Pressures = Annotated[
    tuple[PositivePressure, ...], Listing("at least two pressures", "pressure", 2), AfterValidator(rising)
]
Efficiencies = Annotated[tuple[Efficiency, ...], Listing("efficiencies, one for each of pressures", "number", 2)]
Table = Annotated[tuple[Efficiencies, ...], Listing("rows, one for each of displacements", "number", 2)]
Tables = Annotated[tuple[Table, ...], Listing("tables, one for each of speeds", "number", 1)]
Point = Annotated[
    tuple[Coordinate, Coordinate, Coordinate], Listing("three lengths x, y, z", "length", 3, 3, bare=True)
]
Points = Annotated[tuple[Point, ...], Listing("at least two points [x, y, z]", "length", 2, bare=True)]
Durations = Annotated[tuple[Duration, ...], Listing("at least one time", "time", 1)]
Times = Annotated[tuple[Time, ...], Listing("at least two times", "time", 2), AfterValidator(rising_from_zero)]


class Section(BaseModel):
    """A mapping in a file: its keys are these fields and no others."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)

    @classmethod
    def rule(cls, name: str) -> str:
        """What the value of a key must be."""
        field = cls.model_fields[name]
        rule = rule_of(field.metadata, field.annotation)
        inner = field.annotation
        if rule is None and isinstance(inner, type) and issubclass(inner, Section):
            return inner.mapping()
        return rule.allowed if rule else "must be given"

    @classmethod
    def mapping(cls) -> str:
        """What the section itself must be."""
        return f"must be a mapping with the keys {', '.join(cls.model_fields)}"

    @model_validator(mode="wrap")
    @classmethod
    def _in_our_words(cls, data: Any, handler: ModelWrapValidatorHandler) -> Any:
        """Tell errors in terms of the file: which key, and what is allowed there."""
        try:
            return handler(data)
        except ValidationError as error:
            raise ValidationError.from_exception_data(
                cls.__name__, [cls._reworded(line) for line in error.errors(include_url=False)]
            ) from None

    @classmethod
    def _reworded(cls, line: Any) -> InitErrorDetails:
        kind, context, loc = line["type"], line.get("ctx", {}), line["loc"]
        if "allowed" in context:  # in our words already
            error = refusal(context["allowed"], context["key"], kind)
        elif kind == "missing":
            error = refusal(cls.rule(str(loc[-1])), kind=kind)
        elif kind == "extra_forbidden":
            error = refusal(suggestion(str(loc[-1]), tuple(cls.model_fields)), kind="unknown")
        else:
            error = refusal(f"is refused: {line['msg']}" if loc else cls.mapping())
        return InitErrorDetails(type=error, loc=loc, input=line["input"])


class GeometryKeys(Section):
    """Lengths of the boom in its own vertical plane."""

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
    slewing: Bool
    """Whether the machine has a slewing base."""


class JointKeys(Section):
    """Ranges of the joints, lower and upper end."""

    base: AngleRange | None = None
    """Slewing angle, from x towards y; only if the machine slews."""
    lift: AngleRange
    """Boom against the horizontal."""
    tilt: AngleRange
    """Outer boom against the boom, negative when folded down."""
    extension: LengthRange
    """How far the tool is telescoped out."""


class RackAndPinionKeys(Section):
    """A rack turning a pinion."""

    type: Literal["rack_and_pinion"]
    arm: PositiveLength
    """Pitch radius of the pinion."""


class TriangleKeys(Section):
    """A cylinder spanning the joint: c^2 = long^2 + short^2 - 2 long short cos(q + angle)."""

    type: Literal["triangle"]
    long: PositiveLength
    """Joint to the farther pin."""
    short: PositiveLength
    """Joint to the nearer pin."""
    angle: Angle
    """Angle between the two pins, seen from the joint, at joint angle 0."""


class FourBarKeys(Section):
    """A cylinder driving the joint through lever and coupler."""

    type: Literal["four_bar"]
    L21: PositiveLength
    """Cylinder's pin on the boom to the lever's pivot."""
    L22: PositiveLength
    """Lever's pivot to the tilt joint."""
    L23: PositiveLength
    """Tilt joint to the coupler's pin on the outer boom."""
    L24: PositiveLength
    """Coupler."""
    L25: PositiveLength
    """Lever."""
    a21: Angle
    """Direction of the lever's pivot, seen from the tilt joint, against the boom."""
    a22: Angle
    """Direction of the coupler's pin, seen from the tilt joint, against the outer boom."""
    b21: Angle
    """Direction of the cylinder's pin, seen from the lever's pivot, against the boom."""


class PolynomialKeys(Section):
    """Cylinder length in m as a polynomial of the joint angle in rad."""

    type: Literal["polynomial"]
    coefficients: Coefficients
    """Highest power first."""


class TelescopeKeys(Section):
    """Cylinder length proportional to the extension."""

    type: Literal["telescope"]
    ratio: PositiveNumber
    """Cylinder length per extension: 1, or 0.5 where a chain doubles the stroke."""


class FrictionKeys(Section):
    """Friction force of the cylinder."""

    coulomb: Force
    """Coulomb friction."""
    sharpness: Sharpness
    """K of the tanh(K v) that smooths the change of sign."""
    viscous: Viscous = 0.0
    """Friction per velocity."""
    steps: Steps | None = None
    """Extension only: Coulomb friction rises by 1/m from the first to the second and from the third to the fourth."""
    joint_velocity: Bool = False
    """Whether v in tanh(K v) is the joint's velocity."""


class CylinderKeys(Section):
    """One cylinder: its size, its linkage to the joint, its connection to the valve, its limits."""

    bore: PositiveLength | None = None
    """Piston diameter; with rod."""
    rod: PositiveLength | None = None
    """Rod diameter, below the bore."""
    plunger: PositiveLength | None = None
    """Diameter of two opposed plungers on one rack, in place of bore and rod."""
    racks: Racks | None = None
    """How many racks with two plungers each: 1 (if not given) or 2."""
    piston_area: Area | None = None
    """Area on the piston side, in place of bore; with rod_side_area."""
    rod_side_area: Area | None = None
    """Area on the rod side, at most the piston side's."""
    stroke: Annotated[float | None, Quantity(ranges.POSITIVE_LENGTH)] = None
    """Must be the change of length over the joint's range, within 2 %; that change if not given."""
    linkage: Annotated[
        RackAndPinionKeys | TriangleKeys | FourBarKeys | PolynomialKeys | TelescopeKeys,
        Field(discriminator="type"),
        Variant("rack_and_pinion", "triangle", "four_bar", "polynomial", "telescope"),
    ]
    """How the cylinder moves its joint."""
    connection: Annotated[
        str, Word("standard", "single_acting", "differential", double_acting="standard", regenerative="differential")
    ]
    """How its chambers meet the valve, which decides the pump flow."""
    friction: FrictionKeys
    velocity_limit: Velocity
    """Both ways."""
    acceleration_limit: Acceleration
    """Both ways."""


class CylinderSet(Section):
    """The cylinders, by the joint they move."""

    base: CylinderKeys | None = None
    """Only if the machine slews."""
    lift: CylinderKeys
    tilt: CylinderKeys
    extension: CylinderKeys


class BodyKeys(Section):
    """A rigid body."""

    carrier: Annotated[str, Word("base", "lift", "tilt", column="base", boom="lift", outer="tilt", extension="tilt")]
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


class PayloadKeys(Section):
    """Where a payload hangs on the outer boom."""

    along: Length
    """From the tilt joint along the extension's axis, at zero extension."""
    above: Length
    """Perpendicular to it, upwards."""


class MobileValveKeys(Section):
    """A pressure-compensated mobile valve in steady state."""

    type: Literal["mobile_valve"]
    compensator_drop: Pressure
    """Constant pressure drop over the spool."""
    extend_coefficient: Coefficient
    """Back pressure while extending, in compensator drops."""
    retract_coefficient: Coefficient
    """Back pressure while retracting, in compensator drops."""
    regenerative_ratio: Coefficient
    """Ratio of the flow coefficients P-A to B-P of a differential spool."""


class IndependentMeteringKeys(Section):
    """Valves with separate edges for inflow and outflow."""

    type: Literal["independent_metering"]
    back_pressure: Pressure
    """Pressure in the chamber that empties, in planning."""
    offside_pressure: Pressure
    """The same in the closed-loop simulation."""


class EfficiencyKeys(Section):
    """Efficiency of pump and drive together over speed, displacement and pressure."""

    speed: Speed
    """Of the drive, from the first to the last of speeds."""
    speeds: Speeds
    """At which the tables were measured, rising."""
    displacements: Displacements
    """Delivered flow over speed, rising."""
    pressures: Pressures
    """Rising."""
    total: Tables
    """A table for each speed, in it a row for each displacement, in it a total efficiency for each pressure."""


class PumpKeys(Section):
    """The pump."""

    constant_pressure: PositivePressure
    """Supply pressure of the constant-pressure system."""
    ls_margin: Pressure
    """Load-sensing margin above the highest load pressure."""
    max_pressure: PositivePressure
    max_flow: Flow
    tank_pressure: Pressure
    efficiency: Annotated[
        Annotated[float, Tag("number")] | Annotated[EfficiencyKeys, Tag(EFFICIENCY_MAP)],
        Discriminator(lambda value: EFFICIENCY_MAP if isinstance(value, dict) else "number"),
        OrMapping(Quantity(ranges.EFFICIENCY), ", ".join(EfficiencyKeys.model_fields)),
    ]
    """Of pump and drive together: a number, or a map over speed, displacement and pressure."""


class DynamicsKeys(Section):
    """What planning takes into account."""

    coriolis: Bool = False
    """Centrifugal and Coriolis forces."""
    slewing_inertia: Bool = False
    """Inertia about the slewing axis in the base cylinder's force."""


class CircuitKeys(Section):
    """The hydraulics of the closed-loop simulation; what is not given is taken from the kind of valve."""

    bulk_modulus: PositivePressure | None = None
    """Effective, of oil and hoses."""
    dead_volume: Volume | None = None
    """Chamber and hose with the piston at its end."""
    line_volume: Volume | None = None
    """Between pump and valves."""
    pump_time_constant: PumpTime | None = None
    """Of the supply pressure."""
    edge_flow: Flow | None = None
    """Flow of a fully open valve edge at its compensated pressure drop."""
    edge_drop: PositivePressure | None = None
    """That drop; a mobile valve's compensator_drop counts instead."""
    spool_bandwidth: Frequency | None = None
    """Of the spool behind its command."""
    delay: Delay | None = None
    """From a command to the spool's first movement; at least one sample of 2 ms."""
    dead_zone: DeadZone | None = None
    """Share of the spool's travel that opens nothing."""
    counter_pressure: Pressure | None = None
    """Of the return line above the tank."""
    seal_friction: Share | None = None
    """Coulomb friction beside planning's, as a share of the cylinder's force at constant pressure."""
    seal_damping: Share | None = None
    """Viscous friction at the velocity limit beside planning's, as a share of the same force."""


class Bodies(Rule):
    """Bodies by name."""

    allowed = "must be a mapping with at least one body: name: {carrier, mass, along, above, inertia}"

    def check(self, value: Any) -> Any:
        """The mapping."""
        if not isinstance(value, dict) or not value:
            raise refusal(self.allowed)
        return value


class MachineKeys(Section):
    """A machine file."""

    name: Identifier | None = None
    """By default made of the file's name without its ending."""
    description: Words = ""
    geometry: GeometryKeys
    """Lengths of the boom in its own vertical plane."""
    joints: JointKeys
    """Their ranges, [lower, upper]."""
    cylinders: CylinderSet
    """One for each joint."""
    bodies: Annotated[dict[Identifier, BodyKeys], Bodies()]
    """Rigid bodies, each under a name of its own."""
    payload: PayloadKeys
    """Where a task's payload hangs on the outer boom."""
    valve: Annotated[
        MobileValveKeys | IndependentMeteringKeys,
        Field(discriminator="type"),
        Variant("mobile_valve", "independent_metering"),
    ]
    """The valves of all cylinders."""
    pump: PumpKeys
    driven_velocity: Velocity
    """Slower cylinders count as not driven."""
    dynamics: DynamicsKeys = DynamicsKeys()
    """What planning takes into account."""
    simulation: CircuitKeys = CircuitKeys()
    """The hydraulics of the closed-loop simulation."""
    gravity: Gravity = STANDARD_GRAVITY


class LinesKeys(Section):
    """Straight segments, each from rest to rest."""

    type: Literal["lines"]
    points: Points
    """Corners [x, y, z], one more than durations."""
    durations: Durations
    """Of each segment."""


class SplineKeys(Section):
    """A cubic spline through via points, at rest at both ends."""

    type: Literal["spline"]
    points: Points
    """Via points [x, y, z], as many as times."""
    times: Times
    """When each point is passed, rising from 0."""


class TaskKeys(Section):
    """A task file."""

    name: Identifier | None = None
    """By default made of the file's name without its ending."""
    machine: Words
    """A bundled machine's name, or a machine file, relative to the task file."""
    payload: Payload
    """Hangs at the machine's payload point."""
    path: Annotated[LinesKeys | SplineKeys, Field(discriminator="type"), Variant("lines", "spline")]
    """What the tool does."""
    start: Annotated[str | float, Start()]
    """Where the redundant cylinder starts: smallest, middle, best, or a length."""
    smooth: Cutoff | None = None
    """Low-pass cut-off for the redundant motion before it is judged; none if not given."""
