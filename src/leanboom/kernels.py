"""Compiled kernels of the dynamic program: one backward stage, and the forward rollout.

Kernels know nothing of machines or tasks. All physics arrives as tables over (stage, position) nodes that are
polynomial in the redundant cylinder's velocity w and affine in its acceleration u; formulas are shared with the
rest of the package. Arrays in, caller-owned arrays out, no allocation in the stage loop, ties go to the
candidate tried first (strict <). Threads may share a stage by its positions, which are independent, so results do not
depend on their number; kernels release the interpreter's lock.

| symbol | name | unit |
| --- | --- | --- |
| c, w, u | position, velocity, acceleration of the redundant cylinder | m, m/s, m/s^2 |
| v_i = a0 + a1 w | velocity of moving cylinder i | m/s |
| a_i = b0 + b1 w + b2 w^2 + b3 u | its acceleration | m/s^2 |
| f_i = f0 + f1 w + f2 w^2 + f3 u | its inertia and gravity force | N |
"""

from __future__ import annotations

import numpy as np
from numba import njit

from leanboom.dynamics import friction
from leanboom.formula import enable_in_kernels
from leanboom.hydraulics import cylinder_flow, positive_work, pump_losses, pump_power, recuperating_flow
from leanboom.objective import COSTS

enable_in_kernels()

# Columns of a node's coefficient table, (stages + 1, positions, moving cylinders, COEFFICIENTS).
A0, A1, B0, B1, B2, B3, F0, F1, F2, F3, COULOMB = range(11)
COEFFICIENTS = 11
# Columns of the stage table, (stages + 1, STAGE_COLUMNS).
C_LO, DC, W_LO, DW, FIXED_FLOW, FIXED_PRESSURE, FIXED_COST = range(7)
STAGE_COLUMNS = 7
# Columns of the cylinder table, (moving cylinders, CYLINDER_COLUMNS).
AREA_OUT, AREA_IN, GAIN_OUT, BACK_OUT, GAIN_IN, BACK_IN, SHARPNESS, VISCOUS, V_MAX, A_MAX, PISTON, ROD_SIDE = range(12)
CYLINDER_COLUMNS = 12
# Entries of the setting vector.
STEP, COST, EPSILON, SUPPLY_CP, MARGIN, EFFICIENCY, SLOPE_C, SLOPE_W, SLOPE_V, SLOPE_A, IDLE, LEAK, DRAG = range(13)
SETTINGS = 13
# Rows of the scratch array `lines`, (SCRATCH, moving cylinders).
S_LOAD, S_GAIN, S_P0, S_P1 = range(4)
SCRATCH = 4

LS, CP, ACTUATOR = COSTS["ls"], COSTS["cp"], COSTS["actuator"]
VELOCITY, EXTENSION, RECUPERATION = COSTS["velocity"], COSTS["extension"], COSTS["recuperation"]
MIN_GAIN = 1e-9  # a cylinder whose acceleration depends less than this on the control is prescribed
SWITCH_SHIFT = 1e-7  # candidates sit this far on the unloaded side of a load switch [m/s^2]


@njit(cache=True, error_model="numpy")
def interpolate(ahead, stage, setting, k, c, w):
    """Bilinear value at (c, w) of stage k; outside the grid, the edge value plus a slope times the distance."""
    dc, dw = stage[k, DC], stage[k, DW]
    x = (c - stage[k, C_LO]) / dc
    y = (w - stage[k, W_LO]) / dw
    extra = 0.0
    top = ahead.shape[0] - 1.0
    if x < 0.0:
        extra -= setting[SLOPE_C] * x * dc
        x = 0.0
    elif x > top:
        extra += setting[SLOPE_C] * (x - top) * dc
        x = top
    top = ahead.shape[1] - 1.0
    if y < 0.0:
        extra -= setting[SLOPE_W] * y * dw
        y = 0.0
    elif y > top:
        extra += setting[SLOPE_W] * (y - top) * dw
        y = top
    i = min(int(x), ahead.shape[0] - 2)
    j = min(int(y), ahead.shape[1] - 2)
    x -= i
    y -= j
    low = (1.0 - y) * ahead[i, j] + y * ahead[i, j + 1]
    high = (1.0 - y) * ahead[i + 1, j] + y * ahead[i + 1, j + 1]
    return (1.0 - x) * low + x * high + extra


@njit(cache=True, error_model="numpy")
def running_cost(u, code, count, rate, lowest, lines):
    """The part of a stage's cost that depends on the control: supply pressure (ls) or positive work (actuator)."""
    if code == LS:
        pressure = lowest
        for i in range(count):
            if lines[S_LOAD, i] + lines[S_GAIN, i] * u > 0.0:
                pressure = max(pressure, lines[S_P0, i] + lines[S_P1, i] * u)
        return rate * pressure
    work = 0.0
    for i in range(count):
        work += positive_work(1.0, lines[S_LOAD, i] + lines[S_GAIN, i] * u)
    return rate * work


