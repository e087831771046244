"""What every test needs: compiled kernels within the project, and the same random numbers in every run."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
# Processes of the tests inherit it; each version of the sources has a folder of its own within.
os.environ.setdefault("NUMBA_CACHE_DIR", str(ROOT / ".cache" / "numba"))

# The first call of a kernel compiles it, so a time limit per example would measure the compiler.
hypothesis.settings.register_profile("leanboom", derandomize=True, database=None, deadline=None)
hypothesis.settings.load_profile("leanboom")

# Kernels that take about as long to compile as each other.
PREPARED = (
    "from leanboom.dynamic_programming import value_function; value_function.prepare()",
    "from leanboom.certificate import lower_bounds, value_slopes; from leanboom.fixed_mode import modes; "
    "modes.prepare(); lower_bounds.prepare(); value_slopes.prepare()",
)


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the kernels before workers share tests: all would meet them at once, and each compile every one.

    Workers that share whole files (`--dist loadfile`) meet different ones.
    """
    if session.config.getoption("numprocesses", None) and session.config.getoption("dist") != "loadfile":
        running = [subprocess.Popen([sys.executable, "-c", each]) for each in PREPARED]
        for each in running:
            assert each.wait() == 0, "kernels cannot be compiled"


@pytest.fixture(autouse=True)
def _fixed_seed() -> None:
    """Seed NumPy's global generator before each test, whatever ran before."""
    np.random.seed(20170506)


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator with a fixed seed."""
    return np.random.default_rng(20170506)


@pytest.fixture(scope="module")
def coarser_guide() -> Iterator[None]:
    """Coarser policies as guides of certificates: whatever their slopes, bounds are proven; making them takes time."""
    from leanboom.certificate import value_slopes  # not before the folder of kernels is set

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(value_slopes, "GRID", (401, 101))
        patch.setattr(value_slopes, "TUBE", (101, 161))
        yield


@pytest.fixture
def larger_cells(coarser_guide, monkeypatch) -> None:
    """First cells of certificates twice as wide and high, coarser guides, a motion from a coarser grid beside."""
    from leanboom.certificate import certificate, partition, position_rows

    monkeypatch.setattr(partition, "VELOCITY", 2.0 * partition.VELOCITY)
    monkeypatch.setattr(position_rows, "POSITION", 2.0 * position_rows.POSITION)
    monkeypatch.setattr(certificate, "GRID", (41, 31))
