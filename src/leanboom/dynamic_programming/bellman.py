"""Compiled kernels of the dynamic program: the best control of every state of a row.

Kernels know nothing of machines or tasks. All physics arrives as tables over (stage, position) nodes that are
polynomial in the redundant cylinder's velocity w and affine in its acceleration u; formulas are shared with the
rest of the package. A row is all velocities at one position: its states are worked on together, one short loop
per quantity, so that a processor's vector units are used. For that a loop must not branch, must count in unsigned
numbers where it does not begin at 0, and must not write where it reads at computed places. Arrays in, caller-owned
arrays out, ties go to the control tried first (strict <).

| symbol | name | unit |
| --- | --- | --- |
| c, w, u | position, velocity, acceleration of the redundant cylinder | m, m/s, m/s^2 |
| v_i = a0 + a1 w | velocity of moving cylinder i | m/s |
| a_i = b0 + b1 w + b2 w^2 + b3 u | its acceleration | m/s^2 |
| f_i = f0 + f1 w + f2 w^2 + f3 u | its inertia and gravity force | N |
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from leanboom.compiling import njit
from leanboom.formulas.dynamics import friction
from leanboom.formulas.formula import enable_in_kernels
from leanboom.formulas.hydraulics import cylinder_flow, pump_power
from leanboom.problem.layout import (
    A0,
    A1,
    A_MAX,
    AREA_IN,
    AREA_OUT,
    B0,
    B1,
    B2,
    B3,
    BACK_IN,
    BACK_OUT,
    C_LO,
    COULOMB,
    DC,
    DRAG,
    DW,
    EFFICIENCY,
    EPSILON,
    F0,
    F1,
    F2,
    F3,
    FIXED_COST,
    FIXED_FLOW,
    FIXED_PRESSURE,
    FLOW_IN,
    FLOW_OUT,
    GAIN_IN,
    GAIN_OUT,
    IDLE,
    LEAK,
    MOST_FLOW,
    SENSING,
    SHARPNESS,
    SLOPE_A,
    SLOPE_C,
    SLOPE_F,
    SLOPE_V,
    SLOPE_W,
    SQUARE,
    STEP,
    SUPPLY,
    V_MAX,
    VISCOUS,
    W_LO,
    WORK,
)

enable_in_kernels()

# Rows of `Row.state`: least cost to go [J], its control [m/s^2], cost whatever the control [J], cost per pressure
# [J/Pa] or power [s], cost per control [J s^2/m], 1 where the cost is not one line over the control, else 0, least and
# largest admissible control [m/s^2]; the rest is scratch: cost of a control, flow, shares within a cell along positions
# and velocities, cost of being outside the nodes.
VALUE, CONTROL, OFFSET, RATE, SLOPE, PIECEWISE, LOW, HIGH, COST_TO_GO, FLOW, FRAC_C, FRAC_W, OUT_OF_GRID = range(13)
STATE_ROWS = 13
# Rows of `Row.line`: load along the motion at u = 0 (positive: against the motion) [N], or its power [W], and its
# change with u; the pressure it asks for at u = 0 [Pa], and its change with u.
LOAD, GAIN, P0, P1 = range(4)
LINE_ROWS = 4

MIN_GAIN = 1e-9  # a cylinder whose acceleration depends less than this on the control is determined by the path
SWITCH_SHIFT = 1e-7  # switches are tried this far on the unloaded side [m/s^2]
ROUNDING = 1e-9  # nodes this far beyond the ends of a row's controls are still looked at


class Layer(NamedTuple):
    """Value function of one stage on its nodes, and the penalty slopes outside them."""

    value: np.ndarray  # [J], (positions, velocities)
    c_lo: float  # first position [m]
    dc: float  # spacing [m]
    w_lo: float  # first velocity [m/s]
    dw: float  # spacing [m/s]
    per_dc: float  # 1 / dc
    per_dw: float  # 1 / dw
    slope_c: float  # [J] per spacing
    slope_w: float  # [J] per spacing


class Row(NamedTuple):
    """Values, limits and scratch of the states of a row, in few arrays with named rows: kernels pass them often.

    The part of a stage's cost that depends on the control is a rate times a load-sensing supply pressure, the highest
    of p0_i + p1_i u over cylinders with load_i + gain_i u > 0, or times positive work, the sum of positive
    load_i + gain_i u. Where that is one line over the admissible controls it is part of `OFFSET` and `SLOPE`.
    """

    state: np.ndarray  # (STATE_ROWS, states + velocities ahead); FRAC_C and OUT_OF_GRID alone use all columns
    line: np.ndarray  # (moving cylinders, LINE_ROWS, states)
    cell: np.ndarray  # scratch: cell or row of cells reached, (states + velocities ahead,)


@njit(cache=True, error_model="numpy")
def empty_row(states, cylinders, ahead):
    """An uninitialised `Row` of `states`, of moving `cylinders`, in front of a layer with `ahead` velocities."""
    return Row(
        np.empty((STATE_ROWS, states + ahead)),
        np.empty((cylinders, LINE_ROWS, states)),
        np.empty(states + ahead, dtype=np.uint64),
    )


@njit(cache=True, error_model="numpy")
def layer(value, stage, setting, k):
    """The `Layer` of stage k."""
    dc, dw = stage[k, DC], stage[k, DW]
    slopes = setting[SLOPE_C] * dc, setting[SLOPE_W] * dw
    return Layer(value, stage[k, C_LO], dc, stage[k, W_LO], dw, 1.0 / dc, 1.0 / dw, slopes[0], slopes[1])


@njit(cache=True, error_model="numpy")
def within(x, top):
    """The number between 0 and `top` nearest to x; 0 where x is not a number, so that it may become an index."""
    x = x if x > 0.0 else 0.0
    return x if x < top else top


@njit(cache=True, error_model="numpy")
def locate(ahead, c, w):
    """The cell of (c, w), by its first node's number; the shares within it; what being outside all nodes costs."""
    x, y = (c - ahead.c_lo) * ahead.per_dc, (w - ahead.w_lo) * ahead.per_dw
    positions, velocities = ahead.value.shape
    inside_x, inside_y = within(x, positions - 1.0), within(y, velocities - 1.0)
    extra = ahead.slope_c * abs(x - inside_x) + ahead.slope_w * abs(y - inside_y)
    i, j = np.uint32(min(inside_x, positions - 2.0)), np.uint32(min(inside_y, velocities - 2.0))
    return i * np.uint64(velocities) + j, inside_x - i, inside_y - j, extra


