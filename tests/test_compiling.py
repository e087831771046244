"""Compiled kernels: never those of other sources, kept somewhere that can be written, and told of when made."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

import leanboom
from leanboom import compiling, fingerprint
from leanboom.errors import InputError

PROBE = """
from leanboom.compiling import njit, told
from leanboom.formulas.formula import enable_in_kernels
from leanboom.formulas.hydraulics import positive_work

enable_in_kernels()


@njit(cache=True)
def probe(x):
    return positive_work(x, 1.0)


made = []
with told(lambda text, share: made.append(text)):
    value = probe(3.0)
print(value, len(made))
"""


@pytest.fixture
def package(tmp_path):
    """A copy of the package that tests may edit, and a module in it with a small kernel."""
    folder = tmp_path / "site" / "leanboom"
    shutil.copytree(Path(leanboom.__file__).parent, folder, ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "probe.py").write_text(PROBE, encoding="utf-8")
    return folder


def run(package, code, **variables):
    environment = {name: value for name, value in os.environ.items() if name != compiling.VARIABLE}
    environment |= {"PYTHONPATH": str(package.parent), "PYTHONDONTWRITEBYTECODE": "1", **variables}
    return subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_a_changed_formula_is_compiled_again(package, tmp_path):
    """Numba looks at a kernel's own file alone, and ran the old formula of another file for ever."""
    home = {"XDG_CACHE_HOME": str(tmp_path / "cache"), "LOCALAPPDATA": str(tmp_path / "cache"), "HOME": str(tmp_path)}
    first = run(package, "import leanboom.probe", **home)
    assert first.stdout.split() == ["3.0", "1"], first.stderr
    assert run(package, "import leanboom.probe", **home).stdout.split() == ["3.0", "0"]
    formulas = package / "formulas" / "hydraulics.py"
    text = formulas.read_text(encoding="utf-8")
    old = "return np.maximum(F * v, 0.0)"
    assert old in text
    formulas.write_text(text.replace(old, f"{old} * 10.0"), encoding="utf-8")
    assert run(package, "import leanboom.probe", **home).stdout.split() == ["30.0", "1"]


@pytest.mark.slow
def test_without_a_home_kernels_go_to_a_temporary_folder_with_one_line(package, tmp_path):
    """Containers and the user nobody: neither the home nor the package can be written; numba refused to import."""
    for path in (package / "__pycache__", tmp_path / "home"):
        path.write_text("a file, below which nothing can be made\n", encoding="utf-8")
    (tmp_path / "temporary").mkdir()
    home = {name: str(tmp_path / "home") for name in ("HOME", "XDG_CACHE_HOME", "LOCALAPPDATA")}
    temporary = {name: str(tmp_path / "temporary") for name in ("TMPDIR", "TEMP", "TMP")}
    first = run(package, "import leanboom.probe", **home, **temporary)
    assert first.stdout.split() == ["3.0", "1"], first.stderr
    assert first.stderr.count("\n") == 1
    assert first.stderr.startswith("leanboom: compiled kernels cannot be kept in ")
    assert first.stderr.endswith("set NUMBA_CACHE_DIR to a lasting folder that can be written\n")
    again = run(package, "import leanboom.probe", **home, **temporary)
    assert again.stdout.split() == ["3.0", "0"]


def test_without_any_folder_the_variable_is_named(place, monkeypatch, tmp_path):
    def nowhere():
        raise FileNotFoundError(2, "No usable temporary directory found")

    (tmp_path / "file").write_text("", encoding="utf-8")
    monkeypatch.setenv(compiling.VARIABLE, str(tmp_path / "file" / "kernels"))
    monkeypatch.setattr(compiling, "_temporary_folder", nowhere)
    with pytest.raises(InputError, match=r"cannot be kept in .*; set NUMBA_CACHE_DIR to a folder that can be written"):
        compiling._folder("dynamic_programming.bellman")


