"""Masses, centres of mass, inertias and friction from chamber pressures and joint motions: eq. (16), Appendix B.

The bodies' values are found by bounded least squares through the moments of mass in which forces are linear, so that
no mass or inertia can become negative; what forces can tell of them are the base parameters, sums over bodies.
Cylinders at rest are left out: friction takes any value there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leanboom.formulas import dynamics
from leanboom.identification.base_parameters import BASE, Motion, base_map, condition, moment_columns, moments
from leanboom.identification.estimates import KNOWN, Estimate, Fitted, blocks_of, compare, covariance, kept
from leanboom.identification.logs.checks import Finding
from leanboom.identification.logs.conditioning import Data
from leanboom.model import crane as cranes
from leanboom.model.crane import Crane
from leanboom.model.machine import Body, Machine

MOVING = 0.004  # [m/s], slower cylinders are at rest
RATE = 40.0  # [Hz], of the rows of the fit
TRAINING = 0.7  # share of each part, its beginning
LEAST_TRAVEL = 0.05  # share of a joint's range
FAR_BETTER = 0.5  # times the residual
LEAST_MASS = 1.0  # [kg]
PRIOR_LEVER, PRIOR_HEIGHT = 0.5, 0.3  # [m]
STEP_TRAVEL = 1.0  # [m], extensions that travel less do not show friction steps
KNOTS, FINE_KNOTS = 0.1, 0.01  # [m], of the free friction profile, and of the one that stands for steps
STEP_CHANGE = 1e-3  # [m], for derivatives
LISTED = 6  # pairs of base parameters that are told together
WORTH = 0.97  # steps are kept if they leave less than this share of the extension's residual


@dataclass(slots=True, eq=False)
class _Rows:
    """One cylinder's rows: force = moments @ columns + friction."""

    joint: str
    cylinder: int
    columns: np.ndarray  # of the moments, (rows, 7 x bodies)
    sign: np.ndarray  # tanh(K v)
    velocity: np.ndarray
    extension: np.ndarray
    force: np.ndarray
    swapped: np.ndarray  # force if the chambers were swapped
    time: np.ndarray
    block: np.ndarray
    training: np.ndarray
    part: np.ndarray


def motion_of(data: Data, machine: Machine, every: int) -> Motion:
    """The joints' motion in conditioned logs, every so many samples.

    Args:
        data: The logs; a joint without a position channel is taken to be at rest in the middle of its range.
        machine: The machine.
        every: Samples from one row to the next.
    """
    size = data.time[::every].size
    q, v, a = [], [], []
    for joint in machine.joints:
        name = f"{joint.name}_position"
        if name in data.channels:
            q.append(data.channels[name][::every])
            v.append(data.rates[name][::every])
            a.append(data.accelerations[name][::every])
        else:
            q.append(np.full(size, 0.5 * (joint.lower + joint.upper)))
            v.append(np.zeros(size))
            a.append(np.zeros(size))
    return Motion(tuple(q), tuple(v), tuple(a))


def fit(data: Data, machine: Machine) -> Fitted | None:
    """Fit bodies and friction to the measured forces; None if no joint has pressures and enough motion.

    Args:
        data: The conditioned logs.
        machine: The draft.
    """
    bodies = machine.bodies
    rows = _rows(data, machine, bodies)
    if not rows:
        return None
    problem = _Problem(machine, bodies, rows)
    problem.solve()
    return problem.result()


