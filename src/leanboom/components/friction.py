"""Friction of a cylinder."""

from __future__ import annotations

from dataclasses import dataclass

from leanboom.quantities import ranges
from leanboom.quantities.ranges import hold


@dataclass(frozen=True, slots=True)
class Friction:
    """Cylinder friction: (coulomb x steps(q) x tanh(sharpness v) + viscous v). Eqs. (A3)-(A4) for the steps."""

    coulomb: float  # [N]
    sharpness: float  # K of the tanh [s/m], acting on the cylinder's velocity (see `joint_velocity`)
    viscous: float = 0.0  # [N s/m]
    steps: tuple[float, float, float, float] | None = None  # q_f1..q_f4 [m], extension joint positions
    joint_velocity: bool = False  # the tanh sees the joint's velocity instead, as eq. (A3) is printed

    def __post_init__(self) -> None:
        hold(self, "friction", coulomb=ranges.FORCE, sharpness=ranges.SHARPNESS, viscous=ranges.VISCOUS)
