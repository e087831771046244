"""Feedback and re-planning: control and motion from any state, stops where there is no motion, errors."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import slow_reference as slow
from leanboom.dynamic_programming import grids, value_function
from leanboom.errors import InputError
from leanboom.evaluation import safe_stop
from leanboom.evaluation.evaluate import TOLERANCE, evaluate
from leanboom.io.loading import load_task
from leanboom.model import motion
from leanboom.model.task import Moved
from leanboom.planning import replanning
from leanboom.problem import layout, stages, starts

STEP = 0.1  # [s]
TASK = replace(load_task("forwarder-vertical"), start="middle")


def solved(cost: str, positions: int = 101, velocities: int = 51) -> value_function.Policy:
    problem = stages.discretise(TASK, STEP)
    return value_function.solve(problem, grids.full_grid(problem, positions, velocities), cost)


@pytest.fixture(scope="module")
def policies() -> dict[str, value_function.Policy]:
    return {cost: solved(cost) for cost in ("ls", "cp")}


def planned(policy: value_function.Policy) -> motion.Motion:
    return value_function.rollout(policy, starts.start_position(policy.problem, "middle"))


def state(found, time: float) -> tuple[float, float]:
    c, w, _ = found.at(np.array(time))
    return float(c), float(w)


# Control


@pytest.mark.parametrize("cost", ["ls", "cp"])
def test_control_at_a_stage_is_that_of_the_rollout(policies, cost):
    policy = policies[cost]
    found = planned(policy)
    ours = [policy.control(k * STEP, found.position[k], found.velocity[k]) for k in range(policy.problem.stages)]
    assert ours == found.acceleration.tolist()


@pytest.mark.parametrize("cost", ["ls", "cp", "actuator"])
def test_control_between_stages_equals_its_twin(cost):
    """The rest of the stage as the step, tables mixed linearly in time: the least of the same corners."""
    policy = solved(cost, 21, 15)
    table, rng = policy.tables, np.random.default_rng(7)
    moved = 0
    for _ in range(60):
        k, share = int(rng.integers(0, policy.problem.stages)), float(rng.uniform(0.05, 0.95))
        low, high = table.stage[k, layout.C_LO], table.stage[k, layout.C_LO] + 20 * table.stage[k, layout.DC]
        c, w = float(rng.uniform(low, high)), float(rng.uniform(-0.3, 0.3))
        ahead = policy.values[k + 1].astype(float)
        small = slow.Small(
            table.coefficients, table.outside, table.stage.copy(), table.cylinder, policy.setting.copy(), ahead, cost
        )
        rows = [slow.row_at(small, n, c) for n in (k, k + 1)]
        row = (1.0 - share) * rows[0][0] + share * rows[1][0]
        off = (1.0 - share) * rows[0][1] + share * rows[1][1]
        for column in (layout.FIXED_FLOW, layout.FIXED_PRESSURE, layout.FIXED_COST):
            small.stage[k, column] = (1.0 - share) * table.stage[k, column] + share * table.stage[k + 1, column]
        small.setting[layout.STEP] = (1.0 - share) * STEP
        wanted, _ = slow.least(small, k, row, off, c, w, ahead, fine=2)
        u = policy.control((k + share) * policy.problem.step, c, w)
        ours = float(slow.costs_of(small, k, row, off, c, w, np.array([u]), ahead)[0])
        assert ours == pytest.approx(wanted, rel=1e-6)
        moved += u != policy.control(k * policy.problem.step, c, w)
    assert moved > 8  # a look-ahead over whole stages would have answered differently


def test_control_held_between_stages_stays_the_best_on_the_planned_motion(policies):
    """Half way through a stage most controls are still what they were: the plan is consistent in time."""
    found = planned(policies["cp"])
    times = (np.arange(found.acceleration.size) + 0.5) * STEP
    ours = np.array([policies["cp"].control(float(t), *state(found, t)) for t in times])
    assert np.mean(np.abs(ours - found.acceleration) < 1e-9) > 0.8


# Replan by the policy


@pytest.mark.parametrize("cost", ["ls", "cp"])
@pytest.mark.parametrize("stage", [0, 23, 59])
def test_replanning_on_the_planned_motion_is_its_rest(policies, cost, stage):
    policy = policies[cost]
    found = planned(policy)
    rest = policy.replan(stage * STEP, found.position[stage], found.velocity[stage])
    assert rest.status == "solved" and not rest.stopping
    assert rest.since == pytest.approx(stage * STEP)
    np.testing.assert_array_equal(rest.motion.position, found.position[stage:])
    np.testing.assert_array_equal(rest.motion.acceleration, found.acceleration[stage:])
    whole = evaluate(TASK, found)
    spent = np.interp(stage * STEP, whole.time, whole.cumulative_ls if cost == "ls" else whole.cumulative_cp)
    assert rest.evaluation.energy(cost) == pytest.approx(whole.energy(cost) - spent, rel=1e-6, abs=0.5)


@pytest.mark.parametrize("cost", ["ls", "cp"])
def test_replanning_between_stages_goes_on_from_exactly_there(policies, cost):
    policy = policies[cost]
    found = planned(policy)
    whole = evaluate(TASK, found)
    time = 2.537
    rest = policy.replan(time, *state(found, time))
    assert rest.status == "solved"
    assert rest.motion.lead == pytest.approx(0.063) and rest.motion.duration == pytest.approx(6.0 - time)
    assert rest.at(np.array(time))[:2] == pytest.approx(state(found, time), abs=1e-12)
    # The samples after the first are at the stages: positions follow from the accelerations, first interval shorter.
    assert rest.motion.at(np.array([0.063, 0.163]))[0] == pytest.approx(rest.motion.position[1:3], abs=1e-12)
    spent = np.interp(time, whole.time, whole.cumulative_ls if cost == "ls" else whole.cumulative_cp)
    assert rest.evaluation.energy(cost) == pytest.approx(whole.energy(cost) - spent, rel=0.01)


@pytest.mark.parametrize("cost", ["ls", "cp"])
def test_a_disturbed_motion_goes_on_feasibly_and_no_worse_than_by_tracking(policies, cost):
    policy = policies[cost]
    found = planned(policy)
    compared = 0
    for time, off_c, off_w in ((0.5, 0.03, 0.0), (1.23, -0.02, 0.02), (2.0, 0.02, -0.02), (3.51, 0.1, 0.05)):
        c, w = state(found, time)
        rest = policy.replan(time, c + off_c, w + off_w)
        assert rest.status == "solved" and rest.evaluation.feasible
        left = stages.discretise(safe_stop.rest(TASK, time), STEP)
        search = replanning.Search(left, cost, c + off_c, w + off_w)
        tracked = evaluate(left.task, replanning.track(search, found, time))
        if tracked.feasible:
            compared += 1
            assert rest.evaluation.energy(cost) <= 1.005 * tracked.energy(cost)
    assert compared >= 2


# Planning anew


def test_a_tube_around_the_plan_finds_at_least_what_following_it_costs(policies):
    found = planned(policies["ls"])
    for time, off_c, off_w in ((0.0, 0.0, 0.0), (1.2, 0.03, 0.02), (3.333, -0.03, 0.0)):
        c, w = state(found, time)
        rest = replanning.replan(TASK, time, c + off_c, w + off_w, pump="ls", around=found)
        assert rest.status == "solved"
        assert (rest.motion.position[0], rest.motion.velocity[0]) == (c + off_c, w + off_w)
        assert rest.motion.velocity[-1] == pytest.approx(0.0, abs=1e-9)
        search = replanning.Search(stages.discretise(rest.task, STEP), "ls", c + off_c, w + off_w)
        tracked = evaluate(rest.task, replanning.track(search, found, time))
        assert rest.evaluation.energy_ls <= tracked.energy_ls or not tracked.feasible


def test_planning_anew_without_a_plan_is_near_the_policy(policies):
    found = planned(policies["cp"])
    c, w = state(found, 1.5)
    fresh = replanning.replan(TASK, 1.5, c, w, pump="cp")
    ours = policies["cp"].replan(1.5, c, w)
    assert fresh.status == "solved"
    assert fresh.evaluation.energy_cp <= 1.03 * ours.evaluation.energy_cp


def test_a_path_that_moved_is_followed_to_its_new_end(policies):
    found = planned(policies["cp"])
    moved = replace(TASK, path=Moved(TASK.path, (0.3, 0.2, 0.1), 2.0, 1.5))
    rest = replanning.replan(moved, 2.0, *state(found, 2.0), pump="cp")
    assert rest.status == "solved"
    np.testing.assert_allclose(rest.evaluation.tool[-1], np.array([5.5, 0.0, 1.6]) + [0.3, 0.2, 0.1], atol=1e-6)
    np.testing.assert_allclose(rest.evaluation.tool[0], evaluate(TASK, found).tool[1000], atol=1e-6)


# Stops


def test_a_path_out_of_reach_ends_in_the_shortest_stop_on_the_path(policies):
    found = planned(policies["cp"])
    gone = replace(TASK, path=Moved(TASK.path, (4.0, 0.0, 0.0), 2.0, 4.0))
    c, w = state(found, 2.0)
    stop = replanning.replan(gone, 2.0, c, w, pump="cp")
    judged = stop.evaluation
    assert stop.stopping and judged.feasible and judged.path_error < 1e-6
    assert re.fullmatch(r"no feasible motion: the path leaves the crane's reach at .*; the crane stops within .* s",
                        stop.status)  # fmt: skip
    assert (stop.motion.position[0], stop.motion.velocity[0], stop.motion.velocity[-1]) == (c, w, 0.0)
    np.testing.assert_allclose(judged.velocity[-1], 0.0, atol=1e-9)
    np.testing.assert_allclose(judged.velocity[0], policies_velocity(found, 2.0), atol=1e-9)
    shorter = [lasts for lasts in safe_stop.STOPS if lasts < stop.motion.duration - 1e-9]
    assert shorter, "the shortest stop of all is no test"
    braking = replace(gone, path=replace(stop.task.path, over=shorter[-1]), start="middle")
    for share in safe_stop.SOONER:
        assert not evaluate(braking, safe_stop._slow_down(c, w, shorter[-1], share)).feasible


def policies_velocity(found, time: float) -> np.ndarray:
    return evaluate(TASK, found).velocity[round(time / 0.002)]


def test_a_state_that_breaks_a_limit_is_stopped_as_safely_as_can_be(policies):
    found = planned(policies["cp"])
    fast = 2.0 * TASK.machine.redundant.velocity_limit
    stop = replanning.replan(TASK, 2.0, state(found, 2.0)[0], fast, pump="cp", around=found)
    assert stop.stopping and not stop.evaluation.feasible
    assert "and even that breaks a limit" in stop.status
    assert stop.evaluation.velocity[-1] == pytest.approx(0.0, abs=1e-9)
    assert stop.evaluation.limit_use.worst > TOLERANCE


def test_a_policy_stops_where_its_motion_breaks_a_limit(policies):
    policy = policies["cp"]
    found = planned(policy)
    limit = TASK.machine.redundant.velocity_limit
    low = policy.problem.lower[30]
    stop = policy.replan(3.0, float(low) + 1e-3, -limit)  # cannot stop before the end of its stroke
    assert stop.stopping and stop.status.startswith("no feasible motion: ")
    assert not policy.replan(3.0, *state(found, 3.0)).stopping


# Errors


def test_times_and_states_a_policy_does_not_hold_are_refused(policies):
    policy = policies["cp"]
    c, w = state(planned(policy), 3.0)
    for name in ("control", "replan"):
        ask = getattr(policy, name)
        with pytest.raises(InputError, match="time = 6 s; must be from 0 s to before the end of the path at 6 s"):
            ask(6.0, c, w)
        with pytest.raises(InputError, match="time = -0.1 s"):
            ask(-0.1, c, w)
        with pytest.raises(InputError, match=r"position = 5 m at 3 s; this policy holds .* plan again .* wider grid"):
            ask(3.0, 5.0, w)
        with pytest.raises(InputError, match="velocity = 1 m/s at 3.04 s"):
            ask(3.04, c, 1.0)
        with pytest.raises(InputError, match="position = nan m"):
            ask(3.0, np.nan, w)


def test_bad_arguments_of_a_new_plan_are_refused_all_at_once():
    with pytest.raises(InputError) as error:
        replanning.replan(TASK, 6.0, np.nan, 0.0, pump="steam", grid=(2, 9), step=2.0)
    assert str(error.value) == (
        "time = 6 s; must be from 0 s to 5.99 s, shortly before the end of the path; state = nan m, 0 m/s; must be "
        "finite; pump = steam; must be one of ls, cp, actuator, velocity, extension, recuperation; grid = 2x9; needs "
        "at least 3 positions and 3 velocities; step = 2 s; must be from 0.01 s to 1 s"
    )
    with pytest.raises(InputError, match=r"position = 5 m at 2 s; the tool is on its path there with .* m to .* m: "):
        replanning.replan(TASK, 2.0, 5.0, 0.0)
