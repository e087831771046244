"""What the commands print for people: tables on standard output, units in every heading."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from math import pi
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from leanboom import inspection, shaft
from leanboom.machine import EfficiencyMap
from leanboom.source import shortened
from leanboom.task import Spline, written

if TYPE_CHECKING:
    from leanboom.comparison import Comparison, Row
    from leanboom.experiments import Line
    from leanboom.judge import Evaluation
    from leanboom.machine import Machine, Pump
    from leanboom.planner import Plan
    from leanboom.reproduction import Reproduction
    from leanboom.simulation import Simulation
    from leanboom.task import Task

EVENTS_SHOWN = 12
PIPE_WIDTH = 160  # of tables that do not go to a terminal
PUMPS = {"ls": "load-sensing pump", "cp": "constant-pressure pump"}


def output() -> Console:
    """The console of standard output; files and pipes get lines as long as they are."""
    console = Console(highlight=False, emoji=False)
    return console if console.is_terminal else Console(highlight=False, emoji=False, width=PIPE_WIDTH)


def _say(console: Console, text: str, style: str = "") -> None:
    """One line of text, taken literally and left to the terminal to wrap."""
    console.print(Text(text, style=style), soft_wrap=True)


def _table(*headings: str, numbers: int = 0) -> Table:
    """A table without frame; its first column is kept whole, its last ones are numbers."""
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, show_edge=False)
    for i, heading in enumerate(headings):
        right = i >= len(headings) - numbers
        table.add_column(Text(heading), justify="right" if right else "left", overflow="fold", no_wrap=i == 0 or right)
    return table


def _row(table: Table, *cells: str) -> None:
    table.add_row(*(Text(shortened(cell, 300)) for cell in cells))


def plan(console: Console, result: Plan, out: Path | None, source: str) -> None:
    """A plan beside its baseline.

    Args:
        console: Where to print.
        result: The plan.
        out: Its run folder, if it has one.
        source: Name that `leanboom check` takes to show the machine's values.
    """
    task, motion, judged = result.task, result.motion, result.evaluation
    name = shortened(task.name, 80)
    _say(console, f"{name}: {shortened(task.machine.name, 80)}, {PUMPS[result.pump]}, {task.duration:g} s", "bold")
    console.print()
    _energies(console, result)
    console.print()
    for label, text in _facts(result):
        _say(console, f"{label:<22}{text}")
    if judged.feasible:
        _say(console, f"{'Limits':<22}all kept")
    for violation in judged.violations:
        _say(console, f"{'Violated':<22}{shortened(violation, 400)}", "red")
    for note in judged.notes:
        _say(console, f"{'Note':<22}{note}", "yellow")
    if motion.cost != result.pump:
        _say(console, f"{'Note':<22}minimised {motion.cost}, not the energy of the {PUMPS[result.pump]}", "yellow")
    if out is not None:
        _say(console, f"{'Report':<22}{shortened(str(out / 'report.html'), 400)}")
    console.print()
    _say(console, f"{inspection.assumed(task.machine)} (leanboom check {shlex.quote(source)}).")


def _energies(console: Console, result: Plan) -> None:
    judged, other = result.evaluation, result.baseline
    table = _table("Pump energy", "plan\nkJ", "pseudo-inverse\nkJ", "saving", numbers=3)
    for pump, heading in PUMPS.items():
        mine, theirs = judged.energy(pump), other.energy(pump) if other is not None else None
        cells = [f"{mine / 1e3:.2f}"]
        cells += ["-", "-"] if theirs is None else [f"{theirs / 1e3:.2f}", _saving(mine, theirs)]
        _row(table, f"{heading}{' (chosen)' if pump == result.pump else ''}", *cells)
    console.print(table)
    if other is None:
        _say(console, "The pseudo-inverse, today's method, cannot follow this path.")
    elif not other.feasible:
        _say(console, f"The pseudo-inverse breaks a limit: {shortened(other.status, 300)}.")


def _saving(mine: float, theirs: float) -> str:
    return f"{100.0 * (1.0 - mine / theirs):.1f} %" if theirs > 0.0 else "-"


def _facts(result: Plan) -> list[tuple[str, str]]:
    """What was found and how, labelled."""
    motion, judged = result.motion, result.evaluation
    return [
        ("Method", f"{motion.method}, minimising {motion.cost}"),
        ("Start", f"{_length(motion.position[0])} of the extension cylinder"),
        ("Largest use of limits", _use(judged)),
        ("Tool path error", f"{judged.path_error * 1e3:.3f} mm"),
        ("Solved in", f"{motion.solve_s:.2f} s, {result.peak_memory_bytes / 2**20:.0f} MiB at most"),
    ]


def _use(judged: Evaluation) -> str:
    use = judged.limit_use
    return (
        f"position {100 * use.position:.1f} %, velocity {100 * use.velocity:.1f} %, "
        f"acceleration {100 * use.acceleration:.1f} %"
    )


def _length(value: float) -> str:
    return f"{float(value):.4f} m"


def _start(task: Task) -> str:
    return task.start if isinstance(task.start, str) else _length(task.start)


def simulation(console: Console, run: Simulation, out: Path | None) -> None:
    """A simulated run beside its plan.

    Args:
        console: Where to print.
        run: The run.
        out: Its folder, if it has one.
    """
    name = shortened(run.task.name, 80)
    _say(console, f"{name}: {shortened(run.task.machine.name, 80)}, {PUMPS[run.pump]}, closed loop", "bold")
    console.print()
    change = f"{100.0 * (run.energy / run.planned_energy - 1.0):+.1f} %" if run.planned_energy > 0.0 else "-"
    errors = ", ".join(
        f"{joint} {error:.4f} {'m' if joint == 'extension' else 'rad'}"
        for joint, error in zip(run.task.machine.names, run.joint_error, strict=True)
    )
    facts = (
        ("Energy", f"{run.energy / 1e3:.2f} kJ simulated, {run.planned_energy / 1e3:.2f} kJ planned ({change})"),
        ("Method", f"{run.motion.method}, minimising {run.motion.cost}"),
        ("Path accuracy", f"{run.path_accuracy:.3f} m (ISO 9283)"),
        ("Largest joint errors", errors),
        ("Energy balance", f"{100.0 * run.balance_error:.4f} % not found again"),
        ("Simulated in", f"{run.wall_s:.2f} s, {run.realtime_factor:.0f} times faster than real time"),
    )
    for label, text in facts:
        _say(console, f"{label:<22}{text}")
    if not run.planned.feasible:
        _say(console, f"{'Note':<22}the plan breaks a limit: {shortened(run.planned.status, 300)}", "yellow")
    for event in run.events[:EVENTS_SHOWN]:
        _say(
            console,
            f"{'Event':<22}{event.time:.2f} s, for {event.duration:.2f} s: {shortened(event.text, 300)}",
            "yellow",
        )
    if len(run.events) > EVENTS_SHOWN:
        _say(console, f"{'':<22}and {len(run.events) - EVENTS_SHOWN} more events", "yellow")
    if out is not None:
        _say(console, f"{'Report':<22}{shortened(str(out / 'simulation.html'), 400)}")


def comparison(console: Console, result: Comparison, out: Path | None) -> None:
    """The rows of a comparison, sorted, a table a start and pump.

    Args:
        console: Where to print.
        result: The comparison.
        out: Its folder, if it has one.
    """
    task = result.task
    name = shortened(task.name, 80)
    for start in result.starts:
        for pump in result.pumps:
            where = start if isinstance(start, str) else _length(start)
            _say(console, f"{name}: {PUMPS[pump]}, {where} start, {task.duration:g} s", "bold")
            console.print()
            best = result.best(pump, start)
            more = ("simulated\nkJ",) if any(row.simulated is not None for row in result.rows) else ()
            table = _table(
                "Method (minimised cost)", "energy\nkJ", "relative", *more, "solved\ns", "", numbers=4 + len(more)
            )
            table.columns[-1].justify = "left"
            table.columns[-1].no_wrap = False
            for row in result.block(pump, start):
                _row(table, *_compared(row, best, bool(more)))
            console.print(table)
            if best is None:
                _say(console, "No method found a motion that keeps every limit.", "red")
            console.print()
    if out is not None:
        _say(console, f"{'Rows and figures':<22}{shortened(str(out), 400)}")
    _say(console, f"{inspection.assumed(task.machine)}.")


def _compared(row: Row, best: Row | None, simulated: bool) -> list[str]:
    """The cells of a comparison's row."""
    energy, least = row.energy, None if best is None else best.energy
    seconds = row.summary["solve_s"]
    driven = "-" if row.simulated is None else f"{row.simulated / 1e3:.2f}"
    return [
        row.label,
        "-" if energy is None else f"{energy / 1e3:.2f}",
        "-" if energy is None or not least else f"{energy / least:.3f}",
        *([driven] if simulated else []),
        "-" if seconds is None else f"{seconds:.1f}",
        "best" if row is best else "" if row.feasible else row.status,
    ]


