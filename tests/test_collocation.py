"""Collocation against quadrature theory, a closed form, an independent transcription, the polish and the judge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import leanboom as lb
from leanboom.errors import InfeasibleError, InputError
from leanboom.evaluation.evaluate import evaluate
from leanboom.methods import pseudospectral, smoothed_nlp
from leanboom.methods.pseudospectral import barycentric, double_integrator, interpolate, mesh, radau
from leanboom.model import crane as cranes
from leanboom.model.motion import from_velocities
from leanboom.model.task import Lines, Task, sample
from leanboom.planning.planner import run
from leanboom.problem import stages, starts

LEVEL = 0.3  # [m/s], cruising limit of the limited double integrator


@pytest.fixture(scope="module")
def task() -> Task:
    """A short smooth path that swings the base as well."""
    full = lb.load_task("forwarder-horizontal", start="middle")
    return replace(full, path=Lines(((4.5, 0.0, 2.0), (4.9, 1.0, 2.4)), (4.0,)))


def start_of(task: Task) -> float:
    return starts.start_position(stages.discretise(task, 0.05), task.start)


@given(count=st.integers(2, 120))
def test_radau_weights_integrate_polynomials_exactly(count):
    """Up to degree 2 N - 2, one less than Gauss because an end is a point."""
    tau, weights, _ = radau(count)
    assert weights.sum() == pytest.approx(2.0)
    assert tau[0] == -1.0 and tau[-1] == 1.0 and np.all(np.diff(tau) > 0.0)
    degree = 2 * count - 2
    assert weights @ tau[:-1] ** degree == pytest.approx(2.0 / (degree + 1), rel=1e-10)


@given(count=st.integers(2, 120))
def test_the_differentiation_matrix_is_exact_for_polynomials(count):
    """Legendre's polynomial of the full degree N, whose slope at the end is N (N + 1) / 2."""
    tau, _, matrix = radau(count)
    polynomial = np.polynomial.Legendre.basis(count)
    assert matrix @ polynomial(tau) == pytest.approx(polynomial.deriv()(tau[:-1]), abs=1e-8 * count**2)
    assert matrix @ np.ones(count + 1) == pytest.approx(0.0, abs=1e-9)


def test_interpolation_is_exact_on_and_off_the_nodes():
    tau, _, _ = radau(9)
    at = np.concatenate([tau, np.linspace(-1.0, 1.0, 57)])
    polynomial = np.polynomial.Legendre.basis(9)
    assert interpolate(tau, polynomial(tau), at) == pytest.approx(polynomial(at), abs=1e-13)


def test_barycentric_weights_neither_vanish_nor_overflow():
    weights = np.abs(barycentric(radau(150)[0]))
    assert np.all(np.isfinite(weights)) and weights.min() > 1e-6 * weights.max()


def test_neighbouring_polynomials_share_the_point_at_their_edge():
    points = mesh(np.array([0.0, 1.0, 4.0]), 12)
    assert points.counts == (3, 9)
    assert points.time.size == 13 and points.time[3] == 1.0
    assert points.weight.sum() == pytest.approx(4.0)
    values = np.abs(points.time - 1.0) ** 3  # a kink of the third derivative at the edge
    time = np.linspace(0.0, 4.0, 41)
    assert points.at(values, time) == pytest.approx(np.abs(time - 1.0) ** 3, abs=1e-12)
    row, column, value = points.derivative
    rate = np.bincount(row, value * values[column])
    assert rate == pytest.approx(3.0 * (points.time[:-1] - 1.0) * np.abs(points.time[:-1] - 1.0), abs=1e-11)


def least_effort(points, limit: float):
    """Rest to rest over 1 m in 4 s with least integral of u^2 and |w| <= limit, transcribed on a mesh."""
    functions = smoothed_nlp.node_functions(3, 1, lambda x, p: (p[0] * x[2] * x[2], x[1] * x[1]))
    count = points.time.size
    solver = smoothed_nlp.assemble(functions, count, double_integrator(points, 3))
    low, high = np.full((count, 3), -np.inf), np.full((count, 3), np.inf)
    low[0, :2] = high[0, :2] = 0.0
    low[-1] = high[-1] = [1.0, 0.0, 0.0]
    rows = np.zeros((count, 1)), np.full((count, 1), limit**2)  # the limit as a row, to have its derivatives used
    return smoothed_nlp.optimise(solver, np.zeros((count, 3)), points.weight[:, None], (low, high), rows)


def effort(points, answer) -> float:
    return float(points.weight @ answer.values[:, 2] ** 2)


