"""The crane in motion: rigid bodies, friction, cylinder ends, chambers, valves and pump as one stiff system.

The formulas are those of planning, here on CasADi symbols; they meet chamber pressures in place of a prescribed
motion. With cylinder forces F_i = p_A A_A - p_B A_B less friction and end force, torques r_i F_i drive
M(q) q'' + C(q, q') + G(q) (eq. (16) turned round, with the velocity torques that planning omits), and eqs. (18)-(19)
the pressures. Energies are integrated along, so that their balance is as exact as the motion.

| state | unit | size |
| --- | --- | --- |
| q, q': joints and their velocities | rad or m, per s | n, n |
| p_A, p_B: chamber pressures | Pa | n, n |
| p_s: supply pressure | Pa | 1 |
| energy given by the pump; left in valves, in friction and ends, in compressed oil | J | 4 |
| where the machine has them: coordinates of the tip and their rates (see `tip`), the load pressure as sensed | | |

Inputs are the open shares of all valve edges (n x 4) and 1 for a load-sensing, 0 for a constant-pressure pump.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from leanboom.components.costs import Supply
from leanboom.components.valves import Connection
from leanboom.formulas import dynamics, fluid
from leanboom.model import crane as cranes
from leanboom.model.cost_rates import supply_of
from leanboom.model.crane import Crane
from leanboom.model.machine import Cylinder, Machine
from leanboom.model.task import Task
from leanboom.simulation import tip as tips
from leanboom.simulation import valve_sections
from leanboom.simulation.tip import Tip

END_TRAVEL = 5e-4  # [m], how far a cylinder's end gives under the cylinder's force at constant pressure
ENERGIES = ("pump", "valves", "friction", "oil")
Value = Any


@dataclass(frozen=True, slots=True)
class Layout:
    """Index ranges of the state vector of n cylinders, and of what is switched on besides."""

    n: int
    tip: int = 0  # coordinates of the tip
    sensed: int = 0  # 1 where the load pressure is sensed late

    @property
    def q(self) -> slice:
        """Joints."""
        return slice(0, self.n)

    @property
    def v(self) -> slice:
        """Joint velocities."""
        return slice(self.n, 2 * self.n)

    @property
    def a(self) -> slice:
        """Pressures of the chambers A."""
        return slice(2 * self.n, 3 * self.n)

    @property
    def b(self) -> slice:
        """Pressures of the chambers B."""
        return slice(3 * self.n, 4 * self.n)

    @property
    def supply(self) -> int:
        """Supply pressure."""
        return 4 * self.n

    @property
    def energy(self) -> slice:
        """The energies, in the order of `ENERGIES`."""
        return slice(4 * self.n + 1, 4 * self.n + 1 + len(ENERGIES))

    @property
    def bent(self) -> slice:
        """Coordinates of the tip."""
        return slice(self.energy.stop, self.energy.stop + self.tip)

    @property
    def bending(self) -> slice:
        """Their rates."""
        return slice(self.bent.stop, self.bent.stop + self.tip)

    @property
    def sense(self) -> slice:
        """The load pressure as a load-sensing pump knows it."""
        return slice(self.bending.stop, self.bending.stop + self.sensed)

    @property
    def size(self) -> int:
        """Number of states."""
        return self.sense.stop


@dataclass(frozen=True, slots=True, eq=False)
class Plant:
    """A crane ready to be integrated: CasADi functions of state y and inputs u."""

    crane: Crane
    layout: Layout
    rates: Any  # y, u -> dy/dt
    measure: Any  # y -> piston positions [m], piston velocities [m/s]
    observe: Any  # y, u -> the quantities of OBSERVED
    energy: Any  # y -> kinetic, potential [J]
    tip: Tip | None  # what is at the tool, if it bends or swings
    statics: Any  # joints -> force of gravity on the cylinders [N], and the mass each feels with the others free [kg]


def bind(function: Any, arguments: tuple[np.ndarray, ...], results: tuple[np.ndarray, ...]) -> Callable[[], None]:
    """A CasADi function tied to arrays, called in microseconds: it reads the arguments and fills the results.

    Args:
        function: The function.
        arguments: Contiguous float64 arrays in place of its inputs.
        results: Likewise for its outputs.
    """
    buffer, evaluate = function.buffer()
    for i, argument in enumerate(arguments):
        buffer.set_arg(i, argument.data)
    for i, result in enumerate(results):
        buffer.set_res(i, result.data)

    def call(_buffer=buffer) -> None:  # the buffer must live as long as the call
        evaluate()

    return call


OBSERVED = ("force", "friction", "end", "pump_flow", "wanted", "sense", "starved")


@dataclass(frozen=True, slots=True)
class Mechanism:
    """Map from forces to accelerations: a crane, or a test rig."""

    position: tuple[Value, ...]  # of the pistons, beyond retracted [m]
    velocity: tuple[Value, ...]  # of the pistons [m/s]
    friction: tuple[Value, ...]  # of the cylinders [N]
    accelerate: Callable[[list], list]  # piston forces [N] -> accelerations of joints and tip
    lost: Value = 0.0  # power left in the tip's dampers [W]


def retracted(cylinder: Cylinder, lower: float, upper: float) -> tuple[float, float]:
    """Length of a cylinder at the end of its joint's range where it is shortest [m], and its travel [m]."""
    ends = [float(cylinder.linkage.length_arm_slope(q)[0]) for q in (lower, upper)]
    return min(ends), abs(ends[1] - ends[0])


