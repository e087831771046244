"""What is written of an identification: the machine file, a page with its fits, and the valves' feed-forward tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from leanboom.identification.identify import Identification
from leanboom.io.loading import dump_machine
from leanboom.report import rendering
from leanboom.report.charts import COLOURS, POINTS, PUMP_COLOUR, chart, rounded
from leanboom.report.identification import field_units


def files(found: Identification, out: Path) -> dict[str, bytes]:
    """The files of an identification by their names.

    Args:
        found: What was found.
        out: The machine file.
    """
    contents = {out.name: dump_machine(found.machine), f"{out.stem}.html": page(found, out)}
    if found.feed_forward:
        rows = ["joint,velocity_m_s,command"]
        for joint, table in found.feed_forward.items():
            rows += [f"{joint},{velocity:.6g},{command:.6g}" for velocity, command in table.tolist()]
        contents[f"{out.stem}_feed_forward.csv"] = "\n".join(rows) + "\n"
    return {name: text.encode() for name, text in contents.items()}


def page(found: Identification, out: Path) -> str:
    """The page of an identification as one HTML document.

    Args:
        found: What was found.
        out: The machine file.
    """
    told = [each for each in found.estimates if each.identifiable]
    worst = max(found.fits, key=lambda fit: fit.rms_percent)
    return rendering.page(
        "identification",
        _data(found),
        found=found,
        units=field_units,
        told=told,
        untold=[each for each in found.estimates if not each.identifiable],
        solved=not found.findings,
        verdict="Fitted" if not found.findings else "Fitted, with remarks on the logs",
        cards=[
            ("Values told", f"{len(told)}", f"of {len(found.estimates)} sought"),
            ("Largest error", f"{worst.rms_percent:.2f} %", f"rms of full scale, {worst.signal}, validation"),
            ("Logs", f"{len(found.logs)}", ", ".join(log.digest[:12] for log in found.logs)),
        ],
        first_card=" first",
        machine_file=out.name,
        has_tables=bool(found.feed_forward),
        tables_file=f"{out.stem}_feed_forward.csv",
    )


def _data(found: Identification) -> dict[str, Any]:
    charts = []
    for signal, (time, measured, model, training) in found.series.items():
        # Rows of several logs follow each other; samples left out leave gaps in their time.
        along = np.concatenate([[0.0], np.cumsum(np.maximum(np.diff(time), 0.0))])
        at = np.unique(np.linspace(0, along.size - 1, min(POINTS, along.size)).round().astype(int))
        unit, scale = field_units.of_signal(signal)
        colour = COLOURS.get(signal.partition("_")[0], PUMP_COLOUR)
        used = training[at]
        lines = {
            "model, training": np.where(used, scale * model[at], np.nan),
            "model, validation": np.where(used, np.nan, scale * model[at]),
        }
        one = chart(signal, signal.rpartition("_")[2], unit, colour, lines, {"measured": scale * measured[at]})
        charts.append({"time": rounded(along[at]), **one})
    tables = [
        chart(joint, "command", "", COLOURS.get(joint, PUMP_COLOUR), {"command": table[:, 1]}, {})
        | {"time": rounded(table[:, 0]), "over": "velocity [m/s]"}
        for joint, table in found.feed_forward.items()
    ]
    return {"fits": charts, "tables": tables}
