"""The polish: exact derivatives, modes read off motions, answers that keep the dynamics and the judge agrees with."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from leanboom.components.pump_power import shaft_of
from leanboom.components.pumps import EfficiencyMap
from leanboom.dynamic_programming import grids, value_function
from leanboom.evaluation.evaluate import evaluate, judged_cost
from leanboom.fixed_mode import modes
from leanboom.formulas import hydraulics
from leanboom.io.loading import load_task
from leanboom.methods import pseudo_inverse
from leanboom.model import crane as cranes
from leanboom.model import motion
from leanboom.model.task import Limits, Lines, Task
from leanboom.problem import stages, starts

LIMITED = 21.0 / 6e4  # [m^3/s]
TASKS = {
    "vertical": replace(load_task("forwarder-vertical"), start="middle"),
    "slewing": replace(load_task("forwarder-half-cycle"), start="middle"),
    "loader": replace(
        load_task("loader-triangle-small"), start="middle", path=Lines(((2.6, 0.0, 0.5), (3.2, 0.0, 1.1667)), (6.0,))
    ),
}
TASKS["limited"] = replace(  # below what its best motion takes, above what any does
    TASKS["slewing"],
    machine=replace(TASKS["slewing"].machine, pump=replace(TASKS["slewing"].machine.pump, max_flow=LIMITED)),
    limits=Limits(pump_flow=True),
)
LEVELS = (10e6, 20e6)  # [Pa]
MAP = EfficiencyMap(30.0, (30.0,), (10e-6, 40e-6), LEVELS, (((0.7, 0.74), (0.84, 0.87)),))
TASKS["mapped"] = replace(
    TASKS["vertical"],
    machine=replace(TASKS["vertical"].machine, pump=replace(TASKS["vertical"].machine.pump, efficiency=MAP)),
)


@cache
def built(name: str, cost: str, step: float) -> modes.Polisher:
    return modes.build(stages.discretise(TASKS[name], step), cost)


@cache
def seed(name: str, cost: str, step: float) -> motion.Motion:
    """A coarse dynamic program's motion."""
    problem = built(name, cost, step).problem
    policy = value_function.solve(problem, grids.full_grid(problem, 51, 25), cost)
    return value_function.rollout(policy, starts.start_position(problem, "middle"))


def on_stages(problem: stages.Problem, fine: motion.Motion) -> motion.Motion:
    velocity = fine.at(problem.time)[1].copy()
    velocity[-1] = 0.0
    return motion.from_velocities(problem.step, float(fine.position[0]), velocity, fine.method, fine.cost)


def polished(polisher: modes.Polisher, start: motion.Motion, rounds=1, free=False) -> motion.Motion:
    for _ in range(rounds):
        answer, text = modes.solve(polisher, start, modes.modes(polisher, start), free)
        assert answer is not None, text
        start = answer
    return start


# Modes


def test_modes_of_a_motion_made_by_hand():
    """The extension goes out, rests, goes back; its direction is known, the other cylinders' is the judge's."""
    polisher = built("vertical", "ls", 0.1)
    problem = polisher.problem
    velocity = np.zeros(problem.stages + 1)
    velocity[3:20], velocity[30:50] = 0.05, -0.04
    made = motion.from_velocities(problem.step, 0.75, velocity, "hand", "none")
    found = modes.modes(polisher, made)
    np.testing.assert_array_equal(found.sign[:, -1], np.sign(velocity))
    judged = evaluate(problem.task, made)
    at = np.rint(problem.time / (judged.time[1] - judged.time[0])).astype(int)
    moving = slice(1, None)
    speed, force = judged.velocity[at][:, moving], judged.force[at][:, moving]
    epsilon = problem.crane.machine.driven_velocity
    sign = np.where(np.abs(speed) > epsilon, np.sign(speed), 0.0)
    np.testing.assert_array_equal(found.sign, sign)
    np.testing.assert_array_equal(found.loaded[0], (force * sign > 0.0)[:-1])
    assert found.loaded.any() and not found.loaded.all()
    # The end of an interval is the beginning of the next with this interval's acceleration: equal where it goes on.
    steady = np.nonzero(np.diff(made.acceleration) == 0.0)[0]
    np.testing.assert_array_equal(found.loaded[1, steady], found.loaded[0, steady + 1])


def test_nothing_moves_and_nothing_is_loaded_on_a_path_that_rests():
    task = replace(TASKS["vertical"], path=Lines(((5.5, 0.0, 2.5), (5.5, 0.0, 2.5)), (1.0,)))
    polisher = modes.build(stages.discretise(task, 0.2), "ls")
    found = modes.modes(polisher, motion.from_velocities(0.2, 0.7, np.zeros(6), "hand", "none"))
    assert not found.sign.any() and not found.loaded.any()


def test_same_modes_need_every_switch_to_agree():
    found = modes.modes(built("vertical", "ls", 0.1), seed("vertical", "ls", 0.1))
    other = modes.Modes(found.sign.copy(), found.loaded.copy())
    assert found.same_as(other)
    other.sign[7, 1] += 1
    assert not found.same_as(other) and not other.same_as(found)
    other = modes.Modes(found.sign.copy(), found.loaded.copy())
    other.loaded[1, 3, 0] ^= True
    assert not found.same_as(other)


# Answers


