"""Pump flow: Appendix C.

The flow is a sum of effective areas times velocities, eq. (37), with none below zero, and of what compresses the oil in
driven chambers and in the supply line, eqs. (18)-(19). Where a load drives its cylinder, the chamber that fills takes
oil from the return line: areas are told by the other rows alone, and these rows by what then lacks in the flow.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from leanboom.components.cylinders import Connection
from leanboom.formulas import fluid
from leanboom.identification.cylinder_forces import TRAINING, cylinder_motion
from leanboom.identification.estimates import Estimate, Fitted, beginnings, blocks_of, compare, kept, linear_fit
from leanboom.identification.logs.conditioning import Data
from leanboom.model.machine import Machine
from leanboom.simulation.plant import retracted

BULK = "simulation.bulk_modulus"
RATE = 50.0  # [Hz], of the rows
LEAST_TRAVEL = 0.3  # [m] each way, for an area
EMPTY = 0.5e6  # [Pa] above the return line: a chamber below does not drive its cylinder
OVER_RUNNING_POWERS = 2  # of the polynomial in velocity that takes away area under over-running load
UNIT_SPEED = 0.1  # [m/s], in the polynomial
DIFFERS = 0.05  # share by which an effective area may differ from the drawing without a remark


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Samples of a fit to the pump, (rows,) each."""

    time: np.ndarray
    every: int  # samples from one row to the next
    keep: np.ndarray  # whether a row can be used
    training: np.ndarray
    block: np.ndarray
    velocities: list[np.ndarray]  # of the cylinders [m/s]
    starved: list[np.ndarray]  # whether the chamber that fills is empty


def rows_of(data: Data, machine: Machine) -> Rows:
    """The rows of logs for a fit to the pump.

    Args:
        data: The conditioned logs.
        machine: The machine.
    """
    every = max(1, round(data.rate / RATE))
    keep = data.inner[::every].copy()
    velocities, starved = [], []
    for i, name in enumerate(machine.names):
        if f"{name}_position" not in data.channels:
            velocities.append(np.zeros(keep.size))
        else:
            velocities.append(cylinder_motion(data, machine, i)[0][::every])
            keep &= data.usable[name][::every]
        starved.append(empties(data, machine, i, velocities[-1], every))
    time, part = data.time[::every], data.part[::every]
    return Rows(time, every, keep, beginnings(part, TRAINING), blocks_of(time, part), velocities, starved)


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


def empties(data: Data, machine: Machine, i: int, velocity: np.ndarray, every: int = 1) -> np.ndarray:
    """Whether the chamber that fills is next to empty, as where the load drives its cylinder, (rows,).

    Args:
        data: The conditioned logs.
        machine: The machine, for the pressure of its return line.
        i: Number of the cylinder.
        velocity: Of the cylinder [m/s], (rows,).
        every: Samples from one row to the next.
    """
    from scipy.ndimage import binary_dilation

    name = machine.names[i]
    floor = data.channels.get("tank", machine.pump.tank_pressure + machine.circuit.counter_pressure)
    found = np.zeros(velocity.size, bool)
    around = round(0.5 * data.rate / data.cutoff)  # as far as the filter carries it
    for side, way in (("a", 1.0), ("b", -1.0)):
        pressure = data.channels.get(f"{name}_pressure_{side}")
        breathes = side == "b" and machine.cylinders[i].connection is Connection.SINGLE_ACTING
        if pressure is not None and not breathes:
            empty = np.asarray(binary_dilation(pressure < floor + EMPTY, np.ones(2 * around + 1)), dtype=bool)
            found |= empty[::every] & (way * velocity > 0.0)
    return found


def _compressed(data: Data, machine: Machine, rows: Rows) -> np.ndarray:
    """What driven chambers and the supply line take up, times the bulk modulus, (rows,)."""
    total, every = np.zeros(rows.time.size), rows.every
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


