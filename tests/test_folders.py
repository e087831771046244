"""Folders of results: one run at a time, whole or not at all, whenever a run is killed."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from leanboom.errors import InputError
from leanboom.io import folders

HOLD = """
import sys, time
from pathlib import Path
from leanboom.io import folders

with folders.{how}(Path(sys.argv[1])):
    {left}
    print("ready", flush=True)
    time.sleep(60.0)
"""
REWRITE = """
import itertools, sys
from pathlib import Path
from leanboom.io import folders

for version in itertools.count():
    with folders.reserved(Path(sys.argv[1])):
        folders.put(Path(sys.argv[1]), {f"file{i}": b"%d" % version for i in range(5)})
    if version == 0:
        print("ready", flush=True)
"""


@contextmanager
def process(code, *arguments):
    """Another process, once it has printed a line; killed without any warning in the end."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as running:
        try:
            assert running.stdout is not None and running.stdout.readline() == "ready\n"
            yield running
        finally:
            running.kill()


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_second_run_into_a_place_is_refused_until_the_first_is_gone(tmp_path):
    """Both used to report success, and one folder survived. A run killed without warning left its half for ever."""
    out = tmp_path / "run"
    left = "; ".join(
        f"Path(sys.argv[1]).with_name({name!r}).mkdir()"
        for name in (".run.leanboom-new-0123abcd", ".run2.leanboom-new-0123abcd", ".run.new")
    )
    with process(HOLD.format(how="reserved", left=left), out):
        for _ in range(2):
            with pytest.raises(InputError, match=r"^out = .*run; another run of leanboom writes there: wait"):
                with folders.reserved(out):
                    pass
        with folders.reserved(tmp_path / "run2"):  # beside it there is no reason to wait
            pass
    assert (tmp_path / ".run.leanboom-new-0123abcd").is_dir()
    with folders.reserved(out):
        assert ".run.leanboom-new-0123abcd" not in names(tmp_path)
    assert names(tmp_path) == [".run.new"]  # a stranger's


def test_a_second_run_in_a_folder_of_solutions_is_refused_until_the_first_is_gone(tmp_path):
    left = "(Path(sys.argv[1]) / '.leanboom-new-0123abcd').touch()"
    with process(HOLD.format(how="opened", left=left), tmp_path):
        with pytest.raises(InputError, match="another run of leanboom writes there"):
            with folders.opened(tmp_path):
                pass
    (tmp_path / "mine").touch()
    with folders.opened(tmp_path, tmp_path / "." / "new", tmp_path):
        assert names(tmp_path) == [".leanboom-lock", "mine", "new"]
    assert names(tmp_path) == ["mine"]


def test_folders_are_whole_whenever_a_run_is_killed(tmp_path):
    out, moments = tmp_path / "run", random.Random(7)
    for _ in range(6):
        with process(REWRITE, out) as running:
            time.sleep(moments.uniform(0.0, 0.03))
            running.send_signal(signal.SIGKILL if os.name == "posix" else signal.SIGTERM)
            running.wait()
        contents = {path.read_bytes() for path in out.iterdir()} if out.exists() else {b""}
        assert len(contents) == 1 and (not out.exists() or len(names(out)) == 5)
        with folders.reserved(out):
            assert set(names(tmp_path)) <= {"run", ".run.leanboom-lock"}
        assert names(tmp_path) == ["run"]  # also where the old one had been set aside and the new one not put there


def test_an_earlier_folder_set_aside_by_a_killed_run_returns(tmp_path):
    aside = tmp_path / ".run.leanboom-old-00000000"
    aside.mkdir()
    (aside / "file").write_text("whole", encoding="utf-8")
    with folders.reserved(tmp_path / "run"):
        assert (tmp_path / "run" / "file").read_text(encoding="utf-8") == "whole"
    assert names(tmp_path) == ["run"]


@pytest.mark.parametrize("keep", [folders.reserved, folders.opened])
def test_a_place_that_cannot_be_written_is_refused_before_the_work(tmp_path, monkeypatch, keep):
    (tmp_path / "file").touch()
    for out in (tmp_path / "file" / "run", tmp_path / ("x" * 300) / "run", Path("a\0b")):
        with pytest.raises(InputError, match=r"^out = .*; cannot be written: "):
            with keep(out):
                raise AssertionError("work began")

    def refused(path, *_, **__):
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(Path, "open", refused)
    with pytest.raises(InputError, match="cannot be written: Read-only file system"):
        with keep(tmp_path / "deep" / "run"):
            raise AssertionError("work began")
    assert names(tmp_path) == ["file"]


@pytest.mark.parametrize("keep", [folders.reserved, folders.opened])
def test_work_that_fails_leaves_no_folders_behind(tmp_path, keep):
    with pytest.raises(KeyboardInterrupt):
        with keep(tmp_path / "very" / "deep" / "run"):
            raise KeyboardInterrupt
    assert names(tmp_path) == []
    with keep(tmp_path / "deep" / "run"):
        folders.put(tmp_path / "deep" / "other", {"file": b""})
    assert names(tmp_path / "deep") == ["other"]


@pytest.mark.parametrize("name", ["x" * 250, "\u00e4" * 120, "\u65e5\u672c"])
def test_any_name_that_a_folder_may_have_will_do(tmp_path, name):
    with folders.reserved(tmp_path / name), folders.reserved(tmp_path / (name[:-1] + "y")):
        folders.put(tmp_path / name, {"file": b"1"})
        folders.put(tmp_path / name, {"file": b"2"})
    assert names(tmp_path) == [name]


def test_files_are_written_whole_beside_others(tmp_path, monkeypatch):
    (tmp_path / "mine").touch()
    folders.write(tmp_path, {"page": b"old", "deep/picture": b"old"})
    complete = Path.write_bytes

    def half(path, content):
        complete(path, content[:1])
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(Path, "write_bytes", half)
    with pytest.raises(InputError, match="cannot be written: Input/output error"):
        folders.write(tmp_path, {"page": b"new"})
    assert (tmp_path / "page").read_bytes() == b"old"
    assert names(tmp_path) == ["deep", "mine", "page"]


def test_file_systems_without_locks_are_written_all_the_same(tmp_path, monkeypatch):
    """What another run may be writing is left alone there."""
    monkeypatch.setattr(folders, "_take", lambda file: False)
    (tmp_path / ".run.leanboom-new-00000000").mkdir()
    with folders.reserved(tmp_path / "run"):
        folders.put(tmp_path / "run", {"file": b""})
    assert names(tmp_path) == [".run.leanboom-new-00000000", "run"]
