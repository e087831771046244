"""Sampled paths against finite differences, and the lengths, peaks and rests that are known of the bundled ones."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from bundled_texts import SINGLE
from leanboom.errors import InputError
from leanboom.io.loading import load_task
from leanboom.model.task import Braking, Lines, Moved, Part, Retimed, Spline, Task, sample, written

TASKS = {name: load_task(name) for name in SINGLE}
SHARE = st.floats(0.0, 1.0)


def at(task, *times):
    """Point, velocity and acceleration at times, (times, 3) each."""
    reference = sample(task, np.array(times))
    return reference.point, reference.velocity, reference.acceleration


def joints(task):
    """Times at which a path changes its formula, ends included."""
    path = task.path
    return np.array(path.times) if isinstance(path, Spline) else np.concatenate([[0.0], np.cumsum(path.durations)])


@pytest.mark.parametrize("name", TASKS)
@given(share=st.floats(0.001, 0.999), segment=st.integers(0, 2))
def test_velocity_and_acceleration_are_derivatives(name, share, segment):
    """Inside each segment, where the formulas are smooth."""
    times = joints(TASKS[name])
    segment = min(segment, times.size - 2)
    h = 1e-4
    t = times[segment] + h + share * (times[segment + 1] - times[segment] - 2.0 * h)
    point, velocity, acceleration = at(TASKS[name], t - h, t, t + h)
    assert velocity[1] == pytest.approx((point[2] - point[0]) / (2.0 * h), abs=2e-8)
    assert acceleration[1] == pytest.approx((velocity[2] - velocity[0]) / (2.0 * h), abs=2e-8)


@pytest.mark.parametrize(
    ("name", "length", "peak"),
    [
        ("forwarder-horizontal", 3.20, 0.600),
        ("forwarder-vertical", 3.04, 0.950),
        ("forwarder-half-cycle", 7.02, 0.750),
        ("loader-triangle-large", 2.950 + 1.500 + 2.540, 0.553),
        ("loader-triangle-medium", (2.950 + 1.500 + 2.540) * 2 / 3, 0.553 * 2 / 3),
        ("loader-triangle-small", (2.950 + 1.500 + 2.540) / 3, 0.553 / 3),
    ],
)
def test_lengths_and_peak_speeds_worked_out_elsewhere(name, length, peak):
    task = TASKS[name]

    def speed(t):
        return float(np.linalg.norm(at(task, t)[1]))

    times = joints(task)
    found = sum(quad(speed, a, b, limit=200)[0] for a, b in zip(times[:-1], times[1:], strict=True))
    assert found == pytest.approx(length, abs=1e-3 if "loader" in name else 6e-3)
    speeds = np.linalg.norm(at(task, *np.linspace(0.0, task.duration, 30001))[1], axis=1)
    assert speeds.max() == pytest.approx(peak, abs=6e-4)


@pytest.mark.parametrize(("edge", "length", "peak"), [(0, 2.950, 0.553), (1, 1.500, 0.281), (2, 2.540, 0.476)])
def test_edges_of_the_large_triangle(edge, length, peak):
    """Each edge takes 10 s; the quintic's fastest moment is halfway, at 1.875 D / T."""
    task = TASKS["loader-triangle-large"]
    points, velocities, _ = at(task, 10.0 * edge, 10.0 * edge + 5.0, 10.0 * edge + 10.0)
    assert np.linalg.norm(points[2] - points[0]) == pytest.approx(length, abs=6e-4)
    assert np.linalg.norm(velocities[1]) == pytest.approx(peak, abs=6e-4)
    assert np.linalg.norm(velocities[1]) == pytest.approx(1.875 * np.linalg.norm(points[2] - points[0]) / 10.0)
    assert points[1] == pytest.approx(0.5 * (points[0] + points[2]))


@pytest.mark.parametrize("name", TASKS)
def test_paths_pass_their_points_and_end_at_rest(name):
    task = TASKS[name]
    points, velocities, _ = at(task, *joints(task))
    assert points == pytest.approx(np.array(task.path.points), abs=1e-12)
    assert velocities[[0, -1]] == pytest.approx(np.zeros((2, 3)), abs=1e-12)


