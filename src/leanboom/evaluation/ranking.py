"""Order of judged motions."""

from __future__ import annotations

from leanboom.evaluation.evaluate import Evaluation, judged_cost


def rank(judged: Evaluation, total: float) -> tuple[bool, float, float]:
    """Sorting key, the best first: motions that keep every limit by their costs, then others by their use of limits.

    Args:
        judged: The motion.
        total: What it costs.
    """
    return (False, 0.0, total) if judged.feasible else (True, judged.worst_use, 0.0)


def beats(one: Evaluation, other: Evaluation, cost: str) -> bool:
    """Whether a judged motion is better than another.

    Args:
        one, other: The motions.
        cost: What they cost, a name of `costs.COSTS`.
    """
    return rank(one, judged_cost(one, cost)) < rank(other, judged_cost(other, cost))


def better(one: Evaluation, other: Evaluation | None, cost: str) -> Evaluation:
    """The better one of two judged motions, the first where they are equal; arguments as in `beats`."""
    return other if other is not None and beats(other, one, cost) else one


def risk(judged: Evaluation) -> tuple[bool, bool, float]:
    """Sorting key of stops, the safest first: by their use of limits, whatever they cost."""
    return not judged.feasible, not judged.followed, judged.limit_use.worst
