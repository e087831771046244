"""Stage tables against the crane itself; feasible extensions against their limits; messages where there are none."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bundled_texts import SINGLE
from leanboom import resources
from leanboom.components.costs import COSTS
from leanboom.dynamic_programming import grids
from leanboom.errors import InfeasibleError, InputError
from leanboom.io.loading import load_task
from leanboom.model import crane as cranes
from leanboom.model.machine import Joint
from leanboom.model.task import Lines, Task, sample
from leanboom.problem import feasible_strokes, layout, stage_arrays, stages

TASKS = {name: load_task(name) for name in SINGLE}
PROBLEMS = {name: stages.discretise(task, 0.25) for name, task in TASKS.items()}
FORWARDER = TASKS["forwarder-horizontal"].machine
RATE = st.floats(-1.0, 1.0)


def hold(point, machine=FORWARDER, end=None):
    """A task that keeps the tool at a point, or takes it to another."""
    return Task("hold", machine, Lines((point, end or point), (2.0,)))


def without_limits(machine, **joints):
    """The machine with other joint ranges."""
    return replace(
        machine, joints=tuple(Joint(j.name, *joints.get(j.name, (j.lower, j.upper))) for j in machine.joints)
    )


@pytest.mark.parametrize("wanted", ["0", "-1", "two", "²", "٢", "1_0"])
def test_a_count_of_threads_is_a_whole_number_in_plain_digits(monkeypatch, wanted):
    monkeypatch.setenv("LEANBOOM_THREADS", wanted)
    with pytest.raises(InputError, match="must be a whole number from 1 on"):
        resources.threads()
    monkeypatch.setenv("LEANBOOM_THREADS", "2")
    assert resources.threads() == 2


# Time


@pytest.mark.parametrize(("step", "count"), [(0.05, 120), (0.07, 86), (6.0, 2), (6.0 / 7.0, 7)])
def test_stages_cut_the_duration_into_equal_parts(step, count):
    problem = stages.discretise(TASKS["forwarder-vertical"], step)
    assert problem.stages == count
    assert problem.step == pytest.approx(6.0 / count, rel=1e-15)
    assert (problem.time[0], problem.time[-1]) == (0.0, 6.0)
    assert np.diff(problem.time) == pytest.approx(problem.step)


# Feasible extensions


@pytest.mark.parametrize(
    ("name", "start", "end", "narrowest"),
    [
        ("forwarder-horizontal", (0.0, 0.811), (0.895, 1.85), 0.811),
        ("forwarder-vertical", (0.410, 0.981), (0.023, 1.508), 0.571),
        ("forwarder-half-cycle", (0.0, 0.755), (0.225, 1.754), 0.538),
        ("loader-triangle-large", (0.260, 1.04), (0.260, 1.04), 0.096),
    ],
)
def test_feasible_extensions_worked_out_elsewhere(name, start, end, narrowest):
    """They were found on a grid of 1 mm, so that much may differ."""
    problem = stages.discretise(TASKS[name], 0.05)
    assert all(len(intervals) == 1 for intervals in problem.intervals)
    assert (problem.lower[0], problem.upper[0]) == pytest.approx(start, abs=1.1e-3)
    assert (problem.lower[-1], problem.upper[-1]) == pytest.approx(end, abs=1.1e-3)
    assert np.min(problem.upper - problem.lower) == pytest.approx(narrowest, abs=1.1e-3)


@pytest.mark.parametrize(
    ("edge", "end", "narrowest"), [(0, (0.305, 1.04), 0.735), (1, (0.0, 0.096), 0.096), (2, (0.260, 1.04), 0.096)]
)
def test_feasible_extensions_of_the_triangle_edge_by_edge(edge, end, narrowest):
    problem = stages.discretise(TASKS["loader-triangle-large"], 0.05)
    corner = slice(200 * edge, 200 * edge + 201)
    assert (problem.lower[corner][-1], problem.upper[corner][-1]) == pytest.approx(end, abs=1.1e-3)
    assert np.min((problem.upper - problem.lower)[corner]) == pytest.approx(narrowest, abs=1.1e-3)


def margin(problem, stroke, shift=0.0):
    return cranes.position_margin(problem.crane, problem.plane, stroke + shift)


@pytest.mark.parametrize("name", TASKS)
def test_margins_change_sign_at_the_ends_of_the_feasible_extensions(name):
    """To 1e-9 m: kept at the end, broken just beyond it, unless the cylinder's own range ends there."""
    problem = PROBLEMS[name]
    low, high = feasible_strokes.stroke_range(problem.task)
    assert np.all(margin(problem, problem.lower) >= 0.0) and np.all(margin(problem, problem.upper) >= 0.0)
    assert np.all(margin(problem, problem.lower, -1.1e-9) < 0.0)
    assert np.all(margin(problem, problem.upper, 1.1e-9) < 0.0)
    assert np.all((problem.lower >= low) & (problem.upper <= high))
    assert np.any(problem.lower > low) or np.any(problem.upper < high)


