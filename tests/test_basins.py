"""Least costs through every node, and the local minima among them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from leanboom.dynamic_programming import grids, local_minima, value_function
from leanboom.io.loading import load_task
from leanboom.model.task import Lines, Task
from leanboom.problem import layout, stages, starts

STEP = 0.1  # [s]
MIDDLE = replace(load_task("forwarder-vertical"), start="middle")
FORCES, MOTIONS = slice(layout.F0, layout.F3 + 1), slice(layout.A0, layout.B3 + 1)


def turned_round(task: Task) -> Task:
    """The same path driven from its end to its beginning: rest-to-rest quintics are the same both ways."""
    path = task.path
    assert isinstance(path, Lines)
    return replace(task, path=Lines(path.points[::-1], path.durations[::-1]))


@cache
def swept(cost: str, start: float | None) -> local_minima.Through:
    problem = stages.discretise(MIDDLE, STEP)
    return local_minima.through(value_function.solve(problem, grids.full_grid(problem, 61, 41), cost), start)


def middle() -> float:
    start = starts.start_position(stages.discretise(MIDDLE, STEP), "middle")
    assert start is not None
    return start


def test_tables_backward_in_time_are_those_of_the_path_driven_backward():
    """The path's own tables, made anew from the reversed path, are the oracle: motions agree, forces are opposite.

    A force that is the opposite one, on a cylinder whose directions are exchanged, asks for the same pressure.
    """
    tables = []
    for task in (MIDDLE, turned_round(MIDDLE)):
        problem = stages.discretise(task, STEP)
        tables.append(grids.tables(problem, grids.full_grid(problem, 9, 5), "ls"))
    ours, other = local_minima.backward_in_time(tables[0]), tables[1]
    size = np.abs(other.coefficients).max(axis=(0, 1, 2))
    np.testing.assert_allclose(
        ours.coefficients[..., MOTIONS], other.coefficients[..., MOTIONS], atol=1e-7 * size[MOTIONS].max()
    )
    np.testing.assert_allclose(
        ours.coefficients[..., FORCES], -other.coefficients[..., FORCES], atol=1e-7 * size[FORCES].max()
    )
    np.testing.assert_allclose(ours.stage[:, layout.C_LO], other.stage[:, layout.C_LO], atol=1e-8)
    for one, opposite in (
        (layout.AREA_OUT, layout.AREA_IN),
        (layout.GAIN_OUT, layout.GAIN_IN),
        (layout.BACK_OUT, layout.BACK_IN),
    ):
        np.testing.assert_array_equal(ours.cylinder[:, one], other.cylinder[:, opposite])


def test_turning_time_round_twice_changes_nothing():
    problem = stages.discretise(MIDDLE, STEP)
    table = grids.tables(problem, grids.full_grid(problem, 9, 5), "ls")
    again = local_minima.backward_in_time(local_minima.backward_in_time(table))
    for name in ("coefficients", "outside", "stage", "cylinder"):
        np.testing.assert_allclose(getattr(again, name), getattr(table, name), atol=1e-12)


def test_the_least_cost_through_any_stage_is_that_of_the_task_but_for_the_grid():
    """Every motion passes every stage, so the least of M is the same at all of them but for the grid's error.

    At the start it is J itself, at the end B: two independent sweeps, which agree better on a finer grid.
    """
    spreads = []
    for size in ((31, 21), (61, 41)):
        problem = stages.discretise(MIDDLE, STEP)
        found = local_minima.through(value_function.solve(problem, grids.full_grid(problem, *size), "cp"), middle())
        least = found.cost.min(axis=(1, 2))
        spreads.append(float(np.ptp(least) / np.median(least)))
    assert spreads[1] < 0.75 * spreads[0]
    assert spreads[1] < 0.15


def ends(found: local_minima.Through, stage: int) -> tuple[float, float]:
    grid = found.policy.grid
    return float(grid.c_lo[stage]), float(grid.c_hi[stage])


@pytest.mark.parametrize("stage", [0, 17, 60])
def test_a_motion_through_a_state_passes_it(stage):
    found = swept("ls", middle())
    low, high = ends(found, stage)
    position = middle() if stage == 0 else 0.5 * (low + high)
    made = found.motion(stage, position, 0.0)
    assert made.velocity[0] == made.velocity[-1] == 0.0
    assert made.position[0] == pytest.approx(middle(), abs=0.02)
    assert made.position[stage] == pytest.approx(position, abs=0.02)  # velocities at the ends are set to rest


@pytest.mark.parametrize(("start", "least"), [(None, 2), ("middle", 1)])
def test_local_minima_are_apart_and_the_best_comes_first(start, least):
    found = swept("ls", None if start is None else middle())
    motions = local_minima.local_minima(found, 0.3, 5)
    assert least <= len(motions) <= 5
    width = max(high - low for low, high in (ends(found, k) for k in range(61)))
    for i, one in enumerate(motions):
        for other in motions[:i]:
            assert np.abs(one.position - other.position).max() > local_minima.APART * width
    best = found.motion(*least_node(found))
    assert np.abs(motions[0].position - best.position).max() < local_minima.APART * width
    assert len(local_minima.local_minima(found, 0.3, 1)) == 1
    assert len(local_minima.local_minima(found, 0.0, 5)) <= len(motions)


def least_node(found: local_minima.Through) -> tuple[int, float, float]:
    """The node of least cost at the first stage."""
    stage, cost = found.policy.tables.stage[0], found.cost[0]
    i, j = np.unravel_index(int(cost.argmin()), cost.shape)
    return (
        0,
        float(stage[layout.C_LO] + stage[layout.DC] * i),
        float(stage[layout.W_LO] + stage[layout.DW] * j),
    )
