"""Valves: flow areas and steady-state pressure lines of a cylinder, by its valve and connection.

A valve is a frozen dataclass of its quantities with the steady state of a cylinder on it, and for the simulation its
edges. Its line in `VALVES` gives it its name in machine files, which are read, written and described by its fields.

For every valve the working chamber's pressure is affine in the force: extending p_A = gain_out F + back_out, retracting
p_B = -gain_in F + back_in. `Drive` holds these four numbers and the two flow areas of a cylinder.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import sqrt
from typing import ClassVar

from leanboom.components.circuits import Circuit
from leanboom.components.cylinders import Connection, Cylinder
from leanboom.components.pumps import Pump
from leanboom.errors import InputError
from leanboom.quantities.declarations import hold_declared
from leanboom.quantities.types import Coefficient, Pressure

LEAST_COEFFICIENT = 1e-3  # of eqs. (23)-(24): a smaller one would ask for an endless throttle


@dataclass(frozen=True, slots=True)
class Drive:
    """Flow areas and steady-state pressure lines of one cylinder on its valve."""

    area_out: float  # pump flow per extending velocity [m^2]
    area_in: float  # pump flow per retracting velocity [m^2]
    gain_out: float  # dp_A/dF extending [1/m^2]
    back_out: float  # p_A at zero force, extending [Pa]
    gain_in: float  # -dp_B/dF retracting [1/m^2]
    back_in: float  # p_B at zero force, retracting [Pa]


@dataclass(frozen=True, slots=True)
class Edges:
    """Flow coefficients of a cylinder's open valve edges [m^3/(s sqrt(Pa))], and the drop that compensators keep."""

    compensated_return: bool  # whether edges to the tank are compensated, as in independent metering
    drop: float  # over a compensated edge [Pa]
    supply: float  # K_vPA and K_vPB
    out_b: float  # K_vBT, or K_vBP of a differential spool
    out_a: float  # K_vAT
    make_up: float  # of an anti-cavitation valve


class Valve(ABC):
    """The valves of all cylinders."""

    __slots__ = ()

    circuit: ClassVar[Circuit] = Circuit()  # what the simulation takes where a machine file says nothing
    controller: ClassVar[str] = "dead-zone-inverse"  # a name of `simulation.registry.CONTROLLERS`
    separate: ClassVar[bool] = False  # whether each of a cylinder's ports has a spool and a command of its own

    def __post_init__(self) -> None:
        hold_declared(self, "valve")

    @abstractmethod
    def steady(self, cylinder: Cylinder, pump: Pump) -> Drive:
        """Flow areas and pressure lines of a cylinder on this valve."""

    def edges(self, cylinder: Cylinder, circuit: Circuit) -> Edges:
        """The valve's `Edges` in the simulation, sized so that they settle on the steady states of `steady`."""
        raise InputError(f"valve = {type(self).__name__}; has no `edges`, by which the simulation knows a valve")

    def resting(self, pump: Pump, circuit: Circuit) -> float:
        """Pressure of the less loaded chamber of a cylinder at rest [Pa]."""
        return pump.tank_pressure + circuit.counter_pressure


