"""Enclosures over cells: velocities, accelerations and loads from enclosed coefficients, and edges at thresholds.

A stage's cells are rows of position by columns of velocity. Their coefficients are lines in the position within the
row with a bounded error (`taylor_model`); from them follow bounds over a cell. Edges in velocity lie on a lattice, but
where a cylinder begins to demand pressure (LS) the nearest edge of the row is moved there: power jumps at that
velocity, and a cell with the jump inside would have to take the cheaper side for all of it.

Within the box of a transition everything is affine in (t, x, y) up to a bounded error, so the least value is attained
at a corner. What is not affine enters by a multiple of another form, for which every multiplier gives a valid bound.

Kernels: arrays in, caller-owned arrays out, no interpreter lock. `docs/certificate.md` derives them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from leanboom.compiling import njit
from leanboom.problem.layout import (
    A0,
    A1,
    A_MAX,
    B0,
    B1,
    B2,
    B3,
    BACK_IN,
    BACK_OUT,
    COEFFICIENTS,
    COULOMB,
    EPSILON,
    F0,
    F1,
    F2,
    F3,
    GAIN_IN,
    GAIN_OUT,
    SENSING,
    SHARPNESS,
    V_MAX,
    VISCOUS,
)

# Options of kernels that kernels alone call and that make no arrays. Without `_nrt` nobody counts who holds the arrays
# of a tuple, which would take as long as the work itself; without wrappers there is less to compile.
INNER = {"error_model": "numpy", "nogil": True, "_nrt": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
FORM = 4  # entries of a form in an array: constant, slopes by t, x, y

# Entries of a lattice, one stage's cells in velocity: first edge, height, first column in the arrays of that stage.
L_W, L_DW, L_J = range(3)
LATTICE = 3

# Columns of the scratch arrays of a cell, one row a moving cylinder.
V_M, V_T, V_X, V_E, V_SIDE = range(5)  # velocity: middle, slopes, error; direction: +1, -1, 0 unknown
P_M, P_T, P_X, P_E, P_U, P_UT, P_UE, P_BACK, P_GAIN = range(5, 14)  # load along the motion, by acceleration; line
MOTION = 14
ON_LIMIT = 1e-9  # [m], how far beyond a limit a position may lie, as for the feasible extensions
SNAP = 0.49  # of a cell's height, by how much an edge may be moved onto a threshold
SOLVING = 3  # steps of the fixed point of a threshold
CLEARANCE = 1e-9  # [m/s], beyond a threshold, for the rounding of what is compared with it


class Form(NamedTuple):
    """An affine form of (t, x, y)."""

    constant: float
    t: float
    x: float
    y: float


class Box(NamedTuple):
    """Bounds of (t, x, y)."""

    t_lo: float
    t_hi: float
    x_lo: float
    x_hi: float
    y_lo: float
    y_hi: float


class Stage(NamedTuple):
    """A stage's cells, the next stage's, and the crane's motion over them: what kernels take of `partition.Cells`."""

    model: np.ndarray  # enclosures of the coefficients over rows, (rows, moving, COEFFICIENTS, 4)
    rows: np.ndarray  # edges of the rows [m], (rows + 1,)
    edges: np.ndarray  # of the cells in velocity [m/s], (rows, columns + 1)
    columns: np.ndarray  # admissible velocities of each row [m/s], (rows, 2)
    lattice_ahead: np.ndarray  # (LATTICE,)
    rows_ahead: np.ndarray
    edges_ahead: np.ndarray
    columns_ahead: np.ndarray
    fixed: np.ndarray  # pump flow [m^3/s] and demanded pressure [Pa] of the path-determined cylinders, (2,)
    cylinder: np.ndarray  # (moving, layout.CYLINDER_COLUMNS)
    setting: np.ndarray  # (layout.SETTINGS,)


@njit(cache=True, **INNER)
def lowest(form, box):
    """Least value of an affine form over a box."""
    total = form.constant + form.t * (box.t_lo if form.t > 0.0 else box.t_hi)
    total += form.x * (box.x_lo if form.x > 0.0 else box.x_hi)
    return total + form.y * (box.y_lo if form.y > 0.0 else box.y_hi)


@njit(cache=True, **INNER)
def plus(form, multiplier, direction):
    """A form plus a multiple of another."""
    return Form(
        form.constant + multiplier * direction.constant,
        form.t + multiplier * direction.t,
        form.x + multiplier * direction.x,
        form.y + multiplier * direction.y,
    )


