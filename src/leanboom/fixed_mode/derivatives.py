"""Compiled kernels of the fixed-mode program: variables, cost and limits, with their first and second derivatives.

A program is an optimal-control problem of two states and one control: position and velocity of the redundant
cylinder at every node (stage), its acceleration over every interval. Each end of an interval has variables of its own:
supply pressure and flows, which take the places of maxima. `modes` states a program for given modes, `interior_point`
solves it.

Coefficients of the cylinders' motion come from a table over positions, as in `bellman`; values and two derivatives by
position are those of the fifth-degree polynomial through the six nearest nodes, which are graded towards the ends.

| symbol | name | unit |
| --- | --- | --- |
| c, w, u | position, velocity, acceleration of the redundant cylinder | m, m/s, m/s^2 |
| v, a, F | velocity, acceleration, force of a cylinder | m/s, m/s^2, N |
| p, s | highest demanded pressure, flow of a cylinder | MPa, l/s |
| g, t, m | limit g >= 0, its slack, its multiplier | |
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from leanboom.compiling import njit
from leanboom.formulas.hydraulics import pump_power
from leanboom.problem.layout import A0, A1, B0, B1, B2, B3, COEFFICIENTS, COULOMB, F0, F1, F2, F3

MILLI = 1e-3  # costs are in thousandths of their units: kJ
WIDTH = 6  # nodes that a coefficient is interpolated from
GRADING = 3.5  # nodes are this much denser towards the ends, where a straight boom's coefficients grow steeply
# Rows of `Program.mode`: what a mode asks of a load, alpha p - beta F - gamma >= 0, and the direction of its friction.
SIGN, ALPHA, BETA, GAMMA = range(4)
# Rows of `Program.cylinder`.
AREA_OUT, AREA_IN, SQUARE, VISCOUS, HARDEST = range(5)
# Entries of `Program.pump`: supply without its variable part, and the shaft's coefficients.
SUPPLY, EFFICIENCY, IDLE, LEAK, DRAG = range(5)
# A quantity and its derivatives by position, velocity and control.
X, DC, DW, DU, DCC, DCW, DCU, DWW = range(8)
DERIVATIVES = 8
V, A, F = range(3)  # velocity, acceleration, force of a cylinder
C, W, U, P, S = range(5)  # an end's variables; flows are the last ones


class Limits(NamedTuple):
    """Values, slacks or multipliers of all limits, or a step of one of them."""

    node: np.ndarray  # position and velocities from below and above, (stages + 1, 2 + 2 cylinders)
    # Accelerations from below and above, loads, least pressure, flows, the pump's flow, (stages, 2, 2 + 5 cylinders).
    end: np.ndarray
    every: np.ndarray  # both in one row: the others are views of it


class Point(NamedTuple):
    """Primal variables: states, controls, supply pressures and flows."""

    state: np.ndarray  # position, velocity; (stages + 1, 2)
    control: np.ndarray  # (stages,)
    local: np.ndarray  # supply pressure and flows of both ends, (stages, 2, 1 + cylinders)
    every: np.ndarray  # all in one row: the others are views of it


@njit(cache=True, error_model="numpy")
def limits(every, stages, cylinders):
    """`Limits` over a row of numbers."""
    size = 2 + 2 * cylinders
    nodes = (stages + 1) * size
    node = every[:nodes].reshape((stages + 1, size))
    return Limits(node, every[nodes:].reshape((stages, 2, 2 + 5 * cylinders)), every)


@njit(cache=True, error_model="numpy")
def empty_limits(stages, cylinders):
    """Uninitialised `Limits`."""
    return limits(np.zeros((stages + 1) * (2 + 2 * cylinders) + stages * 2 * (2 + 5 * cylinders)), stages, cylinders)


@njit(cache=True, error_model="numpy")
def empty_point(stages, cylinders):
    """An uninitialised `Point`, for a point or a step."""
    a, b = 2 * (stages + 1), 2 * (stages + 1) + stages
    every = np.zeros(b + 2 * stages * (1 + cylinders))
    local = every[b:].reshape((stages, 2, 1 + cylinders))
    return Point(every[:a].reshape((stages + 1, 2)), every[a:b], local, every)


class Program(NamedTuple):
    """A fixed-mode program; units are m, s, MPa, l/s, kW."""

    step: float
    sensing: bool  # whether the highest demanded pressure adds to the supply
    work: bool  # whether positive work counts
    free_start: bool
    fixed_end: bool  # whether the last position is that of the guess
    table: np.ndarray  # (stages + 1, positions, cylinders, COEFFICIENTS)
    first: np.ndarray  # first position of the table [m], (stages + 1,)
    last: np.ndarray
    coulomb: np.ndarray  # friction level of each cylinder over equal steps of the stroke [N], (cylinders, steps + 1)
    stroke: np.ndarray  # ends of these [m], (2,)
    low: np.ndarray  # lower limits of position and of the cylinders' velocities, (stages + 1, 1 + cylinders)
    high: np.ndarray
    mode: np.ndarray  # (2, stages, 4, cylinders)
    base: np.ndarray  # least demanded pressure, (stages + 1,)
    flow: np.ndarray  # flow of what the path alone moves, (stages + 1,)
    most: np.ndarray  # flow that the cylinders of the program may take together, (stages + 1,)
    cylinder: np.ndarray  # (5, cylinders)
    pump: np.ndarray  # (5,)
    counts: Limits  # which limits count: others are kept by what is fixed


def graded(count):
    """Shares 0 ... 1 of the feasible extensions at which coefficients are tabulated, (count,)."""
    return 0.5 + 0.5 * np.tanh(GRADING * np.linspace(-1.0, 1.0, count)) / np.tanh(GRADING)


@njit(cache=True, error_model="numpy")
def weights(x, out):
    """Weights of six nodes 0 ... 5 for value, first and second derivative at x in node spacings, (3, 6)."""
    for i in range(WIDTH):
        value, slope, bend = 1.0, 0.0, 0.0
        for j in range(WIDTH):
            if j != i:
                per = 1.0 / (i - j)
                bend = bend * (x - j) * per + 2.0 * slope * per
                slope = slope * (x - j) * per + value * per
                value = value * (x - j) * per
        out[0, i], out[1, i], out[2, i] = value, slope, bend


@njit(cache=True, error_model="numpy")
def jets(program, position, out):
    """Coefficients and their two derivatives at a position of every node, (stages + 1, cylinders, 3, COEFFICIENTS)."""
    table, friction = program.table, program.coulomb
    weight = np.empty((3, WIDTH))
    count, steps = table.shape[1], friction.shape[1] - 1
    for k in range(position.size):
        # Share z = -1 ... 1 of the feasible extensions = tanh(GRADING x) / tanh(GRADING): nodes are equal steps of x.
        half = 0.5 * (program.last[k] - program.first[k])
        z = (position[k] - program.first[k]) / half - 1.0
        within = 1.0 if abs(z) <= 1.0 else 0.0  # beyond the ends coefficients stay as they are there
        z = min(max(z, -1.0), 1.0) if np.isfinite(z) else 0.0
        t = z * np.tanh(GRADING)
        x = np.arctanh(t) / GRADING
        stretch = np.tanh(GRADING) / (half * GRADING * (1.0 - t * t))  # dx/dc
        bend = 2.0 * GRADING * t * stretch * stretch  # d2x/dc2
        per = 0.5 * (count - 1)
        place = (x + 1.0) * per
        at = min(max(int(place) - 2, 0), count - WIDTH)
        weights(place - at, weight)
        for m in range(WIDTH):
            by_x, by_xx = within * weight[1, m] * per, within * weight[2, m] * per * per
            weight[1, m], weight[2, m] = by_x * stretch, by_xx * stretch * stretch + by_x * bend
        for i in range(table.shape[2]):
            for d in range(3):
                for j in range(COEFFICIENTS):
                    out[k, i, d, j] = 0.0
                for m in range(WIDTH):
                    for j in range(COEFFICIENTS):
                        out[k, i, d, j] += weight[d, m] * table[k, at + m, i, j]
            # Coulomb friction has kinks along the extension: lines between many nodes of its own.
            share = (position[k] - program.stroke[0]) / (program.stroke[1] - program.stroke[0]) * steps
            share = min(max(share, 0.0), steps - 1e-9) if np.isfinite(share) else 0.0
            cell = int(share)
            rise = friction[i, cell + 1] - friction[i, cell]
            out[k, i, 0, COULOMB] = friction[i, cell] + (share - cell) * rise
            out[k, i, 1, COULOMB] = rise * steps / (program.stroke[1] - program.stroke[0])
            out[k, i, 2, COULOMB] = 0.0


@njit(cache=True, error_model="numpy")
def move(program, k, e, point, jet, out):
    """Velocities, accelerations and forces of all cylinders at an end with their derivatives, (cylinders, 3, 8)."""
    w, u = point.state[k + e, W], point.control[k]
    for i in range(out.shape[0]):
        here, moved = jet[k + e, i], out[i]
        sign, viscous = program.mode[e, k, SIGN, i], program.cylinder[VISCOUS, i]
        for d, by in ((0, X), (1, DC), (2, DCC)):
            moved[V, by] = here[d, A0] + here[d, A1] * w
            moved[A, by] = here[d, B0] + w * (here[d, B1] + w * here[d, B2]) + u * here[d, B3]
            load = here[d, F0] + w * (here[d, F1] + w * here[d, F2]) + u * here[d, F3]
            # With the direction fixed, Coulomb friction is a constant: the tanh of eq. (A3) is saturated.
            moved[F, by] = load + sign * here[d, COULOMB]
        for d, by in ((0, DW), (1, DCW)):
            moved[V, by] = here[d, A1]
            moved[A, by], moved[F, by] = here[d, B1] + 2.0 * w * here[d, B2], here[d, F1] + 2.0 * w * here[d, F2]
        for d, by in ((0, DU), (1, DCU)):
            moved[V, by], moved[A, by], moved[F, by] = 0.0, here[d, B3], here[d, F3]
        moved[V, DWW], moved[A, DWW], moved[F, DWW] = 0.0, 2.0 * here[0, B2], 2.0 * here[0, F2]
        for by in range(DERIVATIVES):
            moved[F, by] += viscous * moved[V, by]


@njit(cache=True, error_model="numpy")
def flow_and_supply(program, k, e, point):
    """Pump flow [l/s] and supply pressure [MPa] at an end."""
    flow = program.flow[k + e]
    for i in range(program.table.shape[2]):
        flow += point.local[k, e, 1 + i]
    return flow, program.pump[SUPPLY] + (point.local[k, e, 0] if program.sensing else 0.0)


@njit(cache=True, error_model="numpy")
def rate(program, k, e, point, moved):
    """Rate of the cost at an end [kW or its like]."""
    total, pump = 0.0, program.pump
    for i in range(moved.shape[0]):
        total += MILLI * program.cylinder[SQUARE, i] * moved[i, V, X] ** 2
        if program.work:
            total += MILLI * program.mode[e, k, ALPHA, i] * moved[i, F, X] * moved[i, V, X]
    flow, supply = flow_and_supply(program, k, e, point)
    return total + pump_power(supply, flow, pump[EFFICIENCY], pump[IDLE], pump[LEAK], pump[DRAG])


@njit(cache=True, error_model="numpy")
def evaluate(program, point, jet, moved, value):
    """Fill in the values of all limits at a point; returns the cost [kJ or its like]."""
    stages, n = point.control.size, program.table.shape[2]
    pressure = 1.0 if program.sensing else 0.0  # whether it is a variable
    cost = 0.0
    for k in range(stages + 1):
        c, w = point.state[k, C], point.state[k, W]
        value.node[k, 0], value.node[k, 1] = c - program.low[k, 0], program.high[k, 0] - c
        for i in range(n):
            v = jet[k, i, 0, A0] + jet[k, i, 0, A1] * w
            value.node[k, 2 + 2 * i] = v - program.low[k, 1 + i]
            value.node[k, 3 + 2 * i] = program.high[k, 1 + i] - v
    for k in range(stages):
        for e in range(2):
            move(program, k, e, point, jet, moved)
            cost += 0.5 * program.step * rate(program, k, e, point, moved)
            g, p = value.end[k, e], pressure * point.local[k, e, 0]
            g[3 * n], g[5 * n + 1] = p - program.base[k + e], program.most[k + e]
            for i in range(n):
                v, a, f, s = moved[i, V, X], moved[i, A, X], moved[i, F, X], point.local[k, e, 1 + i]
                mode, hardest = program.mode[e, k, :, i], program.cylinder[HARDEST, i]
                g[2 * i], g[2 * i + 1] = hardest + a, hardest - a
                g[2 * n + i] = mode[ALPHA] * p - mode[BETA] * f - mode[GAMMA]
                g[3 * n + 1 + 2 * i] = s - program.cylinder[AREA_OUT, i] * v
                g[3 * n + 2 + 2 * i] = s + program.cylinder[AREA_IN, i] * v
                g[5 * n + 1] -= s
    return cost


@njit(cache=True, error_model="numpy")
def change_limits(program, point, jet, step, moved, change):
    """Fill in the change of all limits along a step, to first order."""
    stages, n = point.control.size, moved.shape[0]
    pressure = 1.0 if program.sensing else 0.0
    for k in range(stages + 1):
        c, w = step.state[k, C], step.state[k, W]
        change.node[k, 0], change.node[k, 1] = c, -c
        for i in range(n):
            here = jet[k, i]
            v = (here[1, A0] + here[1, A1] * point.state[k, W]) * c + here[0, A1] * w
            change.node[k, 2 + 2 * i], change.node[k, 3 + 2 * i] = v, -v
    for k in range(stages):
        for e in range(2):
            move(program, k, e, point, jet, moved)
            c, w, u, p = step.state[k + e, C], step.state[k + e, W], step.control[k], pressure * step.local[k, e, 0]
            g = change.end[k, e]
            g[3 * n], g[5 * n + 1] = p, 0.0
            for i in range(n):
                v = moved[i, V, DC] * c + moved[i, V, DW] * w
                a = moved[i, A, DC] * c + moved[i, A, DW] * w + moved[i, A, DU] * u
                f = moved[i, F, DC] * c + moved[i, F, DW] * w + moved[i, F, DU] * u
                g[2 * i], g[2 * i + 1] = a, -a
                g[2 * n + i] = program.mode[e, k, ALPHA, i] * p - program.mode[e, k, BETA, i] * f
                g[3 * n + 1 + 2 * i] = step.local[k, e, 1 + i] - program.cylinder[AREA_OUT, i] * v
                g[3 * n + 2 + 2 * i] = step.local[k, e, 1 + i] + program.cylinder[AREA_IN, i] * v
                g[5 * n + 1] -= step.local[k, e, 1 + i]


@njit(cache=True, error_model="numpy")
def add_product(matrix, vector, share, one, other):
    """Add the derivatives of share x one x other, without the second derivatives of the two factors."""
    for x, d in ((C, DC), (W, DW), (U, DU)):
        vector[x] += share * (one[X] * other[d] + other[X] * one[d])
        for y, b in ((C, DC), (W, DW), (U, DU)):
            if y <= x:
                matrix[x, y] += share * (one[d] * other[b] + other[d] * one[b])


@njit(cache=True, error_model="numpy")
def add_power(program, k, e, point, matrix, vector):
    """Add the pump's power x half a step and its derivatives by pressure and flows."""
    n, pump, half = program.table.shape[2], program.pump, 0.5 * program.step
    flow, supply = flow_and_supply(program, k, e, point)
    by_flow = half * (supply / pump[EFFICIENCY] + 2.0 * pump[DRAG] * flow)
    bend, mixed = half * 2.0 * pump[DRAG], half / pump[EFFICIENCY] if program.sensing else 0.0
    if program.sensing:
        vector[P] += half * (flow / pump[EFFICIENCY] + pump[LEAK])
    for i in range(n):
        vector[S + i] += by_flow
        matrix[S + i, P] += mixed
        for other in range(i + 1):
            matrix[S + i, S + other] += bend


