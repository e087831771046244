r"""Pseudospectral collocation of the low-dimensional problem: the local direct method that stands for DIDO.

State (c, w) and control u of the redundant cylinder, eqs. (30)-(35), 4-DOF paper, with the smoothed costs of both
papers: Heaviside steps by eq. (39) (eq. (29), 3-DOF), maxima by eq. (42) (eq. (36), 3-DOF). Between the corners of
the path the state is one polynomial through Legendre-Gauss-Radau points; dynamics, cost and limits are imposed at
the points. As in section 6.1 of the 3-DOF paper the solution on few points is the guess for more of them
("bootstrapping"); here the smoothing is sharpened along, because from a sharp cost IPOPT does not converge.

A limit kept at the points may be exceeded between them. The judge says where and by how much; there the limits at
the neighbouring points are drawn in and the last problem is solved again.

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

from leanboom import crane as cranes
from leanboom import direct, motion, stages
from leanboom.direct import Progress
from leanboom.errors import InputError
from leanboom.judge import Evaluation, evaluate
from leanboom.motion import Motion
from leanboom.task import Lines, Task, sample

METHOD = "pseudospectral"
STEP = 0.01  # [s], stages of the resulting motion
REPAIRS = 4  # solves with limits drawn in where they are exceeded between the nodes
CALMED = 3.0  # and with the damping raised by this factor, because a swing between nodes touches no limit at them
DRAWN = 1.2  # limits are drawn in by this share of what they are exceeded by


@dataclass(frozen=True, slots=True)
class Level:
    """One solve of a bootstrapped sequence: how finely, how sharply."""

    nodes: int
    sharpness: float  # s of eq. (39) [s/m]; [1/kW] where the step is over a cylinder's power
    maximum: float  # e of eq. (42) [MPa^2]
    damping: float  # weight of the squared control [kW s^4/m^2]: 1 m/s^2 costs as much as that power


# Nodes of section 6.1, 3-DOF paper, "a higher number" for LS. The damping ends below 0.02 % of the energy; without it
# the control swings between the nodes wherever the cost does not depend on it. The papers' s = 20000 s/m and
# e = 1e-6 are where IPOPT stops converging.
LEVELS = {
    "cp": (
        Level(20, 500.0, 1.0, 1.0),
        Level(30, 1000.0, 1.0, 0.1),
        Level(60, 2000.0, 1.0, 0.01),
        Level(90, 5000.0, 1.0, 0.01),
    ),
    "ls": (
        Level(20, 500.0, 1.0, 1.0),
        Level(30, 500.0, 1.0, 0.3),
        Level(60, 500.0, 1.0, 0.1),
        Level(90, 1000.0, 0.1, 0.03),
        Level(120, 2000.0, 0.01, 0.01),
    ),
}


# Legendre-Gauss-Radau points.


def radau(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Legendre-Gauss-Radau points with the end added.

    Args:
        count: Number of points.

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


@dataclass(frozen=True, slots=True, eq=False)
class _Work:
    """A task made ready for collocation."""

    task: Task
    cost: str
    start: float
    problem: stages.Problem  # on the stages of the resulting motion
    functions: direct.NodeFunctions
    edges: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    """A level's motion, judged, and how IPOPT ended."""

    judged: Evaluation
    points: Mesh
    converged: bool
    text: str


def plan(task: Task, cost: str, start: float, progress: Progress | None = None) -> Motion:
    """Plan a task by bootstrapped pseudospectral collocation, from a held extension as the first guess.

    Args:
        task: The task.
        cost: "ls" or "cp".
        start: Where the redundant cylinder starts [m].
        progress: Called with what happens and the share done.

    Returns:
        The motion on stages of `STEP`: of the levels that converged, the cheapest by the judge that keeps all limits.
        Its status is `solved`; or the limit that even the best of them violates; or, if no level converged, how IPOPT
        ended, and then the motion is no result. Its log has a line a solve.

    Raises:
        InputError: If the cost is another one.
        InfeasibleError: If some point of the path cannot be reached.
    """
    if cost not in LEVELS:
        raise InputError(f"method {METHOD} minimises {' or '.join(LEVELS)}, not {cost}")
    began = time.perf_counter()
    tell = progress or (lambda text, share: None)
    problem = stages.discretise(task, STEP)
    functions = direct.node_functions(3, 13, _node(problem.crane, problem.moving, cost))
    corners = np.cumsum(task.path.durations) if isinstance(task.path, Lines) else np.array([task.duration])
    work = _Work(task, cost, start, problem, functions, np.concatenate([[0.0], corners]))
    held = np.clip(start, problem.lower, problem.upper)
    guess = motion.make(problem.step, held, 0.0 * held, 0.0 * held[1:], METHOD, cost)
    best, last, log = None, None, []
    # The last level again and again while there is a limit to be drawn in.
    finest = LEVELS[cost][-1]
    repairs = [replace(finest, damping=finest.damping * CALMED**n) for n in range(1, REPAIRS + 1)]
    levels = (*LEVELS[cost], *repairs)
    drawn = None
    for i, level in enumerate(levels):
        if i >= len(LEVELS[cost]):
            assert last is not None
            drawn = _draw_in(work, last, drawn)
            if drawn is None:
                break
        tell(f"{level.nodes} nodes", min(1.0, i / len(LEVELS[cost])))
        last = _solve(work, level, guess, drawn)
        guess = last.judged.motion  # also unconverged: the next level may do better from there
        log.append(
            f"{time.perf_counter() - began:6.2f} s  {last.points.time.size - 1} nodes, s = {level.sharpness:g} s/m: "
            f"{last.text}, judged {last.judged.energy(cost) / 1e3:.4f} kJ, {last.judged.status}"
        )
        if last.converged and (best is None or direct.better(last.judged, best, cost)):
            best = last.judged
    assert last is not None
    result = replace(guess, status=f"not converged: {last.text}") if best is None else best.motion
    if best is not None and not best.feasible:
        result = replace(result, status=best.status)
    tell("done", 1.0)
    return replace(result, solve_s=time.perf_counter() - began, log=tuple(log))


