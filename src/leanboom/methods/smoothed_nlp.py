"""Smoothed nonlinear programs of the direct methods: smooth costs, assembly from nodes, constraint tightening.

The program is: least sum of the nodes' costs, rows of each node within bounds, linear equations between nodes.
`pseudospectral` and `multiple_shooting` differ in what a node is and in the linear equations.

| symbol | name | unit |
| --- | --- | --- |
| s | sharpness of the smoothed Heaviside step | s/m |
| e | constant under the root of the smoothed maximum | MPa^2 |
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

import numpy as np

from leanboom.components.costs import COSTS
from leanboom.evaluation import ranking
from leanboom.evaluation.evaluate import Evaluation
from leanboom.formulas import hydraulics
from leanboom.model import crane as cranes
from leanboom.model.cost_rates import demand_of, supply_of
from leanboom.model.motion import Motion
from leanboom.model.outcome import Kind, Outcome
from leanboom.progress import Progress

KILO, MEGA = 1e-3, 1e-6  # power in kW, pressure in MPa
REPAIRS = 4  # solves with limits tightened where they are exceeded between the nodes
TIGHTENING = 1.2  # by this share of what they are exceeded by
DAMPING_FACTOR = 3.0  # and with the damping raised by this factor: a swing between nodes touches no limit at them
USABLE_SHARE = 1.0005  # a limit used up to this needs no repair; half of what the judge tolerates
IPOPT = {
    "print_level": 0,
    "sb": "yes",
    "max_iter": 300,
    "tol": 1e-6,
    "acceptable_tol": 1e-4,
    "mu_strategy": "monotone",
    "mu_init": 1e-2,
}

# How IPOPT ends, in plain words.
ENDINGS = {
    "Solve_Succeeded": "solved",
    "Solved_To_Acceptable_Level": "solved, less sharply than asked for",
    "Infeasible_Problem_Detected": "no motion that keeps all limits was found near the first guess",
    "Search_Direction_Becomes_Too_Small": "the search came to a standstill",
    "Diverging_Iterates": "the search ran away",
    "Maximum_Iterations_Exceeded": "the iterations were used up",
    "Restoration_Failed": "no way back to the limits was found",
    "Error_In_Step_Computation": "no direction to search in was found",
    "Invalid_Number_Detected": "the search came to a pose that cannot be computed",
    "Insufficient_Memory": "memory ran out",
}
UNUSABLE = "no first guess that can be computed: the pseudo-inverse leads through a singular pose or beyond the limits"


# Smoothed costs, on CasADi symbols or numbers.


def smooth_heaviside(x: Any, sharpness: Any) -> Any:
    """Differentiable Heaviside step 1 / (1 + exp(-2 s x)), eq. (39); eq. (29), 3-DOF. As a tanh it cannot overflow."""
    return 0.5 * (1.0 + np.tanh(sharpness * x))


def smooth_maximum(a: Any, b: Any, small: Any) -> Any:
    """Differentiable maximum, eq. (42); eq. (36), 3-DOF. Half the root of the small constant too large at a = b."""
    return 0.5 * (a + b + np.sqrt((a - b) * (a - b) + small))


def smooth_power(
    crane: cranes.Crane, pose: cranes.Pose, moving: cranes.Moving, cost: str, sharpness: Any, small: Any
) -> Any:
    """Smoothed power of the pump: eqs. (36)-(43); eqs. (27)-(36), 3-DOF.

    Args:
        crane: The crane.
        pose: Its pose.
        moving: Its motion.
        cost: "ls" or "cp".
        sharpness: s of the smoothed Heaviside step [s/m]; per kW where the step is over a cylinder's power.
        small: The constant e of the smoothed maximum [MPa^2].

    Returns:
        The power [kW].
    """
    sensing = COSTS[cost].loads
    constant, shaft = supply_of(crane.machine.pump, COSTS[cost].supply)
    flow, pressures = 0.0, []
    for i, (v, force, d) in enumerate(zip(moving.velocity, cranes.forces(pose, moving), crane.drives, strict=True)):
        epsilon, gain_out, back_out, gain_in, back_in = demand_of(crane, i)
        out, back = smooth_heaviside(v, sharpness), smooth_heaviside(-v, sharpness)
        flow = flow + v * (d.area_out * out - d.area_in * back)  # eq. (37)
        pressure = (gain_out * force + back_out) * smooth_heaviside(v - epsilon, sharpness)
        pressure = pressure + (back_in - gain_in * force) * smooth_heaviside(-v - epsilon, sharpness)
        pressures.append(MEGA * pressure * smooth_heaviside(KILO * force * v, sharpness))  # eq. (41)
    supply = MEGA * constant
    if sensing:
        supply = reduce(lambda a, b: smooth_maximum(a, b, small), pressures) + supply  # eq. (40)
    return hydraulics.pump_power(supply, flow * KILO / MEGA, *shaft.in_kilowatts())


# The nonlinear program.


@dataclass(frozen=True, slots=True, eq=False)
class NodeFunctions:
    """Cost and rows of one node with their exact derivatives, as CasADi functions."""

    size: int  # variables of a node
    rows: int
    parameters: int
    value: Any  # (x, p) -> cost, rows
    gradient: Any  # (x, p) -> gradient of the cost
    jacobian: Any  # (x, p) -> non-zeros of the rows' Jacobian
    hessian: Any  # (x, p, sigma, lam) -> upper non-zeros of the Lagrangian's Hessian
    jacobian_places: tuple[np.ndarray, np.ndarray]
    hessian_places: tuple[np.ndarray, np.ndarray]


def node_functions(size: int, parameters: int, node: Callable[[Any, Any], tuple[Any, Any]]) -> NodeFunctions:
    """Differentiate a node once, for any number of nodes.

    Args:
        size: Variables of a node.
        parameters: Parameters of a node.
        node: Cost and rows (a column) of symbols for variables and parameters.
    """
    import casadi as ca

    ca.GlobalOptions.setNumpyMode(1)
    x, p = ca.SX.sym("x", size), ca.SX.sym("p", parameters)
    cost, rows = node(x, p)
    sigma, lam = ca.SX.sym("sigma"), ca.SX.sym("lam", rows.numel())
    jacobian = ca.jacobian(rows, x)
    hessian = ca.triu(ca.hessian(sigma * cost + ca.dot(lam, rows), x)[0])

    def function(name, inputs, outputs):
        return ca.Function(name, inputs, [ca.cse(ca.densify(output)) for output in outputs])

    def nonzeros(matrix):
        return ca.vertcat(*[matrix.nz[i] for i in range(matrix.nnz())], ca.SX(0, 1))

    def places(matrix):
        row, column = matrix.sparsity().get_triplet()
        return np.array(row, dtype=np.int64), np.array(column, dtype=np.int64)

    return NodeFunctions(
        size,
        rows.numel(),
        parameters,
        function("value", [x, p], [cost, rows]),
        function("gradient", [x, p], [ca.gradient(cost, x)]),
        function("jacobian", [x, p], [nonzeros(jacobian)]),
        function("hessian", [x, p, sigma, lam], [nonzeros(hessian)]),
        places(jacobian),
        places(hessian),
    )


def assemble(functions: NodeFunctions, nodes: int, linear: tuple, options: dict | None = None) -> Any:
    """An IPOPT solver of: least sum of node costs, rows within bounds, linear equations between nodes.

    Its constraints are the linear equations, then the rows of all nodes; variables, rows and parameters node by
    node. The derivatives of one node are mapped over the nodes and put in their places, which takes milliseconds,
    where differentiating the whole program takes seconds.

    Args:
        functions: The node.
        nodes: How many of them.
        linear: Linear equations as (count, row, column, value); the last three are arrays, (entries,).
        options: IPOPT options that differ from `IPOPT`.
    """
    import casadi as ca

    size, rows, total = functions.size, functions.rows, functions.size * nodes
    x, p = ca.MX.sym("x", total), ca.MX.sym("p", functions.parameters * nodes)
    per_x, per_p = ca.reshape(x, size, nodes), ca.reshape(p, functions.parameters, nodes)
    count, row, column, value = linear
    matrix = ca.DM.triplet(row.tolist(), column.tolist(), ca.DM(value), count, total)
    costs, values = functions.value.map(nodes)(per_x, per_p)
    f, g = ca.sum2(costs), ca.vertcat(ca.mtimes(matrix, x), ca.vec(values))

    node = np.arange(nodes)[:, None]
    r, c = functions.jacobian_places
    jacobian = _place(
        ca,
        ca.vertcat(ca.MX(ca.DM(value)), ca.vec(functions.jacobian.map(nodes)(per_x, per_p))),
        np.concatenate([row, (count + rows * node + r).ravel()]),
        np.concatenate([column, (size * node + c).ravel()]),
        (count + rows * nodes, total),
    )
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", count + rows * nodes)
    r, c = functions.hessian_places
    lam = ca.reshape(lam_g[count:], rows, nodes)
    hessian = _place(
        ca,
        ca.vec(functions.hessian.map(nodes)(per_x, per_p, ca.repmat(lam_f, 1, nodes), lam)),
        (size * node + r).ravel(),
        (size * node + c).ravel(),
        (total, total),
    )
    gradient = ca.vec(functions.gradient.map(nodes)(per_x, per_p))
    settings = {
        "grad_f": ca.Function("nlp_grad_f", [x, p], [f, gradient], ["x", "p"], ["f", "grad_f_x"]),
        "jac_g": ca.Function("nlp_jac_g", [x, p], [g, jacobian], ["x", "p"], ["g", "jac_g_x"]),
        "hess_lag": ca.Function(
            "nlp_hess_l", [x, p, lam_f, lam_g], [hessian], ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
        ),
        "ipopt": {**IPOPT, **(options or {})},
        "print_time": False,
        "error_on_fail": False,
    }
    return ca.nlpsol("direct", "ipopt", {"x": x, "p": p, "f": f, "g": g}, settings)


def _place(ca, nonzeros, row, column, shape):
    """Sparse matrix of given non-zeros, each in its own place."""
    sparsity = ca.Sparsity.triplet(*shape, row.tolist(), column.tolist())
    return ca.MX(sparsity, nonzeros.nz[np.lexsort((row, column)).tolist()])


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """IPOPT's answer to a program."""

    values: np.ndarray  # (nodes, variables)
    converged: bool
    text: str  # how IPOPT ended, in plain words, with iterations and objective
    raw: str  # the same in the solver's own words, for the log


