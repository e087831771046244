"""Compiled kernels of the certificate: rigorous lower bounds of the cost to go over cells of the state space.

A stage's (position, velocity) domain is cut into cells. Over each cell the cost to go of every admissible motion is
bounded from below by a plane, L(c, w) = level + slope_c (c - c_m) + slope_w (w - w_m) with (c_m, w_m) the cell's
middle. `docs/certificate.md` derives what is computed here and proves it.

A transition leads from a cell to a velocity row and a position column of the next stage. Within its box

    t in [-1, 1]: position within the cell,   x: velocity from the cell's middle,   y: next velocity on the lattice,

everything is affine in (t, x, y) up to a bounded error, so the least value is attained at corners. What is not
affine enters by multipliers: sigma (pump flow of a cylinder that may move either way), lambda (which demanded pressure
is the highest), mu (acceleration limits).

Kernels know no machine and no task; arrays in, caller-owned arrays out, no interpreter lock. Rows of positions are
independent, so threads may share a stage.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from leanboom.certificate.cell_enclosures import (
    FORM,
    INNER,
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
    Box,
    Form,
    ascend,
    cell_motion,
    expand,
    lowest,
    plus,
    raised,
    read,
)
from leanboom.compiling import njit
from leanboom.formulas.formula import enable_in_kernels
from leanboom.problem.layout import AREA_IN, AREA_OUT, COEFFICIENTS, EFFICIENCY, SENSING, STEP, SUPPLY

enable_in_kernels()


class Cell(NamedTuple):
    """A cell: middle, half sizes, and the forms that all transitions from it share."""

    at_middle: bool  # whether motions start from its middle alone
    c: float  # [m]
    half_c: float
    w: float  # [m/s]
    lo: float  # least and largest acceleration [m/s^2]; lo > hi where there is none
    hi: float
    x_lo: float  # bounds of x [m/s]
    x_hi: float
    flow: Form  # below the pump flow [m^3/s]
    loose_t: float  # bounds of its slopes whatever the multipliers
    loose_x: float


class Transition(NamedTuple):
    """The forms and bounds shared by the transitions from a cell to one row of next velocities."""

    c: float  # next position from middle to middle [m]
    w: float  # next velocity in the middle [m/s]
    reach: Box  # y_lo > y_hi where there is none
    pressures: int  # lower bounds of the supply pressure
    chosen: int  # the one that energy counts
    energy: Form  # below the stage's energy [J]


class Scratch(NamedTuple):
    """Arrays of a thread, for one cell and one transition at a time."""

    coefficients: np.ndarray  # over the cell's row, (moving, COEFFICIENTS, 3)
    motion: np.ndarray  # over the cell, (moving, MOTION)
    sigma: np.ndarray  # slopes of the cylinders' flows by their velocities [m^2], (moving,)
    pressures: np.ndarray  # lower bounds of the supply pressure, (moving + 1, FORM)


@njit(cache=True, **INNER)
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


@njit(cache=True, **INNER)
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
    tm, xm = max(-box.t_lo, box.t_hi), max(-box.x_lo, box.x_hi)
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
        if lowest(read(forms, count), box) > 0.0:
            count += 1
    return count


@njit(cache=True, error_model="numpy", nogil=True)
def scratch(moving):
    """Scratch arrays for so many moving cylinders."""
    return Scratch(
        np.empty((moving, COEFFICIENTS, 3)), np.zeros((moving, MOTION)), np.zeros(moving), np.zeros((moving + 1, FORM))
    )


@njit(cache=True, **INNER)
def snap(setting):
    """Largest shift of an edge off the lattice, as a share of a cell's height: not zero only where power jumps."""
    return SNAP if setting[SENSING] != 0.0 else 0.0


@njit(cache=True, **INNER)
def cell_forms(stage, p, r, at_middle, work):
    """The `Cell` of all transitions from a cell, or from its middle; `coefficients` are those of its row."""
    rows, edges, columns = stage.rows, stage.edges, stage.columns
    c, half_c = 0.5 * (rows[p + 1] + rows[p]), 0.5 * (rows[p + 1] - rows[p])
    w, half = 0.5 * (edges[p, r + 1] + edges[p, r]), 0.5 * (edges[p, r + 1] - edges[p, r])
    x_lo, x_hi = max(-half, columns[p, 0] - w), min(half, columns[p, 1] - w)
    if at_middle:
        x_lo = x_hi = 0.0
    lo, hi = cell_motion(work.coefficients, stage.cylinder, stage.setting, w, half, work.motion)
    if not (lo <= hi and x_lo <= x_hi):
        return Cell(at_middle, c, half_c, w, np.inf, -np.inf, x_lo, x_hi, Form(0.0, 0.0, 0.0, 0.0), 0.0, 0.0)
    f0, ft, fx, loose_t, loose_x = cell_flow(work.motion, stage.cylinder, half, stage.fixed[0], work.sigma)
    return Cell(at_middle, c, half_c, w, lo, hi, x_lo, x_hi, Form(f0, ft, fx, 0.0), loose_t, loose_x)


