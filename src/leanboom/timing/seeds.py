"""Motions along a path to begin the joint program from, as strokes over the path's own time."""

from __future__ import annotations

import numpy as np

from leanboom.components.paths import Lines, Spline
from leanboom.model import crane as cranes
from leanboom.model.pump_flow import pump_flow
from leanboom.model.task import Task
from leanboom.problem.feasible_strokes import feasible_strokes
from leanboom.timing.along import along, plane_at
from leanboom.timing.program import Ends

STROKES = 81  # at each point


def quickest(
    task: Task, crane: cranes.Crane, shape: Lines | Spline, tau: np.ndarray, ends: Ends, flow: float
) -> tuple[np.ndarray, np.ndarray]:
    """The quickest way along a path where velocities and pump flow alone are limited.

    A dynamic program over the strokes at each point: the least time between two points is the largest share of a
    limit that any cylinder would use at the rate 1.

    Args:
        task: The task.
        crane: Its crane.
        shape: Its shape.
        tau: Own times of the points [s], (points,).
        ends: Where the redundant cylinder starts and ends.
        flow: Largest pump flow [m^3/s]; infinite: none.

    Returns:
        Strokes [m], and the least times since the beginning [s], (points,) each.
    """
    grid, allowed = strokes(task, crane, shape, tau, ends)
    value = np.where(allowed[-1], 0.0, np.inf)
    rest = [value]
    best = np.zeros(grid.shape, dtype=np.intp)
    fast = np.array([c.velocity_limit for c in crane.machine.cylinders])
    steps = np.diff(tau)
    for k in range(steps.size - 1, -1, -1):
        middle = np.full(grid.shape[1], 0.5 * (tau[k] + tau[k + 1]))
        zero = np.zeros_like(middle)
        still, forth = (along(task, crane, shape, middle, grid[k], zero + slope, zero).first for slope in (0.0, 1.0))
        slope = (grid[k + 1][None, :] - grid[k][:, None]) / steps[k]
        velocity = still[:, None, :] + (forth - still)[:, None, :] * slope[:, :, None]
        pace = (np.abs(velocity) / fast).max(axis=2)
        asked = pump_flow(crane.drives, np.moveaxis(velocity, 2, 0))
        through = steps[k] * np.maximum(pace, asked / flow) + value[None, :]
        best[k] = through.argmin(axis=1)
        value = np.where(allowed[k], through[np.arange(through.shape[0]), best[k]], np.inf)
        rest.insert(0, value)
    at = int(value.argmin())
    found = [at]
    for k in range(steps.size):
        at = int(best[k, at])
        found.append(at)
    points = np.arange(grid.shape[0])
    return grid[points, found], value.min() - np.array(rest)[points, found]


def strokes(
    task: Task, crane: cranes.Crane, shape: Lines | Spline, tau: np.ndarray, ends: Ends
) -> tuple[np.ndarray, np.ndarray]:
    """Strokes from the least to the largest feasible one at each point [m], (points, strokes), and which are feasible.

    Args:
        task: The task.
        crane: Its crane.
        shape: Its shape.
        tau: Own times of the points [s], (points,).
        ends: Where the redundant cylinder starts and ends.
    """
    plane = plane_at(task, shape, tau)
    intervals = feasible_strokes(task, crane, plane, tau)
    low, high = (np.array([each.ravel()[i] for each in intervals]) for i in (0, -1))
    grid = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, STROKES)
    grid[0], grid[-1] = (np.linspace(*each, STROKES) for each in (ends.start, ends.end))
    allowed = cranes.position_margin(crane, plane[:, None], grid) >= -1e-9
    return grid, allowed
