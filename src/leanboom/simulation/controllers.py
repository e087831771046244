"""Controllers: valve commands from measured cylinder motions and their targets, every 2 ms.

A controller is any class that is made with a `Rig` and answers a `Sample` with commands from -1 to 1, one a cylinder
for a mobile valve, two (ports A and B) for independent metering:

    class Proportional:
        def __init__(self, rig):
            self.gain = 5.0

        def command(self, now):
            return self.gain * (now.target_position - now.position)

    lb.simulate(task, motion, controller=Proportional)

The 4-DOF paper's controller (Appendix A) is here, the 3-DOF paper's in `adaptive_robust`. Neither knows a method or a
task.

| symbol | name | unit |
| --- | --- | --- |
| I | valve command, share of the full one | 1 |
| DZI | table from velocity to command, which leaps over the dead zone | |
| K_p | gain of the position error | 1/s |
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from leanboom.components.costs import Supply
from leanboom.components.valves import Connection
from leanboom.errors import InputError
from leanboom.model.cost_rates import supply_of
from leanboom.model.crane import Crane
from leanboom.simulation import plant as plants
from leanboom.simulation.integrator import Integrator
from leanboom.simulation.plant import Plant

GAIN = 1.5  # K_p of eq. (A2) [1/s]; the valve's delay allows no more
LEAST_VELOCITY = 0.002  # epsilon_v: a smaller desired velocity does not open the valve [m/s]
LEAST_ERROR = 0.005  # epsilon_p: a larger position error does [m]
RELEASE = 0.4  # share of epsilon_p below which regulation ends

# Measuring the table: openings behind the dead zone that are tried either way, and how long each is held [s].
SHARES = (0.01, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0)
COMMANDED, AVERAGED = 1.6, 0.5
RIG_MASS = 1000.0  # on every cylinder of the test rig; a steady velocity does not depend on it [kg]
RIG_STEP = 0.01  # [s]


@dataclass(slots=True)
class Sample:
    """Measurements and targets at a sample; arrays are (cylinders,), in joint order, and not to be kept."""

    time: float  # [s]
    joint: np.ndarray  # [rad], [m] for the extension
    position: np.ndarray  # of the pistons, beyond retracted [m]
    velocity: np.ndarray  # [m/s]
    pressure_a: np.ndarray  # [Pa]
    pressure_b: np.ndarray  # [Pa]
    supply: float  # [Pa]
    target_position: np.ndarray  # [m]
    target_velocity: np.ndarray  # [m/s]
    target_acceleration: np.ndarray  # [m/s^2]


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """Data available to a controller when it is made: plant, start, sample time."""

    plant: Plant  # its `crane` is the machine with its payload
    joints: np.ndarray  # where the crane starts, (cylinders,) [rad, m]
    step: float  # between samples [s]


class Controller(Protocol):
    """A controller of all cylinders."""

    def command(self, now: Sample) -> np.ndarray:
        """Valve commands from -1 to 1: (cylinders,), or (2 x cylinders,) for independent metering.

        Args:
            now: What is measured, and where the cylinders should be.
        """
        ...


Factory = Callable[[Rig], Controller]


class DeadZoneInverse:
    """Inverse of the measured valve plus proportional feedback, eqs. (A1)-(A2), in two modes.

    Tracking: the valve opens while the desired velocity is above epsilon_v. Regulation: below it, only a position
    error above epsilon_p opens the valve, until the error is well below it.
    """

    def __init__(self, rig: Rig):
        if rig.plant.crane.machine.valve.separate:
            raise InputError(
                "controller = dead-zone-inverse; drives mobile valves, the machine has independent metering"
            )
        self._tables = [(row[:, 0].tolist(), row[:, 1].tolist()) for row in measured_table(rig.plant.crane)]
        self._regulating = [False] * len(self._tables)
        self._command = np.zeros(len(self._tables))

    def command(self, now: Sample) -> np.ndarray:
        """I = DZI(v_d + K_p e), eq. (A2), (cylinders,).

        Args:
            now: The sample.
        """
        targets, wanted, positions = now.target_position.tolist(), now.target_velocity.tolist(), now.position.tolist()
        for i, (target, velocity, position) in enumerate(zip(targets, wanted, positions, strict=True)):
            error = target - position
            self._regulating[i] = abs(error) > LEAST_ERROR * (RELEASE if self._regulating[i] else 1.0)
            active = self._regulating[i] or abs(velocity) > LEAST_VELOCITY
            self._command[i] = _inverse(*self._tables[i], velocity + GAIN * error) if active else 0.0
        return self._command


def _inverse(velocities: list[float], commands: list[float], velocity: float) -> float:
    """Command for a velocity [m/s]: linear between the points of a table, held beyond."""
    i = bisect_right(velocities, velocity)
    if i == 0:
        return commands[0]
    if i == len(velocities):
        return commands[-1]
    share = (velocity - velocities[i - 1]) / (velocities[i] - velocities[i - 1])
    return commands[i - 1] + share * (commands[i] - commands[i - 1])


_TABLES: dict[Crane, tuple[np.ndarray, ...]] = {}


def measured_table(crane: Crane) -> tuple[np.ndarray, ...]:
    """Steady velocities of every cylinder under constant commands, measured on the simulated valve; once a process.

    As the authors did (Figure A1): a valve input is held until the cylinder moves steadily. The cylinders stand on a
    rig with an ample pump at constant pressure, each under the weight that the unladen crane puts on it in the middle
    of its joints' ranges.

    Args:
        crane: The crane; its payload plays no part.

    Returns:
        For each cylinder velocities [m/s], rising, and the commands that give them, (points, 2).
    """
    bare = replace(crane, bodies=crane.machine.bodies)
    if bare not in _TABLES:
        _TABLES[bare] = _measure(bare)
    return _TABLES[bare]


def _measure(crane: Crane) -> tuple[np.ndarray, ...]:
    from leanboom.formulas import fluid

    ample = replace(crane.machine.pump, max_flow=10.0 * crane.machine.pump.max_flow)
    machine = replace(crane.machine, pump=ample)
    crane = replace(crane, machine=machine)
    zone = machine.circuit.dead_zone
    levels = [side * (zone + (1.0 - zone) * share) for side in (1.0, -1.0) for share in SHARES]
    middle = [0.5 * (joint.lower + joint.upper) for joint in machine.joints]
    load = static_loads(plants.of(crane), np.array(middle))
    plant = plants.assemble(crane, rig(crane, load, RIG_MASS))
    layout = plant.layout
    held, averaged = round(COMMANDED / RIG_STEP), round(AVERAGED / RIG_STEP)
    edges = np.zeros((held + 12, 4 * layout.n))
    start = resting(plant, load)
    start[layout.supply] = supply_of(machine.pump, Supply.CONSTANT)[0]
    found: list[list[list[float]]] = [[] for _ in range(layout.n)]
    for level in levels:
        into, out = fluid.opening(level, zone), fluid.opening(-level, zone)
        edges[1:] = np.tile([into, out, out, into], layout.n)
        integrator = Integrator(plant, start, edges, load_sensing=False, step=RIG_STEP, ahead=10, tolerance=1e-5)
        before = integrator.advance(held - averaged)[layout.q].copy()
        moved = integrator.advance(held)[layout.q] - before
        for i, distance in enumerate(moved):
            found[i].append([distance / AVERAGED, level])
    tables = []
    for rows in found:
        table = np.array(sorted([*rows, [0.0, zone], [0.0, -zone]], key=lambda row: row[1]))
        rising = np.maximum.accumulate(table[:, 0])
        tables.append(np.stack([rising + 1e-9 * np.arange(len(rising)), table[:, 1]], axis=1))
    return tuple(tables)


def static_loads(plant: Plant, joints: np.ndarray) -> np.ndarray:
    """Force of gravity on every cylinder [N], (cylinders,).

    Args:
        plant: The crane's plant.
        joints: Joint positions, (cylinders,) [rad, m].
    """
    return np.asarray(plant.statics(joints)[0].full()).ravel()


def resting(plant: Plant, load: np.ndarray) -> np.ndarray:
    """A state at rest whose chambers carry the loads, the less loaded one at its resting pressure, (size,).

    Args:
        plant: The plant.
        load: Force of every cylinder [N], (cylinders,).
    """
    machine, layout = plant.crane.machine, plant.layout
    state = np.zeros(layout.size)
    rest = machine.valve.resting(machine.pump, machine.circuit)
    for i, (cylinder, force) in enumerate(zip(machine.cylinders, load, strict=True)):
        area_a, area_b = cylinder.areas
        low = machine.pump.tank_pressure if cylinder.connection is Connection.SINGLE_ACTING else rest
        a = (force + low * area_b) / area_a
        b = low
        if a < rest and cylinder.connection is not Connection.SINGLE_ACTING:
            a, b = rest, (rest * area_a - force) / area_b
        state[layout.a.start + i], state[layout.b.start + i] = a, b
    state[layout.supply] = machine.pump.tank_pressure + machine.pump.ls_margin
    return state


def rig(crane: Crane, load: np.ndarray, mass: float) -> Callable[[list, list], plants.Mechanism]:
    """Bodies of a test rig: every cylinder pushes a mass against a constant load, its piston near mid-travel.

    Args:
        crane: Whose cylinders stand on the rig.
        load: Force on every cylinder [N], (cylinders,).
        mass: Mass on every cylinder [kg].

    Returns:
        What `plant.assemble` asks for; the joints are travel from mid-stroke [m], too short to change the chambers.
    """
    from leanboom.formulas import dynamics

    machine = crane.machine

    def body(q: list, v: list) -> plants.Mechanism:
        travel = [
            plants.retracted(c, joint.lower, joint.upper)[1]
            for c, joint in zip(machine.cylinders, machine.joints, strict=True)
        ]
        middle = tuple(0.5 * t + 0.0 * x for t, x in zip(travel, q, strict=True))
        friction = tuple(
            dynamics.friction(speed, c.friction.coulomb, c.friction.sharpness, c.friction.viscous)
            for speed, c in zip(v, machine.cylinders, strict=True)
        )
        return plants.Mechanism(
            middle, tuple(v), friction, lambda forces: [(f - w) / mass for f, w in zip(forces, load, strict=True)]
        )

    return body
