"""Ends that a task asks for, and rest there: planner, judge, re-planning, certificate, input."""

from dataclasses import replace

import numpy as np
import pytest

import leanboom as lb
from leanboom.certificate import certificate
from leanboom.components.costs import PUMPS
from leanboom.dynamic_programming import grids, value_function
from leanboom.errors import InputError
from leanboom.fixed_mode import modes
from leanboom.methods import closed_cycle
from leanboom.model import motion
from leanboom.model.task import Lines, Part
from leanboom.planning import planner
from leanboom.problem import stages, starts

VERTICAL = lb.load_task("forwarder-vertical", start="middle")
CLOSED = replace(VERTICAL, end="same")
QUICK = {"grid": (61, 41), "step": 0.1, "effort": "quick", "baseline": False}


@pytest.mark.parametrize("pump", PUMPS)
def test_a_closed_cycle_ends_where_it_starts(pump):
    plan = planner.run(CLOSED, pump=pump, **QUICK)
    assert plan.solved
    assert plan.motion.position[-1] == pytest.approx(plan.motion.position[0], abs=1e-9)
    assert plan.motion.velocity[-1] == 0.0
    free = planner.run(VERTICAL, pump=pump, **QUICK)
    assert abs(free.motion.position[-1] - free.motion.position[0]) > 1e-3
    assert free.evaluation.energy(pump) < plan.evaluation.energy(pump)


def test_no_finer_dynamic_program_ends_at_a_length_for_less():
    """The dense program knows nothing of tubes or of the polish's two last controls."""
    end = 0.6
    plan = planner.run(replace(VERTICAL, end=end), pump="cp", **QUICK)
    problem = stages.discretise(VERTICAL, 0.1)
    start = starts.start_position(problem, "middle")
    policy = value_function.solve(problem, grids.full_grid(problem, 401, 151), "cp", end=end)
    dense = lb.evaluate(plan.evaluation.task, value_function.rollout(policy, start))
    assert plan.motion.position[-1] == pytest.approx(end, abs=1e-9)
    assert plan.evaluation.energy_cp <= dense.energy_cp
    assert plan.evaluation.energy_cp >= 0.98 * dense.energy_cp


def test_the_fixed_mode_program_leads_to_the_end_and_no_shift_of_its_answer_is_better():
    """Optimal with two controls spent on the end: any feasible change that keeps both ends costs more."""
    problem = stages.discretise(CLOSED, 0.1)
    start = starts.start_position(problem, "middle")
    seed = motion.from_velocities(0.1, start, np.zeros(problem.stages + 1), "dp", "cp")
    polisher = modes.build(problem, "cp")
    answer, text = modes.solve(polisher, seed, modes.modes(polisher, seed))
    assert answer is not None, text
    assert answer.position[-1] == pytest.approx(start, abs=1e-12)
    best = lb.evaluate(CLOSED, answer)
    assert best.feasible
    node = np.linspace(0.0, 1.0, problem.stages + 1)
    for waves in (2, 3, 4):
        for size in (-2e-3, 2e-3):
            bump = size * np.sin(np.pi * waves * node) * node * (1.0 - node)
            moved = motion.from_velocities(0.1, start, answer.velocity + bump, "dp", "cp")
            other = lb.evaluate(CLOSED, motion.ending_at(moved, start))
            assert other.energy_cp >= best.energy_cp * (1.0 - 1e-5) or not other.feasible


@pytest.mark.slow
def test_the_best_closed_cycle_costs_no_more_than_those_of_given_starts():
    free = replace(CLOSED, start="best")
    plan = planner.run(free, pump="cp", **QUICK)
    assert plan.solved
    assert plan.motion.position[-1] == pytest.approx(plan.motion.position[0], abs=1e-9)
    problem = stages.discretise(free, 0.1)
    for start in closed_cycle.common_lengths(problem, problem)[::2]:
        given = planner.run(replace(CLOSED, start=float(start)), pump="cp", check=False, **QUICK)
        assert not given.solved or plan.evaluation.energy_cp <= 1.005 * given.evaluation.energy_cp


def test_a_smallest_end_is_the_least_feasible_length_at_the_end():
    plan = planner.run(replace(VERTICAL, end="smallest"), pump="cp", **QUICK)
    problem = stages.discretise(VERTICAL, 0.1)
    assert plan.motion.position[-1] == pytest.approx(problem.lower[-1], abs=1e-9)


# The judge


def test_the_judge_tells_where_a_motion_ends_and_whether_it_rests():
    slow = motion.from_velocities(0.1, 0.7, 0.05 * np.sin(np.pi * np.linspace(0.0, 1.0, 61)) ** 2, "dp", "cp")
    judged = lb.evaluate(CLOSED, slow)
    assert judged.status == "the extension ends at 0.8500 m, and must end at 0.7000 m (end: same)"
    assert lb.evaluate(replace(CLOSED, end=float(slow.position[-1])), slow).feasible
    assert lb.evaluate(VERTICAL, slow).feasible
    moving = motion.from_velocities(0.1, 0.7, np.linspace(0.0, 0.01, 61), "dp", "cp")
    assert lb.evaluate(VERTICAL, moving).status.startswith("the extension still moves by 0.0100 m/s at the end")


def test_what_is_not_the_end_of_a_task_may_move():
    part = replace(CLOSED, path=Part(CLOSED.path, 0.0, 3.0))
    moving = motion.from_velocities(0.1, 0.7, np.linspace(0.0, 0.01, 31), "dp", "cp")
    assert lb.evaluate(part, moving).feasible
    assert not part.whole and CLOSED.whole
    assert replace(CLOSED, path=Part(CLOSED.path, 3.0, CLOSED.duration)).whole


