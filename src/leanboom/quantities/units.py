"""Quantities at the file border: "610 mm" becomes 0.61, a bare number is SI, a number becomes "0.61 m".

Pint knows the units; it sees nothing but the unit's text, and only if that text is made of words and small powers.
Conversion is exact rational arithmetic rounded once, so "610 mm" is the same float as "0.61 m" and 0.61.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from math import inf, isfinite, pi


@dataclass(frozen=True, slots=True)
class Kind:
    """Kind of quantity: its name and SI unit; for messages an example and the usual units."""

    name: str
    unit: str
    example: str
    units: tuple[str, ...]
    bare: float = inf  # largest number without a unit: beyond, another unit is meant


KINDS = {
    kind.name: kind
    for kind in (
        Kind("length", "m", "610 mm", ("mm", "cm", "m"), bare=100.0),
        Kind("angle", "rad", "-0.425 rad", ("deg", "rad", "rev"), bare=6.3),
        Kind("area", "m^2", "103.87 cm^2", ("mm^2", "cm^2", "m^2")),
        Kind("volume", "m^3", "1.5 l", ("cm^3", "l", "m^3")),
        Kind("mass", "kg", "370 kg", ("g", "kg", "t")),
        Kind("inertia", "kg m^2", "420 kg m^2", ("kg m^2", "t m^2")),
        Kind("time", "s", "0.05 s", ("ms", "s", "min", "h")),
        Kind("frequency", "Hz", "5 Hz", ("Hz", "kHz")),
        Kind("velocity", "m/s", "0.15 m/s", ("mm/s", "cm/s", "m/s", "m/min")),
        Kind("acceleration", "m/s^2", "0.4 m/s^2", ("mm/s^2", "cm/s^2", "m/s^2")),
        Kind("force", "N", "6 kN", ("N", "kN", "MN")),
        Kind("pressure", "Pa", "21.5 MPa", ("Pa", "kPa", "MPa", "mbar", "bar")),
        Kind("power", "W", "2 kW", ("W", "kW")),
        Kind("flow", "m^3/s", "325 l/min", ("l/min", "l/s", "cm^3/s", "m^3/h", "m^3/s")),
        Kind("rotational speed", "rev/s", "1800 rev/min", ("rev/min", "rpm", "rev/s")),
        Kind("displacement", "m^3/rev", "45 cm^3/rev", ("cm^3/rev", "l/rev", "m^3/rev")),
        Kind("sharpness", "s/m", "2000 s/m", ("s/mm", "s/m")),
        Kind("viscous friction", "N s/m", "330 N s/m", ("N s/mm", "N s/m", "kN s/m")),
        Kind("number", "", "0.5", ("%",)),
    )
}

# The units a crane file needs. An angle is its own dimension here, so that a length is not taken for one.
DEFINITIONS = f"""
micro- = 1e-6 = µ- = u-
milli- = 1e-3 = m-
centi- = 1e-2 = c-
deci- = 1e-1 = d-
kilo- = 1e3 = k-
mega- = 1e6 = M-
meter = [length] = m = metre
second = [time] = s = sec
minute = 60 * second = min
hour = 60 * minute = h
hertz = 1 / second = Hz
gram = [mass] = g
tonne = 1e3 * kilogram = t
radian = [angle] = rad
degree = {Fraction(pi / 180)} * radian = deg
revolution = {Fraction(pi / 180) * 360} * radian = rev
revolutions_per_minute = revolution / minute = rpm
liter = 1e-3 * meter ** 3 = l = L = litre
newton = kilogram * meter / second ** 2 = N
pascal = newton / meter ** 2 = Pa
watt = newton * meter / second = W
bar = 1e5 * pascal
percent = 0.01 = %
"""

# [0-9], not \d, which matches the digits of every script.
_NUMBER = r"[+-]?(?:[0-9]{1,40}(?:\.[0-9]{0,40})?|\.[0-9]{1,40})(?:[eE][+-]?[0-9]{1,3})?"
_QUANTITY = re.compile(rf"({_NUMBER})\s*(\S.{{0,39}})?")
_AS_WRITTEN = re.compile(r"[+−–-]?[.,]?\d(?:[\d.,'’_]|\s(?=\d{3}(?!\d)))*")  # numbers of people, of any script
_UNIT = re.compile(r"%|[A-Za-zµ]+(?:\^-?[0-9])?(?:(?: ?[*/·] ?| )[A-Za-zµ]+(?:\^-?[0-9])?)*")
_WORD = re.compile(r"[^\W\d]+")
LARGEST = 1e15  # anything beyond, in SI units, is a slip of the pen


@cache
def _registry():
    """The small pint registry: 5 ms to make, where pint's own takes 150 ms."""
    from pint import UnitRegistry

    registry = UnitRegistry(None, non_int_type=Fraction)  # type: ignore[arg-type]
    registry.load_definitions(DEFINITIONS.strip().splitlines())
    return registry


