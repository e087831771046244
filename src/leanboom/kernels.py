"""Compiled kernels of the dynamic program: the best control of every state of a row, backward stages, the rollout.

Kernels know nothing of machines or tasks. All physics arrives as tables over (stage, position) nodes that are
polynomial in the redundant cylinder's velocity w and affine in its acceleration u; formulas are shared with the
rest of the package. A row is all velocities at one position: its states are worked on together, one short loop
per quantity, so that a processor's vector units are used. For that a loop must not branch, must count in unsigned
numbers where it does not begin at 0, and must not write where it reads at computed places. Arrays in, caller-owned
arrays out, no allocation in the stage loop, ties go to the control tried first (strict <). Threads may share a stage
by its positions, which are independent, so results do not depend on their number; kernels release the
interpreter's lock.

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
from numba import njit

from leanboom.dynamics import friction
from leanboom.formula import enable_in_kernels
from leanboom.hydraulics import cylinder_flow, pump_losses, pump_power, recuperating_flow
from leanboom.objective import COSTS

enable_in_kernels()

# Columns of a node's coefficient table, (stages + 1, positions, moving cylinders, COEFFICIENTS).
A0, A1, B0, B1, B2, B3, F0, F1, F2, F3, COULOMB = range(11)
COEFFICIENTS = 11
# Columns of the stage table, (stages + 1, STAGE_COLUMNS). All stages share one spacing of velocities, DW.
C_LO, DC, W_LO, DW, FIXED_FLOW, FIXED_PRESSURE, FIXED_COST = range(7)
STAGE_COLUMNS = 7
# Columns of the cylinder table, (moving cylinders, CYLINDER_COLUMNS).
AREA_OUT, AREA_IN, GAIN_OUT, BACK_OUT, GAIN_IN, BACK_IN, SHARPNESS, VISCOUS, V_MAX, A_MAX, PISTON, ROD_SIDE = range(12)
CYLINDER_COLUMNS = 12
# Entries of the setting vector.
STEP, COST, EPSILON, SUPPLY_CP, MARGIN, EFFICIENCY, SLOPE_C, SLOPE_W, SLOPE_V, SLOPE_A, IDLE, LEAK, DRAG = range(13)
SETTINGS = 13
# Rows of `Row.state`: least cost to go [J], its control [m/s^2], cost whatever the control [J], cost per pressure
# [J/Pa] or power [s], least and largest admissible control [m/s^2]; the rest is scratch: control being tried, its cost,
# flow or pressure or power, shares within a cell along positions and velocities, cost of being outside the nodes.
VALUE, CONTROL, BASE, RATE, LOW, HIGH, TRIED, PRICE, SUPPLY, ALONG, ACROSS, BEYOND = range(12)
STATE_ROWS = 12
# Rows of `Row.line`: load along the motion at u = 0 (positive: driven against it) [N], or its power [W], and its change
# with u; the pressure it asks for at u = 0 [Pa], and its change with u.
LOAD, GAIN, P0, P1 = range(4)
LINE_ROWS = 4

LS, CP, ACTUATOR = COSTS["ls"], COSTS["cp"], COSTS["actuator"]
VELOCITY, EXTENSION, RECUPERATION = COSTS["velocity"], COSTS["extension"], COSTS["recuperation"]
MIN_GAIN = 1e-9  # a cylinder whose acceleration depends less than this on the control is prescribed
SWITCH_SHIFT = 1e-7  # switches are tried this far on the unloaded side [m/s^2]
ROUNDING = 1e-9  # nodes this far beyond the ends of a row's controls are still looked at


class Layer(NamedTuple):
    """The value of one stage on its nodes, and what a state outside them costs."""

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
    """What is known of the states of a row: few arrays with named rows, because kernels hand them around a lot.

    The part of a stage's cost that depends on the control is a rate times the supply pressure (ls), the highest of
    p0_i + p1_i u over cylinders with load_i + gain_i u > 0, or times the sum of positive load_i + gain_i u (actuator).
    """

    state: np.ndarray  # (STATE_ROWS, states + velocities ahead); ALONG and BEYOND alone use all columns
    line: np.ndarray  # (moving cylinders, LINE_ROWS, states)
    cell: np.ndarray  # scratch: cell or row of cells reached, (states + velocities ahead,)


@njit(cache=True, error_model="numpy")
def empty_row(states, cylinders, ahead):
    """Room for a row of `states`, of moving `cylinders`, in front of a layer with `ahead` velocities."""
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
    """Admissible controls of a row, and what its states cost beyond their limits whatever the control."""
    base, low, high = row.state[BASE], row.state[LOW], row.state[HIGH]
    slope_v, slope_a = setting[SLOPE_V], setting[SLOPE_A]
    everywhere = setting[SLOPE_C] * outside + setting[STEP] * stage[k, FIXED_COST]
    for j in range(w.size):
        base[j], low[j], high[j] = everywhere, -np.inf, np.inf
    for i in range(node.shape[0]):
        a0, a1 = node[i, A0], node[i, A1]
        b0, b1, b2, b3 = node[i, B0], node[i, B1], node[i, B2], node[i, B3]
        fastest, hardest = cylinder[i, V_MAX], cylinder[i, A_MAX]
        for j in range(w.size):
            base[j] += slope_v * max(abs(a0 + a1 * w[j]) - fastest, 0.0)
        if abs(b3) > MIN_GAIN:  # |b0 + b1 w + b2 w^2 + b3 u| <= A_MAX
            inverse = 1.0 / b3
            half = hardest * abs(inverse)
            for j in range(w.size):
                middle = -(b0 + w[j] * (b1 + w[j] * b2)) * inverse
                low[j], high[j] = max(low[j], middle - half), min(high[j], middle + half)
        else:
            for j in range(w.size):
                base[j] += slope_a * max(abs(b0 + w[j] * (b1 + w[j] * b2)) - hardest, 0.0)
    for j in range(w.size):
        base[j] += slope_a * max(low[j] - high[j], 0.0)
        middle = 0.5 * (low[j] + high[j])
        empty = low[j] > high[j]
        low[j], high[j] = middle if empty else low[j], middle if empty else high[j]


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
def charge(node, w, k, stage, cylinder, setting, code, row):
    """Cost of a row's states whatever the control, and the rate of what depends on it."""
    base, rate, flow = row.state[BASE], row.state[RATE], row.state[SUPPLY]
    step, prescribed = setting[STEP], stage[k, FIXED_FLOW]
    for j in range(w.size):
        flow[j], rate[j] = prescribed, step
    for i in range(node.shape[0]):
        a0, a1 = node[i, A0], node[i, A1]
        if code == RECUPERATION:
            piston, rod_side = cylinder[i, PISTON], cylinder[i, ROD_SIDE]
            for j in range(w.size):
                flow[j] += recuperating_flow(a0 + a1 * w[j], piston, rod_side)
        elif code == VELOCITY:
            for j in range(w.size):
                v = a0 + a1 * w[j]
                base[j] += step * v * v
        else:
            area_out, area_in = cylinder[i, AREA_OUT], cylinder[i, AREA_IN]
            for j in range(w.size):
                flow[j] += cylinder_flow(a0 + a1 * w[j], area_out, area_in)
    efficiency, margin, supply = setting[EFFICIENCY], setting[MARGIN], setting[SUPPLY_CP]
    idle, leak, drag = setting[IDLE], setting[LEAK], setting[DRAG]
    if code == LS:
        for j in range(w.size):  # affine in the pressure: losses at no pressure, and the rate at which it costs
            rate[j] = step * pump_power(1.0, flow[j], efficiency, 0.0, leak, 0.0)
            base[j] += step * pump_losses(0.0, flow[j], idle, leak, drag) + rate[j] * margin
    elif code == CP or code == RECUPERATION:
        for j in range(w.size):
            base[j] += step * pump_power(supply, flow[j], efficiency, idle, leak, drag)
    elif code == EXTENSION:
        for j in range(w.size):
            base[j] += step * w[j] * w[j]


