"""One-state dynamic program: equal to trying every control, its costs those of the judge, its motion on the path."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from leanboom.components.costs import COSTS
from leanboom.errors import InputError
from leanboom.evaluation.evaluate import evaluate
from leanboom.io.loading import load_task
from leanboom.methods import dp_velocity
from leanboom.model import cost_rates
from leanboom.model import crane as cranes
from leanboom.problem import stages


@pytest.mark.parametrize("cost", COSTS)
def test_equals_enumeration_of_all_controls(cost):
    """Four stages, velocities that reach position nodes exactly: interpolation is exact, so is the optimum."""
    task = load_task("forwarder-vertical")
    step = task.duration / 4
    program = dp_velocity.model(task, cost, (9, 5), step)
    spacing = program.positions[1] - program.positions[0]
    velocities = np.array([-1.0, 0.0, 1.0, 2.0]) * spacing / step
    program = dp_velocity.Model(program.problem, cost, program.positions, velocities, program.penalty)
    ahead = np.zeros(9)
    for k in (3, 2, 1, 0):
        ahead, _ = dp_velocity.backward_stage(program, k, ahead)
    tables = [dp_velocity.stage_cost(program, k) for k in range(4)]
    for first in range(9):
        best = np.inf
        for choice in itertools.product(range(4), repeat=4):
            node, total = first, 0.0
            for k, j in enumerate(choice):
                total += tables[k][node, j]
                node += (-1, 0, 1, 2)[j]
                if not 0 <= node < 9:
                    total += program.penalty
                    node = min(max(node, 0), 8)
            best = min(best, total)
        assert ahead[first] == pytest.approx(best, rel=1e-9)


def test_principal_costs_equal_the_judge():
    """Both pump powers of a judged motion, recomputed from its velocities and forces."""
    task = load_task("forwarder-half-cycle")
    judged = evaluate(task, dp_velocity.plan(task, "cp", 0.4, grid=(15, 11), step=0.3))
    crane = cranes.build(task)
    velocity, force = tuple(judged.velocity.T), tuple(judged.force.T)
    for cost, power in (("ls", judged.power_ls), ("cp", judged.power_cp)):
        np.testing.assert_allclose(cost_rates.rate(crane, cost, velocity, force), power, rtol=1e-12)
    work = np.maximum(judged.velocity * judged.force, 0.0).sum(axis=1)
    np.testing.assert_allclose(cost_rates.rate(crane, "actuator", velocity, force), work, rtol=1e-12)


def test_limits_are_counted():
    """A limit kept costs nothing; position, velocity of two cylinders and acceleration count one each."""
    task = load_task("forwarder-vertical")
    problem = stages.discretise(task, 0.5)
    inside = 0.5 * (problem.lower[4] + problem.upper[4])
    limit = task.machine.cylinders[1].velocity_limit
    at_limit = {"velocity": (0.0, limit, -limit, 0.0), "acceleration": (0.0,) * 4}
    beyond = {"velocity": (0.0, 1.1 * limit, -1.1 * limit, 0.0), "acceleration": (0.0, 0.0, 9.0, 0.0)}
    assert dp_velocity.violated(problem, 4, np.array(inside), at_limit) == 0.0
    assert dp_velocity.violated(problem, 4, np.array(problem.lower[4]), at_limit) == 0.0
    assert dp_velocity.violated(problem, 4, np.array(problem.lower[4] - 0.01), beyond) == 4.0


def test_forces_are_quasi_static():
    """Standing still anywhere costs no work, so `actuator` prices motion alone; no inertia appears."""
    task = load_task("loader-triangle-small")
    program = dp_velocity.model(task, "actuator", (7, 3), 3.0)
    assert np.all(dp_velocity.stage_cost(program, 0)[:, 1] % program.penalty == 0.0)  # rest at the start of the path
    assert np.any(dp_velocity.stage_cost(program, 0)[:, 2] % program.penalty > 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["forwarder-vertical", "loader-triangle-small"])
@pytest.mark.parametrize("cost", ["ls", "cp"])
def test_beats_the_other_pumps_plan_from_the_middle(name, cost):
    """A plan for one pump needs less of its energy than the plan for the other, and keeps position and velocity."""
    task = load_task(name)
    problem = stages.discretise(task, 0.1)
    start = float(0.5 * (problem.lower[0] + problem.upper[0]))
    judged = {c: evaluate(task, dp_velocity.plan(task, c, start, grid=(101, 51), step=0.1)) for c in ("ls", "cp")}
    other = "cp" if cost == "ls" else "ls"
    assert judged[cost].energy(cost) <= judged[other].energy(cost)
    assert judged[cost].limit_use.position <= 1.001
    assert judged[cost].limit_use.velocity <= 1.001
    assert judged[cost].path_error < 1e-6
    assert judged[cost].motion.velocity[0] == judged[cost].motion.velocity[-1] == 0.0
    assert (judged[cost].motion.method, judged[cost].motion.cost) == ("dp1", cost)


@pytest.mark.parametrize(
    ("arguments", "message"), [({"cost": "fuel"}, "cost = fuel; must be one of ls"), ({"grid": (1, 9)}, "grid = 1x9")]
)
def test_wrong_input_is_named(arguments, message):
    with pytest.raises(InputError, match=message):
        dp_velocity.plan(**({"task": load_task("forwarder-vertical"), "cost": "cp", "start": 0.5} | arguments))
