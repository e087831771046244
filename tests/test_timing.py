"""Timing: how fast a path is followed, given or planned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import toppra

from leanboom.errors import InputError
from leanboom.io.loading import dump_task, load_task
from leanboom.methods import pseudo_inverse
from leanboom.methods.least_duration import shortest_duration
from leanboom.model import crane as cranes
from leanboom.model import motion
from leanboom.model.task import Leg, Lines, Reference, Retimed, Task
from leanboom.planning import planner
from leanboom.planning.replanning import replan
from leanboom.problem import stages
from leanboom.timing import along, free, shortest, time_optimal


def test_a_retimed_path_is_written_and_read_again(tmp_path):
    """What a plan of a free timing is kept as."""
    task = replace(load_task("loader-triangle-small"), source="")
    task = replace(task, path=Retimed(task.path, (0.1, 1.0 / 3.0, 0.0, 2.0)))
    file = tmp_path / "again.yaml"
    file.write_text(dump_task(task, "loader"), encoding="utf-8")
    assert replace(load_task(file), source="") == replace(task, name="loader-triangle-small")


TIMINGS = [
    ("duration: 12 s", 12.0, "fixed", None),
    ("duration: shortest", 30.0, "shortest", None),
    ("timing: shortest", 30.0, "shortest", None),
    ("timing: free\nduration: 12 s", 12.0, "free", None),
    ("duration: long", 0.0, "", ":15: duration = long; must be shortest, or a time from 0.0001 s to 3600 s"),
    ("duration: -3 s", 0.0, "", ":15: duration = -3 s; must be shortest, or a time from 0.0001 s to 3600 s"),
    (
        "duration: [6 s, 4 s]",
        0.0,
        "",
        ":15: duration = [6 s, 4 s]; must be shortest, or a time from 0.0001 s to 3600 s",
    ),
    ("timing: fre", 0.0, "", ":15: timing = fre; must be fixed, free, shortest; did you mean free?"),
    ("timing: shortest\nduration: 5 s", 0.0, "", ":16: duration = 5 s; must be left out with timing: shortest"),
    ("duration: shortest\ntiming: free", 0.0, "", ":16: timing = free; must be left out with duration: shortest"),
    ("duration: shortest\nsmooth: 5 Hz", 0.0, "", ":16: smooth = 5 Hz; must be left out with timing: shortest"),
]


@pytest.mark.parametrize(("text", "duration", "timing", "message"), TIMINGS)
def test_a_task_says_how_long_its_path_takes(tmp_path, text, duration, timing, message):
    file = tmp_path / "task.yaml"
    file.write_text(f"{dump_task(load_task('loader-triangle-small'), 'loader')}{text}\n", encoding="utf-8")
    if message is None:
        task = load_task(file)
        assert (task.duration, task.timing) == (pytest.approx(duration), timing)
        assert replace(load_task(file), source="") == replace(task, source="")
    else:
        with pytest.raises(InputError) as caught:
            load_task(file)
        assert message in str(caught.value)


# The fastest way with the redundancy settled

STROKE = 0.7  # [m]
VERTICAL = load_task("forwarder-vertical", start=STROKE)
FEW = 20  # intervals


def at_stroke(task, stroke, points=201):
    """Rates and times of the fastest way along a path at one stroke."""
    crane, shape = cranes.build(task), along.shape_of(task)
    tau = np.linspace(0.0, shape.duration, points)
    begins, ends = (
        along.along(task, crane, shape, own, np.full(own.size, stroke), 0.0 * own, 0.0 * own)
        for own in time_optimal.inside(tau)
    )
    rates = time_optimal.fastest(tau, begins, ends, crane, 1e3)
    return rates, time_optimal.passing(tau, rates)


class Straight(toppra.interpolator.AbstractGeometricPath):
    """Cylinder lengths over the way along one straight line at a stroke, and their derivatives."""

    def __init__(self, task, stroke):
        self.task, self.stroke, self.crane = task, stroke, cranes.build(task)
        self.begin, end = np.array(task.path.points)
        self.length = float(np.linalg.norm(end - self.begin))
        self.direction = (end - self.begin) / self.length

    def __call__(self, way, order=0):
        way = np.atleast_1d(np.asarray(way, dtype=float))
        point = self.begin + way[:, None] * self.direction
        rows = Reference(way, point, np.tile(self.direction, (way.size, 1)), np.zeros_like(point))
        pose = cranes.pose(self.crane, cranes.plane(self.task.machine, rows), np.full(way.size, self.stroke))
        moving = cranes.move(pose, 0.0 * way, 0.0 * way)
        lengths = [length for length, _, _ in pose.cylinders]
        return np.stack((lengths, moving.velocity, moving.acceleration)[order], axis=1)

    @property
    def dof(self):
        return len(self.crane.machine.cylinders)

    @property
    def path_interval(self):
        return np.array([0.0, self.length])

    @property
    def waypoints(self):
        return None


@pytest.mark.parametrize(("name", "stroke"), [("forwarder-vertical", 0.7), ("forwarder-vertical", 0.95)])
def test_the_fastest_way_at_a_fixed_stroke_is_topp_ras(name, stroke):
    task = load_task(name)
    cylinders = task.machine.cylinders
    limits = [
        np.array([[-bound, bound] for bound in bounds])
        for bounds in ([c.velocity_limit for c in cylinders], [c.acceleration_limit for c in cylinders])
    ]
    path = Straight(task, stroke)
    toppra.setup_logging("ERROR")
    kept = [
        toppra.constraint.JointVelocityConstraint(limits[0]),
        toppra.constraint.JointAccelerationConstraint(limits[1]),
    ]
    ways = np.linspace(0.0, path.length, 1001)
    other = toppra.algorithm.TOPPRA(kept, path, gridpoints=ways, solver_wrapper="seidel")
    _, speed, _ = other.compute_parameterization(0.0, 0.0)
    theirs = float(np.sum(2.0 * np.diff(ways) / (speed[1:] + speed[:-1])))
    rates, time = at_stroke(task, stroke)
    assert time[-1] == pytest.approx(theirs, rel=2e-3)
    assert rates[0] > 0.0 and rates[-1] > 0.0  # the tool rests there, its way over own time does not


def test_pump_flow_limits_the_fastest_way():
    """At half the flow that it asks for, the fastest way asks for no more than that."""
    crane, shape = cranes.build(VERTICAL), along.shape_of(VERTICAL)
    tau = np.linspace(0.0, shape.duration, 201)
    still = np.zeros(tau.size)
    rates, before = at_stroke(VERTICAL, STROKE)
    asked = along.along(VERTICAL, crane, shape, tau, still + STROKE, still, still).flow
    half = 0.5 * float((asked * rates).max())
    pump = replace(VERTICAL.machine.pump, max_flow=half)
    tight = replace(VERTICAL, machine=replace(VERTICAL.machine, pump=pump))
    rates, time = at_stroke(tight, STROKE)
    assert time[-1] > 1.02 * before[-1]
    assert (asked * rates).max() == pytest.approx(half, rel=1e-6)


# The least time


@pytest.fixture(scope="module")
def fastest():
    return shortest.plan(VERTICAL, "ls", intervals=FEW)


@pytest.mark.slow
def test_the_shortest_time_is_never_above_that_of_a_settled_redundancy(fastest):
    """Of its start held, and of the pseudo-inverse's motion hurried evenly until a limit is used up."""
    assert fastest.feasible and fastest.limit_use.worst > 0.995 and fastest.task.timing == "fixed"
    assert fastest.motion.position[0] == pytest.approx(STROKE, abs=1e-9)
    assert fastest.task.duration <= 1.002 * at_stroke(VERTICAL, STROKE)[1][-1]
    base = pseudo_inverse.baseline(VERTICAL, STROKE)
    even = max(base.limit_use.velocity, base.limit_use.acceleration**0.5) * VERTICAL.duration
    assert fastest.task.duration < 0.9 * even


