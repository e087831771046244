"""A typical total cost of a task: what penalties and tolerances are relative to."""

from __future__ import annotations

import numpy as np

from leanboom.components.pump_power import shaft_of
from leanboom.formulas import hydraulics
from leanboom.model import crane as cranes
from leanboom.problem.stages import Problem


def energy_scale(problem: Problem, cost: str) -> float:
    """A typical total cost, in the cost's own unit: [J], or [m^2/s] for squared velocities."""
    crane = problem.crane
    pose = cranes.pose(crane, problem.plane, 0.5 * (problem.lower + problem.upper))
    moving = cranes.move(pose, 0.0, 0.0)
    forces = cranes.forces(pose, moving)
    duration = problem.task.duration
    speed = 0.1 * problem.pace
    if cost in ("velocity", "extension"):
        square = sum(v * v for v in moving.velocity) if cost == "velocity" else 0.0
        return float(np.mean(square + speed**2) * duration)
    drives = [*crane.drives, crane.drives[-1]]
    speeds = [*moving.velocity, np.full_like(problem.time, speed)]
    flow = sum(hydraulics.cylinder_flow(v, d.area_out, d.area_in) for v, d in zip(speeds, drives, strict=True))
    if cost == "actuator":
        work = sum(hydraulics.positive_work(v, f) for v, f in zip(moving.velocity, forces, strict=True))
        return float(np.mean(work + 0.05 * crane.machine.pump.constant_pressure * flow) * duration)
    # Recuperation pays back as well as it takes: its gains reach well beyond its total.
    spread = 10.0 if cost == "recuperation" else 1.0
    pressure, shaft = crane.machine.pump.constant_pressure, shaft_of(crane.machine.pump)
    return float(spread * np.mean(hydraulics.pump_power(pressure, flow, *shaft)) * duration)
