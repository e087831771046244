"""Typical total cost of a task: the scale of penalties and tolerances."""

from __future__ import annotations

import numpy as np

from leanboom.components.costs import Supply
from leanboom.formulas import hydraulics
from leanboom.model import crane as cranes
from leanboom.model.cost_rates import supply_of, terms_of
from leanboom.problem.stages import Problem


def energy_scale(problem: Problem, cost: str) -> float:
    """A typical total cost, in the cost's own unit: [J], or [m^2/s] for squared velocities."""
    crane = problem.crane
    pose = cranes.pose(crane, problem.plane, 0.5 * (problem.lower + problem.upper))
    moving = cranes.move(pose, 0.0, 0.0)
    forces = cranes.forces(pose, moving)
    duration, terms = problem.task.duration, terms_of(crane, cost)
    pressure, shaft = supply_of(crane.machine.pump, Supply.CONSTANT)
    drives, square = [*crane.drives, crane.drives[-1]], (*terms.square, terms.square[-1])
    speeds = [*moving.velocity, np.full_like(problem.time, 0.1 * problem.pace)]  # the extension moves besides
    scale = sum(weight * v * v for weight, v in zip(square, speeds, strict=True))
    flow = sum(hydraulics.cylinder_flow(v, d.area_out, d.area_in) for v, d in zip(speeds, drives, strict=True))
    if terms.work:
        work = sum(hydraulics.positive_work(v, f) for v, f in zip(moving.velocity, forces, strict=True))
        scale = scale + work + 0.05 * pressure * flow
    if terms.supply is not Supply.NONE:
        # A cost that pays back as well as it takes has gains well beyond its total.
        spread = 10.0 if min(terms.area_out + terms.area_in) < 0.0 else 1.0
        scale = scale + spread * hydraulics.pump_power(pressure, flow, *shaft)
    return float(np.mean(scale) * duration)
