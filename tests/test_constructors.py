"""What is put together in Python is checked like what is read from files; numbers of NumPy are numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from leanboom.components.friction import Friction
from leanboom.components.linkages import Polynomial, RackAndPinion, Telescope
from leanboom.components.paths import Braking, Lines, Moved, Part, Retimed, Spline
from leanboom.dynamic_programming import value_function
from leanboom.errors import InputError
from leanboom.io.loading import dump_machine, dump_task, load_task
from leanboom.model.machine import Body, Geometry, Joint
from leanboom.model.motion import Motion, from_positions, from_velocities, make
from leanboom.model.task import Task
from leanboom.planning.replanning import replan
from leanboom.quantities import ranges

TASK = load_task("forwarder-vertical")
MACHINE, PATH = TASK.machine, TASK.path
LOADER = load_task("loader-triangle-large").machine
A, B, C = (5.5, 0.0, 4.0), (5.5, 0.0, 3.0), (5.5, 0.0, 2.0)
NAN, INF = float("nan"), float("inf")

BAD = {
    "payload of nan": (lambda: replace(TASK, payload=NAN), "payload = nan; must be a finite mass"),
    "payload below 0": (lambda: replace(TASK, payload=-1.0), "payload = -1 kg; must be at least 0"),
    "infinite payload": (lambda: replace(TASK, payload=INF), "payload = inf; must be a finite mass"),
    "payload as a list": (lambda: replace(TASK, payload=[1.0]), "payload = [1.0]; must be a finite mass"),
    "one duration for two segments": (
        lambda: Lines((A, B, C), (6.0,)),
        "path.durations has 1 entries; must have 2, one less than points",
    ),
    "negative duration": (
        lambda: Lines((A, B, C), (6.0, -1.0)),
        "path.durations[1] = -1 s; must be at least 0.0001 s",
    ),
    "duration of nothing": (lambda: Lines((A, B), (0.0,)), "path.durations[0] = 0 s; must be at least 0.0001 s"),
    "duration of nan": (lambda: Lines((A, B), (NAN,)), "path.durations[0] = nan; must be a finite time"),
    "one point": (lambda: Lines((A,), ()), "path.points = ((5.5, 0.0, 4.0),); must be a list of at least two points"),
    "points of two lengths": (
        lambda: Lines(((1.0, 2.0), A), (1.0,)),
        "path.points[0] = (1.0, 2.0); must be a list of three lengths x, y, z",
    ),
    "a point of nan": (lambda: Lines(((1.0, NAN, 2.0), A), (1.0,)), "path.points[0][1] = nan; must be a finite"),
    "times that fall": (lambda: Spline((A, B, C), (0.0, 2.0, 1.0)), "path.times = [0, 2, 1]; times must begin"),
    "times that begin late": (lambda: Spline((A, B), (1.0, 2.0)), "path.times = [1, 2]; times must begin with 0"),
    "too few times": (lambda: Spline((A, B, C), (0.0, 2.0)), "path.times has 2 entries; must have 3, as many as"),
    "a part beyond its path": (lambda: Part(PATH, 1.0, 9.0), "path.since, path.until = 1 s, 9 s; the second must be"),
    "a part that ends before it begins": (lambda: Part(PATH, 3.0, 2.0), "path.since, path.until = 3 s, 2 s"),
    "moved within no time": (lambda: Moved(PATH, (1.0, 0.0, 0.0), 1.0, 0.0), "path.over = 0 s; must be at least"),
    "moved by nan": (lambda: Moved(PATH, (NAN, 0.0, 0.0), 1.0, 1.0), "path.offset[0] = nan; must be a finite length"),
    "retimed what is no path of its own": (lambda: Retimed("path", (1.0, 1.0)), "path.path = path; must be lines or a"),
    "retimed by one rate": (lambda: Retimed(PATH, (1.0,)), "path.rates = (1.0,); must be a list of at least two rates"),
    "retimed backwards": (lambda: Retimed(PATH, (1.0, -0.5, 1.0)), "path.rates[1] = -0.5; must be at least 0"),
    "retimed to stand still": (lambda: Retimed(PATH, (0.0, 0.0)), "path.rates = [0, 0]; one of the rates must"),
    "retimed to a jump": (lambda: Retimed(PATH, (1e9, 1e9)), "path.rates make the path last"),
    "an unknown timing": (lambda: replace(TASK, timing="fast"), "timing = fast; must be one of fixed, free, shortest"),
    "a free timing of a part": (
        lambda: replace(TASK, path=Part(PATH, 1.0, 3.0), timing="free"),
        "timing = free; must be fixed unless the path is lines or a spline",
    ),
    "a free timing, filtered": (
        lambda: replace(TASK, smooth=5.0, timing="free"),
        "smooth = 5; must be left out with timing: free",
    ),
    "braking within no time": (lambda: Braking(PATH, 1.0, -2.0), "path.over = -2 s; must be at least 0.0001 s"),
    "braking on no path": (lambda: Braking("path", 1.0, 2.0), "path.path = path; must be a path"),
    "a task without a path": (lambda: replace(TASK, path=None), "path = None; must be a path such as"),
    "a task without a machine": (lambda: Task("x", "forwarder", PATH), "machine = forwarder; must be a machine"),
    "an unknown start": (lambda: replace(TASK, start="biggest"), "start = biggest; must be smallest, middle, best, or"),
    "a start of nan": (lambda: replace(TASK, start=NAN), "start = nan; must be smallest, middle, best, or"),
    "a start beyond the stroke": (lambda: replace(TASK, start="9 m"), "start = 9; must be from 0 to 1.85 m"),
    "a cut-off far too low": (lambda: replace(TASK, smooth=1e-9), "smooth = 1e-09 Hz; must be from 0.01 Hz to 240 Hz"),
    "a cut-off beyond the samples": (lambda: replace(TASK, smooth=250.0), "smooth = 250 Hz; must be from 0.01 Hz to"),
    "a path too short for a low pass": (
        lambda: replace(TASK, path=Lines((A, A), (0.01,)), smooth=5.0),
        "smooth = 5; needs a path of at least 0.02 s",
    ),
    "sideways on a machine that does not slew": (
        lambda: replace(TASK, machine=LOADER, path=Lines((A, (5.5, 1.0, 4.0)), (1.0,))),
        "path.points[1] = (5.5, 1.0, 4.0); y must be 0, since machine loader does not slew",
    ),
    "a boom of no length": (lambda: replace(MACHINE.geometry, boom=0.0), "geometry.boom = 0 m; must be above 0"),
    "a base of nan": (lambda: Geometry(NAN, 0.0, 1.0, 0.0, 1.0, True), "geometry.base_x = nan; must be a finite"),
    "an extension below nothing": (
        lambda: Joint("extension", -0.1, 0.5),
        "joints.extension[0] = -0.1 m; must be at least 0",
    ),
    "a joint of no crane": (lambda: Joint("wrist", 0.0, 1.0), "joint = wrist; must be one of base, lift, tilt, ext"),
    "a joint the wrong way round": (lambda: Joint("lift", 1.0, -1.0), "joints.lift = [1, -1]; the lower end must be"),
    "no arm": (lambda: RackAndPinion(0.0), "linkage.arm = 0 m; must be above 0"),
    "no ratio": (lambda: Telescope(INF), "linkage.ratio = inf; must be a finite number"),
    "one coefficient": (lambda: Polynomial((1.0,)), "linkage.coefficients = (1.0,); must be a list of 2 to 12 numbers"),
    "negative friction": (lambda: Friction(-1.0, 1.0), "friction.coulomb = -1 N; must be at least 0"),
    "a velocity limit of nan": (
        lambda: replace(MACHINE.cylinders[1], velocity_limit=NAN),
        "cylinders.lift.velocity_limit = nan; must be a finite velocity",
    ),
    "a mass of nan": (lambda: Body("arm", "lift", NAN, 0.0, 0.0, 0.0), "bodies.arm.mass = nan; must be a finite mass"),
    "an efficiency above 1": (lambda: replace(MACHINE.pump, efficiency=1.2), "pump.efficiency = 1.2; must be above 0"),
    "a delay of a minute": (lambda: replace(MACHINE.circuit, delay=60.0), "simulation.delay = 60 s; must be from 0 to"),
    "a machine without its tilt": (
        lambda: replace(MACHINE, joints=MACHINE.joints[:2]),
        "joints = base, lift; must be base, lift, tilt, extension, in this order",
    ),
    "gravity of nan": (lambda: replace(MACHINE, gravity=NAN), "gravity = nan; must be a finite acceleration"),
    "a motion without stages": (lambda: from_velocities(0.1, 0.3, [0.0], "x", "cp"), "motion has 1 positions, 1 velo"),
    "a motion of no step": (lambda: from_velocities(0.0, 0.3, [0.0, 0.0], "x", "cp"), "motion.step = 0 s; must be"),
    "positions of no step": (lambda: from_positions(NAN, [0.3, 0.3], "x", "cp"), "motion.step = nan; must be a finite"),
    "arrays that do not fit": (
        lambda: make(0.1, [0.0, 0.0], [0.0, 0.0], [0.0, 0.0], "x", "cp"),
        "motion has 2 positions, 2 velocities and 2 accelerations; must have at least one acceleration",
    ),
    "a table of velocities": (
        lambda: from_velocities(0.1, 0.3, np.zeros((2, 2)), "x", "cp"),
        "motion.velocity has the shape (2, 2); must have one axis",
    ),
    "velocities in words": (lambda: from_velocities(0.1, 0.3, ["a"], "x", "cp"), "motion.velocity = ['a']; must be"),
    "a lead longer than the step": (
        lambda: make(0.1, [0.0, 0.0], [0.0, 0.0], [0.0], "x", "cp", lead=0.2),
        "motion.lead = 0.2 s; must be above 0 and at most 0.1 s",
    ),
    "a start of a motion that is none": (
        lambda: from_velocities(0.1, NAN, [0.0, 0.0], "x", "cp"),
        "motion.position = nan at stage 0; must be finite",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("make_it", "message"), BAD.values(), ids=BAD)
def test_what_no_file_may_hold_is_refused_with_its_key(make_it, message):
    with pytest.raises(InputError) as caught:
        make_it()
    assert str(caught.value).startswith(message)


def test_a_motion_made_by_its_class_is_checked_and_keeps_arrays_of_its_own():
    positions = np.zeros(3)
    motion = Motion(0.1, positions, [0.0, 0.0, 0.0], (0.0, 0.0), "x", "cp")
    positions[1] = 7.0
    assert motion.position[1] == 0.0 and not motion.velocity.flags.writeable
    assert replace(motion, status="new").position is motion.position
    with pytest.raises(InputError, match="motion.acceleration = nan at stage 1"):
        Motion(0.1, np.zeros(3), np.zeros(3), np.array([0.0, np.nan]), "x", "cp")


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.int64, np.int8, int, float])
def test_numbers_of_numpy_are_numbers(kind):
    task = replace(TASK, payload=kind(100), start=kind(1), smooth=kind(5))
    assert task == replace(TASK, payload=100.0, start=1.0, smooth=5.0)
    assert all(type(value) is float for value in (task.payload, task.start, task.smooth))
    assert "payload: 100 kg" in dump_task(task)
    assert load_task("forwarder-vertical", start=kind(1)).start == 1.0
    path = Lines(np.array([A, B], dtype=np.float32), np.array([kind(3)]))
    assert path == Lines((A, B), (3.0,)) and hash(path)
    pump = replace(MACHINE.pump, tank_pressure=kind(100))
    assert dump_machine(replace(MACHINE, pump=pump)) == dump_machine(
        replace(MACHINE, pump=replace(pump, tank_pressure=100.0))
    )
    assert from_velocities(kind(1), kind(0), [0, 0, 0], "x", "cp").duration == 2.0


def test_a_start_may_carry_its_unit():
    assert replace(TASK, start="450 mm").start == replace(TASK, start=0.45).start == 0.45
    assert load_task("forwarder-vertical", start="450 mm").start == 0.45
    assert replace(TASK, start="middle").start == "middle"


@pytest.mark.parametrize("grid", [(141, 71), [141, 71], (141.0, np.int64(71)), np.array([141, 71])])
def test_whole_numbers_of_any_kind_make_a_grid(grid):
    assert value_function.nodes(grid) == (141, 71) and all(type(count) is int for count in value_function.nodes(grid))


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        ((141.5, 71), "grid = 141.5x71; must be two whole numbers"),
        ((NAN, 71), "grid = nanx71; must be two whole numbers"),
        ((2, 71), "grid = 2x71; needs at least 3 positions and 3 velocities"),
        ((141,), "grid = (141,); must be a list of two whole numbers"),
        ("141x71", "grid = 141x71; must be a list of two whole numbers"),
        (141, "grid = 141; must be a list of two whole numbers"),
        (("a", 71), "grid = ax71; must be two whole numbers"),
    ],
)
def test_other_grids_are_refused(grid, message):
    with pytest.raises(InputError) as caught:
        value_function.nodes(grid)
    assert str(caught.value).startswith(message)


def test_paths_made_in_python_are_not_bound_to_an_hour():
    assert PATH.slower(2000.0).duration == pytest.approx(2000.0 * PATH.duration)


def test_numbers_are_shown_in_few_digits():
    assert ranges.shown(10**200) == "1e+200" and ranges.shown(1 / 3) == "0.333333"
    assert len(ranges.shown("x" * 500)) == 60


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_planning_anew_around_a_motion_of_another_length_is_refused(factor):
    count = round(factor * TASK.duration / 0.1)
    other = from_velocities(0.1, 0.7, np.zeros(count + 1), "other", "cp")
    with pytest.raises(InputError) as caught:
        replan(TASK, 2.0, 0.7, 0.0, pump="cp", around=other)
    assert str(caught.value) == (
        f"around ends at {factor * TASK.duration:g} s; must end with the task at 6 s: hand in a motion of this task, "
        "or leave it out"
    )
