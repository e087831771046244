"""Stage tables: all physics of a task on (stage, position) nodes, and the grids that fit each stage.

The kernels see a crane only through these tables. At a node, velocities, accelerations and forces of every
cylinder are exact polynomials of the redundant cylinder's motion (v affine in w; a and f quadratic in w and
affine in u), so four evaluations of `crane.move` at a pose give all coefficients. Cylinders that the path
alone prescribes (the base) are reduced to one flow and one pressure a stage.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass

import numpy as np

from leanboom import crane as cranes
from leanboom import hydraulics, kernels, kinematics, motion
from leanboom.errors import InfeasibleError, InputError
from leanboom.motion import Motion
from leanboom.objective import COSTS
from leanboom.shaft import shaft_of
from leanboom.task import Task, sample

SAMPLES = 257  # extensions looked at when searching the feasible ones
CLOSER = 16  # times as many, where none of them is feasible
BLOCK = 1024  # stages looked at together: a closer look takes 220 kB of memory a stage
HELD = 0.99  # planned motions hold a cylinder within this share of the velocity that counts as driven
PROMISE = 1e-9  # [m], accuracy of the ends of the feasible extensions
SLOW = 1e-3  # share of the velocity limit that is always looked at
BRISK = 6.0  # motions may need this many times the velocity that covers all feasible extensions once, evenly
_BENT = f"an arm stays {np.degrees(kinematics.ELBOW_MARGIN):g} deg from straight and from folded up"


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """A task discretised in time: the crane, its reference at the stages, its feasible extensions."""

    task: Task
    crane: cranes.Crane
    step: float  # Ts [s]
    time: np.ndarray  # [s], (stages + 1,)
    plane: cranes.Plane  # reference at the stages
    lower: np.ndarray  # smallest feasible stroke of the redundant cylinder [m], (stages + 1,)
    upper: np.ndarray  # largest [m], (stages + 1,)
    intervals: tuple[np.ndarray, ...]  # feasible strokes of each stage [m], (intervals, 2) each

    @property
    def stages(self) -> int:
        """Number of stages."""
        return self.time.size - 1

    @property
    def pace(self) -> float:
        """Velocity scale of the redundant cylinder [m/s]: its limit, or less where the path leaves time for less."""
        even = float(self.upper.max() - self.lower.min()) / self.task.duration
        limit = self.crane.machine.redundant.velocity_limit
        return min(limit, max(BRISK * even, SLOW * limit))

    @property
    def moving(self) -> slice:
        """The cylinders whose motion depends on the redundancy: all but a base."""
        return slice(1, None) if self.crane.machine.geometry.slewing else slice(0, None)


@dataclass(frozen=True, slots=True, eq=False)
class Tables:
    """What the kernels need, see `kernels` for the columns."""

    coefficients: np.ndarray  # (stages + 1, positions, moving, kernels.COEFFICIENTS)
    outside: np.ndarray  # [m], (stages + 1, positions)
    stage: np.ndarray  # (stages + 1, kernels.STAGE_COLUMNS)
    cylinder: np.ndarray  # (moving, kernels.CYLINDER_COLUMNS)
    velocities: int


def stroke_range(task: Task) -> tuple[float, float]:
    """Smallest and largest stroke of the redundant cylinder [m], from its joint's range."""
    joint, ratio = task.machine.joints[-1], cranes.build(task).ratio
    return joint.lower * ratio, joint.upper * ratio


def discretise(task: Task, step: float) -> Problem:
    """Cut a task into equal stages of about `step` [s] and find the feasible extensions of each.

    Raises:
        InfeasibleError: If the tool cannot be at its point at some stage, whatever the extension.
    """
    count = max(2, int(np.ceil(task.duration / step - 1e-9)))
    time = np.linspace(0.0, task.duration, count + 1)
    crane = cranes.build(task)
    plane = cranes.plane(task.machine, sample(task, time))
    intervals = feasible_strokes(task, crane, plane, time)
    lower = np.array([stage[0, 0] for stage in intervals])
    upper = np.array([stage[-1, 1] for stage in intervals])
    return Problem(task, crane, task.duration / count, time, plane, lower, upper, intervals)


