"""Rigorous lower bounds over cells of the state space: the certificate's dynamic program.

`bound` runs backward and finds, for each cell, a plane below the cost to go of every motion through it; `reach` runs
forward and finds the excess over the bound with which a cell can be reached at all; `refine` keeps the cells
whose excess is small enough and halves them. See `docs/certificate.md` for the proofs.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from leanboom import resources
from leanboom.certificate import bellman_bounds, cell_enclosures, position_rows, viability
from leanboom.certificate.cell_enclosures import L_J, LATTICE, Stage
from leanboom.certificate.partition import AT_REST, COARSE, Cells, bytes_of, made_of, memory_of, size, whole
from leanboom.model.motion import Motion
from leanboom.problem import layout
from leanboom.problem.legs import Legs
from leanboom.problem.stages import Problem

SHARES = 8  # parts a thread takes of a stage: rows differ in work
ON_EDGE = 1e-10  # [m/s], by which a velocity may be off a cell to be counted in it
LEAST_DISTANCE = 1e-6  # [m], [m/s], least distance of middles for a slope
NO_FLOORS = np.empty((0, 0))  # of passes that find none
MOST_LOST = 0.5  # a plane that loses more than this share of what it rises to a corner is tried again, level


GivenSlopes = Callable[[Cells, int], np.ndarray]  # as `value_slopes.Guide.slopes`


@dataclass(frozen=True, slots=True, eq=False)
class Bounds:
    """Planes and floors below the cost to go over cells, and the bound at the start."""

    cells: Cells
    planes: tuple[np.ndarray, ...]  # level [J], slopes [J/m], [J s/m], floor [J]: (rows, columns, 4); the end's, too
    start: np.ndarray  # least cost to go from the start through each cell of stage 0 [J], (rows, columns)

    @property
    def lower(self) -> float:
        """Lower bound of the energy of any motion from the start [J]; inf where there is none."""
        return float(self.start.min())


class OutOfTime(Exception):
    """The time given to a bound is over."""


def excludes_motion(problem: Problem, start: float | None) -> bool:
    """Whether it is proven that no motion of the discretised problem keeps all limits, from rest to rest.

    The cells are the smallest that fit into the free memory; where none do, nothing is proven.

    Args:
        problem: The discretised task.
        start: Where the redundant cylinder starts [m]; None: anywhere.
    """
    room, sizes = resources.USABLE * resources.free_memory(), ((1, 1), *reversed(COARSE))
    legs = Legs((problem,))
    times = next((each for each in sizes if memory_of(legs, size(legs, "cp", times=each)) <= room), None)
    if times is None:
        return False
    cells = whole(legs, "cp", times=times)
    low, high = cells.viable.low[0], cells.viable.high[0]
    rests = (low <= 0.0) & (high >= 0.0)
    if start is None:
        return not bool(np.any(rests))
    share = cells.share(0, np.array([start]))
    low, high = cells.viable.within(0, share, share)
    return not bool(low[0] <= 0.0 <= high[0])


def bound(
    cells: Cells, start: float | None, check: Callable[[float], None], guide: GivenSlopes | None = None,
    limit: float = np.inf, coarse: bool = False, end: float | None = None, multiplier: np.ndarray | None = None,
) -> Bounds:  # fmt: skip
    """Planes below the cost to go over all cells, by the backward pass.

    Args:
        cells: The cells; motions that leave them are not bounded.
        start: Start of the redundant cylinder [m], at rest; None: anywhere feasible.
        check: Called with the share done before every stage; raises to end the pass.
        guide: Gives the slopes of the planes of a stage's cells; None: differences of the bounds themselves.
        limit: Energy beyond which motions are of no interest, and not bounded [J].
        coarse: Without a guide, every plane gets a floor. It pays where cells are large.
        end: Where motions end, at rest [m]; None: anywhere feasible.
        multiplier: Where motions end where they start: extensions [m], rising, and at most 0 J each, linear in
            between, (2, any number). It is paid at the end and gained at the start, so it costs them nothing.

    Returns:
        The bounds.
    """
    n, bottom = cells.legs.stages, 0.0 if multiplier is None else float(multiplier[1].min())
    planes: list[np.ndarray] = [np.empty(0)] * n + [_at_end(cells.rows[n], end, multiplier, cells.rows[0])]
    with _Pool(cells) as pool:
        given = pool.later(guide, n - 1)
        for k in range(n - 1, -1, -1):
            check(1.0 - (k + 1) / n)
            here, given = given, pool.later(guide, k - 1)
            ahead = planes[k + 1]
            if here is not None:
                planes[k] = _guided(pool, k, ahead, here.result(), bottom)
            elif coarse:
                planes[k] = _guided(pool, k, ahead, _differences(pool, k, ahead)[1], bottom)
            else:
                planes[k] = _planes(pool, k, ahead, bottom)
            least = np.maximum(planes[k][..., 0] - _rise(cells, k, planes[k]), planes[k][..., 3])
            planes[k][cells.active[k] + least > limit, 0] = np.inf
    return Bounds(cells, tuple(planes), _at_start(cells, planes[0], start, multiplier))


def _rise(cells: Cells, k: int, planes: np.ndarray) -> np.ndarray:
    """By how much planes of a stage rise from the middles of their cells at most [J], (rows, columns)."""
    high, wide = np.diff(cells.rows[k])[:, None], np.diff(cells.edges[k], axis=1)
    return 0.5 * (np.abs(planes[..., 1]) * high + np.abs(planes[..., 2]) * wide)


def _differences(pool: _Pool, k: int, ahead: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bounds at the middles of a stage's cells [J], (rows, columns), and slopes by them, (rows, columns, 2)."""
    cells, active = pool.cells, pool.cells.active[k]
    middle = pool.backward(k, active, np.zeros((*active.shape, 4)), ahead, at_middle=True)
    along = slopes(middle, 0, position_rows.middles(cells.rows[k])[:, None]), slopes(middle, 1, cells.middles(k))
    return middle, np.stack(along, axis=-1)


