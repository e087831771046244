"""Path accuracy by ISO 9283 on paths whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from leanboom.simulation.path_accuracy import path_accuracy

TIME = np.linspace(0.0, 10.0, 5001)


def straight(time):
    """3 m along x and up, from rest to rest."""
    s = np.clip(time / 8.0, 0.0, 1.0)
    s = s**3 * (10 - 15 * s + 6 * s**2)
    return np.stack([2.4 * s, 0.0 * s, 1.8 * s], axis=1)


def circle(time):
    """A radius of 2 m, held for a second at its end."""
    angle = 0.6 * np.minimum(time, 9.0)
    return np.stack([2.0 * np.cos(angle), 2.0 * np.sin(angle), 0.0 * angle], axis=1)


def test_a_tool_that_is_late_but_on_its_path_is_accurate():
    path = straight(TIME)
    assert path_accuracy(TIME, path, straight(TIME - 0.4)) < 1e-9


def test_a_tool_beside_its_path_is_off_by_that_distance_however_late():
    path = straight(TIME)
    beside = straight(TIME - 0.3) + 0.05 * np.array([-0.6, 0.0, 0.8]) + [0.0, 0.02, 0.0]
    assert path_accuracy(TIME, path, beside) == pytest.approx(np.hypot(0.05, 0.02), rel=1e-3)


def test_a_wider_circle_is_off_by_the_difference_of_the_radii():
    path = circle(TIME)
    assert path_accuracy(TIME, path, 1.03 * circle(TIME - 0.1)) == pytest.approx(0.06, rel=1e-3)


def test_only_the_worst_point_counts():
    path = straight(TIME)
    bumped = path + 0.07 * np.exp(-(((TIME - 4.0) / 0.3) ** 2))[:, None] * [0.0, 1.0, 0.0]
    assert path_accuracy(TIME, path, bumped) == pytest.approx(0.07, rel=0.01)


def test_a_tool_that_stays_behind_is_off_by_what_is_missing():
    path = straight(TIME)
    assert path_accuracy(TIME, path, np.minimum(path, 0.9 * path[-1])) == pytest.approx(0.3, rel=0.02)


def test_a_tool_at_rest_has_no_path_to_leave():
    path = np.ones((TIME.size, 3))
    assert path_accuracy(TIME, path, path + 0.1) == 0.0
