"""Tables of machines and tasks; units in every heading."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi
from typing import TYPE_CHECKING, Any

from rich.text import Text

from leanboom.cli.console import add_row, length, new_table, say, show
from leanboom.components import pump_power
from leanboom.components.pumps import EfficiencyMap
from leanboom.io.yaml_source import shortened
from leanboom.model.task import Lines, Retimed, Spline, Task, written
from leanboom.report import facts

if TYPE_CHECKING:
    from rich.console import Console

    from leanboom.components.pumps import Pump
    from leanboom.model.machine import Machine


def machine_facts(machine: Machine) -> dict[str, Any]:
    """A machine as `machines --json` prints it, in SI units.

    Args:
        machine: The machine.
    """
    reach = facts.reach(machine)
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
        "values": facts.count(machine),
    }


def _efficiency(pump: Pump) -> Any:
    """The constant efficiency, or a map and its fit, as JSON."""
    if not isinstance(pump.efficiency, EfficiencyMap):
        return pump.efficiency
    met = pump_power.fit(pump.efficiency)
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
    if task.legs:
        legs = [
            {"payload_kg": leg.payload, "dwell_s": leg.dwell, **_path_facts(written(task, leg)),
             "duration": list(leg.duration) if isinstance(leg.duration, tuple) else leg.duration, "timing": leg.timing}
            for leg in task.legs
        ]  # fmt: skip
        moved = {"legs": legs, "total_s": task.total, "time_price_w": task.time_price}
    else:
        moved = {"payload_kg": task.payload, **_path_facts(written(task))}
    return {
        "name": task.name,
        "machine": task.machine.name,
        **moved,
        "duration_s": task.duration,
        "start": task.start,
        "end": task.end,
        "smooth_hz": task.smooth,
        "limits": {"pump_flow": task.limits.pump_flow},
    }


def _path_facts(path: Lines | Spline | Retimed) -> dict[str, Any]:
    """A path as it is written, in SI units."""
    if isinstance(path, Retimed):
        timing, shape = {"path": "retimed", "times_s": _passed(path)}, path.path
    elif isinstance(path, Spline):
        timing, shape = {"path": "spline", "times_s": list(path.times)}, path
    else:
        timing, shape = {"path": "lines", "durations_s": list(path.durations)}, path
    return {**timing, "points_m": [list(point) for point in shape.points]}


def machine_list(console: Console, machines: Sequence[Machine]) -> None:
    """Print the machines, a line each.

    Args:
        console: Where to print.
        machines: The machines.
    """
    table = new_table("Machine", "Joints", "reach\nm", "pump", "assumed\nvalues", numbers=3)
    for machine in machines:
        counts, total = facts.count(machine), len(machine.provenance)
        pump = f"{machine.pump.max_pressure / 1e6:g} MPa, {machine.pump.max_flow * 6e4:.0f} l/min"
        reach = f"{facts.reach(machine).radius:.2f}"
        add_row(table, machine.name, ", ".join(machine.names), reach, pump, f"{counts['assumed']} of {total}")
    show(console, table)
    say(console, "\nDetails: leanboom machines NAME; where values come from: leanboom check NAME")


def machine_detail(console: Console, machine: Machine) -> None:
    """Print a machine's joints, cylinders, bodies and pump.

    Args:
        console: Where to print.
        machine: The machine.
    """
    _heading(console, machine.name, machine.description)
    reach, pump, g = facts.reach(machine), machine.pump, machine.geometry
    say(console, f"Lengths   boom {g.boom:g} m, offset {g.offset:g} m, outer boom {g.outer:g} m")
    say(console, f"Reach     {reach.radius:.2f} m, tool at most {reach.highest:.2f} m high")
    say(
        console,
        f"Pump      at most {pump.max_pressure / 1e6:g} MPa and {pump.max_flow * 6e4:.0f} l/min, load-sensing margin "
        f"{pump.ls_margin / 1e6:g} MPa, constant pressure {pump.constant_pressure / 1e6:g} MPa",
    )
    say(console, f"Drive     efficiency {facts.efficiency(machine)}")
    console.print()
    table = new_table(
        "Joint", "Connection", "range", "areas\ncm^2", "stroke\nm", "limit\nm/s", "limit\nm/s^2", numbers=5
    )
    for joint, cylinder in zip(machine.joints, machine.cylinders, strict=True):
        scale, unit = (1.0, "m") if joint.name == "extension" else (180.0 / pi, "deg")
        add_row(
            table,
            joint.name,
            cylinder.connection.value.replace("_", " "),
            f"{joint.lower * scale:.4g} .. {joint.upper * scale:.4g} {unit}",
            f"{cylinder.piston_area * 1e4:.2f} / {cylinder.rod_side_area * 1e4:.2f}",
            f"{cylinder.stroke:.3f}",
            f"{cylinder.velocity_limit:g}",
            f"{cylinder.acceleration_limit:g}",
        )
    show(console, table)
    console.print()
    table = new_table("Body", "Moves with", "mass\nkg", numbers=1)
    for body in machine.bodies:
        share = f" and {body.extension_share:g} of the extension" if body.extension_share else ""
        add_row(table, body.name, f"{body.carrier}{share}", f"{body.mass:g}")
    show(console, table)
    console.print()
    say(console, f"{facts.assumed(machine)} (leanboom check lists them).")


def _passed(path: Lines | Spline | Retimed) -> list[float]:
    """Times at which a path passes its points [s]."""
    if isinstance(path, Retimed):
        return [float(time) for time in path.when(path.path.breaks)]
    return list(path.times) if isinstance(path, Spline) else [sum(path.durations[:i]) for i in range(len(path.points))]


def task_list(console: Console, tasks: Sequence[Task]) -> None:
    """Print the tasks, a line each.

    Args:
        console: Where to print.
        tasks: The tasks.
    """
    table = new_table("Task", "Machine", "Path", "Start", "payload\nkg", "time\ns", numbers=2)
    for task in tasks:
        path = f"{len(task.legs)} legs" if task.legs else _said(written(task))
        add_row(
            table, task.name, task.machine.name, path, _place(task.start), f"{task.payload:g}", f"{task.duration:g}"
        )
    show(console, table)
    say(console, "\nDetails: leanboom tasks NAME; plan one: leanboom plan NAME --out DIR")


def task_detail(console: Console, task: Task) -> None:
    """Print a task's path, point by point.

    Args:
        console: Where to print.
        task: The task.
    """
    _heading(console, task.name, "")
    say(console, f"Machine   {task.machine.name}")
    say(console, f"Start     {_place(task.start)}")
    if task.end != "free":
        say(console, f"End       {_place(task.end)}")
    if not task.legs:
        if task.timing != "fixed":
            say(console, f"Timing    {task.timing}")
        _path_detail(console, written(task), task.payload, f"{task.duration:g} s")
        return
    say(console, f"Time      {task.duration:g} s with waiting, as written")
    if task.total is not None:
        say(console, f"Total     {task.total:g} s, shared among the legs")
    if task.time_price is not None:
        say(console, f"Price     {1e-3 * task.time_price:g} kW for the time that legs take")
    for i, leg in enumerate(task.legs, 1):
        waits = f" after waiting {leg.dwell:g} s" if leg.dwell else ""
        say(console, f"\nLeg {i}{waits}", "bold")
        if leg.timing != "fixed":
            say(console, f"Timing    {leg.timing}")
        asked = leg.duration
        chosen = f"{asked[0]:g} s to {asked[1]:g} s" if isinstance(asked, tuple) else asked
        time = f"{leg.timed.duration:g} s" if asked is None or isinstance(asked, float) else f"{chosen}, to be chosen"
        _path_detail(console, written(task, leg), leg.payload, time)


def _said(path: Lines | Spline | Retimed) -> str:
    """A path's kind and number of points."""
    shape = path.path if isinstance(path, Retimed) else path
    return f"{'spline' if isinstance(shape, Spline) else 'lines'}, {len(shape.points)} points"


