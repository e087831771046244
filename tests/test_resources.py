"""What the machine has to give, by psutil."""

from __future__ import annotations

import os
from types import SimpleNamespace

import psutil
import pytest

from leanboom import budget, resources


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system does not keep processes to some cores")
def test_a_process_kept_to_one_core_counts_one(monkeypatch):
    monkeypatch.delenv("LEANBOOM_THREADS", raising=False)
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    try:
        assert (resources.cores(), resources.threads(), budget.processors()) == (1, 1, 1)
    finally:
        os.sched_setaffinity(0, before)


def test_where_processes_are_not_kept_to_cores_all_count(monkeypatch):
    monkeypatch.setattr(psutil, "Process", SimpleNamespace)
    assert resources.cores() == psutil.cpu_count()


def test_peak_memory_is_known_on_windows_too(monkeypatch):
    """It was missing there: the module `resource` is of Unix."""
    process = SimpleNamespace(memory_info=lambda: SimpleNamespace(peak_wset=7 << 20))
    monkeypatch.setattr(resources.sys, "platform", "win32")
    monkeypatch.setattr(psutil, "Process", lambda: process)
    assert resources.peak_memory() == 7 << 20


def test_free_and_peak_memory_are_of_a_plausible_size():
    there = psutil.virtual_memory().total
    assert 0.0 < resources.free_memory() <= there
    assert psutil.Process().memory_info().rss / 2 < resources.peak_memory() < there
