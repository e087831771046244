"""Units in which people read what was identified, by the names of values and signals."""

from __future__ import annotations

import re

from leanboom.identification.base_parameters import BASE

_SIGNALS = {
    "force": ("kN", 1e-3),
    "velocity": ("m/s", 1.0),
    "flow": ("l/min", 6e4),
    "supply": ("MPa", 1e-6),
    "cylinder": ("mm", 1e3),
}
_DEGREES = 57.29577951308232
_VALUES = {  # by the last part of a name, or its last word
    "mass": ("kg", 1.0),
    "along": ("m", 1.0),
    "above": ("m", 1.0),
    "inertia": ("kg m^2", 1.0),
    "coulomb": ("kN", 1e-3),
    "viscous": ("kN s/m", 1e-3),
    "steps": ("m", 1.0),
    "area_out": ("cm^2", 1e4),
    "area_in": ("cm^2", 1e4),
    "out": ("cm^2", 1e4),  # of an anti-cavitation polynomial
    "in": ("cm^2", 1e4),
    "bulk_modulus": ("MPa", 1e-6),
    "ls_margin": ("MPa", 1e-6),
    "pump_time_constant": ("s", 1.0),
    "velocity": ("mm/s", 1e3),
    "delay": ("ms", 1e3),
    "spool_bandwidth": ("Hz", 1.0),
    "dead_zone": ("%", 1e2),
    "dead_zone_out": ("%", 1e2),
    "dead_zone_in": ("%", 1e2),
    "gain_out": ("m/s", 1.0),
    "gain_in": ("m/s", 1.0),
    "edge_flow": ("l/min", 6e4),
    "angle": ("deg", _DEGREES),
}
_ANGLES = re.compile("[ab]2[0-9]")


def of_signal(name: str) -> tuple[str, float]:
    """Unit of a signal, and how many of them there are in its SI unit.

    Args:
        name: Such as `lift_force`.
    """
    return _SIGNALS[name.rpartition("_")[2]]


def of_value(name: str) -> tuple[str, float]:
    """Unit of an identified value, and how many of them there are in its SI unit; none for a plain number.

    Args:
        name: Such as `cylinders.lift.friction.coulomb`.
    """
    if name in BASE:
        return BASE[name][0], 1.0
    last = re.sub(r"\[\d+\]$", "", name).rpartition(".")[2]
    if ".linkage." in name and last not in _VALUES:
        return ("deg", _DEGREES) if _ANGLES.fullmatch(last) else ("mm", 1e3)
    return _VALUES.get(last) or _VALUES.get(last.rpartition("_")[2], ("", 1.0))  # coefficients have none


def shown(name: str, value: float) -> str:
    """An identified value in its unit, without it.

    Args:
        name: Its name.
        value: The value, in SI.
    """
    return f"{of_value(name)[1] * value:.5g}"