@njit(cache=True, error_model="numpy")
def blend(nodes, velocities, cell, x, y):
    """Bilinear value within a cell; `nodes` are a layer's values in one row."""
    beside = cell + np.uint64(velocities)
    low = (1.0 - y) * nodes[cell] + y * nodes[cell + np.uint64(1)]
    high = (1.0 - y) * nodes[beside] + y * nodes[beside + np.uint64(1)]
    return (1.0 - x) * low + x * high


@njit(cache=True, error_model="numpy")
def interpolate(ahead, c, w):
    """Bilinear value at (c, w) of a layer; outside its nodes, the edge value plus a slope times the distance."""
    cell, x, y, extra = locate(ahead, c, w)
    return blend(ahead.value.reshape(-1), ahead.value.shape[1], cell, x, y) + extra


@njit(cache=True, error_model="numpy")
def limit_controls(node, outside, w, k, stage, cylinder, setting, row):
    """Acceleration bounds at each velocity node of a row, and the limit penalties that do not depend on it."""
    offset, low, high = row.state[OFFSET], row.state[LOW], row.state[HIGH]
    slope_v, slope_a = setting[SLOPE_V], setting[SLOPE_A]
    everywhere = setting[SLOPE_C] * outside + setting[STEP] * stage[k, FIXED_COST]
    for j in range(w.size):
        offset[j], low[j], high[j] = everywhere, -np.inf, np.inf
    for i in range(node.shape[0]):
        a0, a1 = node[i, A0], node[i, A1]
        b0, b1, b2, b3 = node[i, B0], node[i, B1], node[i, B2], node[i, B3]
        fastest, hardest = cylinder[i, V_MAX], cylinder[i, A_MAX]
        for j in range(w.size):
            offset[j] += slope_v * max(abs(a0 + a1 * w[j]) - fastest, 0.0)
        if abs(b3) > MIN_GAIN:  # |b0 + b1 w + b2 w^2 + b3 u| <= A_MAX
            inverse = 1.0 / b3
            half = hardest * abs(inverse)
            for j in range(w.size):
                middle = -(b0 + w[j] * (b1 + w[j] * b2)) * inverse
                low[j], high[j] = max(low[j], middle - half), min(high[j], middle + half)
        else:
            for j in range(w.size):
                offset[j] += slope_a * max(abs(b0 + w[j] * (b1 + w[j] * b2)) - hardest, 0.0)
    if setting[SLOPE_F] != 0.0:
        limit_flow(node, w, k, stage, cylinder, setting, row)
    for j in range(w.size):
        offset[j] += slope_a * max(low[j] - high[j], 0.0)
        middle = 0.5 * (low[j] + high[j])
        empty = low[j] > high[j]
        low[j], high[j] = middle if empty else low[j], middle if empty else high[j]


