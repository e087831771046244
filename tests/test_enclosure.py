"""Enclosures contain what they enclose, and get close with the third power of the cell."""

import numpy as np
import pytest

from leanboom import load_task
from leanboom.certificate import taylor_model
from leanboom.certificate.taylor_model import Enclosure
from leanboom.model import crane as cranes
from leanboom.problem import stages

FUNCTIONS = {
    "sum and product": lambda x: (1.5 - x) * x + 2.0 * x - x / 3.0,
    "quotient": lambda x: (1.0 + x) / (2.0 + x * x) + 1.0 / (3.0 + x),
    "sine and cosine": lambda x: np.sin(2.0 * x) * np.cos(x) - np.sin(x),
    "root": lambda x: np.sqrt(2.0 + x * x) + np.hypot(x, 1.0),
    "angles": lambda x: np.arcsin(0.4 * x) + np.arccos(0.3 * x) - np.arctan2(x, 1.0 + x) + np.arctan2(-1.0, x),
    "kinks": lambda x: np.abs(x) + np.maximum(x, 0.1) - np.minimum(0.2, x) + np.sign(x - 0.05) * (x - 0.05),
}


def inside(enclosed: Enclosure, t: float, value: np.ndarray) -> np.ndarray:
    """How far a value at t is from the bounds of an enclosure; never above 0."""
    off = np.abs(value - (enclosed.p0 + t * (enclosed.p1 + t * enclosed.p2)))
    return off - enclosed.error - 1e-14 * (1.0 + np.abs(value))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_contains_the_function_everywhere_in_the_cell(name, rng):
    function = FUNCTIONS[name]
    middle, half = rng.uniform(-1.0, 1.0, 200), rng.uniform(0.0, 0.3, 200)
    enclosed = function(taylor_model.variable(middle, half))
    for t in np.linspace(-1.0, 1.0, 21):
        assert inside(enclosed, t, function(middle + half * t)).max() <= 0.0


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if name != "kinks"])
def test_error_falls_with_the_third_power(name):
    middle = np.linspace(-0.9, 0.9, 7)
    coarse, fine = (FUNCTIONS[name](taylor_model.variable(middle, half)).error for half in (2e-2, 1e-2))
    assert np.all(fine <= coarse / 6.0)


def test_what_cannot_be_bounded_has_no_finite_error():
    with np.errstate(all="ignore"):
        through_zero = 1.0 / taylor_model.variable(np.array([0.05]), np.array([0.1]))
    assert not np.isfinite(through_zero.error).any()


@pytest.mark.parametrize("name", ["forwarder-vertical", "loader-triangle-small"])
def test_contains_the_motion_of_all_cylinders(name, rng):
    problem = stages.discretise(load_task(name), 0.5)
    half = (0.5 * (problem.upper - problem.lower) / 256)[:, None]
    middle = problem.lower[:, None] + half * (2 * np.arange(1, 256, 17) + 1)
    plane = problem.plane[:, None]

    def moving(position):
        return cranes.move(cranes.pose(problem.crane, plane, position), 0.2, -0.3)

    enclosed = moving(taylor_model.variable(middle, half))
    for t in (-1.0, *rng.uniform(-1.0, 1.0, 3), 1.0):
        exact = moving(middle + half * t)
        for quantity in ("velocity", "acceleration", "load"):
            for one, other in zip(getattr(enclosed, quantity), getattr(exact, quantity), strict=True):
                if isinstance(one, Enclosure):
                    room = one.error + taylor_model.ROUNDING * np.abs(one.p0)
                    assert np.all(np.abs(other - (one.p0 + t * (one.p1 + t * one.p2))) <= room)
