"""Supply pressure: Appendix C.

The supply pressure stands the load-sensing margin above the highest pressure of the driven chambers, eqs. (40)-(41),
which it follows with a time constant. A chamber is driven while its cylinder is faster than a velocity, as in the
paper; where commands tell when its spool is open, that is taken if it repeats the measured pressure better. Pressures
pass the filter after the switching, as the measured supply pressure does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from leanboom.components.cylinders import Connection
from leanboom.formulas import fluid
from leanboom.identification.estimates import Estimate, Fitted, compare, covariance, kept, robust
from leanboom.identification.logs.conditioning import Data
from leanboom.identification.pump_fit import Rows, rows_of
from leanboom.identification.valve_fit import spool_travel
from leanboom.model.machine import Machine

EPSILONS = 0.0005, 0.05  # [m/s], of the driven velocity
TRIED = 9  # of them, before the best is sought between its neighbours
CLOSE = 1.02  # times the least cost: a driven velocity that is not told from the best
SCALE = 0.3  # [MPa], errors beyond count less
LEAST, MOST = (0.0, 0.01), (10e6, 5.0)  # margin [Pa], time constant [s]
WITHIN = (1e3, 0.011), (9.9e6, 4.9)  # to begin at
LEAST_CHANGE = 0.5e6  # [Pa], a supply pressure that changes less tells nothing


def fit(data: Data, machine: Machine) -> Fitted | None:
    """Fit the supply pressure; None without its channel, or where it hardly changes.

    Args:
        data: The conditioned logs.
        machine: The draft, with what was found of its valves.
    """
    chambers = _chambers(data, machine)
    if "supply" not in data.channels or not chambers or np.ptp(data.channels["supply"]) < LEAST_CHANGE:
        return None
    problem = _Problem(data, machine, chambers)
    epsilon, ends, found, highest = problem.driven_velocity()
    estimate = Estimate("verification.driven_velocity", epsilon, *(ends or (None, None)), ends is not None)
    note = "to tell it, start and stop single cylinders slowly"
    if ends is not None:
        note = "repeats the measured supply pressure; not the threshold of planning, for which the draft's is kept"
    by_spools = problem.opened()
    how = f"cylinders count as driven from {epsilon:.3g} m/s on"
    if by_spools is not None:
        other = problem.solved(by_spools)
        if other.cost < found.cost:
            found, highest, how = other, by_spools, "cylinders count as driven while their spools are open"
    return problem.result(found, highest, replace(estimate, note=note), f"supply pressure: {how}")


def _chambers(data: Data, machine: Machine) -> list[tuple[int, float, np.ndarray]]:
    """Cylinder, way of motion, and pressure as measured, of every chamber that a pump can drive."""
    found = []
    for i, (name, cylinder) in enumerate(zip(machine.names, machine.cylinders, strict=True)):
        for side, way in (("a", 1.0), ("b", -1.0)):
            pressure = data.raw.get(f"{name}_pressure_{side}")
            if pressure is not None and (side == "a" or cylinder.connection is not Connection.SINGLE_ACTING):
                found.append((i, way, pressure))
    return found


class _Problem:
    """Margin and time constant, for one highest pressure of driven chambers or another."""

    def __init__(self, data: Data, machine: Machine, chambers: list[tuple[int, float, np.ndarray]]):
        self.data, self.machine, self.chambers = data, machine, chambers
        self.rows: Rows = rows_of(data, machine)
        self.used = self.rows.keep & self.rows.training
        self.supply = data.channels["supply"][:: self.rows.every]
        self.last = np.array([machine.pump.ls_margin, machine.circuit.pump_time_constant])  # found last
        velocities = {}
        for i, name in enumerate(machine.names):
            rate = data.rates.get(f"{name}_position")
            if rate is not None:
                arm = machine.cylinders[i].linkage.length_arm_slope(data.channels[f"{name}_position"])[1]
                velocities[i] = arm * rate
        self.velocities = velocities

    def highest(self, share: Callable[[int, float], np.ndarray]) -> np.ndarray:
        """The highest pressure of all chambers, each times the share to which it is driven, (samples,)."""
        return np.max([share(i, way) * pressure for i, way, pressure in self.chambers], axis=0)

    def moving(self, epsilon: float) -> np.ndarray:
        """The highest pressure of chambers whose cylinders are faster than a velocity [m/s], (samples,)."""
        return self.highest(lambda i, way: (way * self.velocities.get(i, 0.0) > epsilon).astype(np.float64))

    def opened(self) -> np.ndarray | None:
        """The highest pressure of chambers whose spools are open, (samples,); None without all commands."""
        circuit, names = self.machine.circuit, self.machine.names
        commands = {i: self.data.channels.get(f"{names[i]}_command") for i, _, _ in self.chambers}
        if self.machine.valve.separate or any(each is None for each in commands.values()):
            return None
        travel = {
            i: spool_travel(self.data, each, circuit.delay, circuit.spool_bandwidth)
            for i, each in commands.items() if each is not None
        }  # fmt: skip
        return self.highest(lambda i, way: fluid.gate(fluid.opening(way * travel[i], circuit.dead_zone)))

    def model(self, x: np.ndarray, highest: np.ndarray) -> np.ndarray:
        """The supply pressure at the rows, as the filter shows it."""
        from scipy.signal import lfilter

        share = float(np.exp(-1.0 / self.data.rate / x[1]))
        wanted = np.minimum(highest + x[0], self.machine.pump.max_pressure)
        pairs = zip(self.data.split(wanted), self.data.split(self.data.raw["supply"]), strict=True)
        parts = [lfilter([1.0 - share], [1.0, -share], each, zi=[share * first[0]])[0] for each, first in pairs]
        return self.data.low_pass(np.concatenate(parts))[:: self.rows.every]

    def residual(self, x: np.ndarray, highest: np.ndarray) -> np.ndarray:
        """Of the rows used, in MPa."""
        return 1e-6 * (self.model(x, highest) - self.supply)[self.used]

    def solved(self, highest: np.ndarray):
        """Margin [Pa] and time constant [s] by robust least squares, from those found last."""
        from scipy.optimize import least_squares

        found = least_squares(
            lambda x: self.residual(x, highest), np.clip(self.last, *WITHIN), bounds=(LEAST, MOST), x_scale=[1e6, 0.1],
            loss="soft_l1", f_scale=SCALE, diff_step=1e-4, ftol=1e-6, xtol=1e-6, max_nfev=30,
        )  # fmt: skip
        self.last = found.x
        return found

    def driven_velocity(self):
        """The driven velocity, its interval where it is told, the fit with it, and its highest pressure."""
        from scipy.optimize import minimize_scalar

        def cost(y: float) -> float:
            return float(self.solved(self.moving(float(np.exp(y)))).cost)

        low, high = np.log(EPSILONS)
        grid = np.linspace(low, high, TRIED)
        costs = [cost(float(each)) for each in grid]
        best = int(np.argmin(costs))
        around = float(grid[max(best - 1, 0)]), float(grid[min(best + 1, TRIED - 1)])
        chosen = minimize_scalar(cost, bounds=around, method="bounded", options={"maxiter": 10})
        epsilon = float(np.exp(chosen.x))
        highest = self.moving(epsilon)
        found = self.solved(highest)
        # It is told if both a smaller and a larger one are clearly worse.
        close = [float(each) for each, cost in zip(grid, costs, strict=True) if cost < CLOSE * found.cost]
        apart = float(grid[1] - grid[0])
        ends = min([*close, chosen.x]) - apart, max([*close, chosen.x]) + apart
        told = (float(np.exp(ends[0])), float(np.exp(ends[1]))) if ends[0] > low and ends[1] < high else None
        return epsilon, told, found, highest

    def result(self, found, highest: np.ndarray, epsilon: Estimate, remark: str) -> Fitted:
        """Values, intervals and the fit."""
        block = self.rows.block[self.used]
        error = SCALE * robust(self.residual(found.x, highest) / SCALE)
        variance, _, factor = covariance([found.jac], [-error], [block], np.zeros(2))
        half = factor * np.sqrt(np.diag(variance))
        estimates = (
            Estimate.within("pump.ls_margin", found.x[0], half[0]),
            Estimate.within("simulation.pump_time_constant", found.x[1], half[1]),
            epsilon,
        )
        keep, line = self.rows.keep, self.model(found.x, highest)
        time, training = self.rows.time[keep], self.rows.training[keep]
        pump = replace(self.machine.pump, ls_margin=kept(found.x[0]))
        circuit = replace(self.machine.circuit, pump_time_constant=kept(found.x[1]))
        return Fitted(
            replace(self.machine, pump=pump, circuit=circuit), estimates,
            (compare("supply", self.supply[keep], line[keep], training),),
            {"supply": (time, self.supply[keep], line[keep], training)}, (remark,),
        )  # fmt: skip
