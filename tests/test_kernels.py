"""Kernels against their slow twins, enumeration, hand-worked cases and the crane's own formulas."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import slow_reference as slow
from leanboom.dynamic_programming import bellman, sweeps, value_function
from leanboom.problem import layout
from slow_reference import Small

SEED = st.integers(0, 2**32 - 1)
SHARE = st.floats(0.0, 1.0)
COST = pytest.mark.parametrize("cost", slow.COSTS)
MOVING = 3


def problem(seed: int, cost: str, *, stages=3, positions=5, velocities=7, prescribed=False) -> Small:
    """A random problem of the size of a crane's: every number different, the redundant cylinder last."""
    rng = np.random.default_rng(seed)
    shape = (stages + 1, positions, MOVING)
    row = np.empty((*shape, layout.COEFFICIENTS))
    smooth = rng.normal(size=(stages + 1, 1, MOVING, layout.COEFFICIENTS))
    smooth = smooth + 0.1 * rng.normal(size=(stages + 1, positions, MOVING, layout.COEFFICIENTS))
    scale = np.array([0.08, 0.6, 0.08, 0.2, 0.3, 0.8, 2e4, 5e3, 5e3, 1.5e4, 3e3])
    row[:] = scale * smooth
    row[..., layout.COULOMB] = np.abs(row[..., layout.COULOMB])
    row[:, :, -1, :6] = (0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    if prescribed:
        row[:, :, 0, layout.B3] = 0.0
    stage = np.empty((stages + 1, layout.STAGE_COLUMNS))
    stage[:, layout.C_LO] = 0.4 + 0.01 * rng.random(stages + 1)
    stage[:, layout.DC] = 0.02 + 0.01 * rng.random(stages + 1)
    stage[:, layout.W_LO] = -0.2 - 0.02 * rng.random(stages + 1)
    stage[:, layout.DW] = 0.06 + 0.01 * rng.random()
    stage[:, layout.FIXED_FLOW] = 1e-3 * rng.random(stages + 1)
    stage[:, layout.FIXED_PRESSURE] = 4e6 * rng.random(stages + 1) * rng.integers(0, 2)
    stage[:, layout.FIXED_COST] = 300.0 * rng.random(stages + 1)
    a, b = 0.008 + 0.004 * rng.random(MOVING), 0.004 + 0.003 * rng.random(MOVING)
    cylinder = np.empty((MOVING, layout.CYLINDER_COLUMNS))
    columns = [a, b * rng.integers(0, 2, MOVING), 1.1 / a, 3e6 * rng.random(MOVING), 1.2 / b, 3e6 * rng.random(MOVING),
               100.0 + 900.0 * rng.random(MOVING), 2e3 * rng.random(MOVING), 0.1 + 0.2 * rng.random(MOVING),
               0.3 + 0.4 * rng.random(MOVING), np.zeros(MOVING), a, b]  # fmt: skip
    cylinder[:] = np.array(columns).T
    cylinder[:, layout.A_MAX] *= rng.choice([0.2, 1.0])  # every other problem: limits that may exclude each other
    setting = np.array([0.1, 0.0, 0.0, 0.002, 2e7, 0.8, 4e3, 5e2, 6e2, 7e1, 3e2, 4e-5, 5e8, 0.0])
    if cost == "ls":
        setting[[layout.SENSING, layout.SUPPLY]] = 1.0, 2e6
    elif cost == "recuperation":
        cylinder[:, layout.AREA_OUT], cylinder[:, layout.AREA_IN] = a - b, b - a
    elif cost != "cp":  # no pump
        cylinder[:, [layout.AREA_OUT, layout.AREA_IN]] = 0.0
        setting[[layout.SUPPLY, layout.IDLE, layout.LEAK, layout.DRAG]] = 0.0
        setting[layout.WORK] = cost == "actuator"
        cylinder[-1 if cost == "extension" else slice(None), layout.SQUARE] = cost in ("velocity", "extension")
    c = np.linspace(0.0, 1.0, positions)[:, None]
    w = np.linspace(-1.0, 1.0, velocities)[None, :]
    terminal = 200.0 * (rng.normal() * c + rng.normal() * w + np.abs(w) + 0.5 * np.sin(3.0 * c + w))
    outside = 0.01 * np.maximum(0.0, rng.normal(size=(stages + 1, positions)))
    stage[:, layout.MOST_FLOW] = 1e-3 + 1e-3 * rng.random(stages + 1)
    setting[layout.SLOPE_F] = rng.choice([0.0, 3e5])  # every other problem: the pump's flow is a limit
    return Small(row, outside, stage, cylinder, setting, np.ascontiguousarray(terminal), cost)


def swept(small: Small, kind=np.float64) -> np.ndarray:
    values = np.empty((small.stages + 1, *small.terminal.shape), dtype=kind)
    sweeps.sweep(*small.arrays, small.terminal, values)
    return values


def best(small: Small, k: int, row, outside: float, c: float, w: float, ahead) -> tuple[float, float]:
    return best_of_one(row, outside, c, w, k, small.stage, small.cylinder, small.setting, ahead)


def best_of_one(node, outside, c, w, k, stage, cylinder, setting, ahead) -> tuple[float, float]:
    """Least cost and its control of a row of a single state."""
    row = bellman.empty_row(1, node.shape[0], ahead.shape[1])
    layer = bellman.layer(ahead, stage, setting, k + 1)
    bellman.best_controls(node, outside, c, np.array([w]), k, stage, cylinder, setting, layer, row)
    return float(row.state[bellman.VALUE, 0]), float(row.state[bellman.CONTROL, 0])


def nodes(small: Small):
    """All states of all stages but the last: k, p, j, c, w."""
    positions, velocities = small.terminal.shape
    for k, p, j in itertools.product(range(small.stages), range(positions), range(velocities)):
        yield k, p, j, small.position(k, p), small.velocity(k, j)


# Interpolation


def at(small: Small, values, k, c, w) -> float:
    return bellman.interpolate(bellman.layer(values, small.stage, small.setting, k), c, w)


@given(seed=SEED)
@settings(max_examples=20)
def test_interpolation_is_exact_on_nodes(seed):
    small = problem(seed, "cp")
    values = np.random.default_rng(seed).normal(size=small.terminal.shape)
    for p, j in np.ndindex(values.shape):
        assert at(small, values, 1, small.position(1, p), small.velocity(1, j)) == pytest.approx(
            values[p, j], abs=1e-12
        )


@given(seed=SEED, x=SHARE, y=SHARE)
def test_interpolation_is_exact_for_bilinear_functions_between_nodes(seed, x, y):
    small = problem(seed, "cp")
    a, b, d, e = np.random.default_rng(seed).normal(size=4)
    c = small.position(2, 0) + small.stage[2, layout.DC] * np.arange(small.terminal.shape[0])
    w = small.velocity(2, 0) + small.stage[2, layout.DW] * np.arange(small.terminal.shape[1])
    values = a + b * c[:, None] + d * w[None, :] + e * c[:, None] * w[None, :]
    c, w = c[0] + x * (c[-1] - c[0]), w[0] + y * (w[-1] - w[0])
    assert at(small, values, 2, c, w) == pytest.approx(a + b * c + d * w + e * c * w, abs=1e-12)


@given(seed=SEED, x=SHARE, y=SHARE, far=st.floats(0.0, 2.0))
def test_interpolation_outside_is_the_edge_plus_a_slope_times_the_distance(seed, x, y, far):
    small = problem(seed, "cp")
    values = np.random.default_rng(seed).normal(size=small.terminal.shape)
    first_c, last_c = small.position(0, 0), small.position(0, values.shape[0] - 1)
    first_w, last_w = small.velocity(0, 0), small.velocity(0, values.shape[1] - 1)
    c, w = first_c + x * (last_c - first_c), first_w + y * (last_w - first_w)
    steep_c, steep_w = small.setting[[layout.SLOPE_C, layout.SLOPE_W]]
    for edge, sign in ((first_c, -1.0), (last_c, 1.0)):
        found = at(small, values, 0, edge + sign * far, w)
        assert found == pytest.approx(at(small, values, 0, edge, w) + far * steep_c, abs=1e-7)
    for edge, sign in ((first_w, -1.0), (last_w, 1.0)):
        found = at(small, values, 0, c, edge + sign * far)
        assert found == pytest.approx(at(small, values, 0, c, edge) + far * steep_w, abs=1e-7)
    corner = at(small, values, 0, last_c + far, first_w - far)
    assert corner == pytest.approx(values[-1, 0] + far * (steep_c + steep_w), abs=1e-7)


@given(seed=SEED, x=st.floats(-0.5, 1.5), y=st.floats(-0.5, 1.5))
def test_interpolation_equals_its_twin(seed, x, y):
    small = problem(seed, "cp")
    values = np.random.default_rng(seed).normal(size=small.terminal.shape)
    c = small.position(1, 0) + x * small.stage[1, layout.DC] * (values.shape[0] - 1)
    w = small.velocity(1, 0) + y * small.stage[1, layout.DW] * (values.shape[1] - 1)
    assert at(small, values, 1, c, w) == pytest.approx(float(slow.interpolate(small, values, 1, c, w)), abs=1e-9)


# One stage


@COST
@given(seed=SEED, prescribed=st.booleans(), x=SHARE, y=SHARE)
@settings(max_examples=60)
def test_corners_are_exact_where_the_value_ahead_is_piecewise_linear(cost, seed, prescribed, x, y):
    """With a value affine in position, cost over control is piecewise linear: no fine set of controls finds less."""
    small = problem(seed, cost, prescribed=prescribed)
    rng = np.random.default_rng(seed)
    line = small.stage[2, layout.C_LO] + small.stage[2, layout.DC] * np.arange(5)
    ahead = 500.0 * rng.normal() * line[:, None] + 100.0 * rng.normal(size=7)[None, :]
    small = replace(small, setting=np.where(np.arange(layout.SETTINGS) == layout.SLOPE_C, 0.0, small.setting))
    c = small.position(1, 0) + (0.3 + 0.4 * x) * small.stage[1, layout.DC] * 4
    w = small.velocity(1, 0) + y * small.stage[1, layout.DW] * 6
    row = small.coefficients[1, 2]
    # Inside the grid ahead, so that its edges add no corner.
    small.stage[2, layout.C_LO] = c + 0.1 * w - 0.06
    small.stage[2, layout.DC] = 0.03
    value, u = best(small, 1, row, 0.0, c, w, ahead)
    wanted, _ = slow.least(small, 1, row, 0.0, c, w, ahead, fine=2000)
    scale = 1.0 + np.abs(ahead).max() + abs(wanted)
    assert value == pytest.approx(wanted, abs=1e-6 * scale)
    again = slow.costs_of(small, 1, row, 0.0, c, w, np.array([u]), ahead)
    assert float(again[0]) == pytest.approx(value, abs=1e-7 * scale)


def test_the_pressure_of_prescribed_cylinders_is_used_up_but_not_exceeded():
    """More control pays until the load asks for more than the prescribed 2 MPa: 0.2 m/s^2, worked out by hand.

    One cylinder at 0.1 m/s: force 10 kN + 50 kN s^2/m u on 0.01 m^2, so 1 MPa at rest and 2 MPa at 0.2 m/s^2; flow
    1 l/s, so a stage of 0.1 s costs 0.1 x (2 + 3) MPa x 1 l/s = 500 J. The value ahead falls by 100 J per m/s.
    """
    row = np.zeros((1, layout.COEFFICIENTS))
    row[0, [layout.A1, layout.B3, layout.F0, layout.F3]] = 1.0, 1.0, 1e4, 5e4
    stage = np.zeros((2, layout.STAGE_COLUMNS))
    stage[:, [layout.DC, layout.W_LO, layout.DW, layout.FIXED_PRESSURE]] = 1.0, -1.0, 1.95, 2e6
    cylinder = np.zeros((1, layout.CYLINDER_COLUMNS))
    cylinder[0, [layout.AREA_OUT, layout.GAIN_OUT, layout.V_MAX, layout.A_MAX]] = 0.01, 100.0, 1.0, 1.0
    setting = np.array([0.1, 1.0, 0.0, 0.002, 3e6, 1.0, *[0.0] * 8])  # load-sensing, 3 MPa of margin
    ahead = -100.0 * np.array([[-1.0, 0.95], [-1.0, 0.95]])
    value, u = best_of_one(row, 0.0, 0.5, 0.1, 0, stage, cylinder, setting, ahead)
    assert u == pytest.approx(0.2, abs=1e-9)
    assert value == pytest.approx(500.0 - 100.0 * 0.12, rel=1e-9)


@pytest.mark.parametrize("cost", ["ls", "actuator"])
def test_settled_states_cost_one_line_over_their_controls(cost):
    """Against many controls of each state; there are mixed states too, whose costs bend between them."""
    settled = mixed = 0
    for seed in range(12):
        small = problem(seed, cost)
        k, (positions, velocities) = 1, small.terminal.shape
        w = small.velocity(k, 0) + small.stage[k, layout.DW] * np.arange(velocities)
        ahead = bellman.layer(np.zeros_like(small.terminal), small.stage, small.setting, k + 1)
        sensing, lowest = cost == "ls", small.stage[k, layout.FIXED_PRESSURE]
        for p in range(positions):
            row = bellman.empty_row(velocities, small.cylinder.shape[0], velocities)
            node, c = small.coefficients[k, p], small.position(k, p)
            bellman.best_controls(node, 0.0, c, w, k, small.stage, small.cylinder, small.setting, ahead, row)
            base, slope = row.state[bellman.OFFSET].copy(), row.state[bellman.SLOPE].copy()
            bellman.limit_controls(node, 0.0, w, k, small.stage, small.cylinder, small.setting, row)
            bellman.keep_to_nodes(w, ahead, small.setting[layout.STEP], row)
            bellman.charge(node, w, k, small.stage, small.cylinder, small.setting, row)
            for j in range(velocities):
                u = np.linspace(row.state[bellman.LOW, j], row.state[bellman.HIGH, j], 401)
                asked = np.array([bellman.running_cost(x, j, sensing, lowest, row.line) for x in u])
                dear = row.state[bellman.OFFSET, j] + row.state[bellman.RATE, j] * asked
                bend = np.abs(dear - np.linspace(dear[0], dear[-1], u.size)).max()
                if row.state[bellman.PIECEWISE, j]:
                    mixed += bend > 1e-6 * np.abs(dear).max()
                else:
                    settled += 1
                    np.testing.assert_allclose(base[j] + slope[j] * u, dear, rtol=1e-9)
    assert settled > 50
    assert settled > 50
    assert mixed > 20


def corner_error(small: Small, k: int, ahead: np.ndarray) -> float:
    """What corners may miss: the value ahead bends in position by this much within one velocity interval."""
    slope = np.diff(ahead, axis=0) / small.stage[k + 1, layout.DC]
    steepest = max(small.setting[layout.SLOPE_C], float(np.abs(slope).max()))
    return small.setting[layout.STEP] * small.stage[k + 1, layout.DW] * steepest


@COST
@given(seed=SEED, prescribed=st.booleans())
@settings(max_examples=2)
def test_sweep_equals_its_twin_at_every_node(cost, seed, prescribed):
    """Never below the best of all controls, and above it by no more than the value's bend in position allows."""
    small = problem(seed, cost, stages=2, positions=4, velocities=6, prescribed=prescribed)
    values = swept(small)
    np.testing.assert_array_equal(values[-1], small.terminal)
    for k, p, j, c, w in nodes(small):
        row, ahead = small.coefficients[k, p], values[k + 1]
        wanted, _ = slow.least(small, k, row, small.outside[k, p], c, w, ahead, fine=100)
        scale = 1.0 + np.abs(ahead).max()
        assert values[k, p, j] >= wanted - 1e-6 * scale
        assert values[k, p, j] <= wanted + corner_error(small, k, ahead)
        corner = slow.costs_of(
            small, k, row, small.outside[k, p], c, w, slow.corners(small, k, row, w, ahead.shape[1]), ahead
        )
        assert values[k, p, j] == pytest.approx(float(corner.min()), abs=1e-6 * scale)
    # And the whole recursion, with errors adding up over the stages.
    whole = slow.sweep(small, fine=20)
    bound = sum(corner_error(small, k, values[k + 1]) for k in range(small.stages))
    assert np.abs(values - whole).max() <= bound + 1e-6 * np.abs(whole).max()


@COST
@given(seed=SEED)
@settings(max_examples=4)
def test_bellman_residual_of_stored_values_is_zero(cost, seed):
    small = problem(seed, cost, stages=5)
    values = swept(small)
    for k, p, j, c, w in nodes(small):
        again, _ = best(small, k, small.coefficients[k, p], small.outside[k, p], c, w, values[k + 1])
        assert again == pytest.approx(values[k, p, j], rel=1e-12, abs=1e-9)


# Whole problems


def enumerable(seed: int, cost: str) -> Small:
    """Nodes reach nodes exactly: positions half a velocity step times Ts apart, the grid wide enough to stay in."""
    small = problem(seed, cost, stages=4, positions=17, velocities=3)
    ts, dw = small.setting[layout.STEP], 0.1
    stage = small.stage.copy()
    stage[:, layout.W_LO], stage[:, layout.DW] = -dw, dw
    stage[:, layout.DC], stage[:, layout.C_LO] = 0.5 * ts * dw, 0.5
    row = small.coefficients.copy()
    # Controls as free as the velocity nodes: only those corners are left, as stage costs do not depend on u.
    cylinder = small.cylinder.copy()
    cylinder[:, layout.A_MAX] = 1e3
    terminal = np.random.default_rng(seed).normal(size=small.terminal.shape) * 50.0
    return replace(small, stage=stage, coefficients=row, cylinder=cylinder, terminal=terminal)


@pytest.mark.slow
@pytest.mark.parametrize("cost", ["cp", "velocity", "extension", "recuperation"])
@given(seed=SEED)
@settings(max_examples=5)
def test_sweep_and_rollout_equal_enumeration_on_a_tiny_grid(cost, seed):
    """All 3^4 sequences of velocity nodes from one state: the least is the value, and the rollout takes it."""
    small = enumerable(seed, cost)
    values = swept(small)
    ts, dw = small.setting[layout.STEP], 0.1
    start_p, start_j = 8, 1
    c, w = small.position(0, start_p), small.velocity(0, start_j)
    found = {}
    for sequence in itertools.product(range(3), repeat=4):
        p, j, total = start_p, start_j, 0.0
        for k, after in enumerate(sequence):
            row = small.coefficients[k, p]
            total += ts * float(slow.power(small, k, row, (j - 1) * dw, np.zeros(1))[0])
            total += slow.admissible(small, k, row, (j - 1) * dw, 3)[2]
            total += small.setting[layout.SLOPE_C] * small.outside[k, p]
            p, j = p + (j - 1) + (after - 1), after
        found[sequence] = total + small.terminal[p, j]
    least = min(found.values())
    assert values[0, start_p, start_j] == pytest.approx(least, rel=1e-9)
    position, velocity, control = np.empty(5), np.empty(5), np.empty(4)
    sweeps.rollout(*small.arrays, values, np.array([c, w]), 0, position, velocity, control)
    taken = np.rint(velocity[1:] / dw)
    np.testing.assert_allclose(velocity[1:], taken * dw, atol=1e-12)
    assert found[tuple(int(j) + 1 for j in taken)] == pytest.approx(least, rel=1e-9)  # some have equals


def test_value_of_a_problem_worked_out_by_hand():
    """Two stages of 1 s, one cylinder of 1 m^2 both ways, 3 Pa: 2 m/s costs 6 J; stopping takes one stage."""
    row = np.zeros((3, 2, 1, layout.COEFFICIENTS))
    row[..., layout.A1] = row[..., layout.B3] = 1.0
    stage = np.zeros((3, layout.STAGE_COLUMNS))
    stage[:, layout.DC], stage[:, layout.W_LO], stage[:, layout.DW] = 100.0, -2.0, 1.0
    cylinder = np.ones((1, layout.CYLINDER_COLUMNS))
    cylinder[0, [layout.V_MAX, layout.A_MAX, layout.SQUARE]] = 10.0, 1.0, 0.0
    setting = np.array([1.0, 0.0, 0.0, 0.0, 3.0, 1.0, 0.0, 100.0, 100.0, 100.0, 0.0, 0.0, 0.0, 0.0])
    terminal = 100.0 * np.abs(np.arange(-2.0, 3.0))[None, :].repeat(2, axis=0)
    small = Small(row, np.zeros((3, 2)), stage, cylinder, setting, terminal, "cp")
    # From 2 m/s the deceleration of 1 m/s^2 takes both stages: 3 (2 + 1) J. From 1 m/s one: 3 J, then at rest.
    expected = [9.0, 3.0, 0.0, 3.0, 9.0]
    np.testing.assert_allclose(swept(small)[0], [expected, expected], atol=1e-12)
    # One stage is too short to stop from 2 m/s: 3 x 2 J, and 100 J for the 1 m/s that is left.
    np.testing.assert_allclose(swept(small)[1][0], [106.0, 3.0, 0.0, 3.0, 106.0], atol=1e-12)


@COST
@given(seed=SEED, x=SHARE, y=SHARE)
@settings(max_examples=10)
def test_rollout_integrates_exactly_and_takes_the_best_control_at_every_state(cost, seed, x, y):
    small = problem(seed, cost, stages=5)
    values = swept(small)
    c = small.position(0, 0) + x * 4 * small.stage[0, layout.DC]
    w = small.velocity(0, 0) + y * 6 * small.stage[0, layout.DW]
    position, velocity, control = np.full(6, np.nan), np.full(6, np.nan), np.full(5, np.nan)
    total = sweeps.rollout(*small.arrays, values, np.array([c, w]), 0, position, velocity, control)
    ts = small.setting[layout.STEP]
    assert (position[0], velocity[0]) == (c, w)
    np.testing.assert_allclose(position[1:], position[:-1] + ts * velocity[:-1] + 0.5 * ts**2 * control, rtol=1e-14)
    np.testing.assert_allclose(velocity[1:], velocity[:-1] + ts * control, rtol=1e-12, atol=1e-15)
    for k in range(5):
        row, outside = slow.row_at(small, k, position[k])
        _, u = best(small, k, row, outside, position[k], velocity[k], values[k + 1])
        assert control[k] == pytest.approx(u, abs=1e-6)
    assert total == pytest.approx(slow.cost_of_controls(small, c, w, control), rel=1e-8, abs=1e-6)


def test_rollout_from_a_later_stage_leaves_earlier_entries_alone():
    small = problem(3, "cp", stages=5)
    values = swept(small)
    position, velocity, control = np.full(6, -1.0), np.full(6, -2.0), np.full(5, -3.0)
    sweeps.rollout(*small.arrays, values, np.array([0.45, 0.01]), 2, position, velocity, control)
    assert (position[:2] == -1.0).all() and (velocity[:2] == -2.0).all() and (control[:2] == -3.0).all()
    assert (position[2], velocity[2]) == (0.45, 0.01)
    assert (control[2:] != -3.0).all()


# Rules of the house


def test_ties_go_to_the_candidate_tried_first():
    """Nothing costs anything: the lower end of the admissible controls is tried first and kept."""
    small = problem(1, "cp", prescribed=True)
    setting, cylinder = small.setting.copy(), small.cylinder.copy()
    setting[[layout.SUPPLY, layout.SLOPE_W, layout.SLOPE_C]] = 0.0
    cylinder[:, layout.A_MAX] = 1e3  # the redundant cylinder alone limits the control
    cylinder[-1, layout.A_MAX] = 0.25
    small = replace(small, setting=setting, cylinder=cylinder)
    ahead = np.full((5, 7), 3.0)
    value, u = best(small, 1, small.coefficients[1, 2], 0.0, small.position(1, 2), 0.0, ahead)
    assert u == -0.25
    # Velocity nodes come after both ends, lowest first.
    ahead[:, [2, 4]] = 1.0
    cylinder[-1, layout.A_MAX] = 1e3
    _, u = best(small, 1, small.coefficients[1, 2], 0.0, small.position(1, 2), 0.0, ahead)
    assert u * setting[layout.STEP] == pytest.approx(small.velocity(2, 2), abs=1e-12)


@COST
@pytest.mark.parametrize("workers", [2, 3])
def test_results_do_not_depend_on_the_number_of_threads(cost, workers):
    small = problem(5, cost, stages=12, positions=23, velocities=17)
    shared = np.empty_like(swept(small))
    value_function._sweep_shared(small.arrays, small.terminal, shared, workers)
    np.testing.assert_array_equal(swept(small), shared)


@COST
def test_float32_layers_hold_the_float64_values(cost):
    """Only what is stored is rounded: the recursion itself runs in float64."""
    small = problem(6, cost, stages=12, positions=9, velocities=9)
    np.testing.assert_array_equal(swept(small, np.float32), swept(small).astype(np.float32))


def test_arrays_that_are_passed_in_are_not_changed():
    small = problem(7, "ls")
    before = [array.copy() for array in (*small.arrays, small.terminal)]
    swept(small)
    for array, old in zip((*small.arrays, small.terminal), before, strict=True):
        np.testing.assert_array_equal(array, old)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_motion_that_runs_away_stays_on_the_grid(bad):
    """Indices come from clamped numbers alone: with bounds checked, anything else raises here."""
    small = problem(3, "ls")
    values = swept(small)
    count = small.stages + 1
    position, velocity, control = np.zeros(count), np.zeros(count), np.zeros(count - 1)
    sweeps.rollout(*small.arrays, values, np.array([bad, 0.0]), 0, position, velocity, control)
    assert not np.isfinite(position).any()
    assert not np.isfinite(at(small, values[1], 1, bad, 0.0))
