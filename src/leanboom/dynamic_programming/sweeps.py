"""Compiled passes over the stages: values backward, a motion forward.

Arrays in, caller-owned arrays out, no allocation in the stage loop. Threads may share a stage by its positions,
which are independent, so results do not depend on their number; the interpreter's lock is released.
"""

from __future__ import annotations

import numpy as np

from leanboom.compiling import njit
from leanboom.dynamic_programming.bellman import CONTROL, VALUE, best_controls, empty_row, interpolate, layer, within
from leanboom.problem.layout import C_LO, COEFFICIENTS, DC, DW, STEP, W_LO


@njit(cache=True, error_model="numpy", nogil=True)
def sweep_stage(k, first, last, coefficients, outside, stage, cylinder, setting, ahead, here, values):
    """Values of one stage by the backward pass, for positions `first` to `last` - 1.

    Args:
        k: The stage.
        first, last: Range of positions; ranges are independent, so threads may share a stage.
        coefficients: Node tables, (stages + 1, positions, moving cylinders, COEFFICIENTS).
        outside: Distance of each node from the feasible extensions [m], (stages + 1, positions).
        stage: Grid and path-determined cylinders of each stage, (stages + 1, STAGE_COLUMNS).
        cylinder: Moving cylinders, (moving cylinders, CYLINDER_COLUMNS).
        setting: Scalars, (SETTINGS,).
        ahead: Value of the next stage [J], (positions, velocities).
        here: Out: value of this stage [J], (positions, velocities).
        values: Out: value of every stage, (stages + 1, positions, velocities), any float type.
    """
    velocities = here.shape[1]
    row = empty_row(velocities, coefficients.shape[2], velocities)
    w = stage[k, W_LO] + stage[k, DW] * np.arange(velocities)
    beyond = layer(ahead, stage, setting, k + 1)
    for p in range(first, last):
        c = stage[k, C_LO] + p * stage[k, DC]
        best_controls(coefficients[k, p], outside[k, p], c, w, k, stage, cylinder, setting, beyond, row)
        for j in range(velocities):
            here[p, j] = row.state[VALUE, j]
            values[k, p, j] = row.state[VALUE, j]


@njit(cache=True, error_model="numpy", nogil=True)
def sweep(coefficients, outside, stage, cylinder, setting, terminal, values):
    """Values of all stages by one thread; arguments as in `sweep_stage`.

    Args:
        coefficients, outside, stage, cylinder, setting: The problem.
        terminal: Value at the last stage [J], (positions, velocities).
        values: Out: value of every stage, (stages + 1, positions, velocities), any float type.
    """
    stages, positions = stage.shape[0] - 1, terminal.shape[0]
    ahead, here = terminal.copy(), np.empty_like(terminal)
    values[stages] = terminal
    for back in range(stages):
        k = stages - 1 - back
        sweep_stage(k, 0, positions, coefficients, outside, stage, cylinder, setting, ahead, here, values)
        ahead, here = here, ahead


@njit(cache=True, error_model="numpy")
def rollout(coefficients, outside, stage, cylinder, setting, values, start, first, position, velocity, control):
    """Motion by one-step look-ahead from an actual state at stage `first`.

    At the actual position the node tables are interpolated linearly; the control minimises exact stage cost
    plus interpolated value, so stored controls are never interpolated across a switch.

    Args:
        coefficients, outside, stage, cylinder, setting: As in `sweep`.
        values: Values of all stages, (stages + 1, positions, velocities).
        start: Position [m] and velocity [m/s] at stage `first`, (2,).
        first: Stage the rollout begins at.
        position, velocity: Out: states [m], [m/s], (stages + 1,); entries before `first` are left alone.
        control: Out: accelerations [m/s^2], (stages,).

    Returns:
        Sum of the stage costs with penalties [J].
    """
    stages = stage.shape[0] - 1
    n = coefficients.shape[2]
    row = empty_row(1, n, values.shape[2])
    node, here = np.empty((n, COEFFICIENTS)), np.empty(1)
    position[first], velocity[first] = start[0], start[1]
    step = setting[STEP]
    total = 0.0
    for k in range(first, stages):
        c, w = position[k], velocity[k]
        x = within((c - stage[k, C_LO]) / stage[k, DC], coefficients.shape[1] - 1.0)
        i = min(int(x), coefficients.shape[1] - 2)
        x -= i
        for m in range(n):
            for q in range(COEFFICIENTS):
                node[m, q] = (1.0 - x) * coefficients[k, i, m, q] + x * coefficients[k, i + 1, m, q]
        off = (1.0 - x) * outside[k, i] + x * outside[k, i + 1]
        here[0] = w
        ahead = layer(values[k + 1], stage, setting, k + 1)
        best_controls(node, off, c, here, k, stage, cylinder, setting, ahead, row)
        u = row.state[CONTROL, 0]
        control[k] = u
        position[k + 1] = c + step * (w + 0.5 * step * u)
        velocity[k + 1] = w + step * u
        total += row.state[VALUE, 0] - interpolate(ahead, position[k + 1], velocity[k + 1])
    return total
