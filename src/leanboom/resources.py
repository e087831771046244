"""Resources of the computer: memory and cores."""

from __future__ import annotations

import os
import re
import sys

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