@pytest.mark.parametrize("name", TASKS)
@given(share=st.floats(0.0, 1.0))
def test_every_extension_between_the_ends_keeps_the_joint_ranges(name, share):
    """And poses the crane with its tool on the path, by joint positions alone."""
    problem = PROBLEMS[name]
    stroke = problem.lower + share * (problem.upper - problem.lower)
    pose = cranes.pose(problem.crane, problem.plane, stroke)
    for q, joint in zip(pose.q, problem.task.machine.joints[-3:], strict=True):
        assert np.all((q >= joint.lower - 1e-12) & (q <= joint.upper + 1e-12))


def with_a_narrow_range(seconds):
    """A task that stands still where extensions from 0.4015 m to 0.4045 m keep the joint ranges."""
    task = TASKS["forwarder-horizontal"]
    crane = PROBLEMS["forwarder-horizontal"].crane
    plane = PROBLEMS["forwarder-horizontal"].plane[:1]
    tilt = [cranes.pose(crane, plane, np.array([c])).q[1][0] for c in (0.4015, 0.4045)]
    return replace(
        task,
        path=Lines((task.path.points[0],) * 2, (seconds,)),
        machine=without_limits(task.machine, tilt=sorted(tilt)),
    )


def test_a_narrow_range_is_found_by_looking_closer():
    """Three millimetres of 1.85 m, between two of the first samples."""
    narrow = with_a_narrow_range(1.0)
    grid = np.linspace(0.0, 1.85, feasible_strokes.SAMPLES)
    assert not np.any((grid > 0.4015) & (grid < 0.4045))
    problem = stages.discretise(narrow, 0.5)
    assert problem.lower == pytest.approx(0.4015, abs=2e-9)
    assert problem.upper == pytest.approx(0.4045, abs=2e-9)


def test_looking_closer_takes_no_more_memory_where_a_path_takes_longer(monkeypatch):
    """All stages at once took 16 GiB for an hour of them."""
    seen = []
    margin = cranes.position_margin

    def counted(crane, plane, stroke):
        found = margin(crane, plane, stroke)
        seen.append(found.size)
        return found

    monkeypatch.setattr(cranes, "position_margin", counted)
    monkeypatch.setattr(feasible_strokes, "SAMPLES", 17)
    most = []
    for seconds in (60.0, 180.0):
        seen.clear()
        problem = stages.discretise(with_a_narrow_range(seconds), 0.05)
        assert problem.lower == pytest.approx(0.4015, abs=2e-9)
        assert problem.upper == pytest.approx(0.4045, abs=2e-9)
        most.append(max(seen))
    assert most[0] == most[1]


def test_a_stage_blocked_late_on_a_long_path_is_named():
    task = replace(
        hold((7.0, 0.0, 1.6)), path=Lines(((7.0, 0.0, 1.6), (7.0, 0.0, 1.6), (12.0, 0.0, 1.6)), (80.0, 20.0))
    )
    with pytest.raises(InfeasibleError) as error:
        stages.discretise(task, 0.05)
    found = re.search(r"at (\S+) s \(stage (\d+)\)", str(error.value))
    assert found and float(found[1]) == pytest.approx(0.05 * int(found[2])) and float(found[1]) > 80.0


# No feasible extension

OUTER = np.hypot(5.83, 0.376)  # from the forwarder's tilt joint to its tool, telescope out


@pytest.mark.parametrize(
    ("point", "message"),
    [
        (
            (10.0, 0.0, 1.605),
            "the path leaves the crane's reach at 0.000 s (stage 0), tool radius 10.000 m, height 1.605 m: "
            f"too far by {10.208 - np.sqrt(3.504**2 + OUTER**2 + 2.0 * 3.504 * OUTER * np.cos(np.radians(3.0))):.3f} m",
        ),
        (
            (0.3, 0.0, 1.605),
            "the path comes too close to the lift joint at 0.000 s (stage 0), tool radius 0.300 m, height 1.605 m",
        ),
    ],
)
def test_paths_out_of_reach_say_so(point, message):
    machine = without_limits(FORWARDER, extension=(2.5, 3.7)) if point[0] < 1.0 else FORWARDER
    with pytest.raises(InfeasibleError) as error:
        stages.discretise(hold(point, machine), 0.5)
    assert str(error.value) == message


