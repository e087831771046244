"""Polish with the switches fixed: the smooth problem that remains once the combinatorial choices are made.

The dynamic program decides globally which cylinders extend, retract or are held at every stage, and which carry
load. With those modes fixed, maxima become variables: the flow of a cylinder s >= A v, s >= -B v; the supply
p >= every loaded cylinder's pressure; the cost p x sum(s). No smoothing is left, so IPOPT solves it to the bound.
Modes enter as parameters and bounds only: the problem is built once and solved again as modes are read off
the answer.

Both ends of every interval are evaluated (the acceleration is constant between them), which makes the
quadrature second order and keeps acceleration limits on either side of a switch.

| symbol | name | unit |
| --- | --- | --- |
| c, w, u | position, velocity, acceleration of the redundant cylinder | m, m/s, m/s^2 |
| v | velocities of the other moving cylinders | m/s |
| s | pump flow of each moving cylinder | l/s |
| p0, p1 | highest counted pressure at the beginning and end of an interval | MPa |
| alpha, beta, gamma | the row alpha p - beta F - gamma >= 0 that says what a mode asks of a load | |
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from leanboom import crane as cranes
from leanboom import hydraulics, motion
from leanboom.motion import Motion
from leanboom.shaft import shaft_of
from leanboom.stages import HELD, Problem, prescribed, threads

LITRE, MEGA = 1e3, 1e-6  # flow in l/s, pressure in MPa: their product is kW
WORTH_SHARING = 500  # instructions of a stage's function that make another thread worth while
FORCE = 1e-5  # scale of the rows that keep a load's sign [1/N]
REFERENCE = 7  # parameters of a node: r, z, vr, vz, ar, az, prescribed flow
OPTIONS = {
    "print_level": 0, "sb": "yes", "max_iter": 150, "tol": 1e-6, "mu_init": 1e-3, "acceptable_tol": 1e-5,
    "acceptable_iter": 5, "bound_push": 1e-4, "bound_frac": 1e-4, "bound_relax_factor": 0.0,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the variables of one node stand: c w u | v of the others | s | p0 p1, as far as the cost needs them."""

    moving: int  # number of moving cylinders n
    cost: str

    @property
    def flows(self) -> bool:
        """Whether pump flow counts."""
        return self.cost in ("ls", "cp")

    @property
    def loads(self) -> bool:
        """Whether forces count, and with them the modes."""
        return self.cost in ("ls", "actuator")

    @property
    def pressures(self) -> bool:
        """Whether the supply pressure is a variable."""
        return self.cost == "ls"

    @property
    def speeds(self) -> list[int]:
        """Columns of all moving cylinders' velocities; the redundant one's is w."""
        return [*range(3, 2 + self.moving), 1]

    @property
    def flow(self) -> slice:
        """Columns of s."""
        return slice(2 + self.moving, 2 + self.moving + (self.moving if self.flows else 0))

    @property
    def size(self) -> int:
        """Variables of a node."""
        return self.flow.stop + (2 if self.pressures else 0)


@dataclass(frozen=True, slots=True, eq=False)
class Polisher:
    """The built problem of one task, cost and discretisation; `solve` solves it for given modes."""

    problem: Problem
    layout: Layout
    solver: Any  # casadi.Function
    reference: np.ndarray  # parameters of the nodes, (stages + 1, REFERENCE)
    base_pressure: np.ndarray  # counted pressure of the prescribed cylinders [MPa], (stages + 1,)


