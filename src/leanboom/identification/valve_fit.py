"""Valves from commands, velocities and chamber pressures: Appendix A, eqs. (23)-(24) and (27).

A cylinder's steady velocity over the command is the opening of the spool beyond its dead zone, times a gain each way;
the spool follows its command after a delay, as a critically damped second-order system. Model and measured velocity
pass the same filter. What compensators hold constant is a constant gain; where a load lowers its cylinder through an
open throttle, velocity also grows with the root of its pressure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from leanboom.components.valves import Connection, MobileValve
from leanboom.formulas import fluid
from leanboom.identification.cylinder_forces import TRAINING, cylinder_motion, measured_force
from leanboom.identification.estimates import (
    Estimate,
    Fitted,
    beginnings,
    blocks_of,
    compare,
    covariance,
    interval_factor,
    kept,
    robust,
)
from leanboom.identification.logs.checks import Finding
from leanboom.identification.logs.conditioning import Data
from leanboom.identification.pump_fit import empties, pressed
from leanboom.model.machine import Machine
from leanboom.simulation.valve_sections import second_order

SHORTEST, LONGEST = 0.0, 1.0  # [s], of a delay
SLOWEST, FASTEST = 0.5, 50.0  # [Hz], of a spool
STEADY_SPEED, STEADY_ACCELERATION = 0.015, 0.1  # [m/s], [m/s^2]
FILLED = 0.5e6  # [Pa] above the return line, of a chamber that drives its cylinder
WORST = 10.0  # [%] of full scale, rms of a fit whose values are told
FEWEST = 5  # blocks of time with steady motion
SPEEDS = 21  # of a feed-forward table, each way
MOST_ROWS = 60_000  # of a cylinder


def fit(data: Data, machine: Machine) -> Fitted | None:
    """Fit the valves; None if no joint has a command and enough motion, or they have two spools each.

    Args:
        data: The conditioned logs.
        machine: The draft.
    """
    if machine.valve.separate:
        return None
    found: list[_Cylinder] = []
    wrong = []
    for i, name in enumerate(machine.names):
        if f"{name}_command" not in data.channels or f"{name}_position" not in data.channels:
            continue
        one = _Cylinder(data, machine, i)
        if one.against:
            text = (
                f"{name}_position falls while {name}_command is above 0: one of the two has the wrong sign; "
                "give it scale: -1 in the column map"
            )
            wrong.append(Finding("sign", f"{name}_position", text, True))
        elif one.enough:
            one.solve()
            found.append(one)
    if wrong:
        return Fitted(machine, (), faults=tuple(wrong))
    if not found:
        return None
    estimates = [e for one in found for e in one.estimates()]
    pressures = back_pressures(data, machine)
    estimates += pressures
    circuit, shared = _circuit(machine, [one for one in found if one.fit.rms_percent < WORST])
    told = {e.name: e.value for e in pressures if e.identifiable}
    valve = machine.valve
    if isinstance(valve, MobileValve):
        names = {name.split(".")[-1]: kept(value) for name, value in told.items()}
        valve = replace(valve, **names)
    return Fitted(
        replace(machine, circuit=circuit, valve=valve), (*shared, *estimates),
        tuple(one.fit for one in found), {one.fit.signal: one.series for one in found},
        tables={one.name: one.table() for one in found},
    )  # fmt: skip


def _delayed(data: Data, command: np.ndarray, delay: float) -> np.ndarray:
    """A command some time later, in each part by itself."""
    times = np.arange(command.size) / data.rate
    pairs = zip(data.split(times), data.split(command), strict=True)
    return np.concatenate([np.interp(time - delay, time, values) for time, values in pairs])


def spool_travel(data: Data, command: np.ndarray, delay: float, bandwidth: float) -> np.ndarray:
    """Travel of a spool after its command, (samples,).

    Args:
        data: The conditioned logs.
        command: The command, (samples,).
        delay: After which the spool begins to follow [s].
        bandwidth: Of the spool [Hz].
    """
    from scipy.signal import lfilter, ss2tf

    advance, drive = second_order(bandwidth, 1.0 / data.rate)
    above, below = ss2tf(advance, drive[:, None], np.array([[1.0, 0.0]]), np.zeros((1, 1)))
    return np.concatenate([lfilter(above[0], below, part) for part in data.split(_delayed(data, command, delay))])


class _Cylinder:
    """One cylinder on its valve."""

    def __init__(self, data: Data, machine: Machine, i: int):
        self.data, self.machine, self.i = data, machine, i
        self.name = machine.names[i]
        self.velocity, _ = cylinder_motion(data, machine, i)
        self.given_up = _given_up(data, machine, i)
        self.command = data.channels[f"{self.name}_command"]
        self.shares = _shares(data, machine, i)
        self.used = data.inner & data.usable[self.name] & ~empties(data, machine, i, self.velocity)
        fast = np.abs(self.velocity) > STEADY_SPEED
        self.way = [
            bool((self.used & (way * self.velocity > STEADY_SPEED)).sum() > 2 * data.rate) for way in (1.0, -1.0)
        ]
        self.enough = any(self.way)
        late = _delayed(data, self.command, max(machine.circuit.delay, 0.05))
        sure = fast & (np.abs(late) > 0.3)
        agree = np.mean(late[sure] * self.velocity[sure] > 0.0) if sure.any() else 1.0
        self.against = bool(sure.sum() > 2 * data.rate and agree < 0.3)
        self.training = beginnings(data.part, TRAINING)

    def model(self, x: np.ndarray) -> np.ndarray:
        """Filtered velocity under delay, bandwidth, and gain and dead zone each way."""
        delay, bandwidth, out, back, zone_out, zone_back = x
        travel = spool_travel(self.data, self.command, delay, bandwidth)
        ahead, behind = self.shares
        speed = out * ahead * fluid.opening(travel, zone_out) - back * behind * fluid.opening(-travel, zone_back)
        return self.data.low_pass(speed) - np.where(travel > 0.0, *self.given_up)

    def solve(self) -> None:
        """Bounded robust least squares."""
        from scipy.optimize import least_squares

        circuit = self.machine.circuit
        moving = np.abs(self.velocity) > STEADY_SPEED
        late = _delayed(self.data, self.command, circuit.delay)
        zones = []
        for way in (1.0, -1.0):
            sure = moving & (way * self.velocity > 0.0) & (way * late > 0.02)
            zones.append(
                float(np.clip(np.quantile(way * late[sure], 0.02), 0.02, 0.85))
                if sure.sum() > 20
                else circuit.dead_zone
            )
        top = float(np.abs(self.velocity).max())
        start = np.array(
            [max(circuit.delay, 0.02), min(max(circuit.spool_bandwidth, 1.0), 40.0), 4 * top, 4 * top, *zones]
        )
        low = np.array([SHORTEST, SLOWEST, 0.0, 0.0, 0.0, 0.0])
        high = np.array([LONGEST, FASTEST, 100.0, 100.0, 0.9, 0.9])
        rows = np.flatnonzero(self.used & self.training)
        rows = rows[:: max(1, rows.size // MOST_ROWS + 1)] if rows.size > MOST_ROWS else rows
        scale = np.array([0.1, 5.0, top, top, 0.2, 0.2])

        def residual(x: np.ndarray) -> np.ndarray:
            return (self.model(x) - self.velocity)[rows] / (0.01 * top)

        free = np.array([True, True, self.way[0], self.way[1], self.way[0], self.way[1]])
        best = start.copy()

        def reduced(y: np.ndarray) -> np.ndarray:
            best[free] = y
            return residual(best)

        found = least_squares(
            reduced,
            np.clip(start, low, high)[free],
            bounds=(low[free], high[free]),
            x_scale=scale[free],
            loss="soft_l1",
            diff_step=1e-4,
            max_nfev=40,
        )
        self.x = start.copy()
        self.x[free] = found.x
        self.free = free
        block = blocks_of(self.data.time, self.data.part)[rows]
        jacobian = np.zeros((rows.size, 6))
        jacobian[:, free] = found.jac
        variance, _, factor = covariance([jacobian], [-robust(residual(self.x))], [block], np.where(free, 0.0, 1.0))
        self.half = factor * np.sqrt(np.diag(variance))
        model = self.model(self.x)
        keep = self.used
        self.fit = compare(f"{self.name}_velocity", self.velocity[keep], model[keep], self.training[keep])
        self.series = (self.data.time[keep], self.velocity[keep], model[keep], self.training[keep])

    def estimates(self) -> list[Estimate]:
        """Of this cylinder alone."""
        names = ("delay", "spool_bandwidth", "gain_out", "gain_in", "dead_zone_out", "dead_zone_in")
        found = []
        for name, value, half, free in zip(names, self.x, self.half, self.free, strict=True):
            sure = bool(
                self.fit.rms_percent < WORST and free and np.isfinite(half) and half < 0.5 * max(abs(value), 0.05)
            )
            note = "" if sure else "to tell it, drive this cylinder both ways from rest in steps of the command"
            found.append(Estimate.within(f"valve.{self.name}.{name}", value, half, sure, note))
        return found

    def table(self) -> np.ndarray:
        """The inverse feed-forward function of Figure A1: velocity and command, (points, 2), both rising."""
        out, back, zone_out, zone_back = self.x[2:]
        share = np.linspace(0.0, 1.0, SPEEDS)
        up, down = zone_out + (1.0 - zone_out) * share, zone_back + (1.0 - zone_back) * share
        rising = np.stack([out * fluid.opening(up, zone_out), up], axis=1)
        falling = np.stack([-back * fluid.opening(down, zone_back), -down], axis=1)
        return np.concatenate([falling[::-1], rising])


def _shares(data: Data, machine: Machine, i: int) -> tuple[np.ndarray, np.ndarray]:
    """What pressures leave of the flow of an open edge, out and in, (samples,) each.

    A compensator without its drop lets less through; a load lowers its cylinder through a throttle.
    """
    name, cylinder = machine.names[i], machine.cylinders[i]
    found = [np.ones(data.time.size), np.ones(data.time.size)]
    supply = data.raw.get("supply")
    single = cylinder.connection is Connection.SINGLE_ACTING
    if supply is not None and isinstance(machine.valve, MobileValve) and machine.valve.compensator_drop > 0.0:
        for way, side in enumerate("a" if single else "ab"):
            pressure = data.raw.get(f"{name}_pressure_{side}")
            if pressure is not None:
                found[way] = np.sqrt(np.clip((supply - pressure) / machine.valve.compensator_drop, 0.0, 1.0))
    pressure = data.raw.get(f"{name}_pressure_a")
    if single and pressure is not None:
        root = np.sqrt(np.maximum(pressure - machine.pump.tank_pressure - machine.circuit.counter_pressure, 0.0))
        found[1] = root / (float(np.mean(root)) or 1.0)
    return found[0], found[1]


def _given_up(data: Data, machine: Machine, i: int) -> tuple[np.ndarray, np.ndarray]:
    """Velocity that the compression of oil takes away from the flow of an open edge, out and in [m/s], (samples,)."""
    cylinder, drive = machine.cylinders[i], machine.drives[i]
    found = [np.zeros(data.time.size), np.zeros(data.time.size)]
    a, b = (pressed(data, machine, i, side) for side in "ab")
    bulk = machine.circuit.bulk_modulus
    single = cylinder.connection is Connection.SINGLE_ACTING
    if a is not None:
        found[0] += a / (drive.area_out * bulk)
    if a is not None and single:
        found[1] += a / (cylinder.areas[0] * bulk)
    if b is not None and not single:
        found[1] -= b / (cylinder.areas[1] * bulk)
        if cylinder.connection is Connection.DIFFERENTIAL:
            found[0] += b / (drive.area_out * bulk)
    return found[0], found[1]


def _circuit(machine: Machine, found: Sequence[_Cylinder]):
    """The circuit with what all cylinders share, and its estimates: means weighted by their intervals."""
    circuit = machine.circuit
    estimates = []
    places = {"delay": [0], "spool_bandwidth": [1], "dead_zone": [4, 5]}
    for name, columns in places.items():
        pairs = [
            (c.x[j], c.half[j])
            for c in found
            for j in columns
            if c.free[j] and 0.0 < c.half[j] < 0.5 * max(c.x[j], 0.05)
        ]
        if pairs:
            value, half = _pooled(np.array(pairs))
            estimates.append(Estimate.within(f"simulation.{name}", value, half))
            circuit = replace(circuit, **{name: kept(value)})
        else:
            note = "to tell it, drive cylinders from rest in steps of the command"
            estimates.append(Estimate(f"simulation.{name}", getattr(circuit, name), None, None, False, note))
    pairs = []
    for c in found:
        drive = machine.drives[c.i]
        for j, area in ((2, drive.area_out), (3, drive.area_in)):
            if area > 0.0 and c.free[j] and 0.0 < c.half[j] < 0.2 * c.x[j]:
                pairs.append((c.x[j] * area, c.half[j] * area))
    if pairs:
        value, half = _pooled(np.array(pairs))
        estimates.append(Estimate.within("simulation.edge_flow", value, half))
        circuit = replace(circuit, edge_flow=kept(value))
    return circuit, estimates


def _pooled(pairs: np.ndarray) -> tuple[float, float]:
    """Weighted mean of values and half widths, (n, 2); its half width grows with what they differ by."""
    weight = 1.0 / pairs[:, 1] ** 2
    mean = float(np.sum(weight * pairs[:, 0]) / np.sum(weight))
    spread = float(np.sum(weight * (pairs[:, 0] - mean) ** 2) / max(len(pairs) - 1, 1)) / 3.8  # 1.96 squared
    return mean, float(np.sqrt(1.0 / np.sum(weight)) * max(1.0, np.sqrt(spread)))


def back_pressures(data: Data, machine: Machine) -> list[Estimate]:
    """Coefficients of eqs. (23)-(24) and (27), from chambers that empty while their cylinders move steadily.

    Args:
        data: The conditioned logs.
        machine: The draft; its drop of the compensator and counter-pressure count, which pressures do not tell.
    """
    valve = machine.valve
    if not isinstance(valve, MobileValve) or valve.compensator_drop <= 0.0:
        return []
    drop = valve.compensator_drop
    back = machine.pump.tank_pressure + machine.circuit.counter_pressure
    tank = data.channels.get("tank")
    block = blocks_of(data.time, data.part)
    found: dict[str, list[np.ndarray]] = {"extend_coefficient": [], "retract_coefficient": [], "regenerative_ratio": []}
    for i, cylinder in enumerate(machine.cylinders):
        name = machine.names[i]
        a, b = (data.channels.get(f"{name}_pressure_{side}") for side in "ab")
        force = measured_force(data, machine, i)
        if force is None or a is None or b is None or f"{name}_position" not in data.channels:
            continue
        v, acceleration = cylinder_motion(data, machine, i)
        steady = data.inner & data.usable[name] & (np.abs(acceleration) < STEADY_ACCELERATION)
        floor = back if tank is None else tank
        area_a, area_b = cylinder.areas
        for sign, values, key in (
            (1.0, (b - floor) / drop, "extend_coefficient"),
            (-1.0, (a - floor) / drop, "retract_coefficient"),
        ):
            if cylinder.connection is Connection.SINGLE_ACTING:
                continue
            kind = key
            if sign > 0.0 and cylinder.connection is Connection.DIFFERENTIAL:
                rod = area_a - area_b
                values = ((b - force / rod) / drop - area_a / rod) * rod**3 / (area_b**2 * area_a)  # noqa: PLW2901
                kind = "regenerative_ratio"
            # Where the load drives, the chamber that fills is empty and the flow is not the compensator's.
            filled = (a if sign > 0.0 else b) > floor + FILLED
            moving = steady & filled & (sign * v > STEADY_SPEED)
            for each in np.unique(block[moving]):
                inside = moving & (block == each)
                if inside.sum() > 0.25 * data.rate:
                    found[kind].append(np.array([np.median(values[inside]), inside.sum()]))
    estimates = []
    for kind, rows in found.items():
        if len(rows) < FEWEST:
            note = "to tell it, drive cylinders steadily that way for some seconds each"
            estimates.append(Estimate(f"valve.{kind}", getattr(valve, kind), None, None, False, note))
            continue
        table = np.array(rows)
        middle = float(np.median(table[:, 0]))
        spread = 1.4826 * float(np.median(np.abs(table[:, 0] - middle)))
        half = interval_factor(len(rows) - 1) * 1.2533 * max(spread, 1e-6) / np.sqrt(len(rows))
        ends = np.maximum([middle, middle - half, middle + half], 0.0)
        if kind == "regenerative_ratio":
            ends = np.sqrt(ends)
        value, low, high = (float(end) for end in ends)
        estimates.append(Estimate(f"valve.{kind}", value, low, high, True))
    return estimates
