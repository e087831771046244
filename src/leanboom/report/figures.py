"""Figures of comparisons and reproductions, as PNG: bars of energies, motions laid over each other, convergence.

Drawn without a display and without dates, so that the same numbers give the same files.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

from leanboom.model.outcome import SOLVED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from leanboom.model.task import Start
    from leanboom.study.comparison import Comparison
    from leanboom.study.papers.jobs import Line, Record, Records
    from leanboom.study.pareto import Pareto

PUMPS = {"ls": ("load-sensing pump", "#0b5c8c"), "cp": ("constant-pressure pump", "#d9931e")}
PRINTED, OURS = "#9aa5b1", "#0b5c8c"
GREY = "#9aa5b1"
LINES = ("#0b5c8c", "#b4540a", "#17804a", "#5b4a9e", "#a3241b", "#59636e", "#d9931e", "#3c9dd0", "#7c5c3b", "#c05a9c")
WIDTH, DPI = 8.0, 100  # [in], points per inch
POINTS = 601  # of a motion
BROKEN = " *"  # behind the name of what breaks a limit
STARVED = " +"  # behind the name of what the pump cannot deliver
MARKS = {BROKEN: "* breaks a limit of position, velocity or acceleration", STARVED: "+ more than the pump can deliver"}


def energies(comparison: Comparison) -> bytes:
    """Bars of pump energy, a panel a start, sorted as the papers' Figures 10a to 12a.

    Args:
        comparison: The comparison.
    """
    figure, panels = _panels(len(comparison.starts), 0.26 * len({row.label for row in comparison.rows}) + 0.9)
    for panel, start in zip(panels, comparison.starts, strict=True):
        labels = _labels(comparison, start)
        blocks = {pump: comparison.block(pump, start) for pump in comparison.pumps}
        rows = {pump: {labels[row.label]: row.energy for row in block} for pump, block in blocks.items()}
        order = [labels[row.label] for row in blocks[comparison.pumps[0]]]
        _bars(panel, order, rows)
        panel.set_title(f"{comparison.task.name}, start: {_start(start)}", fontsize=10, loc="left")
    return _png(figure)


def trajectories(comparison: Comparison) -> bytes:
    """The extension cylinder over time by every method, a panel a start.

    Args:
        comparison: The comparison.
    """
    figure, panels = _panels(len(comparison.starts), 3.4)
    for panel, start in zip(panels, comparison.starts, strict=True):
        best = comparison.best(comparison.pumps[0], start)
        curves, labels = {}, _labels(comparison, start)
        for row in comparison.block(comparison.pumps[0], start):
            if row.motion is not None:
                time = np.linspace(0.0, row.motion.duration, POINTS)
                curves[labels[row.label]] = time, row.motion.at(time)[0], row is best
        _curves(panel, curves)
        panel.set_title(f"{comparison.task.name}, start: {_start(start)}", fontsize=10, loc="left")
    return _png(figure)


def durations(result: Pareto) -> bytes:
    """Least energy over duration, and that of the pseudo-inverse, by pump.

    Args:
        result: The points.
    """
    figure, (panel,) = _panels(1, 4.0)
    for pump in result.pumps:
        name, colour = PUMPS[pump]
        for method, style in (("least energy", "o-"), ("pseudo-inverse", "s--")):
            pairs = [
                (point.duration, 1e-3 * energy)
                for point in result.curve(pump)
                if (energy := point.energy if method == "least energy" else point.baseline) is not None
            ]
            if pairs:
                panel.plot(*zip(*pairs, strict=True), style, color=colour, markersize=4, linewidth=1.2,
                           alpha=1.0 if method == "least energy" else 0.6, label=f"{method}, {name}")  # fmt: skip
    if all(leg.duration is None or isinstance(leg.duration, float) for leg in result.task.legs):
        panel.axvline(result.task.duration, color=GREY, linewidth=0.8, linestyle=":", label="the task's own duration")
    panel.set_ylim(0.0, 1.05 * panel.get_ylim()[1])
    panel.set_xlabel(f"duration of the {'cycle' if result.task.legs else 'path'} [s]", fontsize=8)
    panel.set_ylabel("pump energy [kJ]", fontsize=8)
    figure.legend(loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    panel.set_title(f"{result.task.name}: energy against duration", fontsize=10, loc="left")
    return _png(figure)


def path_energies(name: str, starts: Mapping[str, Records]) -> bytes:
    """Bars of LS and CP energy by solution, a panel a start.

    Args:
        name: Title.
        starts: Records by solution, by start.
    """
    most = max(len(records) for records in starts.values())
    figure, panels = _panels(len(starts), 0.26 * most + 0.9)
    for panel, (start, records) in zip(panels, starts.items(), strict=True):
        labelled = {_marked(label, record): record for label, record in records.items()}
        values = {pump: {label: record[f"energy_{pump}_j"] for label, record in labelled.items()} for pump in PUMPS}
        order = sorted(labelled, key=lambda label: values["ls"][label] or np.inf)
        _bars(panel, order, values)
        panel.set_title(f"{name}, start: {start}", fontsize=10, loc="left")
    return _png(figure)


def motions(titles: Mapping[str, Records]) -> bytes:
    """The extension cylinder over time by solution, a panel a title.

    Args:
        titles: Records by solution, by title.
    """
    figure, panels = _panels(len(titles), 2.7)
    for panel, (title, records) in zip(panels, titles.items(), strict=True):
        curves = {}
        for i, (label, record) in enumerate(records.items()):
            if record["time_s"]:
                curves[_marked(label, record)] = np.array(record["time_s"]), np.array(record["stroke_m"]), i == 0
        _curves(panel, curves)
        panel.set_title(title, fontsize=10, loc="left")
    return _png(figure)


def beside(title: str, lines: Sequence[Line]) -> bytes:
    """Printed and our relative costs, side by side.

    Args:
        title: Title.
        lines: The lines.
    """
    figure, (panel,) = _panels(1, 0.34 * len(lines) + 0.9)
    at = np.arange(len(lines))[::-1]
    for values, name, colour, offset in (
        ([line.printed for line in lines], "printed", PRINTED, 0.19),
        ([line.ours for line in lines], "leanboom", OURS, -0.19),
    ):
        numbers = [0.0 if value is None else value for value in values]
        panel.barh(at + offset, numbers, 0.36, label=name, color=colour)
        for y, value in zip(at + offset, values, strict=True):
            panel.annotate("no result" if value is None else f"{value:.3f}", (value or 0.9, y), (3, 0),
                           textcoords="offset points", va="center", fontsize=7)  # fmt: skip
    panel.set_yticks(at, [line.row for line in lines], fontsize=8)
    panel.set_xlim(0.9, 1.05 * max([line.printed or 0.0 for line in lines] + [line.ours or 0.0 for line in lines]))
    panel.set_xlabel("cost relative to dynamic programming of the same cost", fontsize=8)
    panel.legend(fontsize=8, loc="lower right", frameon=False)
    panel.set_title(title, fontsize=10, loc="left")
    return _png(figure)


def convergence(curves: Mapping[str, tuple[Sequence[int], Sequence[float | None], float | None]]) -> bytes:
    """Cost over the number of grid nodes, relative to the densest grid; the refined plan as a line.

    Args:
        curves: By name: numbers of nodes, relative costs, relative cost of the refined plan.
    """
    figure, (panel,) = _panels(1, 3.2)
    for (name, (nodes, values, refined)), colour in zip(curves.items(), LINES, strict=False):
        pairs = [(n, v) for n, v in zip(nodes, values, strict=True) if v is not None]
        panel.semilogx([n for n, _ in pairs], [v for _, v in pairs], "o-", color=colour, markersize=4, label=name)
        if refined is not None:
            panel.axhline(refined, color=colour, linestyle="--", linewidth=1, label=f"{name}, refined and polished")
    panel.set_xlabel("nodes of the grid (positions x velocities)", fontsize=8)
    panel.set_ylabel("cost relative to the densest grid", fontsize=8)
    panel.legend(fontsize=8, frameon=False)
    panel.set_title("One sweep on one grid, and what tubes and polish add", fontsize=10, loc="left")
    return _png(figure)


def spread(title: str, groups: Mapping[str, tuple[Sequence[float], float | None]]) -> bytes:
    """Dots of varied values around the unvaried one, and the printed value.

    Args:
        title: Title.
        groups: By name: values, the unvaried first, and the printed value.
    """
    figure, (panel,) = _panels(1, 0.24 * len(groups) + 0.9)
    at = np.arange(len(groups))[::-1]
    for y, (values, said) in zip(at, groups.values(), strict=True):
        panel.plot(values[1:], [y] * (len(values) - 1), "o", color=GREY, markersize=4)
        panel.plot(values[:1], [y], "o", color=OURS, markersize=5)
        if said is not None:
            panel.plot([said], [y], "x", color="#a3241b", markersize=6)
    panel.set_yticks(at, list(groups), fontsize=8)
    for label, style, colour in (("as bundled", "o", OURS), ("varied", "o", GREY), ("printed", "x", "#a3241b")):
        panel.plot([], [], style, color=colour, label=label, markersize=5)
    panel.axvline(1.0, color="black", linewidth=0.6)
    panel.set_xlabel("cost relative to dynamic programming of the same cost", fontsize=8)
    panel.legend(fontsize=8, frameon=False)
    panel.set_title(title, fontsize=10, loc="left")
    return _png(figure)


def _panels(count: int, height: float) -> tuple[Figure, list[Axes]]:
    """A figure of panels above each other, of a height [in] each."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, count * height), layout="constrained")
    panels = list(np.ravel(figure.subplots(count, 1, squeeze=False)))
    for panel in panels:
        panel.spines[["top", "right"]].set_visible(False)
        panel.tick_params(labelsize=8)
    return figure, panels


