r"""One-state dynamic programming of the 3-DOF paper, eqs. (18)-(25): the velocity is the control.

State: position c of the redundant cylinder; control: its velocity w; dynamics c_{k+1} = c_k + T_s w_k, eq. (21).
The other cylinders' velocities follow from the path, eqs. (22)-(25). Bellman's equation (18),

    J_k(c) = min_w { P_k(c, w) + l_k(c, w) + J_{k+1}(c + T_s w) },     J_N = 0,

is solved over uniform grids of the whole stroke and of all allowed velocities; J_{k+1} is interpolated linearly, the
best controls are stored and interpolated in the forward simulation. l_k adds a large constant for each violated
position or velocity limit. Accelerations do not exist here, so their limits are not kept, and forces are those of
gravity and friction alone.

The penalty is shared with `dp_paper`, the two-state algorithm.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from leanboom.components.costs import COSTS, Supply
from leanboom.errors import InputError
from leanboom.model import crane as cranes
from leanboom.model import motion
from leanboom.model.cost_rates import rate
from leanboom.model.motion import Motion
from leanboom.model.task import Task
from leanboom.problem import feasible_strokes, stages
from leanboom.problem.stages import Problem
from leanboom.progress import Progress, quiet
from leanboom.quantities import ranges

GRID = (200, 101)  # positions, velocities; section 6.2 of the 3-DOF paper
STEP = 0.05  # [s], both papers
PENALTY = 10.0  # a violated limit costs this many times the highest principal cost
SLACK = 1e-9  # limits used by this much more than 1 still count as kept


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """Inputs of a backward stage: the task in time, the cost, and the grids."""

    problem: Problem
    cost: str  # a name of `costs.COSTS`
    positions: np.ndarray  # [m], (positions,)
    velocities: np.ndarray  # the control [m/s], (velocities,)
    penalty: float  # cost of one violated limit, in units of the principal cost


def penalty(crane: cranes.Crane, cost: str) -> float:
    """The constant added for a violated limit: `PENALTY` times the rate of the cost with all cylinders at full speed.

    A pump is counted at constant pressure, work at the pump's highest.
    """
    machine = crane.machine
    fastest = tuple(c.velocity_limit for c in machine.cylinders)
    strongest = tuple(c.push(machine.pump.max_pressure) for c in machine.cylinders)
    pumped = COSTS[cost].supply is not Supply.NONE
    return PENALTY * float(rate(crane, "cp" if pumped else cost, fastest, strongest))


def violated(problem: Problem, k: int, stroke: np.ndarray, values: dict[str, tuple]):
    """Number of violated limits at stage k.

    Args:
        problem: The discretised task.
        k: The stage.
        stroke: Redundant cylinder [m], any shape.
        values: "velocity" and, where there are any, "acceleration" of each cylinder, broadcasting with the stroke.
    """
    count = 1.0 * (cranes.position_margin(problem.crane, problem.plane[k], stroke) < -SLACK)
    for kind, entries in values.items():
        for value, cylinder in zip(entries, problem.crane.machine.cylinders, strict=True):
            limit = getattr(cylinder, f"{kind}_limit")
            count = count + (np.abs(value) > limit * (1.0 + SLACK))
    return count


def check(cost: str, grid: tuple[int, ...]) -> None:
    """Raise InputError for a cost that does not exist, or a grid that cannot be interpolated on."""
    ranges.one_of("cost", cost, COSTS)
    if min(grid) < 2:
        raise InputError(f"grid = {'x'.join(map(str, grid))}; needs at least 2 nodes along each axis")


def model(task: Task, cost: str, grid: tuple[int, int] = GRID, step: float = STEP) -> Model:
    """Discretise a task for `backward_stage`; arguments as in `plan`."""
    check(cost, grid)
    problem = stages.discretise(task, step)
    limit = task.machine.redundant.velocity_limit
    return Model(
        problem,
        cost,
        np.linspace(*feasible_strokes.stroke_range(task), grid[0]),
        np.linspace(-limit, limit, grid[1]),
        penalty(problem.crane, cost),
    )


def stage_cost(model: Model, k: int) -> np.ndarray:
    """Principal cost plus penalties at stage k over the grid, (positions, velocities)."""
    problem = model.problem
    c, w = model.positions[:, None], model.velocities[None, :]
    with np.errstate(all="ignore"):  # poses out of reach give no numbers, and are penalised
        pose = cranes.pose(replace(problem.crane, bent=1.0), problem.plane[k], c)  # as in the paper, without a margin
        moving = cranes.move(pose, w + 0.0 * c, 0.0)
        # Quasi-static: gravity alone, no force of inertia.
        gravity = [torque / arm for torque, (_, arm, _) in zip(pose.gravity, pose.cylinders[-3:], strict=True)]
        base = [0.0 * w] * (len(pose.cylinders) - 3)
        force = cranes.forces(pose, replace(moving, load=(*base, *gravity)))
        power = rate(problem.crane, model.cost, moving.velocity, force)
    power = np.where(np.isfinite(power), power, 0.0)
    return power + model.penalty * violated(problem, k, c, {"velocity": moving.velocity})


def backward_stage(model: Model, k: int, ahead: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One stage of Bellman's equation (18).

    Args:
        model: Task, cost and grids.
        k: The stage.
        ahead: Cost to go of the next stage, (positions,).

    Returns:
        Cost to go of this stage and the velocities [m/s] that attain it (ties: the lowest), (positions,) each.
    """
    after = model.positions[:, None] + model.problem.step * model.velocities  # Eq. (21).
    total = stage_cost(model, k) + np.interp(after, model.positions, ahead)
    total += model.penalty * ((after < model.positions[0] - SLACK) | (after > model.positions[-1] + SLACK))
    best = total.argmin(axis=1)
    return total[np.arange(best.size), best], model.velocities[best]


def plan(
    task: Task,
    cost: str,
    start: float,
    tell: Progress = quiet,
    settings: object = None,
    *,
    grid: tuple[int, int] = GRID,
    step: float = STEP,
) -> Motion:
    """The motion of the one-state dynamic program.

    Args:
        task: The task.
        cost: A name of `costs.COSTS`.
        start: Where the redundant cylinder starts [m].
        tell: Not used: it takes a moment.
        settings: Not used; grid and step are the paper's.
        grid: Numbers of positions and velocities.
        step: Length of a stage T_s [s].

    Returns:
        The motion. A control is the mean velocity of its stage, so the velocity between two stages is the mean of
        theirs, and at both ends zero.
    """
    began = time.perf_counter()
    program = model(task, cost, grid, step)
    count = program.problem.stages
    controls = np.empty((count, grid[0]))
    ahead = np.zeros(grid[0])
    for k in range(count - 1, -1, -1):
        ahead, controls[k] = backward_stage(program, k, ahead)
    c = float(start)
    speed = np.empty(count)
    for k in range(count):
        speed[k] = np.interp(c, program.positions, controls[k])
        c += program.problem.step * speed[k]
    velocity = np.concatenate([[0.0], 0.5 * (speed[1:] + speed[:-1]), [0.0]])
    seconds = time.perf_counter() - began
    return motion.from_velocities(program.problem.step, float(start), velocity, "dp1", cost, solve_s=seconds)