# On the way, and proofs


def test_what_is_left_of_a_closed_cycle_ends_where_it_started():
    plan = planner.run(CLOSED, pump="cp", **QUICK)
    c, w, _ = plan.motion.at(np.array([2.0]))
    rest = lb.replan(CLOSED, 2.0, float(c[0]) + 1e-3, float(w[0]), pump="cp", around=plan.motion)
    assert rest.solved
    assert rest.motion.position[-1] == pytest.approx(plan.motion.position[0], abs=1e-9)
    best = replace(CLOSED, start="best")  # where it began is where the plan ends
    again = lb.replan(best, 2.0, float(c[0]) + 1e-3, float(w[0]), pump="cp", around=plan.motion)
    assert again.motion.position[-1] == pytest.approx(plan.motion.position[0], abs=1e-4)


@pytest.mark.slow
def test_a_policy_ends_where_it_was_told_to():
    problem = stages.discretise(VERTICAL, 0.1)
    start = starts.start_position(problem, "middle")
    policy = value_function.solve(problem, grids.full_grid(problem, 101, 51), "cp", end=start)
    moved = value_function.rollout(policy, start)
    rest = policy.replan(2.03, *(float(values[0]) for values in moved.at(np.array([2.03]))[:2]))
    assert rest.solved
    assert rest.motion.position[-1] == pytest.approx(start, abs=1e-9)


def test_a_receding_horizon_ends_where_the_task_asks():
    moved = lb.plan_receding(CLOSED, pump="ls", horizon=4.0, grid=(61, 41), step=0.1)
    assert moved.position[-1] == pytest.approx(moved.position[0], abs=1e-4)


@pytest.mark.slow
def test_a_bound_knows_the_end():
    """It is above the bound with a free end, and below what closed motions cost."""
    proofs = []
    for task in (VERTICAL, CLOSED):
        plan = planner.run(task, pump="cp", **QUICK)
        proofs.append(certificate.certify(task, "cp", motion=plan.motion, step=0.1, seconds=4.0, gap=10.0))
    free, closed = proofs
    assert free.energy_j < closed.lower_bound_j <= closed.energy_j
    assert closed.motion.position[-1] == pytest.approx(closed.motion.position[0], abs=1e-9)


# Input


def test_an_end_is_written_and_read(tmp_path):
    for end in ("same", 0.5):
        file = tmp_path / "task.yaml"
        file.write_text(lb.io.loading.dump_task(replace(VERTICAL, end=end), "forwarder"))
        assert lb.load_task(file).end == end
    assert lb.load_task(file, end="30 cm").end == pytest.approx(0.3)
    assert lb.load_task("forwarder-vertical").end == "free"


@pytest.mark.parametrize(
    ("end", "message"),
    [
        ("there", r"end = there; must be free, same, smallest, middle, or a length of the redundant cylinder such as"),
        (9.0, r"end = 9; must be from 0 to [0-9.]+ m, the stroke of the extension cylinder"),
        (1.8, r"end = 1.8 m; feasible at the end of this path: "),
    ],
)
def test_an_end_that_cannot_be_is_named(end, message):
    with pytest.raises(InputError, match=message):
        planner.run(replace(VERTICAL, end=end), pump="cp", **QUICK)


def test_a_cycle_that_cannot_close_is_refused():
    open_path = lb.load_task("forwarder-horizontal")
    with pytest.raises(InputError, match=r"end = same; at the beginning of the path .* are feasible, at its end "):
        planner.run(replace(open_path, start="best", end="same"), pump="cp", **QUICK)
    with pytest.raises(InputError, match=r"end = same, and the start is 0.0000 m; feasible at the end of this path"):
        planner.run(replace(open_path, end="same"), pump="cp", **QUICK)


def test_methods_that_leave_the_end_free_say_so():
    with pytest.raises(InputError, match="end = same; method dp1 cannot lead the motion to an end: use dp or polish"):
        planner.run(CLOSED, pump="cp", method="dp1")


def test_the_baseline_of_a_closed_cycle_has_a_free_end():
    plan = planner.run(CLOSED, pump="cp", **(QUICK | {"baseline": True}))
    assert plan.baseline is not None and plan.baseline.task.end == "free"


def test_leading_a_motion_to_an_end_keeps_its_start_and_its_clock():
    """Also one that begins between two stages; nothing changes where it ends there already."""
    velocity = 0.05 * np.sin(np.pi * np.linspace(0.0, 1.0, 11))
    whole = motion.from_velocities(0.1, 0.3, velocity, "dp", "cp")
    steps = np.array([0.04, *[0.1] * 9])
    along = 0.3 + np.concatenate([[0.0], np.cumsum(0.5 * steps * (velocity[1:] + velocity[:-1]))])
    late = motion.make(0.1, along, velocity, np.diff(velocity) / steps, "dp", "cp", lead=0.04)
    for moved in (whole, late):
        led = motion.ending_at(moved, 0.31)
        assert led.position[-1] == pytest.approx(0.31, abs=1e-12)
        assert (led.position[0], led.velocity[0], led.duration) == (moved.position[0], velocity[0], moved.duration)
        steps = np.diff(led.breaks)
        np.testing.assert_allclose(led.velocity[1:] - led.velocity[:-1], steps * led.acceleration, atol=1e-14)
    assert motion.ending_at(whole, float(whole.position[-1])) is whole


def test_a_path_of_lines_is_whole():
    assert replace(VERTICAL, path=Lines(((3.0, 0.0, 1.0), (4.0, 0.0, 1.0)), (3.0,))).whole