@njit(cache=True, error_model="numpy")
def load_lines(node, w, cylinder, setting, code, lowest, row):
    """Loads of a row's cylinders and the pressures they ask for, as lines over the control."""
    epsilon = setting[EPSILON]
    for i in range(node.shape[0]):
        a0, a1, f0, f1, f2, f3 = node[i, A0], node[i, A1], node[i, F0], node[i, F1], node[i, F2], node[i, F3]
        load, gain, p0, p1 = row.line[i, LOAD], row.line[i, GAIN], row.line[i, P0], row.line[i, P1]
        coulomb, sharpness, viscous = node[i, COULOMB], cylinder[i, SHARPNESS], cylinder[i, VISCOUS]
        for j in range(w.size):
            load[j] = friction(a0 + a1 * w[j], coulomb, sharpness, viscous)
        if code == ACTUATOR:
            for j in range(w.size):
                v = a0 + a1 * w[j]
                load[j], gain[j] = v * (load[j] + f0 + w[j] * (f1 + w[j] * f2)), v * f3
            continue
        gain_out, back_out = cylinder[i, GAIN_OUT], cylinder[i, BACK_OUT]
        gain_in, back_in = cylinder[i, GAIN_IN], cylinder[i, BACK_IN]
        for j in range(w.size):
            v = a0 + a1 * w[j]
            force = load[j] + f0 + w[j] * (f1 + w[j] * f2)
            out, driven = v > 0.0, abs(v) > epsilon
            along = 1.0 if out else -1.0
            at_rest = gain_out * force + back_out if out else back_in - gain_in * force
            change = gain_out * f3 if out else -gain_in * f3
            load[j], gain[j] = along * force if driven else -1.0, along * f3 if driven else 0.0
            p0[j], p1[j] = at_rest if driven else lowest, change if driven else 0.0