def test_the_least_effort_of_a_double_integrator_is_exact():
    """Rest to rest over L in T takes u = 6 L / T^2 - 12 L t / T^3 at a cost of 12 L^2 / T^3."""
    points = mesh(np.array([0.0, 4.0]), 5)
    answer = least_effort(points, 10.0)
    assert answer.converged
    assert effort(points, answer) == pytest.approx(12.0 / 64.0, rel=1e-7)
    t = points.time
    assert answer.values[:, 0] == pytest.approx(3.0 * (t / 4.0) ** 2 - 2.0 * (t / 4.0) ** 3, abs=1e-6)
    assert answer.values[:-1, 2] == pytest.approx(6.0 / 16.0 - 12.0 * t[:-1] / 64.0, abs=1e-6)


def test_more_points_find_the_least_effort_below_a_speed_limit():
    """Two parabolas in velocity, w = W (1 - (1 - t / d)^2), and a cruise between them: L = W (T - 2 d / 3)."""
    ramp = 1.5 * (4.0 - 1.0 / LEVEL)
    wanted = 2.0 * 4.0 * LEVEL**2 / (3.0 * ramp)
    errors = []
    for count in (10, 20, 40):
        points = mesh(np.array([0.0, 4.0]), count)
        answer = least_effort(points, LEVEL)
        assert answer.converged
        errors.append(abs(effort(points, answer) / wanted - 1.0))
    assert errors[2] < errors[0] and errors[2] < 2e-3


def test_maptor_finds_the_same_least_effort():
    """An independent transcription of the same kind, with derivatives by CasADi instead of ours."""
    maptor = pytest.importorskip("maptor")
    problem = maptor.Problem("least effort")
    phase = problem.set_phase(1)
    phase.time(initial=0.0, final=4.0)
    c = phase.state("c", initial=0.0, final=1.0)
    w = phase.state("w", initial=0.0, final=0.0, boundary=(-LEVEL, LEVEL))
    u = phase.control("u")
    phase.dynamics({c: w, w: u})
    problem.minimize(phase.add_integral(u * u))
    phase.mesh([20], [-1.0, 1.0])
    phase.guess(terminal_time=4.0)
    quiet = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False, "ipopt.tol": 1e-9}
    solution = maptor.solve_fixed_mesh(problem, nlp_options=quiet, show_summary=False)
    points = mesh(np.array([0.0, 4.0]), 20)
    assert effort(points, least_effort(points, LEVEL)) == pytest.approx(solution.status["objective"], rel=1e-4)


def test_derivatives_of_the_crane_equal_differences(task):
    """Gradient, Jacobian and Hessian of a node of the LS problem against central differences."""
    problem = stages.discretise(task, 0.05)
    functions = smoothed_nlp.node_functions(3, 13, pseudospectral._node(problem.crane, problem.moving, "ls"))
    plane = cranes.plane(task.machine, sample(task, np.array([1.7])))
    p = [float(np.ravel(getattr(plane, name))[0]) for name in ("r", "z", "vr", "vz", "ar", "az", "q1", "v1", "a1")]
    p += [0.7, 50.0, 0.1, 0.01]
    x, lam = np.array([0.9, 0.03, -0.05]), np.array([0.3, -0.2, 0.5, 0.1])
    assert functions.rows == lam.size

    def rows(at):
        return np.array(functions.value(at, p)[1]).ravel()

    def slope(at):
        jacobian = np.zeros((functions.rows, 3))
        jacobian[functions.jacobian_places] = np.array(functions.jacobian(at, p)).ravel()
        gradient = np.array(functions.gradient(at, p)).ravel()
        return gradient, jacobian

    steps = 1e-6 * np.eye(3)
    gradient, jacobian = slope(x)
    for i, h in enumerate(steps):
        cost = float(functions.value(x + h, p)[0]) - float(functions.value(x - h, p)[0])
        assert gradient[i] == pytest.approx(cost / 2e-6, rel=1e-5, abs=1e-6)
        assert jacobian[:, i] == pytest.approx((rows(x + h) - rows(x - h)) / 2e-6, rel=1e-5, abs=1e-6)
    hessian = np.zeros((3, 3))
    hessian[functions.hessian_places] = np.array(functions.hessian(x, p, 2.0, lam)).ravel()
    hessian = hessian + np.triu(hessian, 1).T
    for i, h in enumerate(steps):
        (g1, j1), (g0, j0) = slope(x + h), slope(x - h)
        wanted = (2.0 * (g1 - g0) + lam @ (j1 - j0)) / 2e-6
        assert hessian[i] == pytest.approx(wanted, rel=1e-4, abs=1e-4 * np.abs(hessian).max())


def test_smoothed_steps_and_maxima():
    assert smoothed_nlp.smooth_heaviside(0.0, 20000.0) == 0.5
    assert smoothed_nlp.smooth_heaviside(np.array([-9.0, 9.0]), 20000.0).tolist() == [0.0, 1.0]  # no overflow
    x = np.linspace(-1e-3, 1e-3, 11)
    assert smoothed_nlp.smooth_heaviside(x, 500.0) == pytest.approx(
        1.0 / (1.0 + np.exp(-2.0 * 500.0 * x))
    )  # as printed
    a, b = np.array([3.0, 3.0, -2.0]), np.array([1.0, 3.0, 5.0])
    excess = smoothed_nlp.smooth_maximum(a, b, 1e-6) - np.maximum(a, b)
    assert np.all(excess >= 0.0) and excess.max() == pytest.approx(0.5e-3)


