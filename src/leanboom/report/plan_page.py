"""The report of a plan: one HTML file that opens offline and explains itself to a reader who knows cranes, not code.

The page is `page/report.html` with its style and script; this module fills in texts, tables and the data that the
script draws. Whatever comes from a file is escaped, and the page forbids itself every network access.
"""

from __future__ import annotations

import json
import re
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from leanboom import __version__
from leanboom.evaluation import limits
from leanboom.evaluation.evaluate import SAMPLE, TOLERANCE
from leanboom.methods.registry import METHODS
from leanboom.report import energy_section, facts, plan_charts

if TYPE_CHECKING:
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
POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"

_FOLDER = Path(__file__).parent / "templates"
_HOLE = re.compile(r"\{\{(\w+)\}\}")

GLOSSARY = {
    "Redundant crane": "A crane with one more joint than the tool path needs, here the telescope. The same path can be "
    "followed in infinitely many ways, which differ in energy.",
    "Load-sensing pump (LS)": "Its pressure follows the cylinder that needs the most, plus a fixed margin, and its "
    "flow follows the sum of what the cylinders take. Energy is pressure times flow, so one highly loaded cylinder "
    "makes all flow dear.",
    "Constant-pressure pump (CP)": "Its pressure is always the same; energy is that pressure times the flow, so what "
    "counts is how much oil the cylinders take.",
    "Counted pressure": "What a cylinder asks of a load-sensing pump: the pressure in its driven chamber while it "
    "moves against its load; zero while it is held, or lowered by its load.",
    "Pseudo-inverse": "Today's usual method: at every instant, the cylinder velocities that are smallest in the sense "
    "of least squares. It looks neither at loads nor ahead.",
    "Dynamic programming": "A method that works backward from the end of the path and knows, for every state on the "
    "way, the least energy still to come. It finds the best motion of all, not one that is only better than its "
    "neighbours.",
    "Use of a limit": "How much of the permitted range is used at the worst instant: 100 % is at the limit. For "
    "positions, 0 % is the middle of the joint's range.",
}


def page(plan: Plan, grid: tuple[int, int] | None = None) -> str:
    """The report of a plan as one HTML document.

    Args:
        plan: The plan.
        grid: Position and velocity nodes the plan was made with, if known.

    Returns:
        The document's text.
    """
    task = plan.task
    holes = {
        "title": _text(task.name),
        "subtitle": f"Crane {_text(task.machine.name)} · {PUMPS[plan.pump]} pump · {task.duration:g} s"
        + (f" · payload {task.payload:g} kg" if task.payload else " · no payload"),
        "badge": "good" if plan.solved else "bad",
        "verdict": _verdict(plan),
        "lead": _lead(plan),
        "alerts": _alerts(plan),
        "cards": _cards(plan),
        "bars": _bars(plan),
        "bars_caption": "Pump energy over the whole path. The same two motions are also measured with the other kind "
        "of pump, which they were not planned for." if plan.baseline else "Pump energy over the whole path.",
        "line_legend": _line_legend(plan),
        "hourly": energy_section.hourly(plan),
        "energy_parts": energy_section.parts(plan),
        "limits_table": _limits_table(plan),
        "assumed": _assumed(task.machine),
        "how": _how(plan, grid),
        "glossary": "".join(f"<dt>{escape(word)}</dt><dd>{escape(text)}</dd>" for word, text in GLOSSARY.items()),
        **_section_texts(plan),
        **_crane_texts(plan),
    }  # fmt: skip
    return filled("report", holes, plan_charts.data(plan))


def filled(name: str, holes: dict[str, str], data: dict[str, Any]) -> str:
    """A page of the folder `page` with its holes filled, its script, style and plotting library inside.

    Args:
        name: Of its .html and .js.
        holes: Texts by their names, escaped.
        data: What its script draws, ready for JSON.

    Returns:
        The document's text.
    """
    from plotly.offline import get_plotlyjs

    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    for character in "<>&":  # nothing in the data may end the script element
        text = text.replace(character, f"\\u{ord(character):04x}")
    every = {
        **holes,
        "policy": POLICY,
        "style": (_FOLDER / "report.css").read_text(encoding="utf-8"),
        "script": (_FOLDER / f"{name}.js").read_text(encoding="utf-8"),
        "plotly": get_plotlyjs(),
        "data": text,
        "version": __version__,
    }
    return _HOLE.sub(lambda hole: every[hole[1]], (_FOLDER / f"{name}.html").read_text(encoding="utf-8"))