@pytest.mark.parametrize("name", [name for name in TASKS if isinstance(TASKS[name].path, Lines)])
def test_lines_rest_at_every_corner(name):
    """Velocity and acceleration vanish there, on either side."""
    corners = joints(TASKS[name])
    _, velocities, accelerations = at(TASKS[name], *corners, *(corners - 1e-7), *(corners + 1e-7))
    assert np.abs(velocities).max() < 1e-12
    assert np.abs(accelerations).max() < 1e-6


def test_half_cycle_ends_with_the_accelerations_of_a_clamped_spline():
    """0.22 and 0.32 m/s^2: a clamped cubic cannot have zero."""
    _, _, acceleration = at(TASKS["forwarder-half-cycle"], 0.0, 15.0)
    assert np.linalg.norm(acceleration, axis=1) == pytest.approx((0.22, 0.32), abs=6e-3)


def test_spline_is_twice_smooth_and_cubic_between_its_points():
    task = TASKS["forwarder-half-cycle"]
    for knot in task.path.times[1:-1]:
        _, velocity, acceleration = at(task, knot - 1e-9, knot + 1e-9)
        assert velocity[0] == pytest.approx(velocity[1], abs=1e-8)
        assert acceleration[0] == pytest.approx(acceleration[1], abs=1e-8)
        # A cubic's acceleration is a straight line.
    _, _, acceleration = at(task, 4.2, 6.0, 7.8)
    assert acceleration[1] == pytest.approx(0.5 * (acceleration[0] + acceleration[2]), abs=1e-12)


@given(start=st.tuples(*[st.floats(-5.0, 5.0)] * 3), end=st.tuples(*[st.floats(-5.0, 5.0)] * 3), T=st.floats(0.5, 60.0))
def test_a_line_is_straight_and_monotone(start, end, T):
    task = Task("line", TASKS["forwarder-horizontal"].machine, Lines((start, end), (T,)))
    points, velocities, _ = at(task, *np.linspace(0.0, T, 50))
    along = np.subtract(end, start)
    share = (points - start) @ along
    assert np.abs(np.cross(points - start, along)).max() < 1e-9
    assert np.diff(share).min() >= -1e-9
    assert (velocities @ along).min() >= 0.0


def test_times_outside_are_held_at_the_ends():
    task = TASKS["loader-triangle-large"]
    reference = sample(task, np.array([-3.0, 31.0]))
    assert reference.point == pytest.approx(np.array([task.path.points[0], task.path.points[-1]]), abs=1e-12)
    assert reference.velocity == pytest.approx(np.zeros((2, 3)), abs=1e-12)
    assert reference.time.tolist() == [-3.0, 31.0]


def test_references_are_read_only():
    reference = sample(TASKS["forwarder-vertical"], np.linspace(0.0, 6.0, 5))
    for name in ("time", "point", "velocity", "acceleration"):
        array = getattr(reference, name)
        assert not array.flags.writeable
        assert array.dtype == np.float64


# Paths made of others

HALF = TASKS["forwarder-half-cycle"].path
MADE = {
    "part": Part(HALF, 2.0, 9.5),
    "moved": Moved(HALF, (0.3, -0.2, 0.1), 4.0, 3.0),
    "braking": Braking(HALF, 5.0, 1.5),
    "retimed": Retimed(HALF, (1.0, 1.7, 0.6, 0.0, 0.0, 1.2, 1.0)),
    "braking of a moved part": Braking(Part(Moved(HALF, (0.3, -0.2, 0.1), 4.0, 3.0), 3.0, 12.0), 2.0, 1.5),
}


@pytest.mark.parametrize("path", MADE.values(), ids=MADE)
def test_made_paths_are_smooth(path):
    """Velocity and acceleration are derivatives everywhere, also where the path begins to change."""
    h, time = 1e-4, np.linspace(2e-4, path.duration - 2e-4, 301)
    (before, v0, _), (_, velocity, acceleration), (after, v1, _) = (path.values(time + d) for d in (-h, 0.0, h))
    kept = np.ones(time.size, dtype=bool)
    if isinstance(path, Retimed):  # its acceleration jumps where its rates have corners
        kept = np.abs(time[:, None] - path.nodes).min(axis=1) > h
    np.testing.assert_allclose(velocity[kept], ((after - before) / (2.0 * h))[kept], atol=2e-7)
    # The spline's third derivative jumps.
    np.testing.assert_allclose(acceleration[kept], ((v1 - v0) / (2.0 * h))[kept], atol=2e-3)


