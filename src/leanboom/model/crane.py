"""The whole crane's state from the redundant cylinder's motion: machine data and formulas put together.

Everything leanboom computes about a crane goes through here, on NumPy arrays (tables, judge) as well as on
CasADi symbols (collocation, simulation): inverse kinematics of the non-redundant joints, eqs. (33)-(35);
cylinder coordinates, eqs. (10)-(12); forces, eq. (16); flows and demanded pressures, eqs. (37) and (41).

A state is completed in two steps, because tables need many motions at each pose:
`pose` evaluates all that depends on position alone, `move` adds velocity and acceleration.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from leanboom.components.linkages import Telescope
from leanboom.components.paths import approaches
from leanboom.components.valves import Drive
from leanboom.errors import InputError
from leanboom.formulas import dynamics, kinematics
from leanboom.model.machine import Body, Machine
from leanboom.model.task import Joined, Lines, Reference, Spline, Task, sample

AXIS = 1e-6  # [m], a path nearer to the slewing axis has no base angle there

Value = Any  # float, NumPy array or CasADi symbol

LOOKED_AT = (65, 129)  # points of a path and extensions at each when the elbow's side is chosen


@dataclass(frozen=True, slots=True)
class Crane:
    """A machine made ready for computing: payload among the bodies, cylinders on their valves."""

    machine: Machine
    bodies: tuple[Body, ...]
    drives: tuple[Drive, ...]
    side: float = kinematics.ELBOW_UP  # to which the outer boom folds, kept along the whole path
    bent: float = kinematics.BENT  # largest |cosine| of the angle at the tilt joint; 1: up to the straight pose

    @property
    def ratio(self) -> float:
        """Redundant cylinder travel per extension travel (r4)."""
        linkage = self.machine.redundant.linkage
        if not isinstance(linkage, Telescope):
            raise InputError("the extension cylinder needs a linkage of type telescope")
        return linkage.ratio


def build(task: Task) -> Crane:
    """The crane of a task, its payload hung where the machine says.

    Raises:
        InputError: If the path passes through the slewing axis.
    """
    machine = task.machine
    check_axis(task)
    bodies = (*machine.bodies, *load(machine, task.payload))
    return _on_its_side(Crane(machine, bodies, machine.drives), task)


def load(machine: Machine, mass: float) -> tuple[Body, ...]:
    """A payload of a mass [kg] as a body of the crane; none of 0 kg."""
    return (Body("payload", "tilt", mass, machine.payload_along, machine.payload_above, 0.0, 1.0),) if mass else ()


def check_axis(task: Task) -> None:
    """Raise InputError if the path of a task passes through the slewing axis."""
    if task.machine.geometry.slewing:
        times, distances = approaches(task.path)
        if distances.size and distances.min() < AXIS:
            raise InputError(
                f"the path passes through the slewing axis at {times[distances.argmin()]:.3f} s, where the base angle "
                "is undefined; move it away"
            )


def sides(machine: Machine) -> tuple[float, ...]:
    """Sides of the straight arm on which the tilt joint's range has poses: `ELBOW_UP` and `ELBOW_DOWN`, or one."""
    g, (_, tilt, extension) = machine.geometry, machine.joints[-3:]
    lines = [np.arctan2(g.offset, g.outer + q4) for q4 in (extension.lower, extension.upper)]
    ends = tilt.lower + min(lines), tilt.upper + max(lines)  # of the tool line against the boom line
    found = []
    if ends[0] < -kinematics.ELBOW_MARGIN:
        found.append(kinematics.ELBOW_UP)
    if ends[1] > kinematics.ELBOW_MARGIN:
        found.append(kinematics.ELBOW_DOWN)
    return tuple(found) or (kinematics.ELBOW_UP,)


