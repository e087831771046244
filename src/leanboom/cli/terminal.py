"""Shared parts of the commands: options, progress, messages and JSON."""

from __future__ import annotations

import re
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Annotated, Any, Literal, NoReturn

import typer

from leanboom.errors import InputError, LeanboomError
from leanboom.methods import registry

PATIENCE = 1.0  # [s], a command that takes longer says what it does
INTERVAL = 10.0  # [s], at least, between two lines about one beginning


def bundled(*kinds: str) -> Callable[[str], list[str]]:
    """Shell completion of the bundled names of some kinds.

    Where none fits, the shell goes on with the names of files.
    """

    def complete(incomplete: str) -> list[str]:
        from leanboom.io import loading

        names = {
            "machine": loading.bundled_machines,
            "task": loading.bundled_tasks,
            "library": loading.bundled_libraries,
        }
        return [name for kind in kinds for name in names[kind]() if name.startswith(incomplete)]

    return complete


Task = Annotated[
    str,
    typer.Argument(
        metavar="TASK",
        help="A bundled task (see: leanboom tasks) or a task file.",
        autocompletion=bundled("task"),
    ),
]
Pump = Annotated[Literal["ls", "cp"], typer.Option(help="Whose energy counts: load-sensing or constant-pressure pump.")]
Start = Annotated[
    str | None,
    typer.Option(
        metavar="WHERE",
        help="Where the extension starts: smallest, middle, best, or a length such as '0.45 m'. "
        "By default what the task says.",
    ),
]
End = Annotated[
    str | None,
    typer.Option(
        metavar="WHERE",
        help="Where the extension ends: free, same (a closed cycle), smallest, middle, or a length. "
        "By default what the task says.",
    ),
]
FlowLimit = Annotated[
    bool,
    typer.Option("--pump-flow-limit", help="Keep the flow of all cylinders within the pump's max_flow at all times."),
]
Effort = Annotated[
    str,
    typer.Option(
        metavar="|".join(registry.EFFORTS),
        autocompletion=lambda: list(registry.EFFORTS),
        help="How many ways to follow the path are looked into, and how closely; thorough also proves how far from "
        "the optimum the plan can be (up to five minutes).",
    ),
]
Step = Annotated[str, typer.Option(metavar="TIME", help="Length of a stage, in seconds.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON on standard output and nothing else.")]

GRID, STEP = "x".join(map(str, registry.GRID)), f"{registry.STEP:g}"  # as options have them

_GRID = re.compile(r"([0-9]{1,6})[xX]([0-9]{1,6})")


def settings(grid: str, step: str) -> tuple[tuple[int, int], float]:
    """The grid nodes and stage length [s] as given on the command line."""
    problems = []
    nodes = _GRID.fullmatch(grid.strip())
    if nodes is None:
        problems.append(f"grid = {grid}; must be positions x velocities, such as 201x101")
    try:
        seconds = duration("step", step)
    except InputError as error:
        seconds = 0.0
        problems.append(str(error))
    if nodes is None or problems:
        raise InputError("\n".join(problems))
    return (int(nodes[1]), int(nodes[2])), seconds


def duration(name: str, text: str) -> float:
    """A time above 0 [s] as given on the command line."""
    from leanboom.quantities.units import KINDS, parse, slip

    seconds = parse(text, KINDS["time"])
    if seconds is None or seconds <= 0.0:
        raise InputError(f"{name} = {text}; must be a time above 0, such as 0.05 or '50 ms'{slip(text, KINDS['time'])}")
    return seconds


def percent(name: str, text: str) -> float:
    """A number of per cent as given on the command line, with or without the sign."""
    from leanboom.quantities.units import KINDS, parse, slip

    number = text.strip().removesuffix("%")
    value = parse(number, KINDS["number"])
    if value is None:
        raise InputError(f"{name} = {text}; must be a number of per cent, such as 0.5{slip(number, KINDS['number'])}")
    return value


def listed(text: str) -> list[str]:
    """The parts of a list with commas."""
    return [part.strip() for part in text.split(",") if part.strip()]


def print_json(value: Any) -> None:
    """One value as JSON on standard output."""
    import json

    typer.echo(json.dumps(value, indent=2, allow_nan=False))


def complain(error: LeanboomError | str) -> None:
    """One message on standard error, without control characters of file names."""
    text = "".join(c if c.isprintable() or c == "\n" else "?" for c in str(error))
    _say(text)


def _say(text: str) -> None:
    """One message on standard error, if that can be written."""
    with suppress(OSError):
        typer.echo(f"leanboom: {text}", err=True)


class Terminated(KeyboardInterrupt):
    """Signal to end the process, as from `timeout` or a stopping container: treated as Ctrl-C."""


def _terminate(*_: object) -> NoReturn:
    raise Terminated


class Progress:
    """Progress line of a command on standard error.

    A terminal gets a bar. Elsewhere a line now and then tells of a beginning that takes long, such as the first
    compilation, or each step has a line. Meanwhile Ctrl-C raises KeyboardInterrupt, and a request to
    end `Terminated`, so that work is tidied up.
    """

    def __init__(self, steps: bool = False) -> None:
        self._steps = steps
        self._bar: Any = None
        self._over: Any = None  # event that ends the lines of a beginning
        self._beginning = ""  # what the next line will say

    def __enter__(self) -> Progress:
        self._handler = signal.getsignal(signal.SIGINT)
        if callable(self._handler):  # else it is ignored, or not Python's
            signal.signal(signal.SIGINT, signal.default_int_handler)
        self._ended_at_once = signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
        if self._ended_at_once:
            signal.signal(signal.SIGTERM, _terminate)
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

            columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
            self._bar = Progress(*columns, console=Console(stderr=True), transient=True)
            self._bar.start()
            self._task = self._bar.add_task("starting", total=1.0)
        return self

    def __call__(self, text: str, fraction: float) -> None:
        """Show the present activity and the share done."""
        if self._bar is not None:
            self._bar.update(self._task, description=text, completed=fraction)
            return
        if self._steps:
            _say(text)
        elif fraction == 0.0:
            self._beginning = text
            if self._over is None:
                from threading import Event, Thread

                self._over = Event()
                Thread(target=self._go_on, args=(self._over,), daemon=True).start()
        else:
            self._quiet()

    def _go_on(self, over: Any) -> None:
        """Repeat the activity every few seconds until the first share is reported."""
        wait = PATIENCE
        while not over.wait(wait):
            _say(self._beginning)
            wait = INTERVAL

    def __exit__(self, *_: object) -> None:
        self._quiet()
        if self._bar is not None:
            self._bar.stop()
        if callable(self._handler):
            signal.signal(signal.SIGINT, self._handler)
        if self._ended_at_once:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)

    def _quiet(self) -> None:
        if self._over is not None:
            self._over.set()
            self._over = None
