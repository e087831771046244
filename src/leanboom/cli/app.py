"""The command line: planning, certificates, simulation, studies, files.

Results go to standard output, for people as tables and with `--json` as one object and nothing else; progress and
problems go to standard error. Exit codes: 0 done, 1 no feasible motion, 2 bad input, 130 interrupted, 143 ended on
request. Whatever a command needs is imported when it runs, so that help comes at once.
"""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption

from leanboom.cli.files import check, machines, new, schema, tasks
from leanboom.cli.identify import identify
from leanboom.cli.library import commands as library_commands
from leanboom.cli.planning import certify, plan, simulate
from leanboom.cli.studies import compare, pareto, reproduce
from leanboom.cli.terminal import Terminated, complain
from leanboom.errors import LeanboomError

INTERRUPTED, TERMINATED = 130, 143  # exit codes of a process ended by Ctrl-C, and by a request to end


class _Guarded(TyperGroup):
    """Commands whose refusals end as one message and an exit code, never as a traceback."""

    def make_context(self, *args: Any, **settings: Any) -> Any:
        with _refusals():  # of help and version, which are printed while options are read
            return super().make_context(*args, **settings)

    def invoke(self, ctx: Any) -> Any:
        with _refusals():
            return super().invoke(ctx)


@contextmanager
def _refusals() -> Iterator[None]:
    """Context in which refusals end as a message and an exit code."""
    try:
        yield
    except LeanboomError as error:
        complain(error)
        raise typer.Exit(error.exit_code) from None
    except Terminated:
        complain("ended on request")
        raise typer.Exit(TERMINATED) from None
    except KeyboardInterrupt:
        complain("interrupted")
        raise typer.Exit(INTERRUPTED) from None
    except OSError as error:  # what becomes of folders and files is said where they are used
        raise _unwritten(error.filename, error.strerror or str(error)) from None
    except SystemExit as end:
        if end.code != 1:
            raise
        # Rich's answer to a closed pipe.
        raise _unwritten(None, os.strerror(errno.EPIPE)) from None


def _unwritten(file: str | None, reason: str) -> typer.Exit:
    """The exit of a command whose results cannot be written, its message printed."""
    complain(f"{file or 'standard output'}: cannot be written: {reason}")
    with suppress(OSError, ValueError):  # of an output that is no file
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or Python would try again in the end
    return typer.Exit(LeanboomError.exit_code)


app = typer.Typer(
    cls=_Guarded,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> NoReturn:
    """Run the command line and end the process with its exit code."""
    try:
        sys.exit(app(prog_name="leanboom"))
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


class _Listing(TyperCommand):
    """A command whose help lists the names of a registry, also those of other packages."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        from leanboom.methods.registry import METHODS
        from leanboom.simulation.registry import CONTROLLERS

        lists = {
            "{methods}": lambda: METHODS.names()[1:],
            "{slow}": lambda: [name for name in METHODS.own if METHODS.find(name).slow],
            "{controllers}": CONTROLLERS.names,
        }
        for option in self.params:
            for hole, names in lists.items():  # what installed packages bring takes a while to find
                if isinstance(option, TyperOption) and option.help and hole in option.help:
                    option.help = option.help.replace(hole, ", ".join(names()))
        super().format_help(ctx, formatter)


for _command in (plan, certify, simulate, compare, pareto, reproduce, identify, new, schema, check, machines, tasks):
    app.command(cls=_Listing)(_command)
app.add_typer(library_commands, name="library")