def on_stages(problem: Problem, seed: Motion) -> Motion:
    """A motion on a problem's stages: itself, or one with its velocities there, ending at rest."""
    if seed.acceleration.size == problem.stages:
        return seed
    _, velocity, _ = seed.at(problem.time)
    velocity = velocity.copy()
    velocity[-1] = 0.0
    return motion.from_velocities(problem.step, float(seed.position[0]), velocity, seed.method, seed.cost)


def feasible_strokes(task: Task, crane: cranes.Crane, plane: cranes.Plane, time: np.ndarray) -> tuple[np.ndarray, ...]:
    """Feasible strokes of the redundant cylinder [m] at times of a path, (intervals, 2) each.

    Args:
        task: The task.
        crane: Its crane.
        plane: Its reference at the times.
        time: The times [s], (times,).

    Raises:
        InfeasibleError: If the tool cannot be at its point at some time, whatever the extension.
    """
    parts = (slice(first, first + BLOCK) for first in range(0, time.size, BLOCK))
    return tuple(ends for part in parts for ends in _feasible_strokes(task, crane, plane, time, part))


def _feasible_strokes(
    task: Task, crane: cranes.Crane, plane: cranes.Plane, time: np.ndarray, part: slice
) -> list[np.ndarray]:
    """Feasible strokes at a part of the times, as `feasible_strokes`."""
    low, high = stroke_range(task)
    here = plane[part]
    for samples in (SAMPLES, CLOSER * SAMPLES):
        grid = np.linspace(low, high, samples)
        inside = cranes.position_margin(crane, here[:, None], grid[None, :]) >= -1e-12
        if inside.any(axis=1).all():
            break
    else:
        k = part.start + int(np.argmin(inside.any(axis=1)))
        raise InfeasibleError(_why_unreachable(task, crane, plane, k, time[k], grid))
    # Ends between a feasible and an infeasible sample are bisected, all at once.
    edges = inside[:, 1:] != inside[:, :-1]
    stage, index = np.nonzero(edges)
    good = np.where(inside[stage, index], grid[index], grid[index + 1])
    bad = np.where(inside[stage, index], grid[index + 1], grid[index])
    here = here[stage]
    while np.max(np.abs(good - bad), initial=0.0) > PROMISE:
        middle = 0.5 * (good + bad)
        keeps = cranes.position_margin(crane, here, middle) >= 0.0
        good, bad = np.where(keeps, middle, good), np.where(keeps, bad, middle)
    found = []
    for k, row in enumerate(inside):
        ends = list(good[stage == k])
        if row[0]:
            ends.insert(0, low)
        if row[-1]:
            ends.append(high)
        found.append(np.array(ends).reshape(-1, 2))
    return found


def _why_unreachable(task, crane, plane, k, time, grid) -> str:
    here = plane[k]
    where = f"at {time:.3f} s (stage {k}), tool radius {here.r:.3f} m, height {here.z:.3f} m"
    cosine = cranes.elbow_cosine(crane, here, grid / crane.ratio)
    if np.all(cosine < -kinematics.BENT):
        gap = np.ceil(1e3 * _reach_gap(task, here)) / 1e3
        bent = "" if cosine.max() < -1.0 else f"; {_BENT}"
        return f"the path leaves the crane's reach {where}: too far by {gap:.3f} m{bent}"
    if np.all(np.abs(cosine) > kinematics.BENT):
        return f"the path comes too close to the lift joint {where}"
    margin = cranes.position_margin(crane, here, grid)
    best = grid[int(margin.argmax())]
    pose = cranes.pose(crane, here, best)
    worst, message = 0.0, f"the joint ranges allow a straight or folded arm alone; {_BENT}"
    for q, joint in zip(pose.q, task.machine.joints[-3:], strict=True):
        for bound, amount in ((joint.lower, joint.lower - q), (joint.upper, q - joint.upper)):
            if amount / (joint.upper - joint.lower) > worst:
                worst = amount / (joint.upper - joint.lower)
                unit = "m" if joint.name == "extension" else "rad"
                message = f"joint {joint.name} would be {amount:.4f} {unit} beyond its limit {bound:.4f} {unit}"
    other = "; nor is all of it reached with the outer boom folded up" if len(cranes.sides(task.machine)) > 1 else ""
    return f"no extension reaches the path {where}: even at {best:.3f} m, {message}{other}"


