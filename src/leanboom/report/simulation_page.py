"""Files of a simulated run: numbers as JSON, samples as CSV, and a page that explains them, offline."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from leanboom.planning import summaries
from leanboom.planning.summaries import LegShare
from leanboom.report import plan_page, rendering
from leanboom.report.charts import COLOURS, POINTS, chart, chart_rows, pump_charts, pump_values, rounded
from leanboom.simulation.closed_loop import SETTLE, Simulation

SUMMARY, SAMPLES, PAGE = FILES = ("simulation.json", "simulation.csv", "simulation.html")
LED_BACK = 5.0  # [J] of waiting beyond those of the plan, from where a reason is given
SIMULATED, PORTS = "simulated", ("piston side", "rod side")


def summary(run: Simulation, out: Path | None = None) -> dict[str, Any]:
    """A run's numbers in SI units, as `simulation.json` and `--json` have them; one that is not finite is None.

    Args:
        run: The run.
        out: Its folder, if it has one.
    """
    return {
        "task": run.task.name,
        "pump": run.pump,
        "method": run.motion.method,
        "energy_j": _finite(run.energy),
        "planned_energy_j": _finite(run.planned_energy),
        "path_accuracy_m": _finite(run.path_accuracy),
        "balance_error": _finite(run.balance_error),
        "legs": [leg.json() for leg in legs(run)],
        "wall_s": _finite(run.wall_s),
        "realtime_factor": _finite(run.realtime_factor),
        "events": [event.json() for event in run.events],
        "out": None if out is None else str(out),
    }


@dataclass(frozen=True, slots=True)
class LegRun:
    """A leg's part of a run, with the waiting before it; a task without legs is one of them."""

    planned: LegShare
    energy: float | None  # [J]; the last leg's counts what comes after the path's end; None where the run ended before
    path_accuracy: float | None  # [m]

    def json(self) -> dict[str, float | None]:
        """The same as `--json` prints it."""
        planned = self.planned.json()
        return {
            **planned, "energy_j": self.energy, "planned_energy_j": planned["energy_j"],
            "path_accuracy_m": self.path_accuracy,
        }  # fmt: skip


def legs(run: Simulation) -> tuple[LegRun, ...]:
    """The legs of a run; their energies sum to that of the whole.

    Args:
        run: The run.
    """
    ends = [each.until for each in run.task.stretches if not each.waits][:-1]
    shares = summaries.legs(run.planned, run.pump)
    found = []
    for share, (since, until) in zip(shares, pairwise([0.0, *ends, np.inf]), strict=True):
        begun = run.time[-1] > since or since == 0.0
        energy, accuracy = (run.spent(since, until), run.accuracy_between(since, until)) if begun else (None, None)
        found.append(LegRun(share, energy, accuracy))
    return tuple(found)


def waiting(run: Simulation) -> str:
    """Sentence on what the pump takes while the crane waits between legs; empty where it does not."""
    waits = [each for each in run.task.stretches if each.waits]
    if not waits:
        return ""
    spent = sum(run.spent(each.since, each.until) for each in waits)
    planned = sum(run.planned.spent(run.pump, each.since, each.until) for each in waits)
    lasts = sum(each.until - each.since for each in waits)
    said = f"While the crane waits, {lasts:g} s, the pump takes {spent / 1e3:.2f} kJ, {planned / 1e3:.2f} kJ by plan"
    late = "; valves are late, and the crane is led back to its place under the payload of the leg to come"
    return f"{said}{late if spent - planned > LED_BACK else ''}."


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def columns(run: Simulation) -> dict[str, np.ndarray]:
    """The columns of `simulation.csv` by name, in their order, (samples,) each.

    Args:
        run: The run.
    """
    table = {"time_s": run.time}
    for j, axis in enumerate("xyz"):
        table[f"{axis}_m"] = run.tool[:, j]
        table[f"{axis}_target_m"] = run.tool_target[:, j]
    names = run.task.machine.names
    for j, name in enumerate(names):
        unit = "m" if name == "extension" else "rad"
        table[f"{name}_{unit}"] = run.joint_position[:, j]
        table[f"{name}_target_{unit}"] = run.joint_target[:, j]
        table[f"{name}_{unit}_s"] = run.joint_velocity[:, j]
    ports = run.command.shape[1] // len(names)
    for j, name in enumerate(names):
        table[f"{name}_piston_m"] = run.position[:, j]
        table[f"{name}_piston_m_s"] = run.velocity[:, j]
        for port in range(ports):
            ending = "" if ports == 1 else f"_{'ab'[port]}"
            table[f"{name}_command{ending}"] = run.command[:, j * ports + port]
        table[f"{name}_pressure_a_pa"] = run.pressure_a[:, j]
        table[f"{name}_pressure_b_pa"] = run.pressure_b[:, j]
        table[f"{name}_force_n"] = run.force[:, j]
    table |= {"supply_pa": run.supply, "pump_flow_m3_s": run.pump_flow, "power_w": run.power}
    return table | {"energy_j": run.cumulative}


