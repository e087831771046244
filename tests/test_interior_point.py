"""The polish's program and its solver against differences, dense linear algebra and another solver.

Oracles: central differences of the program's values for every derivative; the whole Newton system built densely and
solved by NumPy for the recursion that eliminates it; IPOPT on the same program stated in CasADi from the crane's
exact formulas for the answer.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from leanboom.components.costs import COSTS
from leanboom.fixed_mode import derivatives, interior_point, modes
from leanboom.model import crane as cranes
from leanboom.model import motion
from leanboom.problem import cost_scale, layout, stage_arrays, stages
from test_polish import TASKS, built, seed

STAGES = 4
BARRIER = 3e-4


@cache
def small(name: str, cost: str, free: bool = False) -> tuple[derivatives.Program, derivatives.Point]:
    """A program of a few stages, and a point inside its domain that keeps the dynamics and ends at rest."""
    task = TASKS[name]
    polisher = modes.build(stages.discretise(task, task.duration / STAGES), cost)
    problem = polisher.problem
    rng = np.random.default_rng(20170506)
    velocity = 0.04 * rng.normal(size=STAGES + 1)
    velocity[[0, -1]] = 0.0
    c0 = problem.lower[0] + 0.47 * (problem.upper[0] - problem.lower[0])  # between two nodes of the table
    moved = motion.from_velocities(problem.step, float(c0), velocity, "test", cost)
    switches = modes.modes(polisher, moved)
    mode = modes._mode_parameters(polisher, switches)
    stated = modes._program(polisher, moved, switches, mode, free, (1.0,) * 3)
    point = modes._guess(polisher, moved, switches, mode)
    point.local[:] += 0.1 * rng.random(point.local.shape)
    return stated, point


def count(stated: derivatives.Program) -> tuple[int, int]:
    """Stages and cylinders."""
    return stated.table.shape[0] - 1, stated.table.shape[2]


def flat(point: derivatives.Point) -> np.ndarray:
    return point.every.copy()


def shaped(stated: derivatives.Program, x: np.ndarray) -> derivatives.Point:
    point = derivatives.empty_point(*count(stated))
    point.every[:] = x
    return point


def empty(stated: derivatives.Program) -> derivatives.Limits:
    return derivatives.empty_limits(*count(stated))


def measured(stated: derivatives.Program, x: np.ndarray) -> tuple[float, np.ndarray]:
    """Cost and values of all limits at a point."""
    stages_, n = count(stated)
    point, value = shaped(stated, x), empty(stated)
    jet = np.empty((stages_ + 1, n, 3, layout.COEFFICIENTS))
    derivatives.jets(stated, point.state[:, 0], jet)
    cost = derivatives.evaluate(stated, point, jet, np.empty((n, 3, derivatives.DERIVATIVES)), value)
    return cost, value.every.copy()


def multipliers(stated: derivatives.Program) -> tuple[derivatives.Limits, derivatives.Limits]:
    """Slacks and multipliers drawn at random."""
    rng = np.random.default_rng(7)
    slack, multiplier = empty(stated), empty(stated)
    slack.every[:] = rng.uniform(0.05, 1.0, slack.every.size)
    multiplier.every[:] = rng.uniform(0.01, 0.5, slack.every.size)
    return slack, multiplier


def assembled(stated: derivatives.Program, x: np.ndarray, slack, multiplier):
    """Newton's whole matrix and gradient over all variables, from the parts of ends and nodes."""
    stages_, n = count(stated)
    point, value = shaped(stated, x), empty(stated)
    jet = np.empty((stages_ + 1, n, 3, layout.COEFFICIENTS))
    derivatives.jets(stated, point.state[:, 0], jet)
    moved, bends = np.empty((n, 3, derivatives.DERIVATIVES)), np.empty((n, 3))
    derivatives.evaluate(stated, point, jet, moved, value)
    matrix, gradient = np.zeros((x.size, x.size)), np.zeros(x.size)
    size = 4 + n
    a, b = 2 * (stages_ + 1), 2 * (stages_ + 1) + stages_
    parts, pulls = np.zeros((stages_ + 1, 2, 2)), np.zeros((stages_ + 1, 2))
    arguments = stated, point, jet, value, slack, multiplier, BARRIER
    derivatives.assemble_nodes(*arguments, parts, pulls)
    for k in range(stages_ + 1):
        at = np.array([2 * k, 2 * k + 1])
        gradient[at] += pulls[k]
        matrix[np.ix_(at, at)] += np.tril(parts[k]) + np.tril(parts[k], -1).T
    ends, pulls = np.full((stages_, 2, size, size), np.nan), np.full((stages_, 2, size), np.nan)
    derivatives.assemble_ends(*arguments, moved, bends, ends, pulls)
    for k in range(stages_):
        for e in range(2):
            own = b + (2 * k + e) * (1 + n) + np.arange(1 + n)
            at = np.concatenate([[2 * (k + e), 2 * (k + e) + 1, a + k], own]).astype(int)
            gradient[at] += pulls[k, e]
            matrix[np.ix_(at, at)] += np.tril(ends[k, e]) + np.tril(ends[k, e], -1).T
    return matrix, gradient, value


