"""Printing to a terminal: the console, lines of text and tables that fit its width."""

from __future__ import annotations

import textwrap

from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from leanboom.io.yaml_source import shortened

PIPE_WIDTH = 160  # of tables that do not go to a terminal
WORD = 14  # characters that a column of words is not made narrower than; longer words are folded
PUMPS = {"ls": "load-sensing pump", "cp": "constant-pressure pump"}


def output() -> Console:
    """The console of standard output; files and pipes get lines as long as they are."""
    console = Console(highlight=False, emoji=False)
    return console if console.is_terminal else Console(highlight=False, emoji=False, width=PIPE_WIDTH)


def say(console: Console, text: str, style: str = "") -> None:
    """One line of text, taken literally; a terminal gets it wrapped at spaces, with names and paths in one piece."""
    if console.is_terminal:
        text = "\n".join(
            textwrap.fill(line, console.width, break_long_words=False, break_on_hyphens=False, replace_whitespace=False)
            for line in text.split("\n")
        )
    console.print(Text(text, style=style), soft_wrap=True)


def new_table(*headings: str, numbers: int = 0) -> Table:
    """A table without frame, its last columns numbers; `show` prints it."""
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, show_edge=False)
    for i, heading in enumerate(headings):
        right = i >= len(headings) - numbers
        table.add_column(Text(heading), justify="right" if right else "left", overflow="fold", no_wrap=right)
    return table


def show(console: Console, table: Table) -> None:
    """Print a table in the console's width; where its numbers would not fit, a line a cell, so that none is cut."""
    cells = [[text for text in [column.header, *column.cells] if isinstance(text, Text)] for column in table.columns]
    for column, texts in zip(table.columns, cells, strict=True):
        pieces = [
            piece for text in texts for piece in (text.plain.splitlines() if column.no_wrap else text.plain.split())
        ]
        longest = max((cell_len(piece) for piece in pieces), default=0)
        column.min_width = longest if column.no_wrap else min(longest, WORD)
    if sum((column.min_width or 0) + 1 for column in table.columns) - 1 <= console.width:
        console.print(table)
        return
    headings = [" ".join(texts[0].plain.split()) for texts in cells]
    for row in zip(*(texts[1:] for texts in cells), strict=True):
        say(console, row[0].plain, "bold")
        for heading, text in zip(headings[1:], row[1:], strict=True):
            if text.plain:
                say(console, f"  {heading + ': ' if heading else ''}{text.plain}")


def add_row(table: Table, *cells: str) -> None:
    """A row of cells, taken literally and kept to a few lines each."""
    table.add_row(*(Text(shortened(cell, 300)) for cell in cells))


def length(value: float) -> str:
    """A length in metres, as tables and labels show it."""
    return f"{float(value):.4f} m"
