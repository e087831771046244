"""Tables of plans, simulations, comparisons, reproductions and identifications; units in every heading."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from leanboom.cli.console import PUMPS, add_row, length, new_table, say, show
from leanboom.evaluation import limits
from leanboom.io.yaml_source import shortened
from leanboom.planning import summaries
from leanboom.report import facts, simulation_page

if TYPE_CHECKING:
    from rich.console import Console

    from leanboom.evaluation.evaluate import Evaluation
    from leanboom.identification.identify import Identification
    from leanboom.planning.planner import Plan
    from leanboom.simulation.closed_loop import Simulation
    from leanboom.study.comparison import Comparison, Row
    from leanboom.study.papers.jobs import Line
    from leanboom.study.papers.reproduction import Reproduction
    from leanboom.study.pareto import Pareto

EVENTS_SHOWN = 12
WORDS = ("", "beyond the pump", "breaks a limit", "no result")  # what becomes of a row, by its rank


def plan(console: Console, result: Plan, out: Path | None, source: str) -> None:
    """Print a plan beside its baseline.

    Args:
        console: Where to print.
        result: The plan.
        out: Its run folder, if it has one.
        source: Name that `leanboom check` takes to show the machine's values.
    """
    task, motion, judged = result.task, result.motion, result.evaluation
    name = shortened(task.name, 80)
    say(console, f"{name}: {shortened(task.machine.name, 80)}, {PUMPS[result.pump]}, {task.duration:g} s", "bold")
    console.print()
    _energies(console, result)
    console.print()
    if task.legs:
        _legs(console, result)
        console.print()
    for label, text in _facts(result):
        say(console, f"{label:<22}{text}")
    if result.solved:
        say(console, f"{'Limits':<22}all kept")
    elif judged.feasible:
        say(console, f"{'NOT SOLVED':<22}{result.status}", "red")
    for violation in judged.violations:
        say(console, f"{'Violated':<22}{shortened(violation, 400)}", "red")
    for note in judged.notes:
        say(console, f"{'Note':<22}{note}", "yellow")
    if motion.cost != result.pump:
        say(console, f"{'Note':<22}minimised {motion.cost}, not the energy of the {PUMPS[result.pump]}", "yellow")
    if out is not None:
        say(console, f"{'Report':<22}{shortened(str(out / 'report.html'), 400)}")
    console.print()
    say(console, f"{facts.assumed(task.machine)} (leanboom check {shlex.quote(source)}).")


def _energies(console: Console, result: Plan) -> None:
    judged, other = result.evaluation, result.baseline
    table = new_table("Pump energy", _named(result), "pseudo-inverse\nkJ", "saving", numbers=3)
    for pump, heading in PUMPS.items():
        mine = judged.energy(pump) if judged.followed else None
        theirs = other.energy(pump) if other is not None and other.followed else None
        cells = ["-" if energy is None else f"{energy / 1e3:.2f}" for energy in (mine, theirs)]
        saving = result.saving(pump)
        cells.append("-" if saving is None else f"{100.0 * saving:.1f} %")
        add_row(table, f"{heading}{' (chosen)' if pump == result.pump else ''}", *cells)
    show(console, table)
    if other is None:
        say(console, "The pseudo-inverse, today's method, cannot follow this path.")
    elif not other.feasible:
        say(console, f"The pseudo-inverse breaks a limit: {shortened(other.status, 300)}.")


def _legs(console: Console, result: Plan) -> None:
    """Print the legs of a cycle, a line each: energies count waiting before them."""
    table = new_table("Leg", "payload\nkg", "waiting\ns", "time\ns", f"{PUMPS[result.pump]}\nkJ", numbers=4)
    for i, leg in enumerate(summaries.legs(result.evaluation, result.pump), 1):
        energy = "-" if leg.energy is None else f"{leg.energy / 1e3:.2f}"
        add_row(table, str(i), f"{leg.payload:g}", f"{leg.dwell:g}", f"{leg.duration:.2f}", energy)
    show(console, table)
    if any(leg.dwell for leg in result.task.legs):
        say(console, summaries.waiting(result.evaluation, result.pump))


def _named(result: Plan) -> str:
    """The heading of a plan's energies, with a warning where the plan is not solved."""
    return "plan\nkJ" if result.solved else "NOT SOLVED\nkJ"


def _facts(result: Plan) -> list[tuple[str, str]]:
    """Labels and values of a plan's status, limits, method and times."""
    motion, judged = result.motion, result.evaluation
    memory = f", {result.peak_memory_bytes / 2**20:.0f} MiB at most"
    return [
        ("Method", f"{motion.method}, minimising {motion.cost}"),
        ("Start", f"{length(motion.position[0])} of the extension cylinder"),
        ("Largest use of limits", _use(judged)),
        ("Tool path error", f"{judged.path_error * 1e3:.3f} mm"),
        *(("Straight arm", text) for text in facts.straight(judged)),
        ("Solved in", f"{motion.solve_s:.2f} s{memory}"),
    ]


