"""The pump as data: its two ways to be run, and its efficiency."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from leanboom.quantities import ranges
from leanboom.quantities.declarations import OrSection, Section, hold_declared
from leanboom.quantities.rules import Listing, rising
from leanboom.quantities.types import Displacement, Efficiency, Flow, PositivePressure, Pressure, Speed

Speeds = Annotated[tuple[Speed, ...], Listing("at least one speed", ranges.SPEED, 1, order=rising)]
Displacements = Annotated[
    tuple[Displacement, ...], Listing("at least two displacements", ranges.DISPLACEMENT, 2, order=rising)
]
Pressures = Annotated[
    tuple[PositivePressure, ...], Listing("at least two pressures", ranges.POSITIVE_PRESSURE, 2, order=rising)
]
_ROW = Listing("efficiencies, one for each of pressures", ranges.EFFICIENCY, 2)
_TABLE = Listing("rows, one for each of displacements", _ROW, 2)
Row = Annotated[tuple[Efficiency, ...], _ROW]
Table = Annotated[tuple[Row, ...], _TABLE]
Tables = Annotated[tuple[Table, ...], Listing("tables, one for each of speeds", _TABLE, 1)]


@dataclass(frozen=True, slots=True)
class EfficiencyMap:
    """Efficiency of pump and drive together over speed, displacement and pressure."""

    speed: Speed
    """Of the drive, from the first to the last of speeds."""
    speeds: Speeds
    """At which the tables were measured, rising."""
    displacements: Displacements
    """Delivered flow over speed, rising."""
    pressures: Pressures
    """Rising."""
    total: Tables
    """A table for each speed, in it a row for each displacement, in it a total efficiency for each pressure."""

    def __post_init__(self) -> None:
        hold_declared(self, "pump.efficiency")


@dataclass(frozen=True, slots=True)
class Pump:
    """The pump."""

    constant_pressure: PositivePressure
    """Supply pressure of the constant-pressure system."""
    ls_margin: Pressure
    """Load-sensing margin above the highest load pressure."""
    max_pressure: PositivePressure
    max_flow: Flow
    tank_pressure: Pressure = 0.0
    efficiency: Annotated[float | EfficiencyMap, OrSection(ranges.EFFICIENCY, Section(EfficiencyMap))] = (
        1.0  # eqs. (36), (43); what becomes of it is in `pump_power`
    )
    """Of pump and drive together: a number, or a map over speed, displacement and pressure."""

    def __post_init__(self) -> None:
        hold_declared(self, "pump")
