"""Cylinders: size, linkage to the joint, connection to the valve, friction and limits."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Annotated

from leanboom.components.friction import Friction
from leanboom.components.linkages import LINKAGES, Linkage
from leanboom.quantities.declarations import Section, Variant, hold_declared
from leanboom.quantities.rules import Word
from leanboom.quantities.types import Acceleration, Area, PositiveLength, Velocity


class Connection(Enum):
    """How a cylinder's chambers are connected to its valve, which decides the pump flow it needs."""

    STANDARD = "standard"  # A v extending, B |v| retracting
    SINGLE_ACTING = "single_acting"  # rod side drained: no pump flow retracting
    DIFFERENTIAL = "differential"  # regenerative: (A - B) v extending, B |v| retracting


_CONNECTION = Word(*(each.value for each in Connection), double_acting="standard", regenerative="differential")


@dataclass(frozen=True, slots=True)
class Cylinder:
    """One cylinder: its size, its linkage to the joint, its connection to the valve, its limits."""

    name: str  # of the joint it moves
    piston_area: Area  # A_A
    """Area on the piston side, in place of bore; with rod_side_area."""
    rod_side_area: Area  # A_B
    """Area on the rod side, at most the piston side's."""
    stroke: PositiveLength
    """Must be the change of length over the joint's range, within 2 %; that change if not given."""
    linkage: Annotated[Linkage, Variant(LINKAGES)]
    """How the cylinder moves its joint."""
    connection: Annotated[Connection, _CONNECTION]
    """How its chambers meet the valve, which decides the pump flow."""
    friction: Annotated[Friction, Section(Friction)]
    velocity_limit: Velocity
    """Both ways."""
    acceleration_limit: Acceleration
    """Both ways."""

    def __post_init__(self) -> None:
        hold_declared(self, f"cylinders.{self.name}")

    @property
    def areas(self) -> tuple[float, float]:
        """Area on the piston side and on the rod side [m^2]."""
        return self.piston_area, self.rod_side_area

    def push(self, pressure: float) -> float:
        """Force of a pressure on the piston side [N]."""
        return self.piston_area * pressure
