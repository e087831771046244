"""The report of a plan: one HTML file that opens offline and explains itself to a reader who knows cranes, not code.

The page is `templates/plan.html.j2`; this module gives it the plan and what is worked out of it for its tables.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from leanboom.evaluation import limits
from leanboom.evaluation.evaluate import SAMPLE, TOLERANCE
from leanboom.methods.registry import METHODS
from leanboom.planning import summaries
from leanboom.report import energy_section, facts, plan_charts, rendering

if TYPE_CHECKING:
    from leanboom.components.cylinders import Cylinder
    from leanboom.evaluation.evaluate import Evaluation
    from leanboom.model.machine import Machine
    from leanboom.planning.planner import Plan

PUMPS = {"ls": "load-sensing", "cp": "constant-pressure"}
STATUS_COLOURS = {
    "printed": "#14693a",
    "derived": "#5a9e6f",
    "identified": "#0b5c8c",
    "assumed": "#d9931e",
    "unstated": "#a3241b",
}
GOALS = {
    "ls": "energy of a load-sensing pump",
    "cp": "energy of a constant-pressure pump",
    "actuator": "mechanical work of the cylinders",
    "velocity": "squared velocities of the cylinders",
    "extension": "use of the telescope",
    "recuperation": "energy of a constant-pressure pump that gets return flow back",
}


def page(plan: Plan, grid: tuple[int, int] | None = None) -> str:
    """The report of a plan as one HTML document.

    Args:
        plan: The plan.
        grid: Position and velocity nodes the plan was made with, if known.

    Returns:
        The document's text.
    """
    task, motion, judged, other = plan.task, plan.motion, plan.evaluation, plan.baseline
    motions = {"plan" if plan.solved else "plan (not solved)": judged}
    if other is not None:
        motions["pseudo-inverse"] = other
    totals, energy_parts = energy_section.parts(motions, plan.pump)
    return rendering.page(
        "plan",
        plan_charts.data(plan),
        plan=plan,
        task=task,
        motion=motion,
        judged=judged,
        other=other,
        solved=plan.solved,
        pump=PUMPS[plan.pump],
        verdict=_verdict(plan),
        energy=_kilojoule(judged, plan.pump),
        other_energy=None if other is None else _kilojoule(other, plan.pump),
        saving=plan.saving(),
        goal=GOALS.get(motion.cost, motion.cost),
        cards=_cards(plan),
        first_card=" first" if plan.solved else " void",
        bars=_bars(plan, motions),
        columns=["plan", "pseudo-inverse"][: len(motions)],
        motion_text=_motion_text(plan),
        crane_parts=_crane_parts(plan),
        legs=summaries.legs(judged, plan.pump) if task.legs else (),
        waiting=summaries.waiting(judged, plan.pump) if any(leg.dwell for leg in task.legs) else "",
        hourly=energy_section.hourly(plan),
        totals=totals,
        energy_parts=energy_parts,
        frictions=_frictions(task.machine),
        limits=_limits(plan),
        assumed=facts.assumed(task.machine),
        statuses=[(status, n, STATUS_COLOURS[status]) for status, n in facts.count(task.machine).items() if n],
        assumed_rows=_assumed_rows(task.machine),
        method=METHODS.find(motion.method) if motion.method in METHODS.names() else None,
        grid=grid,
        sample=SAMPLE,
        tolerance=TOLERANCE,
    )


def _kilojoule(judged: Evaluation, pump: str) -> str:
    value = judged.energy(pump) / 1e3
    if not judged.followed:
        return "unknown"
    return f"{value:.1f} kJ" if abs(value) >= 9.95 else f"{value:.2f} kJ"


def _average(judged: Evaluation, pump: str) -> str:
    if not judged.followed:
        return "the crane cannot make this motion"
    return f"{judged.energy(pump) / judged.task.duration / 1e3:.2f} kW on average"


def _verdict(plan: Plan) -> str:
    if plan.solved:
        return "All limits kept"
    return "Limits kept, but the pump cannot deliver it" if plan.evaluation.feasible else "No feasible motion"


def _cards(plan: Plan) -> list[tuple[str, str, str]]:
    """Title, value and note of each card."""
    judged = plan.evaluation
    what = "Energy, plan" if plan.solved else "Energy, plan (not solved)"
    cards = [(what, _kilojoule(judged, plan.pump), _average(judged, plan.pump))]
    if plan.baseline is not None:
        theirs = _kilojoule(plan.baseline, plan.pump), _average(plan.baseline, plan.pump)
        cards.append(("Energy, pseudo-inverse", *theirs))
    saving = plan.saving()
    if saving is not None:
        what = "Saving" if saving >= 0.0 else "Loss"
        cards.append((what, f"{100 * abs(saving):.1f} %", f"{PUMPS[plan.pump]} pump"))
    kept = "all kept" if judged.feasible else f"{len(judged.violations)} broken"
    cards.append(("Limits", kept, limits.nearest(judged)))
    if plan.solved:
        fuel = energy_section.per_hour(judged, plan.pump)
        cards.append(("Diesel an hour", fuel, "if repeated without pause; assumed below"))
    return [*cards, ("Time", f"{plan.task.duration:.4g} s", f"planned in {plan.motion.solve_s:.1f} s")]


def _bars(plan: Plan, motions: dict[str, Evaluation]) -> list[tuple[str, float, str, str]]:
    """Name, share of the longest, energy and classes of each bar; the pump planned for first."""
    order = [plan.pump, *(pump for pump in PUMPS if pump != plan.pump)]
    largest = max((m.energy(pump) for pump in order for m in motions.values() if m.followed), default=0.0)
    bars = []
    for pump in order:
        for name, motion in motions.items():
            mine, aside = motion is plan.evaluation, pump != plan.pump
            share = motion.energy(pump) / largest if motion.followed and largest > 0.0 else 0.0
            kinds = {"other": not mine, "void": mine and not plan.solved, "aside": aside, "gap": mine and aside}
            classes = "".join(f" {kind}" for kind, given in kinds.items() if given)
            bars.append((f"{PUMPS[pump]}, {name}", share, _kilojoule(motion, pump), classes))
    return bars


def _motion_text(plan: Plan) -> str:
    """Sentences on the pose first drawn, and on where postures differ."""
    if plan.baseline is None:
        return "The crane drawn to scale along its path. Press play to see it move."
    time, apart = plan_charts.postures_apart(plan)
    if not plan_charts.visible(plan, apart):
        return (
            "The crane drawn to scale along its path. Plan and pseudo-inverse hold the boom in nearly the same "
            f"posture: it differs by {100.0 * apart:.1f} cm at most, which hardly shows."
        )
    return (
        f"The crane drawn to scale, {time:.1f} s after the start, when the boom's postures differ most: by "
        f"{apart:.2f} m. Both motions move the tool in the same way. Press play to see them along the whole path."
    )


def _frictions(machine: Machine) -> str:
    """The cylinders' Coulomb frictions; empty where there is none."""
    if not any(cylinder.friction.coulomb > 0.0 for cylinder in machine.cylinders):
        return ""
    return ", ".join(f"{c.name} {c.friction.coulomb / 1e3:g} kN" for c in machine.cylinders)


