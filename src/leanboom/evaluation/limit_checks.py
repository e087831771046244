"""Limits of a motion: times of checks, use of each limit, and sentences on violations.

The judge's samples are 2 ms apart. Whatever is shorter has times of its own here: every segment of the path, every
stage of the motion and every approach to the slewing axis, with values from just inside both of its ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from leanboom.components.paths import Path, approaches
from leanboom.formulas import kinematics
from leanboom.model.machine import Machine
from leanboom.model.motion import STAGE_HIT, Motion
from leanboom.model.pump_flow import LITRES_PER_MINUTE
from leanboom.model.task import Task

TOLERANCE = 1.001  # a limit used above this counts as violated
PATH_TOLERANCE = 1e-4  # [m], tool path error that counts as leaving the path
END_TOLERANCE, REST_TOLERANCE = 1e-4, 1e-4  # [m], [m/s]: of the redundant cylinder's end, and of its rest there
FOLDED = 1e-2  # [rad], [m]: a joint farther from where it was has jumped
BEYOND = 1e6  # values in sentences that are larger are given by their order of magnitude
LOOKS = 20  # times at which a short segment is looked at; among them a quintic's largest velocity and acceleration
INSIDE = 1e-7  # [s], how far inside its ends the one-sided values of a segment are taken
# How far velocities may be from the change of lengths, and accelerations from that of velocities: shares of their
# limits, on top of what rounding does [m], [m/s].
SHARES = (0.05, 0.5)
ROUNDING = (1e-6, 1e-5)


@dataclass(frozen=True, slots=True)
class LimitUse:
    """Largest use of each kind of limit over all joints or cylinders; 1.0 is at the limit."""

    position: float
    velocity: float
    acceleration: float
    flow: float  # of the pump's largest flow, whether or not that is a limit
    flow_limited: bool = False  # whether it is

    @property
    def worst(self) -> float:
        """The largest one of those that are limits."""
        return max(self.position, self.velocity, self.acceleration, self.flow if self.flow_limited else 0.0)


Rows = tuple[np.ndarray, ...]  # one array a joint, in joint order, (times,) each


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """A motion of the whole crane at the checked times."""

    time: np.ndarray  # [s], (times,)
    error: np.ndarray  # distance of the tool from its path [m], (times,)
    cosine: np.ndarray  # of the elbow's angle that the path asks for, (times,)
    position: Rows  # of the joints [rad] or [m]
    length: Rows  # of the cylinders [m]
    velocity: Rows  # [m/s]
    acceleration: Rows  # [m/s^2]
    flow: np.ndarray  # of the pump [m^3/s], (times,)


def times(path: Path, samples: np.ndarray, motion: Motion | None = None) -> np.ndarray:
    """Times at which a motion is checked [s]: equal samples, and more in whatever is shorter than some of these.

    Args:
        path: The path of the tool.
        samples: Equally spaced times [s], from 0 to the path's end.
        motion: The motion of the redundant cylinder; None: that of the tool counts alone.

    Returns:
        Rising times, all samples among them.
    """
    every = samples[1] - samples[0]
    near, _ = approaches(path)
    pieces = np.unique(np.concatenate([path.breaks, near]))
    short = np.nonzero(np.diff(pieces) < LOOKS * every)[0]
    looks = pieces[short, None] + np.diff(pieces)[short, None] * (np.arange(1, LOOKS) / LOOKS)
    ends = pieces if motion is None else np.sort(np.concatenate([pieces, motion.breaks]))
    ends = np.clip(ends, 0.0, samples[-1])
    inset = np.minimum(1e-3 * np.diff(ends), INSIDE)
    after = ends[:-1] + inset
    sampled = np.abs(ends[:-1] - every * np.round(ends[:-1] / every)) < INSIDE  # a sample looks there already
    return np.unique(np.concatenate([samples, looks.ravel(), near, after[~sampled], ends[1:] - inset]))


def used(machine: Machine, course: Course) -> tuple[Rows, Rows, Rows]:
    """Use of position, velocity and acceleration limits."""
    position, velocity, acceleration = [], [], []
    for j, (joint, cylinder) in enumerate(zip(machine.joints, machine.cylinders, strict=True)):
        middle, half = 0.5 * (joint.lower + joint.upper), 0.5 * (joint.upper - joint.lower)
        position.append(np.abs(course.position[j] - middle) / half)
        velocity.append(np.abs(course.velocity[j]) / cylinder.velocity_limit)
        acceleration.append(np.abs(course.acceleration[j]) / cylinder.acceleration_limit)
    return tuple(position), tuple(velocity), tuple(acceleration)


def largest(task: Task, course: Course, use: tuple[Rows, Rows, Rows]) -> LimitUse:
    """The largest `LimitUse` of a course of a task, whose uses are known."""
    flow = float(course.flow.max()) / task.machine.pump.max_flow
    position, velocity, acceleration = (float(max(row.max() for row in rows)) for rows in use)
    return LimitUse(position, velocity, acceleration, flow, task.limits.pump_flow)


def violations(task: Task, motion: Motion, course: Course, use: tuple[Rows, Rows, Rows]) -> tuple[str, ...]:
    """One sentence where the tool leaves its path, and one a violated limit, worst first.

    Args:
        task: The task; it says whether the pump's flow is a limit.
        motion: The motion of the redundant cylinder.
        course: What becomes of it.
        use: What `used` says of it.
    """
    machine, time, found = task.machine, course.time, []
    limits = [(joint.lower, joint.upper) for joint in machine.joints]
    speeds = [(-c.velocity_limit, c.velocity_limit) for c in machine.cylinders]
    pushes = [(-c.acceleration_limit, c.acceleration_limit) for c in machine.cylinders]
    kinds = (
        ("position", course.position, limits, None),
        ("velocity", course.velocity, speeds, "m/s"),
        ("acceleration", course.acceleration, pushes, "m/s^2"),
    )
    for (kind, values, allowed, unit), shares in zip(kinds, use, strict=True):
        for j, name in enumerate(machine.names):
            i = int(shares[j].argmax())
            if shares[j][i] > TOLERANCE:
                value = values[j][i]
                limit = allowed[j][1] if value > 0.5 * sum(allowed[j]) else allowed[j][0]
                what = unit or ("m" if name == "extension" else "rad")
                sentence = (
                    f"{kind} of {name} is {_number(value)} {what} at {_when(motion, time[i])}, "
                    f"beyond its limit {limit:.4f} by {_number(abs(value - limit))}"
                )
                found.append((shares[j][i], sentence))
    i = int(course.flow.argmax())
    if course.flow[i] > TOLERANCE * task.flow_limit:
        needed, given = (LITRES_PER_MINUTE * flow for flow in (course.flow[i], task.flow_limit))
        sentence = (
            f"pump flow is {needed:.1f} l/min at {_when(motion, time[i])}, beyond its limit {given:.1f} by "
            f"{needed - given:.2f}"
        )
        found.append((course.flow[i] / task.flow_limit, sentence))
    beyond = tuple(sentence for _, sentence in sorted(found, key=lambda item: -item[0]))
    return (*_off_path(motion, course), *beyond) or tuple(_contradictions(machine, course))


def unended(task: Task, position: np.ndarray, velocity: np.ndarray) -> tuple[str, ...]:
    """Where a motion does not end as its task asks: one sentence each, worst first; nothing where more is to follow.

    Args:
        task: The task; the ends `smallest` and `middle` are lengths once a task is planned.
        position, velocity: Of the redundant cylinder, at rising times [m], [m/s].
    """
    found = []
    if task.end != "free" and task.whole:
        wanted = float(position[0]) if task.end == "same" else task.end
        if isinstance(wanted, float) and abs(position[-1] - wanted) > END_TOLERANCE:
            found.append(
                f"the extension ends at {_number(position[-1])} m, and must end at {wanted:.4f} m (end: {task.end})"
            )
    if task.whole and abs(velocity[-1]) > REST_TOLERANCE:
        found.append(f"the extension still moves by {_number(velocity[-1])} m/s at the end, and must be at rest")
    return tuple(found)


def apart(task: Task, position: Sequence[np.ndarray], length: Sequence[np.ndarray]) -> list[str]:
    """Where legs do not begin as the one before ends: one sentence each.

    Args:
        task: A task with legs.
        position: Of the joints in each stretch [rad] or [m], (samples, joints) each.
        length: Of the cylinders [m], (samples, joints) each.
    """
    found = []
    for i, stretch in enumerate(task.stretches[1:], 1):
        left, met = float(length[i - 1][-1, -1]), float(length[i][0, -1])
        if abs(met - left) > END_TOLERANCE:
            found.append(f"{stretch.said}: the extension begins at {_number(met)} m, but was at {left:.4f} m")
        elif np.abs(position[i][0] - position[i - 1][-1]).max() > FOLDED:
            found.append(f"{stretch.said}: the arm would be folded to the other side than before")
    return found


def largest_of(found: Sequence[LimitUse]) -> LimitUse:
    """The largest use of each limit."""
    return LimitUse(*(max(getattr(each, field.name) for each in found) for field in fields(LimitUse)))


def _off_path(motion: Motion, course: Course) -> tuple[str, ...]:
    """Sentence on the largest path error, and whether the elbow margin causes it; empty where there is none."""
    i = int(course.error.argmax())
    if course.error[i] <= PATH_TOLERANCE:
        return ()
    cosine = course.cosine[i]
    sentence = f"tool off its path by {_number(course.error[i])} m at {_when(motion, course.time[i])}"
    if np.abs(cosine) <= 1.0:
        pose, angle = ("straight", np.pi - np.arccos(cosine)) if cosine < 0.0 else ("folded", np.arccos(cosine))
        least = np.degrees(kinematics.ELBOW_MARGIN)
        sentence += (
            f": the arm would be {pose} to within {np.degrees(angle):.1f} deg, and must stay {least:g} deg from it"
        )
    return (sentence,)


def _contradictions(machine: Machine, course: Course) -> list[str]:
    """Where velocities are not the rates of lengths, or accelerations not those of velocities: one sentence a cylinder.

    Every interval between two times is integrated by the trapezoidal rule and compared with what has changed.
    """
    time, found = course.time, []
    step = time[1:] - time[:-1]
    half = 0.5 * step
    for j, cylinder in enumerate(machine.cylinders):
        pairs = (
            (course.length[j], course.velocity[j], cylinder.velocity_limit, "length", "m", "velocity"),
            (course.velocity[j], course.acceleration[j], cylinder.acceleration_limit,
             "velocity", "m/s", "acceleration"),
        )  # fmt: skip
        for (value, rate, limit, what, unit, rate_name), share, rounding in zip(pairs, SHARES, ROUNDING, strict=True):
            change, expected = value[1:] - value[:-1], rate[1:] + rate[:-1]
            expected *= half
            beyond = np.abs(change - expected)
            if beyond.max() <= rounding:
                continue
            beyond -= share * limit * step + rounding
            i = int(beyond.argmax())
            if beyond[i] > 0.0:
                found.append(
                    f"the motion of {cylinder.name} contradicts itself: from {time[i]:.3f} s on, within "
                    f"{1e3 * step[i]:.3g} ms, the {what} of its cylinder changes by {_number(change[i])} {unit}, "
                    f"but by its {rate_name} it would be {_number(expected[i])} {unit}"
                )
    return found


def _number(value: float) -> str:
    """Four decimals, or for a value beyond all machines its order of magnitude."""
    return f"{value:.4f}" if abs(value) < BEYOND else f"{value:.3g}"


def _when(motion: Motion, time: float) -> str:
    """A time and the stage it is in."""
    stage = int(np.searchsorted(motion.breaks[1:-1], time + STAGE_HIT * motion.step, side="right"))
    return f"{time:.3f} s (stage {stage})"
