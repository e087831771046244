"""Valves: what the steady state of a cylinder takes from its valve and connection."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from leanboom.quantities import ranges
from leanboom.quantities.ranges import hold


class Connection(Enum):
    """How a cylinder's chambers are connected to its valve, which decides the pump flow it needs."""

    STANDARD = "standard"  # A v extending, B |v| retracting
    SINGLE_ACTING = "single_acting"  # rod side drained: no pump flow retracting
    DIFFERENTIAL = "differential"  # regenerative: (A - B) v extending, B |v| retracting


@dataclass(frozen=True, slots=True)
class MobileValve:
    """Pressure-compensated mobile valve: steady state of eqs. (23)-(24) and (27)-(28)."""

    compensator_drop: float  # delta p_c [Pa]
    extend_coefficient: float  # Coeff. of eq. (24): p_B = coefficient x drop + tank while extending
    retract_coefficient: float  # Coeff. of eq. (23): p_A = coefficient x drop + tank while retracting
    regenerative_ratio: float  # K_vPA / K_vBP of eq. (27)

    def __post_init__(self) -> None:
        hold(
            self, "valve", compensator_drop=ranges.PRESSURE, extend_coefficient=ranges.COEFFICIENT,
            retract_coefficient=ranges.COEFFICIENT, regenerative_ratio=ranges.COEFFICIENT,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class IndependentMetering:
    """Separate meter-in and meter-out edges, eqs. (34)-(35): a chosen back pressure in the off-side chamber."""

    back_pressure: float  # [Pa], planning value (0 in the paper)
    offside_pressure: float  # [Pa], held in the closed-loop simulation (1 MPa in the paper)

    def __post_init__(self) -> None:
        hold(self, "valve", back_pressure=ranges.PRESSURE, offside_pressure=ranges.PRESSURE)


Valve = MobileValve | IndependentMetering