def _bars(panel: Axes, order: Sequence[str], values: Mapping[str, Mapping[str, float | None]]) -> None:
    """Horizontal bars, best above; a bar a pump."""
    at = np.arange(len(order))[::-1]
    height = 0.8 / len(values)
    for i, (pump, energy) in enumerate(values.items()):
        name, colour = PUMPS[pump]
        place = at + (0.5 * (len(values) - 1) - i) * height
        numbers = [energy[label] for label in order]
        bars = panel.barh(
            place, [0.0 if e is None else e / 1e3 for e in numbers], 0.92 * height, color=colour, label=name
        )
        for bar, label in zip(bars, order, strict=True):
            if label.endswith(tuple(MARKS)):  # an outline alone: no result
                bar.set(facecolor="white", edgecolor=colour, hatch="////", linewidth=0.8)
        for y, number in zip(place, numbers, strict=True):
            text = "no result" if number is None else f"{number / 1e3:.2f}"
            panel.annotate(
                text, ((number or 0.0) / 1e3, y), (3, 0), textcoords="offset points", va="center", fontsize=7
            )
    panel.set_yticks(at, list(order), fontsize=8)
    panel.set_xlabel(_noted("pump energy [kJ]", order), fontsize=8)
    panel.legend(fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)
    panel.margins(x=0.1)


