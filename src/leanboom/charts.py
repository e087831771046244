"""What the script of a report draws: the crane's poses and the charts' values, thinned out and in readable units."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from leanboom import linkages
from leanboom.judge import SAMPLE

if TYPE_CHECKING:
    from leanboom.judge import Evaluation
    from leanboom.machine import Machine
    from leanboom.planner import Plan

PLOT_STEP = 0.02  # [s] between the points of a chart
PLOT_POINTS = 1500  # at most
FRAMES = 121  # poses of the animation; the page interpolates between them
COLOURS = {"base": "#5b4a9e", "lift": "#0b5c8c", "tilt": "#b4540a", "extension": "#17804a"}
PLAN_COLOUR = "#0b5c8c"


def colours(machine: Machine) -> dict[str, str]:
    """Colour of each part of the crane: those of its cylinders; a base that does not slew is grey.

    Args:
        machine: The machine.
    """
    return {**COLOURS} if machine.geometry.slewing else {**COLOURS, "base": "#59636e"}


def _rounded(values: np.ndarray, digits: int = 5) -> list[float | None]:
    """Numbers of a chart: few digits, and None where there is none."""
    return [float(f"{value:.{digits}g}") if np.isfinite(value) else None for value in np.asarray(values).tolist()]


def data(plan: Plan) -> dict[str, Any]:
    """What the page's script draws, ready for JSON.

    Args:
        plan: The plan.
    """
    judged, other = plan.evaluation, plan.baseline
    every = max(int(round(PLOT_STEP / SAMPLE)), -(-judged.time.size // PLOT_POINTS))
    at = np.unique(np.append(np.arange(0, judged.time.size, every), judged.time.size - 1))
    frames = np.unique(np.linspace(0, judged.time.size - 1, FRAMES).round().astype(int))
    opens = judged.time[judged.time.size // 2]
    if other is not None:
        difference = np.abs(judged.length[frames, -1] - other.length[frames, -1])
        ends = max(1, frames.size // 10)  # a posture at an end tells little
        difference[:ends] = difference[-ends:] = 0.0
        opens = judged.time[frames[int(np.nan_to_num(difference).argmax())]]
    motions = {"plan": judged} | ({"other": other} if other is not None else {})
    return {
        "duration": plan.task.duration,
        "opens_at": float(opens),
        "other_name": "pseudo-inverse",
        "time": _rounded(judged.time[at], 6),
        "crane": _crane(plan, frames),
        "frames": {name: _frames(motion, plan.pump, frames) for name, motion in motions.items()},
        "pump": _pump_charts(plan, at),
        "cylinders": _cylinder_charts(plan, at),
    }


def _frames(motion: Evaluation, pump: str, frames: np.ndarray) -> dict[str, Any]:
    joints = np.nan_to_num(motion.joint_position[frames])
    if not motion.task.machine.geometry.slewing:
        joints = np.concatenate([np.zeros((frames.size, 1)), joints], axis=1)
    supply, power, energy = _pump_values(motion, pump)

    def row(values: np.ndarray, digits: int) -> dict[str, Any]:
        return {"values": _rounded(np.nan_to_num(values[frames]), 6), "digits": digits}

    return {
        "joints": np.round(joints, 5).tolist(),
        "stroke": row(motion.length[:, -1], 3),
        "supply": row(supply / 1e6, 1),
        "power": row(power / 1e3, 2),
        "energy": row(energy / 1e3, 2),
    }


def _pump_values(motion: Evaluation, pump: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Supply pressure [Pa], power [W] and energy so far [J] with a pump."""
    if pump == "ls":
        return motion.supply_ls, motion.power_ls, motion.cumulative_ls
    return motion.supply_cp, motion.power_cp, motion.cumulative_cp


