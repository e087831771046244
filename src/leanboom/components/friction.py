"""Friction of a cylinder."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from leanboom.quantities import ranges
from leanboom.quantities.declarations import hold_declared
from leanboom.quantities.rules import Listing, rising
from leanboom.quantities.types import Bool, Force, Length, Sharpness, Viscous

Steps = Annotated[tuple[Length, Length, Length, Length], Listing("four lengths", ranges.LENGTH, 4, 4, order=rising)]


@dataclass(frozen=True, slots=True)
class Friction:
    """Friction force of the cylinder: coulomb x steps(q) x tanh(sharpness v) + viscous v."""

    coulomb: Force
    """Coulomb friction."""
    sharpness: Sharpness
    """K of the tanh(K v) that smooths the change of sign."""
    viscous: Viscous = 0.0
    """Friction per velocity."""
    steps: Steps | None = None  # q_f1..q_f4 of eq. (A4)
    """Extension only: Coulomb friction rises by 1/m from the first to the second and from the third to the fourth."""
    joint_velocity: Bool = False  # as eq. (A3) is printed
    """Whether v in tanh(K v) is the joint's velocity."""

    def __post_init__(self) -> None:
        hold_declared(self, "friction")
