"""What every test needs: compiled kernels that match the sources, and the same random numbers in every run."""

from __future__ import annotations

import hashlib
import os
import shutil
import time
from pathlib import Path

import hypothesis
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
DAY = 86400.0  # [s]


def _numba_cache_dir() -> Path:
    """A cache folder of its own for these sources and these numba settings.

    Numba notices a change in a kernel's file, not one in a formula the kernel calls from another file, and with
    a warm cache it ignores NUMBA_BOUNDSCHECK. Either would test code that is not there any more.
    """
    digest = hashlib.sha256()
    for path in sorted((ROOT / "src").rglob("*.py")):
        digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    for name in sorted(name for name in os.environ if name.startswith("NUMBA_")):
        digest.update(f"{name}={os.environ[name]}\0".encode())
    return ROOT / ".cache" / "numba" / digest.hexdigest()[:16]


def _drop_old_caches(keep: Path) -> None:
    """Remove the caches of sources that nobody has tested for a day."""
    for folder in keep.parent.iterdir():
        if folder != keep and time.time() - folder.stat().st_mtime > DAY:
            shutil.rmtree(folder, ignore_errors=True)


# Numba reads its settings on import, so this stands above every import of the package.
if "NUMBA_CACHE_DIR" not in os.environ:
    _cache = _numba_cache_dir()
    _cache.mkdir(parents=True, exist_ok=True)
    os.utime(_cache)
    _drop_old_caches(_cache)
    os.environ["NUMBA_CACHE_DIR"] = str(_cache)

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
