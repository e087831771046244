r"""Readings of the weighted pseudo-inverse of the 3-DOF paper, as rules for `pseudo_inverse.resolve`.

The text weighs the cylinders' velocities with the diagonal matrix A_ii = A_A H(v_i) + A_B H(-v_i), the area of the
chamber that is filled, and minimises v'Av. That is `sns-actuator-weighted`, and it does not give the printed values.
Other readings replace the weight, the velocities it stands at, or its sign.

| symbol | name | unit |
| --- | --- | --- |
| A_A, A_B | areas of the piston side and of the rod side | m^2 |
| v, q' | velocities of cylinders and of joints, affine in w | m/s; rad/s and m/s |
| w | velocity of the redundant cylinder | m/s |

`signed` is A_A H(v_i) - A_B H(-v_i), the bracket of the paper's eq. (27), which the paper calls the discontinuous
cylinder area: a retracting cylinder gets a negative weight. v'Av has no least value then; eq. (9) gives the point where
its slope is zero, as it always does. Where the weights nearly cancel, the limits of the velocities decide.
"""

from __future__ import annotations

import numpy as np

from leanboom.methods.pseudo_inverse import Line, Rule

SIGNED = "sns-actuator-signed"  # names the reading in jobs; no method of the planner


def flat(line: Line, weights: np.ndarray, joints: bool = False) -> float:
    """Velocity of the redundant cylinder where a weighted norm has no slope [m/s].

    Args:
        line: Velocities on the path at one point.
        weights: Of the squared velocities, (joints,).
        joints: Whether they weigh joint velocities.
    """
    at, along = (line.joint0, line.joint1) if joints else (line.cylinder0, line.cylinder1)
    curvature = float((weights * along) @ along)
    return float(-((weights * at) @ along)) / curvature if curvature else 0.0


def power(exponent: float, *, joints: bool = False, exchanged: bool = False) -> Rule:
    """The rule of weights A^exponent, with directions of the unweighted answer.

    Args:
        exponent: Of the areas; -1 for A in place of its inverse in eq. (9).
        joints: Whether joint velocities are weighed.
        exchanged: Whether A_A and A_B change places.
    """

    def rule(line: Line, area_out: np.ndarray, area_in: np.ndarray) -> float:
        one, other = (area_in, area_out) if exchanged else (area_out, area_in)
        return flat(line, np.where(_extends(line, joints), one, other) ** exponent, joints)

    return rule


def signed(*, joints: bool = False) -> Rule:
    """The rule of weights A_A H(v) - A_B H(-v), with directions of the unweighted answer.

    Args:
        joints: Whether joint velocities are weighed.
    """

    def rule(line: Line, area_out: np.ndarray, area_in: np.ndarray) -> float:
        return flat(line, np.where(_extends(line, joints), area_out, -area_in), joints)

    return rule


def _extends(line: Line, joints: bool) -> np.ndarray:
    """Which cylinders extend in the unweighted answer, (joints,)."""
    free = flat(line, np.ones(line.cylinder0.size), joints)
    return line.cylinder0 + line.cylinder1 * free > 0.0


READINGS: dict[str, Rule] = {
    "A, directions of the unweighted solution": power(1.0),
    "A with A_A and A_B exchanged": power(1.0, exchanged=True),
    "A^2": power(2.0),
    "A^-1 (A in place of W^-1 in eq. (9))": power(-1.0),
    "A^-2": power(-2.0),
    "A on joint velocities, q'Aq": power(1.0, joints=True),
    "A^-1 on joint velocities": power(-1.0, joints=True),
    "A_A H(v) - A_B H(-v), the bracket of eq. (27)": signed(),
    "the same on joint velocities": signed(joints=True),
}
