"""Cranes whose tilt joint passes the straight pose, as knuckle booms do: no inverse there, and two sides of it."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from math import cos, pi, radians, sin

import numpy as np
import pytest
from rich.console import Console

import leanboom as lb
from leanboom.cli import machine_tables, result_tables
from leanboom.components.linkages import Triangle
from leanboom.errors import InfeasibleError, InputError
from leanboom.evaluation.evaluate import evaluate
from leanboom.formulas.kinematics import ELBOW_DOWN, ELBOW_MARGIN, ELBOW_UP
from leanboom.methods import pseudo_inverse
from leanboom.model import crane as cranes
from leanboom.model import motion
from leanboom.model.machine import Joint
from leanboom.model.task import Braking, Lines, Moved, Part, Task
from leanboom.planning import planner, summaries
from leanboom.problem import stages
from leanboom.report import facts
from leanboom.simulation.closed_loop import simulate

LOADER, FORWARDER = lb.load_machine("loader"), lb.load_machine("forwarder")
GRID = (9, 7)  # coarse: what is asked is whether anything breaks


def knuckle(over=15.0, offset=0.0):
    """The loader with a tilt joint that goes `over` [deg] beyond the straight pose."""
    lift, tilt, extension = LOADER.joints
    tilting = replace(LOADER.cylinders[1], linkage=Triangle(0.8, 0.25, 2.7))
    return replace(
        LOADER,
        geometry=replace(LOADER.geometry, offset=offset),
        joints=(lift, Joint("tilt", tilt.lower, radians(over)), extension),
        cylinders=(LOADER.cylinders[0], tilting, LOADER.cylinders[2]),
    )


def ray(machine, direction, *distances, duration=8.0, start="smallest"):
    """A task along a ray from the lift joint, through points at distances [m]."""
    g = machine.geometry
    points = tuple((g.base_x + d * cos(direction), 0.0, g.base_z + d * sin(direction)) for d in distances)
    return Task("ray", machine, Lines(points, (duration,) * (len(distances) - 1)), 50.0, start)


def bends(judged):
    """Angle between boom and tool line all along a motion [rad], negative with the outer boom folded down."""
    g = judged.task.machine.geometry
    return judged.joint_position[:, -2] + np.arctan2(g.offset, g.outer + judged.joint_position[:, -1])


def arrays(judged):
    return [value for name in judged.__slots__ if isinstance(value := getattr(judged, name), np.ndarray)]


STRAIGHT = LOADER.geometry.boom + LOADER.geometry.outer + 0.2  # reached with the arm straight, 0.2 m out [m]
OUTWARDS = ray(knuckle(), 0.5, STRAIGHT, STRAIGHT + 0.4)


def test_bundled_machines_stay_clear_of_the_margin():
    """So it changes nothing for them: their tilt joints end before it, on the side that is planned by default."""
    for machine in (LOADER, FORWARDER):
        assert cranes.sides(machine) == (ELBOW_UP,)
        g, (_, tilt, extension) = machine.geometry, machine.joints[-3:]
        for q4 in (extension.lower, extension.upper):
            ends = np.array([tilt.lower, tilt.upper]) + np.arctan2(g.offset, g.outer + q4)
            assert ends[0] > -pi + ELBOW_MARGIN and ends[1] < -ELBOW_MARGIN


@pytest.mark.parametrize("offset", [0.0, 0.2, -0.1])
def test_feasible_extensions_end_before_the_straight_pose(offset):
    """The smallest extension bends the arm by the margin, no less; the determinant stays as far from zero."""
    problem = stages.discretise(ray(knuckle(offset=offset), 0.5, STRAIGHT, STRAIGHT + 0.4), 0.5)
    g = problem.crane.machine.geometry
    pose = cranes.pose(problem.crane, problem.plane, problem.lower)
    bend = pose.q[1] + np.arctan2(g.offset, g.outer + pose.q[2])
    assert bend == pytest.approx(-ELBOW_MARGIN, abs=1e-6)
    r2, r3, _, z2, z3, _ = pose.jacobian
    e = np.hypot(g.offset, g.outer + pose.q[2])
    assert r2 * z3 - z2 * r3 == pytest.approx(-g.boom * e * sin(ELBOW_MARGIN), rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("pump", ["ls", "cp"])
def test_a_path_that_begins_with_the_arm_straight_is_planned(pump):
    """Energies were infinite, numbers a hundred digits long and the saving 100 %."""
    plan = planner.run(OUTWARDS, pump=pump, grid=GRID, step=0.25)
    assert plan.evaluation.feasible and plan.evaluation.limit_use.worst <= 1.001
    assert np.all(bends(plan.evaluation) < -ELBOW_MARGIN + 0.01)
    assert plan.baseline is not None and plan.baseline.followed
    assert 0.0 < plan.evaluation.energy(pump) < 1.001 * plan.baseline.energy(pump)
    assert all(np.isfinite(values).all() for each in (plan.evaluation, plan.baseline) for values in arrays(each))


@pytest.mark.parametrize("variant", pseudo_inverse.METHODS)
def test_a_pseudo_inverse_passes_a_nearly_straight_arm_without_a_warning(variant):
    """The least velocity was 0 / 0 there."""
    start = float(stages.discretise(OUTWARDS, 0.05).lower[0])
    judged = evaluate(OUTWARDS, pseudo_inverse.resolve(OUTWARDS, start, variant))
    assert judged.followed and np.isfinite(judged.motion.velocity).all()


def test_a_straight_arm_is_a_finding_with_its_time_and_angle():
    """Half a degree from straight the tool is a little off its path; all numbers are those of a bent arm."""
    outer = LOADER.geometry.outer + 0.3
    d = np.sqrt(1.6**2 + outer**2 + 2.0 * 1.6 * outer * cos(radians(0.5)))
    task = ray(knuckle(), 0.4, 3.0, d, duration=2.0)
    judged = evaluate(task, motion.from_velocities(0.1, 0.3, np.zeros(21), "rest", "ls"))
    assert judged.status.startswith(
        "tool off its path by 0.0011 m at 2.000 s (stage 19): the arm would be straight to "
    )
    assert judged.status.endswith("within 0.5 deg, and must stay 3 deg from it")
    assert not judged.followed and not judged.feasible


@pytest.mark.parametrize("machine", [knuckle(), FORWARDER], ids=["knuckle", "forwarder"])
@pytest.mark.parametrize("stroke", [-3.0, 0.0, 0.2, 1.0, 7.0, 1e200])
def test_every_motion_is_judged_with_finite_numbers(machine, stroke):
    """Straight, out of reach, beyond a four-bar linkage's range, or absurd: usual sentences, finite numbers."""
    task = ray(machine, 0.5, STRAIGHT, STRAIGHT + 0.4)
    speed = np.linspace(0.0, stroke, 81)
    judged = evaluate(task, motion.from_velocities(0.1, stroke, speed, "any", "ls"))
    assert not judged.feasible
    assert all(np.isfinite(values).all() for values in arrays(judged))
    assert np.isfinite([judged.energy_ls, judged.energy_cp, judged.limit_use.worst, judged.path_error]).all()
    assert all(len(sentence) < 200 for sentence in judged.violations)


