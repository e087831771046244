r"""The pump and its shaft power: a constant efficiency, or an efficiency map at the drive's speed made a formula.

A table of efficiencies has no derivatives at its nodes and is slow to look up, so planner, judge and the methods
compared with use one smooth power instead,

    P(p, Q) = p Q / eta + idle + leak p + drag Q^2.

With a constant efficiency the last three are zero. With a map, the table is taken at the drive's speed n (linear
between the speeds), its points become powers P_ij = p_j Q_i / eta_ij with Q_i = n D_i, and 1/eta - 1, idle, leak and
drag are the non-negative least squares of the relative errors P(p_j, Q_i) / P_ij - 1. The terms are those of
displacement machines (Wilson 1950, Schlosser 1961) at one speed: viscous drag and feed pump, friction and leakage under
pressure, flow resistance. Non-negative coefficients keep every efficiency below 1 and the power rising in p and Q,
beyond the table as well.

| symbol | name | unit |
| --- | --- | --- |
| p, Q | supply pressure, pump flow | Pa, m^3/s |
| n, D | drive speed, displacement | rev/s, m^3/rev |
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from leanboom.components.pumps import EfficiencyMap, Pump
from leanboom.formulas.hydraulics import pump_power

ALLOWED = 0.03  # typical error of the power from which a map is refused


class Shaft(NamedTuple):
    """Coefficients of `hydraulics.pump_power`, in the order of its arguments."""

    efficiency: float  # eta: what remains at large powers
    idle: float = 0.0  # [W]
    leak: float = 0.0  # loss per supply pressure [W/Pa]
    drag: float = 0.0  # loss per squared flow [W s^2/m^6]

    def in_kilowatts(self) -> Shaft:
        """The same for power in kW, pressure in MPa and flow in l/s."""
        return Shaft(self.efficiency, 1e-3 * self.idle, 1e3 * self.leak, 1e-9 * self.drag)


@dataclass(frozen=True, slots=True)
class Fit:
    """The shaft power that meets a map, and how well."""

    shaft: Shaft
    typical: float  # root mean square of the relative errors of power at the map's points
    largest: float  # largest of them
    worst: tuple[int, int]  # where that is: index of displacement and pressure


def at_speed(efficiency: EfficiencyMap) -> np.ndarray:
    """The map at the drive's speed, linear between its speeds, (displacements, pressures)."""
    total, speeds = np.array(efficiency.total), np.array(efficiency.speeds)
    if speeds.size == 1:
        return total[0]
    i = int(np.clip(np.searchsorted(speeds, efficiency.speed) - 1, 0, speeds.size - 2))
    x = (efficiency.speed - speeds[i]) / (speeds[i + 1] - speeds[i])
    return (1.0 - x) * total[i] + x * total[i + 1]


@lru_cache(maxsize=64)
def fit(efficiency: EfficiencyMap) -> Fit:
    """Fit the shaft power to an efficiency map.

    Args:
        efficiency: The map, of consistent shape, with at least two displacements and two pressures.

    Returns:
        The fit, whatever its error; files are held to `ALLOWED`.
    """
    from scipy.optimize import nnls

    pressure = np.array(efficiency.pressures)[None, :]
    flow = efficiency.speed * np.array(efficiency.displacements)[:, None]
    useful = pressure * flow
    power = useful / at_speed(efficiency)
    terms = np.stack([useful, np.ones_like(useful), pressure + 0.0 * flow, flow**2 + 0.0 * pressure], axis=-1)
    relative = (terms / power[..., None]).reshape(-1, 4)
    scale = relative.max(axis=0)
    answer, _ = nnls(relative / scale, (1.0 - useful / power).ravel())
    share, idle, leak, drag = (float(value) for value in answer / scale)
    shaft = Shaft(1.0 / (1.0 + share), idle, leak, drag)
    error = np.abs(pump_power(pressure, flow, *shaft) / power - 1.0)
    i, j = np.unravel_index(int(error.argmax()), error.shape)
    return Fit(shaft, float(np.sqrt(np.mean(error**2))), float(error.max()), (int(i), int(j)))


def shaft_of(pump: Pump) -> Shaft:
    """The coefficients of a pump's shaft power."""
    if isinstance(pump.efficiency, EfficiencyMap):
        return fit(pump.efficiency).shaft
    return Shaft(pump.efficiency)