def test_made_paths_agree_with_the_paths_they_are_made_of():
    time = np.linspace(0.0, 15.0, 61)
    point, velocity, _ = HALF.values(time)
    moved = MADE["moved"].values(time)
    np.testing.assert_array_equal(moved[0][time <= 4.0], point[time <= 4.0])
    np.testing.assert_allclose(moved[0][time >= 7.0], point[time >= 7.0] + [0.3, -0.2, 0.1], atol=1e-12)
    part = Part(HALF, 2.0, 9.5)
    assert part.duration == 7.5
    np.testing.assert_array_equal(part.values(time[:31])[0], HALF.values(time[:31] + 2.0)[0])
    begins, stands = Braking(HALF, 5.0, 1.5).values(np.array([0.0, 1.5]))[:2]
    np.testing.assert_allclose(begins, HALF.values(np.array([5.0, 5.75]))[0], atol=1e-12)
    np.testing.assert_allclose(stands, [HALF.values(np.array([5.0]))[1][0], np.zeros(3)], atol=1e-12)


@pytest.mark.parametrize("path", [HALF, TASKS["loader-triangle-large"].path, *MADE.values()])
def test_slower_paths_pass_the_same_points(path):
    slow, time = path.slower(2.0), np.linspace(0.0, path.duration, 41)
    assert slow.duration == pytest.approx(2.0 * path.duration)
    for power, (ours, theirs) in enumerate(zip(slow.values(2.0 * time), path.values(time), strict=True)):
        np.testing.assert_allclose(ours, theirs / 2.0**power, atol=1e-9)


def test_a_retimed_path_passes_its_points_when_it_says():
    """Corners and via points among them; and with rates of 1 a spline is itself."""
    for shape in (HALF, TASKS["loader-triangle-large"].path):
        path = Retimed(shape, (0.5, 1.5, 2.0, 0.0, 0.0, 1.0, 0.2, 1.0))
        times = path.when(shape.breaks)
        np.testing.assert_allclose(path.values(times)[0], shape.points, atol=1e-12)
        np.testing.assert_allclose(path.own(times)[0], shape.breaks, atol=1e-12)
        assert path.duration == pytest.approx(shape.duration / np.mean([1.0, 1.75, 1.0, 0.0, 0.5, 0.6, 0.6]))
        assert times[-1] == pytest.approx(path.duration) and set(path.nodes) <= set(path.breaks)
        again = Retimed(shape, (2.0, 2.0))
        time = np.linspace(0.0, again.duration, 41)
        if shape is HALF:
            np.testing.assert_allclose(again.values(time)[1], 2.0 * shape.values(2.0 * time)[1], atol=1e-12)
    corner = Retimed(TASKS["loader-triangle-large"].path, (1.0, 2.0, 0.5)).when(np.array([10.0]))
    np.testing.assert_allclose(
        Retimed(TASKS["loader-triangle-large"].path, (1.0, 2.0, 0.5)).values(corner)[1], 0.0, atol=1e-12
    )


def test_made_paths_are_no_files():
    task = Task("made", TASKS["forwarder-half-cycle"].machine, MADE["moved"])
    with pytest.raises(InputError, match="the path of task made is a moved path; files and tables hold lines and"):
        written(task)


def test_a_task_and_its_machine_print_in_a_line():
    """They once printed every value of the machine with its origin: four screens."""
    task = load_task("forwarder-vertical", start="0.45 m")
    assert repr(task) == (
        "Task(forwarder-vertical: forwarder, lines through 2 points in 6 s, payload 0 kg, start 0.45 m)"
    )
    assert repr(task.machine).startswith("Machine(forwarder: joints base, lift, tilt, extension; ")
    assert repr(task.machine).endswith("; pump 325 l/min, 21.5 MPa)")
