"""The papers' experiments: the solutions each needs, and the ratios computed from them.

An experiment is its jobs, by name, and a function from their records to lines that stand beside the printed values.
Jobs of several experiments that agree are solved once. All solutions start and are filtered (5 Hz, after planning) as
in the papers; the grids are those of `plan`, but for the convergence studies and the sweep of the sensitivity study.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from dataclasses import replace
from math import log

from leanboom.io import loading
from leanboom.methods.registry import METHODS
from leanboom.model.outcome import SOLVED
from leanboom.model.task import Task
from leanboom.study.papers import forwarder, loading_cycles, printed_values, statements
from leanboom.study.papers.jobs import COARSE, Experiment, Job, Line, Record, Records, percent, ratio
from leanboom.study.papers.variations import (
    ALL,
    EARLIER_TRIANGLE,
    SWITCHES,
    cornered,
    derived_pins,
    heavier,
    moved,
    resized,
    rubbed,
    zeroed,
)
from leanboom.study.papers.weights import SIGNED

SWEEP_GRID = (121, 61)
CONVERGENCE = ((21, 11), (41, 21), (81, 41), (125, 101), (161, 101), (241, 151), (321, 201))
SIZES = ("large", "medium", "small")
PATHS = ("horizontal", "vertical", "half-cycle")
STARTS = ("smallest", "middle")
PUMPS = {"ls": "energy_ls_j", "cp": "energy_cp_j"}
DRIVEN = {"ls": "driven_ls_j", "cp": "driven_cp_j"}  # energies of the closed-loop simulation
FULL = " (full model)"  # ends the names of rows that it gives

# The papers' tasks, and their solutions. Simulations take longer than plans: only those are driven that lines read.


@functools.cache
def _triangle_task(size: str) -> Task:
    return loading.load_task(f"loader-triangle-{size}", start="smallest")


@functools.cache
def _forwarder_task(path: str, start: str) -> Task:
    return loading.load_task(f"forwarder-{path}", start=start)


def _triangle_job(size: str, method: str, cost: str) -> Job:
    return Job(_triangle_task(size), method, cost, driven=size == "large")  # Tables 2 and 3


def _forwarder_job(path: str, start: str, row: printed_values.Entry) -> Job:
    tracked = start == "smallest"  # Table 4
    return Job(_forwarder_task(path, start), row.method, row.cost, driven=tracked, switched=tracked)


# Tables 2 and 3.

CLOSE = 0.02  # ratios that differ by less need no reason
INFERRED = "no triangle gives all rows at once; the last section has the variation nearest to the printed value"
SIZED = "no triangle gives all rows at once (page triangle)"
LOCAL = "another local method: this one ends at the optimum, the printed one did not"
WHY = {("table2", "fmincon (CP)"): LOCAL, ("table3", "fmincon (LS)"): LOCAL}


def _line(experiment: str, row: str, value: float | None, ours: float | None, why: str, close: float = CLOSE) -> Line:
    """A line with its reason, if it differs enough to need one."""
    apart = ours is not None and value is not None and abs(ours - value) >= close
    return Line(experiment, row, value, ours, why if apart else "")


def _table_jobs(rows: tuple[printed_values.Entry, ...]) -> dict[str, Job]:
    return {row.name: _triangle_job("large", row.method, row.cost) for row in (*rows, printed_values.AS_WRITTEN)}


def _table_lines(name: str, rows: tuple[printed_values.Entry, ...], pump: str, got: Records) -> list[Line]:
    best = got[rows[0].name]
    rows = (*rows, printed_values.AS_WRITTEN)
    lines = []
    for row in rows:
        mine = got[row.name]
        ours = ratio(mine, best, PUMPS[pump])
        if ours is None:
            lines.append(Line(name, row.name, row.value, None, mine["status"]))
        else:
            line = _line(name, row.name, row.value, ours, WHY.get((name, row.name), INFERRED))
            lines.append(replace(line, why="; ".join(filter(None, (line.why, _broken(mine))))))
    for row, planned in zip(rows, tuple(lines), strict=True):
        ours = ratio(got[row.name], best, DRIVEN[pump])
        why = "" if planned.difference is None else f"{planned.difference:+.3f} as planned already"
        lines.append(_line(name, row.name + FULL, row.full, ours, why))
    return lines


def _broken(record: Record) -> str:
    """Limits that a record's motion breaks, in few words; empty if none."""
    if record["status"] == SOLVED:
        return ""
    limit = re.search(r"(position|velocity|acceleration) of (\w+)", record["status"])
    return f"breaks the {limit[1]} limit of {limit[2]}" if limit else record["status"]


