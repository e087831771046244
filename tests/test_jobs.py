"""Calls in processes of their own: values in order, reasons of failures, nothing of one in another."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys

import pytest

from leanboom.errors import InputError
from leanboom.study import processes


def fate(what):
    """A call that ends as it is told."""
    if what == "refuse":
        raise InputError("grid = 2x2; needs at least 3 positions")
    if what == "stumble":
        raise ZeroDivisionError("division by zero")
    if what == "crash":
        os.kill(os.getpid(), signal.SIGKILL)
    if what == "leave":
        os._exit(3)
    if what == "print":
        print("not for standard output", flush=True)
        os.write(1, b"nor this")
    return what, os.getpid()


def test_values_come_in_order_and_from_other_processes(capfd):
    seen = []
    outcomes = processes.each(fate, ["a", "print", "c"], workers=2, done=lambda index, outcome: seen.append(index))
    assert [outcome.value[0] for outcome in outcomes] == ["a", "print", "c"]
    numbers = {outcome.value[1] for outcome in outcomes}
    assert len(numbers) == 3 and os.getpid() not in numbers
    assert sorted(seen) == [0, 1, 2]
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize(
    ("what", "reason", "refused"),
    [
        ("refuse", "grid = 2x2; needs at least 3 positions", True),
        ("stumble", "ZeroDivisionError: division by zero", False),
        ("crash", "its process ended unexpectedly (signal 9, Killed)", False),
        ("leave", "its process ended unexpectedly (exit code 3)", False),
    ],
)
def test_a_failure_is_a_reason_and_spares_the_others(what, reason, refused):
    bad, good = processes.each(fate, [what, "fine"], workers=1)
    assert (bad.failed, bad.failure, bad.refused) == (True, reason, refused)
    assert good.value[0] == "fine" and not good.failed


def allowed(_):
    return os.environ.get("LEANBOOM_THREADS")


def test_each_process_keeps_to_one_thread_in_sweeps_too():
    """It told numba alone, but sweeps ask `resources.threads`, which counted the cores."""
    (outcome,) = processes.each(allowed, [None])
    assert outcome.value == "1"


def loaded(_):
    return [name for name in ("scipy.signal", "scipy.interpolate", "numba") if name in sys.modules]


@pytest.mark.skipif("forkserver" not in multiprocessing.get_all_start_methods(), reason="processes start empty there")
def test_what_every_process_needs_is_imported_once():
    """Each imported SciPy's filters and splines anew, 0.8 s of processor time."""
    (outcome,) = processes.each(loaded, [None])
    assert outcome.value == ["scipy.signal", "scipy.interpolate", "numba"]


def test_nothing_to_do():
    assert processes.each(fate, []) == []
