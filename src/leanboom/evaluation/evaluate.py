"""The judge: completes any Motion on a 2 ms grid and measures it; every number a user sees comes from here.

Energy is the trapezoidal integral of pump power, for the load-sensing and for the constant-pressure pump,
whatever the motion was planned for. Limits are checked at every sample and between them, see `limit_checks`: use 1.0
means at the limit.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from leanboom import resources
from leanboom.components.costs import PUMPS, Supply, of_pump
from leanboom.components.pump_power import shaft_of
from leanboom.errors import InputError
from leanboom.evaluation import limit_checks, remarks
from leanboom.evaluation.limit_checks import PATH_TOLERANCE, TOLERANCE, LimitUse
from leanboom.formulas import hydraulics, kinematics
from leanboom.model import crane as cranes
from leanboom.model import motion as motions
from leanboom.model.cost_rates import demanded_pressure, rate, supply_of
from leanboom.model.motion import Motion
from leanboom.model.outcome import SOLVED, Kind, Outcome
from leanboom.model.pump_flow import pump_flow
from leanboom.model.task import Stretch, Task, sample

__all__ = ["PATH_TOLERANCE", "SAMPLE", "TOLERANCE", "Evaluation", "LimitUse", "evaluate", "judged_cost"]

SAMPLE = 0.002  # [s], the papers' recording rate
# Memory a sample takes [bytes]: while a motion is measured, plain and a joint; in an evaluation, a joint.
MEASURING, STORED = (300, 250), 105


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """A motion of the whole crane, measured. Arrays are (samples,) or (samples, joints), joint order."""

    task: Task
    motion: Motion
    time: np.ndarray  # [s], (samples,)
    tool: np.ndarray  # tool position by forward kinematics [m], (samples, 3)
    tool_target: np.ndarray  # [m], (samples, 3)
    joint_position: np.ndarray  # [rad] or [m], (samples, joints)
    joint_velocity: np.ndarray
    joint_acceleration: np.ndarray
    length: np.ndarray  # cylinder lengths; the extension's beyond retracted [m], (samples, joints)
    velocity: np.ndarray  # cylinder velocities [m/s], (samples, joints)
    acceleration: np.ndarray  # [m/s^2], (samples, joints)
    force: np.ndarray  # [N], (samples, joints)
    pressure: np.ndarray  # demanded pressures, eq. (41) [Pa], (samples, joints)
    flow: np.ndarray  # pump flow of each cylinder [m^3/s], (samples, joints)
    pump_flow: np.ndarray  # [m^3/s], (samples,)
    supply_ls: np.ndarray  # [Pa], (samples,)
    supply_cp: np.ndarray  # [Pa], (samples,)
    power_ls: np.ndarray  # [W], (samples,)
    power_cp: np.ndarray  # [W], (samples,)
    cumulative_ls: np.ndarray  # energy so far [J], (samples,)
    cumulative_cp: np.ndarray  # [J], (samples,)
    limit_use: LimitUse
    path_error: float  # largest distance of the tool from its path [m]
    violations: tuple[str, ...]  # one sentence a violated limit, worst first
    notes: tuple[str, ...]  # what a real pump could not do, or LS energy leaves out; no limits of the planning problem
    followed: bool  # whether the crane can make the motion at all; if not, energies are not the task's: "-" in tables

    @property
    def energy_ls(self) -> float:
        """Energy of the load-sensing pump [J]."""
        return float(self.cumulative_ls[-1])

    @property
    def energy_cp(self) -> float:
        """Energy of the constant-pressure pump [J]."""
        return float(self.cumulative_cp[-1])

    def energy(self, pump: str) -> float:
        """Energy of the chosen pump, "ls" or "cp" [J].

        Raises:
            InputError: For any other name.
        """
        return float(of_pump(pump, self.cumulative_ls, self.cumulative_cp)[-1])

    def spent(self, pump: str, since: float, until: float) -> float:
        """Energy of the chosen pump, "ls" or "cp", between two times [s] [J]."""
        before, after = np.interp([since, until], self.time, of_pump(pump, self.cumulative_ls, self.cumulative_cp))
        return float(after - before)

    @property
    def feasible(self) -> bool:
        """Whether every limit is kept and the tool stays on its path."""
        return not self.violations

    @property
    def bend(self) -> np.ndarray:
        """Angle between the boom and the line from tilt joint to tool, 0 with the arm straight [rad], (samples,)."""
        g = self.task.machine.geometry
        return np.abs(self.joint_position[:, -2] + np.arctan2(g.offset, g.outer + self.joint_position[:, -1]))

    @property
    def worst_use(self) -> float:
        """Largest use of any limit, that of the path's tolerance among them."""
        return max(self.limit_use.worst, self.path_error / PATH_TOLERANCE)

    @property
    def deliverable(self) -> bool:
        """Whether the pump can deliver what the motion needs: the constant-pressure one if planned for it, else LS."""
        return not self._shortfalls(self._pump)

    @property
    def status(self) -> Outcome:
        """`solved`, or the violated limit or the shortfall of the pump of `deliverable`, as a sentence."""
        return self.status_with(self._pump)

    def status_with(self, pump: str) -> Outcome:
        """`solved`, the worst violation as a sentence, or else what the chosen pump, "ls" or "cp", cannot deliver."""
        if self.violations:
            kind = Kind.UNCONVERGED if self.motion.status.kind is Kind.UNCONVERGED else Kind.INFEASIBLE
            return Outcome(kind, self.violations[0])
        found = self._shortfalls(pump)
        return Outcome(Kind.UNDELIVERABLE, remarks.undeliverable(found)) if found else SOLVED

    @property
    def _pump(self) -> str:
        return "cp" if self.motion.cost == "cp" else "ls"

    def _shortfalls(self, pump: str) -> tuple[remarks.Shortfall, ...]:
        given = self.task.machine.pump
        return remarks.shortfalls(given, pump, self.time, self.pump_flow, self.supply_ls, self.pressure)

    @property
    def summary(self) -> str:
        """Task, method, energies and use of limits in a few words."""
        use = self.limit_use
        ls, cp = (f"{e / 1e3:.2f} kJ" if self.followed else "-" for e in (self.energy_ls, self.energy_cp))
        used = f"limit use {use.position:.3f}/{use.velocity:.3f}/{use.acceleration:.3f}"
        return f"{self.task.name}, {self.motion.method}: LS {ls}, CP {cp}, {used}"

    def __repr__(self) -> str:
        return self.status.head(f"Evaluation({self.summary}, {self.status})")