def _crane_parts(plan: Plan) -> list[tuple[str, str]]:
    """Colour and name of each drawn part of the crane."""
    machine = plan.task.machine
    names = {
        "base": "column",
        "lift": "boom, moved by lift",
        "tilt": "outer boom, moved by tilt",
        "extension": "telescope",
    }
    drawn = [name for name in names if name == "base" or name in machine.names]
    parts = [(colour, names[name]) for name, colour in plan_charts.colours(machine).items() if name in drawn]
    return parts if plan.baseline is None else [*parts, ("#9aa3ad", "pseudo-inverse")]


def _limits(plan: Plan) -> list[tuple[Cylinder, list[tuple[float, str | None, str]]]]:
    """Each cylinder with its cells, by limit and motion: share used, end of the stroke it stands at, and class."""
    judged = [(plan.evaluation, "")] + ([(plan.baseline, " other")] if plan.baseline is not None else [])
    motions = [(limits.uses(motion), limits.ends(motion), which) for motion, which in judged]
    return [
        (
            cylinder,
            [
                (float(uses[kind, j]), ends.get(cylinder.name) if kind == 0 else None, which)
                for kind in range(3)
                for uses, ends, which in motions
            ],
        )
        for j, cylinder in enumerate(plan.task.machine.cylinders)
    ]


def _assumed_rows(machine: Machine) -> list[tuple[str, str, str]]:
    """Key, value and reason of what is assumed or unstated; a list's entries in one row."""
    rows: dict[tuple[str, str], list[str]] = {}
    for entry in machine.provenance:
        if entry.status in ("assumed", "unstated"):
            key = re.sub(r"(\[\d+\])+$", "", entry.key).replace(".", " › ").replace("_", " ")
            note = entry.note if entry.status == "assumed" else "origin not stated"
            rows.setdefault((key, note), []).append(entry.value)
    return [(key, ", ".join(values), note) for (key, note), values in rows.items()]