def reproduction(console: Console, result: Reproduction, titles: dict[str, str]) -> None:
    """Our values beside the printed ones, a table an experiment.

    Args:
        console: Where to print.
        result: The reproduction.
        titles: Of the experiments.
    """
    for name in result.records:
        _say(console, titles[name], "bold")
        console.print()
        table = _table(name, "printed", "ours", "difference", "why", numbers=4)
        table.columns[-1].justify = "left"
        table.columns[-1].no_wrap = False
        for line in result.lines:
            if line.experiment == name:
                _row(table, *_beside(line))
        console.print(table)
        console.print()


def _beside(line: Line) -> list[str]:
    """The cells of a reproduced line."""
    difference = "" if line.difference is None else f"{line.difference:+.3f}"
    printed = "" if line.printed is None else f"{line.printed:.3f}"
    return [line.row, printed, "-" if line.ours is None else f"{line.ours:.3f}", difference, line.why]


def machine_facts(machine: Machine) -> dict[str, Any]:
    """A machine as `machines --json` prints it, in SI units.

    Args:
        machine: The machine.
    """
    reach = inspection.reach(machine)
    pairs = list(zip(machine.joints, machine.cylinders, reach.pressure, strict=True))
    return {
        "name": machine.name,
        "description": machine.description,
        "reach_m": reach.radius,
        "highest_m": reach.highest,
        "capacity_kg": reach.capacity,
        "joints": [{"name": joint.name, "lower": joint.lower, "upper": joint.upper} for joint, _, _ in pairs],
        "cylinders": [
            {
                "name": cylinder.name,
                "connection": cylinder.connection.value,
                "piston_area_m2": cylinder.piston_area,
                "rod_side_area_m2": cylinder.rod_side_area,
                "stroke_m": cylinder.stroke,
                "velocity_limit_m_s": cylinder.velocity_limit,
                "acceleration_limit_m_s2": cylinder.acceleration_limit,
                "static_pressure_pa": pressure,
            }
            for _, cylinder, pressure in pairs
        ],
        "pump": {
            "constant_pressure_pa": machine.pump.constant_pressure,
            "ls_margin_pa": machine.pump.ls_margin,
            "max_pressure_pa": machine.pump.max_pressure,
            "max_flow_m3_s": machine.pump.max_flow,
            "efficiency": _efficiency(machine.pump),
        },
        "values": inspection.count(machine),
    }


