"""The command line: `leanboom plan`, `certify`, `simulate`, `compare`, `reproduce`, `check`, `machines`, `tasks`.

Results go to standard output, for people as tables and with `--json` as one object and nothing else; progress and
problems go to standard error. Exit codes: 0 done, 1 no feasible motion, 2 bad input, 130 interrupted. Whatever a
command needs is imported when it runs, so that help comes at once.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn

import typer
from typer.core import TyperGroup

from leanboom.errors import InfeasibleError, InputError, LeanboomError

INTERRUPTED = 130  # exit code of a process ended by Ctrl-C
PATIENCE = 1.0  # [s], a command that takes longer says what it does

_GRID = re.compile(r"(\d{1,6})[xX](\d{1,6})")


class _Guarded(TyperGroup):
    """Commands whose refusals end as one message and an exit code, never as a traceback."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except LeanboomError as error:
            _complain(error)
            raise typer.Exit(error.exit_code) from None
        except KeyboardInterrupt:
            _complain("interrupted")
            raise typer.Exit(INTERRUPTED) from None


app = typer.Typer(
    cls=_Guarded,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

Json = Annotated[bool, typer.Option("--json", help="Print JSON on standard output and nothing else.")]


def main() -> NoReturn:
    """Run the command line and end the process with its exit code."""
    try:
        sys.exit(app())
    except KeyboardInterrupt:  # before or after a command
        sys.exit(INTERRUPTED)


def _version(wanted: bool) -> None:
    if wanted:
        from leanboom import __version__

        typer.echo(f"leanboom {__version__}")
        raise typer.Exit


@app.callback()
def _leanboom(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Energy-optimal motion planning for redundant hydraulic cranes."""


@app.command()
def plan(
    task: Annotated[str, typer.Argument(metavar="TASK", help="A bundled task (see: leanboom tasks) or a task file.")],
    pump: Annotated[
        Literal["ls", "cp"], typer.Option(help="Whose energy counts: load-sensing or constant-pressure pump.")
    ] = "ls",
    cost: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="What to minimise, if not the pump's energy: ls, cp, actuator, velocity, extension, recuperation.",
        ),
    ] = None,
    method: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="dp (the planner), polish, pseudospectral, shooting, dp-paper, dp1, sns-joint, sns-actuator, "
            "sns-actuator-weighted.",
        ),
    ] = "dp",
    start: Annotated[
        str | None,
        typer.Option(
            metavar="WHERE",
            help="Where the extension starts: smallest, middle, best, or a length such as '0.45 m'. "
            "By default what the task says.",
        ),
    ] = None,
    grid: Annotated[
        str, typer.Option(metavar="PxV", help="Positions and velocities of the extension on the coarse grid.")
    ] = "141x71",
    step: Annotated[str, typer.Option(metavar="TIME", help="Length of a stage, in seconds.")] = "0.05",
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Write a run folder: report, trajectory, task, machine and summary."),
    ] = None,
    certified: Annotated[
        bool,
        typer.Option("--certify", help="Prove how far from the optimum the plan can be (a minute; see certify)."),
    ] = False,
    as_json: Json = False,
) -> None:
    """Plan the motion that takes the least pump energy."""
    nodes, seconds = _settings(grid, step)
    from leanboom import files, runfolder

    if out is not None:
        runfolder.check(out)
    asked = files.load_task(task, start=start)
    from leanboom import planner

    with _Progress() as tell:
        result = planner.run(asked, pump=pump, cost=cost, method=method, grid=nodes, step=seconds, progress=tell)
        if out is not None:
            tell("writing the run folder", 1.0)
            runfolder.write(result, out, nodes)
        proof = None
        if certified and result.evaluation.feasible:
            from leanboom import certificate

            proof = certificate.certify(asked, pump, motion=result.motion, step=seconds, progress=tell)
    if as_json:
        _print_json(runfolder.summary(result, out) | ({} if proof is None else proof.json()))
    else:
        from leanboom import tables

        source = asked.machine.name if task in files.bundled_tasks() else task
        tables.plan(tables.output(), result, out, source)
        if proof is not None:
            from leanboom import proofs

            proofs.certificate(tables.output(), proof)
    if not result.evaluation.feasible:
        _complain(result.evaluation.status)
        raise typer.Exit(1)


@app.command()
def certify(
    task: Annotated[str, typer.Argument(metavar="TASK", help="A bundled task (see: leanboom tasks) or a task file.")],
    pump: Annotated[
        Literal["ls", "cp"], typer.Option(help="Whose energy counts: load-sensing or constant-pressure pump.")
    ] = "ls",
    start: Annotated[
        str | None,
        typer.Option(
            metavar="WHERE",
            help="Where the extension starts: smallest, middle, best, or a length such as '0.45 m'. "
            "By default what the task says.",
        ),
    ] = None,
    step: Annotated[str, typer.Option(metavar="TIME", help="Length of a stage, in seconds.")] = "0.05",
    seconds: Annotated[str, typer.Option(metavar="TIME", help="Time for bounding; planning comes on top.")] = "60 s",
    gap: Annotated[float, typer.Option(metavar="PERCENT", help="Gap at which bounding ends.")] = 0.5,
    as_json: Json = False,
) -> None:
    """Plan a task and prove how far from the optimum the plan can be."""
    _, stage = _settings("141x71", step)
    from leanboom import certificate, files, planner, runfolder

    limit = _time("seconds", seconds)
    certificate.check(pump, stage, limit, gap)
    asked = files.load_task(task, start=start)
    with _Progress() as tell:
        result = planner.run(asked, pump=pump, step=stage, baseline=False, progress=tell)
        if not result.evaluation.feasible:
            raise InfeasibleError(result.evaluation.status)
        proof = certificate.certify(
            asked, pump, motion=result.motion, step=stage, seconds=limit, gap=gap, progress=tell
        )
    if as_json:
        _print_json(runfolder.summary(result) | proof.json())
    else:
        from leanboom import proofs, tables

        proofs.certificate(tables.output(), proof)


@app.command()
def simulate(
    task: Annotated[
        str, typer.Argument(metavar="TASK|RUN", help="A bundled task, a task file, or the run folder of a plan.")
    ],
    pump: Annotated[
        str | None, typer.Option(help="ls or cp. By default that of the run folder; of a task, ls.")
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="How a task is planned first: a method of `leanboom plan`; by default dp."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Write a run folder with the simulation. By default a RUN gets it added."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Drive a plan in closed loop: pump, valves, oil and controller."""
    from leanboom import files, planner, runfolder, simulation, simulation_page

    if pump not in (None, *simulation.PUMPS):
        raise InputError(f"pump = {pump}; must be one of {', '.join(simulation.PUMPS)}")
    run = Path(task) if task not in files.bundled_tasks() and Path(task).is_dir() else None
    if run is not None and method is not None:
        raise InputError(f"method = {method}; the run folder {task} is planned already: leave --method out")
    if out is not None:
        runfolder.check(out)
    with _Progress() as tell:
        if run is None:
            asked = files.load_task(task)
            plan = planner.run(asked, pump=pump or "ls", method=method or "dp", progress=tell)
            result = simulation.simulate(asked, plan.motion, plan.pump, progress=tell)
            if out is not None:
                tell("writing the run folder", 1.0)
                runfolder.write(plan, out, simulation=result)
        else:
            asked, motion, planned_for = runfolder.read(run)
            result = simulation.simulate(asked, motion, pump or planned_for, progress=tell)
            out = out or run
            tell("writing the run folder", 1.0)
            runfolder.add(run, out, result)
    if as_json:
        _print_json(simulation_page.summary(result, out))
    else:
        from leanboom import tables

        tables.simulation(tables.output(), result, out)
    if not result.complete:
        _complain(result.status)
        raise typer.Exit(1)


@app.command()
def compare(
    task: Annotated[str, typer.Argument(metavar="TASK", help="A bundled task (see: leanboom tasks) or a task file.")],
    pump: Annotated[str, typer.Option(metavar="NAMES", help="Whose energy counts: ls, cp or ls,cp.")] = "ls,cp",
    start: Annotated[
        str | None,
        typer.Option(
            metavar="WHERE",
            help="Where the extension starts, one or more: smallest, middle, best, or lengths such as '0.45 m'. "
            "By default what the task says.",
        ),
    ] = None,
    methods: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="Some of dp, polish, pseudospectral, shooting, dp1, dp-paper, sns-joint, sns-actuator, "
            "sns-actuator-weighted; dp:cp is dp with that minimised cost alone. By default all but dp-paper, which "
            "takes minutes.",
        ),
    ] = None,
    simulate: Annotated[
        bool, typer.Option("--simulate", help="Also drive every motion in closed loop, for a column of its own.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Write the rows, a bar chart and the motions laid over each other."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Compare the methods of the papers on a task."""
    from leanboom import comparison, files, results

    pumps = _listed(pump)
    chosen = None if methods is None else _listed(methods)
    comparison.entries(chosen, pumps)
    if out is not None:
        results.check(out)
    asked = files.load_task(task)
    starts = None if start is None else [files.load_task(task, start=each).start for each in _listed(start)]
    with _Progress(steps=True) as tell:
        result = comparison.compare(asked, pumps, start=starts, methods=chosen, simulate=simulate, progress=tell)
        if out is not None:
            tell("drawing", 1.0)
            results.write_comparison(result, out)
    if as_json:
        _print_json(result.json())
    else:
        from leanboom import tables

        tables.comparison(tables.output(), result, out)
    if not any(row.feasible for row in result.rows):
        _complain("no method found a feasible motion")
        raise typer.Exit(1)


@app.command()
def reproduce(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAME...]",
            help="all, or some of table2, table3, fig8, fig10, sizing, horizontal, vertical, half-cycle, tracking, "
            "sensitivity.",
        ),
    ] = None,
    out: Annotated[
        Path,
        typer.Option(metavar="DIR", help="Where solutions are kept: an interrupted run goes on from there."),
    ] = Path("leanboom-reproduce"),
    docs: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write the page of results and its figures there, not to --out.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Solve the papers' experiments again; print our values beside the printed ones."""
    from leanboom import reproduction, results

    wanted = reproduction.names(names or [])
    with _Progress(steps=True) as tell:
        result = reproduction.reproduce(wanted, out, progress=tell)
        tell("writing the page", 1.0)
        page = results.write_page(result, out if docs is None else docs)
    if as_json:
        _print_json(result.json())
    else:
        from leanboom import tables

        titles = {name: experiment.title for name, experiment in reproduction.EXPERIMENTS.items()}
        tables.reproduction(tables.output(), result, titles)
        typer.echo(f"Page and figures: {page}")


@app.command()
def check(
    names: Annotated[
        list[str], typer.Argument(metavar="FILE...", help="Machine or task files, or names of bundled ones.")
    ],
) -> None:
    """Check machine and task files; say where their values come from."""
    from leanboom import inspection, tables
    from leanboom.machine import Machine

    console = tables.output()
    code = 0
    for name in names:
        try:
            found = inspection.load(name)
            tables.checked_machine(console, name, found) if isinstance(found, Machine) else tables.checked_task(
                console, name, found
            )
        except LeanboomError as error:
            _complain(error)
            code = max(code, error.exit_code)
    if code:
        raise typer.Exit(code)


@app.command()
def machines(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="A bundled machine or a machine file to show in detail.")
    ] = None,
    as_json: Json = False,
) -> None:
    """List the bundled machines, or show one in detail."""
    from leanboom import files, tables

    names = files.bundled_machines() if name is None else (name,)
    found = [files.load_machine(each) for each in names]
    if as_json:
        rows = [tables.machine_facts(machine) for machine in found]
        _print_json(rows if name is None else rows[0])
    elif name is None:
        tables.machine_list(tables.output(), found)
    else:
        tables.machine_detail(tables.output(), found[0])


@app.command()
def tasks(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="A bundled task or a task file to show in detail.")
    ] = None,
    as_json: Json = False,
) -> None:
    """List the bundled tasks, or show one in detail."""
    from leanboom import files, tables

    names = files.bundled_tasks() if name is None else (name,)
    found = [files.load_task(each) for each in names]
    if as_json:
        rows = [tables.task_facts(task) for task in found]
        _print_json(rows if name is None else rows[0])
    elif name is None:
        tables.task_list(tables.output(), found)
    else:
        tables.task_detail(tables.output(), found[0])


