r"""Dynamic programming over the redundant cylinder: values backward, motions forward.

The problem, eqs. (29)-(30) of the 4-DOF paper: choose accelerations u_k of the redundant cylinder so that the sum of
stage costs is least. State (c, w), its position and velocity; dynamics the exact double integrator

    c_{k+1} = c_k + T_s w_k + T_s^2 u_k / 2,     w_{k+1} = w_k + T_s u_k,

so that the planned samples and the continuous motion agree. Bellman's equation (44),

    J_k(c, w) = min_u { T_s P_k(c, w, u) + penalties + J_{k+1}(c', w') },    J_N = slope |w|  (the path ends at rest),

is solved on grids that fit each stage: positions span exactly its feasible extensions, so limits lie on nodes.
J_{k+1} is interpolated bilinearly. Controls are not gridded: along u the right-hand side is (nearly) piecewise
linear and only its corners are tried (see `kernels.best_controls`).

Limits are exact slopes, not constants: violating a velocity or acceleration limit costs in proportion to its
size, `SLOPES` times the task's energy scale, steep enough that a feasible motion is preferred and flat enough that
interpolation next to a limit stays sane. What a rollout still violates is reported by the judge.

The error of the value is that of linear interpolation, first order in the grid spacing across the kinks of J.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from leanboom import crane as cranes
from leanboom import hydraulics, kernels, motion, stages
from leanboom.errors import InputError
from leanboom.motion import Motion
from leanboom.shaft import shaft_of
from leanboom.stages import Grid, Problem, Tables

# Penalty slopes relative to the energy scale: per stroke range [m], per velocity limit (state, cylinders), per
# acceleration limit. Measured: results change by less than 1 % between a tenth and ten times these.
SLOPES = (20.0, 1.5, 1.5, 0.2)


WORTH_SHARING = 600  # nodes of a stage that make another thread worth while


@dataclass(frozen=True, slots=True, eq=False)
class Policy:
    """Values of every state at every stage: the optimal motion from anywhere, by one-step look-ahead."""

    problem: Problem
    cost: str
    grid: Grid
    tables: Tables
    setting: np.ndarray  # kernels' scalars, (kernels.SETTINGS,)
    values: np.ndarray  # cost to go, float32, (stages + 1, positions, velocities)

    def __repr__(self) -> str:
        n, p, v = self.values.shape
        return f"Policy({self.problem.task.name}, {self.cost}: {n - 1} stages x {p} positions x {v} velocities)"


def energy_scale(problem: Problem, cost: str) -> float:
    """A typical total cost: what the steep slopes are relative to."""
    crane = problem.crane
    pose = cranes.pose(crane, problem.plane, 0.5 * (problem.lower + problem.upper))
    moving = cranes.move(pose, 0.0, 0.0)
    forces = cranes.forces(pose, moving)
    duration = problem.task.duration
    speed = 0.1 * crane.machine.redundant.velocity_limit
    if cost in ("velocity", "extension"):
        square = sum(v * v for v in moving.velocity) if cost == "velocity" else 0.0
        return float(np.mean(square + speed**2) * duration)
    drives = [*crane.drives, crane.drives[-1]]
    speeds = [*moving.velocity, np.full_like(problem.time, speed)]
    flow = sum(hydraulics.cylinder_flow(v, d.area_out, d.area_in) for v, d in zip(speeds, drives, strict=True))
    if cost == "actuator":
        work = sum(hydraulics.positive_work(v, f) for v, f in zip(moving.velocity, forces, strict=True))
        return float(np.mean(work + 0.05 * crane.machine.pump.constant_pressure * flow) * duration)
    # Recuperation pays back as well as it takes: its gains reach well beyond its total.
    spread = 10.0 if cost == "recuperation" else 1.0
    pressure, shaft = crane.machine.pump.constant_pressure, shaft_of(crane.machine.pump)
    power = pressure * flow + hydraulics.pump_losses(pressure, flow, shaft.idle, shaft.leak, shaft.drag)
    return float(spread * np.mean(power) * duration)


def slopes(problem: Problem, cost: str) -> tuple[float, float, float, float]:
    """Penalties per violated m, m/s of the state, m/s and m/s^2 of a cylinder, in units of the cost."""
    scale = energy_scale(problem, cost)
    low, high = stages.stroke_range(problem.task)
    cylinders = problem.crane.machine.cylinders[problem.moving]
    fastest = min(c.velocity_limit for c in cylinders)
    hardest = min(c.acceleration_limit for c in cylinders)
    c, w, v, a = SLOPES
    return (
        scale * c / (high - low),
        scale * w / problem.crane.machine.redundant.velocity_limit,
        scale * v / fastest,
        scale * a / hardest,
    )


def memory(stages_: int, positions: int, velocities: int) -> int:
    """Bytes a policy of this size takes: tables, float32 values of all stages, a few float64 layers."""
    nodes = (stages_ + 1) * positions
    return nodes * (4 * velocities + 8 * (3 * kernels.COEFFICIENTS + 1) + 8 * 60) + 4 * 8 * positions * velocities


def check_memory(stages_: int, positions: int, velocities: int, limit: float | None = None) -> None:
    """Raise InputError where a grid would not fit into the memory that is free."""
    need = memory(stages_, positions, velocities)
    limit = free_memory() if limit is None else limit
    if need > 0.8 * limit:
        raise InputError(
            f"grid {positions}x{velocities} over {stages_} stages needs {need / 2**30:.1f} GiB, "
            f"{limit / 2**30:.1f} GiB are free; choose a coarser --grid or a longer --step"
        )


def free_memory() -> float:
    """Memory this process may still take [bytes]; a generous guess where the system does not say."""
    try:
        with open("/proc/meminfo", encoding="ascii") as file:
            for line in file:
                if line.startswith("MemAvailable"):
                    return float(line.split()[1]) * 1024.0
    except OSError:
        pass
    return 4.0 * 2**30


def solve(problem: Problem, grid: Grid, cost: str) -> Policy:
    """Sweep backward over a grid.

    Args:
        problem: The discretised task.
        grid: Position and velocity nodes of every stage.
        cost: A name of `objective.COSTS`.

    Returns:
        The policy over that grid.
    """
    table = stages.tables(problem, grid, cost)
    steep = slopes(problem, cost)
    setting = stages.setting(problem, cost, steep)
    last = table.stage[-1]
    w = last[kernels.W_LO] + last[kernels.DW] * np.arange(grid.velocities)
    terminal = np.repeat((steep[1] * np.abs(w))[None, :], grid.positions, axis=0)
    values = np.empty((problem.stages + 1, grid.positions, grid.velocities), dtype=np.float32)
    problem_arrays = table.coefficients, table.outside, table.stage, table.cylinder, setting
    workers = min(stages.threads(), grid.positions * grid.velocities // WORTH_SHARING)
    if workers < 2:
        kernels.sweep(*problem_arrays, terminal, values)
    else:
        _sweep_shared(problem_arrays, terminal, values, workers)
    return Policy(problem, cost, grid, table, setting, values)


def _sweep_shared(problem_arrays: Any, terminal: np.ndarray, values: np.ndarray, workers: int) -> None:
    """The backward pass with every stage's positions shared among threads; the same bits as `kernels.sweep`."""
    stages_, positions = values.shape[0] - 1, values.shape[1]
    bounds = np.linspace(0, positions, workers + 1).astype(int).tolist()
    ahead, here = terminal.copy(), np.empty_like(terminal)
    values[stages_] = terminal
    with ThreadPoolExecutor(workers - 1) as pool:
        for k in range(stages_ - 1, -1, -1):
            arrays: Any = (*problem_arrays, ahead, here, values)
            parts = [
                pool.submit(kernels.sweep_stage, k, first, last, *arrays)
                for first, last in zip(bounds[1:-1], bounds[2:], strict=True)
            ]
            kernels.sweep_stage(k, 0, bounds[1], *arrays)
            for part in parts:
                part.result()
            ahead, here = here, ahead


