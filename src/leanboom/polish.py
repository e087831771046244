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
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from leanboom import crane as cranes
from leanboom import hydraulics, motion
from leanboom.motion import Motion
from leanboom.stages import HELD, Problem

LITRE, MEGA = 1e3, 1e-6  # flow in l/s, pressure in MPa: their product is kW


@dataclass(frozen=True, slots=True, eq=False)
class Polisher:
    """The built problem of one task, pump and discretisation; `polish` solves it for given modes."""

    problem: Problem
    cost: str
    solver: Any
    shape: tuple[int, int]  # variables and rows of one interval
    reference: np.ndarray  # per node parameters of the reference, (parameters, stages + 1)
    names: dict = field(repr=False, default_factory=dict)


def build(problem: Problem, cost: str) -> Polisher:
    """Build the polishing problem for cost `ls` or `cp`."""
    import casadi as ca

    ca.GlobalOptions.setNumpyMode(1)
    n = len(problem.crane.machine.cylinders[problem.moving])
    loads = cost == "ls"
    size = 3 + (n - 1) + n + (2 if loads else 0)  # c w u, v, s, p0 p1
    here, there = ca.SX.sym("x", size), ca.SX.sym("y", size)
    theta, phi = ca.SX.sym("t", 7), ca.SX.sym("f", 7)  # reference at both ends
    mode0, mode1 = ca.SX.sym("m", 4 * n), ca.SX.sym("l", 4 * n)  # sign, alpha, beta, gamma of every cylinder

    start, end = _state(problem, here, here[2], theta), _state(problem, there, here[2], phi)
    node_rows = _node_rows(ca, problem, here, start, n)
    start_rows, start_power = _end_rows(ca, problem, here, start, here[-2] if loads else None, theta[6], mode0, n)
    end_rows, end_power = _end_rows(ca, problem, there, end, here[-1] if loads else None, phi[6], mode1, n)
    ts = problem.step
    rows = ca.vertcat(
        there[0] - here[0] - ts * here[1] - 0.5 * ts * ts * here[2],
        there[1] - here[1] - ts * here[2],
        node_rows,
        start_rows,
        end_rows,
    )
    cost_term = 0.5 * ts * (start_power + end_power)
    parameters = ca.vertcat(theta, phi, mode0, mode1)
    solver = _assemble(ca, problem.stages, here, there, parameters, rows, cost_term, node_rows, theta)
    p = problem.plane
    stage_flow, stage_pressure = _prescribed(problem)
    reference = np.stack([p.r, p.z, p.vr, p.vz, p.ar, p.az, stage_flow * LITRE])
    return Polisher(problem, cost, solver, (size, rows.numel()), reference, {"n": n, "base_pressure": stage_pressure * MEGA})


