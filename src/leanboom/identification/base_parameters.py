"""What cylinder forces can tell of the bodies: sums of moments of mass over them, and how well a motion tells them.

Forces are linear in moments of mass: for each body m, m x, m h, m x^2, m h^2, m x h and J. Their columns are the
model's own formulas at bodies of unit mass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leanboom.model import crane as cranes
from leanboom.model.crane import Crane
from leanboom.model.machine import Body, Machine

MOMENTS = (
    (0.0, 0.0, 0.0),
    (1.0, 0.0, 0.0),
    (-1.0, 0.0, 0.0),
    (0.0, 1.0, 0.0),
    (0.0, -1.0, 0.0),
    (1.0, 1.0, 0.0),
    (0.0, 0.0, 1.0),
)

BASE = {  # what each base parameter is, and which motion tells it
    "gravity.lift.along": ("kg m", "move the lift over its range at both ends of the extension"),
    "gravity.lift.above": ("kg m", "move the lift over its whole range, low and high"),
    "gravity.tilt.along": ("kg m", "move the tilt over its whole range"),
    "gravity.tilt.above": ("kg m", "move the tilt until the outer boom hangs and stands out"),
    "gravity.extension.mass": ("kg", "move the extension with the outer boom steep and level"),
    "inertia.lift": ("kg m^2", "start and stop the lift quickly, extension in and out"),
    "inertia.tilt": ("kg m^2", "start and stop the tilt quickly"),
    "inertia.extension.along": ("kg m", "start and stop the tilt quickly at several extensions"),
    "inertia.extension.above": ("kg m", "start and stop extension and tilt together"),
    "inertia.extension.mass": ("kg", "start and stop the extension quickly"),
}


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Joints in motion, base first; arrays are (samples,)."""

    q: tuple[np.ndarray, ...]
    v: tuple[np.ndarray, ...]
    a: tuple[np.ndarray, ...]


def moment_columns(machine: Machine, bodies: Sequence[Body], motion: Motion) -> list[np.ndarray]:
    """For each cylinder the force of every moment of mass, (samples, 7 x bodies), moments of a body beside each other.

    Args:
        machine: The machine.
        bodies: Whose carrier and share of the extension count.
        motion: The motion.
    """
    slewing = machine.geometry.slewing
    boom = motion.q[-3:]
    v = motion.v if slewing else (0.0 * motion.v[0], *motion.v)
    a2, a3, a4 = motion.a[-3:]
    arms = [c.linkage.length_arm_slope(q)[1] for c, q in zip(machine.cylinders, motion.q, strict=True)]
    result: list[list[np.ndarray]] = [[] for _ in machine.cylinders]
    for body in bodies:
        values = []
        for x, h, inertia in MOMENTS:
            mass = 0.0 if inertia else 1.0
            unit = _unit(body, mass, x, h, inertia)
            crane = Crane(machine, (unit,), ())
            m, g = cranes.inertia_and_gravity(crane, *boom)
            swing = cranes.velocity_torques(crane, tuple(boom), tuple(v))
            torque = [
                m[0] * a2 + m[1] * a3 + m[2] * a4 + g[0] + swing[0],
                m[1] * a2 + m[3] * a3 + m[4] * a4 + g[1] + swing[1],
                m[2] * a2 + m[4] * a3 + m[5] * a4 + g[2] + swing[2],
            ]
            if slewing:
                turning, change = cranes.slewing(crane, tuple(boom), tuple(motion.v[-3:]))
                torque.insert(0, turning * motion.a[0] + change * motion.v[0])
            values.append([t / arm + 0.0 * arm for t, arm in zip(torque, arms, strict=True)])
        for i, columns in enumerate(result):
            f0, f1, f2, f3, f4, f5, f6 = (value[i] for value in values)
            mx, mh = 0.5 * (f1 - f2), 0.5 * (f3 - f4)
            mxx, mhh = 0.5 * (f1 + f2) - f0, 0.5 * (f3 + f4) - f0
            columns += [f0, mx, mh, mxx, mhh, f5 - f0 - mx - mh - mxx - mhh, f6]
    return [np.stack(columns, axis=1) for columns in result]


def _unit(body: Body, mass: float, x: float, h: float, inertia: float) -> Body:
    """A body of unit moments; one of inertia alone has a mass too small to count."""
    return replace(body, mass=mass or 1e-12, along=x, above=h, inertia=inertia)


def moments(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Moments of bodies from mass, along, above and inertia, (7 x bodies,), and their derivatives.

    Args:
        values: Four a body, (4 x bodies,).
    """
    n = values.size // 4
    found, slopes = np.zeros(7 * n), np.zeros((7 * n, 4 * n))
    for i in range(n):
        m, x, h, inertia = values[4 * i : 4 * i + 4]
        rows, columns = slice(7 * i, 7 * i + 7), slice(4 * i, 4 * i + 4)
        found[rows] = [m, m * x, m * h, m * x * x, m * h * h, m * x * h, inertia]
        slopes[rows, columns] = np.array([
            [1.0, x, h, x * x, h * h, x * h, 0.0],
            [0.0, m, 0.0, 2.0 * m * x, 0.0, m * h, 0.0],
            [0.0, 0.0, m, 0.0, 2.0 * m * h, m * x, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        ]).T  # fmt: skip
    return found, slopes


def base_map(machine: Machine, bodies: Sequence[Body]) -> np.ndarray:
    """Base parameters as sums of moments, (parameters, 7 x bodies), in the order of `BASE`.

    Args:
        machine: The machine.
        bodies: Its bodies.
    """
    boom = machine.geometry.boom
    rows = np.zeros((len(BASE), 7 * len(bodies)))
    for i, body in enumerate(bodies):
        m, mx, mh, mxx, mhh, _, inertia = range(7 * i, 7 * i + 7)
        second = [mxx, mhh, inertia]
        if body.carrier == "lift":
            rows[0, mx] = rows[1, mh] = 1.0
            rows[5, second] = 1.0
        elif body.carrier == "tilt":
            k = body.extension_share
            rows[0, m], rows[5, m] = boom, boom * boom
            rows[2, mx] = rows[3, mh] = 1.0
            rows[6, second] = 1.0
            rows[4, m], rows[7, mx], rows[8, mh], rows[9, m] = k, k, k, k * k
    return rows


def condition(columns: Sequence[np.ndarray], machine: Machine, bodies: Sequence[Body]) -> tuple[int, float]:
    """Rank and condition number of the forces' dependence on the base parameters, each scaled by its size.

    Args:
        columns: `moment_columns`.
        machine: The machine.
        bodies: The bodies of the columns.
    """
    base = base_map(machine, bodies)
    values = np.array([v for b in bodies for v in (b.mass, b.along, b.above, b.inertia)])
    size = np.abs(base) @ np.abs(moments(values)[0])
    told = size > 0.0
    stacked = np.concatenate([block for block in columns[-3:] if block.size])
    found = np.linalg.svd((stacked @ np.linalg.pinv(base))[:, told] * size[told], compute_uv=False)
    return int((found > 1e-6 * found[0]).sum()), float(found[0] / max(found[-1], 1e-15 * found[0]))