def test_energies_of_a_motion_that_cannot_be_made_are_left_out():
    """None in JSON, a dash in tables; nothing is saved compared with it."""
    judged = evaluate(OUTWARDS, motion.from_velocities(0.1, 0.0, np.zeros(81), "rest", "ls"))
    plan = planner.Plan(OUTWARDS, "ls", judged.motion, judged, judged, 0)
    summary = summaries.summary(plan)
    assert [summary[key] for key in ("energy_j", "energy_ls_j", "energy_cp_j")] == [None] * 3
    assert "Infinity" not in (text := json.dumps(summary)) and "NaN" not in text
    assert "LS -, CP -" in repr(judged)
    with pytest.raises(InputError, match="leaves the crane's reach"):
        simulate(OUTWARDS, judged.motion)
    out = io.StringIO()
    result_tables.plan(Console(file=out, width=100), plan, None, "ray")
    pumps = [line.split()[-3:] for line in out.getvalue().splitlines() if "pump  " in line or "(chosen)" in line]
    assert pumps == [["-", "-", "-"]] * 2
    assert "inf" not in out.getvalue().split() and "nan" not in out.getvalue().split()


def test_a_path_says_when_a_straight_arm_limits_the_extension():
    """All along this one, as it moves straight outwards; never where the arm is bent anyway; `check` tells."""
    path = facts.path(OUTWARDS)
    assert path.straight == (0.0, OUTWARDS.duration)
    (note,) = path.notes
    assert note.startswith("at times from 0.00 s to 8.00 s a straight arm limits the extension: plans stay 3 deg")
    assert facts.path(ray(knuckle(), 0.5, 2.0, 2.4)).notes == ()
    found = facts.Checked("ray", "task", OUTWARDS, path, None)
    out = io.StringIO()
    machine_tables.checked(Console(file=out, width=200), found, known=False)
    assert f"Note              {note}" in out.getvalue()
    assert note in found.json()["notes"]