@njit(cache=True, error_model="numpy")
def limit_flow(node, w, k, stage, cylinder, setting, row):
    """Add what a pump flow beyond the pump's costs at each velocity node of a row."""
    offset, flow = row.state[OFFSET], row.state[FLOW]
    for j in range(w.size):
        flow[j] = -stage[k, MOST_FLOW]
    for i in range(node.shape[0]):
        a0, a1, out, back = node[i, A0], node[i, A1], cylinder[i, FLOW_OUT], cylinder[i, FLOW_IN]
        for j in range(w.size):
            flow[j] += cylinder_flow(a0 + a1 * w[j], out, back)
    for j in range(w.size):
        offset[j] += setting[SLOPE_F] * max(flow[j], 0.0)


@njit(cache=True, error_model="numpy")
def keep_to_nodes(w, ahead, step, row):
    """Stay within the next stage's velocity nodes where the admissible controls allow it."""
    low, high = row.state[LOW], row.state[HIGH]
    first, last = ahead.w_lo, ahead.w_lo + ahead.dw * (ahead.value.shape[1] - 1)
    for j in range(w.size):
        lowest, highest = (first - w[j]) / step, (last - w[j]) / step
        meets = lowest <= high[j] and highest >= low[j]
        lowest, highest = max(low[j], lowest), min(high[j], highest)
        low[j], high[j] = lowest if meets else low[j], highest if meets else high[j]


@njit(cache=True, error_model="numpy")
def charge(node, w, k, stage, cylinder, setting, row):
    """Stage cost of a row's states without the terms that depend on the acceleration, and the factor of those."""
    offset, rate, flow = row.state[OFFSET], row.state[RATE], row.state[FLOW]
    step, fixed = setting[STEP], stage[k, FIXED_FLOW]
    for j in range(w.size):
        flow[j], rate[j] = fixed, step
    for i in range(node.shape[0]):
        a0, a1 = node[i, A0], node[i, A1]
        area_out, area_in, square = cylinder[i, AREA_OUT], cylinder[i, AREA_IN], cylinder[i, SQUARE]
        for j in range(w.size):
            flow[j] += cylinder_flow(a0 + a1 * w[j], area_out, area_in)
        if square != 0.0:
            for j in range(w.size):
                v = a0 + a1 * w[j]
                offset[j] += step * square * v * v
    supply, efficiency = setting[SUPPLY], setting[EFFICIENCY]
    idle, leak, drag = setting[IDLE], setting[LEAK], setting[DRAG]
    for j in range(w.size):
        offset[j] += step * pump_power(supply, flow[j], efficiency, idle, leak, drag)
    if setting[SENSING] != 0.0:
        for j in range(w.size):  # pump power is affine in the pressure
            rate[j] = step * pump_power(1.0, flow[j], efficiency, 0.0, leak, 0.0)


