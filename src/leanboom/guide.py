"""Slopes of the cost to go from a policy: where the certificate's own bounds cannot see an end of the stroke coming.

A cell at an end of the feasible extensions is a box: whoever may be anywhere in it may stay in it although moving
toward the end. Bounds of such cells know nothing of the end, nor do slopes that are differences of them, and
planes without slope let them be so at every stage before. The values of a dynamic program do know. Only their
slopes are used; whatever these are, the bounds stay proven (`docs/certificate.md`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from leanboom import dp, stages
from leanboom.bounds import L_C, L_DC, L_DW, L_I, L_J, L_W
from leanboom.dp import Policy
from leanboom.stages import Problem
from leanboom.viability import Viable

GRID = (201, 101)  # positions and velocities of the policy
MARGIN = 3.0  # spacings of that grid around a cell in which no state may be lost, for its slopes to be used


@dataclass(frozen=True, slots=True, eq=False)
class Guide:
    """A policy's values, and which states are lost: beside those, penalties spoil the values."""

    policy: Policy
    viable: Viable

    def slopes(self, k: int, lattice: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Slopes of the values over the cells of a stage; cells near lost states take those of the nearest others.

        Args:
            k: The stage.
            lattice: Its cells, (bounds.LATTICE,).
            shape: Rows and columns of its window.

        Returns:
            Along position [J/m] and velocity [J s/m], arrays of that shape.
        """
        grid = self.policy.grid
        position = lattice[L_C] + (lattice[L_I] + np.arange(shape[0] + 1)) * lattice[L_DC]
        velocity = lattice[L_W] + (lattice[L_J] + np.arange(shape[1] + 1)) * lattice[L_DW]
        length, speed = max(grid.c_hi[k] - grid.c_lo[k], 1e-9), grid.w_hi[k] - grid.w_lo[k]
        nodes = np.meshgrid(
            (position - grid.c_lo[k]) / length * (grid.positions - 1),
            (velocity - grid.w_lo[k]) / speed * (grid.velocities - 1),
            indexing="ij",
        )
        corner = ndimage.map_coordinates(self.policy.values[k].astype(float), nodes, order=1, mode="nearest")
        edge_c, edge_w = np.diff(corner, axis=0), np.diff(corner, axis=1)
        along_c = 0.5 * (edge_c[:, 1:] + edge_c[:, :-1]) / lattice[L_DC]
        along_w = 0.5 * (edge_w[1:] + edge_w[:-1]) / lattice[L_DW]
        row, column = self._nearest(k, (position - lattice[L_C]) / length, velocity)
        return along_c[row[:, None], column], along_w[row[:, None], column]

    def _nearest(self, k: int, share: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """For every cell the nearest that keeps the margin: rows, (rows,), and columns, (rows, columns).

        `share` and `velocity` are the edges of the cells: shares of the feasible extensions, and [m/s].
        """
        grid = self.policy.grid
        apart = MARGIN / (grid.positions - 1)
        aside = MARGIN * (grid.w_hi[k] - grid.w_lo[k]) / (grid.velocities - 1)
        below, above = share[:-1] - apart, share[1:] + apart
        low = np.where(below < 0.0, np.inf, self.viable.within(k, below, below)[0]) + aside
        high = np.where(above > 1.0, -np.inf, self.viable.within(k, above, above)[1]) - aside
        first = np.searchsorted(velocity[:-1], low - 1e-9)
        last = np.searchsorted(velocity[1:], high + 1e-9, side="right") - 1
        keeps = np.nonzero(first <= last)[0]
        rows, columns = np.arange(low.size), np.arange(velocity.size - 1)
        if keeps.size == 0:
            return rows, np.tile(columns, (rows.size, 1))
        row = keeps[np.abs(keeps[None, :] - rows[:, None]).argmin(axis=1)]
        return row, np.clip(columns[None, :], first[row, None], last[row, None])


def make(problem: Problem, cost: str, viable: Viable) -> Guide:
    """The guide of a problem: solve it on a grid."""
    return Guide(dp.solve(problem, stages.full_grid(problem, *GRID), cost), viable)