@pytest.mark.skipif(os.name != "posix", reason="owners and permissions of POSIX systems")
def test_a_temporary_folder_that_others_can_write_is_not_used(monkeypatch, tmp_path):
    """Compiled code is loaded from it and run."""
    monkeypatch.setattr(compiling.tempfile, "tempdir", str(tmp_path))
    mine = compiling._temporary_folder()
    assert compiling._temporary_folder() == mine
    mine.chmod(0o777)
    other = compiling._temporary_folder()
    assert other != mine and not other.stat().st_mode & 0o077


@pytest.fixture
def place(monkeypatch, tmp_path):
    """An empty place for compiled code, as at the beginning of a process."""
    for function in (compiling._folder, compiling._place):
        function.cache_clear()
        monkeypatch.setattr(compiling, function.__name__, function)
    monkeypatch.setenv(compiling.VARIABLE, str(tmp_path))
    yield tmp_path
    for function in (compiling._folder, compiling._place):
        function.cache_clear()


def test_kernels_of_sources_long_out_of_use_are_removed(place):
    old, recent, strange = (place / name for name in (f"leanboom-{'0' * 16}", f"leanboom-{'1' * 16}", "mine"))
    for folder in (old, recent, strange):
        folder.mkdir()
        (folder / "kernel.nbi").write_bytes(b"")
    ago = time.time() - compiling.UNUSED - 60.0
    for folder in (old, strange):
        os.utime(folder, (ago, ago))
    made = Path(compiling._folder("dynamic_programming.bellman"))
    assert set(place.iterdir()) == {recent, strange, made}
    os.utime(made, (ago, ago))
    compiling._folder.cache_clear()
    assert compiling._folder("dynamic_programming.bellman") == str(made)
    assert time.time() - made.stat().st_mtime < 60.0  # used, so it stays for another week


def test_settings_that_change_compiled_code_have_their_own_folder(place, monkeypatch):
    plain = compiling._folder("dynamic_programming.bellman")
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")
    compiling._folder.cache_clear()
    assert compiling._folder("dynamic_programming.bellman") == plain != compiling._folder("fixed_mode.derivatives")
    monkeypatch.setenv("NUMBA_BOUNDSCHECK", "1" if os.environ.get("NUMBA_BOUNDSCHECK") != "1" else "0")
    compiling._folder.cache_clear()
    assert compiling._folder("dynamic_programming.bellman") != plain


def test_code_that_no_kernel_calls_may_change():
    """Compiling all kernels again for a word on the command line would take a minute or two."""
    needed = fingerprint.needed("dynamic_programming.bellman") | fingerprint.needed("fixed_mode.interior_point")
    kernels = {"dynamic_programming.bellman", "fixed_mode.interior_point", "fixed_mode.derivatives"}
    assert kernels | {"formulas.hydraulics", "formulas.dynamics", "formulas.formula", "compiling"} <= needed
    others = {"cli.app", "planning.planner", "report.plan_page", "evaluation.evaluate", "problem.stages"}
    assert not others & needed and others <= fingerprint._modules()


def test_compiling_is_told_while_it_happens_and_only_then():
    @compiling.njit()
    def inner(x):
        return 2.0 * x

    @compiling.njit()
    def outer(x):
        return inner(x) + 1.0

    said = []
    for _ in range(2):
        with compiling.told(lambda text, share: said.append((text, share))):
            assert outer(1.0) == 3.0
    assert [share for _, share in said] == [0.0, 0.0]
    assert all(text.startswith("compiling kernels, which takes a minute or two once: 0 of up to ") for text, _ in said)
    with compiling.told(lambda text, share: said.append((text, share))):
        assert outer(1) == 3.0
    assert len(said) > 2  # other types


def test_other_packages_keep_their_own_folder():
    from numba.core import config

    assert "leanboom-" not in str(vars(config)["CACHE_DIR"])
