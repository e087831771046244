"""Compiled kernels of the certificate: rigorous lower bounds of the cost to go over cells of the state space.

A stage's (position, velocity) domain is cut into cells. Over each cell the cost to go of every admissible motion is
bounded from below by a plane, L(c, w) = level + slope_c (c - c_m) + slope_w (w - w_m) with (c_m, w_m) the cell's
middle. `docs/certificate.md` derives what is computed here and proves it.

A transition leads from a cell to a velocity row and a position column of the next stage. Within its box

    t in [-1, 1]: position within the cell,   x: velocity from the cell's middle,   y: next velocity on the lattice,

everything is affine in (t, x, y) up to a bounded error, so the least value is attained at corners. What is not
affine enters by multipliers, for which every value gives a valid bound and `ascend` finds the best: sigma (pump flow
of a cylinder that may move either way), lambda (which counted pressure is the highest), mu (acceleration limits).

Kernels know no machine and no task; arrays in, caller-owned arrays out, no interpreter lock. Rows of positions are
independent, so threads may share a stage.
"""

from __future__ import annotations

import numpy as np

from leanboom.certificate.cell_enclosures import (
    L_DW,
    L_J,
    L_W,
    MOTION,
    ON_LIMIT,
    P_BACK,
    P_E,
    P_GAIN,
    P_M,
    P_T,
    P_U,
    P_UE,
    P_UT,
    P_X,
    SNAP,
    V_E,
    V_M,
    V_SIDE,
    V_T,
    V_X,
    cell_motion,
    expand,
)
from leanboom.compiling import njit
from leanboom.formulas.formula import enable_in_kernels
from leanboom.problem.layout import AREA_IN, AREA_OUT, COEFFICIENTS, EFFICIENCY, SENSING, STEP, SUPPLY

enable_in_kernels()

# What a pass over a stage's cells finds.
MIDDLE, PLANE, FLOORED, FORWARD = range(4)

# Rows of the forms of a transition: supply pressure candidates as constant, t, x, y.
FORM = 4


@njit(cache=True, error_model="numpy", nogil=True)
def lowest(form, box):
    """Least value of an affine form over a box of (t, x, y), (2, 3)."""
    total = form[0]
    for v in range(3):
        g = form[v + 1]
        total += g * (box[0, v] if g > 0.0 else box[1, v])
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def ascend(form, direction, low, high, box):
    """Add the multiple of `direction` within [low, high] that raises the least value over the box most.

    The least value is concave and piecewise linear in the multiplier: its corners are where a slope vanishes.
    """
    best, chosen = lowest(form, box), 0.0
    for v in range(-1, 4):
        if v == -1:
            multiplier = low
        elif v == 3:
            multiplier = high
        elif direction[v + 1] != 0.0:
            multiplier = min(max(-form[v + 1] / direction[v + 1], low), high)
        else:
            continue
        if multiplier == 0.0 or abs(multiplier) == np.inf:
            continue
        total = form[0] + multiplier * direction[0]
        for q in range(3):
            g = form[q + 1] + multiplier * direction[q + 1]
            total += g * (box[0, q] if g > 0.0 else box[1, q])
        if total > best:
            best, chosen = total, multiplier
    if chosen != 0.0:
        for q in range(FORM):
            form[q] += chosen * direction[q]
    return chosen


@njit(cache=True, error_model="numpy", nogil=True)
def cell_flow(motion, cylinder, half, flow, sigma):
    """Plane below the pump flow over a cell: middle, slope by t, by x, bounds of both slopes for any sigma."""
    f0, ft, fx = flow, 0.0, 0.0
    loose_t, loose_x = 0.0, 0.0
    for m in range(motion.shape[0]):
        side, out, back = motion[m, V_SIDE], cylinder[m, AREA_OUT], cylinder[m, AREA_IN]
        if side == 0.0:
            reach = abs(motion[m, V_T]) + abs(motion[m, V_X]) * half + motion[m, V_E]
            fast, slow = motion[m, V_M] + reach, motion[m, V_M] - reach
            area = (out * fast + back * slow) / (fast - slow)
            largest = max(out, back)
        else:
            area = out if side > 0.0 else -back
            largest = abs(area)
        if (
            not area * motion[m, V_M] + largest * (abs(motion[m, V_X]) * half + abs(motion[m, V_T]))
            > largest * motion[m, V_E]
        ):
            motion[m, V_SIDE] = 1.0
            continue  # bounds too wide to say more than that flow is not negative
        f0 -= largest * motion[m, V_E]
        loose_t += largest * abs(motion[m, V_T])
        loose_x += largest * abs(motion[m, V_X])
        sigma[m] = area
        f0 += area * motion[m, V_M]
        ft += area * motion[m, V_T]
        fx += area * motion[m, V_X]
    return f0, ft, fx, loose_t, loose_x