def fit(data: Data, machine: Machine) -> Fitted | None:
    """Fit the pump's flow; None without its channel, or without motion.

    Args:
        data: The conditioned logs.
        machine: The draft.
    """
    rows = rows_of(data, machine)
    if "pump_flow" in data.channels:
        flow = data.channels["pump_flow"][:: rows.every]
    elif "pump_volume" in data.channels:
        flow = data.rates["pump_volume"][:: rows.every]
    else:
        return None
    full = rows.keep & rows.training & ~np.any(rows.starved, axis=0)
    known = np.zeros(flow.size)
    columns, names, drawn, untold = [], [], [], []
    for name, speed, way, area in _ways(machine, rows):
        key = f"cylinders.{name}.area_{way}"
        if _travel(speed, full, data, rows) < LEAST_TRAVEL:
            note = f"to tell it, drive the {name} {way} for {LEAST_TRAVEL:g} m or more with its chambers filled"
            untold.append(Estimate(key, area, None, None, False, note))
            known += speed * area
        else:
            columns.append(speed)
            names.append(key)
            drawn.append(area)
    if not columns:
        return None
    columns.append(_compressed(data, machine, rows))
    table = np.stack(columns, axis=1)
    values, half, _ = linear_fit(table[full], (flow - known)[full], rows.block[full])
    model = known + table @ values
    estimates, remarks = [], []
    for name, value, width, area in zip(names, values, half, drawn, strict=False):
        estimates.append(Estimate.within(name, value, width))
        if abs(value - area) > width + DIFFERS * max(area, float(values.max()) * 0.2):
            remarks.append(
                f"{name}: the flow says {1e4 * value:.1f} cm^2, the draft {1e4 * area:.1f} cm^2; check bore, rod and "
                "connection (single_acting takes no flow in, differential A - B out)"
            )
    remarks.append("effective areas are reported only: in a machine file they follow from bore, rod and connection")
    machine = _bulk(machine, float(values[-1]), float(half[-1]), estimates)
    lacking, over = _over_running(data, machine, rows, model - flow)
    if over:
        remarks.append("anti-cavitation polynomials are reported only: a machine file has no place for them")
    kept_rows, model = rows.keep, model - lacking
    fits = (compare("pump_flow", flow[kept_rows], model[kept_rows], rows.training[kept_rows]),)
    series = {"pump_flow": (rows.time[kept_rows], flow[kept_rows], model[kept_rows], rows.training[kept_rows])}
    return Fitted(machine, (*estimates, *over, *untold), fits, series, tuple(remarks))


def _ways(machine: Machine, rows: Rows) -> list[tuple[str, np.ndarray, str, float]]:
    """Joint, speed, way, and the drawing's effective area of every cylinder, out and in."""
    found = []
    for name, drive, v in zip(machine.names, machine.drives, rows.velocities, strict=True):
        found.append((name, np.maximum(v, 0.0), "out", drive.area_out))
        found.append((name, np.maximum(-v, 0.0), "in", drive.area_in))
    return found


def _travel(speed: np.ndarray, used: np.ndarray, data: Data, rows: Rows) -> float:
    """How far a cylinder travels in the rows used [m]."""
    return float(speed[used].sum()) * rows.every / data.rate


def _over_running(data: Data, machine: Machine, rows: Rows, excess: np.ndarray) -> tuple[np.ndarray, list[Estimate]]:
    """What loads that drive their cylinders take away of a flow, (rows,), and the polynomials in velocity of it.

    Args:
        data: The conditioned logs.
        machine: The machine.
        rows: The rows.
        excess: By how much the flow of all areas is above the measured one, (rows,).
    """
    columns, names = [], []
    used = rows.keep & rows.training & np.any(rows.starved, axis=0)
    for k, (name, speed, way, _) in enumerate(_ways(machine, rows)):
        over = speed * rows.starved[k // 2]
        if _travel(over, used, data, rows) >= LEAST_TRAVEL:
            for power in range(OVER_RUNNING_POWERS):
                columns.append(over * (speed / UNIT_SPEED) ** power)
                names.append(f"anti_cavitation.{name}.{way}[{power}]")
    if not columns:
        return np.zeros(excess.size), []
    table = np.stack(columns, axis=1)
    values, half, _ = linear_fit(table[used], excess[used], rows.block[used])
    return table @ values, [Estimate.within(*each) for each in zip(names, values, half, strict=True)]


def _bulk(machine: Machine, softness: float, width: float, estimates: list[Estimate]) -> Machine:
    """The machine with the bulk modulus that a softness [1/Pa] means, if the logs tell it; its estimate is added."""
    if softness <= 2.0 * width:
        note = "to tell it, start and stop cylinders under load"
        estimates.append(Estimate(BULK, machine.circuit.bulk_modulus, None, None, False, note))
        return machine
    bulk = 1.0 / softness
    estimates.append(Estimate(BULK, bulk, 1.0 / (softness + width), 1.0 / (softness - width), True))
    return replace(machine, circuit=replace(machine.circuit, bulk_modulus=kept(bulk)))