def _on_its_side(crane: Crane, task: Task) -> Crane:
    """The crane with its elbow on the side it keeps: the first of `sides` on which the whole path can be reached.

    What is left of a path, or follows from it, keeps the side of the path it is made of.
    """
    possible = [replace(crane, side=side) for side in sides(crane.machine)]
    if len(possible) > 1:
        path = task.path
        while not isinstance(path, Lines | Spline | Joined):
            path = path.path
        whole = replace(task, path=path)
        points, extensions = LOOKED_AT
        here = plane(crane.machine, sample(whole, np.linspace(0.0, path.duration, points)))[:, None]
        joint = crane.machine.joints[-1]
        strokes = np.linspace(joint.lower, joint.upper, extensions) * crane.ratio
        for one in possible:
            if (position_margin(one, here, strokes) >= 0.0).any(axis=1).all():
                return one
    return possible[0]


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """The tool reference in the boom's own plane, and the slewing it asks for; values of one shape."""

    r: Value  # radius of the tool from the slewing axis [m]
    z: Value  # height [m]
    vr: Value  # [m/s]
    vz: Value
    ar: Value  # [m/s^2]
    az: Value
    q1: Value = 0.0  # base angle [rad]
    v1: Value = 0.0  # [rad/s]
    a1: Value = 0.0  # [rad/s^2]

    def __getitem__(self, index) -> Plane:
        return Plane(*(np.asarray(getattr(self, name))[index] for name in _PLANE))


_PLANE = ("r", "z", "vr", "vz", "ar", "az", "q1", "v1", "a1")


def plane(machine: Machine, reference: Reference) -> Plane:
    """The reference in boom coordinates; the base joint follows from it alone, first entry of eq. (33)."""
    x, y, z = reference.point.T
    vx, vy, vz = reference.velocity.T
    ax, ay, az = reference.acceleration.T
    if not machine.geometry.slewing:
        zero = np.zeros_like(x)
        return Plane(x, z, vx, vz, ax, az, zero, zero, zero)
    r, vr, ar, v1, a1 = kinematics.cylindrical(x, y, vx, vy, ax, ay)
    q1 = np.unwrap(np.arctan2(y, x))
    # Whole turns are free: take those that bring the path nearest to the middle of the base joint's range.
    turns = np.round(
        (0.5 * (machine.joints[0].lower + machine.joints[0].upper) - 0.5 * (q1.min() + q1.max())) / (2 * np.pi)
    )
    return Plane(r, z, vr, vz, ar, az, q1 + 2 * np.pi * turns, v1, a1)


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """All of a crane's state that depends on position alone."""

    crane: Crane
    plane: Plane
    q: tuple[Value, Value, Value]  # lift [rad], tilt [rad], extension [m]
    cylinders: tuple[tuple[Value, Value, Value], ...]  # length, arm, slope of the arm; all joints in order
    jacobian: tuple[Value, ...]  # r2, r3, r4, z2, z3, z4
    inertia: tuple[Value, ...]  # M22, M23, M24, M33, M34, M44
    gravity: tuple[Value, Value, Value]
    coulomb: tuple[Value, ...]  # Coulomb friction level of each cylinder [N]


def pose(crane: Crane, plane: Plane, stroke: Value) -> Pose:
    """The crane's pose with the tool at a reference point and the redundant cylinder at a stroke [m]."""
    machine, g = crane.machine, crane.machine.geometry
    q4 = stroke / crane.ratio
    q2, q3 = lift_and_tilt(crane, plane, q4)
    joints = (plane.q1, q2, q3, q4) if g.slewing else (q2, q3, q4)
    inertia, gravity = inertia_and_gravity(crane, q2, q3, q4)
    coulomb = []
    for cylinder in machine.cylinders:
        level = cylinder.friction.coulomb
        if cylinder.friction.steps is not None:
            level = level * dynamics.stepped_coulomb(q4, *cylinder.friction.steps)
        coulomb.append(level)
    return Pose(
        crane,
        plane,
        (q2, q3, q4),
        tuple(c.linkage.length_arm_slope(q) for c, q in zip(machine.cylinders, joints, strict=True)),
        kinematics.jacobian(q2, q3, q4, g.boom, g.offset, g.outer),
        inertia,
        gravity,
        tuple(coulomb),
    )


def lift_and_tilt(crane: Crane, plane: Plane, q4: Value) -> tuple[Value, Value]:
    """Lift and tilt angle [rad] with the tool at a reference point and the extension at q4 [m], on the crane's side."""
    g = crane.machine.geometry
    return kinematics.lift_and_tilt(
        plane.r, plane.z, q4, g.base_x, g.base_z, g.boom, g.offset, g.outer, crane.side, crane.bent
    )