def optimise(
    solver: Any, guess: np.ndarray, parameters: np.ndarray, bounds: tuple, row_bounds: tuple,
    right: np.ndarray | None = None,
) -> Answer:  # fmt: skip
    """Solve an assembled program.

    Args:
        solver: From `assemble`.
        guess: First guess, (nodes, variables).
        parameters: (nodes, parameters).
        bounds: Lower and upper bounds of the variables, (nodes, variables) each.
        row_bounds: Lower and upper bounds of the rows, (nodes, rows) each.
        right: Right sides of the linear equations, (count,); None: zeros.
    """
    equations = np.zeros(solver.size1_in("lbg") - row_bounds[0].size) if right is None else right
    try:
        answer = solver(
            x0=np.clip(guess, *bounds).ravel(), p=parameters.ravel(), lbx=bounds[0].ravel(), ubx=bounds[1].ravel(),
            lbg=np.concatenate([equations, row_bounds[0].ravel()]),
            ubg=np.concatenate([equations, row_bounds[1].ravel()]),
        )  # fmt: skip
    except RuntimeError as error:  # CasADi checks what it is given, and what it evaluates
        return Answer(_finite(guess), False, UNUSABLE, " ".join(str(error).split()))
    stats = solver.stats()
    values, cost, count = np.array(answer["x"]).reshape(guess.shape), float(answer["f"]), int(stats["iter_count"])
    status = str(stats["return_status"])
    reached = f", {cost:.4f} kJ" if np.isfinite(cost) else ""
    text = f"{ENDINGS.get(status, status.replace('_', ' ').lower())} ({count} iterations{reached})"
    return Answer(_finite(values), bool(stats["success"]), text, f"{status} after {count} iterations at {cost:.4f} kJ")