@njit(cache=True, **INNER)
def read(forms, q):
    """Row `q` of an array of forms."""
    return Form(forms[q, 0], forms[q, 1], forms[q, 2], forms[q, 3])


@njit(cache=True, **INNER)
def levelling(slope, rise, low, high):
    """Multiplier within [low, high] that makes a slope vanish, or nearly; 0 where none changes it."""
    return min(max(-slope / rise, low), high) if rise != 0.0 else 0.0


@njit(cache=True, **INNER)
def ascend(form, direction, low, high, box):
    """Multiplier within [low, high] of `direction` that raises the least value of a form over a box most.

    The least value is concave and piecewise linear in the multiplier: its corners are where a slope vanishes.
    """
    best, chosen = lowest(form, box), 0.0
    for multiplier in (
        low,
        levelling(form.t, direction.t, low, high),
        levelling(form.x, direction.x, low, high),
        levelling(form.y, direction.y, low, high),
        high,
    ):
        if multiplier == 0.0 or abs(multiplier) == np.inf:
            continue
        total = lowest(plus(form, multiplier, direction), box)
        if total > best:
            best, chosen = total, multiplier
    return chosen


@njit(cache=True, **INNER)
def raised(form, direction, low, high, box):
    """A form plus the multiple of another that raises its least value most."""
    chosen = ascend(form, direction, low, high, box)
    return plus(form, chosen, direction) if chosen != 0.0 else form


@njit(cache=True, **INNER)
def expand(model, i, coefficients):
    """Coefficients over position cell i as a line in t: value, slope, error. The bend is halved, p2 t^2 <= |p2|."""
    for m in range(coefficients.shape[0]):
        for q in range(COEFFICIENTS):
            bend = 0.5 * model[i, m, q, 2]
            coefficients[m, q, 0] = model[i, m, q, 0] + bend
            coefficients[m, q, 1] = model[i, m, q, 1]
            coefficients[m, q, 2] = model[i, m, q, 3] + abs(bend)


@njit(cache=True, **INNER)
def column_velocities(coefficients, cylinder, low, high):
    """Velocities of the redundant cylinder that keep every velocity limit somewhere in a position cell."""
    for m in range(coefficients.shape[0]):
        a0, a1, limit = coefficients[m, A0], coefficients[m, A1], cylinder[m, V_MAX]
        reach0, reach1 = abs(a0[1]) + a0[2], abs(a1[1]) + a1[2]
        # a1 w <= limit - a0 and a1 w >= -limit - a0, for some a0 and a1 of the cell.
        top, bottom = limit - (a0[0] - reach0), -limit - (a0[0] + reach0)
        if a1[0] < 0.0:
            top, bottom = -bottom, -top
        small, large = abs(a1[0]) - reach1, abs(a1[0]) + reach1
        if small > 0.0:
            high = min(high, top / (small if top > 0.0 else large))
            low = max(low, bottom / (small if bottom < 0.0 else large))
    return low, high


@njit(cache=True, **INNER)
def cell_accelerations(coefficients, cylinder, w, half):
    """Bounds of the accelerations of the redundant cylinder that some state of a cell admits [m/s^2]."""
    lo, hi = -np.inf, np.inf
    top = abs(w) + half
    for m in range(coefficients.shape[0]):
        row = coefficients[m]
        # |b0 + b1 w + b2 w^2 + b3 u| <= limit for some state of the cell.
        b = row[B0, 0] + w * (row[B1, 0] + w * row[B2, 0])
        spread = abs(row[B0, 1] + w * (row[B1, 1] + w * row[B2, 1]))
        spread += half * (abs(row[B1, 0] + 2.0 * w * row[B2, 0]) + abs(row[B1, 1] + 2.0 * w * row[B2, 1]))
        spread += half * half * (abs(row[B2, 0]) + abs(row[B2, 1]))
        spread += row[B0, 2] + top * (row[B1, 2] + top * row[B2, 2])
        limit = cylinder[m, A_MAX]
        most, least = limit - (b - spread), -limit - (b + spread)
        if row[B3, 0] < 0.0:
            most, least = -least, -most
        reach = abs(row[B3, 1]) + row[B3, 2]
        small, large = abs(row[B3, 0]) - reach, abs(row[B3, 0]) + reach
        if small > 0.0:
            hi = min(hi, most / (small if most > 0.0 else large))
            lo = max(lo, least / (small if least < 0.0 else large))
    return lo, hi


