"""Every example runs as its reader would run it: by itself, from anywhere, quietly."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).resolve().parents[1] / "examples").glob("*.py"))


def test_examples_are_numbered():
    assert [path.name[:3] for path in EXAMPLES] == [f"{number:02d}_" for number in range(1, 13)]


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_fits_a_screen(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) < 60


@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs_and_writes_only_where_it_is_told(path, tmp_path):
    """Warnings are errors; one thread, because grids are small and other tests may want the rest."""
    here, folder = tmp_path / "here", tmp_path / "folder"
    for each in (here, folder):
        each.mkdir()
    with tempfile.TemporaryDirectory() as temporary:  # short: names of sockets have at most 100 characters
        answer = subprocess.run(
            [sys.executable, "-W", "error", str(path), str(folder)],
            cwd=here,
            env={**os.environ, "LEANBOOM_THREADS": "1", "TMPDIR": temporary},
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
    assert answer.returncode == 0, answer.stderr
    assert answer.stderr == ""
    assert answer.stdout.count("\n") >= 3
    assert "nan" not in answer.stdout.split() and "inf" not in answer.stdout.split()
    assert list(here.iterdir()) == []
