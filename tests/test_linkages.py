"""Linkages against printed lengths and arms, finite differences, and a four-bar drawn with points."""

from __future__ import annotations

from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leanboom.components.linkages import Polynomial, RackAndPinion, Telescope
from leanboom.io.loading import load_machine

MACHINES = {name: load_machine(name) for name in ("forwarder", "loader")}
# The quintic of eq. (14) fitted to the forwarder's tilt linkage, s5 to s0.
QUINTIC = Polynomial((0.002866, 0.030668, 0.126368, 0.188005, -0.255217, 0.941039))
SHARE = st.floats(0.0, 1.0)


def part(machine, name):
    """Linkage and range of a joint."""
    index = machine.names.index(name)
    joint = machine.joints[index]
    return machine.cylinders[index].linkage, joint.lower, joint.upper


# Each type of linkage with a range to try it over.
LINKAGES = (
    pytest.param(RackAndPinion(0.1146), -pi, pi, id="rack_and_pinion"),
    pytest.param(Telescope(0.5), 0.0, 3.7, id="telescope"),
    pytest.param(QUINTIC, -2.75, -0.25, id="polynomial"),
    pytest.param(*part(MACHINES["forwarder"], "lift"), id="triangle"),
    pytest.param(*part(MACHINES["loader"], "tilt"), id="triangle-loader"),
    pytest.param(*part(MACHINES["forwarder"], "tilt"), id="four_bar"),
)


@pytest.mark.parametrize(
    ("machine", "joint", "lengths", "arms"),
    [
        (
            "loader",
            "lift",
            (0.78275, 0.94017, 1.09779, 1.23178, 1.32775),
            (0.33741, 0.37606, 0.34431, 0.27023, 0.17061),
        ),
        (
            "loader",
            "tilt",
            (0.83000, 0.92664, 1.08842, 1.25248, 1.37663),
            (0.07539, 0.25342, 0.30901, 0.26868, 0.17094),
        ),
        (
            "forwarder",
            "lift",
            (0.91000, 1.05446, 1.22091, 1.38208, 1.52000),
            (0.31960, 0.42295, 0.44011, 0.39928, 0.32065),
        ),
        (
            "forwarder",
            "tilt",
            (1.74000, 1.64840, 1.52678, 1.37310, 1.19397, 1.01500),
            (-0.15656, -0.21173, -0.27560, -0.33719, -0.37158, -0.32252),
        ),
    ],
)
def test_lengths_and_arms_worked_out_elsewhere(machine, joint, lengths, arms):
    """Equally spaced over the range, to the last digit given (the pins in the files are rounded, too)."""
    linkage, lower, upper = part(MACHINES[machine], joint)
    c, r, _ = linkage.length_arm_slope(np.linspace(lower, upper, len(lengths)))
    assert c == pytest.approx(lengths, abs=6e-6)
    assert r == pytest.approx(arms, abs=6e-6)


@pytest.mark.parametrize(
    ("machine", "joint", "largest", "at"),
    [
        ("loader", "lift", 0.376, 0.2045),
        ("loader", "tilt", 0.309, -1.4305),
        ("forwarder", "lift", 0.4423, 0.236),
        ("forwarder", "tilt", 0.372, -0.71),
    ],
)
def test_largest_arm_is_where_the_slope_vanishes(machine, joint, largest, at):
    linkage, lower, upper = part(MACHINES[machine], joint)
    q = np.linspace(lower, upper, 4001)
    _, r, s = linkage.length_arm_slope(q)
    best = np.abs(r).argmax()
    assert abs(r[best]) == pytest.approx(largest, abs=5e-4)
    assert q[best] == pytest.approx(at, abs=6e-3)
    assert abs(s[best]) < 1e-3 < min(abs(s[0]), abs(s[-1]))


@pytest.mark.parametrize("name", MACHINES)
def test_lengths_change_by_the_printed_strokes(name):
    machine = MACHINES[name]
    printed = {"forwarder": (0.72, 0.61, 0.725, 1.85), "loader": (0.545, 0.545, 1.04)}[name]
    for c, joint, stroke in zip(machine.cylinders, machine.joints, printed, strict=True):
        ends, _, _ = c.linkage.length_arm_slope(np.array([joint.lower, joint.upper]))
        # The loader's tilt is set by eq. (30) and the public retracted length: 1.6 mm more than printed.
        close = 2e-3 if (name, c.name) == ("loader", "tilt") else 1e-4
        assert abs(ends[1] - ends[0]) == pytest.approx(stroke, abs=close)