def _path_detail(console: Console, path: Lines | Spline | Retimed, payload: float, lasts: str) -> None:
    """Print a path, point by point, with what hangs at the tool and how long it takes."""
    times = _passed(path)
    shape, own = (path.path, ", retimed") if isinstance(path, Retimed) else (path, "")
    kind = "clamped cubic spline" if isinstance(shape, Spline) else "straight lines, at rest at every point"
    say(console, f"Payload   {payload:g} kg")
    say(console, f"Path      {kind}{own}, {lasts}")
    console.print()
    table = new_table("time\ns", "x\nm", "y\nm", "z\nm", numbers=4)
    for time, point in zip(times, shape.points, strict=True):
        add_row(table, f"{time:g}", *(f"{value:g}" for value in point))
    show(console, table)


def checked(console: Console, found: facts.Checked, known: bool) -> None:
    """Print the checks of a machine, or of a task and its machine; nothing for a file with problems.

    Args:
        console: Where to print.
        found: What the look at the file found.
        known: Whether the machine was told of before.
    """
    if found.error is not None or found.found is None or found.machine is None:
        return
    name = shortened(found.found.name, 80)
    say(console, f"{shortened(found.file, 200)}: {found.kind} {name} is right.", "bold")
    if isinstance(found.found, Task) and found.path is not None:
        _path_report(console, found.found, found.path)
    if known:
        say(console, f"Machine           {found.machine.name}, as above\n")
    else:
        _machine_report(console, found.machine)