# Figures 8 and 10: cost over grid size.


def _convergence_jobs(cost: str) -> dict[str, Job]:
    task = _triangle_task("large")
    jobs = {f"{p}x{v}": Job(task, COARSE, cost, (p, v)) for p, v in CONVERGENCE}
    return jobs | {"plan": _triangle_job("large", "dp", cost)}


def _convergence_lines(name: str, pump: str, got: Records) -> list[Line]:
    densest = got["{}x{}".format(*CONVERGENCE[-1])]
    lines = []
    for grid, record in got.items():
        row = "refined and polished" if grid == "plan" else f"grid {grid}"
        lines.append(
            Line(name, f"{row}: cost over that of the densest grid", None, ratio(record, densest, PUMPS[pump]))
        )
    return lines


# Cylinder sizes, sections 6.2 and 6.3, and the three triangles.

CHANGES = {"tilt 80/56": ("tilt", 0.080, 0.056), "extension 45/30": ("extension", 0.045, 0.030)}


def _sizing_jobs() -> dict[str, Job]:
    jobs = {}
    for size in SIZES:
        task = _triangle_task(size)
        for cost in PUMPS:
            jobs[f"{size}, {cost}"] = _triangle_job(size, "dp", cost)
            for change, cylinder in CHANGES.items():
                other = replace(task, machine=resized(task.machine, *cylinder))
                jobs[f"{change}, {size}, {cost}"] = Job(other, "dp", cost)
        jobs[f"{size}, pointwise"] = _triangle_job(size, "sns-actuator", "velocity")
    return jobs


def _sizing_lines(got: Records) -> list[Line]:
    lines = []
    said = {"tilt 80/56": printed_values.TILT_ROD, "extension 45/30": printed_values.EXTENSION_BORE}
    for change, claims in said.items():
        for size in SIZES:
            pairs = {pump: (got[f"{change}, {size}, {pump}"], got[f"{size}, {pump}"]) for pump in PUMPS}
            values = {key: by_size[size] for key, by_size in claims.items() if size in by_size}
            lines += _changes(f"{change}, {size} triangle", pairs, values)
    for pump, key in PUMPS.items():
        for size in SIZES:
            best, pointwise = got[f"{size}, {pump}"], got[f"{size}, pointwise"]
            row = f"{size} triangle: {pump.upper()} energy saved against the unweighted p-inv."
            saving = percent(best, pointwise, key)
            lines.append(Line("sizing", f"{row} [%]", None, None if saving is None else -saving))
            both = best[key], pointwise[key]
            less = None if None in both else (both[1] - both[0]) / 1e3
            lines.append(Line("sizing", f"{row} [kJ]", None, less))
    return lines


def _changes(what: str, pairs: Mapping[str, tuple[Record, Record]], values: Mapping[str, float]) -> list[Line]:
    """Effect of a change of a cylinder [%]; pairs are the new and old optimum of each pump."""
    lines = []
    for name, key, pump, quantity in (
        ("CP flow", "flow", "cp", "flow_m3"),
        ("highest pressure of the CP optimum", "pressure", "cp", "pressure_pa"),
        ("LS energy", "ls", "ls", "energy_ls_j"),
        ("highest pressure of the LS optimum", "", "ls", "pressure_pa"),
    ):
        ours = percent(*pairs[pump], quantity)
        value = values.get(key)
        more = key == "pressure" and ours is not None and value is not None and ours > value > 0.0
        why = "printed as well over 5 %" if more else SIZED
        lines.append(_line("sizing", f"{what}: change of {name} [%]", value, ours, why, close=1.0))
    return lines


# The 4-DOF paper's paths, Figures 10 to 12 and A4 to A6.


def _path_jobs(path: str) -> dict[str, Job]:
    return {
        f"{start}, {row.name}": _forwarder_job(path, start, row) for start in STARTS for row in printed_values.SOLUTIONS
    }


