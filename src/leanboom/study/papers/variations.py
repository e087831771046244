"""Variations of machines and tasks: other cylinders, masses, friction, pin distances and places.

The papers do not print all that it takes to model their cranes; what follows from what is assumed instead is found by
varying it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import pi
from typing import Any

from leanboom.components.linkages import Linkage, Triangle
from leanboom.model.machine import Joint, Machine
from leanboom.model.task import Lines, Task


def resized(machine: Machine, name: str, bore: float, rod: float) -> Machine:
    """A machine with another cylinder.

    Args:
        machine: The machine.
        name: Name of the cylinder.
        bore, rod: Its diameters [m].
    """
    areas = {"piston_area": 0.25 * pi * bore**2, "rod_side_area": 0.25 * pi * (bore**2 - rod**2)}
    cylinders = tuple(replace(c, **areas) if c.name == name else c for c in machine.cylinders)
    return replace(machine, cylinders=cylinders)


def heavier(task: Task, factor: float) -> Task:
    """A task whose machine and payload have `factor` times the mass."""
    bodies = tuple(replace(b, mass=factor * b.mass, inertia=factor * b.inertia) for b in task.machine.bodies)
    return replace(task, machine=replace(task.machine, bodies=bodies), payload=factor * task.payload)


def rubbed(task: Task, factor: float) -> Task:
    """A task whose machine has `factor` times the friction."""
    cylinders = []
    for cylinder in task.machine.cylinders:
        rub = cylinder.friction
        rub = replace(rub, coulomb=factor * rub.coulomb, viscous=factor * rub.viscous)
        cylinders.append(replace(cylinder, friction=rub))
    return replace(task, machine=replace(task.machine, cylinders=tuple(cylinders)))


def moved(task: Task, x: float, z: float) -> Task:
    """A task whose path is shifted by x and z [m]."""
    assert isinstance(task.path, Lines)
    points = tuple((a + x, b, c + z) for a, b, c in task.path.points)
    return replace(task, path=replace(task.path, points=points))


def turned(machine: Machine) -> Machine:
    """The loader with its tilt cylinder mounted the other way round: it extends to fold, its rod side holds the load.

    The same retracted length and stroke; the same pressure holds the load at full reach, so the arm there is larger by
    the ratio of the areas.

    Args:
        machine: The machine; its tilt is a triangle.
    """
    joint, cylinder = machine.joints[1], machine.cylinders[1]
    old = cylinder.linkage
    assert isinstance(old, Triangle)
    short, long = _ends(cylinder.linkage, joint)
    arm = _arm(old, joint.upper) * cylinder.piston_area / cylinder.rod_side_area
    near = replace(old, angle=-(joint.lower + joint.upper + old.angle))
    new = _triangle(near, joint, (long, short), lambda triangle: _arm(triangle, joint.upper) - arm)
    cylinders = (machine.cylinders[0], replace(cylinder, linkage=new), *machine.cylinders[2:])
    return replace(machine, cylinders=cylinders)


def lengthened(machine: Machine, dead: float) -> Machine:
    """The loader with cylinders that have another dead length, its pin distances derived again.

    Strokes and joint ranges are printed. The lift's arms stay equal at both ends of the stroke, the tilt's arm at its
    upper end stays as it is, and with it the pressure that holds the load at full reach.

    Args:
        machine: The machine; its lift and tilt are triangles.
        dead: Retracted length less stroke [m].
    """
    cylinders = list(machine.cylinders)
    lift, tilt = machine.joints[:2]
    kept = _arm(machine.cylinders[1].linkage, tilt.upper)
    thirds = (
        lambda triangle: _arm(triangle, lift.upper) - _arm(triangle, lift.lower),
        lambda triangle: _arm(triangle, tilt.upper) - kept,
    )
    for i, (joint, third) in enumerate(zip((lift, tilt), thirds, strict=True)):
        old, stroke = cylinders[i].linkage, cylinders[i].stroke
        assert isinstance(old, Triangle)
        new = _triangle(old, joint, (stroke + dead, 2.0 * stroke + dead), third)
        cylinders[i] = replace(cylinders[i], linkage=new)
    return replace(machine, cylinders=tuple(cylinders))


def _ends(linkage: Linkage, joint: Joint) -> tuple[float, float]:
    """Lengths of a cylinder at both ends of its joint's range [m]."""
    low, high = (float(linkage.length_arm_slope(q)[0]) for q in (joint.lower, joint.upper))
    return low, high


def _arm(linkage: Linkage, q: float) -> float:
    """Size of a cylinder's torque arm [m]."""
    return abs(float(linkage.length_arm_slope(q)[1]))


def _triangle(near: Triangle, joint: Joint, ends: tuple[float, float], third: Callable[[Triangle], float]) -> Triangle:
    """The triangle with given lengths at both ends of a joint's range and a third condition, near another one."""
    from scipy.optimize import root

    def miss(values: Any) -> list[float]:
        triangle = Triangle(*(float(value) for value in values))
        low, high = _ends(triangle, joint)
        return [low - ends[0], high - ends[1], third(triangle)]

    answer = root(miss, [near.long, near.short, near.angle], tol=1e-12)
    assert answer.success, answer.message
    return Triangle(*(float(value) for value in answer.x))