def _planes(pool: _Pool, k: int, ahead: np.ndarray, bottom: float) -> np.ndarray:
    """Planes sloped as bounds of neighbours differ, with zero slope next to infeasible cells, where the value jumps.

    No cost to go is below `bottom` [J].
    """
    cells, active = pool.cells, pool.cells.active[k]
    here = np.zeros((*active.shape, 4))
    middle, here[..., 1:3] = _differences(pool, k, ahead)
    here[..., 3] = bottom
    level = pool.backward(k, active, here, ahead)
    with np.errstate(invalid="ignore"):
        bent = np.isfinite(level) & ~(middle - level <= MOST_LOST * _rise(cells, k, here))
    if bent.any():
        flat = pool.backward(k, np.where(bent, 0.0, np.inf), np.zeros_like(here), ahead)
        here[..., 3] = np.where(bent, np.maximum(flat, bottom), bottom)
        better = bent & (flat > level)
        here[better, 1:3] = 0.0
        level = np.where(better, flat, level)
    here[..., 0] = level
    return here


def _guided(pool: _Pool, k: int, ahead: np.ndarray, given: np.ndarray, bottom: float) -> np.ndarray:
    """Planes of a stage with given slopes, (rows, columns, 2), and a floor to each, not below `bottom` [J]."""
    active = pool.cells.active[k]
    here = np.zeros((*active.shape, 4))
    here[..., 1:3] = np.where(np.isfinite(given), given, 0.0)  # nan would pass for a state without motions
    floors = np.full(active.shape, np.inf)
    here[..., 0] = pool.backward(k, active, here, ahead, floors=floors)
    here[..., 3] = np.where(np.isfinite(here[..., 0]), np.maximum(floors, bottom), bottom)
    return here


def slopes(values: np.ndarray, axis: int, at: np.ndarray) -> np.ndarray:
    """Slopes of values from cell to cell along an axis, 0 at an extreme.

    Any slope gives a valid plane; these make planes that lie close. Along position, where values bend little and
    their differences are noisy: van Leer's mean of both sides of smoothed values. Along velocity, across the jumps
    where a cylinder begins to demand pressure: the smaller side.

    Args:
        values: Least cost to go from the cells' middles [J], inf where there is none, (rows, columns).
        axis: 0 for position, 1 for velocity.
        at: Positions [m] or velocities [m/s] of the middles, as broadcast to the values.

    Returns:
        Slopes [J/m] or [J s/m], (rows, columns).
    """
    f = np.swapaxes(np.where(np.isfinite(values), values, np.nan), 0, axis)
    if f.shape[0] < 2:
        return np.zeros_like(values)
    if axis == 0:
        mean = 0.25 * f[:-2] + 0.5 * f[1:-1] + 0.25 * f[2:]
        f = np.concatenate([f[:1], np.where(np.isfinite(mean), mean, f[1:-1]), f[-1:]])
    apart = np.swapaxes(np.broadcast_to(at, values.shape), 0, axis)
    step = np.diff(f, axis=0) / np.maximum(np.diff(apart, axis=0), LEAST_DISTANCE)
    edge = np.full((1, f.shape[1]), np.nan)
    left, right = np.concatenate([edge, step]), np.concatenate([step, edge])
    left, right = np.where(np.isnan(left), right, left), np.where(np.isnan(right), left, right)
    with np.errstate(all="ignore"):
        if axis == 0:
            rise = 2.0 * left * right / (left + right)
        else:
            rise = np.where(np.abs(left) < np.abs(right), left, right)
        rise = np.where(left * right > 0.0, rise, 0.0)
    return np.swapaxes(rise, 0, axis)


