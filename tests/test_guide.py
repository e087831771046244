"""Slopes from a policy: of what follows and of the stage's cost, exact on kinks; the end of the stroke is seen."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

import slow_bounds
from leanboom import certify, load_task
from leanboom.certificate import lower_bounds, partition, upper_bound, value_slopes
from leanboom.model import motion
from leanboom.problem import layout, stages
from leanboom.problem.legs import Legs
from slow_bounds import quiet

REACH = 0.6  # of a cell, how far from its middle differences are taken


@pytest.fixture(scope="module")
def loader(coarser_guide):
    """The medium triangle from the retracted telescope, coarsely, its cells and a guide."""
    task = replace(load_task("loader-triangle-medium"), start="smallest")
    problem = stages.discretise(task, 0.5)
    kept = partition.whole(Legs((problem,)), "cp")
    held = motion.from_velocities(problem.step, problem.lower[0] + 0.3, np.zeros(problem.stages + 1), "held", "cp")
    return problem, kept, value_slopes.make(Legs((problem,)), "cp", kept.viable, held)


@pytest.mark.slow
def test_guided_bounds_see_the_end_of_the_stroke_and_stay_below_every_motion(loader):
    problem, _, known = loader
    kept, start = partition.whole(Legs((problem,)), "cp", times=(1, 2)), float(problem.lower[0])
    guided = lower_bounds.bound(kept, start, quiet, known.slopes)
    assert guided.lower > 1.01 * lower_bounds.bound(kept, start, quiet).lower
    # Nor above a policy's motion, stage by stage.
    moving = value_slopes.value_function.rollout(known.policies[0][0], start)
    measured = upper_bound.measure(problem, moving, "cp")
    assert measured.keeps_limits
    assert guided.lower <= measured.energy
    assert lower_bounds.residuals(guided, moving, measured.costs).min() >= -1e-9 * measured.energy


def test_slopes_that_are_no_numbers_are_level_ones(loader):
    problem, _, _ = loader
    kept, start = partition.whole(Legs((problem,)), "cp", times=(4, 2)), float(problem.lower[0])

    def given(value):
        return lambda cells_, k: np.full((*cells_.active[k].shape, 2), value)

    level = lower_bounds.bound(kept, start, quiet, given(0.0)).lower
    assert 0.0 < level < np.inf
    for value in (np.nan, np.inf, -np.inf):
        assert lower_bounds.bound(kept, start, quiet, given(value)).lower == level


def test_the_envelope_is_the_least_value_of_every_line(rng):
    values = rng.uniform(0.0, 10.0, (7, 5)).astype(np.float32)
    step, stage, setting = 0.3, np.zeros((1, layout.STAGE_COLUMNS)), np.zeros(layout.SETTINGS)
    for column, value in ((layout.C_LO, 1.0), (layout.DC, 0.1), (layout.W_LO, -0.4), (layout.DW, 0.2)):
        stage[0, column] = value
    setting[layout.STEP] = step
    line = np.linspace(1.0 - 0.5 * step * 0.4, 1.6 + 0.5 * step * 0.4, 30)
    least, next_w = np.empty(30), np.empty(30)
    value_slopes.min_over_next_velocity(values, stage, setting, 0, value_slopes.Envelope(line, least, next_w))
    at = RegularGridInterpolator((1.0 + 0.1 * np.arange(7), -0.4 + 0.2 * np.arange(5)), values.astype(float))
    for s, value, w in zip(line, least, next_w, strict=True):
        tried = -0.4 + 0.2 * np.arange(5)
        c = s + 0.5 * step * tried
        inside = (c >= 1.0 - 1e-9) & (c <= 1.6 + 1e-9)
        twin = at(np.stack([np.clip(c[inside], 1.0, 1.6), tried[inside]], axis=1))
        assert value == pytest.approx(twin.min(), abs=1e-6)
        assert w == pytest.approx(tried[inside][twin.argmin()])


def test_an_envelope_is_found_once_for_cells_of_any_size(loader, monkeypatch):
    _, kept, known = loader
    fresh, k, plain, found = replace(known), 12, value_slopes.min_over_next_velocity, []
    monkeypatch.setattr(value_slopes, "min_over_next_velocity", lambda *given: (found.append(given[3]), plain(*given)))
    first = fresh.slopes(kept, k)
    assert found == [k + 1, k + 1]  # the tube's and the whole policy's
    assert np.array_equal(fresh.slopes(kept, k), first)
    assert len(found) == 2


def given_values(known, k, values):
    """A guide of one policy with other values at a stage, a function of position above the lower end and velocity."""
    policy = known.policies[0][0]
    grid = policy.grid
    c = np.linspace(0.0, grid.c_hi[k] - grid.c_lo[k], grid.positions)
    w = np.linspace(grid.w_lo[k], grid.w_hi[k], grid.velocities)
    changed = policy.values.copy()
    changed[k] = values(c[:, None], w[None, :])
    return replace(known, policies=((replace(policy, values=changed),),))


def nearest(known, kept, k):
    """The cells where the slopes of a stage's cells are taken: the whole policy knows them all."""
    mask = value_slopes.known_cells(known.policies[0][0], kept, k)
    assert mask.all()
    return known.nearest_known(known.policies[0][0], kept, k, mask)