def build(task: Task) -> Plant:
    """The plant of a task: of its machine with its payload; built once a process.

    Args:
        task: The task; its path plays no part.
    """
    return of(cranes.build(task))


@lru_cache(maxsize=8)
def of(crane: Crane) -> Plant:
    """The plant of a crane; built once a process.

    Args:
        crane: The crane.
    """
    tip = tips.of(crane)

    def body(q: list, v: list) -> Mechanism:
        return _crane_motion(crane, tip, q, v)

    return assemble(crane, body, tip)


def assemble(crane: Crane, body: Callable[[list, list], Mechanism], tip: Tip | None = None) -> Plant:
    """A plant of a crane's cylinders, valves and pump on bodies that move as given.

    Args:
        crane: The crane.
        body: Joints and their velocities, as lists of symbols that end with the tip's, to their `Mechanism`.
        tip: What is at the tool, if it bends or swings.
    """
    import casadi as ca

    ca.GlobalOptions.setNumpyMode(1)
    machine = crane.machine
    n = len(machine.cylinders)
    layout = Layout(n, tip.count if tip else 0, int(machine.circuit.sensing_time > 0.0))
    y, u = ca.SX.sym("y", layout.size), ca.SX.sym("u", 4 * n + 1)
    q, v, a, b = (ca.vertsplit(y[part]) for part in (layout.q, layout.v, layout.a, layout.b))
    bent, bending = (ca.vertsplit(y[part]) if layout.tip else [] for part in (layout.bent, layout.bending))
    moving = body([*q, *bent], [*v, *bending])
    known = y[layout.sense] if layout.sensed else None
    hydraulic = _hydraulics(machine, moving, a, b, y[layout.supply], known, ca.vertsplit(u))
    forces = [f - r + e for f, r, e in zip(hydraulic.force, moving.friction, hydraulic.end, strict=True)]
    faster = moving.accelerate(forces)
    rates = ca.vertcat(*v, *faster[:n], *hydraulic.rates, *bending, *faster[n:], *hydraulic.sensing)
    observed = [
        ca.vertcat(*hydraulic.force), ca.vertcat(*moving.friction), ca.vertcat(*hydraulic.end),
        hydraulic.pump_flow, hydraulic.wanted, ca.vertcat(*hydraulic.sense), ca.vertcat(*hydraulic.starved),
    ]  # fmt: skip
    kinetic, potential = _energy(tip.crane if tip else crane, q, v)
    if tip:
        further = tip.energy([*q, *bent], [*v, *bending])
        kinetic, potential = kinetic + further[0], potential + further[1]
    return Plant(
        crane=crane,
        layout=layout,
        rates=ca.Function("rates", [y, u], [rates]),
        measure=ca.Function("measure", [y], [ca.densify(ca.vertcat(*moving.position, *moving.velocity))]),
        observe=ca.Function("observe", [y, u], observed, ["y", "u"], list(OBSERVED)),
        energy=ca.Function("energy", [y], [kinetic, potential]),
        tip=tip,
        statics=ca.Function("statics", [y[layout.q]], [ca.densify(ca.vertcat(*x)) for x in _statics(crane, q)]),
    )


