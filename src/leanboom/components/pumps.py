"""The pump as data: its two ways to be run, and its efficiency."""

from __future__ import annotations

from dataclasses import dataclass

from leanboom.quantities import ranges
from leanboom.quantities.ranges import hold


@dataclass(frozen=True, slots=True)
class EfficiencyMap:
    """Efficiency of pump and drive together, measured over speed, displacement and pressure; axes rise.

    Displacement is the delivered flow over the speed.
    """

    speed: float  # of the drive, within `speeds` [rev/s]
    speeds: tuple[float, ...]  # [rev/s]
    displacements: tuple[float, ...]  # [m^3/rev]
    pressures: tuple[float, ...]  # [Pa]
    total: tuple[tuple[tuple[float, ...], ...], ...]  # (speeds, displacements, pressures)


@dataclass(frozen=True, slots=True)
class Pump:
    """The pump and its two ways to be run. Efficiency is that of pump and drive together (eqs. 36, 43)."""

    constant_pressure: float  # CP supply [Pa]
    ls_margin: float  # delta p_LS [Pa]
    max_pressure: float  # [Pa]
    max_flow: float  # [m^3/s]
    tank_pressure: float = 0.0  # [Pa]
    efficiency: float | EfficiencyMap = 1.0  # what becomes of it is in `shaft`

    def __post_init__(self) -> None:
        hold(
            self, "pump", constant_pressure=ranges.POSITIVE_PRESSURE, ls_margin=ranges.PRESSURE,
            max_pressure=ranges.POSITIVE_PRESSURE, max_flow=ranges.FLOW, tank_pressure=ranges.PRESSURE,
        )  # fmt: skip
        if not isinstance(self.efficiency, EfficiencyMap):
            hold(self, "pump", efficiency=ranges.EFFICIENCY)
