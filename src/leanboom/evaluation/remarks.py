"""Sentences on shortfalls of the pump, and on work that load-sensing energy leaves out.

None of it is a limit of the planning problem, which knows cylinders and joints alone. The judge adds these remarks to
what it measures.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from leanboom.components.pumps import Pump
from leanboom.model.machine import Machine

EXCEEDED = 1.001  # a pump is asked for too much above this share of what it gives, as with the limits of a plan
LEFT_OUT = 0.5  # uncounted work above this share of the load-sensing energy is remarked upon


@dataclass(frozen=True, slots=True)
class Shortfall:
    """Flow or pressure that a motion needs beyond the pump's largest."""

    what: str  # is needed: "pump flow", ...
    most: str  # largest need and its time
    given: str  # by the pump
    lasts: str  # for how long more is needed than given, and between which times

    def __str__(self) -> str:
        return f"{self.what} {self.most} is above the pump's {self.given}, {self.lasts}"


def shortfalls(
    pump: Pump, kind: str, time: np.ndarray, flow: np.ndarray, supply_ls: np.ndarray, pressure: np.ndarray
) -> tuple[Shortfall, ...]:
    """The shortfalls of a pump: flow; supply pressure if it is load-sensing, load pressure if constant-pressure.

    Args:
        pump: The pump.
        kind: "ls" or "cp", how it is run.
        time: [s], (samples,).
        flow: Pump flow [m^3/s], (samples,).
        supply_ls: Load-sensing supply [Pa], (samples,).
        pressure: Demanded pressures [Pa], (samples, joints).
    """
    found = [_above(time, 6e4 * flow, 6e4 * pump.max_flow, "pump flow", "l/min", 1)]
    if kind == "ls":
        found.append(_above(time, 1e-6 * supply_ls, 1e-6 * pump.max_pressure, "LS supply", "MPa", 2))
    else:
        most = pressure.max(axis=1)
        found.append(_above(time, 1e-6 * most, 1e-6 * pump.constant_pressure, "load pressure", "MPa", 2))
    return tuple(filter(None, found))


def _above(time: np.ndarray, values: np.ndarray, limit: float, what: str, unit: str, digits: int) -> Shortfall | None:
    above = np.flatnonzero(values > EXCEEDED * limit)
    if not above.size:
        return None
    i, step = int(values.argmax()), float(time[1] - time[0])
    begin, end = time[above[0]], time[above[-1]]
    return Shortfall(
        what,
        f"{values[i]:.{digits}f} {unit} at {time[i]:.3f} s",
        f"{limit:.{digits}f} {unit}",
        f"for {step * above.size:.3f} s between {begin:.3f} s and {end:.3f} s",
    )


def undeliverable(found: tuple[Shortfall, ...]) -> str:
    """The status of a motion that keeps its limits and asks too much of the pump.

    Args:
        found: What the pump cannot deliver, at least one.
    """
    parts = []
    for each in found:
        what = "" if each.what == "pump flow" else f"{each.what} "
        parts.append(f"{what}{each.most}, the pump gives {each.given}; exceeded {each.lasts}")
    return f"limits kept, but the pump cannot deliver it: {'; '.join(parts)}"


def uncounted_work(
    machine: Machine, time: np.ndarray, velocity: np.ndarray, force: np.ndarray, energy_ls: float, energy_cp: float
) -> str:
    """Sentence where load-sensing energy leaves out most of the work; empty elsewhere.

    Loads of cylinders no faster than the machine's threshold do not count. A motion that moves its loads so
    slowly seems to take hardly any energy, which is a property of eq. (41) and not of a real pump.

    Args:
        machine: The machine.
        time: [s], (samples,).
        velocity: Cylinder velocities [m/s], (samples, joints).
        force: Cylinder forces [N], (samples, joints).
        energy_ls: Energy of the load-sensing pump [J].
        energy_cp: Energy of the constant-pressure pump [J].
    """
    slow = np.abs(velocity) <= machine.driven_velocity
    work = float(np.trapezoid(np.where(slow, np.maximum(force * velocity, 0.0), 0.0).sum(axis=1), time))
    if not work > LEFT_OUT * energy_ls:
        return ""
    return (
        f"the load-sensing energy of {1e-3 * energy_ls:.2f} kJ leaves out {1e-3 * work:.2f} kJ of work that cylinders "
        f"do against their loads at no more than {1e3 * machine.driven_velocity:g} mm/s, where loads do not count "
        f"(driven_velocity); a constant-pressure pump takes {1e-3 * energy_cp:.2f} kJ"
    )
