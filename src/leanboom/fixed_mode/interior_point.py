"""Compiled primal-dual interior-point method for the fixed-mode program, with a Riccati recursion for Newton's step.

Everything a general solver does for such a problem has a short form here: what belongs to an end of an interval
alone is eliminated there, a backward recursion (Riccati) eliminates control after control, and the curvature
that remains by each control tells whether a step leads towards a minimum. An iteration costs a few microseconds a
stage.

Dynamics are linear and hold from the first guess on. A limit g >= 0 has a slack t > 0 and a multiplier m; the step is
Newton's for g = t, t m = barrier and stationarity (Nocedal and Wright, Numerical Optimization, chapter 19). It goes
as far as slacks and multipliers stay positive and is halved until an l1 merit falls; one that fails at once is first
corrected for the curvature of the limits (second-order correction). Where the curvature has the wrong sign it is
shifted. The barrier falls when its problem is solved.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from leanboom.compiling import njit
from leanboom.fixed_mode.derivatives import (
    DERIVATIVES,
    C,
    Limits,
    P,
    Point,
    U,
    W,
    assemble_ends,
    assemble_nodes,
    change_limits,
    empty_limits,
    empty_point,
    evaluate,
    jets,
    pull_of,
)  # fmt: skip
from leanboom.problem.layout import COEFFICIENTS

BOUNDARY = 0.995  # share of the way to the nearest limit that a step may go
SMALLEST_SLACK = 1e-4  # of the first guess
BARRIER_FACTOR, SOLVED = 0.1, 10.0  # the barrier falls once errors are below this many times it
OPTIMAL, ACCEPTABLE = 1e-5, 1e-4  # sum of all limits' errors: of an answer; of one from which no better was found
FIRST_PENALTY, SUFFICIENT, NOISE = 1e-3, 1e-4, 1e-10  # of errors; share of a promised fall; the merit's rounding
HALVINGS = 12
FIRST_SHIFT, LARGEST_SHIFT, GROWTH = 1e-6, 1e6, 10.0
LARGEST_PENALTY = 1e4
MULTIPLIER_RANGE = 1e8  # multipliers stay within this factor of barrier / slack


class Eliminated(NamedTuple):
    """Newton's step of the eliminated variables (local ones, controls) as affine functions of those that remain."""

    rows: np.ndarray  # pivot rows of the locals, (stages, 2, 1 + cylinders, 4 + cylinders)
    pulls: np.ndarray  # their right sides over pivots
    gain: np.ndarray  # of the controls, (stages, 2)
    push: np.ndarray  # (stages,)
    matrix: np.ndarray  # of the ends' condensed cost, (stages, 2, 4 + cylinders, 4 + cylinders)
    gradient: np.ndarray  # (stages, 2, 4 + cylinders)
    node_matrix: np.ndarray  # of the nodes', (stages + 1, 2, 2)
    node_gradient: np.ndarray  # (stages + 1, 2)


class Place(NamedTuple):
    """A point, its coefficients, values of the limits, and slacks."""

    point: Point
    jet: np.ndarray  # coefficients, see `derivatives.jets`
    value: Limits
    slack: Limits


class Work(NamedTuple):
    """Scratch arrays of the method."""

    moved: np.ndarray  # (cylinders, 3, DERIVATIVES)
    bends: np.ndarray  # (cylinders, 3)
    change: Limits
    out: Eliminated


@njit(cache=True, error_model="numpy")
def eliminate_locals(matrix, vector, rows, pulls):
    """Eliminate pressure and flows from an end's matrix; False where that is not a minimum in them."""
    size = vector.size
    for j in range(size - 1, U, -1):
        pivot = matrix[j, j]
        if not pivot > 0.0:
            return False
        per = 1.0 / pivot
        pulls[j - P] = vector[j] * per
        for a in range(j):
            rows[j - P, a] = matrix[j, a] * per
        for a in range(j):
            vector[a] -= matrix[j, a] * pulls[j - P]
            for b in range(a + 1):
                matrix[a, b] -= matrix[j, a] * rows[j - P, b]
    return True


