"""What is wrong with a log, named with rows and times, before anything is fitted to it.

What can be left out or filled in is a remark; what would spoil a fit is a fault and ends the identification.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from leanboom.components.cylinders import Connection
from leanboom.errors import InputError
from leanboom.identification.logs.channels import kind_of
from leanboom.identification.logs.reading import Log
from leanboom.model.machine import Machine
from leanboom.quantities.units import parse

GAP = 5.0  # sampling periods without a sample
OUTLIER = 20.0  # typical distances from the median of the neighbours
JUMP, SPIKE = 0.02, 0.25  # and shares of a channel's spread: of a position, and of what may jump in truth
NEIGHBOURS = 7  # samples of that median
MOST_MISSING = 0.05  # share of a channel's samples that may be filled in
STUCK = 3.0  # [s] of one and the same value while the joint moves
MOST_STUCK = 0.2  # share of a log in which a sensor may be stuck
HIGHEST_PRESSURE, LEAST_PRESSURE = 60e6, 5e4  # of a plausible log's largest pressure [Pa]
DRIVEN = 0.05  # a command so far beyond the dead zone moves its cylinder
LISTED = 5  # rows in a message


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong with a log."""

    kind: str  # missing, units, gap, time, outliers, stuck, chambers, sign, motion
    channel: str
    text: str
    fault: bool  # whether it ends the identification


@dataclass(frozen=True, slots=True, eq=False)
class Checked:
    """A log with bad samples filled in, what was found, and where each joint's samples can be used."""

    log: Log
    signals: Mapping[str, np.ndarray]
    usable: Mapping[str, np.ndarray]  # by joint, (rows,)
    breaks: np.ndarray  # samples before which the log is interrupted
    findings: tuple[Finding, ...]


def refuse(findings: list[Finding]) -> None:
    """Raise InputError with all faults, if there are any.

    Args:
        findings: What was found.
    """
    faults = [finding.text for finding in findings if finding.fault]
    if faults:
        raise InputError("\n".join(faults))


def check(log: Log, machine: Machine) -> Checked:
    """Check a log by itself.

    Args:
        log: The log.
        machine: The draft, for ranges of joints and sizes.

    Raises:
        InputError: It has faults; all are named.
    """
    findings = _times(log)
    refuse(findings)
    period = float(np.median(np.diff(log.time)))
    breaks = np.flatnonzero(np.diff(log.time) > GAP * period) + 1
    signals: dict[str, np.ndarray] = {}
    for channel, values in log.signals.items():
        signals[channel] = _filled(log, channel, values, findings)
    for channel, values in signals.items():
        findings += _units(log, machine, channel, values)
    refuse(findings)
    for channel in [c for c in signals if not c.endswith("_command")]:
        signals[channel] = _without_outliers(log, channel, signals[channel], findings)
    usable = {joint: _unstuck(log, machine, joint, signals, findings) for joint in machine.names}
    refuse(findings)
    return Checked(log, signals, usable, breaks, tuple(findings))


def _times(log: Log) -> list[Finding]:
    bad = np.flatnonzero(~np.isfinite(log.time))
    if bad.size:
        return [Finding("time", "time", f"{log.file}: time is no number in {_rows(log, bad)}", True)]
    steps = np.diff(log.time)
    back = np.flatnonzero(steps <= 0.0)
    if back.size:
        at = ", ".join(f"from {log.time[i]:g} s to {log.time[i + 1]:g} s" for i in back[:LISTED])
        text = f"{log.file}: time jumps back or stands still in {_rows(log, back + 1)} ({at}); sort or cut it"
        return [Finding("time", "time", text, True)]
    period = float(np.median(steps))
    found = []
    for i in np.flatnonzero(steps > GAP * period)[:50]:
        text = f"{log.file}: gap of {steps[i]:.3g} s after row {log.row(i)} ({log.time[i]:.3f} s): parts apart"
        found.append(Finding("gap", "time", text, False))
    return found


