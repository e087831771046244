"""What printing to a terminal takes: the console, lines of text and tables that fit its width."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from leanboom.source import shortened

PIPE_WIDTH = 160  # of tables that do not go to a terminal
PUMPS = {"ls": "load-sensing pump", "cp": "constant-pressure pump"}


def output() -> Console:
    """The console of standard output; files and pipes get lines as long as they are."""
    console = Console(highlight=False, emoji=False)
    return console if console.is_terminal else Console(highlight=False, emoji=False, width=PIPE_WIDTH)


def say(console: Console, text: str, style: str = "") -> None:
    """One line of text, taken literally and left to the terminal to wrap."""
    console.print(Text(text, style=style), soft_wrap=True)


def new_table(*headings: str, numbers: int = 0) -> Table:
    """A table without frame; its first column is kept whole, its last ones are numbers."""
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, show_edge=False)
    for i, heading in enumerate(headings):
        right = i >= len(headings) - numbers
        table.add_column(Text(heading), justify="right" if right else "left", overflow="fold", no_wrap=i == 0 or right)
    return table


def add_row(table: Table, *cells: str) -> None:
    """A row of cells, taken literally and kept to a few lines each."""
    table.add_row(*(Text(shortened(cell, 300)) for cell in cells))


def length(value: float) -> str:
    """A length in metres, as tables and labels show it."""
    return f"{float(value):.4f} m"