def rollout(policy: Policy, start: float, method: str = "dp") -> Motion:
    """The policy's motion from rest at a start position [m]."""
    problem, table = policy.problem, policy.tables
    position, velocity = np.empty(problem.stages + 1), np.empty(problem.stages + 1)
    control = np.empty(problem.stages)
    kernels.rollout(
        table.coefficients, table.outside, table.stage, table.cylinder, policy.setting, policy.values,
        np.array([start, 0.0]), 0, position, velocity, control,
    )  # fmt: skip
    return motion.make(problem.step, position, velocity, control, method, policy.cost)


def best_start(policy: Policy) -> float:
    """The start position [m] of least cost from rest."""
    stage = policy.tables.stage[0]
    column = int(round(-stage[kernels.W_LO] / stage[kernels.DW]))
    column = min(max(column, 0), policy.grid.velocities - 1)
    values = policy.values[0, :, column] + policy.setting[kernels.SLOPE_C] * policy.tables.outside[0]
    return float(stage[kernels.C_LO] + stage[kernels.DC] * int(values.argmin()))


def start_position(problem: Problem, start: str | float) -> float | None:
    """The start of the redundant cylinder [m] that a task asks for; None for `best`.

    Raises:
        InputError: If a given length is outside the feasible extensions at the start of the path.
    """
    intervals = problem.intervals[0]
    if start == "smallest":
        return float(problem.lower[0])
    if start == "middle":
        # Between the smallest and the largest feasible length; beside a gap, its nearest end.
        middle = 0.5 * (problem.lower[0] + problem.upper[0])
        nearest = np.clip(middle, intervals[:, 0], intervals[:, 1])
        return float(nearest[np.abs(nearest - middle).argmin()])
    if start == "best":
        return None
    length = float(start)
    if not np.any((intervals[:, 0] - 1e-9 <= length) & (length <= intervals[:, 1] + 1e-9)):
        allowed = " or ".join(f"{low:.4f} m to {high:.4f} m" for low, high in intervals)
        raise InputError(f"start = {length:g} m; feasible at the beginning of this path: {allowed}")
    return length


def prepare() -> None:
    """Load the compiled kernels, compiling them on the very first run, by solving a problem of a few nodes."""
    coefficients = np.zeros((2, 2, 1, kernels.COEFFICIENTS))
    stage = np.ones((2, kernels.STAGE_COLUMNS))
    setting = np.ones(kernels.SETTINGS)
    values = np.zeros((2, 2, 2), dtype=np.float32)
    cylinder = np.ones((1, kernels.CYLINDER_COLUMNS))
    arrays = coefficients, np.zeros((2, 2)), stage, cylinder, setting
    kernels.sweep(*arrays, np.zeros((2, 2)), values)
    _sweep_shared(arrays, np.zeros((2, 2)), values, 2)
    kernels.rollout(
        coefficients, np.zeros((2, 2)), stage, cylinder, setting, values, np.zeros(2), 0, np.zeros(2), np.zeros(2),
        np.zeros(1),
    )  # fmt: skip
