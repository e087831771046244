"""Steady-state pressure lines and flow areas of a cylinder on its valve.

For every valve type the driven chamber's pressure is affine in the force: extending p_A = gain_out F + back_out,
retracting p_B = -gain_in F + back_in. `Drive` holds these four numbers and the two flow areas of a cylinder; they
follow from areas, connection and valve once, when a machine is used.
"""

from __future__ import annotations

from dataclasses import dataclass

from leanboom.components.pumps import Pump
from leanboom.components.valves import Connection, IndependentMetering, Valve
from leanboom.model.machine import Cylinder, Machine


@dataclass(frozen=True, slots=True)
class Drive:
    """Flow areas and steady-state pressure lines of one cylinder on its valve."""

    area_out: float  # pump flow per extending velocity [m^2]
    area_in: float  # pump flow per retracting velocity [m^2]
    gain_out: float  # dp_A/dF extending [1/m^2]
    back_out: float  # p_A at zero force, extending [Pa]
    gain_in: float  # -dp_B/dF retracting [1/m^2]
    back_in: float  # p_B at zero force, retracting [Pa]


def drive(cylinder: Cylinder, valve: Valve, pump: Pump) -> Drive:
    """The `Drive` of a cylinder: its connection and its valve's back pressures worked into six numbers."""
    a, b = cylinder.piston_area, cylinder.rod_side_area
    if isinstance(valve, IndependentMetering):
        drop, back_rod, back_piston, ratio = 0.0, valve.back_pressure, valve.back_pressure, 1.0
    else:
        drop, ratio = valve.compensator_drop, valve.regenerative_ratio
        back_rod = valve.extend_coefficient * drop + pump.tank_pressure  # p_B extending, eq. (24)
        back_piston = valve.retract_coefficient * drop + pump.tank_pressure  # p_A retracting, eq. (23)
    gain_in, back_in = 1.0 / b, a / b * back_piston  # eq. (24) retracting; eqs. (34)-(35)
    if cylinder.connection is Connection.SINGLE_ACTING:
        # Rod side drained to the tank: no pump flow and no driven pressure retracting.
        return Drive(a, 0.0, 1.0 / a, b / a * pump.tank_pressure, 0.0, 0.0)
    if cylinder.connection is Connection.DIFFERENTIAL:
        # Eqs. (27)-(28): p_A = F/A + (B/A) p_B, p_B = F/(A-B) + (K^2 B^2 A/(A-B)^3 + A/(A-B)) drop.
        rod = a - b
        p_b = (ratio**2 * b * b * a / rod**3 + a / rod) * drop
        return Drive(rod, b, 1.0 / a + b / (a * rod), b / a * p_b, gain_in, back_in)
    return Drive(a, b, 1.0 / a, b / a * back_rod, gain_in, back_in)


def drives(machine: Machine) -> tuple[Drive, ...]:
    """The drives of all cylinders, in joint order."""
    return tuple(drive(cylinder, machine.valve, machine.pump) for cylinder in machine.cylinders)