def _path_lines(path: str, got: Records) -> list[Line]:
    lines = []
    for start in STARTS:
        mine = {row.name: got[f"{start}, {row.name}"] for row in printed_values.SOLUTIONS}
        for pump, key in PUMPS.items():
            where = f"{pump.upper()}, {start} start"
            for name, record in mine.items():
                joules = record[key]
                ours = None if joules is None else joules / 1e3
                lines.append(Line(path, f"{where}: {name} [kJ]", None, ours, _broken(record)))
            best = mine["DP (LS)" if pump == "ls" else "DP (CP)"]
            for name in ("P-inv. (j.)", "P-inv. (a.)"):
                value = printed_values.EXCESS.get((path, pump)) if start == "smallest" else None
                why = _measured(ratio(mine[name], best, DRIVEN[pump]))
                lines.append(_line(path, f"{where}: {name} over the best", value, ratio(mine[name], best, key), why))
        cp, ls, pointwise = mine["DP (CP)"], mine["DP (LS)"], mine["P-inv. (a.)"]
        for row, under, printed in (
            ("best LS energy", ls, printed_values.CP_OVER_LS),
            ("LS energy of P-inv. (a.)", pointwise, printed_values.CP_BEST_OVER_LS_POINTWISE),
        ):
            value = printed.get(path) if start == "smallest" else None
            why = _measured(_over(cp["driven_cp_j"], under["driven_ls_j"]))
            ours = _over(cp["energy_cp_j"], under["energy_ls_j"])
            lines.append(_line(path, f"{start} start: best CP energy over {row}", value, ours, why))
    return lines


def _measured(closed: float | None) -> str:
    """Why a planned ratio differs from one that is measured on the real crane."""
    driven = "" if closed is None else f"{closed:.3f} in closed loop; "
    return f"{driven}what the paper says of energies, below, has another crane and place"


def _tracking_jobs() -> dict[str, Job]:
    return {
        f"{path}, {row.name}": _forwarder_job(path, "smallest", row)
        for path in PATHS
        for row in printed_values.SOLUTIONS
    }


def _tracking_lines(got: Records) -> list[Line]:
    """Table 4, the largest path error of every solution by ISO 9283 [m], and how many are within a factor of 2."""
    lines, with_all, counts = [], [], []
    for name, record in got.items():
        path, solution = name.split(", ")
        for pump, value in zip(PUMPS, printed_values.TABLE4[path, solution], strict=True):
            row = f"{path}, {pump.upper()}: {solution}"
            errors = {switch: record["switched_m"].get(f"{switch}, {pump}") for switch in (*SWITCHES, ALL)}
            errors = {NONE: record[f"accuracy_{pump}_m"], **errors}
            why = _nearer(value, errors, NONE)
            lines.append(_line("tracking", f"{row} [m]", value, errors[NONE], why))
            line = _line("tracking", f"{row}, {ALL} [m]", value, errors[ALL], _nearer(value, errors, ALL))
            with_all.append(replace(line, why="" if _is_close(line.ours, value) else line.why))
    for switch in (NONE, *SWITCHES, ALL):
        for path in PATHS:
            for pump in PUMPS:
                ours = _within(got, path, pump, switch)
                counts.append(Line("tracking", f"within a factor of 2, {switch}: {path}, {pump.upper()}", None, ours))
    return lines + with_all + counts


LATE = "the assumed delay of the valves: half of it takes P-inv. (a.) from 0.186 to 0.128 m (LS)"


def _nearer(printed: float, errors: Mapping[str, float | None], than: str) -> str:
    """Which switch brings an error nearer to the printed one than a given one does.

    Args:
        printed: The printed error [m].
        errors: Ours by switch, `NONE` and `ALL` included [m].
        than: The switch that is asked about.
    """
    off = {name: abs(log(error / printed)) for name, error in errors.items() if error}
    if than not in off:
        return ""
    nearest = min(off, key=off.__getitem__)
    return LATE if nearest == than else f"{errors[nearest]:.3f} with {nearest}"


def _is_close(error: float | None, printed: float) -> bool:
    """Whether an error is within a factor of 2 of the printed one."""
    return error is not None and 0.5 <= error / printed <= 2.0


NONE = "no switch"


