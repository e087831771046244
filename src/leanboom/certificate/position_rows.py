"""Intervals of positions that rows of cells cover: their edges, and enclosures of coefficients over them.

Rows are narrower near the best known motion, narrowest where it is near an end of the feasible extensions. Which rows
are chosen has no part in the proof of a bound.
"""

from __future__ import annotations

import numpy as np

from leanboom.certificate import taylor_model
from leanboom.certificate.taylor_model import Enclosure
from leanboom.model import crane as cranes
from leanboom.model.motion import Motion
from leanboom.problem import layout
from leanboom.problem.legs import Legs
from leanboom.problem.stages import Problem

POSITION = 0.006  # [m], largest width of a row of the first level
NEAR_MOTION = 0.1  # [m], from a motion to which rows beside it are narrower
NEAR_END, NARROWEST = 0.02, 16  # [m], from an end to which a motion's rows are so many times narrower, and cells lower
OUTERMOST = 64  # how many times narrower the outermost row of a coarse level is: an end may be near a singular pose
# How many times narrower rows and lower cells are there; where power jumps with velocity (LS), rows do more.
FINER = {"cp": (4, 4), "ls": (8, 2)}
LEAST_RANGE = 1e-9  # [m], least range of a stage's positions
AT_ONCE = 8192  # rows enclosed together: what their formulas need in between stays in the processor's caches
UNKNOWN = 1e30  # error of a coefficient that cannot be enclosed over a cell


def from_end(legs: Legs, k: int | slice, position: np.ndarray) -> np.ndarray:
    """Distances of positions from the next end of their stage's feasible extensions [m]."""
    return np.minimum(position - legs.lower[k], legs.upper[k] - position)


def whole(legs: Legs, k: int, positions: int, beside: Motion | None, narrower: int, ends: bool = False) -> np.ndarray:
    """Edges of the rows of a whole stage [m]: `positions` equal ones, those near the motion cut `narrower`.

    Where `ends` is set, rows at both ends are halved toward the end, down to an `OUTERMOST`-th.
    """
    low, high = legs.lower[k], max(legs.upper[k], legs.lower[k] + LEAST_RANGE)
    edges = np.arange(positions * NARROWEST + 1)
    middle = low + (high - low) * (np.arange(positions + 1) + 0.5) / positions
    parts = np.ones(positions + 1, dtype=int)
    if beside is not None:
        near = np.abs(middle - beside.position[k]) < NEAR_MOTION
        parts[near] = narrower
        if from_end(legs, k, beside.position[k]) < NEAR_END:
            parts[near & (from_end(legs, k, middle) < NEAR_END)] = NARROWEST
    edges = edges[edges % (NARROWEST // parts[edges // NARROWEST]) == 0]
    parted = NARROWEST
    if ends:
        parted, halves = OUTERMOST, 2 ** np.arange(OUTERMOST.bit_length())
        edges = np.unique(np.concatenate([edges * (parted // NARROWEST), halves, positions * parted - halves]))
    return low + (high - low) * edges / (positions * parted)


def middles(edges: np.ndarray) -> np.ndarray:
    """Middles between edges, along the first axis."""
    return 0.5 * (edges[1:] + edges[:-1])


def halved(edges: np.ndarray) -> np.ndarray:
    """Edges with the middles between them."""
    return np.append(np.stack([edges[:-1], middles(edges)], axis=1), edges[-1])


def enclosures(problem: Problem, rows: list[np.ndarray]) -> tuple[np.ndarray, ...]:
    """Enclosures of all coefficients over the position cells of every stage's window.

    Args:
        problem: The discretised task.
        rows: Edges of the rows of each window [m], (rows + 1,) a stage.

    Returns:
        Per stage an array (rows, moving, layout.COEFFICIENTS, 4): p0, p1, p2 and error of `taylor_model.Enclosure`.
    """
    counts = [edges.size - 1 for edges in rows]
    stage = np.repeat(np.arange(len(rows)), counts)
    half = np.concatenate([0.5 * np.diff(edges) for edges in rows])
    middle = np.concatenate([middles(edges) for edges in rows])
    parts = [slice(first, first + AT_ONCE) for first in range(0, stage.size, AT_ONCE)]
    out = np.concatenate([_enclosed(problem, stage[part], middle[part], half[part]) for part in parts])
    return tuple(np.split(out, np.cumsum(counts)[:-1]))


def _enclosed(problem: Problem, stage: np.ndarray, middle: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Enclosures of all coefficients over intervals of positions, each at a stage of its own."""
    with np.errstate(all="ignore"):  # beside a singular pose bounds may be infinite
        pose = cranes.pose(problem.crane, problem.plane[stage], taylor_model.variable(middle, half))
        motions = [cranes.move(pose, w, u) for w, u in ((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0))]
    still, forth = motions[:2]
    cylinders = range(len(problem.crane.machine.cylinders))[problem.moving]
    out = np.empty((stage.size, len(cylinders), layout.COEFFICIENTS, 4))
    with np.errstate(all="ignore"):
        for m, i in enumerate(cylinders):
            columns = [still.velocity[i], forth.velocity[i] - still.velocity[i]]
            for name in ("acceleration", "load"):
                c0, c1, c2, c3 = (getattr(each, name)[i] for each in motions)
                columns += [c0, 0.5 * (c1 - c2), 0.5 * (c1 + c2) - c0, c3 - c0]
            for q, value in enumerate([*columns, pose.coulomb[i]]):
                model: Enclosure = taylor_model.constant(value)
                for part, name in enumerate(("p0", "p1", "p2", "error")):
                    out[:, m, q, part] = getattr(model, name)
    out[..., 3] += taylor_model.ROUNDING * np.abs(out[..., :3]).sum(axis=-1)
    out[~np.isfinite(out).all(axis=-1) | (out[..., 3] > UNKNOWN)] = (0.0, 0.0, 0.0, UNKNOWN)
    return out