@njit(cache=True, error_model="numpy")
def running_cost(u, j, code, lowest, row):
    """The part of state j's cost that depends on its control: supply pressure (ls) or positive work (actuator)."""
    line, rate = row.line, row.state[RATE, j]
    if code == LS:
        pressure = lowest
        for i in range(line.shape[0]):
            if line[i, LOAD, j] + line[i, GAIN, j] * u > 0.0:
                pressure = max(pressure, line[i, P0, j] + line[i, P1, j] * u)
        return rate * pressure
    work = 0.0
    for i in range(line.shape[0]):
        work += max(line[i, LOAD, j] + line[i, GAIN, j] * u, 0.0)
    return rate * work


@njit(cache=True, error_model="numpy")
def add_running_cost(first, last, code, lowest, row):
    """Add the `running_cost` of the controls tried to the price of states `first` to `last` - 1."""
    tried, price, supply, rate = row.state[TRIED], row.state[PRICE], row.state[SUPPLY], row.state[RATE]
    least = lowest if code == LS else 0.0
    first, last = np.uint64(first), np.uint64(last)
    for j in range(first, last):
        supply[j] = least
    for i in range(row.line.shape[0]):
        load, gain, p0, p1 = row.line[i, LOAD], row.line[i, GAIN], row.line[i, P0], row.line[i, P1]
        if code == LS:
            for j in range(first, last):
                asked = p0[j] + p1[j] * tried[j]
                asked = asked if load[j] + gain[j] * tried[j] > 0.0 else 0.0
                supply[j] = max(supply[j], asked)
        else:
            for j in range(first, last):
                supply[j] += max(load[j] + gain[j] * tried[j], 0.0)
    for j in range(first, last):
        price[j] += rate[j] * supply[j]


@njit(cache=True, error_model="numpy")
def try_end(end, c, w, step, ahead, code, lowest, row):
    """Try one end of the admissible controls: row `end`, LOW or HIGH."""
    tried, price, value, control = row.state[TRIED], row.state[PRICE], row.state[VALUE], row.state[CONTROL]
    along, across, beyond, cell = row.state[ALONG], row.state[ACROSS], row.state[BEYOND], row.cell
    half, nodes, velocities = 0.5 * step * step, ahead.value.reshape(-1), ahead.value.shape[1]
    for j in range(w.size):
        tried[j] = row.state[end, j]
    for j in range(w.size):
        cell[j], along[j], across[j], beyond[j] = locate(
            ahead, c + step * w[j] + half * tried[j], w[j] + step * tried[j]
        )
    for j in range(w.size):
        price[j] = blend(nodes, velocities, cell[j], along[j], across[j]) + beyond[j]
    if code == LS or code == ACTUATOR:
        add_running_cost(0, w.size, code, lowest, row)
    for j in range(w.size):
        better = price[j] < value[j]
        value[j] = price[j] if better else value[j]
        control[j] = tried[j] if better else control[j]


