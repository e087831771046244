"""Cells of the state space: rows of positions, at every stage cut into cells of velocity.

A `Cells` is a set of boxes in position and velocity at every stage; outside it no motion is of interest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from leanboom.certificate import cell_enclosures, position_rows, viability
from leanboom.certificate.cell_enclosures import L_DW, L_J, L_W, LATTICE, Stage
from leanboom.certificate.viability import Viable
from leanboom.evaluation.limit_checks import TOLERANCE
from leanboom.model.motion import Motion
from leanboom.problem import layout, stage_arrays
from leanboom.problem.legs import Legs, one_after_another
from leanboom.problem.stages import Problem

VELOCITY = 0.01  # [m/s], largest height of a cell of the first level
COARSE = ((16, 8), (8, 4), (4, 2))  # how many times wider and higher cells are where time is short
AT_REST = 1e-6  # [m/s], velocity below which a motion ends at rest
REST = 1e-10  # [m/s], velocity up to which a leg begins at rest
FLOW_STRIPS = 256  # parts of the velocity range, in each of which the pump's flow is enclosed


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """The cells of every stage; arrays of a stage cover a window of its lattice."""

    legs: Legs
    cost: str
    positions: int  # rows between the ends of a stage's feasible extensions, narrower ones apart
    velocities: np.ndarray  # cells between the limits of the redundant cylinder's velocity, (stages,)
    lattice: np.ndarray  # (stages + 1, cell_enclosures.LATTICE)
    active: tuple[np.ndarray, ...]  # energy motions take up to a cell at least [J], inf where not kept: (rows, columns)
    model: tuple[np.ndarray, ...]  # enclosures of the coefficients, (rows, moving, COEFFICIENTS, 4) a stage
    rows: tuple[np.ndarray, ...]  # edges of the rows of cells [m], (rows + 1,) a stage and the end
    edges: tuple[np.ndarray, ...]  # of the cells in velocity [m/s], (rows, columns + 1) a stage and the end
    columns: tuple[np.ndarray, ...]  # admissible velocities of each row [m/s], (rows, 2) a stage and the end
    fixed: np.ndarray  # pump flow [m^3/s] and pressure [Pa] of path-determined cylinders, (stages + 1, 2)
    cylinder: np.ndarray  # (moving, layout.CYLINDER_COLUMNS)
    setting: np.ndarray  # (stages, layout.SETTINGS)
    viable: Viable  # velocities from which motions can go on within the limits

    @property
    def count(self) -> int:
        """Number of cells kept."""
        return sum(int(np.isfinite(a).sum()) for a in self.active)

    def stage(self, k: int) -> Stage:
        """The arrays of a stage and the next one that kernels take."""
        return Stage(
            self.model[k], self.rows[k], self.edges[k], self.columns[k], self.lattice[k + 1], self.rows[k + 1],
            self.edges[k + 1], self.columns[k + 1], self.fixed[k], self.cylinder, self.setting[k],
        )  # fmt: skip

    def middles(self, k: int) -> np.ndarray:
        """Velocities in the middle of a stage's cells [m/s], (rows, columns)."""
        return position_rows.middles(self.edges[k].T).T

    def share(self, k: int, position: np.ndarray) -> np.ndarray:
        """Positions [m] as shares of a stage's feasible extensions."""
        lower, upper = self.legs.lower[k], self.legs.upper[k]
        return (position - lower) / max(upper - lower, position_rows.LEAST_RANGE)


@dataclass(frozen=True, slots=True, eq=False)
class Size:
    """Sizes of the cells of whole stages."""

    positions: int  # rows between the ends of a stage's feasible extensions, narrower ones apart
    velocities: np.ndarray  # cells between the limits of the redundant cylinder's velocity, (stages,)
    rows: list[np.ndarray]  # edges of the rows [m], (rows + 1,) a stage and the end
    bins: int  # bins of position that viable velocities are looked for in: edges of rows are edges of bins

    @property
    def count(self) -> int:
        """Number of cells of all stages."""
        return sum((edges.size - 1) * int(each) for edges, each in zip(self.rows[:-1], self.velocities, strict=True))