def test_the_shortest_time_is_not_above_that_of_the_paths_own_timing_made_faster(fastest):
    """Of the same search at a redundancy that is free, but a speed along the path that is the own one's shape."""
    factor = shortest_duration(VERTICAL, (31, 21), 0.3, 0.1, least=1.0 / 8.0)
    assert factor is not None and fastest.task.duration <= factor * VERTICAL.duration


@pytest.mark.slow
def test_the_shortest_time_keeps_the_pumps_flow(fastest):
    """With a pump of 60 % of the flow that it asks for; that makes it slower."""
    flow = 0.6 * float(fastest.pump_flow.max())
    machine = replace(VERTICAL.machine, pump=replace(VERTICAL.machine.pump, max_flow=flow))
    found = shortest.plan(replace(VERTICAL, machine=machine), "ls", intervals=FEW)
    assert found.feasible and found.task.limits.pump_flow
    assert found.pump_flow.max() <= 1.001 * flow
    assert found.task.duration > 1.05 * fastest.task.duration


def test_a_shortest_plan_has_its_timing_in_its_task(monkeypatch, fastest):
    monkeypatch.setattr(shortest, "plan", lambda *_: fastest)
    plan = planner.run(replace(VERTICAL, timing="shortest"), pump="cp", effort="quick", grid=(41, 31), baseline=False)
    assert plan.solved and plan.task == fastest.task
    assert plan.evaluation.energy_cp <= fastest.energy_cp
    assert load_task_of(plan.task) == replace(plan.task, source="")


