"""Kinematics against the papers' DH matrices, finite differences and the inverse of the inverse."""

from __future__ import annotations

from dataclasses import replace
from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leanboom.formulas import kinematics
from leanboom.formulas.kinematics import ELBOW_DOWN, ELBOW_MARGIN, ELBOW_UP
from leanboom.io.loading import load_machine
from leanboom.model import crane as cranes
from leanboom.model.task import Lines, Task

MACHINES = {name: load_machine(name) for name in ("forwarder", "loader")}
SHARE = st.floats(0.0, 1.0)
RATE = st.floats(-1.0, 1.0)


def plane(geometry):
    """The geometry as `tool_point` takes it."""
    return geometry.base_x, geometry.base_z, geometry.boom, geometry.offset, geometry.outer


def links(geometry):
    """The geometry as `jacobian` takes it."""
    return geometry.boom, geometry.offset, geometry.outer


def pose(machine, shares):
    """Lift, tilt and extension at shares of their ranges."""
    return [j.lower + s * (j.upper - j.lower) for j, s in zip(machine.joints[-3:], shares, strict=True)]


def transformation(a, alpha, d, theta):
    """Denavit-Hartenberg matrix: eq. (3), 4-DOF; eq. (2), 3-DOF paper."""
    return np.array(
        [
            [cos(theta), -sin(theta) * cos(alpha), sin(theta) * sin(alpha), a * cos(theta)],
            [sin(theta), cos(theta) * cos(alpha), -cos(theta) * sin(alpha), a * sin(theta)],
            [0.0, sin(alpha), cos(alpha), d],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


@given(q1=st.floats(-pi, pi), shares=st.tuples(SHARE, SHARE, SHARE))
def test_tool_point_is_the_dh_product_of_the_4dof_paper(q1, shares):
    machine = MACHINES["forwarder"]
    q2, q3, q4 = pose(machine, shares)
    # Table 2, as printed.
    table = [
        (-0.208, pi / 2, 1.605, q1),
        (3.504, 0, 0, q2),
        (0.376, pi / 2, 0, q3 + pi / 2),
        (0, -pi / 2, 2.13 + q4, 0),
    ]
    x, y, z = np.linalg.multi_dot([transformation(*row) for row in table])[:3, 3]
    radius, height = kinematics.tool_point(q2, q3, q4, *plane(machine.geometry))
    assert [radius * cos(q1), radius * sin(q1), height] == pytest.approx([x, y, z], abs=1e-13)


@given(shares=st.tuples(SHARE, SHARE, SHARE))
def test_tool_point_is_the_dh_product_of_the_3dof_paper(shares):
    machine = MACHINES["loader"]
    q1, q2, q3 = pose(machine, shares)
    table = [(1.60, 0, 0, q1), (0, pi / 2, 0, pi / 2 + q2), (0, 0, 1.562 + q3, 0)]  # Table 1, as printed
    x, y, _ = np.linalg.multi_dot([transformation(*row) for row in table])[:3, 3] + [-0.225, 0.957, 0.0]
    assert kinematics.tool_point(q1, q2, q3, *plane(machine.geometry)) == pytest.approx((x, y), abs=1e-13)


@pytest.mark.parametrize(
    ("name", "q", "tool"),
    [
        ("forwarder", (0.3, -1.0, 1.0), (5.7757, 0.9117)),
        ("forwarder", (0.117, -0.25, 3.7), (9.1004, 1.6136)),
        ("forwarder", (0.8, -1.6, 0.5), (4.3353, 2.4939)),
        ("loader", (0.90673, -1.52200, 0.2), (2.2, 1.2)),
        ("loader", (1.15799, -1.75903, 0.6), (2.2, 1.2)),
    ],
)
def test_tool_points_worked_out_elsewhere(name, q, tool):
    geometry = MACHINES[name].geometry
    assert kinematics.tool_point(*q, *plane(geometry)) == pytest.approx(tool, abs=6e-5)
    assert kinematics.lift_and_tilt(*tool, q[2], *plane(geometry)) == pytest.approx(q[:2], abs=6e-5)


@pytest.mark.parametrize("offset", [0.376, -0.2])
def test_the_offset_is_upwards_where_the_crane_is_stretched_out(offset):
    """As docs/files.md draws it, also for the payload that hangs at the tool."""
    machine = MACHINES["forwarder"]
    g = replace(machine.geometry, offset=offset)
    extension = 1.5
    r, z = kinematics.tool_point(0.0, 0.0, extension, *plane(g))
    assert r == pytest.approx(g.base_x + g.boom + g.outer + extension)
    assert z == pytest.approx(g.base_z + offset)
    machine = replace(machine, geometry=g, payload_along=g.outer, payload_above=offset)
    q = (0.3, -0.4, extension)
    empty, loaded = (
        cranes.inertia_and_gravity(
            cranes.build(Task("hold", machine, Lines(((5, 0, 2), (5, 0, 2)), (1.0,)), payload)), *q
        )
        for payload in (0.0, 100.0)
    )
    _, _, _, *slopes = kinematics.jacobian(*q, *links(g))
    np.testing.assert_allclose(np.subtract(loaded[1], empty[1]), 100.0 * machine.gravity * np.array(slopes), rtol=1e-9)


def test_forwarder_reaches_what_its_maker_prints():
    """9.1 m from the slewing axis, stretched as far as the tilt joint allows."""
    machine = MACHINES["forwarder"]
    q2 = np.linspace(machine.joints[1].lower, machine.joints[1].upper, 20001)
    radius, _ = kinematics.tool_point(q2, machine.joints[2].upper, machine.joints[3].upper, *plane(machine.geometry))
    assert radius.max() == pytest.approx(9.100, abs=5e-4)


@pytest.mark.parametrize("name", MACHINES)
@given(shares=st.tuples(SHARE, SHARE, SHARE))
def test_inverse_kinematics_finds_the_joints_back(name, shares):
    """Every pose inside the joint ranges is the one that the inverse finds: one branch, no wrapped angle."""
    machine = MACHINES[name]
    q = pose(machine, shares)
    tool = kinematics.tool_point(*q, *plane(machine.geometry))
    assert kinematics.lift_and_tilt(*tool, q[2], *plane(machine.geometry)) == pytest.approx(q[:2], abs=1e-11)
    assert abs(kinematics.elbow_cosine(*tool, q[2], *plane(machine.geometry))) < 1.0


@pytest.mark.parametrize("name", MACHINES)
@pytest.mark.parametrize("side", [ELBOW_UP, ELBOW_DOWN])
@given(bend=st.floats(1.001 * ELBOW_MARGIN, pi - 1.001 * ELBOW_MARGIN), angle=st.floats(-1.5, 1.5), share=SHARE)
def test_forward_kinematics_returns_every_reachable_point(name, side, bend, angle, share):
    """Also outside the joint ranges, on both sides, as far as the arms reach without being straight or folded."""
    machine = MACHINES[name]
    g = machine.geometry
    q4 = share * machine.joints[-1].upper
    e = np.hypot(g.outer + q4, g.offset)
    distance = np.sqrt(g.boom**2 + e**2 + 2.0 * g.boom * e * cos(bend))
    target = g.base_x + distance * cos(angle), g.base_z + distance * sin(angle)
    q2, q3 = kinematics.lift_and_tilt(*target, q4, *plane(g), side)
    assert kinematics.tool_point(q2, q3, q4, *plane(g)) == pytest.approx(target, abs=1e-11)
    assert side * (q3 + np.arctan2(g.offset, g.outer + q4)) == pytest.approx(
        bend, abs=1e-9
    )  # up: outer boom folded down


@pytest.mark.parametrize(
    ("distance", "bend"),
    [(9.9, ELBOW_MARGIN), (7.650, ELBOW_MARGIN), (0.3, pi - ELBOW_MARGIN), (0.65, pi - ELBOW_MARGIN)],
)
@pytest.mark.parametrize("side", [ELBOW_UP, ELBOW_DOWN])
def test_unreachable_points_give_the_nearest_pose(distance, bend, side):
    """Nearly straight when the tool is too far, nearly folded when it is too close, pointing at the tool."""
    g = MACHINES["forwarder"].geometry
    e = np.hypot(4.13, 0.376)
    length = np.sqrt(3.504**2 + e**2 + 2.0 * 3.504 * e * cos(bend))
    target = g.base_x + distance * cos(0.4), g.base_z + distance * sin(0.4)
    assert abs(kinematics.elbow_cosine(*target, 2.0, *plane(g))) > cos(ELBOW_MARGIN)
    q2, q3 = kinematics.lift_and_tilt(*target, 2.0, *plane(g), side)
    assert side * (q3 + np.arctan2(0.376, 4.13)) == pytest.approx(bend, abs=1e-12)
    nearest = g.base_x + length * cos(0.4), g.base_z + length * sin(0.4)
    assert kinematics.tool_point(q2, q3, 2.0, *plane(g)) == pytest.approx(nearest, abs=1e-12)


@pytest.mark.parametrize("name", MACHINES)
@given(shares=st.tuples(SHARE, SHARE, SHARE))
def test_jacobian_is_the_slope_of_the_tool_point(name, shares):
    machine = MACHINES[name]
    q = np.array(pose(machine, shares))
    h = 1e-5
    ends = [kinematics.tool_point(*(q + step), *plane(machine.geometry)) for step in (*h * np.eye(3), *-h * np.eye(3))]
    slopes = (np.array(ends[:3]) - np.array(ends[3:])).T / (2.0 * h)
    assert kinematics.jacobian(*q, *links(machine.geometry)) == pytest.approx(slopes.ravel(), abs=2e-9)


@pytest.mark.parametrize("name", MACHINES)
@given(shares=st.tuples(SHARE, SHARE, SHARE), v=st.tuples(RATE, RATE, RATE))
def test_velocity_product_is_the_tool_acceleration_without_joint_acceleration(name, shares, v):
    machine = MACHINES[name]
    q, v = np.array(pose(machine, shares)), np.array(v)
    h = 1e-3  # fourth-order difference
    weights = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / (12.0 * h * h)
    points = [kinematics.tool_point(*(q + k * h * v), *plane(machine.geometry)) for k in (-2, -1, 0, 1, 2)]
    product = kinematics.velocity_product(*q, *v, *links(machine.geometry))
    assert product == pytest.approx(weights @ np.array(points), abs=3e-8)


def test_solve_plane_is_the_inverse_matrix(rng):
    for _ in range(20):
        matrix, right = rng.normal(size=(2, 2)), rng.normal(size=2)
        assert kinematics.solve_plane(*matrix.ravel(), *right) == pytest.approx(np.linalg.solve(matrix, right))


def spiral(t):
    """A tool that goes around the crane: x and y [m]."""
    radius, angle = 5.0 + np.sin(0.7 * t), 0.5 * t + 0.2 * np.cos(t)
    return np.array([radius * np.cos(angle), radius * np.sin(angle)])


@given(t=st.floats(-10.0, 10.0))
def test_cylindrical_rates_are_those_of_a_path(t):
    h = 1e-3
    before, here, after = spiral(t - h), spiral(t), spiral(t + h)
    rates = (after - before) / (2.0 * h), (after - 2.0 * here + before) / h**2
    r, vr, ar, q1v, q1a = kinematics.cylindrical(*here, *rates[0], *rates[1])
    # What the path says: radius and angle of `spiral`, differentiated by hand.
    assert r == pytest.approx(5.0 + np.sin(0.7 * t), abs=1e-12)
    assert vr == pytest.approx(0.7 * np.cos(0.7 * t), abs=1e-5)
    assert ar == pytest.approx(-0.49 * np.sin(0.7 * t), abs=1e-5)
    assert q1v == pytest.approx(0.5 - 0.2 * np.sin(t), abs=1e-5)
    assert q1a == pytest.approx(-0.2 * np.cos(t), abs=1e-5)


def test_a_straight_pass_has_no_tangential_acceleration():
    """At (3, 4) with velocity (1, 0): r = 5, r' = 3/5, r'' = 16/125, q' = -4/25, q'' = 24/625."""
    rates = kinematics.cylindrical(3.0, 4.0, 1.0, 0.0, 0.0, 0.0)
    assert rates == pytest.approx((5.0, 3 / 5, 16 / 125, -4 / 25, 24 / 625), rel=1e-14)


def test_the_offset_bends_the_outer_boom_upwards():
    """With all angles zero the tool stands the offset above the boom's line."""
    g = replace(MACHINES["forwarder"].geometry, base_x=0.0, base_z=0.0)
    assert kinematics.tool_point(0.0, 0.0, 0.0, *plane(g)) == pytest.approx((3.504 + 2.13, 0.376))