def test_paths_outside_the_joint_ranges_name_the_joint():
    """Close above the column the lift joint would have to go beyond its upper limit."""
    task = hold((3.0, 0.0, 4.0))
    with pytest.raises(InfeasibleError, match="^no extension reaches the path at 0.000 s") as error:
        stages.discretise(task, 0.5)
    # What the message says about the best extension is what the crane does there.
    assert "(stage 0), tool radius 3.000 m, height 4.000 m: " in str(error.value)
    pattern = r"even at (\S+) m, joint (\w+) would be (\S+) rad beyond its limit (\S+) rad$"
    stroke, name, amount, limit = re.search(pattern, str(error.value)).groups()
    plane = cranes.plane(task.machine, sample(task, np.array([0.0])))
    q = cranes.pose(cranes.build(task), plane, np.array([float(stroke)])).q
    index = task.machine.names.index(name)
    joint = task.machine.joints[index]
    assert float(limit) in {round(joint.lower, 4), round(joint.upper, 4)}
    assert abs(q[index - 1][0] - float(limit)) == pytest.approx(float(amount), abs=5e-3)


def test_the_first_blocked_stage_is_named():
    """The tool leaves the reach on its way out: 9.100 m from the axis at this height."""
    task = hold((7.0, 0.0, 1.6), end=(12.0, 0.0, 1.6))
    with pytest.raises(InfeasibleError, match=r"^the path leaves the crane's reach at (\S+) s \(stage \d+\)") as error:
        stages.discretise(task, 0.05)
    time = float(str(error.value).split("at ")[1].split(" s")[0])
    reach = -0.208 + 3.504 + np.hypot(5.83, 0.376)
    radius = sample(task, np.array([time - 0.05, time])).point[:, 0]
    assert radius[0] < reach < radius[1]


# Several feasible intervals


def gapped():
    """A tool 2 m from the lift joint: extending opens the elbow, then closes it; an upper tilt limit cuts between."""
    machine = without_limits(FORWARDER, lift=(-3.0, 3.0), tilt=(-3.1, -2.70))
    return hold((-0.208 + 2.0, 0.0, 1.605), machine)


def test_a_gap_in_the_feasible_extensions_is_kept():
    problem = stages.discretise(gapped(), 1.0)
    crane, plane = problem.crane, problem.plane[:1]
    for intervals in problem.intervals:
        assert intervals.shape == (2, 2)
        assert np.all(np.diff(intervals.ravel()) > 0.0)
        inner = intervals.ravel()[1:3]
        tilt = cranes.pose(crane, plane[:, None], inner[None, :]).q[1]
        assert tilt == pytest.approx(-2.70, abs=1e-8)  # both sides of the gap are at the tilt limit
        middle = cranes.pose(crane, plane, np.array([inner.mean()])).q[1]
        assert middle > -2.70
    assert problem.lower[0] == problem.intervals[0][0, 0]
    assert problem.upper[0] == problem.intervals[0][1, 1]


def test_nodes_in_a_gap_know_their_distance_from_feasible_extensions():
    """Zero on either side, rising to half the gap's width in its middle."""
    problem = stages.discretise(gapped(), 1.0)
    grid = grids.full_grid(problem, 201, 3)
    outside = grids.tables(problem, grid, "ls").outside
    (a, b), (c, d) = problem.intervals[0]
    nodes = np.linspace(a, d, 201)
    expected = np.where((nodes > b) & (nodes < c), np.minimum(nodes - b, c - nodes), 0.0)
    assert outside[0] == pytest.approx(expected, abs=1e-12)
    assert outside.max() == pytest.approx(0.5 * (c - b), abs=nodes[1] - nodes[0])


@pytest.mark.parametrize("name", TASKS)
def test_nothing_is_outside_where_there_is_one_interval(name):
    problem = PROBLEMS[name]
    assert not grids.tables(problem, grids.full_grid(problem, 5, 3), "cp").outside.any()


# Grids


def test_full_grids_span_the_feasible_extensions_and_have_a_node_at_rest():
    problem = PROBLEMS["forwarder-vertical"]
    grid = grids.full_grid(problem, 31, 20)
    assert grid.velocities == 21
    assert np.array_equal(grid.c_lo, problem.lower) and np.array_equal(grid.c_hi, problem.upper)
    nodes = np.linspace(grid.w_lo[0], grid.w_hi[0], grid.velocities)
    assert nodes[[0, 10, 20]].tolist() == [-0.4, 0.0, 0.4]


