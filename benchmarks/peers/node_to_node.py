r"""Node-to-node dynamic programming without a velocity state, as in ROS packages for redundancy resolution.

Positions are nodes, all nodes of neighbouring stages are joined by edges, and the velocity of an edge is the difference
of its ends over the step (Ferrentino and Chiacchio, "A topological approach to globally-optimal redundancy resolution
with dynamic programming", 2018, and its MoveIt packages):

    V_0 = 0,     V_{k+1}(j) = min_i { V_k(i) + T_s P_k(i, j) },     v_m(i, j) = (l_m(k+1, j) - l_m(k, i)) / T_s

with l_m the length of cylinder m. An edge on which a cylinder would be too fast is no edge. P is the pump's power with
quasi-static forces, gravity and friction: an edge has no acceleration, so acceleration limits cannot be kept.
The velocity resolution is the spacing of the nodes over the step, which is why the step is longer than elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from leanboom.errors import InfeasibleError
from leanboom.formulas.dynamics import friction
from leanboom.methods import dp_velocity
from leanboom.methods.registry import Settings
from leanboom.model import crane as cranes
from leanboom.model import motion
from leanboom.model.cost_rates import rate
from leanboom.model.motion import Motion
from leanboom.model.task import Task
from leanboom.problem import stages
from leanboom.problem.stages import Problem

METHOD = "node-to-node"
NODES = 401  # positions of a stage
STEP = 0.1  # [s]

Progress = Callable[[str, float], None]


def plan(task: Task, cost: str, start: float, tell: Progress, settings: Settings) -> Motion:
    """The motion of the cheapest path over the nodes.

    Args:
        task: The task.
        cost: "ls" or "cp".
        start: Where the redundant cylinder starts [m].
        tell: Called with what happens and the share done.
        settings: Not used.

    Raises:
        InfeasibleError: If no path keeps the velocity limits.
    """
    problem = stages.discretise(task, STEP)
    nodes = feasible_nodes(problem, start, NODES)

    def edges(k: int) -> np.ndarray:
        tell("stages", k / problem.stages)
        return problem.step * edge_power(problem, cost, k, nodes[k], nodes[k + 1])

    path, total = cheapest_path([n.size for n in nodes], edges)
    if not np.isfinite(total):
        raise InfeasibleError(f"no path over {NODES} nodes a stage keeps the velocity limits")
    through = np.array([n[i] for n, i in zip(nodes, path, strict=True)])
    return through_nodes(problem.step, through, cost)


def feasible_nodes(problem: Problem, start: float, count: int) -> list[np.ndarray]:
    """Nodes of every stage [m]: the start, then those of `count` equally far apart that are feasible."""
    nodes = [np.array([start])]
    for k in range(1, problem.stages + 1):
        grid = np.linspace(problem.lower[k], problem.upper[k], count)
        margin = cranes.position_margin(problem.crane, problem.plane[k], grid)
        nodes.append(grid[margin >= -dp_velocity.SLACK])
    return nodes


def edge_power(problem: Problem, cost: str, k: int, here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Power on the edges from stage k to the next [W], infinite where a cylinder would be too fast.

    Args:
        problem: The discretised task.
        cost: "ls" or "cp".
        k: The stage.
        here: Positions at stage k [m], (nodes here,).
        there: Positions at the next stage [m], (nodes there,).

    Returns:
        (nodes here, nodes there).
    """
    crane = problem.crane
    before, after = cranes.pose(crane, problem.plane[k], here), cranes.pose(crane, problem.plane[k + 1], there)
    base = (0.0,) * (len(before.cylinders) - len(before.gravity))
    velocity, force, possible = [], [], True
    for cylinder, gravity, level, sharpness, at, to in zip(
        crane.machine.cylinders, (*base, *before.gravity), before.coulomb, cranes.sharpness(crane),
        before.cylinders, after.cylinders, strict=True,
    ):  # fmt: skip
        v = (np.asarray(to[0]) + 0.0 * there - (np.asarray(at[0]) + 0.0 * here)[:, None]) / problem.step
        still = column(here, gravity / at[1])
        velocity.append(v)
        force.append(still + friction(v, column(here, level), sharpness, cylinder.friction.viscous))
        possible = possible & (np.abs(v) <= cylinder.velocity_limit * (1.0 + dp_velocity.SLACK))
    power = rate(crane, cost, tuple(velocity), tuple(force))
    return np.where(possible, power, np.inf)


def column(here: np.ndarray, value) -> np.ndarray:
    """A value of each node, or the same for all, as a column, (nodes, 1)."""
    return np.broadcast_to(np.asarray(value, dtype=np.float64), here.shape)[:, None]


def cheapest_path(sizes: list[int], edges: Callable[[int], np.ndarray]) -> tuple[np.ndarray, float]:
    """The cheapest path through layers of nodes, from any of the first to any of the last.

    Args:
        sizes: Nodes of every layer.
        edges: Costs of the edges from layer k to the next, (nodes, nodes); infinite: no edge.

    Returns:
        Node of each layer, (layers,), ties to the lowest; the cost of the path, infinite where there is none.
    """
    value, before = np.zeros(sizes[0]), []
    for k in range(len(sizes) - 1):
        total = value[:, None] + edges(k)
        before.append(total.argmin(axis=0))
        value = total.min(axis=0)
    node = int(value.argmin())
    path = [node]
    for choice in reversed(before):
        path.append(int(choice[path[-1]]))
    return np.array(path[::-1]), float(value[node])


def through_nodes(step: float, position: np.ndarray, cost: str) -> Motion:
    """A motion through node positions that a judge can measure, at rest at both ends.

    A path of nodes has a constant speed s_k on every edge and jumps between them. Here the velocity at a node is the
    mean m_k of its two edges, zero at both ends, and changes linearly to the middle of a stage, where it is
    2 s_k - (m_k + m_{k+1}) / 2: all nodes are met at their time, with finite accelerations.

    Args:
        step: Time between nodes [s].
        position: The nodes [m], (stages + 1,).
        cost: What the path was chosen for.
    """
    speed = np.diff(position) / step
    velocity = np.zeros(2 * speed.size + 1)
    velocity[2:-1:2] = 0.5 * (speed[1:] + speed[:-1])
    velocity[1::2] = 2.0 * speed - 0.5 * (velocity[:-1:2] + velocity[2::2])
    return motion.from_velocities(0.5 * step, float(position[0]), velocity, METHOD, cost)