@njit(cache=True, error_model="numpy")
def eliminate(program, place, value, multiplier, barrier, shift, work):
    """Riccati recursion backward in time: eliminate all variables but the start position.

    Returns:
        Whether the step leads towards a minimum, and its change of the start's position.
    """
    point, jet, slack, moved, bends, out = place.point, place.jet, place.slack, work.moved, work.bends, work.out
    stages, size, ts = point.control.size, 4 + program.table.shape[2], program.step
    arguments = program, point, jet, value, slack, multiplier, barrier
    assemble_ends(*arguments, moved, bends, out.matrix, out.gradient)
    assemble_nodes(*arguments, out.node_matrix, out.node_gradient)
    vector = np.empty(size)
    h = 0.5 * ts * ts
    acc = awc = aww = auc = auw = auu = ac = aw = au = 0.0  # of what is left at the node, and of the control
    for k in range(stages - 1, -1, -1):
        node, pull = out.node_matrix[k + 1], out.node_gradient[k + 1]
        acc, awc, aww = acc + node[C, C], awc + node[W, C], aww + node[W, W]
        ac, aw = ac + pull[C], aw + pull[W]
        auc = auw = auu = au = 0.0
        for e in (1, 0):
            if e == 0:
                # From c', w', u to c, w, u through c' = c + ts w + h u, w' = w + ts u.
                auc, auw, auu = (
                    h * acc + ts * awc + auc,
                    ts * (h * acc + ts * awc + auc) + h * awc + ts * aww + auw,
                    h * (h * acc + 2.0 * (ts * awc + auc)) + ts * (ts * aww + 2.0 * auw) + auu,
                )
                awc, aww = ts * acc + awc, ts * ts * acc + 2.0 * ts * awc + aww
                aw, au = ts * ac + aw, h * ac + ts * aw + au
                acc, aww, auu = acc + shift, aww + shift, auu + shift
            matrix = out.matrix[k, e]
            for j in range(size):
                vector[j] = out.gradient[k, e, j]
            for j in range(P, size):
                matrix[j, j] += shift
            if not eliminate_locals(matrix, vector, out.rows[k, e], out.pulls[k, e]):
                return False, 0.0
            acc, awc, aww = acc + matrix[C, C], awc + matrix[W, C], aww + matrix[W, W]
            auc, auw, auu = auc + matrix[U, C], auw + matrix[U, W], auu + matrix[U, U]
            ac, aw, au = ac + vector[C], aw + vector[W], au + vector[U]
        gain_c, gain_w, push = 0.0, -1.0 / ts, 0.0  # the last control ends at rest
        if k < stages - 1:
            if not auu > 0.0:
                return False, 0.0
            gain_c, gain_w, push = -auc / auu, -auw / auu, -au / auu
            if k == stages - 2 and program.fixed_end:  # the last two controls lead to the end, at rest
                gain_c, gain_w, push = -1.0 / (ts * ts), -1.5 / ts, 0.0
        out.gain[k, 0], out.gain[k, 1], out.push[k] = gain_c, gain_w, push
        ac, aw = ac + auc * push + gain_c * (au + auu * push), aw + auw * push + gain_w * (au + auu * push)
        acc, awc, aww = (
            acc + 2.0 * auc * gain_c + auu * gain_c * gain_c,
            awc + auc * gain_w + auw * gain_c + auu * gain_c * gain_w,
            aww + 2.0 * auw * gain_w + auu * gain_w * gain_w,
        )
    if not program.free_start:
        return True, 0.0
    curvature = acc + out.node_matrix[0, C, C]
    return curvature > 0.0, -(ac + out.node_gradient[0, C]) / curvature


@njit(cache=True, error_model="numpy")
def substitute(program, first, out, step):
    """Forward pass: the whole step from the start's; returns the slope of the condensed cost along it."""
    stages, size, ts = step.control.size, 4 + program.table.shape[2], program.step
    slope = 0.0
    step.state[0, C], step.state[0, W] = first, 0.0
    for k in range(stages):
        c, w = step.state[k, C], step.state[k, W]
        u = out.gain[k, 0] * c + out.gain[k, 1] * w + out.push[k]
        step.control[k] = u
        step.state[k + 1, C] = c + ts * w + 0.5 * ts * ts * u
        step.state[k + 1, W] = w + ts * u if k < stages - 1 else 0.0
    for k in range(stages + 1):
        slope += out.node_gradient[k, C] * step.state[k, C] + out.node_gradient[k, W] * step.state[k, W]
    vector = np.empty(size)
    for k in range(stages):
        for e in range(2):
            vector[C], vector[W], vector[U] = step.state[k + e, C], step.state[k + e, W], step.control[k]
            for j in range(P, size):
                total = out.pulls[k, e, j - P]
                for a in range(j):
                    total += out.rows[k, e, j - P, a] * vector[a]
                vector[j] = -total
                step.local[k, e, j - P] = -total
            for a in range(size):
                slope += out.gradient[k, e, a] * vector[a]
    return slope


