"""Planning of neighbours: a sweep's tasks begin with motions of each other, and with those of a neighbouring sweep.

The first of a family is planned as `plan` does. For every further sweep one dynamic program on a coarser grid serves
all starts of the redundant cylinder; its motions and the neighbours', carried over, are refined in tubes, polished and
put on shorter stages by the same search. Where that finds nothing feasible the whole search is run: a motion is never
called infeasible because of a short cut.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from leanboom.dynamic_programming import value_function
from leanboom.dynamic_programming.value_function import Policy
from leanboom.errors import LeanboomError
from leanboom.evaluation.evaluate import Evaluation
from leanboom.library.specification import Sweep
from leanboom.methods import pseudo_inverse
from leanboom.methods.dp_refined import Search, coarse_policy
from leanboom.methods.registry import STEP, Effort
from leanboom.model import motion
from leanboom.model.motion import Motion
from leanboom.model.task import Task
from leanboom.planning.planner import run
from leanboom.problem import stages, starts
from leanboom.problem.stages import Problem

COARSE = (61, 31)  # nodes of the program that serves all starts; see docs/library.md
WARM = Effort(minima=1, stages=0, share=0.0, leading=1, shortest=2)
LED_OVER = 0.4  # share of a motion over which a neighbour's is led over from another start


@dataclass(frozen=True, slots=True)
class Result:
    """What became of a task: all of it that is stored."""

    start_m: float | None  # where the redundant cylinder starts [m]; None where there is no motion
    end_m: float | None  # where it must end [m]; None where there is no motion or its end is free
    solved: bool
    status: str
    energy_j: float | None  # of the pump that it is planned for; None where the crane cannot make the motion
    pseudo_inverse_j: float | None  # what the pseudo-inverse takes from the same start; None where it cannot
    solve_s: float
    motion: Motion | None  # where it is solved


@dataclass(frozen=True, slots=True)
class Known:
    """A task with a motion that solves it."""

    task: Task
    motion: Motion


def plan_sweep(sweep: Sweep, neighbours: Sequence[Known]) -> tuple[Result, ...]:
    """Plan all tasks of a sweep.

    Args:
        sweep: The tasks and their pump.
        neighbours: Motions of neighbouring tasks, along the same line; none: the sweep is the first of its family.

    Returns:
        The results, in the order of the tasks.
    """
    found: list[Result] = []
    near = list(neighbours)
    policies: dict[Any, Policy] = {}  # by where motions end
    for asked in sweep.tasks:
        began = time.perf_counter()
        try:
            task = starts.settled(asked, STEP)
            best = None
            # The start of the best closed cycle is found by a search of its own.
            if near and (task.start, task.end) != ("best", "same"):
                if task.end not in policies:
                    policies[task.end] = _policy(task, sweep.pump)
                best = _warm(task, sweep.pump, policies[task.end], _nearest(task, near))
            if best is None or not best.feasible:
                best = _whole(task, sweep.pump)
        except LeanboomError as error:
            found.append(Result(None, None, False, str(error), None, None, time.perf_counter() - began, None))
            continue
        found.append(_result(task, sweep.pump, best, began))
        if best.feasible:
            near.append(Known(task, best.motion))
    return tuple(found)


def _result(task: Task, pump: str, best: Evaluation, began: float) -> Result:
    status = best.status_with(pump)
    first = float(best.motion.position[0])
    other = pseudo_inverse.baseline(replace(task, end="free"), first, STEP)
    return Result(
        start_m=first,
        end_m=None if task.end == "free" else float(best.motion.position[-1]),
        solved=status.solved,
        status=str(status),
        energy_j=best.energy(pump) if best.followed else None,
        pseudo_inverse_j=None if other is None else other.energy(pump),
        solve_s=time.perf_counter() - began,
        motion=replace(best.motion, method="dp", log=()) if status.solved else None,
    )


def _whole(task: Task, pump: str) -> Evaluation:
    """The best motion as `plan` finds it."""
    return run(task, pump=pump, baseline=False, check=False).evaluation


def _policy(task: Task, pump: str) -> Policy:
    """The coarse program that serves all starts of a task, with velocities as far as its motions use them."""
    problem = stages.discretise(task, Search(task, pump, COARSE, STEP, WARM).step)
    end = starts.end_position(problem, None)

    def from_ends(policy: Policy) -> list[Motion]:
        return [value_function.rollout(policy, float(end[0])) for end in (problem.lower, problem.upper)]

    return coarse_policy(problem, COARSE, pump, from_ends, end)[0]


def _warm(task: Task, pump: str, policy: Policy, near: Sequence[Known]) -> Evaluation:
    """The best motion around that of a coarse program and around neighbours'."""
    problem = replace(policy.problem, task=task)
    search = Search(task, pump, COARSE, STEP, WARM)
    start = starts.start_position(problem, task.start)
    first = value_function.best_start(policy) if start is None else start
    seeds = [value_function.rollout(policy, first)]
    seeds += [carried_over(each, problem, start) for each in near]
    return search.around(problem, seeds, start, float(policy.grid.w_hi[0]))


def _nearest(task: Task, near: Sequence[Known]) -> list[Known]:
    """The neighbours to begin with: the latest of this sweep, and of others that from the same start."""
    same_start = [each for each in near if each.task.start == task.start]
    chosen = (same_start or list(near))[:1]
    return chosen + [each for each in near[-1:] if each not in chosen]


def carried_over(known: Known, problem: Problem, start: float | None) -> Motion:
    """A neighbour's motion on another problem's stages: the same shares of the feasible extensions.

    Args:
        known: The neighbour.
        problem: The other problem.
        start: Where its redundant cylinder starts [m]; None: as the neighbour's.
    """
    theirs = stages.discretise(known.task, known.motion.step)
    span = np.maximum(theirs.upper - theirs.lower, 1e-9)
    share = np.clip((known.motion.position - theirs.lower) / span, 0.0, 1.0)
    at = np.linspace(0.0, 1.0, problem.stages + 1)
    share = np.interp(at, np.linspace(0.0, 1.0, share.size), share)
    position = problem.lower + share * (problem.upper - problem.lower)
    first = float(position[0]) if start is None else start
    led = (1.0 - np.minimum(at / LED_OVER, 1.0)) ** 3
    position = np.clip(position + led * (first - position[0]), problem.lower, problem.upper)
    velocity = np.gradient(position, problem.step)
    velocity[[0, -1]] = 0.0
    return motion.from_velocities(problem.step, first, velocity, known.motion.method, known.motion.cost)
