"""The commands of motion libraries: `library build`, `info`, `query`, `verify` and `export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from leanboom.cli.terminal import Json, Progress, bundled, complain, duration, listed, print_json
from leanboom.errors import InputError, LeanboomError

commands = typer.Typer(no_args_is_help=True, help="Build a library of motions, and look motions up in it.")

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="The folder of a library.")]
Pump = Annotated[str, typer.Option(metavar="NAME", help="Whose energy counts: ls or cp.")]


@commands.command()
def build(
    spec: Annotated[
        str,
        typer.Argument(
            metavar="SPEC",
            help="A bundled specification (forwarder-small, forwarder-work-area) or a file.",
            autocompletion=bundled("library"),
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="The library's folder: new, or one to go on with.")],
    workers: Annotated[
        int | None, typer.Option(min=1, help="Motions planned at a time; by default one a core.")
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="A Dask scheduler such as tcp://host:8786, or local, to plan with."),
    ] = None,
    most: Annotated[int | None, typer.Option(min=1, help="Motions that may be built; by default 20,000.")] = None,
    as_json: Json = False,
) -> None:
    """Plan all motions of a specification and store them; a build that was stopped goes on."""
    from leanboom import resources
    from leanboom.library import engine, specification
    from leanboom.report import library_page

    count = workers or resources.cores()
    made = specification.load(spec, count, specification.MOST if most is None else most)
    complain(f"{made.name}: {specification.expected(made.total, count)}")
    if made.unreachable:
        complain(f"{len(made.unreachable)} places are out of the crane's reach and left out")
    with Progress(steps=True) as tell:
        summary = engine.build(made, out, workers=workers, cluster=cluster, progress=tell)
        library_page.write(out, made.unreachable)
    if as_json:
        print_json(summary.json())
    else:
        typer.echo(
            f"{summary.total} motions: {summary.solved} solved, {summary.infeasible} infeasible, "
            f"{summary.failed} failed; {summary.reused} were there already. {summary.build_s:.1f} s. "
            f"Report: {out / library_page.PAGE}"
        )
    for reason, times in list(summary.reasons.items())[:10]:
        complain(f"{times} times: {reason}")
    if not summary.solved:
        raise typer.Exit(1)


@commands.command()
def info(folder: Folder, as_json: Json = False) -> None:
    """What a library holds."""
    from leanboom.library.lookup import Library
    from leanboom.library.overview import overview

    with Library(folder) as library:
        seen = overview(library.store)
    if as_json:
        print_json(seen.json())
        return
    typer.echo(
        f"{seen.name} of machine {seen.machine}: {seen.motions} motions, {seen.solved} solved, along {seen.ways} ways; "
        f"{seen.size_bytes / 1e6:.1f} MB"
    )
    typer.echo(f"durations: {', '.join(f'{each:g} s' for each in seen.durations)}")
    typer.echo(f"payloads: {', '.join(f'{each:g} kg' for each in seen.payloads)}")
    typer.echo(f"pumps: {', '.join(seen.pumps)}")
    if seen.mean_saving is not None:
        typer.echo(f"mean saving against the pseudo-inverse: {100 * seen.mean_saving:.1f} %")


@commands.command()
def query(
    folder: Folder,
    origin: Annotated[str, typer.Option("--from", metavar="X,Y,Z", help="Where the tool is [m].")],
    goal: Annotated[str, typer.Option("--to", metavar="X,Y,Z", help="Where it goes [m].")],
    max_duration: Annotated[str | None, typer.Option(metavar="TIME", help="Longest duration.")] = None,
    payload: Annotated[str, typer.Option(metavar="MASS", help="What the tool carries.")] = "0 kg",
    pump: Pump = "ls",
    extension: Annotated[
        str | None, typer.Option(metavar="LENGTH", help="Where the extension cylinder is, in its stroke.")
    ] = None,
    machine: Annotated[
        str | None, typer.Option(metavar="NAME", help="The machine that will move: refuses a library of another one.")
    ] = None,
    as_json: Json = False,
) -> None:
    """The stored motion of least energy that fits, judged; between stored places it is led over and polished."""
    from leanboom.io import loading
    from leanboom.library import carrying
    from leanboom.library.lookup import Library

    ends = _place("from", origin), _place("to", goal)
    asked = {
        "max_duration": None if max_duration is None else duration("max-duration", max_duration),
        "payload": _quantity("payload", payload, "mass"),
        "extension": None if extension is None else _quantity("extension", extension, "length"),
    }
    with Library(folder, None if machine is None else loading.load_machine(machine)) as library:
        answer = library.query(*ends, pump=pump, **asked)
        found = carrying.offer(library, answer, *ends)
        others = library.movement(*ends, pump)
    numbers = _answer(found, others)
    if as_json:
        print_json(numbers)
    else:
        _print_answer(numbers)
    if not found.solved:
        complain(str(found.evaluation.status_with(pump)))
        raise typer.Exit(1)


def _answer(found: Any, others: list) -> dict[str, Any]:
    """An answer as `--json` has it."""
    entry, moved = found.answer.entry, found.evaluation.motion
    rows = [
        {"duration_s": each.duration, "payload_kg": each.payload, "start": each.start, "energy_j": each.energy_j}
        for each in others
        if each.solved
    ]
    return {
        "key": entry.key,
        "from": list(entry.origin),
        "to": list(entry.goal),
        "apart_m": found.answer.apart_m,
        "pump": entry.pump,
        "payload_kg": entry.payload,
        "duration_s": entry.duration,
        "start_m": float(moved.position[0]),
        "end_m": float(moved.position[-1]),
        "blended_m": found.answer.blended_m,
        "polished": found.polished,
        "status": str(found.evaluation.status_with(entry.pump)),
        "energy_j": found.energy_j if found.evaluation.followed else None,
        "stored_energy_j": entry.energy_j,
        "more_than_fresh": found.more_than_fresh,
        "step_s": moved.step,
        "position_m": moved.position.tolist(),
        "velocity_m_s": moved.velocity.tolist(),
        "movement": rows,
    }


def _print_answer(numbers: dict[str, Any]) -> None:
    kept = "led over and polished" if numbers["polished"] else "as stored"
    energy = "-" if numbers["energy_j"] is None else f"{numbers['energy_j'] / 1e3:.2f} kJ"
    typer.echo(
        f"{numbers['duration_s']:g} s, {energy} ({numbers['pump']}), extension {numbers['start_m']:.3f} m -> "
        f"{numbers['end_m']:.3f} m, {kept}, {numbers['apart_m']:.3f} m from a stored way"
    )
    if numbers["more_than_fresh"] is not None:
        typer.echo(f"{100 * numbers['more_than_fresh']:+.2f} % against a fresh plan")
    typer.echo("Energy against duration along the stored way:")
    for row in numbers["movement"]:
        typer.echo(
            f"  {row['duration_s']:6.1f} s  {row['payload_kg']:6.0f} kg  start {row['start']:>8}  "
            f"{row['energy_j'] / 1e3:8.2f} kJ"
        )


@commands.command()
def verify(
    folder: Folder,
    sample: Annotated[int | None, typer.Option(min=1, help="How many motions, at random; by default all.")] = None,
    as_json: Json = False,
) -> None:
    """Judge stored motions again and look for damaged files."""
    from leanboom.library import carrying
    from leanboom.library.lookup import Library

    with Library(folder) as library:
        seen = carrying.verify(library, sample)
    numbers = {"checked": seen.checked, "wrong": list(seen.wrong), "damaged_files": list(seen.damaged)}
    if as_json:
        print_json(numbers)
    else:
        typer.echo(f"{seen.checked} motions judged: {len(seen.wrong)} wrong; {len(seen.damaged)} damaged files")
    if seen.wrong or seen.damaged:
        raise LeanboomError(f"library = {folder}; is not as it was written: build it again, which plans what is lost")


@commands.command()
def export(
    folder: Folder,
    out: Annotated[Path, typer.Option(metavar="FILE", help="A new file: .csv, a row a stage, or .parquet.")],
) -> None:
    """Write all motions into one file, with their tasks."""
    from leanboom.library.lookup import Library
    from leanboom.library.overview import export as write

    with Library(folder) as library:
        count = write(library.store, out)
    typer.echo(f"{count} motions in {out}")


def _place(name: str, text: str) -> tuple[float, float, float]:
    """Three lengths as given on the command line."""
    parts = listed(text)
    if len(parts) != 3:
        raise InputError(f"{name} = {text}; must be three lengths X,Y,Z such as 4.3,0,2.5")
    x, y, z = (_quantity(name, each, "length", negative=True) for each in parts)
    return x, y, z


def _quantity(name: str, text: str, kind: str, negative: bool = False) -> float:
    """A quantity as given on the command line, in SI units."""
    from leanboom.quantities.units import KINDS, parse, slip

    value = parse(text, KINDS[kind])
    if value is None or (value < 0.0 and not negative):
        bound = "" if negative else " from 0 on"
        raise InputError(
            f"{name} = {text}; must be a {kind}{bound}, such as {KINDS[kind].example}{slip(text, KINDS[kind])}"
        )
    return value