def evaluate(task: Task, motion: Motion) -> Evaluation:
    """The `Evaluation` of a motion.

    Args:
        task: The task the motion belongs to.
        motion: Motion of the redundant cylinder, from any method; of a task with legs, that of all of them.

    Returns:
        The completed motion with pressures, flows, power, energy and limit use on a 2 ms grid, all finite. Where a
        motion asks for a straight arm or one out of reach, the tool stays at the nearest pose with a bent one, off its
        path; values that do not exist, as of a linkage that does not close, are 0. Either way `followed` is False.

    Raises:
        InputError: If the motion does not last as long as the task, if the task is too long for the memory that is
            free, or if its path passes through the slewing axis.
    """
    _check(task, motion)
    with np.errstate(all="ignore"):  # linkages beyond their joints' ranges: reported as such
        return _by_stretches(task, motion) if task.legs else _evaluate(task, motion)


def _by_stretches(task: Task, whole: Motion) -> Evaluation:
    """The judged motion of a task with legs: that of each leg and of the waiting between them, one after the other."""
    stretches = task.stretches
    parts = [_evaluate(task.stretch(each), motions.between(whole, each.since, each.until)) for each in stretches]
    arrays = {
        field.name: _chained(field.name, parts, stretches)
        for field in fields(Evaluation)
        if isinstance(getattr(parts[0], field.name), np.ndarray)
    }
    for array in arrays.values():
        array.setflags(write=False)
    exists, path_error = all(part.followed for part in parts), max(part.path_error for part in parts)
    worst_first = sorted(zip(parts, stretches, strict=True), key=lambda pair: -pair[0].worst_use)
    violations = [
        f"{stretch.said}: {sentence}" for part, stretch in worst_first for sentence in part.violations
        if sentence is not whole.status
    ]  # fmt: skip
    violations += limit_checks.apart(task, [part.joint_position for part in parts], [part.length for part in parts])
    violations += limit_checks.unended(task, arrays["length"][:, -1], np.zeros(1))
    if whole.status.kind is Kind.UNCONVERGED:
        violations.insert(0, whole.status)
    energies = float(arrays["cumulative_ls"][-1]), float(arrays["cumulative_cp"][-1])
    return Evaluation(
        task=task,
        motion=whole,
        **arrays,
        limit_use=limit_checks.largest_of([part.limit_use for part in parts]),
        path_error=path_error,
        violations=tuple(violations),
        notes=_notes(
            task,
            arrays["time"],
            arrays["velocity"],
            arrays["force"],
            arrays["pump_flow"],
            arrays["supply_ls"],
            arrays["pressure"],
            energies,
        ),  # fmt: skip
        followed=exists,
    )