@pytest.mark.parametrize("pump", ["cp", "ls"])
def test_slopes_are_those_of_the_least_cost_to_go(loader, pump):
    """Against differences of stage cost plus values ahead, least over all accelerations, where nothing has a kink."""
    problem, _, known = loader
    kept, k = partition.whole(Legs((problem,)), pump), 20

    def values(above, w):
        return 3e4 * (above - 0.3) ** 2 + 2e4 * (w - 0.05) ** 2

    found = given_values(known, k + 1, values).slopes(kept, k)
    limit, step = problem.crane.machine.redundant.acceleration_limit, problem.step
    u = np.linspace(-limit, limit, 1001)

    def least(c, w):
        cost, used = slow_bounds.rates(problem, pump, k, c, w, u)
        total = cost + values(c + step * (w + 0.5 * step * u) - problem.lower[k + 1], w + step * u)
        return np.min(total[used <= 1.0])

    rows, middles, compared = kept.rows[k], kept.middles(k), 0
    width = rows[1] - rows[0]
    row, column = nearest(known, kept, k)
    for p in range(40, 120, 27):
        c = 0.5 * (rows[p] + rows[p + 1])
        for r in np.nonzero((column[p] == np.arange(middles.shape[1])) & (row[p] == p))[0]:
            w, high = middles[p, r], kept.edges[k][p, r + 1] - kept.edges[k][p, r]
            share = (-REACH, 0.0, REACH)
            tried = np.array([[least(c + a * width, w + b * high) for b in share] for a in share])
            if max(np.abs(np.diff(tried, 2, axis=axis)).max() for axis in (0, 1)) > 0.1 * (np.ptp(tried) + 1.0):
                continue  # a kink or a jump
            compared += 1
            rise = (tried[2, 1] - tried[0, 1], tried[1, 2] - tried[1, 0])
            assert found[p, r] * (width, high) * 2.0 * REACH == pytest.approx(rise, abs=0.05 * np.ptp(tried))
    assert compared > 20


def test_riding_on_a_kink_of_flow_is_exact(loader):
    """In a cell where a cylinder turns round nothing is gained across, or its slope is at its bound."""
    problem, kept, known = loader
    k, turning, exact = 20, 0, 0
    found = given_values(known, k + 1, lambda above, w: 4e4 * above + 0.0 * w).slopes(kept, k)
    across = found[..., 1] + 0.5 * problem.step * found[..., 0]
    for p in range(20, 150, 10):
        change = np.sign(across[p])
        # The slope across rises with the velocity as flow is convex; where it passes zero it does so on a kink.
        passing = np.nonzero(np.abs(across[p]) < 1e-6 * np.abs(found[p, :, 1]).max())[0]
        turning += bool((change > 0).any() and (change < 0).any())
        exact += bool(passing.size)
    assert turning >= 5
    assert exact >= turning // 2


def test_beside_states_that_are_not_viable_the_nearest_cells_with_a_margin_are_taken(loader):
    problem, kept, known = loader
    k = 10
    row, column = nearest(known, kept, k)
    apart = value_slopes.MARGIN_SPACINGS / (known.policies[0][0].grid.positions - 1)
    first = int(np.ceil(apart * kept.positions - 1e-9))
    assert row[: first + 1].tolist() == [first] * (first + 1)
    assert row[first + 1] == first + 1
    low = known.viable.low[k]
    assert np.all(kept.edges[k][row[:, None], column] >= low[-1] - 1e-9)
    assert np.array_equal(column[kept.positions // 2], np.clip(column[kept.positions // 2], 0, kept.velocities[k] - 1))


def test_a_tube_gives_the_slopes_inside_it_and_only_there(loader):
    problem, kept, known = loader
    k, (whole, tube) = 5, known.policies[0]
    changed = tube.values.copy()
    changed[k + 1] += np.linspace(0.0, 1e3, tube.grid.positions, dtype=np.float32)[:, None]
    before = known.slopes(kept, k)
    after = replace(known, policies=((whole, replace(tube, values=changed)),)).slopes(kept, k)
    differ = np.any(before != after, axis=-1)
    assert differ.sum() > 50
    rows, edges = kept.rows[k], kept.edges[k]
    near_c, near_w = (
        0.6 * value_slopes.HALF_WIDTH,
        0.6 * value_slopes.HALF_HEIGHT,
    )  # around the motion, held 0.3 m above the first lower end
    centre = problem.lower[0] + 0.3
    inside_c = (rows[:-1] >= centre - near_c) & (rows[1:] <= centre + near_c)
    inside_w = (edges[:, :-1] >= -near_w) & (edges[:, 1:] <= near_w)
    assert np.array_equal(differ, inside_c[:, None] & inside_w)
    rise = (after - before)[differ][:, 0]
    assert np.median(rise) == pytest.approx(1e3 / (tube.grid.c_hi[k + 1] - tube.grid.c_lo[k + 1]), rel=0.05)


@pytest.mark.parametrize(("gap", "guided"), [(99.0, False), (0.6, True)])
def test_a_guide_is_asked_where_the_first_bound_does_not_do(larger_cells, monkeypatch, gap, guided):
    plain, asked = lower_bounds.bound, []

    def watched(kept, begin, clock, given, *others, **named):
        asked.append(given)
        return plain(kept, begin, clock, given, *others, **named)

    monkeypatch.setattr(lower_bounds, "bound", watched)
    proof = certify(load_task("forwarder-vertical", start="middle"), "cp", step=0.5, gap=gap, seconds=120.0)
    assert any(given is not None for given in asked) == guided
    assert 0.0 < proof.lower_bound_j <= proof.energy_j