@njit(cache=True, **INNER)
def next_columns(stage, cell, count):
    """First and last of the next stage's `count` columns that a cell's motions reach, as they count on the lattice."""
    there, step, off = stage.lattice_ahead, stage.setting[STEP], snap(stage.setting)
    if cell.lo > cell.hi:
        return 0, -1
    slowest, fastest = cell.w + cell.x_lo + step * cell.lo, cell.w + cell.x_hi + step * cell.hi
    if there[L_DW] > 0.0:
        first = int(np.floor((slowest - there[L_W]) / there[L_DW] - off))
        last = int(np.floor((fastest - there[L_W]) / there[L_DW] + off))
    else:
        first, last = 0, (0 if slowest <= there[L_W] <= fastest else -1)
    return max(first, int(there[L_J])), min(last, int(there[L_J]) + count - 1)


@njit(cache=True, **INNER)
def transition(stage, cell, j, work):
    """The `Transition` from a cell to column `j` of the next stage; `pressures` are filled."""
    there, setting, forms = stage.lattice_ahead, stage.setting, work.pressures
    step, rate, half = setting[STEP], setting[STEP] / setting[EFFICIENCY], (0.5 + snap(setting)) * there[L_DW]
    w = there[L_W] + (j + 0.5) * there[L_DW]
    t = 0.0 if cell.at_middle else 1.0
    y_lo = max(-half, cell.w + cell.x_lo + step * cell.lo - w)
    y_hi = min(half, cell.w + cell.x_hi + step * cell.hi - w)
    reach = Box(-t, t, cell.x_lo, cell.x_hi, y_lo, y_hi)
    u0 = (w - cell.w) / step
    u_lo = max(cell.lo, u0 + (y_lo - cell.x_hi) / step)
    u_hi = min(cell.hi, u0 + (y_hi - cell.x_lo) / step)
    if u_lo > u_hi or y_lo > y_hi:
        none = Form(0.0, 0.0, 0.0, 0.0)
        return Transition(0.0, w, Box(-t, t, cell.x_lo, cell.x_hi, np.inf, -np.inf), 0, 0, none)
    count = supply_forms(work.motion, setting, stage.fixed[1], u0, u_lo, u_hi, reach, forms)
    chosen, rest, most_x, most_y = 0, 0.0, max(-cell.x_lo, cell.x_hi), max(-y_lo, y_hi)
    for q in range(count):
        if forms[q, 0] > forms[chosen, 0]:
            chosen = q
        rest = max(rest, t * abs(forms[q, 1]) + most_x * abs(forms[q, 2]) + most_y * abs(forms[q, 3]))
    rest *= t * cell.loose_t + most_x * cell.loose_x
    supply, f = read(forms, chosen), cell.flow
    energy = Form(
        rate * (f.constant * supply.constant - rest),
        rate * (f.constant * supply.t + f.t * supply.constant),
        rate * (f.constant * supply.x + f.x * supply.constant),
        rate * f.constant * supply.y,
    )
    return Transition(cell.c + 0.5 * step * (cell.w + w), w, reach, count, chosen, energy)


@njit(cache=True, **INNER)
def next_position(move, cell, step, box):
    """Least and largest position at the next stage over a box [m]."""
    low = move.c + cell.half_c * box.t_lo + 0.5 * step * (box.x_lo + box.y_lo)
    return low, move.c + cell.half_c * box.t_hi + 0.5 * step * (box.x_hi + box.y_hi)


@njit(cache=True, **INNER)
def first_row(rows, low, guess):
    """The first row that does not end below a position, looked for from a guess."""
    while guess > 0 and rows[guess] > low:
        guess -= 1
    while guess < rows.size - 2 and rows[guess + 1] < low:
        guess += 1
    return guess


@njit(cache=True, **INNER)
def landing(stage, cell, move, row, column, ahead):
    """Box of the transitions into a cell of the next stage, and energy plus that cell's plane over it as a form."""
    half_step, columns, edges, reach = 0.5 * stage.setting[STEP], stage.columns_ahead, stage.edges_ahead, move.reach
    low, high = stage.rows_ahead[row], stage.rows_ahead[row + 1]
    bottom, top = edges[row, column], edges[row, column + 1]
    y_lo = max(reach.y_lo, max(columns[row, 0], bottom) - move.w)
    y_hi = min(reach.y_hi, min(columns[row, 1], top) - move.w)
    inverse = 1.0 / cell.half_c
    t_lo = (low - ON_LIMIT - move.c - half_step * (reach.x_hi + y_hi)) * inverse
    t_hi = (high + ON_LIMIT - move.c - half_step * (reach.x_lo + y_lo)) * inverse
    slope_c, slope_w = ahead[row, column, 1], ahead[row, column, 2]
    lean = half_step * slope_c
    constant = move.energy.constant + ahead[row, column, 0] + slope_c * (move.c - 0.5 * (low + high))
    constant += slope_w * (move.w - 0.5 * (bottom + top))
    form = Form(constant, move.energy.t + slope_c * cell.half_c, move.energy.x + lean, move.energy.y + lean + slope_w)
    return Box(max(reach.t_lo, t_lo), min(reach.t_hi, t_hi), reach.x_lo, reach.x_hi, y_lo, y_hi), form