def _prescribed(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Flow [m^3/s] and counted pressure [Pa] of a base at every stage."""
    from leanboom import kernels, stages

    stage = np.zeros((problem.stages + 1, kernels.STAGE_COLUMNS))
    stages.prescribe(problem, stage, "ls")
    return stage[:, kernels.FIXED_FLOW], stage[:, kernels.FIXED_PRESSURE]


def _state(problem: Problem, x, u, theta):
    plane = cranes.Plane(theta[0], theta[1], theta[2], theta[3], theta[4], theta[5])
    pose = cranes.pose(problem.crane, plane, x[0])
    return pose, cranes.move(pose, x[1], u)


def _node_rows(ca, problem: Problem, x, state, n):
    """v = its kinematics (equality) and s >= A v, s >= -B v, per node."""
    _, moving = state
    velocity = moving.velocity[problem.moving]
    drives = problem.crane.drives[problem.moving]
    v = [x[3 + i] for i in range(n - 1)] + [x[1]]
    s = [x[3 + n - 1 + i] for i in range(n)]
    rows = [v[i] - velocity[i] for i in range(n - 1)]
    for i in range(n):
        rows += [s[i] - LITRE * drives[i].area_out * v[i], s[i] + LITRE * drives[i].area_in * v[i]]
    return ca.vertcat(*rows)


def _end_rows(ca, problem: Problem, x, state, pressure, flow, mode, n):
    """Accelerations and load conditions at one end of an interval, and the pump power there [kW]."""
    pose, moving = state
    machine = problem.crane.machine
    rows = [moving.acceleration[problem.moving][i] for i in range(n - 1)]
    for i in range(n):
        flow = flow + x[3 + n - 1 + i]
    if pressure is None:
        supply = machine.pump.constant_pressure * MEGA
    else:
        supply = pressure + machine.pump.ls_margin * MEGA
        for i in range(n):
            sign, alpha, beta, gamma = (mode[j * n + i] for j in range(4))
            force = moving.load[problem.moving][i] + pose.coulomb[problem.moving][i] * sign
            force = force + machine.cylinders[problem.moving][i].friction.viscous * moving.velocity[problem.moving][i]
            rows.append(alpha * pressure - beta * force - gamma)
    return ca.vertcat(*rows), hydraulics.pump_power(supply, flow, machine.pump.efficiency)


def _assemble(ca, stages, here, there, parameters, rows, cost, node_rows, theta):
    """An IPOPT solver whose exact derivatives are one stage function mapped over the stages, then scattered."""
    size, m, np_ = here.numel(), rows.numel(), parameters.numel()
    threads = max(1, min(2, os.cpu_count() or 1))
    both = ca.vertcat(here, there)
    lam = ca.SX.sym("lam", m)
    sigma = ca.SX.sym("sigma")
    jac = ca.jacobian(rows, both)
    hess, _ = ca.hessian(sigma * cost + ca.dot(lam, rows), both)
    hess = ca.triu(hess)
    grad = ca.gradient(cost, both)
    f_rows = ca.Function("rows", [both, parameters], [cost, rows]).map(stages, "thread", threads)
    f_jac = ca.Function("jacobians", [both, parameters], [ca.cse(ca.vertcat(*_nonzeros(ca, jac)))]).map(stages, "thread", threads)
    f_hess = ca.Function("hessians", [both, parameters, sigma, lam], [ca.cse(ca.vertcat(*_nonzeros(ca, hess)))]).map(stages, "thread", threads)
    f_grad = ca.Function("gradients", [both, parameters], [grad]).map(stages, "thread", threads)
    # The last node's own rows (v and s), which no interval begins with.
    last_lam = ca.SX.sym("last", node_rows.numel())
    last_jac = ca.jacobian(node_rows, here)
    last_hess = ca.triu(ca.hessian(ca.dot(last_lam, node_rows), here)[0])
    l_rows = ca.Function("last_rows", [here, theta], [node_rows])
    l_jac = ca.Function("last_jac", [here, theta], [ca.vertcat(*_nonzeros(ca, last_jac))])
    l_hess = ca.Function("last_hess", [here, theta, last_lam], [ca.vertcat(*_nonzeros(ca, last_hess))])

    x = ca.MX.sym("x", size * (stages + 1))
    p = ca.MX.sym("p", np_ * stages + theta.numel())
    blocks = ca.reshape(x, size, stages + 1)
    pairs = ca.vertcat(blocks[:, :-1], blocks[:, 1:])
    per = ca.reshape(p[: np_ * stages], np_, stages)
    last_x, last_p = blocks[:, -1], p[np_ * stages :]
    costs, g = f_rows(pairs, per)
    f = ca.sum2(costs)
    g = ca.vertcat(ca.vec(g), l_rows(last_x, last_p))

    offset = size * np.arange(stages)[:, None]
    total = size * (stages + 1)
    count_g = m * stages + node_rows.numel()
    # Jacobian: every block entry has its own place.
    r, c = (np.array(a) for a in jac.sparsity().get_triplet())
    lr, lc = (np.array(a) for a in last_jac.sparsity().get_triplet())
    jr = np.concatenate([(r[None] + m * np.arange(stages)[:, None]).ravel(), lr + m * stages])
    jc = np.concatenate([(c[None] + offset).ravel(), lc + size * stages])
    jac_nz = ca.vertcat(ca.vec(f_jac(pairs, per)), l_jac(last_x, last_p))
    jac_g = _scatter(ca, jac_nz, jr, jc, (count_g, total))
    # Hessian: neighbouring intervals share a node, so entries are summed where they meet.
    lam_f, lam_g = ca.MX.sym("lf"), ca.MX.sym("lg", count_g)
    hr, hc = (np.array(a) for a in hess.sparsity().get_triplet())
    wr, wc = (np.array(a) for a in last_hess.sparsity().get_triplet())
    rr = np.concatenate([(hr[None] + offset).ravel(), wr + size * stages])
    cc = np.concatenate([(hc[None] + offset).ravel(), wc + size * stages])
    lams = ca.reshape(lam_g[: m * stages], m, stages)
    hess_nz = ca.vertcat(
        ca.vec(f_hess(pairs, per, ca.repmat(lam_f, 1, stages), lams)), l_hess(last_x, last_p, lam_g[m * stages :])
    )
    hess_l = _scatter(ca, hess_nz, rr, cc, (total, total))
    gradient = f_grad(pairs, per)
    grad_f = ca.vec(
        ca.horzcat(gradient[:size, :], ca.MX.zeros(size, 1)) + ca.horzcat(ca.MX.zeros(size, 1), gradient[size:, :])
    )
    options = {
        "grad_f": ca.Function("nlp_grad_f", [x, p], [f, grad_f], ["x", "p"], ["f", "grad_f_x"]),
        "jac_g": ca.Function("nlp_jac_g", [x, p], [g, jac_g], ["x", "p"], ["g", "jac_g_x"]),
        "hess_lag": ca.Function(
            "nlp_hess_l", [x, p, lam_f, lam_g], [hess_l], ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
        ),
        "ipopt": {"print_level": 0, "sb": "yes", "max_iter": 150, "tol": 1e-6, "mu_init": 1e-3, "acceptable_tol": 1e-5,
                  "acceptable_iter": 5, "bound_push": 1e-4, "bound_frac": 1e-4, "bound_relax_factor": 0.0},
        "print_time": False,
        "error_on_fail": False,
    }  # fmt: skip
    return ca.nlpsol("polish", "ipopt", {"x": x, "p": p, "f": f, "g": g}, options)


def _nonzeros(ca, matrix):
    return [matrix.nz[i] for i in range(matrix.nnz())] if matrix.nnz() else [ca.SX(0, 1)]


def _scatter(ca, nonzeros, rows, columns, shape):
    """Sparse MX whose entries are sums of given values at given places."""
    key = columns.astype(np.int64) * shape[0] + rows
    unique, place = np.unique(key, return_inverse=True)
    sparsity = ca.Sparsity.triplet(
        shape[0], shape[1], (unique % shape[0]).tolist(), (unique // shape[0]).tolist()
    )
    if unique.size == key.size:
        order = np.argsort(key, kind="stable")
        return ca.MX(sparsity, nonzeros.nz[order.tolist()])
    gather = ca.DM(ca.Sparsity.triplet(unique.size, key.size, place.tolist(), list(range(key.size))), 1.0)
    return ca.MX(sparsity, ca.mtimes(gather, nonzeros))


@dataclass(frozen=True, slots=True, eq=False)
class Modes:
    """The switches: direction of every moving cylinder at every node, and whether it carries load."""

    sign: np.ndarray  # -1 retracts, 0 held, 1 extends, (stages + 1, moving)
    loaded: np.ndarray  # at the beginning and end of every interval, (2, stages, moving)

    def same_as(self, other: Modes) -> bool:
        """Whether all switches agree."""
        return np.array_equal(self.sign, other.sign) and np.array_equal(self.loaded, other.loaded)


def modes(problem: Problem, position, velocity, control, slack: float = 1.0) -> Modes:
    """Read the modes off a motion; cylinders faster than `slack` x epsilon count as driven."""
    crane = problem.crane
    pose = cranes.pose(crane, problem.plane, position)
    rates = np.stack(cranes.move(pose, velocity, 0.0).velocity, axis=1)[:, problem.moving]
    epsilon = slack * crane.machine.driven_velocity
    sign = np.where(rates > epsilon, 1, np.where(rates < -epsilon, -1, 0))
    loaded = np.zeros((2, problem.stages, sign.shape[1]), dtype=bool)
    for end, nodes in ((0, slice(None, -1)), (1, slice(1, None))):
        here = cranes.pose(crane, problem.plane[nodes], position[nodes])
        moving = cranes.move(here, velocity[nodes], control)
        load = np.stack(moving.load, axis=1)[:, problem.moving]
        viscous = np.array([c.friction.viscous for c in crane.machine.cylinders[problem.moving]])
        coulomb = np.stack(np.broadcast_arrays(*here.coulomb, position[nodes])[:-1], axis=1)[:, problem.moving]
        force = load + coulomb * sign[nodes] + viscous * np.stack(moving.velocity, axis=1)[:, problem.moving]
        loaded[end] = force * sign[nodes] > 0.0
    return Modes(sign, loaded)


def solve(polisher: Polisher, seed: Motion, switches: Modes, free_start: bool = False) -> tuple[Motion | None, str]:
    """Solve the smooth problem for given modes from a seed.

    Args:
        polisher: The built problem.
        seed: Motion on the problem's stages; gives start and first guess.
        switches: The modes.
        free_start: Whether the start may move inside its feasible interval (start kind `best`).

    Returns:
        The polished motion and IPOPT's status; no motion where IPOPT did not converge.
    """
    problem, (size, m) = polisher.problem, polisher.shape
    n, loads, stages = polisher.names["n"], polisher.cost == "ls", problem.stages
    machine, epsilon = problem.crane.machine, problem.crane.machine.driven_velocity
    cylinders, drives = machine.cylinders[problem.moving], problem.crane.drives[problem.moving]
    fastest = np.array([c.velocity_limit for c in cylinders])
    hardest = np.array([c.acceleration_limit for c in cylinders])
    sign, held = switches.sign, switches.sign == 0

    x0 = np.zeros((stages + 1, size))
    lb, ub = np.full((stages + 1, size), -np.inf), np.full((stages + 1, size), np.inf)
    pose = cranes.pose(problem.crane, problem.plane, seed.position)
    v = np.stack(cranes.move(pose, seed.velocity, 0.0).velocity, axis=1)[:, problem.moving]
    x0[:, 0], x0[:, 1], x0[:-1, 2] = seed.position, seed.velocity, seed.acceleration
    x0[:, 3 : 2 + n] = v[:, :-1]
    out, back = (np.array([getattr(d, name) for d in drives]) for name in ("area_out", "area_in"))
    x0[:, 2 + n : 2 + 2 * n] = LITRE * np.maximum(out * v, -back * v)
    lb[:, 0], ub[:, 0] = problem.lower, problem.upper
    lb[:, 2], ub[:, 2] = -hardest[-1], hardest[-1]
    lb[-1, 2] = ub[-1, 2] = 0.0
    columns = [*range(3, 2 + n), 1]
    for i, column in enumerate(columns):
        low, high = -fastest[i] * np.ones(stages + 1), fastest[i] * np.ones(stages + 1)
        if loads:
            # A seed that rides closer to the threshold keeps its place: two held cylinders may leave no other.
            edge = np.where(held[:, i], np.maximum(HELD * epsilon, np.abs(v[:, i])), HELD * epsilon)
            low = np.where(held[:, i] | (sign[:, i] > 0), -edge, low)
            high = np.where(held[:, i] | (sign[:, i] < 0), edge, high)
        lb[:, column], ub[:, column] = low, high
    lb[:, 2 + n : 2 + 2 * n] = 0.0
    if not free_start:
        lb[0, 0] = ub[0, 0] = seed.position[0]
    lb[[0, -1], 1] = ub[[0, -1], 1] = 0.0
    x0[[0, -1], 1] = 0.0

    mode = np.zeros((2, stages, 4, n))
    if loads:
        _load_parameters(mode, switches, drives)
        base = polisher.names["base_pressure"]
        for end, nodes in ((0, slice(None, -1)), (1, slice(1, None))):
            lb[:-1, -2 + end] = np.maximum(0.0, base[nodes])
            here = cranes.pose(problem.crane, problem.plane[nodes], seed.position[nodes])
            moving = cranes.move(here, seed.velocity[nodes], seed.acceleration)
            load = np.stack(moving.load, axis=1)[:, problem.moving]
            coulomb = np.stack(np.broadcast_arrays(*here.coulomb, seed.position[nodes])[:-1], axis=1)[:, problem.moving]
            force = load + coulomb * mode[end, :, 0]
            need = np.where(mode[end, :, 1] > 0, mode[end, :, 2] * force + mode[end, :, 3], 0.0)
            x0[:-1, -2 + end] = np.maximum(lb[:-1, -2 + end], need.max(axis=1))
        lb[-1, -2:] = ub[-1, -2:] = 0.0
    parameters = np.concatenate(
        [
            np.concatenate(
                [polisher.reference[:, :-1].T, polisher.reference[:, 1:].T, mode[0].reshape(stages, -1),
                 mode[1].reshape(stages, -1)], axis=1
            ).ravel(),
            polisher.reference[:, -1],
        ]
    )  # fmt: skip
    node_low = np.concatenate([np.zeros(n - 1), np.zeros(2 * n)])
    node_high = np.concatenate([np.zeros(n - 1), np.full(2 * n, np.inf)])
    end_low = np.concatenate([-hardest[:-1], np.zeros(n if loads else 0)])
    end_high = np.concatenate([hardest[:-1], np.full(n if loads else 0, np.inf)])
    row_low = np.concatenate([[0.0, 0.0], node_low, end_low, end_low])
    row_high = np.concatenate([[0.0, 0.0], node_high, end_high, end_high])
    answer = polisher.solver(
        x0=x0.ravel(), p=parameters, lbx=lb.ravel(), ubx=ub.ravel(),
        lbg=np.concatenate([np.tile(row_low, stages), node_low]),
        ubg=np.concatenate([np.tile(row_high, stages), node_high]),
    )  # fmt: skip
    stats = polisher.solver.stats()
    text = f"{stats['return_status']} in {stats['iter_count']} iterations, {float(answer['f']):.4f} kJ"
    if not stats["success"]:
        return None, text
    x = np.array(answer["x"]).reshape(stages + 1, size)
    return motion.from_velocities(
        problem.step, float(x[0, 0]), x[:, 1], seed.method, polisher.cost
    ), text


def _load_parameters(mode: np.ndarray, switches: Modes, drives) -> None:
    """Fill sign, alpha, beta, gamma so that alpha p - beta F - gamma >= 0 says what each mode asks for."""
    for end, nodes in ((0, slice(None, -1)), (1, slice(1, None))):
        sign = switches.sign[nodes]
        loaded = switches.loaded[end]
        for i, d in enumerate(drives):
            s = sign[:, i]
            gain = np.where(s > 0, d.gain_out, -d.gain_in) * MEGA
            backing = np.where(s > 0, d.back_out, d.back_in) * MEGA
            carries = loaded[:, i] & (s != 0) & (gain != 0.0)
            overruns = ~loaded[:, i] & (s != 0)
            mode[end, :, 0, i] = s
            mode[end, :, 1, i] = carries
            mode[end, :, 2, i] = np.where(carries, gain, np.where(overruns, 1e-5 * s, 0.0))
            mode[end, :, 3, i] = np.where(carries, backing, np.where(overruns, 0.0, -1.0))
