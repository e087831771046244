"""Saturation in the null space for any number of joints (Flacco, De Luca, Khatib, ICRA 2012).

What `leanboom.methods.pseudo_inverse` answers in closed form for one redundant joint is compared with it.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog

from leanboom.errors import InfeasibleError, InputError
from leanboom.methods.pseudo_inverse import SMALL


def sns(
    jacobian: np.ndarray,
    task_velocity: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    weights: np.ndarray | None = None,
) -> tuple[np.ndarray, float]:
    """Joint velocities of least norm for a task, inside a box: saturation in the null space with task scaling.

    The algorithm of the paper saturates the most critical joint until the rest fits, and never frees a joint again.
    That greedy order can miss a velocity that follows the task; then a linear programme finds the largest scale
    and saturated joints that pull the wrong way are freed, so a scale below 1 means that the box has no better.
    Otherwise its answer is returned as it is; with two or more redundant joints its norm need not be the least.

    Args:
        jacobian: Task velocity per joint velocity, (tasks, joints), tasks <= joints, full rank.
        task_velocity: Wanted task velocity, (tasks,).
        lower: Least joint velocities [rad/s or m/s], (joints,).
        upper: Largest joint velocities, (joints,).
        weights: Diagonal of the weights W of the norm q' W q, above 0, (joints,); None: all 1.

    Returns:
        The joint velocities, (joints,), and the scale in [0, 1] of the task velocity that they give.

    Raises:
        InputError: If shapes do not fit, the jacobian lacks rank, a weight is not positive, or bounds contradict.
        InfeasibleError: If not even scale 0 is inside the box.
    """
    jacobian = np.atleast_2d(np.asarray(jacobian, dtype=np.float64))
    rows, joints = jacobian.shape
    wanted = np.asarray(task_velocity, dtype=np.float64).reshape(-1)
    lower, upper = np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64)
    inverse = 1.0 / np.asarray(np.ones(joints) if weights is None else weights, dtype=np.float64)
    if wanted.shape != (rows,) or lower.shape != (joints,) or upper.shape != (joints,) or inverse.shape != (joints,):
        raise InputError(
            f"jacobian is {rows}x{joints}; needs a task velocity of {rows} and bounds and weights of {joints} values"
        )
    if not np.all((inverse > 0.0) & np.isfinite(inverse)):
        raise InputError("weights must be above 0")
    if np.linalg.matrix_rank(jacobian) < rows:
        raise InputError("the rows of the jacobian depend on each other")
    if np.any(lower > upper):
        raise InputError(f"lower bound of joint {int(np.argmax(lower > upper))} is above its upper bound")
    free = np.ones(joints)  # the diagonal matrix W of the SNS paper: 0 where a joint is saturated
    held = np.zeros(joints)  # velocities of saturated joints
    best = 0.0, free.copy(), held.copy()
    while True:
        right = _right_inverse(jacobian, inverse * free)
        along = right @ wanted
        offset = held - right @ (jacobian @ held)
        velocity = along + offset
        outside = np.maximum(lower - velocity, velocity - upper) > SMALL
        if not outside.any():
            return np.clip(velocity, lower, upper), 1.0
        scale, critical = _task_scale(along, offset, lower, upper)
        if scale > best[0]:
            best = scale, free.copy(), held.copy()
        free[critical] = 0.0
        held[critical] = upper[critical] if velocity[critical] > upper[critical] else lower[critical]
        if np.linalg.matrix_rank(jacobian * free) < rows:
            break
    return _scaled(jacobian, wanted, lower, upper, inverse, best)


def _right_inverse(jacobian: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """Weighted right pseudo-inverse, eq. (9) of the 3-DOF paper; `inverse` is the diagonal of W^-1, (joints,)."""
    weighted = inverse[:, None] * jacobian.T
    return weighted @ np.linalg.inv(jacobian @ weighted)


def _task_scale(along, offset, lower, upper) -> tuple[float, int]:
    """Largest task scale at which along x scale + offset is inside the box, and the joint that limits it most."""
    least, most = np.zeros(along.size), np.full(along.size, np.inf)
    moves = np.abs(along) > SMALL
    ends = np.stack([lower - offset, upper - offset])[:, moves] / along[moves]
    least[moves], most[moves] = ends.min(axis=0), ends.max(axis=0)
    # A joint that the task does not move can only be critical by itself.
    stuck = ~moves & (np.maximum(lower - offset, offset - upper) > SMALL)
    most[stuck] = -1.0
    critical = int(np.argmin(most))
    scale = min(float(most[critical]), 1.0)
    if scale < 0.0 or least.max() > scale:
        return 0.0, critical
    return scale, critical


def _scaled(jacobian, wanted, lower, upper, inverse, greedy) -> tuple[np.ndarray, float]:
    """The answer after the greedy saturation has used up its joints: its best scale, or a larger one if there is."""
    rows, joints = jacobian.shape
    answer = linprog(
        np.append(np.zeros(joints), -1.0),
        A_eq=np.hstack([jacobian, -wanted[:, None]]),
        b_eq=np.zeros(rows),
        bounds=[*zip(lower, upper, strict=True), (0.0, 1.0)],
    )
    if answer.x is None:
        raise InfeasibleError("no velocity inside the bounds moves the tool along its task or holds it still")
    scale, free, held = greedy
    if scale > 0.0 and answer.x[-1] <= scale + 1e-9:
        right = _right_inverse(jacobian, inverse * free)
        velocity = held + right @ (scale * wanted - jacobian @ held)
        return np.clip(velocity, lower, upper), scale
    vertex = np.clip(answer.x[:-1], lower, upper)
    return _least_norm(jacobian, lower, upper, inverse, vertex), float(answer.x[-1])


def _least_norm(jacobian, lower, upper, inverse, velocity) -> np.ndarray:
    """Least norm inside the box among the velocities that move the tool as a given one does (active-set method)."""
    weights = 1.0 / inverse
    held = (velocity <= lower + SMALL) | (velocity >= upper - SMALL)
    for _ in range(20 * velocity.size):
        columns = jacobian[:, ~held]
        _, values, rows = np.linalg.svd(columns) if columns.size else (None, np.zeros(0), np.zeros((0, 0)))
        null = rows[int(np.sum(values > 1e-10)) :].T  # motions of the free joints that leave the tool alone
        step = np.zeros_like(velocity)
        if null.size:
            curvature = null.T @ (weights[~held, None] * null)
            step[~held] = -null @ np.linalg.solve(curvature, null.T @ (weights * velocity)[~held])
        if np.max(np.abs(step), initial=0.0) > SMALL:
            room = np.where(step > 0.0, upper - velocity, lower - velocity)
            share = np.where(np.abs(step) > SMALL, room / np.where(step == 0.0, 1.0, step), np.inf)
            first = int(np.argmin(share))
            velocity = velocity + min(1.0, float(share[first])) * step
            if share[first] <= 1.0:
                held[first] = True
            continue
        # Multipliers of the held joints: free the one that is pulled inwards most.
        gradient = weights * velocity
        dual = np.linalg.lstsq(columns.T, gradient[~held], rcond=None)[0] if columns.size else np.zeros(len(jacobian))
        pull = (gradient - jacobian.T @ dual) * np.where(velocity <= lower + SMALL, -1.0, 1.0)
        pull[~held | (upper - lower <= SMALL)] = 0.0
        if pull.max() <= 1e-10:
            break
        held[int(np.argmax(pull))] = False
    return np.clip(velocity, lower, upper)
