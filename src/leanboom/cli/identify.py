"""The command that makes a machine file out of logs: `identify`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from leanboom.cli.terminal import Json, Progress, complain, print_json


def identify(
    logs: Annotated[
        list[Path] | None, typer.Argument(metavar="LOG", help="Logs of the machine: .csv, .mat, .mf4 or .mcap.")
    ] = None,
    machine: Annotated[
        str,
        typer.Option(metavar="DRAFT", help="Machine file with what drawings and data sheet say, or a bundled name."),
    ] = "",
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write the machine file here, its report (.html) and feed-forward tables (.csv) beside it; with "
            "--excitation, the folder of the task files.",
        ),
    ] = None,
    columns: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Column map: a YAML file of channels and the columns they stand in."),
    ] = None,
    cutoff: Annotated[
        str | None, typer.Option(metavar="HZ", help="Cut-off of the low pass; by default chosen from the data.")
    ] = None,
    excitation: Annotated[
        bool, typer.Option("--excitation", help="Propose test motions that make the parameters identifiable.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Identify a machine from its logs, or propose test motions for them."""
    from leanboom.errors import InputError
    from leanboom.identification.logs import channels
    from leanboom.io import loading

    if not machine:
        raise InputError("machine = nothing; give a draft with --machine, such as one begun with: leanboom new machine")
    draft = loading.load_machine(machine)
    if excitation:
        _excite(draft, machine, out, as_json)
        return
    from leanboom.identification.identify import identify as run
    from leanboom.io import folders
    from leanboom.quantities.units import KINDS, parse
    from leanboom.report.identification import page as identification_page

    named = {} if columns is None else channels.read_map(columns, draft)
    frequency = None
    if cutoff is not None:
        frequency = parse(cutoff, KINDS["frequency"])
        if frequency is None or frequency <= 0.0:
            raise InputError(f"cutoff = {cutoff}; must be a frequency above 0, such as 5 or '5 Hz'")
    if out is not None and out.suffix not in (".yaml", ".yml"):
        raise InputError(f"out = {out}; must be a file that ends in .yaml")
    with Progress() as tell:
        found = run(logs or [], draft, columns=named, cutoff=frequency, progress=tell)
        if out is not None:
            tell("writing", 1.0)
            with folders.opened(out.parent):
                folders.write(out.parent, identification_page.files(found, out))
    for finding in found.findings:
        complain(finding.text)
    if as_json:
        print_json(found.json(out))
    else:
        from leanboom.cli import result_tables
        from leanboom.cli.console import output

        result_tables.identified(output(), found, out)


def _excite(draft, name: str, out: Path | None, as_json: bool) -> None:
    """Test motions as task files."""
    from leanboom.identification import excitation
    from leanboom.io import folders

    with Progress() as tell:
        found = excitation.propose(draft, progress=tell)
        if out is not None:
            with folders.opened(out):
                given = Path(name)
                reference = str(given.resolve()) if given.is_file() else name
                folders.write(out, excitation.files(found, reference))
    if as_json:
        print_json(found.json(out))
        return
    typer.echo(
        f"Condition number of the base parameters: {found.before:.3g} with an ordinary motion "
        f"(rank {found.rank_before}), "
        f"{found.after:.3g} with the test motions (rank {found.rank_after} of {found.wanted})."
    )
    for task, length in zip(found.tasks, found.starts, strict=True):
        typer.echo(f"{task.name}: {task.duration:g} s, extension starts at {length:.3f} m")
    if out is not None:
        typer.echo(f"Task files: {out}")
