r"""Breakdown of a pump's energy: into work of the cylinders, valves, the load-sensing margin, and the pump itself.

Pump power is P = p Q / eta + losses with supply p and flow Q = sum Q_i. The hydraulic power p Q_i of a cylinder whose
pressure p_i counts is its work F v, what the rest of p_i Q_i pays for (the oil pushed out of its other chamber, and the
drop of its own valve), the margin dp Q_i, and (p - dp - p_i) Q_i, which is throttled because another cylinder, or a
constant pressure, sets the supply. A cylinder that its load moves, or that is no faster than the threshold of eq. (41),
needs no pressure: all of (p - dp) Q_i is throttled. dp is 0 with constant pressure. The parts sum to P at every sample.

What loads give back while they move a cylinder is throttled as well. It never came from the pump along this path, so it
is no part of the sum.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from leanboom.components.costs import of_pump
from leanboom.evaluation.evaluate import Evaluation


@dataclass(frozen=True, slots=True)
class Breakdown:
    """The parts of a pump's energy [J]."""

    work: float  # of cylinders moving against their load, friction of cylinders among it
    back_pressure: float  # oil pushed out of their other chambers, and the drop of their own valves
    throttled: float  # in their valves, since the supply is higher than what they need
    lowered: float  # in valves of cylinders that their loads move, or that move too slowly to count
    margin: float  # of the load-sensing pump
    pump: float  # losses of pump and drive

    @property
    def total(self) -> float:
        """The pump's energy [J]."""
        return sum(getattr(self, field.name) for field in fields(self))


def breakdown(evaluation: Evaluation, pump: str) -> Breakdown:
    """The `Breakdown` of a motion's energy.

    Args:
        evaluation: The judged motion.
        pump: "ls" or "cp".
    """
    e, given = evaluation, evaluation.task.machine.pump
    margin = of_pump(pump, given.ls_margin, 0.0)
    supply, power = of_pump(pump, (e.supply_ls, e.power_ls), (e.supply_cp, e.power_cp))
    counted = e.pressure > 0.0
    needed = e.pressure * e.flow
    work = np.clip(e.force * e.velocity, 0.0, needed)
    rest = (supply - margin)[:, None] * e.flow - needed

    def energy(rate: np.ndarray) -> float:
        return float(np.trapezoid(rate if rate.ndim == 1 else rate.sum(axis=1), e.time))

    return Breakdown(
        work=energy(work),
        back_pressure=energy(needed - work),
        throttled=energy(np.where(counted, rest, 0.0)),
        lowered=energy(np.where(counted, 0.0, rest)),
        margin=energy(margin * e.flow),
        pump=energy(power - supply * e.pump_flow),
    )