def _rows(data: Data, machine: Machine, bodies: Sequence[Body]) -> list[_Rows]:
    every = max(1, round(data.rate / RATE))
    motion = motion_of(data, machine, every)
    columns = moment_columns(machine, bodies, motion)
    time, part = data.time[::every], data.part[::every]
    block = blocks_of(time, part)
    training = np.zeros(time.size, bool)
    for each in np.unique(part):
        inside = part == each
        begin, end = time[inside][0], time[inside][-1]
        training |= inside & (time <= begin + TRAINING * (end - begin))
    found = []
    for i, joint in enumerate(machine.joints):
        force = measured_force(data, machine, i)
        position = f"{joint.name}_position"
        if force is None or position not in data.channels:
            continue
        if np.ptp(data.channels[position][data.inner]) < LEAST_TRAVEL * (joint.upper - joint.lower):
            continue
        velocity, _ = cylinder_motion(data, machine, i)
        moving = (np.abs(velocity) > MOVING) & data.inner & data.usable[joint.name]
        for other in machine.names:
            moving &= data.usable[other] | (f"{other}_position" not in data.channels)
        moving = _eroded(moving, round(0.5 * data.rate / data.cutoff))[::every]
        v = velocity[::every]
        sharp = cranes.sharpness(Crane(machine, (), ()))[i]
        found.append(_Rows(
            joint.name, i, columns[i][moving], np.tanh(sharp * v[moving]), v[moving], motion.q[-1][moving],
            force[::every][moving],
            _swapped(data, machine, i, force)[::every][moving],
            time[moving], block[moving], training[moving], part[moving],
        ))  # fmt: skip
    return [each for each in found if each.force.size > 50 and each.training.sum() > 30]


def cylinder_motion(data: Data, machine: Machine, i: int) -> tuple[np.ndarray, np.ndarray]:
    """Velocity [m/s] and acceleration [m/s^2] of a cylinder, (samples,) each, eqs. (11)-(12).

    Args:
        data: The logs, with the position of its joint.
        machine: The machine, for the linkage.
        i: Number of the cylinder.
    """
    position = f"{machine.names[i]}_position"
    _, arm, slope = machine.cylinders[i].linkage.length_arm_slope(data.channels[position])
    rate = data.rates[position]
    return arm * rate, slope * rate**2 + arm * data.accelerations[position]


def measured_force(data: Data, machine: Machine, i: int) -> np.ndarray | None:
    """Force of the pressures on a piston [N], (samples,); None without them.

    Args:
        data: The logs.
        machine: The machine, for the cylinder's areas.
        i: Number of the cylinder.
    """
    name, (area_a, area_b) = machine.names[i], machine.cylinders[i].areas
    a, b = (data.channels.get(f"{name}_pressure_{side}") for side in "ab")
    if a is None or (b is None and machine.cylinders[i].connection.value != "single_acting"):
        return None
    return area_a * a - area_b * (machine.pump.tank_pressure if b is None else b)


def _swapped(data: Data, machine: Machine, i: int, force: np.ndarray) -> np.ndarray:
    """What `measured_force` would be with the two chambers' channels swapped; the same without two."""
    name, (area_a, area_b) = machine.names[i], machine.cylinders[i].areas
    a, b = (data.channels.get(f"{name}_pressure_{side}") for side in "ab")
    return force if a is None or b is None else area_a * b - area_b * a


def _eroded(mask: np.ndarray, samples: int) -> np.ndarray:
    """Where a mask and all its neighbours hold."""
    from scipy.ndimage import binary_erosion

    return binary_erosion(mask, np.ones(2 * samples + 1)) if samples else mask


