"""Linkages between a cylinder and its joint."""

from __future__ import annotations

from dataclasses import dataclass

from leanboom.quantities import ranges
from leanboom.quantities.ranges import checked, hold, listed


@dataclass(frozen=True, slots=True)
class RackAndPinion:
    """Constant torque arm [m]: the pinion's pitch radius."""

    arm: float

    def __post_init__(self) -> None:
        hold(self, "linkage", arm=ranges.POSITIVE_LENGTH)

    def length_arm_slope(self, q):
        """Length [m], signed torque arm and its slope [m/rad, m/rad^2] at joint position q."""
        return self.arm * q, self.arm + 0.0 * q, 0.0 * q


@dataclass(frozen=True, slots=True)
class Triangle:
    """Cylinder spanning a joint: c^2 = long^2 + short^2 - 2 long short cos(q + angle). Eq. (13), eq. (30)."""

    long: float  # [m]
    short: float  # [m]
    angle: float  # [rad]; q(0) of eq. (30), pi/2 - b11 - b12 of eq. (13)

    def __post_init__(self) -> None:
        hold(self, "linkage", long=ranges.POSITIVE_LENGTH, short=ranges.POSITIVE_LENGTH, angle=ranges.ANGLE)

    def length_arm_slope(self, q):
        """Length [m], signed torque arm and its slope [m/rad, m/rad^2] at joint position q."""
        from leanboom.formulas.linkages import triangle

        return triangle(q, self.long, self.short, self.angle)


@dataclass(frozen=True, slots=True)
class FourBar:
    """Cylinder driving a joint through lever and coupler, eq. (14); names as in the 4-DOF paper [m, rad]."""

    L21: float
    L22: float
    L23: float
    L24: float
    L25: float
    a21: float
    a22: float
    b21: float

    def __post_init__(self) -> None:
        bars = dict.fromkeys(("L21", "L22", "L23", "L24", "L25"), ranges.POSITIVE_LENGTH)
        hold(self, "linkage", **bars, **dict.fromkeys(("a21", "a22", "b21"), ranges.ANGLE))

    def length_arm_slope(self, q):
        """Length [m], signed torque arm and its slope [m/rad, m/rad^2] at joint position q."""
        from leanboom.formulas.linkages import four_bar

        return four_bar(q, self.L21, self.L22, self.L23, self.L24, self.L25, self.a21, self.a22, self.b21)


@dataclass(frozen=True, slots=True)
class Polynomial:
    """Cylinder length as a polynomial of the joint angle, highest power first; the quintic of eq. (14) [m]."""

    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        given = listed("linkage.coefficients", self.coefficients, "2 to 12 numbers, highest power first", 2, 12)
        kept = tuple(checked(f"linkage.coefficients[{i}]", value, ranges.NUMBER) for i, value in enumerate(given))
        object.__setattr__(self, "coefficients", kept)

    def length_arm_slope(self, q):
        """Length [m], signed torque arm and its slope [m/rad, m/rad^2] at joint position q."""
        c = r = s = 0.0 * q
        for coefficient in self.coefficients:  # Horner's rule for value and two derivatives
            s = s * q + 2.0 * r
            r = r * q + c
            c = c * q + coefficient
        return c, r, s


@dataclass(frozen=True, slots=True)
class Telescope:
    """Extension cylinder: length = ratio x joint; 1/2 where a chain doubles the stroke (r4 of the paper)."""

    ratio: float

    def __post_init__(self) -> None:
        hold(self, "linkage", ratio=ranges.POSITIVE_NUMBER)

    def length_arm_slope(self, q):
        """Length [m], signed torque arm [m/m] and its slope [1/m] at joint position q."""
        return self.ratio * q, self.ratio + 0.0 * q, 0.0 * q


Linkage = RackAndPinion | Triangle | FourBar | Polynomial | Telescope
