"""The judge: completes any Motion on a 2 ms grid and measures it; every number a user sees comes from here.

Energy is the trapezoidal integral of pump power, for the load-sensing and for the constant-pressure pump,
whatever the motion was planned for. Limits are checked at every sample: use 1.0 means at the limit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from leanboom import crane as cranes
from leanboom import hydraulics, kinematics
from leanboom.errors import InputError
from leanboom.motion import Motion
from leanboom.shaft import shaft_of
from leanboom.task import Task, sample

SAMPLE = 0.002  # [s], the papers' recording rate
TOLERANCE = 1.001  # a limit used above this counts as violated
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
    notes: tuple[str, ...]  # what a real pump could not do (flow, pressure); not limits of the planning problem

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
    def status(self) -> str:
        """`solved`, or the worst violation as a sentence."""
        return self.violations[0] if self.violations else "solved"

    def __repr__(self) -> str:
        use = self.limit_use
        return (
            f"Evaluation({self.task.name}, {self.motion.method}: LS {self.energy_ls / 1e3:.2f} kJ, "
            f"CP {self.energy_cp / 1e3:.2f} kJ, limit use {use.position:.3f}/{use.velocity:.3f}/"
            f"{use.acceleration:.3f}, {self.status})"
        )


def evaluate(task: Task, motion: Motion) -> Evaluation:
    """Measure a motion.

    Args:
        task: The task the motion belongs to.
        motion: Motion of the redundant cylinder, from any method.

    Returns:
        The completed motion with pressures, flows, power, energy and limit use on a 2 ms grid. A motion that
        leaves the crane's reach is off its path and costs infinitely much.

    Raises:
        InputError: If the motion does not last as long as the task, or the task's low pass cannot be sampled.
    """
    _check(task, motion)
    with np.errstate(all="ignore"):  # singular poses, off the path: reported as such
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
    force = np.stack(cranes.forces(pose, moving), axis=1)
    velocity = np.stack(moving.velocity, axis=1)
    acceleration = np.stack(moving.acceleration, axis=1)
    joint_position = np.stack((plane.q1, *pose.q) if machine.geometry.slewing else pose.q, axis=1)
    pressure, flow = hydraulic_state(crane, velocity, force)

    pump = machine.pump
    pump_flow = flow.sum(axis=1)
    supply_ls = pressure.max(axis=1) + pump.ls_margin
    supply_cp = np.full_like(time, pump.constant_pressure)
    power_ls = hydraulics.pump_power(supply_ls, pump_flow, *shaft_of(pump))
    power_cp = hydraulics.pump_power(supply_cp, pump_flow, *shaft_of(pump))

    g = machine.geometry
    r, z = kinematics.tool_point(*pose.q, g.base_x, g.base_z, g.boom, g.offset, g.outer)
    tool = np.stack([r * np.cos(plane.q1), r * np.sin(plane.q1), z], axis=1)
    error = np.linalg.norm(tool - reference.point, axis=1)

    use = _limit_use(task, joint_position, velocity, acceleration)
    violations = _violations(task, motion, time, use, joint_position, velocity, acceleration, error)
    largest = [float(values.max()) for values in use]
    arrays = {
        "time": time, "tool": tool, "tool_target": reference.point, "joint_position": joint_position,
        "joint_velocity": np.stack(moving.joint_velocity, axis=1),
        "joint_acceleration": np.stack(moving.joint_acceleration, axis=1),
        "length": np.stack([length for length, _, _ in pose.cylinders], axis=1),
        "velocity": velocity, "acceleration": acceleration, "force": force, "pressure": pressure, "flow": flow,
        "pump_flow": pump_flow, "supply_ls": supply_ls, "supply_cp": supply_cp,
        "power_ls": power_ls, "power_cp": power_cp,
        "cumulative_ls": _integral(time, power_ls), "cumulative_cp": _integral(time, power_cp),
    }  # fmt: skip
    for array in arrays.values():
        array.setflags(write=False)
    return Evaluation(
        task=task,
        motion=motion,
        **arrays,
        limit_use=LimitUse(*largest),
        path_error=float(error.max()),
        violations=violations,
        notes=_notes(task, time, pump_flow, supply_ls),
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


def _integral(time: np.ndarray, power: np.ndarray) -> np.ndarray:
    steps = 0.5 * (power[1:] + power[:-1]) * np.diff(time)
    steps = np.where(np.isfinite(steps), steps, np.inf)
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
    used = position, np.abs(velocity) / fastest, np.abs(acceleration) / hardest
    return tuple(np.where(np.isfinite(values), values, np.inf) for values in used)


def _violations(task, motion, time, use, joint_position, velocity, acceleration, error) -> tuple[str, ...]:
    machine = task.machine
    found = []
    if error.max() > PATH_TOLERANCE:
        i = int(error.argmax())
        found.append((np.inf, f"tool off its path by {error[i]:.4f} m at {time[i]:.3f} s{_stage(motion, time[i])}"))
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
            i = int(np.where(np.isfinite(values[:, j]), used[:, j], 0.0).argmax())
            if used[i, j] > TOLERANCE:
                value = values[i, j]
                limit = ranges[j][1] if value > 0.5 * sum(ranges[j]) else ranges[j][0]
                what = unit or ("m" if name == "extension" else "rad")
                sentence = (
                    f"{kind} of {name} is {value:.4f} {what} at {time[i]:.3f} s{_stage(motion, time[i])}, "
                    f"beyond its limit {limit:.4f} by {abs(value - limit):.4f}"
                )
                found.append((used[i, j], sentence))
    return tuple(sentence for _, sentence in sorted(found, key=lambda item: -item[0]))


def _stage(motion: Motion, time: float) -> str:
    late = motion.step * motion.acceleration.size - motion.duration
    return f" (stage {min(int((time + late) / motion.step + 1e-9), motion.acceleration.size - 1)})"


def _notes(task: Task, time: np.ndarray, pump_flow: np.ndarray, supply: np.ndarray) -> tuple[str, ...]:
    pump = task.machine.pump
    notes = []
    i = int(pump_flow.argmax())
    if pump_flow[i] > pump.max_flow:
        flow, limit = pump_flow[i] * 6e4, pump.max_flow * 6e4
        notes.append(f"pump flow {flow:.1f} l/min at {time[i]:.3f} s is above the pump's {limit:.1f} l/min")
    i = int(supply.argmax())
    if supply[i] > pump.max_pressure:
        high, limit = supply[i] / 1e6, pump.max_pressure / 1e6
        notes.append(f"LS supply {high:.2f} MPa at {time[i]:.3f} s is above the pump's {limit:.2f} MPa")
    return tuple(notes)