@njit(cache=True, error_model="numpy")
def step_limits(value, slack, multiplier, change, counts, barrier, slack_step, turn):
    """Steps of slacks and multipliers, given the limits' change; returns what pulls add to the condensed slope."""
    slope = 0.0
    for j in range(value.size):
        if counts[j]:
            slack_step[j] = change[j] + value[j] - slack[j]
            turn[j] = (barrier - multiplier[j] * (slack[j] + slack_step[j])) / slack[j]
            slope += pull_of(value[j], slack[j], multiplier[j], barrier) * change[j]
    return slope


@njit(cache=True, error_model="numpy")
def newton(program, place, value, multiplier, barrier, shift, work, step, slack_step, turn):
    """Newton's step from a place, for given values of the limits there.

    Returns:
        Whether it leads towards a minimum, and the cost's slope along it.
    """
    good, first = eliminate(program, place, value, multiplier, barrier, shift, work)
    if not good:
        return False, 0.0
    slope = substitute(program, first, work.out, step)
    change_limits(program, place.point, place.jet, step, work.moved, work.change)
    slope += step_limits(
        value.every, place.slack.every, multiplier.every, work.change.every, program.counts.every, barrier,
        slack_step.every, turn.every,
    )  # fmt: skip
    return True, slope


@njit(cache=True, error_model="numpy")
def furthest(value, step, counts):
    """The largest share of a step that keeps positive numbers positive, with a margin."""
    share = 1.0
    for j in range(value.size):
        if counts[j] and step[j] < 0.0:
            share = min(share, -BOUNDARY * value[j] / step[j])
    return share


@njit(cache=True, error_model="numpy")
def survey(value, slack, multiplier, slack_step, counts, barrier):
    """Sums and maxima over all limits.

    Returns:
        Sum of |g - t|, largest |t m - barrier|, sum of log t, its change by the slacks' step.
    """
    broken = off = logarithms = change = 0.0
    for j in range(value.size):
        if counts[j]:
            broken += abs(value[j] - slack[j])
            off = max(off, abs(slack[j] * multiplier[j] - barrier))
            logarithms += np.log(slack[j])
            change += slack_step[j] / slack[j]
    return broken, off, logarithms, change


@njit(cache=True, error_model="numpy")
def go(program, start, slack, step, slack_step, share, barrier, penalty, moved, end):
    """The place after a share of a step; returns the cost and the merit there."""
    for j in range(start.every.size):
        end.point.every[j] = start.every[j] + share * step.every[j]
    jets(program, end.point.state[:, C], end.jet)
    cost = evaluate(program, end.point, end.jet, moved, end.value)
    merit = cost
    value, counts, there = end.value.every, program.counts.every, end.slack.every
    for j in range(value.size):
        if counts[j]:
            # A slack below its limit's value is free to be it: the merit falls.
            there[j] = max(slack[j] + share * slack_step[j], value[j])
            merit += penalty * (there[j] - value[j]) - barrier * np.log(there[j])
    return cost, merit


@njit(cache=True, error_model="numpy")
def settle(multiplier, step, share, slack, counts, barrier):
    """Step the multipliers, but keep each within a factor of the barrier over its slack."""
    for j in range(slack.size):
        if counts[j]:
            near = barrier / slack[j]
            multiplier[j] = min(max(multiplier[j] + share * step[j], near / MULTIPLIER_RANGE), near * MULTIPLIER_RANGE)


