"""Files that hold results: folders of comparisons and of energies over duration, pages of reproductions."""

from __future__ import annotations

import csv
import html
import io
import json
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from leanboom.io import folders
from leanboom.model.outcome import SOLVED
from leanboom.report import figures, rendering
from leanboom.study.papers import experiments, printed_values, statements
from leanboom.study.papers.experiments import EXPERIMENTS, PATHS, PUMPS, STARTS

if TYPE_CHECKING:
    from leanboom.study.comparison import Comparison
    from leanboom.study.papers.jobs import Line, Records
    from leanboom.study.papers.reproduction import Reproduction
    from leanboom.study.pareto import Pareto

COMPARISON = ("comparison.json", "energies.png", "trajectories.png")
PARETO = ("pareto.json", "pareto.csv", "pareto.png")
COLUMNS: tuple[str, ...] = ("pump", "duration_s", "energy_j", "baseline_j", "status")
PAGE, FIGURES = "results.md", "figures"

Table = tuple[list[str], list[list[str]], bool]  # heads, rows, and whether the last column is text


@contextmanager
def reserved(out: Path | None, names: tuple[str, ...] = COMPARISON) -> Iterator[None]:
    """Context that reserves a place for a folder of results while they are made; without a place, nothing.

    Args:
        out: The folder.
        names: Its files: `COMPARISON` or `PARETO`.

    Raises:
        InputError: The folder holds something else, cannot be written, or another run is about to.
    """
    if out is None:
        yield
        return
    _check(out, names)
    with folders.reserved(out):
        yield


def _check(out: Path, names: tuple[str, ...]) -> None:
    kind = "comparison" if names is COMPARISON else "pareto"
    folders.check(out, names, lambda folder: True, f"that of an earlier {kind}")


