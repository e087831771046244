"""Charts over time as `templates/charts.js` draws them: lines in readable units, thinned out by who makes them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from leanboom.components.costs import of_pump

if TYPE_CHECKING:
    from leanboom.evaluation.evaluate import Evaluation

POINTS = 1500  # of a line, at most
COLOURS = {"base": "#5b4a9e", "lift": "#0b5c8c", "tilt": "#b4540a", "extension": "#17804a"}
PUMP_COLOUR, BEHIND_COLOUR = "#0b5c8c", "#7b8490"
PUMP = (("Flow", "flow", "l/min", 6e4), ("Supply pressure", "pressure", "MPa", 1e-6), ("Power", "power", "kW", 1e-3),
        ("Energy so far", "energy", "kJ", 1e-3))  # fmt: skip
Lines = Mapping[str, np.ndarray]  # values by what they are called


def rounded(values: np.ndarray | Sequence[float], digits: int = 5) -> list[float | None]:
    """Numbers of a chart, (n,): few digits, and None where there is none."""
    return [float(f"{value:.{digits}g}") if math.isfinite(value) else None for value in np.asarray(values).tolist()]


def chart(
    title: str, axis: str, unit: str, colour: str, lines: Lines, behind: Lines,
    limits: Sequence[float] = (), *, zero: bool = False, dot: bool = False,
) -> dict[str, Any]:  # fmt: skip
    """One chart, ready for JSON.

    Args:
        title: Above it.
        axis: What its values are.
        unit: Theirs; "" for none.
        colour: Of its lines.
        lines: What it is about; a second line is dotted.
        behind: What it is compared with, in grey.
        limits: Values drawn across.
        zero: Whether zero is in its range.
        dot: Whether its title shows the colour.
    """
    drawn = [(name, values, BEHIND_COLOUR, "5px,3px") for name, values in behind.items()]
    drawn += [(name, v, colour, dash) for (name, v), dash in zip(lines.items(), ("", "2px,2px"), strict=False)]
    return {
        "title": title,
        "axis": f"{axis} [{unit}]" if unit else axis,
        "unit": unit,
        "dot": colour if dot else None,
        "zero": zero,
        "lines": [{"name": n, "values": rounded(v), "colour": c, "dash": dash} for n, v, c, dash in drawn],
        "limits": rounded(limits),
    }


def chart_rows(rows: Mapping[str, list[dict[str, Any]]]) -> list[dict[str, Any]]:
    """Charts beside each other under titles, ready for JSON.

    Args:
        rows: The charts by the title above them.
    """
    return [{"title": title, "charts": charts} for title, charts in rows.items()]


def pump_values(judged: Evaluation, pump: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Flow [m^3/s], supply pressure [Pa], power [W] and energy so far [J] of a motion with a pump, (samples,) each."""
    ls = judged.supply_ls, judged.power_ls, judged.cumulative_ls
    return judged.pump_flow, *of_pump(pump, ls, (judged.supply_cp, judged.power_cp, judged.cumulative_cp))


def pump_charts(
    values: Mapping[str, Sequence[np.ndarray]], behind: Mapping[str, Sequence[np.ndarray]], highest: float
) -> list[dict[str, Any]]:
    """The charts of a pump.

    Args:
        values: Flow [m^3/s], supply pressure [Pa], power [W] and energy so far [J] by what they are called.
        behind: Those that they are compared with.
        highest: Pressure of the pump [Pa].
    """
    return [
        chart(
            title, axis, unit, PUMP_COLOUR,
            {name: scale * each[i] for name, each in values.items()},
            {name: scale * each[i] for name, each in behind.items()},
            [scale * highest] if axis == "pressure" else (), zero=True,
        )
        for i, (title, axis, unit, scale) in enumerate(PUMP)
    ]  # fmt: skip
