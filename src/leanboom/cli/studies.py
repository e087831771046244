"""The commands that plan many tasks: `compare` the methods, `pareto` over durations, `reproduce` the papers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from leanboom.cli.terminal import (
    Effort,
    End,
    FlowLimit,
    Json,
    Progress,
    Start,
    Task,
    complain,
    duration,
    listed,
    print_json,
)


def compare(
    task: Task,
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
            help="Some of dp, {methods}; dp:cp is dp with that minimised cost alone. By default all but those that "
            "take minutes, as {slow} does.",
        ),
    ] = None,
    flow_limit: FlowLimit = False,
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
    from leanboom.io import loading
    from leanboom.report import papers_page
    from leanboom.study import comparison

    pumps = listed(pump)
    chosen = None if methods is None else listed(methods)
    comparison.entries(chosen, pumps)
    asked = loading.load_task(task, pump_flow_limit=flow_limit or None)
    starts = None if start is None else [loading.load_task(task, start=each).start for each in listed(start)]
    with Progress(steps=True) as tell, papers_page.reserved(out):
        result = comparison.compare(asked, pumps, start=starts, methods=chosen, simulate=simulate, progress=tell)
        if out is not None:
            tell("drawing", 1.0)
            papers_page.write_comparison(result, out)
    if as_json:
        print_json(result.json())
    else:
        from leanboom.cli import result_tables
        from leanboom.cli.console import output

        result_tables.comparison(output(), result, out)
    if not any(row.feasible for row in result.rows):
        complain("no method found a feasible motion")
        raise typer.Exit(1)
    for row in result.rows:
        if row.feasible and not row.solved:
            complain(f"{row.label} from {row.start}, {row.pump}: {row.status}")


def pareto(
    task: Task,
    durations: Annotated[
        str | None,
        typer.Option(
            metavar="TIMES",
            help="Durations of the path, or of a whole cycle, such as 6,8,10. By default eight, from the shortest "
            "feasible one found to 2.5 times the task's.",
        ),
    ] = None,
    pump: Annotated[str, typer.Option(metavar="NAMES", help="Whose energy counts: ls, cp or ls,cp.")] = "ls",
    start: Start = None,
    end: End = None,
    flow_limit: FlowLimit = False,
    effort: Effort = "default",
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write the points as a figure, as a table and as JSON.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Plan a task in several durations: least energy against time, the pseudo-inverse beside it."""
    from leanboom.io import loading
    from leanboom.report import papers_page
    from leanboom.study import pareto as study

    times = None if durations is None else [duration("durations", each) for each in listed(durations)]
    asked = loading.load_task(task, start=start, end=end, pump_flow_limit=flow_limit or None)
    with Progress(steps=True) as tell, papers_page.reserved(out, papers_page.PARETO):
        result = study.pareto(asked, listed(pump), durations=times, effort=effort, progress=tell)
        if out is not None:
            tell("drawing", 1.0)
            papers_page.write_pareto(result, out)
    if as_json:
        print_json(result.json())
    else:
        from leanboom.cli import result_tables
        from leanboom.cli.console import output

        result_tables.pareto(output(), result, out)
    if not any(point.solved for point in result.points):
        complain("no duration has a motion that keeps every limit and that the pump can deliver")
        raise typer.Exit(1)


def reproduce(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="NAME",
            help="all, or some of table2, table3, fig8, fig10, sizing, horizontal, vertical, half-cycle, cycles, "
            "statements, tracking, sensitivity.",
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
    from leanboom.io import folders
    from leanboom.report import papers_page
    from leanboom.study.papers import reproduction

    wanted = reproduction.names(names or [])
    page_folder = out if docs is None else docs
    with Progress(steps=True) as tell, folders.opened(out, page_folder):
        result = reproduction.reproduce(wanted, out, progress=tell)
        tell("writing the page", 1.0)
        page = papers_page.write_page(result, page_folder)
    if as_json:
        print_json(result.json())
    else:
        from leanboom.cli import result_tables
        from leanboom.cli.console import output

        titles = {name: experiment.title for name, experiment in reproduction.EXPERIMENTS.items()}
        result_tables.reproduction(output(), result, titles)
        typer.echo(f"Page and figures: {page}")
