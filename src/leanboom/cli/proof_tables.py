"""Tables of a certificate: the bound of every level of cells, and the gap."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.table import Table

from leanboom.cli.console import PUMPS
from leanboom.io.yaml_source import shortened

if TYPE_CHECKING:
    from rich.console import Console

    from leanboom.certificate.certificate import Certificate, Outlook


def certificate(console: Console, proof: Certificate) -> None:
    """Print the proven bounds of a task's energy, level by level.

    Args:
        console: Where to print.
        proof: The certificate.
    """
    table = Table(box=SIMPLE_HEAD, title_justify="left")
    table.add_column("Cells of a stage")
    for heading in ("looked at", "at least\nkJ", "gap\n%", "after\ns"):
        table.add_column(heading, justify="right")
    for level in proof.levels:
        table.add_row(
            f"{level.positions} x {level.velocities}", f"{level.cells}", f"{level.lower_bound_j / 1e3:.3f}",
            f"{level.gap_percent:.2f}", f"{level.seconds:.1f}",
        )  # fmt: skip
    console.print(f"{shortened(proof.task.name, 80)}, {PUMPS[proof.pump]}: what is proven", markup=False)
    if proof.levels:
        console.print(table)
    lines = [
        ("Best known motion", f"{proof.energy_j / 1e3:.3f} kJ over stages of {proof.step:g} s"),
        ("No motion below", f"{proof.lower_bound_j / 1e3:.3f} kJ"),
        ("Gap", f"{proof.gap_percent:.2f} % ({proof.reason} after {proof.certify_s:.1f} s)"),
        ("Processor time", f"{proof.processor_s:.1f} s"),
    ]
    if proof.more_time is not None:
        lines.append(("More time", _more_time(proof.more_time)))
    for label, text in lines:
        console.print(f"{label:<22}{text}", markup=False)


def _more_time(outlook: Outlook) -> str:
    """Sentence on the expected gap and time of one more level."""
    gap = outlook.gap_percent
    brings = "one more level; too few levels to expect a gap" if gap is None else f"a gap of about {gap:.2g} %"
    return f"--seconds {outlook.seconds:g}: {brings} (extrapolated, not proven)"