def _text(value: object) -> str:
    return escape(str(value))


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


def _called(plan: Plan, what: str) -> str:
    """What is said of the plan's own numbers, which are no result where it is not solved."""
    return what if plan.solved else f"{what} (not solved)"


def _lead(plan: Plan) -> str:
    judged, pump = plan.evaluation, PUMPS[plan.pump]
    if not judged.feasible:
        return (
            f"No motion was found that follows the path in {plan.task.duration:g} s and keeps every limit: "
            f"{_text(judged.status)}. What is shown below is the closest one."
        )
    if not plan.solved:
        return (
            f"A motion was found that follows the path in {plan.task.duration:g} s and keeps every limit of the "
            f"cylinders, but the pump cannot deliver it: {_text(plan.status.partition(': ')[2])}. A larger pump or a "
            "slower path would do."
        )
    goal = "" if plan.motion.cost == plan.pump else f" It was chosen for the least {_goal(plan)}, not for this energy."
    begin = (
        f"The crane's tool follows a given path in {plan.task.duration:g} s. Its telescope leaves infinitely many ways "
        f"to do so; this one takes <strong>{_kilojoule(judged, plan.pump)}</strong> from a {pump} pump"
    )
    saving = plan.saving()
    if plan.baseline is None or saving is None:
        return f"{begin}.{goal}{_proven(plan)}"
    other = _kilojoule(plan.baseline, plan.pump)
    if abs(saving) < 5e-4:
        compared = "as much as the"
    else:
        share = f"{100 * abs(saving):.{0 if abs(saving) > 0.01 else 1}f} %"
        compared = f"<strong>{share} {'less' if saving > 0.0 else 'more'}</strong> than the {other} of the"
    return f"{begin}, {compared} method in use today, the pseudo-inverse.{goal}{_proven(plan)}"


def _proven(plan: Plan) -> str:
    """What is proven of the plan's distance from the optimum, if anything."""
    proof = plan.certificate
    if proof is None:
        return ""
    return (
        f" It is proven that no motion planned in stages of {proof.step:g} s takes less than "
        f"{proof.lower_bound_j / 1e3:.2f} kJ, {proof.gap_percent:.2f} % below the best one known."
    )


def _goal(plan: Plan) -> str:
    return _text(GOALS.get(plan.motion.cost, plan.motion.cost))


def _alerts(plan: Plan) -> str:
    lines = [("alert bad", f"Limit broken: {text}.") for text in plan.evaluation.violations]
    lines += [("alert", f"Note: {text}.") for text in plan.evaluation.notes]
    if plan.baseline is not None and not plan.baseline.feasible:
        lines.append(("alert", f"The pseudo-inverse it is compared with breaks a limit: {plan.baseline.status}."))
    if plan.baseline is None:
        lines.append(("alert", "There is no comparison: the pseudo-inverse cannot follow this path."))
    return "".join(f'<p class="{kind}">{_text(text)}</p>' for kind, text in lines)


def _cards(plan: Plan) -> str:
    judged, duration = plan.evaluation, plan.task.duration
    cards = [
        (
            _called(plan, "Energy, plan"),
            _kilojoule(judged, plan.pump),
            _average(judged, plan.pump),
            " first" if plan.solved else " void",
        ),
    ]
    if plan.baseline is not None:
        theirs = _kilojoule(plan.baseline, plan.pump), _average(plan.baseline, plan.pump)
        cards.append(("Energy, pseudo-inverse", *theirs, ""))
    saving = plan.saving()
    if saving is not None:
        what = "Saving" if saving >= 0.0 else "Loss"
        cards.append((what, f"{100 * abs(saving):.1f} %", f"{PUMPS[plan.pump]} pump", ""))
    kept = "all kept" if judged.feasible else f"{len(judged.violations)} broken"
    cards.append(("Limits", kept, limits.nearest(judged), ""))
    if plan.solved:
        fuel = energy_section.per_hour(judged, plan.pump)
        cards.append(("Diesel an hour", fuel, "if repeated without pause; assumed below", ""))
    cards.append(("Time", f"{duration:g} s", f"planned in {plan.motion.solve_s:.1f} s", ""))
    return "".join(
        f'<div class="card{extra}"><span class="what">{what}</span><span class="value">{value}</span>'
        f'<span class="more">{more}</span></div>'
        for what, value, more, extra in cards
    )


