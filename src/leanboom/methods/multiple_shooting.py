r"""Direct multiple shooting of the full-dimensional problem: the local direct method that stands for fmincon.

Eqs. (11)-(15), 3-DOF paper, whose summed cost is eq. (16): states are positions and velocities of all joints,
controls their accelerations. Nothing is known of redundancy here; the tool stays on its path by an equality
constraint at every stage. One Runge-Kutta step a stage integrates the double integrators exactly. The states are
variables as well ("multiple" shooting), with the same solutions as when only the controls are, and sparse equations.

The path is kept in velocity form, x' = r', with the position error fed back so that it cannot drift,

    J(q) q' - r' - (r - x(q)) / t_r = 0.

The position form, eq. (14), leaves velocities undamped between the stages where accelerations are constant on them.
The tool is measured in the coordinates of the slewing crane: radius, height and base angle.

Costs are smoothed as in `pseudospectral`, limits between the stages tightened likewise. The start is the actuator
pseudo-inverse.

| symbol | name | unit |
| --- | --- | --- |
| q, v, u | joint positions, velocities, accelerations | rad or m, /s, /s^2 |
| x, r | tool by forward kinematics, tool on its path | m, m, rad |
| t_r | time in which a position error decays | s |
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from leanboom.errors import LeanboomError
from leanboom.evaluation.evaluate import evaluate
from leanboom.formulas import kinematics
from leanboom.methods import pseudo_inverse, smoothed_nlp
from leanboom.methods.smoothed_nlp import Attempt, Level, Tightening
from leanboom.model import crane as cranes
from leanboom.model import motion
from leanboom.model.motion import Motion
from leanboom.model.task import Task
from leanboom.problem import stages
from leanboom.progress import Progress, quiet

METHOD = "shooting"
STEP = 0.05  # [s]
RETURN = 0.5  # [s], t_r
LEVELS = {
    "cp": (Level(500.0, 1.0, 0.1), Level(2000.0, 1.0, 0.01)),
    "ls": (Level(200.0, 1.0, 1.0), Level(500.0, 1.0, 0.1), Level(1000.0, 0.1, 0.03)),
}


def plan(task: Task, cost: str, start: float, tell: Progress = quiet, settings: object = None) -> Motion:
    """Plan a task by direct multiple shooting in all joints, from the actuator pseudo-inverse.

    Args:
        task: The task.
        cost: "ls" or "cp".
        start: Where the redundant cylinder starts [m].
        tell: Called with what happens and the share done.
        settings: Not used; steps and smoothing are the method's own.

    Returns:
        The motion of the redundant cylinder: of the solves that converged, the cheapest by the judge that keeps all
        limits. Its status is `solved`; or the limit that even the best of them violates; or, if none converged, how
        IPOPT ended, and then the motion is no result. Its log has a line a solve.

    Raises:
        InfeasibleError: If some point of the path cannot be reached.
    """
    began = time.perf_counter()
    work = _prepare(stages.discretise(task, STEP), cost)
    first = _first_guess(work.problem, start)

    def solve(level: Level, guess: Attempt | None, tightening: Tightening) -> Attempt:
        answer = _solve(work, level, first if guess is None else guess.answer.values, tightening)
        return Attempt(evaluate(task, _motion(work.problem, answer.values, cost)), answer, work.problem.time)

    result = smoothed_nlp.bootstrap(LEVELS[cost], solve, _tightening, cost, tell)
    return replace(result, solve_s=time.perf_counter() - began)


@dataclass(frozen=True, slots=True, eq=False)
class _Work:
    """The assembled program of a task. A node has x = (q, v, u), p = (path in the plane, weight, s, e, damping)."""

    problem: stages.Problem
    program: Any
    reference: np.ndarray  # (stages + 1, 9)


def _prepare(problem: stages.Problem, cost: str) -> _Work:
    joints = len(problem.crane.machine.joints)
    functions = smoothed_nlp.node_functions(3 * joints, 13, _node(problem.crane, cost))
    program = smoothed_nlp.assemble(functions, problem.stages + 1, integrators(problem.stages, joints, problem.step))
    columns = [getattr(problem.plane, field.name) for field in fields(problem.plane)]
    return _Work(problem, program, np.stack(np.broadcast_arrays(*columns), axis=1))


def integrators(count: int, joints: int, step: float) -> tuple:
    """Linear equations of a Runge-Kutta step a stage, exact for q'' = u, for `smoothed_nlp.assemble`.

    Args:
        count: Number of stages.
        joints: Number of joints; a node's variables are their q, their v, their u.
        step: Length of a stage [s].
    """
    node, joint = (index.ravel() for index in np.meshgrid(np.arange(count), np.arange(joints), indexing="ij"))
    here, there = 3 * joints * node + joint, 3 * joints * (node + 1) + joint
    row, second = joints * node + joint, joints * count
    terms = (
        (row, there, 1.0),
        (row, here, -1.0),
        (row, here + joints, -step),
        (row, here + 2 * joints, -0.5 * step * step),
        (second + row, there + joints, 1.0),
        (second + row, here + joints, -1.0),
        (second + row, here + 2 * joints, -step),
    )
    rows, columns, values = zip(*((r, c, np.full(r.size, value)) for r, c, value in terms), strict=True)
    return 2 * second, np.concatenate(rows), np.concatenate(columns), np.concatenate(values)


def forward(crane: cranes.Crane, q: list, v: list, u: list) -> cranes.Plane:
    """The tool of given joint motion in the boom's plane: eqs. (4)-(9); eqs. (5)-(8), 3-DOF.

    Args:
        crane: The crane.
        q, v, u: Positions, velocities and accelerations of all joints, in joint order.
    """
    g = crane.machine.geometry
    (q2, q3, q4), (v2, v3, v4), (u2, u3, u4) = q[-3:], v[-3:], u[-3:]
    r, z = kinematics.tool_point(q2, q3, q4, g.base_x, g.base_z, g.boom, g.offset, g.outer)
    r2, r3, r4, z2, z3, z4 = kinematics.jacobian(q2, q3, q4, g.boom, g.offset, g.outer)
    br, bz = kinematics.velocity_product(q2, q3, q4, v2, v3, v4, g.boom, g.offset, g.outer)
    vr, vz = r2 * v2 + r3 * v3 + r4 * v4, z2 * v2 + z3 * v3 + z4 * v4
    ar, az = r2 * u2 + r3 * u3 + r4 * u4 + br, z2 * u2 + z3 * u3 + z4 * u4 + bz
    q1, v1, u1 = (q[0], v[0], u[0]) if g.slewing else (0.0, 0.0, 0.0)
    return cranes.Plane(r, z, vr, vz, ar, az, q1, v1, u1)


def _node(crane: cranes.Crane, cost: str) -> Callable[[Any, Any], tuple[Any, Any]]:
    """Cost and rows of a node: path in velocity form, then cylinder velocities and accelerations."""
    import casadi as ca

    joints, slewing = len(crane.machine.joints), crane.machine.geometry.slewing

    def node(x, p):
        q, v, u = ([x[k * joints + i] for i in range(joints)] for k in range(3))
        tool = forward(crane, q, v, u)
        # The inverse kinematics of this pose gives q back: the crane's one model serves here as well.
        pose = cranes.pose(crane, tool, crane.ratio * q[-1])
        state = cranes.move(pose, crane.ratio * v[-1], crane.ratio * u[-1])
        path = [tool.vr - p[2] - (p[0] - tool.r) / RETURN, tool.vz - p[3] - (p[1] - tool.z) / RETURN]
        if slewing:
            path.append(tool.v1 - p[7] - (p[6] - tool.q1) / RETURN)
        power = smoothed_nlp.smooth_power(crane, pose, state, cost, p[10], p[11])
        return p[9] * (power + p[12] * state.acceleration[-1] ** 2), ca.vertcat(
            *path, *state.velocity, *state.acceleration
        )

    return node


def _complete(problem: stages.Problem, c: np.ndarray, w: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Variables of all nodes, (stages + 1, 3 joints), from the motion of the redundant cylinder there."""
    pose = cranes.pose(problem.crane, problem.plane, c)
    moving = cranes.move(pose, w, u)
    q = (problem.plane.q1, *pose.q) if problem.crane.machine.geometry.slewing else pose.q
    return np.stack([*q, *moving.joint_velocity, *moving.joint_acceleration], axis=1)


