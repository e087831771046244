"""Identification as a whole: logs and a draft to a machine whose values are marked identified."""

from __future__ import annotations

import time as clock
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from leanboom.errors import InputError
from leanboom.identification import cylinder_forces, geometry_fit, pump_fit, supply_fit, valve_fit
from leanboom.identification.estimates import Estimate, Fit, Fitted, Series
from leanboom.identification.logs import conditioning
from leanboom.identification.logs.checks import Finding, check, refuse
from leanboom.identification.logs.conditioning import Data
from leanboom.identification.logs.reading import Log, read_log
from leanboom.model.machine import Machine, Provenance
from leanboom.progress import Progress, quiet
from leanboom.quantities.declarations import declared
from leanboom.quantities.units import KINDS, Kind, write


@dataclass(frozen=True, slots=True, eq=False)
class Identification:
    """What logs tell of a machine."""

    draft: Machine
    machine: Machine  # the draft with what was found
    logs: tuple[Log, ...]
    estimates: tuple[Estimate, ...]
    fits: tuple[Fit, ...]
    series: Mapping[str, Series]  # by signal
    feed_forward: Mapping[str, np.ndarray]  # by joint: velocity [m/s] and command, (points, 2)
    findings: tuple[Finding, ...]
    said: tuple[str, ...]  # what was done, and what cannot be told
    date: str
    wall_s: float

    def json(self, out: Path | None = None) -> dict[str, Any]:
        """What `--json` prints.

        Args:
            out: The machine file that was written.
        """
        return {
            "parameters": {each.name: each.json() for each in self.estimates},
            "fit": {each.signal: each.json() for each in self.fits},
            "out": None if out is None else str(out),
        }


def identify(
    paths: Sequence[Path],
    draft: Machine,
    *,
    columns: Mapping[str, Mapping[str, Any]] | None = None,
    cutoff: float | None = None,
    date: str | None = None,
    progress: Progress | None = None,
) -> Identification:
    """Identify a machine from logs.

    Args:
        paths: The logs, one or more.
        draft: What drawings and data sheet say; values that nothing tells are kept.
        columns: A column map, see `channels.read_map`.
        cutoff: Of the low pass [Hz]; None: from the data.
        date: What the machine file says; None: today.
        progress: Called with what happens and the share done.

    Raises:
        InputError: A log cannot be read or has faults, all of them named, or nothing can be fitted.
    """
    tell = progress or quiet
    began = clock.perf_counter()
    if not paths:
        raise InputError("log = nothing; must be at least one log")
    tell("reading logs", 0.0)
    logs = [read_log(path, draft, columns or {}) for path in paths]
    checked = [check(log, draft) for log in logs]
    findings = [finding for each in checked for finding in each.findings]
    data = conditioning.condition(checked, draft, cutoff)
    findings += _unmoved(data, draft)
    refuse(findings)
    with _one_thread():
        machine, results = _fits(data, draft, findings, tell)
    if not results:
        needed = ", ".join(f"{name}_{what}" for name in draft.names[-3:] for what in ("position", "pressure_a"))
        raise InputError(
            f"nothing can be fitted: positions, pressures or commands are missing or stand still, such as {needed}"
        )
    said = [*data.said, *_missing(data, draft), *(remark for each in results for remark in each.remarks)]
    estimates = tuple(estimate for each in results for estimate in each.estimates)
    untold = {each.name for each in estimates if not each.identifiable}
    day = date or datetime.now(UTC).date().isoformat()
    return Identification(
        draft=draft, machine=_marked(machine, draft, logs, day, untold), logs=tuple(logs), estimates=estimates,
        fits=tuple(fit for each in results for fit in each.fits),
        series={name: values for each in results for name, values in each.series.items()},
        feed_forward={joint: table for each in results for joint, table in each.tables.items()},
        findings=tuple(findings), said=tuple(said), date=day, wall_s=clock.perf_counter() - began,
    )  # fmt: skip


def _one_thread():
    """Small matrices are faster without a pool of threads, which may have to share its cores."""
    from threadpoolctl import threadpool_limits

    return threadpool_limits(1)


def _fits(data: Data, draft: Machine, findings: list[Finding], tell: Progress) -> tuple[Machine, list[Fitted]]:
    """The machine after all fits, and their results; a fit builds on what the one before found."""
    machine, results = draft, []
    kinds = (
        ("linkages", geometry_fit.fit),
        ("pump flow", pump_fit.fit),
        ("valves", valve_fit.fit),
        ("cylinder forces", cylinder_forces.fit),
        ("supply pressure", supply_fit.fit),
    )
    for i, (what, fit) in enumerate(kinds):
        tell(f"fitting {what}", 0.2 + 0.15 * i)
        found = fit(data, machine)
        if found is None:
            continue
        findings += found.faults
        refuse(findings)
        machine = found.machine
        results.append(found)
    return machine, results


