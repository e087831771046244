r"""The load at the tool as real cranes have it: on a telescope that bends, on a hanger that swings.

Coordinates appended to the joints: the tool's deflection d across the outer boom in its plane, and angles of the hanger
in that plane and across it (a crane that does not slew has the first alone). The deflection is that of a massless beam
with its mass at the end: one bending mode, a spring and a damper, as reduced models of loader cranes with flexible
telescopes have it (Pedersen, Andersen, Nielsen, J. Dyn. Syst. Meas. Control 137 (2015) 101012). The equations of motion
are Lagrange's: with particles m_k at p_k(Q), Q the joints with these coordinates, J_k their Jacobians, and the rigid
rest as in `plant`,

    (M + sum m_k J_k' J_k) Q'' = torques - C - G - sum m_k J_k' (J_k' Q' + g e_z) - springs - dampers.

| symbol | name | unit |
| --- | --- | --- |
| d, a, b | deflection, angles of the hanger in the boom's plane and across | m, rad, rad |
| m, l | mass at the tool, length of the hanger | kg, m |
| f, z | natural frequency and damping ratio of a coordinate; k = m (2 pi f)^2 | Hz, 1 |
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import pi, sqrt
from typing import Any

import numpy as np

from leanboom.errors import InputError
from leanboom.model.crane import Crane
from leanboom.model.machine import Body

ROTATOR = 0.2  # share of a hanging tool's mass that stays at the tool: hanger and rotator; a usual grapple's
Value = Any


@dataclass(frozen=True, slots=True)
class Tip:
    """The point mass at a crane's tool, and how it is held."""

    crane: Crane  # without that mass
    at: Body  # where it is on the outer boom, and the mass
    bends: bool
    swings: bool

    @property
    def count(self) -> int:
        """Number of coordinates."""
        return int(self.bends) + int(self.swings) * (2 if self.crane.machine.geometry.slewing else 1)

    @property
    def masses(self) -> tuple[float, float]:
        """What stays at the tool, and what hangs [kg]."""
        hanging = (1.0 - ROTATOR) * self.at.mass if self.swings else 0.0
        return self.at.mass - hanging, hanging

    @property
    def springs(self) -> list[float]:
        """Stiffness of every coordinate [N/m, N m/rad]; a hanger's is its weight's, not a spring's."""
        stiff = self.at.mass * (2.0 * pi * self.crane.machine.circuit.tip_frequency) ** 2
        return [stiff, *[0.0] * (self.count - 1)] if self.bends else [0.0] * self.count

    @property
    def dampers(self) -> list[float]:
        """Damping of every coordinate [N s/m, N m s/rad]."""
        circuit, found = self.crane.machine.circuit, []
        if self.bends:
            found.append(2.0 * circuit.tip_damping * self.at.mass * 2.0 * pi * circuit.tip_frequency)
        length, hanging = circuit.hanging_length, self.masses[1]
        if self.swings:
            swing = sqrt(self.crane.machine.gravity / length)
            found += [2.0 * circuit.hanging_damping * hanging * length**2 * swing] * (self.count - len(found))
        return found

    def rest(self, q: np.ndarray) -> np.ndarray:
        """Coordinates at rest, the load hanging straight down, (count,).

        Args:
            q: Joints, (cylinders,).
        """
        found = np.zeros(self.count)
        if self.bends:
            found[0] = -self.at.mass * self.crane.machine.gravity * np.cos(q[-3] + q[-2]) / self.springs[0]
        return found

    def offset(self, q: np.ndarray, coordinates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far the tool is bent off, along radius and height [m], (samples,) each.

        Args:
            q: Joints, (samples, cylinders).
            coordinates: Those of the tip, (samples, count).
        """
        bent = coordinates[:, 0] if self.bends else np.zeros(q.shape[0])
        angle = q[:, -3] + q[:, -2]
        return -bent * np.sin(angle), bent * np.cos(angle)

    def particles(self, q: list, coordinates: list) -> list[tuple[float, Value]]:
        """Masses [kg] and their places (x, y, z) [m], as symbols.

        Args:
            q: Joints.
            coordinates: Those of the tip.
        """
        import casadi as ca

        g, rest = self.crane.machine.geometry, list(coordinates)
        turn, lift, angle = (q[0] if g.slewing else 0.0), q[-3], q[-3] + q[-2]
        across = self.at.above + (rest.pop(0) if self.bends else 0.0)
        along = self.at.along + q[-1]
        r = g.base_x + g.boom * np.cos(lift) + along * np.cos(angle) - across * np.sin(angle)
        z = g.base_z + g.boom * np.sin(lift) + along * np.sin(angle) + across * np.cos(angle)
        tool, hanging = self.masses
        found = [(tool, ca.vertcat(r * np.cos(turn), r * np.sin(turn), z))]
        if self.swings:
            length, (a, b) = self.crane.machine.circuit.hanging_length, (*rest, 0.0)[:2]
            out, side = length * np.sin(a), length * np.cos(a) * np.sin(b)
            x = (r + out) * np.cos(turn) - side * np.sin(turn)
            y = (r + out) * np.sin(turn) + side * np.cos(turn)
            found.append((hanging, ca.vertcat(x, y, z - length * np.cos(a) * np.cos(b))))
        return found

    def accelerations(self, q: list, v: list, base: list, inertia: tuple, right: list) -> list:
        """Accelerations of joints and tip, as symbols.

        Args:
            q, v: Joints and coordinates of the tip, and their rates.
            base: Inertia of the rest about the slewing axis, if the crane slews.
            inertia: Entries (2,2), (2,3), (2,4), (3,3), (3,4), (4,4) of its matrix.
            right: Torques on the joints, less velocity torques and gravity of the rest.
        """
        import casadi as ca

        n = len(q) - self.count
        whole, rate = ca.vertcat(*q), ca.vertcat(*v)
        m22, m23, m24, m33, m34, m44 = inertia
        boom = ca.blockcat([[m22, m23, m24], [m23, m33, m34], [m24, m34, m44]])
        mass = ca.diagcat(*base, boom, ca.SX.zeros(self.count, self.count))
        springs = [-k * s - c * w for k, c, s, w in zip(self.springs, self.dampers, q[n:], v[n:], strict=True)]
        force = ca.vertcat(*right, *springs)
        weight = ca.vertcat(0.0, 0.0, self.crane.machine.gravity)
        for m, place in self.particles(q[:n], q[n:]):
            jacobian = ca.jacobian(place, whole)
            bias = ca.jtimes(ca.mtimes(jacobian, rate), whole, rate)
            mass += m * ca.mtimes(jacobian.T, jacobian)
            force -= m * ca.mtimes(jacobian.T, bias + weight)
        return ca.vertsplit(ca.ldl_solve(force, *ca.ldl(mass)))

    def energy(self, q: list, v: list) -> tuple[Value, Value]:
        """Kinetic and potential energy of load and springs, as symbols [J]; arguments as in `accelerations`."""
        import casadi as ca

        n = len(q) - self.count
        whole, rate = ca.vertcat(*q), ca.vertcat(*v)
        kinetic = 0.0
        potential = sum(0.5 * k * s * s for k, s in zip(self.springs, q[n:], strict=True))
        for m, place in self.particles(q[:n], q[n:]):
            speed = ca.mtimes(ca.jacobian(place, whole), rate)
            kinetic = kinetic + 0.5 * m * ca.dot(speed, speed)
            potential = potential + m * self.crane.machine.gravity * place[2]
        return kinetic, potential

    def lost(self, v: list) -> Value:
        """Power left in the dampers [W], of the rates of the tip's coordinates."""
        return sum(c * w * w for c, w in zip(self.dampers, v, strict=True))


def of(crane: Crane) -> Tip | None:
    """The tip of a crane; None where its telescope is stiff and its load does not swing.

    Raises:
        InputError: The switches are on, and there is no point mass at the tool.
    """
    circuit = crane.machine.circuit
    bends, swings = circuit.tip_frequency > 0.0, circuit.hanging_length > 0.0
    if not (bends or swings):
        return None
    points = [
        body for body in crane.bodies if body.carrier == "tilt" and body.inertia == 0.0 and body.extension_share == 1.0
    ]
    mass = sum(body.mass for body in points)
    if mass == 0.0:
        key = "tip_frequency" if bends else "hanging_length"
        raise InputError(
            f"simulation.{key} = {getattr(circuit, key):g}; must be 0 for machine {crane.machine.name}, which has no "
            "payload and no body of inertia 0 at the tool"
        )
    along, above = (sum(body.mass * getattr(body, key) for body in points) / mass for key in ("along", "above"))
    rest = tuple(body for body in crane.bodies if body not in points)
    at = Body("tip", "tilt", mass, along, above, 0.0, 1.0)
    return Tip(replace(crane, bodies=rest), at, bends, swings)
