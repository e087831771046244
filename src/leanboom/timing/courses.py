"""Motions along a path, speed and stroke together, at the ends of intervals; and what becomes of them as a task."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from leanboom.components.paths import Lines, Retimed, Spline
from leanboom.evaluation.evaluate import Evaluation, evaluate
from leanboom.model import crane as cranes
from leanboom.model import motion
from leanboom.model.motion import Motion
from leanboom.model.task import Task
from leanboom.timing import time_optimal
from leanboom.timing.along import along, own_time

SMOOTHING = 2.5  # points over which strokes are smoothed
LEAST = 4  # intervals between two corners


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """A motion along a path at the ends of intervals on which both accelerations are constant, (intervals + 1,)."""

    time: np.ndarray  # [s]
    tau: np.ndarray  # times of the path's own timing [s]
    omega: np.ndarray  # their rate
    x: np.ndarray  # stroke of the redundant cylinder [m]
    w: np.ndarray  # its velocity [m/s]
    counts: tuple[int, ...]  # intervals between two corners, equally long ones

    @property
    def edges(self) -> np.ndarray:
        """When corners are passed, both ends included [s]."""
        return self.time[np.concatenate([[0], np.cumsum(self.counts)])]


def shared(edges: np.ndarray, count: int) -> tuple[int, ...]:
    """Numbers of intervals between corners, in proportion to the times between them, so many together.

    Args:
        edges: When corners are passed, both ends included [s].
        count: All intervals; more where some segments would have too few.
    """
    ends = np.round(count * (edges - edges[0]) / (edges[-1] - edges[0])).astype(int)
    return tuple(int(max(LEAST, each)) for each in np.diff(ends))


def ticks(edges: np.ndarray, counts: tuple[int, ...]) -> np.ndarray:
    """Ends of intervals that are equally long between two corners [s]."""
    parts = [np.linspace(a, b, n + 1)[1:] for a, b, n in zip(edges[:-1], edges[1:], counts, strict=True)]
    return np.concatenate([edges[:1], *parts])


def corners(shape: Lines | Spline) -> np.ndarray:
    """Own times at which the tool rests at corners, both ends included [s]."""
    return shape.breaks if isinstance(shape, Lines) else np.array([0.0, shape.duration])


def of_strokes(
    task: Task, crane: cranes.Crane, shape: Lines | Spline, tau: np.ndarray, stroke: np.ndarray, count: int
) -> Course:  # fmt: skip
    """The fastest motion with given strokes, smoothed a little; a slow one where these keep no limits.

    Args:
        task: The task.
        crane: Its crane.
        shape: Its shape.
        tau: Own times of points [s], (points,), corners among them.
        stroke: Strokes there [m], (points,).
        count: Intervals of the motion.
    """
    from scipy.interpolate import CubicSpline
    from scipy.ndimage import gaussian_filter1d

    smooth = CubicSpline(tau, gaussian_filter1d(stroke, SMOOTHING, mode="nearest"), bc_type="clamped")

    def at(own: np.ndarray):
        return along(task, crane, shape, own, *(smooth(own, order) for order in range(3)))

    begins, ends = (at(own) for own in time_optimal.inside(tau))
    rates = time_optimal.fastest(tau, begins, ends, crane, shape.duration / time_optimal.LEAST_TIME)
    if rates is None or not np.all(rates[1:] + rates[:-1] > 0.0):
        rates = np.ones(tau.size)
    time = time_optimal.passing(tau, rates)
    edges = np.interp(corners(shape), tau, time)
    counts = shared(edges, count)
    when = ticks(edges, counts)
    k = np.clip(np.searchsorted(time, when, side="right") - 1, 0, time.size - 2)
    omega = np.interp(when, time, rates)
    passed = np.clip(tau[k] + 0.5 * (when - time[k]) * (rates[k] + omega), 0.0, tau[-1])
    return Course(when, passed, omega, smooth(passed), smooth(passed, 1) * omega, counts)


def of_motion(task: Task, shape: Lines | Spline, moved: Motion, count: int) -> Course:
    """A planned motion of a task as a course.

    Args:
        task: The task.
        shape: Its shape.
        moved: The motion.
        count: Intervals of the course.
    """
    time = np.linspace(0.0, task.duration, 20 * count + 1)
    edges = np.interp(corners(shape), own_time(task, time), time)
    counts = shared(edges, count)
    when = ticks(edges, counts)
    tau = own_time(task, when)
    x, w, _ = moved.at(when)
    return Course(when, tau, np.gradient(tau, when), x, w, counts)


def evened(course: Course, count: int) -> Course:
    """A course with intervals that are as nearly equal all along as whole numbers between corners allow."""
    from scipy.interpolate import CubicHermiteSpline

    counts = shared(course.edges, count)
    when = ticks(course.edges, counts)
    x = CubicHermiteSpline(course.time, course.x, course.w)
    tau = CubicHermiteSpline(course.time, course.tau, course.omega)
    return Course(when, tau(when), np.interp(when, course.time, course.omega), x(when), x(when, 1), counts)


def judged(task: Task, shape: Lines | Spline, course: Course, cost: str, duration: float | None = None) -> Evaluation:
    """A course with equal intervals, measured: a task with a fixed timing, and its motion.

    Args:
        task: The task whose timing was planned.
        shape: Its shape.
        course: The course.
        cost: What was minimised.
        duration: What the task must last [s]; None: what comes out.
    """
    path = Retimed(shape, tuple(np.maximum(course.omega, 0.0).tolist()))
    path = path if duration is None else path.slower(duration / path.duration)
    step = path.duration / (course.time.size - 1)
    moved = motion.from_velocities(step, float(course.x[0]), course.w, "dp", cost)
    return evaluate(replace(task, path=path, timing="fixed"), moved)


def slowed(found: Evaluation, factor: float) -> Evaluation:
    """A measured motion, taking `factor` times as long, measured again."""
    task, moved = found.task, found.motion
    slow = replace(
        moved, step=factor * moved.step, velocity=moved.velocity / factor, acceleration=moved.acceleration / factor**2
    )
    return evaluate(replace(task, path=task.path.slower(factor)), slow)