def _reach_gap(task: Task, here: cranes.Plane) -> float:
    g = task.machine.geometry
    outer = np.hypot(g.outer + task.machine.joints[-1].upper, g.offset)
    reach = np.sqrt(g.boom**2 + outer**2 + 2.0 * g.boom * outer * kinematics.BENT)
    return float(np.hypot(here.r - g.base_x, here.z - g.base_z) - reach)


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Position and velocity nodes of every stage."""

    c_lo: np.ndarray  # [m], (stages + 1,)
    c_hi: np.ndarray
    w_lo: np.ndarray  # [m/s], (stages + 1,)
    w_hi: np.ndarray
    positions: int
    velocities: int


def full_grid(problem: Problem, positions: int, velocities: int, span: float | None = None) -> Grid:
    """Nodes over all feasible extensions of each stage and velocities up to `span` [m/s], by default the limit.

    Zero velocity is a node.
    """
    span = problem.crane.machine.redundant.velocity_limit if span is None else span
    ones = np.ones(problem.stages + 1)
    return Grid(problem.lower, problem.upper, -span * ones, span * ones, positions, velocities | 1)


def tube_grid(
    problem: Problem, position, velocity, width: float, spread: float, positions: int, velocities: int
) -> Grid:
    """Nodes within `width` [m] and `spread` [m/s] of a motion, (stages + 1,), inside the feasible extensions.

    The motion's own velocity is a node at every stage.
    """
    limit = problem.crane.machine.redundant.velocity_limit
    c_lo = np.clip(position - width, problem.lower, problem.upper)
    c_hi = np.clip(position + width, problem.lower, problem.upper)
    centre = np.clip(velocity, -limit, limit)
    return Grid(c_lo, c_hi, centre - spread, centre + spread, positions, velocities | 1)


def tables(problem: Problem, grid: Grid, cost: str) -> Tables:
    """All physics of a problem on the nodes of a grid."""
    c_hi = np.maximum(grid.c_hi, grid.c_lo + 1e-9)
    share = np.linspace(0.0, 1.0, grid.positions)
    nodes = grid.c_lo[:, None] + (c_hi - grid.c_lo)[:, None] * share
    stage = np.empty((problem.stages + 1, kernels.STAGE_COLUMNS))
    stage[:, kernels.C_LO] = grid.c_lo
    stage[:, kernels.DC] = (c_hi - grid.c_lo) / (grid.positions - 1)
    stage[:, kernels.W_LO] = grid.w_lo
    stage[:, kernels.DW] = (grid.w_hi - grid.w_lo) / (grid.velocities - 1)
    flow, pressure, rate = prescribed(problem, cost)
    stage[:, kernels.FIXED_FLOW], stage[:, kernels.FIXED_PRESSURE], stage[:, kernels.FIXED_COST] = flow, pressure, rate
    return Tables(
        coefficients(problem, nodes), _distance_outside(problem, nodes), stage, cylinder_table(problem), grid.velocities
    )


def coefficients(problem: Problem, positions: np.ndarray) -> np.ndarray:
    """The kernels' coefficients at positions of the redundant cylinder [m], (stages + 1, any number).

    Returns:
        (stages + 1, any number, moving, kernels.COEFFICIENTS).
    """
    crane = problem.crane
    pose = cranes.pose(crane, problem.plane[:, None], positions)
    still, forth, back, push = (cranes.move(pose, w, u) for w, u in ((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0)))
    moving = range(len(crane.machine.cylinders))[problem.moving]
    found = np.empty((*positions.shape, len(moving), kernels.COEFFICIENTS))
    for m, i in enumerate(moving):
        out = found[:, :, m]
        out[..., kernels.A0] = still.velocity[i]
        out[..., kernels.A1] = forth.velocity[i] - still.velocity[i]
        for column, name in ((kernels.B0, "acceleration"), (kernels.F0, "load")):
            c0, c1, c2, c3 = (getattr(one, name)[i] for one in (still, forth, back, push))
            out[..., column] = c0
            out[..., column + 1] = 0.5 * (c1 - c2)
            out[..., column + 2] = 0.5 * (c1 + c2) - c0
            out[..., column + 3] = c3 - c0
        out[..., kernels.COULOMB] = pose.coulomb[i]
    return found


def prescribed(problem: Problem, cost: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What the cylinders that the path alone moves add at every stage.

    With `slewing_inertia` the base force depends on the extension a little; it is taken at the middle one.

    Args:
        problem: The discretised task.
        cost: A name of `objective.COSTS`.

    Returns:
        Pump flow [m^3/s], counted pressure [Pa] and rate of the costs without pump, (stages + 1,) each.
    """
    crane = problem.crane
    zero = np.zeros(problem.stages + 1)
    if not crane.machine.geometry.slewing:
        return zero, zero, zero
    pose = cranes.pose(crane, problem.plane, 0.5 * (problem.lower + problem.upper))
    moving = cranes.move(pose, 0.0, 0.0)
    v, force, d = moving.velocity[0], cranes.forces(pose, moving)[0], crane.drives[0]
    cylinder = crane.machine.cylinders[0]
    if cost == "recuperation":
        flow = hydraulics.recuperating_flow(v, cylinder.piston_area, cylinder.rod_side_area)
    else:
        flow = hydraulics.cylinder_flow(v, d.area_out, d.area_in)
    pressure = hydraulics.counted_pressure(
        v, force, crane.machine.driven_velocity, d.gain_out, d.back_out, d.gain_in, d.back_in
    )
    rate = {"actuator": hydraulics.positive_work(v, force), "velocity": v * v}.get(cost, zero)
    return flow, pressure, rate