@njit(cache=True, **INNER)
def transition_bound(stage, cell, move, row, column, ahead, box, form, work):
    """Least reduced cost of the transitions into a cell of the next stage, raised by multipliers.

    Args:
        stage, cell, move, work: As the functions above make them.
        row, column: The cell.
        ahead: Planes and floors of the next stage, (rows, columns, 4).
        box: As `landing` finds it.
        form: As `landing` finds it, less the own cell's slopes.
    """
    step, edges, rows = stage.setting[STEP], stage.edges_ahead, stage.rows_ahead
    half_c, level, floor = cell.half_c, ahead[row, column, 0], ahead[row, column, 3]
    slope_c, slope_w = ahead[row, column, 1], ahead[row, column, 2]
    span = abs(slope_c) * (rows[row + 1] - rows[row]) + abs(slope_w) * (edges[row, column + 1] - edges[row, column])
    if level - 0.5 * span < floor:
        # The cost to go is not below the floor either: any mean of plane and floor will do.
        lean = 0.5 * step * slope_c
        rise = Form(floor - (form.constant - move.energy.constant), -slope_c * half_c, -lean, -lean - slope_w)
        form = raised(form, rise, 0.0, 1.0, box)
    low, high = next_position(move, cell, step, box)
    # Only where the next position is in its cell.
    if not cell.at_middle and rows[row] - low > 0.0:
        form = raised(form, Form(rows[row] - ON_LIMIT - move.c, -half_c, -0.5 * step, -0.5 * step), 0.0, np.inf, box)
    if not cell.at_middle and high - rows[row + 1] > 0.0:
        form = raised(form, Form(move.c - rows[row + 1] - ON_LIMIT, half_c, 0.5 * step, 0.5 * step), 0.0, np.inf, box)
    return sharpen(form, stage, cell, move, box, work)


@njit(cache=True, **INNER)
def sharpen(form, stage, cell, move, box, work):
    """Least value of a transition's form, raised by its multipliers lambda, sigma and mu."""
    step, cylinder, motion, forms = stage.setting[STEP], stage.cylinder, work.motion, work.pressures
    rate, supply, f = step / stage.setting[EFFICIENCY], read(forms, move.chosen), cell.flow
    for q in range(move.pressures):
        if q == move.chosen:
            continue
        rise = plus(read(forms, q), -1.0, supply)
        direction = Form(
            rate * f.constant * rise.constant,
            rate * (f.constant * rise.t + f.t * rise.constant),
            rate * (f.constant * rise.x + f.x * rise.constant),
            rate * f.constant * rise.y,
        )
        share = ascend(form, direction, 0.0, 1.0, box)
        if share != 0.0:
            form, supply = plus(form, share, direction), plus(supply, share, rise)
    for m in range(motion.shape[0]):
        if motion[m, V_SIDE] == 0.0:
            middle = motion[m, V_M]
            direction = Form(
                rate * middle * supply.constant,
                rate * (middle * supply.t + motion[m, V_T] * supply.constant),
                rate * (middle * supply.x + motion[m, V_X] * supply.constant),
                rate * middle * supply.y,
            )
            sigma = work.sigma[m]
            form = raised(form, direction, -cylinder[m, AREA_IN] - sigma, cylinder[m, AREA_OUT] - sigma, box)
    over, under = move.w - cell.w - step * cell.hi, step * cell.lo - (move.w - cell.w)
    if over + (box.y_hi - box.x_lo) > 0.0:
        form = raised(form, Form(over, 0.0, -1.0, 1.0), 0.0, np.inf, box)
    if under + (box.x_hi - box.y_lo) > 0.0:
        form = raised(form, Form(under, 0.0, 1.0, -1.0), 0.0, np.inf, box)
    return lowest(form, box)


