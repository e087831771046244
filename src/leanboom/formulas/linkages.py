"""Linkages between cylinder and joint: length, torque arm and its slope, eqs. (10)-(15), 4-DOF; eq. (30), 3-DOF paper.

| symbol | name | unit |
| --- | --- | --- |
| c | cylinder length | m |
| r = dc/dq | torque arm, signed | m/rad (m/m for the extension) |
| s = dr/dq | slope of the arm, for eq. (12) | m/rad^2 |

Formulas: numbers, arrays or CasADi symbols in, the same out. Each returns (c, r, s).
"""

from __future__ import annotations

import numpy as np

from leanboom.formulas.formula import formula


@formula
def triangle(q, a, b, q0):
    """Cylinder spanning a joint between pins at distances a and b. Eq. (13); eq. (30) with lengths squared."""
    sine = np.sin(q + q0)
    cosine = np.cos(q + q0)
    c = np.sqrt(a * a + b * b - 2.0 * a * b * cosine)
    r = a * b * sine / c
    return c, r, (a * b * cosine - r * r) / c


@formula
def four_bar(q, L21, L22, L23, L24, L25, a21, a22, b21):
    """Cylinder driving the tilt joint through lever L25 and coupler L24, eq. (14), with exact derivatives."""
    a23 = np.pi + q + a21 + a22
    sine = np.sin(a23)
    cosine = np.cos(a23)
    # L26: lever pivot to coupler pin.
    L26 = np.sqrt(L22 * L22 + L23 * L23 - 2.0 * L22 * L23 * cosine)
    dL26 = L22 * L23 * sine / L26
    ddL26 = (L22 * L23 * cosine - dL26 * dL26) / L26
    # b23 = asin(L23 / L26 sin a23): its derivatives follow from those of its sine.
    b23 = np.arcsin(L23 * sine / L26)
    cos23 = (L26 * L26 + L22 * L22 - L23 * L23) / (2.0 * L22 * L26)  # law of cosines for the same angle
    dsin = L23 * (cosine / L26 - sine * dL26 / (L26 * L26))
    ddsin = L23 * (
        -sine / L26
        - 2.0 * cosine * dL26 / (L26 * L26)
        - sine * (ddL26 / (L26 * L26) - 2.0 * dL26 * dL26 / (L26 * L26 * L26))
    )
    db23 = dsin / cos23
    ddb23 = (ddsin + np.sin(b23) * dsin * dsin / (cos23 * cos23)) / cos23
    # b24 = acos((L25^2 + L26^2 - L24^2) / (2 L25 L26)): angle between lever and L26.
    k = L25 * L25 - L24 * L24
    u = (k + L26 * L26) / (2.0 * L25 * L26)
    du = (1.0 - k / (L26 * L26)) / (2.0 * L25)  # by L26
    ddu = k / (L25 * L26 * L26 * L26)
    root = np.sqrt(1.0 - u * u)
    b24 = np.arccos(u)
    db24 = -du / root  # by L26
    ddb24 = -ddu / root - u * du * du / (root * root * root)
    b22 = np.pi - b21 - b24 + b23 + a21
    db22 = -db24 * dL26 + db23
    ddb22 = -ddb24 * dL26 * dL26 - db24 * ddL26 + ddb23
    c = np.sqrt(L21 * L21 + L25 * L25 - 2.0 * L21 * L25 * np.cos(b22))
    arm = L21 * L25 * np.sin(b22) / c  # dc / db22
    slope = (L21 * L25 * np.cos(b22) - arm * arm) / c
    return c, arm * db22, slope * db22 * db22 + arm * ddb22