def _chained(name: str, parts: list[Evaluation], stretches: tuple[Stretch, ...]) -> np.ndarray:
    """An array of judged motions one after the other: where they meet, the end of the one before counts."""
    found = [getattr(parts[0], name)]
    for part, stretch in zip(parts[1:], stretches[1:], strict=True):
        before = stretch.since if name == "time" else found[-1][-1] if name.startswith("cumulative") else 0.0
        found.append(before + getattr(part, name)[1:])
    return np.concatenate(found)


def _check(task: Task, motion: Motion) -> None:
    lasts = motion.duration
    if abs(lasts - task.duration) > 1e-6 * task.duration:
        raise InputError(f"the motion lasts {lasts:g} s, the task {task.name} {task.duration:g} s")
    check_measurable(task)


def _evaluate(task: Task, motion: Motion) -> Evaluation:
    crane = cranes.build(task)
    machine = task.machine
    time = np.linspace(0.0, task.duration, _samples(task))
    looks = limit_checks.times(task.path, time, motion if task.smooth is None else None)
    regular = np.searchsorted(looks, time)
    c, w, u = motion.at(looks) if task.smooth is None else _low_pass(motion, time, looks, task.smooth)
    reference = sample(task, looks)
    plane = cranes.plane(machine, reference)
    pose = cranes.pose(crane, plane, c)
    moving = cranes.move(pose, w, u)
    g = machine.geometry
    r, z = kinematics.tool_point(*pose.q, g.base_x, g.base_z, g.boom, g.offset, g.outer)
    rows = {
        "tool": (r * np.cos(plane.q1), r * np.sin(plane.q1), z),
        "joint_position": (plane.q1, *pose.q) if g.slewing else pose.q,
        "joint_velocity": moving.joint_velocity, "joint_acceleration": moving.joint_acceleration,
        "length": tuple(length for length, _, _ in pose.cylinders), "velocity": moving.velocity,
        "acceleration": moving.acceleration, "force": cranes.forces(pose, moving),
    }  # fmt: skip
    exists = all(np.isfinite(row).all() for values in rows.values() for row in values)
    if not exists:
        rows = {name: tuple(_finite(row) for row in values) for name, values in rows.items()}
    moved = {name: np.stack([row[regular] for row in values], axis=1) for name, values in rows.items()}
    velocity, force = moved["velocity"], moved["force"]
    pressure, flow = hydraulic_state(crane, velocity, force)

    pump = machine.pump
    total = flow.sum(axis=1)
    supply_ls = pressure.max(axis=1) + pump.ls_margin
    supply_cp = np.full_like(time, supply_of(pump, Supply.CONSTANT)[0])
    power_ls = _finite(hydraulics.pump_power(supply_ls, total, *shaft_of(pump)))
    power_cp = _finite(hydraulics.pump_power(supply_cp, total, *shaft_of(pump)))

    course = limit_checks.Course(
        time=looks,
        error=np.linalg.norm(np.stack(rows["tool"], axis=1) - reference.point, axis=1),
        cosine=cranes.elbow_cosine(crane, plane, pose.q[2]),
        position=rows["joint_position"],
        length=rows["length"],
        velocity=rows["velocity"],
        acceleration=rows["acceleration"],
        flow=pump_flow(crane.drives, rows["velocity"]),
    )
    use = limit_checks.used(machine, course)
    violations = limit_checks.violations(task, motion, course, use) + limit_checks.unended(task, c, w)
    if not (exists or violations):
        violations = ("a linkage does not close, or has no torque arm, somewhere on the way",)
    if motion.status.kind is Kind.UNCONVERGED:  # no result, whatever it keeps
        violations = (motion.status, *violations)
    path_error = float(course.error.max())
    arrays = {
        "time": time, **moved, "tool_target": reference.point.take(regular, axis=0), "pressure": pressure, "flow": flow,
        "pump_flow": total, "supply_ls": supply_ls, "supply_cp": supply_cp,
        "power_ls": power_ls, "power_cp": power_cp,
        "cumulative_ls": _integral(time, power_ls), "cumulative_cp": _integral(time, power_cp),
    }  # fmt: skip
    for array in arrays.values():
        array.setflags(write=False)
    energies = float(arrays["cumulative_ls"][-1]), float(arrays["cumulative_cp"][-1])
    return Evaluation(
        task=task,
        motion=motion,
        **arrays,
        limit_use=limit_checks.largest(task, course, use),
        path_error=path_error,
        violations=violations,
        notes=_notes(task, time, velocity, force, total, supply_ls, pressure, energies),
        followed=exists and path_error <= PATH_TOLERANCE,
    )