@pytest.mark.parametrize(("linkage", "lower", "upper"), LINKAGES)
@given(share=SHARE)
def test_arm_and_slope_are_the_derivatives_of_the_length(linkage, lower, upper, share):
    q = lower + share * (upper - lower)
    h = 1e-4
    (before, r_before, _), (_, r, s), (after, r_after, _) = (
        linkage.length_arm_slope(q + k * h) for k in (-1.0, 0.0, 1.0)
    )
    assert r == pytest.approx((after - before) / (2.0 * h), abs=5e-8)
    assert s == pytest.approx((r_after - r_before) / (2.0 * h), abs=5e-7)


@pytest.mark.parametrize(("linkage", "lower", "upper"), LINKAGES)
def test_arrays_go_through_like_numbers(linkage, lower, upper):
    q = np.linspace(lower, upper, 7).reshape(7, 1)
    together = linkage.length_arm_slope(q)
    for value, one in zip(np.array(together).reshape(3, 7).T, q[:, 0], strict=True):
        assert tuple(value) == pytest.approx(linkage.length_arm_slope(one), rel=1e-14, abs=1e-15)
    assert {value.shape for value in together} == {(7, 1)}


def crossing(centre1, radius1, centre2, radius2):
    """The point at given distances from two centres, on the left of the line from the first to the second."""
    line = centre2 - centre1
    distance = np.hypot(*line)
    along = (radius1**2 - radius2**2 + distance**2) / (2.0 * distance)
    left = np.array([-line[1], line[0]]) / distance
    return centre1 + along * line / distance + np.sqrt(radius1**2 - along**2) * left


@given(share=SHARE)
def test_four_bar_is_that_of_its_drawing(share):
    """Eq. (14) against pins put on paper: tilt joint at the origin, the boom's line along x."""
    k, lower, upper = part(MACHINES["forwarder"], "tilt")
    q = lower + share * (upper - lower)
    pivot = k.L22 * np.array([cos(pi - k.a21), sin(pi - k.a21)])  # of the lever, on the boom
    pin = k.L23 * np.array([cos(q + k.a22), sin(q + k.a22)])  # of the coupler, on the outer boom
    rear = pivot + k.L21 * np.array([cos(pi - k.b21), sin(pi - k.b21)])  # of the cylinder, on the boom
    lever_end = crossing(pivot, k.L25, pin, k.L24)
    assert k.length_arm_slope(q)[0] == pytest.approx(np.hypot(*(lever_end - rear)), abs=1e-12)


def test_triangle_is_the_distance_of_its_pins():
    """Eq. (13): long side down from the joint, short side on the boom, the angle between them q + q0."""
    k, _, _ = part(MACHINES["forwarder"], "lift")
    for q in (-0.4, 0.3, 1.0):
        column = k.long * np.array([cos(-k.angle), sin(-k.angle)])
        boom = k.short * np.array([cos(q), sin(q)])
        assert k.length_arm_slope(q)[0] == pytest.approx(np.hypot(*(boom - column)), rel=1e-14)
    assert k.angle == pytest.approx(pi / 2 - 0.595237, abs=1e-6)  # b11 + b12 of eq. (13)


def test_quintic_is_as_close_to_the_four_bar_as_stated():
    """0.26 mm in length, 4.8 mm in the arm near the ends: why the exact linkage is the default."""
    linkage, lower, upper = part(MACHINES["forwarder"], "tilt")
    q = np.linspace(lower, upper, 2001)
    exact, fitted = linkage.length_arm_slope(q), QUINTIC.length_arm_slope(q)
    assert np.abs(fitted[0] - exact[0]).max() == pytest.approx(0.26e-3, abs=0.01e-3)
    error = np.abs(fitted[1] - exact[1])
    assert error.max() == pytest.approx(4.8e-3, abs=0.1e-3)
    assert error.argmax() in {0, 2000}


def test_polynomials_are_written_highest_power_first():
    c, r, s = Polynomial((2.0, -3.0, 5.0, 7.0)).length_arm_slope(2.0)  # 2 q^3 - 3 q^2 + 5 q + 7
    assert (c, r, s) == (21.0, 17.0, 18.0)
