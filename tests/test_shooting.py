"""Shooting against a closed form, the crane's kinematics, and collocation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import leanboom as lb
from leanboom.errors import InputError
from leanboom.evaluation.evaluate import evaluate
from leanboom.methods import multiple_shooting, pseudospectral, smoothed_nlp
from leanboom.methods.multiple_shooting import integrators
from leanboom.model.task import Lines, Task
from leanboom.problem import stages, starts


@pytest.fixture(scope="module", params=["forwarder", "loader"])
def task(request) -> Task:
    """A short smooth path; the forwarder's swings the base as well."""
    if request.param == "forwarder":
        full, end = lb.load_task("forwarder-horizontal", start="middle"), (4.9, 1.0, 2.4)
        return replace(full, path=Lines(((4.5, 0.0, 2.0), end), (4.0,)))
    full = lb.load_task("loader-triangle-small", start="middle")
    return replace(full, path=Lines(((2.6, 0.0, 0.5), (3.0, 0.0, 0.9)), (4.0,)))


def start_of(task: Task) -> float:
    return starts.start_position(stages.discretise(task, 0.05), task.start)


def test_the_least_effort_of_double_integrators_is_exact():
    """Rest to rest over 1 m and 2 m with u constant on the stages: the least-norm solution of four equations.

    With many stages it tends to 12 L^2 / T^3 each.
    """
    step, count, goals = 0.1, 40, np.array([1.0, 2.0])
    functions = smoothed_nlp.node_functions(6, 1, lambda x, p: (p[0] * (x[4] * x[4] + x[5] * x[5]), x[0] * x[1]))
    solver = smoothed_nlp.assemble(functions, count + 1, integrators(count, 2, step))
    low, high = np.full((count + 1, 6), -np.inf), np.full((count + 1, 6), np.inf)
    low[0, :4] = high[0, :4] = 0.0
    low[-1] = high[-1] = [*goals, 0.0, 0.0, 0.0, 0.0]
    free = np.full((count + 1, 1), np.inf)
    weight = np.append(np.full(count, step), 0.0)[:, None]
    answer = smoothed_nlp.optimise(solver, np.zeros((count + 1, 6)), weight, (low, high), (-free, free))
    assert answer.converged
    later = step * (np.arange(count)[::-1] + 0.5)  # from the middle of a stage to the end
    wanted = np.linalg.pinv(step * np.stack([later, np.ones(count)])) @ np.array([1.0, 0.0])
    assert answer.values[:-1, 4:] == pytest.approx(wanted[:, None] * goals, abs=1e-6)
    effort = step * (answer.values[:, 4:] ** 2).sum(axis=0)
    assert effort == pytest.approx(12.0 * goals**2 / 4.0**3, rel=1e-3)


def test_forward_kinematics_gives_the_path_back(task):
    """Joint motion completed from the redundant cylinder's moves the tool as the path asks, in all three orders."""
    problem = stages.discretise(task, 0.05)
    t = problem.time
    c = start_of(task) + 0.05 * np.sin(t)
    values = multiple_shooting._complete(problem, c, 0.05 * np.cos(t), -0.05 * np.sin(t))
    joints = len(task.machine.joints)
    q, v, u = (list(values[:, i * joints : (i + 1) * joints].T) for i in range(3))
    tool = multiple_shooting.forward(problem.crane, q, v, u)
    for name in ("r", "z", "vr", "vz", "ar", "az", "q1", "v1", "a1"):
        assert getattr(tool, name) == pytest.approx(getattr(problem.plane, name), abs=1e-11), name


def test_the_tool_stays_on_its_path(task):
    """The full-dimensional solution leaves the path by less than what the judge calls off the path."""
    problem = stages.discretise(task, 0.05)
    work = multiple_shooting._prepare(problem, "cp")
    answer = multiple_shooting._solve(
        work, smoothed_nlp.Level(500.0, 1.0, 0.1), multiple_shooting._first_guess(problem, start_of(task)), None
    )
    assert answer.converged, answer.text
    joints = len(task.machine.joints)
    q, v, u = (list(answer.values[:, i * joints : (i + 1) * joints].T) for i in range(3))
    tool = multiple_shooting.forward(problem.crane, q, v, u)
    assert np.hypot(tool.r - problem.plane.r, tool.z - problem.plane.z).max() < 1e-4
    assert q[-1][0] * problem.crane.ratio == pytest.approx(start_of(task), abs=1e-12)
    assert np.abs(answer.values[[0, -1], joints : 2 * joints]).max() == 0.0


@pytest.mark.slow
def test_shooting_and_collocation_agree_on_a_short_smooth_task(task):
    """CP, where one basin holds everything: within 1 % for smoothing and stages of 0.05 s."""
    motion = multiple_shooting.plan(task, "cp", start_of(task))
    judged = evaluate(task, motion)
    assert motion.status == "solved" and judged.feasible, motion.log
    assert motion.method == "shooting" and motion.cost == "cp"
    other = evaluate(task, pseudospectral.plan(task, "cp", start_of(task)))
    assert judged.energy_cp == pytest.approx(other.energy_cp, rel=0.01)


def test_an_unfinished_solve_is_no_result(task, monkeypatch):
    monkeypatch.setitem(smoothed_nlp.IPOPT, "max_iter", 1)
    told = []
    motion = multiple_shooting.plan(task, "ls", start_of(task), tell=lambda text, share: told.append((text, share)))
    assert motion.status.startswith("not converged: the iterations were used up (1 iterations, ")
    assert told[0] == ("s = 200 s/m", 0.0) and told[-1] == ("done", 1.0)


def test_costs_that_cannot_be():
    with pytest.raises(InputError, match="method shooting minimises ls or cp, not velocity"):
        lb.run(lb.load_task("forwarder-horizontal"), method="shooting", cost="velocity")