def check_measurable(task: Task, kept: int = 0) -> None:
    """Raise InputError where a task's motions cannot be measured: too long for the free memory, or through the axis.

    Args:
        task: The task.
        kept: Number of evaluations that are kept besides.
    """
    cranes.check_axis(task)
    samples, joints = _samples(task), len(task.machine.joints)
    each = MEASURING[0] + MEASURING[1] * joints + kept * STORED * joints
    what = f"measuring task {task.name} at {samples} samples, 2 ms apart over {task.duration:g} s,"
    resources.check_memory(samples * each, what, "split the task into shorter ones")


def _samples(task: Task) -> int:
    """Number of samples of 2 ms."""
    return max(2, int(round(task.duration / SAMPLE)) + 1)


def judged_cost(evaluation: Evaluation, cost: str) -> float:
    """Judged cost of a motion, for any name of `costs.COSTS`, in the cost's unit."""
    if cost in PUMPS:
        return evaluation.energy(cost)
    columns = tuple(evaluation.velocity.T), tuple(evaluation.force.T)
    return float(_integral(evaluation.time, rate(cranes.build(evaluation.task), cost, *columns))[-1])


def hydraulic_state(crane: cranes.Crane, velocity: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Demanded pressures [Pa] and pump flows [m^3/s] of all cylinders, each (samples, joints)."""
    pressure = np.empty_like(velocity)
    flow = np.empty_like(velocity)
    for i, d in enumerate(crane.drives):
        v = velocity[:, i]
        pressure[:, i] = demanded_pressure(crane, i, v, force[:, i])
        flow[:, i] = hydraulics.cylinder_flow(v, d.area_out, d.area_in)
    return pressure, flow


def _finite(values: np.ndarray) -> np.ndarray:
    """Values with 0 in place of those that do not exist."""
    return np.where(np.isfinite(values), values, 0.0)


def _integral(time: np.ndarray, power: np.ndarray) -> np.ndarray:
    steps = 0.5 * (power[1:] + power[:-1]) * np.diff(time)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _low_pass(motion: Motion, time: np.ndarray, looks: np.ndarray, cutoff: float) -> tuple[np.ndarray, ...]:
    """Zero-phase low pass of the redundant motion, its ends kept (both papers filter their plans at 5 Hz).

    Args:
        motion: The motion.
        time: Samples that are filtered [s], equally spaced.
        looks: Times of the answer [s], read off between the samples.
        cutoff: Of the low pass [Hz].

    Returns:
        Position [m], velocity [m/s] and acceleration [m/s^2].
    """
    from scipy.signal import butter, sosfiltfilt

    step = time[1] - time[0]
    c, w, _ = motion.at(time)
    sections = butter(2, cutoff, fs=1.0 / step, output="sos")
    pad = min(time.size - 1, int(1.0 / (cutoff * step)))
    smooth = sosfiltfilt(sections, w, padtype="odd", padlen=pad)
    ramp = np.linspace(0.0, 1.0, time.size)
    smooth = smooth + (w[0] - smooth[0]) * (1.0 - ramp) + (w[-1] - smooth[-1]) * ramp
    moved = _integral(time, smooth)
    # Keep the end: spread what the filter lost as a velocity bump that vanishes at both ends.
    bump = ramp * (1.0 - ramp)
    smooth = smooth + (c[-1] - c[0] - moved[-1]) / _integral(time, bump)[-1] * bump
    filtered = c[0] + _integral(time, smooth), smooth, np.gradient(smooth, step)
    return tuple(np.interp(looks, time, values) for values in filtered)


def _notes(task, time, velocity, force, flow, supply, pressure, energies) -> tuple[str, ...]:
    machine = task.machine
    found = remarks.shortfalls(machine.pump, "ls", time, flow, supply, pressure)
    left_out = remarks.uncounted_work(machine, time, velocity, force, *energies)
    return (*(str(each) for each in found), *filter(None, [left_out]))
