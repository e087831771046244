"""Feedback: the best control from a state at any time, by one-step look-ahead over the rest of a stage.

One compiled function, quick enough for a controller's cycle. At a stage it is the first step of `sweeps.rollout`.
"""

from __future__ import annotations

import numpy as np

from leanboom.compiling import njit
from leanboom.dynamic_programming import bellman
from leanboom.problem import layout


@njit(cache=True, error_model="numpy")
def between(table, k, x, share):
    """Rows of two stages at shares `x` of their positions, mixed linearly in time: (..., positions, ...) to (...).

    Args:
        table: Values on nodes, (stages + 1, positions, columns).
        k: The stage.
        x: Positions in node spacings of stage k and of the next, (2,).
        share: Share of the stage that is gone.
    """
    out = np.zeros(table.shape[2])
    for ahead in range(2 if share > 0.0 else 1):
        inside = bellman.within(x[ahead], table.shape[1] - 1.0)
        i = min(int(inside), table.shape[1] - 2)
        far = inside - i
        weight = 1.0 if share == 0.0 else (share if ahead else 1.0 - share)
        for q in range(out.size):
            out[q] += weight * ((1.0 - far) * table[k + ahead, i, q] + far * table[k + ahead, i + 1, q])
    return out


@njit(cache=True, error_model="numpy")
def control(coefficients, outside, stage, cylinder, setting, values, k, share, c, w):
    """The control of least cost from a state between two stages, until the next of them.

    Args:
        coefficients, outside, stage, cylinder, setting: The problem, as in `sweeps.sweep`.
        values: Values of all stages, (stages + 1, positions, velocities).
        k: The stage.
        share: Share of it that is gone, from 0 to below 1.
        c, w: Position [m] and velocity [m/s].

    Returns:
        The control [m/s^2].
    """
    moving, columns = coefficients.shape[2], coefficients.shape[3]
    x = np.empty(2)
    for ahead in range(2):
        x[ahead] = (c - stage[k + ahead, layout.C_LO]) / stage[k + ahead, layout.DC]
    flat = coefficients.reshape((coefficients.shape[0], coefficients.shape[1], moving * columns))
    node = between(flat, k, x, share).reshape((moving, columns))
    off = between(outside.reshape((outside.shape[0], outside.shape[1], 1)), k, x, share)[0]
    now = stage[k : k + 1].copy()
    for column in (layout.FIXED_FLOW, layout.FIXED_PRESSURE, layout.FIXED_COST, layout.MOST_FLOW):
        if share > 0.0:
            now[0, column] = (1.0 - share) * stage[k, column] + share * stage[k + 1, column]
    rest = setting.copy()
    rest[layout.STEP] = (1.0 - share) * setting[layout.STEP]
    row = bellman.empty_row(1, moving, values.shape[2])
    ahead_layer = bellman.layer(values[k + 1], stage, setting, k + 1)
    bellman.best_controls(node, off, c, np.full(1, w), 0, now, cylinder, rest, ahead_layer, row)
    return row.state[bellman.CONTROL, 0]
