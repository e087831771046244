"""Arrays of a discretised task: all physics as polynomial coefficients over (stage, position).

Kernels see a crane only through these arrays, whose columns `layout` names. At a node, velocities, accelerations and
forces of every cylinder are exact polynomials of the redundant cylinder's motion (v affine in w; a and f quadratic in
w and affine in u), so four evaluations of `crane.move` at a pose give all coefficients. Cylinders that the path alone
moves (the base) are reduced to one flow and one pressure a stage.
"""

from __future__ import annotations

import numpy as np

from leanboom.components.costs import Supply
from leanboom.formulas import hydraulics
from leanboom.model import crane as cranes
from leanboom.model.cost_rates import demanded_pressure, supply_of, terms_of
from leanboom.model.pump_flow import base_flow
from leanboom.problem import layout
from leanboom.problem.stages import Problem

AT_REST = 0.99  # in plans a cylinder no faster than this share of the threshold `driven_velocity` is at rest


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


def path_determined(problem: Problem, cost: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What the cylinders that the path alone moves add at every stage.

    With `slewing_inertia` the base force depends on the extension a little; it is taken at the middle one.

    Args:
        problem: The discretised task.
        cost: A name of `costs.COSTS`.

    Returns:
        Pump flow [m^3/s], demanded pressure [Pa] and rate of the terms without pump, (stages + 1,) each.
    """
    crane = problem.crane
    zero = np.zeros(problem.stages + 1)
    if not crane.machine.geometry.slewing:
        return zero, zero, zero
    pose = cranes.pose(crane, problem.plane, 0.5 * (problem.lower + problem.upper))
    moving = cranes.move(pose, 0.0, 0.0)
    v, force = moving.velocity[0], cranes.forces(pose, moving)[0]
    terms = terms_of(crane, cost)
    flow = hydraulics.cylinder_flow(v, terms.area_out[0], terms.area_in[0])
    pressure = demanded_pressure(crane, 0, v, force)
    rate = terms.square[0] * v * v
    return flow, pressure, rate + hydraulics.positive_work(v, force) if terms.work else rate


def cylinder_table(problem: Problem, cost: str) -> np.ndarray:
    """The moving cylinders' constants, (moving, layout.CYLINDER_COLUMNS)."""
    crane = problem.crane
    terms = terms_of(crane, cost)
    rows = [
        [terms.area_out[i], terms.area_in[i], d.gain_out, d.back_out, d.gain_in, d.back_in, k,
         cylinder.friction.viscous, cylinder.velocity_limit, cylinder.acceleration_limit, terms.square[i],
         d.area_out, d.area_in]
        for i, (cylinder, d, k) in enumerate(
            zip(crane.machine.cylinders, crane.drives, cranes.sharpness(crane), strict=True)
        )
    ]  # fmt: skip
    return np.array(rows)[problem.moving]


def threshold(problem: Problem, share: float = AT_REST) -> float:
    """Velocity up to which a planned cylinder is at rest [m/s]: a share of the machine's threshold, eq. (41)."""
    return share * problem.crane.machine.driven_velocity


def most_flow(problem: Problem) -> np.ndarray:
    """What the pump gives at most, less what the path alone takes, at every stage [m^3/s], (stages + 1,)."""
    machine = problem.crane.machine
    return machine.pump.max_flow - base_flow(machine, problem.plane)


def setting(
    problem: Problem, cost: str, slopes: tuple[float, float, float, float, float], share: float = AT_REST
) -> np.ndarray:
    """The kernels' scalars.

    Args:
        problem: The discretised task.
        cost: A name of `costs.COSTS`.
        slopes: Penalties per violated m, m/s (state), m/s and m/s^2 (cylinders), m^3/s (pump flow).
        share: Share of the threshold `driven_velocity` up to which a cylinder is at rest.
    """
    machine, terms = problem.crane.machine, terms_of(problem.crane, cost)
    supply, (efficiency, *losses) = supply_of(machine.pump, terms.supply)
    *state, flow = slopes
    return np.array(
        [problem.step, terms.supply is Supply.LOAD_SENSING, terms.work, threshold(problem, share), supply,
         efficiency, *state, *losses, flow]
    )  # fmt: skip