def _bars(plan: Plan) -> str:
    judged, other = plan.evaluation, plan.baseline
    motions = [(_called(plan, "plan"), judged, "" if plan.solved else " void")] + (
        [("pseudo-inverse", other, " other")] if other is not None else []
    )
    order = [plan.pump, *(pump for pump in PUMPS if pump != plan.pump)]
    largest = max((m.energy(pump) for pump in order for _, m, _ in motions if m.followed), default=0.0)
    lines = []
    for pump in order:
        for i, (name, motion, kind) in enumerate(motions):
            share = motion.energy(pump) / largest if motion.followed and largest > 0.0 else 0.0
            gap = " gap" if i == 0 and pump != plan.pump else ""
            aside = " aside" if pump != plan.pump else ""
            lines.append(
                f'<div class="bar{kind}{aside}{gap}"><span>{PUMPS[pump]}, {name}</span><span class="track">'
                f'<span class="fill" style="--share:{share:.4f}"></span>'
                f'<span class="amount">{_kilojoule(motion, pump)}</span></span></div>'
            )
    return "".join(lines)


def _section_texts(plan: Plan) -> dict[str, str]:
    pump, machine = plan.task.machine.pump, plan.task.machine
    if plan.pump == "ls":
        supply = f"the highest counted cylinder pressure plus {pump.ls_margin / 1e6:g} MPa"
    else:
        supply = f"always {pump.constant_pressure / 1e6:g} MPa"
    return {
        "motion_text": _motion_text(plan),
        "pump_text": f"Power is supply pressure times flow; the supply pressure is {supply}. The pump can give "
        f"{pump.max_pressure / 1e6:g} MPa and {pump.max_flow * 6e4:.0f} l/min. The thin upright line is the moment "
        "shown above.",
        "cylinder_text": "Lengths and velocities must stay between the red dotted lines. Forces push the cylinder out "
        f"where they are positive. {_friction_text(machine)}Counted pressures are what a load-sensing pump has to "
        f"supply: zero while a cylinder is held (slower than {1e3 * machine.driven_velocity:g} mm/s) or moved by its "
        "load.",
        "limits_text": "The largest use of each limit at any instant; 100 % is at the limit. A position is measured "
        "from the middle of the joint's range. A cylinder that stands at an end of its stroke, as a telescope does "
        "that starts retracted, has nothing wrong with it.",
    }  # fmt: skip


def _motion_text(plan: Plan) -> str:
    """What the drawing shows when it opens; that postures differ is said where they do."""
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


def _friction_text(machine: Machine) -> str:
    """What the spikes in the charts of forces are."""
    most = max(machine.cylinders, key=lambda cylinder: cylinder.friction.coulomb)
    if not most.friction.coulomb > 0.0:
        return ""
    levels = ", ".join(f"{c.name} {c.friction.coulomb / 1e3:g} kN" for c in machine.cylinders)
    return (
        "Short spikes and steps in them are friction: it always points against the motion, so where a cylinder stops, "
        f"turns or creeps, its Coulomb friction ({levels}) fades or changes sign within a few mm/s. Smaller steps come "
        "from accelerations, which are constant on each stage of a plan. "
    )


