"""Which quantities are allowed: the same ranges for values in files and for those handed to a constructor in Python."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite
from numbers import Real
from typing import Any, TypeVar

from leanboom.errors import InputError
from leanboom.quantities.units import KINDS, LARGEST, expected, parse, write

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Range:
    """The allowed values of a quantity, in SI units."""

    name: str  # of the kind, one of `units.KINDS`
    above: float | None = None
    least: float | None = None
    most: float | None = None

    @property
    def bounds(self) -> str:
        """The bounds in words; empty without any."""
        kind = KINDS[self.name]
        if self.least is not None and self.most is not None:
            return f"from {write(self.least, kind) if self.least else 0} to {write(self.most, kind)}"
        given = (("above", self.above), ("at least", self.least), ("at most", self.most))
        return " and ".join(
            f"{name} {write(bound, kind) if bound else 0}" for name, bound in given if bound is not None
        )

    def read(self, value: object) -> float:
        """A quantity in SI units.

        Args:
            value: A number of Python or NumPy in SI units, or a text such as "610 mm".

        Raises:
            ValueError: It is no finite quantity of this kind or out of bounds; the text says what it must be.
        """
        kind = KINDS[self.name]
        number = parse(value, kind) if isinstance(value, str) else _number(value)
        if number is None:
            raise ValueError(expected(value if isinstance(value, str) else "", kind))
        low = (self.above is not None and number <= self.above) or (self.least is not None and number < self.least)
        if low or (self.most is not None and number > self.most):
            raise ValueError(f"must be {self.bounds}")
        return number


def _number(value: object) -> float | None:
    """A number as a float; None where it is none, or not finite."""
    if not isinstance(value, Real) or isinstance(value, bool):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if isfinite(number) and abs(number) <= LARGEST else None


def checked(key: str, value: object, allowed: Range) -> float:
    """A quantity handed over in Python, in SI units.

    Args:
        key: What the message calls it.
        value: A number or a text with a unit.
        allowed: Its range.

    Raises:
        InputError: It is not allowed.
    """
    try:
        return allowed.read(value)
    except ValueError as error:
        unit = f" {KINDS[allowed.name].unit}" if isinstance(value, Real) and isfinite(float(value)) else ""
        raise InputError(f"{key} = {shown(value)}{unit.rstrip()}; {error}") from None


def noted(problems: list[str], read: Callable[..., T], *arguments: Any) -> T | None:
    """What a reader answers; None where it raises InputError, whose text is added to the problems.

    Args:
        problems: Where texts are added.
        read: Such as `checked`.
        *arguments: Of the reader.
    """
    try:
        return read(*arguments)
    except InputError as error:
        problems.append(str(error))
        return None


def shown(value: object) -> str:
    """A value as a message shows it, on one short line."""
    text = f"{float(value):.6g}" if isinstance(value, Real) else str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def hold(instance: Any, key: str, **allowed: Range) -> None:
    """Check the fields of a new frozen instance and keep them as floats.

    Args:
        instance: The instance.
        key: What messages call the instance; empty for nothing.
        allowed: Ranges by the field's name.

    Raises:
        InputError: A field is not allowed.
    """
    for name, one in allowed.items():
        full = f"{key}.{name}" if key else name
        object.__setattr__(instance, name, checked(full, getattr(instance, name), one))


def listed(key: str, values: Any, size: str, least: int, most: int | None = None) -> tuple[Any, ...]:
    """A list, a tuple or an array as a tuple.

    Args:
        key: What the message calls it.
        values: The values.
        size: How many there must be, in words.
        least, most: The same in numbers; None: any number from the least on.

    Raises:
        InputError: It is no such list.
    """
    found = tuple(values) if isinstance(values, Sequence) or getattr(values, "ndim", 0) else ()
    if isinstance(values, str) or len(found) < least or len(found) > (most or len(found)):
        raise InputError(f"{key} = {shown(values)}; must be a list of {size}")
    return found


LENGTH = Range("length")
POSITIVE_LENGTH = Range("length", above=0)
LEAST_LENGTH = Range("length", least=0)
ANGLE = Range("angle")
AREA = Range("area", above=0)
VOLUME = Range("volume", above=0)
NUMBER = Range("number")
POSITIVE_NUMBER = Range("number", above=0)
COEFFICIENT = Range("number", least=0)
SHARE = Range("number", least=0, most=1)
DEAD_ZONE = Range("number", least=0, most=0.9)
EFFICIENCY = Range("number", above=0, most=1)
MASS = Range("mass", above=0)
LEAST_MASS = Range("mass", least=0)
INERTIA = Range("inertia", least=0)
VELOCITY = Range("velocity", above=0)
ACCELERATION = Range("acceleration", above=0)
GRAVITY = Range("acceleration", least=0)
FORCE = Range("force", least=0)
SHARPNESS = Range("sharpness", above=0)
VISCOUS = Range("viscous friction", least=0)
PRESSURE = Range("pressure", least=0)
POSITIVE_PRESSURE = Range("pressure", above=0)
FLOW = Range("flow", above=0)
SPEED = Range("rotational speed", above=0)
DISPLACEMENT = Range("displacement", above=0)
FREQUENCY = Range("frequency", above=0)
# Below the least the low pass of 2 ms samples is singular or inaccurate; the most is just below half their rate.
CUTOFF = Range("frequency", least=0.01, most=240)
MOMENT = 1e-4  # [s], shorter segments of a path are jumps
LONGEST = 3600.0  # [s], of a file's segment
DURATION = Range("time", least=MOMENT)
FILE_DURATION = Range("time", least=MOMENT, most=LONGEST)
TIME = Range("time", least=0)
FILE_TIME = Range("time", least=0, most=LONGEST)
STAGE = Range("time", least=1e-3, most=1.0)  # of a plan
PUMP_TIME = Range("time", above=0, most=10)
DELAY = Range("time", least=0, most=10)