@dataclass(frozen=True, slots=True)
class MobileValve(Valve):
    """A pressure-compensated mobile valve in steady state."""

    compensator_drop: Pressure  # delta p_c
    """Constant pressure drop over the spool."""
    extend_coefficient: Coefficient  # of eq. (24): p_B = coefficient x drop + tank while extending
    """Back pressure while extending, in compensator drops."""
    retract_coefficient: Coefficient  # of eq. (23): p_A = coefficient x drop + tank while retracting
    """Back pressure while retracting, in compensator drops."""
    regenerative_ratio: Coefficient  # K_vPA / K_vBP of eq. (27)
    """Ratio of the flow coefficients P-A to B-P of a differential spool."""

    def steady(self, cylinder: Cylinder, pump: Pump) -> Drive:
        """Flow areas and pressure lines of eqs. (23)-(24) and (27)-(28)."""
        back_rod = self.extend_coefficient * self.compensator_drop + pump.tank_pressure
        back_piston = self.retract_coefficient * self.compensator_drop + pump.tank_pressure
        # Eqs. (27)-(28): p_B = F/(A-B) + (K^2 B^2 A/(A-B)^3 + A/(A-B)) drop.
        a, b, rod = cylinder.piston_area, cylinder.rod_side_area, cylinder.piston_area - cylinder.rod_side_area
        differential = 0.0
        if cylinder.connection is Connection.DIFFERENTIAL:
            differential = (self.regenerative_ratio**2 * b * b * a / rod**3 + a / rod) * self.compensator_drop
        return drive_of(cylinder, pump, back_rod, back_piston, differential)

    def edges(self, cylinder: Cylinder, circuit: Circuit) -> Edges:
        """Throttles to the tank whose back pressures are those of eqs. (23)-(24)."""
        drop = max(self.compensator_drop, 1.0)
        k = circuit.edge_flow / sqrt(drop)
        ratio = cylinder.piston_area / cylinder.rod_side_area
        # Coeff. = (K_in A_out / (K_out A_in))^2 of eqs. (23)-(24), solved for K_out.
        out_b = k / ratio / sqrt(max(self.extend_coefficient, LEAST_COEFFICIENT))
        out_a = k * ratio / sqrt(max(self.retract_coefficient, LEAST_COEFFICIENT))
        if cylinder.connection is Connection.DIFFERENTIAL:
            out_b = k / max(self.regenerative_ratio, LEAST_COEFFICIENT)  # K_vPA / K_vBP of eq. (27)
        return Edges(False, drop, k, out_b, out_a, k)


METERING = Circuit(
    dead_volume=0.5e-3, line_volume=1e-3, edge_flow=80e-3 / 60, edge_drop=0.5e6, spool_bandwidth=25.0, delay=0.002,
    dead_zone=0.0, counter_pressure=0.0, seal_friction=0.02,
    seal_damping=0.02,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class IndependentMetering(Valve):
    """Valves with separate edges for inflow and outflow."""

    circuit: ClassVar[Circuit] = METERING
    controller: ClassVar[str] = "adaptive-robust"
    separate: ClassVar[bool] = True

    back_pressure: Pressure  # 0 in the 3-DOF paper
    """Pressure in the chamber that empties, in planning."""
    offside_pressure: Pressure  # 1 MPa in the paper
    """The same in the closed-loop simulation."""

    def steady(self, cylinder: Cylinder, pump: Pump) -> Drive:
        """Flow areas and pressure lines of eqs. (34)-(35): a chosen pressure in the chamber that empties."""
        return drive_of(cylinder, pump, self.back_pressure, self.back_pressure, 0.0)

    def edges(self, cylinder: Cylinder, circuit: Circuit) -> Edges:
        """Compensated edges on both sides."""
        k = circuit.edge_flow / sqrt(circuit.edge_drop)
        return Edges(True, circuit.edge_drop, k, k, k, k)

    def resting(self, pump: Pump, circuit: Circuit) -> float:
        """The pressure that is chosen for the chamber that empties [Pa]."""
        return self.offside_pressure


def drive_of(cylinder: Cylinder, pump: Pump, back_rod: float, back_piston: float, differential: float) -> Drive:
    """The drive of a cylinder, by its connection, on a valve that leaves given pressures in the chamber that empties.

    Args:
        cylinder: The cylinder.
        pump: The pump.
        back_rod: Pressure of the rod side, extending [Pa].
        back_piston: Pressure of the piston side, retracting [Pa].
        differential: Pressure of the rod side at zero force, extending in differential connection [Pa].
    """
    a, b = cylinder.piston_area, cylinder.rod_side_area
    gain_in, back_in = 1.0 / b, a / b * back_piston  # eq. (24) retracting; eqs. (34)-(35)
    if cylinder.connection is Connection.SINGLE_ACTING:
        # Rod side drained to the tank: no pump flow and no demanded pressure retracting.
        return Drive(a, 0.0, 1.0 / a, b / a * pump.tank_pressure, 0.0, 0.0)
    if cylinder.connection is Connection.DIFFERENTIAL:
        rod = a - b
        return Drive(rod, b, 1.0 / a + b / (a * rod), b / a * differential, gain_in, back_in)  # p_A = F/A + (B/A) p_B
    return Drive(a, b, 1.0 / a, b / a * back_rod, gain_in, back_in)


VALVES: dict[str, type[Valve]] = {"mobile_valve": MobileValve, "independent_metering": IndependentMetering}