@pytest.mark.parametrize(
    ("name", "cost"), [("vertical", "ls"), ("vertical", "cp"), ("slewing", "ls"), ("loader", "cp"), ("mapped", "ls")]
)
def test_answer_keeps_dynamics_limits_and_ends_and_costs_what_the_solver_says(name, cost):
    """The judge's 2 ms and the trapezoid between stages differ by what switches inside an interval cost: 4 %."""
    polisher = built(name, cost, 0.1)
    problem, start = polisher.problem, seed(name, cost, 0.1)
    switches = modes.modes(polisher, start)
    answer, text = modes.solve(polisher, start, switches)
    assert answer is not None, text
    assert text.startswith("solved in ")
    ts = problem.step
    c, w, u = answer.position, answer.velocity, answer.acceleration
    np.testing.assert_allclose(c[1:], c[:-1] + ts * w[:-1] + 0.5 * ts**2 * u, atol=1e-13)
    np.testing.assert_allclose(w[1:], w[:-1] + ts * u, atol=1e-13)
    assert c[0] == pytest.approx(start.position[0], abs=1e-12)
    assert w[0] == 0.0 and w[-1] == 0.0
    judged = evaluate(problem.task, answer)
    assert judged.feasible, judged.status
    assert judged_cost(judged, cost) == pytest.approx(trapezoids(polisher, answer, cost), rel=0.04)
    assert judged_cost(judged, cost) < judged_cost(evaluate(problem.task, start), cost)
    assert (answer.method, answer.cost) == (start.method, cost)


def trapezoids(polisher: modes.Polisher, made: motion.Motion, cost: str) -> float:
    """Pump energy of a motion [J] from the powers at both ends of every interval."""
    problem = polisher.problem
    pump, drives = problem.crane.machine.pump, problem.crane.drives
    total = 0.0
    for nodes in (slice(None, -1), slice(1, None)):
        pose = cranes.pose(problem.crane, problem.plane[nodes], made.position[nodes])
        moving = cranes.move(pose, made.velocity[nodes], made.acceleration)
        force = cranes.forces(pose, moving)
        flow = sum(
            hydraulics.cylinder_flow(v, d.area_out, d.area_in) for v, d in zip(moving.velocity, drives, strict=True)
        )
        pressure = pump.ls_margin + np.max(
            [
                hydraulics.pressure_demand(
                    v, f, problem.crane.machine.driven_velocity, d.gain_out, d.back_out, d.gain_in, d.back_in
                )
                for v, f, d in zip(moving.velocity, force, drives, strict=True)
            ],
            axis=0,
        )
        supply = pressure if cost == "ls" else pump.constant_pressure
        total += 0.5 * problem.step * np.sum(hydraulics.pump_power(supply, flow, *shaft_of(pump)))
    return float(total)


def test_an_answer_that_did_not_converge_is_never_returned(monkeypatch):
    polisher = built("vertical", "cp", 0.1)
    start = seed("vertical", "cp", 0.1)
    monkeypatch.setattr(modes, "ITERATIONS", 2)
    answer, text = modes.solve(polisher, start, modes.modes(polisher, start))
    assert answer is None
    assert text == "not solved in 2 iterations"


def test_modes_that_contradict_the_path_have_no_answer():
    """All cylinders held while the tool has to move by three metres."""
    polisher = built("vertical", "ls", 1.0)
    start = seed("vertical", "ls", 1.0)
    still = motion.from_velocities(1.0, float(start.position[0]), np.zeros_like(start.velocity), "hand", "none")
    found = modes.modes(polisher, start)
    # Both boom cylinders against the way the path drives them.
    answer, text = modes.solve(polisher, still, modes.Modes(-np.abs(found.sign), found.loaded))
    assert answer is None
    assert text.startswith("not solved in ")


def test_constant_pressure_has_the_same_optimum_from_very_different_seeds():
    polisher = built("vertical", "cp", 0.1)
    problem, task = polisher.problem, TASKS["vertical"]
    first = float(seed("vertical", "cp", 0.1).position[0])
    seeds = [
        seed("vertical", "cp", 0.1),
        on_stages(problem, pseudo_inverse.resolve(task, first, "actuator")),
        motion.from_velocities(problem.step, first, np.zeros(problem.stages + 1), "rest", "none"),
    ]
    energies = [evaluate(task, polished(polisher, start, rounds=2)).energy_cp for start in seeds]
    assert max(energies) / min(energies) - 1.0 < 1e-3, energies


def test_a_free_start_is_feasible_and_not_dearer_than_a_fixed_one():
    polisher, start = built("vertical", "cp", 0.1), seed("vertical", "cp", 0.1)
    problem = polisher.problem
    fixed, free = polished(polisher, start), polished(polisher, start, free=True)
    low, high = problem.intervals[0][0]
    assert low - 1e-9 <= free.position[0] <= high + 1e-9
    assert free.position[0] != pytest.approx(fixed.position[0], abs=1e-3)
    task: Task = problem.task
    assert evaluate(task, free).energy_cp <= evaluate(task, fixed).energy_cp * 1.001


def test_polishing_twice_changes_nothing():
    """With unchanged modes the answer is the optimum already."""
    polisher = built("vertical", "cp", 0.1)
    once = polished(polisher, seed("vertical", "cp", 0.1))
    twice = polished(polisher, once)
    assert evaluate(polisher.problem.task, twice).energy_cp == pytest.approx(
        evaluate(polisher.problem.task, once).energy_cp, rel=1e-4
    )
