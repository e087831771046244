"""The judge: completes any Motion on a 2 ms grid and measures it; every number a user sees comes from here.

Energy is the trapezoidal integral of pump power, for the load-sensing and for the constant-pressure pump,
whatever the motion was planned for. Limits are checked at every sample: use 1.0 means at the limit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from leanboom import crane as cranes
from leanboom import hydraulics, kinematics, remarks
from leanboom.errors import InputError
from leanboom.motion import Motion, headed
from leanboom.shaft import shaft_of
from leanboom.task import Task, sample

SAMPLE = 0.002  # [s], the papers' recording rate
TOLERANCE = 1.001  # a limit used above this counts as violated
BEYOND = 1e6  # values in sentences that are larger are given by their order of magnitude
PATH_TOLERANCE = 1e-4  # [m], tool path error that counts as leaving the path


@dataclass(frozen=True, slots=True)
class LimitUse:
    """Largest use of each kind of limit over all joints or cylinders; 1.0 is at the limit."""

    position: float
    velocity: float
    acceleration: float

    @property
    def worst(self) -> float:
        """The largest of the three."""
        return max(self.position, self.velocity, self.acceleration)


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
    pressure: np.ndarray  # counted pressures, eq. (41) [Pa], (samples, joints)
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
        """Energy of the chosen pump, "ls" or "cp" [J]."""
        return self.energy_ls if pump == "ls" else self.energy_cp

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
    def status(self) -> str:
        """`solved`, or what is wrong as a sentence; of the pump that `deliverable` looks at."""
        return self.status_with(self._pump)

    def status_with(self, pump: str) -> str:
        """`solved`, the worst violation as a sentence, or else what the chosen pump, "ls" or "cp", cannot deliver."""
        if self.violations:
            return self.violations[0]
        found = self._shortfalls(pump)
        return remarks.undeliverable(found) if found else "solved"

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
        return headed(self.status, f"Evaluation({self.summary}, {self.status})")


def evaluate(task: Task, motion: Motion) -> Evaluation:
    """Measure a motion.

    Args:
        task: The task the motion belongs to.
        motion: Motion of the redundant cylinder, from any method.

    Returns:
        The completed motion with pressures, flows, power, energy and limit use on a 2 ms grid, all finite. Where a
        motion asks for a straight arm or one out of reach, the tool stays at the nearest pose with a bent one, off its
        path; values that do not exist, as of a linkage that does not close, are 0. Either way `followed` is False.

    Raises:
        InputError: If the motion does not last as long as the task, or the task's low pass cannot be sampled.
    """
    _check(task, motion)
    with np.errstate(all="ignore"):  # linkages beyond their joints' ranges: reported as such
        return _evaluate(task, motion)


def _check(task: Task, motion: Motion) -> None:
    lasts = motion.duration
    if abs(lasts - task.duration) > 1e-6 * task.duration:
        raise InputError(f"the motion lasts {lasts:g} s, the task {task.name} {task.duration:g} s")
    if task.smooth is not None and not 0.0 < task.smooth < 0.5 / SAMPLE:
        raise InputError(f"smooth = {task.smooth:g} Hz; must be above 0 Hz and below {0.5 / SAMPLE:g} Hz")


def _evaluate(task: Task, motion: Motion) -> Evaluation:
    crane = cranes.build(task)
    machine = task.machine
    time = np.linspace(0.0, task.duration, max(2, int(round(task.duration / SAMPLE)) + 1))
    c, w, u = motion.at(time) if task.smooth is None else _low_pass(motion, time, task.smooth)
    reference = sample(task, time)
    plane = cranes.plane(machine, reference)
    pose = cranes.pose(crane, plane, c)
    moving = cranes.move(pose, w, u)
    g = machine.geometry
    r, z = kinematics.tool_point(*pose.q, g.base_x, g.base_z, g.boom, g.offset, g.outer)
    columns = {
        "tool": [r * np.cos(plane.q1), r * np.sin(plane.q1), z],
        "joint_position": (plane.q1, *pose.q) if g.slewing else pose.q,
        "joint_velocity": moving.joint_velocity, "joint_acceleration": moving.joint_acceleration,
        "length": [length for length, _, _ in pose.cylinders], "velocity": moving.velocity,
        "acceleration": moving.acceleration, "force": cranes.forces(pose, moving),
    }  # fmt: skip
    moved = {name: np.stack(values, axis=1) for name, values in columns.items()}
    exists = all(np.isfinite(values).all() for values in moved.values())
    moved = {name: _finite(values) for name, values in moved.items()}
    velocity, force = moved["velocity"], moved["force"]
    pressure, flow = hydraulic_state(crane, velocity, force)

    pump = machine.pump
    pump_flow = flow.sum(axis=1)
    supply_ls = pressure.max(axis=1) + pump.ls_margin
    supply_cp = np.full_like(time, pump.constant_pressure)
    power_ls = _finite(hydraulics.pump_power(supply_ls, pump_flow, *shaft_of(pump)))
    power_cp = _finite(hydraulics.pump_power(supply_cp, pump_flow, *shaft_of(pump)))

    error = np.linalg.norm(moved["tool"] - reference.point, axis=1)
    limited = moved["joint_position"], velocity, moved["acceleration"]
    use = _limit_use(task, *limited)
    violations = _off_path(motion, time, error, cranes.elbow_cosine(crane, plane, pose.q[2]))
    violations += _violations(task, motion, time, use, *limited)
    if not (exists or violations):
        violations = ("a linkage does not close, or has no torque arm, somewhere on the way",)
    largest = [float(values.max()) for values in use]
    arrays = {
        "time": time, **moved, "tool_target": reference.point, "pressure": pressure, "flow": flow,
        "pump_flow": pump_flow, "supply_ls": supply_ls, "supply_cp": supply_cp,
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
        limit_use=LimitUse(*largest),
        path_error=float(error.max()),
        violations=violations,
        notes=_notes(task, time, velocity, force, pump_flow, supply_ls, pressure, energies),
        followed=exists and float(error.max()) <= PATH_TOLERANCE,
    )


def judged_cost(evaluation: Evaluation, cost: str) -> float:
    """What a motion costs by the judge, for any name of `objective.COSTS`: [J], or [m^2/s] for the last two kinds."""
    if cost in ("ls", "cp"):
        return evaluation.energy(cost)
    machine = evaluation.task.machine
    if cost == "actuator":
        rate = hydraulics.positive_work(evaluation.velocity, evaluation.force).sum(axis=1)
    elif cost == "velocity":
        rate = (evaluation.velocity**2).sum(axis=1)
    elif cost == "extension":
        rate = evaluation.velocity[:, -1] ** 2
    else:
        areas = [(c.piston_area, c.rod_side_area) for c in machine.cylinders]
        flow = sum(hydraulics.recuperating_flow(evaluation.velocity[:, i], a, b) for i, (a, b) in enumerate(areas))
        rate = hydraulics.pump_power(machine.pump.constant_pressure, flow, *shaft_of(machine.pump))
    return float(_integral(evaluation.time, rate)[-1])


def hydraulic_state(crane: cranes.Crane, velocity: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Counted pressures [Pa] and pump flows [m^3/s] of all cylinders, each (samples, joints)."""
    epsilon = crane.machine.driven_velocity
    pressure = np.empty_like(velocity)
    flow = np.empty_like(velocity)
    for i, d in enumerate(crane.drives):
        v = velocity[:, i]
        pressure[:, i] = hydraulics.counted_pressure(
            v, force[:, i], epsilon, d.gain_out, d.back_out, d.gain_in, d.back_in
        )
        flow[:, i] = hydraulics.cylinder_flow(v, d.area_out, d.area_in)
    return pressure, flow


