"""The whole crane in motion: finite differences, power balance, static loads; formulas equal in all three consumers."""

from __future__ import annotations

import ast
import importlib
import inspect
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import leanboom
from bundled_texts import SINGLE
from leanboom.errors import InputError
from leanboom.formulas import dynamics, kinematics
from leanboom.io.loading import load_task
from leanboom.model import crane as cranes
from leanboom.model.task import Lines, Task, sample
from leanboom.problem import stages

TASKS = {name: load_task(name) for name in SINGLE}
TASKS = {
    name: replace(task, machine=replace(task.machine, gravity=9.81, coriolis=True, slewing_inertia=True))
    for name, task in TASKS.items()
}
# A smooth motion of the redundant cylinder for each path: start [m], rate [m/s], swing [m], [rad/s].
STROKES = {
    "forwarder-half-cycle": (0.4, 0.03, 0.1, 0.8),
    "forwarder-horizontal": (0.4, 0.1, 0.05, 1.1),
    "forwarder-vertical": (0.7, 0.0, 0.15, 0.9),
    "loader-triangle-large": (0.8, 0.0, 0.12, 0.7),
    "loader-triangle-medium": (0.7, 0.0, 0.12, 0.7),
    "loader-triangle-small": (0.6, 0.0, 0.12, 0.7),
}
SHARE = st.floats(0.01, 0.99)


def stroke(name, t):
    """Position, velocity and acceleration of the redundant cylinder."""
    start, rate, swing, pace = STROKES[name]
    s, c = np.sin(pace * t), np.cos(pace * t)
    return start + rate * t + swing * s, rate + swing * pace * c, -swing * pace**2 * s


def at(name, t):
    """Pose and motion of the whole crane at times."""
    task = TASKS[name]
    crane = cranes.build(task)
    c, w, u = stroke(name, t)
    pose = cranes.pose(crane, cranes.plane(task.machine, sample(task, t)), c)
    return crane, pose, cranes.move(pose, w, u)


def inside(name, share, h):
    """Three times around one inside a segment, at distance h."""
    task = TASKS[name]
    edges = np.cumsum([0.0, *task.path.durations]) if isinstance(task.path, Lines) else np.array(task.path.times)
    t = share * task.duration
    k = np.searchsorted(edges, t) - 1
    t = np.clip(t, edges[k] + 2.0 * h, edges[k + 1] - 2.0 * h)
    return np.array([t - h, t, t + h])


# Motion


@pytest.mark.parametrize("name", TASKS)
@given(share=SHARE)
def test_cylinder_motion_is_the_derivative_of_the_cylinder_lengths(name, share):
    """Eqs. (10)-(12) and (33)-(35) at once."""
    h = 1e-3
    _, pose, moving = at(name, inside(name, share, h))
    for (length, _, _), v, a in zip(pose.cylinders, moving.velocity, moving.acceleration, strict=True):
        assert v[1] == pytest.approx((length[2] - length[0]) / (2.0 * h), abs=2e-6)
        assert a[1] == pytest.approx((v[2] - v[0]) / (2.0 * h), abs=2e-6)


@pytest.mark.parametrize("name", TASKS)
@given(share=SHARE)
def test_joint_motion_is_the_derivative_of_the_joint_positions(name, share):
    h = 1e-3
    crane, pose, moving = at(name, inside(name, share, h))
    joints = (pose.plane.q1, *pose.q) if crane.machine.geometry.slewing else pose.q
    for q, v, a in zip(joints, moving.joint_velocity, moving.joint_acceleration, strict=True):
        assert v[1] == pytest.approx((q[2] - q[0]) / (2.0 * h), abs=3e-6)
        assert a[1] == pytest.approx((v[2] - v[0]) / (2.0 * h), abs=3e-6)


