r"""maptor's adaptive pseudospectral mesh on the smoothed low-dimensional problem of `leanboom.methods.pseudospectral`.

States c, w and control u of the redundant cylinder, c' = w, w' = u, least integral of the smoothed power plus
a damping of u^2, rows for the other cylinders' velocities and accelerations and for the joints' ranges. The crane is
`leanboom.model.crane` on CasADi symbols, made one function of (t, c, w, u). maptor knows time as a symbol, so the path
has to be one formula of it: every polynomial piece of the path is a phase, linked to the next.
maptor solves, estimates each interval's error by integrating the dynamics with the control found, then raises
polynomial degrees or splits intervals until the error is below `ACCURACY`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import BarycentricInterpolator, CubicSpline

from leanboom.errors import LeanboomError
from leanboom.formulas import kinematics
from leanboom.methods import pseudo_inverse, pseudospectral, smoothed_nlp
from leanboom.methods.registry import Settings
from leanboom.methods.smoothed_nlp import Level
from leanboom.model import crane as cranes
from leanboom.model import motion
from leanboom.model.motion import Motion
from leanboom.model.task import Lines, Task
from leanboom.problem import feasible_strokes, stages
from leanboom.problem.stages import Problem

METHOD = "adaptive-mesh"
STEP = 0.01  # [s], of the resulting motion
INTERVAL, DEGREE = 1.5, 5  # first mesh: about how long its intervals are [s], degree of its polynomials
ACCURACY, MESHES = 1e-6, 6  # relative error of the dynamics aimed at; meshes at most
ITERATIONS = 600  # of IPOPT on a mesh
# Solved one after the other, each from the one before; all but the last on the first mesh alone.
LEVELS = (Level(200.0, 1.0, 1.0), Level(1000.0, 1.0, 0.1))

Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """A part of the path that is one polynomial of the time since it began."""

    begin: float  # [s]
    end: float
    coefficients: np.ndarray  # of x, y, z, highest power first, (powers, 3)


def pieces(task: Task) -> list[Piece]:
    """The path of a task as polynomials."""
    path = task.path
    points = np.asarray(path.points, dtype=np.float64)
    if isinstance(path, Lines):
        ends = np.cumsum(path.durations)
        found = []
        for i, (end, t) in enumerate(zip(ends, path.durations, strict=True)):
            shape = np.array([6.0 / t**5, -15.0 / t**4, 10.0 / t**3, 0.0, 0.0, 0.0])
            coefficients = shape[:, None] * (points[i + 1] - points[i])
            coefficients[-1] += points[i]
            found.append(Piece(float(end - t), float(end), coefficients))
        return found
    spline = CubicSpline(np.asarray(path.times), points, bc_type="clamped")
    return [
        Piece(float(begin), float(end), spline.c[:, i])
        for i, (begin, end) in enumerate(zip(path.times[:-1], path.times[1:], strict=True))
    ]


def plan(task: Task, cost: str, start: float, tell: Progress, settings: Settings) -> Motion:
    """The motion of the last level that converged.

    Args:
        task: The task.
        cost: "ls" or "cp".
        start: Where the redundant cylinder starts [m].
        tell: Called with what happens and the share done.
        settings: Not used.

    Raises:
        LeanboomError: If IPOPT does not converge on the first mesh of the first level: there is no motion then.
    """
    problem = stages.discretise(task, STEP)
    best, log = None, []
    for number, level in enumerate(LEVELS):
        tell(str(level), number / len(LEVELS))
        seed = best or pseudo_inverse.resolve(task, start, "actuator")
        answer = solve(problem, cost, start, level, seed, MESHES if level is LEVELS[-1] else 1)
        if isinstance(answer, str):
            log.append(f"{level} not converged: {answer}")
            break
        best = answer
        log = [*best.log]
    if best is None:
        raise LeanboomError(log[0])
    return replace(best, log=("; ".join(log),))


def solve(problem: Problem, cost: str, start: float, level: Level, seed: Motion, meshes: int) -> Motion | str:
    """Solve a level of smoothing.

    Args:
        problem: The discretised task.
        cost: "ls" or "cp".
        start: Where the redundant cylinder starts [m].
        level: The smoothing.
        seed: The first guess.
        meshes: Meshes at most.

    Returns:
        The motion of the last mesh; where IPOPT fails on the first, its status.
    """
    import maptor

    model = maptor.Problem(problem.task.name)
    parts = pieces(problem.task)
    total, before = 0.0, None
    for number, piece in enumerate(parts, 1):
        node = node_function(problem, piece, cost, level)
        integral, before = add_phase(model, number, problem, piece, node, before or start, number == len(parts), seed)
        total = total + integral
    model.minimize(total)
    options: dict[str, object] = {f"ipopt.{name}": value for name, value in smoothed_nlp.IPOPT.items()}
    options |= {"ipopt.max_iter": ITERATIONS, "print_time": False}
    solution = maptor.solve_adaptive(
        model, error_tolerance=ACCURACY, max_iterations=meshes, nlp_options=options, show_summary=False
    )
    if not solution.status["success"]:
        return solution.status["message"].rsplit("return_status is ")[-1]
    return as_motion(problem, solution, len(parts), start, cost)


def add_phase(
    model: Any, number: int, problem: Problem, piece: Piece, node: Any, start: Any, last: bool, guess: Motion
) -> tuple[Any, Any]:
    """Add a piece of the path to maptor's problem as a phase.

    Args:
        model: maptor's problem.
        number: Number of the phase, from 1 on.
        problem: The discretised task.
        piece: The piece.
        node: From `node_function`.
        start: Where the redundant cylinder starts [m], or the two states of the phase before.
        last: Whether the path ends here, at rest.
        guess: The first guess.

    Returns:
        The phase's integral [kJ], and its two states.
    """
    phase = model.set_phase(number)
    time = phase.time(initial=piece.begin, final=piece.end)
    first = (start, 0.0) if isinstance(start, float) else (start[0].final, start[1].final)
    cylinder = problem.crane.machine.redundant
    c = phase.state("c", initial=first[0], boundary=feasible_strokes.stroke_range(problem.task))
    speed = (-cylinder.velocity_limit, cylinder.velocity_limit)
    w = phase.state("w", initial=first[1], final=0.0 if last else None, boundary=speed)
    u = phase.control("u", boundary=(-cylinder.acceleration_limit, cylinder.acceleration_limit))
    phase.dynamics({c: w, w: u})
    power, rows = node(time(), c(), w(), u)
    for i in range(rows.numel()):
        phase.path_constraints(rows[i] <= 1.0, rows[i] >= -1.0)
    count = max(1, int(round((piece.end - piece.begin) / INTERVAL)))
    edges = np.linspace(-1.0, 1.0, count + 1)
    phase.mesh([DEGREE] * count, edges)
    tau = pseudospectral.radau(DEGREE)[0]
    states, controls = [], []
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        share = 0.5 * (low + 0.5 * (high - low) * (tau + 1.0) + 1.0)
        at = guess.at(piece.begin + (piece.end - piece.begin) * share)
        states.append(np.stack(at[:2]))
        controls.append(at[2][None, :-1])
    phase.guess(states=states, controls=controls, initial_time=piece.begin, terminal_time=piece.end)
    return phase.add_integral(power), (c, w)


def node_function(problem: Problem, piece: Piece, cost: str, level: Level) -> Any:
    """Smoothed power with damping [kW] and rows within [-1, 1], as a CasADi function of t, c, w, u."""
    import casadi as ca

    ca.GlobalOptions.setNumpyMode(1)
    crane, machine = problem.crane, problem.crane.machine
    t, c, w, u = (ca.SX.sym(name) for name in "tcwu")
    x, vx, ax = on_path(piece.coefficients, t - piece.begin)
    if machine.geometry.slewing:
        q1 = np.arctan2(x[1], x[0])  # whole turns change nothing that is used here
        r, vr, ar, v1, a1 = kinematics.cylindrical(x[0], x[1], vx[0], vx[1], ax[0], ax[1])
    else:
        q1 = v1 = a1 = 0.0
        r, vr, ar = x[0], vx[0], ax[0]
    pose = cranes.pose(crane, cranes.Plane(r, x[2], vr, vx[2], ar, ax[2], q1, v1, a1), c)
    state = cranes.move(pose, w, u)
    rows = []
    for values, name in ((state.velocity, "velocity_limit"), (state.acceleration, "acceleration_limit")):
        cylinders = machine.cylinders[problem.moving][:-1]  # the redundant one comes last; its limits are bounds
        rows += [v / getattr(a, name) for v, a in zip(values[problem.moving][:-1], cylinders, strict=True)]
    for q, joint in zip(pose.q[:2], machine.joints[-3:-1], strict=True):
        rows.append((q - 0.5 * (joint.lower + joint.upper)) / (0.5 * (joint.upper - joint.lower)))
    power = smoothed_nlp.smooth_power(crane, pose, state, cost, level.sharpness, level.maximum)
    power = power + level.damping * u * u
    return ca.Function("node", [t, c, w, u], [ca.cse(power), ca.cse(ca.vertcat(*rows))])


def on_path(coefficients: np.ndarray, t: Any) -> list[list[Any]]:
    """Position, velocity and acceleration of the tool on a polynomial, (3, 3), at a time since it began."""
    found = []
    for order in range(3):
        values = []
        for axis in range(3):
            value = 0.0
            for factor in np.polyder(coefficients[:, axis], order):
                value = value * t + factor
            values.append(value)
        found.append(values)
    return found


def as_motion(problem: Problem, solution: Any, phases: int, start: float, cost: str) -> Motion:
    """What maptor found, sampled on stages of `STEP`."""
    velocity = np.zeros_like(problem.time)
    for number in range(1, phases + 1):
        found = solution.phases[number]
        begin, end = found["times"]["initial"], found["times"]["final"]
        edges = begin + 0.5 * (end - begin) * (np.asarray(found["mesh"]["mesh_nodes"]) + 1.0)
        degrees = found["mesh"]["polynomial_degrees"]
        values, first = solution[(number, "w")], 0
        for low, high, degree in zip(edges[:-1], edges[1:], degrees, strict=True):
            inside = (problem.time >= low - 1e-9) & (problem.time <= high + 1e-9)
            nodes = low + 0.5 * (high - low) * (pseudospectral.radau(degree)[0] + 1.0)
            polynomial = BarycentricInterpolator(nodes, values[first : first + degree + 1])
            velocity[inside] = polynomial(problem.time[inside])
            first += degree + 1  # neighbours both hold the point between them
    velocity[[0, -1]] = 0.0
    sizes = solution.adaptive["benchmark"]["collocation_points"]
    text = f"{len(sizes)} meshes, {sizes[-1]} points in the last"
    if not solution.adaptive["converged"]:
        text += ", its error above the aim"
    return motion.from_velocities(problem.step, start, velocity, METHOD, cost, log=(text,))
