"""Types of declared fields: a value, with the rule that it keeps.

@dataclass(frozen=True, slots=True)
class Triangle(Linkage):
    long: PositiveLength
    \"\"\"Joint to the farther pin.\"\"\"
"""

from __future__ import annotations

from typing import Annotated

from leanboom.quantities import ranges
from leanboom.quantities.rules import Name, Switch, Text

Length = Annotated[float, ranges.LENGTH]
Coordinate = Annotated[float, ranges.COORDINATE]
PositiveLength = Annotated[float, ranges.POSITIVE_LENGTH]
LeastLength = Annotated[float, ranges.LEAST_LENGTH]
Angle = Annotated[float, ranges.ANGLE]
Area = Annotated[float, ranges.AREA]
Volume = Annotated[float, ranges.VOLUME]
Number = Annotated[float, ranges.NUMBER]
PositiveNumber = Annotated[float, ranges.POSITIVE_NUMBER]
Coefficient = Annotated[float, ranges.COEFFICIENT]
Share = Annotated[float, ranges.SHARE]
DeadZone = Annotated[float, ranges.DEAD_ZONE]
Efficiency = Annotated[float, ranges.EFFICIENCY]
Mass = Annotated[float, ranges.MASS]
LeastMass = Annotated[float, ranges.LEAST_MASS]
Inertia = Annotated[float, ranges.INERTIA]
Velocity = Annotated[float, ranges.VELOCITY]
Acceleration = Annotated[float, ranges.ACCELERATION]
Gravity = Annotated[float, ranges.GRAVITY]
Force = Annotated[float, ranges.FORCE]
Sharpness = Annotated[float, ranges.SHARPNESS]
Viscous = Annotated[float, ranges.VISCOUS]
Price = Annotated[float, ranges.PRICE]
Pressure = Annotated[float, ranges.PRESSURE]
PositivePressure = Annotated[float, ranges.POSITIVE_PRESSURE]
Flow = Annotated[float, ranges.FLOW]
Speed = Annotated[float, ranges.SPEED]
Displacement = Annotated[float, ranges.DISPLACEMENT]
Frequency = Annotated[float, ranges.FREQUENCY]
LeastFrequency = Annotated[float, ranges.LEAST_FREQUENCY]
Cutoff = Annotated[float, ranges.CUTOFF]
Duration = Annotated[float, ranges.DURATION]
Time = Annotated[float, ranges.TIME]
PumpTime = Annotated[float, ranges.PUMP_TIME]
Delay = Annotated[float, ranges.DELAY]
Bool = Annotated[bool, Switch()]
Words = Annotated[str, Text()]
Identifier = Annotated[str, Name()]
