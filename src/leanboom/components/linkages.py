"""Linkages between a cylinder and its joint.

A linkage is a frozen dataclass of lengths and angles with the formula of its length. Its line in `LINKAGES` gives it a
name in machine files, which are read, written and described by its fields.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import pi
from typing import Annotated, Any

from leanboom.quantities import ranges
from leanboom.quantities.declarations import hold_declared
from leanboom.quantities.rules import Listing
from leanboom.quantities.types import Angle, Number, PositiveLength, PositiveNumber


class Linkage(ABC):
    """How a cylinder moves its joint."""

    __slots__ = ()

    def __post_init__(self) -> None:
        hold_declared(self, "linkage")

    @abstractmethod
    def length_arm_slope(self, q: Any) -> tuple[Any, Any, Any]:
        """Length [m], signed torque arm and its slope [m/rad, m/rad^2] at joint position q, numbers or arrays."""

    def closes(self, q: Any) -> Any:
        """Whether the linkage can be put together at joint position q."""
        return abs(q) >= 0.0  # at any position


@dataclass(frozen=True, slots=True)
class RackAndPinion(Linkage):
    """A rack turning a pinion."""

    arm: PositiveLength
    """Pitch radius of the pinion."""

    def length_arm_slope(self, q):
        """Length [m], signed torque arm and its slope [m/rad, m/rad^2] at joint position q."""
        return self.arm * q, self.arm + 0.0 * q, 0.0 * q


@dataclass(frozen=True, slots=True)
class Triangle(Linkage):
    """A cylinder spanning the joint: c^2 = long^2 + short^2 - 2 long short cos(q + angle)."""

    # Eqs. (13), (30); the angle is q(0) of eq. (30), pi/2 - b11 - b12 of eq. (13).
    long: PositiveLength
    """Joint to the farther pin."""
    short: PositiveLength
    """Joint to the nearer pin."""
    angle: Angle
    """Angle between the two pins, seen from the joint, at joint angle 0."""

    def length_arm_slope(self, q):
        """Length [m], signed torque arm and its slope [m/rad, m/rad^2] at joint position q."""
        from leanboom.formulas.linkages import triangle

        return triangle(q, self.long, self.short, self.angle)


@dataclass(frozen=True, slots=True)
class FourBar(Linkage):
    """A cylinder driving the joint through lever and coupler."""

    # Eq. (14), names as in the 4-DOF paper.
    L21: PositiveLength
    """Cylinder's pin on the boom to the lever's pivot."""
    L22: PositiveLength
    """Lever's pivot to the tilt joint."""
    L23: PositiveLength
    """Tilt joint to the coupler's pin on the outer boom."""
    L24: PositiveLength
    """Coupler."""
    L25: PositiveLength
    """Lever."""
    a21: Angle
    """Direction of the lever's pivot, seen from the tilt joint, against the boom."""
    a22: Angle
    """Direction of the coupler's pin, seen from the tilt joint, against the outer boom."""
    b21: Angle
    """Direction of the cylinder's pin, seen from the lever's pivot, against the boom."""

    def length_arm_slope(self, q):
        """Length [m], signed torque arm and its slope [m/rad, m/rad^2] at joint position q."""
        from leanboom.formulas.linkages import four_bar

        return four_bar(q, self.L21, self.L22, self.L23, self.L24, self.L25, self.a21, self.a22, self.b21)

    def closes(self, q):
        """Whether eq. (14) holds at joint position q: lever and coupler meet (acos) and the asin is on its branch."""
        import numpy as np

        squared = self.L22**2 + self.L23**2 - 2.0 * self.L22 * self.L23 * np.cos(pi + q + self.a21 + self.a22)
        cosine = (self.L25**2 + squared - self.L24**2) / (2.0 * self.L25 * np.sqrt(squared))
        return (np.abs(cosine) < 1.0) & (self.L22**2 + squared > self.L23**2)


@dataclass(frozen=True, slots=True)
class Polynomial(Linkage):
    """Cylinder length in m as a polynomial of the joint angle in rad."""

    coefficients: Annotated[tuple[Number, ...], Listing("2 to 12 numbers, highest power first", ranges.NUMBER, 2, 12)]
    """Highest power first."""

    def length_arm_slope(self, q):
        """Length [m], signed torque arm and its slope [m/rad, m/rad^2] at joint position q."""
        c = r = s = 0.0 * q
        for coefficient in self.coefficients:  # Horner's rule for value and two derivatives
            s = s * q + 2.0 * r
            r = r * q + c
            c = c * q + coefficient
        return c, r, s


@dataclass(frozen=True, slots=True)
class Telescope(Linkage):
    """Cylinder length proportional to the extension."""

    ratio: PositiveNumber  # r4 of the 4-DOF paper
    """Cylinder length per extension: 1, or 0.5 where a chain doubles the stroke."""

    def length_arm_slope(self, q):
        """Length [m], signed torque arm [m/m] and its slope [1/m] at joint position q."""
        return self.ratio * q, self.ratio + 0.0 * q, 0.0 * q


LINKAGES: dict[str, type[Linkage]] = {
    "rack_and_pinion": RackAndPinion,
    "triangle": Triangle,
    "four_bar": FourBar,
    "polynomial": Polynomial,
    "telescope": Telescope,
}