def write_comparison(comparison: Comparison, out: Path) -> Path:
    """Write a comparison's rows, bars and motions.

    Args:
        comparison: The comparison.
        out: The folder; new, empty, or that of an earlier comparison.

    Returns:
        The folder.

    Raises:
        InputError: The folder holds something else, or cannot be written.
    """
    _check(out, COMPARISON)
    text = json.dumps(comparison.json(), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    pictures = figures.energies(comparison), figures.trajectories(comparison)
    folders.put(out, dict(zip(COMPARISON, (text.encode(), *pictures), strict=True)))
    return out


def write_pareto(result: Pareto, out: Path) -> Path:
    """Write energies over duration as JSON, as a table and as a figure; arguments as in `write_comparison`."""
    _check(out, PARETO)
    rows = result.json()
    text = json.dumps(rows, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    table = io.StringIO()
    writer = csv.DictWriter(table, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    contents = text.encode(), table.getvalue().encode(), figures.durations(result)
    folders.put(out, dict(zip(PARETO, contents, strict=True)))
    return out


def write_page(result: Reproduction, out: Path) -> Path:
    """Write the page of a reproduction and its figures.

    Args:
        result: The reproduction.
        out: The folder.

    Returns:
        The page.

    Raises:
        InputError: The folder cannot be written.
    """
    drawn = {f"{FIGURES}/{name}": content for name, content in pictures(result).items()}
    folders.write(out, drawn | {PAGE: page(result).encode()})
    return out / PAGE


def page(result: Reproduction) -> str:
    """The page of a reproduction, as Markdown: the sections of `templates/results.md.j2` whose experiments were run.

    Args:
        result: The reproduction.
    """
    sections = {name: _section(name, result) for name in result.records}
    text = rendering.templates().get_template("results.md.j2").render(sections=sections, folder=FIGURES)
    return re.sub(r"\n{3,}", "\n\n", text).rstrip("\n") + "\n"


def _section(name: str, result: Reproduction) -> dict[str, Any]:
    """Values for the template of an experiment's section."""
    lines = [line for line in result.lines if line.experiment == name]
    section = {"title": EXPERIMENTS[name].title, "figures": list(_figures_of(name, result))}
    if name == "sensitivity":
        groups = _grouped(lines)
        return section | {"ranges": _ranges(groups), "verdicts": verdicts(groups)}
    if name in PATHS:
        energies = _energy_table(result.records[name])
        return section | {"energies": energies, "table": _table([line for line in lines if "[kJ]" not in line.row])}
    if name == "tracking":
        counts = [line for line in lines if line.row.startswith("within")]
        return section | {"table": _table([line for line in lines if line not in counts]), "switches": _columns(counts)}
    if name == "statements":
        return section | {"table": _statements(lines)}
    if name == "cycles":
        changes = [line for line in lines if "change" in line.row]
        whole = [line for line in lines if line not in changes]
        return section | {"table": _cycles(whole), "changes": _table(changes)}
    return section | {"table": _table(lines)}


def _cycles(lines: list[Line]) -> Table:
    """Times and energies of whole cycles, a row a cycle, timing or method, and pump."""
    rows: dict[str, list[Line]] = {}
    for line in lines:
        rows.setdefault(line.row.rsplit(": ", 1)[0], []).append(line)
    legs = max(len(found) for found in rows.values()) - 2
    heads = ["cycle", "time [s]", "energy [kJ]", *(f"leg {i} [kJ]" for i in range(1, legs + 1)), "why not"]
    cells = []
    for name, found in rows.items():
        numbers = [number(line.ours, 1) for line in found]
        cells.append([_plain(name), *numbers, *[""] * (legs + 2 - len(numbers)), _plain(found[0].why)])
    return [_plain(head) for head in heads], cells, True


def _statements(lines: list[Line]) -> Table:
    """What the paper says, a row a statement, a column a case; bold what is in the range."""
    cases = len(experiments.CASES)
    rows = []
    for i, statement in enumerate(statements.STATEMENTS):
        found = [line.ours for line in lines[cases * i : cases * (i + 1)]]
        held = [value is not None and statement.low <= value <= statement.high for value in found]
        texts = [number(value) for value in found]
        texts = [f"**{text}**" if holds else text for text, holds in zip(texts, held, strict=True)]
        rows.append([f"{statement.path}, {statement.text}", statement.span, *texts])
    return ["what the paper says", "range", *experiments.CASES], rows, False


def _columns(counts: list[Line]) -> Table:
    """Entries of Table 4 within a factor of 2, a row a switch, a column a path and pump."""
    rows: dict[str, list[float]] = {}
    for line in counts:
        rows.setdefault(line.row.split(": ")[0].split(", ")[1], []).append(line.ours or 0.0)
    heads = [f"{path}, {pump.upper()}" for path in PATHS for pump in PUMPS]
    cells = [[name, *(f"{value:.0f}" for value in values), f"{sum(values):.0f}"] for name, values in rows.items()]
    return ["within a factor of 2", *heads, "all"], cells, False


def pictures(result: Reproduction) -> dict[str, bytes]:
    """The figures of a reproduction by file name.

    Args:
        result: The reproduction.
    """
    drawn = {}
    for name in result.records:
        drawn |= {f"{figure}.png": content for figure, content in _figures_of(name, result).items()}
    return drawn


def _figures_of(name: str, result: Reproduction) -> Mapping[str, bytes]:
    """The figures that belong to an experiment, by name."""
    got = result.records[name]
    lines = [line for line in result.lines if line.experiment == name]
    if name in ("table2", "table3"):
        pump = "constant pressure" if name == "table2" else "load sensing"
        return {
            name: figures.beside(
                f"Relative cost, {pump}", [line for line in lines if not line.row.endswith(experiments.FULL)]
            ),
            f"{name}-motions": figures.motions({f"loader-triangle-large, {pump}": got}),
        }
    if name == "fig8" or (name == "fig10" and "fig8" not in result.records):
        curves = {}
        for other, pump in (("fig8", "constant pressure"), ("fig10", "load sensing")):
            values = [line.ours for line in result.lines if line.experiment == other]
            if values:
                nodes = [positions * velocities for positions, velocities in experiments.CONVERGENCE]
                curves[pump] = nodes, values[:-1], values[-1]
        return {"convergence": figures.convergence(curves)}
    if name in PATHS:
        starts = {
            start: {row.name: got[f"{start}, {row.name}"] for row in printed_values.SOLUTIONS} for start in STARTS
        }
        return {
            name: figures.path_energies(f"forwarder-{name}", starts),
            f"{name}-motions": figures.motions({f"forwarder-{name}, start: {s}": rows for s, rows in starts.items()}),
        }
    if name == "sensitivity":
        groups = {
            what: ([line.ours for line in rows if line.ours is not None], rows[0].printed)
            for what, rows in _grouped(lines).items()
        }
        return {"sensitivity": figures.spread("What depends on assumed values", groups)}
    return {}


def _table(lines: list[Line]) -> Table:
    """Lines as a table; columns without any value are left out."""
    beside = any(line.printed is not None for line in lines)
    noted = any(line.why for line in lines)
    heads = ["row", *(["printed"] if beside else []), "ours", *(["difference"] if beside else [])]
    heads += ["why"] if noted else []
    rows = []
    for line in lines:
        cells = [_plain(line.row)]
        digits = 1 if "[%]" in line.row or "[kJ]" in line.row else 3
        cells += [number(line.printed, digits)] if beside else []
        cells += [number(line.ours, digits)]
        cells += [number(line.difference, digits, signed=True)] if beside else []
        cells += [_plain(line.why)] if noted else []
        rows.append(cells)
    return heads, rows, noted


def _plain(text: str) -> str:
    """A text for a cell of a table, where nothing in it is markup."""
    return re.sub(r"([\\`*_\[|])", r"\\\1", html.escape(" ".join(text.split()), quote=False))


def number(value: float | None, digits: int = 3, *, signed: bool = False) -> str:
    """A number for people; "-" where there is none.

    Args:
        value: The number.
        digits: Behind the point.
        signed: Whether to show a plus sign.
    """
    if value is None:
        return "-"
    text = f"{value:+.{digits}f}" if signed else f"{value:.{digits}f}"
    return text.lstrip("+-") if float(text) == 0.0 else text


def _energy_table(got: Records) -> Table:
    """Energies of a path: a row a solution, a column a pump and start."""
    columns = [(start, pump) for start in STARTS for pump in PUMPS]
    rows = []
    for row in printed_values.SOLUTIONS:
        cells = [row.name]
        for start, pump in columns:
            record = got[f"{start}, {row.name}"]
            joules = record[PUMPS[pump]]
            mark = "" if record["status"] == SOLVED else "*"
            cells.append("-" if joules is None else f"{joules / 1e3:.2f}{mark}")
        rows.append(cells)
    return ["energy in kJ", *(f"{pump.upper()}, {start} start" for start, pump in columns)], rows, False


def _grouped(lines: list[Line]) -> dict[str, list[Line]]:
    """Lines of the sensitivity study by what is varied around, the unvaried first."""
    groups: dict[str, list[Line]] = {}
    for line in lines:
        groups.setdefault(line.row.rsplit(": ", 1)[0], []).append(line)
    return groups


def _ranges(groups: Mapping[str, list[Line]]) -> Table:
    """Ranges of the varied ratios, as a table."""
    rows = []
    for what, varied in groups.items():
        found = [(line.ours, line.row.rsplit(": ", 1)[1]) for line in varied if line.ours is not None]
        if not found:
            continue
        base = found[0][0]
        values = [value for value, _ in found]
        moved, most = max((abs(value - base), name) for value, name in found)
        most = most if moved >= 5e-4 else "-"
        printed = varied[0].printed
        near = "-"
        if printed is not None:
            _, value, name = min((abs(value - printed), value, name) for value, name in found)
            near = f"{number(value)}, {name}"
        rows.append([what, number(printed), number(base), number(min(values)), number(max(values)), near, most])
    return ["ratio", "printed", "as bundled", "least", "most", "nearest to printed", "moved most by"], rows, True


def verdicts(groups: Mapping[str, list[Line]]) -> list[str]:
    """Which conclusions hold in every variation, as sentences.

    Args:
        groups: Lines by what is varied around, the unvaried first.
    """
    said = []
    for table, pump in (("Table 2", "CP"), ("Table 3", "LS")):
        rows = {what: [line.ours for line in lines] for what, lines in groups.items() if what.startswith(table)}
        if not rows or any(value is None for values in rows.values() for value in values):
            continue
        orders = [
            sorted(rows, key=lambda what, i=i: rows[what][i] or 0.0) for i in range(len(next(iter(rows.values()))))
        ]
        names = [line.row.rsplit(": ", 1)[1] for line in groups[next(iter(rows))]]
        other = [name for name, order in zip(names, orders, strict=True) if order != orders[0]]
        kept = f"{len(orders) - 1 - len(other)} of {len(orders) - 1} variations"
        but = f", not with: {'; '.join(other)}" if other else ""
        said.append(f"The order of the rows of {table} stays as bundled in {kept}{but}.")
        for name in ("Unweighted", "Weighted"):
            values = next(values for what, values in rows.items() if f"({name})" in what)
            more = sorted(100.0 * ((value or 0.0) - 1.0) for value in values)
            range_ = f"{more[0]:.0f} to {more[-1]:.0f} %"
            said.append(f"Triangle: the {name.lower()} pseudo-inverse needs {range_} more {pump} energy than the best.")
    for path in PATHS:
        for pump in ("LS", "CP"):
            values = [
                line.ours
                for what, lines in groups.items()
                if what.startswith(f"{path}, {pump},")
                for line in lines
                if line.ours is not None
            ]
            if values:
                saving = sorted(100.0 * (1.0 - 1.0 / value) for value in values)
                range_ = f"{saving[0]:.0f} to {saving[-1]:.0f} %"
                said.append(f"Path {path}: the best saves {range_} of {pump} energy against a pseudo-inverse.")
    return said
