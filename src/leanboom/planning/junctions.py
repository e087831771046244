"""Where the redundant cylinder stands between legs: by a dynamic program over all legs, then moved by their polish.

Legs are coupled through these extensions alone. Backward from the last leg, the least cost to go from rest at every
extension is the terminal cost of the leg before: one dynamic program over the whole task, on the coarse grid. A cycle
that closes is solved so for some starts, each of which is its end. The fixed-mode program of a leg is smooth in the
extensions at both its ends, and moves all of them together to the least total cost.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from leanboom.dynamic_programming import value_function
from leanboom.dynamic_programming.value_function import Policy, Terminal
from leanboom.errors import InfeasibleError, InputError
from leanboom.evaluation.evaluate import Evaluation, judged_cost
from leanboom.fixed_mode import modes
from leanboom.methods import closed_cycle
from leanboom.methods.dp_refined import coarse_policy, stage_length
from leanboom.model.motion import Motion
from leanboom.model.task import Stretch, Task
from leanboom.problem import stages, starts
from leanboom.problem.stages import Problem

CLOSED_GRID = 0.5  # nodes along each axis where a cycle closes, in those of the grid asked for
Pins = tuple[float | None, ...]
ACCURACY, CALLS = 2e-4, 20  # of extensions that are moved [m]; evaluations for each of them at most
BROKEN = 10.0  # times its cost, that a motion counts which breaks a limit or was not found


@dataclass(frozen=True, slots=True)
class Chain:
    """A task with legs, ready to be planned: the discretised legs, and what is given of its start and end."""

    task: Task
    cost: str
    grid: tuple[int, int]
    step: float  # [s], asked for
    legs: tuple[Stretch, ...]
    problems: tuple[Problem, ...]
    pins: tuple[float | None, ...]  # extensions that are given before, between and after the legs [m]; None: free
    closed: bool  # whether it ends where it starts
    known: dict[int, Evaluation]  # legs, by their number, whose motion is given

    @property
    def inner(self) -> tuple[tuple[float, float], ...]:
        """Feasible extensions before the first leg, between legs, and after the last one [m]."""
        before = [(float(p.lower[0]), float(p.upper[0])) for p in self.problems]
        return (*before, (float(self.problems[-1].lower[-1]), float(self.problems[-1].upper[-1])))

    @property
    def spacing(self) -> float:
        """Distance of extensions on the coarse grid [m]."""
        return max(high - low for low, high in self.inner) / (self.grid[0] - 1)

    def leg(self, i: int, start: float | str, end: float | str) -> Task:
        """A leg as a task of its own, from a start to an end [m], which motions may have missed by a little."""
        ends = (
            place if isinstance(place, str) else float(np.clip(place, *bounds))
            for place, bounds in zip((start, end), self.inner[i : i + 2], strict=True)
        )
        return self.task.stretch(self.legs[i], *ends)


def chain(
    task: Task, cost: str, grid: tuple[int, int], step: float, known: dict[int, Evaluation] | None = None
) -> Chain:
    """The `Chain` of a task with legs.

    Args:
        task: The task.
        cost: What to minimise, a name of `costs.COSTS`.
        grid: Coarse grid of the search.
        step: Length of a stage [s].
        known: Legs, by their number, whose motion is given.

    Raises:
        InputError: A given start or end is not feasible, or none is feasible at both where it closes.
        InfeasibleError: The tool cannot follow a leg, whatever the extension.
    """
    known = known or {}
    legs = tuple(each for each in task.stretches if not each.waits)
    problems, last = [], len(legs) - 1
    for i, each in enumerate(legs):
        alone = task.stretch(each, task.start if i == 0 else "best", task.end if i == last else "free")
        with named(i):
            problems.append(stages.discretise(alone, stage_length(alone, cost, step)))
    pins: list[float | None] = [None] * (len(legs) + 1)
    for i, each in known.items():
        pins[i], pins[i + 1] = float(each.motion.position[0]), float(each.motion.position[-1])
    closed = task.end == "same"
    if pins[0] is None:
        with named(0):
            pins[0] = starts.start_position(problems[0], task.start)
    if closed and pins[0] is None:
        pins[0] = pins[-1]
    if pins[-1] is None:
        with named(last):
            pins[-1] = starts.end_position(problems[-1], pins[0])
    return Chain(task, cost, grid, step, legs, tuple(problems), tuple(pins), closed, known)


@contextmanager
def named(leg: int) -> Iterator[None]:
    """Context in which errors say which leg they are about, by its number from 0."""
    try:
        yield
    except InputError as error:
        raise InputError(f"leg {leg + 1}: {error}") from None
    except InfeasibleError as error:
        raise InfeasibleError(f"leg {leg + 1}: {error}", plan=error.plan, evaluation=error.evaluation) from None


def coarse(given: Chain) -> np.ndarray:
    """Extensions before, between and after the legs that cost least on the coarse grid [m], (legs + 1,).

    Args:
        given: The chain.
    """
    if not given.closed or given.pins[0] is not None:
        return _forward(given, _backward(given, given.grid, given.pins), given.pins)
    nodes = tuple(max(3, round(CLOSED_GRID * count)) for count in given.grid)
    found = []
    for start in closed_cycle.common_lengths(given.problems[0], given.problems[-1]).tolist():
        first = _backward(given, (nodes[0], nodes[1]), _closing(given.pins, start))[0]
        assert first is not None  # or the start would be given
        found.append((float(np.interp(start, *value_function.rest_costs(first))), start))
    pins = _closing(given.pins, min(found)[1])
    return _forward(given, _backward(given, given.grid, pins), pins)


def _closing(pins: Pins, start: float) -> Pins:
    """Given extensions, with a start that is the end as well."""
    return (start, *pins[1:-1], start)


def _backward(given: Chain, nodes: tuple[int, int], pins: Pins) -> list[Policy | None]:
    """The policies of all legs, None for known ones; from the last one on, each knows what those after it cost."""
    policies: list[Policy | None] = []
    terminal: Terminal | None = None
    for i in reversed(range(len(given.legs))):
        start, end = pins[i], pins[i + 1]

        def shown(policy: Policy, start: float | None = start) -> list[Motion]:
            return [value_function.rollout(policy, value_function.best_start(policy) if start is None else start)]

        policy = None
        if i not in given.known:
            after = None if end is not None else terminal
            with named(i):
                policy, _ = coarse_policy(given.problems[i], nodes, given.cost, shown, end, terminal=after)
            costs = value_function.rest_costs(policy)
            terminal = value_function.resting(given.problems[i - 1], given.cost, *costs) if i else None
        policies.insert(0, policy)
    return policies


def _forward(given: Chain, policies: Sequence[Policy | None], pins: Pins) -> np.ndarray:
    """Extensions that the policies lead through [m], (legs + 1,), but for those that are given."""
    first = pins[0]
    if first is None:
        assert policies[0] is not None  # or it would be given
        first = value_function.best_start(policies[0])
    at = [first]
    for policy, pin, (low, high) in zip(policies, pins[1:], given.inner[1:], strict=True):
        if pin is not None:
            at.append(pin)
            continue
        assert policy is not None
        at.append(float(np.clip(value_function.rollout(policy, at[-1]).position[-1], low, high)))
    return np.array(at)


class Mover:
    """Moves the extensions between legs, with the modes of a motion of each leg."""

    def __init__(self, given: Chain, motions: Sequence[Evaluation], step: float | None = None):
        self.given, self.base = given, motions
        problems = given.problems
        if step is not None:  # shorter stages than those of the chain
            problems = tuple(stages.discretise(problem.task, step) for problem in problems)
        self._polishers = [modes.build(ended(problem), given.cost) for problem in problems]
        self._seeds = [stages.on_stages(p.problem, e.motion) for p, e in zip(self._polishers, motions, strict=True)]
        self._switches = [modes.modes(p, seed) for p, seed in zip(self._polishers, self._seeds, strict=True)]
        self._known: dict[tuple[int, float, float], Evaluation | None] = {}

    def leg(self, i: int, start: float, end: float) -> Evaluation | None:
        """A leg from a start to an end [m], polished; None where nothing is found."""
        if i in self.given.known:
            return self.given.known[i]
        key = i, round(start, 9), round(end, 9)
        if key not in self._known:
            self._known[key] = modes.between(self._polishers[i], self._seeds[i], start, end, self._switches[i])
        return self._known[key]

    def legs(self, at: np.ndarray) -> list[Evaluation | None]:
        """All legs between extensions [m], (legs + 1,)."""
        return [self.leg(i, float(at[i]), float(at[i + 1])) for i in range(len(self._seeds))]

    def total(self, at: np.ndarray) -> float:
        """What all legs cost between extensions [m]; more where a limit is broken."""
        found, cost = 0.0, self.given.cost
        for each, known in zip(self.legs(at), self.base, strict=True):
            spent = judged_cost(known if each is None else each, cost)
            found += spent if each is not None and each.feasible else BROKEN * abs(spent)
        return found

    def best(self, at: np.ndarray, reach: float) -> np.ndarray:
        """The extensions of least total cost near given ones [m], (legs + 1,).

        Costs have kinks where cylinders begin or end to move: a method without derivatives goes downhill.

        Args:
            at: The given ones.
            reach: How far to look first [m].
        """
        from scipy.optimize import minimize

        free = self.free
        if not free:
            return at
        first = self.total(at)
        scale = abs(first) or 1.0
        low, high = np.array(self.bounds).T
        answer = minimize(
            lambda moved: self.total(self.placed(at, np.clip(reach * moved, low, high))) / scale, at[free] / reach,
            method="COBYLA", bounds=list(zip(low / reach, high / reach, strict=True)), tol=ACCURACY / reach,
            options={"rhobeg": 1.0, "maxiter": CALLS * len(free)},
        )  # fmt: skip
        found = self.placed(at, np.clip(reach * answer.x, low, high))
        return found if self.total(found) < first else at

    @property
    def free(self) -> list[int]:
        """Which extensions may move; the last one of a closed cycle moves with the first."""
        pins = self.given.pins[:-1] if self.given.closed else self.given.pins
        return [k for k, pin in enumerate(pins) if pin is None]

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Feasible ends of those that may move [m]."""
        inner = list(self.given.inner)
        if self.given.closed:
            inner[0] = max(inner[0][0], inner[-1][0]), min(inner[0][1], inner[-1][1])
        return [inner[k] for k in self.free]

    def placed(self, at: np.ndarray, moved: np.ndarray) -> np.ndarray:
        """All extensions where those that may move are moved [m]."""
        found = at.copy()
        found[self.free] = moved
        if self.given.closed:
            found[-1] = found[0]
        return found


def ended(problem: Problem) -> Problem:
    """A problem whose motions end where they are led to."""
    return replace(problem, task=replace(problem.task, start="middle", end="same"))
