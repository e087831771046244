"""Taylor models of one variable: second-order expansions over a cell with rigorous error bounds.

An `Enclosure` stands for a function of position over a cell, c = middle + half width t with -1 <= t <= 1:

    f(c) = p0 + p1 t + p2 t^2 + e(t),     |e(t)| <= error.

Formulas of the package run on enclosures as they run on arrays, because they use NumPy's ufuncs alone; out come the
value, the slope and the curvature of every coefficient over the cell, and a bound on what is missing. Operations
follow Berz and Makino, "Verified integration of ODEs and flows using differential algebraic methods on
high-order Taylor models", Reliable Computing 4 (1998) 361: exact in the polynomial, upper bounds in the error.
Floating-point rounding is not tracked; `ROUNDING` covers it many times over where enclosures are used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

ROUNDING = 1e-11  # relative error of double precision after a few hundred operations, with room to spare


@dataclass(frozen=True, slots=True, eq=False)
class Enclosure:
    """A quadratic in t in [-1, 1] and a bound on the error; arrays of one shape, one cell an entry."""

    p0: np.ndarray
    p1: np.ndarray
    p2: np.ndarray
    error: np.ndarray

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        if method != "__call__" or kwargs or ufunc not in _RULES:
            return NotImplemented
        return _RULES[ufunc](*inputs)

    def __add__(self, other: Any) -> Enclosure:
        return _add(self, other)

    def __sub__(self, other: Any) -> Enclosure:
        return _subtract(self, other)

    def __mul__(self, other: Any) -> Enclosure:
        return _multiply(self, other)

    def __truediv__(self, other: Any) -> Enclosure:
        return _divide(self, other)

    def __radd__(self, other: Any) -> Enclosure:
        return _add(other, self)

    def __rsub__(self, other: Any) -> Enclosure:
        return _subtract(other, self)

    def __rmul__(self, other: Any) -> Enclosure:
        return _multiply(other, self)

    def __rtruediv__(self, other: Any) -> Enclosure:
        return _divide(other, self)

    def __neg__(self) -> Enclosure:
        return Enclosure(-self.p0, -self.p1, -self.p2, self.error)

    @property
    def reach(self) -> np.ndarray:
        """Bound on |f(c) - p0| over the cell."""
        return np.abs(self.p1) + np.abs(self.p2) + self.error


def variable(middle: np.ndarray, half: np.ndarray) -> Enclosure:
    """The position itself: c = middle + half t."""
    middle, half = np.broadcast_arrays(np.asarray(middle, float), np.asarray(half, float))
    zero = np.zeros_like(middle)
    return Enclosure(middle, half, zero, zero)


def constant(value: Any) -> Enclosure:
    """A number, the same over the whole cell; an enclosure stays what it is."""
    if isinstance(value, Enclosure):
        return value
    value = np.asarray(value, float)
    zero = np.zeros_like(value)
    return Enclosure(value, zero, zero, zero)


def _between(low: np.ndarray, high: np.ndarray) -> Enclosure:
    zero = np.zeros_like(low)
    return Enclosure(0.5 * (low + high), zero, zero, 0.5 * (high - low))


def _choose(condition: np.ndarray, one: Enclosure, other: Enclosure) -> Enclosure:
    return Enclosure(*(np.where(condition, getattr(one, n), getattr(other, n)) for n in ("p0", "p1", "p2", "error")))


def _add(x: Any, y: Any) -> Enclosure:
    x, y = constant(x), constant(y)
    return Enclosure(x.p0 + y.p0, x.p1 + y.p1, x.p2 + y.p2, x.error + y.error)


def _subtract(x: Any, y: Any) -> Enclosure:
    return _add(x, -constant(y))


def _multiply(x: Any, y: Any) -> Enclosure:
    if not isinstance(x, Enclosure):
        x, y = y, x
    if not isinstance(y, Enclosure):
        y = np.asarray(y, float)
        return Enclosure(x.p0 * y, x.p1 * y, x.p2 * y, x.error * np.abs(y))
    rest = np.abs(x.p1 * y.p2 + x.p2 * y.p1) + np.abs(x.p2 * y.p2)
    rest = rest + x.error * (np.abs(y.p0) + y.reach) + y.error * (np.abs(x.p0) + x.reach - x.error)
    return Enclosure(x.p0 * y.p0, x.p0 * y.p1 + x.p1 * y.p0, x.p0 * y.p2 + x.p1 * y.p1 + x.p2 * y.p0, rest)


def _compose(x: Enclosure, g0: np.ndarray, g1: np.ndarray, g2: np.ndarray, third: np.ndarray) -> Enclosure:
    """The function g of x by Taylor's theorem: g and two derivatives at p0, a bound on the third over the cell."""
    step = Enclosure(np.zeros_like(x.p0), x.p1, x.p2, x.error)
    taylor = _add(g0, _add(_multiply(step, g1), _multiply(_multiply(step, step), 0.5 * g2)))
    return Enclosure(taylor.p0, taylor.p1, taylor.p2, taylor.error + third * x.reach**3 / 6.0)