def position_margin(crane: Crane, plane: Plane, stroke: np.ndarray) -> np.ndarray:
    """How far a pose is inside the reach and the joint ranges: >= 0 exactly where all are kept."""
    q4 = stroke / crane.ratio
    margin = kinematics.BENT - np.abs(elbow_cosine(crane, plane, q4))
    for q, joint in zip((*lift_and_tilt(crane, plane, q4), q4), crane.machine.joints[-3:], strict=True):
        margin = np.minimum(margin, np.minimum(q - joint.lower, joint.upper - q) / (joint.upper - joint.lower))
    return margin


def elbow_cosine(crane: Crane, plane: Plane, q4: Value) -> Value:
    """Cosine of the angle at the tilt joint with the tool at a reference point and the extension at q4 [m]."""
    g = crane.machine.geometry
    return kinematics.elbow_cosine(plane.r, plane.z, q4, g.base_x, g.base_z, g.boom, g.offset, g.outer)


def inertia_and_gravity(crane: Crane, q2: Value, q3: Value, q4: Value) -> tuple[tuple, tuple]:
    """Planar inertia entries M22, M23, M24, M33, M34, M44 and gravity torques of lift, tilt, extension."""
    g, boom = crane.machine.gravity, crane.machine.geometry.boom
    inertia = [0.0] * 6
    gravity = [0.0] * 3
    for body in crane.bodies:
        if body.carrier == "lift":
            inertia[0] = inertia[0] + dynamics.lift_body_inertia(body.mass, body.inertia, body.along, body.above)
            gravity[0] = gravity[0] + dynamics.lift_body_gravity(q2, body.mass, body.along, body.above, g)
        elif body.carrier == "tilt":
            k = body.extension_share
            x = body.along + k * q4
            entries = dynamics.outer_body_inertia(q3, body.mass, body.inertia, x, body.above, k, boom)
            inertia = [total + entry for total, entry in zip(inertia, entries, strict=True)]
            torques = dynamics.outer_body_gravity(q2, q3, body.mass, x, body.above, k, boom, g)
            gravity = [total + torque for total, torque in zip(gravity, torques, strict=True)]
    return tuple(inertia), tuple(gravity)


def velocity_torques(crane: Crane, q: tuple, v: tuple) -> tuple[Value, Value, Value]:
    """Centrifugal and Coriolis torques of lift, tilt and extension; v includes the base first."""
    q2, q3, q4 = q
    v1, v2, v3, v4 = v
    geometry = crane.machine.geometry
    total: list[Value] = [0.0] * 3
    for body in crane.bodies:
        if body.carrier == "lift":
            total[0] = total[0] + dynamics.lift_body_centrifugal(
                q2, body.mass, body.inertia, body.along, body.above, geometry.base_x, v1
            )
        elif body.carrier == "tilt":
            k = body.extension_share
            x, h, boom = body.along + k * q4, body.above, geometry.boom
            bias = dynamics.outer_body_bias(q2, q3, x, h, k, boom, geometry.base_x, v1, v2, v3, v4)
            lift, tilt, extension = dynamics.outer_body_torques(q2, q3, body.mass, x, h, k, boom, *bias)
            spin = dynamics.rod_centrifugal(q2 + q3, body.inertia, v1)
            torques = lift + spin, tilt + spin, extension
            total = [a + b for a, b in zip(total, torques, strict=True)]
    return total[0], total[1], total[2]


def slewing(crane: Crane, q: tuple, v: tuple) -> tuple[Value, Value]:
    """Slewing inertia M11 [kg m^2] and its rate [kg m^2/s]; q, v are lift, tilt, extension."""
    q2, q3, q4 = q
    v2, v3, v4 = v
    g = crane.machine.geometry
    inertia = rate = 0.0
    for body in crane.bodies:
        if body.carrier == "base":
            inertia = inertia + dynamics.slewing_inertia(body.along, body.mass, body.inertia, 0.0)
            continue
        if body.carrier == "lift":
            angle, angle_rate = q2, v2
            radius = g.base_x + body.along * np.cos(q2) - body.above * np.sin(q2)
            radius_rate = -(body.along * np.sin(q2) + body.above * np.cos(q2)) * v2
        else:
            k = body.extension_share
            angle, angle_rate = q2 + q3, v2 + v3
            radius, _ = kinematics.tool_point(q2, q3, k * q4, g.base_x, 0.0, g.boom, body.above, body.along)
            r2, r3, r4, _, _, _ = kinematics.jacobian(q2, q3, k * q4, g.boom, body.above, body.along)
            radius_rate = r2 * v2 + r3 * v3 + r4 * k * v4
        inertia = inertia + dynamics.slewing_inertia(radius, body.mass, body.inertia, angle)
        rate = rate + dynamics.slewing_inertia_rate(radius, radius_rate, body.mass, body.inertia, angle, angle_rate)
    return inertia, rate