def texts(run: Simulation, out: Path) -> dict[str, str]:
    """The files of a run by their names.

    Args:
        run: The run.
        out: The folder they go to.
    """
    table = columns(run)
    row = ",".join(["%.8g"] * len(table))
    values = np.stack(list(table.values()), axis=1) + 0.0  # no minus zeros
    samples = "\n".join([",".join(table), *(row % tuple(sample) for sample in values.tolist())]) + "\n"
    numbers = json.dumps(summary(run, out), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    return {SUMMARY: numbers, SAMPLES: samples, PAGE: page(run)}


def page(run: Simulation) -> str:
    """The page of a run as one HTML document.

    Args:
        run: The run.
    """
    return rendering.page(
        "simulation",
        _data(run),
        run=run,
        task=run.task,
        pump=plan_page.PUMPS[run.pump],
        solved=run.solved,
        verdict="Incomplete" if not run.complete else "Complete" if run.solved else "Complete, but of no solved plan",
        cards=_cards(run),
        legs=legs(run) if run.task.legs else (),
        waiting=waiting(run),
        first_card=" first",
        settle=SETTLE,
        points=POINTS,
        summary=SUMMARY,
        samples=SAMPLES,
    )


def _cards(run: Simulation) -> list[tuple[str, str, str]]:
    """Title, value and note of each card."""
    errors = ", ".join(
        f"{name} {1e3 * error:.1f} {'mm' if name == 'extension' else 'mrad'}"
        for name, error in zip(run.task.machine.names, run.joint_error, strict=True)
    )
    turning = run.joint_error[:-1]  # the extension slides: it is named among the others
    return [
        ("Energy, simulated", f"{run.energy / 1e3:.2f} kJ", "supply pressure times flow"),
        ("Energy, planned", f"{run.planned_energy / 1e3:.2f} kJ", ""),
        ("Path accuracy", f"{1e3 * run.path_accuracy:.0f} mm", "largest, by ISO 9283"),
        ("Largest angle error", f"{1e3 * turning.max():.1f} mrad", errors),
        ("Energy balance", f"{1e6 * run.balance_error:.1f} ppm", "of the pump's energy not found again"),
        ("Speed", f"{run.realtime_factor:.0f} x", f"real time, {run.wall_s:.2f} s"),
    ]


def _data(run: Simulation) -> dict[str, Any]:
    at = np.unique(np.linspace(0, run.time.size - 1, min(POINTS, run.time.size)).round().astype(int))
    plan, last = run.planned, run.planned.time.size - 1
    # Samples of legs are a little apart from those of the run.
    there = np.minimum(np.searchsorted(plan.time, run.time[at] - 0.5 * run.time[:2].max()), last)
    moving = run.time[at] <= plan.time[-1] + 0.5 * run.time[:2].max()

    flow, supply, power, energy = (values[there] for values in pump_values(plan, run.pump))
    simulated = [values[at] for values in (run.pump_flow, run.supply, run.power, run.cumulative)]
    wanted = [flow * moving, supply, power * moving, energy]
    joints: dict[str, list] = {"Positions": [], "Errors": [], "Piston velocities": []}
    cylinders: dict[str, list] = {"Chamber pressures": [], "Valve commands": []}
    commands = run.command.reshape(run.time.size, len(run.task.machine.names), -1)
    for j, name in enumerate(run.task.machine.names):
        unit, small = ("m", "mm") if name == "extension" else ("rad", "mrad")
        found, target = run.joint_position[at, j], run.joint_target[at, j]
        chambers = dict(zip(PORTS, (1e-6 * run.pressure_a[at, j], 1e-6 * run.pressure_b[at, j]), strict=True))
        ports = dict(zip(PORTS, commands[at, j].T, strict=False))
        velocity, demanded = moving * plan.velocity[there, j], 1e-6 * moving * plan.pressure[there, j]
        for rows, row, axis, of, lines, planned in (
            (joints, "Positions", "position", unit, {SIMULATED: found}, target),
            (joints, "Errors", "error", small, {SIMULATED: 1e3 * (found - target)}, None),
            (joints, "Piston velocities", "velocity", "m/s", {SIMULATED: run.velocity[at, j]}, velocity),
            (cylinders, "Chamber pressures", "pressure", "MPa", chambers, demanded),
            (
                cylinders,
                "Valve commands",
                "command",
                "",
                ports if len(ports) > 1 else {SIMULATED: ports[PORTS[0]]},
                None,
            ),
        ):
            behind = {} if planned is None else {"planned": planned}
            rows[row].append(chart(name.capitalize(), axis, of, COLOURS[name], lines, behind))
    return {
        "time": rounded(run.time[at]),
        "pump": pump_charts({SIMULATED: simulated}, {"planned": wanted}, run.task.machine.pump.max_pressure),
        "rows": {"joint-charts": chart_rows(joints), "cylinder-charts": chart_rows(cylinders)},
    }
