r"""Algorithm 1 of the 4-DOF paper to the letter, with the paper's own settings: what `dp` is measured against.

State (c, v) of the redundant cylinder, control a, in units of their largest values, eqs. (30)-(31):

    c_{k+1} = c_k + T_s v_max / c_max v_k,     v_{k+1} = v_k + T_s a_max / v_max a_k     (explicit Euler),

uniform grids over the full range of all three; Bellman's equation (44) with a constant added for each violated
limit, bilinear interpolation of J_{k+1}, stored controls, bilinearly interpolated in the forward simulation. As in
the Matlab function the paper used, a stage's model is evaluated on the full grid of states and controls, here some
positions at a time to bound the memory. The 3-DOF paper's two-state program is the same.

| symbol | name | unit |
| --- | --- | --- |
| c, v, a | position, velocity, acceleration of the redundant cylinder, normalised | 1 |
| J | cost to go, eq. (44): sum of P_h + l over the stages | unit of P_h |
| P_h | principal cost, eqs. (36) and (43) | W for energies |
| l | penalty of violated limits | unit of P_h |

Known weaknesses, kept on purpose: beside a limit the constant penalties leak into feasible states through the
interpolation, which a start on a joint limit meets at once; interpolated controls are no control's optimum across a
switch; the Euler position lags behind the motion.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from leanboom.methods import dp_velocity
from leanboom.model import crane as cranes
from leanboom.model import motion
from leanboom.model.cost_rates import rate
from leanboom.model.motion import Motion
from leanboom.model.task import Task
from leanboom.problem import feasible_strokes, stages
from leanboom.problem.stages import Problem
from leanboom.progress import Progress, quiet

GRID = (356, 101, 151)  # positions, velocities, controls; section 6 of the 4-DOF paper
GRID_3DOF = (125, 101, 201)  # section 6.2 of the 3-DOF paper
STEP = dp_velocity.STEP
BLOCK = 2**18  # nodes of states and controls evaluated at once; about 100 MB


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """Inputs of a backward stage: the task in time, the cost, and the normalised grids."""

    problem: Problem
    cost: str  # a name of `costs.COSTS`
    positions: np.ndarray  # X_1: c / c_max, (positions,)
    velocities: np.ndarray  # X_2: v / v_max, (velocities,)
    controls: np.ndarray  # U: a / a_max, (controls,)
    scale: tuple[float, float, float]  # c_max [m], v_max [m/s], a_max [m/s^2]
    penalty: float  # cost of one violated limit, in units of the principal cost


def default_grid(task: Task) -> tuple[int, int, int]:
    """The grid of the paper a task's machine comes from: positions, velocities, controls."""
    return GRID if task.machine.geometry.slewing else GRID_3DOF


def model(task: Task, cost: str, grid: tuple[int, int, int] | None = None, step: float = STEP) -> Model:
    """Discretise a task for `backward_stage`; arguments as in `plan`."""
    grid = default_grid(task) if grid is None else grid
    dp_velocity.check(cost, grid)
    problem = stages.discretise(task, step)
    low, high = feasible_strokes.stroke_range(task)
    cylinder = task.machine.redundant
    return Model(
        problem,
        cost,
        np.linspace(low / high, 1.0, grid[0]),
        np.linspace(-1.0, 1.0, grid[1]),
        np.linspace(-1.0, 1.0, grid[2]),
        (high, cylinder.velocity_limit, cylinder.acceleration_limit),
        dp_velocity.penalty(problem.crane, cost),
    )


def successor(model: Model, c, v, a):
    """Next state, normalised: eqs. (30)-(31)."""
    c_max, v_max, a_max = model.scale
    step = model.problem.step
    return c + step * (v_max / c_max) * v, v + step * (a_max / v_max) * a


def interpolate(model: Model, table: np.ndarray, c, v):
    """Bilinear value of a table over the states, (positions, velocities), at normalised states held inside the grid."""
    i, x = _cell(model.positions, c)
    j, y = _cell(model.velocities, v)
    low = (1.0 - y) * table[i, j] + y * table[i, j + 1]
    high = (1.0 - y) * table[i + 1, j] + y * table[i + 1, j + 1]
    return (1.0 - x) * low + x * high


def _cell(nodes: np.ndarray, value):
    """Index of the node below a value, and how far beyond it the value is, in node spacings."""
    share = (np.asarray(value) - nodes[0]) * ((nodes.size - 1) / (nodes[-1] - nodes[0]))
    share = np.clip(share, 0.0, nodes.size - 1.0)
    index = np.minimum(share.astype(np.intp), nodes.size - 2)
    return index, share - index


