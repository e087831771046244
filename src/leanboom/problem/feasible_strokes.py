"""Feasible strokes of the redundant cylinder: the intervals in which the tool is at its point."""

from __future__ import annotations

import numpy as np

from leanboom.errors import InfeasibleError
from leanboom.formulas import kinematics
from leanboom.model import crane as cranes
from leanboom.model.task import Task

SAMPLES = 257  # extensions looked at when searching the feasible ones
CLOSER = 16  # times as many, where none of them is feasible
BLOCK = 1024  # stages looked at together: a closer look takes 220 kB of memory a stage
STROKE_ACCURACY = 1e-9  # [m], accuracy of the ends of the feasible extensions
_BENT = f"an arm stays {np.degrees(kinematics.ELBOW_MARGIN):g} deg from straight and from folded up"


def stroke_range(task: Task) -> tuple[float, float]:
    """Smallest and largest stroke of the redundant cylinder [m], from its joint's range."""
    joint, ratio = task.machine.joints[-1], cranes.build(task).ratio
    return joint.lower * ratio, joint.upper * ratio


def feasible_strokes(task: Task, crane: cranes.Crane, plane: cranes.Plane, time: np.ndarray) -> tuple[np.ndarray, ...]:
    """Feasible strokes of the redundant cylinder [m] at times of a path, (intervals, 2) each.

    Args:
        task: The task.
        crane: Its crane.
        plane: Its reference at the times.
        time: The times [s], (times,).

    Raises:
        InfeasibleError: If the tool cannot be at its point at some time, whatever the extension.
    """
    parts = (slice(first, first + BLOCK) for first in range(0, time.size, BLOCK))
    return tuple(ends for part in parts for ends in _feasible_strokes(task, crane, plane, time, part))


def _feasible_strokes(
    task: Task, crane: cranes.Crane, plane: cranes.Plane, time: np.ndarray, part: slice
) -> list[np.ndarray]:
    """Feasible strokes at a part of the times, as `feasible_strokes`."""
    low, high = stroke_range(task)
    here = plane[part]
    for samples in (SAMPLES, CLOSER * SAMPLES):
        grid = np.linspace(low, high, samples)
        inside = cranes.position_margin(crane, here[:, None], grid[None, :]) >= -1e-12
        if inside.any(axis=1).all():
            break
    else:
        k = part.start + int(np.argmin(inside.any(axis=1)))
        raise InfeasibleError(_why_unreachable(task, crane, plane, k, time[k], grid))
    # Ends between a feasible and an infeasible sample are bisected, all at once.
    edges = inside[:, 1:] != inside[:, :-1]
    stage, index = np.nonzero(edges)
    good = np.where(inside[stage, index], grid[index], grid[index + 1])
    bad = np.where(inside[stage, index], grid[index + 1], grid[index])
    here = here[stage]
    while np.max(np.abs(good - bad), initial=0.0) > STROKE_ACCURACY:
        middle = 0.5 * (good + bad)
        keeps = cranes.position_margin(crane, here, middle) >= 0.0
        good, bad = np.where(keeps, middle, good), np.where(keeps, bad, middle)
    found = []
    for k, row in enumerate(inside):
        ends = list(good[stage == k])
        if row[0]:
            ends.insert(0, low)
        if row[-1]:
            ends.append(high)
        found.append(np.array(ends).reshape(-1, 2))
    return found


def _why_unreachable(task, crane, plane, k, time, grid) -> str:
    here = plane[k]
    where = f"at {time:.3f} s (stage {k}), tool radius {here.r:.3f} m, height {here.z:.3f} m"
    cosine = cranes.elbow_cosine(crane, here, grid / crane.ratio)
    if np.all(cosine < -kinematics.BENT):
        gap = np.ceil(1e3 * _reach_gap(task, here)) / 1e3
        bent = "" if cosine.max() < -1.0 else f"; {_BENT}"
        return f"the path leaves the crane's reach {where}: too far by {gap:.3f} m{bent}"
    if np.all(np.abs(cosine) > kinematics.BENT):
        return f"the path comes too close to the lift joint {where}"
    margin = cranes.position_margin(crane, here, grid)
    best = grid[int(margin.argmax())]
    pose = cranes.pose(crane, here, best)
    worst, message = 0.0, f"the joint ranges allow a straight or folded arm alone; {_BENT}"
    for q, joint in zip(pose.q, task.machine.joints[-3:], strict=True):
        for bound, amount in ((joint.lower, joint.lower - q), (joint.upper, q - joint.upper)):
            if amount / (joint.upper - joint.lower) > worst:
                worst = amount / (joint.upper - joint.lower)
                unit = "m" if joint.name == "extension" else "rad"
                message = f"joint {joint.name} would be {amount:.4f} {unit} beyond its limit {bound:.4f} {unit}"
    other = "; nor is all of it reached with the outer boom folded up" if len(cranes.sides(task.machine)) > 1 else ""
    return f"no extension reaches the path {where}: even at {best:.3f} m, {message}{other}"


def _reach_gap(task: Task, here: cranes.Plane) -> float:
    g = task.machine.geometry
    outer = np.hypot(g.outer + task.machine.joints[-1].upper, g.offset)
    reach = np.sqrt(g.boom**2 + outer**2 + 2.0 * g.boom * outer * kinematics.BENT)
    return float(np.hypot(here.r - g.base_x, here.z - g.base_z) - reach)
