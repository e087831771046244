"""What `identify` prints for people."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from leanboom.identification.identify import Identification


def identified(console: Console, found: Identification, out: Path | None) -> None:
    """Values with intervals, errors on validation data, and what was done.

    Args:
        console: Where to.
        found: What was found.
        out: The machine file, if one was written.
    """
    from rich.table import Table

    table = Table(title=f"{found.draft.name}: values told by the logs, SI units")
    for name in ("value", "95 % from", "to"):
        if not table.columns:
            table.add_column("parameter")
        table.add_column(name, justify="right")
    for each in found.estimates:
        if each.identifiable and each.low is not None and each.high is not None:
            table.add_row(each.name, f"{each.value:.5g}", f"{each.low:.5g}", f"{each.high:.5g}")
    console.print(table)
    errors = Table(title="Errors on validation data")
    errors.add_column("signal")
    errors.add_column("rms", justify="right")
    errors.add_column("of full scale", justify="right")
    for each in found.fits:
        errors.add_row(each.signal, f"{each.rms:.4g}", f"{each.rms_percent:.2f} %")
    console.print(errors)
    untold = [each.name for each in found.estimates if not each.identifiable]
    if untold:
        console.print(f"Not told by the logs, kept near the draft: {', '.join(untold)}", highlight=False)
    for line in found.said:
        console.print(line, highlight=False, markup=False)
    console.print(
        f"Fitted in {found.wall_s:.1f} s." + (f" Machine file: {out}" if out else ""), highlight=False, markup=False
    )
