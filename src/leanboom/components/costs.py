"""The pumps, the costs a motion can be planned for, and their codes inside kernels."""

from __future__ import annotations

from typing import TypeVar

from leanboom.errors import InputError

Value = TypeVar("Value")

PUMPS = ("ls", "cp")  # load-sensing, constant-pressure

COSTS = {
    "ls": 0,  # load-sensing pump energy, eq. (36); eq. (32), 3-DOF paper [J]
    "cp": 1,  # constant-pressure pump energy, eq. (43); eqs. (27), (31), 3-DOF paper [J]
    "actuator": 2,  # positive actuator work, both papers [J]
    "velocity": 3,  # sum of squared cylinder velocities [m^2/s]
    "extension": 4,  # squared velocity of the extension cylinder [m^2/s]
    "recuperation": 5,  # CP energy with return flow reused, eq. (37), 3-DOF paper [J]
}
LS, CP, ACTUATOR = COSTS["ls"], COSTS["cp"], COSTS["actuator"]
VELOCITY, EXTENSION, RECUPERATION = COSTS["velocity"], COSTS["extension"], COSTS["recuperation"]


def of_pump(pump: str, ls: Value, cp: Value) -> Value:
    """The one of two values that belongs to a pump.

    Args:
        pump: A name of `PUMPS`.
        ls: The value of a load-sensing pump.
        cp: The value of a constant-pressure pump.

    Raises:
        InputError: For any other name.
    """
    if pump not in PUMPS:
        raise InputError(f"pump = {pump}; must be one of {', '.join(PUMPS)}")
    return ls if pump == "ls" else cp