def running_cost(model: Model, k: int, c: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """P_h + l of lines 6-10 at stage k, at normalised states and controls that broadcast.

    To the letter: lines 6 to 8 stand inside the loops over states and controls, so everything is evaluated at
    every combination, as the general Matlab code the paper used does with its full state x control arrays.
    """
    c_max, v_max, a_max = model.scale
    crane = replace(model.problem.crane, bent=1.0)  # as in the paper, without a margin
    c, v, a = (x.copy() for x in np.broadcast_arrays(c, v, a))
    stroke = c_max * c
    with np.errstate(all="ignore"):  # poses out of reach give no numbers, and are penalised
        pose = cranes.pose(crane, model.problem.plane[k], stroke)
        moving = cranes.move(pose, v_max * v, a_max * a)
        power = rate(crane, model.cost, moving.velocity, cranes.forces(pose, moving))
    power = np.where(np.isfinite(power), power, 0.0)
    values = {"velocity": moving.velocity, "acceleration": moving.acceleration}
    return power + model.penalty * dp_velocity.violated(model.problem, k, stroke, values)


def backward_stage(model: Model, k: int, ahead: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lines 3-14 of Algorithm 1: one stage, all states, all controls.

    Args:
        model: Task, cost and grids.
        k: The stage.
        ahead: J_{k+1}, (positions, velocities).

    Returns:
        J_k and the normalised controls that attain it (ties: the lowest), (positions, velocities) each.
    """
    best, chosen = np.empty_like(ahead), np.empty_like(ahead)
    block = max(1, BLOCK // (model.velocities.size * model.controls.size))
    v, a = model.velocities[:, None], model.controls[None, :]
    for first in range(0, model.positions.size, block):
        c = model.positions[first : first + block, None, None]
        c_next, v_next = successor(model, c, v, a)
        total = running_cost(model, k, c, v, a) + interpolate(model, ahead, c_next, v_next)
        outside = (c_next < model.positions[0] - dp_velocity.SLACK) | (c_next > 1.0 + dp_velocity.SLACK)
        total += model.penalty * (outside + 1.0 * (np.abs(v_next) > 1.0 + dp_velocity.SLACK))
        index = total.argmin(axis=2)
        best[first : first + block] = np.take_along_axis(total, index[..., None], axis=2)[..., 0]
        chosen[first : first + block] = model.controls[index]
    return best, chosen


def backward(model: Model, tell: Progress = quiet) -> tuple[np.ndarray, np.ndarray]:
    """The backward phase, with J_N = 0.

    Args:
        model: Task, cost and grids.
        tell: Called after each stage with what happens and the share done, in (0, 1].

    Returns:
        J_0, (positions, velocities), and the table of normalised controls, (stages, positions, velocities).
    """
    count = model.problem.stages
    states = model.positions.size, model.velocities.size
    ahead = np.zeros(states)
    controls = np.empty((count, *states))
    for k in range(count - 1, -1, -1):
        ahead, controls[k] = backward_stage(model, k, ahead)
        tell("Algorithm 1", (count - k) / count)
    return ahead, controls


def forward(model: Model, controls: np.ndarray, start_position: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The forward simulation with interpolated controls, from rest.

    Args:
        model: Task, cost and grids.
        controls: Normalised controls, (stages, positions, velocities).
        start_position: Where the redundant cylinder starts [m].

    Returns:
        Normalised positions and velocities, (stages + 1,) each, and controls, (stages,).
    """
    count = model.problem.stages
    c, v, a = np.empty(count + 1), np.empty(count + 1), np.empty(count)
    c[0], v[0] = start_position / model.scale[0], 0.0
    for k in range(count):
        a[k] = interpolate(model, controls[k], c[k], v[k])
        c[k + 1], v[k + 1] = successor(model, c[k], v[k], a[k])
    return c, v, a


def plan(
    task: Task,
    cost: str,
    start: float,
    tell: Progress = quiet,
    settings: object = None,
    *,
    grid: tuple[int, int, int] | None = None,
    step: float = STEP,
) -> Motion:
    """The motion of Algorithm 1.

    The Euler trajectory's positions are not the integral of its velocities; no real cylinder could follow both. The
    motion keeps start and velocities and integrates those exactly, so its positions differ from the Euler ones by
    T_s (v_k - v_0) / 2.

    Args:
        task: The task.
        cost: A name of `costs.COSTS`.
        start: Where the redundant cylinder starts [m].
        tell: Called after each stage with what happens and the share done, in (0, 1].
        settings: Not used; grid and step are the papers'.
        grid: Numbers of positions, velocities and controls; None: the paper's.
        step: Length of a stage T_s [s].

    Returns:
        The motion. It may end moving: J_N = 0 asks for no rest, only the cost of moving does.
    """
    began = time.perf_counter()
    program = model(task, cost, grid, step)
    _, controls = backward(program, tell)
    _, v, _ = forward(program, controls, start)
    seconds = time.perf_counter() - began
    return motion.from_velocities(
        program.problem.step, float(start), program.scale[1] * v, "dp-paper", cost, solve_s=seconds
    )
