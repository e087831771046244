"""Value-function slopes for the certificate's affine bounds, taken from a dynamic program's solution.

Finite differences of the bounds themselves ignore stroke limits. A cell at an end of the feasible extensions is a box:
whoever may be anywhere in it may stay in it although moving toward the end. Neither the bounds of such cells nor
differences of them rise toward the end, and planes without slope pass that on to every stage before.

Power has kinks and jumps in velocity, so differences of the values across one are bad slopes, and optimal motions
follow kinks of the power. A stage's cost and what follows after it are taken apart (`docs/certificate.md`): what
follows is smooth, and the slope of the stage's cost is chosen so that the bound is tight along the kink. Only slopes
come from here; whatever they are, the bounds stay proven.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from leanboom.certificate.bellman_bounds import cell_flow, supply_forms
from leanboom.certificate.cell_enclosures import (
    FORM,
    INNER,
    LATTICE,
    MOTION,
    ON_LIMIT,
    V_SIDE,
    V_T,
    V_X,
    Box,
    Stage,
    cell_accelerations,
    cell_motion,
    expand,
    read,
)
from leanboom.certificate.partition import Cells
from leanboom.certificate.viability import Viable
from leanboom.compiling import njit
from leanboom.dynamic_programming import grids, value_function
from leanboom.dynamic_programming.bellman import interpolate, layer, within
from leanboom.dynamic_programming.grids import Grid
from leanboom.dynamic_programming.value_function import Policy
from leanboom.model.motion import Motion
from leanboom.problem.layout import (
    AREA_IN,
    AREA_OUT,
    COEFFICIENTS,
    CYLINDER_COLUMNS,
    DC,
    DW,
    EFFICIENCY,
    SETTINGS,
    STAGE_COLUMNS,
    STEP,
)
from leanboom.problem.legs import Legs

GRID = (801, 201)  # positions and velocities of a policy over everything feasible
TUBE = (201, 321)  # of a policy around the best known motion
HALF_WIDTH, HALF_HEIGHT = 0.1, 0.08  # [m], [m/s], half widths of the tube
UNUSED_SHARE = 0.2  # share of a tube at its sides in which its values are not used: no motion may leave it there
MARGIN_SPACINGS = (
    3.0  # spacings of a policy's grid around a cell in which all states must be viable, for its slopes to be used
)
LEAST_HALF_HEIGHT = 1e-6  # [m/s], least half height of a cell for differences over it


class Envelope(NamedTuple):
    """The least value ahead over all next velocities, along lines; the same for cells of any size."""

    line: np.ndarray  # c + step w / 2 [m], equally spaced
    least: np.ndarray  # least value there [J]
    next_w: np.ndarray  # next velocity that has it [m/s]


@dataclass(frozen=True, slots=True, eq=False)
class Guide:
    """DP value functions and the viable set; near non-viable states values contain penalty terms and are not used."""

    policies: tuple[tuple[Policy, ...], ...]  # of each leg, ever finer and narrower; the first knows every state
    viable: Viable
    closes: bool  # whether where motions end costs something
    envelopes: dict[tuple[int, int], Envelope] = field(default_factory=dict, init=False)  # as asked for: policy, stage

    def slopes(self, cells: Cells, k: int) -> np.ndarray:
        """Slopes for the planes of a stage's cells, from the finest policy that knows a cell.

        Cells near non-viable states take what follows from the nearest others.

        Args:
            cells: The cells.
            k: The stage.

        Returns:
            Along position [J/m] and velocity [J s/m], (rows, columns, 2).
        """
        found, stage = np.zeros((*cells.active[k].shape, 2)), cells.stage(k)
        if k < cells.legs.stages - 1 or self.closes:
            leg, own = cells.legs.of_stage(k)
            left = np.isfinite(cells.active[k])
            for i in range(len(self.policies[leg]) - 1, -1, -1):
                policy = self.policies[leg][i]
                known = known_cells(policy, cells, k)
                row, column = self.nearest_known(policy, cells, k, known)
                ahead, some = self._envelope(i, k, policy, own + 1), np.where(known & left, 0.0, np.inf)
                follow(stage, policy.values[own + 1], policy.tables.stage, own + 1, ahead, some, row, column, found)
                left &= ~known
        charge(stage, cells.active[k], found)
        return found

    def _envelope(self, i: int, k: int, policy: Policy, ahead: int) -> Envelope:
        """The envelope of the values of a leg's i-th policy, at its stage that follows stage k of all."""
        if (i, k) not in self.envelopes:
            line = _lines(policy.grid, policy.problem.step, ahead)
            found = Envelope(line, np.empty(line.size), np.empty(line.size))
            setting = np.zeros(SETTINGS)
            setting[STEP] = policy.problem.step
            min_over_next_velocity(policy.values[ahead], policy.tables.stage, setting, ahead, found)
            self.envelopes[i, k] = found
        return self.envelopes[i, k]

    def nearest_known(self, policy: Policy, cells: Cells, k: int, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """For every cell the nearest known one that keeps the margin: rows, (rows,), and columns, (rows, columns)."""
        edges, spacing = cells.edges[k], policy.tables.stage[cells.legs.of_stage(k)[1]]
        aside, apart = MARGIN_SPACINGS * spacing[DW], MARGIN_SPACINGS * spacing[DC]
        below, above = cells.share(k, cells.rows[k][:-1] - apart), cells.share(k, cells.rows[k][1:] + apart)
        low = np.where(below < 0.0, np.inf, self.viable.within(k, below, below)[0]) + aside
        high = np.where(above > 1.0, -np.inf, self.viable.within(k, above, above)[1]) - aside
        keeps = known & (edges[:, :-1] >= low[:, None] - 1e-9) & (edges[:, 1:] <= high[:, None] + 1e-9)
        some = np.nonzero(keeps.any(axis=1))[0]
        rows, columns = np.arange(keeps.shape[0]), np.arange(keeps.shape[1])
        if some.size == 0:
            return rows, np.tile(columns, (rows.size, 1))
        row = some[np.abs(some[None, :] - rows[:, None]).argmin(axis=1)]
        first, last = keeps.argmax(axis=1), columns.size - 1 - keeps[:, ::-1].argmax(axis=1)
        return row, np.clip(columns[None, :], first[row, None], last[row, None])


def known_cells(policy: Policy, cells: Cells, k: int) -> np.ndarray:
    """Mask of the cells of a stage that are far enough from the sides of a policy's grid, (rows, columns)."""
    rows, edges, own = cells.rows[k], cells.edges[k], cells.legs.of_stage(k)[1]
    grid = policy.grid
    c_lo, c_hi, w_lo, w_hi = (side[own] for side in (grid.c_lo, grid.c_hi, grid.w_lo, grid.w_hi))
    inset_c, inset_w = UNUSED_SHARE * (c_hi - c_lo), UNUSED_SHARE * (w_hi - w_lo)
    limit = cells.legs.velocity_limit
    # Sides that are limits of the motion itself count for nothing.
    low_c = -np.inf if c_lo <= policy.problem.lower[own] else c_lo + inset_c
    high_c = np.inf if c_hi >= policy.problem.upper[own] else c_hi - inset_c
    low_w = -np.inf if w_lo <= -limit else w_lo + inset_w
    high_w = np.inf if w_hi >= limit else w_hi - inset_w
    row = (rows[:-1] >= low_c) & (rows[1:] <= high_c)
    return row[:, None] & (edges[:, :-1] >= low_w) & (edges[:, 1:] <= high_w)


def _lines(grid: Grid, step: float, k: int) -> np.ndarray:
    """Equally spaced lines c - step w / 2 [m] that meet the nodes of a grid's stage."""
    low, high = grid.c_lo[k] - 0.5 * step * grid.w_hi[k], grid.c_hi[k] - 0.5 * step * grid.w_lo[k]
    return np.linspace(low, high, 2 * grid.positions)


def make(
    legs: Legs, cost: str, viable: Viable, beside: Motion, end: float | None = None,
    multiplier: np.ndarray | None = None,
) -> Guide:  # fmt: skip
    """The guide of legs: solved on a grid of everything feasible and on one around a motion, from the last leg on.

    Args:
        legs: The discretised task.
        cost: "ls" or "cp".
        viable: Velocities from which motions can go on within the limits.
        beside: The motion, on the stages of all legs.
        end, multiplier: As in `lower_bounds.bound`.
    """
    policies: list[tuple[Policy, ...]] = []
    after, last = multiplier, len(legs.problems) - 1
    for i in range(last, -1, -1):
        problem, here = legs.problems[i], legs.part(i)
        full = grids.full_grid(problem, *GRID)
        tube = grids.tube_grid(problem, beside.position[here], beside.velocity[here], HALF_WIDTH, HALF_HEIGHT, *TUBE)
        terminal = None if after is None else value_function.resting(problem, cost, *after)
        ends = end if i == last else None
        policies.append(tuple(value_function.solve(problem, each, cost, terminal, ends) for each in (full, tube)))
        after = value_function.rest_costs(policies[-1][0])
    return Guide(tuple(policies[::-1]), viable, multiplier is not None)


def memory(legs: Legs) -> float:
    """Bytes that making the guide of legs takes."""
    return sum(value_function.memory(each.stages, *nodes) for each in legs.problems for nodes in (GRID, TUBE))


@njit(cache=True, error_model="numpy", nogil=True)
def min_over_next_velocity(values, grid, setting, k, envelope):
    """Lower envelope of the values ahead along c' = s + step w' / 2, for every s = c + step w / 2.

    Args:
        values: Cost to go of stage k, the next one [J], (positions, velocities).
        grid: The policy's stages, (stages + 1, STAGE_COLUMNS).
        setting: Scalars, (SETTINGS,), without penalties.
        k: The next stage.
        envelope: Its lines, each leading to some node's position; `least` and `next_w` are filled.
    """
    line, least, next_w = envelope
    ahead = layer(values, grid, setting, k)
    end = ahead.c_lo + (values.shape[0] - 1) * ahead.dc
    for q in range(line.size):
        least[q], next_w[q] = np.inf, 0.0
        for j in range(values.shape[1]):
            w = ahead.w_lo + j * ahead.dw
            c = line[q] + 0.5 * setting[STEP] * w
            if ahead.c_lo - ON_LIMIT <= c <= end + ON_LIMIT:
                value = interpolate(ahead, c, w)
                if value < least[q]:
                    least[q], next_w[q] = value, w


@njit(cache=True, **INNER)
def least_ahead(ahead, step, envelope, c, w, lo, hi):
    """Least value ahead of a state whose acceleration is between lo and hi: the envelope where it is in reach."""
    line, least, next_w = envelope
    s = c + 0.5 * step * w
    x = within((s - line[0]) / (line[1] - line[0]), line.size - 1.0)
    q = min(int(x), line.size - 2)
    share = x - q
    target = next_w[q] if share < 0.5 else next_w[q + 1]
    if w + step * lo <= target <= w + step * hi:
        return (1.0 - share) * least[q] + share * least[q + 1]
    target = min(max(target, w + step * lo), w + step * hi)
    return interpolate(ahead, s + 0.5 * step * target, target)


@njit(cache=True, error_model="numpy", nogil=True)
def follow(stage, values, grid, k, envelope, active, row, column, slope):
    """Slopes over a stage's cells of the least cost after the stage.

    Args:
        stage: A `cell_enclosures.Stage`.
        values, grid, k, envelope: As in `min_over_next_velocity`.
        active: Finite where a cell is looked at, (rows, columns).
        row, column: Cell of the stage where the slopes of a cell are taken, (rows,) and (rows, columns).
        slope: Out: along position [J/m] and velocity [J s/m], (rows, columns, 2).
    """
    model, rows, edges, cylinder = stage.model, stage.rows, stage.edges, stage.cylinder
    coefficients = np.empty((model.shape[1], COEFFICIENTS, 3))
    step, ahead = stage.setting[STEP], layer(values, grid, stage.setting, k)
    for p in range(slope.shape[0]):
        expand(model, row[p], coefficients)
        c, half_c = 0.5 * (rows[row[p] + 1] + rows[row[p]]), 0.5 * (rows[row[p] + 1] - rows[row[p]])
        for r in range(slope.shape[1]):
            if active[p, r] == np.inf:
                continue
            slow, fast = edges[row[p], column[p, r]], edges[row[p], column[p, r] + 1]
            w, half = 0.5 * (fast + slow), max(0.5 * (fast - slow), LEAST_HALF_HEIGHT)
            lo, hi = cell_accelerations(coefficients, cylinder, w, 0.0)
            rise = least_ahead(ahead, step, envelope, c + half_c, w, lo, hi)
            rise -= least_ahead(ahead, step, envelope, c - half_c, w, lo, hi)
            slope[p, r, 0] = 0.5 * rise / half_c
            rise = least_ahead(ahead, step, envelope, c, w + half, lo, hi)
            rise -= least_ahead(ahead, step, envelope, c, w - half, lo, hi)
            slope[p, r, 1] = 0.5 * rise / half


@njit(cache=True, error_model="numpy", nogil=True)
def charge(stage, active, slope):
    """Add the slopes of the stage's own cost over its cells to those of the cost after it.

    The flow of a cylinder that turns round within the cell has a kink. Of its slopes there the one is taken with
    which a motion gains nothing by leaving the kink: slope_w + step / 2 slope_c = 0, as far as it has it.

    Args:
        stage: A `cell_enclosures.Stage`.
        active: Finite where a cell is looked at, (rows, columns).
        slope: Changed in place: along position [J/m] and velocity [J s/m], (rows, columns, 2).
    """
    model, rows, edges, cylinder, setting = stage.model, stage.rows, stage.edges, stage.cylinder, stage.setting
    fixed, n = stage.fixed, model.shape[1]
    coefficients, motion, sigma = np.empty((n, COEFFICIENTS, 3)), np.zeros((n, MOTION)), np.zeros(n)
    forms, middle = np.zeros((n + 1, FORM)), Box(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    half_step, rate = 0.5 * setting[STEP], setting[STEP] / setting[EFFICIENCY]
    for p in range(slope.shape[0]):
        expand(model, p, coefficients)
        half_c = 0.5 * (rows[p + 1] - rows[p])
        for r in range(slope.shape[1]):
            if active[p, r] == np.inf:
                continue
            w, half = (
                0.5 * (edges[p, r + 1] + edges[p, r]),
                max(0.5 * (edges[p, r + 1] - edges[p, r]), LEAST_HALF_HEIGHT),
            )
            lo, hi = cell_motion(coefficients, cylinder, setting, w, half, motion)
            if not lo <= hi:
                continue
            flow, flow_t, flow_x, _, _ = cell_flow(motion, cylinder, half, fixed[0], sigma)
            u = min(max(0.0, lo), hi)
            best = 0
            for q in range(supply_forms(motion, setting, fixed[1], u, u, u, middle, forms)):
                if forms[q, 0] > forms[best, 0]:
                    best = q
            supply, supply_t, supply_x, supply_y = read(forms, best)
            # Without what supply owes to accelerating, which the stage before owes as much to arriving.
            along_c = slope[p, r, 0] + rate * (flow * supply_t + flow_t * supply) / half_c
            along_w = slope[p, r, 1] + rate * (flow * (supply_x + supply_y) + flow_x * supply)
            for m in range(n):
                turn_c, turn_w = rate * supply * motion[m, V_T] / half_c, rate * supply * motion[m, V_X]
                if motion[m, V_SIDE] == 0.0 and half_step * turn_c + turn_w != 0.0:
                    share = -(half_step * along_c + along_w) / (half_step * turn_c + turn_w)
                    share = min(max(share, -cylinder[m, AREA_IN] - sigma[m]), cylinder[m, AREA_OUT] - sigma[m])
                    along_c += share * turn_c
                    along_w += share * turn_w
            slope[p, r, 0], slope[p, r, 1] = along_c, along_w - rate * flow * supply_y


def prepare() -> None:
    """Load the compiled kernels, compiling them on the very first run."""
    one, none, edges, rows = np.zeros((1, 1)), np.zeros((1, 1), int), np.zeros((1, 2)), np.arange(2.0)
    stage = Stage(
        np.zeros((1, 1, COEFFICIENTS, 4)), rows, edges, edges, np.ones(LATTICE), rows, edges, edges, np.zeros(2),
        np.ones((1, CYLINDER_COLUMNS)), np.ones(SETTINGS),
    )  # fmt: skip
    values, grid, slope = np.zeros((2, 2), dtype=np.float32), np.ones((1, STAGE_COLUMNS)), np.zeros((1, 1, 2))
    envelope = Envelope(rows, np.zeros(2), np.zeros(2))
    min_over_next_velocity(values, grid, stage.setting, 0, envelope)
    follow(stage, values, grid, 0, envelope, one, none[0], none, slope)
    charge(stage, one, slope)