def test_tubes_follow_the_motion_inside_the_feasible_extensions():
    problem = PROBLEMS["forwarder-vertical"]
    position = 0.5 * (problem.lower + problem.upper)
    position[3] = problem.upper[3] - 0.01
    velocity = np.linspace(-0.2, 0.2, position.size)
    grid = grids.tube_grid(problem, position, velocity, 0.05, 0.08, 21, 10)
    assert grid.c_hi[3] == problem.upper[3]
    assert grid.c_lo[3] == pytest.approx(position[3] - 0.05)
    assert (grid.c_lo[0], grid.c_hi[0]) == pytest.approx((position[0] - 0.05, position[0] + 0.05))
    assert 0.5 * (grid.w_lo + grid.w_hi) == pytest.approx(velocity, abs=1e-15)
    assert grid.w_hi - grid.w_lo == pytest.approx(0.16)
    assert grid.velocities == 11


# Tables


def all_physics(task):
    """The task with every switch on, so that no term of the tables is zero."""
    return replace(task, machine=replace(task.machine, coriolis=True, slewing_inertia=True))


@pytest.mark.parametrize("name", TASKS)
@settings(max_examples=20)
@given(w=RATE, u=RATE)
def test_tables_are_the_crane_at_every_node(name, w, u):
    """Velocity affine in w; acceleration and load quadratic in w and affine in u, at 1e-9 of their size."""
    problem, grid, table = TABLES[name]
    nodes = grid.c_lo[:, None] + (grid.c_hi - grid.c_lo)[:, None] * np.linspace(0.0, 1.0, grid.positions)
    moving = cranes.move(cranes.pose(problem.crane, problem.plane[:, None], nodes), w, u)
    for m, i in enumerate(range(len(problem.crane.machine.cylinders))[problem.moving]):
        row = table.coefficients[:, :, m]
        scale = np.abs(row).max(axis=(0, 1))
        v = row[..., layout.A0] + row[..., layout.A1] * w
        a = row[..., layout.B0] + row[..., layout.B1] * w + row[..., layout.B2] * w * w + row[..., layout.B3] * u
        f = row[..., layout.F0] + row[..., layout.F1] * w + row[..., layout.F2] * w * w + row[..., layout.F3] * u
        assert v == pytest.approx(moving.velocity[i], abs=1e-9 * scale[layout.A0 : layout.A1 + 1].sum())
        assert a == pytest.approx(moving.acceleration[i], abs=1e-9 * scale[layout.B0 : layout.B3 + 1].sum())
        assert f == pytest.approx(moving.load[i], abs=1e-9 * scale[layout.F0 : layout.F3 + 1].sum())


def build_tables():
    found = {}
    for name, task in TASKS.items():
        problem = stages.discretise(all_physics(task), 1.0)
        grid = grids.full_grid(problem, 7, 5)
        found[name] = problem, grid, grids.tables(problem, grid, "ls")
    return found


TABLES = build_tables()


@pytest.mark.parametrize("name", TASKS)
def test_redundant_cylinder_moves_as_it_is_told(name):
    """The last cylinder's velocity is w and its acceleration u, exactly what the kernels assume."""
    _, _, table = TABLES[name]
    row = table.coefficients[:, :, -1]
    exact = {layout.A0: 0.0, layout.A1: 1.0, layout.B0: 0.0, layout.B1: 0.0, layout.B2: 0.0, layout.B3: 1.0}
    for column, value in exact.items():
        assert row[..., column] == pytest.approx(value, abs=1e-12)


def test_friction_levels_follow_the_extension():
    problem, grid, table = TABLES["forwarder-horizontal"]
    levels = table.coefficients[..., layout.COULOMB]
    assert np.all(levels[..., 0] == 6000.0) and np.all(levels[..., 1] == 5000.0)
    end = table.coefficients[-1, :, 2, layout.COULOMB]  # q4 from 1.79 m to 3.7 m
    assert (end[0], end[-1]) == (pytest.approx(4500.0), pytest.approx(6000.0))