def differences(function, x, h=1e-6):
    """Central differences by every variable, last axis."""
    columns = []
    for i in range(x.size):
        step = np.zeros_like(x)
        step[i] = h
        columns.append((function(x + step) - function(x - step)) / (2.0 * h))
    return np.stack(columns, axis=-1)


CASES = [
    *(("vertical", cost) for cost in COSTS),
    *(("slewing", "ls"), ("loader", "ls"), ("loader", "cp")),
    *(("mapped", cost) for cost in ("ls", "cp", "recuperation")),
    *(("limited", cost) for cost in ("ls", "velocity")),
]


# Derivatives


@pytest.mark.parametrize(("name", "cost"), CASES)
def test_assembled_derivatives_equal_differences(name, cost):
    """Gradient: cost less pull x limit. Matrix: curvature of cost less m g, plus m / t x the limits' slopes squared."""
    stated, point = small(name, cost, True)
    x = flat(point)
    slack, multiplier = multipliers(stated)
    matrix, gradient, value = assembled(stated, x, slack, multiplier)
    used = stated.counts.every
    t, m = np.where(used, slack.every, 1.0), np.where(used, multiplier.every, 0.0)
    pull = np.where(used, (BARRIER - m * (value.every - t)) / t, 0.0)
    slopes = differences(lambda y: measured(stated, y)[1], x)
    slope = differences(lambda y: np.array(measured(stated, y)[0]), x)
    scale = np.abs(slope).max() + np.abs(pull @ slopes).max()
    np.testing.assert_allclose(gradient / scale, (slope - pull @ slopes) / scale, atol=1e-7)

    def bent(y):
        """Gradient of cost less m g alone: at slacks of one a pull is m where barrier = m g."""
        ones = empty(stated)
        ones.every[:] = 1.0
        _, found, there = assembled(stated, y, ones, multiplier)
        # pull there is BARRIER - m (g - 1); take it back to m.
        extra = np.where(used, BARRIER - m * (there.every - 1.0) - m, 0.0)
        return found + extra @ differences(lambda z: measured(stated, z)[1], y)

    weights = m / t
    wanted = differences(bent, x, 1e-5) + slopes.T @ (weights[:, None] * slopes)
    unused = np.flatnonzero(np.abs(wanted).max(axis=0) == 0.0)
    matrix[unused, unused] -= 1.0  # variables that this cost has not: held where they are
    scale = np.sqrt(np.outer(np.abs(np.diag(wanted)) + 1e-3, np.abs(np.diag(wanted)) + 1e-3))
    np.testing.assert_allclose(matrix / scale, wanted / scale, atol=2e-4)


