"""Motions against the double integrator they promise to be."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from leanboom.model.motion import from_positions, from_velocities, make

STEP = 0.05
VELOCITIES = arrays(np.float64, st.integers(2, 40), elements=st.floats(-0.4, 0.4))


@given(w=VELOCITIES)
def test_samples_are_the_exact_double_integrator(w):
    motion = from_velocities(STEP, 0.3, w, "test", "ls")
    c, w, u = motion.position, motion.velocity, motion.acceleration
    assert c[0] == 0.3
    assert c[1:] == pytest.approx(c[:-1] + STEP * w[:-1] + 0.5 * STEP**2 * u, abs=1e-14)
    assert w[1:] == pytest.approx(w[:-1] + STEP * u, abs=1e-15)


@given(w=VELOCITIES, share=st.floats(0.0, 1.0))
def test_between_stages_the_motion_is_integrated_exactly(w, share):
    """Also where the time falls on a stage: position and velocity have no jump there."""
    motion = from_velocities(STEP, 0.3, w, "test", "ls")
    t = share * STEP * (w.size - 1)
    times = np.arange(w.size) * STEP
    position, velocity, acceleration = motion.at(t)
    assert velocity == pytest.approx(np.interp(t, times, w), abs=1e-9)
    # The area under the straight pieces of velocity up to t.
    inner = np.append(times[times < t], t)
    area = np.trapezoid(np.interp(inner, times, w), inner)
    assert position == pytest.approx(0.3 + area, abs=1e-9)
    assert acceleration in motion.acceleration


@given(w=VELOCITIES)
def test_at_the_stages_the_samples_come_back(w):
    motion = from_velocities(STEP, 0.3, w, "test", "ls")
    position, velocity, acceleration = motion.at(STEP * np.arange(w.size))
    assert position == pytest.approx(motion.position, abs=1e-9)
    assert velocity == pytest.approx(motion.velocity, abs=1e-9)
    assert acceleration.tolist() == [*motion.acceleration, motion.acceleration[-1]]


def test_a_stage_begins_with_its_own_acceleration_despite_rounding():
    """0.15 / 0.05 is 2.9999999999999996, and still stage 3."""
    motion = make(0.05, np.zeros(6), np.zeros(6), np.arange(5.0), "test", "ls")
    times = np.array([0.0, 0.05, 0.15, 0.2, 0.25])
    assert int(0.15 / 0.05) == 2
    assert motion.at(times)[2].tolist() == [0.0, 1.0, 3.0, 4.0, 4.0]


def test_outside_the_ends_are_held():
    motion = from_velocities(0.5, 1.0, np.array([0.0, 0.2, 0.0]), "test", "ls")
    position, velocity, _ = motion.at(np.array([-1.0, 9.0]))
    assert position == pytest.approx([1.0, 1.1])
    assert velocity == pytest.approx([0.0, 0.0])


@given(w=VELOCITIES)
def test_a_motion_can_be_made_from_its_positions(w):
    w[0] = 0.0
    motion = from_velocities(STEP, 0.3, w, "test", "ls")
    again = from_positions(STEP, motion.position, "test", "ls")
    assert again.position == pytest.approx(motion.position, abs=1e-12)
    assert again.velocity == pytest.approx(motion.velocity, abs=1e-10)
    assert again.acceleration == pytest.approx(motion.acceleration, abs=1e-8)


def test_a_parabola_keeps_its_acceleration():
    t = STEP * np.arange(21)
    motion = from_positions(STEP, 0.2 + 0.15 * t**2, "test", "ls")
    assert motion.acceleration == pytest.approx(0.3, abs=1e-10)
    assert motion.velocity == pytest.approx(0.3 * t, abs=1e-11)


def test_motions_are_read_only_and_describe_themselves():
    motion = from_velocities(0.05, 0.25, np.array([0.0, 0.1, 0.0]), "dp", "cp", solve_s=1.5, log=("swept",))
    assert all(not array.flags.writeable for array in (motion.position, motion.velocity, motion.acceleration))
    assert repr(motion) == "Motion(dp minimising cp: 2 stages of 0.05 s, 0.2500 m -> 0.2550 m, solved)"
    assert (motion.solve_s, motion.log, motion.status) == (1.5, ("swept",), "solved")


def test_a_motion_taken_up_between_stages_has_a_shorter_first_interval():
    motion = make(0.1, [0.0, 0.03, 0.1303], [1.0, 1.006, 1.0], [0.2, -0.06], "test", "ls", lead=0.03)
    assert motion.duration == pytest.approx(0.13)
    position, velocity, acceleration = motion.at(np.array([0.0, 0.02, 0.03, 0.08, 0.13]))
    assert position == pytest.approx([0.0, 0.02004, 0.03, 0.03 + 0.0503 - 0.5 * 0.06 * 0.0025, 0.1303], abs=1e-12)
    assert velocity == pytest.approx([1.0, 1.004, 1.006, 1.003, 1.0])
    assert acceleration == pytest.approx([0.2, 0.2, -0.06, -0.06, -0.06])
