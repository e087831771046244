"""The best known motion of a discretised problem: the upper bound beside a certificate.

The energy of a motion in the discretised problem is the sum over the stages of step x power at the stage's start, as
the dynamic program adds it up. The planner's motion is the best by the judge, who integrates every 2 ms; tubes around
it, as the planner's own, look for a better sum. A motion that breaks a limit at the start of a stage, as one of other
stages may, is polished there, which keeps all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leanboom.dynamic_programming import grids, value_function
from leanboom.evaluation.evaluate import PATH_TOLERANCE, TOLERANCE
from leanboom.fixed_mode import modes
from leanboom.fixed_mode.modes import Polisher
from leanboom.model import cost_rates
from leanboom.model import crane as cranes
from leanboom.model import motion as motions
from leanboom.model.motion import Motion
from leanboom.model.pump_flow import pump_flow
from leanboom.problem import feasible_strokes, stage_arrays, starts
from leanboom.problem.stages import Problem

TUBE = (41, 33)  # nodes of a tube
HALF_WIDTH, HALF_HEIGHT = 0.03, 0.06  # half widths of the first tube: share of the stroke range, of the velocity limit
LEVELS, REPEATS = 8, 3  # tubes are halved, and repeated while they gain


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """A motion, its energies at the stages, and whether it keeps the limits there."""

    motion: Motion
    costs: np.ndarray  # energy of every stage [J], (stages,)
    keeps_limits: bool  # at every stage, within the judge's tolerances

    @property
    def energy(self) -> float:
        """Sum of the stages' energies [J]."""
        return float(self.costs.sum())


def joined(parts: Sequence[Measured]) -> Measured:
    """Motions of legs, one after the other, as one on all their stages."""
    motion = motions.joined([part.motion for part in parts])
    return Measured(motion, np.concatenate([part.costs for part in parts]), all(part.keeps_limits for part in parts))


def measure(problem: Problem, candidate: Motion, pump: str) -> Measured:
    """Energy of a motion on a problem's stages, and whether it keeps their limits.

    Args:
        problem: The discretised task.
        candidate: A motion on its stages.
        pump: "ls" or "cp".
    """
    crane, machine = problem.crane, problem.crane.machine
    pose = cranes.pose(crane, problem.plane[:-1], candidate.position[:-1])
    moving = cranes.move(pose, candidate.velocity[:-1], candidate.acceleration)
    force = cranes.forces(pose, moving)
    others = [part[:-1] for part in stage_arrays.path_determined(problem, pump)]
    power = cost_rates.rate(crane, pump, moving.velocity[problem.moving], force[problem.moving], others)
    used = max(np.max(problem.lower - candidate.position), np.max(candidate.position - problem.upper)) / PATH_TOLERANCE
    used = max(used, abs(candidate.velocity[-1]) / PATH_TOLERANCE)
    end = starts.end_position(problem, float(candidate.position[0]))
    used = used if end is None else max(used, abs(candidate.position[-1] - end) / PATH_TOLERANCE)
    for i in range(len(machine.cylinders))[problem.moving]:
        cylinder = machine.cylinders[i]
        used = max(used, np.max(np.abs(moving.velocity[i])) / cylinder.velocity_limit / TOLERANCE)
        used = max(used, np.max(np.abs(moving.acceleration[i])) / cylinder.acceleration_limit / TOLERANCE)
    used = max(used, np.max(pump_flow(crane.drives, moving.velocity)) / problem.task.flow_limit / TOLERANCE)
    return Measured(candidate, problem.step * power, used <= 1.0)


def improve(problem: Problem, seed: Measured, pump: str, free: bool) -> Measured:
    """The motion of least energy found in ever narrower tubes around a motion.

    Args:
        problem: The discretised task.
        seed: The motion to begin with.
        pump: "ls" or "cp".
        free: Whether the start may move.

    Returns:
        The best motion found that keeps the limits; the seed where there is none.
    """
    polisher = modes.build(problem, pump)
    low, high = feasible_strokes.stroke_range(problem.task)
    limit = problem.crane.machine.redundant.velocity_limit
    best = _keeping(polisher, seed, free)
    for level in range(LEVELS):
        for _ in range(REPEATS):
            share = 0.5**level
            at = best.motion
            width, spread = share * HALF_WIDTH * (high - low), share * HALF_HEIGHT * 2.0 * limit
            end = starts.end_position(problem, float(at.position[0]))
            tube = grids.tube_grid(problem, at.position, at.velocity, width, spread, *TUBE)
            policy = value_function.solve(problem, tube, pump, end=end)
            start = value_function.best_start(policy) if free else float(at.position[0])
            found = measure(problem, value_function.rollout(policy, start), pump)
            if best.keeps_limits and found.energy >= best.energy:
                break
            found = _keeping(polisher, found, free)
            if not found.keeps_limits or (best.keeps_limits and found.energy >= best.energy):
                break
            best = found
    return best


def _keeping(polisher: Polisher, found: Measured, free: bool) -> Measured:
    """A motion that keeps the limits, polished where it did not; itself where none is found."""
    if found.keeps_limits:
        return found
    with np.errstate(all="ignore"):  # a motion out of reach has no numbers there
        switches = modes.modes(polisher, found.motion)
        polished, _ = modes.solve(polisher, found.motion, switches, free)
    return found if polished is None else measure(polisher.problem, polished, polisher.cost)
