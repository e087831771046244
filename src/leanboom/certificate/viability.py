"""Velocities from which the redundant cylinder can still keep its limits: the viable set, stage by stage.

Near an end of the feasible extensions only slow motions toward it can still stop in time. For every stage and
position `Viable` bounds the velocities of all motions that keep the limits to the end; `docs/certificate.md` proves
the recursion. Positions are in bins and velocities are numbers, so the edge of the viable set is known more
exactly than by cells, which are boxes of both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from leanboom.certificate import cell_enclosures
from leanboom.certificate.cell_enclosures import INNER, ON_LIMIT
from leanboom.compiling import njit
from leanboom.problem.layout import COEFFICIENTS

BINS = 16  # bins of position in a row of the first level
STRIPS = 8  # parts of the velocity range, over each of which the acceleration limits are enclosed
HALVINGS = 30  # of the bracket of a velocity


@dataclass(frozen=True, slots=True, eq=False)
class Viable:
    """Bounds of the viable velocities of all positions in a bin [m/s], (stages + 1, bins); both fall with position."""

    low: np.ndarray  # inf where no velocity is viable
    high: np.ndarray  # -inf where no velocity is viable

    def within(self, k: int, first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bounds over positions from shares `first` to `last` of a stage's feasible extensions, arrays of one shape.

        The widest bounds of the bins touched: every viable velocity of every position between is within them.
        """
        bins = self.low.shape[1]
        lowest = np.clip(np.floor(first * bins + 1e-9).astype(int), 0, bins - 1)
        highest = np.clip(np.ceil(last * bins - 1e-9).astype(int) - 1, 0, bins - 1)
        return self.low[k, highest], self.high[k, lowest]


def viable_velocities(
    bins: int, rows: tuple[np.ndarray, ...], model: tuple[np.ndarray, ...], columns: list[np.ndarray],
    cylinder: np.ndarray, step: np.ndarray,
) -> Viable:  # fmt: skip
    """The viable velocities of every stage.

    Args:
        bins: Number of bins of a stage, equally wide; edges of rows are edges of bins.
        rows: Edges of the rows of the first level [m], whole stages, (rows + 1,) a stage and the end.
        model: Enclosures of the coefficients over rows, (rows, moving, COEFFICIENTS, 4) a stage.
        columns: Velocities of each row that keep the velocity limits [m/s], (rows, 2) a stage.
        cylinder: (moving, layout.CYLINDER_COLUMNS).
        step: Lengths of the stages [s], (stages,).

    Returns:
        The viable velocities; at the last stage only rest.
    """
    n = len(model)
    low, high = np.zeros((n + 1, bins)), np.zeros((n + 1, bins))
    for k in range(n - 1, -1, -1):
        stage_velocities(
            model[k], cylinder, step[k], rows[k], rows[k + 1], columns[k], low[k + 1], high[k + 1], low[k], high[k]
        )
    return Viable(low, high)


@njit(cache=True, **INNER)
def least_viable(low, first, width, c):
    """Least viable velocity at position c of bins of `width` from `first` on; inf below them."""
    if c < first - ON_LIMIT:
        return np.inf
    return low[int(min(max((c - first + ON_LIMIT) / width, 0.0), low.size - 1.0))]


@njit(cache=True, **INNER)
def least_velocity(slowest, fastest, push, c, step, ahead, first, width):
    """Smallest velocity at c from which maximum acceleration reaches the viable set; inf where there is none.

    What is reached rises with the velocity and what is viable there falls, so there is one threshold. The end of
    its bracket that is not viable is returned.
    """
    c += 0.5 * step * step * push
    if slowest + step * push >= least_viable(ahead, first, width, c + step * slowest):
        return slowest
    if not fastest + step * push >= least_viable(ahead, first, width, c + step * fastest):
        return np.inf
    for _ in range(HALVINGS):
        w = 0.5 * (slowest + fastest)
        if w + step * push >= least_viable(ahead, first, width, c + step * w):
            fastest = w
        else:
            slowest = w
    return slowest


@njit(cache=True, error_model="numpy", nogil=True)
def stage_velocities(model, cylinder, step, rows, rows_ahead, columns, low_ahead, high_ahead, low, high):
    """Viable velocities of one stage's bins, `low` and `high`, from those of the next stage.

    The upper bounds are the lower ones of the mirrored problem: positions, velocities and pushes with the other sign.
    """
    bins = low.size
    coefficients = np.empty((model.shape[1], COEFFICIENTS, 3))
    width, width_ahead = (rows[-1] - rows[0]) / bins, (rows_ahead[-1] - rows_ahead[0]) / bins
    mirrored = -high_ahead[::-1]
    for p in range(model.shape[0]):
        cell_enclosures.expand(model, p, coefficients)
        slowest, fastest = columns[p, 0], columns[p, 1]
        half = 0.5 * (fastest - slowest) / STRIPS
        down, up = np.inf, -np.inf
        for q in range(STRIPS):
            lo, hi = cell_enclosures.cell_accelerations(coefficients, cylinder, slowest + half * (2 * q + 1), half)
            down, up = min(down, lo), max(up, hi)
        for b in range(round((rows[p] - rows[0]) / width), round((rows[p + 1] - rows[0]) / width)):
            c = rows[0] + b * width
            low[b] = least_velocity(slowest, fastest, up, c + width, step, low_ahead, rows_ahead[0], width_ahead)
            high[b] = -least_velocity(-fastest, -slowest, -down, -c, step, mirrored, -rows_ahead[-1], width_ahead)
    for b in range(1, bins):
        low[b] = min(low[b], low[b - 1])
    for b in range(bins - 2, -1, -1):
        high[b] = max(high[b], high[b + 1])