@cache
def _factor(unit: str, target: str) -> Fraction | None:
    """Factor from `unit` to SI units `target`; None if it is no unit or measures something else."""
    if unit == target:
        return Fraction(1)
    from pint import PintError

    try:
        return Fraction(_registry().convert(Fraction(1), _parsed(unit), _registry().parse_units(target)))
    except (PintError, ArithmeticError, AttributeError, TypeError, ValueError):
        return None


def _parsed(unit: str):
    """A unit as a pint object.

    Raises:
        ValueError: It is not made of words and small powers.
        PintError: Pint does not know its words.
    """
    if not _UNIT.fullmatch(unit):
        raise ValueError
    return _registry().parse_units(unit.replace("·", "*").replace("µ", "u"))


def parse(text: str, kind: Kind) -> float | None:
    """Read a quantity.

    Args:
        text: As written: "610 mm", "0.61".
        kind: What it must measure.

    Returns:
        The value in SI units, correctly rounded; None if the text is no finite quantity of that kind.
    """
    match = _QUANTITY.fullmatch(text.strip())
    if match is None or not isfinite(float(match[1])):
        return None
    factor = Fraction(1) if match[2] is None else _factor(match[2].strip(), kind.unit)
    if factor is None:
        return None
    value = Fraction(match[1]) * factor
    return float(value) if abs(value) <= LARGEST else None


def is_bare(text: str) -> bool:
    """Whether a text is a number without a unit."""
    return re.fullmatch(_NUMBER, text.strip()) is not None


def write(value: float, kind: Kind) -> str:
    """A quantity as it stands in a file: shortest decimal that reads back equal, with its SI unit."""
    text = repr(float(value))
    text = text[:-2] if text.endswith(".0") else text
    return f"{text} {kind.unit}".strip()


def expected(text: str, kind: Kind) -> str:
    """Message on the allowed form of a text that `parse` refuses.

    Args:
        text: As written.
        kind: What it must measure.
    """
    unit = _unit(text)
    units = ""
    if unit and _factor(unit, kind.unit) is None:
        units = f" {'in' if kind.unit else 'without a unit or in'} {', '.join(kind.units)}"
    return f"must be a finite {kind.name}{units}, such as {kind.example}{slip(text, kind)}"


def slip(text: str, kind: Kind) -> str:
    """The part of a text that is no number or no unit here, as the end of a message; nothing if there is none.

    Args:
        text: As written.
        kind: What it must measure.
    """
    if _odd(text):
        return "; numbers are written with 0-9 and a decimal point"
    unit = _unit(text)
    if not unit or _known(unit):
        return ""
    part = next((word for word in _WORD.findall(unit) if not _known(word)), unit)
    meant = [known for known in kind.units if _plain(known) == _plain(unit)]
    return f"; {part} is not a unit here" + (f", did you mean {meant[0]}?" if meant else "")


def _odd(text: str) -> bool:
    """Whether a text begins with a number that is written otherwise."""
    number = _AS_WRITTEN.match(text.strip())
    return number is not None and not re.fullmatch(_NUMBER, number[0])


def _unit(text: str) -> str:
    """The text after the number of a quantity; empty without one."""
    match = _QUANTITY.fullmatch(text.strip())
    return "" if match is None or _odd(text) else (match[2] or "").strip()


def _known(unit: str) -> bool:
    from pint import PintError

    try:
        return bool(_parsed(unit))
    except (PintError, ArithmeticError, AttributeError, TypeError, ValueError):
        return False


def _plain(unit: str) -> str:
    """A unit without what is easily written otherwise: case, spaces, signs of powers and products."""
    return re.sub(r"[\s^*·]", "", unit.translate(str.maketrans("²³", "23"))).lower()