def _at_end(rows: np.ndarray, end: float | None, multiplier: np.ndarray | None, first_rows: np.ndarray) -> np.ndarray:
    """Planes over the last stage's cells, (rows, 1, 4): below what ending there costs, inf where none may.

    With a multiplier motions end where they start: within the rows of the first stage, `first_rows`.
    """
    planes = np.zeros((rows.size - 1, 1, 4))
    if multiplier is not None:
        first, last = (np.interp(edges, *multiplier) for edges in (rows[:-1], rows[1:]))
        slope, level, floor = (last - first) / np.diff(rows), 0.5 * (first + last), np.minimum(first, last)
        row, at, cost = _within_rows(multiplier, rows)
        np.minimum.at(level, row, cost - slope[row] * (at - position_rows.middles(rows)[row]))
        np.minimum.at(floor, row, cost)
        off = cell_enclosures.ON_LIMIT * np.abs(np.diff(multiplier[1]) / np.diff(multiplier[0])).max()
        planes[:, 0, 0], planes[:, 0, 1] = level - 2.0 * off, slope  # rows overlap a little
        planes[:, 0, 3] = np.maximum(floor - off, multiplier[1].min())
        planes[_beside(rows, float(first_rows[0]), float(first_rows[-1])), 0, 0] = np.inf
    if end is not None:
        planes[_beside(rows, end, end), 0, 0] = np.inf
    return planes


def _beside(rows: np.ndarray, low: float, high: float) -> np.ndarray:
    """Mask of the rows that hold no position from `low` to `high` [m]."""
    return (high < rows[:-1] - cell_enclosures.ON_LIMIT) | (low > rows[1:] + cell_enclosures.ON_LIMIT)