def _use(judged: Evaluation) -> str:
    use, found = judged.limit_use, limits.ends(judged)
    where = f" ({limits.at_ends(found)})" if found else ""
    return (
        f"position {100 * use.position:.1f} %{where}, velocity {100 * use.velocity:.1f} %, "
        f"acceleration {100 * use.acceleration:.1f} %, pump flow {100 * use.flow:.1f} %"
        f"{'' if use.flow_limited else ' (not a limit)'}"
    )


def simulation(console: Console, run: Simulation, out: Path | None) -> None:
    """Print a simulated run beside its plan.

    Args:
        console: Where to print.
        run: The run.
        out: Its folder, if it has one.
    """
    name = shortened(run.task.name, 80)
    say(console, f"{name}: {shortened(run.task.machine.name, 80)}, {PUMPS[run.pump]}, closed loop", "bold")
    console.print()
    if run.task.legs:
        _simulated_legs(console, run)
        console.print()
    change = "" if run.change is None else f" ({100.0 * run.change:+.1f} %)"
    errors = ", ".join(
        f"{joint} {error:.4f} {'m' if joint == 'extension' else 'rad'}"
        for joint, error in zip(run.task.machine.names, run.joint_error, strict=True)
    )
    facts = (
        ("Energy", f"{run.energy / 1e3:.2f} kJ simulated, {run.planned_energy / 1e3:.2f} kJ planned{change}"),
        ("Method", f"{run.motion.method}, minimising {run.motion.cost}"),
        ("Path accuracy", f"{run.path_accuracy:.3f} m (ISO 9283)"),
        ("Largest joint errors", errors),
        ("Energy balance", f"{100.0 * run.balance_error:.4f} % not found again"),
        ("Simulated in", f"{run.wall_s:.2f} s, {run.realtime_factor:.0f} times faster than real time"),
    )
    for label, text in facts:
        say(console, f"{label:<22}{text}")
    if not run.solved:
        say(console, f"{'NOT SOLVED':<22}{shortened(run.verdict, 300)}", "red")
    for event in run.events[:EVENTS_SHOWN]:
        say(
            console,
            f"{'Event':<22}{event.time:.2f} s, for {event.duration:.2f} s: {shortened(event.text, 300)}",
            "yellow",
        )
    if len(run.events) > EVENTS_SHOWN:
        say(console, f"{'':<22}and {len(run.events) - EVENTS_SHOWN} more events", "yellow")
    if out is not None:
        say(console, f"{'Report':<22}{shortened(str(out / 'simulation.html'), 400)}")


def _simulated_legs(console: Console, run: Simulation) -> None:
    """Print the legs of a run, a line each: energies count waiting before them."""
    headings = "payload\nkg", "waiting\ns", "time\ns", "simulated\nkJ", "planned\nkJ", "path accuracy\nm"
    table = new_table("Leg", *headings, numbers=len(headings))
    for i, leg in enumerate(simulation_page.legs(run), 1):
        plan, energies = leg.planned, (leg.energy, leg.planned.energy)
        found = ["-" if energy is None else f"{energy / 1e3:.2f}" for energy in energies]
        accuracy = "-" if leg.path_accuracy is None else f"{leg.path_accuracy:.3f}"
        add_row(table, str(i), f"{plan.payload:g}", f"{plan.dwell:g}", f"{plan.duration:.2f}", *found, accuracy)
    show(console, table)
    if said := simulation_page.waiting(run):
        say(console, said)


def comparison(console: Console, result: Comparison, out: Path | None) -> None:
    """Print the rows of a comparison, sorted, a table a start and pump.

    Args:
        console: Where to print.
        result: The comparison.
        out: Its folder, if it has one.
    """
    task = result.task
    name = shortened(task.name, 80)
    for start in result.starts:
        for pump in result.pumps:
            where = start if isinstance(start, str) else length(start)
            best = result.best(pump, start)
            lasts = task.duration if best is None else best.summary["duration_s"]  # its timing may be planned
            say(console, f"{name}: {PUMPS[pump]}, {where} start, {lasts:g} s", "bold")
            console.print()
            more = ("simulated\nkJ",) if any(row.simulated is not None for row in result.rows) else ()
            table = new_table(
                "Method (minimised cost)", "energy\nkJ", "relative", *more, "solved\ns", "", numbers=4 + len(more)
            )
            table.columns[-1].justify = "left"
            table.columns[-1].no_wrap = False
            rows = result.block(pump, start)
            for row in rows:
                add_row(table, *_compared(row, best, bool(more)))
            show(console, table)
            for row in rows:
                if not row.solved:
                    say(console, f"{row.label}: {shortened(row.status, 300)}.", "yellow")
            if best is None:
                say(console, "No method found a motion that keeps every limit and that the pump can deliver.", "red")
            console.print()
    if out is not None:
        say(console, f"{'Rows and figures':<22}{shortened(str(out), 400)}")
    say(console, f"{facts.assumed(task.machine)}.")


