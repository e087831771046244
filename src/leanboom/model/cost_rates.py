"""Rates of costs: the terms of `components.costs` with a crane's numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from leanboom.components.costs import COSTS, CostTerms, Supply
from leanboom.components.pump_power import Shaft, shaft_of
from leanboom.components.pumps import Pump
from leanboom.formulas import hydraulics
from leanboom.model.crane import Crane


def terms_of(crane: Crane, cost: str) -> CostTerms:
    """The terms of a cost of `costs.COSTS` for all cylinders of a crane."""
    return COSTS[cost].terms(crane.machine.cylinders, crane.drives)


def supply_of(pump: Pump, supply: Supply) -> tuple[float, Shaft]:
    """The part of the supply pressure that does not change [Pa], and the shaft power's coefficients; zeros for none."""
    if supply is Supply.NONE:
        return 0.0, Shaft(1.0)
    return pump.ls_margin if supply is Supply.LOAD_SENSING else pump.constant_pressure, shaft_of(pump)


def demand_of(crane: Crane, cylinder: int) -> tuple[float, float, float, float, float]:
    """Constants of the pressure that a cylinder, by its number, demands: of `hydraulics.pressure_demand`, in order."""
    d = crane.drives[cylinder]
    return crane.machine.driven_velocity, d.gain_out, d.back_out, d.gain_in, d.back_in


def demanded_pressure(crane: Crane, cylinder: int, velocity: Any, force: Any) -> Any:
    """Pressure that a cylinder, by its number, demands of a load-sensing pump [Pa]. Eq. (41)."""
    return hydraulics.pressure_demand(velocity, force, *demand_of(crane, cylinder))


def rate(
    crane: Crane, cost: str, velocity: Sequence[Any], force: Sequence[Any], others: Sequence[Any] = (0.0, 0.0, 0.0)
) -> Any:
    """Rate of a cost: eqs. (36) and (43), and the other costs of the papers' comparisons.

    Args:
        crane: The crane.
        cost: A name of `costs.COSTS`.
        velocity: Velocity of each cylinder, or of the last ones [m/s], arrays that broadcast.
        force: Force of each of them [N]; only read where loads count.
        others: What cylinders before them add: pump flow [m^3/s], demanded pressure [Pa], rate of the other terms.

    Returns:
        Power [W], or squared velocity [m^2/s^2].
    """
    terms = terms_of(crane, cost)
    constant, shaft = supply_of(crane.machine.pump, terms.supply)
    flow, highest, total = others
    for i, v, f in zip(range(len(crane.drives))[-len(velocity) :], velocity, force, strict=True):
        total = total + terms.square[i] * v * v
        flow = flow + hydraulics.cylinder_flow(v, terms.area_out[i], terms.area_in[i])
        if terms.work:
            total = total + hydraulics.positive_work(v, f)
        if terms.supply is Supply.LOAD_SENSING:  # eq. (40)
            highest = np.maximum(highest, demanded_pressure(crane, i, v, f))
    supply = constant + highest if terms.supply is Supply.LOAD_SENSING else constant
    return total + hydraulics.pump_power(supply, flow, *shaft)