def _within_rows(multiplier: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows that extensions of a multiplier are in, these extensions [m], and its values there [J]."""
    at, cost = multiplier[:, (multiplier[0] > rows[0]) & (multiplier[0] < rows[-1])]
    return np.searchsorted(rows, at) - 1, at, cost


def _at_start(cells: Cells, planes: np.ndarray, start: float | None, multiplier: np.ndarray | None) -> np.ndarray:
    """Least value over the start states of each cell of stage 0, inf where a cell holds none."""
    rows = cells.rows[0]
    half, middle = 0.5 * np.diff(rows), position_rows.middles(rows)
    off = -cells.middles(0)  # from the middle to rest
    if start is None:
        low, high = -half, half
        inside = np.ones(middle.size, dtype=bool)
    else:
        low = high = start - middle
        inside = np.abs(low) <= half + cell_enclosures.ON_LIMIT
    at_rest, slope = planes[..., 0] + planes[..., 2] * off, planes[..., 1]
    gained = np.zeros((2, middle.size))
    if multiplier is not None:
        gained = np.interp(middle + np.stack([low, high]), *multiplier)
    value = at_rest + np.minimum(slope * low[:, None] - gained[0][:, None], slope * high[:, None] - gained[1][:, None])
    most = gained.max(axis=0)
    if multiplier is not None:
        row, at, cost = _within_rows(multiplier, rows)
        np.minimum.at(value, row, at_rest[row] + slope[row] * (at - middle[row])[:, None] - cost[:, None])
        np.maximum.at(most, row, cost)
    value = np.maximum(value, np.where(np.isfinite(planes[..., 0]), planes[..., 3] - most[:, None], np.inf))
    holds = np.abs(off) <= 0.5 * np.diff(cells.edges[0], axis=1) + ON_EDGE
    return np.where(inside[:, None] & holds, value, np.inf)


def steeper(found: Bounds, before: np.ndarray) -> np.ndarray:
    """The multiplier that bounds suggest: the cost to go from rest where motions start, which pays for itself.

    With the true cost to go as a multiplier no bound is lower than without (`docs/certificate.md`). It is nowhere
    above the one before: what motions up to a cell have taken, start included, then still holds.

    Args:
        found: The bounds.
        before: The multiplier with which they were found.
    """
    cells, planes = found.cells, found.planes[0]
    rest = np.maximum(planes[..., 0] - planes[..., 2] * cells.middles(0), planes[..., 3])
    least = np.where(np.isfinite(found.start), rest, np.inf).min(axis=1)
    some = np.isfinite(least)
    if some.sum() < 2:  # no line in between
        return before
    at = position_rows.middles(cells.rows[0])[some]
    every = np.union1d(at, before[0])
    raised = np.interp(every, at, least[some]) - np.interp(every, *before)
    return np.stack([at, least[some] - max(float(raised.max()), float(least[some].max()))])


def reach(found: Bounds, limit: float, check: Callable[[float], None]) -> tuple[np.ndarray, ...]:
    """Least excess over the bound with which a motion from the start enters each cell, by the forward pass.

    Args:
        found: The bounds.
        limit: Energy beyond which motions are of no interest [J].
        check: As in `bound`.

    Returns:
        Excess [J], inf where every motion through the cell costs more than `limit`, (rows, columns) a stage.
    """
    cells, room = found.cells, limit - found.lower
    excess = [np.where(found.start <= limit, found.start - found.lower, np.inf)]
    with _Pool(cells) as pool:
        for k in range(cells.legs.stages - 1):
            check((k + 1) / cells.legs.stages)
            excess.append(pool.forward(k, room, excess[-1], found.planes[k], found.planes[k + 1]))
    return tuple(excess)


def refine(found: Bounds, excess: tuple[np.ndarray, ...], rows_too: bool = True) -> Cells | None:
    """Reachable cells, bisected; None if none is reachable below the cut-off energy.

    Args:
        found: The bounds over the cells.
        excess: As `reach` finds it.
        rows_too: Whether rows are halved as well.
    """
    cells = found.cells
    n = cells.legs.stages
    corner, counts, finer_rows = np.zeros(n, dtype=int), np.zeros(n, dtype=int), []
    cut = position_rows.halved if rows_too else np.copy
    for k, reached in enumerate(excess):
        some = np.isfinite(reached)
        rows, columns = np.nonzero(some.any(axis=1))[0], np.nonzero(some.any(axis=0))[0]
        if rows.size == 0:
            return None
        finer_rows.append(cut(cells.rows[k][rows[0] : rows[-1] + 2]))
        # Edges of both levels are moved, by less than half a cell each: a neighbour may take over a strip.
        origin = int(cells.lattice[k, L_J])
        first, last = max(origin + columns[0] - 1, 0), min(origin + columns[-1] + 1, int(cells.velocities[k]) - 1)
        corner[k], counts[k] = 2 * first, 2 * (last - first + 1)
    finer_rows.append(cut(cells.rows[n]))
    size = (2 if rows_too else 1) * cells.positions, 2 * cells.velocities
    finer = made_of(cells.legs, cells.cost, *size, finer_rows, counts, corner, cells.viable)
    for k, reached in enumerate(excess):
        cell_enclosures.hand_down(
            cells.rows[k], cells.edges[k], cells.lattice[k], found.planes[k], found.lower + reached, finer.rows[k],
            finer.edges[k], finer.lattice[k], finer.active[k],
        )  # fmt: skip
    return finer


def memory(cells: Cells, excess: tuple[np.ndarray, ...]) -> float:
    """Bytes that bounding the refined cells takes."""
    rows = sum(2 * int(np.isfinite(e).any(axis=1).sum()) for e in excess)
    size = sum(4 * e.size for e in excess)
    return bytes_of(size, rows, cells.cylinder.shape[0])


def value_at(found: Bounds, k: int, position: float, velocity: float) -> float:
    """Lower bound of the cost to go from a state [J]: the least of the cells it lies in; inf where there is none."""
    if k == found.cells.legs.stages and abs(velocity) < AT_REST:
        velocity = 0.0
    planes, edges, rows = found.planes[k], found.cells.edges[k], found.cells.rows[k]
    least = np.inf
    touched = (rows[:-1] - cell_enclosures.ON_LIMIT <= position) & (position <= rows[1:] + cell_enclosures.ON_LIMIT)
    for i in np.nonzero(touched)[0]:
        inside = (edges[i, :-1] - ON_EDGE <= velocity) & (velocity <= edges[i, 1:] + ON_EDGE)
        for j in np.nonzero(inside & np.isfinite(planes[i, :, 0]))[0]:
            level, slope_c, slope_w, floor = planes[i, j]
            value = level + slope_c * (position - 0.5 * (rows[i] + rows[i + 1]))
            value += slope_w * (velocity - 0.5 * (edges[i, j] + edges[i, j + 1]))
            least = min(least, max(value, floor))
    return least


def residuals(found: Bounds, motion: Motion, costs: np.ndarray) -> np.ndarray:
    """By how much a motion's stages cost more than the bounds allow [J], (stages,): never below 0 if they are valid.

    Stage cost plus bound at the next state less bound at this one; inf from where the motion leaves the cells.

    Args:
        found: The bounds.
        motion: A motion on the problem's stages that keeps every limit.
        costs: Its stages' energies [J], (stages,).
    """
    n = costs.size
    value = [value_at(found, k, motion.position[k], motion.velocity[k]) for k in range(n + 1)]
    with np.errstate(invalid="ignore"):
        rest = costs + np.array(value[1:]) - np.array(value[:-1])
    return np.where(np.isfinite(rest), rest, np.inf)


def prepare() -> None:
    """Load the compiled kernels, compiling them on the very first run, by bounding a stage of one cell."""
    model, one = np.zeros((1, 1, layout.COEFFICIENTS, 4)), np.zeros((1, 1))
    columns, lattice, rows = np.zeros((1, 2)), np.ones(LATTICE), np.arange(2.0)
    cylinder, setting = np.ones((1, layout.CYLINDER_COLUMNS)), np.ones(layout.SETTINGS)
    planes = np.zeros((1, 1, 4))
    cell_enclosures.velocity_columns(model, cylinder, columns)
    cell_enclosures.place_edges(model, setting, lattice, np.zeros((1, 2)))
    cell_enclosures.hand_down(rows, columns, lattice, planes, one, rows, columns, lattice, one)
    viability.viable_velocities(1, (rows, rows), (model,), [columns], cylinder, np.ones(1))
    stage = Stage(model, rows, columns, columns, lattice, rows, columns, columns, np.zeros(2), cylinder, setting)
    bellman_bounds.backward(stage, 0, 1, False, one, planes, planes, one, NO_FLOORS)
    bellman_bounds.forward(stage, 0, 1, 0.0, one, planes, planes, one)


class _Pool:
    """Threads that share the rows of a stage among them."""

    def __init__(self, cells: Cells) -> None:
        self.cells, self.workers = cells, resources.threads()

    def __enter__(self) -> _Pool:
        self.pool = ThreadPoolExecutor(self.workers)
        return self

    def __exit__(self, *_: object) -> None:
        self.pool.shutdown()

    def later(self, guide: GivenSlopes | None, k: int) -> Future[np.ndarray] | None:
        """Slopes that a guide gives for a stage, made while others are bounded; None without guide or stage."""
        return None if guide is None or k < 0 else self.pool.submit(guide, self.cells, k)

    def backward(
        self, k: int, active: np.ndarray, planes: np.ndarray, ahead: np.ndarray, at_middle: bool = False,
        floors: np.ndarray = NO_FLOORS,
    ) -> np.ndarray:  # fmt: skip
        """Values of the cells of stage k, inf where there are none; arguments as in `bellman_bounds.backward`."""
        stage, found = self.cells.stage(k), np.full(active.shape, np.inf)
        parts = _shares(active, min(SHARES * self.workers, active.shape[0]))
        jobs = [
            self.pool.submit(bellman_bounds.backward, stage, *part, at_middle, active, planes, ahead, found, floors)
            for part in parts
        ]
        for job in jobs:
            job.result()
        return found

    def forward(self, k: int, limit: float, active: np.ndarray, planes: np.ndarray, ahead: np.ndarray) -> np.ndarray:
        """Excess of the cells of stage k + 1 [J]; arguments as in `bellman_bounds.forward`."""
        stage, jobs = self.cells.stage(k), []
        for part in _shares(active, self.workers):
            found = np.full(ahead.shape[:2], np.inf)  # one a thread: it is lowered in place
            jobs.append(
                (found, self.pool.submit(bellman_bounds.forward, stage, *part, limit, active, planes, ahead, found))
            )
        for _, job in jobs:
            job.result()
        return np.minimum.reduce([found for found, _ in jobs])


def _shares(active: np.ndarray, parts: int) -> list[tuple[int, int]]:
    """First and last row of parts of about as many finite cells."""
    work = np.cumsum(np.isfinite(active).sum(axis=1))
    edges = [0, *(int(np.searchsorted(work, work[-1] * q / parts)) for q in range(1, parts)), active.shape[0]]
    return list(zip(edges[:-1], edges[1:], strict=True))