def _curves(panel: Axes, curves: Mapping[str, tuple[Any, Any, bool]]) -> None:
    """Curves by label: times, strokes, and whether it is the best."""
    for (label, (time, stroke, best)), colour in zip(curves.items(), (LINES * len(curves))[: len(curves)], strict=True):
        style = ":" if label.endswith(tuple(MARKS)) else "-"
        panel.plot(time, stroke, color=colour, linewidth=1.0, linestyle=style, label=label)
        if best:  # a broad band below the others, so that it hides none of them
            panel.plot(time, stroke, color=colour, linewidth=6.0, alpha=0.3, zorder=1)
    panel.set_xlabel(_noted("time [s]", list(curves)), fontsize=8)
    panel.set_ylabel("extension cylinder [m]", fontsize=8)
    panel.legend(fontsize=7, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))


def _noted(text: str, labels: Sequence[str]) -> str:
    """An axis' title, and below it what the marks of its labels mean."""
    notes = [note for mark, note in MARKS.items() if any(label.endswith(mark) for label in labels)]
    return "      ".join([text, *notes])


def _marked(label: str, record: Record) -> str:
    return label if record["status"] == SOLVED or record["energy_ls_j"] is None else label + BROKEN


def _labels(comparison: Comparison, start: Start) -> dict[str, str]:
    """The methods from a start by their labels, those marked that are no solution with one of the pumps."""
    labels = {}
    for pump in comparison.pumps:
        for row in comparison.block(pump, start):
            mark = "" if row.solved or row.motion is None else STARVED if row.feasible else BROKEN
            labels[row.label] = max(labels.get(row.label, row.label), row.label + mark, key=len)
    return labels


def _start(start: str | float) -> str:
    return start if isinstance(start, str) else f"{start:g} m"


def _png(figure: Figure) -> bytes:
    target = BytesIO()
    figure.savefig(target, format="png", dpi=DPI, metadata={"Software": None})
    return target.getvalue()