def _crane_motion(crane: Crane, tip: Tip | None, q: list, v: list) -> Mechanism:
    """Bodies and linkages of a crane; positions and velocities end with those of its tip."""
    machine = crane.machine
    whole, whole_rate, rigid = list(q), list(v), tip.crane if tip else crane
    q, v = q[: len(machine.cylinders)], v[: len(machine.cylinders)]
    boom = q[-3:]
    rate = list(v) if machine.geometry.slewing else [0.0, *v]
    position, velocity, friction, arms = [], [], [], []
    for cylinder, joint, sharp, q_i, v_i in zip(
        machine.cylinders, machine.joints, cranes.sharpness(crane), q, v, strict=True
    ):
        length, arm, _ = cylinder.linkage.length_arm_slope(q_i)
        speed = arm * v_i
        level = cylinder.friction.coulomb
        if cylinder.friction.steps is not None:
            level = level * dynamics.stepped_coulomb(q[-1], *cylinder.friction.steps)
        full = machine.full_force(cylinder)
        level = level + machine.circuit.seal_friction * full
        viscous = cylinder.friction.viscous + machine.circuit.seal_damping * full / cylinder.velocity_limit
        position.append(length - retracted(cylinder, joint.lower, joint.upper)[0])
        velocity.append(speed)
        friction.append(dynamics.friction(speed, level, sharp, viscous))
        arms.append(arm)

    def accelerate(forces: list) -> list:
        torque = [arm * force for arm, force in zip(arms, forces, strict=True)]
        inertia, gravity = cranes.inertia_and_gravity(rigid, *boom)
        swing = cranes.velocity_torques(rigid, tuple(boom), tuple(rate))
        right = [t - g - c for t, g, c in zip(torque[-3:], gravity, swing, strict=True)]
        base = []  # inertia about the slewing axis, and torque there
        if machine.geometry.slewing:
            turning, change = cranes.slewing(rigid, tuple(boom), tuple(rate[1:]))
            base = [(turning, torque[0] - change * rate[0])]
        if tip:
            return tip.accelerations(whole, whole_rate, [m for m, _ in base], inertia, [*(t for _, t in base), *right])
        return [*(t / m for m, t in base), *_solve(inertia, right)]

    lost = tip.lost(whole_rate[len(v) :]) if tip else 0.0
    return Mechanism(tuple(position), tuple(velocity), tuple(friction), accelerate, lost)


def _statics(crane: Crane, q: list) -> tuple[list, list]:
    """Force of gravity on every cylinder, and the mass that it feels at once, the others being free to give way."""
    machine, boom = crane.machine, q[-3:]
    inertia, gravity = cranes.inertia_and_gravity(crane, *boom)
    torque = list(gravity)
    inertias = [1.0 / _solve(inertia, [float(i == j) for i in range(3)])[j] for j in range(3)]
    if machine.geometry.slewing:
        torque.insert(0, 0.0)
        inertias.insert(0, cranes.slewing(crane, tuple(boom), (0.0, 0.0, 0.0))[0])
    arms = [c.linkage.length_arm_slope(joint)[1] for c, joint in zip(machine.cylinders, q, strict=True)]
    forces = [t / arm for t, arm in zip(torque, arms, strict=True)]
    return forces, [i / (arm * arm) for i, arm in zip(inertias, arms, strict=True)]


def _solve(inertia: tuple, right: list) -> list:
    """Accelerations of lift, tilt and extension: the symmetric system of eq. (16), by Cholesky's method."""
    m22, m23, m24, m33, m34, m44 = inertia
    l21, l31 = m23 / m22, m24 / m22
    d2 = m33 - l21 * m23
    l32 = (m34 - l31 * m23) / d2
    d3 = m44 - l31 * m24 - l32 * l32 * d2
    y1 = right[0]
    y2 = right[1] - l21 * y1
    y3 = right[2] - l31 * y1 - l32 * y2
    x3 = y3 / d3
    x2 = y2 / d2 - l32 * x3
    return [y1 / m22 - l21 * x2 - l31 * x3, x2, x3]


@dataclass(frozen=True, slots=True)
class _Hydraulics:
    force: list  # of the pressures on the pistons [N]
    end: list  # of the cylinders' ends [N]
    rates: list  # of all states behind the joints' velocities
    pump_flow: Value
    wanted: Value  # supply pressure the pump is set to [Pa]
    sense: list
    sensing: list  # rate of the sensed load pressure, where it lags
    starved: list  # by how much a compensator's drop is short of what is open to the supply [Pa]


