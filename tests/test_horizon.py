"""Receding horizon: only what is in sight counts, limits are kept, and little is lost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from leanboom.components.valves import MobileValve
from leanboom.dynamic_programming import grids, value_function
from leanboom.errors import InfeasibleError, InputError
from leanboom.evaluation.evaluate import evaluate
from leanboom.io.loading import load_task
from leanboom.methods import pseudo_inverse
from leanboom.model import crane as cranes
from leanboom.model.task import Moved
from leanboom.planning import receding_horizon
from leanboom.problem import stages

TASK = replace(load_task("forwarder-vertical"), start="middle")
QUICK = {"horizon": 1.5, "every": 0.5, "step": 0.1, "grid": (41, 21)}


@pytest.fixture(scope="module")
def recedings():
    return {pump: receding_horizon.plan_receding(TASK, pump=pump, **QUICK) for pump in ("ls", "cp")}


@pytest.mark.slow
@pytest.mark.parametrize("pump", ["ls", "cp"])
def test_limits_are_kept_and_energy_lies_between_whole_path_and_pseudo_inverse(recedings, pump):
    found = recedings[pump]
    judged = evaluate(TASK, found)
    assert found.status == "solved" and judged.feasible
    assert found.velocity[0] == 0.0 and found.velocity[-1] == pytest.approx(0.0, abs=1e-9)
    today = evaluate(TASK, pseudo_inverse.resolve(TASK, float(found.position[0])))
    assert judged.energy(pump) < 0.8 * today.energy(pump)
    problem = stages.discretise(TASK, 0.1)
    whole = evaluate(
        TASK,
        value_function.rollout(
            value_function.solve(problem, grids.full_grid(problem, 201, 101), pump), found.position[0]
        ),
    )
    assert 0.9 * whole.energy(pump) < judged.energy(pump) < 1.25 * whole.energy(pump)


def test_nothing_beyond_the_horizon_changes_what_is_done_now(recedings):
    """The target moves at 4 s: plans made up to 2.5 s do not see it, and the one of 2.5 s is carried out until 3 s."""
    moved = replace(TASK, path=Moved(TASK.path, (0.2, 0.1, 0.2), 4.0, 1.5))
    other = receding_horizon.plan_receding(moved, pump="cp", **QUICK)
    assert other.status == "solved"
    np.testing.assert_array_equal(other.velocity[:31], recedings["cp"].velocity[:31])
    np.testing.assert_array_equal(other.position[:31], recedings["cp"].position[:31])
    assert np.abs(other.velocity[31:] - recedings["cp"].velocity[31:]).max() > 1e-3


def test_a_horizon_over_the_whole_path_is_one_plan():
    found = receding_horizon.plan_receding(TASK, pump="cp", **{**QUICK, "horizon": 6.0})
    assert len(found.log) == 1 and found.log[0].endswith("solved")
    longer = receding_horizon.plan_receding(TASK, pump="cp", **{**QUICK, "horizon": 60.0})
    np.testing.assert_array_equal(found.velocity, longer.velocity)


def test_the_price_pays_for_room_and_for_being_able_to_stop():
    ends = receding_horizon.TerminalCost(low=1.0, high=3.0, margin=0.5, value=100.0, brake=0.5, slope=1e4)
    price = [float(ends(np.array(c), np.array(0.0))) for c in (1.0, 1.25, 1.5, 2.0, 3.0)]
    assert price == pytest.approx([25.0, 6.25, 0.0, 0.0, 0.0])  # a triangle's area: 100 J/m over half of 0.5 m
    # 0.5 m/s needs 0.25 m to stop.
    assert float(ends(np.array(2.75), np.array(0.5))) == pytest.approx(0.0)
    assert float(ends(np.array(2.85), np.array(0.5))) == pytest.approx(0.1 * 1e4)
    assert float(ends(np.array(1.6), np.array(-1.0))) == pytest.approx(0.4 * 1e4)


def test_room_is_worth_the_power_of_extending_by_a_metre_a_second():
    """Supply pressure and flow are those of the formulas, back pressures and the pump's losses among them."""
    task = load_task("loader-triangle-small")
    pump = replace(task.machine.pump, efficiency=0.8)
    valve = MobileValve(1e6, 2.0, 3.0, 1.0)
    task = replace(task, machine=replace(task.machine, pump=pump, valve=valve), start="middle")
    problem = stages.discretise(task, 0.05)
    middle = 0.5 * float(problem.lower[-1] + problem.upper[-1])
    pose = cranes.pose(problem.crane, problem.plane[-1], middle)
    rates = [float(v) for v in cranes.move(pose, 1.0, 0.0).velocity]
    loads = [float(load) for load in cranes.move(pose, 0.0, 0.0).load]
    lines = list(zip(task.machine.cylinders, loads, rates, strict=True))[problem.moving]
    flow = sum(c.piston_area * v if v > 0 else c.rod_side_area * -v for c, _, v in lines)
    asked = [
        f / c.piston_area + c.rod_side_area / c.piston_area * 2e6 if f > 0 else
        -f / c.rod_side_area + c.piston_area / c.rod_side_area * 3e6
        for c, f, _ in lines
    ]  # fmt: skip
    for cost, supply in (("ls", max(asked) + pump.ls_margin), ("cp", pump.constant_pressure)):
        assert receding_horizon.terminal_cost(problem, cost).value == pytest.approx(
            receding_horizon.RETRACTION_VALUE * supply * flow / 0.8, rel=1e-9
        )


def test_progress_is_told():
    told = []
    receding_horizon.plan_receding(TASK, pump="cp", **QUICK, progress=lambda text, share: told.append((text, share)))
    assert told[0] == ("plan at 0.0 s of 6 s", 0.0) and len(told) == 10
    assert [share for _, share in told] == sorted(share for _, share in told)


def test_a_path_out_of_reach_is_refused_when_it_comes_into_sight():
    gone = replace(TASK, path=Moved(TASK.path, (9.0, 0.0, 0.0), 3.0, 2.0))
    with pytest.raises(InfeasibleError, match="the path leaves the crane's reach"):
        receding_horizon.plan_receding(gone, pump="cp", **QUICK)


def test_bad_arguments_are_refused_with_what_to_change():
    for wrong, text in (
        ({"horizon": 0.04}, "horizon = 0.04 s; must be at least two stages, 0.2 s"),
        ({"horizon": float("nan")}, "horizon = nan s; must be at least two stages, 0.2 s"),
        ({"every": 2.0}, "every = 2 s; must be from one stage, 0.1 s, to the horizon, 1.5 s"),
        ({"every": 0.01}, "every = 0.01 s; must be from one stage, 0.1 s, to the horizon, 1.5 s"),
        ({"step": 3.0}, "step = 3 s; must be from 0.001 s to 1 s"),
        ({"pump": "steam"}, "pump = steam; must be one of ls, cp"),
        ({"pump": "velocity"}, "pump = velocity; must be one of ls, cp"),
        ({"grid": (2, 21)}, "grid = 2x21; needs at least 3 positions and 3 velocities"),
    ):
        with pytest.raises(InputError) as error:
            receding_horizon.plan_receding(TASK, **{**QUICK, **wrong})
        assert str(error.value) == text
    with pytest.raises(InputError, match="start = best; needs the whole path, choose smallest, middle or a length"):
        receding_horizon.plan_receding(replace(TASK, start="best"), **QUICK)
