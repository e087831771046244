"""Between the judge's samples: jumps, passes beside the slewing axis; and motions that contradict themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from leanboom import resources
from leanboom.components.paths import Braking, Lines, Moved, Part, Retimed, Spline, approaches
from leanboom.dynamic_programming import grids, value_function
from leanboom.errors import InfeasibleError, InputError
from leanboom.evaluation import limit_checks
from leanboom.evaluation.evaluate import SAMPLE, check_measurable, evaluate
from leanboom.io.loading import load_task
from leanboom.model.motion import Motion, from_velocities, make
from leanboom.planning.planner import run
from leanboom.problem import feasible_strokes, stages
from leanboom.report import facts
from leanboom.study.comparison import compare
from leanboom.study.papers.variations import cornered

VERTICAL = load_task("forwarder-vertical")
HIGH, LOW, ASIDE = (5.5, 0.0, 4.0), (5.5, 0.0, 2.0), (0.0, 5.5, 4.0)


def still(task, stroke=0.7, step=0.05):
    """The motion that holds the redundant cylinder."""
    count = max(2, round(task.duration / step))
    return from_velocities(task.duration / count, stroke, np.zeros(count + 1), "still", "ls")


def lines(points, durations):
    return replace(VERTICAL, path=Lines(tuple(points), tuple(durations)))


@pytest.mark.parametrize("lasts", [1e-4, 5e-4, 1e-3, 2e-3, 3.7e-3])
@pytest.mark.parametrize("end", [LOW, ASIDE])
@pytest.mark.parametrize("before", [3.0, 3.0005])
def test_a_jump_of_the_tool_is_not_solved_however_short(lasts, end, before):
    """Two metres, or a quarter turn of the base, between two rests; the judge's samples are 2 ms apart."""
    task = lines([HIGH, HIGH, end, end], [before, lasts, 3.0])
    judged = evaluate(task, still(task))
    assert not judged.feasible
    assert judged.limit_use.velocity > 100.0
    assert any(sentence.startswith("velocity of ") for sentence in judged.violations)


@pytest.mark.parametrize("lasts", [1e-4, 2e-3])
def test_a_jump_between_two_moves_is_not_solved(lasts):
    third = (5.5, 0.0, 3.5), (5.5, 0.0, 2.5)
    task = lines([HIGH, *third, LOW], [6.0, lasts, 6.0])
    assert evaluate(task, still(task)).limit_use.velocity > 100.0
    assert evaluate(lines([HIGH, third[0]], [6.0]), still(lines([HIGH, third[0]], [6.0]))).feasible


def test_a_target_that_jumps_aside_is_not_solved():
    rest = Lines((HIGH, HIGH), (6.0,))
    for path in (Moved(rest, (0.0, 0.0, -1.0), 3.0, 1e-3), Part(Moved(rest, (0.0, 0.0, -1.0), 3.0, 1e-3), 1.0, 5.0)):
        task = replace(VERTICAL, path=path)
        assert evaluate(task, still(task)).limit_use.velocity > 100.0


def test_accelerations_of_stages_between_samples_count():
    """Four stages a sample, at rest at all samples, pushed back and forth in between."""
    task = lines([HIGH, HIGH], [0.4])
    speed = np.tile([0.0, 0.01, 0.0, -0.01], 200)
    judged = evaluate(task, from_velocities(5e-4, 0.7, np.append(speed, 0.0), "shaken", "ls"))
    assert np.abs(judged.velocity).max() < 1e-9
    assert judged.limit_use.acceleration > 10.0 and not judged.feasible


def test_accelerations_at_the_end_of_a_stage_count():
    """One long stage that ends between two samples: its largest velocity is just there."""
    task = lines([HIGH, HIGH], [2.0])
    motion = from_velocities(0.6667, 0.5, [0.0, 0.2, 0.2, 0.0], "ramp", "ls")
    task = replace(task, path=Lines((HIGH, HIGH), (motion.duration,)))
    cylinder = task.machine.redundant
    judged = evaluate(task, motion)
    assert judged.limit_use.velocity >= 0.2 / cylinder.velocity_limit * (1.0 - 1e-6)


def test_every_segment_is_looked_at_and_all_samples_are_kept():
    samples = np.linspace(0.0, 4.0021, 2002)
    path = Lines((HIGH, LOW, HIGH, LOW), (2.0, 2.1e-3, 2.0))
    times = limit_checks.times(path, samples, from_velocities(4.0021 / 40, 0.7, np.zeros(41), "still", "ls"))
    assert np.isin(samples, times).all() and np.all(np.diff(times) > 0.0)
    for first, last in zip(path.breaks, path.breaks[1:], strict=False):
        inside = times[(times >= first) & (times < last)]
        assert inside.size >= limit_checks.LOOKS
        assert inside[0] - first < 3e-7 and last - inside[-1] < 3e-7


# Beside the slewing axis