def load_task_of(task):
    """A task after a way through its file."""
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"{task.name}.yaml"
        file.write_text(dump_task(task, "forwarder"), encoding="utf-8")
        return replace(load_task(file), source="")


def test_a_fastest_leg_to_come_is_kept_by_a_new_plan(fastest):
    """On the stages of a new plan no motion keeps its limits; the crane would stop."""
    lines = VERTICAL.path
    up = Leg(payload=0.0, path=Lines(lines.points[::-1], (5.0,)))
    cycle = Task("cycle", VERTICAL.machine, legs=(up, Leg(payload=0.0, path=fastest.task.path)), start=STROKE)
    known = motion.joined([motion.held(STROKE, 5.0, "held", "ls"), fastest.motion])
    off = replan(cycle, 2.0, STROKE + 5e-3, 0.0, around=known)
    assert off.solved and off.at(np.array([5.0]))[0] == pytest.approx(STROKE, abs=1e-9)
    assert off.at(np.array([6.0]))[0] == pytest.approx(known.at(np.array([6.0]))[0], abs=1e-9)
    c, w, _ = known.at(np.array([6.0]))
    last = replan(cycle, 6.0, float(c[0]), float(w[0]), around=off)
    assert last.solved and last.task.duration == pytest.approx(cycle.duration - 6.0)


# The least energy


@pytest.mark.slow
def test_a_free_timing_never_costs_more(monkeypatch):
    """Whatever is proposed: also where it is dearer, or breaks limits."""
    monkeypatch.setattr(free, "MOST", FEW)
    monkeypatch.setattr(free, "OPTIONS", {"max_iter": 15})
    monkeypatch.setattr(planner, "TIMINGS", 1)
    monkeypatch.setattr(free, "LEVELS", {"ls": free.LEVELS["ls"][-1:]})
    task = replace(VERTICAL, path=VERTICAL.path.slower(0.6))
    fixed = planner.run(task, effort="quick", grid=(41, 31), baseline=False)
    plan = planner.run(replace(task, timing="free"), effort="quick", grid=(41, 31), baseline=False)
    assert plan.solved and plan.task.duration == pytest.approx(task.duration, rel=1e-9)
    assert plan.evaluation.energy_ls <= fixed.evaluation.energy_ls


def test_what_cannot_plan_a_timing_says_so():
    task = replace(VERTICAL, timing="free")
    with pytest.raises(InputError, match="timing = free; method polish keeps the timing of the path: use dp"):
        planner.run(task, method="polish")
    with pytest.raises(InputError, match="timing = free; a timing is planned for the energy of a pump, ls or cp, not"):
        planner.run(task, cost="velocity")
    with pytest.raises(InputError, match="timing = free; a motion alone has no timing of the path: use leanboom.run"):
        planner.plan(task)
    with pytest.raises(InputError, match="timing = shortest; the speed along the path must be planned first"):
        stages.discretise(replace(VERTICAL, timing="shortest"), 0.1)