@njit(cache=True, error_model="numpy")
def load_lines(node, w, cylinder, setting, lowest, row):
    """Loads of a row's cylinders and the pressures they ask for, as lines over the control."""
    epsilon = setting[EPSILON]
    for i in range(node.shape[0]):
        a0, a1, f0, f1, f2, f3 = node[i, A0], node[i, A1], node[i, F0], node[i, F1], node[i, F2], node[i, F3]
        load, gain, p0, p1 = row.line[i, LOAD], row.line[i, GAIN], row.line[i, P0], row.line[i, P1]
        coulomb, sharpness, viscous = node[i, COULOMB], cylinder[i, SHARPNESS], cylinder[i, VISCOUS]
        for j in range(w.size):
            load[j] = friction(a0 + a1 * w[j], coulomb, sharpness, viscous)
        if setting[WORK] != 0.0:
            for j in range(w.size):
                v = a0 + a1 * w[j]
                p0[j], p1[j] = 0.0, 0.0
                load[j], gain[j] = v * (load[j] + f0 + w[j] * (f1 + w[j] * f2)), v * f3
            continue
        gain_out, back_out = cylinder[i, GAIN_OUT], cylinder[i, BACK_OUT]
        gain_in, back_in = cylinder[i, GAIN_IN], cylinder[i, BACK_IN]
        for j in range(w.size):
            v = a0 + a1 * w[j]
            force = load[j] + f0 + w[j] * (f1 + w[j] * f2)
            out, metering = v > 0.0, abs(v) > epsilon
            along = 1.0 if out else -1.0
            working = gain_out * force + back_out if out else back_in - gain_in * force
            change = gain_out * f3 if out else -gain_in * f3
            load[j], gain[j] = along * force if metering else -1.0, along * f3 if metering else 0.0
            p0[j], p1[j] = working if metering else lowest, change if metering else 0.0


@njit(cache=True, error_model="numpy")
def running_cost(u, j, sensing, lowest, line):
    """Acceleration-dependent term of state j per `RATE`: highest demanded pressure (load-sensing) or positive work."""
    pressure, work = lowest, 0.0
    for i in range(line.shape[0]):
        along = line[i, LOAD, j] + line[i, GAIN, j] * u
        if along > 0.0:
            work += along
            pressure = max(pressure, line[i, P0, j] + line[i, P1, j] * u)
    return pressure if sensing else work


@njit(cache=True, error_model="numpy")
def settle_lines(states, sensing, lowest, row):
    """Where the stage cost is affine in the acceleration over its whole range, fold it into `OFFSET` and `SLOPE`.

    A cylinder is loaded between two accelerations if it is at both ends, and so is the one that demands most. States
    of which this does not hold are `PIECEWISE`: piecewise affine.
    """
    line, low, high, slope = row.line, row.state[LOW], row.state[HIGH], row.state[SLOPE]
    offset, rate, piecewise = row.state[OFFSET], row.state[RATE], row.state[PIECEWISE]
    for j in range(states):
        least, most = low[j], high[j]
        changes = False
        p, dp, asked = lowest, 0.0, lowest  # the line that is highest at the first end, and its value there
        q, dq, wanted = lowest, 0.0, lowest  # at the last end
        work, dwork = 0.0, 0.0
        for i in range(line.shape[0]):
            load, gain, p0, p1 = line[i, LOAD, j], line[i, GAIN, j], line[i, P0, j], line[i, P1, j]
            first, last = load + gain * least > 0.0, load + gain * most > 0.0
            changes = changes or first != last
            if first and p0 + p1 * least > asked:
                p, dp, asked = p0, p1, p0 + p1 * least
            if last and p0 + p1 * most > wanted:
                q, dq, wanted = p0, p1, p0 + p1 * most
            if first:
                work, dwork = work + load, dwork + gain
        if sensing:
            changes = changes or p != q or dp != dq
        piecewise[j] = 1.0 if changes else 0.0
        if not changes:
            offset[j] += rate[j] * (p if sensing else work)
            slope[j] = rate[j] * (dp if sensing else dwork)