def _finite(values: np.ndarray) -> np.ndarray:
    """Values with 0 in place of those that do not exist."""
    return np.where(np.isfinite(values), values, 0.0)


def _integral(time: np.ndarray, power: np.ndarray) -> np.ndarray:
    steps = 0.5 * (power[1:] + power[:-1]) * np.diff(time)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _low_pass(motion: Motion, time: np.ndarray, cutoff: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Zero-phase low pass of the redundant motion, its ends kept (both papers filter their plans at 5 Hz)."""
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
    return c[0] + _integral(time, smooth), smooth, np.gradient(smooth, step)


def _limit_use(task: Task, joint_position, velocity, acceleration) -> tuple[np.ndarray, ...]:
    """Use of position, velocity and acceleration limits at every sample, (samples, joints) each."""
    machine = task.machine
    lower = np.array([joint.lower for joint in machine.joints])
    upper = np.array([joint.upper for joint in machine.joints])
    position = np.abs(joint_position - 0.5 * (lower + upper)) / (0.5 * (upper - lower))
    fastest = np.array([cylinder.velocity_limit for cylinder in machine.cylinders])
    hardest = np.array([cylinder.acceleration_limit for cylinder in machine.cylinders])
    return position, np.abs(velocity) / fastest, np.abs(acceleration) / hardest


def _off_path(motion: Motion, time: np.ndarray, error: np.ndarray, cosine: np.ndarray) -> tuple[str, ...]:
    """Where the tool is farthest off its path, and whether that is because the arm must stay bent; or nothing."""
    i = int(error.argmax())
    if error[i] <= PATH_TOLERANCE:
        return ()
    sentence = f"tool off its path by {_number(error[i])} m at {time[i]:.3f} s{_stage(motion, time[i])}"
    if np.abs(cosine[i]) <= 1.0:
        pose, angle = (
            ("straight", np.pi - np.arccos(cosine[i])) if cosine[i] < 0.0 else ("folded", np.arccos(cosine[i]))
        )
        least = np.degrees(kinematics.ELBOW_MARGIN)
        sentence += (
            f": the arm would be {pose} to within {np.degrees(angle):.1f} deg, and must stay {least:g} deg from it"
        )
    return (sentence,)


def _violations(task, motion, time, use, joint_position, velocity, acceleration) -> tuple[str, ...]:
    machine = task.machine
    found = []
    limits = [(joint.lower, joint.upper) for joint in machine.joints]
    speeds = [(-c.velocity_limit, c.velocity_limit) for c in machine.cylinders]
    pushes = [(-c.acceleration_limit, c.acceleration_limit) for c in machine.cylinders]
    kinds = (
        ("position", joint_position, limits, None),
        ("velocity", velocity, speeds, "m/s"),
        ("acceleration", acceleration, pushes, "m/s^2"),
    )
    for (kind, values, ranges, unit), used in zip(kinds, use, strict=True):
        for j, name in enumerate(machine.names):
            i = int(used[:, j].argmax())
            if used[i, j] > TOLERANCE:
                value = values[i, j]
                limit = ranges[j][1] if value > 0.5 * sum(ranges[j]) else ranges[j][0]
                what = unit or ("m" if name == "extension" else "rad")
                sentence = (
                    f"{kind} of {name} is {_number(value)} {what} at {time[i]:.3f} s{_stage(motion, time[i])}, "
                    f"beyond its limit {limit:.4f} by {_number(abs(value - limit))}"
                )
                found.append((used[i, j], sentence))
    return tuple(sentence for _, sentence in sorted(found, key=lambda item: -item[0]))


def _number(value: float) -> str:
    """Four decimals, or for a value beyond all machines its order of magnitude."""
    return f"{value:.4f}" if abs(value) < BEYOND else f"{value:.3g}"


def _stage(motion: Motion, time: float) -> str:
    late = motion.step * motion.acceleration.size - motion.duration
    return f" (stage {min(int((time + late) / motion.step + 1e-9), motion.acceleration.size - 1)})"


def _notes(task, time, velocity, force, pump_flow, supply, pressure, energies) -> tuple[str, ...]:
    machine = task.machine
    found = remarks.shortfalls(machine.pump, "ls", time, pump_flow, supply, pressure)
    left_out = remarks.uncounted_work(machine, time, velocity, force, *energies)
    return (*(str(each) for each in found), *filter(None, [left_out]))
