r"""Pseudo-inverses with limits: the pointwise optimal baselines of both papers.

Least cylinder (or joint) velocities that give the tool its velocity, inside velocity limits: saturation in the null
space (SNS: Flacco, De Luca, Khatib, ICRA 2012) with the weighted pseudo-inverse of eq. (9), 3-DOF paper, carried to
cylinder space as both papers do. A cylinder that would exceed a limit is held at it and the others share the rest;
only if they cannot, the tool slows down.

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
from dataclasses import dataclass, fields

import numpy as np

from leanboom.errors import InfeasibleError, InputError, LeanboomError
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


def sns(
    jacobian: np.ndarray,
    task_velocity: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    weights: np.ndarray | None = None,
) -> tuple[np.ndarray, float]:
    """Joint velocities of least norm for a task, inside a box: saturation in the null space with task scaling.

    The algorithm of the paper saturates the most critical joint until the rest fits, and never frees a joint again.
    That greedy order can miss a velocity that follows the task; then a linear programme finds the largest scale
    and saturated joints that pull the wrong way are freed, so a scale below 1 means that the box has no better.
    Otherwise its answer is returned as it is; with two or more redundant joints its norm need not be the least.

    Args:
        jacobian: Task velocity per joint velocity, (tasks, joints), tasks <= joints, full rank.
        task_velocity: Wanted task velocity, (tasks,).
        lower: Least joint velocities [rad/s or m/s], (joints,).
        upper: Largest joint velocities, (joints,).
        weights: Diagonal of the weights W of the norm q' W q, above 0, (joints,); None: all 1.

    Returns:
        The joint velocities, (joints,), and the scale in [0, 1] of the task velocity that they give.

    Raises:
        InputError: If shapes do not fit, the jacobian lacks rank, a weight is not positive, or bounds contradict.
        InfeasibleError: If not even scale 0 is inside the box.
    """
    jacobian = np.atleast_2d(np.asarray(jacobian, dtype=np.float64))
    rows, joints = jacobian.shape
    wanted = np.asarray(task_velocity, dtype=np.float64).reshape(-1)
    lower, upper = np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64)
    inverse = 1.0 / np.asarray(np.ones(joints) if weights is None else weights, dtype=np.float64)
    if wanted.shape != (rows,) or lower.shape != (joints,) or upper.shape != (joints,) or inverse.shape != (joints,):
        raise InputError(
            f"jacobian is {rows}x{joints}; needs a task velocity of {rows} and bounds and weights of {joints} values"
        )
    if not np.all((inverse > 0.0) & np.isfinite(inverse)):
        raise InputError("weights must be above 0")
    if np.linalg.matrix_rank(jacobian) < rows:
        raise InputError("the rows of the jacobian depend on each other")
    if np.any(lower > upper):
        raise InputError(f"lower bound of joint {int(np.argmax(lower > upper))} is above its upper bound")
    free = np.ones(joints)  # the diagonal matrix W of the SNS paper: 0 where a joint is saturated
    held = np.zeros(joints)  # velocities of saturated joints
    best = 0.0, free.copy(), held.copy()
    while True:
        right = _right_inverse(jacobian, inverse * free)
        along = right @ wanted
        offset = held - right @ (jacobian @ held)
        velocity = along + offset
        outside = np.maximum(lower - velocity, velocity - upper) > SMALL
        if not outside.any():
            return np.clip(velocity, lower, upper), 1.0
        scale, critical = _task_scale(along, offset, lower, upper)
        if scale > best[0]:
            best = scale, free.copy(), held.copy()
        free[critical] = 0.0
        held[critical] = upper[critical] if velocity[critical] > upper[critical] else lower[critical]
        if np.linalg.matrix_rank(jacobian * free) < rows:
            break
    return _scaled(jacobian, wanted, lower, upper, inverse, best)


def _right_inverse(jacobian: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """Weighted right pseudo-inverse, eq. (9) of the 3-DOF paper; `inverse` is the diagonal of W^-1, (joints,)."""
    weighted = inverse[:, None] * jacobian.T
    return weighted @ np.linalg.inv(jacobian @ weighted)


def _task_scale(along, offset, lower, upper) -> tuple[float, int]:
    """Largest task scale at which along x scale + offset is inside the box, and the joint that limits it most."""
    least, most = np.zeros(along.size), np.full(along.size, np.inf)
    moves = np.abs(along) > SMALL
    ends = np.stack([lower - offset, upper - offset])[:, moves] / along[moves]
    least[moves], most[moves] = ends.min(axis=0), ends.max(axis=0)
    # A joint that the task does not move can only be critical by itself.
    stuck = ~moves & (np.maximum(lower - offset, offset - upper) > SMALL)
    most[stuck] = -1.0
    critical = int(np.argmin(most))
    scale = min(float(most[critical]), 1.0)
    if scale < 0.0 or least.max() > scale:
        return 0.0, critical
    return scale, critical


def _scaled(jacobian, wanted, lower, upper, inverse, greedy) -> tuple[np.ndarray, float]:
    """The answer after the greedy saturation has used up its joints: its best scale, or a larger one if there is."""
    from scipy.optimize import linprog  # slow to import and rarely needed

    rows, joints = jacobian.shape
    answer = linprog(
        np.append(np.zeros(joints), -1.0),
        A_eq=np.hstack([jacobian, -wanted[:, None]]),
        b_eq=np.zeros(rows),
        bounds=[*zip(lower, upper, strict=True), (0.0, 1.0)],
    )
    if answer.x is None:
        raise InfeasibleError("no velocity inside the bounds moves the tool along its task or holds it still")
    scale, free, held = greedy
    if scale > 0.0 and answer.x[-1] <= scale + 1e-9:
        right = _right_inverse(jacobian, inverse * free)
        velocity = held + right @ (scale * wanted - jacobian @ held)
        return np.clip(velocity, lower, upper), scale
    vertex = np.clip(answer.x[:-1], lower, upper)
    return _least_norm(jacobian, lower, upper, inverse, vertex), float(answer.x[-1])


def _least_norm(jacobian, lower, upper, inverse, velocity) -> np.ndarray:
    """Least norm inside the box among the velocities that move the tool as a given one does (active-set method)."""
    weights = 1.0 / inverse
    held = (velocity <= lower + SMALL) | (velocity >= upper - SMALL)
    for _ in range(20 * velocity.size):
        columns = jacobian[:, ~held]
        _, values, rows = np.linalg.svd(columns) if columns.size else (None, np.zeros(0), np.zeros((0, 0)))
        null = rows[int(np.sum(values > 1e-10)) :].T  # motions of the free joints that leave the tool alone
        step = np.zeros_like(velocity)
        if null.size:
            curvature = null.T @ (weights[~held, None] * null)
            step[~held] = -null @ np.linalg.solve(curvature, null.T @ (weights * velocity)[~held])
        if np.max(np.abs(step), initial=0.0) > SMALL:
            room = np.where(step > 0.0, upper - velocity, lower - velocity)
            share = np.where(np.abs(step) > SMALL, room / np.where(step == 0.0, 1.0, step), np.inf)
            first = int(np.argmin(share))
            velocity = velocity + min(1.0, float(share[first])) * step
            if share[first] <= 1.0:
                held[first] = True
            continue
        # Multipliers of the held joints: free the one that is pulled inwards most.
        gradient = weights * velocity
        dual = np.linalg.lstsq(columns.T, gradient[~held], rcond=None)[0] if columns.size else np.zeros(len(jacobian))
        pull = (gradient - jacobian.T @ dual) * np.where(velocity <= lower + SMALL, -1.0, 1.0)
        pull[~held | (upper - lower <= SMALL)] = 0.0
        if pull.max() <= 1e-10:
            break
        held[int(np.argmax(pull))] = False
    return np.clip(velocity, lower, upper)


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """All velocities that keep the tool on its path: affine in the redundant cylinder's. Arrays are (..., joints)."""

    joint0: np.ndarray  # joint velocities at w = 0 [rad/s, m/s]
    joint1: np.ndarray  # and per w
    cylinder0: np.ndarray  # a0, cylinder velocities at w = 0 [m/s]
    cylinder1: np.ndarray  # a1, and per w
    length: np.ndarray  # cylinder lengths [m]


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


def resolve(task: Task, start_position: float, variant: str = "actuator", step: float = STEP) -> Motion:
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
        least = least_velocity(line, variant, area_out, area_in)
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