@njit(cache=True, error_model="numpy", nogil=True)
def supply_forms(motion, setting, fixed, u0, u_lo, u_hi, box, forms):
    """Affine lower bounds of the supply pressure over a transition's box; returns how many."""
    step = setting[STEP]
    if setting[SENSING] == 0.0:
        forms[0, 0] = setting[SUPPLY]
        forms[0, 1:] = 0.0
        return 1
    forms[0, 0] = fixed + setting[SUPPLY]
    forms[0, 1:] = 0.0
    count = 1
    tm, xm = max(-box[0, 0], box[1, 0]), max(-box[0, 1], box[1, 1])
    um, du = max(abs(u_lo), abs(u_hi)), max(abs(u_lo - u0), abs(u_hi - u0))
    for m in range(motion.shape[0]):
        gain = motion[m, P_GAIN]
        if gain < 0.0:
            continue
        error = motion[m, P_E] + motion[m, P_UE] * um
        pull = motion[m, P_U]
        least = motion[m, P_M] + min(pull * u_lo, pull * u_hi) - error
        least -= tm * (abs(motion[m, P_T]) + abs(motion[m, P_UT]) * um) + xm * abs(motion[m, P_X])
        if least <= 0.0:
            continue  # may run free: nothing to count on
        form = forms[count]
        form[0] = motion[m, P_M] + pull * u0 - error - tm * abs(motion[m, P_UT]) * du
        form[0] = setting[SUPPLY] + motion[m, P_BACK] + gain * form[0]
        form[1] = gain * (motion[m, P_T] + motion[m, P_UT] * u0)
        form[2] = gain * (motion[m, P_X] - pull / step)
        form[3] = gain * pull / step
        if lowest(form, box) > 0.0:
            count += 1
    return count


@njit(cache=True, error_model="numpy", nogil=True)
def low_end(drift, half_c, step, box):
    """Smallest next position of a box."""
    return drift + half_c * box[0, 0] + 0.5 * step * (box[0, 1] + box[0, 2])


@njit(cache=True, error_model="numpy", nogil=True)
def high_end(drift, half_c, step, box):
    """Largest next position of a box."""
    return drift + half_c * box[1, 0] + 0.5 * step * (box[1, 1] + box[1, 2])


@njit(cache=True, error_model="numpy", nogil=True)
def sharpen(  # noqa: PLR0913
    form, count, chosen, forms, supply, f0, ft, fx, sigma, motion, cylinder, rate, turn, box, direction
):
    """Raise the least value of a transition's form by its multipliers lambda, sigma and mu."""
    for q in range(count):
        if q == chosen:
            continue
        rise0, rise1 = forms[q, 0] - supply[0], forms[q, 1] - supply[1]
        rise2, rise3 = forms[q, 2] - supply[2], forms[q, 3] - supply[3]
        direction[0] = rate * f0 * rise0
        direction[1] = rate * (f0 * rise1 + ft * rise0)
        direction[2] = rate * (f0 * rise2 + fx * rise0)
        direction[3] = rate * f0 * rise3
        share = ascend(form, direction, 0.0, 1.0, box)
        if share != 0.0:
            supply[0] += share * rise0
            supply[1] += share * rise1
            supply[2] += share * rise2
            supply[3] += share * rise3
    for m in range(motion.shape[0]):
        if motion[m, V_SIDE] == 0.0:
            middle = motion[m, V_M]
            direction[0] = rate * middle * supply[0]
            direction[1] = rate * (middle * supply[1] + motion[m, V_T] * supply[0])
            direction[2] = rate * (middle * supply[2] + motion[m, V_X] * supply[0])
            direction[3] = rate * middle * supply[3]
            ascend(form, direction, -cylinder[m, AREA_IN] - sigma[m], cylinder[m, AREA_OUT] - sigma[m], box)
    for side in range(2):
        sign = 1.0 if side == 0 else -1.0
        if turn[side] + (box[1, 2] - box[0, 1] if side == 0 else box[1, 1] - box[0, 2]) > 0.0:
            direction[0], direction[1], direction[2], direction[3] = turn[side], 0.0, -sign, sign
            ascend(form, direction, 0.0, np.inf, box)
    return lowest(form, box)


