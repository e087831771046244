r"""Dynamic programming over the redundant cylinder: values backward, motions forward.

The problem, eqs. (29)-(30) of the 4-DOF paper: choose accelerations u_k of the redundant cylinder so that the sum of
stage costs is least. State (c, w), its position and velocity; dynamics the exact double integrator

    c_{k+1} = c_k + T_s w_k + T_s^2 u_k / 2,     w_{k+1} = w_k + T_s u_k,

so that the planned samples and the continuous motion agree. Bellman's equation (44),

    J_k(c, w) = min_u { T_s P_k(c, w, u) + penalties + J_{k+1}(c', w') },    J_N = slope |w|  (the path ends at rest),

is solved on grids that fit each stage: positions span exactly its feasible extensions, so limits lie on nodes.
J_{k+1} is interpolated bilinearly. Controls are not gridded: along u the right-hand side is (nearly) piecewise
linear and only its corners are tried (see `bellman.best_controls`).

Limits are exact slopes, not constants: violating a velocity or acceleration limit costs in proportion to its
size, `SLOPES` times the task's energy scale, steep enough that a feasible motion is preferred and flat enough that
interpolation next to a limit stays sane. What a rollout still violates is reported by the judge.

The error of the value is that of linear interpolation, first order in the grid spacing across the kinks of J.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

import numpy as np

from leanboom import resources
from leanboom.dynamic_programming import grids, lookahead, sweeps
from leanboom.dynamic_programming.grids import Grid, Tables
from leanboom.errors import InputError
from leanboom.evaluation import safe_stop
from leanboom.evaluation.safe_stop import Continuation
from leanboom.model import motion
from leanboom.model.motion import Motion
from leanboom.problem import feasible_strokes, layout, stage_arrays
from leanboom.problem.cost_scale import energy_scale
from leanboom.problem.stages import Problem
from leanboom.quantities import ranges
from leanboom.quantities.ranges import noted

# Penalty slopes relative to the energy scale: per stroke range [m], per velocity limit (state, cylinders), per
# acceleration limit, per largest flow of the pump. Measured: results change by less than 1 % between a tenth and ten
# times the first four.
SLOPES = (20.0, 1.5, 1.5, 0.2, 1.5)


RUNAWAY = 100.0  # velocity limits, where a rollout without a way on is cut off: far beyond what is feasible
WORTH_SHARING = 2000  # nodes of a stage that make another thread worth while
STAGE_HIT = 1e-9  # times this close to a stage, relative to its length, are the stage's
REACHED = 1e-9  # [m], [m/s]: states this far off the grid are on it

Terminal = Callable[[np.ndarray, np.ndarray], np.ndarray]  # cost [J] of positions [m] and velocities [m/s], broadcast


@dataclass(frozen=True, slots=True, eq=False)
class Policy:
    """Value function of every stage: the optimal motion from any state follows by one-step look-ahead."""

    problem: Problem
    cost: str
    grid: Grid
    tables: Tables
    setting: np.ndarray  # kernels' scalars, (layout.SETTINGS,)
    values: np.ndarray  # cost to go, float32, (stages + 1, positions, velocities)
    end: float | None = None  # where motions end [m]; None: anywhere

    def control(self, time: float, position: float, velocity: float) -> float:
        """The best acceleration of the redundant cylinder from any state on the way, by one-step look-ahead.

        Between two stages the remaining part of the stage is the step, its tables taken linearly in time. The first
        call ever on a machine compiles for some seconds: a controller should ask once before it counts.

        Args:
            time: Time on the path [s], from 0 to before its end.
            position, velocity: Actual state of the redundant cylinder [m], [m/s].

        Returns:
            Its acceleration [m/s^2], to be held until the next stage or the next query.

        Raises:
            InputError: If the time is not on the path or the state more than half a node spacing off the grid.
        """
        stage, share = self._locate(time, position, velocity)
        table = self.tables
        return lookahead.control(
            table.coefficients, table.outside, table.stage, table.cylinder, self.setting, self.values,
            stage, share, float(position), float(velocity),
        )  # fmt: skip

    def replan(self, time: float, position: float, velocity: float) -> Continuation:
        """The policy's motion from any state on the way to the end of the task, judged.

        Args:
            time: Time on the path [s], from 0 to before its end.
            position, velocity: Actual state of the redundant cylinder [m], [m/s].

        Returns:
            The motion of the remaining task, or the safest stop where that motion breaks a limit; its status says so.

        Raises:
            InputError: If the time is not on the path or the state more than half a node spacing off the grid.
        """
        stage, share = self._locate(time, position, velocity)
        problem, table = self.problem, self.tables
        first = self.control(time, position, velocity)
        lead = problem.step * (1.0 - share)
        c, w = np.empty(problem.stages + 1), np.empty(problem.stages + 1)
        u = np.empty(problem.stages)
        after = np.array([position + lead * (velocity + 0.5 * lead * first), velocity + lead * first])
        c[stage], w[stage], u[stage] = position, velocity, first
        sweeps.rollout(
            table.coefficients, table.outside, table.stage, table.cylinder, self.setting, self.values,
            after, stage + 1, c, w, u,
        )  # fmt: skip
        rest = _motion(problem, c[stage:], w[stage:], u[stage:], "dp", self.cost, lead=lead if share > 0.0 else None)
        since = problem.step * (stage + share)
        if self.end is None:
            return safe_stop.resume(problem.task, since, rest)
        return safe_stop.resume(replace(problem.task, end=self.end), since, motion.ending_at(rest, self.end))

    def _locate(self, time: float, position: float, velocity: float) -> tuple[int, float]:
        """Stage that a time belongs to, and the share of it gone; InputError for what the grid does not hold."""
        problem, grid = self.problem, self.grid
        duration = problem.time[-1]
        if not 0.0 <= time < duration - STAGE_HIT * problem.step:
            raise InputError(f"time = {time:g} s; must be from 0 s to before the end of the path at {duration:g} s")
        stage = int(time / problem.step + STAGE_HIT)
        share = max(0.0, time / problem.step - stage)
        share = share if share > STAGE_HIT else 0.0
        for name, unit, value, low, high, count in (
            ("position", "m", position, grid.c_lo, grid.c_hi, grid.positions),
            ("velocity", "m/s", velocity, grid.w_lo, grid.w_hi, grid.velocities),
        ):
            least = float((1.0 - share) * low[stage] + share * low[stage + 1])
            most = float((1.0 - share) * high[stage] + share * high[stage + 1])
            if not abs(value - 0.5 * (least + most)) <= 0.5 * (most - least) * count / (count - 1) + REACHED:
                raise InputError(
                    f"{name} = {value:g} {unit} at {time:g} s; this policy holds {least:.4f} {unit} to {most:.4f} "
                    f"{unit} there: plan again from the state with leanboom.replan, or solve the policy on a wider grid"
                )
        return stage, share

    def __repr__(self) -> str:
        n, p, v = self.values.shape
        return f"Policy({self.problem.task.name}, {self.cost}: {n - 1} stages x {p} positions x {v} velocities)"


def slopes(problem: Problem, cost: str) -> tuple[float, float, float, float, float]:
    """Penalties per violated m, m/s of the state, m/s and m/s^2 of a cylinder, m^3/s of the pump, in the cost's unit.

    That of the flow is 0 where it is no limit.
    """
    scale = energy_scale(problem, cost)
    low, high = feasible_strokes.stroke_range(problem.task)
    cylinders = problem.crane.machine.cylinders[problem.moving]
    fastest = min(c.velocity_limit for c in cylinders)
    hardest = min(c.acceleration_limit for c in cylinders)
    c, w, v, a, f = SLOPES
    return (
        scale * c / (high - low),
        scale * w / problem.pace,
        scale * v / fastest,
        scale * a / hardest,
        scale * f / problem.task.flow_limit,
    )


def memory(stages_: int, positions: int, velocities: int) -> int:
    """Bytes a policy of this size takes: tables, float32 values of all stages, a few float64 layers."""
    nodes = (stages_ + 1) * positions
    return nodes * (4 * velocities + 8 * (3 * layout.COEFFICIENTS + 1) + 8 * 60) + 4 * 8 * positions * velocities


def check_memory(stages_: int, positions: int, velocities: int, limit: float | None = None) -> None:
    """Raise InputError where a grid would not fit into the memory that is free."""
    need = memory(stages_, positions, velocities)
    what = f"grid {positions}x{velocities} over {stages_} stages"
    resources.check_memory(need, what, "choose a coarser --grid or a longer --step", limit)


def nodes(grid: object) -> tuple[int, int]:
    """Numbers of position and velocity nodes.

    Args:
        grid: Two whole numbers, of Python or NumPy.

    Raises:
        InputError: It is something else, or a number is below 3.
    """
    given = ranges.listed("grid", grid, "two whole numbers, positions and velocities, such as (141, 71)", 2, 2)
    numbers = [float(value) if isinstance(value, Real) else np.nan for value in given]
    whole = [int(value) if np.isfinite(value) and value == int(value) else None for value in numbers]
    text = "x".join(ranges.shown(value) for value in given)
    positions, velocities = whole
    if positions is None or velocities is None:
        raise InputError(f"grid = {text}; must be two whole numbers")
    if min(positions, velocities) < 3:
        raise InputError(f"grid = {text}; needs at least 3 positions and 3 velocities")
    return positions, velocities


def sizes(grid: object, step: object, stage: ranges.Range, problems: list[str]) -> tuple[tuple[int, int], float]:
    """Numbers of nodes, and the length of a stage [s], as they are used.

    Args:
        grid: Numbers of position and velocity nodes.
        step: Length of a stage.
        stage: Its range.
        problems: What else is wrong with a call.

    Raises:
        InputError: There are problems, or one of the two cannot be used; all in one message.
    """
    found = noted(problems, nodes, grid), noted(problems, ranges.checked, "step", step, stage)
    if found[0] is None or found[1] is None or problems:
        raise InputError("; ".join(problems))
    return found[0], found[1]


def solve(
    problem: Problem, grid: Grid, cost: str, terminal: Terminal | None = None, end: float | None = None
) -> Policy:
    """The `Policy` of a problem and a cost, by a backward sweep over a grid.

    Args:
        problem: The discretised task.
        grid: Position and velocity nodes of every stage.
        cost: A name of `costs.COSTS`.
        terminal: What a position and a velocity at the last stage cost; None: the path ends at rest.
        end: Where it ends at rest [m]; None: anywhere.

    Returns:
        The policy over that grid.
    """
    table = grids.tables(problem, grid, cost)
    steep = slopes(problem, cost)
    setting = stage_arrays.setting(problem, cost, steep)
    last = table.stage[-1]
    c = last[layout.C_LO] + last[layout.DC] * np.arange(grid.positions)
    w = last[layout.W_LO] + last[layout.DW] * np.arange(grid.velocities)
    if terminal is None:
        off = np.zeros_like(c) if end is None else np.abs(c - end)
        ends = steep[0] * off[:, None] + steep[1] * np.abs(w)[None, :]
    else:
        ends = terminal(c[:, None], w[None, :])
    final = np.array(np.broadcast_to(ends, (grid.positions, grid.velocities)), order="C")
    return Policy(problem, cost, grid, table, setting, sweep(table, setting, final), end)


def sweep(table: Tables, setting: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Values of all nodes by the backward pass, shared among threads where that pays; the same bits either way.

    Args:
        table: The physics on all nodes.
        setting: The kernels' scalars, (layout.SETTINGS,).
        end: Values of the last stage [J], (positions, velocities).

    Returns:
        Cost to go [J], float32, (stages + 1, positions, velocities).
    """
    count, (positions, velocities) = table.stage.shape[0], end.shape
    values = np.empty((count, positions, velocities), dtype=np.float32)
    arrays = table.coefficients, table.outside, table.stage, table.cylinder, setting
    workers = min(resources.threads(), positions * velocities // WORTH_SHARING)
    if workers < 2:
        sweeps.sweep(*arrays, end, values)
    else:
        _sweep_shared(arrays, end, values, workers)
    return values


def _sweep_shared(problem_arrays: Any, terminal: np.ndarray, values: np.ndarray, workers: int) -> None:
    """The backward pass with every stage's positions shared among threads; the same bits as `sweeps.sweep`."""
    stages_, positions = values.shape[0] - 1, values.shape[1]
    bounds = np.linspace(0, positions, workers + 1).astype(int).tolist()
    ahead, here = terminal.copy(), np.empty_like(terminal)
    values[stages_] = terminal
    with ThreadPoolExecutor(workers - 1) as pool:
        for k in range(stages_ - 1, -1, -1):
            arrays: Any = (*problem_arrays, ahead, here, values)
            parts = [
                pool.submit(sweeps.sweep_stage, k, first, last, *arrays)
                for first, last in zip(bounds[1:-1], bounds[2:], strict=True)
            ]
            sweeps.sweep_stage(k, 0, bounds[1], *arrays)
            for part in parts:
                part.result()
            ahead, here = here, ahead


def rollout(policy: Policy, start: float, method: str = "dp", velocity: float = 0.0) -> Motion:
    """The policy's motion from a start position [m] and velocity [m/s]."""
    problem, table = policy.problem, policy.tables
    positions, velocities = np.empty(problem.stages + 1), np.empty(problem.stages + 1)
    control = np.empty(problem.stages)
    sweeps.rollout(
        table.coefficients, table.outside, table.stage, table.cylinder, policy.setting, policy.values,
        np.array([start, velocity]), 0, positions, velocities, control,
    )  # fmt: skip
    moved = _motion(problem, positions, velocities, control, method, policy.cost)
    return moved if policy.end is None else motion.ending_at(moved, policy.end)


def _motion(
    problem: Problem, position: np.ndarray, velocity: np.ndarray, control: np.ndarray, method: str, cost: str,
    lead: float | None = None,
) -> Motion:  # fmt: skip
    """The motion of a rollout; where that runs away from a state without a way on, its velocities end at `RUNAWAY`."""
    most = RUNAWAY * problem.crane.machine.redundant.velocity_limit
    if not np.abs(velocity).max() <= most:  # also where it is no number
        velocity = np.clip(np.nan_to_num(velocity, nan=most), -most, most)
        steps = np.full(control.size, problem.step)
        steps[0] = problem.step if lead is None else lead
        control = np.diff(velocity) / steps
        moved = np.cumsum(0.5 * steps * (velocity[1:] + velocity[:-1]))
        position = position[0] + np.concatenate([[0.0], moved])
    return motion.make(problem.step, position, velocity, control, method, cost, lead=lead)


def best_start(policy: Policy) -> float:
    """The start position [m] of least cost from rest."""
    stage = policy.tables.stage[0]
    return float(stage[layout.C_LO] + stage[layout.DC] * int(from_rest(policy).argmin()))


def from_rest(policy: Policy) -> np.ndarray:
    """Cost to go from rest at each position of the first stage [J], (positions,)."""
    stage = policy.tables.stage[0]
    column = int(round(-stage[layout.W_LO] / stage[layout.DW]))
    column = min(max(column, 0), policy.grid.velocities - 1)
    return policy.values[0, :, column] + policy.setting[layout.SLOPE_C] * policy.tables.outside[0]


def rest_costs(policy: Policy) -> tuple[np.ndarray, np.ndarray]:
    """Extensions at the first stage of a policy [m], and least costs from rest there."""
    return np.linspace(policy.grid.c_lo[0], policy.grid.c_hi[0], policy.grid.positions), from_rest(policy)


def resting(problem: Problem, cost: str, at: np.ndarray, costs: np.ndarray) -> Terminal:
    """Terminal cost of motions that end at rest, and that of what follows from there: linear between extensions [m]."""
    steep = slopes(problem, cost)[1]
    return lambda position, velocity: np.interp(position, at, costs) + steep * np.abs(velocity)


def prepare() -> None:
    """Load the compiled kernels, compiling them on the very first run, by solving a problem of a few nodes."""
    coefficients = np.zeros((2, 2, 1, layout.COEFFICIENTS))
    stage = np.ones((2, layout.STAGE_COLUMNS))
    setting = np.ones(layout.SETTINGS)
    values = np.zeros((2, 2, 2), dtype=np.float32)
    cylinder = np.ones((1, layout.CYLINDER_COLUMNS))
    arrays = coefficients, np.zeros((2, 2)), stage, cylinder, setting
    sweeps.sweep(*arrays, np.zeros((2, 2)), values)
    _sweep_shared(arrays, np.zeros((2, 2)), values, 2)
    sweeps.rollout(
        coefficients, np.zeros((2, 2)), stage, cylinder, setting, values, np.zeros(2), 0, np.zeros(2), np.zeros(2),
        np.zeros(1),
    )  # fmt: skip