@pytest.mark.slow
@pytest.mark.parametrize("cost", ["ls", "cp"])
def test_collocation_and_polish_agree_on_a_short_smooth_task(task, cost):
    """Within 1 %: smoothing and damping here, stages of 0.05 s and, for LS, another basin there."""
    motion = pseudospectral.plan(task, cost, start_of(task))
    judged = evaluate(task, motion)
    assert motion.status == "solved" and judged.feasible, motion.log
    assert motion.method == "pseudospectral" and motion.cost == cost
    assert motion.velocity[0] == motion.velocity[-1] == 0.0
    other = run(task, pump=cost, method="polish", baseline=False).evaluation
    if cost == "cp":
        assert judged.energy(cost) == pytest.approx(other.energy(cost), rel=0.01)
    else:
        assert judged.energy(cost) < 1.01 * other.energy(cost)


def test_an_unfinished_solve_is_no_result(task, monkeypatch):
    monkeypatch.setitem(smoothed_nlp.IPOPT, "max_iter", 1)
    motion = pseudospectral.plan(task, "cp", start_of(task))
    assert motion.status.startswith("not converged: the iterations were used up (1 iterations, ")
    assert len(motion.log) == len(pseudospectral.LEVELS["cp"])
    assert all("Maximum_Iterations_Exceeded" in line for line in motion.log)  # the solver's own word


class Refusing:
    """A solver that is given what it cannot use."""

    def __call__(self, **given):
        raise RuntimeError(
            'Error in Function::call at function.cpp:330:\n\tassertion "lbx <= ubx" failed:\nNaN detected'
        )

    def size1_in(self, name):
        return 5


def test_what_casadi_refuses_is_told_in_plain_words():
    """Its assertion, lines with file names, once stood in the table of `compare` and ended `plan` in a traceback."""
    bounds, rows = (np.zeros((3, 2)), np.ones((3, 2))), (np.zeros((3, 1)), np.ones((3, 1)))
    answer = smoothed_nlp.optimise(Refusing(), np.full((3, 2), np.nan), np.zeros((3, 1)), bounds, rows)
    assert not answer.converged and np.all(np.isfinite(answer.values))
    assert answer.text == smoothed_nlp.UNUSABLE
    assert "assertion" in answer.raw and "\n" not in answer.raw


def test_the_best_level_that_converged_is_kept(task, monkeypatch):
    """A last level that fails leaves what was found before, and says so in the log."""
    levels = pseudospectral.LEVELS["cp"][:1]
    monkeypatch.setitem(pseudospectral.LEVELS, "cp", levels)
    alone = pseudospectral.plan(task, "cp", start_of(task))
    solve = pseudospectral._solve

    def failing(problem, functions, points, level, guess, drawn):
        attempt = solve(problem, functions, points, level, guess, drawn)
        if level.nodes == 30:
            attempt = replace(attempt, answer=replace(attempt.answer, converged=False, raw="gave up"))
        return attempt

    monkeypatch.setattr(pseudospectral, "_solve", failing)
    monkeypatch.setitem(pseudospectral.LEVELS, "cp", (*levels, replace(levels[0], nodes=30)))
    motion = pseudospectral.plan(task, "cp", start_of(task))
    assert motion.status == "solved"
    assert motion.velocity == pytest.approx(alone.velocity)
    assert "30 nodes, s = 500 s/m: gave up" in motion.log[-1]


def test_what_is_exceeded_between_nodes_draws_in_the_limits_beside_it(task):
    """A jump of 1.25 times the extension's acceleration limit after 2 s asks both neighbours for 1.2 times the rest."""
    hardest = task.machine.redundant.acceleration_limit
    velocity = np.zeros(81)
    velocity[41] = 1.25 * hardest * 0.05
    judged = evaluate(task, from_velocities(0.05, start_of(task), velocity, "test", "cp"))
    nodes = np.array([0.0, 1.0, 1.9, 2.3, 3.0, 4.0])
    found, tightening = smoothed_nlp.exceeded(judged, nodes)
    assert found == pytest.approx(0.0)
    assert tightening[:, -1] == pytest.approx(np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0]) * 1.2 * 0.25 * hardest, abs=1e-9)


def test_costs_and_paths_that_cannot_be():
    task = lb.load_task("forwarder-horizontal")
    with pytest.raises(InputError, match="method pseudospectral minimises ls or cp, not actuator"):
        lb.run(task, method="pseudospectral", cost="actuator")
    far = replace(task, path=Lines(((4.0, 0.0, 2.0), (20.0, 0.0, 2.0)), (10.0,)))
    with pytest.raises(InfeasibleError):
        pseudospectral.plan(far, "cp", 0.1)
