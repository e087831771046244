"""The command line as tests call it."""

from __future__ import annotations

import re

from typer.testing import CliRunner

from leanboom.cli import app


def leanboom(*arguments):
    """Run the command line as a shell would, on a wide terminal."""
    return CliRunner().invoke(app.app, arguments, env={"COLUMNS": "160", "TERM": "dumb", "NO_COLOR": "1"})


def words(text):
    return " ".join(re.sub(r"[│╭╮╰╯─]", " ", text).split())
