"""Adaptive robust control of independently metered cylinders, one controller a function.

After Liu and Yao, "Coordinate control of energy saving programmable valves", IEEE Trans. Control Syst. Technol. 16
(2008) 34, without its cross-port valve, as the 3-DOF paper has it. Backstepping in two steps: a desired cylinder force
that lets the position error die out, with the load adapted and bounded; then a desired flow that lets the force error
die out. The chamber that carries the load makes the force; the other, the off-side one, is held at its pressure.

| symbol | name | unit |
| --- | --- | --- |
| e = x - x_d | position error | m |
| s = v - v_d + k_1 e | velocity error against v_eq = v_d - k_1 e | m/s |
| G, m | force of gravity on the cylinder, mass that it feels at once, both of the model | N, kg |
| F_L | what else loads the cylinder, friction and couplings: adapted | N |
| F_d = G + F_L + m (a_d - k_1 (v - v_d) - k_2 s) | desired force | N |
| k = B_eff (A_A^2 / V_A + A_B^2 / V_B) | stiffness of the locked cylinder | N/m |
| F_L' = -gamma k s, held inside +-A p_max | adaptation | N/s |
| p_A = max(p_0, (F_d + p_0 A_B) / A_A) | desired pressure of chamber A, likewise B; p_0 off-side | Pa |
| Q = A v_eq + V/B_eff (p_d' - k_3 (p - p_d)) | desired flow of a chamber | m^3/s |

A chamber whose pressure is left to itself answers a velocity error with the stiffness k, one held at p_d with none.
With gamma below 1 the cylinder is something in between, spring and damper, whatever mass it moves.

Couplings between the joints are left to the robustness of the law, as the 3-DOF paper leaves them.
"""

from __future__ import annotations

import math

import numpy as np

from leanboom.errors import InputError
from leanboom.model import crane as cranes
from leanboom.simulation import plant
from leanboom.simulation.controllers import Rig, Sample

K1, K2, K3 = 6.0, 8.0, 20.0  # [1/s]
ADAPTATION = 0.05  # gamma, below 1: the oil's own stiffness would follow no faster
SMOOTH = 60.0  # of the desired pressures' rates [rad/s]
LEAST_ERROR = 0.004  # a cylinder that planning counts as at rest moves only for a larger error [m]


class AdaptiveRobust:
    """The 3-DOF paper's controller: every function by itself, two commands each."""

    def __init__(self, rig: Rig):
        n = rig.plant.layout.n
        self._functions = [_Function(rig.plant.crane, i, rig.step) for i in range(n)]
        self._command = np.zeros(2 * n)
        self._joints, self._gravity, self._mass = np.zeros(n), np.zeros(n), np.zeros(n)
        self._statics = plant.bind(rig.plant.statics, (self._joints,), (self._gravity, self._mass))

    def command(self, now: Sample) -> np.ndarray:
        """Commands of ports A and B of every cylinder, (2 x cylinders,).

        Args:
            now: The sample.
        """
        self._joints[:] = now.joint
        self._statics()
        columns = (
            now.position, now.velocity, now.pressure_a, now.pressure_b, now.target_position, now.target_velocity,
            now.target_acceleration, self._gravity, self._mass,
        )  # fmt: skip
        rows = zip(*(column.tolist() for column in columns), strict=True)
        for i, (function, values) in enumerate(zip(self._functions, rows, strict=True)):
            self._command[2 * i], self._command[2 * i + 1] = function.command(*values)
        return self._command


class _Function:
    """The law for one cylinder."""

    def __init__(self, crane: cranes.Crane, index: int, step: float):
        machine = crane.machine
        cylinder, joint = machine.cylinders[index], machine.joints[index]
        valve = machine.valve
        if not valve.separate:
            raise InputError("controller = adaptive-robust; drives independent metering, the machine has another valve")
        self._a, self._b = cylinder.areas
        self._travel = plant.retracted(cylinder, joint.lower, joint.upper)[1]
        self._dead, self._bulk = machine.circuit.dead_volume, machine.circuit.bulk_modulus
        self._rest, self._zone = valve.resting(machine.pump, machine.circuit), machine.circuit.dead_zone
        edges = valve.edges(cylinder, machine.circuit)
        self._full = edges.supply * math.sqrt(edges.drop)  # flow of an open edge [m^3/s]
        self._step, self._load = step, 0.0
        self._most = cylinder.push(machine.pump.max_pressure)
        self._wanted: tuple[float, float] | None = None  # pressures wanted last, smoothed
        self._direction = 0.0
        self._least = machine.driven_velocity

    def command(self, x, v, p_a, p_b, x_d, v_d, a_d, gravity, mass) -> tuple[float, float]:
        """Commands of ports A and B."""
        error = x - x_d
        velocity = v_d - K1 * error
        s = v - velocity
        self._turn(v_d, error)
        if self._direction == 0.0:
            return 0.0, 0.0
        volume_a = self._dead + self._a * min(max(x, 0.0), self._travel)
        volume_b = self._dead + self._b * min(max(self._travel - x, 0.0), self._travel)
        stiffness = self._bulk * (self._a * self._a / volume_a + self._b * self._b / volume_b)
        self._load = min(max(self._load - ADAPTATION * stiffness * s * self._step, -self._most), self._most)
        force = gravity + self._load + mass * (a_d - K1 * (v - v_d) - K2 * s)
        a = max(self._rest, (force + self._rest * self._b) / self._a)
        b = max(self._rest, (self._rest * self._a - force) / self._b)
        before = self._wanted or (a, b)
        share = min(1.0, SMOOTH * self._step)
        smooth = (before[0] + share * (a - before[0]), before[1] + share * (b - before[1]))
        rates = ((smooth[0] - before[0]) / self._step, (smooth[1] - before[1]) / self._step)
        self._wanted = smooth
        flow_a = self._a * velocity + volume_a / self._bulk * (rates[0] - K3 * (p_a - smooth[0]))
        flow_b = -self._b * velocity + volume_b / self._bulk * (rates[1] - K3 * (p_b - smooth[1]))
        # Connections P-A and B-T open together, or P-B and A-T; a chamber is never filled against its direction.
        if self._direction > 0.0:
            return self._inverse(max(flow_a, 0.0)), self._inverse(min(flow_b, 0.0))
        return self._inverse(min(flow_a, 0.0)), self._inverse(max(flow_b, 0.0))

    def _turn(self, v_d: float, error: float) -> None:
        """Direction of the valves: of the desired velocity; at rest that which takes a large error away, or none."""
        if abs(v_d) > self._least:
            self._direction = math.copysign(1.0, v_d)
        elif abs(error) > LEAST_ERROR:
            self._direction = -math.copysign(1.0, error)
        elif error * self._direction >= 0.0:
            self._direction = 0.0

    def _inverse(self, flow: float) -> float:
        """Command that opens an edge for a flow: the inverse of `fluid.opening`."""
        share = min(abs(flow) / self._full, 1.0)
        if share == 0.0:
            return 0.0
        open_ = 0.5 * (math.sqrt(1.0 + 8.0 * share) - 1.0)
        return math.copysign(self._zone + (1.0 - self._zone) * open_, flow)
