"""Rigid-body dynamics of the boom, body by body: M(q) q'' + C(q, q') + G(q) of eq. (16), and friction.

| symbol | name | unit |
| --- | --- | --- |
| m, J | mass, inertia about the own centre of mass in the boom plane | kg, kg m^2 |
| x, h | centre of mass along and above its link; x includes the share k of the extension | m |
| k | share of the extension joint the body moves along with | 1 |
| R | radius of the centre of mass from the slewing axis | m |

A body on the outer boom sits at p = L1 e(q2) + x e(q2 + q3) + h n(q2 + q3), with e the direction of a link
and n its normal. Formulas: numbers, arrays or CasADi symbols in, the same out. Each returns one body's
contribution to the torques of lift, tilt and extension.
"""

from __future__ import annotations

import numpy as np

from leanboom.formulas.formula import formula


@formula
def lift_body_inertia(m, J, x, h):
    """Entry M22 of a body carried by the lift boom [kg m^2]."""
    return m * (x * x + h * h) + J


@formula
def lift_body_gravity(q2, m, x, h, g):
    """Lift torque that holds a body carried by the lift boom [N m]."""
    return m * g * (x * np.cos(q2) - h * np.sin(q2))


@formula
def outer_body_inertia(q3, m, J, x, h, k, L1):
    """Inertia entries of a body carried by the outer boom: M22, M23, M24, M33, M34, M44."""
    s3 = np.sin(q3)
    c3 = np.cos(q3)
    own = x * x + h * h
    cross = L1 * (x * c3 - h * s3)
    m22 = m * (L1 * L1 + own + 2.0 * cross) + J
    m23 = m * (own + cross) + J
    m24 = m * k * (L1 * s3 - h)
    m33 = m * own + J + 0.0 * s3
    m34 = -m * k * h + 0.0 * s3
    m44 = m * k * k + 0.0 * s3
    return m22, m23, m24, m33, m34, m44


@formula
def outer_body_gravity(q2, q3, m, x, h, k, L1, g):
    """Torques of lift, tilt [N m] and force of the extension [N] that hold a body of the outer boom."""
    s23 = np.sin(q2 + q3)
    c23 = np.cos(q2 + q3)
    tilt = m * g * (x * c23 - h * s23)
    return tilt + m * g * L1 * np.cos(q2), tilt, m * g * k * s23


@formula
def lift_body_centrifugal(q2, m, J, x, h, ox, v1):
    """Lift torque from slewing at v1 of a body carried by the lift boom (slender rod along the boom) [N m]."""
    s2 = np.sin(q2)
    c2 = np.cos(q2)
    radius = ox + x * c2 - h * s2
    return (m * radius * (x * s2 + h * c2) + J * s2 * c2) * v1 * v1


@formula
def outer_body_bias(q2, q3, x, h, k, L1, ox, v1, v2, v3, v4):
    """Radial and vertical acceleration of a point of the outer boom without joint accelerations [m/s^2]."""
    s23 = np.sin(q2 + q3)
    c23 = np.cos(q2 + q3)
    v23 = v2 + v3
    xv = k * v4
    radius = ox + L1 * np.cos(q2) + x * c23 - h * s23
    radial = -L1 * np.cos(q2) * v2 * v2 + (h * s23 - x * c23) * v23 * v23 - 2.0 * s23 * v23 * xv - radius * v1 * v1
    vertical = -L1 * np.sin(q2) * v2 * v2 - (h * c23 + x * s23) * v23 * v23 + 2.0 * c23 * v23 * xv
    return radial, vertical


@formula
def outer_body_torques(q2, q3, m, x, h, k, L1, radial, vertical):
    """Torques of lift, tilt [N m] and force of the extension [N] that accelerate a body of the outer boom."""
    s23 = np.sin(q2 + q3)
    c23 = np.cos(q2 + q3)
    r3 = -x * s23 - h * c23
    z3 = x * c23 - h * s23
    lift = m * ((r3 - L1 * np.sin(q2)) * radial + (z3 + L1 * np.cos(q2)) * vertical)
    tilt = m * (r3 * radial + z3 * vertical)
    return lift, tilt, m * k * (c23 * radial + s23 * vertical)


@formula
def rod_centrifugal(angle, J, v1):
    """Torque that holds a slender rod, turned up by an angle and slewing at v1, at that angle [N m]."""
    return J * np.sin(angle) * np.cos(angle) * v1 * v1


@formula
def slewing_inertia(radius, m, J, angle):
    """Entry M11 of a body at a radius, its slender-rod inertia J turned up by an angle [kg m^2]."""
    c = np.cos(angle)
    return m * radius * radius + J * c * c


@formula
def slewing_inertia_rate(radius, radius_rate, m, J, angle, angle_rate):
    """Time derivative of `slewing_inertia` [kg m^2/s]."""
    return 2.0 * m * radius * radius_rate - 2.0 * J * np.sin(angle) * np.cos(angle) * angle_rate


@formula
def heaviside(x):
    """Heaviside step with value 1/2 at zero, eq. (38)."""
    return 0.5 * (1.0 + np.sign(x))


@formula
def stepped_coulomb(q, f1, f2, f3, f4):
    """Coulomb friction of the extension relative to F_c4: 1 plus two ramps of slope 1/m. Eqs. (A3)-(A4)."""
    h1 = heaviside(q - f1) + heaviside(f2 - q) - 1.0
    h2 = heaviside(q - f2)
    h3 = heaviside(q - f3) + heaviside(f4 - q) - 1.0
    h4 = heaviside(q - f4)
    return 1.0 + h1 * (q - f1) + h2 * (f2 - f1) + h3 * (q - f3) + h4 * (f4 - f3)


@formula
def friction(v, coulomb, sharpness, viscous):
    """Friction force of a cylinder at velocity v [N]: smooth Coulomb plus viscous, eq. (A3)."""
    return coulomb * np.tanh(sharpness * v) + viscous * v
