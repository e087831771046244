"""Viable velocities and slopes from a policy: nothing a motion does is lost, and the end of the stroke is seen."""

from dataclasses import replace

import numpy as np
import pytest

import slow_bounds
from leanboom import bounds, cells, certify, guide, incumbent, kernels, load_task, stages, viability
from leanboom.task import Lines
from slow_bounds import quiet

STEP, PUSH, LENGTH = 0.1, 0.5, 0.2  # of the sled [s], [m/s^2], [m]


def sled(rows: int, stages_: int) -> viability.Viable:
    """A mass on a track with nothing but an acceleration limit: B3 = 1, all else 0."""
    lattice = np.zeros((stages_ + 1, bounds.LATTICE))
    lattice[:, bounds.L_DC] = LENGTH / rows
    model = np.zeros((rows, 1, kernels.COEFFICIENTS, 4))
    model[:, 0, kernels.B3, 0] = 1.0
    cylinder = np.zeros((1, kernels.CYLINDER_COLUMNS))
    cylinder[0, kernels.A_MAX] = PUSH
    columns = [np.tile([-0.3, 0.3], (rows, 1)) for _ in range(stages_)]
    return viability.find(lattice, (model,) * stages_, columns, cylinder, STEP)


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
    viable = cells.whole(problem, "cp").viable
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


@pytest.fixture(scope="module")
def loader():
    """The medium triangle from the retracted telescope, coarsely, and its cells."""
    task = replace(load_task("loader-triangle-medium"), start="smallest")
    problem = stages.discretise(task, 0.25)
    return problem, cells.whole(problem, "cp")


def test_guided_bounds_see_the_end_of_the_stroke_and_stay_below_every_motion(loader, rng):
    problem, kept = loader
    start = float(problem.lower[0])
    known = guide.make(problem, "cp", kept.viable)
    guided = cells.bound(kept, start, quiet, known.slopes)
    assert guided.lower > 1.005 * cells.bound(kept, start, quiet).lower
    # Nor above a policy's motion, stage by stage.
    moving = guide.dp.rollout(known.policy, start)
    measured = incumbent.measure(problem, moving, "cp")
    assert measured.keeps_limits
    assert guided.lower <= measured.energy
    assert cells.residuals(guided, moving, measured.costs).min() >= -1e-9 * measured.energy


def test_slopes_are_the_policys_where_no_state_is_lost_and_the_nearest_elsewhere(loader):
    problem, kept = loader
    known = guide.make(problem, "cp", kept.viable)
    k, grid = 10, known.policy.grid
    position = np.linspace(grid.c_lo[k], grid.c_hi[k], grid.positions)
    velocity = np.linspace(grid.w_lo[k], grid.w_hi[k], grid.velocities)
    values = known.policy.values.copy()
    values[k] = 1e4 * (position[:, None] - grid.c_lo[k]) ** 2 - 3e3 * velocity[None, :]
    shape = kept.active[k].shape
    along_c, along_w = replace(known, policy=replace(known.policy, values=values)).slopes(k, kept.lattice[k], shape)
    width = kept.lattice[k, bounds.L_DC]
    middle = width * (np.arange(shape[0]) + 0.5)
    assert np.allclose(along_w, -3e3, rtol=1e-2)
    inner = slice(shape[0] // 3, 2 * shape[0] // 3)
    assert np.allclose(along_c[inner, shape[1] // 2], 2e4 * middle[inner], rtol=1e-2)
    # At rest at the lower end: the slope of the first row the margin away from it.
    apart = guide.MARGIN * (grid.c_hi[k] - grid.c_lo[k]) / (grid.positions - 1)
    first = int(np.ceil(apart / width - 1e-9))
    assert along_c[0, shape[1] // 2] == along_c[first, shape[1] // 2] != along_c[first + 1, shape[1] // 2]


@pytest.mark.parametrize(
    ("start", "pump", "guided"), [("smallest", "cp", True), ("smallest", "ls", False), ("middle", "cp", False)]
)
def test_a_guide_is_asked_where_the_motion_comes_to_an_end_of_the_stroke(monkeypatch, start, pump, guided):
    plain, asked = cells.bound, []

    def watched(kept, begin, clock, given=None):
        asked.append(given)
        return plain(kept, begin, clock, given)

    monkeypatch.setattr(cells, "bound", watched)
    proof = certify(load_task("forwarder-vertical", start=start), pump, step=0.1, gap=60.0)
    assert any(given is not None for given in asked) == guided
    assert 0.0 < proof.lower_bound_j <= proof.energy_j
