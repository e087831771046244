r"""Least cost of a motion through every node of a grid, and the local minima that it shows.

The backward sweep gives J, the least cost from a node to the end. The same sweep over the task run backward in time
gives B, the least cost from the start to a node: with t' = -t every velocity changes its sign, accelerations do not,
and a cylinder that extends against a load retracts against the opposite one. So no other kernel is needed, only other
tables. M = B + J is the least cost of any motion through a node; its minimum over velocity, m(k, c), has a local
minimum in c wherever another way to follow the path is locally the best one.

| symbol | forward | backward in time |
| --- | --- | --- |
| velocity of a cylinder | a0 + a1 w | -a0 + a1 w' |
| acceleration | b0 + b1 w + b2 w^2 + b3 u | b0 - b1 w' + b2 w'^2 + b3 u |
| inertia and gravity force | f0 + f1 w + f2 w^2 + f3 u | -f0 + f1 w' - f2 w'^2 - f3 u |
| extending, retracting | area_out, gain_out, back_out, area_in, ... | exchanged |

A stage's cost is taken at its beginning in J and at its end in B, so M is exact but for the step's error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from leanboom.dynamic_programming import grids, sweeps, value_function
from leanboom.dynamic_programming.grids import Tables
from leanboom.dynamic_programming.value_function import Policy
from leanboom.model import motion
from leanboom.model.motion import Motion
from leanboom.problem import layout

_TURNED = (layout.A0, layout.B1, layout.F0, layout.F2, layout.F3)  # coefficients that change their sign
_EXCHANGED = (
    (layout.AREA_OUT, layout.AREA_IN),
    (layout.GAIN_OUT, layout.GAIN_IN),
    (layout.BACK_OUT, layout.BACK_IN),
    (layout.FLOW_OUT, layout.FLOW_IN),
)
APART = 0.02  # motions closer than this share of the widest feasible extensions are one local minimum
FLAT = 0.005  # beyond the best by less than this share of its cost a grid cannot tell which motion is the better one


@dataclass(frozen=True, slots=True, eq=False)
class Through:
    """Policies forward and backward in time over one grid: the best motion through any state of any stage."""

    policy: Policy
    behind: Policy  # over the same nodes, stages and velocities in the opposite order

    @property
    def cost(self) -> np.ndarray:
        """Least cost of a motion through each node [J], (stages + 1, positions, velocities)."""
        return self.policy.values + self.behind.values[::-1, :, ::-1]

    def motion(self, stage: int, position: float, velocity: float) -> Motion:
        """The best motion through a state; it starts and ends at rest, near the start that B was made for.

        Args:
            stage: The stage.
            position, velocity: The state [m], [m/s].
        """
        n = self.policy.problem.stages
        _, after = _from(self.policy, stage, position, velocity)
        start, before = _from(self.behind, n - stage, position, -velocity)
        w = np.concatenate([-before[::-1], after[1:]])
        w[0] = w[-1] = 0.0
        return motion.from_velocities(self.policy.problem.step, start, w, "dp", self.policy.cost)


def _from(policy: Policy, stage: int, position: float, velocity: float) -> tuple[float, np.ndarray]:
    """Final position of a policy from a state [m], and its velocities from there on [m/s]."""
    table, n = policy.tables, policy.problem.stages
    c, w, u = np.empty(n + 1), np.empty(n + 1), np.empty(n)
    sweeps.rollout(
        table.coefficients, table.outside, table.stage, table.cylinder, policy.setting, policy.values,
        np.array([position, velocity]), stage, c, w, u,
    )  # fmt: skip
    return float(c[n]), w[stage:]


def backward_in_time(table: Tables) -> Tables:
    """The tables of a task run backward in time: stage k is stage N - k of the task, velocities are turned round."""
    coefficients = table.coefficients[::-1].copy()
    coefficients[..., _TURNED] *= -1.0
    stage = table.stage[::-1].copy()
    stage[:, layout.W_LO] = -(stage[:, layout.W_LO] + stage[:, layout.DW] * (table.velocities - 1))
    cylinder = table.cylinder.copy()
    for one, other in _EXCHANGED:
        cylinder[:, [one, other]] = cylinder[:, [other, one]]
    return Tables(coefficients, table.outside[::-1].copy(), stage, cylinder, table.velocities)


def through(policy: Policy, start: float | None) -> Through:
    """The `Through` of a policy: its task is swept backward in time as well.

    Args:
        policy: Values of all nodes, the path ending at rest.
        start: Where the redundant cylinder starts, at rest [m]; None: anywhere.
    """
    table = backward_in_time(policy.tables)
    last = table.stage[-1]
    c = last[layout.C_LO] + last[layout.DC] * np.arange(policy.grid.positions)
    w = last[layout.W_LO] + last[layout.DW] * np.arange(policy.grid.velocities)
    off = np.zeros_like(c) if start is None else np.abs(c - start)
    end = policy.setting[layout.SLOPE_C] * off[:, None] + policy.setting[layout.SLOPE_W] * np.abs(w)[None, :]
    values = value_function.sweep(table, policy.setting, end)
    grid = policy.grid
    turned = grids.Grid(
        grid.c_lo[::-1], grid.c_hi[::-1], -grid.w_hi[::-1], -grid.w_lo[::-1], grid.positions, grid.velocities
    )
    return Through(policy, Policy(policy.problem, policy.cost, turned, table, policy.setting, values))


def local_minima(found: Through, share: float, most: int) -> list[Motion]:
    """Motions of locally least cost, the best first.

    Where the least cost is flat, the grid's errors are larger than the differences between motions far apart. There
    motions follow that are far from all others, the farthest first.

    Args:
        found: Costs through all nodes.
        share: How much more than the best motion the others may cost, as a share of its cost.
        most: Number of motions at most.
    """
    cost, stage = found.cost, found.policy.tables.stage
    fastest = cost.argmin(axis=2)
    least = np.take_along_axis(cost, fastest[..., None], axis=2)[..., 0]  # m(k, c)
    best = least.min(axis=1, keepdims=True)
    beyond = least - best
    padded = np.pad(least, ((0, 0), (1, 1)), constant_values=np.inf)
    minimum = (least <= padded[:, :-2]) & (least <= padded[:, 2:]) & (beyond <= share * np.abs(best))
    candidates = np.argwhere(minimum)
    order = np.argsort(beyond[minimum], kind="stable")
    nodes = stage[:, layout.C_LO, None] + stage[:, layout.DC, None] * np.arange(least.shape[1])
    apart = APART * float(np.max(nodes[:, -1] - nodes[:, 0]))
    motions: list[Motion] = []
    far = np.full_like(nodes, np.inf)  # how far each node is from the nearest motion [m]

    def follow(k: int, i: int) -> None:
        w = stage[k, layout.W_LO] + stage[k, layout.DW] * fastest[k, i]
        made = found.motion(k, float(nodes[k, i]), float(w))
        motions.append(made)
        np.minimum(far, np.abs(nodes - made.position[:, None]), out=far)

    for k, i in candidates[order]:
        if far[k, i] > apart and len(motions) < most:
            follow(int(k), int(i))
    flat = beyond <= FLAT * np.abs(best)
    while len(motions) < most:
        k, i = np.unravel_index(int(np.where(flat, far, 0.0).argmax()), far.shape)
        if far[k, i] <= apart:
            break
        flat[k, i] = False  # the best motion through a node may keep away from it at other stages
        follow(int(k), int(i))
    return motions