def _within(got: Records, path: str, pump: str, switch: str) -> float:
    """How many solutions of a column of Table 4 have an error within a factor of 2 of the printed one."""
    count = 0
    for row in printed_values.SOLUTIONS:
        record = got[f"{path}, {row.name}"]
        ours = record[f"accuracy_{pump}_m"] if switch == NONE else record["switched_m"].get(f"{switch}, {pump}")
        printed = printed_values.TABLE4[path, row.name][("ls", "cp").index(pump)]
        count += _is_close(ours, printed)
    return float(count)


def _over(a: float | None, b: float | None) -> float | None:
    return None if a is None or not b else a / b


# What the 4-DOF paper's text says of energies, on the bundled crane and on the one that explains it best.

CASES = {
    f"{case}{where}": (case, keys)
    for case in ("bundled", "explaining")
    for where, keys in (("", PUMPS), (", closed loop", DRIVEN))
}


def _explaining_task(path: str) -> Task:
    return forwarder.explaining(_forwarder_task(path, "smallest"), path)


def _statement_jobs() -> dict[str, Job]:
    jobs = {}
    for path in PATHS:
        for row in printed_values.SOLUTIONS:
            if row.name in statements.SOLUTIONS:
                jobs[f"bundled, {path}, {row.name}"] = _forwarder_job(path, "smallest", row)
                task = _explaining_task(path)
                jobs[f"explaining, {path}, {row.name}"] = Job(task, row.method, row.cost, driven=True)
    return jobs


def _statement_lines(got: Records) -> list[Line]:
    """Of every statement, the ratio that decides whether it holds, in every case."""
    lines = []
    for statement in statements.STATEMENTS:
        for name, (case, keys) in CASES.items():
            records = {row: got[f"{case}, {statement.path}, {row}"] for row in statements.SOLUTIONS}
            energies = {row: (record[keys["ls"]], record[keys["cp"]]) for row, record in records.items()}
            whole = all(None not in pair for pair in energies.values())
            ours = statement.decisive(energies) if whole else None
            row = f"{statement.path}, {statement.text} ({statement.span}): {name}"
            lines.append(Line("statements", row, None, ours))
    return lines


# Sensitivity to what the papers do not print.

SWEPT = ("ls", "cp", "velocity", "actuator")
LIFT_ZEROS = {  # angle between its pins at joint angle 0 [rad]
    "eq. (30), retracted at 0.83 m": 1.118825,  # stroke 0.519 m
    "the angles of the pins' source": 1.005546,  # stroke 0.541 m
}


@functools.cache
def variations() -> Mapping[str, Task]:
    """The varied triangle tasks by name, the unvaried first."""
    base = _triangle_task("large")
    tasks = {"as bundled": base}
    tasks["pins derived from the strokes"] = replace(base, machine=derived_pins(base.machine))
    for reading, angle in LIFT_ZEROS.items():
        tasks[f"lift's zero by {reading}"] = replace(base, machine=zeroed(base.machine, angle))
    for factor in (0.8, 1.2):
        tasks[f"masses {100 * (factor - 1):+.0f} %"] = heavier(base, factor)
    tasks["triangle as assumed before"] = cornered(base, *EARLIER_TRIANGLE)
    for x, z in ((0.1, 0.0), (0.0, 0.1), (0.0, -0.1)):
        tasks[f"triangle moved by ({x:g}, {z:g}) m"] = moved(base, x, z)
    return tasks


@functools.cache
def path_variations(path: str) -> Mapping[str, Task]:
    """The varied tasks of a forwarder path by name, the unvaried first.

    Args:
        path: One of `PATHS`.
    """
    base = _forwarder_task(path, "smallest")
    tasks = {"as bundled": base}
    for factor in (0.8, 1.2):
        tasks[f"masses {100 * (factor - 1):+.0f} %"] = heavier(base, factor)
    for factor in (0.5, 2.0):
        tasks[f"friction x {factor:g}"] = rubbed(base, factor)
    for reading, what in (("public", "pins"), ("dead lengths", "dead lengths")):
        tasks[f"{what} of a public model"] = replace(base, machine=forwarder.pinned(base.machine, reading))
    tasks["masses of a public model"] = replace(base, machine=forwarder.bodied(base.machine))
    tasks["friction of a public model"] = replace(base, machine=forwarder.rubbing(base.machine, *forwarder.PUBLIC))
    return tasks