def _inverse(x: Enclosure) -> Enclosure:
    nearest = np.abs(x.p0) - x.reach
    third = np.where(nearest > 0.0, 6.0 / np.maximum(nearest, 1e-300) ** 4, np.inf)
    return _compose(x, 1.0 / x.p0, -1.0 / x.p0**2, 2.0 / x.p0**3, third)


def _divide(x: Any, y: Any) -> Enclosure:
    if not isinstance(y, Enclosure):
        return _multiply(x, 1.0 / np.asarray(y, float))
    return _multiply(x, _inverse(y))


def _sin(x: Enclosure) -> Enclosure:
    s, c = np.sin(x.p0), np.cos(x.p0)
    return _compose(x, s, c, -s, np.ones_like(s))


def _cos(x: Enclosure) -> Enclosure:
    s, c = np.sin(x.p0), np.cos(x.p0)
    return _compose(x, c, -s, -c, np.ones_like(s))


def _sqrt(x: Enclosure) -> Enclosure:
    least = x.p0 - x.reach
    third = np.where(least > 0.0, 0.375 / np.maximum(least, 1e-300) ** 2.5, np.inf)
    root = np.sqrt(x.p0)
    return _compose(x, root, 0.5 / root, -0.25 / (x.p0 * root), third)


def _arcsin(x: Enclosure) -> Enclosure:
    most = np.abs(x.p0) + x.reach
    room = 1.0 - most * most
    third = np.where(room > 0.0, (1.0 + 2.0 * most * most) / np.maximum(room, 1e-120) ** 2.5, np.inf)
    root = np.sqrt(1.0 - x.p0 * x.p0)
    return _compose(x, np.arcsin(x.p0), 1.0 / root, x.p0 / root**3, third)


def _arccos(x: Enclosure) -> Enclosure:
    return _subtract(0.5 * np.pi, _arcsin(x))


def _arctan2(y: Any, x: Any) -> Enclosure:
    """Angle of a vector: that of the cell's middle plus the arctangent of what is turned from there."""
    y, x = constant(y), constant(x)
    across, along = x.p0 * y - y.p0 * x, x.p0 * x + y.p0 * y
    ratio = _divide(across, along)
    third = np.where(along.p0 > along.reach, 2.0, np.inf)  # |arctan'''| <= 2
    g1 = 1.0 / (1.0 + ratio.p0**2)
    turned = _compose(ratio, np.arctan(ratio.p0), g1, -2.0 * ratio.p0 * g1 * g1, third)
    return _add(np.arctan2(y.p0, x.p0), turned)


def _hypot(x: Any, y: Any) -> Enclosure:
    x, y = constant(x), constant(y)
    return _sqrt(x * x + y * y)


def _sign(x: Enclosure) -> Enclosure:
    apart = np.abs(x.p0) > x.reach
    return _choose(apart, constant(np.sign(x.p0)), _between(-np.ones_like(x.p0), np.ones_like(x.p0)))


def _abs(x: Enclosure) -> Enclosure:
    apart = np.abs(x.p0) > x.reach
    folded = _between(np.zeros_like(x.p0), np.abs(x.p0) + x.reach)
    return _choose(apart, _multiply(x, np.sign(x.p0)), folded)


def _maximum(x: Any, y: Any) -> Enclosure:
    """The larger of two; over a cell where they cross, the interval between the bounds of both."""
    x, y = constant(x), constant(y)
    x_low, x_high, y_low, y_high = x.p0 - x.reach, x.p0 + x.reach, y.p0 - y.reach, y.p0 + y.reach
    crossed = _between(np.maximum(x_low, y_low), np.maximum(x_high, y_high))
    return _choose(x_low >= y_high, x, _choose(y_low >= x_high, y, crossed))


def _minimum(x: Any, y: Any) -> Enclosure:
    return -_maximum(-constant(x), -constant(y))


_RULES: dict[np.ufunc, Callable[..., Enclosure]] = {
    np.add: _add, np.subtract: _subtract, np.multiply: _multiply, np.true_divide: _divide, np.negative: lambda x: -x,
    np.sin: _sin, np.cos: _cos, np.sqrt: _sqrt, np.arcsin: _arcsin, np.arccos: _arccos, np.arctan2: _arctan2,
    np.hypot: _hypot, np.sign: _sign, np.abs: _abs, np.absolute: _abs, np.maximum: _maximum, np.minimum: _minimum,
}  # fmt: skip
