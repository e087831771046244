"""The report's section on energy for who pays for it: an hour's work, its fuel, and where the energy goes."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from leanboom.evaluation.energy_breakdown import Breakdown, breakdown

if TYPE_CHECKING:
    from leanboom.evaluation.evaluate import Evaluation
    from leanboom.planning.planner import Plan

ENGINE = 0.35  # assumed efficiency of the diesel engine, from fuel to the pump's shaft
DIESEL = 36e6  # assumed heating value of a litre of diesel [J]
HOUR, KILOWATT_HOUR = 3600.0, 3.6e6  # [s], [J]
PARTS = {
    "work": ("#14693a", "Work of the cylinders", "moving the crane and its load against gravity, inertia and friction"),
    "back_pressure": ("#5a9e6f", "Back pressure", "pushing oil out of the other chambers, and drop of the valves"),
    "throttled": ("#b4540a", "Throttled", "cylinders that need less pressure than the pump supplies"),
    "lowered": ("#d9931e", "Throttled while lowering", "oil for cylinders that their loads move, or that barely move"),
    "margin": ("#5b4a9e", "Load-sensing margin", "pressure the pump keeps above the highest need"),
    "pump": ("#59636e", "Pump and drive", "losses before the oil"),
}


def hourly(plan: Plan) -> str:
    """What an hour of this motion takes, as a paragraph; empty for a plan that is not solved.

    Args:
        plan: The plan.
    """
    if not plan.solved:
        return ""
    mine = _per_hour(plan.evaluation, plan.pump)
    times = HOUR / plan.task.duration
    begin = (
        f"<strong>In an hour.</strong> Driven {times:.0f} times an hour, path after path without a pause, the plan "
        f"takes {_amounts(mine)}"
    )
    if plan.saving() is not None and plan.baseline is not None:
        theirs = _per_hour(plan.baseline, plan.pump)
        less = theirs - mine
        begin += (
            f", the pseudo-inverse {_amounts(theirs)}: {abs(less) / _LITRE:.2g} l {'less' if less >= 0 else 'more'}"
        )
    return (
        f"<p>{begin}. Assumed: all of it comes from a diesel engine with {100 * ENGINE:.0f} % efficiency and "
        f"{DIESEL / 1e6:.0f} MJ in a litre; the ways between the paths, idling and travel are not counted.</p>"
    )


_LITRE = ENGINE * DIESEL  # energy at the pump's shaft from a litre [J]


def _per_hour(judged: Evaluation, pump: str) -> float:
    """Energy of an hour of paths [J]."""
    return judged.energy(pump) * HOUR / judged.task.duration


def _amounts(energy: float) -> str:
    return f"{energy / KILOWATT_HOUR:.2f} kWh, about {energy / _LITRE:.2g} l of diesel"


def per_hour(judged: Evaluation, pump: str) -> str:
    """The fuel of an hour, for a card.

    Args:
        judged: The motion.
        pump: "ls" or "cp".
    """
    return f"{_per_hour(judged, pump) / _LITRE:.2g} l"


def parts(plan: Plan) -> str:
    """Stacked bars and a table of where the energy goes, plan and pseudo-inverse beside each other.

    Args:
        plan: The plan.
    """
    motions = {"plan" if plan.solved else "plan (not solved)": plan.evaluation}
    if plan.baseline is not None:
        motions["pseudo-inverse"] = plan.baseline
    found = {name: breakdown(judged, plan.pump) for name, judged in motions.items() if judged.followed}
    most = max((each.total for each in found.values()), default=0.0)
    if not most > 0.0:
        return "<p>No energy to break down.</p>"
    present = [key for key in PARTS if any(asdict(each)[key] > 5e-4 * most for each in found.values())]
    bars = "".join(
        f'<div class="bar"><span>{name}</span><span class="track"><span class="stack" style="--share:'
        f'{each.total / most:.4f}">{_segments(each, present)}</span><span class="amount">{each.total / 1e3:.2f} kJ'
        "</span></span></div>"
        for name, each in found.items()
    )
    head = "".join(f'<th scope="col" class="n" colspan="2">{name}</th>' for name in found)
    rows = "".join(_row(key, list(found.values())) for key in present)
    total = "".join(f'<td class="n">{each.total / 1e3:.2f} kJ</td><td class="n">100 %</td>' for each in found.values())
    return (
        f'<figure class="bars">{bars}</figure><div class="scroll"><table class="parts"><thead><tr><th scope="col">Goes '
        f'into</th>{head}</tr></thead><tbody>{rows}<tr><th scope="row">Energy of the pump</th>{total}</tr></tbody>'
        "</table></div>"
    )


def _segments(each: Breakdown, present: list[str]) -> str:
    values = asdict(each)
    shares = {key: max(values[key], 0.0) / each.total for key in present if each.total > 0.0}
    return "".join(
        f'<i style="flex:{share:.5f};background:{PARTS[key][0]}" title="{PARTS[key][1]}"></i>'
        for key, share in shares.items()
    )


def _row(key: str, found: list[Breakdown]) -> str:
    colour, name, what = PARTS[key]
    cells = "".join(
        f'<td class="n">{asdict(each)[key] / 1e3:.2f} kJ</td>'
        f'<td class="n">{100.0 * asdict(each)[key] / each.total if each.total else 0.0:.0f} %</td>'
        for each in found
    )
    return (
        f'<tr><th scope="row"><svg class="square" aria-hidden="true"><rect width="12" height="12" fill="{colour}"/>'
        f'</svg>{name}<span class="more">{what}</span></th>{cells}</tr>'
    )
