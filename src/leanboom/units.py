"""Quantities at the file border: "610 mm" becomes 0.61, a bare number is SI, a number becomes "0.61 m".

Pint knows the units; it sees nothing but the unit's text, and only if that text is made of words and small powers.
Conversion is exact rational arithmetic rounded once, so "610 mm" is the same float as "0.61 m" and 0.61.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from math import isfinite, pi


@dataclass(frozen=True, slots=True)
class Kind:
    """What a quantity measures, the SI unit it becomes, and an example for messages."""

    name: str
    unit: str
    example: str


KINDS = {
    kind.name: kind
    for kind in (
        Kind("length", "m", "610 mm"),
        Kind("angle", "rad", "-0.425 rad"),
        Kind("area", "m^2", "103.87 cm^2"),
        Kind("volume", "m^3", "1.5 l"),
        Kind("mass", "kg", "370 kg"),
        Kind("inertia", "kg m^2", "420 kg m^2"),
        Kind("time", "s", "0.05 s"),
        Kind("frequency", "Hz", "5 Hz"),
        Kind("velocity", "m/s", "0.15 m/s"),
        Kind("acceleration", "m/s^2", "0.4 m/s^2"),
        Kind("force", "N", "6 kN"),
        Kind("pressure", "Pa", "21.5 MPa"),
        Kind("flow", "m^3/s", "325 l/min"),
        Kind("rotational speed", "rev/s", "1800 rev/min"),
        Kind("displacement", "m^3/rev", "45 cm^3/rev"),
        Kind("sharpness", "s/m", "2000 s/m"),
        Kind("viscous friction", "N s/m", "330 N s/m"),
        Kind("number", "", "0.5"),
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
bar = 1e5 * pascal
percent = 0.01 = %
"""

_QUANTITY = re.compile(r"([+-]?(?:\d{1,40}(?:\.\d{0,40})?|\.\d{1,40})(?:[eE][+-]?\d{1,3})?)\s*(\S.{0,39})?")
_UNIT = re.compile(r"%|[A-Za-zµ]+(?:\^-?\d)?(?:(?: ?[*/·] ?| )[A-Za-zµ]+(?:\^-?\d)?)*")
_LARGEST = 1e15  # anything beyond, in SI units, is a slip of the pen


@cache
def _registry():
    """The small pint registry: 5 ms to make, where pint's own takes 150 ms."""
    from pint import UnitRegistry

    registry = UnitRegistry(None, non_int_type=Fraction)  # type: ignore[arg-type]
    registry.load_definitions(DEFINITIONS.strip().splitlines())
    return registry


@cache
def _factor(unit: str, target: str) -> Fraction | None:
    """What one `unit` is in SI units `target`; None if it is no unit or measures something else."""
    if unit == target:
        return Fraction(1)
    if not _UNIT.fullmatch(unit):
        return None
    from pint import PintError

    registry = _registry()
    text = unit.replace("·", "*").replace("µ", "u")
    try:
        return Fraction(registry.convert(Fraction(1), registry.parse_units(text), registry.parse_units(target)))
    except (PintError, ArithmeticError, AttributeError, TypeError, ValueError):
        return None


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
    return float(value) if abs(value) <= _LARGEST else None


def write(value: float, kind: Kind) -> str:
    """A quantity as it stands in a file: shortest decimal that reads back equal, with its SI unit."""
    text = repr(float(value))
    text = text[:-2] if text.endswith(".0") else text
    return f"{text} {kind.unit}".strip()