@njit(cache=True, error_model="numpy")
def best_control(row, outside, c, w, k, stage, cylinder, setting, ahead, lines):  # noqa: PLR0912, PLR0913, PLR0915
    """Least stage cost plus value ahead over the control, and that control.

    Only the corners of this (nearly) piecewise linear function of u are tried: the ends of the admissible
    interval, controls that reach a velocity node, switches of a cylinder's load sign, and crossings of two
    counted pressures. Long and with ten arguments because it is the whole inner loop: the node, where it is,
    and the tables of the problem; `lines` is scratch, (SCRATCH, moving cylinders).

    Returns:
        The value [J] and the control [m/s^2].
    """
    step, code = setting[STEP], int(setting[COST])
    n = row.shape[0]
    base = setting[SLOPE_C] * outside + step * stage[k, FIXED_COST]
    flow = stage[k, FIXED_FLOW]
    lo, hi = -np.inf, np.inf
    count = 0
    square = 0.0
    for i in range(n):
        v = row[i, A0] + row[i, A1] * w
        limit = cylinder[i, V_MAX]
        if abs(v) > limit:
            base += setting[SLOPE_V] * (abs(v) - limit)
        # Admissible controls: |b0 + b1 w + b2 w^2 + b3 u| <= A_MAX.
        b = row[i, B0] + w * (row[i, B1] + w * row[i, B2])
        b3 = row[i, B3]
        limit = cylinder[i, A_MAX]
        if abs(b3) > MIN_GAIN:
            inverse = 1.0 / b3
            middle, half = -b * inverse, limit * abs(inverse)
            lo = max(lo, middle - half)
            hi = min(hi, middle + half)
        elif abs(b) > limit:
            base += setting[SLOPE_A] * (abs(b) - limit)
        if code == RECUPERATION:
            flow += recuperating_flow(v, cylinder[i, PISTON], cylinder[i, ROD_SIDE])
        else:
            flow += cylinder_flow(v, cylinder[i, AREA_OUT], cylinder[i, AREA_IN])
        square += v * v
        if (code == LS and abs(v) > setting[EPSILON]) or code == ACTUATOR:
            load = row[i, F0] + w * (row[i, F1] + w * row[i, F2])
            load += friction(v, row[i, COULOMB], cylinder[i, SHARPNESS], cylinder[i, VISCOUS])
            # Load along the motion (positive: driven against it) and, for LS, the pressure it then asks for.
            if code == ACTUATOR:
                sign = v
            elif v > 0.0:
                sign = 1.0
                lines[S_P0, count] = cylinder[i, GAIN_OUT] * load + cylinder[i, BACK_OUT]
                lines[S_P1, count] = cylinder[i, GAIN_OUT] * row[i, F3]
            else:
                sign = -1.0
                lines[S_P0, count] = cylinder[i, BACK_IN] - cylinder[i, GAIN_IN] * load
                lines[S_P1, count] = -cylinder[i, GAIN_IN] * row[i, F3]
            lines[S_LOAD, count] = sign * load
            lines[S_GAIN, count] = sign * row[i, F3]
            count += 1
    rate = step
    if code == LS:
        # Affine in the pressure: losses at no pressure, and the rate at which it costs.
        base += step * pump_losses(0.0, flow, setting[IDLE], setting[LEAK], setting[DRAG])
        rate = step * pump_power(1.0, flow, setting[EFFICIENCY], 0.0, setting[LEAK], 0.0)
        base += rate * setting[MARGIN]
    elif code == CP or code == RECUPERATION:
        base += step * pump_power(
            setting[SUPPLY_CP], flow, setting[EFFICIENCY], setting[IDLE], setting[LEAK], setting[DRAG]
        )
    elif code == VELOCITY:
        base += step * square
    elif code == EXTENSION:
        base += step * w * w
    loads = code == LS or code == ACTUATOR
    lowest = stage[k, FIXED_PRESSURE]
    if lo > hi:
        base += setting[SLOPE_A] * (lo - hi)
        lo = hi = 0.5 * (lo + hi)
    # Stay within next stage's velocity nodes where the admissible controls allow it.
    velocities = ahead.shape[1]
    w_lo, dw = stage[k + 1, W_LO], stage[k + 1, DW]
    u_lo = (w_lo - w) / step
    u_hi = (w_lo + dw * (velocities - 1) - w) / step
    if u_lo <= hi and u_hi >= lo:
        lo, hi = max(lo, u_lo), min(hi, u_hi)

    half = 0.5 * step * step
    drift = c + step * w
    best, best_u = np.inf, lo
    for end in range(2):
        u = lo if end == 0 else hi
        cost = interpolate(ahead, stage, setting, k + 1, drift + half * u, w + step * u)
        if loads:
            cost += running_cost(u, code, count, rate, lowest, lines)
        if cost < best:
            best, best_u = cost, u
    if hi > lo:
        # Controls that reach velocity node j: one interpolation, in position only.
        c_lo, dc = stage[k + 1, C_LO], stage[k + 1, DC]
        top = ahead.shape[0] - 1.0
        inverse_dw, inverse_dc, inverse_step = 1.0 / dw, 1.0 / dc, 1.0 / step
        first = max(int(np.ceil((w + step * lo - w_lo) * inverse_dw)), 0)
        last = min(int(np.floor((w + step * hi - w_lo) * inverse_dw)), velocities - 1)
        for j in range(first, last + 1):
            reached = w_lo + j * dw
            u = (reached - w) * inverse_step
            x = (c + 0.5 * step * (w + reached) - c_lo) * inverse_dc
            cost = 0.0
            if x < 0.0:
                cost = -setting[SLOPE_C] * x * dc
                x = 0.0
            elif x > top:
                cost = setting[SLOPE_C] * (x - top) * dc
                x = top
            i = min(int(x), ahead.shape[0] - 2)
            x -= i
            cost += (1.0 - x) * ahead[i, j] + x * ahead[i + 1, j]
            if loads and cost < best:
                cost += running_cost(u, code, count, rate, lowest, lines)
            if cost < best:
                best, best_u = cost, u
        if loads:
            for i in range(count):
                # A load changes sign: try its unloaded side.
                gain = lines[S_GAIN, i]
                if gain != 0.0:
                    u = -lines[S_LOAD, i] / gain - SWITCH_SHIFT * np.sign(gain)
                    if lo < u < hi:
                        cost = interpolate(ahead, stage, setting, k + 1, drift + half * u, w + step * u)
                        cost += running_cost(u, code, count, rate, lowest, lines)
                        if cost < best:
                            best, best_u = cost, u
                if code != LS:
                    continue
                # The most loaded cylinder changes: pressures i and j cross (j == i: the prescribed pressure).
                for j in range(i, count):
                    rise = lines[S_P0, i] - (lowest if i == j else lines[S_P0, j])
                    slope = lines[S_P1, i] - (0.0 if i == j else lines[S_P1, j])
                    if slope != 0.0:
                        u = -rise / slope
                        if lo < u < hi:
                            cost = interpolate(ahead, stage, setting, k + 1, drift + half * u, w + step * u)
                            cost += running_cost(u, code, count, rate, lowest, lines)
                            if cost < best:
                                best, best_u = cost, u
    return base + best, best_u