def _crane(plan: Plan, frames: np.ndarray) -> dict[str, Any]:
    """Lengths, paths and the extent of the drawing [m]."""
    machine, judged = plan.task.machine, plan.evaluation
    g = machine.geometry
    path = judged.tool_target[frames]
    radius = np.hypot(path[:, 0], path[:, 1]) if g.slewing else path[:, 0]
    side = [np.stack([radius, path[:, 2]], axis=1), [[-0.6, -0.3], [g.base_x, g.base_z]]]
    above = [path[:, :2], [[-0.8, -0.8], [0.8, 0.8]]]
    for motion in filter(None, (judged, plan.baseline)):
        q2, q3 = np.nan_to_num(motion.joint_position[frames, -3]), np.nan_to_num(motion.joint_position[frames, -2])
        knee = np.stack([g.base_x + g.boom * np.cos(q2), g.base_z + g.boom * np.sin(q2)], axis=1)
        heel = knee + g.offset * np.stack([-np.sin(q2 + q3), np.cos(q2 + q3)], axis=1)
        side += [knee, heel]
    reach = float(radius.max() - min(0.0, g.base_x))
    return {
        "slewing": g.slewing,
        "base_x": g.base_x,
        "base_z": g.base_z,
        "boom": g.boom,
        "offset": g.offset,
        "outer": g.outer,
        "payload": plan.task.payload,
        "thickness": round(100.0 * 0.036 * reach, 2),
        "colours": colours(machine),
        "path_side": np.round(np.stack([radius, path[:, 2]], axis=1), 4).tolist(),
        "path_above": np.round(path[:, :2], 4).tolist(),
        "side": _extent(side, 0.06),
        "above": _extent(above, 0.06),
    }


def _extent(points: list, margin: float) -> list[float]:
    """Left, right, bottom and top of a drawing that holds the points [m]."""
    everything = np.concatenate([np.asarray(part, dtype=np.float64) for part in points])
    low, high = everything.min(axis=0), everything.max(axis=0)
    room = margin * float((high - low).max())
    return np.round([low[0] - room, high[0] + room, low[1] - room, high[1] + room], 3).tolist()


def _pump_charts(plan: Plan, at: np.ndarray) -> list[dict[str, Any]]:
    pump, colour = plan.task.machine.pump, PLAN_COLOUR
    motions = [plan.evaluation] + ([plan.baseline] if plan.baseline is not None else [])
    values = [_pump_values(motion, plan.pump) for motion in motions]
    return [
        _chart("Flow", "flow", "l/min", colour, [1e3 * 60 * m.pump_flow[at] for m in motions], [], zero=True),
        _chart(
            "Supply pressure", "pressure", "MPa", colour, [v[0][at] / 1e6 for v in values],
            [pump.max_pressure / 1e6], zero=True,
        ),
        _chart("Power", "power", "kW", colour, [v[1][at] / 1e3 for v in values], [], zero=True),
        _chart("Energy so far", "energy", "kJ", colour, [v[2][at] / 1e3 for v in values], [], zero=True),
    ]  # fmt: skip


def _cylinder_charts(plan: Plan, at: np.ndarray) -> list[dict[str, Any]]:
    machine = plan.task.machine
    motions = [plan.evaluation] + ([plan.baseline] if plan.baseline is not None else [])
    rows: dict[str, list] = {"Length": [], "Velocity": [], "Force": [], "Counted pressure": []}
    for j, (joint, cylinder) in enumerate(zip(machine.joints, machine.cylinders, strict=True)):
        title, colour = cylinder.name.capitalize(), COLOURS[cylinder.name]
        ends = [float(linkages.cylinder(cylinder.linkage, q)[0]) for q in (joint.lower, joint.upper)]
        fastest = cylinder.velocity_limit
        for row, axis, unit, name, scale, limits in (
            ("Length", "position" if joint.name == "base" else "length", "m", "length", 1.0, ends),
            ("Velocity", "velocity", "m/s", "velocity", 1.0, [-fastest, fastest]),
            ("Force", "force", "kN", "force", 1e-3, []),
            ("Counted pressure", "pressure", "MPa", "pressure", 1e-6, [machine.pump.max_pressure * 1e-6]),
        ):
            series = [scale * getattr(motion, name)[at, j] for motion in motions]
            zero = row in ("Force", "Counted pressure")
            rows[row].append(_chart(title, axis, unit, colour, series, limits, zero=zero, dot=True))
    titles = {
        "Length": "Lengths, with the ends of the stroke (the extension beyond its retracted length)",
        "Velocity": "Velocities, with their limits",
        "Force": "Forces",
        "Counted pressure": "Counted pressures, with the pump's highest",
    }
    return [{"title": titles[row], "charts": charts} for row, charts in rows.items()]


def _chart(title, axis, unit, colour, series, limits, *, zero: bool = False, dot: bool = False) -> dict[str, Any]:
    """One chart: the plan's values and, where there is one, the baseline's."""
    return {
        "title": title,
        "axis": axis,
        "unit": unit,
        "colour": colour,
        "dot": dot,
        "zero": zero,
        "plan": _rounded(series[0]),
        "other": _rounded(series[1]) if len(series) > 1 else None,
        "limits": _rounded(limits),
    }
