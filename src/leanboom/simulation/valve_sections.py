"""Valve sections between pump, cylinder and tank: flows at given openings of the four edges.

Every section has the edges P-A, A-T, P-B and B-T, each open by a share from 0 to 1. A mobile valve's one spool moves
them together; independent metering moves each by itself. Steady states are those that planning knows: eqs. (23)-(24)
and (27)-(28) for the mobile valve, eqs. (34)-(35) of the 3-DOF paper for independent metering.

| edge | mobile valve | differential spool | independent metering |
| --- | --- | --- | --- |
| P-A | compensated | compensated, joined by B-P | compensated |
| B-T | throttle of eq. (22) | closed: B feeds P, eq. (26) | compensated |
| P-B | compensated | compensated | compensated |
| A-T | throttle of eq. (21) | throttle | compensated |

A cylinder's chambers also have anti-cavitation valves from the return line.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from leanboom.components.valves import Connection, Edges
from leanboom.formulas.fluid import compensated, gate, opening, orifice
from leanboom.model.machine import Cylinder, Machine

Value = Any  # float, NumPy array or CasADi symbol


@dataclass(frozen=True, slots=True)
class Flows:
    """Flows and losses of a section."""

    a: Value  # into chamber A [m^3/s]
    b: Value  # into chamber B
    pump: Value  # from the supply line
    loss: Value  # power left in edges and anti-cavitation valves, tank pressure as zero [W]
    sense: Value  # pressure reported to a load-sensing pump [Pa]


@dataclass(frozen=True, slots=True)
class Section:
    """One cylinder's valve, and the circuit around it."""

    edges: Edges
    connection: Connection
    back: float  # pressure of the return line [Pa]


def section(machine: Machine, cylinder: Cylinder) -> Section:
    """The section of a cylinder.

    Args:
        machine: The machine, for its valve and circuit.
        cylinder: One of its cylinders.
    """
    back = machine.pump.tank_pressure + machine.circuit.counter_pressure
    return Section(machine.valve.edges(cylinder, machine.circuit), cylinder.connection, back)


def flows(section: Section, shares: tuple[Value, Value, Value, Value], a: Value, b: Value, supply: Value) -> Flows:
    """The `Flows` of a section.

    Args:
        section: The section.
        shares: Open shares of P-A, A-T, P-B, B-T.
        a: Pressure of chamber A [Pa].
        b: Pressure of chamber B [Pa].
        supply: Pressure of the supply line [Pa].
    """
    s, back = section.edges, section.back
    pa, at, pb, bt = shares
    into_a = compensated(supply - a, s.drop, s.supply * pa)
    make_up_a = orifice(back - a, s.make_up)
    if s.compensated_return:
        from_a = compensated(a - back, s.drop, s.out_a * at)
    else:
        from_a = orifice(a - back, s.out_a * at)
    loss = (supply - a) * into_a + a * from_a - a * make_up_a
    to_a = into_a + make_up_a - from_a
    if section.connection is Connection.SINGLE_ACTING:  # the rod side breathes from the tank
        return Flows(to_a, 0.0 * a, into_a, loss, gate(pa) * a)
    into_b = compensated(supply - b, s.drop, s.supply * pb)
    make_up_b = orifice(back - b, s.make_up)
    loss = loss + (supply - b) * into_b - b * make_up_b
    sense = np.maximum(gate(pa) * a, gate(pb) * b)
    if section.connection is Connection.DIFFERENTIAL and not s.compensated_return:
        # Eqs. (25)-(26): chamber B feeds the valve's port P, which stands a compensator's drop above chamber A.
        port = np.maximum(np.minimum(supply - a, s.drop), 0.0)
        from_b = orifice(b - a - port, s.out_b * bt)
        loss = loss + (b - a) * from_b
        to_a = to_a + from_b
    else:
        from_b = (
            compensated(b - back, s.drop, s.out_b * bt) if s.compensated_return else orifice(b - back, s.out_b * bt)
        )
        loss = loss + b * from_b
    return Flows(to_a, into_b + make_up_b - from_b, into_a + into_b, loss, sense)


class Spools:
    """The moving part of the valves: second-order spools behind a delay, stepped by samples.

    Spools move without regard to pressures, so their travel is known before the oil's motion is integrated: exactly
    at the samples, for commands held in between. A low supply may delay a command further, never past the next one;
    a spool with hysteresis follows with play.
    """

    def __init__(self, machine: Machine, step: float):
        circuit = machine.circuit
        self.separate = machine.valve.separate
        self.count = len(machine.cylinders) * (2 if self.separate else 1)
        self.delay = max(1, round(circuit.delay / step))  # samples; a controller's answer takes one
        self._dead_zone, self._play = circuit.dead_zone, 0.5 * circuit.hysteresis
        self._slack, self._highest = circuit.delay_slack / step, machine.pump.max_pressure
        self._now = 0
        self._coming: deque[tuple[int, np.ndarray]] = deque([(0, np.zeros(self.count))])  # commands, when they act
        self._held = np.zeros(self.count)
        self._advance, self._drive = second_order(circuit.spool_bandwidth, step)
        self._state = np.zeros((2, self.count))  # travel, and its rate

    def move(self, command: np.ndarray, supply: float) -> np.ndarray:
        """Open shares of all edges a sample later, (cylinders x 4,), under commands from -1 to 1 held until then.

        Args:
            command: One a cylinder, or a pair for its ports A and B where they are separate.
            supply: Supply pressure as the command is given [Pa].
        """
        slack = round(self._slack * min(max(1.0 - supply / self._highest, 0.0), 1.0))
        self._coming.append((max(self._now + slack, self._coming[-1][0]), command.copy()))
        while len(self._coming) > 1 and self._coming[1][0] <= self._now:
            self._coming.popleft()
        self._now += 1
        acting = self._coming[0][1]
        self._held = np.clip(self._held, acting - self._play, acting + self._play)
        self._state = self._advance @ self._state + np.outer(self._drive, self._held)
        travel = self._state[0]
        into, out = opening(travel, self._dead_zone), opening(-travel, self._dead_zone)
        if self.separate:
            into, out = into.reshape(-1, 2), out.reshape(-1, 2)
            return np.stack([into[:, 0], out[:, 0], into[:, 1], out[:, 1]], axis=1).ravel()
        return np.stack([into, out, out, into], axis=1).ravel()


def second_order(bandwidth: float, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Exact sampled motion of a critically damped spool whose amplitude is down by 3 dB at a frequency [Hz]."""
    from scipy.linalg import expm

    w = 2.0 * np.pi * bandwidth / np.sqrt(np.sqrt(2.0) - 1.0)
    augmented = np.zeros((3, 3))
    augmented[:2] = [[0.0, 1.0, 0.0], [-w * w, -2.0 * w, w * w]]
    held = expm(augmented * step)
    return held[:2, :2], held[:2, 2]