def _path_report(console: Console, task: Task, path: facts.PathFacts) -> None:
    low, high = path.start
    timing = {
        "fixed": f"in {task.duration:g} s, at most {path.fastest:.3g} m/s",
        "free": f"in {task.duration:g} s, its speed to be planned",
        "shortest": "in the shortest time, to be planned",
    }
    say(console, f"Path              {path.length:.2f} m {timing[task.timing]}")
    loads = [f"{leg.payload:g} kg" for leg in task.legs] or [f"{task.payload:g} kg"]
    say(console, f"Payload           {', '.join(loads)}")
    say(
        console, f"Start             {_place(task.start)}; {low:.4f} m to {high:.4f} m of the extension cylinder can be"
    )
    for note in path.notes:
        say(console, f"Note              {note}")


def _machine_report(console: Console, machine: Machine) -> None:
    reach = facts.reach(machine)
    say(console, f"Machine           {machine.name}, joints {', '.join(machine.names)}")
    say(console, f"Reach             {reach.radius:.2f} m, tool at most {reach.highest:.2f} m high")
    pairs = zip(machine.names, reach.pressure, strict=True)
    held = ", ".join(f"{name} {pressure / 1e6:.1f} MPa" for name, pressure in pairs if pressure > 0.0)
    say(console, f"Held at reach     {held or 'no pressure needed'} (empty, at rest)")
    say(console, f"Lifts at reach    {reach.capacity:.0f} kg more, with the load-sensing margin kept")
    say(console, f"Pump efficiency   {facts.efficiency(machine)}")
    for doubt in facts.doubts(machine):
        say(console, f"Doubtful          {doubt}", "yellow")
    console.print()
    table = new_table("Values", "count", numbers=1)
    for status, number in facts.count(machine).items():
        add_row(table, status, str(number))
    show(console, table)
    entries = [entry for entry in machine.provenance if entry.status in ("assumed", "unstated")]
    if entries:
        console.print()
        table = new_table("Assumed or unstated", "value", "why")
        for entry in entries:
            add_row(table, entry.key, entry.value, entry.note if entry.status == "assumed" else "unstated")
        show(console, table)
    console.print()


def _heading(console: Console, name: str, description: str) -> None:
    say(console, shortened(name, 80), "bold")
    if description:
        console.print(Text(shortened(description, 1000)))
    console.print()


def _place(place: str | float) -> str:
    return place if isinstance(place, str) else length(place)
