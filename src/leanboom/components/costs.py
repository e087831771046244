"""The pumps, and the costs a motion can be planned for, as data.

The rate of every cost is one expression of the cylinders' velocities v and forces F,

    sum square v^2 + work sum max(F v, 0) + P(supply, sum max(area_out v, -area_in v)),

with P the pump's shaft power. `Cost` says which of these a cost has, `CostTerms` holds their numbers for a crane.
Kernels, nonlinear program, judge, baselines and certificate know a cost by these alone: a new one is an entry of
`COSTS`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, NamedTuple, TypeVar

from leanboom.errors import InputError

Value = TypeVar("Value")

PUMPS = ("ls", "cp")  # load-sensing, constant-pressure


class Supply(Enum):
    """Kinds of supply pressure in a cost."""

    NONE = "no pump"
    CONSTANT = "constant pressure"
    LOAD_SENSING = "highest pressure that a cylinder demands, and a margin"


class CostTerms(NamedTuple):
    """Numbers of a cost's rate; sequences in the order of the cylinders."""

    square: tuple[float, ...]  # of squared velocities
    work: bool  # whether positive work counts
    area_out: tuple[float, ...]  # pump flow per extending velocity [m^2]
    area_in: tuple[float, ...]  # per retracting velocity [m^2]; below zero, retracting feeds the pump
    supply: Supply


def of_drive(cylinder: Any, drive: Any) -> tuple[float, float]:
    """Areas through which a cylinder takes oil from the pump [m^2]."""
    return drive.area_out, drive.area_in


def net(cylinder: Any, drive: Any) -> tuple[float, float]:
    """Areas of the net flow of a cylinder whose return flow is reused [m^2]. Eq. (37), 3-DOF paper."""
    area = cylinder.piston_area - cylinder.rod_side_area
    return area, -area


@dataclass(frozen=True, slots=True)
class Cost:
    """A cost: the terms of its rate, with its name and unit.

    Work and a load-sensing supply do not go together: over the acceleration, kernels follow the one or the other.
    """

    name: str
    sentence: str
    unit: str = "J"
    supply: Supply = Supply.NONE
    areas: Callable[[Any, Any], tuple[float, float]] = of_drive  # of a cylinder and its drive
    work: bool = False
    square: Callable[[int], tuple[float, ...]] = lambda count: (0.0,) * count  # weights of a number of cylinders

    def __post_init__(self) -> None:
        if self.work and self.supply is Supply.LOAD_SENSING:
            raise InputError(f"cost {self.name} = work and a load-sensing supply; must be one of them")

    @property
    def loads(self) -> bool:
        """Whether the cylinders' forces count."""
        return self.work or self.supply is Supply.LOAD_SENSING

    def terms(self, cylinders: Sequence[Any], drives: Sequence[Any]) -> CostTerms:
        """The numbers for cylinders on their drives."""
        none = self.supply is Supply.NONE
        areas = [(0.0, 0.0) if none else self.areas(c, d) for c, d in zip(cylinders, drives, strict=True)]
        area_out, area_in = zip(*areas, strict=True)
        return CostTerms(self.square(len(areas)), self.work, area_out, area_in, self.supply)


COSTS = {
    cost.name: cost
    for cost in (
        Cost("ls", "load-sensing pump energy, eq. (36); eq. (32), 3-DOF paper", supply=Supply.LOAD_SENSING),
        Cost("cp", "constant-pressure pump energy, eq. (43); eqs. (27), (31), 3-DOF paper", supply=Supply.CONSTANT),
        Cost("actuator", "positive actuator work, both papers", work=True),
        Cost("velocity", "squared cylinder velocities", "m^2/s", square=lambda count: (1.0,) * count),
        Cost(
            "extension", "squared velocity of the extension cylinder", "m^2/s",
            square=lambda count: (0.0,) * (count - 1) + (1.0,),
        ),
        Cost(
            "recuperation", "constant-pressure energy with return flow reused, eq. (37), 3-DOF paper",
            supply=Supply.CONSTANT, areas=net,
        ),
    )
}  # fmt: skip


def of_pump(pump: str, ls: Value, cp: Value) -> Value:
    """The one of two values that belongs to a pump.

    Args:
        pump: A name of `PUMPS`.
        ls: The value of a load-sensing pump.
        cp: The value of a constant-pressure pump.

    Raises:
        InputError: For any other name.
    """
    if pump not in PUMPS:
        raise InputError(f"pump = {pump}; must be one of {', '.join(PUMPS)}")
    return ls if pump == "ls" else cp