def _node(crane: cranes.Crane, moving: slice, cost: str) -> Callable[[Any, Any], tuple[Any, Any]]:
    """Cost and rows of a node: x = (c, w, u), p = (reference in the boom's plane, weight, s, e, damping)."""
    import casadi as ca

    def node(x, p):
        pose = cranes.pose(crane, cranes.Plane(*[p[i] for i in range(9)]), x[0])
        state = cranes.move(pose, x[1], x[2])
        # The redundant cylinder comes last; its limits are bounds.
        rows = ca.vertcat(*state.velocity[moving][:-1], *state.acceleration[moving][:-1])
        power = direct.smooth_power(crane, pose, state, cost, p[10], p[11])
        return p[9] * (power + p[12] * x[2] * x[2]), rows

    return node


def _solve(work: _Work, level: Level, guess: Motion, drawn: tuple | None) -> _Solved:
    """Solve one level from a guess, its limits drawn in by the results of `_draw_in`."""
    task, problem = work.task, work.problem
    points = mesh(work.edges, level.nodes)
    count = points.time.size
    plane = cranes.plane(task.machine, sample(task, points.time))
    columns = [getattr(plane, field.name) for field in fields(plane)]
    columns += [points.weight, level.sharpness, level.maximum, level.damping]
    parameters = np.stack(np.broadcast_arrays(*columns), axis=1)
    cylinders = problem.crane.machine.cylinders[problem.moving]
    velocity = np.tile([c.velocity_limit for c in cylinders], (count, 1))
    acceleration = np.tile([c.acceleration_limit for c in cylinders], (count, 1))
    lowest = np.interp(points.time, problem.time, problem.lower)
    highest = np.interp(points.time, problem.time, problem.upper)
    if drawn is not None:
        lowest, highest = lowest + drawn[0][:, 0], highest - drawn[0][:, 1]
        velocity, acceleration = velocity - drawn[1], acceleration - drawn[2]
    low = np.stack([lowest, -velocity[:, -1], -acceleration[:, -1]], axis=1)
    high = np.stack([highest, velocity[:, -1], acceleration[:, -1]], axis=1)
    low[0, 0] = high[0, 0] = work.start
    low[[0, -1], 1] = high[[0, -1], 1] = 0.0
    low[-1, 2] = high[-1, 2] = 0.0  # the end is no point: nothing depends on its control
    rows = np.concatenate([velocity[:, :-1], acceleration[:, :-1]], axis=1)
    c, w, u = guess.at(points.time)
    program = direct.assemble(work.functions, count, double_integrator(points, 3))
    answer = direct.optimise(program, np.stack([c, w, u], axis=1), parameters, (low, high), (-rows, rows))
    speed = points.at(answer.values[:, 1], problem.time)
    speed[[0, -1]] = 0.0
    found = motion.from_velocities(problem.step, work.start, speed, METHOD, work.cost)
    return _Solved(evaluate(task, found), points, answer.converged, answer.text)


def _draw_in(work: _Work, solved: _Solved, drawn: tuple | None) -> tuple | None:
    """By how much to draw in the limits at the nodes, what was drawn in before included; None: nothing to do.

    Returns:
        Lower and upper position [m], (nodes, 2); velocities [m/s] and accelerations [m/s^2], (nodes, moving).
    """
    judged, problem, nodes = solved.judged, work.problem, solved.points.time
    c = judged.length[:, -1]
    outside = np.stack(
        [
            np.interp(judged.time, problem.time, problem.lower) - c,
            c - np.interp(judged.time, problem.time, problem.upper),
        ],
        axis=1,
    )
    stroke = np.ptp(stages.stroke_range(work.task))
    cylinders = problem.crane.machine.cylinders
    found = (
        direct.around(np.where(outside > 0.5 * (direct.KEPT - 1.0) * stroke, outside, 0.0), judged.time, nodes),
        direct.exceeded(judged.velocity, [c.velocity_limit for c in cylinders], judged.time, nodes)[:, problem.moving],
        direct.exceeded(judged.acceleration, [c.acceleration_limit for c in cylinders], judged.time, nodes)[
            :, problem.moving
        ],
    )
    if judged.feasible or not any(np.any(amount > 0.0) for amount in found):
        return None
    found = tuple(DRAWN * amount for amount in found)
    return found if drawn is None else tuple(old + new for old, new in zip(drawn, found, strict=True))