def test_a_motion_says_where_it_is_as_straight_as_plans_go():
    start = float(stages.discretise(OUTWARDS, 0.05).lower[0])
    task = ray(knuckle(), 0.5, STRAIGHT, STRAIGHT - 0.4)
    judged = evaluate(task, motion.from_velocities(0.1, start, np.zeros(81), "rest", "ls"))
    assert judged.feasible and judged.bend[0] == pytest.approx(ELBOW_MARGIN, abs=1e-6)
    assert facts.straight(judged) == ("straight to within 3.0 deg at 0.000 s, as near as plans go",)
    bent = ray(knuckle(), 0.5, STRAIGHT - 0.2, STRAIGHT - 0.4)
    assert facts.straight(evaluate(bent, judged.motion)) == ()


# The two sides of the straight pose

# Nearly upright: with the outer boom folded down the lift joint would have to go beyond its end.
UPRIGHT = ray(knuckle(), 1.5, 3.4, 3.8)


@pytest.mark.slow
def test_a_path_reached_on_the_other_side_alone_is_planned_there():
    assert cranes.sides(UPRIGHT.machine) == (ELBOW_UP, ELBOW_DOWN)
    assert cranes.build(UPRIGHT).side == ELBOW_DOWN
    judged = planner.run(UPRIGHT, grid=GRID, step=0.25).evaluation
    assert "the outer boom is folded up" in facts.path(UPRIGHT).notes[0]
    assert judged.feasible and np.all(bends(judged) > ELBOW_MARGIN - 0.01)
    assert np.all(judged.joint_position[:, 0] < UPRIGHT.machine.joints[0].upper)


def test_what_is_left_of_a_path_keeps_its_side():
    """Its end alone could be reached with the outer boom folded down."""
    task = ray(knuckle(), 1.35, 3.4, 3.4)
    assert cranes.build(task).side == ELBOW_UP
    g = task.machine.geometry
    end = (g.base_x + 3.4 * cos(1.35), 0.0, g.base_z + 3.4 * sin(1.35))
    path = Lines((UPRIGHT.path.points[0], end), (8.0,))
    whole = replace(UPRIGHT, path=path)
    assert cranes.build(whole).side == ELBOW_DOWN
    for left in (
        Part(path, 7.0, 8.0),
        Moved(path, (0.0, 0.0, 0.01), 7.0, 0.5),
        Braking(Part(path, 7.0, 8.0), 0.5, 0.2),
    ):
        assert cranes.build(replace(whole, path=left)).side == ELBOW_DOWN


def test_a_path_that_changes_sides_is_refused_with_both_of_them():
    """From one side the other is reached through the straight pose alone."""
    g = knuckle().geometry
    low = (g.base_x + 1.2, 0.0, g.base_z + 0.3)
    with pytest.raises(InfeasibleError, match="nor is all of it reached with the outer boom folded up") as refused:
        stages.discretise(replace(UPRIGHT, path=Lines((low, UPRIGHT.path.points[0]), (8.0,))), 0.1)
    assert "joint lift would be" in str(refused.value)


def test_a_path_at_the_end_of_a_straight_arm_says_how_far_it_is_too_far():
    furthest = 1.6 + 1.562 + 1.04 - 1e-4
    task = ray(knuckle(), 0.5, furthest, furthest)
    with pytest.raises(InfeasibleError, match=r"too far by 0.002 m; an arm stays 3 deg from straight"):
        stages.discretise(task, 0.1)


# Random cranes


@pytest.mark.parametrize("seed", range(4))
def test_random_knuckle_booms_give_finite_plans_or_a_sentence(seed):
    """Ranges, offsets and paths at random, by methods of each kind."""
    rng = np.random.default_rng(seed)
    machine = knuckle(rng.uniform(-5.0, 20.0), rng.uniform(-0.15, 0.25))
    distances = rng.uniform(1.0, 4.3, 3)
    task = ray(machine, rng.uniform(0.0, 1.5), *distances, duration=10.0, start=("smallest", "middle")[seed % 2])
    for method in ("dp", "dp1", "sns-actuator", "sns-joint"):
        try:
            plan = planner.run(task, method=method, grid=GRID, step=0.25)
        except InfeasibleError as error:
            assert len(str(error)) < 300
            continue
        for judged in filter(None, (plan.evaluation, plan.baseline)):
            assert all(np.isfinite(values).all() for values in arrays(judged))
            assert all(len(sentence) < 300 for sentence in judged.violations)
