"""Files that hold results: the folder of a comparison, and the page of a reproduction with its figures."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from leanboom import experiments, figures, printed
from leanboom.errors import InputError
from leanboom.experiments import EXPERIMENTS, PATHS, PUMPS, STARTS

if TYPE_CHECKING:
    from leanboom.comparison import Comparison
    from leanboom.experiments import Line
    from leanboom.reproduction import Reproduction

COMPARISON = ("comparison.json", "energies.png", "trajectories.png")
PAGE, FIGURES = "results.md", "figures"

INTRODUCTION = """# Results

The experiments of the two papers, solved again by leanboom: our values beside the printed ones, and why they differ.
*3-DOF* is Nurmi and Mattila, Automation in Construction 73 (2017); *4-DOF* is Nurmi and Mattila, Energies 10 (2017) 647.
This page and its figures are written by

    leanboom reproduce all --docs docs

What to know before comparing:

- **The cranes are not the papers' cranes.** Neither paper prints all it takes to model its crane: pin distances, the corners
  of the paths, and for the 4-DOF crane also masses, friction and valve data are *assumed* (`leanboom check loader`,
  `leanboom check forwarder` list every value and where it comes from). Agreement to the last digit would be chance.
- The 3-DOF tables have two columns. Ours is the "simplified" one, the model that is planned with. The "full" one comes
  from a closed-loop simulation and is not part of these experiments.
- The 4-DOF figures are measured on the real crane, its controller's tracking errors included, and have no numbers; ours are
  planned. Only what the paper's text says can be compared.
- As in the papers, motions start from the smallest feasible extension (the 4-DOF ones also from the middle) and are low-pass
  filtered at 5 Hz after planning; energies are those of the filtered motions. Ratios can therefore fall below 1 by some
  tenths of a thousandth.
- `*` marks motions that break a limit. Pseudo-inverses know no acceleration limits, so most of theirs do.
- DIDO and fmincon are commercial; `pseudospectral` and `shooting` stand for them (see `docs/baselines.md`). A local method's
  result says as much about its settings and its first guess as about the method.
"""

TEXTS = {
    "table2": """The order of the first half and both gaps that matter to a user agree: dynamic programming for CP needs about a
tenth less oil than the unweighted pseudo-inverse, and a pseudospectral method comes close to it.

- *DP (Act. velocity)* is the true optimum of v'v here (dynamic programming, one-state dynamic programming and the polish
  alone agree on it to 0.02 %), yet it needs more oil than the pseudo-inverse: small velocities are not small flows. How much
  more depends on the unprinted geometry.
- *fmincon (CP)*: our full-dimensional direct method finds practically the optimum. The printed 1.166 is a poor local optimum.
- *Act. p-inv. (Weighted)*: 1.308 is not reproduced by any reading of the weights that we tried; see `docs/baselines.md`.
""",
    "table3": """DP (LS) is the least in both. The unweighted pseudo-inverse is worse here than printed, the weighted one close to
print; the printed order of the two is the opposite, as in Table 2.
""",
    "fig8": """Figures 8 and 10 have no numbers in their text. As printed, even coarse grids are close for CP, and LS needs denser
ones. The dashed lines are what `leanboom plan` finds with tubes and polish from its usual grid: below every single grid.
""",
    "sizing": """Printed values are rounded ("almost 6%", "well over 5%", "negligible"). What the pressure of a changed cylinder does
depends on which cylinder is loaded most and where, hence on the assumed geometry; the flow depends on areas and strokes
alone. As printed, the saving against the pseudo-inverse falls with the size of the triangle for CP.
""",
    "horizontal": """The paper: pseudo-inverses need 25 % more LS energy and about 30 % more CP energy than the best; minimising the use of
the extension is poor; the CP solution is nearly as good for LS; the best CP energy equals the LS energy of the pseudo-inverses.
""",
    "vertical": """The paper: pseudo-inverses need almost twice the LS energy of the best; CP takes about double the energy of LS. There the
papers' dynamic program was beaten by DIDO, which was put down to its grid; a refined and polished one is not.
The direction of this path is not printed; downwards is assumed.
""",
    "half-cycle": """The paper: all solutions perform fairly similarly for LS, although its simulations (not shown) predicted greater
differences; for CP the pseudo-inverses are inferior. The via points are assumed.
""",
    "sensitivity": """Values that the papers do not print are varied: the cylinders' dead length (pin distances derived again), all masses by
