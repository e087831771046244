"""Pump flow and supply pressure: Appendix C.

The flow is a sum of effective areas times velocities, eq. (37), with none below zero, and of what compresses the oil in
driven chambers and in the supply line, eqs. (18)-(19); the supply pressure stands the
load-sensing margin above the highest pressure of the driven chambers, eqs. (40)-(41), which it follows with a
time constant.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from leanboom.components.cylinders import Connection
from leanboom.formulas import fluid
from leanboom.identification.cylinder_forces import TRAINING, cylinder_motion, measured_force
from leanboom.identification.estimates import (
    Estimate,
    Fit,
    Series,
    beginnings,
    blocks_of,
    compare,
    covariance,
    kept,
    linear_fit,
)
from leanboom.identification.logs.conditioning import Data
from leanboom.model.machine import Machine
from leanboom.simulation.plant import retracted

BULK = "simulation.bulk_modulus"
RATE = 50.0  # [Hz], of the rows
EPSILONS = 0.0005, 0.05  # [m/s], of the driven velocity
LEAST_TRAVEL = 0.3  # [m] each way, for an area
OVER_RUNNING_POWERS = 2  # of the polynomial in velocity that takes away area under over-running load
DIFFERS = 0.05  # share by which an effective area may differ from the drawing without a remark


@dataclass(frozen=True, slots=True, eq=False)
class PumpFit:
    """What was found of the pump."""

    machine: Machine
    estimates: tuple[Estimate, ...]
    fits: tuple[Fit, ...]
    series: dict[str, Series]
    remarks: tuple[str, ...]


def fit(data: Data, machine: Machine) -> PumpFit | None:
    """Fit pump flow and supply pressure; None without both.

    Args:
        data: The conditioned logs.
        machine: The draft.
    """
    every = max(1, round(data.rate / RATE))
    keep = data.inner[::every].copy()
    velocities, forces = [], []
    for i, name in enumerate(machine.names):
        if f"{name}_position" not in data.channels:
            velocities.append(np.zeros(keep.size))
        else:
            velocities.append(cylinder_motion(data, machine, i)[0][::every])
            keep &= data.usable[name][::every]
        force = measured_force(data, machine, i)
        forces.append(None if force is None else force[::every])
    part = data.part[::every]
    training = beginnings(part, TRAINING)
    block = blocks_of(data.time[::every], part)
    rows = _Rows(data.time[::every], part, keep, training, block, velocities, forces)
    found = [part for part in (_flow(data, machine, every, rows), _supply(data, machine, every, rows)) if part]
    if not found:
        return None
    result = found[0]
    for other in found[1:]:
        circuit = replace(other.machine.circuit, bulk_modulus=result.machine.circuit.bulk_modulus)
        result = PumpFit(
            replace(result.machine, pump=other.machine.pump, circuit=circuit,
                    driven_velocity=other.machine.driven_velocity),
            result.estimates + other.estimates, result.fits + other.fits, result.series | other.series,
            result.remarks + other.remarks,
        )  # fmt: skip
    return result


def pressed(data: Data, machine: Machine, i: int, side: str) -> np.ndarray | None:
    """What a chamber takes up by compression, times the bulk modulus: V dp/dt [m^3 Pa/s], (samples,).

    Args:
        data: The conditioned logs.
        machine: The machine, for its volumes.
        i: Number of the cylinder.
        side: "a" or "b".
    """
    name, cylinder, joint = machine.names[i], machine.cylinders[i], machine.joints[i]
    pressure, position = data.channels.get(f"{name}_pressure_{side}"), data.channels.get(f"{name}_position")
    if pressure is None or position is None:
        return None
    shortest, travel = retracted(cylinder, joint.lower, joint.upper)
    x = cylinder.linkage.length_arm_slope(position)[0] - shortest
    area = cylinder.areas[side == "b"]
    volume = fluid.chamber_volume(machine.circuit.dead_volume, area, x if side == "a" else travel - x)
    return volume * data.slope(pressure)


def _compressed(data: Data, machine: Machine, rows: _Rows, every: int) -> np.ndarray:
    """What driven chambers and the supply line take up, times the bulk modulus, (rows,)."""
    total = np.zeros(rows.time.size)
    for i, cylinder in enumerate(machine.cylinders):
        a, b = pressed(data, machine, i, "a"), pressed(data, machine, i, "b")
        out, back = rows.velocities[i] > 0.0, rows.velocities[i] < 0.0
        if a is not None:
            total += a[::every] * out
        if b is not None and cylinder.connection is not Connection.SINGLE_ACTING:
            total += b[::every] * (back | (out & (cylinder.connection is Connection.DIFFERENTIAL)))
    if "supply" in data.channels:
        total += machine.circuit.line_volume * data.slope(data.channels["supply"])[::every]
    return total


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    time: np.ndarray
    part: np.ndarray
    keep: np.ndarray
    training: np.ndarray
    block: np.ndarray
    velocities: list[np.ndarray]
    forces: list[np.ndarray | None]


def _flow(data: Data, machine: Machine, every: int, rows: _Rows) -> PumpFit | None:
    if "pump_flow" in data.channels:
        flow = data.channels["pump_flow"][::every]
    elif "pump_volume" in data.channels:
        flow = data.rates["pump_volume"][::every]
    else:
        return None
    columns, names, drawn = [], [], []
    untold = []
    for i, (name, drive) in enumerate(zip(machine.names, machine.drives, strict=True)):
        v = rows.velocities[i]
        for way, speed, area in (
            ("out", np.maximum(v, 0.0), drive.area_out),
            ("in", np.maximum(-v, 0.0), drive.area_in),
        ):
            key = f"cylinders.{name}.area_{way}"
            travel = float(speed[rows.keep & rows.training].sum()) * every / data.rate
            if travel < LEAST_TRAVEL:
                note = f"to tell it, drive the {name} {'out' if way == 'out' else 'in'} for {LEAST_TRAVEL:g} m or more"
                untold.append(Estimate(key, area, None, None, False, note))
                columns.append(speed * area)
                names.append("")
            else:
                columns.append(speed)
                names.append(key)
            drawn.append(area)
            force = rows.forces[i]
            if name == "tilt" and force is not None and travel >= LEAST_TRAVEL:
                over = speed * (force * v < 0.0)
                if float(over[rows.keep & rows.training].sum()) * every / data.rate >= LEAST_TRAVEL:
                    for power in range(1, OVER_RUNNING_POWERS + 1):
                        columns.append(-over * (np.abs(v) / 0.1) ** (power - 1))
                        names.append(f"anti_cavitation.tilt.{way}[{power - 1}]")
                        drawn.append(0.0)
    columns.append(_compressed(data, machine, rows, every))
    names.append(BULK)
    drawn.append(0.0)
    table = np.stack(columns, axis=1)
    used = rows.keep & rows.training
    fixed = [j for j, name in enumerate(names) if not name]
    rest = flow - table[:, fixed].sum(axis=1)
    free = [j for j, name in enumerate(names) if name]
    if not free:
        return None
    values, half, _ = linear_fit(table[used][:, free], rest[used], rows.block[used])
    model = table[:, free] @ values + table[:, fixed].sum(axis=1)
    estimates, remarks = [], []
    for j, value, width in zip(free, values, half, strict=True):
        name = names[j]
        if name == BULK:
            machine = _bulk(machine, float(value), float(width), estimates)
            continue
        estimates.append(Estimate.within(name, value, width))
        if name.startswith("cylinders"):
            area = drawn[j]
            if abs(value - area) > width + DIFFERS * max(area, float(values.max()) * 0.2):
                remarks.append(
                    f"{name}: the flow says {1e4 * value:.1f} cm^2, the draft {1e4 * area:.1f} cm^2; "
                    "check bore, rod and "
                    "connection (single_acting takes no flow in, differential A - B out)"
                )
    fits = (compare("pump_flow", flow[rows.keep], model[rows.keep], rows.training[rows.keep]),)
    series = {"pump_flow": (rows.time[rows.keep], flow[rows.keep], model[rows.keep], rows.training[rows.keep])}
    return PumpFit(machine, (*estimates, *untold), fits, series, tuple(remarks))


def _bulk(machine: Machine, softness: float, width: float, estimates: list[Estimate]) -> Machine:
    """The machine with the bulk modulus that a softness [1/Pa] means, if the logs tell it; its estimate is added."""
    if softness <= 2.0 * width:
        note = "to tell it, start and stop cylinders under load"
        estimates.append(Estimate(BULK, machine.circuit.bulk_modulus, None, None, False, note))
        return machine
    bulk = 1.0 / softness
    estimates.append(Estimate(BULK, bulk, 1.0 / (softness + width), 1.0 / (softness - width), True))
    return replace(machine, circuit=replace(machine.circuit, bulk_modulus=kept(bulk)))


def _supply(data: Data, machine: Machine, every: int, rows: _Rows) -> PumpFit | None:
    from scipy.optimize import least_squares, minimize_scalar
    from scipy.signal import lfilter

    if "supply" not in data.channels:
        return None
    supply = data.channels["supply"][::every]
    pressures = []
    for i, name in enumerate(machine.names):
        sides = [data.channels.get(f"{name}_pressure_{side}") for side in "ab"]
        drive = machine.drives[i]
        if sides[0] is not None:
            pressures.append(
                (i, sides[0][::every], None if sides[1] is None or drive.area_in == 0.0 else sides[1][::every])
            )
    if not pressures or np.ptp(supply) < 0.5e6:
        return None
    step = every / data.rate
    used = rows.keep & rows.training
    bounds = np.flatnonzero(np.diff(rows.part)) + 1
    top = machine.pump.max_pressure

    def demanded(epsilon: float) -> np.ndarray:
        highest = np.zeros(supply.size)
        for i, a, b in pressures:
            v = rows.velocities[i]
            highest = np.maximum(highest, a * (v > epsilon))
            if b is not None:
                highest = np.maximum(highest, b * (v < -epsilon))
        return highest

    def model(x: np.ndarray, highest: np.ndarray) -> np.ndarray:
        share = float(np.exp(-step / x[1]))
        wanted = np.minimum(highest + x[0], top)
        parts = []
        for values, measured in zip(np.split(wanted, bounds), np.split(supply, bounds), strict=True):
            parts.append(lfilter([1.0 - share], [1.0, -share], values, zi=[share * measured[0]])[0])
        return np.concatenate(parts)

    start = np.array([machine.pump.ls_margin, machine.circuit.pump_time_constant])

    def solved(epsilon: float):
        highest = demanded(epsilon)
        return least_squares(
            lambda x: 1e-6 * (model(x, highest) - supply)[used], start, bounds=([0.0, 0.01], [10e6, 5.0]),
            x_scale=[1e6, 0.1], loss="soft_l1", f_scale=0.3, diff_step=1e-4, max_nfev=30,
        )  # fmt: skip

    low, high = np.log(EPSILONS)
    grid = np.linspace(low, high, 9)
    costs = [solved(float(np.exp(each))).cost for each in grid]
    best = int(np.argmin(costs))
    around = float(grid[max(best - 1, 0)]), float(grid[min(best + 1, 8)])
    chosen = minimize_scalar(
        lambda y: solved(float(np.exp(y))).cost, bounds=around, method="bounded", options={"maxiter": 10}
    )
    epsilon = float(np.exp(chosen.x))
    found = solved(epsilon)
    residual = 1e-6 * (model(found.x, demanded(epsilon)) - supply)[used]
    variance, _, factor = covariance([found.jac], [-residual], [rows.block[used]], np.zeros(2))
    half = factor * np.sqrt(np.diag(variance))
    # A driven velocity is told if both a smaller and a larger one are clearly worse.
    close = [each for each, cost in zip(grid, costs, strict=True) if cost < 1.02 * found.cost]
    ends = min([*close, chosen.x]) - (grid[1] - grid[0]), max([*close, chosen.x]) + (grid[1] - grid[0])
    told = np.exp(ends)
    known = ends[0] > low and ends[1] < high
    estimates = [
        Estimate.within("pump.ls_margin", found.x[0], half[0]),
        Estimate.within("simulation.pump_time_constant", found.x[1], half[1]),
        Estimate(
            "verification.driven_velocity",
            epsilon,
            float(min(told)) if known else None,
            float(max(told)) if known else None,
            known,
            "of the measured supply pressure; for planning the draft's is kept, as in the paper"
            if known
            else "to tell it, start and stop single cylinders slowly",
        ),
    ]
    line = model(found.x, demanded(epsilon))
    fits = (compare("supply", supply[rows.keep], line[rows.keep], rows.training[rows.keep]),)
    series = {"supply": (rows.time[rows.keep], supply[rows.keep], line[rows.keep], rows.training[rows.keep])}
    pump = replace(machine.pump, ls_margin=kept(found.x[0]))
    circuit = replace(machine.circuit, pump_time_constant=kept(found.x[1]))
    return PumpFit(replace(machine, pump=pump, circuit=circuit), tuple(estimates), fits, series, ())
