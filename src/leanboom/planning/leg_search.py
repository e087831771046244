"""Motions of legs whose timing is known: each by the search for single tasks, where they meet by `junctions`.

The extensions between legs come from the dynamic program over all legs, or from legs planned one after another where
those cost less; the polish moves them together. Then every leg is searched with its start and its end given, and at
last the extensions are moved once more, on the stages of that search.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from leanboom.components.costs import COSTS
from leanboom.errors import LeanboomError
from leanboom.evaluation.evaluate import Evaluation, evaluate, judged_cost
from leanboom.methods import pseudo_inverse
from leanboom.methods.registry import Method, Settings
from leanboom.model import motion
from leanboom.model.motion import Motion
from leanboom.model.task import Task
from leanboom.planning.junctions import Chain, Mover, chain, coarse, named
from leanboom.progress import Progress

NEAR = 2e-3  # [m], where extensions are looked for at last
ROUNDS = (1, 2)  # of moving the extensions before all legs are searched: without loads, and with

Legs = list[Evaluation]  # judged motions of all legs, in order


def legs(
    task: Task, cost: str, method: Method, tell: Progress, settings: Settings,
    known: dict[int, Evaluation] | None = None,
) -> Legs:  # fmt: skip
    """The judged motions of all legs of a task.

    Args:
        task: The task; the timing of its legs is known.
        cost: What to minimise, a name of `costs.COSTS`.
        method: How each leg is planned; one that leaves the end free plans them one after another.
        tell: Called with what happens and the share done.
        settings: As for a single task; seeds are motions of the whole task.
        known: Legs, by their number from 0, whose motion is given.

    Raises:
        InputError: Starts and ends that are not feasible.
        InfeasibleError: The tool cannot follow a leg, whatever the extension.
    """
    given = chain(task, cost, settings.grid, settings.step, known)
    if not method.ends:
        return _one_after_another(given, method, tell, settings)
    quick = replace(settings, effort="quick", seeds=())
    tell("extensions between legs", 0.02)
    found = _between(given, coarse(given), method, _within(tell, 0.05, 0.2), quick)
    try:
        greedy = _one_after_another(given, method, _within(tell, 0.2, 0.3), quick)
        found = _better(found, greedy, cost)
    except LeanboomError:  # where the others lead, the last leg cannot begin
        pass
    for seed in settings.seeds:
        found = _better(found, _cut(given, seed), cost)
    for _ in range(ROUNDS[COSTS[cost].loads]):
        moved = _moved(given, found, given.spacing)
        if moved is found:
            break
        found = _better(_between(given, _ends(moved), method, _within(tell, 0.3, 0.5), quick, moved), moved, cost)
    if settings.effort != "quick":
        found = _between(given, _ends(found), method, _within(tell, 0.5, 0.9), settings, found)
        found = _moved(given, found, NEAR, min(each.motion.step for each in found))
    return _no_worse_than_pseudo_inverse(given, found, method, tell, settings)


def whole(task: Task, found: Legs) -> Evaluation:
    """The judged motion of a task with legs made of those of its legs, at rest between them."""
    log = [f"leg {i}: {line}" for i, leg in enumerate(found, 1) for line in leg.motion.log]
    return evaluate(task, replace(joined(task, [leg.motion for leg in found]), log=tuple(log)))


def joined(task: Task, found: Sequence[Motion]) -> Motion:
    """The motion of a task made of those of its legs, at rest between them; the only one of a task without legs."""
    first, parts = found[0], []
    for each in task.stretches:
        leg = found[each.leg]
        held = motion.held(float(leg.position[0]), each.until - each.since, first.method, first.cost)
        parts.append(held if each.waits else leg)
    return motion.joined(parts) if parts else first


@lru_cache(maxsize=1)  # a plan is held to it, and is shown beside it
def baseline(task: Task, start: float) -> Evaluation | None:
    """The actuator pseudo-inverse of all legs one after another from a start [m], judged; None where it cannot follow.

    Its end is free.
    """
    found, at = [], start
    for each in task.stretches:
        if each.waits:
            continue
        leg = pseudo_inverse.baseline(task.stretch(each), at)
        if leg is None:
            return None
        found.append(leg)
        at = float(leg.motion.position[-1])
    return whole(replace(task, end="free"), found)


def _one_after_another(given: Chain, method: Method, tell: Progress, settings: Settings) -> Legs:
    """The legs planned one after another, each from where the one before ends: none looks ahead."""
    found: Legs = []
    at = given.pins[0]
    for i, pin in enumerate(given.pins[1:]):
        closes = given.closed and found and i == len(given.legs) - 1
        end = float(found[0].motion.position[0]) if closes else "free" if pin is None else pin
        found.append(_leg(given, i, "best" if at is None else at, end, method, tell, settings))
        at = float(found[-1].motion.position[-1])
    return found


def _between(
    given: Chain, at: np.ndarray, method: Method, tell: Progress, settings: Settings, seeds: Sequence[Evaluation] = ()
) -> Legs:
    """The legs between extensions [m], (legs + 1,), each searched with both its ends given.

    Args:
        given: The chain.
        at: The extensions.
        method: How a leg is planned.
        tell: Called with what happens and the share done.
        settings: Of the search.
        seeds: Motions of the legs that are to be as good as these at least.
    """
    found: Legs = []
    for i, (start, end) in enumerate(zip(at[:-1].tolist(), at[1:].tolist(), strict=True)):
        known = (seeds[i].motion,) if seeds else ()
        found.append(_leg(given, i, start, end, method, tell, replace(settings, seeds=known)))
    return found


def _leg(
    given: Chain, i: int, start: float | str, end: float | str, method: Method, tell: Progress, settings: Settings
) -> Evaluation:
    """A leg planned from a start to an end [m], or to a free one, judged."""
    if i in given.known:
        return given.known[i]
    count = len(given.legs)
    task = given.leg(i, start, end)

    def told(text: str, share: float) -> None:
        tell(f"leg {i + 1}: {text}", (i + share) / count)

    with named(i):
        first = None if method.free_start or isinstance(start, str) else start
        cost = method.costs[0] if method.pointwise and method.costs else given.cost
        answer = method.plan(task, cost, first, told, settings)
    return evaluate(task, answer) if isinstance(answer, Motion) else answer


def _moved(given: Chain, known: Legs, reach: float, step: float | None = None) -> Legs:
    """Legs with the extensions between them moved together; the same where that gains nothing.

    Args:
        given: The chain.
        known: The legs.
        reach: How far to look first [m].
        step: Length of the stages on which they are polished [s]; None: that of the chain.
    """
    mover = Mover(given, known, step)
    found = [each for each in mover.legs(mover.best(_ends(known), reach)) if each is not None]
    return _better(known, found, given.cost) if len(found) == len(known) else known


def _ends(found: Sequence[Evaluation]) -> np.ndarray:
    """Extensions before, between and after legs [m], (legs + 1,)."""
    return np.array([*(leg.motion.position[0] for leg in found), found[-1].motion.position[-1]])


def _better(one: Legs, other: Legs, cost: str) -> Legs:
    """The better of two motions of all legs, the first where they are equal."""
    return other if _rank(other, cost) < _rank(one, cost) else one


def _rank(found: Legs, cost: str) -> tuple[bool, float, float]:
    """Sorting key, the best first, as `ranking.rank` has it for one motion."""
    if all(leg.feasible for leg in found):
        return False, 0.0, sum(judged_cost(leg, cost) for leg in found)
    return True, max(leg.worst_use for leg in found), 0.0


def _cut(given: Chain, seed: Motion) -> Legs:
    """The judged legs of a motion of the whole task."""
    found: Legs = []
    for i, each in enumerate(given.legs):
        part = motion.between(seed, each.since, each.until)
        found.append(evaluate(given.leg(i, float(part.position[0]), float(part.position[-1])), part))
    return found


def _no_worse_than_pseudo_inverse(
    given: Chain, found: Legs, method: Method, tell: Progress, settings: Settings
) -> Legs:
    """Legs, or those searched around the pseudo-inverse from the same start where that ends as asked and costs less."""
    if given.known:  # the others meet them, wherever the pseudo-inverse would lead
        return found
    other = baseline(given.task, float(found[0].motion.position[0]))
    if other is None:
        return found
    cost = given.cost
    asked = evaluate(given.task, other.motion)
    if not asked.feasible or judged_cost(asked, cost) >= sum(judged_cost(leg, cost) for leg in found):
        return found
    seeds = _cut(given, other.motion)
    return _better(_between(given, _ends(seeds), method, tell, settings, seeds), found, cost)


def _within(tell: Progress, since: float, until: float) -> Progress:
    """Progress of a part of the work as that of the whole."""
    return lambda text, share: tell(text, since + (until - since) * share)