@njit(cache=True, **INNER)
def cell_motion(coefficients, cylinder, setting, w, half, motion):
    """Velocities, loads and admissible accelerations over a cell; `motion` is filled row by row.

    Returns:
        Bounds of the accelerations of the redundant cylinder that some state of the cell admits [m/s^2].
    """
    top = abs(w) + half
    pressures = setting[SENSING] != 0.0
    for m in range(coefficients.shape[0]):
        row = coefficients[m]
        motion[m, V_M] = row[A0, 0] + row[A1, 0] * w
        motion[m, V_T] = row[A0, 1] + row[A1, 1] * w
        motion[m, V_X] = row[A1, 0]
        motion[m, V_E] = row[A0, 2] + row[A1, 2] * top + abs(row[A1, 1]) * half
        # Which way the cylinder moves, and whether it is surely metering.
        reach = abs(motion[m, V_T]) + abs(motion[m, V_X]) * half + motion[m, V_E]
        slow, fast = motion[m, V_M] - reach, motion[m, V_M] + reach
        motion[m, V_SIDE] = 1.0 if slow >= 0.0 else (-1.0 if fast <= 0.0 else 0.0)
        motion[m, P_GAIN] = 0.0
        motion[m, P_BACK] = 0.0
        if not pressures:
            continue
        side = 0.0
        if slow > setting[EPSILON]:
            side = 1.0
            motion[m, P_GAIN], motion[m, P_BACK] = cylinder[m, GAIN_OUT], cylinder[m, BACK_OUT]
        elif fast < -setting[EPSILON]:
            side = -1.0
            motion[m, P_GAIN], motion[m, P_BACK] = cylinder[m, GAIN_IN], cylinder[m, BACK_IN]
        if side == 0.0 or (motion[m, P_GAIN] == 0.0 and motion[m, P_BACK] == 0.0):
            motion[m, P_GAIN] = -1.0  # no pressure to count on
            continue
        # Load along the motion, side (f0 + f1 w + f2 w^2 + f3 u + friction), friction rising from slow to fast.
        grip_slow, grip_fast = np.tanh(cylinder[m, SHARPNESS] * slow), np.tanh(cylinder[m, SHARPNESS] * fast)
        grip, slip = 0.5 * (grip_slow + grip_fast), 0.5 * (grip_fast - grip_slow)
        motion[m, P_M] = row[F0, 0] + w * (row[F1, 0] + w * row[F2, 0]) + grip * row[COULOMB, 0]
        motion[m, P_M] += cylinder[m, VISCOUS] * motion[m, V_M]
        motion[m, P_T] = row[F0, 1] + w * (row[F1, 1] + w * row[F2, 1]) + grip * row[COULOMB, 1]
        motion[m, P_T] += cylinder[m, VISCOUS] * motion[m, V_T]
        motion[m, P_X] = row[F1, 0] + 2.0 * w * row[F2, 0] + cylinder[m, VISCOUS] * motion[m, V_X]
        motion[m, P_E] = row[F0, 2] + top * (row[F1, 2] + top * row[F2, 2]) + cylinder[m, VISCOUS] * motion[m, V_E]
        motion[m, P_E] += half * abs(row[F1, 1] + 2.0 * w * row[F2, 1])
        motion[m, P_E] += half * half * (abs(row[F2, 0]) + abs(row[F2, 1]))
        motion[m, P_E] += abs(grip) * row[COULOMB, 2] + slip * (
            abs(row[COULOMB, 0]) + abs(row[COULOMB, 1]) + row[COULOMB, 2]
        )
        motion[m, P_U], motion[m, P_UT], motion[m, P_UE] = row[F3, 0], row[F3, 1], row[F3, 2]
        if side < 0.0:
            for column in (P_M, P_T, P_X, P_U, P_UT):
                motion[m, column] = -motion[m, column]
    return cell_accelerations(coefficients, cylinder, w, half)


@njit(cache=True, error_model="numpy", nogil=True)
def velocity_columns(model, cylinder, columns):
    """Bounds of the admissible velocities over every position cell of a window, `columns` (rows, 2) [m/s]."""
    coefficients = np.empty((*model.shape[1:3], 3))
    for p in range(columns.shape[0]):
        expand(model, p, coefficients)
        columns[p, 0], columns[p, 1] = column_velocities(coefficients, cylinder, columns[p, 0], columns[p, 1])


