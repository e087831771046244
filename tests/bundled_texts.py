"""Texts of bundled files, files made of texts, and what is wrong with them."""

from __future__ import annotations

from pathlib import Path

import pytest

import leanboom
from leanboom.errors import InputError
from leanboom.io.loading import bundled_tasks, load_task

PACKAGE = Path(leanboom.__file__).parent
SINGLE = tuple(name for name in bundled_tasks() if not load_task(name).legs)  # tasks with one path
FORWARDER = (PACKAGE / "data/machines/forwarder.yaml").read_text()
HALF_CYCLE = (PACKAGE / "data/tasks/forwarder-half-cycle.yaml").read_text()
TRIANGLE = (PACKAGE / "data/tasks/loader-triangle-large.yaml").read_text()


def written(folder, text, name="bad.yaml"):
    """A file with this text."""
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def edited(text, edits):
    """The text with replacements that all must apply."""
    for old, new in edits:
        assert old in text
        text = text.replace(old, new, 1)
    return text


def problems(load, path):
    """What loading a bad file says, without the file's folder."""
    with pytest.raises(InputError) as caught:
        load(path)
    return str(caught.value).replace(f"{path.parent}/", "").split("\n")