@pytest.mark.parametrize("name", TASKS)
def test_the_tool_is_on_its_path_whatever_the_extension_does(name):
    task = TASKS[name]
    t = np.linspace(0.0, task.duration, 201)
    crane, pose, _ = at(name, t)
    g = crane.machine.geometry
    r, z = kinematics.tool_point(*pose.q, g.base_x, g.base_z, g.boom, g.offset, g.outer)
    tool = np.stack([r * np.cos(pose.plane.q1), r * np.sin(pose.plane.q1), z], axis=1)
    assert tool == pytest.approx(sample(task, t).point, abs=1e-12)


def test_base_motion_of_the_half_cycle():
    """0 to 1.21 rad; the rack within 0.015 m/s and 0.004 m/s^2."""
    _, pose, moving = at("forwarder-half-cycle", np.linspace(0.0, 15.0, 3001))
    assert (pose.plane.q1.min(), pose.plane.q1.max()) == pytest.approx((0.0, 1.21), abs=6e-3)
    assert np.abs(moving.velocity[0]).max() == pytest.approx(0.015, abs=6e-4)
    assert np.abs(moving.acceleration[0]).max() == pytest.approx(0.004, abs=6e-4)


# Energy


def energy(crane, pose, moving):
    """Kinetic and potential energy of the crane, from its bodies' speeds and heights."""
    g = crane.machine.geometry
    q2, q3, q4 = pose.q
    v1, v2, v3, v4 = moving.joint_velocity if g.slewing else (0.0, *moving.joint_velocity)
    total = 0.0
    for b in crane.bodies:
        if b.carrier == "base":
            total = total + 0.5 * b.inertia * v1**2
            continue
        if b.carrier == "lift":
            angle, spin = q2, v2
            x, z = b.along * np.cos(q2) - b.above * np.sin(q2), b.along * np.sin(q2) + b.above * np.cos(q2)
            vx, vz = -z * v2, x * v2
        else:
            angle, spin = q2 + q3, v2 + v3
            s, c, along = np.sin(angle), np.cos(angle), b.along + b.extension_share * q4
            px, pz = along * c - b.above * s, along * s + b.above * c
            x, z = g.boom * np.cos(q2) + px, g.boom * np.sin(q2) + pz
            slide = b.extension_share * v4
            vx = -g.boom * np.sin(q2) * v2 - pz * spin + slide * c
            vz = g.boom * np.cos(q2) * v2 + px * spin + slide * s
        speed = vx**2 + vz**2 + ((g.base_x + x) * v1) ** 2
        turning = spin**2 + (np.cos(angle) * v1) ** 2
        total = total + 0.5 * b.mass * speed + 0.5 * b.inertia * turning + b.mass * crane.machine.gravity * z
    return total


@pytest.mark.parametrize("name", TASKS)
@given(share=SHARE)
def test_cylinder_power_is_what_the_crane_gains(name, share):
    """Force times velocity, summed over the cylinders, is the rate of kinetic and potential energy."""
    h = 1e-3
    crane, pose, moving = at(name, inside(name, share, h))
    gained = energy(crane, pose, moving)
    power = sum(load * v for load, v in zip(moving.load, moving.velocity, strict=True))
    assert power[1] == pytest.approx((gained[2] - gained[0]) / (2.0 * h), rel=2e-5, abs=2e-2)


@pytest.mark.parametrize("name", ["forwarder-half-cycle", "loader-triangle-large"])
def test_joint_power_is_cylinder_power(name):
    """Cylinder by cylinder: M q'' + G on the joint times its speed, force times cylinder velocity."""
    task = TASKS[name]
    task = replace(task, machine=replace(task.machine, coriolis=False, slewing_inertia=False))
    crane = cranes.build(task)
    t = np.linspace(0.1, 0.9, 33) * task.duration
    c, w, u = stroke(name, t)
    pose = cranes.pose(crane, cranes.plane(task.machine, sample(task, t)), c)
    moving = cranes.move(pose, w, u)
    m22, m23, m24, m33, m34, m44 = pose.inertia
    rows = ((m22, m23, m24), (m23, m33, m34), (m24, m34, m44))
    for i, row in enumerate(rows, start=-3):
        torque = sum(m * a for m, a in zip(row, moving.joint_acceleration[-3:], strict=True)) + pose.gravity[i]
        assert moving.load[i] * moving.velocity[i] == pytest.approx(torque * moving.joint_velocity[i], rel=1e-10)
    if task.machine.geometry.slewing:
        assert np.all(moving.load[0] == 0.0)  # the base force is friction alone, as the 4-DOF paper takes it


