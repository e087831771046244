"""Data for the script of a report: poses of the crane and values of charts, thinned out, in readable units."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from leanboom.evaluation.evaluate import SAMPLE
from leanboom.report.charts import COLOURS, POINTS, chart, chart_rows, pump_charts, pump_values, rounded

if TYPE_CHECKING:
    from leanboom.evaluation.evaluate import Evaluation
    from leanboom.model.machine import Machine
    from leanboom.planning.planner import Plan

PLOT_STEP = 0.02  # [s] between the points of a chart
THICKNESS, VISIBLE = 0.036, 0.03  # of the drawn boom, and from which on two are told apart, of the reach
LENGTHS = "Lengths, with the ends of the stroke (the extension beyond its retracted length)"
FRAMES = 121  # poses of the animation; the page interpolates between them


def colours(machine: Machine) -> dict[str, str]:
    """Colour of each part of the crane: those of its cylinders; a base that does not slew is grey.

    Args:
        machine: The machine.
    """
    return {**COLOURS} if machine.geometry.slewing else {**COLOURS, "base": "#59636e"}


def data(plan: Plan) -> dict[str, Any]:
    """Data for the page's script, ready for JSON.

    Args:
        plan: The plan.
    """
    judged, other = plan.evaluation, plan.baseline
    every = max(int(round(PLOT_STEP / SAMPLE)), -(-judged.time.size // POINTS))
    at = np.unique(np.append(np.arange(0, judged.time.size, every), judged.time.size - 1))
    frames = np.unique(np.linspace(0, judged.time.size - 1, FRAMES).round().astype(int))
    opens = judged.time[judged.time.size // 2] if other is None else postures_apart(plan)[0]
    motions = {"plan": judged} | ({"other": other} if other is not None else {})
    behind = {} if other is None else {"pseudo-inverse": other}
    return {
        "duration": plan.task.duration,
        "opens_at": float(opens),
        "time": rounded(judged.time[at], 6),
        "crane": _crane(plan, frames),
        "frames": {name: _frames(motion, plan.pump, frames) for name, motion in motions.items()},
        "pump": pump_charts(
            {"plan": [values[at] for values in pump_values(judged, plan.pump)]},
            {name: [values[at] for values in pump_values(motion, plan.pump)] for name, motion in behind.items()},
            plan.task.machine.pump.max_pressure,
        ),
        "rows": {"cylinder-charts": _cylinder_charts(plan, behind, at)},
    }


def postures_apart(plan: Plan) -> tuple[float, float]:
    """When the boom's postures differ most between plan and pseudo-inverse [s], and by how much [m].

    Args:
        plan: A plan with a baseline.
    """
    assert plan.baseline is not None
    mine, theirs = (_boom(motion, np.arange(motion.time.size)) for motion in (plan.evaluation, plan.baseline))
    apart = np.max([np.linalg.norm(a - b, axis=1) for a, b in zip(mine, theirs, strict=True)], axis=0)
    at = int(apart.argmax())
    return float(plan.evaluation.time[at]), float(apart[at])


def visible(plan: Plan, apart: float) -> bool:
    """Whether postures so far apart [m] can be told from each other in the drawing."""
    return apart > VISIBLE * _reach(plan)


def _reach(plan: Plan) -> float:
    """Farthest the path leads from the foot of the boom or the slewing axis [m]."""
    g, path = plan.task.machine.geometry, plan.evaluation.tool_target
    radius = np.hypot(path[:, 0], path[:, 1]) if g.slewing else path[:, 0]
    return float(radius.max() - min(0.0, g.base_x))


def _boom(motion: Evaluation, at: np.ndarray) -> tuple[np.ndarray, ...]:
    """Knee, heel and mouth of the boom in its plane [m], (samples, 2) each."""
    g = motion.task.machine.geometry
    q2, q3 = motion.joint_position[at, -3], motion.joint_position[at, -2]
    knee = np.stack([g.base_x + g.boom * np.cos(q2), g.base_z + g.boom * np.sin(q2)], axis=1)
    heel = knee + g.offset * np.stack([-np.sin(q2 + q3), np.cos(q2 + q3)], axis=1)
    return knee, heel, heel + g.outer * np.stack([np.cos(q2 + q3), np.sin(q2 + q3)], axis=1)


def _frames(motion: Evaluation, pump: str, frames: np.ndarray) -> dict[str, Any]:
    joints = np.nan_to_num(motion.joint_position[frames])
    if not motion.task.machine.geometry.slewing:
        joints = np.concatenate([np.zeros((frames.size, 1)), joints], axis=1)
    _, supply, power, energy = pump_values(motion, pump)

    def row(values: np.ndarray, digits: int) -> dict[str, Any]:
        return {"values": rounded(np.nan_to_num(values[frames]), 6), "digits": digits}

    return {
        "joints": np.round(joints, 5).tolist(),
        "stroke": row(motion.length[:, -1], 3),
        "supply": row(supply / 1e6, 1),
        "power": row(power / 1e3, 2),
        "energy": row(energy / 1e3, 2),
    }


def _crane(plan: Plan, frames: np.ndarray) -> dict[str, Any]:
    """Lengths, paths and the extent of the drawing [m]."""
    machine, judged = plan.task.machine, plan.evaluation
    g = machine.geometry
    path = judged.tool_target[frames]
    radius = np.hypot(path[:, 0], path[:, 1]) if g.slewing else path[:, 0]
    side = [np.stack([radius, path[:, 2]], axis=1), [[-0.6, -0.3], [g.base_x, g.base_z]]]
    above = [path[:, :2], [[-0.8, -0.8], [0.8, 0.8]]]
    for motion in filter(None, (judged, plan.baseline)):
        side += _boom(motion, frames)[:2]
    beside, over = _same_height(_extent(side, 0.06), _extent(above, 0.06))
    return {
        "slewing": g.slewing,
        "base_x": g.base_x,
        "base_z": g.base_z,
        "boom": g.boom,
        "offset": g.offset,
        "outer": g.outer,
        "payload": plan.task.payload,
        "thickness": round(100.0 * THICKNESS * _reach(plan), 2),
        "colours": colours(machine),
        "path_side": np.round(np.stack([radius, path[:, 2]], axis=1), 4).tolist(),
        "path_above": np.round(path[:, :2], 4).tolist(),
        "side": beside,
        "above": over,
    }


def _extent(points: list, margin: float) -> list[float]:
    """Left, right, bottom and top of a drawing that holds the points [m]."""
    everything = np.concatenate([np.asarray(part, dtype=np.float64) for part in points])
    low, high = everything.min(axis=0), everything.max(axis=0)
    room = margin * float((high - low).max())
    return np.round([low[0] - room, high[0] + room, low[1] - room, high[1] + room], 3).tolist()


def _same_height(side: list[float], above: list[float]) -> tuple[list[float], list[float]]:
    """The extents of both views, the lower one made as high as the other: the ground stays where it is."""
    high = max(side[3] - side[2], above[3] - above[2])
    middle = 0.5 * (above[2] + above[3])
    beside = [side[0], side[1], side[2], side[2] + high]
    over = [above[0], above[1], middle - 0.5 * high, middle + 0.5 * high]
    return np.round(beside, 3).tolist(), np.round(over, 3).tolist()


def _cylinder_charts(plan: Plan, behind: dict[str, Evaluation], at: np.ndarray) -> list[dict[str, Any]]:
    machine = plan.task.machine
    rows: dict[str, list] = {}
    for j, (joint, cylinder) in enumerate(zip(machine.joints, machine.cylinders, strict=True)):
        title, colour = cylinder.name.capitalize(), COLOURS[cylinder.name]
        ends = [float(cylinder.linkage.length_arm_slope(q)[0]) for q in (joint.lower, joint.upper)]
        fastest, highest = cylinder.velocity_limit, machine.pump.max_pressure
        for row, axis, unit, name, scale, limits in (
            (LENGTHS, "position" if joint.name == "base" else "length", "m", "length", 1.0, ends),
            ("Velocities, with their limits", "velocity", "m/s", "velocity", 1.0, [-fastest, fastest]),
            ("Forces", "force", "kN", "force", 1e-3, []),
            ("Demanded pressures, with the pump's highest", "pressure", "MPa", "pressure", 1e-6, [1e-6 * highest]),
        ):
            lines, grey = (
                {called: scale * getattr(motion, name)[at, j] for called, motion in motions.items()}
                for motions in ({"plan": plan.evaluation}, behind)
            )
            drawn = chart(title, axis, unit, colour, lines, grey, limits, zero=name in ("force", "pressure"), dot=True)
            rows.setdefault(row, []).append(drawn)
    return chart_rows(rows)