def _crane_texts(plan: Plan) -> dict[str, str]:
    machine, compared = plan.task.machine, plan.baseline is not None
    colours = plan_charts.colours(machine)
    shown = {"base": "column", "lift": "boom, moved by lift", "tilt": "outer boom, moved by tilt"}
    names = [name for name in ("base", "lift", "tilt", "extension") if name == "base" or name in machine.names]
    legend = [(colours[name], shown.get(name, "telescope"), "") for name in names]
    if compared:
        legend.append(("#9aa3ad", "pseudo-inverse", ' opacity="0.6"'))
    items = [
        f'<li><svg aria-hidden="true"><line x1="3" x2="27" y1="6" y2="6" stroke="{colour}" stroke-width="8" '
        f'stroke-linecap="round"{extra}/></svg>{text}</li>'
        for colour, text, extra in legend
    ]
    items.append(
        '<li><svg aria-hidden="true"><line x1="0" x2="30" y1="6" y2="6" stroke="#17202b" stroke-width="2" '
        'stroke-dasharray="5 4"/></svg>tool path</li>'
    )
    rows = [
        ("Extension cylinder", "stroke", "m"),
        (f"Supply pressure, {PUMPS[plan.pump]}", "supply", "MPa"),
        ("Pump power", "power", "kW"),
        ("Energy so far", "energy", "kJ"),
    ]
    who = ["plan", "other"] if compared else ["plan"]
    body = "".join(
        f'<tr><th scope="row">{label} [{unit}]</th>'
        + "".join(f'<td class="n" data-now="{motion} {key}"></td>' for motion in who)
        + "</tr>"
        for label, key, unit in rows
    )
    head = '<th scope="col" class="n">plan</th>'
    head += '<th scope="col" class="n">pseudo-inverse</th>' if compared else ""
    return {
        "views": "two" if machine.geometry.slewing else "one",
        "crane_legend": "".join(items),
        "now_head": head,
        "now_rows": body,
    }


def _line_legend(plan: Plan) -> str:
    def item(colour: str, width: float, dash: str, text: str) -> str:
        return (
            f'<li><svg aria-hidden="true"><line x1="0" x2="30" y1="6" y2="6" stroke="{colour}" '
            f'stroke-width="{width}" stroke-dasharray="{dash}"/></svg>{text}</li>'
        )

    items = [item("#17202b", 2.5, "", _called(plan, "plan (coloured by cylinder)"))]
    if plan.baseline is not None:
        items.append(item("#7b8490", 2, "5 3", "pseudo-inverse"))
    items.append(item("#b3261e", 1.6, "2 3", "limit"))
    return f'<ul class="legend">{"".join(items)}</ul>'


def _limits_table(plan: Plan) -> str:
    machine = plan.task.machine
    judged = [(plan.evaluation, "")] + ([(plan.baseline, " other")] if plan.baseline is not None else [])
    motions = [(limits.uses(motion), limits.ends(motion), extra) for motion, extra in judged]
    kinds = ("Position", "Velocity", "Acceleration")
    span = len(motions)
    names = ["plan", "pseudo-inverse"][:span]
    head = "".join(f'<th scope="colgroup" colspan="{span}">{kind}</th>' for kind in kinds)
    second = "".join(f'<th scope="col" class="n">{name}</th>' for _ in kinds for name in names)
    body = []
    for j, cylinder in enumerate(machine.cylinders):
        given = f"{cylinder.velocity_limit:g} m/s, {cylinder.acceleration_limit:g} m/s²"
        cells = "".join(
            _end_cell(ends[cylinder.name], extra)
            if kind == 0 and cylinder.name in ends
            else _use_cell(float(values[kind, j]), extra)
            for kind in range(len(kinds))
            for values, ends, extra in motions
        )
        body.append(f'<tr><th scope="row">{cylinder.name.capitalize()}</th><td>{given}</td>{cells}</tr>')
    return (
        '<div class="scroll"><table class="limits"><thead>'
        f'<tr><th></th><th></th>{head}</tr><tr><th scope="col">Cylinder</th><th scope="col">Limits</th>{second}</tr>'
        f"</thead><tbody>{''.join(body)}</tbody></table></div>"
    )


def _end_cell(which: str, extra: str) -> str:
    return f'<td class="n end{extra}">at its end: {which}</td>'


def _use_cell(use: float, extra: str) -> str:
    over = " over" if use > TOLERANCE else ""
    return f'<td class="n{extra}{over}" style="--use:{min(100.0, 100.0 * use):.0f}%">{100.0 * use:.1f} %</td>'