def build(problem: Problem, cost: str) -> Polisher:
    """Build the polishing problem for a cost of `objective.COSTS`."""
    import casadi as ca

    ca.GlobalOptions.setNumpyMode(1)
    n = len(problem.crane.machine.cylinders[problem.moving])
    layout = Layout(n, cost)
    here, there = ca.SX.sym("x", layout.size), ca.SX.sym("y", layout.size)
    theta, phi = ca.SX.sym("t", REFERENCE), ca.SX.sym("f", REFERENCE)  # reference at both ends
    mode0, mode1 = ca.SX.sym("m", 4 * n), ca.SX.sym("l", 4 * n)  # sign, alpha, beta, gamma of every cylinder
    start, end = _state(problem, here, here[2], theta), _state(problem, there, here[2], phi)
    node_rows = _node_rows(ca, problem, layout, here, start)
    start_rows, start_cost = _end_rows(ca, problem, layout, here, start, here[layout.size - 2], theta[6], mode0)
    end_rows, end_cost = _end_rows(ca, problem, layout, there, end, here[layout.size - 1], phi[6], mode1)
    ts = problem.step
    rows = ca.vertcat(
        there[0] - here[0] - ts * here[1] - 0.5 * ts * ts * here[2],
        there[1] - here[1] - ts * here[2],
        node_rows,
        start_rows,
        end_rows,
    )
    cost_term = 0.5 * ts * (start_cost + end_cost)
    parameters = ca.vertcat(theta, phi, mode0, mode1)
    solver = _assemble(ca, problem.stages, here, there, parameters, rows, cost_term, node_rows, theta)
    p = problem.plane
    flow, pressure, _ = prescribed(problem, cost)
    reference = np.stack([p.r, p.z, p.vr, p.vz, p.ar, p.az, flow * LITRE], axis=1)
    return Polisher(problem, layout, solver, reference, pressure * MEGA)


def _state(problem: Problem, x, u, theta):
    plane = cranes.Plane(theta[0], theta[1], theta[2], theta[3], theta[4], theta[5])
    pose = cranes.pose(problem.crane, plane, x[0])
    return pose, cranes.move(pose, x[1], u)


def _node_rows(ca, problem: Problem, layout: Layout, x, state):
    """V = its kinematics (equality) and s >= A v, s >= -B v, per node."""
    velocity = state[1].velocity[problem.moving]
    rows = [x[column] - velocity[i] for i, column in enumerate(layout.speeds[:-1])]
    if layout.flows:
        drives = problem.crane.drives[problem.moving]
        for column, s, d in zip(layout.speeds, range(layout.flow.start, layout.flow.stop), drives, strict=True):
            rows += [x[s] - LITRE * d.area_out * x[column], x[s] + LITRE * d.area_in * x[column]]
    return ca.vertcat(*rows)


def _end_rows(ca, problem: Problem, layout: Layout, x, state, pressure, flow, mode):
    """Accelerations and load conditions at one end of an interval, and the cost rate there (power in kW)."""
    pose, moving = state
    machine, n = problem.crane.machine, layout.moving
    rows = [moving.acceleration[problem.moving][i] for i in range(n - 1)]
    speeds = [x[column] for column in layout.speeds]
    work = 0.0
    if layout.loads:
        cylinders = machine.cylinders[problem.moving]
        for i in range(n):
            sign, alpha, beta, gamma = (mode[j * n + i] for j in range(4))
            # With the direction fixed, Coulomb friction is a constant: the tanh of eq. (A3) is saturated.
            force = moving.load[problem.moving][i] + pose.coulomb[problem.moving][i] * sign
            force = force + cylinders[i].friction.viscous * speeds[i]
            rows.append((alpha * pressure if layout.pressures else 0.0) - beta * force - gamma)
            work = work + alpha * force * speeds[i]
    if layout.flows:
        flow = flow + ca.sum1(x[layout.flow])
        supply = pressure + machine.pump.ls_margin * MEGA if layout.pressures else machine.pump.constant_pressure * MEGA
        rate = hydraulics.pump_power(supply, flow, *shaft_of(machine.pump).in_kilowatts())
    elif layout.cost == "actuator":
        rate = 1e-3 * work
    elif layout.cost == "velocity":
        rate = sum(v * v for v in speeds)
    elif layout.cost == "extension":
        rate = speeds[-1] * speeds[-1]
    else:
        cylinders = machine.cylinders[problem.moving]
        net = sum(
            hydraulics.recuperating_flow(v, c.piston_area, c.rod_side_area)
            for v, c in zip(speeds, cylinders, strict=True)
        )
        rate = 1e-3 * hydraulics.pump_power(machine.pump.constant_pressure, net, *shaft_of(machine.pump))
    return ca.vertcat(*rows), rate