def cylinder_table(problem: Problem) -> np.ndarray:
    """The moving cylinders' constants, (moving, kernels.CYLINDER_COLUMNS)."""
    crane = problem.crane
    rows = []
    for cylinder, d, k in zip(crane.machine.cylinders, crane.drives, cranes.sharpness(crane), strict=True):
        rows.append(
            [d.area_out, d.area_in, d.gain_out, d.back_out, d.gain_in, d.back_in, k, cylinder.friction.viscous,
             cylinder.velocity_limit, cylinder.acceleration_limit, cylinder.piston_area, cylinder.rod_side_area]
        )  # fmt: skip
    return np.array(rows)[problem.moving]


def setting(problem: Problem, cost: str, slopes: tuple[float, float, float, float]) -> np.ndarray:
    """The kernels' scalars; slopes are the penalties per violated m, m/s (state), m/s and m/s^2 (cylinders)."""
    machine = problem.crane.machine
    pump = machine.pump
    efficiency, *losses = shaft_of(pump)
    return np.array(
        [problem.step, COSTS[cost], HELD * machine.driven_velocity, pump.constant_pressure, pump.ls_margin,
         efficiency, *slopes, *losses]
    )  # fmt: skip


def _distance_outside(problem: Problem, nodes: np.ndarray) -> np.ndarray:
    """Distance of each node from the feasible extensions of its stage [m]."""
    outside = np.zeros_like(nodes)
    for k, intervals in enumerate(problem.intervals):
        if len(intervals) > 1:
            gaps = np.maximum(intervals[:, :1] - nodes[k], nodes[k] - intervals[:, 1:])
            outside[k] = np.maximum(0.0, gaps.min(axis=0))
    return outside


def threads() -> int:
    """Threads a sweep may use: LEANBOOM_THREADS where set, else the processors of this process."""
    wanted = os.environ.get("LEANBOOM_THREADS", "")
    if wanted:
        if not re.fullmatch("[0-9]{1,6}", wanted) or int(wanted) < 1:
            raise InputError(f"LEANBOOM_THREADS = {wanted}; must be a whole number from 1 on")
        return int(wanted)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