def size(legs: Legs, cost: str, beside: Motion | None = None, times: tuple[int, int] = (1, 1)) -> Size:
    """The `Size` of cells over all feasible extensions and velocities of every stage, on the first level or coarser.

    Args:
        legs: The discretised task.
        cost: "ls" or "cp".
        beside: A motion on all stages, near which rows are narrower.
        times: How many times wider and higher cells are than those of the first level.
    """
    wider, higher = times
    coarse = wider > 1
    positions = max(2, int(np.ceil(np.max(legs.upper - legs.lower) / (wider * position_rows.POSITION))))
    narrower, lower = position_rows.FINER[cost]
    rows = [position_rows.whole(legs, k, positions, beside, narrower, coarse) for k in range(legs.stages + 1)]
    velocities = np.full(legs.stages, 2 * int(np.ceil(legs.velocity_limit / (higher * VELOCITY))))
    if beside is not None:
        velocities[position_rows.from_end(legs, slice(-1), beside.position[:-1]) < position_rows.NEAR_END] *= lower
    return Size(positions, velocities, rows, (position_rows.OUTERMOST if coarse else viability.BINS) * positions)


def whole(legs: Legs, cost: str, beside: Motion | None = None, times: tuple[int, int] = (1, 1)) -> Cells:
    """The cells of all feasible extensions and all velocities of every stage; arguments as in `size`."""
    cut = size(legs, cost, beside, times)
    corner = np.zeros(legs.stages, dtype=int)
    return made_of(legs, cost, cut.positions, cut.velocities, cut.rows, cut.velocities, corner, cut.bins)


def made_of(
    legs: Legs, cost: str, positions: int, velocities: np.ndarray, rows: list[np.ndarray], counts: np.ndarray,
    corner: np.ndarray, viable: Viable | int,
) -> Cells:  # fmt: skip
    """Cells of a resolution, all active.

    Args:
        legs: The discretised task.
        cost: A name of `costs.COSTS`.
        positions, velocities: Rows of a whole stage, narrower ones apart, and columns, (stages,).
        rows: Edges of the rows of every stage's window and of the end [m].
        counts: Columns of the windows, (stages,).
        corner: First column of the windows, (stages,).
        viable: Viable velocities; or the number of bins to look for them in, on windows that are whole stages.
    """
    limit, n, first = legs.velocity_limit, legs.stages, legs.problems[0]
    lattice = np.zeros((n + 1, LATTICE))
    lattice[:n, L_W] = -limit
    lattice[:n, L_DW] = 2.0 * limit / velocities
    lattice[:n, L_J] = corner
    cylinder = stage_arrays.cylinder_table(first, cost)
    scalars = [stage_arrays.setting(each, cost, (0.0, 0.0, 0.0, 0.0, 0.0), share=1.0) for each in legs.problems]
    setting = np.repeat(scalars, np.diff(legs.firsts), axis=0)
    model = tuple(
        stage
        for i, each in enumerate(legs.problems)
        for stage in position_rows.enclosures(each, rows[legs.firsts[i] : legs.firsts[i + 1]])
    )
    most = one_after_another([stage_arrays.most_flow(each) for each in legs.problems])
    most = most + (TOLERANCE - 1.0) * first.crane.machine.pump.max_flow
    columns = [np.tile([-limit, limit], (edges.size - 1, 1)) for edges in rows]
    edges = [np.zeros((stage.shape[0], count + 1)) for stage, count in zip(model, counts, strict=True)]
    for k, stage in enumerate(model):
        cell_enclosures.velocity_columns(stage, cylinder, columns[k])
        if first.task.limits.pump_flow:
            columns[k] = flow_columns(stage, cylinder, float(most[k]), columns[k])
        cell_enclosures.place_edges(stage, setting[k], lattice[k], edges[k])
    edges.append(np.zeros((rows[n].size - 1, 2)))
    for k in legs.firsts[:-1].tolist():  # where legs begin the cylinder rests, up to the rounding of lattices
        np.clip(columns[k], -REST, REST, out=columns[k])
    columns[n] = np.zeros((rows[n].size - 1, 2))  # the end: at rest
    if isinstance(viable, int):
        viable = viability.viable_velocities(viable, tuple(rows), model, columns, cylinder, setting[:, layout.STEP])
    cells = Cells(
        legs, cost, positions, velocities, lattice,
        tuple(np.zeros((stage.shape[0], count)) for stage, count in zip(model, counts, strict=True)), model,
        tuple(rows), tuple(edges), tuple(columns),
        one_after_another([_fixed(each, cost) for each in legs.problems]), cylinder, setting, viable,
    )  # fmt: skip
    for k in range(n):
        share = cells.share(k, rows[k])
        low, high = viable.within(k, share[:-1], share[1:])
        columns[k][:, 0], columns[k][:, 1] = np.maximum(columns[k][:, 0], low), np.minimum(columns[k][:, 1], high)
    return cells


