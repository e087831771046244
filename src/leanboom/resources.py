"""What the machine that computes has to give: free memory."""

from __future__ import annotations

import os
import re

from leanboom.errors import InputError

USABLE = 0.8  # share of the free memory that may be taken


def free_memory() -> float:
    """Memory this process may still take [bytes]; a generous guess where the system does not say."""
    try:
        with open("/proc/meminfo", encoding="ascii") as file:
            for line in file:
                if line.startswith("MemAvailable"):
                    return float(line.split()[1]) * 1024.0
    except OSError:
        pass
    return 4.0 * 2**30


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
    """Threads a sweep may use: LEANBOOM_THREADS where set, else the processors of this process."""
    wanted = os.environ.get("LEANBOOM_THREADS", "")
    if wanted:
        if not re.fullmatch("[0-9]{1,6}", wanted) or int(wanted) < 1:
            raise InputError(f"LEANBOOM_THREADS = {wanted}; must be a whole number from 1 on")
        return int(wanted)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