@njit(cache=True, error_model="numpy")
def empty_place(stages, cylinders):
    """An uninitialised `Place`."""
    return Place(
        empty_point(stages, cylinders), np.empty((stages + 1, cylinders, 3, COEFFICIENTS)),
        empty_limits(stages, cylinders), empty_limits(stages, cylinders),
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def empty_work(stages, cylinders):
    """Scratch arrays of the method."""
    n = 1 + cylinders
    out = Eliminated(
        np.empty((stages, 2, n, 3 + n)), np.empty((stages, 2, n)), np.empty((stages, 2)), np.empty(stages),
        np.empty((stages, 2, 3 + n, 3 + n)), np.empty((stages, 2, 3 + n)), np.empty((stages + 1, 2, 2)),
        np.empty((stages + 1, 2)),
    )  # fmt: skip
    return Work(np.empty((cylinders, 3, DERIVATIVES)), np.empty((cylinders, 3)), empty_limits(stages, cylinders), out)


@njit(cache=True, error_model="numpy", nogil=True)
def minimise(program, guess, barrier, last_barrier, iterations):
    """Minimise a program's cost.

    Args:
        program: The `Program`.
        guess: A point that keeps the dynamics and ends at rest.
        barrier: First barrier, in the cost's unit.
        last_barrier: Last barrier: every limit that is met costs about this much.
        iterations: Most iterations.

    Returns:
        The answer, whether it is optimal, the iterations taken.
    """
    stages, n = guess.control.size, program.table.shape[2]
    here, there, work = empty_place(stages, n), empty_place(stages, n), empty_work(stages, n)
    step, bent, wanted = empty_point(stages, n), empty_point(stages, n), empty_limits(stages, n)
    slack_step, bent_slack = empty_limits(stages, n), empty_limits(stages, n)
    multiplier, turn, bent_turn = empty_limits(stages, n), empty_limits(stages, n), empty_limits(stages, n)
    counts = program.counts.every
    step.every[:], slack_step.every[:] = 0.0, 0.0  # no step yet, whatever this memory held
    for j in range(counts.size):
        here.slack.every[j] = SMALLEST_SLACK
    cost, _ = go(program, guess, here.slack.every, step, slack_step.every, 0.0, barrier, 0.0, work.moved, here)
    for j in range(counts.size):
        multiplier.every[j] = barrier / here.slack.every[j]
    penalty, shift, broken = FIRST_PENALTY, 0.0, np.inf
    for iteration in range(iterations):
        slack = here.slack.every
        last_shift, shift, good, slope = shift, 0.0, False, 0.0
        while not good:
            good, slope = newton(program, here, here.value, multiplier, barrier, shift, work, step, slack_step, turn)
            if not good:
                shift = max(FIRST_SHIFT, last_shift / GROWTH) if shift == 0.0 else GROWTH * shift
                if shift > LARGEST_SHIFT:
                    return here.point, False, iteration
        broken, off, logarithms, change = survey(
            here.value.every, slack, multiplier.every, slack_step.every, counts, barrier
        )
        slope -= barrier * change
        if broken > 0.0:
            penalty = max(penalty, 2.0 * slope / broken)
        if penalty > LARGEST_PENALTY:
            return here.point, False, iteration  # limits that contradict each other nearby
        merit, promise = cost - barrier * logarithms + penalty * broken, slope - penalty * broken
        if broken <= max(SOLVED * barrier, OPTIMAL) and off <= SOLVED * barrier and -promise <= SOLVED * barrier:
            if barrier <= last_barrier:
                return here.point, True, iteration
            barrier = max(last_barrier, BARRIER_FACTOR * barrier)
            penalty = FIRST_PENALTY
            continue
        share = furthest(slack, slack_step.every, counts)
        asked, then, accepted = merit + NOISE * abs(merit), cost, False
        for trial in range(HALVINGS + 1):
            if trial == 1:
                # The step that meets the limits' curvature as well.
                for j in range(counts.size):
                    wanted.every[j] = there.value.every[j] - there.slack.every[j] + (
                        slack[j] + share * (here.value.every[j] - slack[j])
                    )  # fmt: skip
                newton(program, here, wanted, multiplier, barrier, shift, work, bent, bent_slack, bent_turn)
            far = furthest(slack, bent_slack.every, counts) if trial == 1 else share
            way, slack_way = (bent, bent_slack) if trial == 1 else (step, slack_step)
            then, merit_then = go(
                program, here.point, slack, way, slack_way.every, far, barrier, penalty, work.moved, there
            )
            accepted = merit_then <= asked + SUFFICIENT * share * promise
            if accepted:
                break
            share *= 0.5 if trial > 0 else 1.0
        if not accepted:
            return here.point, barrier <= last_barrier and broken <= ACCEPTABLE, iteration
        ahead = furthest(multiplier.every, turn.every, counts)
        here, there, cost = there, here, then
        settle(multiplier.every, turn.every, ahead, here.slack.every, counts, barrier)
    return here.point, barrier <= last_barrier and broken <= ACCEPTABLE, iterations