def _finite(values: np.ndarray) -> np.ndarray:
    """Variables that can be judged, whatever came out of a solver that failed."""
    return np.nan_to_num(values, posinf=0.0, neginf=0.0)


# A sequence of programs, and limits exceeded between the nodes.


@dataclass(frozen=True, slots=True)
class Level:
    """One solve of a bootstrapped sequence: how finely, how sharply."""

    sharpness: float  # s of eq. (39) [s/m]; [1/kW] where the step is over a cylinder's power
    maximum: float  # e of eq. (42) [MPa^2]
    damping: float  # weight of the squared extension acceleration [kW s^4/m^2]
    nodes: int = 0  # about how many points; 0: one a stage

    def __str__(self) -> str:
        return (f"{self.nodes} nodes, " if self.nodes else "") + f"s = {self.sharpness:g} s/m"


@dataclass(frozen=True, slots=True, eq=False)
class Attempt:
    """A level's motion, judged."""

    judged: Evaluation
    answer: Answer
    nodes: np.ndarray  # their times [s], (nodes,)


Tightening = tuple[np.ndarray, ...] | None  # by how much limits are tightened at the nodes
Solve = Callable[[Level, Attempt | None, Tightening], Attempt]
Tighten = Callable[[Attempt], Tightening]


def bootstrap(levels: tuple[Level, ...], solve: Solve, tighten: Tighten, cost: str, tell: Progress) -> Motion:
    """Solve level after level, each from the one before, then the last with limits tightened where it exceeds them.

    Args:
        levels: From coarse and smooth to fine and sharp.
        solve: Solves a level from an attempt (None: the first guess), with limits tightened.
        tighten: By how much an attempt asks for limits to be tightened; None: nothing to do.
        cost: "ls" or "cp".
        tell: Called with what happens and the share done.

    Returns:
        The cheapest by the judge of the motions that converged and keep all limits. Status and log as `plan` of the
        methods promises.
    """
    began = time.perf_counter()
    best: Evaluation | None = None
    settled: tuple[Level, Attempt] | None = None
    log: list[str] = []

    def attempt(level: Level, guess: Attempt | None, tightening: Tightening) -> Attempt:
        nonlocal best, settled
        made = solve(level, guess, tightening)
        seconds, energy = time.perf_counter() - began, made.judged.energy(cost)
        log.append(f"{seconds:6.2f} s  {level}: {made.answer.raw}, judged {1e-3 * energy:.5g} kJ, {made.judged.status}")
        if made.answer.converged:
            settled = level, made
            if best is None or ranking.beats(made.judged, best, cost):
                best = made.judged
        return made

    last = None
    for i, level in enumerate(levels):
        tell(str(level), i / len(levels))
        last = attempt(level, settled[1] if settled is not None else last, None)
    tightening = None
    for _ in range(REPAIRS):
        more = tighten(settled[1]) if settled is not None else None
        if settled is None or more is None:
            break
        tell("limits tightened", 1.0)
        before = tightening
        tightening = more if before is None else tuple(old + new for old, new in zip(before, more, strict=True))
        level = replace(settled[0], damping=settled[0].damping * DAMPING_FACTOR)
        last = attempt(level, settled[1], tightening)
        if not last.answer.converged:
            break
    tell("done", 1.0)
    assert last is not None
    if best is None:
        result = replace(last.judged.motion, status=Outcome(Kind.UNCONVERGED, f"not converged: {last.answer.text}"))
    else:
        result = best.motion if best.feasible else replace(best.motion, status=best.status)
    return replace(result, solve_s=time.perf_counter() - began, log=tuple(log))


def exceeded(judged: Evaluation, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far to tighten the limits of cylinder velocity and acceleration around each node.

    Args:
        judged: The motion that exceeds them.
        nodes: Times of the nodes [s], (nodes,).

    Returns:
        Amounts [m/s] and [m/s^2], (nodes, joints) each; 0 where no more than `USABLE_SHARE` of the limit is used.
    """
    amounts = []
    cylinders = judged.task.machine.cylinders
    for values, limits in (
        (judged.velocity, [c.velocity_limit for c in cylinders]),
        (judged.acceleration, [c.acceleration_limit for c in cylinders]),
    ):
        bound = np.array(limits)
        amounts.append(np.where(np.abs(values) > USABLE_SHARE * bound, TIGHTENING * (np.abs(values) - bound), 0.0))
    return around(amounts[0], judged.time, nodes), around(amounts[1], judged.time, nodes)


def around(values: np.ndarray, time: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """The largest sampled value, (samples, columns), between the neighbours of each node, (nodes, columns)."""
    first = np.minimum(np.searchsorted(time, nodes[:-1]), time.size - 1)
    largest = np.maximum.reduceat(values, first, axis=0)
    return np.maximum(np.concatenate([largest[:1], largest]), np.concatenate([largest, largest[-1:]]))
