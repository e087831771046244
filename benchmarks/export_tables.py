"""Stage tables for dynamic programming elsewhere: `python -m benchmarks.export_tables TASK tables.mat`.

Writes all physics of a task on (stage, position) nodes as a .mat file for GNU Octave's or Matlab's `dpm`;
docs/octave-dpm.md lists every name and unit. `--judge motion.mat` measures what came back.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from scipy.io import loadmat, savemat

import leanboom as lb
from leanboom.dynamic_programming import grids
from leanboom.errors import InputError
from leanboom.evaluation.evaluate import Evaluation
from leanboom.model import motion
from leanboom.model.task import Task
from leanboom.problem import cost_scale, layout, stage_arrays, stages, starts

INFINITE = 100.0  # cost of an infeasible state, in typical costs of the task
STAGE = {
    "c_lo": layout.C_LO, "dc": layout.DC, "w_lo": layout.W_LO, "dw": layout.DW,
    "fixed_flow": layout.FIXED_FLOW, "fixed_pressure": layout.FIXED_PRESSURE,
}  # fmt: skip
CYLINDER = {
    "area_out": layout.AREA_OUT, "area_in": layout.AREA_IN, "gain_out": layout.GAIN_OUT,
    "back_out": layout.BACK_OUT, "gain_in": layout.GAIN_IN, "back_in": layout.BACK_IN,
    "sharpness": layout.SHARPNESS, "viscous": layout.VISCOUS, "velocity_limit": layout.V_MAX,
    "acceleration_limit": layout.A_MAX,
}  # fmt: skip
SETTING = {
    "step": layout.STEP, "epsilon": layout.EPSILON, "efficiency": layout.EFFICIENCY, "idle": layout.IDLE,
    "leak": layout.LEAK, "drag": layout.DRAG,
}  # fmt: skip
COLUMNS = "a0 a1 b0 b1 b2 b3 f0 f1 f2 f3 coulomb"  # of a node's coefficients, in the order of `bellman`
UNITS = {
    "start": "m", "velocities": "1", "time": "s", "outside": "m", "infinite": "J",
    "coefficients": "m/s 1 m/s^2 1/s 1/m 1 N N.s/m N.s^2/m^2 kg N", "c_lo": "m", "dc": "m", "w_lo": "m/s", "dw": "m/s",
    "fixed_flow": "m^3/s", "fixed_pressure": "Pa", "area_out": "m^2", "area_in": "m^2", "gain_out": "1/m^2",
    "back_out": "Pa", "gain_in": "1/m^2", "back_in": "Pa", "sharpness": "s/m", "viscous": "N.s/m",
    "velocity_limit": "m/s", "acceleration_limit": "m/s^2", "step": "s", "epsilon": "m/s", "supply_cp": "Pa",
    "margin": "Pa", "efficiency": "1", "idle": "W", "leak": "W/Pa", "drag": "W.s^2/m^6",
}  # fmt: skip


def export(task: Task, pump: str, grid: tuple[int, int], step: float, file: Path) -> None:
    """Write a task's tables.

    Args:
        task: The task, with a start other than `best`.
        pump: "ls" or "cp".
        grid: Position and velocity nodes.
        step: Length of a stage [s].
        file: Where to write; MAT-file version 5.
    """
    problem = stages.discretise(task, step)
    start = starts.start_position(problem, task.start)
    if start is None:
        raise InputError("start = best; dpm simulates forward from one start: smallest, middle or a length")
    table = grids.tables(problem, grids.full_grid(problem, *grid), pump)
    setting = stage_arrays.setting(problem, pump, (0.0,) * 5)
    contents = {
        "task": task.name, "pump": pump, "start": start, "velocities": float(table.velocities),
        "time": problem.time, "coefficients": table.coefficients, "outside": table.outside,
        "infinite": INFINITE * cost_scale.energy_scale(problem, pump),
    }  # fmt: skip
    contents |= {name: table.stage[:, column] for name, column in STAGE.items()}
    contents |= {name: table.cylinder[:, column] for name, column in CYLINDER.items()}
    contents |= {name: float(setting[entry]) for name, entry in SETTING.items()}
    given = task.machine.pump
    contents |= {"supply_cp": given.constant_pressure, "margin": given.ls_margin}
    savemat(file, contents | {"columns": COLUMNS, "units": UNITS})


def judge(file: Path) -> tuple[Evaluation, str]:
    """Measure a motion that came back.

    Args:
        file: A .mat file with `task`, `pump`, `step` [s], `start` [m] and `velocity` at the stages [m/s].

    Returns:
        The judged motion, and the pump it was planned for.
    """
    found = loadmat(file, squeeze_me=True)
    pump = str(found["pump"])
    back = motion.from_velocities(float(found["step"]), float(found["start"]), found["velocity"], "dpm", pump)
    return lb.evaluate(lb.load_task(str(found["task"])), back), pump


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("task", nargs="?", help="a bundled task")
    parser.add_argument("file", nargs="?", type=Path, help="the .mat file to write")
    parser.add_argument("--pump", choices=("ls", "cp"), default="ls")
    parser.add_argument("--start", help="smallest, middle or a length; default: the task's")
    parser.add_argument("--grid", default="101x51", help="position x velocity nodes")
    parser.add_argument("--step", type=float, default=0.1, help="length of a stage [s]")
    parser.add_argument("--judge", type=Path, metavar="FILE", help="measure a motion that came back")
    arguments = parser.parse_args()
    if arguments.judge is not None:
        judged, pump = judge(arguments.judge)
        print(f"{judged.energy(pump) / 1e3:.3f} kJ ({pump})", *(judged.violations or ["keeps all limits"]), sep="\n")
        return
    if arguments.file is None:
        parser.error("say which TASK to export, and to which FILE")
    positions, velocities = (int(size) for size in arguments.grid.split("x"))
    task = lb.load_task(arguments.task, start=arguments.start)
    export(task, arguments.pump, (positions, velocities), arguments.step, arguments.file)


if __name__ == "__main__":
    main()
