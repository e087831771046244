"""The run folder of a plan: everything about one run in files that open without leanboom.

It appears as a whole or not at all. An earlier run folder gives way to a new one; a folder that holds anything else is
never touched.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from leanboom.errors import InputError
from leanboom.io import folders
from leanboom.io.yaml_source import shortened
from leanboom.planning.summaries import KEYS, summary
from leanboom.report import simulation_page

if TYPE_CHECKING:
    import numpy as np

    from leanboom.evaluation.evaluate import Evaluation
    from leanboom.model.motion import Motion
    from leanboom.model.task import Task
    from leanboom.planning.planner import Plan
    from leanboom.simulation.closed_loop import Simulation

SUMMARY, TASK, MACHINE, TRAJECTORY, REPORT = FILES = (
    "summary.json",
    "task.yaml",
    "machine.yaml",
    "trajectory.csv",
    "report.html",
)
ALLOWED = (*FILES, *simulation_page.FILES)  # what a simulation adds is kept by `simulate` alone
MAX_SUMMARY, MAX_TRAJECTORY = 2**20, 2**29  # [bytes]
TOLERANCE = 1e-3  # of a sample's time, as a share of the step, and of the end, as a share of the duration
LEAST_JUMP = 1e-5  # [m/s^2] of an acceleration between two samples, from where a stage is looked for
APART = 2e-3  # [m], between a length and what the velocities before it lead to
PUMPS = ("ls", "cp")
EARLIER = tuple(key for key in KEYS if key != "legs")  # of a summary, before tasks could have legs


def columns(evaluation: Evaluation) -> dict[str, np.ndarray]:
    """The columns of `trajectory.csv` by name, in their order, (samples,) each.

    Args:
        evaluation: The judged motion.
    """
    e = evaluation
    table = {"time_s": e.time, "x_m": e.tool[:, 0], "y_m": e.tool[:, 1], "z_m": e.tool[:, 2]}
    names = e.task.machine.names
    for j, name in enumerate(names):
        unit = "m" if name == "extension" else "rad"
        table[f"{name}_{unit}"] = e.joint_position[:, j]
        table[f"{name}_{unit}_s"] = e.joint_velocity[:, j]
        table[f"{name}_{unit}_s2"] = e.joint_acceleration[:, j]
    for j, name in enumerate(names):
        table[f"{name}_cylinder_m"] = e.length[:, j]
        table[f"{name}_cylinder_m_s"] = e.velocity[:, j]
        table[f"{name}_cylinder_m_s2"] = e.acceleration[:, j]
        table[f"{name}_force_n"] = e.force[:, j]
        table[f"{name}_pressure_pa"] = e.pressure[:, j]
        table[f"{name}_flow_m3_s"] = e.flow[:, j]
    table["pump_flow_m3_s"] = e.pump_flow
    table["supply_ls_pa"] = e.supply_ls
    table["supply_cp_pa"] = e.supply_cp
    table["power_ls_w"] = e.power_ls
    table["power_cp_w"] = e.power_cp
    table["energy_ls_j"] = e.cumulative_ls
    table["energy_cp_j"] = e.cumulative_cp
    return table


def check(out: Path) -> None:
    """Raise InputError if a run folder must not be written at a place.

    Args:
        out: Where the run folder is wanted.
    """
    folders.check(out, ALLOWED, _is_run_folder, "an earlier run folder")


@contextmanager
def reserved(out: Path | None) -> Iterator[None]:
    """Context that reserves a place for a run folder while its contents are computed; without a place, nothing.

    Args:
        out: Where the run folder is wanted.

    Raises:
        InputError: The folder cannot be written there, or another run is about to.
    """
    if out is None:
        yield
        return
    check(out)
    with folders.reserved(out):
        yield


def _is_run_folder(folder: Path) -> bool:
    """Whether a folder holds what `write` writes and nothing else."""
    entries = list(folder.iterdir())
    if any(path.name not in ALLOWED or path.is_symlink() or not path.is_file() for path in entries):
        return False
    return tuple(_kept(folder)) in (KEYS, EARLIER)


def _kept(folder: Path) -> dict[str, Any]:
    """The data of a folder's summary; empty where it is none."""
    try:
        with (folder / SUMMARY).open("rb") as stream:
            found = json.loads(stream.read(MAX_SUMMARY))  # of a longer file the end is missing, and it is none
    except (OSError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def write(plan: Plan, out: Path, grid: tuple[int, int] | None = None, simulation: Simulation | None = None) -> Path:
    """Write the run folder of a plan.

    Args:
        plan: The plan.
        out: The folder; new, empty, or an earlier run folder, which is replaced.
        grid: Position and velocity nodes the plan was made with, for the report.
        simulation: The plan driven in closed loop, if it was.

    Returns:
        The folder.

    Raises:
        InputError: The folder holds something else, or cannot be written.
    """
    from leanboom.io import loading
    from leanboom.report import plan_page

    check(out)
    texts = {
        SUMMARY: json.dumps(summary(plan, out), indent=2, ensure_ascii=False, allow_nan=False) + "\n",
        TASK: loading.dump_task(plan.task, MACHINE),
        MACHINE: loading.dump_machine(plan.task.machine),
        TRAJECTORY: trajectory(plan.evaluation),
        REPORT: plan_page.page(plan, grid),
    }
    if simulation is not None:
        texts |= simulation_page.texts(simulation, out)
    folders.put(out, {name: text.encode() for name, text in texts.items()})
    return out


def add(run: Path, out: Path, simulation: Simulation) -> Path:
    """Write a simulation beside the plan it drove.

    Args:
        run: The plan's run folder.
        out: The folder to write, which may be the same; see `write`.
        simulation: The plan driven in closed loop.

    Returns:
        The folder.

    Raises:
        InputError: The folder holds something else, or cannot be written.
    """
    check(out)
    with folders.explained(run, "run", "cannot be read"):
        kept = {name: (run / name).read_bytes() for name in FILES}
    texts = simulation_page.texts(simulation, out)
    folders.put(out, kept | {name: text.encode() for name, text in texts.items()})
    return out


def read(run: Path) -> tuple[Task, Motion, str]:
    """The task, the motion and the pump of a run folder.

    Args:
        run: The folder.

    Raises:
        InputError: It is no run folder, or its files do not fit together.
    """
    from dataclasses import replace

    import numpy as np

    from leanboom.io import loading
    from leanboom.model import motion

    with folders.explained(run, "run", "cannot be read"):
        if not run.is_dir() or not _is_run_folder(run):
            raise InputError(f"run = {run}; is not a run folder: make one with leanboom plan TASK --out DIR")
        kept = _kept(run)
        time, position, velocity, acceleration = _samples(run / TRAJECTORY)
    for key, valid in (("pump", PUMPS), ("method", None), ("cost", None)):
        if not isinstance(kept[key], str) or (valid and kept[key] not in valid):
            allowed = f"one of {', '.join(valid)}" if valid else "a name"
            raise _damaged(run / SUMMARY, f"{key} = {shortened(str(kept[key]), 100)}; must be {allowed}")
    # What was filtered before it was judged is not filtered again.
    task = replace(loading.load_task(run / TASK), smooth=None)
    _check_times(run / TRAJECTORY, time, task)
    if abs(time[-1] - task.duration) > TOLERANCE * task.duration:
        raise _damaged(run / TRAJECTORY, f"ends at {time[-1]:g} s; the task ends at {task.duration:g} s")
    names = str(kept["method"]), str(kept["cost"])
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            times, velocities = _stages(time, velocity, acceleration)
            found = motion.from_velocities_at(times, position[0], velocities, *names)
    except InputError as error:
        raise _damaged(run / TRAJECTORY, str(error)) from None
    led = found.position[np.searchsorted(times, time)]
    apart = np.abs(led - position)
    if not np.all(apart <= APART):
        k = int(np.argmax(~(apart <= APART)))
        raise _damaged(
            run / TRAJECTORY,
            f"extension_cylinder_m = {position[k]:g} m at {time[k]:g} s; the velocities before lead to {led[k]:g} m",
        )
    return task, found, str(kept["pump"])


def _stages(time: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and velocities [m/s] where accelerations may change: at samples, and at stages between two of them.

    Args:
        time, velocity, acceleration: Of the samples [s], [m/s], [m/s^2]; a sample's acceleration lasts from it to the
            next stage, (samples,).
    """
    import numpy as np

    step, jump = np.diff(time), acceleration[:-1] - acceleration[1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        after = (np.diff(velocity) - acceleration[1:] * step) / jump  # velocities are linear before a stage and after
    between = (np.abs(jump) > LEAST_JUMP) & (after > TOLERANCE * step) & (after < (1.0 - TOLERANCE) * step)
    times = np.concatenate([time, (time[:-1] + after)[between]])
    velocities = np.concatenate([velocity, (velocity[:-1] + acceleration[:-1] * after)[between]])
    order = np.argsort(times)
    return times[order], velocities[order]


def _samples(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Times [s], and lengths [m], velocities [m/s] and accelerations [m/s^2] of the redundant cylinder, (samples,)."""
    import csv

    import numpy as np

    wanted = ("time_s", "extension_cylinder_m", "extension_cylinder_m_s", "extension_cylinder_m_s2")
    if path.stat().st_size > MAX_TRAJECTORY:
        raise _damaged(path, f"is above {MAX_TRAJECTORY // 2**20} MiB")
    numbers: list[list[float]] = []
    with path.open(encoding="utf-8", newline="") as stream:
        rows = csv.DictReader(stream)
        try:
            for row in rows:
                numbers.append([float(row[name]) for name in wanted])
                if not all(map(math.isfinite, numbers[-1])):
                    raise ValueError
        except (KeyError, TypeError, ValueError, csv.Error):
            raise _damaged(path, f"line {rows.line_num} lacks finite numbers in {', '.join(wanted)}") from None
    if len(numbers) < 2:
        raise _damaged(path, "needs two samples or more")
    time, position, velocity, acceleration = np.array(numbers).T
    return time, position, velocity, acceleration


def _check_times(path: Path, time: np.ndarray, task: Task) -> None:
    """Raise InputError unless times [s] rise evenly from 0; with legs, in each of them and while waiting."""
    import numpy as np

    inner = [int(np.argmin(np.abs(time - each.until))) for each in task.stretches[:-1]]
    first = 0
    for last in [*inner, time.size - 1]:
        since = time[first] if first else 0.0
        step = (time[last] - since) / max(last - first, 1)
        uneven = np.abs(time[first : last + 1] - since - step * np.arange(last - first + 1)) > TOLERANCE * step
        if step <= 0.0 or last <= first or np.any(uneven):
            k = first + int(np.argmax(uneven))
            raise _damaged(path, f"time_s = {time[k]:g} s in sample {k}; times must rise evenly from 0")
        first = last


def _damaged(path: Path, problem: str) -> InputError:
    return InputError(f"{path}: {problem}: the file was changed or damaged; plan again")


def trajectory(evaluation: Evaluation) -> str:
    """The text of `trajectory.csv`: ten significant digits, one row a sample of 2 ms.

    Args:
        evaluation: The judged motion.
    """
    import numpy as np

    table = columns(evaluation)
    row = ",".join(["%.10g"] * len(table))
    values = np.stack(list(table.values()), axis=1) + 0.0  # no minus zeros
    return "\n".join([",".join(table), *(row % tuple(sample) for sample in values.tolist())]) + "\n"