@pytest.mark.parametrize("points", [[(0.5, 0.0, -2.0), (-0.4, 0.0, -2.0)], [(0.31, 0.2, -2.0), (-0.62, -0.4, -2.0)]])
def test_a_path_through_the_slewing_axis_is_refused_by_all(points):
    """Its samples pass it by: no one of them is within a micrometre."""
    task = lines(points, [8.0])
    for use in (lambda: evaluate(task, still(task)), lambda: run(task), lambda: facts.path(task)):
        with pytest.raises(InputError, match=r"passes through the slewing axis at [34]\.\d{3} s"):
            use()


def test_a_spline_through_the_slewing_axis_is_refused():
    spline = Spline(((0.5, 0.3, -2.0), (0.0, 0.0, -2.0), (-0.5, 0.2, -2.0)), (0.0, 4.0003, 8.0))
    task = replace(VERTICAL, path=spline)
    with pytest.raises(InputError, match=r"axis at 4\.000 s"):
        evaluate(task, still(task))


@pytest.mark.parametrize("aside", [1e-5, 1e-4, 1e-3])
def test_a_pass_close_to_the_slewing_axis_is_governed_by_the_base(aside):
    """Half a turn between two samples: the rate at the nearest point is what counts."""
    task = lines([(0.5, aside, -2.0), (-0.4, aside, -2.0)], [8.0])
    judged = evaluate(task, still(task, 0.9))
    times, distances = approaches(task.path)
    nearest = times[distances.argmin()]
    assert distances.min() == pytest.approx(aside, rel=1e-6)
    rate = np.linalg.norm(task.path.values(np.array([nearest]))[1]) / aside
    arm, limit = task.machine.cylinders[0].linkage.arm, task.machine.cylinders[0].velocity_limit
    assert judged.limit_use.velocity >= 0.999 * rate * arm / limit
    assert any(sentence.startswith("velocity of base is ") for sentence in judged.violations)


@pytest.mark.parametrize("seed", range(12))
def test_the_nearest_points_of_paths_are_found(seed):
    """Against two hundred thousand samples, for every kind of path."""
    rng = np.random.default_rng(seed)
    points = tuple(tuple(point) for point in rng.uniform(-0.07, 0.07, (5, 3)))
    base = Lines(points, (1.0, 0.4, 2.0, 0.6)) if seed % 2 else Spline(points, (0.0, 1.0, 1.4, 3.4, 4.0))
    made = (base, Part(base, 0.5, 3.7), Moved(base, (0.02, -0.03, 0.0), 0.7, 1.1), Braking(base, 0.3, 2.5))
    made = (*made, Retimed(base, tuple(rng.uniform(0.0, 2.0, 9))))
    for path in (*made, Braking(Part(made[2], 0.2, 3.9), 0.1, 3.0)):
        dense = path.values(np.linspace(0.0, path.duration, 200001))[0]
        times, distances = approaches(path)
        found = path.values(times)[0]
        np.testing.assert_allclose(np.hypot(found[:, 0], found[:, 1]), distances, atol=1e-9)
        least = np.hypot(dense[:, 0], dense[:, 1]).min()
        assert least - 1e-4 < distances.min() <= least + 1e-12


# Positions, velocities and accelerations that do not belong together


def moving(task):
    """A motion within all limits: arrays of its positions, velocities, accelerations."""
    motion = from_velocities(0.05, 0.6, 0.02 * np.sin(np.linspace(0.0, np.pi, 121)) ** 2, "moving", "cp")
    return motion.position.copy(), motion.velocity.copy(), motion.acceleration.copy()


def test_a_position_that_jumps_contradicts_the_velocities():
    c, w, u = moving(VERTICAL)
    assert evaluate(VERTICAL, make(0.05, c, w, u, "x", "cp")).feasible
    c[60:] += 2e-5
    judged = evaluate(VERTICAL, make(0.05, c, w, u, "x", "cp"))
    assert not judged.feasible
    assert judged.status.startswith("the motion of ") and "contradicts itself: from 3.000 s on" in judged.status


def test_velocities_that_are_not_those_of_the_positions_contradict_them():
    c, w, u = moving(VERTICAL)
    judged = evaluate(VERTICAL, make(0.05, c, 0.0 * w, 0.0 * u, "x", "cp"))
    assert not judged.feasible and "length of its cylinder changes by" in judged.status


def test_accelerations_that_are_not_those_of_the_velocities_contradict_them():
    """The positions keep to the velocities, within a micrometre a stage."""
    c, w, _ = moving(VERTICAL)
    w[60] += 2e-4
    u = np.diff(w) / 0.05
    u[59:61] = 0.0
    judged = evaluate(VERTICAL, make(0.05, c, w, u, "x", "cp"))
    assert not judged.feasible and "contradicts itself" in judged.status