def test_grid_columns_describe_the_nodes():
    problem, grid, table = TABLES["forwarder-vertical"]
    assert np.array_equal(table.stage[:, layout.C_LO], grid.c_lo)
    assert grid.c_lo + 6 * table.stage[:, layout.DC] == pytest.approx(grid.c_hi, abs=1e-15)
    assert np.array_equal(table.stage[:, layout.W_LO], grid.w_lo)
    assert grid.w_lo + 4 * table.stage[:, layout.DW] == pytest.approx(grid.w_hi, abs=1e-15)
    assert table.velocities == 5


def test_a_tube_of_no_width_still_has_distinct_nodes():
    problem = PROBLEMS["forwarder-vertical"]
    grid = grids.tube_grid(problem, problem.lower, 0.0 * problem.lower, 0.0, 0.1, 5, 5)
    assert np.all(grids.tables(problem, grid, "cp").stage[:, layout.DC] > 0.0)


@pytest.mark.parametrize("cost", COSTS)
def test_the_prescribed_base_is_one_flow_pressure_and_cost_a_stage(cost):
    """The half cycle's rack turns outwards all the time, against friction alone: 15 kN over 103.87 cm^2 plus back."""
    problem = PROBLEMS["forwarder-half-cycle"]
    stage = grids.tables(problem, grids.full_grid(problem, 3, 3), cost).stage
    base = problem.crane.machine.cylinders[0]
    v = base.linkage.arm * problem.plane.v1
    driven = v > 0.0021
    force = 15e3 * np.tanh(2000.0 * v)
    pressure = force / base.piston_area + 1.5 * 0.7e6
    assert driven.sum() > 30
    flow = base.piston_area * v if cost in ("ls", "cp") else 0.0 * v  # recuperation's return flow is as large
    assert stage[:, layout.FIXED_FLOW] == pytest.approx(flow, abs=1e-12)
    assert stage[driven, layout.FIXED_PRESSURE] == pytest.approx(pressure[driven], rel=1e-12)
    assert not stage[np.abs(v) < 0.0019, layout.FIXED_PRESSURE].any()
    costs = {"actuator": force * v, "velocity": v * v}.get(cost, 0.0 * v)
    assert stage[:, layout.FIXED_COST] == pytest.approx(costs, abs=1e-9)


def test_a_crane_without_a_base_has_nothing_prescribed():
    problem = PROBLEMS["loader-triangle-small"]
    stage = grids.tables(problem, grids.full_grid(problem, 3, 3), "ls").stage
    assert problem.moving == slice(0, None)
    assert not stage[:, [layout.FIXED_FLOW, layout.FIXED_PRESSURE, layout.FIXED_COST]].any()


def test_cylinder_table_holds_drives_and_limits_of_the_moving_cylinders():
    problem = PROBLEMS["forwarder-horizontal"]
    table = stage_arrays.cylinder_table(problem, "ls")
    drives = FORWARDER.drives
    assert table.shape == (3, layout.CYLINDER_COLUMNS)
    for row, d, c in zip(table, drives[1:], FORWARDER.cylinders[1:], strict=True):
        assert row[: layout.BACK_IN + 1].tolist() == [
            d.area_out,
            d.area_in,
            d.gain_out,
            d.back_out,
            d.gain_in,
            d.back_in,
        ]
        assert (row[layout.V_MAX], row[layout.A_MAX]) == (c.velocity_limit, c.acceleration_limit)
        assert row[layout.SQUARE] == 0.0
        assert row[[layout.FLOW_OUT, layout.FLOW_IN]].tolist() == [d.area_out, d.area_in]
    assert table[:, layout.SHARPNESS].tolist() == [2000.0, 2000.0, 4000.0]


@pytest.mark.parametrize("cost", COSTS)
def test_settings_are_the_machine_and_the_slopes(cost):
    setting = stage_arrays.setting(PROBLEMS["forwarder-vertical"], cost, (1.0, 2.0, 3.0, 4.0, 5.0))
    assert setting.shape == (layout.SETTINGS,)
    assert setting[layout.STEP] == 0.25
    assert setting[[layout.SENSING, layout.WORK]].tolist() == [cost == "ls", cost == "actuator"]
    supply = {"ls": 3e6, "cp": 20e6, "recuperation": 20e6}.get(cost, 0.0)
    assert setting[[layout.SUPPLY, layout.EFFICIENCY]].tolist() == [supply, 1.0]
    slopes = [layout.SLOPE_C, layout.SLOPE_W, layout.SLOPE_V, layout.SLOPE_A, layout.SLOPE_F]
    assert setting[slopes].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0]
    assert 0.9 * 0.002 < setting[layout.EPSILON] < 0.002  # planned to hold well inside the judge's threshold
