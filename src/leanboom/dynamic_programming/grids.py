"""Grids of positions and velocities for every stage, and all physics of a task on their nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from leanboom.problem import layout
from leanboom.problem.stage_arrays import coefficients, cylinder_table, most_flow, path_determined
from leanboom.problem.stages import Problem


@dataclass(frozen=True, slots=True, eq=False)
class Tables:
    """All physics on the nodes of a grid, as kernels take it; `layout` names the columns."""

    coefficients: np.ndarray  # (stages + 1, positions, moving, layout.COEFFICIENTS)
    outside: np.ndarray  # [m], (stages + 1, positions)
    stage: np.ndarray  # (stages + 1, layout.STAGE_COLUMNS)
    cylinder: np.ndarray  # (moving, layout.CYLINDER_COLUMNS)
    velocities: int


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
    stage = np.empty((problem.stages + 1, layout.STAGE_COLUMNS))
    stage[:, layout.C_LO] = grid.c_lo
    stage[:, layout.DC] = (c_hi - grid.c_lo) / (grid.positions - 1)
    stage[:, layout.W_LO] = grid.w_lo
    stage[:, layout.DW] = (grid.w_hi - grid.w_lo) / (grid.velocities - 1)
    flow, pressure, rate = path_determined(problem, cost)
    stage[:, layout.FIXED_FLOW], stage[:, layout.FIXED_PRESSURE], stage[:, layout.FIXED_COST] = flow, pressure, rate
    stage[:, layout.MOST_FLOW] = most_flow(problem)
    outside, cylinder = _distance_outside(problem, nodes), cylinder_table(problem, cost)
    return Tables(coefficients(problem, nodes), outside, stage, cylinder, grid.velocities)


def _distance_outside(problem: Problem, nodes: np.ndarray) -> np.ndarray:
    """Distance of each node from the feasible extensions of its stage [m]."""
    outside = np.zeros_like(nodes)
    for k, intervals in enumerate(problem.intervals):
        if len(intervals) > 1:
            gaps = np.maximum(intervals[:, :1] - nodes[k], nodes[k] - intervals[:, 1:])
            outside[k] = np.maximum(0.0, gaps.min(axis=0))
    return outside
