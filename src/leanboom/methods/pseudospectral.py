r"""Pseudospectral collocation of the low-dimensional problem: the local direct method that stands for DIDO.

State (c, w) and control u of the redundant cylinder, eqs. (30)-(35), 4-DOF paper, with the smoothed costs of both
papers: Heaviside steps by eq. (39) (eq. (29), 3-DOF), maxima by eq. (42) (eq. (36), 3-DOF). Between the corners of
the path the state is one polynomial through Legendre-Gauss-Radau points; dynamics, cost and limits are imposed at
the points. As in section 6.1 of the 3-DOF paper the solution on few points is the guess for more of them
("bootstrapping"); here the smoothing is sharpened along, because from a sharp cost IPOPT does not converge.

A limit kept at the points may be exceeded between them. The judge says where and by how much; there the limits at
the neighbouring points are tightened and the last problem is solved again.

| symbol | name | unit |
| --- | --- | --- |
| c, w, u | position, velocity, acceleration of the redundant cylinder | m, m/s, m/s^2 |
| tau | time scaled to [-1, 1] | 1 |
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from leanboom.evaluation.evaluate import evaluate
from leanboom.methods import smoothed_nlp
from leanboom.methods.smoothed_nlp import Attempt, Level, Tightening
from leanboom.model import crane as cranes
from leanboom.model import motion
from leanboom.model.motion import Motion
from leanboom.model.task import Lines, Task, sample
from leanboom.problem import feasible_strokes, stages
from leanboom.progress import Progress, quiet

METHOD = "pseudospectral"
STEP = 0.01  # [s], stages of the resulting motion

# Nodes of section 6.1, 3-DOF paper, and "a higher number" for LS. The damping ends below 0.1 % of the energy; without
# it the control swings between the nodes wherever the cost does not depend on it. From the s = 20000 s/m and
# e = 1e-6 of the papers IPOPT does not converge.
LEVELS = {
    "cp": (
        Level(500.0, 1.0, 1.0, nodes=20),
        Level(1000.0, 1.0, 0.1, nodes=30),
        Level(2000.0, 1.0, 0.01, nodes=60),
        Level(5000.0, 1.0, 0.01, nodes=90),
    ),
    "ls": (
        Level(500.0, 1.0, 1.0, nodes=20),
        Level(500.0, 1.0, 0.3, nodes=30),
        Level(500.0, 1.0, 0.1, nodes=60),
        Level(1000.0, 0.1, 0.03, nodes=90),
        Level(2000.0, 0.01, 0.01, nodes=120),
    ),
}


# Legendre-Gauss-Radau points.


def radau(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Legendre-Gauss-Radau points with the end added.

    Args:
        count: Number of points, at least 2.

    Returns:
        Points and the end, tau in [-1, 1], (count + 1,); weights of the points, (count,); differentiation matrix,
        (count, count + 1), exact for polynomials up to degree `count`.
    """
    from scipy.special import roots_jacobi

    inner, weights = roots_jacobi(count - 1, 0.0, 1.0)
    tau = np.concatenate([[-1.0], inner, [1.0]])
    weights = np.concatenate([[2.0 / count**2], weights / (1.0 + inner)])
    difference = tau[:, None] - tau
    np.fill_diagonal(difference, 1.0)
    matrix = barycentric(tau)[None, :] / barycentric(tau)[:, None] / difference
    np.fill_diagonal(matrix, 0.0)
    np.fill_diagonal(matrix, -matrix.sum(axis=1))
    return tau, weights, matrix[:-1]