@pytest.mark.parametrize("name", ["vertical", "slewing", "loader"])
def test_interpolated_coefficients_are_the_cranes(name):
    """Between the nodes of the table, from the retracted telescope of a nearly straight arm on."""
    polisher = built(name, "ls", 0.5)
    problem = polisher.problem
    stated, _ = small(name, "ls")
    stated = stated._replace(
        table=polisher.coefficients, first=problem.lower, last=problem.upper, coulomb=polisher.coulomb
    )
    jet = np.empty((problem.stages + 1, stated.table.shape[2], 3, layout.COEFFICIENTS))
    for share in (0.0003, 0.004, 0.03, 0.2, 0.61, 0.998):
        c = problem.lower + share * (problem.upper - problem.lower)
        derivatives.jets(stated, c, jet)
        h = 1e-5
        exact = stage_arrays.coefficients(problem, np.stack([c - h, c, c + h], axis=1))
        scale = np.abs(exact[:, 1]).max(axis=(0, 1)) + 1e-9
        smooth = np.arange(layout.COEFFICIENTS) != layout.COULOMB
        close = np.where(smooth, 2e-5, 1e-4)
        assert np.all(np.abs(jet[:, :, 0] - exact[:, 1]) <= close * scale)
        slope = (exact[:, 2] - exact[:, 0]) / (2.0 * h)
        scale = np.abs(slope).max(axis=(0, 1)) + 1e-3 * scale
        np.testing.assert_allclose((jet[:, :, 1] / scale)[..., smooth], (slope / scale)[..., smooth], atol=5e-3)


# The step


def standing(stated: derivatives.Program, point: derivatives.Point, slack: derivatives.Limits) -> interior_point.Place:
    """A place with all that is known there."""
    stages_, n = count(stated)
    place = interior_point.Place(point, np.empty((stages_ + 1, n, 3, layout.COEFFICIENTS)), empty(stated), slack)
    derivatives.jets(stated, point.state[:, 0], place.jet)
    derivatives.evaluate(stated, point, place.jet, np.empty((n, 3, derivatives.DERIVATIVES)), place.value)
    return place


@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize(("name", "cost"), [("vertical", "ls"), ("slewing", "cp"), ("loader", "actuator")])
def test_recursion_solves_the_newton_system(name, cost, free):
    """The same step as one dense system with the dynamics, the start and the end at rest as equations."""
    stated, point = small(name, cost, free)
    stages_, n = count(stated)
    x = flat(point)
    slack, multiplier = multipliers(stated)
    shift = 50.0  # steep enough for any point
    matrix, gradient, value = assembled(stated, x, slack, multiplier)
    a, b = 2 * (stages_ + 1), 2 * (stages_ + 1) + stages_
    shifted = matrix.copy()
    where = np.concatenate([np.arange(a - 2), np.arange(a, x.size)])  # the last node has no shift of its own
    shifted[where, where] += shift
    ts = stated.step
    rows = np.zeros((a, x.size))
    for k in range(stages_):
        for i, right in enumerate(({2 * k: 1.0, 2 * k + 1: ts, a + k: 0.5 * ts * ts}, {2 * k + 1: 1.0, a + k: ts})):
            rows[2 * k + i, 2 * (k + 1) + i] = -1.0
            for column, entry in right.items():
                rows[2 * k + i, column] = entry
    rows = np.vstack([rows[: 2 * stages_], np.zeros((2, x.size))])
    rows[-2, 1] = 1.0  # at rest at first
    rows[-1, 2 * stages_ + 1] = 1.0  # and at last
    if not free:
        rows = np.vstack([rows, np.eye(1, x.size)])
    kkt = np.block([[shifted, rows.T], [rows, np.zeros((len(rows), len(rows)))]])
    wanted = np.linalg.solve(kkt, np.concatenate([-gradient, np.zeros(len(rows))]))[: x.size]

    place = standing(stated, point, slack)
    step, slack_step, turn = derivatives.empty_point(stages_, n), empty(stated), empty(stated)
    work = interior_point.empty_work(stages_, n)
    good, slope = interior_point.newton(
        stated, place, place.value, multiplier, BARRIER, shift, work, step, slack_step, turn
    )
    assert good
    used = stated.counts.every
    steps = flat(step)
    if cost not in ("ls", "cp"):
        steps[b:] = wanted[b:]  # no variables
    np.testing.assert_allclose(steps, wanted, atol=1e-7 * np.abs(wanted).max())
    along = differences(lambda s: measured(stated, x + s[0] * wanted)[1], np.zeros(1))[:, 0]
    np.testing.assert_allclose(slack_step.every[used], (along + value.every - slack.every)[used], rtol=1e-4, atol=1e-6)
    complementary = (slack.every * turn.every + multiplier.every * slack_step.every)[used]
    np.testing.assert_allclose(complementary, (BARRIER - slack.every * multiplier.every)[used], atol=1e-9)
    downhill = float(differences(lambda s: np.array(measured(stated, x + s[0] * wanted)[0]), np.zeros(1))[0])
    assert slope == pytest.approx(downhill, rel=1e-4, abs=1e-8)