def _settings(grid: str, step: str) -> tuple[tuple[int, int], float]:
    """Grid nodes and stage length [s] as given on the command line."""
    problems = []
    nodes = _GRID.fullmatch(grid.strip())
    if nodes is None:
        problems.append(f"grid = {grid}; must be positions x velocities, such as 201x101")
    try:
        seconds = _time("step", step)
    except InputError as error:
        seconds = 0.0
        problems.append(str(error))
    if nodes is None or problems:
        raise InputError("\n".join(problems))
    return (int(nodes[1]), int(nodes[2])), seconds


def _time(name: str, text: str) -> float:
    """A time above 0 [s] as given on the command line."""
    from leanboom.units import KINDS, parse

    seconds = parse(text, KINDS["time"])
    if seconds is None or seconds <= 0.0:
        raise InputError(f"{name} = {text}; must be a time above 0, such as 0.05 or '50 ms'")
    return seconds


def _listed(text: str) -> list[str]:
    """The parts of a list with commas."""
    return [part.strip() for part in text.split(",") if part.strip()]


def _print_json(value: Any) -> None:
    import json

    typer.echo(json.dumps(value, indent=2, allow_nan=False))


def _complain(error: LeanboomError | str) -> None:
    """One message on standard error, without control characters of file names."""
    text = "".join(c if c.isprintable() or c == "\n" else "?" for c in str(error))
    typer.echo(f"leanboom: {text}", err=True)


class _Progress:
    """What a command does at the moment, on standard error.

    A terminal gets a bar. Elsewhere one line tells of a beginning that takes long, such as the first compilation, or
    each step has a line.
    """

    def __init__(self, steps: bool = False) -> None:
        self._steps = steps
        self._bar: Any = None
        self._timer: Any = None

    def __enter__(self) -> _Progress:
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

            columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
            self._bar = Progress(*columns, console=Console(stderr=True), transient=True)
            self._bar.start()
            self._task = self._bar.add_task("starting", total=1.0)
        return self

    def __call__(self, text: str, fraction: float) -> None:
        """Show what happens and the share done."""
        if self._bar is not None:
            self._bar.update(self._task, description=text, completed=fraction)
            return
        self._quiet()
        if self._steps:
            typer.echo(f"leanboom: {text}", err=True)
        elif fraction == 0.0:
            from threading import Timer

            self._timer = Timer(PATIENCE, typer.echo, (f"leanboom: {text}",), {"err": True})
            self._timer.daemon = True
            self._timer.start()

    def __exit__(self, *_: object) -> None:
        self._quiet()
        if self._bar is not None:
            self._bar.stop()

    def _quiet(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