@njit(cache=True, **INNER)
def surely_beyond(a0, a1, limit, room):
    """Velocity of the redundant cylinder from which on a cylinder is beyond a limit all over a row of positions.

    On which side of it depends on the sign of `a1`.

    Args:
        a0, a1: Coefficients of the cylinder's velocity, a0 + a1 w, as lines with an error, (3,) each.
        limit: Velocity of the cylinder [m/s], of the sign of its direction; not zero.
        room: Height that no cell exceeds [m/s]; `cell_motion` adds up errors over the cell's.

    Returns:
        Velocity [m/s]; not finite where the cylinder does not move with the redundant one.
    """
    sign = 1.0 if limit > 0.0 else -1.0
    w = (limit - a0[0]) / a1[0]
    for _ in range(SOLVING):
        error = abs(a0[1] + a1[1] * w) + room * abs(a1[1]) + a0[2] + a1[2] * (abs(w) + room)
        w = (limit + sign * (error + CLEARANCE) - a0[0]) / a1[0]
    return w


@njit(cache=True, error_model="numpy", nogil=True)
def place_edges(model, setting, here, edges):
    """Edges of a stage's cells in velocity, the nearest of each row moved to the cylinders' thresholds of eq. (41).

    Any edges that do not fall are good ones. Each moves by at most `SNAP` of a cell's height; those on the velocity
    limits stay, or states between them and the limits would be in no cell.

    Args:
        model: Enclosures of the coefficients over rows, (rows, moving, COEFFICIENTS, 4).
        setting: Scalars, (SETTINGS,).
        here: The stage's lattice, (LATTICE,).
        edges: Out: velocities [m/s], (rows, columns + 1).
    """
    coefficients = np.empty((model.shape[1], COEFFICIENTS, 3))
    height = here[L_DW]
    last = round(-2.0 * here[L_W] / height)
    moved = np.empty(edges.shape[1], np.bool_)
    for p in range(edges.shape[0]):
        for r in range(edges.shape[1]):
            edges[p, r] = here[L_W] + (here[L_J] + r) * height
        if setting[SENSING] == 0.0:
            continue
        moved[:] = False
        expand(model, p, coefficients)
        for m in range(model.shape[1]):
            for sign in (1.0, -1.0):
                w = surely_beyond(coefficients[m, A0], coefficients[m, A1], sign * setting[EPSILON], 2.0 * height)
                share = (w - here[L_W]) / height - here[L_J]
                if not -1.0 < share < edges.shape[1]:
                    continue
                r = int(np.floor(share + 0.5))
                inner = 0 <= r < edges.shape[1] and 0 < here[L_J] + r < last
                if inner and not moved[r] and abs(share - r) < SNAP:
                    edges[p, r], moved[r] = w, True


@njit(cache=True, error_model="numpy", nogil=True)
def hand_down(rows, edges, here, planes, through, finer_rows, finer_edges, finer, behind):
    """Least energy of motions up to the cells of a finer level, from the excess of the larger cells.

    A motion through a cell that takes at least so much in all has at least that, less the bound there, behind it.

    Args:
        rows, edges, here: Edges [m], [m/s], and lattice of a stage's cells, as in `place_edges`.
        planes: Their bounds of the cost to go, (rows, columns, 4).
        through: Least energy of motions through them [J], inf where they are dropped, (rows, columns).
        finer_rows, finer_edges, finer: Edges and lattice of the finer cells: some of the rows, or their halves.
        behind: Out: energy [J], inf where no cell that is kept shares a state, (finer rows, finer columns).
    """
    i = 0
    for p in range(behind.shape[0]):
        while rows[i + 1] < 0.5 * (finer_rows[p] + finer_rows[p + 1]):
            i += 1
        c = 0.5 * (finer_rows[p] + finer_rows[p + 1] - rows[i] - rows[i + 1])
        half_c = 0.5 * (finer_rows[p + 1] - finer_rows[p])
        for r in range(behind.shape[1]):
            slow, fast = finer_edges[p, r], finer_edges[p, r + 1]
            least, j = np.inf, (int(finer[L_J]) + r) // 2 - int(here[L_J])
            for q in range(max(j - 1, 0), min(j + 2, through.shape[1])):
                if through[i, q] == np.inf or edges[i, q] >= fast or edges[i, q + 1] <= slow:
                    continue
                w = 0.5 * (slow + fast - edges[i, q] - edges[i, q + 1])
                most = planes[i, q, 0] + planes[i, q, 1] * c + planes[i, q, 2] * w
                most += abs(planes[i, q, 1]) * half_c + abs(planes[i, q, 2]) * 0.5 * (fast - slow)
                least = min(least, through[i, q] - max(most, planes[i, q, 3]))
            behind[p, r] = max(least, 0.0)