def _assemble(ca, stages, here, there, parameters, rows, cost, node_rows, theta):
    """An IPOPT solver whose exact derivatives are one stage function mapped over the stages, then scattered."""
    size, m, count = here.numel(), rows.numel(), parameters.numel()
    both, lam, sigma = ca.vertcat(here, there), ca.SX.sym("lam", m), ca.SX.sym("sigma")
    jac = ca.jacobian(rows, both)
    hess = ca.triu(ca.hessian(sigma * cost + ca.dot(lam, rows), both)[0])

    def mapped(name, arguments, values):
        function = ca.Function(name, arguments, [ca.cse(value) for value in values])
        if function.n_instructions() < WORTH_SHARING:
            return function.map(stages)
        return function.map(stages, "thread", threads())

    f_cost = mapped("costs", [both, parameters], [cost])
    f_rows = mapped("rows", [both, parameters], [rows])
    f_grad = mapped("gradients", [both, parameters], [ca.gradient(cost, both)])
    f_jac = mapped("jacobians", [both, parameters], [_nonzeros(ca, jac)])
    f_hess = mapped("hessians", [both, parameters, sigma, lam], [_nonzeros(ca, hess)])
    # The last node's own rows (v and s), which no interval begins with.
    last_lam = ca.SX.sym("last", node_rows.numel())
    last_jac = ca.jacobian(node_rows, here)
    last_hess = ca.triu(ca.hessian(ca.dot(last_lam, node_rows), here)[0])
    l_rows = ca.Function("last_rows", [here, theta], [node_rows])
    l_jac = ca.Function("last_jacobian", [here, theta], [_nonzeros(ca, last_jac)])
    l_hess = ca.Function("last_hessian", [here, theta, last_lam], [_nonzeros(ca, last_hess)])

    x = ca.MX.sym("x", size * (stages + 1))
    p = ca.MX.sym("p", count * stages + theta.numel())
    blocks = ca.reshape(x, size, stages + 1)
    pairs = ca.vertcat(blocks[:, :-1], blocks[:, 1:])
    per = ca.reshape(p[: count * stages], count, stages)
    last_x, last_p = blocks[:, -1], p[count * stages :]
    f = ca.sum2(f_cost(pairs, per))
    g = ca.vertcat(ca.vec(f_rows(pairs, per)), l_rows(last_x, last_p))
    lam_f, lam_g = ca.MX.sym("lf"), ca.MX.sym("lg", g.numel())
    lams = ca.reshape(lam_g[: m * stages], m, stages)

    def places(block, last, row_step):
        # Rows and columns of the entries of all intervals and of the last node in the whole matrix.
        r, c = (np.array(a, dtype=np.int64) for a in block.sparsity().get_triplet())
        lr, lc = (np.array(a, dtype=np.int64) for a in last.sparsity().get_triplet())
        k = np.arange(stages)[:, None]
        return (
            np.concatenate([(r[None] + row_step * k).ravel(), lr + row_step * stages]),
            np.concatenate([(c[None] + size * k).ravel(), lc + size * stages]),
        )

    jac_values = ca.vertcat(ca.vec(f_jac(pairs, per)), l_jac(last_x, last_p))
    jac_g = _scatter(ca, jac_values, *places(jac, last_jac, m), (g.numel(), x.numel()))
    hess_values = ca.vertcat(
        ca.vec(f_hess(pairs, per, ca.repmat(lam_f, 1, stages), lams)), l_hess(last_x, last_p, lam_g[m * stages :])
    )
    hess_l = _scatter(ca, hess_values, *places(hess, last_hess, size), (x.numel(), x.numel()))
    gradient, zero = f_grad(pairs, per), ca.MX.zeros(size, 1)
    grad_f = ca.vec(ca.horzcat(gradient[:size, :], zero) + ca.horzcat(zero, gradient[size:, :]))
    names = ["x", "p"]
    options = {
        "grad_f": ca.Function("nlp_grad_f", [x, p], [f, grad_f], names, ["f", "grad_f_x"]),
        "jac_g": ca.Function("nlp_jac_g", [x, p], [g, jac_g], names, ["g", "jac_g_x"]),
        "hess_lag": ca.Function(
            "nlp_hess_l", [x, p, lam_f, lam_g], [hess_l], [*names, "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
        ),
        "ipopt": OPTIONS,
        "print_time": False,
        "show_eval_warnings": False,  # a trial step out of reach is cut back, and no news to the user
        "error_on_fail": False,
    }
    return ca.nlpsol("polish", "ipopt", {"x": x, "p": p, "f": f, "g": g}, options)


def _nonzeros(ca, matrix):
    return ca.vertcat(*(matrix.nz[i] for i in range(matrix.nnz()))) if matrix.nnz() else ca.SX(0, 1)


def _scatter(ca, values, rows, columns, shape):
    """Sparse MX whose entries are sums of given values at given places."""
    key = columns * shape[0] + rows
    unique, place = np.unique(key, return_inverse=True)
    sparsity = ca.Sparsity.triplet(*shape, (unique % shape[0]).tolist(), (unique // shape[0]).tolist())
    gather = ca.DM(ca.Sparsity.triplet(unique.size, key.size, place.tolist(), list(range(key.size))), 1.0)
    return ca.MX(sparsity, ca.mtimes(gather, values))


@dataclass(frozen=True, slots=True, eq=False)
class Modes:
    """The switches: direction of every moving cylinder at every node, and whether it carries load."""

    sign: np.ndarray  # -1 retracts, 0 held, 1 extends, (stages + 1, moving)
    loaded: np.ndarray  # at the beginning and end of every interval, (2, stages, moving)

    def same_as(self, other: Modes) -> bool:
        """Whether all switches agree."""
        return np.array_equal(self.sign, other.sign) and np.array_equal(self.loaded, other.loaded)


def modes(polisher: Polisher, seed: Motion) -> Modes:
    """Read the modes off a motion on the problem's stages."""
    problem = polisher.problem
    with np.errstate(all="ignore"):  # a seed out of reach has no numbers there, and no modes
        rates = _speeds(problem, seed)
    epsilon = problem.crane.machine.driven_velocity if polisher.layout.pressures else 0.0
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
    polisher: Polisher, seed: Motion, switches: Modes, free_start: bool = False, share: tuple[float, float] = (1.0, 1.0)
) -> tuple[Motion | None, str]:
    """Solve the smooth problem for given modes from a seed.

    Args:
        polisher: The built problem.
        seed: Motion on the problem's stages; gives start and first guess.
        switches: The modes.
        free_start: Whether the start may move inside its feasible interval (start kind `best`).
        share: Parts of the cylinders' velocity and acceleration limits that may be used at the ends of the intervals;
            less than 1 leaves room for what happens between them.

    Returns:
        The polished motion and IPOPT's status; no motion where IPOPT did not converge.
    """
    problem, layout = polisher.problem, polisher.layout
    stages, n = problem.stages, layout.moving
    hardest = share[1] * np.array([c.acceleration_limit for c in problem.crane.machine.cylinders[problem.moving]])
    mode = _mode_parameters(problem, layout, switches)
    guess, low, high = _guess_and_bounds(polisher, seed, switches, mode, share)
    if not free_start:
        low[0, 0] = high[0, 0] = seed.position[0]
    parameters = np.concatenate(
        [
            np.concatenate([polisher.reference[:-1], polisher.reference[1:], mode[0], mode[1]], axis=1).ravel(),
            polisher.reference[-1],
        ]
    )
    node_low = np.zeros(n - 1 + (2 * n if layout.flows else 0))
    node_high = np.where(np.arange(node_low.size) < n - 1, 0.0, np.inf)
    load_rows = n if layout.loads else 0
    end_low = np.concatenate([-hardest[:-1], np.zeros(load_rows)])
    end_high = np.concatenate([hardest[:-1], np.full(load_rows, np.inf)])
    row_low = np.concatenate([np.zeros(2), node_low, end_low, end_low])
    row_high = np.concatenate([np.zeros(2), node_high, end_high, end_high])
    answer = polisher.solver(
        x0=guess.ravel(), p=parameters, lbx=low.ravel(), ubx=high.ravel(),
        lbg=np.concatenate([np.tile(row_low, stages), node_low]),
        ubg=np.concatenate([np.tile(row_high, stages), node_high]),
    )  # fmt: skip
    stats = polisher.solver.stats()
    text = f"{stats['return_status']} in {stats['iter_count']} iterations"
    if not stats["success"]:
        return None, text
    x = np.array(answer["x"]).reshape(stages + 1, layout.size)
    return motion.from_velocities(problem.step, float(x[0, 0]), x[:, 1], seed.method, layout.cost), text


def _guess_and_bounds(polisher: Polisher, seed: Motion, switches: Modes, mode: np.ndarray, share: tuple[float, float]):
    """First guess and bounds of all variables, (stages + 1, size) each; modes bound speeds and pressures."""
    problem, layout = polisher.problem, polisher.layout
    machine, n = problem.crane.machine, layout.moving
    cylinders, drives = machine.cylinders[problem.moving], problem.crane.drives[problem.moving]
    guess = np.zeros((problem.stages + 1, layout.size))
    low, high = np.full_like(guess, -np.inf), np.full_like(guess, np.inf)
    v = _speeds(problem, seed)
    guess[:, 0], guess[:, 1], guess[:-1, 2] = seed.position, seed.velocity, seed.acceleration
    guess[:, layout.speeds] = v
    low[:, 0], high[:, 0] = problem.lower, problem.upper
    high[:-1, 2] = share[1] * cylinders[-1].acceleration_limit
    low[:, 2] = -high[:, 2]
    low[-1, 2] = high[-1, 2] = 0.0
    held = HELD * machine.driven_velocity if layout.pressures else 0.0
    for i, column in enumerate(layout.speeds):
        high[:, column] = share[0] * cylinders[i].velocity_limit
        low[:, column] = -high[:, column]
        if layout.loads:
            # A seed that rides closer to the threshold keeps its place: two held cylinders may leave no other.
            sign = switches.sign[:, i]
            edge = np.where(sign == 0, np.maximum(held, np.abs(v[:, i])), held)
            low[:, column] = np.where(sign >= 0, -edge, low[:, column])
            high[:, column] = np.where(sign <= 0, edge, high[:, column])
    low[[0, -1], 1] = high[[0, -1], 1] = guess[[0, -1], 1] = 0.0
    if layout.flows:
        low[:, layout.flow] = 0.0
        for s, i in zip(range(layout.flow.start, layout.flow.stop), range(n), strict=True):
            guess[:, s] = LITRE * hydraulics.cylinder_flow(v[:, i], drives[i].area_out, drives[i].area_in)
    if layout.pressures:
        for end in range(2):
            column = layout.size - 2 + end
            low[:-1, column] = polisher.base_pressure[_nodes(end)]
            low[-1, column] = high[-1, column] = 0.0
            _, alpha, beta, gamma = mode[end].reshape(-1, 4, n).transpose(1, 0, 2)
            need = alpha * (beta * _force(problem, seed, end, switches.sign) + gamma)
            guess[:-1, column] = np.maximum(low[:-1, column], need.max(axis=1))
    return guess, low, high


def _mode_parameters(problem: Problem, layout: Layout, switches: Modes) -> np.ndarray:
    """Sign, alpha, beta, gamma of every cylinder at both ends of every interval, (2, stages, 4 moving)."""
    mode = np.zeros((2, problem.stages, 4, layout.moving))
    for end in range(2):
        sign, loaded = switches.sign[_nodes(end)], switches.loaded[end]
        for i, d in enumerate(problem.crane.drives[problem.moving]):
            s = sign[:, i]
            carries, overruns = loaded[:, i] & (s != 0), ~loaded[:, i] & (s != 0)
            if layout.pressures:
                # p >= gain F + back while loaded; the load's sign kept while overrunning; nothing while held.
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
    return mode.reshape(2, problem.stages, -1)