def _hats(values: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Piecewise linear functions that are 1 at one knot and 0 at the others, (values, knots)."""
    return np.maximum(0.0, 1.0 - np.abs(values[:, None] - knots) / (knots[1] - knots[0]))


def _by_steps(extension: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Derivatives of the stepped friction by its four positions, (extensions, 4)."""
    moved = np.diag(np.full(4, STEP_CHANGE))
    ahead, back = ([dynamics.stepped_coulomb(extension, *(steps + way * m)) for m in moved] for way in (1.0, -1.0))
    return (np.stack(ahead, axis=1) - np.stack(back, axis=1)) / (2.0 * STEP_CHANGE)


class _Problem:
    """Bounded least squares over bodies, friction and friction steps."""

    def __init__(self, machine: Machine, bodies: Sequence[Body], rows: list[_Rows]):
        self.machine, self.bodies, self.rows = machine, bodies, rows
        self.n = 4 * len(bodies)
        self.joints = [each.joint for each in rows]
        full = [machine.full_force(machine.cylinders[each.cylinder]) for each in rows]
        limit = [machine.cylinders[each.cylinder].velocity_limit for each in rows]
        start, low, high, spread = [], [], [], []
        for body in bodies:
            start += [max(body.mass, 2 * LEAST_MASS), body.along, body.above, max(body.inertia, 1e-3)]
            low += [LEAST_MASS, -5.0, -2.0, 0.0]
            high += [1e4, 10.0, 2.0, 1e5]
            spread += [max(body.mass, 50.0), PRIOR_LEVER, PRIOR_HEIGHT, max(body.inertia, 50.0)]
        for each, force, speed in zip(rows, full, limit, strict=True):
            friction = machine.cylinders[each.cylinder].friction
            start += [max(friction.coulomb, 1.0), max(friction.viscous, 1.0)]
            low += [0.0, 0.0]
            high += [force, force / speed]
            spread += [0.2 * force, 0.1 * force / speed]
        self.start, self.spread = np.array(start), np.array(spread)
        self.bounds = np.array(low), np.array(high)
        self.steps: np.ndarray | None = None
        self.stepped = next((i for i, each in enumerate(rows) if each.joint == "extension"), None)
        extension = machine.joints[-1]
        self.knots = np.arange(extension.lower, extension.upper + FINE_KNOTS, FINE_KNOTS)
        self.triangles = [self._compressed(i) for i in range(len(rows))]
        self.sigma = np.array([float(np.std(each.force)) or 1.0 for each in rows])
        self.faults: tuple[Finding, ...] = ()
        self.floor: list[float] = []

    def _level(self, i: int, steps: np.ndarray | None, extension: np.ndarray) -> np.ndarray | float:
        if steps is None or i != self.stepped:
            return 1.0
        return dynamics.stepped_coulomb(extension, *steps)

    def _predict(self, x: np.ndarray, i: int, which: np.ndarray | slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
        """Force of the rows of a cylinder, and its derivatives by the parameters."""
        each = self.rows[i]
        steps = x[-4:] if self.steps is not None else None
        found, slopes = moments(x[: self.n])
        columns, sign, v, q = each.columns[which], each.sign[which], each.velocity[which], each.extension[which]
        coulomb, viscous = x[self.n + 2 * i], x[self.n + 2 * i + 1]
        level = self._level(i, steps, q)
        force = columns @ found + coulomb * sign * level + viscous * v
        jacobian = np.zeros((v.size, x.size))
        jacobian[:, : self.n] = columns @ slopes
        jacobian[:, self.n + 2 * i] = sign * level
        jacobian[:, self.n + 2 * i + 1] = v
        if steps is not None and i == self.stepped:
            jacobian[:, x.size - 4 :] = (coulomb * sign)[:, None] * _by_steps(q, steps)
        return force, jacobian

    def _compressed(self, i: int) -> np.ndarray:
        """The training rows of a cylinder as a triangle that has the same least squares, the force last.

        Friction steps need friction by position: its columns are hats over the extension.
        """
        each = self.rows[i]
        used = each.training
        sign = each.sign[used, None]
        if i == self.stepped:
            sign = sign * _hats(each.extension[used], self.knots)
        table = np.column_stack([each.columns[used], sign, each.velocity[used], each.force[used]])
        return np.asarray(np.linalg.qr(table, mode="r"))

    def _residual(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        parts, slopes = [], []
        found, by_body = moments(x[: self.n])
        for i, triangle in enumerate(self.triangles):
            coulomb, viscous = x[self.n + 2 * i], x[self.n + 2 * i + 1]
            level = np.ones(triangle.shape[1] - found.size - 2)
            steps = x[-4:] if self.steps is not None and i == self.stepped else None
            if steps is not None:
                level = dynamics.stepped_coulomb(self.knots, *steps)
            factors = np.concatenate([found, coulomb * level, [viscous]])
            slope = np.zeros((factors.size, x.size))
            slope[: found.size, : self.n] = by_body
            slope[found.size : -1, self.n + 2 * i] = level
            slope[-1, self.n + 2 * i + 1] = 1.0
            if steps is not None:
                slope[found.size : -1, x.size - 4 :] = coulomb * _by_steps(self.knots, steps)
            parts.append((triangle[:, :-1] @ factors - triangle[:, -1]) / self.sigma[i])
            slopes.append(triangle[:, :-1] @ slope / self.sigma[i])
        parts.append((x - self._centre) / self._spread)
        slopes.append(np.diag(1.0 / self._spread))
        # As many rows as parameters say the same: the solver decomposes them at every step.
        small = np.asarray(np.linalg.qr(np.column_stack([np.concatenate(slopes), np.concatenate(parts)]), mode="r"))
        return small[:, -1], small[:, :-1]

    def solve(self) -> None:
        """Free friction profile first, then steps if they are worth it; weights from residuals, twice."""
        self._signs()
        self._minimise(self.start)
        self._reweigh()
        self._minimise(self.x)
        if self.stepped is not None:
            extension = self.rows[self.stepped].extension
            if np.ptp(extension) > STEP_TRAVEL:
                self._try_steps()
        self._reweigh()
        self._minimise(self.x)

    def _signs(self) -> None:
        """Joints whose friction, free of bounds, would drive them, or whose forces fit better with chambers swapped.

        What such a fit, free of the draft too, leaves is kept as the floor of the errors.
        """
        negative = []
        self.floor = []
        for each in self.rows:
            used = each.training
            columns = np.column_stack([each.columns, each.sign])[used]
            scale = np.linalg.norm(columns, axis=0)
            columns = columns[:, scale > 1e-9 * scale.max()] / scale[scale > 1e-9 * scale.max()]
            found = np.linalg.lstsq(columns, each.force[used], rcond=1e-6)[0]
            residual = each.force[used] - columns @ found
            self.floor.append(float(np.sqrt(np.mean(residual**2))))
            other = each.swapped[used] - columns @ np.linalg.lstsq(columns, each.swapped[used], rcond=1e-6)[0]
            better = np.sum(other**2) < FAR_BETTER**2 * np.sum(residual**2)
            spread = np.linalg.pinv(columns.T @ columns, rcond=1e-9, hermitian=True)
            # Rows hang together over about a second.
            error = float(np.sqrt(spread[-1, -1] * np.mean(residual**2) * RATE))
            if found[-1] < -4.0 * error or better:
                negative.append(each.joint)
        self.faults = tuple(
            Finding(
                "chambers",
                f"{joint}_pressure_a",
                f"{joint}: its cylinder force does not fit its motion, as if friction drove it: chambers "
                f"{joint}_pressure_a and {joint}_pressure_b are swapped, or {joint}_position has the wrong sign",
                True,
            )
            for joint in negative
        )

    def _minimise(self, x: np.ndarray) -> None:
        from scipy.optimize import least_squares

        low, high = self.bounds
        self._centre, self._spread = self.start, self.spread
        if self.steps is not None:
            joint = self.machine.joints[-1]
            low = np.concatenate([low, np.full(4, joint.lower)])
            high = np.concatenate([high, np.full(4, joint.upper)])
            self._centre = np.concatenate([self.start, self.steps])
            self._spread = np.concatenate([self.spread, np.full(4, 1.0)])
            x = np.concatenate([x[: self.start.size], self.steps])
        x = np.clip(x, low + 1e-9 * (high - low), high - 1e-9 * (high - low))
        found = least_squares(
            lambda y: self._residual(y)[0], x, jac=lambda y: self._residual(y)[1],  # type: ignore[arg-type]
            bounds=(low, high),
            x_scale=self._spread, max_nfev=60,
        )  # fmt: skip
        self.x = found.x
        if self.steps is not None:
            self.steps = np.sort(found.x[-4:])
            self.x[-4:] = self.steps

    def _reweigh(self) -> None:
        for i, each in enumerate(self.rows):
            error = self._predict(self.x, i, each.training)[0] - each.force[each.training]
            square = min(float(np.mean(error * error)), self.floor[i] ** 2)
            # Errors hang together over a block, whose rows count as one: more would drown what the draft says.
            rows = error.size / np.unique(each.block[each.training]).size
            self.sigma[i] = max(float(np.sqrt(rows * square)), 1.0)

    def _try_steps(self) -> None:
        from scipy.optimize import least_squares

        i = self.stepped
        assert i is not None
        each = self.rows[i]
        used = each.training
        q, sign = each.extension[used], each.sign[used]
        plain = self._predict(self.x, i, used)[0] - each.force[used]
        rest = each.force[used] - each.columns[used] @ moments(self.x[: self.n])[0]
        knots = np.arange(q.min(), q.max() + KNOTS, KNOTS)
        hats = _hats(q, knots)
        # The gravity of what telescopes, free beside the profile.
        aside = each.columns[used][:, np.abs(each.columns[used]).max(axis=0) > 0.0]
        aside = aside / np.linalg.norm(aside, axis=0)
        profile = np.linalg.lstsq(np.column_stack([hats * sign[:, None], aside]), rest, rcond=1e-6)[0][: knots.size]
        weight = np.sqrt((hats * hats).sum(axis=0))

        def apart(y: np.ndarray) -> np.ndarray:
            return weight * (y[0] * dynamics.stepped_coulomb(knots, *np.cumsum(y[1:])) - profile)

        span = np.ptp(knots)
        level = float(np.quantile(profile, 0.1))
        best = None
        for first in (0.1, 0.2, 0.3, 0.4):
            for gap in (0.15, 0.25, 0.35):
                begin = [max(level, 10.0), knots[0] + first * span, 0.12 * span, gap * span, 0.12 * span]
                bounds = [1.0, knots[0] - span, 0.02, 0.0, 0.02], [np.inf, knots[-1], span, span, span]
                found = least_squares(apart, begin, bounds=bounds, x_scale=[max(level, 10.0), 1.0, 1.0, 1.0, 1.0])
                best = found if best is None or found.cost < best.cost else best
        assert best is not None
        before, self.steps = self.x, np.clip(np.cumsum(best.x[1:]), knots[0], knots[-1])
        self.x = self.x.copy()
        self.x[self.n + 2 * i] = best.x[0]
        self._minimise(self.x)
        left = self._predict(self.x, i, used)[0] - each.force[used]
        if np.sum(left**2) > WORTH * np.sum(plain**2):
            self.steps, self.x = None, before

    def result(self) -> Fitted:
        """Values, intervals and what the data cannot tell."""
        jacobians, residuals, blocks = [], [], []
        for i, each in enumerate(self.rows):
            force, jacobian = self._predict(self.x, i, each.training)
            jacobians.append(jacobian / self.sigma[i])
            residuals.append((each.force[each.training] - force) / self.sigma[i])
            blocks.append(each.block[each.training])
        prior = 1.0 / self._spread**2
        variance, posterior, factor = covariance(jacobians, residuals, blocks, prior)
        slopes = moments(self.x[: self.n])[1]
        base = base_map(self.machine, self.bodies)
        weights = np.zeros((len(BASE), self.x.size))
        weights[:, : self.n] = base @ slopes
        values = base @ moments(self.x[: self.n])[0]
        estimates = [
            self._estimate(name, value, row, variance, posterior, factor, motion)
            for (name, (_, motion)), value, row in zip(BASE.items(), values, weights, strict=True)
        ]
        for j, (name, value) in enumerate(zip(self._names(), self.x, strict=True)):
            row = np.zeros(self.x.size)
            row[j] = 1.0
            estimates.append(self._estimate(name, value, row, variance, posterior, factor, ""))
        rank, conditioned = condition([each.columns for each in self.rows][-3:], self.machine, self.bodies)
        shared = weights @ variance @ weights.T
        size = np.sqrt(np.maximum(np.diag(shared), 1e-30))
        names = list(BASE)
        remarks = [f"base parameters: rank {rank} of {len(BASE)}, condition number {conditioned:.3g}"]
        pairs = sorted(
            ((float(shared[i, j] / size[i] / size[j]), names[i], names[j])
             for i in range(len(names)) for j in range(i)
             if size[i] > 1e-12 and size[j] > 1e-12 and abs(shared[i, j]) > 0.9 * size[i] * size[j]),
            key=lambda pair: -abs(pair[0]),
        )  # fmt: skip
        remarks += [f"{a} and {b} are told together (correlation {r:.2f})" for r, a, b in pairs[:LISTED]]
        remarks += [f"{len(pairs) - LISTED} more pairs are told together"] if len(pairs) > LISTED else []
        fits, series = [], {}
        for i, each in enumerate(self.rows):
            model = self._predict(self.x, i)[0]
            name = f"{each.joint}_force"
            fits.append(compare(name, each.force, model, each.training))
            series[name] = (each.time, each.force, model, each.training)
        told = any(each.identifiable for each in estimates[: len(BASE)])
        if not told:
            remarks.append("the logs tell no sum over bodies: the machine file keeps the draft's bodies")
        return Fitted(self._machine(told), tuple(estimates), tuple(fits), series, tuple(remarks), self.faults)

    def _names(self) -> list[str]:
        names = [f"bodies.{b.name}.{key}" for b in self.bodies for key in ("mass", "along", "above", "inertia")]
        names += [f"cylinders.{joint}.friction.{key}" for joint in self.joints for key in ("coulomb", "viscous")]
        if self.steps is not None:
            names += [f"cylinders.extension.friction.steps[{i}]" for i in range(4)]
        return names

    def _estimate(self, name: str, value: float, row: np.ndarray, variance: np.ndarray, posterior: np.ndarray,
                  factor: float, motion: str) -> Estimate:  # fmt: skip
        before = float(row @ (self._spread**2 * row))
        left = max(float(row @ posterior @ row), float(row @ variance @ row))
        known = before > 0.0 and left < KNOWN * before
        half = factor * float(np.sqrt(max(row @ variance @ row, 0.0)))
        note = (
            ""
            if known
            else (f"to tell it, {motion}" if motion else "only sums over bodies are told: see the base parameters")
        )
        return Estimate.within(name, value, half, bool(known), note)

    def _machine(self, told: bool) -> Machine:
        """The machine with what was found; with the draft's bodies where nothing is told of them."""
        values = [kept(value) for value in self.x.tolist()]
        bodies = (
            self.bodies
            if not told
            else tuple(
                replace(b, **dict(zip(("mass", "along", "above", "inertia"), values[4 * i : 4 * i + 4], strict=True)))
                for i, b in enumerate(self.bodies)
            )
        )
        cylinders = list(self.machine.cylinders)
        for i, each in enumerate(self.rows):
            friction = cylinders[each.cylinder].friction
            coulomb, viscous = values[self.n + 2 * i : self.n + 2 * i + 2]
            steps = tuple(values[-4:]) if self.steps is not None and i == self.stepped else friction.steps
            if each.joint == "extension" and self.steps is None and np.ptp(each.extension) > STEP_TRAVEL:
                steps = None
            friction = replace(friction, coulomb=coulomb, viscous=viscous, steps=steps)
            cylinders[each.cylinder] = replace(cylinders[each.cylinder], friction=friction)
        return replace(self.machine, bodies=bodies, cylinders=tuple(cylinders))
