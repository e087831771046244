"""Energy section of a report: an hour's work, its fuel, and the parts of the energy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from leanboom.evaluation.energy_breakdown import breakdown

if TYPE_CHECKING:
    from leanboom.evaluation.evaluate import Evaluation
    from leanboom.planning.planner import Plan

ENGINE = 0.35  # assumed efficiency of the diesel engine, from fuel to the pump's shaft
DIESEL = 36e6  # assumed heating value of a litre of diesel [J]
LITRE = ENGINE * DIESEL  # energy at the pump's shaft from a litre [J]
HOUR, KILOWATT_HOUR = 3600.0, 3.6e6  # [s], [J]
PARTS = {
    "work": ("#14693a", "Work of the cylinders", "moving the crane and its load against gravity, inertia and friction"),
    "back_pressure": ("#5a9e6f", "Back pressure", "pushing oil out of the other chambers, and drop of the valves"),
    "throttled": ("#b4540a", "Throttled", "cylinders that need less pressure than the pump supplies"),
    "lowered": ("#d9931e", "Throttled while lowering", "oil for cylinders that their loads move, or that barely move"),
    "margin": ("#5b4a9e", "Load-sensing margin", "pressure the pump keeps above the highest need"),
    "pump": ("#59636e", "Pump and drive", "losses before the oil"),
}


@dataclass(frozen=True, slots=True)
class Part:
    """Energy that goes into one thing, of every motion [J]."""

    colour: str
    name: str
    what: str
    joules: tuple[float, ...]


def hourly(plan: Plan) -> str:
    """Sentences on energy and fuel of an hour of this motion; empty for a plan that is not solved.

    Args:
        plan: The plan.
    """
    if not plan.solved:
        return ""
    mine = _per_hour(plan.evaluation, plan.pump)
    text = (
        f"Driven {HOUR / plan.task.duration:.0f} times an hour, path after path without a pause, the plan takes "
        f"{_amounts(mine)}"
    )
    if plan.saving() is not None and plan.baseline is not None:
        theirs = _per_hour(plan.baseline, plan.pump)
        less = theirs - mine
        text += f", the pseudo-inverse {_amounts(theirs)}: {abs(less) / LITRE:.2g} l {'less' if less >= 0 else 'more'}"
    return (
        f"{text}. Assumed: all of it comes from a diesel engine with {100 * ENGINE:.0f} % efficiency and "
        f"{DIESEL / 1e6:.0f} MJ in a litre; the ways between the paths, idling and travel are not counted."
    )


def _per_hour(judged: Evaluation, pump: str) -> float:
    """Energy of an hour of paths [J]."""
    return judged.energy(pump) * HOUR / judged.task.duration


def _amounts(energy: float) -> str:
    return f"{energy / KILOWATT_HOUR:.2f} kWh, about {energy / LITRE:.2g} l of diesel"


def per_hour(judged: Evaluation, pump: str) -> str:
    """The fuel of an hour, for a card.

    Args:
        judged: The motion.
        pump: "ls" or "cp".
    """
    return f"{_per_hour(judged, pump) / LITRE:.2g} l"


def parts(motions: dict[str, Evaluation], pump: str) -> tuple[list[tuple[str, float]], list[Part]]:
    """Parts of the energy of motions that follow the path, beside each other.

    Args:
        motions: The motions by their names.
        pump: "ls" or "cp".

    Returns:
        Name and whole energy [J] of each motion, and the parts that are worth showing; none where there is no energy.
    """
    found = {name: breakdown(judged, pump) for name, judged in motions.items() if judged.followed}
    totals = [(name, each.total) for name, each in found.items()]
    most = max((total for _, total in totals), default=0.0)
    every = [Part(*texts, tuple(getattr(each, key) for each in found.values())) for key, texts in PARTS.items()]
    return totals, [part for part in every if most > 0.0 and max(part.joules) > 5e-4 * most]
