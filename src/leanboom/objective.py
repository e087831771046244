"""The pumps, the costs a motion can be planned for, and their codes inside kernels."""

from __future__ import annotations

PUMPS = ("ls", "cp")  # load-sensing, constant-pressure

COSTS = {
    "ls": 0,  # load-sensing pump energy, eq. (36); eq. (32), 3-DOF paper [J]
    "cp": 1,  # constant-pressure pump energy, eq. (43); eqs. (27), (31), 3-DOF paper [J]
    "actuator": 2,  # positive actuator work, both papers [J]
    "velocity": 3,  # sum of squared cylinder velocities [m^2/s]
    "extension": 4,  # squared velocity of the extension cylinder [m^2/s]
    "recuperation": 5,  # CP energy with return flow reused, eq. (37), 3-DOF paper [J]
}