def test_switches_add_slewing_and_velocity_torques():
    """Slewing inertia brings M11 q1''; with Coriolis forces also M11' q1', and centrifugal torques elsewhere."""
    name = "forwarder-half-cycle"
    task = TASKS[name]
    t = np.array([5.0, 7.0, 9.0])
    loads = {}
    for coriolis in (False, True):
        for inertia in (False, True):
            crane = cranes.build(
                replace(task, machine=replace(task.machine, coriolis=coriolis, slewing_inertia=inertia))
            )
            pose = cranes.pose(crane, cranes.plane(task.machine, sample(task, t)), stroke(name, t)[0])
            moving = cranes.move(pose, *stroke(name, t)[1:])
            loads[coriolis, inertia] = np.array(moving.load)
    arm = crane.machine.cylinders[0].linkage.arm
    m11, rate = cranes.slewing(crane, pose.q, moving.joint_velocity[1:])
    assert loads[False, True][0] * arm == pytest.approx(m11 * moving.joint_acceleration[0])
    assert loads[True, True][0] * arm == pytest.approx(
        m11 * moving.joint_acceleration[0] + rate * moving.joint_velocity[0]
    )
    assert np.all(loads[False, False][0] == 0.0) and np.all(loads[True, False][0] == 0.0)
    extra = cranes.velocity_torques(crane, pose.q, moving.joint_velocity)
    arms = np.array([pose.cylinders[i][1] for i in (1, 2, 3)])
    for inertia in (False, True):
        assert (loads[True, inertia] - loads[False, inertia])[1:] * arms == pytest.approx(np.array(extra), rel=1e-8)


def test_friction_is_added_to_the_load():
    """Fully sliding above a few mm/s: Coulomb level with the motion's sign; the extension's in its three plateaus."""
    task = TASKS["forwarder-horizontal"]
    crane = cranes.build(task)
    plane = cranes.plane(task.machine, sample(task, np.full(3, 5.0)))
    pose = cranes.pose(crane, plane, np.array([0.3, 0.8, 1.4]))  # q4 = 0.6, 1.6, 2.8 m
    for w in (0.2, -0.2):
        moving = cranes.move(pose, w, 0.0)
        added = np.array(cranes.forces(pose, moving)) - np.array(moving.load)
        assert added[3] == pytest.approx(np.sign(w) * np.array([3000.0, 4500.0, 6000.0]))
        assert added[1] == pytest.approx(6000.0 * np.sign(moving.velocity[1]))
        assert added[2] == pytest.approx(5000.0 * np.sign(moving.velocity[2]))
        assert added[0] == pytest.approx(0.0)  # the base rests


def test_extension_friction_sees_the_joint_velocity():
    """Eq. (A3) has tanh(K q4'), and the joint is twice as fast as the cylinder."""
    task = TASKS["forwarder-horizontal"]
    crane = cranes.build(task)
    assert cranes.sharpness(crane) == (2000.0, 2000.0, 2000.0, 4000.0)
    pose = cranes.pose(crane, cranes.plane(task.machine, sample(task, np.array([5.0]))), np.array([0.3]))
    moving = cranes.move(pose, 1e-4, 0.0)
    added = cranes.forces(pose, moving)[3] - moving.load[3]
    assert added == pytest.approx(3000.0 * np.tanh(0.4), rel=1e-9)


# Static loads


def static_forces(crane, q):
    """Gravity's cylinder forces of lift, tilt and extension."""
    _, gravity = cranes.inertia_and_gravity(crane, *q)
    cylinders = crane.machine.cylinders[-3:]
    return [g / c.linkage.length_arm_slope(v)[1] for g, c, v in zip(gravity, cylinders, q, strict=True)]


