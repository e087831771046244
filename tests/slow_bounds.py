"""Plain twins of the certificate: energies of whole motions and of single cells by trying everything.

Written from the crane's formulas, not from the kernels: a cell's least cost to go is looked for on a fine set of
states and accelerations, the least energy of a task on a fine set of velocities at every stage.
"""

from __future__ import annotations

import itertools

import numpy as np

from leanboom.certificate import lower_bounds, upper_bound
from leanboom.formulas import hydraulics
from leanboom.model import crane as cranes
from leanboom.model import motion
from leanboom.problem import stage_arrays
from leanboom.problem.legs import Legs
from leanboom.problem.stages import Problem


def quiet(share: float) -> None:
    """No clock."""


def rates(problem: Problem, pump: str, k, c, w, u) -> tuple[np.ndarray, np.ndarray]:
    """Energy of stages k from states and controls [J], and the largest use of velocity, acceleration and flow."""
    crane, machine = problem.crane, problem.crane.machine
    k, c, w, u = np.broadcast_arrays(k, c, w, u)
    pose = cranes.pose(crane, problem.plane[k], c)
    moving = cranes.move(pose, w, u)
    force = cranes.forces(pose, moving)
    flow, pressure, _ = stage_arrays.path_determined(problem, pump)
    flow, pressure, used = flow[k], pressure[k], np.zeros(c.shape)
    for i in range(len(machine.cylinders))[problem.moving]:
        d, v, cylinder = crane.drives[i], moving.velocity[i], machine.cylinders[i]
        flow = flow + hydraulics.cylinder_flow(v, d.area_out, d.area_in)
        line = (machine.driven_velocity, d.gain_out, d.back_out, d.gain_in, d.back_in)
        pressure = np.maximum(pressure, hydraulics.pressure_demand(v, force[i], *line))
        used = np.maximum(used, np.abs(v) / cylinder.velocity_limit)
        used = np.maximum(used, np.abs(moving.acceleration[i]) / cylinder.acceleration_limit)
    used = np.maximum(used, flow / problem.task.flow_limit)
    supply = pressure + machine.pump.ls_margin if pump == "ls" else machine.pump.constant_pressure
    return problem.step * supply * flow / machine.pump.efficiency, used


def least_energy(problem: Problem, pump: str, start: float, count: int) -> tuple[float, motion.Motion | None]:
    """The least energy over all motions whose velocities are on a grid of `count` values, and such a motion."""
    limit = problem.crane.machine.redundant.velocity_limit
    span, centre = limit, np.zeros(problem.stages - 1)
    best, chosen = np.inf, None
    for _ in range(4):  # look again around the best
        axes = [np.unique(np.clip(middle + np.linspace(-span, span, count), -limit, limit)) for middle in centre]
        inner = np.array(list(itertools.product(*axes)))
        w = np.concatenate([np.zeros((len(inner), 1)), inner, np.zeros((len(inner), 1))], axis=1)
        u = np.diff(w, axis=1) / problem.step
        c = start + np.concatenate(
            [np.zeros((len(w), 1)), np.cumsum(0.5 * problem.step * (w[:, 1:] + w[:, :-1]), axis=1)], axis=1
        )
        keeps = np.all((c >= problem.lower - 1e-9) & (c <= problem.upper + 1e-9), axis=1)
        c, w, u = c[keeps], w[keeps], u[keeps]
        if len(c):
            cost, used = rates(problem, pump, np.arange(problem.stages), c[:, :-1], w[:, :-1], u)
            total = np.where(np.all(used <= 1.0, axis=1), cost.sum(axis=1), np.inf)
            least = int(total.argmin())
            if total[least] < best:
                best, centre = float(total[least]), w[least, 1:-1]
                chosen = motion.from_velocities(problem.step, start, w[least], "brute force", pump)
        span *= 3.0 / count
    return best, chosen


def least_in_cell(found: lower_bounds.Bounds, pump: str, k: int, p: int, r: int, count: int) -> float:
    """Least of stage cost plus bound at the next state less rise of the cell's plane [J], over sampled motions.

    From states within the row's velocity bounds: the others can keep no limit further on.
    """
    held, problem = found.cells, found.cells.legs.problems[0]
    low, high = held.rows[k][p : p + 2]
    slow, fast = held.edges[k][p, r : r + 2]
    share = np.linspace(-0.5, 0.5, count)
    limit = problem.crane.machine.redundant.acceleration_limit
    dx, dy, u = np.meshgrid(
        (high - low) * share, (fast - slow) * share, np.linspace(-limit, limit, 8 * count), indexing="ij"
    )
    c, w = 0.5 * (low + high) + dx, 0.5 * (slow + fast) + dy
    cost, used = rates(problem, pump, k, c, w, u)
    next_c, next_w = c + problem.step * (w + 0.5 * problem.step * u), w + problem.step * u
    slowest, fastest = held.columns[k][p]
    inside = (
        (used <= 1.0)
        & (w >= slowest)
        & (w <= fastest)
        & (next_c >= problem.lower[k + 1])
        & (next_c <= problem.upper[k + 1])
    )
    plane = found.planes[k][p, r]
    least = np.inf
    for x, y, here, rise in zip(
        next_c[inside], next_w[inside], cost[inside], (plane[1] * dx + plane[2] * dy)[inside], strict=True
    ):
        least = min(least, here + lower_bounds.value_at(found, k + 1, x, y) - rise)
    return least