@njit(cache=True, error_model="numpy", nogil=True)
def backward(stage, first, last, at_middle, active, planes, ahead, found, floors):
    """Least reduced cost of the cells of some rows: levels of planes whose slopes are given.

    Args:
        stage: A `cell_enclosures.Stage`.
        first, last: The rows are `first` to `last` - 1.
        at_middle: Whether motions start from the cells' middles alone: values there, for slopes.
        active: Finite where a cell is looked at, (rows, columns).
        planes: Level [J] and slopes [J/m], [J s/m] of the cells' planes, and floors [J], (rows, columns, 4).
        ahead: The same of the next stage; level inf where no motion may pass, (rows, columns, 4).
        found: Out: values [J], (rows, columns).
        floors: Out: levels of planes without slope [J], (rows, columns); empty if they are not asked for.
    """
    work, level_too, lead, i = scratch(stage.model.shape[1]), floors.size > 0, 0, 0
    rows_ahead, origin, step = stage.rows_ahead, int(stage.lattice_ahead[L_J]), stage.setting[STEP]
    for p in range(first, last):
        expand(stage.model, p, work.coefficients)
        for r in range(active.shape[1]):
            if active[p, r] == np.inf:
                continue
            best = floor = np.inf
            cell = cell_forms(stage, p, r, at_middle, work)
            own = Form(0.0, -planes[p, r, 1] * cell.half_c, -planes[p, r, 2], 0.0)
            j_first, j_last = next_columns(stage, cell, ahead.shape[1])
            tried = j_last - j_first + 1
            begin = min(lead, max(tried - 1, 0))
            for visit in range(tried):
                j = j_first + (visit + begin) % tried
                move = transition(stage, cell, j, work)
                if move.reach.y_lo > move.reach.y_hi:
                    continue
                low, high = next_position(move, cell, step, move.reach)
                i = first_row(rows_ahead, low - ON_LIMIT, i)
                for row in range(i, ahead.shape[0]):
                    if rows_ahead[row] > high + ON_LIMIT:
                        break
                    if ahead[row, j - origin, 0] == np.inf:
                        continue
                    box, level = landing(stage, cell, move, row, j - origin, ahead)
                    if box.t_lo > box.t_hi or box.y_lo > box.y_hi:
                        continue
                    form = plus(level, 1.0, own)
                    if lowest(form, box) < best:
                        value = transition_bound(stage, cell, move, row, j - origin, ahead, box, form, work)
                        if value < best:
                            best, lead = value, j - j_first
                    if level_too and lowest(level, box) < floor:
                        value = transition_bound(stage, cell, move, row, j - origin, ahead, box, level, work)
                        floor = min(floor, value)
            found[p, r] = best
            if level_too:
                floors[p, r] = floor


@njit(cache=True, error_model="numpy", nogil=True)
def forward(stage, first, last, limit, active, planes, ahead, found):
    """Least excess with which the cells of the next stage are reached from the cells of some rows.

    Args:
        stage, first, last, planes, ahead: As in `backward`.
        limit: Excess beyond which nothing is passed on [J].
        active: Excess with which the cells are reached [J], inf where they are not, (rows, columns).
        found: Excess of the next stage's cells [J], lowered in place, (rows, columns).
    """
    work, i = scratch(stage.model.shape[1]), 0
    rows_ahead, origin, step = stage.rows_ahead, int(stage.lattice_ahead[L_J]), stage.setting[STEP]
    for p in range(first, last):
        expand(stage.model, p, work.coefficients)
        for r in range(active.shape[1]):
            if active[p, r] == np.inf:
                continue
            cell = cell_forms(stage, p, r, False, work)
            half = 0.5 * (stage.edges[p, r + 1] - stage.edges[p, r])
            # Excess so far less the level; where the floor is above the plane, less by how much at most.
            rise = abs(planes[p, r, 1]) * cell.half_c + abs(planes[p, r, 2]) * half
            so_far = active[p, r] - max(planes[p, r, 0], planes[p, r, 3] + rise)
            own = Form(0.0, -planes[p, r, 1] * cell.half_c, -planes[p, r, 2], 0.0)
            j_first, j_last = next_columns(stage, cell, ahead.shape[1])
            for j in range(j_first, j_last + 1):
                move = transition(stage, cell, j, work)
                if move.reach.y_lo > move.reach.y_hi:
                    continue
                low, high = next_position(move, cell, step, move.reach)
                i = first_row(rows_ahead, low - ON_LIMIT, i)
                for row in range(i, ahead.shape[0]):
                    if rows_ahead[row] > high + ON_LIMIT:
                        break
                    if ahead[row, j - origin, 0] == np.inf:
                        continue
                    box, form = landing(stage, cell, move, row, j - origin, ahead)
                    form, bar = plus(form, 1.0, own), min(limit, found[row, j - origin]) - so_far
                    if box.t_lo > box.t_hi or box.y_lo > box.y_hi or not lowest(form, box) < bar:
                        continue
                    value = transition_bound(stage, cell, move, row, j - origin, ahead, box, form, work)
                    if value < bar:
                        found[row, j - origin] = max(active[p, r], so_far + value)
