"""Resources of the computer: memory, cores, and processes that share them."""

from __future__ import annotations

import multiprocessing
import os
import re
import signal
import sys
from collections.abc import Sequence
from typing import Any

from leanboom.errors import InputError

USABLE = 0.8  # share of the free memory that may be taken


def free_memory() -> float:
    """Memory this process may still take [bytes]."""
    import psutil

    return float(psutil.virtual_memory().available)


def peak_memory() -> int:
    """The most memory this process has taken [bytes]."""
    if sys.platform == "win32":
        import psutil

        return psutil.Process().memory_info().peak_wset
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def cores() -> int:
    """Cores that this process may use: fewer than there are where it is kept to some."""
    import psutil

    process = psutil.Process()
    if hasattr(process, "cpu_affinity"):  # not on macOS
        return len(process.cpu_affinity())
    return psutil.cpu_count() or 1


def check_memory(need: float, what: str, change: str, limit: float | None = None) -> None:
    """Raise InputError where something would not fit into the memory that is free.

    Args:
        need: Memory it takes [bytes].
        what: What takes it.
        change: What to do about it.
        limit: Memory there is [bytes]; None: what is free.
    """
    limit = free_memory() if limit is None else limit
    if need > USABLE * limit:
        raise InputError(f"{what} needs {need / 2**30:.1f} GiB, {limit / 2**30:.1f} GiB are free; {change}")


def threads() -> int:
    """Threads a sweep may use: LEANBOOM_THREADS where set, else the cores of this process."""
    wanted = os.environ.get("LEANBOOM_THREADS", "")
    if wanted:
        if not re.fullmatch("[0-9]{1,6}", wanted) or int(wanted) < 1:
            raise InputError(f"LEANBOOM_THREADS = {wanted}; must be a whole number from 1 on")
        return int(wanted)
    return cores()


def process_context(preloaded: Sequence[str]) -> Any:
    """The way to start processes: from a server that has modules loaded where the system knows that.

    Args:
        preloaded: Names of modules that every process needs.
    """
    methods = multiprocessing.get_all_start_methods()
    context: Any = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
    if context.get_start_method() == "forkserver":
        context.set_forkserver_preload([*preloaded])
    return context


def quieten() -> None:
    """What a process for calls of another one does first: no output, no interrupts, one thread.

    Ctrl-C reaches the other process, which ends this one; solvers print, but output belongs to results. By default
    numba shares a lock with further processes, which one that is ended would leave behind.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    multiprocessing.set_start_method("spawn", force=True)
    single_thread()


def single_thread() -> None:
    """Keep this process to one thread, where several share the cores, and those that it starts."""
    import numba

    os.environ["LEANBOOM_THREADS"] = "1"
    numba.set_num_threads(1)