def _compared(row: Row, best: Row | None, simulated: bool) -> list[str]:
    """The cells of a comparison's row."""
    energy, least = row.energy, None if best is None else best.energy
    seconds = row.summary["solve_s"]
    closed_loop = "-" if row.simulated is None else f"{row.simulated / 1e3:.2f}"
    return [
        row.label,
        "-" if energy is None else f"{energy / 1e3:.2f}",
        f"{energy / least:.3f}" if row.solved and energy is not None and least else "-",
        *([closed_loop] if simulated else []),
        "-" if seconds is None else f"{seconds:.1f}",
        "best" if row is best else WORDS[row.rank[0]],
    ]


def pareto(console: Console, result: Pareto, out: Path | None) -> None:
    """Print least energies over duration, a table a pump.

    Args:
        console: Where to print.
        result: The points.
        out: Their folder, if they have one.
    """
    for pump in result.pumps:
        say(console, f"{shortened(result.task.name, 80)}: {PUMPS[pump]}, energy against duration", "bold")
        console.print()
        table = new_table("Duration\ns", "plan\nkJ", "pseudo-inverse\nkJ", "saving", numbers=4)
        for point in result.curve(pump):
            mine, theirs = point.energy, point.baseline
            saving = "-" if not point.solved or mine is None or not theirs else f"{100.0 * (1.0 - mine / theirs):.1f} %"
            cells = ["-" if energy is None else f"{energy / 1e3:.2f}" for energy in (mine, theirs)]
            add_row(table, f"{point.duration:g}", *cells, saving)
        show(console, table)
        for point in result.curve(pump):
            if not point.solved:
                say(console, f"{point.duration:g} s: {shortened(point.status, 300)}.", "yellow")
        console.print()
    if out is not None:
        say(console, f"{'Figure and table':<22}{shortened(str(out), 400)}")
    say(console, f"{facts.assumed(result.task.machine)}.")


def reproduction(console: Console, result: Reproduction, titles: dict[str, str]) -> None:
    """Print our values beside the printed ones, a table an experiment.

    Args:
        console: Where to print.
        result: The reproduction.
        titles: Of the experiments.
    """
    for name in result.records:
        say(console, titles[name], "bold")
        console.print()
        table = new_table(name, "printed", "ours", "difference", "why", numbers=4)
        table.columns[-1].justify = "left"
        table.columns[-1].no_wrap = False
        for line in result.lines:
            if line.experiment == name:
                add_row(table, *_beside(line))
        show(console, table)
        console.print()


def _beside(line: Line) -> list[str]:
    """The cells of a reproduced line."""
    difference = "" if line.difference is None else f"{line.difference:+.3f}"
    printed = "" if line.printed is None else f"{line.printed:.3f}"
    return [line.row, printed, "-" if line.ours is None else f"{line.ours:.3f}", difference, line.why]


def identified(console: Console, found: Identification, out: Path | None) -> None:
    """Values with intervals, errors on validation data, and what was done.

    Args:
        console: Where to.
        found: What was found.
        out: The machine file, if one was written.
    """
    from rich.table import Table

    from leanboom.report.identification import field_units

    table = Table(title=f"{found.draft.name}: values told by the logs")
    for name in ("value", "95 % from", "to"):
        if not table.columns:
            table.add_column("parameter")
        table.add_column(name, justify="right")
    table.add_column("unit")
    for each in found.estimates:
        if each.identifiable and each.low is not None and each.high is not None:
            numbers = (field_units.shown(each.name, value) for value in (each.value, each.low, each.high))
            table.add_row(each.name, *numbers, field_units.of_value(each.name)[0])
    console.print(table)
    errors = Table(title="Errors on validation data")
    errors.add_column("signal")
    errors.add_column("rms", justify="right")
    errors.add_column("of full scale", justify="right")
    for each in found.fits:
        unit, scale = field_units.of_signal(each.signal)
        errors.add_row(each.signal, f"{scale * each.rms:.3g} {unit}", f"{each.rms_percent:.2f} %")
    console.print(errors)
    untold = [each.name for each in found.estimates if not each.identifiable]
    if untold:
        console.print(f"Not told by the logs by themselves: {', '.join(untold)}", highlight=False)
    for line in found.said:
        console.print(line, highlight=False, markup=False)
    console.print(
        f"Fitted in {found.wall_s:.1f} s." + (f" Machine file: {out}" if out else ""), highlight=False, markup=False
    )
