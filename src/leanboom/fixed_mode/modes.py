"""Fixed-mode nonlinear program: each cylinder's direction and load sign are fixed, so maxima become constraints.

The dynamic program decides globally which cylinders extend, retract or rest at every stage, and which support
their load. With these modes fixed, a cylinder's flow is a variable s >= A v, s >= -B v, and so is the supply, p >=
every supporting cylinder's demanded pressure; the cost is p x sum(s). Where the pump's flow is a limit, sum(s) is at
most that. No smoothing is left; `interior_point` solves it.
Modes enter as parameters and bounds only: the problem is built once and solved again
as modes are read off the answer.

Both ends of every interval are evaluated (the acceleration is constant between them), which makes the
quadrature second order and keeps acceleration limits on either side of a switch.

| symbol | name | unit |
| --- | --- | --- |
| c, w, u | position, velocity, acceleration of the redundant cylinder | m, m/s, m/s^2 |
| v | velocities of the other moving cylinders | m/s |
| s | pump flow of each moving cylinder | l/s |
| p | highest demanded pressure at an end of an interval | MPa |
| alpha, beta, gamma | the row alpha p - beta F - gamma >= 0 that says what a mode asks of a load | |
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from leanboom.components.costs import CostTerms, Supply
from leanboom.evaluation.evaluate import Evaluation, evaluate
from leanboom.fixed_mode import derivatives, interior_point
from leanboom.formulas import hydraulics
from leanboom.model import crane as cranes
from leanboom.model import motion
from leanboom.model.cost_rates import supply_of, terms_of
from leanboom.model.motion import Motion
from leanboom.problem import cost_scale, feasible_strokes, layout, stage_arrays
from leanboom.problem.stage_arrays import path_determined, threshold
from leanboom.problem.stages import Problem

LITRE, MEGA = 1e3, 1e-6  # flow in l/s, pressure in MPa: their product is kW
FORCE = 1e-5  # scale of the rows that keep a load's sign [1/N]
FRICTION_STEPS = 4096
POSITIONS = 65  # nodes of the coefficients' table
LEAST_ROOM = 1e-6  # [m/s]: a bound on a velocity leaves at least this much on either side
BARRIER, LAST_BARRIER, ITERATIONS = 1e-6, 2e-9, 300


@dataclass(frozen=True, slots=True, eq=False)
class Polisher:
    """The parts of a fixed-mode program that do not depend on the modes, for one task, cost and discretisation."""

    problem: Problem
    cost: str
    coefficients: np.ndarray  # over `derivatives.graded` shares of the feasible extensions
    coulomb: np.ndarray  # friction levels over the stroke [N], (moving, FRICTION_STEPS + 1)

    @property
    def terms(self) -> CostTerms:
        """The cost's terms for all cylinders."""
        return terms_of(self.problem.crane, self.cost)

    @property
    def flows(self) -> bool:
        """Whether pump flow counts, in the cost or as a limit."""
        return self.terms.supply is not Supply.NONE or self.flow_limited

    @property
    def flow_limited(self) -> bool:
        """Whether the pump's flow is a limit."""
        return self.problem.task.limits.pump_flow

    @property
    def areas(self) -> tuple[np.ndarray, np.ndarray]:
        """Flows of the moving cylinders per extending and per retracting velocity [m^2], (moving,) each.

        Where the pump's flow is a limit these are its flows, also for a cost that counts others, `recuperation`: the
        judge compares what comes out.
        """
        if self.flow_limited:
            pairs = [(drive.area_out, drive.area_in) for drive in self.problem.crane.drives]
        else:
            pairs = list(zip(self.terms.area_out, self.terms.area_in, strict=True))
        out, back = np.array(pairs)[self.problem.moving].T
        return out, back

    @property
    def loads(self) -> bool:
        """Whether forces count, and with them the modes."""
        return self.terms.work or self.pressures

    @property
    def pressures(self) -> bool:
        """Whether the supply pressure is a variable."""
        return self.terms.supply is Supply.LOAD_SENSING