def _pointwise(method: str) -> bool:
    return method == SIGNED or METHODS.find(method).pointwise


def _sensitivity_jobs() -> dict[str, Job]:
    jobs = {}
    for name, task in variations().items():
        for cost in SWEPT:
            jobs[f"loader, {name}, {cost}"] = Job(task, "dp", cost, SWEEP_GRID)
        for row in printed_values.TABLE2:
            if _pointwise(row.method):
                jobs[f"loader, {name}, {row.method}"] = Job(task, row.method, row.cost)
    for path in PATHS:
        for name, task in path_variations(path).items():
            for pump in PUMPS:
                jobs[f"{path}, {name}, {pump}"] = Job(task, "dp", pump, SWEEP_GRID)
            for row in printed_values.SOLUTIONS:
                if METHODS.find(row.method).pointwise:
                    jobs[f"{path}, {name}, {row.method}"] = Job(task, row.method, row.cost)
    return jobs


def _sensitivity_lines(got: Records) -> list[Line]:
    lines = []
    for table, rows, pump in (("Table 2", printed_values.TABLE2, "cp"), ("Table 3", printed_values.TABLE3, "ls")):
        swept = [row for row in rows[1:] if row.method == "dp" or _pointwise(row.method)]
        for row in swept:
            for name in variations():
                mine = got[f"loader, {name}, {row.cost if row.method == 'dp' else row.method}"]
                ours = ratio(mine, got[f"loader, {name}, {pump}"], PUMPS[pump])
                lines.append(Line("sensitivity", f"{table}, {row.name}: {name}", row.value, ours))
    for path in PATHS:
        for pump, key in PUMPS.items():
            for solution, method in (("P-inv. (j.)", "sns-joint"), ("P-inv. (a.)", "sns-actuator")):
                for name in path_variations(path):
                    ours = ratio(got[f"{path}, {name}, {method}"], got[f"{path}, {name}, {pump}"], key)
                    value = printed_values.EXCESS.get((path, pump))
                    row = f"{path}, {pump.upper()}, {solution} over the best: {name}"
                    lines.append(Line("sensitivity", row, value, ours))
    return lines


EXPERIMENTS = {
    "table2": Experiment(
        "Constant pressure: pump flow relative to the least (3-DOF, Table 2)",
        lambda: _table_jobs(printed_values.TABLE2),
        lambda got: _table_lines("table2", printed_values.TABLE2, "cp", got),
    ),
    "table3": Experiment(
        "Load sensing: energy relative to the least (3-DOF, Table 3)",
        lambda: _table_jobs(printed_values.TABLE3),
        lambda got: _table_lines("table3", printed_values.TABLE3, "ls", got),
    ),
    "fig8": Experiment(
        "Convergence over the grid, constant pressure (3-DOF, Figure 8)",
        lambda: _convergence_jobs("cp"),
        lambda got: _convergence_lines("fig8", "cp", got),
    ),
    "fig10": Experiment(
        "Convergence over the grid, load sensing (3-DOF, Figure 10)",
        lambda: _convergence_jobs("ls"),
        lambda got: _convergence_lines("fig10", "ls", got),
    ),
    "sizing": Experiment(
        "Other cylinder sizes, three triangles (3-DOF, sections 6.2, 6.3)", _sizing_jobs, _sizing_lines
    ),
    **{
        path: Experiment(
            f"Pump energies, {path} (4-DOF, {figures})",
            lambda path=path: _path_jobs(path),
            lambda got, path=path: _path_lines(path, got),
        )
        for path, figures in zip(PATHS, ("Figures 10, A4", "Figures 11, A5", "Figures 12, A6"), strict=True)
    },
    "statements": Experiment(
        "What the 4-DOF paper says of energies (4-DOF, section 6)", _statement_jobs, _statement_lines
    ),
    "cycles": Experiment("Whole cycles (4-DOF, conclusions)", loading_cycles.jobs, loading_cycles.lines),
    "tracking": Experiment(
        "Largest path errors in closed loop by ISO 9283 (4-DOF, Table 4)", _tracking_jobs, _tracking_lines
    ),
    "sensitivity": Experiment(
        "What depends on values that the papers do not print", _sensitivity_jobs, _sensitivity_lines
    ),
}