def _efficiency(pump: Pump) -> Any:
    """The constant efficiency, or what became of a map."""
    if not isinstance(pump.efficiency, EfficiencyMap):
        return pump.efficiency
    met = shaft.fit(pump.efficiency)
    return {
        "speed_rev_s": pump.efficiency.speed,
        "shaft": {
            "efficiency": met.shaft.efficiency,
            "idle_w": met.shaft.idle,
            "leak_w_per_pa": met.shaft.leak,
            "drag_w_s2_m6": met.shaft.drag,
        },
        "typical_error": met.typical,
        "largest_error": met.largest,
    }


def task_facts(task: Task) -> dict[str, Any]:
    """A task as `tasks --json` prints it, in SI units.

    Args:
        task: The task.
    """
    path = written(task)
    if isinstance(path, Spline):
        timing = {"path": "spline", "times_s": list(path.times)}
    else:
        timing = {"path": "lines", "durations_s": list(path.durations)}
    return {
        "name": task.name,
        "machine": task.machine.name,
        "payload_kg": task.payload,
        **timing,
        "points_m": [list(point) for point in path.points],
        "duration_s": task.duration,
        "start": task.start,
        "smooth_hz": task.smooth,
    }


def machine_list(console: Console, machines: Sequence[Machine]) -> None:
    """A line a machine.

    Args:
        console: Where to print.
        machines: The machines.
    """
    table = _table("Machine", "Joints", "reach\nm", "pump", "assumed\nvalues", numbers=3)
    for machine in machines:
        counts, total = inspection.count(machine), len(machine.provenance)
        pump = f"{machine.pump.max_pressure / 1e6:g} MPa, {machine.pump.max_flow * 6e4:.0f} l/min"
        reach = f"{inspection.reach(machine).radius:.2f}"
        _row(table, machine.name, ", ".join(machine.names), reach, pump, f"{counts['assumed']} of {total}")
    console.print(table)
    _say(console, "\nDetails: leanboom machines NAME; where values come from: leanboom check NAME")


