"""Variations of machines and tasks: other cylinders, masses, friction, pin distances and places.

The papers do not print all that it takes to model their cranes, and what is public besides has readings; what
follows from either is found by varying it.
"""

from __future__ import annotations

from dataclasses import replace
from math import pi

from leanboom.components.linkages import Triangle
from leanboom.model.machine import Machine
from leanboom.model.task import Lines, Task

Corner = tuple[float, float]  # x, z [m]
EARLIER_TRIANGLE: tuple[Corner, Corner] = (1.40, 0.50), (3.20, 2.50)  # A and B, as bundled before; a guess


# What the 4-DOF paper's crane had and the bundled forwarder's simulation has not, by name; values are assumed.
SWITCHES: dict[str, dict[str, float]] = {
    "telescope bends": {"tip_frequency": 2.0},
    "load swings": {"hanging_length": 1.5},
    "delay varies": {"delay_slack": 0.09},  # 160 to 250 ms
    "spool hysteresis": {"hysteresis": 0.04},
    "load sensing lags": {"sensing_time": 0.15},
}
ALL = "all switches"


def switched(task: Task, name: str) -> Task:
    """A task whose machine is simulated with one of `SWITCHES`, or `ALL` of them."""
    chosen = SWITCHES.values() if name == ALL else [SWITCHES[name]]
    circuit = task.machine.circuit
    for changes in chosen:
        circuit = replace(circuit, **changes)
    return replace(task, machine=replace(task.machine, circuit=circuit))


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


def cornered(task: Task, a: Corner, b: Corner) -> Task:
    """A task along another triangle: from A along a diagonal to B, vertically to C, horizontally back.

    Args:
        task: The task; its path is a closed triangle.
        a, b: Corners A and B, (x, z) [m]; C is below or above B at A's height.
    """
    assert isinstance(task.path, Lines)
    points = tuple((x, 0.0, z) for x, z in (a, b, (b[0], a[1]), a))
    return replace(task, path=replace(task.path, points=points))


def moved(task: Task, x: float, z: float) -> Task:
    """A task whose path is shifted by x and z [m]."""
    assert isinstance(task.path, Lines)
    points = tuple((a + x, b, c + z) for a, b, c in task.path.points)
    return replace(task, path=replace(task.path, points=points))


def derived_pins(machine: Machine) -> Machine:
    """The loader with pin distances derived from the paper alone, as it was bundled before its pins were public.

    Retracted lengths of stroke and 0.28 m were assumed; the lift's arms are equal at both ends of its stroke, and
    20 MPa hold 475 kg at full reach by the tilt.

    Args:
        machine: The machine; its lift and tilt are triangles.
    """
    pins = Triangle(1.1220, 0.358189, 0.708935), Triangle(1.1220, 0.306492, 2.758194)
    derived = tuple(replace(c, linkage=pin) for c, pin in zip(machine.cylinders, pins, strict=False))
    return replace(machine, cylinders=(*derived, *machine.cylinders[2:]))


def zeroed(machine: Machine, angle: float) -> Machine:
    """The loader with another zero of its lift.

    Args:
        machine: The machine; its lift is a triangle.
        angle: Angle between the lift's pins at joint angle 0 [rad].
    """
    lift = machine.cylinders[0]
    assert isinstance(lift.linkage, Triangle)
    lift = replace(lift, linkage=replace(lift.linkage, angle=angle))
    return replace(machine, cylinders=(lift, *machine.cylinders[1:]))