def build(problem: Problem, cost: str) -> Polisher:
    """Tabulate the fixed-mode program for a cost of `costs.COSTS`."""
    shares = derivatives.graded(POSITIONS)
    positions = problem.lower[:, None] + (_last(problem) - problem.lower)[:, None] * shares
    strokes = np.linspace(*feasible_strokes.stroke_range(problem.task), FRICTION_STEPS + 1)
    pose = cranes.pose(problem.crane, problem.plane[0], strokes)
    coulomb = [np.broadcast_to(level, strokes.shape) for level in pose.coulomb[problem.moving]]
    return Polisher(problem, cost, stage_arrays.coefficients(problem, positions), np.array(coulomb))


def _last(problem: Problem) -> np.ndarray:
    """Last tabulated position of every node [m]."""
    return np.maximum(problem.upper, problem.lower + 1e-6)


@dataclass(frozen=True, slots=True, eq=False)
class Modes:
    """Modes: direction of every moving cylinder at every node, and whether it carries load."""

    sign: np.ndarray  # -1 retracts, 0 at rest, 1 extends, (stages + 1, moving)
    loaded: np.ndarray  # at the beginning and end of every interval, (2, stages, moving)

    def same_as(self, other: Modes) -> bool:
        """Whether all switches agree."""
        return np.array_equal(self.sign, other.sign) and np.array_equal(self.loaded, other.loaded)


def modes(polisher: Polisher, seed: Motion) -> Modes:
    """The modes of a motion on the problem's stages."""
    problem = polisher.problem
    with np.errstate(all="ignore"):  # a seed out of reach has no numbers there, and no modes
        rates = _speeds(problem, seed)
    epsilon = threshold(problem, 1.0) if polisher.pressures else 0.0
    sign = np.where(rates > epsilon, 1, np.where(rates < -epsilon, -1, 0))
    with np.errstate(all="ignore"):
        loaded = np.stack([_force(problem, seed, end, sign) * sign[_nodes(end)] > 0.0 for end in range(2)])
    return Modes(sign, loaded)


def _nodes(end: int) -> slice:
    """The nodes at the beginnings (0) or ends (1) of all intervals."""
    return slice(1, None) if end else slice(None, -1)


def _speeds(problem: Problem, seed: Motion) -> np.ndarray:
    """Velocities of the moving cylinders at the nodes [m/s], (stages + 1, moving)."""
    pose = cranes.pose(problem.crane, problem.plane, seed.position)
    return np.stack(cranes.move(pose, seed.velocity, 0.0).velocity, axis=1)[:, problem.moving]


def _force(problem: Problem, seed: Motion, end: int, sign: np.ndarray) -> np.ndarray:
    """Forces at one end of every interval with friction of given directions [N], (stages, moving)."""
    nodes = _nodes(end)
    pose = cranes.pose(problem.crane, problem.plane[nodes], seed.position[nodes])
    moving = cranes.move(pose, seed.velocity[nodes], seed.acceleration)
    cylinders = problem.crane.machine.cylinders[problem.moving]
    columns = []
    for i, cylinder in enumerate(cylinders):
        friction = pose.coulomb[problem.moving][i] * sign[nodes, i]
        friction = friction + cylinder.friction.viscous * moving.velocity[problem.moving][i]
        columns.append(moving.load[problem.moving][i] + friction)
    return np.stack(columns, axis=1)