def _first_guess(problem: stages.Problem, start: float) -> np.ndarray:
    """The actuator pseudo-inverse, or a held extension where it finds no way."""
    try:
        seed = pseudo_inverse.resolve(problem.task, start, "actuator")
        c, w, u = seed.at(problem.time)
    except LeanboomError:
        c = np.clip(start, problem.lower, problem.upper)
        w = u = np.zeros_like(c)
    c[0], w[0] = start, 0.0
    return _complete(problem, c, w, u)


def _motion(problem: stages.Problem, values: np.ndarray, cost: str) -> Motion:
    ratio, joints = problem.crane.ratio, values.shape[1] // 3
    velocity = ratio * values[:, 2 * joints - 1]
    return motion.from_velocities(problem.step, ratio * float(values[0, joints - 1]), velocity, METHOD, cost)


def _solve(work: _Work, level: Level, guess: np.ndarray, tightening: Tightening) -> smoothed_nlp.Answer:
    """Solve from a guess, (stages + 1, 3 joints), limits tightened by the results of `_tightening`."""
    problem = work.problem
    machine, count = problem.crane.machine, problem.stages + 1
    joints = len(machine.joints)
    smoothing = [level.sharpness, level.maximum, level.damping]
    weight = np.append(np.full(count - 1, problem.step), 0.0)  # eq. (16)
    parameters = np.column_stack([work.reference, weight, np.tile(smoothing, (count, 1))])
    lower = np.tile([joint.lower for joint in machine.joints], (count, 1))
    upper = np.tile([joint.upper for joint in machine.joints], (count, 1))
    velocity = np.tile([c.velocity_limit for c in machine.cylinders], (count, 1))
    acceleration = np.tile([c.acceleration_limit for c in machine.cylinders], (count, 1))
    if tightening is not None:
        lower, upper = lower + tightening[0], upper - tightening[1]
        velocity, acceleration = velocity - tightening[2], acceleration - tightening[3]
    free = np.full((count, 2 * joints), np.inf)  # joint velocities and accelerations: their cylinders have the limits
    low, high = np.hstack([lower, -free]), np.hstack([upper, free])
    low[0, :joints] = high[0, :joints] = guess[0, :joints]
    low[[0, -1], joints : 2 * joints] = high[[0, -1], joints : 2 * joints] = 0.0
    low[-1, 2 * joints :] = high[-1, 2 * joints :] = 0.0
    path = np.zeros((count, joints - 1))
    path[[0, -1]] = np.inf  # crane and path are at rest there; nothing is free to correct the position
    rows = np.hstack([path, velocity, acceleration])
    return smoothed_nlp.optimise(work.program, guess, parameters, (low, high), (-rows, rows))


def _tightening(attempt: Attempt) -> Tightening:
    """Constraint tightening at the stages; None where no limit is exceeded.

    Returns:
        Lower and upper joint positions, cylinder velocities, cylinder accelerations, each (stages + 1, joints).
    """
    judged = attempt.judged
    joints = judged.task.machine.joints
    lower, upper = (np.array([getattr(joint, end) for joint in joints]) for end in ("lower", "upper"))
    least = 0.5 * (smoothed_nlp.USABLE_SHARE - 1.0) * (upper - lower)
    positions = [
        smoothed_nlp.around(
            np.where(outside > least, smoothed_nlp.TIGHTENING * outside, 0.0), judged.time, attempt.nodes
        )
        for outside in (lower - judged.joint_position, judged.joint_position - upper)
    ]
    amounts = (*positions, *smoothed_nlp.exceeded(judged, attempt.nodes))
    return None if judged.feasible or not any(np.any(amount > 0.0) for amount in amounts) else amounts