def machine_detail(console: Console, machine: Machine) -> None:
    """A machine's joints, cylinders, bodies and pump.

    Args:
        console: Where to print.
        machine: The machine.
    """
    _heading(console, machine.name, machine.description)
    reach, pump, g = inspection.reach(machine), machine.pump, machine.geometry
    _say(console, f"Lengths   boom {g.boom:g} m, offset {g.offset:g} m, outer boom {g.outer:g} m")
    _say(console, f"Reach     {reach.radius:.2f} m, tool at most {reach.highest:.2f} m high")
    _say(
        console,
        f"Pump      at most {pump.max_pressure / 1e6:g} MPa and {pump.max_flow * 6e4:.0f} l/min, load-sensing margin "
        f"{pump.ls_margin / 1e6:g} MPa, constant pressure {pump.constant_pressure / 1e6:g} MPa",
    )
    _say(console, f"Drive     efficiency {inspection.efficiency(machine)}")
    console.print()
    table = _table("Joint", "Connection", "range", "areas\ncm^2", "stroke\nm", "limit\nm/s", "limit\nm/s^2", numbers=5)
    for joint, cylinder in zip(machine.joints, machine.cylinders, strict=True):
        scale, unit = (1.0, "m") if joint.name == "extension" else (180.0 / pi, "deg")
        _row(
            table,
            joint.name,
            cylinder.connection.value.replace("_", " "),
            f"{joint.lower * scale:.4g} .. {joint.upper * scale:.4g} {unit}",
            f"{cylinder.piston_area * 1e4:.2f} / {cylinder.rod_side_area * 1e4:.2f}",
            f"{cylinder.stroke:.3f}",
            f"{cylinder.velocity_limit:g}",
            f"{cylinder.acceleration_limit:g}",
        )
    console.print(table)
    console.print()
    table = _table("Body", "Moves with", "mass\nkg", numbers=1)
    for body in machine.bodies:
        share = f" and {body.extension_share:g} of the extension" if body.extension_share else ""
        _row(table, body.name, f"{body.carrier}{share}", f"{body.mass:g}")
    console.print(table)
    console.print()
    _say(console, f"{inspection.assumed(machine)} (leanboom check lists them).")