def barycentric(tau: np.ndarray) -> np.ndarray:
    """Barycentric weights of nodes in [-1, 1], (nodes,), up to a common factor."""
    difference = 2.0 * (tau[:, None] - tau)  # the interval's capacity is 1/2: products stay near 1
    np.fill_diagonal(difference, 1.0)
    return 1.0 / difference.prod(axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Points in time, one polynomial between neighbouring edges; neighbours share the point at their edge."""

    edges: np.ndarray  # [s], (polynomials + 1,)
    counts: tuple[int, ...]  # points of each polynomial, its end left out
    time: np.ndarray  # points and the end of the path [s], (nodes,)
    weight: np.ndarray  # of the points in an integral, 0 at the end [s], (nodes,)
    derivative: tuple[np.ndarray, np.ndarray, np.ndarray]  # row, column, value [1/s] of the differentiation matrix

    def at(self, values: np.ndarray, time: np.ndarray) -> np.ndarray:
        """The polynomials through values at the nodes, (nodes,), at given times [s], (times,)."""
        result, first = np.empty_like(time), 0
        for begin, end, count in zip(self.edges[:-1], self.edges[1:], self.counts, strict=True):
            inside = (time >= begin) & (time <= end)
            at = 2.0 * (time[inside] - begin) / (end - begin) - 1.0
            result[inside] = interpolate(radau(count)[0], values[first : first + count + 1], at)
            first += count
        return result


def mesh(edges: np.ndarray, nodes: int) -> Mesh:
    """About `nodes` points, shared out among the polynomials by their duration.

    Args:
        edges: Where polynomials begin and end [s], (polynomials + 1,).
        nodes: Number of points.
    """
    counts = np.maximum(3, np.round(nodes * np.diff(edges) / (edges[-1] - edges[0]))).astype(int)
    times, weights, rows, columns, values, first = [], [], [], [], [], 0
    for begin, end, count in zip(edges[:-1], edges[1:], counts, strict=True):
        tau, weight, matrix = radau(int(count))
        half = 0.5 * (end - begin)
        row, column = np.nonzero(matrix)
        times.append(begin + half * (tau[:-1] + 1.0))
        weights.append(half * weight)
        rows.append(first + row)
        columns.append(first + column)
        values.append(matrix[row, column] / half)
        first += count
    return Mesh(
        edges,
        tuple(int(count) for count in counts),
        np.append(np.concatenate(times), edges[-1]),
        np.append(np.concatenate(weights), 0.0),
        (np.concatenate(rows), np.concatenate(columns), np.concatenate(values)),
    )


def double_integrator(points: Mesh, size: int) -> tuple:
    """Linear equations c' = w, w' = u at the points of a mesh, for `assemble`; c, w, u lead each node's variables."""
    row, column, value = points.derivative
    count = points.time.size - 1
    node = np.arange(count)
    ones = np.ones(count)
    return (
        2 * count,
        np.concatenate([row, node, count + row, count + node]),
        np.concatenate([size * column, size * node + 1, size * column + 1, size * node + 2]),
        np.concatenate([value, -ones, value, -ones]),
    )


def interpolate(tau: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The polynomial through values at nodes, (nodes,), at given places, (places,)."""
    difference = at[:, None] - tau
    nearest = np.abs(difference).argmin(axis=1)
    hit = np.abs(difference[np.arange(at.size), nearest]) < 1e-13
    difference[hit] = 1.0
    kernel = barycentric(tau) / difference
    return np.where(hit, values[nearest], (kernel @ values) / kernel.sum(axis=1))


# The crane's problem on these points.


def plan(task: Task, cost: str, start: float, tell: Progress = quiet, settings: object = None) -> Motion:
    """Plan a task by bootstrapped pseudospectral collocation, from a held extension as the first guess.

    Args:
        task: The task.
        cost: "ls" or "cp".
        start: Where the redundant cylinder starts [m].
        tell: Called with what happens and the share done.
        settings: Not used; nodes and smoothing are the method's own.

    Returns:
        The motion on stages of `STEP`: of the levels that converged, the cheapest by the judge that keeps all limits.
        Its status is `solved`; or the limit that even the best of them violates; or, if no level converged, how IPOPT
        ended, and then the motion is no result. Its log has a line a solve.

    Raises:
        InfeasibleError: If some point of the path cannot be reached.
    """
    began = time.perf_counter()
    problem = stages.discretise(task, STEP)
    functions = smoothed_nlp.node_functions(3, 13, _node(problem.crane, problem.moving, cost))
    corners = np.cumsum(task.path.durations) if isinstance(task.path, Lines) else np.array([task.duration])
    edges = np.concatenate([[0.0], corners])

    def solve(level: Level, guess: Attempt | None, tightening: Tightening) -> Attempt:
        return _solve(problem, functions, mesh(edges, level.nodes), level, seed(guess), tightening)

    def seed(guess: Attempt | None) -> Motion:
        if guess is not None:
            return guess.judged.motion
        held = np.clip(start, problem.lower, problem.upper)
        held[0] = start
        return motion.make(problem.step, held, 0.0 * held, 0.0 * held[1:], METHOD, cost)

    result = smoothed_nlp.bootstrap(LEVELS[cost], solve, lambda attempt: _tightening(problem, attempt), cost, tell)
    return replace(result, solve_s=time.perf_counter() - began)


def _node(crane: cranes.Crane, moving: slice, cost: str) -> Callable[[Any, Any], tuple[Any, Any]]:
    """Cost and rows of a node: x = (c, w, u), p = (reference in the boom's plane, weight, s, e, damping)."""
    import casadi as ca

    def node(x, p):
        pose = cranes.pose(crane, cranes.Plane(*[p[i] for i in range(9)]), x[0])
        state = cranes.move(pose, x[1], x[2])
        # The redundant cylinder comes last; its limits are bounds.
        rows = ca.vertcat(*state.velocity[moving][:-1], *state.acceleration[moving][:-1])
        power = smoothed_nlp.smooth_power(crane, pose, state, cost, p[10], p[11])
        return p[9] * (power + p[12] * x[2] * x[2]), rows

    return node


def _solve(
    problem: stages.Problem,
    functions: smoothed_nlp.NodeFunctions,
    points: Mesh,
    level: Level,
    guess: Motion,
    tightening: Tightening,
) -> Attempt:
    """Solve one level from a guess that starts where the motion shall, limits tightened as `_tightening` says."""
    count = points.time.size
    plane = cranes.plane(problem.task.machine, sample(problem.task, points.time))
    columns = [getattr(plane, field.name) for field in fields(plane)]
    columns += [points.weight, level.sharpness, level.maximum, level.damping]
    parameters = np.stack(np.broadcast_arrays(*columns), axis=1)
    cylinders = problem.crane.machine.cylinders[problem.moving]
    velocity = np.tile([c.velocity_limit for c in cylinders], (count, 1))
    acceleration = np.tile([c.acceleration_limit for c in cylinders], (count, 1))
    lowest = np.interp(points.time, problem.time, problem.lower)
    highest = np.interp(points.time, problem.time, problem.upper)
    if tightening is not None:
        lowest, highest = lowest + tightening[0][:, 0], highest - tightening[0][:, 1]
        velocity, acceleration = velocity - tightening[1], acceleration - tightening[2]
    low = np.stack([lowest, -velocity[:, -1], -acceleration[:, -1]], axis=1)
    high = np.stack([highest, velocity[:, -1], acceleration[:, -1]], axis=1)
    start = float(guess.position[0])
    low[0, 0] = high[0, 0] = start
    low[[0, -1], 1] = high[[0, -1], 1] = 0.0
    low[-1, 2] = high[-1, 2] = 0.0  # the end is no point: nothing depends on its control
    rows = np.concatenate([velocity[:, :-1], acceleration[:, :-1]], axis=1)
    first = np.stack(guess.at(points.time), axis=1)
    program = smoothed_nlp.assemble(functions, count, double_integrator(points, 3))
    answer = smoothed_nlp.optimise(program, first, parameters, (low, high), (-rows, rows))
    speed = points.at(answer.values[:, 1], problem.time)
    speed[[0, -1]] = 0.0
    found = motion.from_velocities(problem.step, start, speed, METHOD, guess.cost)
    return Attempt(evaluate(problem.task, found), answer, points.time)


def _tightening(problem: stages.Problem, attempt: Attempt) -> Tightening:
    """Constraint tightening at the nodes; None where no limit is exceeded.

    Returns:
        Lower and upper position [m], (nodes, 2); velocities [m/s] and accelerations [m/s^2], (nodes, moving).
    """
    judged = attempt.judged
    c = judged.length[:, -1]
    below = np.interp(judged.time, problem.time, problem.lower) - c
    outside = np.stack([below, c - np.interp(judged.time, problem.time, problem.upper)], axis=1)
    least = 0.5 * (smoothed_nlp.USABLE_SHARE - 1.0) * np.ptp(feasible_strokes.stroke_range(problem.task))
    position = smoothed_nlp.around(
        np.where(outside > least, smoothed_nlp.TIGHTENING * outside, 0.0), judged.time, attempt.nodes
    )
    velocity, acceleration = smoothed_nlp.exceeded(judged, attempt.nodes)
    amounts = position, velocity[:, problem.moving], acceleration[:, problem.moving]
    return None if judged.feasible or not any(np.any(amount > 0.0) for amount in amounts) else amounts