def test_a_direction_that_is_not_downhill_is_told():
    """Without a shift, at a point where the cost bends the wrong way, elimination says so."""
    stated, point = small("vertical", "ls")
    stages_, n = count(stated)
    slack, multiplier = multipliers(stated)
    slack.every[:], multiplier.every[:] = 1.0, 1e-9  # nothing holds flow and pressure: their product is a saddle
    place, work = standing(stated, point, slack), interior_point.empty_work(stages_, n)
    out = derivatives.empty_point(stages_, n), empty(stated), empty(stated)
    assert not interior_point.newton(stated, place, place.value, multiplier, BARRIER, 0.0, work, *out)[0]
    assert interior_point.newton(stated, place, place.value, multiplier, BARRIER, 1e3, work, *out)[0]


# The answer


def by_ipopt(polisher: modes.Polisher, start: motion.Motion, switches: modes.Modes, fixed_end: bool) -> float:
    """Least cost of the same modes by IPOPT: the program stated once more, on symbols, from the crane's formulas."""
    import casadi as ca

    ca.GlobalOptions.setNumpyMode(1)
    problem, cost = polisher.problem, polisher.cost
    mode = modes._mode_parameters(polisher, switches)
    stated = modes._program(polisher, start, switches, mode, False, (1.0,) * 3)
    machine, n, count_ = problem.crane.machine, stated.table.shape[2], problem.stages
    u = ca.SX.sym("u", count_)
    s, p = ca.SX.sym("s", n, 2 * count_), ca.SX.sym("p", 2 * count_)
    rows, low, high, total = [], [], [], 0.0

    def hold(value, least, most):
        rows.append(value)
        low.append(least)
        high.append(most)

    c, w = ca.SX(float(start.position[0])), ca.SX(0.0)
    poses = []
    states = [(c, w)]
    for k in range(count_):
        c, w = c + problem.step * w + 0.5 * problem.step**2 * u[k], w + problem.step * u[k]
        states.append((c, w))
    for k, (c, w) in enumerate(states):
        here = problem.plane[k]
        poses.append(cranes.pose(problem.crane, here, c))
        velocity = cranes.move(poses[k], w, 0.0).velocity[problem.moving]
        if k > 0:
            ends = fixed_end and k == count_
            hold(c, *(start.position[[-1, -1]] if ends else (stated.low[k, 0], stated.high[k, 0])))
            for i in range(n - (k == count_)):
                hold(velocity[i], stated.low[k, 1 + i], stated.high[k, 1 + i])
    hold(states[-1][1], 0.0, 0.0)
    for k in range(count_):
        hold(u[k], -stated.cylinder[derivatives.HARDEST, -1], stated.cylinder[derivatives.HARDEST, -1])
        for e in range(2):
            moving = cranes.move(poses[k + e], states[k + e][1], u[k])
            flow, column = stated.flow[k + e], 2 * k + e
            for i in range(n):
                v, a = moving.velocity[problem.moving][i], moving.acceleration[problem.moving][i]
                sign, alpha, beta, gamma = mode[e, k, :, i]
                friction = sign * poses[k + e].coulomb[problem.moving][i] + stated.cylinder[derivatives.VISCOUS, i] * v
                force = moving.load[problem.moving][i] + friction
                if i < n - 1:
                    hold(a, -stated.cylinder[derivatives.HARDEST, i], stated.cylinder[derivatives.HARDEST, i])
                if cost == "ls" and (alpha or beta):
                    hold(alpha * p[column] - beta * force - gamma, 0.0, np.inf)
                hold(s[i, column] - stated.cylinder[derivatives.AREA_OUT, i] * v, 0.0, np.inf)
                hold(s[i, column] + stated.cylinder[derivatives.AREA_IN, i] * v, 0.0, np.inf)
                flow = flow + s[i, column]
            if problem.task.limits.pump_flow:
                hold(1e3 * machine.pump.max_flow - flow, 0.0, np.inf)
            hold(p[column], stated.base[k + e], np.inf)
            pressure = p[column] + stated.pump[derivatives.SUPPLY] if cost == "ls" else stated.pump[derivatives.SUPPLY]
            total += 0.5 * problem.step * pressure * flow / machine.pump.efficiency
    local = modes._guess(polisher, start, switches, mode).local
    x = ca.vertcat(u, ca.vec(s), p)
    options = {"ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-9}, "print_time": False}
    solver = ca.nlpsol("twin", "ipopt", {"x": x, "f": total + 1e-9 * ca.sumsqr(p), "g": ca.vertcat(*rows)}, options)
    guess = np.concatenate([start.acceleration, local[:, :, 1:].reshape(2 * count_, n).ravel(), local[:, :, 0].ravel()])
    answer = solver(x0=guess, lbg=np.array(low), ubg=np.array(high))
    assert solver.stats()["success"], solver.stats()["return_status"]
    return float(answer["f"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "cost", "fixed_end"),
    [
        ("vertical", "cp", False), ("vertical", "ls", False), ("loader", "ls", False), ("slewing", "cp", False),
        ("vertical", "cp", True), ("loader", "ls", True), ("limited", "ls", False), ("limited", "cp", False),
    ],
)  # fmt: skip
def test_answer_is_ipopts(name, cost, fixed_end):
    """Same modes, same start, another formulation and another solver: costs within 0.01 %."""
    polisher = built(name, cost, 0.5)
    if fixed_end:
        task = replace(polisher.problem.task, end="same")
        polisher = replace(polisher, problem=replace(polisher.problem, task=task))
    problem = polisher.problem
    first = seed(name, cost, 0.5)
    if fixed_end:
        first = motion.ending_at(first, float(first.position[0]))
    start, text = modes.solve(polisher, first, modes.modes(polisher, first))
    assert start is not None, text  # its modes agree with themselves
    switches = modes.modes(polisher, start)
    mode = modes._mode_parameters(polisher, switches)
    stated = modes._program(polisher, start, switches, mode, False, (1.0,) * 3)
    guess = modes._guess(polisher, start, switches, mode)
    unit = 1e-3 * cost_scale.energy_scale(problem, cost)
    answer, solved, _ = interior_point.minimise(stated, guess, 1e-5 * unit, 1e-10 * unit, 300)
    assert solved
    cost_here, limits = measured(stated, flat(answer))
    least = [limits[k] for k in np.flatnonzero(stated.counts.every)]
    assert min(least) > -1e-6
    assert cost_here == pytest.approx(by_ipopt(polisher, start, switches, fixed_end), rel=1e-4)


def test_a_better_answer_from_a_smaller_last_barrier():
    """Cost above the limit of no barrier is in proportion to the last one."""
    polisher = built("vertical", "cp", 0.5)
    start = seed("vertical", "cp", 0.5)
    switches = modes.modes(polisher, start)
    mode = modes._mode_parameters(polisher, switches)
    stated = modes._program(polisher, start, switches, mode, False, (1.0,) * 3)
    guess = modes._guess(polisher, start, switches, mode)
    costs = []
    for last in (1e-4, 1e-5, 1e-6, 1e-9):
        answer, solved, _ = interior_point.minimise(stated, guess, 1e-2, last, 300)
        assert solved
        costs.append(measured(stated, flat(answer))[0])
    above = np.array(costs[:-1]) - costs[-1]
    assert np.all(above > 0.0)
    assert above[0] / above[1] == pytest.approx(10.0, rel=0.3)
    assert above[1] / above[2] == pytest.approx(10.0, rel=0.3)


def test_too_few_iterations_are_told():
    stated, point = small("vertical", "cp")
    _, solved, iterations = interior_point.minimise(stated, point, 1e-3, 1e-7, 2)
    assert not solved
    assert iterations == 2