@pytest.mark.parametrize("smooth", [None, 0.01, 5.0, 50.0, 240.0])
def test_motions_within_limits_keep_far_from_contradicting_themselves(smooth, monkeypatch):
    """A fiftieth of what is allowed would do, filtered a fifth."""
    share = 0.02 if smooth is None else 0.2
    monkeypatch.setattr(limit_checks, "SHARES", tuple(share * value for value in limit_checks.SHARES))
    far = cornered(load_task("loader-triangle-small"), (2.6, 0.5), (3.2, 1.1667))  # with room for the extension
    for whole, start, halves in ((load_task("forwarder-vertical"), 0.7, 2), (far, 0.6, 6)):
        task = replace(whole, smooth=smooth)
        speed = 0.05 * np.sin(np.pi * halves * np.linspace(0.0, 1.0, round(task.duration / 0.05) + 1))  # ends at rest
        judged = evaluate(task, from_velocities(0.05, start, speed, "x", "cp"))
        assert judged.feasible, judged.status


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_motion_with_a_number_that_is_none_is_refused(bad):
    _, w, _ = moving(VERTICAL)
    w[60] = bad
    with pytest.raises(InputError, match=r"motion.velocity = -?(nan|inf) at stage 60; must be finite"):
        from_velocities(0.05, 0.6, w, "x", "cp")


# Before planning


def test_check_says_that_a_jump_is_too_fast_for_the_cylinders():
    task = lines([HIGH, HIGH, LOW, LOW], [3.0, 2e-3, 3.0])
    with pytest.raises(InfeasibleError, match=r"too fast for the cylinders at 3\.00\d s, where the tool moves at 1\.8"):
        facts.path(task)
    quarter = lines([(0.5, 4.0, 2.0), (0.5, 4.0, 2.0), (4.0, 0.5, 2.0), (4.0, 0.5, 2.0)], [3.0, 2e-3, 3.0])
    with pytest.raises(InfeasibleError, match="too fast for the cylinders"):
        facts.path(quarter)
    assert facts.path(VERTICAL).fastest == pytest.approx(0.95, abs=1e-3)


def test_haste_is_what_the_best_motion_of_the_extension_needs():
    """Against all velocities of the extension on a fine grid, at the poses that are looked at."""
    from leanboom.model import crane as cranes
    from leanboom.model.task import sample

    time = np.linspace(0.5, 5.5, 9)
    crane = cranes.build(VERTICAL)
    plane = cranes.plane(VERTICAL.machine, sample(VERTICAL, time))
    ends = feasible_strokes.feasible_strokes(VERTICAL, crane, plane, time)
    low, high = (np.array([each.ravel()[i] for each in ends]) for i in (0, -1))
    found = facts.least_haste(crane, plane, low, high)
    strokes = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, 33)
    pose = cranes.pose(crane, plane[:, None, None], strokes[:, :, None])
    w = np.linspace(-0.6, 0.6, 2401)
    shares = [
        np.abs(v) / cylinder.velocity_limit
        for v, cylinder in zip(cranes.move(pose, w, 0.0).velocity, crane.machine.cylinders, strict=True)
    ]
    best = np.max(np.broadcast_arrays(*shares), axis=0).min(axis=(1, 2))
    np.testing.assert_allclose(found, best, atol=4e-3)


def test_memory_of_the_samples_is_checked_before_planning(monkeypatch):
    """Five hours at 2 ms: refused as input, not killed halfway."""
    monkeypatch.setattr(resources, "free_memory", lambda: 8.0 * 2**30)
    long = lines([HIGH, LOW] * 3, [3600.0] * 5)
    expected = r"measuring task forwarder-vertical at 9000001 samples, 2 ms apart over 18000 s, needs .* GiB, 8.0 GiB"
    with pytest.raises(InputError, match=expected):
        run(long, pump="cp")
    with pytest.raises(InputError, match=expected):
        evaluate(long, still(long, step=1.0))
    monkeypatch.setattr(resources, "free_memory", lambda: 22.0 * 2**30)  # enough to judge one motion, not to plan
    with pytest.raises(InputError, match=expected.replace("8.0", "22.0")):
        compare(long, methods=["sns-actuator"])  # looked for the start at 360,000 stages first
    check_measurable(VERTICAL, 8)


def test_the_estimated_memory_is_what_measuring_takes():
    import tracemalloc

    task = lines([HIGH, LOW], [120.0])
    motion = still(task)
    evaluate(task, motion)
    tracemalloc.start()
    kept = evaluate(task, motion)
    now, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    needs: list[float] = []
    original, resources.check_memory = resources.check_memory, lambda need, *_: needs.append(need)
    try:
        check_measurable(task)
        check_measurable(task, 1)
    finally:
        resources.check_memory = original
    assert kept.time.size == round(120.0 / SAMPLE) + 1
    assert 0.7 * needs[0] < most < needs[0]
    assert 0.7 * (needs[1] - needs[0]) < now < 1.05 * (needs[1] - needs[0])


def test_a_rollout_without_a_way_on_stays_finite():
    """From a velocity a thousand times the limit the look-ahead runs away; its motion is infeasible and finite."""
    problem = stages.discretise(VERTICAL, 0.1)
    policy = value_function.solve(problem, grids.full_grid(problem, 21, 21), "cp")
    motion = value_function.rollout(policy, 0.7, velocity=1e3)
    assert isinstance(motion, Motion) and np.isfinite(motion.position).all()
    judged = evaluate(VERTICAL, motion)
    assert not judged.feasible and len(judged.status) < 200