@njit(cache=True, error_model="numpy", nogil=True)
def sweep_stage(k, first, last, coefficients, outside, stage, cylinder, setting, ahead, here, values):
    """One stage of the backward pass, for positions `first` to `last` - 1.

    Args:
        k: The stage.
        first, last: Range of positions; ranges are independent, so threads may share a stage.
        coefficients: Node tables, (stages + 1, positions, moving cylinders, COEFFICIENTS).
        outside: Distance of each node from the feasible extensions [m], (stages + 1, positions).
        stage: Grid and prescribed cylinders of each stage, (stages + 1, STAGE_COLUMNS).
        cylinder: Moving cylinders, (moving cylinders, CYLINDER_COLUMNS).
        setting: Scalars, (SETTINGS,).
        ahead: Value of the next stage [J], (positions, velocities).
        here: Out: value of this stage [J], (positions, velocities).
        values: Out: value of every stage, (stages + 1, positions, velocities), any float type.
    """
    lines = np.zeros((SCRATCH, coefficients.shape[2]))
    for p in range(first, last):
        row = coefficients[k, p]
        c = stage[k, C_LO] + p * stage[k, DC]
        for j in range(here.shape[1]):
            w = stage[k, W_LO] + j * stage[k, DW]
            value, _ = best_control(row, outside[k, p], c, w, k, stage, cylinder, setting, ahead, lines)
            here[p, j] = value
            values[k, p, j] = value


@njit(cache=True, error_model="numpy", nogil=True)
def sweep(coefficients, outside, stage, cylinder, setting, terminal, values):
    """Backward pass over all stages by one thread; arguments as in `sweep_stage`.

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
    """Forward pass by one-step look-ahead from an actual state at stage `first`.

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
    scratch = np.zeros((SCRATCH, n))
    row = np.empty((n, COEFFICIENTS))
    position[first], velocity[first] = start[0], start[1]
    step = setting[STEP]
    total = 0.0
    for k in range(first, stages):
        c, w = position[k], velocity[k]
        x = min(max((c - stage[k, C_LO]) / stage[k, DC], 0.0), coefficients.shape[1] - 1.0)
        i = min(int(x), coefficients.shape[1] - 2)
        x -= i
        for m in range(n):
            for q in range(COEFFICIENTS):
                row[m, q] = (1.0 - x) * coefficients[k, i, m, q] + x * coefficients[k, i + 1, m, q]
        off = (1.0 - x) * outside[k, i] + x * outside[k, i + 1]
        value, u = best_control(row, off, c, w, k, stage, cylinder, setting, values[k + 1], scratch)
        control[k] = u
        position[k + 1] = c + step * (w + 0.5 * step * u)
        velocity[k + 1] = w + step * u
        total += value - interpolate(values[k + 1], stage, setting, k + 1, position[k + 1], velocity[k + 1])
    return total