@njit(cache=True, error_model="numpy")
def try_end(end, c, w, step, ahead, row):
    """Try one end of the admissible controls: row `end`, LOW or HIGH."""
    cost_to_go, value, control, slope = row.state[COST_TO_GO], row.state[VALUE], row.state[CONTROL], row.state[SLOPE]
    frac_c, frac_w, out_of_grid, cell = row.state[FRAC_C], row.state[FRAC_W], row.state[OUT_OF_GRID], row.cell
    half, nodes, velocities = 0.5 * step * step, ahead.value.reshape(-1), ahead.value.shape[1]
    u = row.state[end]
    for j in range(w.size):
        cell[j], frac_c[j], frac_w[j], out_of_grid[j] = locate(ahead, c + step * w[j] + half * u[j], w[j] + step * u[j])
    for j in range(w.size):
        cost_to_go[j] = blend(nodes, velocities, cell[j], frac_c[j], frac_w[j]) + out_of_grid[j]
    for j in range(w.size):
        cost = cost_to_go[j] + slope[j] * u[j]
        better = cost < value[j]
        value[j] = cost if better else value[j]
        control[j] = u[j] if better else control[j]


@njit(cache=True, error_model="numpy")
def try_nodes(c, w, step, ahead, row):
    """Try the controls that reach the next stage's velocity nodes: one interpolation each, in position only.

    From velocity j to node j + d the control is the same for all j, and the position reached depends on the
    sum of the two numbers alone.
    """
    cost_to_go, value, control, slope = row.state[COST_TO_GO], row.state[VALUE], row.state[CONTROL], row.state[SLOPE]
    low, high, frac_c = row.state[LOW], row.state[HIGH], row.state[FRAC_C]
    out_of_grid, cell = row.state[OUT_OF_GRID], row.cell
    nodes, (positions, velocities) = ahead.value, ahead.value.shape
    half = 0.5 * step * ahead.dw
    middle = c + 0.5 * step * (w[0] + ahead.w_lo)
    for total in range(w.size + velocities - 1):
        x = (middle + half * total - ahead.c_lo) * ahead.per_dc
        inside = within(x, positions - 1.0)
        i = np.uint32(min(inside, positions - 2.0))
        cell[total], frac_c[total], out_of_grid[total] = i, inside - i, ahead.slope_c * abs(x - inside)
    lowest_u, highest_u = np.inf, -np.inf
    for j in range(w.size):
        lowest_u, highest_u = min(lowest_u, low[j]), max(highest_u, high[j])
    nearest, farthest = reachable(lowest_u, highest_u, w[0], step, ahead)
    for d in range(max(nearest, 1 - w.size), min(farthest, velocities - 1) + 1):
        u = (ahead.w_lo - w[0] + d * ahead.dw) / step
        first, last = np.uint64(max(0, -d)), np.uint64(min(w.size, velocities - d))
        for j in range(first, last):
            node = np.uint64(np.int64(j) + d)
            total = j + node
            i, x = cell[total], frac_c[total]
            near, far = nodes[i, node], nodes[i + np.uint64(1), node]
            cost_to_go[j] = near + x * (far - near) + out_of_grid[total]
        for j in range(first, last):
            cost = cost_to_go[j] + slope[j] * u
            better = (cost < value[j]) & (low[j] <= u) & (u <= high[j])
            value[j] = cost if better else value[j]
            control[j] = u if better else control[j]


@njit(cache=True, error_model="numpy")
def reachable(low, high, w, step, ahead):
    """Numbers of the first and the last velocity node that controls from `low` to `high` lead to from velocity w."""
    per_control, start = step * ahead.per_dw, (w - ahead.w_lo) * ahead.per_dw
    return int(np.ceil(low * per_control + start - ROUNDING)), int(np.floor(high * per_control + start + ROUNDING))