@dataclass(frozen=True, slots=True, eq=False)
class Moving:
    """Joint and cylinder motion and the force of inertia and gravity; one value a joint, in joint order."""

    joint_velocity: tuple[Value, ...]  # [rad/s], [m/s]
    joint_acceleration: tuple[Value, ...]
    velocity: tuple[Value, ...]  # cylinders [m/s], eq. (11)
    acceleration: tuple[Value, ...]  # [m/s^2], eq. (12)
    load: tuple[Value, ...]  # inertia and gravity force on the cylinder [N], eq. (16) without friction


def move(pose: Pose, w: Value, u: Value) -> Moving:
    """Motion and load of all cylinders when the redundant one moves at w [m/s] with acceleration u [m/s^2]."""
    crane, plane, machine = pose.crane, pose.plane, pose.crane.machine
    g = machine.geometry
    q2, q3, q4 = pose.q
    r2, r3, r4, z2, z3, z4 = pose.jacobian
    v4, a4 = w / crane.ratio, u / crane.ratio
    v2, v3 = kinematics.solve_plane(r2, r3, z2, z3, plane.vr - r4 * v4, plane.vz - z4 * v4)  # eq. (34)
    br, bz = kinematics.velocity_product(q2, q3, q4, v2, v3, v4, g.boom, g.offset, g.outer)
    a2, a3 = kinematics.solve_plane(r2, r3, z2, z3, plane.ar - br - r4 * a4, plane.az - bz - z4 * a4)  # eq. (35)
    m22, m23, m24, m33, m34, m44 = pose.inertia
    torque = [
        m22 * a2 + m23 * a3 + m24 * a4 + pose.gravity[0],
        m23 * a2 + m33 * a3 + m34 * a4 + pose.gravity[1],
        m24 * a2 + m34 * a3 + m44 * a4 + pose.gravity[2],
    ]
    if machine.coriolis:
        extra = velocity_torques(crane, pose.q, (plane.v1, v2, v3, v4))
        torque = [a + b for a, b in zip(torque, extra, strict=True)]
    joint_velocity: tuple = (v2, v3, v4)
    joint_acceleration: tuple = (a2, a3, a4)
    if g.slewing:
        base = 0.0 * v2
        if machine.slewing_inertia:
            inertia, rate = slewing(crane, pose.q, joint_velocity)
            base = inertia * plane.a1 + (rate * plane.v1 if machine.coriolis else 0.0)
        torque = [base, *torque]
        joint_velocity = (plane.v1, *joint_velocity)
        joint_acceleration = (plane.a1, *joint_acceleration)
    velocity, acceleration, load = [], [], []
    for (_, arm, slope), vq, aq, tq in zip(pose.cylinders, joint_velocity, joint_acceleration, torque, strict=True):
        velocity.append(arm * vq)
        acceleration.append(slope * vq * vq + arm * aq)
        load.append(tq / arm)
    return Moving(joint_velocity, joint_acceleration, tuple(velocity), tuple(acceleration), tuple(load))


def sharpness(crane: Crane) -> tuple[float, ...]:
    """The tanh constant of each cylinder's friction, per cylinder velocity [s/m]."""
    values = []
    for cylinder in crane.machine.cylinders:
        k = cylinder.friction.sharpness
        values.append(k / crane.ratio if cylinder.friction.joint_velocity else k)
    return tuple(values)


def forces(pose: Pose, moving: Moving) -> tuple[Value, ...]:
    """Cylinder forces [N]: load plus friction, eq. (16)."""
    crane = pose.crane
    return tuple(
        load + dynamics.friction(v, level, k, cylinder.friction.viscous)
        for load, v, level, k, cylinder in zip(
            moving.load, moving.velocity, pose.coulomb, sharpness(crane), crane.machine.cylinders, strict=True
        )
    )
