"""What every test needs: compiled kernels within the project, and the same random numbers in every run."""

from __future__ import annotations

import os
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


@pytest.fixture(autouse=True)
def _fixed_seed() -> None:
    """Seed NumPy's global generator before each test, whatever ran before."""
    np.random.seed(20170506)


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator with a fixed seed."""
    return np.random.default_rng(20170506)