def flow_columns(model: np.ndarray, cylinder: np.ndarray, most: float, columns: np.ndarray) -> np.ndarray:
    """Velocities of each row at which some state of it may keep within the pump's flow [m/s], (rows, 2).

    Args:
        model: Enclosures of the coefficients over the rows, (rows, moving, COEFFICIENTS, 4).
        cylinder: (moving, layout.CYLINDER_COLUMNS).
        most: Flow that the moving cylinders may take together [m^3/s].
        columns: Velocities that are looked at, (rows, 2); where there are none, the lower end is above the upper one.
    """
    low, high = columns.T
    ends = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, FLOW_STRIPS + 1)
    p0, p1, p2, error = np.moveaxis(model[:, :, [layout.A0, layout.A1]], 3, 0)
    middle, reach = p0 + 0.5 * p2, np.abs(p1) + 0.5 * np.abs(p2) + error  # (rows, moving, 2)
    lowest, highest = middle - reach, middle + reach
    # A velocity a0 + a1 w is least and largest at ends of a1 and of a strip of w.
    products = [slope[:, :, 1, None] * w[:, None] for slope in (lowest, highest) for w in (ends[:, :-1], ends[:, 1:])]
    slowest = lowest[:, :, 0, None] + np.minimum.reduce(products)  # (rows, moving, strips)
    fastest = highest[:, :, 0, None] + np.maximum.reduce(products)
    out, back = cylinder[:, layout.FLOW_OUT, None], cylinder[:, layout.FLOW_IN, None]
    keeps = np.maximum(np.maximum(out * slowest, -back * fastest), 0.0).sum(axis=1) <= most
    first, last = keeps.argmax(axis=1), FLOW_STRIPS - keeps[:, ::-1].argmax(axis=1)
    rows = np.arange(low.size)
    narrowed = np.stack([ends[rows, first], ends[rows, last]], axis=1)
    return np.where((keeps.any(axis=1) & (low <= high))[:, None], narrowed, (np.inf, -np.inf))


def _fixed(problem: Problem, cost: str) -> np.ndarray:
    """Pump flow [m^3/s] and pressure [Pa] of the path-determined cylinders, (stages + 1, 2)."""
    flow, pressure, _ = stage_arrays.path_determined(problem, cost)
    return np.stack([flow, pressure], axis=1)


def memory_of(legs: Legs, cut: Size) -> float:
    """Bytes that bounding whole stages takes."""
    rows = sum(edges.size - 1 for edges in cut.rows[:-1])
    first = legs.problems[0]
    return bytes_of(cut.count, rows, len(range(len(first.crane.machine.cylinders))[first.moving]))


def bytes_of(count: int, rows: int, moving: int) -> float:
    """Bytes that so many cells in so many rows take, and the enclosures of their coefficients."""
    return 8.0 * (count * 6 + rows * moving * layout.COEFFICIENTS * 4 * 2)