@njit(cache=True, error_model="numpy", nogil=True)
def cells(  # noqa: PLR0913
    kind, first, last, model, there, rows, rows_ahead, edges, edges_ahead, columns, columns_ahead, fixed, cylinder,
    setting, limit, active, planes, ahead, found, floors,
):  # fmt: skip
    """One pass over the cells of a stage, rows `first` to `last` - 1 of its window.

    Args:
        kind: MIDDLE: least cost to go from each cell's middle, for slopes. PLANE: levels of the planes whose slopes
            are given. FLOORED: those, and levels of planes without slope. FORWARD: least excess with which cells of
            the next stage are reached.
        first, last: Rows.
        model: Enclosures of the stage's coefficients over position cells, (rows, moving, COEFFICIENTS, 4).
        there: Lattice of the next stage, (LATTICE,).
        rows, rows_ahead: Edges of the rows of both windows [m], (rows + 1,).
        edges, edges_ahead: Edges of the cells of both windows in velocity [m/s], (rows, columns + 1).
        columns, columns_ahead: Admissible velocities over position cells of both windows [m/s], (rows, 2).
        fixed: Flow [m^3/s] and counted pressure [Pa] of the prescribed cylinders, (2,).
        cylinder: (moving, CYLINDER_COLUMNS).
        setting: Scalars, (SETTINGS,).
        limit: FORWARD: excess beyond which nothing is passed on [J].
        active: Cells to look at, finite; FORWARD: the excess they are reached with [J]; (rows, columns).
        planes: Level [J] and slopes [J/m], [J s/m] of the cells' planes, and floors [J], (rows, columns, 4).
        ahead: The same of the next stage; level inf where no motion may pass, (rows, columns, 4).
        found: Out. FORWARD: excess of the next stage [J], lowered in place. Others: values [J], (rows, columns).
        floors: Out. FLOORED: levels of planes without slope [J], (rows, columns).
    """
    n = model.shape[1]
    step = setting[STEP]
    coefficients, motion = np.empty((n, COEFFICIENTS, 3)), np.zeros((n, MOTION))
    box, whole = np.zeros((2, 3)), np.zeros((2, 3))
    forms, supply = np.zeros((n + 1, FORM)), np.zeros(FORM)
    form, direction = np.zeros(FORM), np.zeros(FORM)
    sigma, turn = np.zeros(n), np.zeros(2)
    rate = step / setting[EFFICIENCY]
    # Edges off the lattice: only where power jumps.
    off = SNAP if setting[SENSING] != 0.0 else 0.0
    next_dw, next_half, j_ahead = there[L_DW], (0.5 + off) * there[L_DW], int(there[L_J])
    lead = i_first = 0
    # Forms with the slopes of the cell's plane, without, or both.
    sloped, level_too = (1 if kind == MIDDLE else 0), (2 if kind in (MIDDLE, FLOORED) else 1)
    for p in range(first, last):
        expand(model, p, coefficients)
        c, half_c = 0.5 * (rows[p + 1] + rows[p]), 0.5 * (rows[p + 1] - rows[p])
        inverse = 1.0 / half_c
        for r in range(active.shape[1]):
            if active[p, r] == np.inf:
                continue
            w, half = 0.5 * (edges[p, r + 1] + edges[p, r]), 0.5 * (edges[p, r + 1] - edges[p, r])
            best = floor = np.inf
            # Excess so far less the level; where the floor is above the plane, less by how much at most.
            rise = abs(planes[p, r, 1]) * half_c + abs(planes[p, r, 2]) * half
            so_far = active[p, r] - max(planes[p, r, 0], planes[p, r, 3] + rise)
            whole[0, 0], whole[1, 0] = -1.0, 1.0
            whole[0, 1], whole[1, 1] = max(-half, columns[p, 0] - w), min(half, columns[p, 1] - w)
            if kind == MIDDLE:
                whole[:, :2] = 0.0
            lo, hi = cell_motion(coefficients, cylinder, setting, w, half, motion)
            if lo <= hi and whole[0, 1] <= whole[1, 1]:
                f0, ft, fx, loose_t, loose_x = cell_flow(motion, cylinder, half, fixed[0], sigma)
                slowest, fastest = w + whole[0, 1] + step * lo, w + whole[1, 1] + step * hi
                if next_dw > 0.0:
                    j_first = int(np.floor((slowest - there[L_W]) / next_dw - off))
                    j_last = int(np.floor((fastest - there[L_W]) / next_dw + off))
                else:
                    j_first, j_last = 0, (0 if slowest <= there[L_W] <= fastest else -1)
                j_first, j_last = max(j_first, int(there[L_J])), min(j_last, int(there[L_J]) + ahead.shape[1] - 1)
                tried = j_last - j_first + 1
                begin = min(lead, max(tried - 1, 0))
                for visit in range(tried):
                    j = j_first + (visit + begin) % tried
                    next_w = there[L_W] + (j + 0.5) * next_dw
                    whole[0, 2] = max(-next_half, slowest - next_w)
                    whole[1, 2] = min(next_half, fastest - next_w)
                    u0 = (next_w - w) / step
                    u_lo = max(lo, u0 + (whole[0, 2] - whole[1, 1]) / step)
                    u_hi = min(hi, u0 + (whole[1, 2] - whole[0, 1]) / step)
                    if u_lo > u_hi or whole[0, 2] > whole[1, 2]:
                        continue
                    turn[0], turn[1] = next_w - w - step * hi, step * lo - (next_w - w)
                    count = supply_forms(motion, setting, fixed[1], u0, u_lo, u_hi, whole, forms)
                    chosen = 0
                    rest = 0.0
                    for q in range(count):
                        if forms[q, 0] > forms[chosen, 0]:
                            chosen = q
                        reach = max(-whole[0, 0], whole[1, 0]) * abs(forms[q, 1])
                        reach += max(-whole[0, 1], whole[1, 1]) * abs(forms[q, 2])
                        reach += max(-whole[0, 2], whole[1, 2]) * abs(forms[q, 3])
                        rest = max(rest, reach)
                    rest *= whole[1, 0] * loose_t + max(-whole[0, 1], whole[1, 1]) * loose_x
                    drift = c + 0.5 * step * (w + next_w)
                    low = drift + half_c * whole[0, 0] + 0.5 * step * (whole[0, 1] + whole[0, 2]) - ON_LIMIT
                    high = drift + half_c * whole[1, 0] + 0.5 * step * (whole[1, 1] + whole[1, 2]) + ON_LIMIT
                    while i_first > 0 and rows_ahead[i_first] > low:
                        i_first -= 1
                    while i_first < ahead.shape[0] - 1 and rows_ahead[i_first + 1] < low:
                        i_first += 1
                    supply_m, supply_t = forms[chosen, 0], forms[chosen, 1]
                    supply_x, supply_y = forms[chosen, 2], forms[chosen, 3]
                    cost_m = rate * (f0 * supply_m - rest)
                    cost_t = rate * (f0 * supply_t + ft * supply_m)
                    cost_x = rate * (f0 * supply_x + fx * supply_m)
                    cost_y = rate * f0 * supply_y
                    column = j - j_ahead
                    for row in range(i_first, ahead.shape[0]):
                        bottom_c, top_c = rows_ahead[row], rows_ahead[row + 1]
                        if bottom_c > high:
                            break
                        level = ahead[row, column, 0]
                        if level == np.inf:
                            continue
                        bottom, top = edges_ahead[row, column], edges_ahead[row, column + 1]
                        y_lo = max(whole[0, 2], max(columns_ahead[row, 0], bottom) - next_w)
                        y_hi = min(whole[1, 2], min(columns_ahead[row, 1], top) - next_w)
                        t_lo = (bottom_c - ON_LIMIT - drift - 0.5 * step * (whole[1, 1] + y_hi)) * inverse
                        t_hi = (top_c + ON_LIMIT - drift - 0.5 * step * (whole[0, 1] + y_lo)) * inverse
                        t_lo, t_hi = max(whole[0, 0], t_lo), min(whole[1, 0], t_hi)
                        if t_lo > t_hi or y_lo > y_hi:
                            continue
                        slope_c, slope_w = ahead[row, column, 1], ahead[row, column, 2]
                        lean = 0.5 * step * slope_c
                        g0 = cost_m + level + slope_c * (drift - 0.5 * (bottom_c + top_c))
                        g0 += slope_w * (next_w - 0.5 * (bottom + top))
                        gy = cost_y + lean + slope_w
                        for level_plane in range(sloped, level_too):
                            gt, gx = cost_t + slope_c * half_c, cost_x + lean
                            if not level_plane:
                                gt, gx = gt - planes[p, r, 1] * half_c, gx - planes[p, r, 2]
                            value = g0 + gt * (t_lo if gt > 0.0 else t_hi)
                            value += gx * (whole[0, 1] if gx > 0.0 else whole[1, 1]) + gy * (y_lo if gy > 0.0 else y_hi)
                            if kind == FORWARD:
                                bar = min(limit, found[row, column]) - so_far
                            else:
                                bar = floor if kind == FLOORED and level_plane else best
                            if value < bar:
                                box[0, 0], box[0, 1], box[0, 2] = t_lo, whole[0, 1], y_lo
                                box[1, 0], box[1, 1], box[1, 2] = t_hi, whole[1, 1], y_hi
                                form[0], form[1], form[2], form[3] = g0, gt, gx, gy
                                for v in range(FORM):
                                    supply[v] = forms[chosen, v]
                                other = ahead[row, column, 3]
                                span = abs(slope_c) * (top_c - bottom_c) + abs(slope_w) * (top - bottom)
                                if level - 0.5 * span < other:
                                    # The cost to go is not below the floor either: any mean of plane and floor will do.
                                    direction[0] = other - (g0 - cost_m)
                                    direction[1], direction[2], direction[3] = -slope_c * half_c, -lean, -lean - slope_w
                                    ascend(form, direction, 0.0, 1.0, box)
                                # Only where the next position is in its cell.
                                if kind != MIDDLE and bottom_c - low_end(drift, half_c, step, box) > 0.0:
                                    direction[0], direction[1] = bottom_c - ON_LIMIT - drift, -half_c
                                    direction[2] = direction[3] = -0.5 * step
                                    ascend(form, direction, 0.0, np.inf, box)
                                if kind != MIDDLE and high_end(drift, half_c, step, box) - top_c > 0.0:
                                    direction[0], direction[1] = drift - top_c - ON_LIMIT, half_c
                                    direction[2] = direction[3] = 0.5 * step
                                    ascend(form, direction, 0.0, np.inf, box)
                                value = sharpen(
                                    form, count, chosen, forms, supply, f0, ft, fx, sigma, motion, cylinder, rate, turn,
                                    box, direction,
                                )  # fmt: skip
                                if value < bar:
                                    if kind == FORWARD:
                                        found[row, column] = max(active[p, r], so_far + value)
                                    elif kind == FLOORED and level_plane:
                                        floor = value
                                    else:
                                        best, lead = value, j - j_first
            if kind != FORWARD:
                found[p, r] = best
            if kind == FLOORED:
                floors[p, r] = floor
