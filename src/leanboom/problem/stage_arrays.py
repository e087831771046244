"""Arrays of a discretised task: all physics as polynomial coefficients over (stage, position).

Kernels see a crane only through these arrays, whose columns `layout` names. At a node, velocities, accelerations and
forces of every cylinder are exact polynomials of the redundant cylinder's motion (v affine in w; a and f quadratic in
w and affine in u), so four evaluations of `crane.move` at a pose give all coefficients. Cylinders that the path alone
moves (the base) are reduced to one flow and one pressure a stage.
"""

from __future__ import annotations

import numpy as np

from leanboom.components.costs import COSTS
from leanboom.components.pump_power import shaft_of
from leanboom.formulas import hydraulics
from leanboom.model import crane as cranes
from leanboom.problem import layout
from leanboom.problem.stages import Problem

HELD = 0.99  # planned motions hold a cylinder within this share of the velocity that counts as driven


def coefficients(problem: Problem, positions: np.ndarray) -> np.ndarray:
    """The kernels' coefficients at positions of the redundant cylinder [m], (stages + 1, any number).

    Returns:
        (stages + 1, any number, moving, layout.COEFFICIENTS).
    """
    crane = problem.crane
    pose = cranes.pose(crane, problem.plane[:, None], positions)
    still, forth, back, push = (cranes.move(pose, w, u) for w, u in ((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0)))
    moving = range(len(crane.machine.cylinders))[problem.moving]
    found = np.empty((*positions.shape, len(moving), layout.COEFFICIENTS))
    for m, i in enumerate(moving):
        out = found[:, :, m]
        out[..., layout.A0] = still.velocity[i]
        out[..., layout.A1] = forth.velocity[i] - still.velocity[i]
        for column, name in ((layout.B0, "acceleration"), (layout.F0, "load")):
            c0, c1, c2, c3 = (getattr(one, name)[i] for one in (still, forth, back, push))
            out[..., column] = c0
            out[..., column + 1] = 0.5 * (c1 - c2)
            out[..., column + 2] = 0.5 * (c1 + c2) - c0
            out[..., column + 3] = c3 - c0
        out[..., layout.COULOMB] = pose.coulomb[i]
    return found


def prescribed(problem: Problem, cost: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What the cylinders that the path alone moves add at every stage.

    With `slewing_inertia` the base force depends on the extension a little; it is taken at the middle one.

    Args:
        problem: The discretised task.
        cost: A name of `costs.COSTS`.

    Returns:
        Pump flow [m^3/s], counted pressure [Pa] and rate of the costs without pump, (stages + 1,) each.
    """
    crane = problem.crane
    zero = np.zeros(problem.stages + 1)
    if not crane.machine.geometry.slewing:
        return zero, zero, zero
    pose = cranes.pose(crane, problem.plane, 0.5 * (problem.lower + problem.upper))
    moving = cranes.move(pose, 0.0, 0.0)
    v, force, d = moving.velocity[0], cranes.forces(pose, moving)[0], crane.drives[0]
    cylinder = crane.machine.cylinders[0]
    if cost == "recuperation":
        flow = hydraulics.recuperating_flow(v, cylinder.piston_area, cylinder.rod_side_area)
    else:
        flow = hydraulics.cylinder_flow(v, d.area_out, d.area_in)
    pressure = hydraulics.counted_pressure(
        v, force, crane.machine.driven_velocity, d.gain_out, d.back_out, d.gain_in, d.back_in
    )
    rate = {"actuator": hydraulics.positive_work(v, force), "velocity": v * v}.get(cost, zero)
    return flow, pressure, rate


def cylinder_table(problem: Problem) -> np.ndarray:
    """The moving cylinders' constants, (moving, layout.CYLINDER_COLUMNS)."""
    crane = problem.crane
    rows = []
    for cylinder, d, k in zip(crane.machine.cylinders, crane.drives, cranes.sharpness(crane), strict=True):
        rows.append(
            [d.area_out, d.area_in, d.gain_out, d.back_out, d.gain_in, d.back_in, k, cylinder.friction.viscous,
             cylinder.velocity_limit, cylinder.acceleration_limit, cylinder.piston_area, cylinder.rod_side_area]
        )  # fmt: skip
    return np.array(rows)[problem.moving]


def setting(problem: Problem, cost: str, slopes: tuple[float, float, float, float]) -> np.ndarray:
    """The kernels' scalars; slopes are the penalties per violated m, m/s (state), m/s and m/s^2 (cylinders)."""
    machine = problem.crane.machine
    pump = machine.pump
    efficiency, *losses = shaft_of(pump)
    return np.array(
        [problem.step, COSTS[cost], HELD * machine.driven_velocity, pump.constant_pressure, pump.ls_margin,
         efficiency, *slopes, *losses]
    )  # fmt: skip