@njit(cache=True, error_model="numpy")
def try_nodes(c, w, step, ahead, code, lowest, row):
    """Try the controls that reach the next stage's velocity nodes: one interpolation each, in position only.

    From velocity j to node j + d the control is the same for all j, and the position reached depends on the
    sum of the two numbers alone.
    """
    tried, price, value, control = row.state[TRIED], row.state[PRICE], row.state[VALUE], row.state[CONTROL]
    low, high, along, beyond, cell = row.state[LOW], row.state[HIGH], row.state[ALONG], row.state[BEYOND], row.cell
    positions, velocities = ahead.value.shape
    half = 0.5 * step * ahead.dw
    middle = c + 0.5 * step * (w[0] + ahead.w_lo)
    for total in range(w.size + velocities - 1):
        x = (middle + half * total - ahead.c_lo) * ahead.per_dc
        inside = within(x, positions - 1.0)
        i = np.uint32(min(inside, positions - 2.0))
        cell[total], along[total], beyond[total] = i, inside - i, ahead.slope_c * abs(x - inside)
    lowest_u, highest_u = np.inf, -np.inf
    for j in range(w.size):
        lowest_u, highest_u = min(lowest_u, low[j]), max(highest_u, high[j])
    shift = (w[0] - ahead.w_lo) * ahead.per_dw
    nearest = max(int(np.ceil(lowest_u * step * ahead.per_dw + shift - ROUNDING)), 1 - w.size)
    farthest = min(int(np.floor(highest_u * step * ahead.per_dw + shift + ROUNDING)), velocities - 1)
    for d in range(nearest, farthest + 1):
        u = (ahead.w_lo - w[0] + d * ahead.dw) / step
        first, last = np.uint64(max(0, -d)), np.uint64(min(w.size, velocities - d))
        for j in range(first, last):
            node = np.uint64(np.int64(j) + d)
            total = j + node
            i, x = cell[total], along[total]
            near, far = ahead.value[i, node], ahead.value[i + np.uint64(1), node]
            price[j] = near + x * (far - near) + beyond[total]
        if code == LS or code == ACTUATOR:
            for j in range(first, last):
                tried[j] = u
            add_running_cost(first, last, code, lowest, row)
        for j in range(first, last):
            better = (price[j] < value[j]) & (low[j] <= u) & (u <= high[j])
            value[j] = price[j] if better else value[j]
            control[j] = u if better else control[j]


@njit(cache=True, error_model="numpy")
def try_inside(c, w, step, ahead, code, lowest, row):
    """Try the control `TRIED` of every state where it is admissible and better in value alone."""
    tried, value, control, low, high = (
        row.state[TRIED], row.state[VALUE], row.state[CONTROL], row.state[LOW], row.state[HIGH],
    )  # fmt: skip
    half = 0.5 * step * step
    first, last = w.size, -1
    for j in range(w.size):
        inside = (low[j] < tried[j]) & (tried[j] < high[j])
        first, last = min(first, j if inside else w.size), max(last, j if inside else -1)
    for j in range(first, last + 1):
        u = tried[j]
        if low[j] < u < high[j]:
            price = interpolate(ahead, c + step * w[j] + half * u, w[j] + step * u)
            if price < value[j]:
                price += running_cost(u, j, code, lowest, row)
                if price < value[j]:
                    value[j], control[j] = price, u


@njit(cache=True, error_model="numpy")
def try_switches(c, w, step, ahead, code, lowest, row):
    """Try the unloaded side of every switch of a load's sign and, for ls, every crossing of two pressures."""
    tried, line = row.state[TRIED], row.line
    for i in range(line.shape[0]):
        for j in range(w.size):
            shift = SWITCH_SHIFT if line[i, GAIN, j] > 0.0 else -SWITCH_SHIFT
            tried[j] = -line[i, LOAD, j] / line[i, GAIN, j] - shift
        try_inside(c, w, step, ahead, code, lowest, row)
        if code == ACTUATOR:
            continue
        for j in range(w.size):
            tried[j] = (lowest - line[i, P0, j]) / line[i, P1, j]
        try_inside(c, w, step, ahead, code, lowest, row)
        for m in range(i + 1, line.shape[0]):
            for j in range(w.size):
                tried[j] = (line[m, P0, j] - line[i, P0, j]) / (line[i, P1, j] - line[m, P1, j])
            try_inside(c, w, step, ahead, code, lowest, row)


@njit(cache=True, error_model="numpy")
def best_controls(node, outside, c, w, k, stage, cylinder, setting, ahead, row):
    """Least stage cost plus value ahead over the control, and that control, of every state of a row.

    Only the corners of this (nearly) piecewise linear function of u are tried: the ends of the admissible
    interval, controls that reach a velocity node, switches of a cylinder's load sign, and crossings of two
    counted pressures.

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
    step, code, lowest = setting[STEP], int(setting[COST]), stage[k, FIXED_PRESSURE]
    limit_controls(node, outside, w, k, stage, cylinder, setting, row)
    keep_to_nodes(w, ahead, step, row)
    charge(node, w, k, stage, cylinder, setting, code, row)
    if code == LS or code == ACTUATOR:
        load_lines(node, w, cylinder, setting, code, lowest, row)
    value, base = row.state[VALUE], row.state[BASE]
    for j in range(w.size):
        value[j], row.state[CONTROL, j] = np.inf, row.state[LOW, j]
    try_end(LOW, c, w, step, ahead, code, lowest, row)
    try_end(HIGH, c, w, step, ahead, code, lowest, row)
    try_nodes(c, w, step, ahead, code, lowest, row)
    if code == LS or code == ACTUATOR:
        try_switches(c, w, step, ahead, code, lowest, row)
    for j in range(w.size):
        value[j] += base[j]


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