@njit(cache=True, error_model="numpy")
def add_cost(program, k, e, point, moved, matrix, vector, bends):
    """Add the cost x half a step and its derivatives; `bends` gets its slopes by the cylinders' quantities."""
    share = 0.5 * program.step * MILLI
    for i in range(moved.shape[0]):
        square = share * program.cylinder[SQUARE, i]
        if square != 0.0:
            bends[i, V] += 2.0 * square * moved[i, V, X]
            add_product(matrix, vector, square, moved[i, V], moved[i, V])
        if program.work:
            loaded = share * program.mode[e, k, ALPHA, i]
            bends[i, V] += loaded * moved[i, F, X]
            bends[i, F] += loaded * moved[i, V, X]
            add_product(matrix, vector, loaded, moved[i, F], moved[i, V])
    add_power(program, k, e, point, matrix, vector)


@njit(cache=True, error_model="numpy")
def pull_of(value, slack, multiplier, barrier):
    """Factor of a limit's gradient in the condensed gradient, with opposite sign."""
    return (barrier - multiplier * (value - slack)) / slack


@njit(cache=True, error_model="numpy")
def assemble_ends(program, point, jet, value, slack, multiplier, barrier, moved, bends, matrices, vectors):
    """Newton's matrices (lower triangles) and gradients of the ends' condensed costs, by c, w, u, p and flows there.

    A limit adds multiplier / slack x its gradient squared, less its pull x gradient and multiplier x curvature.

    Args:
        program, point, jet: The problem, a point and the coefficients there.
        value, slack, multiplier: Of the limits.
        barrier: The barrier.
        moved, bends: Room for one end's quantities and their slopes.
        matrices: Out, (stages, 2, 4 + cylinders, 4 + cylinders).
        vectors: Out, (stages, 2, 4 + cylinders).
    """
    n = moved.shape[0]
    for k in range(point.control.size):
        for e in range(2):
            matrix, vector = matrices[k, e], vectors[k, e]
            for x in range(vector.size):
                vector[x] = 0.0
                for y in range(x + 1):
                    matrix[x, y] = 0.0
            for i in range(n):
                bends[i, V] = bends[i, A] = bends[i, F] = 0.0
            move(program, k, e, point, jet, moved)
            add_cost(program, k, e, point, moved, matrix, vector, bends)
            counts, g, t, m = program.counts.end[k, e], value.end[k, e], slack.end[k, e], multiplier.end[k, e]
            j = 3 * n
            if counts[j]:
                matrix[P, P] += m[j] / t[j]
                vector[P] -= pull_of(g[j], t[j], m[j], barrier)
            else:
                matrix[P, P] = 1.0  # no variable of this cost
            cc = wc = ww = uc = uw = uu = at_c = at_w = at_u = 0.0
            for i in range(n):
                v_c, v_w = moved[i, V, DC], moved[i, V, DW]
                a_c, a_w, a_u = moved[i, A, DC], moved[i, A, DW], moved[i, A, DU]
                f_c, f_w, f_u = moved[i, F, DC], moved[i, F, DW], moved[i, F, DU]
                # Acceleration from below and above: the same gradient but for its sign.
                j = 2 * i
                if counts[j]:
                    weight = m[j] / t[j] + m[j + 1] / t[j + 1]
                    pull = pull_of(g[j], t[j], m[j], barrier) - pull_of(g[j + 1], t[j + 1], m[j + 1], barrier)
                    bends[i, A] -= m[j] - m[j + 1]
                    at_c, at_w, at_u = at_c - pull * a_c, at_w - pull * a_w, at_u - pull * a_u
                    cc, wc, ww = cc + weight * a_c * a_c, wc + weight * a_w * a_c, ww + weight * a_w * a_w
                    uc, uw, uu = uc + weight * a_u * a_c, uw + weight * a_u * a_w, uu + weight * a_u * a_u
                # Load: alpha p - beta F.
                j = 2 * n + i
                if counts[j]:
                    beta, alpha = program.mode[e, k, BETA, i], program.mode[e, k, ALPHA, i] if program.sensing else 0.0
                    weight, pull = m[j] / t[j], pull_of(g[j], t[j], m[j], barrier)
                    bends[i, F] += beta * m[j]
                    vector[P] -= pull * alpha
                    matrix[P, P] += weight * alpha * alpha
                    mixed = weight * alpha * beta
                    matrix[P, C] -= mixed * f_c
                    matrix[P, W] -= mixed * f_w
                    matrix[P, U] -= mixed * f_u
                    weight, pull = weight * beta * beta, -pull * beta
                    at_c, at_w, at_u = at_c - pull * f_c, at_w - pull * f_w, at_u - pull * f_u
                    cc, wc, ww = cc + weight * f_c * f_c, wc + weight * f_w * f_c, ww + weight * f_w * f_w
                    uc, uw, uu = uc + weight * f_u * f_c, uw + weight * f_u * f_w, uu + weight * f_u * f_u
                # Flow: s - A v and s + B v.
                j = 3 * n + 1 + 2 * i
                if counts[j]:
                    out, back = -program.cylinder[AREA_OUT, i], program.cylinder[AREA_IN, i]
                    weight_out, weight_in = m[j] / t[j], m[j + 1] / t[j + 1]
                    pull_out = pull_of(g[j], t[j], m[j], barrier)
                    pull_in = pull_of(g[j + 1], t[j + 1], m[j + 1], barrier)
                    bends[i, V] -= out * m[j] + back * m[j + 1]
                    vector[S + i] -= pull_out + pull_in
                    matrix[S + i, S + i] += weight_out + weight_in
                    mixed = weight_out * out + weight_in * back
                    matrix[S + i, C] += mixed * v_c
                    matrix[S + i, W] += mixed * v_w
                    weight, pull = weight_out * out * out + weight_in * back * back, pull_out * out + pull_in * back
                    at_c, at_w = at_c - pull * v_c, at_w - pull * v_w
                    cc, wc, ww = cc + weight * v_c * v_c, wc + weight * v_w * v_c, ww + weight * v_w * v_w
                else:
                    matrix[S + i, S + i] = 1.0
                for q in range(3):
                    share = bends[i, q]
                    cc, wc = cc + share * moved[i, q, DCC], wc + share * moved[i, q, DCW]
                    ww, uc = ww + share * moved[i, q, DWW], uc + share * moved[i, q, DCU]
            # The pump's flow: most - sum of s.
            j = 5 * n + 1
            if counts[j]:
                weight, pull = m[j] / t[j], pull_of(g[j], t[j], m[j], barrier)
                for i in range(n):
                    vector[S + i] += pull
                    for other in range(i + 1):
                        matrix[S + i, S + other] += weight
            vector[C] += at_c
            vector[W] += at_w
            vector[U] += at_u
            matrix[C, C] += cc
            matrix[W, C] += wc
            matrix[W, W] += ww
            matrix[U, C] += uc
            matrix[U, W] += uw
            matrix[U, U] += uu