def _filled(log: Log, channel: str, values: np.ndarray, findings: list[Finding]) -> np.ndarray:
    bad = ~np.isfinite(values)
    if not bad.any():
        return values
    share = float(bad.mean())
    text = f"{log.file}: {channel} has no number in {_rows(log, np.flatnonzero(bad))}"
    fault = share > MOST_MISSING
    findings.append(Finding("missing", channel, text + ("" if fault else "; filled in from their neighbours"), fault))
    if bad.all():
        return values
    good = np.flatnonzero(~bad)
    return np.interp(np.arange(values.size), good, values[good])


def _units(log: Log, machine: Machine, channel: str, values: np.ndarray) -> list[Finding]:
    """Whether a channel's values are plausible in the unit that was taken; if not, the unit that they fit."""
    low, high = _plausible(machine, channel)
    if low is None or not np.isfinite(values).all():
        return []
    seen = np.quantile(values, [0.002, 0.998])
    if channel == "pump_volume":
        rate = (values[-1] - values[0]) / (log.time[-1] - log.time[0])
        seen = np.array([rate, rate])
    reach = np.abs(values).max()
    small = channel == "supply" and reach < LEAST_PRESSURE
    if channel.endswith("_pressure_a"):
        other = log.signals.get(channel.replace("_pressure_a", "_pressure_b"))
        small = max(reach, 0.0 if other is None else float(np.nanmax(np.abs(other)))) < LEAST_PRESSURE
    if low <= seen[0] and seen[1] <= high and not small:
        return []
    column = log.columns[channel]
    kind = kind_of(channel)
    fits = []
    for unit in kind.units:
        factor = (parse(f"1 {unit}", kind) or 1.0) / abs(parse(f"1 {column.unit}" if column.unit else "1", kind) or 1.0)
        least = LEAST_PRESSURE if kind.name == "pressure" else 0.0
        inside = low <= factor * seen[0] and factor * seen[1] <= high and factor * reach >= least
        if factor != 1.0 and inside and unit != column.unit:
            fits.append(unit)
    where = np.flatnonzero((values < low) | (values > high)) if channel != "pump_volume" else np.array([], int)
    rows = f" in {_rows(log, where)}" if where.size and not small else ""
    hint = f"; it would fit in {' or '.join(fits)}" if fits else "; check column, unit, scale and zero"
    text = (
        f"{log.file}: {channel} goes from {seen[0]:.4g} to {seen[1]:.4g} {kind.unit}{rows}, column {column.name} "
        "taken in "
        f"{column.unit or 'shares'}; plausible is {low:.4g} to {high:.4g} {kind.unit}{hint}"
    )
    return [Finding("units", channel, text, True)]


def _plausible(machine: Machine, channel: str) -> tuple[float, float] | tuple[None, None]:
    for joint, cylinder in zip(machine.joints, machine.cylinders, strict=True):
        if channel == f"{joint.name}_position":
            room = 0.05 * (joint.upper - joint.lower)
            return joint.lower - room, joint.upper + room
        if channel == f"{joint.name}_cylinder":
            ends = sorted(float(cylinder.linkage.length_arm_slope(q)[0]) for q in (joint.lower, joint.upper))
            return ends[0] - 0.3 * cylinder.stroke, ends[1] + 0.3 * cylinder.stroke
    if channel.endswith("_command"):
        return -1.02, 1.02
    if kind_of(channel).name == "pressure":
        return -1e6, HIGHEST_PRESSURE
    if channel in ("pump_flow", "pump_volume"):
        return -0.2 * machine.pump.max_flow, 2.0 * machine.pump.max_flow
    return None, None


