r"""A crane along a path, without time: what each cylinder does per unit of the path's own time.

Where the extension is a function of the path's own time tau, so is the length of every cylinder. With the rate
omega = d tau / dt at which the own time passes,

    v = L' omega,    a = L'' omega^2 + L' d omega / dt,

which is what makes the fastest way along it a matter of omega alone.

| symbol | name | unit |
| --- | --- | --- |
| tau | time of the path's own timing | s |
| omega | its rate: 1 as fast as by the own timing | |
| L', L'' | derivatives of a cylinder's length over tau | m/s, m/s^2 |
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from leanboom.components.paths import Lines, Retimed, Spline, geometry, pieces
from leanboom.errors import InputError
from leanboom.model import crane as cranes
from leanboom.model.motion import Motion
from leanboom.model.pump_flow import pump_flow
from leanboom.model.task import Reference, Task

INSIDE = 1e-9  # share of an interval by which values at its ends are taken from inside: a corner has two of each


@dataclass(frozen=True, slots=True, eq=False)
class Along:
    """What cylinders do at points of a path. Arrays are (points, joints) or (points,)."""

    first: np.ndarray  # L'
    second: np.ndarray  # L''
    flow: np.ndarray  # pump flow at the rate 1 [m^3/s]


def shape_of(task: Task) -> Lines | Spline:
    """The path of a task without what retimes it.

    Raises:
        InputError: If it has no timing of its own.
    """
    path = task.path.path if isinstance(task.path, Retimed) else task.path
    if isinstance(path, Lines | Spline):
        return path
    raise InputError(f"path = {type(path).__name__}; only the timing of lines and splines can be planned")


def own_time(task: Task, time: np.ndarray) -> np.ndarray:
    """Times of the own timing of a task's shape [s], as `Retimed` follows it, at times of the task [s]."""
    path = task.path
    if isinstance(path, Retimed):
        return path.own(time)[0]
    if isinstance(path, Spline):
        return np.asarray(time, dtype=np.float64)
    assert isinstance(path, Lines)
    segment = pieces(path.breaks, time)
    begins, lengths = path.breaks[segment], np.asarray(path.durations)[segment]
    s = np.clip((time - begins) / lengths, 0.0, 1.0)
    way = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)  # by the quintic; the cubic's share of time for the same way
    share = 0.5 - np.sin(np.arcsin(np.clip(1.0 - 2.0 * way, -1.0, 1.0)) / 3.0)
    return begins + lengths * share


def plane_at(task: Task, shape: Lines | Spline, tau: np.ndarray) -> cranes.Plane:
    """The tool in the boom's plane at own times [s], moving at the rate 1."""
    point, first, second = geometry(shape, tau)
    return cranes.plane(task.machine, Reference(tau, point, first, second))


def along(
    task: Task, crane: cranes.Crane, shape: Lines | Spline, tau: np.ndarray, x: np.ndarray, dx: np.ndarray,
    ddx: np.ndarray,
) -> Along:  # fmt: skip
    """What the cylinders do at own times.

    Args:
        task: The task.
        crane: Its crane.
        shape: Its shape.
        tau: Own times [s], (points,).
        x, dx, ddx: Stroke of the redundant cylinder [m] and its derivatives over own time there.
    """
    pose = cranes.pose(crane, plane_at(task, shape, tau), x)
    moving = cranes.move(pose, dx, ddx)
    first = np.stack(moving.velocity, axis=1)
    return Along(first, np.stack(moving.acceleration, axis=1), pump_flow(crane.drives, moving.velocity))


def strokes(task: Task, motion: Motion, tau: np.ndarray) -> np.ndarray:
    """Strokes of a motion [m] where own times of its task's shape are passed [s]."""
    time = np.linspace(0.0, task.duration, max(2001, 8 * motion.acceleration.size))
    return np.interp(tau, own_time(task, time), motion.at(time)[0])
