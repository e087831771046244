r"""Pseudo-inverses with limits: the pointwise optimal baselines of both papers.

Least cylinder (or joint) velocities that give the tool its velocity, inside velocity limits: saturation in the null
space (SNS: Flacco, De Luca, Khatib, ICRA 2012) with the weighted pseudo-inverse of eq. (9), 3-DOF paper, carried to
cylinder space as both papers do. With one redundant joint the answer has a closed form, see `resolve`.

| symbol | name | unit | equation |
| --- | --- | --- | --- |
| J | tool velocity per joint or cylinder velocity | | (7); (8), 3-DOF |
| x | tool velocity | m/s | (7); (8), 3-DOF |
| W | weights of the velocity norm, diagonal | | (9), 3-DOF |
| v = a0 + a1 w | velocities over the redundant cylinder's, all on the path | m/s | (11), (34) |
| w | velocity of the redundant cylinder | m/s | |

A point-wise optimum knows nothing of what comes next. It keeps position and velocity limits (see `viable_strokes`)
and slows down before a joint limit that stands still, but no acceleration limit otherwise; the judge says how much
it is exceeded.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from leanboom.errors import LeanboomError
from leanboom.evaluation.evaluate import Evaluation, evaluate
from leanboom.model import crane as cranes
from leanboom.model import motion
from leanboom.model.motion import Motion
from leanboom.model.task import Task, sample
from leanboom.problem import stages
from leanboom.problem.stages import Problem
from leanboom.progress import Progress, quiet
from leanboom.quantities import ranges

METHODS = {"joint": "sns-joint", "actuator": "sns-actuator", "weighted": "sns-actuator-weighted"}
COSTS = {"joint": "joint-velocity", "actuator": "velocity", "weighted": "weighted-velocity"}
STEP = 0.01  # [s], interval of the integration
SMALL = 1e-12  # velocities and gains below this count as zero


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """All velocities that keep the tool on its path: affine in the redundant cylinder's. Arrays are (..., joints)."""

    joint0: np.ndarray  # joint velocities at w = 0 [rad/s, m/s]
    joint1: np.ndarray  # and per w
    cylinder0: np.ndarray  # a0, cylinder velocities at w = 0 [m/s]
    cylinder1: np.ndarray  # a1, and per w
    length: np.ndarray  # cylinder lengths [m]


Rule = Callable[[Line, np.ndarray, np.ndarray], float]  # line, areas of extending and retracting: w [m/s]


def velocity_line(crane: cranes.Crane, plane: cranes.Plane, stroke) -> Line:
    """The velocities on the path with the redundant cylinder at a stroke [m]; plane and stroke of one shape."""
    pose = cranes.pose(crane, plane, stroke)
    rest = 0.0 * stroke  # of the shape of all other values
    still, forth = cranes.move(pose, rest, rest), cranes.move(pose, rest + 1.0, rest)
    joint0, cylinder0 = np.array(still.joint_velocity).T, np.array(still.velocity).T
    joint1, cylinder1 = np.array(forth.joint_velocity).T - joint0, np.array(forth.velocity).T - cylinder0
    return Line(joint0, joint1, cylinder0, cylinder1, np.array([length for length, _, _ in pose.cylinders]).T)


def least_velocity(line: Line, variant: str, area_out: np.ndarray, area_in: np.ndarray) -> float:
    """Velocity of the redundant cylinder [m/s] of least norm, limits aside.

    Args:
        line: Velocities on the path at one point.
        variant: A name of `METHODS`.
        area_out, area_in: Weights of extending and retracting cylinders [m^2], (joints,), for "weighted".
    """
    if variant == "joint":
        return float(-(line.joint0 @ line.joint1) / (line.joint1 @ line.joint1))  # min q'q
    a0, a1 = line.cylinder0, line.cylinder1
    if variant == "actuator":
        return float(-(a0 @ a1) / (a1 @ a1))  # min v'v
    # min v'Av, A = A_A H(v) + A_B H(-v), section 6.1 of the 3-DOF paper: convex and smooth in w, quadratic between
    # the velocities at which a cylinder turns round. So iterating the directions is not needed: its slope rises
    # through zero in one piece only.
    moves = np.abs(a1) > SMALL
    turns = np.sort(-a0[moves] / a1[moves])
    v = a0 + a1 * turns[:, None]
    slopes = (np.where(v > 0.0, area_out, area_in) * v) @ a1
    inside = np.concatenate([[turns[0] - 1.0], 0.5 * (turns[1:] + turns[:-1]), [turns[-1] + 1.0]])
    area = np.where(a0 + a1 * inside[int(np.sum(slopes < 0.0))] > 0.0, area_out, area_in)
    return float(-((area * a0) @ a1) / ((area * a1) @ a1))