20 %, friction by a factor of 2, and the place of the triangle. Solved on a coarser first grid.
""",
}


def check(out: Path) -> None:
    """Raise InputError if a comparison must not be written to a folder.

    Args:
        out: The folder.
    """
    try:
        if out.exists() and not out.is_dir():
            raise InputError(f"out = {out}; is a file: give a new or empty folder, or that of an earlier comparison")
        strange = sorted(path.name for path in out.iterdir() if path.name not in COMPARISON) if out.is_dir() else []
    except (OSError, ValueError) as error:
        raise InputError(f"out = {out}; cannot be used: {error}") from None
    if strange:
        raise InputError(
            f"out = {out}; holds {strange[0]}: give a new or empty folder, or that of an earlier comparison"
        )


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
    check(out)
    text = json.dumps(comparison.json(), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    pictures = figures.energies(comparison), figures.trajectories(comparison)
    _write(out, dict(zip(COMPARISON, (text.encode(), *pictures), strict=True)))
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
    _write(out / FIGURES, pictures(result))
    _write(out, {PAGE: page(result).encode()})
    return out / PAGE


def page(result: Reproduction) -> str:
    """The page of a reproduction, as Markdown.

    Args:
        result: The reproduction.
    """
    parts = [INTRODUCTION]
    for name in result.records:
        lines = [line for line in result.lines if line.experiment == name]
        parts.append(f"## {EXPERIMENTS[name].title}\n")
        parts.append(TEXTS.get(name, ""))
        if name == "sensitivity":
            parts += _sensitivity(lines)
        elif name in PATHS:
            parts += [_energy_table(result.records[name]), _table([line for line in lines if "[kJ]" not in line.row])]
        else:
            parts.append(_table(lines))
        parts += [f"![{figure}]({FIGURES}/{figure}.png)\n" for figure in _figures_of(name, result)]
    return "\n".join(part for part in parts if part)


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
            name: figures.beside(f"Relative cost, {pump}", lines),
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
        starts = {start: {row.name: got[f"{start}, {row.name}"] for row in printed.SOLUTIONS} for start in STARTS}
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


def _table(lines: list[Line]) -> str:
    """Lines as a table; columns without any value are left out."""
    beside = any(line.printed is not None for line in lines)
    noted = any(line.why for line in lines)
    heads = ["row", *(["printed"] if beside else []), "ours", *(["difference"] if beside else [])]
    heads += ["why"] if noted else []
    rows = [f"| {' | '.join(heads)} |", "| --- |" + " ---: |" * (len(heads) - 1 - noted) + " --- |" * noted]
    for line in lines:
        cells = [line.row.replace("[", "\\[")]
        cells += [number(line.printed)] if beside else []
        cells += [number(line.ours)]
        cells += [number(line.difference, signed=True)] if beside else []
        cells += [line.why] if noted else []
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"


def number(value: float | None, *, signed: bool = False) -> str:
    """A number for people; "-" where there is none.

    Args:
        value: The number.
        signed: Whether to show a plus sign.
    """
    if value is None:
        return "-"
    digits = 1 if abs(value) >= 20 else 2 if abs(value) >= 5 else 3
    text = f"{value:+.{digits}f}" if signed else f"{value:.{digits}f}"
    return text.lstrip("+-") if float(text) == 0.0 else text


def _energy_table(got: experiments.Records) -> str:
    """Energies of a path: a row a solution, a column a pump and start."""
    columns = [(start, pump) for start in STARTS for pump in PUMPS]
    rows = ["| energy in kJ | " + " | ".join(f"{p.upper()}, {s} start" for s, p in columns) + " |"]
    rows.append("| --- |" + " ---: |" * len(columns))
    for row in printed.SOLUTIONS:
        cells = []
        for start, pump in columns:
            record = got[f"{start}, {row.name}"]
            joules = record[PUMPS[pump]]
            mark = "" if record["status"] == "solved" else "*"
            cells.append("-" if joules is None else f"{joules / 1e3:.2f}{mark}")
        rows.append(f"| {row.name} | {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"


def _grouped(lines: list[Line]) -> dict[str, list[Line]]:
    """Lines of the sensitivity study by what is varied around, the unvaried first."""
    groups: dict[str, list[Line]] = {}
    for line in lines:
        groups.setdefault(line.row.rsplit(": ", 1)[0], []).append(line)
    return groups


def _sensitivity(lines: list[Line]) -> list[str]:
    """Ranges of the varied ratios, and which conclusions survive."""
    groups = _grouped(lines)
    rows = ["| ratio | printed | as bundled | least | most | moved most by |", "| --- |" + " ---: |" * 4 + " --- |"]
    for what, varied in groups.items():
        found = [(line.ours, line.row.rsplit(": ", 1)[1]) for line in varied if line.ours is not None]
        if not found:
            continue
        base = found[0][0]
        values = [value for value, _ in found]
        most = max(found, key=lambda pair: abs(pair[0] - base))[1]
        cells = [what, number(varied[0].printed), number(base), number(min(values)), number(max(values)), most]
        rows.append(f"| {' | '.join(cells)} |")
    return ["\n".join(rows) + "\n", "What survives:\n", "\n".join(f"- {text}" for text in verdicts(groups)) + "\n"]


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
        same = sum(order == orders[0] for order in orders[1:])
        said.append(f"The order of the rows of {table} stays as bundled in {same} of {len(orders) - 1} variations.")
        for name in ("Unweighted", "Weighted"):
            values = next(values for what, values in rows.items() if f"({name})" in what)
            numbers = [value or 0.0 for value in values]
            said.append(
                f"The {name.lower()} pseudo-inverse needs {100 * (min(numbers) - 1):.0f} to {100 * (max(numbers) - 1):.0f} % "
                f"more {pump} energy than the best in every variation."
            )
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
                said.append(
                    f"Path {path}, {pump}: the best saves {saving[0]:.0f} to {saving[-1]:.0f} % against a pseudo-inverse."
                )
    return said


def _write(folder: Path, contents: Mapping[str, bytes]) -> None:
    """Write files; each appears whole or not at all."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in contents.items():
            new = folder / f".{name}.new"
            new.write_bytes(content)
            new.replace(folder / name)
    except OSError as error:
        raise InputError(f"out = {folder}; cannot be written: {error.strerror or error}") from None