def _hydraulics(
    machine: Machine, moving: Mechanism, a: list, b: list, supply: Value, known: Value | None, u: list
) -> _Hydraulics:
    circuit, pump = machine.circuit, machine.pump
    bulk = circuit.bulk_modulus
    force, end, rate_a, rate_b, sense, starved = [], [], [], [], [], []
    taken = valve_loss = oil = 0.0
    friction_loss = moving.lost
    for i, (cylinder, joint) in enumerate(zip(machine.cylinders, machine.joints, strict=True)):
        area_a, area_b = cylinder.areas
        x, v = moving.position[i], moving.velocity[i]
        travel = retracted(cylinder, joint.lower, joint.upper)[1]
        section = valve_sections.section(machine, cylinder)
        edges = (u[4 * i], u[4 * i + 1], u[4 * i + 2], u[4 * i + 3])
        flow = valve_sections.flows(section, edges, a[i], b[i], supply)
        volume_a = fluid.chamber_volume(circuit.dead_volume, area_a, x)
        volume_b = fluid.chamber_volume(circuit.dead_volume, area_b, travel - x)
        change_a = fluid.pressure_rate(flow.a, area_a * v, volume_a, bulk)
        change_b = fluid.pressure_rate(flow.b, -area_b * v, volume_b, bulk)
        work_b = b[i] * (flow.b + area_b * v)
        if cylinder.connection is Connection.SINGLE_ACTING:  # open to the tank: no pressure to speak of
            change_b, work_b = 0.0 * v, 0.0
            valve_loss = valve_loss + b[i] * area_b * v
        stiffness = machine.full_force(cylinder) / END_TRAVEL
        force.append(area_a * a[i] - area_b * b[i])
        end.append(fluid.end_force(x, v, travel, stiffness))
        rate_a.append(change_a)
        rate_b.append(change_b)
        sense.append(flow.sense)
        short_a = fluid.gate(edges[0]) * np.maximum(section.edges.drop - (supply - a[i]), 0.0)
        short_b = fluid.gate(edges[2]) * np.maximum(section.edges.drop - (supply - b[i]), 0.0)
        starved.append(np.maximum(short_a, short_b))
        taken = taken + flow.pump
        valve_loss = valve_loss + flow.loss
        friction_loss = friction_loss + (moving.friction[i] - end[i]) * v
        oil = oil + a[i] * (flow.a - area_a * v) + work_b
    highest = sense[0]
    for pressure in sense[1:]:
        highest = np.maximum(highest, pressure)
    sensing = [] if known is None else [(highest - known) / circuit.sensing_time]
    highest = highest if known is None else known
    sensed = np.minimum(np.maximum(highest, 0.0) + pump.ls_margin, pump.max_pressure)
    wanted = u[-1] * sensed + (1.0 - u[-1]) * supply_of(pump, Supply.CONSTANT)[0]
    line = bulk / circuit.line_volume
    change = fluid.supply_rate(wanted, supply, circuit.pump_time_constant, pump.max_flow - taken, line)
    filling = taken + change / line
    given = np.maximum(filling, 0.0)
    # What the line gives off beyond what the valves take goes to the tank through the pump's controller.
    valve_loss = valve_loss + supply * (given - filling)
    oil = oil + supply * change / line
    energies = [supply * given, valve_loss, friction_loss, oil]
    return _Hydraulics(force, end, [*rate_a, *rate_b, change, *energies], given, wanted, sense, sensing, starved)


def _energy(crane: Crane, q: list, v: list) -> tuple[Value, Value]:
    """Kinetic and potential energy of the bodies [J]."""
    machine, g = crane.machine, crane.machine.geometry
    q2, q3, q4 = q[-3:]
    v2, v3, v4 = v[-3:]
    (m22, m23, m24, m33, m34, m44), _ = cranes.inertia_and_gravity(crane, q2, q3, q4)
    kinetic = 0.5 * (m22 * v2 * v2 + m33 * v3 * v3 + m44 * v4 * v4) + m23 * v2 * v3 + m24 * v2 * v4 + m34 * v3 * v4
    if g.slewing:
        kinetic = kinetic + 0.5 * cranes.slewing(crane, (q2, q3, q4), (v2, v3, v4))[0] * v[0] * v[0]
    potential = 0.0
    for body in crane.bodies:
        if body.carrier == "base":
            continue
        height = body.along * np.sin(q2) + body.above * np.cos(q2)
        if body.carrier == "tilt":
            along = body.along + body.extension_share * q4
            height = g.boom * np.sin(q2) + along * np.sin(q2 + q3) + body.above * np.cos(q2 + q3)
        potential = potential + body.mass * machine.gravity * height
    return kinetic, potential
