"""The table of a run: what was measured of each peer, beside leanboom's dp, as Markdown."""

from __future__ import annotations

import math
from dataclasses import dataclass

from benchmarks.peers.roster import OURS

HEAD = ("peer", "time [s]", "of dp", "memory [MiB]", "energy [kJ]", "gap", "limit use", "remark")


@dataclass(frozen=True, slots=True)
class Measured:
    """One peer on one task, start and pump; numbers that are missing are nan."""

    peer: str
    seconds: float = math.nan  # of the processor, from the loaded task to the motion
    peak_bytes: float = math.nan
    energy: float = math.nan  # judged [J]
    limit_use: float = math.nan  # largest; 1 is at the limit
    feasible: bool = False
    remark: str = ""  # `solved`, what is violated, or why there is no motion


def lines(rows: list[Measured]) -> list[str]:
    """A Markdown table, columns padded to their widest entry.

    Args:
        rows: What was measured; ratio and gap are relative to the row of `OURS`, where there is one.
    """
    ours = next((row for row in rows if row.peer == OURS), Measured(OURS))
    cells = [HEAD, *(_cells(row, ours) for row in rows)]
    widths = [max(len(line[i]) for line in cells) for i in range(len(HEAD))]
    rule = tuple("-" * width for width in widths)
    padded = [
        [text.ljust(width) for text, width in zip(line, widths, strict=True)] for line in (HEAD, rule, *cells[1:])
    ]
    return ["| " + " | ".join(line) + " |" for line in padded]


def _cells(row: Measured, ours: Measured) -> tuple[str, ...]:
    """The entries of a row; energies of motions that break a limit are marked."""
    return (
        row.peer,
        _number("{:.1f}", row.seconds),
        _number("{:.1f}", row.seconds / ours.seconds),
        _number("{:.0f}", row.peak_bytes / 2**20),
        _number("{:.2f}" if row.feasible else "{:.2f} (!)", row.energy / 1e3),
        _number("{:+.1f} %", 100.0 * (row.energy / ours.energy - 1.0)),
        _number("{:.3f}", row.limit_use),
        row.remark.replace("|", "/"),
    )


def _number(form: str, value: float) -> str:
    return form.format(value) if not math.isnan(value) else ""
