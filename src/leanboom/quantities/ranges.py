"""Allowed values of fields, the same in files and in constructors.

A rule stands in a field's type, `Annotated[float, LENGTH]`; `declarations` finds it there. Pydantic applies it to
the values of files.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import isfinite
from numbers import Real
from typing import TYPE_CHECKING, Any, LiteralString, TypeVar

from leanboom.errors import InputError
from leanboom.quantities.units import KINDS, LARGEST, Kind, expected, is_bare, parse, write

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
    from pydantic_core import CoreSchema

T = TypeVar("T")


class Refused(ValueError):
    """Error of a value that is not allowed; `key` if it stands one level deeper."""

    def __init__(self, allowed: str, key: str = "", kind: LiteralString = "refused"):
        super().__init__(allowed)
        self.allowed, self.key = allowed, key
        self.kind: LiteralString = kind


class Rule:
    """Rule of a value: its range in words, how it is read, and for quantities the kind."""

    __slots__ = ()
    _allowed = "must be given"

    @property
    def allowed(self) -> str:
        """The allowed values in words."""
        return self._allowed

    @property
    def kind(self) -> Kind | None:
        """What a quantity measures; None for other values."""
        return None

    @property
    def bare(self) -> bool:
        """Whether quantities are written without their unit."""
        return False

    def check(self, value: Any) -> Any:
        """A value of a file, ready for its type.

        Raises:
            Refused: It is not allowed.
        """
        return value

    def finish(self, value: Any) -> Any:
        """A value whose parts have been read.

        Raises:
            Refused: It is not allowed.
        """
        return value

    def kept(self, key: str, value: Any) -> Any:
        """A value handed over in Python, as a frozen instance keeps it.

        Args:
            key: What messages call it.
            value: The value.

        Raises:
            InputError: It is not allowed.
        """
        return value

    def section_of(self, value: Any) -> Any:
        """The `declarations.Section` that a value is written as; None if it is none."""
        return None

    def described(self, schema: dict[str, Any]) -> dict[str, Any]:
        """The JSON schema of the value as written, from that of its type."""
        return schema

    def validated(self, value: Any, parts: Callable[[Any], Any]) -> Any:
        """A value of a file, checked before and after its parts; errors as pydantic wants them."""
        from pydantic_core import PydanticCustomError

        try:
            return self.finish(parts(self.check(value)))
        except Refused as error:
            context = {"allowed": error.allowed, "key": error.key}
            raise PydanticCustomError(error.kind, "{allowed}", context) from None

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Check around the type."""
        from pydantic_core import core_schema

        return core_schema.no_info_wrap_validator_function(self.validated, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Describe the value as written."""
        return self.described(handler(schema))


@dataclass(frozen=True, slots=True)
class Range(Rule):
    """The allowed values of a quantity, in SI units."""

    name: str  # of the kind, one of `units.KINDS`
    above: float | None = None
    least: float | None = None
    most: float | None = None
    any_bare: bool = False  # bare numbers of any size
    in_python: Range | None = None  # what Python may hand over, where files hold less

    @property
    def kind(self) -> Kind:
        """What the quantity measures."""
        return KINDS[self.name]

    @property
    def allowed(self) -> str:
        """The kind, its bounds and an example."""
        article = "an" if self.name[0] in "aeiou" else "a"
        return f"must be {article} {self.name}{f' {self.bounds}' if self.bounds else ''}, such as {self.kind.example}"

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

    def check(self, value: Any) -> float:
        """A quantity of a file in SI units."""
        kind = self.kind
        number = parse(value, kind) if isinstance(value, str) and is_bare(value) else None
        if number is not None and abs(number) > kind.bare and not self.any_bare:
            raise Refused(f"must have its unit beyond {write(kind.bare, kind)}, since a bare number is in {kind.unit}")
        return self.number(value)

    def number(self, value: object) -> float:
        """A quantity in SI units.

        Args:
            value: A number of Python or NumPy in SI units, or a text such as "610 mm".

        Raises:
            Refused: It is no finite quantity of this kind or out of bounds; the text says what it must be.
        """
        kind = self.kind
        number = parse(value, kind) if isinstance(value, str) else _number(value)
        if number is None:
            raise Refused(expected(value if isinstance(value, str) else "", kind))
        low = (self.above is not None and number <= self.above) or (self.least is not None and number < self.least)
        if low or (self.most is not None and number > self.most):
            raise Refused(f"must be {self.bounds}")
        return number

    def kept(self, key: str, value: Any) -> float:
        """A quantity handed over in Python, in SI units."""
        return checked(key, value, self.in_python or self)

    def described(self, schema: dict[str, Any]) -> dict[str, Any]:
        """Text with a unit, or a bare number."""
        bare = f"a bare number is in {self.kind.unit}" if self.kind.unit else "without a unit"
        return {"type": ["string", "number"], "description": f"{self.allowed.removeprefix('must be ')}; {bare}"}


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
        return allowed.number(value)
    except Refused as error:
        unit = f" {KINDS[allowed.name].unit}" if isinstance(value, Real) and isfinite(float(value)) else ""
        raise InputError(f"{key} = {shown(value)}{unit.rstrip()}; {error}") from None


def one_of(key: str, value: object, allowed: Iterable[str]) -> None:
    """Raise InputError for a value that is none of the allowed ones.

    Args:
        key: What the message calls it.
        value: The value.
        allowed: The names it may be.
    """
    names = tuple(allowed)
    if value not in names:
        raise InputError(f"{key} = {value}; must be one of {', '.join(names)}")


def noted(problems: list[str], read: Callable[..., T], *arguments: Any) -> T | None:
    """Value returned by a reader; None where it raises InputError, whose text is added to the problems.

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
COORDINATE = Range("length", any_bare=True)
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
PRICE = Range("power", least=0)
PRESSURE = Range("pressure", least=0)
POSITIVE_PRESSURE = Range("pressure", above=0)
FLOW = Range("flow", above=0)
SPEED = Range("rotational speed", above=0)
DISPLACEMENT = Range("displacement", above=0)
FREQUENCY = Range("frequency", above=0)
LEAST_FREQUENCY = Range("frequency", least=0, most=50)
# Below the least the low pass of 2 ms samples is singular or inaccurate; the most is just below half their rate.
CUTOFF = Range("frequency", least=0.01, most=240)
MOMENT = 1e-4  # [s], shorter segments of a path are jumps
LONGEST = 3600.0  # [s], of a file's segment
DURATION = Range("time", least=MOMENT, most=LONGEST, in_python=Range("time", least=MOMENT))
TIME = Range("time", least=0, most=LONGEST, in_python=Range("time", least=0))
STAGE = Range("time", least=1e-3, most=1.0)  # of a plan
PUMP_TIME = Range("time", above=0, most=10)
DELAY = Range("time", least=0, most=10)