@njit(cache=True, error_model="numpy")
def assemble_nodes(program, point, jet, value, slack, multiplier, barrier, matrices, vectors):
    """Newton's matrices (lower triangles) and gradients of the limits of the nodes, by their position and velocity.

    Args:
        program, point, jet, value, slack, multiplier, barrier: As in `assemble_ends`.
        matrices: Out, (stages + 1, 2, 2).
        vectors: Out, (stages + 1, 2).
    """
    for k in range(point.control.size + 1):
        w, matrix, vector = point.state[k, W], matrices[k], vectors[k]
        counts, g, t, m = program.counts.node[k], value.node[k], slack.node[k], multiplier.node[k]
        vector[C] = vector[W] = matrix[C, C] = matrix[W, C] = matrix[W, W] = 0.0
        for i in range(1 + program.table.shape[2]):
            j = 2 * i
            if not counts[j]:
                continue
            by_c, by_w, bend, mixed = 1.0, 0.0, 0.0, 0.0
            if i > 0:
                here = jet[k, i - 1]
                by_c, by_w, mixed = here[1, A0] + here[1, A1] * w, here[0, A1], here[1, A1]
                bend = here[2, A0] + here[2, A1] * w
            weight, lean = m[j] / t[j] + m[j + 1] / t[j + 1], m[j] - m[j + 1]
            pull = pull_of(g[j], t[j], m[j], barrier) - pull_of(g[j + 1], t[j + 1], m[j + 1], barrier)
            vector[C] -= pull * by_c
            vector[W] -= pull * by_w
            matrix[C, C] += weight * by_c * by_c - lean * bend
            matrix[W, C] += weight * by_c * by_w - lean * mixed
            matrix[W, W] += weight * by_w * by_w