def pressures(crane, forces):
    """Largest piston-side and rod-side pressures [MPa] of lift, tilt and extension with the other side empty."""
    found = []
    for force, cylinder in zip(forces, crane.machine.cylinders[-3:], strict=True):
        found.append((np.max(force) / cylinder.piston_area / 1e6, np.max(-force) / cylinder.rod_side_area / 1e6))
    return found


def over_the_path(name):
    """Static forces at every stage and 21 feasible extensions of it."""
    problem = stages.discretise(TASKS[name], 0.1)
    share = np.linspace(0.0, 1.0, 21)
    nodes = problem.lower[:, None] + (problem.upper - problem.lower)[:, None] * share
    pose = cranes.pose(problem.crane, problem.plane[:, None], nodes)
    return problem.crane, static_forces(problem.crane, pose.q)


def joint_space(crane, count=61):
    """Every combination of lift, tilt and extension."""
    return np.meshgrid(*(np.linspace(j.lower, j.upper, count) for j in crane.machine.joints[-3:]), indexing="ij")


def test_static_pressures_of_the_loader():
    """Over the large triangle 12.3, 21.4 and 4.5 MPa; in the corners of the joint space 19.8 and 22.4 MPa.

    Worked out from the law of cosines and virtual work, at 201 points of an edge and extensions 1 mm apart. The tilt's
    arm is small and falls fast before its joint's limit: half a millimetre there is 0.3 MPa.
    """
    crane, forces = over_the_path("loader-triangle-large")
    (lift, _), (tilt, _), extension = pressures(crane, forces)
    assert (lift, max(extension)) == pytest.approx((12.30, 4.45), abs=0.06)
    assert tilt == pytest.approx(21.44, abs=0.4)
    (lift, _), (tilt, _), _ = pressures(crane, static_forces(crane, joint_space(crane)))
    assert (lift, tilt) == pytest.approx((19.78, 22.38), abs=0.06)


def test_static_pressures_of_the_forwarder():
    """Over the three paths lift 9.4, tilt rod side 8.9 MPa (9.0 in the limit); in all poses 12.7, 9.0, 13.4 MPa."""
    worst = [pressures(*over_the_path(name)) for name in TASKS if name.startswith("forwarder")]
    assert max(lift for (lift, _), _, _ in worst) == pytest.approx(9.4, abs=0.06)
    assert max(rod for _, (_, rod), _ in worst) == pytest.approx(8.9, abs=0.12)
    crane = cranes.build(TASKS["forwarder-vertical"])
    forces = static_forces(crane, joint_space(crane))
    (lift, _), (piston, rod), _ = pressures(crane, forces)
    assert lift == pytest.approx(12.7, abs=0.06)
    assert (piston, rod) == pytest.approx((13.4, 9.0), abs=0.06)


def test_extension_carries_twice_its_load():
    """7.2 kN with the telescope upright: the 4-DOF paper's doubled gravity component."""
    crane = cranes.build(TASKS["forwarder-vertical"])
    *_, force = static_forces(crane, (np.pi / 2, 0.0, 1.0))
    assert force == pytest.approx(2.0 * 9.81 * (115.0 / 2.0 + 80.0 + 230.0))
    assert force == pytest.approx(7.2e3, abs=60.0)


# Input


def test_a_path_through_the_slewing_axis_is_refused():
    task = Task("through", TASKS["forwarder-horizontal"].machine, Lines(((-4.0, 0.0, 2.0), (4.0, 0.0, 2.0)), (10.0,)))
    with pytest.raises(InputError, match=r"^the path passes through the slewing axis at 5\.000 s, .*; move it away$"):
        cranes.build(task)


def test_the_base_angle_does_not_jump_behind_the_crane():
    task = Task("behind", TASKS["forwarder-horizontal"].machine, Lines(((-4.0, 2.0, 2.0), (-4.0, -2.0, 2.0)), (10.0,)))
    plane = cranes.plane(task.machine, sample(task, np.linspace(0.0, 10.0, 201)))
    assert np.abs(np.diff(plane.q1)).max() < 0.02
    assert plane.q1[-1] - plane.q1[0] == pytest.approx(2.0 * np.arctan2(2.0, 4.0))


