r"""The fastest way along a path with the redundancy settled: time-optimal path parametrisation.

Bobrow, Dubowsky, Gibson (1985) and Shin, McKay (1985): in b = omega^2 and u = d omega / dt all limits are linear,

    |L'| sqrt(b) <= v_max,    |L'' b + L' u| <= a_max,    Q_1 sqrt(b) <= Q_max,    b' = 2 u,

so with u constant between points the fastest rates are a linear program (Verscheure and others, 2009, has the same
limits with the time as a convex cost). Of all b that keep the limits the fastest is the largest at every point at
once, so their sum is what is maximised. Symbols as in `along`; Q_1 is the pump flow at the rate 1.
"""

from __future__ import annotations

import numpy as np

from leanboom.model import crane as cranes
from leanboom.timing.along import INSIDE, Along

LEAST_TIME = 0.02  # [s], no path is passed faster than in this: rates stay finite where nothing limits them


def fastest(tau: np.ndarray, begins: Along, ends: Along, crane: cranes.Crane, most: float) -> np.ndarray | None:
    """The fastest rates with which points of a path can be passed.

    Args:
        tau: Own times of the points [s], (points,).
        begins, ends: The cylinders at the beginning and the end of each interval, from inside, (points - 1,).
        crane: The crane, whose limits count.
        most: Largest rate.

    Returns:
        Rates, (points,); None where no rate keeps the limits.
    """
    from scipy.optimize import linprog
    from scipy.sparse import coo_array

    cylinders = crane.machine.cylinders
    fast = np.array([c.velocity_limit for c in cylinders])
    hard = np.array([c.acceleration_limit for c in cylinders])
    count, steps = tau.size, np.diff(tau)
    bound = np.full(count, most**2)
    for here, points in ((begins, slice(0, -1)), (ends, slice(1, None))):
        with np.errstate(divide="ignore"):
            allowed = np.minimum((fast / np.abs(here.first)).min(axis=1), crane.machine.pump.max_flow / here.flow)
        bound[points] = np.minimum(bound[points], allowed**2)
    interval = np.repeat(np.arange(count - 1)[:, None], len(cylinders), axis=1)
    rows, columns, values, limits = [], [], [], []
    for number, (here, own) in enumerate(((begins, 0), (ends, 1))):
        slope = here.first / (2.0 * steps[:, None])  # u = (b_next - b) / (2 step)
        low, high = -slope, slope.copy()
        (low if own == 0 else high)[...] += here.second
        row = number * interval.size + np.arange(interval.size).reshape(interval.shape)
        for column, value in ((interval, low), (interval + 1, high)):
            rows.append(row.ravel())
            columns.append(column.ravel())
            values.append((value / hard).ravel())
        limits.append(np.ones(interval.size))
    shape = (2 * interval.size, count)
    matrix = coo_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape).tocsr()
    limit = np.concatenate(limits)
    scale = float(np.median(bound))
    answer = linprog(
        -np.ones(count), A_ub=_both(matrix), b_ub=np.concatenate([limit, limit]) / scale,
        bounds=np.column_stack([np.zeros(count), bound / scale]), method="highs",
    )  # fmt: skip
    return np.sqrt(np.maximum(scale * answer.x, 0.0)) if answer.status == 0 else None


def _both(matrix):
    """A matrix over its negative: bounds of an amount."""
    from scipy.sparse import vstack

    return vstack([matrix, -matrix])


def passing(tau: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Times at which points are passed [s], (points,), from the rates there; u is constant between them."""
    pace = np.maximum(rates[1:] + rates[:-1], 1e-300)
    return np.concatenate([[0.0], np.cumsum(2.0 * np.diff(tau) / pace)])


def inside(tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Beginnings and ends of the intervals between points [s], (points - 1,) each, taken from inside."""
    inset = INSIDE * np.diff(tau)
    return tau[:-1] + inset, tau[1:] - inset
