"""The search: feasible is feasible whatever the cost, and no plan is beaten by another look at the same task."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from leanboom import resources
from leanboom.certificate import lower_bounds, partition, upper_bound
from leanboom.errors import InputError
from leanboom.evaluation.evaluate import judged_cost
from leanboom.io.loading import load_task
from leanboom.methods import dp_refined
from leanboom.model import motion
from leanboom.model.machine import Machine
from leanboom.model.task import Lines, Task
from leanboom.planning import planner
from leanboom.problem import stages, starts
from leanboom.problem.legs import Legs
from leanboom.report import plan_page

CASES = Path(__file__).parent / "cases"
SAME = 1e-3  # relations between plans hold to this share
COARSELY = 5e-3  # on grids as coarse as these, load-sensing plans differ by the switches that the grid shows
VERTICAL = replace(load_task("forwarder-vertical"), start="middle")
EDGE = replace(
    load_task("loader-triangle-small"), start="middle", path=Lines(((2.6, 0.0, 0.5), (3.2, 0.0, 1.1667)), (5.0,))
)
COARSE = {"grid": (41, 31), "step": 0.1, "baseline": False}


def limits(task: Task, velocity: float = 1.0, acceleration: float = 1.0) -> Task:
    """The same task with other limits."""
    cylinders = tuple(
        replace(c, velocity_limit=velocity * c.velocity_limit, acceleration_limit=acceleration * c.acceleration_limit)
        for c in task.machine.cylinders
    )
    machine: Machine = replace(task.machine, cylinders=cylinders)
    return replace(task, machine=machine)


def energy(task: Task, pump: str, **options) -> float:
    return planner.run(task, pump=pump, **(COARSE | options)).evaluation.energy(pump)


# Feasible is feasible


@pytest.mark.slow
@pytest.mark.parametrize("pump", planner.PUMPS)
def test_whether_there_is_a_motion_does_not_depend_on_the_pump(pump):
    plan = planner.run(load_task(CASES / "tight-corner.yaml"), pump=pump, baseline=False)
    assert plan.evaluation.feasible


def test_other_costs_lead_to_a_feasible_motion_where_this_one_does_not():
    """A search whose own candidates all fail is led to a motion by its constant-pressure cost."""
    looking = dp_refined.Search(VERTICAL, "ls", (41, 31), 0.1)
    problem = stages.discretise(VERTICAL, 0.1)
    start = starts.start_position(problem, "middle")
    assert start is not None
    velocity = np.zeros(problem.stages + 1)
    velocity[1] = 5.0
    looking.judge(motion.from_velocities(problem.step, start, velocity, "dp", "ls"), "a motion far too fast")
    assert not looking.known_best().feasible
    looking.span = problem.pace
    looking.from_other_costs(problem, start)
    assert looking.known_best().feasible


def test_plans_do_not_depend_on_the_number_of_threads(monkeypatch):
    """Local minima are searched beside each other, each without knowing what the others find meanwhile."""
    found = []
    for threads in ("1", "3"):
        monkeypatch.setenv("LEANBOOM_THREADS", threads)
        looking = dp_refined.Search(VERTICAL, "ls", (41, 31), 0.1)
        problem = stages.discretise(VERTICAL, 0.1)
        start = starts.start_position(problem, "middle")
        assert start is not None
        seeds = looking.coarse(problem, start)
        assert len(seeds) > 1
        around = looking.descend_all(problem, seeds, start, dp_refined.NEXT_LEVELS)
        found.append((looking.known_best(), around, [text.split("  ")[-1] for text in looking.log]))
    one, three = found
    assert np.array_equal(one[0].motion.velocity, three[0].motion.velocity)
    assert [each.energy_ls for each in one[1]] == [each.energy_ls for each in three[1]]
    assert one[2] == three[2]


def moved(seconds: float) -> Task:
    """The vertical path in another time."""
    assert isinstance(VERTICAL.path, Lines)
    return replace(VERTICAL, path=Lines(VERTICAL.path.points, (seconds,)))


def test_no_motion_is_proven_only_where_there_is_none():
    for task, proven in ((VERTICAL, False), (moved(0.5), True)):
        problem = stages.discretise(task, 0.05)
        for start in (starts.start_position(problem, "middle"), None):
            assert lower_bounds.excludes_motion(problem, start) == proven


def test_a_proof_takes_no_more_memory_than_there_is(monkeypatch):
    """Cells of an hour took 40 GiB: larger ones prove as much here, and where none fit nothing is proven."""
    problem = stages.discretise(moved(0.5), 0.05)
    needs = [
        partition.memory_of(Legs((problem,)), partition.size(Legs((problem,)), "cp", times=times))
        for times in ((1, 1), *partition.COARSE)
    ]
    taken = []
    whole = partition.whole

    def measured(*arguments, **settings):
        found = whole(*arguments, **settings)
        taken.append(8.0 * sum(a.size for a in (*found.active, *found.model)))
        return found

    monkeypatch.setattr(lower_bounds, "whole", measured)
    for free, proven in ((4.0 * needs[0], True), (0.5 * needs[0], True), (0.5 * min(needs), False)):
        taken.clear()
        monkeypatch.setattr(resources, "free_memory", lambda free=free: free)
        assert lower_bounds.excludes_motion(problem, None) == proven
        assert sum(taken) <= free


def test_a_path_far_too_fast_is_proven_to_have_no_motion():
    status = planner.run(moved(0.5), pump="cp", check=False, grid=(41, 31), baseline=False).motion.status
    assert status.startswith("no feasible motion (proven): ")


# Relations between plans


@pytest.mark.slow
@pytest.mark.parametrize("pump", planner.PUMPS)
@pytest.mark.parametrize("factor", [3.0, 1000.0])
def test_limits_that_no_good_motion_comes_near_change_nothing(pump, factor):
    """Nodes and tubes fit the motion, not the limits: 1000 times wider ones once cost 60 % more."""
    assert energy(limits(EDGE, factor), pump) <= energy(EDGE, pump) * (1.0 + COARSELY)


@pytest.mark.slow
@pytest.mark.parametrize("pump", planner.PUMPS)
def test_a_warm_start_is_never_lost(pump):
    tight = limits(VERTICAL, acceleration=0.7)
    narrow = planner.run(tight, pump=pump, **COARSE)
    wide = planner.run(VERTICAL, pump=pump, warm_start=(narrow.motion,), **COARSE)
    assert wide.evaluation.energy(pump) <= narrow.evaluation.energy(pump)


def test_a_warm_start_of_another_task_is_refused():
    other = planner.run(EDGE, pump="cp", **COARSE).motion
    with pytest.raises(InputError, match=r"the motion lasts 5 s, the task forwarder-vertical 6 s"):
        planner.run(VERTICAL, pump="cp", warm_start=(other,), **COARSE)


@pytest.mark.slow
@pytest.mark.parametrize("pump", planner.PUMPS)
def test_the_best_start_costs_no_more_than_any_given_one(pump):
    best = energy(replace(EDGE, start="best"), pump)
    for start in ("smallest", "middle"):
        assert best <= energy(replace(EDGE, start=start), pump) * (1.0 + SAME)


@pytest.mark.slow
@pytest.mark.parametrize("pump", planner.PUMPS)
def test_more_effort_costs_no_more_energy(pump):
    spent = [energy(VERTICAL, pump, effort=effort, seconds=0.1) for effort in ("quick", "default", "thorough")]
    assert spent[1] <= spent[0] * (1.0 + SAME)
    assert spent[2] <= spent[1] * (1.0 + SAME)


def test_thorough_proves_how_far_from_the_optimum_the_plan_can_be():
    """The bound lies below what the planned motion takes in the same discretised problem, and the report says so."""
    step = 0.1
    plan = planner.run(VERTICAL, pump="cp", effort="thorough", seconds=0.1, grid=(41, 31), step=step, baseline=False)
    proof = plan.certificate
    assert proof is not None
    problem = stages.discretise(VERTICAL, step)
    measured = upper_bound.measure(problem, stages.on_stages(problem, plan.motion), "cp")
    assert 0.0 < proof.lower_bound_j <= proof.energy_j
    assert not measured.keeps_limits or proof.energy_j <= measured.energy
    assert f"{proof.lower_bound_j / 1e3:.2f} kJ, {proof.gap_percent:.2f} % below" in plan_page.page(plan)


def test_what_a_proof_finds_is_one_more_seed():
    looking = dp_refined.Search(VERTICAL, "cp", (41, 31), 0.1, dp_refined.EFFORTS["quick"])
    better = planner.plan(VERTICAL, "cp", grid=(41, 31), step=0.1)
    held = motion.from_velocities(0.1, float(better.position[0]), np.zeros(61), "dp", "cp")
    before = looking.judge(held, "a motion that does not move").energy_cp
    assert looking.look_around(better).energy_cp < before


def test_an_unknown_effort_names_the_known_ones():
    with pytest.raises(InputError, match="effort = all; must be one of quick, default, thorough"):
        planner.plan(VERTICAL, effort="all")


def test_the_log_ends_with_the_best_motion_among_its_candidates():
    """Every candidate's cost stands in the log, and none is lower than the plan's where it was solved."""
    plan = planner.run(EDGE, pump="ls", **COARSE)
    solved = [float(line.split(": ")[-1].split(",")[0]) for line in plan.motion.log if line.endswith("solved")]
    assert len(solved) >= 3
    assert judged_cost(plan.evaluation, "ls") == pytest.approx(min(solved), rel=1e-5)
    assert np.all(np.isfinite(solved))
