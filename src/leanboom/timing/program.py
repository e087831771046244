r"""The joint program: speed along the path and motion of the redundant cylinder together, as a nonlinear program.

Time is cut into N intervals of length h, on which both accelerations are constant,

    tau' = omega,  omega' = alpha,    x' = w,  w' = u,

and every interval has its own copy of the states at its two ends, so that limits hold at both, from inside, and only
linear equations tie intervals together. All limits of the judge are rows of an interval: velocities, positions and pump
flow at its beginning, accelerations at both ends and in the middle. The cost is the time, or the smoothed energy of
`smoothed_nlp` by the trapezoidal rule. At corners of a path the tool rests, whatever the rate; each falls on the end of
an interval.

| symbol | name | unit |
| --- | --- | --- |
| tau, omega, alpha | time of the path's own timing, its rate, and the rate of that | s, -, 1/s |
| x, w, u | stroke of the redundant cylinder, its velocity and acceleration | m, m/s, m/s^2 |
| h | length of an interval | s |
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from leanboom.components.paths import Lines, Spline, cubics, geometry, pieces
from leanboom.formulas import kinematics
from leanboom.methods import smoothed_nlp
from leanboom.methods.smoothed_nlp import Answer, Level
from leanboom.model import crane as cranes
from leanboom.model.task import Task
from leanboom.timing.along import plane_at
from leanboom.timing.courses import Course, corners
from leanboom.timing.time_optimal import LEAST_TIME

# Columns of an interval's variables: states at its beginning, at its end, then what is constant on it.
TAU, OMEGA, X, W = 0, 1, 2, 3
END = 4  # the same states at the end
ALPHA, U, H = 8, 9, 10
SIZE = 11
PIECE = 13  # parameters of a point of the path: where its piece begins, and its coefficients
PARAMETERS = 2 * PIECE + 5  # two points, whole turns of the base, sharpness, e, damping, weight of time
OPTIONS = {"max_iter": 400, "tol": 1e-7, "acceptable_tol": 1e-5, "acceptable_iter": 10}
LEAST_INTERVAL = 1e-5  # [s]
BRISK = 0.1  # share of the duration in which a speed that doubles is damped like an acceleration limit used up
SHARE = 0.9999  # of velocity, acceleration and flow limits


@dataclass(frozen=True, slots=True)
class Ends:
    """Where the redundant cylinder starts and ends: lower and upper bound of each [m], and whether both are one."""

    start: tuple[float, float]
    end: tuple[float, float]
    same: bool = False


class Program:
    """The program of a task: an interval is differentiated once, for any number of them and any guess."""

    def __init__(
        self, task: Task, crane: cranes.Crane, shape: Lines | Spline, cost: str, ends: Ends, flow: float = np.inf
    ):
        """Differentiate an interval.

        Args:
            task: The task.
            crane: Its crane.
            shape: Its shape.
            cost: "time", "ls" or "cp".
            ends: Where the redundant cylinder starts and ends.
            flow: Largest pump flow [m^3/s]; infinite: none.
        """
        self.task, self.crane, self.shape, self.cost, self.ends = task, crane, shape, cost, ends
        self.flow = flow if flow < _most_flow(crane) else np.inf
        self._functions = smoothed_nlp.node_functions(SIZE, PARAMETERS, self._node)
        self._programs: dict[tuple, Any] = {}

    def solve(
        self, guess: Course, level: Level, total: float | None = None, *, even: bool = True, options: dict | None = None
    ) -> tuple[Answer, Course]:
        """Solve the program from a guess.

        Args:
            guess: The guess.
            level: How smooth the energy is.
            total: Duration [s]; None: free.
            even: Whether all intervals last equally long; else those between two corners do.
            options: IPOPT options that differ from `OPTIONS`.

        Returns:
            How the solver ended, and the motion that it ended with.
        """
        values, counts = self._guess(guess), guess.counts
        kept = (counts, even, total is None)
        if kept not in self._programs:
            linear = self._linear(counts, even, total is not None)
            program = smoothed_nlp.assemble(self._functions, sum(counts), linear, OPTIONS | (options or {}))
            self._programs[kept] = program, linear[0]
        program, equations = self._programs[kept]
        right = np.zeros(equations)
        if total is not None and not even:
            right[-1] = total
        answer = smoothed_nlp.optimise(
            program, values, self._parameters(values, counts, level), self._bounds(counts, total if even else None),
            self._row_bounds(sum(counts)), right,
        )  # fmt: skip
        found = answer.values
        tau, omega, x, w = (np.append(found[:, column], found[-1, END + column]) for column in (TAU, OMEGA, X, W))
        return answer, Course(np.concatenate([[0.0], np.cumsum(found[:, H])]), tau, omega, x, w, counts)

    def _node(self, z: Any, p: Any) -> tuple[Any, Any]:
        """Cost and rows of an interval."""
        import casadi as ca

        crane, machine = self.crane, self.crane.machine
        cylinders = machine.cylinders
        h, alpha, u = z[H], z[ALPHA], z[U]
        dynamics = [
            z[TAU] + h * (z[OMEGA] + 0.5 * h * alpha) - z[END + TAU],
            z[OMEGA] + h * alpha - z[END + OMEGA],
            z[X] + h * (z[W] + 0.5 * h * u) - z[END + X],
            z[W] + h * u - z[END + W],
        ]
        rows, power = list(dynamics), 0.0
        half = 0.5 * h
        middle = (
            z[TAU] + half * (z[OMEGA] + 0.5 * half * alpha), z[OMEGA] + half * alpha,
            z[X] + half * (z[W] + 0.5 * half * u), z[W] + half * u,
        )  # fmt: skip
        states = [z[state] for state in (TAU, OMEGA, X, W)], middle, [z[END + state] for state in (TAU, OMEGA, X, W)]
        for place, (piece, state) in enumerate(zip((0, 0, PIECE), states, strict=True)):
            tau, omega, x, w = state
            plane = self._plane(p[piece : piece + PIECE], p[2 * PIECE], tau, omega, alpha)
            pose = cranes.pose(crane, plane, x)
            moving = cranes.move(pose, w, u)
            if place == 0:
                rows += [v / c.velocity_limit for v, c in zip(moving.velocity, cylinders, strict=True)]
                rows += [
                    (q - 0.5 * (joint.lower + joint.upper)) / (0.5 * (joint.upper - joint.lower))
                    for q, joint in zip(pose.q[:2], machine.joints[-3:], strict=False)
                ]
                rows.append(cranes.elbow_cosine(crane, plane, pose.q[2]) / kinematics.BENT)
                if np.isfinite(self.flow):
                    areas = [(d.area_out, -d.area_in) for d in crane.drives]
                    for signs in product(*areas):
                        rows.append(sum(a * v for a, v in zip(signs, moving.velocity, strict=True)) / self.flow)
            rows += [a / c.acceleration_limit for a, c in zip(moving.acceleration, cylinders, strict=True)]
            if self.cost != "time" and place != 1:
                smooth = p[2 * PIECE + 1], p[2 * PIECE + 2]
                power = power + 0.5 * smoothed_nlp.smooth_power(crane, pose, moving, self.cost, *smooth)
        # Nothing stays undetermined: strokes where a slewing base alone is at its limits, speed where it costs nothing.
        restless = (u / cylinders[-1].acceleration_limit) ** 2
        if self.cost != "time":
            restless = restless + (BRISK * self.shape.duration * alpha) ** 2
        cost = h * (p[2 * PIECE + 4] + power + p[2 * PIECE + 3] * restless)
        return cost, ca.vertcat(*rows)

    def _plane(self, piece: Any, turns: Any, tau: Any, omega: Any, alpha: Any) -> cranes.Plane:
        """The tool in the boom's plane, on symbols."""
        since = tau - piece[0]
        point, velocity, acceleration = [], [], []
        for axis in range(3):
            c0, c1, c2, c3 = (piece[1 + 3 * power + axis] for power in range(4))
            first = c1 + since * (2.0 * c2 + 3.0 * since * c3)
            point.append(c0 + since * (c1 + since * (c2 + since * c3)))
            velocity.append(first * omega)
            acceleration.append((2.0 * c2 + 6.0 * since * c3) * omega * omega + first * alpha)
        (x, y, z), (vx, vy, vz), (ax, ay, az) = point, velocity, acceleration
        if not self.crane.machine.geometry.slewing:
            return cranes.Plane(x, z, vx, vz, ax, az)
        r, vr, ar, v1, a1 = kinematics.cylindrical(x, y, vx, vy, ax, ay)
        return cranes.Plane(r, z, vr, vz, ar, az, np.arctan2(y, x) + turns, v1, a1)

    def _guess(self, guess: Course) -> np.ndarray:
        """The variables of all intervals, (intervals, SIZE), from a motion at their ends."""
        h = np.diff(guess.time)
        states = np.stack([guess.tau, guess.omega, guess.x, guess.w], axis=1)
        rates = np.diff(guess.omega) / h, np.diff(guess.w) / h, h
        return np.column_stack([states[:-1], states[1:], *rates])

    def _parameters(self, values: np.ndarray, counts: tuple[int, ...], level: Level) -> np.ndarray:
        """The parameters of all intervals: pieces of the path where a guess is, and the smoothing."""
        begins, coefficients = cubics(self.shape)
        coefficients = coefficients.reshape(begins.size, -1)
        inside = 0.5 * (values[:, TAU] + values[:, END + TAU])
        found = []
        for tau in (values[:, TAU], values[:, END + TAU]):
            if isinstance(self.shape, Lines):  # pieces meet at corners
                piece = np.repeat(np.arange(begins.size), counts)
            else:  # a point where pieces meet belongs to that of the interval
                nearly = tau + 1e-9 * (inside - tau)
                piece = pieces(self.shape.breaks, nearly)
            found += [begins[piece][:, None], coefficients[piece]]
        plane = plane_at(self.task, self.shape, values[:, TAU])
        turns = np.zeros(values.shape[0])
        if self.crane.machine.geometry.slewing:
            point = geometry(self.shape, values[:, TAU])[0]
            turns = plane.q1 - np.arctan2(point[:, 1], point[:, 0])
        smoothing = [level.sharpness, level.maximum, level.damping, 1.0 if self.cost == "time" else 0.0]
        return np.column_stack([*found, turns, np.tile(smoothing, (values.shape[0], 1))])

    def _bounds(self, counts: tuple[int, ...], total: float | None) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of all variables, (intervals, SIZE) each; with a total, of equal intervals."""
        intervals = sum(counts)
        duration, joint, ratio = self.shape.duration, self.crane.machine.joints[-1], self.crane.ratio
        limit, most = self.crane.machine.redundant.velocity_limit, duration / LEAST_TIME
        lowest = [0.0, 0.0, joint.lower * ratio, -limit] * 2 + [-np.inf, -np.inf, LEAST_INTERVAL]
        highest = [duration, most, joint.upper * ratio, limit] * 2 + [np.inf] * 3
        low, high = np.tile(lowest, (intervals, 1)), np.tile(highest, (intervals, 1))
        for place, tau in zip(np.concatenate([[0], np.cumsum(counts)]), corners(self.shape), strict=True):
            if place < intervals:
                low[place, TAU] = high[place, TAU] = tau
            if place > 0:
                low[place - 1, END + TAU] = high[place - 1, END + TAU] = tau
        low[0, W] = high[0, W] = low[-1, END + W] = high[-1, END + W] = 0.0
        (low[0, X], high[0, X]), (low[-1, END + X], high[-1, END + X]) = self.ends.start, self.ends.end
        if total is not None:
            low[:, H] = high[:, H] = total / intervals
        return low, high

    def _row_bounds(self, intervals: int) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the rows of all intervals, (intervals, rows) each."""
        joints = len(self.crane.machine.joints)
        flows = 2**joints if np.isfinite(self.flow) else 0
        low = [0.0] * 4 + [-SHARE] * joints + [-1.0] * 3 + [-np.inf] * flows + [-SHARE] * 3 * joints
        high = [0.0] * 4 + [SHARE] * joints + [1.0] * 3 + [SHARE] * flows + [SHARE] * 3 * joints
        return np.tile(low, (intervals, 1)), np.tile(high, (intervals, 1))

    def _linear(self, counts: tuple[int, ...], even: bool, total: bool) -> tuple:
        """Equations between the intervals: states go on, lengths are equal, the ends may be one, the total is given."""
        rows: list[tuple[int, int, float]] = []
        row, intervals, behind_corners = 0, sum(counts), set(np.cumsum(counts)[:-1].tolist())
        for k in range(intervals - 1):
            here, there = SIZE * k, SIZE * (k + 1)
            ties = [(here + END + state, there + state) for state in (TAU, OMEGA, X, W)]
            if even or k + 1 not in behind_corners:
                ties.append((here + H, there + H))
            for one, other in ties:
                rows += [(row, one, 1.0), (row, other, -1.0)]
                row += 1
        if self.ends.same:
            rows += [(row, X, 1.0), (row, SIZE * (intervals - 1) + END + X, -1.0)]
            row += 1
        if total and not even:
            rows += [(row, SIZE * k + H, 1.0) for k in range(intervals)]
            row += 1
        places = np.array([entry[:2] for entry in rows])
        return row, places[:, 0], places[:, 1], np.array([value for _, _, value in rows])


def _most_flow(crane: cranes.Crane) -> float:
    """Pump flow with every cylinder at its velocity limit [m^3/s]."""
    pairs = zip(crane.machine.cylinders, crane.drives, strict=True)
    return sum(c.velocity_limit * max(d.area_out, d.area_in) for c, d in pairs)