def _unmoved(data: Data, machine: Machine) -> list[Finding]:
    """Joints that move too little; a fault if none moves."""
    found = []
    positions = 0
    for joint in machine.joints:
        values = data.channels.get(f"{joint.name}_position")
        if values is None:
            continue
        positions += 1
        share = np.ptp(values[data.inner]) / (joint.upper - joint.lower)
        if share < cylinder_forces.LEAST_TRAVEL:
            text = (
                f"{joint.name} moves over {100 * share:.1f} % of its range; nothing is fitted to it below "
                f"{100 * cylinder_forces.LEAST_TRAVEL:g} %: see identify --excitation for test motions"
            )
            found.append(Finding("motion", f"{joint.name}_position", text, False))
    return [replace(each, fault=True) for each in found] if found and len(found) == positions else found


def _missing(data: Data, machine: Machine) -> list[str]:
    """Channels that are not there, and what cannot be fitted without."""
    said = []
    for joint in machine.names:
        lost = [
            what
            for what in ("position", "pressure_a", "pressure_b", "command")
            if f"{joint}_{what}" not in data.channels
        ]
        if lost:
            fits = [
                name
                for name, needs in (("forces", {"position", "pressure_a"}), ("valve", {"position", "command"}))
                if needs & set(lost)
            ]
            said.append(
                f"{joint}: no {', '.join(lost)} in the logs"
                + (f"; without, no fit of its {' and '.join(fits)}" if fits else "")
            )
    if "supply" not in data.channels:
        said.append("no supply in the logs; without, no fit of the load-sensing margin")
    if not {"pump_flow", "pump_volume"} & set(data.channels):
        said.append("no pump_flow and no pump_volume in the logs; without, no fit of effective areas")
    return said


def _marked(machine: Machine, draft: Machine, logs: Sequence[Log], day: str, untold: set[str]) -> Machine:
    """The machine with the provenance of every value that differs from the draft's: date and hash of the logs."""
    hashes = ", ".join(log.digest[:12] for log in logs)
    changed = dict(_differences(draft, machine))
    note = f"{day}, log {hashes}"
    sums = f"{note}; told in sums over bodies alone"
    kept = [each for each in draft.provenance if each.key not in changed and not _replaced(each.key, changed)]
    entries = [
        Provenance(key, write(value, kind), "identified", sums if key in untold else note)
        for key, (value, kind) in changed.items()
    ]
    return replace(machine, provenance=(*kept, *entries))


def _replaced(key: str, changed: Mapping[str, Any]) -> bool:
    """Whether a drafted list of friction steps was replaced as a whole."""
    return ".steps[" in key and any(".steps[" in other for other in changed)


def _differences(draft: Machine, machine: Machine) -> list[tuple[str, tuple[float, Kind]]]:
    """Keys of a machine file whose numbers changed, these, and what they measure."""
    found: list[tuple[str, tuple[float, Kind]]] = []
    for name, key in (("valve", "valve"), ("pump", "pump"), ("circuit", "simulation")):
        found += _changed(getattr(draft, name), getattr(machine, name), key)
    for old, new in zip(draft.cylinders, machine.cylinders, strict=True):
        found += _changed(old, new, f"cylinders.{new.name}")
    for old, new in zip(draft.bodies, machine.bodies, strict=True):
        found += _changed(old, new, f"bodies.{new.name}")
    return found


def _changed(old: Any, new: Any, key: str) -> list[tuple[str, tuple[float, Kind]]]:
    found = []
    for name in (each.name for each in fields(new)):
        before, now, here = getattr(old, name), getattr(new, name), f"{key}.{name}"
        kind = declared(type(new))[name].rule.kind if name in declared(type(new)) else None
        if is_dataclass(now) and type(before) is type(now):
            found += _changed(before, now, here)
        elif isinstance(now, tuple) and now and isinstance(now[0], float):
            same = isinstance(before, tuple) and len(before) == len(now)
            found += [
                (f"{here}[{i}]", (value, KINDS["length"]))
                for i, value in enumerate(now)
                if not same or before[i] != value
            ]
        elif isinstance(now, float) and isinstance(before, float) and before != now:
            found.append((here, (now, kind or KINDS["number"])))
    return found