def solve(
    polisher: Polisher,
    seed: Motion,
    switches: Modes,
    free_start: bool = False,
    share: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> tuple[Motion | None, str]:
    """Solution of the fixed-mode program from a seed: the polished motion.

    It ends where the seed does if the task asks for an end.

    Args:
        polisher: The built problem.
        seed: Motion on the problem's stages; gives start and first guess.
        switches: The modes.
        free_start: Whether the start may move inside its feasible interval (start kind `best`).
        share: Parts of the cylinders' velocity and acceleration limits and of the pump's flow that may be used at the
            ends of the intervals; less than 1 leaves room for what happens between them.

    Returns:
        The polished motion and how the solver ended; no motion where it did not converge.
    """
    problem = polisher.problem
    mode = _mode_parameters(polisher, switches)
    stated = _program(polisher, seed, switches, mode, free_start, share)
    guess = _guess(polisher, seed, switches, mode)
    unit = derivatives.MILLI * cost_scale.energy_scale(problem, polisher.cost)
    answer, solved, count = interior_point.minimise(stated, guess, BARRIER * unit, LAST_BARRIER * unit, ITERATIONS)
    text = f"{'solved' if solved else 'not solved'} in {count} iterations"
    if not solved:
        return None, text
    velocity = answer.state[:, 1].copy()
    velocity[-1] = 0.0
    return motion.from_velocities(problem.step, float(answer.state[0, 0]), velocity, seed.method, polisher.cost), text


def between(
    polisher: Polisher, beside: Motion, start: float, end: float, switches: Modes | None = None
) -> Evaluation | None:
    """The judged motion from a start to an end [m], polished from one beside it; None where none is found.

    Args:
        polisher: The built problem, of a task that asks for an end.
        beside: The other motion, on the problem's stages.
        start, end: Of the redundant cylinder [m].
        switches: The modes; None: as they are read off the other motion once it is led there.
    """
    seed = motion.from_velocities(beside.step, start, beside.velocity, "dp", polisher.cost)
    seed = motion.ending_at(seed, end)
    switches = modes(polisher, seed) if switches is None else switches
    answer, _ = solve(polisher, seed, switches)
    return None if answer is None else evaluate(replace(polisher.problem.task, start=start, end=end), answer)


def _program(
    polisher: Polisher,
    seed: Motion,
    switches: Modes,
    mode: np.ndarray,
    free_start: bool,
    share: tuple[float, float, float],
) -> derivatives.Program:
    """The `Program` for given modes, which bound speeds; limits that cannot change are left out."""
    problem = polisher.problem
    machine = problem.crane.machine
    cylinders = machine.cylinders[problem.moving]
    n, nodes = len(cylinders), problem.stages + 1
    v = _speeds(problem, seed)
    low, high = np.empty((nodes, 1 + n)), np.empty((nodes, 1 + n))
    low[:, 0], high[:, 0] = problem.lower, problem.upper
    epsilon = threshold(problem) if polisher.pressures else 0.0
    for i, cylinder in enumerate(cylinders):
        high[:, 1 + i] = share[0] * cylinder.velocity_limit
        low[:, 1 + i] = -high[:, 1 + i]
        if polisher.loads:
            # A seed that rides closer to the threshold keeps its place: two cylinders at rest may leave no other.
            sign = switches.sign[:, i]
            edge = np.maximum(np.where(sign == 0, np.maximum(epsilon, np.abs(v[:, i])), epsilon), LEAST_ROOM)
            low[:, 1 + i] = np.where(sign >= 0, -edge, low[:, 1 + i])
            high[:, 1 + i] = np.where(sign <= 0, edge, high[:, 1 + i])
    some = derivatives.empty_limits(problem.stages, n).every
    counts = derivatives.limits(np.ones_like(some, dtype=np.bool_), problem.stages, n)
    counts.node[[0, -1], -2:] = False  # at rest
    if not free_start:
        counts.node[0] = False
    fixed_end = problem.task.end != "free"
    if fixed_end:
        counts.node[-1] = False
    counts.end[:, 1, 2 * n - 2 : 2 * n] = False  # the control is the same at both ends
    asked = (mode[:, :, derivatives.ALPHA] != 0.0) & polisher.pressures | (mode[:, :, derivatives.BETA] != 0.0)
    counts.end[:, :, 2 * n : 3 * n] = np.moveaxis(asked, 0, 1) & polisher.loads
    counts.end[:, :, 3 * n] = polisher.pressures
    counts.end[:, :, 3 * n + 1 : 5 * n + 1] = polisher.flows
    counts.end[:, :, 5 * n + 1] = polisher.flow_limited
    flow, pressure, _ = path_determined(problem, polisher.cost)
    terms = polisher.terms
    constants = [
        *(LITRE * area for area in polisher.areas),
        np.array(terms.square)[problem.moving], [c.friction.viscous for c in cylinders],
        [share[1] * c.acceleration_limit for c in cylinders],
    ]  # fmt: skip
    supply, shaft = supply_of(machine.pump, terms.supply)
    most = LITRE * (stage_arrays.most_flow(problem) - (1.0 - share[2]) * machine.pump.max_flow)
    return derivatives.Program(
        problem.step, polisher.pressures, terms.work, free_start, fixed_end, polisher.coefficients, problem.lower,
        _last(problem), polisher.coulomb, np.array(feasible_strokes.stroke_range(problem.task)), low, high, mode,
        pressure * MEGA, flow * LITRE, most, np.array(constants), np.array([MEGA * supply, *shaft.in_kilowatts()]),
        counts,
    )  # fmt: skip


def _guess(polisher: Polisher, seed: Motion, switches: Modes, mode: np.ndarray) -> derivatives.Point:
    """First guess: the seed with its own supply pressure and flows."""
    problem = polisher.problem
    areas = list(zip(*polisher.areas, strict=True))
    point = derivatives.empty_point(problem.stages, len(areas))
    point.state[:, 0], point.state[:, 1], point.control[:] = seed.position, seed.velocity, seed.acceleration
    v = _speeds(problem, seed)
    _, pressure, _ = path_determined(problem, polisher.cost)
    for end in range(2):
        if polisher.flows:
            for i, (out, back) in enumerate(areas):
                point.local[:, end, 1 + i] = LITRE * hydraulics.cylinder_flow(v[_nodes(end), i], out, back)
        if polisher.pressures:
            _, alpha, beta, gamma = np.moveaxis(mode[end], 1, 0)
            need = alpha * (beta * _force(problem, seed, end, switches.sign) + gamma)
            point.local[:, end, 0] = np.maximum(MEGA * pressure[_nodes(end)], need.max(axis=1))
    return point


def _mode_parameters(polisher: Polisher, switches: Modes) -> np.ndarray:
    """Sign, alpha, beta, gamma of every cylinder at both ends of every interval, (2, stages, 4, moving)."""
    problem = polisher.problem
    drives = problem.crane.drives[problem.moving]
    mode = np.zeros((2, problem.stages, 4, len(drives)))
    for end in range(2):
        sign, loaded = switches.sign[_nodes(end)], switches.loaded[end]
        for i, d in enumerate(drives):
            s = sign[:, i]
            carries, overruns = loaded[:, i] & (s != 0), ~loaded[:, i] & (s != 0)
            if polisher.pressures:
                # p >= gain F + back while loaded; the load's sign kept while overrunning; nothing at rest.
                gain = np.where(s > 0, d.gain_out, -d.gain_in) * MEGA
                back = np.where(s > 0, d.back_out, d.back_in) * MEGA
                carries = carries & (gain != 0.0)
                beta, gamma = np.where(carries, gain, 0.0), np.where(carries, back, np.where(overruns, 0.0, -1.0))
            else:
                beta, gamma = np.where(carries, -FORCE * s, 0.0), np.where(s == 0, -1.0, 0.0)
            mode[end, :, 0, i] = s
            mode[end, :, 1, i] = carries
            mode[end, :, 2, i] = np.where(overruns, FORCE * s, beta)
            mode[end, :, 3, i] = gamma
    return mode


def prepare() -> None:
    """Load the compiled kernels, compiling them on the very first run, by stating a problem that is not solved."""
    n, count = 2, 2
    limit = np.zeros((count + 1, 1 + n))
    node, pump = np.zeros(count + 1), np.ones(5)
    counts = derivatives.limits(np.zeros(derivatives.empty_limits(count, n).every.size, dtype=np.bool_), count, n)
    table = np.zeros((count + 1, POSITIONS, n, layout.COEFFICIENTS))
    stated = derivatives.Program(
        1.0, False, False, False, False, table, node, node + 1.0, np.zeros((n, 2)), np.arange(2.0), limit, limit,
        np.zeros((2, count, 4, n)), node, node, node, np.zeros((5, n)), pump, counts,
    )  # fmt: skip
    interior_point.minimise(stated, derivatives.empty_point(count, n), 1.0, 1.0, 0)