def velocity_bounds(problem: Problem, line: Line, strokes: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Velocities of the redundant cylinder [m/s] at which no cylinder is faster than allowed.

    Args:
        problem: The discretised task.
        line: Velocities on the path, (..., joints).
        strokes: Least and largest length of the cylinders [m], (2, joints): each also slows down in time to stop
            at its end, |v| <= sqrt(2 a d) in the SNS paper, where its velocity limit leaves that choice.

    Returns:
        Lower and upper bound, (...). Where cylinders contradict each other, both are midway between the two.
    """
    cylinders = problem.crane.machine.cylinders[problem.moving]
    a0, a1 = line.cylinder0[..., problem.moving], line.cylinder1[..., problem.moving]
    fastest = np.array([c.velocity_limit for c in cylinders])
    low, high = _interval(-fastest, fastest, a0, a1)
    between = 0.5 * (low + high)
    low, high = np.minimum(low, between), np.maximum(high, between)
    if strokes is None:
        return low, high
    hardest = 2.0 * np.array([c.acceleration_limit for c in cylinders])
    length, ends = line.length[..., problem.moving], strokes[:, problem.moving]
    slow = _interval(
        -np.sqrt(hardest * np.maximum(length - ends[0], 0.0)),
        np.sqrt(hardest * np.maximum(ends[1] - length, 0.0)),
        a0,
        a1,
    )
    slow_low, slow_high = np.maximum(slow[0], low), np.minimum(slow[1], high)
    kept = slow_low <= slow_high
    return np.where(kept, slow_low, low), np.where(kept, slow_high, high)


def _interval(lower, upper, a0, a1) -> tuple[np.ndarray, np.ndarray]:
    """Velocities w with lower <= a0 + a1 w <= upper for all cylinders; none where the first is above the second."""
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (lower - a0) / a1, (upper - a0) / a1
    return np.minimum(one, other).max(axis=-1), np.maximum(one, other).min(axis=-1)


def viable_strokes(problem: Problem, middle: cranes.Plane, points: list[cranes.Plane]) -> np.ndarray:
    """Strokes from which the redundant cylinder can stay inside the feasible ones to the end, at allowed velocities.

    (q_lim - q) / T looks one interval ahead, too short where the path later moves an end of the feasible strokes
    faster than the cylinders can follow. Going backwards from the last stage, the ends are moved in by the
    distance that the velocity limits fall short. An end that cannot be met is left where it is.

    Args:
        problem: The discretised task, one feasible interval a stage.
        middle: Reference at the middle of the intervals, (stages,).
        points: The same, point by point.

    Returns:
        Least and largest stroke of each stage [m], (stages + 1, 2).
    """
    step = problem.step
    ends = np.stack([problem.lower, problem.upper], axis=1)
    viable = ends.copy()
    for side, sign in ((0, 1.0), (1, -1.0)):  # velocities towards the inside count positive
        reach = velocity_bounds(problem, velocity_line(problem.crane, middle, ends[:-1, side]))[1 - side]
        for k in range(problem.stages - 1, -1, -1):
            target = viable[k + 1, side]
            edge = target - step * reach[k]
            if sign * (edge - ends[k, side]) > 0.0:
                line = velocity_line(problem.crane, points[k], float(edge))
                edge = target - step * float(velocity_bounds(problem, line)[1 - side])
                viable[k, side] = sign * np.fmax(sign * edge, sign * ends[k, side])
    empty = viable[:, 0] > viable[:, 1]
    viable[empty] = ends[empty]
    return viable


def resolve(
    task: Task, start_position: float, variant: str = "actuator", step: float = STEP, rule: Rule | None = None
) -> Motion:
    """The motion that a pseudo-inverse with limits gives along a task's path.

    The velocity of the redundant cylinder is found at the middle of each interval and held over it (midpoint
    rule). With one redundant joint, saturation in the null space has a closed form: all velocities on the path
    lie on a line, the limits cut an interval out of it, and the answer is the point of least norm on that
    interval. The position limits of all joints, (q_lim - q) / T in the SNS paper, are the feasible strokes at the
    end of the interval. They win over velocity limits, and the path over both: the tool is never slowed down.

    Args:
        task: The task.
        start_position: Where the redundant cylinder starts [m].
        variant: "joint" (min q'q), "actuator" (min v'v of the cylinders) or "weighted" (min v'Av).
        step: Interval of the integration [s].
        rule: Another choice than the variant's least norm: from the velocities on the path and the areas of extending
            and retracting cylinders [m^2] to the velocity of the redundant one [m/s], limits aside.

    Returns:
        The motion, its stage velocities the means of the intervals beside them, at rest at both ends.

    Raises:
        InputError: If the variant is unknown.
        InfeasibleError: If some point of the path cannot be reached.
    """
    ranges.one_of("variant", variant, METHODS)
    began = time.perf_counter()
    problem = stages.discretise(task, step)
    step, cylinders = problem.step, problem.crane.machine.cylinders
    middle = cranes.plane(task.machine, sample(task, problem.time[:-1] + 0.5 * step))
    columns = (np.asarray(getattr(middle, field.name)).tolist() for field in fields(middle))
    points = [cranes.Plane(*values) for values in zip(*columns, strict=True)]
    area_out, area_in = np.array([c.areas for c in cylinders]).T
    strokes = _strokes(problem.crane)
    single = all(len(intervals) == 1 for intervals in problem.intervals)
    viable = viable_strokes(problem, middle, points) if single else None
    c, w = float(start_position), 0.0
    speed = np.empty(problem.stages)
    for k, plane in enumerate(points):
        line = velocity_line(problem.crane, plane, c + 0.5 * step * w)
        low, high = velocity_bounds(problem, line, strokes)
        least = rule(line, area_out, area_in) if rule else least_velocity(line, variant, area_out, area_in)
        w = min(max(least, float(low)), float(high))
        low, high = viable[k + 1] if viable is not None else _nearest(problem.intervals[k + 1], c)
        w = min(max(w, float(low - c) / step), float(high - c) / step)
        c += step * w
        speed[k] = w
    velocity = np.concatenate([[0.0], 0.5 * (speed[1:] + speed[:-1]), [0.0]])
    seconds = time.perf_counter() - began
    return motion.from_velocities(
        step, float(start_position), velocity, METHODS[variant], COSTS[variant], solve_s=seconds
    )


def plan(task: Task, cost: str, start: float, tell: Progress = quiet, settings: object = None) -> Motion:
    """The motion of `resolve` that minimises a cost at every instant.

    Args:
        task: The task.
        cost: One of the three of `COSTS`.
        start: Where the redundant cylinder starts [m].
        tell: Not used: it takes a moment.
        settings: Not used; the step is the method's own.
    """
    return resolve(task, start, next(variant for variant, own in COSTS.items() if own == cost))


def baseline(task: Task, start: float, step: float = STEP) -> Evaluation | None:
    """The actuator pseudo-inverse, judged; None where it cannot follow the path.

    Args:
        task: The task.
        start: Where the redundant cylinder starts [m].
        step: Interval of the integration [s]; a short one takes time.
    """
    try:
        judged = evaluate(task, resolve(task, start, "actuator", step))
    except LeanboomError:
        return None
    return judged if judged.followed else None


def _strokes(crane: cranes.Crane) -> np.ndarray:
    """Least and largest length of the cylinders [m], (2, joints)."""
    pairs = zip(crane.machine.cylinders, crane.machine.joints, strict=True)
    ends = [[c.linkage.length_arm_slope(q)[0] for q in (joint.lower, joint.upper)] for c, joint in pairs]
    return np.sort(np.array(ends), axis=1).T


def _nearest(intervals: np.ndarray, stroke: float) -> np.ndarray:
    """The feasible interval a stroke is in or nearest to [m]; intervals are (intervals, 2)."""
    distance = np.maximum(intervals[:, 0] - stroke, stroke - intervals[:, 1])
    return intervals[int(distance.argmin())]