def random_motion(problem: Problem, start: float, rng: np.random.Generator, tries: int = 2000) -> motion.Motion | None:
    """A random motion that keeps every limit; None where none was found."""
    limit = problem.crane.machine.redundant.velocity_limit
    for _ in range(tries):
        knots = rng.uniform(-limit, limit, 5) * rng.uniform(0.0, 1.0)
        w = np.interp(np.arange(problem.stages + 1), np.linspace(0, problem.stages, 7), [0.0, *knots, 0.0])
        found = upper_bound.measure(problem, motion.from_velocities(problem.step, start, w, "random", "ls"), "ls")
        strict = np.all(found.motion.position <= problem.upper) and np.all(found.motion.position >= problem.lower)
        _, used = rates(
            problem, "ls", np.arange(problem.stages), found.motion.position[:-1], w[:-1], found.motion.acceleration
        )
        if strict and used.max() <= 1.0:
            return found.motion
    return None


def least_of_legs(
    legs: Legs, pump: str, start: float | None, closed: bool, count: int
) -> tuple[float, upper_bound.Measured | None]:
    """The least energy of legs over all motions on grids of `count` values, and such a motion.

    The grids are of velocities at every stage, and of the start where that is None. A closed motion's last velocity is
    the one that leads it back to its start.
    """
    limit, low, high = legs.velocity_limit, float(legs.lower[0]), float(legs.upper[0])
    inner = [k for i in range(len(legs.problems)) for k in range(legs.firsts[i] + 1, legs.firsts[i + 1])]
    step = np.repeat([problem.step for problem in legs.problems], np.diff(legs.firsts))
    centre = np.array([0.5 * (low + high) if start is None else start, *[0.0] * (len(inner) - closed)])
    span = np.array([0.5 * (high - low) if start is None else 0.0, *[limit] * (len(inner) - closed)])
    best, chosen = np.inf, None
    for _ in range(4):  # look again around the best
        axes = [
            np.unique(middle + np.linspace(-reach, reach, count)) for middle, reach in zip(centre, span, strict=True)
        ]
        tried = np.array(list(itertools.product(*axes)))
        w = np.zeros((len(tried), legs.stages + 1))
        w[:, inner[: len(centre) - 1]] = tried[:, 1:]
        if closed:
            w[:, inner[-1]] = -(w[:, inner[:-1]] * step[inner[:-1]]).sum(axis=1) / step[inner[-1]]
        u, moved = np.diff(w, axis=1) / step, np.cumsum(0.5 * step * (w[:, 1:] + w[:, :-1]), axis=1)
        c = tried[:, :1] + np.concatenate([np.zeros((len(w), 1)), moved], axis=1)
        keeps = np.all((c >= legs.lower) & (c <= legs.upper) & (np.abs(w) <= limit), axis=1)
        keeps &= (c[:, -1] >= legs.lower[-1]) & (c[:, -1] <= legs.upper[-1])
        tried, c, w, u = tried[keeps], c[keeps], w[keeps], u[keeps]
        total = np.zeros(len(c))
        for i, problem in enumerate(legs.problems):
            here = slice(int(legs.firsts[i]), int(legs.firsts[i + 1]))
            cost, used = rates(problem, pump, np.arange(problem.stages), c[:, here], w[:, here], u[:, here])
            total += np.where(np.all(used <= 1.0, axis=1), cost.sum(axis=1), np.inf)
        if len(total) and total.min() < best:
            least = int(total.argmin())
            best, centre = float(total[least]), tried[least]
            chosen = [
                motion.make(
                    problem.step, c[least, part], w[least, part], np.diff(w[least, part]) / problem.step, "", pump
                )
                for problem, part in ((legs.problems[i], legs.part(i)) for i in range(len(legs.problems)))
            ]
        span = span * 3.0 / count
    if chosen is None:
        return best, None
    return best, upper_bound.joined(
        [upper_bound.measure(problem, each, pump) for problem, each in zip(legs.problems, chosen, strict=True)]
    )
