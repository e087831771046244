"""The commands about machine and task files: `new`, `schema`, `check`, `machines`, `tasks`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from leanboom.cli.terminal import Json, bundled, complain, print_json


def new(
    kind: Annotated[Literal["machine", "task"], typer.Argument(help="What the file is to describe.")],
    path: Annotated[
        Path | None, typer.Argument(metavar="FILE", help="Where to write it; by default to standard output.")
    ] = None,
) -> None:
    """Write a machine or task file to begin with, every key explained."""
    from leanboom.io import starter

    if path is None:
        typer.echo(starter.text(kind), nl=False)
        return
    starter.write(kind, path)
    typer.echo(f"Written: {path}; check it with: leanboom check {path}")


def schema(
    kind: Annotated[Literal["machine", "task"], typer.Argument(help="What the files describe.")],
) -> None:
    """Print the JSON schema of machine or task files, for editors that complete and check keys."""
    from leanboom.io import loading

    print_json(loading.json_schema(kind))


def check(
    names: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE",
            help="Machine or task files, or names of bundled ones.",
            autocompletion=bundled("machine", "task"),
        ),
    ],
    as_json: Json = False,
) -> None:
    """Check machine and task files; say where their values come from."""
    from leanboom.cli import machine_tables
    from leanboom.cli.console import output
    from leanboom.report import facts

    console, told = output(), []
    found = []
    for name in names:
        found.append(facts.check(name))
        if not as_json:
            machine_tables.checked(console, found[-1], found[-1].machine in told)
        if found[-1].error is None:
            told.append(found[-1].machine)
        else:
            complain(found[-1].complaint)
    if as_json:
        print_json([each.json() for each in found])
    code = max((each.error.exit_code for each in found if each.error is not None), default=0)
    if code:
        raise typer.Exit(code)


def machines(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME",
            help="A bundled machine or a machine file to show in detail.",
            autocompletion=bundled("machine"),
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """List the bundled machines, or show one in detail."""
    from leanboom.cli import machine_tables
    from leanboom.cli.console import output
    from leanboom.io import loading

    names = loading.bundled_machines() if name is None else (name,)
    found = [loading.load_machine(each) for each in names]
    if as_json:
        rows = [machine_tables.machine_facts(machine) for machine in found]
        print_json(rows if name is None else rows[0])
    elif name is None:
        machine_tables.machine_list(output(), found)
    else:
        machine_tables.machine_detail(output(), found[0])


def tasks(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME",
            help="A bundled task or a task file to show in detail.",
            autocompletion=bundled("task"),
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """List the bundled tasks, or show one in detail."""
    from leanboom.cli import machine_tables
    from leanboom.cli.console import output
    from leanboom.io import loading

    names = loading.bundled_tasks() if name is None else (name,)
    found = [loading.load_task(each) for each in names]
    if as_json:
        rows = [machine_tables.task_facts(task) for task in found]
        print_json(rows if name is None else rows[0])
    elif name is None:
        machine_tables.task_list(output(), found)
    else:
        machine_tables.task_detail(output(), found[0])