def test_without_a_telescope_there_is_no_redundant_ratio():
    machine = TASKS["loader-triangle-large"].machine
    wrong = replace(machine.cylinders[-1], linkage=machine.cylinders[0].linkage)
    crane = cranes.build(
        replace(TASKS["loader-triangle-large"], machine=replace(machine, cylinders=(*machine.cylinders[:2], wrong)))
    )
    with pytest.raises(InputError, match="^the extension cylinder needs a linkage of type telescope$"):
        _ = crane.ratio


# Formulas


def formulas():
    """Every function that carries the decorator, read off the sources: the registry empties itself when used."""
    found = {}
    folder = Path(leanboom.__file__).parent / "formulas"
    for path in sorted(folder.glob("*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef) and any(
                getattr(d, "id", "") == "formula" for d in node.decorator_list
            ):
                found[f"{path.stem}.{node.name}"] = getattr(
                    importlib.import_module(f"leanboom.formulas.{path.stem}"), node.name
                )
    return found


FORMULAS = formulas()
# Where arguments are drawn from, by name; all others from 0.1 to 2.
RANGES = {
    "q2": (-0.4, 1.1), "q3": (-2.7, -0.3), "q4": (0.0, 3.7), "q": (-2.7, -0.3), "r": (4.0, 6.0), "z": (0.5, 3.0),
    "ox": (-0.2, 0.2), "oz": (1.5, 1.7), "L1": (3.4, 3.6), "L2": (0.3, 0.4), "L3": (2.0, 2.2), "angle": (-2.0, 1.0),
    "L21": (1.39, 1.4), "L22": (0.18, 0.19), "L23": (0.27, 0.28), "L24": (0.50, 0.51), "L25": (0.48, 0.49),
    "a21": (-0.05, -0.04), "a22": (1.95, 1.97), "b21": (0.18, 0.19), "v": (-0.4, 0.4), "F": (-2.0, 2.0),
    "v1": (-1.0, 1.0), "v2": (-1.0, 1.0), "v3": (-1.0, 1.0), "v4": (-1.0, 1.0), "epsilon": (0.0, 0.1),
    "angle_rate": (-1.0, 1.0), "radius_rate": (-1.0, 1.0),
}  # fmt: skip
SPECIAL = {
    ("linkages.four_bar", "L22"): (0.18, 0.182),
    ("linkages.triangle", "q"): (-0.4, 1.1), ("linkages.triangle", "a"): (1.2, 1.3),
    ("linkages.triangle", "b"): (0.4, 0.5), ("linkages.triangle", "q0"): (0.9, 1.0),
    ("dynamics.stepped_coulomb", "q"): (0.0, 3.7), ("dynamics.stepped_coulomb", "f1"): (0.8, 0.9),
    ("dynamics.stepped_coulomb", "f2"): (1.3, 1.4), ("dynamics.stepped_coulomb", "f3"): (2.2, 2.3),
    ("dynamics.stepped_coulomb", "f4"): (2.7, 2.8),
    ("dynamics.heaviside", "x"): (-1.0, 1.0), ("kinematics.cylindrical", "x"): (-2.0, -1.0),
}  # fmt: skip
DRAWS = 25


def arguments(name):
    """Random arguments of a formula, (arguments, DRAWS)."""
    rng = np.random.default_rng(len(name))
    ranges = [SPECIAL.get((name, p), RANGES.get(p, (0.1, 2.0))) for p in inspect.signature(FORMULAS[name]).parameters]
    return np.array([rng.uniform(*limits, size=DRAWS) for limits in ranges])


def values(result):
    """The results of a formula as one array, however many it returns."""
    return np.array(result if isinstance(result, tuple) else (result,), dtype=np.float64)


def test_all_formulas_are_found():
    assert {"kinematics.lift_and_tilt", "linkages.four_bar", "dynamics.friction", "hydraulics.pressure_demand"} < set(
        FORMULAS
    )
    assert len(FORMULAS) >= 25


@pytest.mark.parametrize("name", FORMULAS)
def test_formulas_agree_on_arrays_and_numbers(name):
    x = arguments(name)
    together = values(FORMULAS[name](*x))
    assert np.all(np.isfinite(together))
    for i in range(DRAWS):
        assert values(FORMULAS[name](*x[:, i])) == pytest.approx(together[:, i], rel=1e-14, abs=1e-15)


@pytest.fixture(scope="module")
def kernel():
    """All formulas in one compiled function: a call by index, results into an array."""
    from numba import njit

    from leanboom.formulas.formula import enable_in_kernels

    enable_in_kernels()  # those too that were imported after the kernels
    lines = ["def call(index, x, out):"]
    for index, (name, function) in enumerate(FORMULAS.items()):
        count = len(inspect.signature(function).parameters)
        results = len(values(function(*arguments(name)[:, 0])))
        targets = ", ".join(f"out[{k}]" for k in range(results))
        lines += [
            f"    if index == {index}:",
            f"        {targets} = f{index}({', '.join(f'x[{k}]' for k in range(count))})",
        ]
    names = {f"f{index}": function for index, function in enumerate(FORMULAS.values())}
    exec("\n".join(lines), names)  # numba needs each call spelt out
    return njit(names["call"])


@pytest.mark.parametrize("name", FORMULAS)
def test_formulas_agree_inside_kernels(name, kernel):
    x = arguments(name)
    expected = values(FORMULAS[name](*x))
    out = np.full((expected.shape[0], DRAWS), np.nan)
    for i in range(DRAWS):
        column = np.full(expected.shape[0], np.nan)
        kernel(list(FORMULAS).index(name), np.ascontiguousarray(x[:, i]), column)
        out[:, i] = column
    assert out == pytest.approx(expected, rel=1e-12, abs=1e-14)


@pytest.mark.parametrize("name", FORMULAS)
def test_formulas_agree_on_symbols(name):
    import casadi

    casadi.GlobalOptions.setNumpyMode(1)
    x = arguments(name)
    symbols = [casadi.SX.sym(f"x{k}") for k in range(len(x))]
    result = FORMULAS[name](*symbols)
    function = casadi.Function("f", symbols, list(result) if isinstance(result, tuple) else [result])
    columns = [
        np.array(function(*x[:, i]) if function.n_out() > 1 else [function(*x[:, i])], dtype=float).ravel()
        for i in range(DRAWS)
    ]
    assert np.array(columns).T == pytest.approx(values(FORMULAS[name](*x)), rel=1e-12, abs=1e-14)


def test_a_whole_crane_goes_through_on_symbols():
    """As collocation and simulation use it."""
    import casadi

    casadi.GlobalOptions.setNumpyMode(1)
    task = TASKS["forwarder-half-cycle"]
    crane = cranes.build(task)
    plane = cranes.plane(task.machine, sample(task, np.array([6.0])))
    c, w, u = (casadi.SX.sym(name) for name in "cwu")
    here = cranes.Plane(*(float(np.squeeze(getattr(plane, name))) for name in cranes.Plane.__slots__))
    pose = cranes.pose(crane, here, c)
    moving = cranes.move(pose, w, u)
    symbolic = casadi.Function("f", [c, w, u], [*moving.velocity, *moving.acceleration, *cranes.forces(pose, moving)])
    found = np.array([float(value) for value in symbolic(0.6, 0.1, -0.2)])
    pose = cranes.pose(crane, here, 0.6)
    moving = cranes.move(pose, 0.1, -0.2)
    assert found == pytest.approx([*moving.velocity, *moving.acceleration, *cranes.forces(pose, moving)], rel=1e-12)


def test_heaviside_of_eq_38_survives_symbols_at_zero():
    import casadi

    casadi.GlobalOptions.setNumpyMode(1)
    x = casadi.SX.sym("x")
    assert float(casadi.Function("h", [x], [dynamics.heaviside(x)])(0.0)) == 0.5
