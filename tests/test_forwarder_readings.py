"""The 4-DOF paper's crane read otherwise: pins that fit its cylinders, paths as printed, statements as ranges."""

from __future__ import annotations

import numpy as np
import pytest

import leanboom as lb
from leanboom.errors import InfeasibleError
from leanboom.study.papers import forwarder, statements
from leanboom.study.papers.forwarder import PINS, HalfCycle


@pytest.fixture(scope="module")
def machine():
    return lb.load_machine("forwarder")


def lengths(machine, name, nodes=101):
    """Cylinder lengths over the joint's printed range [m]."""
    index = machine.names.index(name)
    joint = machine.joints[index]
    return machine.cylinders[index].linkage.length_arm_slope(np.linspace(joint.lower, joint.upper, nodes))


@pytest.mark.parametrize("reading", ["dead lengths", "public"])
def test_pins_of_a_public_model_fit_its_cylinders_over_the_printed_ranges(machine, reading):
    """Retracted 0.920 and 1.068 m, strokes 0.610 and 0.725 m; arms keep their sign."""
    other = forwarder.pinned(machine, reading)
    for name, retracted, stroke in (("lift", 0.920, 0.610), ("tilt", 1.068, 0.725)):
        length, arm, _ = lengths(other, name)
        assert retracted - 1e-5 <= length.min() and length.max() <= retracted + stroke + 1e-5
        assert np.all(arm > 0.1) if name == "lift" else np.all(arm < -0.1)
        if reading == "dead lengths":  # the whole stroke over the whole range, as the bundled pins
            assert np.ptp(length) == pytest.approx(stroke, abs=1e-5)
    assert forwarder.pinned(machine, "assumed") == machine


def test_public_pins_are_those_of_the_models_coordinates(machine):
    """The distances between its points; the boom's angles count from the line between its joints."""
    lift, tilt = PINS["public"]
    joint, pillar = np.array([-0.18, 1.274]), np.array([0.19, 0.14])
    outer, lever, barrel = np.array([3.59, 0.282]), np.array([3.430, 0.295]), np.array([2.028, 0.55])
    assert lift.long == pytest.approx(np.hypot(*(pillar - joint)), abs=1e-6)
    assert lift.short == pytest.approx(np.hypot(0.401, -0.016), abs=1e-6)
    assert tilt.L21 == pytest.approx(np.hypot(*(barrel - lever)), abs=1e-6)
    assert tilt.L22 == pytest.approx(np.hypot(*(lever - outer)), abs=1e-6)
    assert (tilt.L23, tilt.L24, tilt.L25) == (0.24, 0.452, 0.43)


def test_masses_of_the_public_model_leave_grapple_and_inertia_per_mass(machine):
    other = {body.name: body for body in forwarder.bodied(machine).bodies}
    for body in machine.bodies:
        assert other[body.name].inertia * body.mass == pytest.approx(body.inertia * other[body.name].mass)
    assert other["lift_boom"].mass == 500.0 and other["grapple"].mass == 230.0


def test_friction_as_a_share_is_that_of_the_highest_pressure(machine):
    base, lift, tilt, extension = forwarder.rubbing(machine, 0.10, 5.5e3).cylinders
    assert lift.friction.coulomb == pytest.approx(0.1 * 21.5e6 * np.pi / 4 * 0.120**2)
    assert tilt.friction.coulomb == base.friction.coulomb == pytest.approx(0.1 * 21.5e6 * np.pi / 4 * 0.115**2)
    assert extension.friction.coulomb == 5.5e3
    assert extension.friction.steps == machine.cylinders[-1].friction.steps


def test_a_half_cycle_elsewhere_has_the_printed_peak_speed():
    bundled = lb.load_task("forwarder-half-cycle").path
    assert np.abs(np.array(HalfCycle().path().points) - np.array(bundled.points)).max() < 0.01
    time = np.linspace(0.0, 15.0, 1501)
    for place in (HalfCycle(), HalfCycle(4.6, 2.4, 3.1, 5.0, 0.4)):
        speed = np.linalg.norm(place.path().values(time)[1], axis=1)
        assert speed.max() == pytest.approx(0.75, abs=1e-3) and max(speed[0], speed[-1]) < 1e-9
    with pytest.raises(InfeasibleError, match="peak speed"):
        HalfCycle(end_radius=14.0).path()


def test_explaining_tasks_have_what_is_printed_of_the_paths():
    for path, duration, peak in (("horizontal", 10.0, 0.60), ("vertical", 6.0, 0.95), ("half-cycle", 15.0, 0.75)):
        task = forwarder.explaining(lb.load_task(f"forwarder-{path}"), path)
        time = np.linspace(0.0, task.path.duration, 2001)
        speed = np.linalg.norm(task.path.values(time)[1], axis=1)
        assert task.path.duration == duration and speed.max() == pytest.approx(peak, abs=2e-3)
        assert task.machine.cylinders[1].linkage == PINS["public"][0]


def test_a_statement_holds_where_all_its_ratios_are_in_its_range():
    """Energies as the paper tells them of the horizontal path, and one number off."""
    told = {
        "DP (LS)": (1.0, 1.3), "DP (CP)": (1.05, 1.25), "DP (A. En.)": (1.02, 1.3), "DP (ext.)": (1.3, 1.7),
        "P-inv. (j.)": (1.25, 1.6), "P-inv. (a.)": (1.26, 1.65),
    }  # fmt: skip
    horizontal = statements.of("horizontal")
    assert len(horizontal) == 6 and not any(statement.missing(told) for statement in horizontal)
    first = horizontal[0]
    assert first.span == "1.20 to 1.30" and first.decisive(told) == 1.26
    off = told | {"P-inv. (a.)": (1.43, 1.65)}
    assert first.missing(off) == pytest.approx(np.log(1.1)) and first.decisive(off) == 1.43
    poor = next(one for one in horizontal if "poor" in one.text)
    assert poor.span == "at least 1.15" and poor.missing(told | {"DP (ext.)": (1.0, 1.7)}) == pytest.approx(
        np.log(1.15)
    )
    similar = statements.of("half-cycle")[0]
    assert similar.span == "at most 1.20" and similar.decisive(told) == 1.3  # not the best's own ratio, 1