@njit(cache=True, error_model="numpy")
def try_piecewise(c, w, step, ahead, sensing, lowest, row):
    """Try all corners of the states that are `PIECEWISE`.

    Besides the ends and the nodes these are the unloaded side of every switch of a load's sign and, with a load-sensing
    supply, the crossings of two pressures.
    """
    value, control, low, high = row.state[VALUE], row.state[CONTROL], row.state[LOW], row.state[HIGH]
    line, piecewise, rate = row.line, row.state[PIECEWISE], row.state[RATE]
    half, corners = 0.5 * step * step, row.line.shape[0] + 2  # corners of a cylinder
    nodes, velocities = ahead.value.reshape(-1), ahead.value.shape[1]
    for j in range(w.size):
        if piecewise[j] == 0.0:
            continue
        best, chosen = np.inf, low[j]
        nearest, farthest = reachable(low[j], high[j], w[j], step, ahead)
        nearest, farthest = max(nearest, 0), min(farthest, velocities - 1)
        switches = 2 + max(farthest + 1 - nearest, 0)
        for trial in range(switches + line.shape[0] * corners):
            if trial < 2:
                u = high[j] if trial else low[j]
            elif trial < switches:
                u = (ahead.w_lo - w[j] + (nearest + trial - 2) * ahead.dw) / step
            else:
                i, m = (trial - switches) // corners, (trial - switches) % corners
                load, gain, p0, p1 = line[i, LOAD, j], line[i, GAIN, j], line[i, P0, j], line[i, P1, j]
                if m < line.shape[0]:
                    u = (line[m, P0, j] - p0) / (p1 - line[m, P1, j])
                elif m == line.shape[0]:
                    u = (lowest - p0) / p1
                else:
                    u = -load / gain - (SWITCH_SHIFT if gain > 0.0 else -SWITCH_SHIFT)
            if low[j] <= u <= high[j]:
                cell, x, y, extra = locate(ahead, c + step * w[j] + half * u, w[j] + step * u)
                cost_to_go = blend(nodes, velocities, cell, x, y) + extra
                if cost_to_go < best:
                    cost_to_go += rate[j] * running_cost(u, j, sensing, lowest, line)
                    if cost_to_go < best:
                        best, chosen = cost_to_go, u
        value[j], control[j] = best, chosen


@njit(cache=True, error_model="numpy")
def best_controls(node, outside, c, w, k, stage, cylinder, setting, ahead, row):
    """Least stage cost plus value ahead over the control, and that control, of every state of a row.

    Only the corners of this (nearly) piecewise linear function of u are tried: the ends of the admissible
    interval, controls that reach a velocity node, switches of a cylinder's load sign, and crossings of two
    demanded pressures.

    Args:
        node: Coefficients at the row's position, (moving cylinders, COEFFICIENTS).
        outside: Its distance from the feasible extensions [m].
        c: The position [m].
        w: Velocities [m/s], (states,), DW apart.
        k: The stage.
        stage, cylinder, setting: The problem, as in `sweep`.
        ahead: The next stage's `Layer`.
        row: Out: `VALUE` [J] and `CONTROL` [m/s^2] of its states; the rest is scratch.
    """
    step, sensing, lowest = setting[STEP], setting[SENSING] != 0.0, stage[k, FIXED_PRESSURE]
    value, control, slope = row.state[VALUE], row.state[CONTROL], row.state[SLOPE]
    limit_controls(node, outside, w, k, stage, cylinder, setting, row)
    keep_to_nodes(w, ahead, step, row)
    charge(node, w, k, stage, cylinder, setting, row)
    for j in range(w.size):
        value[j], control[j], slope[j] = np.inf, row.state[LOW, j], 0.0
    priced = sensing or setting[WORK] != 0.0
    if priced:
        load_lines(node, w, cylinder, setting, lowest, row)
        settle_lines(w.size, sensing, lowest, row)
    try_end(LOW, c, w, step, ahead, row)
    try_end(HIGH, c, w, step, ahead, row)
    try_nodes(c, w, step, ahead, row)
    if priced:
        try_piecewise(c, w, step, ahead, sensing, lowest, row)
    for j in range(w.size):
        value[j] += row.state[OFFSET, j]
