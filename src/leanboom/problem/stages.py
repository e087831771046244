"""The discretised problem: a task cut into equal stages, with the feasible extensions of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from leanboom.errors import InputError
from leanboom.model import crane as cranes
from leanboom.model import motion
from leanboom.model.motion import Motion
from leanboom.model.task import Task, sample, take_single
from leanboom.problem.feasible_strokes import feasible_strokes

SLOW = 1e-3  # share of the velocity limit that is always looked at
BRISK = 6.0  # motions may need this many times the velocity that covers all feasible extensions once, evenly


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """A task discretised in time: the crane, its reference at the stages, its feasible extensions."""

    task: Task
    crane: cranes.Crane
    step: float  # Ts [s]
    time: np.ndarray  # [s], (stages + 1,)
    plane: cranes.Plane  # reference at the stages
    lower: np.ndarray  # smallest feasible stroke of the redundant cylinder [m], (stages + 1,)
    upper: np.ndarray  # largest [m], (stages + 1,)
    intervals: tuple[np.ndarray, ...]  # feasible strokes of each stage [m], (intervals, 2) each

    @property
    def stages(self) -> int:
        """Number of stages."""
        return self.time.size - 1

    @property
    def pace(self) -> float:
        """Velocity scale of the redundant cylinder [m/s]: its limit, or less where the path leaves time for less."""
        even = float(self.upper.max() - self.lower.min()) / self.task.duration
        limit = self.crane.machine.redundant.velocity_limit
        return min(limit, max(BRISK * even, SLOW * limit))

    @property
    def moving(self) -> slice:
        """The cylinders whose motion depends on the redundancy: all but a base."""
        return slice(1, None) if self.crane.machine.geometry.slewing else slice(0, None)


def count(duration: float, step: float) -> int:
    """Number of equal stages of about `step` [s] in a duration [s]."""
    return max(2, int(np.ceil(duration / step - 1e-9)))


def discretise(task: Task, step: float) -> Problem:
    """Cut a task into equal stages of about `step` [s] and find the feasible extensions of each.

    Raises:
        InfeasibleError: If the tool cannot be at its point at some stage, whatever the extension.
        InputError: If the task has legs, or its timing is still to be planned.
    """
    take_single(task, "a dynamic program")
    if task.timing != "fixed":
        raise InputError(
            f"timing = {task.timing}; the speed along the path must be planned first: use the task of the plan, "
            "plan = leanboom.run(task), plan.task"
        )
    time = np.linspace(0.0, task.duration, count(task.duration, step) + 1)
    crane = cranes.build(task)
    plane = cranes.plane(task.machine, sample(task, time))
    intervals = feasible_strokes(task, crane, plane, time)
    lower = np.array([stage[0, 0] for stage in intervals])
    upper = np.array([stage[-1, 1] for stage in intervals])
    return Problem(task, crane, task.duration / (time.size - 1), time, plane, lower, upper, intervals)


def on_stages(problem: Problem, seed: Motion) -> Motion:
    """A motion on a problem's stages: itself, or one with its velocities there, ending at rest."""
    if seed.acceleration.size == problem.stages and seed.times is None:
        return seed
    _, velocity, _ = seed.at(problem.time)
    velocity = velocity.copy()
    velocity[-1] = 0.0
    return motion.from_velocities(problem.step, float(seed.position[0]), velocity, seed.method, seed.cost)