def task_list(console: Console, tasks: Sequence[Task]) -> None:
    """A line a task.

    Args:
        console: Where to print.
        tasks: The tasks.
    """
    table = _table("Task", "Machine", "Path", "Start", "payload\nkg", "time\ns", numbers=2)
    for task in tasks:
        kind = "spline" if isinstance(task.path, Spline) else "lines"
        path = f"{kind}, {len(written(task).points)} points"
        _row(table, task.name, task.machine.name, path, _start(task), f"{task.payload:g}", f"{task.duration:g}")
    console.print(table)
    _say(console, "\nDetails: leanboom tasks NAME; plan one: leanboom plan NAME --out DIR")


def task_detail(console: Console, task: Task) -> None:
    """A task's path, point by point.

    Args:
        console: Where to print.
        task: The task.
    """
    path = written(task)
    _heading(console, task.name, "")
    kind = "clamped cubic spline" if isinstance(path, Spline) else "straight lines, at rest at every point"
    _say(console, f"Machine   {task.machine.name}")
    _say(console, f"Payload   {task.payload:g} kg")
    _say(console, f"Start     {_start(task)}")
    _say(console, f"Path      {kind}, {task.duration:g} s")
    console.print()
    if isinstance(path, Spline):
        times = path.times
    else:
        times = tuple(sum(path.durations[:i]) for i in range(len(path.points)))
    table = _table("time\ns", "x\nm", "y\nm", "z\nm", numbers=4)
    for time, point in zip(times, path.points, strict=True):
        _row(table, f"{time:g}", *(f"{value:g}" for value in point))
    console.print(table)


def checked_machine(console: Console, name: str, machine: Machine) -> None:
    """What `check` says of a machine.

    Args:
        console: Where to print.
        name: What was asked for.
        machine: The machine.
    """
    _say(console, f"{shortened(name, 200)}: machine {shortened(machine.name, 80)} is right.", "bold")
    _machine_report(console, machine)


def checked_task(console: Console, name: str, task: Task) -> None:
    """What `check` says of a task and its machine.

    Args:
        console: Where to print.
        name: What was asked for.
        task: The task.

    Raises:
        InfeasibleError: If the tool cannot be everywhere on its path, whatever the extension.
    """
    facts = inspection.path(task)
    _say(console, f"{shortened(name, 200)}: task {shortened(task.name, 80)} is right.", "bold")
    low, high = facts.start
    _say(console, f"Path              {facts.length:.2f} m in {task.duration:g} s, at most {facts.fastest:.2f} m/s")
    _say(console, f"Payload           {task.payload:g} kg")
    _say(console, f"Start             {_start(task)}; {low:.4f} m to {high:.4f} m of the extension cylinder can be")
    _machine_report(console, task.machine)


def _machine_report(console: Console, machine: Machine) -> None:
    reach = inspection.reach(machine)
    _say(console, f"Machine           {machine.name}, joints {', '.join(machine.names)}")
    _say(console, f"Reach             {reach.radius:.2f} m, tool at most {reach.highest:.2f} m high")
    pairs = zip(machine.names, reach.pressure, strict=True)
    held = ", ".join(f"{name} {pressure / 1e6:.1f} MPa" for name, pressure in pairs if pressure > 0.0)
    _say(console, f"Held at reach     {held or 'no pressure needed'} (empty, at rest)")
    _say(console, f"Lifts at reach    {reach.capacity:.0f} kg more, with the load-sensing margin kept")
    _say(console, f"Pump efficiency   {inspection.efficiency(machine)}")
    for doubt in inspection.doubts(machine):
        _say(console, f"Doubtful          {doubt}", "yellow")
    console.print()
    table = _table("Values", "count", numbers=1)
    for status, number in inspection.count(machine).items():
        _row(table, status, str(number))
    console.print(table)
    entries = [entry for entry in machine.provenance if entry.status in ("assumed", "unstated")]
    if entries:
        console.print()
        table = _table("Assumed or unstated", "value", "why")
        for entry in entries:
            _row(table, entry.key, entry.value, entry.note if entry.status == "assumed" else "unstated")
        console.print(table)
    console.print()


def _heading(console: Console, name: str, description: str) -> None:
    _say(console, shortened(name, 80), "bold")
    if description:
        console.print(Text(shortened(description, 1000)))
    console.print()
