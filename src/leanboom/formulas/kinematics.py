"""Kinematics of the boom in its own vertical plane, and of the slewing base above it.

| symbol | name | unit | equation |
| --- | --- | --- | --- |
| r, z | tool radius from the slewing axis, tool height | m | (4)-(6), 4-DOF; (5)-(6), 3-DOF |
| q2, q3, q4 | lift, tilt, extension joint | rad, rad, m | (1) |
| ox, oz | base offsets (o_x, o_y of the papers) | m | Table 2 |
| L1, L2, L3 | boom, offset, outer boom | m | Table 2 |
| e, d | tilt joint to tool; lift joint to tool | m | |

All functions are formulas: numbers, arrays or CasADi symbols in, the same out.
"""

from __future__ import annotations

import numpy as np

from leanboom.formulas.formula import formula

ELBOW_MARGIN = 3.0 * np.pi / 180.0  # [rad]: an arm is never bent by less than this, nor folded up closer than this
BENT = np.cos(ELBOW_MARGIN)  # largest |cosine| of the angle at the tilt joint
ELBOW_UP, ELBOW_DOWN = -1.0, 1.0  # sides to which the outer boom folds: down and up


@formula
def tool_point(q2, q3, q4, ox, oz, L1, L2, L3):
    """Tool radius and height [m]. Eqs. (4)-(5), 4-DOF paper; with L2 = 0 eqs. (5)-(6), 3-DOF paper."""
    q23 = q2 + q3
    r = ox + L1 * np.cos(q2) - L2 * np.sin(q23) + (L3 + q4) * np.cos(q23)
    z = oz + L1 * np.sin(q2) + L2 * np.cos(q23) + (L3 + q4) * np.sin(q23)
    return r, z


@formula
def elbow_cosine(r, z, q4, ox, oz, L1, L2, L3):
    """Cosine of the angle at the tilt joint between boom and tool; outside [-1, 1] the tool is unreachable."""
    e2 = L2 * L2 + (L3 + q4) * (L3 + q4)
    d2 = (r - ox) * (r - ox) + (z - oz) * (z - oz)
    return (L1 * L1 + e2 - d2) / (2.0 * L1 * np.sqrt(e2))


@formula
def lift_and_tilt(r, z, q4, ox, oz, L1, L2, L3, side=ELBOW_UP, bent=BENT):
    """Lift and tilt angle [rad] that put the tool at (r, z) with extension q4: the h2, h3 of eq. (33).

    On one side of the straight arm, `ELBOW_UP` (outer boom folded down, as on both papers' machines) or `ELBOW_DOWN`.
    A straight or folded arm has no inverse, so none is bent by less than `ELBOW_MARGIN`: where that does not reach the
    tool, the pose is returned that comes nearest to it on the line from the lift joint. `bent` is the margin's cosine.
    """
    cosine = np.maximum(-bent, np.minimum(bent, elbow_cosine(r, z, q4, ox, oz, L1, L2, L3)))
    fold = side * (np.pi - np.arccos(cosine))  # angle of the tool line against the boom line
    e = np.hypot(L3 + q4, L2)
    q3 = fold - np.arctan2(L2, L3 + q4)
    q2 = np.arctan2(z - oz, r - ox) - np.arctan2(e * np.sin(fold), L1 + e * np.cos(fold))
    return q2, q3


@formula
def jacobian(q2, q3, q4, L1, L2, L3):
    """Partial derivatives of tool radius and height by lift, tilt and extension: eq. (7) in the boom plane.

    Returns:
        r2, r3, r4, z2, z3, z4: dr/dq2, dr/dq3, dr/dq4, dz/dq2, dz/dq3, dz/dq4.
    """
    s23 = np.sin(q2 + q3)
    c23 = np.cos(q2 + q3)
    r3 = -L2 * c23 - (L3 + q4) * s23
    z3 = -L2 * s23 + (L3 + q4) * c23
    return r3 - L1 * np.sin(q2), r3, c23, z3 + L1 * np.cos(q2), z3, s23


@formula
def velocity_product(q2, q3, q4, v2, v3, v4, L1, L2, L3):
    """The part J' q' of the tool acceleration, eqs. (8)-(9), in the boom plane: (radial, vertical)."""
    v23 = v2 + v3
    s23 = np.sin(q2 + q3)
    c23 = np.cos(q2 + q3)
    x = L3 + q4
    radial = -L1 * np.cos(q2) * v2 * v2 + (L2 * s23 - x * c23) * v23 * v23 - 2.0 * s23 * v23 * v4
    vertical = -L1 * np.sin(q2) * v2 * v2 - (L2 * c23 + x * s23) * v23 * v23 + 2.0 * c23 * v23 * v4
    return radial, vertical


@formula
def solve_plane(a, b, c, d, right1, right2):
    """Solution of [[a, b], [c, d]] x = right: the inverse in eqs. (34) and (35)."""
    determinant = a * d - b * c
    return (right1 * d - b * right2) / determinant, (a * right2 - c * right1) / determinant


@formula
def cylindrical(x, y, vx, vy, ax, ay):
    """Radius, its two rates, slewing rate and slewing acceleration of a tool moving in the plane z = 0.

    Returns:
        r [m], r' [m/s], r'' [m/s^2], q1' [rad/s], q1'' [rad/s^2].
    """
    r = np.hypot(x, y)
    c = x / r
    s = y / r
    vr = c * vx + s * vy
    q1v = (c * vy - s * vx) / r
    ar = c * ax + s * ay + r * q1v * q1v
    q1a = (c * ay - s * ax - 2.0 * vr * q1v) / r
    return r, vr, ar, q1v, q1a
