"""Viable velocities: nothing a motion does is lost, and little else is left."""

from dataclasses import replace

import numpy as np
import pytest

import slow_bounds
from leanboom import load_task
from leanboom.certificate import partition, viability
from leanboom.model.task import Lines
from leanboom.problem import layout, stages
from leanboom.problem.legs import Legs

STEP, PUSH, LENGTH = 0.1, 0.5, 0.2  # of the sled [s], [m/s^2], [m]


def sled(rows: int, stages_: int) -> viability.Viable:
    """A mass on a track with nothing but an acceleration limit: B3 = 1, all else 0."""
    model = np.zeros((rows, 1, layout.COEFFICIENTS, 4))
    model[:, 0, layout.B3, 0] = 1.0
    cylinder = np.zeros((1, layout.CYLINDER_COLUMNS))
    cylinder[0, layout.A_MAX] = PUSH
    columns = [np.tile([-0.3, 0.3], (rows, 1)) for _ in range(stages_)]
    edges = (np.linspace(0.0, LENGTH, rows + 1),) * (stages_ + 1)
    return viability.viable_velocities(
        viability.BINS * rows, edges, (model,) * stages_, columns, cylinder, np.full(stages_, STEP)
    )


def room_to_stop(speed: float) -> float:
    """How far a mass goes that brakes as hard as it may, at the ends of its steps [m]."""
    way = farthest = 0.0
    while speed > 0.0:
        slower = speed - STEP * PUSH
        way += 0.5 * STEP * (speed + slower)
        farthest, speed = max(farthest, way), slower
    return farthest


def fastest_stop(room: float) -> float:
    """The largest speed from which the mass stops within `room` [m/s], by bisection."""
    low, high = 0.0, 0.3
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if room_to_stop(middle) <= room else (low, middle)
    return low


def test_a_mass_may_be_as_fast_as_it_can_stop_before_the_end():
    found = sled(rows=100, stages_=30)
    bins = found.low.shape[1]
    for b in (0, 3, 20, 100, 400):
        exact, coarser = fastest_stop((b + 1) / bins * LENGTH), fastest_stop((b + 12) / bins * LENGTH)
        assert exact <= -found.low[0, b] + 1e-9  # never cuts what is viable
        assert -found.low[0, b] <= coarser + 1e-9  # and little else is left
        assert found.high[0, bins - 1 - b] == pytest.approx(-found.low[0, b], abs=1e-7)


def test_the_last_stage_is_at_rest_and_bounds_fall_with_position():
    found = sled(rows=10, stages_=5)
    assert not found.low[-1].any()
    assert not found.high[-1].any()
    assert np.all(np.diff(found.low, axis=1) <= 0.0)
    assert np.all(np.diff(found.high, axis=1) <= 0.0)
    # One stage before the end only what one push stops.
    assert found.low[-2].min() >= -STEP * PUSH - 1e-7


def test_a_range_of_positions_takes_the_widest_bounds():
    found = viability.Viable(np.array([[3.0, 2.0, 1.0, 0.0]]), np.array([[9.0, 8.0, 7.0, 6.0]]))
    low, high = found.within(0, np.array([0.0, 0.25, 0.3]), np.array([0.25, 0.75, 0.4]))
    assert low.tolist() == [3.0, 1.0, 2.0]
    assert high.tolist() == [9.0, 8.0, 8.0]


def test_no_random_motion_is_lost(rng):
    task = load_task("loader-triangle-small")
    path = Lines(((2.2, 0.0, 1.2), (2.3, 0.0, 1.25)), (1.5,))
    problem = stages.discretise(replace(task, path=path), 0.1)
    viable = partition.whole(Legs((problem,)), "cp").viable
    length = problem.upper - problem.lower
    seen, tightest = 0, np.inf
    for start in problem.lower[0] + length[0] * np.array([0.0, 0.02, 0.5, 0.98, 1.0]):
        for _ in range(6):
            moving = slow_bounds.random_motion(problem, float(start), rng, 300)
            if moving is None:
                continue
            seen += 1
            for k in range(problem.stages + 1):
                at = np.array([(moving.position[k] - problem.lower[k]) / length[k]])
                low, high = viable.within(k, at - 1e-9, at + 1e-9)
                assert low[0] - 1e-9 <= moving.velocity[k] <= high[0] + 1e-9
                tightest = min(tightest, high[0] - low[0])
    assert seen >= 8
    assert tightest < 0.1  # the bounds say something