def _without_outliers(log: Log, channel: str, values: np.ndarray, findings: list[Finding]) -> np.ndarray:
    from scipy.ndimage import median_filter

    smooth = median_filter(values, NEIGHBOURS, mode="nearest")
    apart = np.abs(values - smooth)
    spread = float(np.subtract(*np.quantile(values, [0.99, 0.01])))
    typical = float(np.quantile(apart, 0.95))
    least = JUMP if channel.endswith(("_position", "_cylinder")) else SPIKE
    bad = np.flatnonzero(apart > max(OUTLIER * typical, least * spread, 1e-12))
    if not bad.size:
        return values
    fault = bad.size > MOST_MISSING * values.size
    text = f"{log.file}: {channel} has outliers in {_rows(log, bad)} ({_times_of(log, bad)})"
    findings.append(
        Finding("outliers", channel, text + ("" if fault else "; replaced by the neighbours' median"), fault)
    )
    clean = values.copy()
    clean[bad] = smooth[bad]
    return clean


def _unstuck(
    log: Log, machine: Machine, joint: str, signals: Mapping[str, np.ndarray], findings: list[Finding]
) -> np.ndarray:
    """Where none of a joint's sensors is stuck, (rows,)."""
    usable = np.ones(log.time.size, bool)
    position, command = signals.get(f"{joint}_position"), signals.get(f"{joint}_command")
    cylinder = signals.get(f"{joint}_cylinder")
    part = machine.cylinders[machine.names.index(joint)]
    zone = machine.circuit.dead_zone + DRIVEN
    range_ = machine.joints[machine.names.index(joint)]
    for name in ("position", "pressure_a", "pressure_b"):
        channel = f"{joint}_{name}"
        values = signals.get(channel)
        if values is None or (name == "pressure_b" and part.connection is Connection.SINGLE_ACTING):
            continue
        for begin, end in _constant(log.time, values):
            inside = slice(begin, end)
            if name == "position":
                moves = (command is not None and np.mean(np.abs(command[inside]) > zone) > 0.5) or (
                    cylinder is not None and np.ptp(cylinder[inside]) > 0.02 * part.stroke
                )
                ends = min(values[begin] - range_.lower, range_.upper - values[begin])
                moves = moves and ends > 0.02 * (range_.upper - range_.lower)  # else it may stand at its end
            else:
                other = signals.get(f"{joint}_pressure_{'b' if name == 'pressure_a' else 'a'}")
                travel = 0.0 if position is None else np.ptp(position[inside]) / (range_.upper - range_.lower)
                moves = travel > 0.05 and (other is None or np.ptp(other[inside]) > 1e6)
            if moves:
                share = (end - begin) / values.size
                text = (
                    f"{log.file}: {channel} is stuck at {values[begin]:.5g} {kind_of(channel).unit} in rows "
                    f"{log.row(begin)} to "
                    f"{log.row(end - 1)} ({log.time[begin]:.2f} to {log.time[end - 1]:.2f} s) while the joint moves"
                )
                fault = share > MOST_STUCK
                findings.append(Finding("stuck", channel, text + ("" if fault else "; left out of the fits"), fault))
                usable[inside] = False
    return usable


def _constant(time: np.ndarray, values: np.ndarray) -> list[tuple[int, int]]:
    """Runs of one and the same value that last long, (begin, end) samples."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(values) != 0.0) + 1, [values.size]])
    return [(int(a), int(b)) for a, b in zip(edges[:-1], edges[1:], strict=True) if time[b - 1] - time[a] > STUCK]


def _rows(log: Log, samples: np.ndarray) -> str:
    """Rows of a file in words: ranges, at most a few."""
    edges = np.flatnonzero(np.diff(samples) > 1) + 1
    parts = np.split(samples, edges)
    said = [
        f"{log.row(part[0])}" if part.size == 1 else f"{log.row(part[0])}-{log.row(part[-1])}"
        for part in parts[:LISTED]
    ]
    rest = f" and {len(parts) - LISTED} more places" if len(parts) > LISTED else ""
    return f"{'row' if samples.size == 1 else 'rows'} {', '.join(said)}{rest}"


def _times_of(log: Log, samples: np.ndarray) -> str:
    return ", ".join(f"{log.time[i]:.3f} s" for i in samples[:LISTED]) + (", ..." if samples.size > LISTED else "")