def _assumed(machine: Machine) -> str:
    counts, total = facts.count(machine), len(machine.provenance)
    described = f"<p>{_text(machine.description)}</p>" if machine.description else ""
    if not total:
        return f"{described}<p>The machine's values do not say where they come from.</p>"
    present = [(status, number) for status, number in counts.items() if number]
    bar = "".join(
        f'<span style="flex:{number};background:{STATUS_COLOURS[status]}"></span>' for status, number in present
    )
    legend = "".join(
        f'<li><svg class="square" aria-hidden="true"><rect width="12" height="12" '
        f'fill="{STATUS_COLOURS[status]}"/></svg>'
        f"{number} {status}</li>"
        for status, number in present
    )
    parts = [
        described,
        f"<p><strong>{_text(facts.assumed(machine))}.</strong> Printed values stand in the literature or a data "
        "sheet, derived ones follow from them, identified ones were measured on the machine. Savings depend on the "
        "assumed ones; replace them by measured values before relying on absolute numbers.</p>",
        f'<div class="counts" aria-hidden="true">{bar}</div><ul class="legend">{legend}</ul>',
    ]
    rows = _assumed_rows(machine)
    if rows:
        body = "".join(f"<tr>{''.join(f'<td>{_text(cell)}</td>' for cell in row)}</tr>" for row in rows)
        parts.append(
            "<details><summary>All assumed values</summary><div class='scroll'><table><thead><tr>"
            '<th scope="col">Value</th><th scope="col">is</th><th scope="col">because</th></tr></thead>'
            f"<tbody>{body}</tbody></table></div></details>"
        )
    return "".join(parts)


def _assumed_rows(machine: Machine) -> list[tuple[str, str, str]]:
    """Key, value and reason of what is assumed or unstated; a list's entries in one row."""
    rows: dict[tuple[str, str], list[str]] = {}
    for entry in machine.provenance:
        if entry.status in ("assumed", "unstated"):
            key = re.sub(r"(\[\d+\])+$", "", entry.key).replace(".", " › ").replace("_", " ")
            note = entry.note if entry.status == "assumed" else "origin not stated"
            rows.setdefault((key, note), []).append(entry.value)
    return [(key, ", ".join(values), note) for (key, note), values in rows.items()]


def _how(plan: Plan, grid: tuple[int, int] | None) -> str:
    motion = plan.motion
    settings = [f"stages of {1e3 * motion.step:g} ms"]
    method = METHODS.find(motion.method) if motion.method in METHODS.names() else None
    if grid is not None and method is not None and method.exhaustive:
        settings.insert(0, f"a coarse grid of {grid[0]} positions and {grid[1]} velocities of the extension cylinder")
    lines = [
        f"The motion was found by method <strong>{_text(motion.method)}</strong>"
        + (f" ({_text(method.sentence)})" if method is not None else "")
        + f", minimising the {_goal(plan)}, with {' and '.join(settings)}. The extension cylinder starts at "
        f"{float(motion.position[0]):.4f} m.",
        f"Every energy, pressure and limit on this page, for the plan and for the pseudo-inverse alike, was then "
        f"measured afresh: the whole crane's motion is worked out every {1e3 * SAMPLE:g} ms, with the dynamics, "
        "friction and hydraulics of the machine file, and pump power is added up over time. The charts show every "
        "tenth of these instants or fewer; trajectory.csv, beside this page, holds them all.",
        f"The tool leaves its path by at most {1e3 * plan.evaluation.path_error:.3f} mm. A limit counts as kept up to "
        f"{100 * TOLERANCE:.1f} % use.",
    ]  # fmt: skip
    log = ""
    if motion.log:
        unit = "J" if motion.cost in ("ls", "cp", "actuator", "recuperation") else "SI units"
        text = _text("\n".join(motion.log))
        title = f"Steps of the search (time, step, cost in {unit})"
        log = f"<details open><summary>{title}</summary><pre>{text}</pre></details>"
    return "".join(f"<p>{line}</p>" for line in lines) + log
