"""The 4-DOF paper's crane read otherwise: pins, dead lengths and masses of a public model, and paths elsewhere.

A model of a crane with the paper's exact cylinders is public (github.com/AlessiaIacono/Hydraulic_Crane_RT_simulation,
commit 02252dd, `project.m`); nobody says that it is the paper's crane, and its boom is 3 % longer. Its numbers are
facts to vary with. Angles of its boom are measured from the line between the joints, as Denavit and Hartenberg do.

The paths' durations, peak speeds and shapes are printed, their places are not: a place is what is left to choose.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import root_scalar

from leanboom.components.linkages import FourBar, Linkage, Triangle
from leanboom.errors import InfeasibleError
from leanboom.model.machine import Machine
from leanboom.model.task import Lines, Spline, Task

# Linkages of lift and tilt, by reading; "assumed" is what is bundled.
PINS: Mapping[str, tuple[Linkage, Linkage] | None] = {
    "assumed": None,
    # The bundled recipe (equal arms at both ends of the lift, proportions of two comparable cranes) with retracted
    # cylinders of 0.920 and 1.068 m, of the public model, in place of 0.910 and 1.015 m.
    "dead lengths": (
        Triangle(1.266172, 0.442256, 0.979084),
        FourBar(1.448836, 0.181, 0.272, 0.503, 0.486891, -0.046, 1.963, 0.185),
    ),
    # All pins of the public model. Lift: 0.927 to 1.474 m of 0.920 to 1.530; tilt: 1.179 to 1.776 of 1.068 to 1.793.
    "public": (
        Triangle(1.192835, 0.401319, 1.137139),
        FourBar(1.425001, 0.160527, 0.240, 0.452, 0.430, 0.159462, 1.570796, 0.258307),
    ),
}

# Mass [kg] and centre of mass (along, above the link) [m] of the public model's bodies, as the bundled machine has
# them: the boom with tilt barrel and rods, the outer boom with a link and the extension's barrel. The grapple is not
# part of it.
BODIES = {
    "lift_boom": (500.0, 1.66, 0.18),
    "outer_boom": (235.0, 0.48, 0.50),
    "telescope_1": (115.0, 0.85, 0.376),
    "telescope_2": (90.0, 0.915, 0.376),
}


def pinned(machine: Machine, reading: str) -> Machine:
    """The forwarder with the linkages of lift and tilt by another reading, a name of `PINS`."""
    linkages = PINS[reading]
    if linkages is None:
        return machine
    base, lift, tilt, extension = machine.cylinders
    lift, tilt = replace(lift, linkage=linkages[0]), replace(tilt, linkage=linkages[1])
    return replace(machine, cylinders=(base, lift, tilt, extension))


def bodied(machine: Machine) -> Machine:
    """The forwarder with the public model's masses and centres of mass; inertias grow with the masses."""
    bodies = []
    for body in machine.bodies:
        mass, along, above = BODIES.get(body.name, (body.mass, body.along, body.above))
        inertia = body.inertia * mass / body.mass
        bodies.append(replace(body, mass=mass, along=along, above=above, inertia=inertia))
    return replace(machine, bodies=tuple(bodies))


PUBLIC = 0.10, 5.5e3  # friction of the public model, for `rubbing`


def rubbing(machine: Machine, share: float, extension: float) -> Machine:
    """The forwarder with other friction.

    The public model has a tenth of what supply pressure pushes with, for every cylinder: 5.5 kN for the extension, if
    its middle plateau is that.

    Args:
        machine: The machine.
        share: Of what the highest pressure pushes with, for base, lift and tilt.
        extension: F_c4, of the extension's first plateau [N].
    """
    *others, telescope = machine.cylinders
    forces = [share * cylinder.push(machine.pump.max_pressure) for cylinder in others] + [extension]
    cylinders = (
        replace(cylinder, friction=replace(cylinder.friction, coulomb=force))
        for cylinder, force in zip((*others, telescope), forces, strict=True)
    )
    return replace(machine, cylinders=tuple(cylinders))


def straight(task: Task, x: float, z: float, dx: float, dz: float) -> Task:
    """A task along another straight line in the boom's plane.

    Args:
        task: The task; its path is a line with a duration.
        x, z: Where it begins [m].
        dx, dz: How far it goes [m].
    """
    assert isinstance(task.path, Lines)
    return replace(task, path=replace(task.path, points=((x, 0.0, z), (x + dx, 0.0, z + dz))))


WAY = 0.0, 0.03, 0.2, 1.0  # of the half-cycle's change of radius that is done at its points; the bundled one's
SHARES = 0.0, 0.173, 0.563, 1.0  # of its turn
TIMES = 0.0, 4.2, 8.55, 15.0  # [s], the last one printed
PEAK = 0.75  # [m/s], printed


@dataclass(frozen=True, slots=True)
class HalfCycle:
    """Where the half-cycle leads; its turn follows from the printed peak speed."""

    radius: float = 4.30  # of its beginning above the load space, from the slewing axis [m]
    height: float = 2.50  # [m]
    over: float = 3.30  # height of the two points on the way [m]
    end_radius: float = 5.89  # of its end beside the machine [m]
    end_height: float = 1.30  # [m]

    def turned(self, turn: float) -> Spline:
        """The path on which the base turns by so many radians."""
        radius = self.radius + np.array(WAY) * (self.end_radius - self.radius)
        height = np.array([self.height, self.over, self.over, self.end_height])
        angle = turn * np.array(SHARES)
        points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
        return Spline(tuple((x, y, z) for x, y, z in points.tolist()), TIMES)

    def path(self) -> Spline:
        """The path that has the printed peak speed.

        Raises:
            InfeasibleError: None has with a turn between 0.2 and 3 rad.
        """
        time = np.linspace(0.0, TIMES[-1], 301)

        def fast(turn: float) -> float:
            return float(np.linalg.norm(self.turned(turn).values(time)[1], axis=1).max()) - PEAK

        if fast(0.2) > 0.0 or fast(3.0) < 0.0:
            raise InfeasibleError("no turn gives the half-cycle its printed peak speed")
        return self.turned(root_scalar(fast, bracket=(0.2, 3.0), xtol=1e-6).root)


def explaining(task: Task, path: str) -> Task:
    """A bundled task of the forwarder, by the crane and at the place that explain the paper's statements best.

    Args:
        task: The task, along one of the paper's paths.
        path: Its name, "horizontal", "vertical" or "half-cycle".
    """
    return replace(task, machine=rubbing(pinned(task.machine, "public"), *FRICTION), path=PLACES[path])


# Found by `benchmarks.forwarder`: the friction of the public model, that of the extension [N] twice as much. Closed
# loop chose between places of nearly the same misfit.
FRICTION = 0.10, 12e3
PLACES = {
    "horizontal": Lines(((4.36, 0.0, 3.15), (7.56, 0.0, 3.15)), (10.0,)),
    "vertical": Lines(((6.00, 0.0, 4.79), (6.00, 0.0, 1.75)), (6.0,)),
    "half-cycle": HalfCycle(5.13, 2.86, 3.19, 4.36, 1.69).path(),
}
