"""Steady-state hydraulics of one cylinder and of the pump: eqs. (23)-(28), (36)-(43), 4-DOF; (27)-(35), 3-DOF.

| symbol | name | unit |
| --- | --- | --- |
| v, F | cylinder velocity, cylinder force | m/s, N |
| A, B | piston-side and rod-side area | m^2 |
| p | pressure of the working chamber | Pa |
| Q | pump flow of a cylinder | m^3/s |

For every valve type the working chamber's pressure is affine in the force: extending p_A = gain_out F + back_out,
retracting p_B = -gain_in F + back_in.
"""

from __future__ import annotations

import numpy as np

from leanboom.formulas.dynamics import heaviside
from leanboom.formulas.formula import formula


@formula
def cylinder_flow(v, area_out, area_in):
    """Pump flow of a cylinder [m^3/s]: out area extending, in area retracting. Eq. (37); eq. (27), 3-DOF."""
    return np.maximum(area_out * v, -area_in * v)


@formula
def pressure_demand(v, F, epsilon, gain_out, back_out, gain_in, back_in):
    """Demanded pressure [Pa]: zero unless a cylinder moves against its load above epsilon. Eq. (41)."""
    out = (gain_out * F + back_out) * heaviside(v - epsilon)
    back = (back_in - gain_in * F) * heaviside(-v - epsilon)
    return (out + back) * heaviside(F * v)


@formula
def positive_work(v, F):
    """Positive mechanical power of a cylinder [W], the actuator-energy cost of both papers."""
    return np.maximum(F * v, 0.0)


@formula
def pump_losses(supply, flow, idle, leak, drag):
    """Losses of the pump besides the share that is in proportion to p Q [W]; see `pump_power.Shaft`."""
    return idle + leak * supply + drag * flow * flow


@formula
def pump_power(supply, flow, efficiency, idle, leak, drag):
    """Power the pump takes [W]. Eqs. (36) and (43); (31)-(32), 3-DOF; the losses of an efficiency map added."""
    return supply * flow / efficiency + pump_losses(supply, flow, idle, leak, drag)
