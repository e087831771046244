"""Discretised legs of a task as one sequence of stages.

Between two legs the redundant cylinder rests, and where it stands is all that they have in common: the end of a leg and
the beginning of the next one are one stage.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from leanboom.model.task import Task
from leanboom.problem.stages import Problem


@dataclass(frozen=True, slots=True, eq=False)
class Legs:
    """Discretised legs one after the other, each from rest to rest; a path alone is one leg.

    A stage where a leg begins belongs to that leg, and the last one of all to the last leg.
    """

    problems: tuple[Problem, ...]
    firsts: np.ndarray = field(init=False)  # stages where legs begin, and the last one of all, (legs + 1,)
    lower: np.ndarray = field(init=False)  # smallest feasible stroke of the redundant cylinder [m], (stages + 1,)
    upper: np.ndarray = field(init=False)  # largest [m], (stages + 1,)

    def __post_init__(self) -> None:
        counts = [problem.stages for problem in self.problems]
        object.__setattr__(self, "firsts", np.concatenate([[0], np.cumsum(counts)]))
        object.__setattr__(self, "lower", one_after_another([problem.lower for problem in self.problems]))
        object.__setattr__(self, "upper", one_after_another([problem.upper for problem in self.problems]))

    @property
    def stages(self) -> int:
        """Number of stages of all legs."""
        return int(self.firsts[-1])

    @property
    def velocity_limit(self) -> float:
        """Velocity limit of the redundant cylinder [m/s]."""
        return self.problems[0].crane.machine.redundant.velocity_limit

    def of_stage(self, k: int) -> tuple[int, int]:
        """Leg that a stage belongs to, and its number among that leg's stages."""
        leg = min(int(np.searchsorted(self.firsts, k, side="right")), len(self.problems)) - 1
        return leg, k - int(self.firsts[leg])

    def part(self, leg: int) -> slice:
        """The stages of a leg, both ends included."""
        return slice(int(self.firsts[leg]), int(self.firsts[leg + 1]) + 1)


def one_after_another(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Values at the stages of all legs from those of each, whose ends are included: (stages + 1, ...)."""
    return np.concatenate([*(part[:-1] for part in parts), parts[-1][-1:]])


def alone(task: Task) -> tuple[Task, ...]:
    """The legs of a task as tasks of their own, free where they meet; a task without legs is one."""
    if not task.legs:
        return (task,)
    moves = [each for each in task.stretches if not each.waits]
    begins = [task.start, *["best"] * (len(moves) - 1)]
    ends = [*["free"] * (len(moves) - 1), task.end]
    return tuple(task.stretch(*given) for given in zip(moves, begins, ends, strict=True))
