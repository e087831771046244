"""The judge against motions worked out by hand, against quadrature, and against limits broken on purpose."""

from __future__ import annotations

from dataclasses import replace
from math import cos, sin

import numpy as np
import pytest
from scipy.integrate import fixed_quad

from bundled_texts import SINGLE
from leanboom.errors import InputError
from leanboom.evaluation.evaluate import SAMPLE, evaluate, hydraulic_state, judged_cost
from leanboom.formulas import kinematics
from leanboom.io.loading import load_machine, load_task
from leanboom.model import crane as cranes
from leanboom.model.machine import Joint
from leanboom.model.motion import from_velocities
from leanboom.model.task import Lines, Task, sample

LOADER, FORWARDER = load_machine("loader"), load_machine("forwarder")
TASKS = {name: load_task(name) for name in SINGLE}


def rest(task, stroke, step=0.05):
    """The motion that holds the redundant cylinder still."""
    count = round(task.duration / step)
    return from_velocities(task.duration / count, stroke, np.zeros(count + 1), "rest", "ls")


# A smooth motion of the redundant cylinder for each path: start [m], rate [m/s], swing [m], [rad/s].
STROKES = {
    "forwarder-half-cycle": (0.4, 0.03, 0.1, 0.8),
    "forwarder-horizontal": (0.4, 0.1, 0.05, 1.1),
    "forwarder-vertical": (0.7, 0.0, 0.15, 0.9),
    "loader-triangle-large": (0.8, 0.0, 0.12, 0.7),
    "loader-triangle-medium": (0.7, 0.0, 0.12, 0.7),
    "loader-triangle-small": (0.6, 0.0, 0.12, 0.7),
}


def swinging(name, step=0.05):
    """A motion that reaches the whole path, with the redundant cylinder going out and in."""
    start, rate, swing, pace = STROKES[name]
    count = round(TASKS[name].duration / step)
    t = step * np.arange(count + 1)
    return from_velocities(step, start, rate + swing * pace * np.cos(pace * t), "swinging", "ls")


def largest(difference):
    """The largest deviation in an array, NaN included."""
    return float(np.max(np.abs(difference)))


# Worked out by hand


def along_the_boom(q2, q3, payload=475.0, duration=10.0):
    """The loader slides its tool straight along the outer boom: lift and tilt rest, the extension does it all."""
    g, (near, far) = LOADER.geometry, (0.1, 0.9)
    ends = [kinematics.tool_point(q2, q3, q4, g.base_x, g.base_z, g.boom, g.offset, g.outer) for q4 in (near, far)]
    machine = replace(LOADER, driven_velocity=1e-5)  # so that nearly all of the slide counts
    task = Task("slide", machine, Lines(tuple((r, 0.0, z) for r, z in ends), (duration,)), payload)
    t = np.linspace(0.0, 1.0, round(duration / SAMPLE) + 1)
    speed = (far - near) * 30.0 * t**2 * (1.0 - t) ** 2 / duration
    return task, from_velocities(SAMPLE, near, speed, "slide", "ls"), far - near


MASS = 95.19 + 475.0  # what the extension moves


def test_a_slide_out_and_level_costs_margin_and_kinetic_energy():
    """Level boom: LS pays its margin over the volume, and the speed-up to 1.875 D / T; slowing down pays nothing."""
    task, motion, distance = along_the_boom(1.0, -1.0)
    judged = evaluate(task, motion)
    volume = LOADER.cylinders[-1].piston_area * distance
    peak = 1.875 * distance / 10.0
    assert judged.energy_cp == pytest.approx(20e6 * volume, rel=1e-5)
    assert judged.energy_ls == pytest.approx(2e6 * volume + 0.5 * MASS * peak**2, rel=1e-4)
    assert judged.velocity[:, -1].max() == pytest.approx(peak, rel=1e-6)
    assert judged.feasible and judged.status == "solved"


def test_a_slide_up_and_out_also_lifts_its_load():
    """Rising boom: gravity keeps the load positive throughout, so the kinetic energy comes back as lower pressure."""
    task, motion, distance = along_the_boom(1.5, -0.9)
    judged = evaluate(task, motion)
    volume = LOADER.cylinders[-1].piston_area * distance
    lifted = MASS * LOADER.gravity * distance * sin(0.6)
    assert judged.energy_ls == pytest.approx(2e6 * volume + lifted, rel=1e-4)
    assert judged_cost(judged, "actuator") == pytest.approx(lifted, rel=1e-4)
    # Pressure in the middle, without acceleration: weight along the boom over the piston.
    middle = judged.time.size // 2
    weight = MASS * LOADER.gravity * sin(0.6)
    assert judged.force[middle, -1] == pytest.approx(weight, rel=1e-4)
    assert judged.supply_ls[middle] == pytest.approx(weight / LOADER.cylinders[-1].piston_area + 2e6, rel=1e-4)


def test_a_slide_back_down_is_paid_on_the_rod_side_without_counting_its_load():
    """The load pushes the cylinder in: no demanded pressure, only the margin over the rod-side volume."""
    task, motion, distance = along_the_boom(1.5, -0.9)
    task = replace(task, path=Lines(task.path.points[::-1], task.path.durations))
    judged = evaluate(task, from_velocities(SAMPLE, 0.9, -motion.velocity, "slide", "ls"))
    volume = LOADER.cylinders[-1].rod_side_area * distance
    assert judged.energy_ls == pytest.approx(2e6 * volume, rel=1e-4)
    assert judged.energy_cp == pytest.approx(20e6 * volume, rel=1e-4)
    assert not judged.pressure.any()


def test_a_crane_at_rest_uses_no_energy():
    task = replace(TASKS["loader-triangle-large"], path=Lines(((2.2, 0.0, 1.2),) * 2, (2.0,)))
    judged = evaluate(task, rest(task, 0.2))
    assert (judged.energy_ls, judged.energy_cp) == (0.0, 0.0)
    assert np.all(judged.supply_ls == 2e6) and np.all(judged.supply_cp == 20e6)
    assert judged.force[0] / 1e3 == pytest.approx((51.832, 31.109, -3.228), rel=1e-3)  # at 9.81 m/s^2
    assert judged.limit_use.velocity == judged.limit_use.acceleration == 0.0


def test_efficiency_divides_the_energy():
    task, motion, _ = along_the_boom(1.5, -0.9)
    lossy = replace(task, machine=replace(task.machine, pump=replace(LOADER.pump, efficiency=0.8)))
    for pump in ("ls", "cp"):
        assert evaluate(lossy, motion).energy(pump) == pytest.approx(evaluate(task, motion).energy(pump) / 0.8)


# Against the crane, point by point


def power_cp(task, motion, t):
    """Constant-pressure power at times, from the crane alone."""
    crane = cranes.build(task)
    pose = cranes.pose(crane, cranes.plane(task.machine, sample(task, t)), motion.at(t)[0])
    moving = cranes.move(pose, *motion.at(t)[1:])
    flows = [np.maximum(d.area_out * v, -d.area_in * v) for d, v in zip(crane.drives, moving.velocity, strict=True)]
    return task.machine.pump.constant_pressure * sum(flows)


@pytest.mark.parametrize("name", ["forwarder-vertical", "forwarder-half-cycle", "loader-triangle-small"])
def test_energy_is_the_integral_of_power(name):
    """Gauss quadrature over every stage, against the judge's trapezoids."""
    task, motion = TASKS[name], swinging(name)
    edges = motion.step * np.arange(motion.velocity.size)
    pairs = zip(edges[:-1], edges[1:], strict=True)
    exact = sum(fixed_quad(lambda t: power_cp(task, motion, t), a, b, n=5)[0] for a, b in pairs)
    judged = evaluate(task, motion)
    assert judged.energy_cp == pytest.approx(exact, rel=2e-6)
    assert judged.cumulative_cp[0] == judged.cumulative_ls[0] == 0.0
    trapezoids = 0.5 * (judged.power_ls[1:] + judged.power_ls[:-1]) * np.diff(judged.time)
    assert largest(np.diff(judged.cumulative_ls) - trapezoids) < 1e-8
    assert trapezoids.min() >= 0.0


@pytest.mark.parametrize("name", TASKS)
def test_columns_fit_together(name):
    """Supply is the highest demanded pressure plus margin; power is supply times flow; all on a 2 ms grid."""
    task, motion = TASKS[name], swinging(name)
    judged = evaluate(task, motion)
    pump = task.machine.pump
    assert largest(np.diff(judged.time) - 0.002) < 1e-11
    assert judged.time[-1] == task.duration
    assert np.array_equal(judged.supply_ls, judged.pressure.max(axis=1) + pump.ls_margin)
    assert np.array_equal(judged.pump_flow, judged.flow.sum(axis=1))
    assert largest(judged.power_ls - judged.supply_ls * judged.pump_flow) < 1e-9
    assert largest(judged.power_cp - pump.constant_pressure * judged.pump_flow) < 1e-9
    assert np.all(judged.flow >= 0.0)
    # Pressures and flows from the judged velocities and forces, cylinder by cylinder.
    for i, d in enumerate(task.machine.drives):
        v, force = judged.velocity[:, i], judged.force[:, i]
        loaded = (np.abs(v) > task.machine.driven_velocity) & (v * force > 0.0)
        line = np.where(v > 0.0, d.gain_out * force + d.back_out, d.back_in - d.gain_in * force)
        assert largest(judged.pressure[:, i] - np.where(loaded, line, 0.0)) < 1e-6
    assert judged.energy("ls") == judged.energy_ls == judged.cumulative_ls[-1]
    assert judged.energy("cp") == judged.energy_cp == judged.cumulative_cp[-1]


@pytest.mark.parametrize("name", TASKS)
def test_the_tool_stays_on_its_path(name):
    """Whatever the extension does: inverse kinematics leaves an error of rounding alone."""
    judged = evaluate(TASKS[name], swinging(name))
    assert judged.path_error < 1e-12
    assert largest(judged.tool - judged.tool_target) < 1e-12
    assert np.array_equal(judged.tool_target, sample(TASKS[name], judged.time).point)


@pytest.mark.parametrize("name", TASKS)
def test_rates_are_derivatives_of_what_was_judged(name):
    """Lengths, velocities and joints on the 2 ms grid belong together."""
    judged = evaluate(TASKS[name], swinging(name))
    step = judged.time[1] - judged.time[0]
    pairs = (
        (judged.length, judged.velocity),
        (judged.joint_position, judged.joint_velocity),
        (judged.velocity, judged.acceleration),
        (judged.joint_velocity, judged.joint_acceleration),
    )
    for value, rate in pairs:  # accelerations of the redundant cylinder are steps, hence no better than this
        assert largest((value[2:] - value[:-2]) / (2.0 * step) - rate[1:-1]) < 0.02
        assert np.median(np.abs((value[2:] - value[:-2]) / (2.0 * step) - rate[1:-1])) < 1e-6
        assert largest(value[-1] - value[0] - np.trapezoid(rate, judged.time, axis=0)) < 5e-4


def test_single_states_are_judged_like_whole_motions():
    judged = evaluate(TASKS["forwarder-vertical"], swinging("forwarder-vertical"))
    crane = cranes.build(TASKS["forwarder-vertical"])
    pressure, flow = hydraulic_state(crane, judged.velocity[900:901], judged.force[900:901])
    assert np.array_equal(pressure, judged.pressure[900:901]) and np.array_equal(flow, judged.flow[900:901])


def test_costs_by_every_name():
    judged = evaluate(TASKS["forwarder-vertical"], swinging("forwarder-vertical"))

    def integral(rate):
        return np.trapezoid(rate, judged.time)

    areas = np.array([c.piston_area - c.rod_side_area for c in FORWARDER.cylinders])
    expected = {
        "ls": judged.energy_ls,
        "cp": judged.energy_cp,
        "actuator": integral(np.maximum(judged.force * judged.velocity, 0.0).sum(axis=1)),
        "velocity": integral((judged.velocity**2).sum(axis=1)),
        "extension": integral(judged.velocity[:, 3] ** 2),
        "recuperation": 20e6 * integral(judged.velocity @ areas),
    }
    for cost, value in expected.items():
        assert judged_cost(judged, cost) == pytest.approx(value, rel=1e-9), cost


# Limits


def test_limit_use_is_one_at_the_limit():
    """Positions from the middle of the range, velocities and accelerations from zero; the largest of all counts."""
    task, motion, distance = along_the_boom(1.0, -1.0)
    judged = evaluate(task, motion)
    use = judged.limit_use
    assert use.velocity == pytest.approx(1.875 * distance / 10.0 / 0.2, rel=1e-6)
    assert use.acceleration == pytest.approx(10.0 / np.sqrt(3.0) * distance / 10.0**2 / 0.5, rel=1e-3)
    shares = [
        abs(2.0 * (q - j.lower) / (j.upper - j.lower) - 1.0)
        for q, j in zip((1.0, -1.0, 0.1), LOADER.joints, strict=True)
    ]
    assert use.position == pytest.approx(max(shares), rel=1e-6)
    assert use.worst == max(use.position, use.velocity, use.acceleration)


def test_a_limit_used_to_its_last_is_kept():
    task, motion, distance = along_the_boom(1.0, -1.0)
    for factor, kept in ((1.0, True), (0.9992, True), (0.998, False)):
        cylinder = replace(LOADER.cylinders[-1], velocity_limit=factor * 1.875 * distance / 10.0)
        tight = replace(task, machine=replace(task.machine, cylinders=(*LOADER.cylinders[:2], cylinder)))
        assert evaluate(tight, motion).feasible is kept


def test_violations_are_sentences_with_joint_time_stage_and_amount():
    """A slide of 0.8 m in 4 s at up to 0.375 m/s and 0.289 m/s^2, against limits of 0.2 m/s and 0.25 m/s^2."""
    task, motion, _ = along_the_boom(1.0, -1.0, duration=4.0)
    cylinder = replace(LOADER.cylinders[-1], acceleration_limit=0.25)
    extension = Joint("extension", 0.0, 0.85)
    machine = replace(task.machine, cylinders=(*LOADER.cylinders[:2], cylinder), joints=(*LOADER.joints[:2], extension))
    judged = evaluate(replace(task, machine=machine), motion)
    velocity, acceleration, position = judged.violations  # worst first
    assert velocity == (
        "velocity of extension is 0.3750 m/s at 2.000 s (stage 1000), beyond its limit 0.2000 by 0.1750"
    )
    assert acceleration.startswith("acceleration of extension is ") and " m/s^2 at " in acceleration
    assert acceleration.endswith(("beyond its limit 0.2500 by 0.0387", "beyond its limit -0.2500 by 0.0387"))
    assert position == "position of extension is 0.9000 m at 4.000 s (stage 1999), beyond its limit 0.8500 by 0.0500"
    assert judged.status == velocity
    assert not judged.feasible
    assert velocity in repr(judged)


def test_a_joint_below_its_range_is_compared_with_its_lower_limit():
    task, motion, _ = along_the_boom(1.0, -1.0)
    narrow = replace(task, machine=replace(task.machine, joints=(Joint("lift", 1.2, 1.5), *LOADER.joints[1:])))
    assert "position of lift is 1.0000 rad" in evaluate(narrow, motion).status
    assert evaluate(narrow, motion).status.endswith("beyond its limit 1.2000 by 0.2000")


def test_a_motion_out_of_reach_leaves_the_path():
    """The tool then stops short on a nearly straight boom: 1 m beyond the reach, 1 m off the path."""
    g = LOADER.geometry
    outer = g.outer + 0.5
    reach = np.sqrt(g.boom**2 + outer**2 + 2.0 * g.boom * outer * cos(kinematics.ELBOW_MARGIN))
    ends = tuple((g.base_x + d * cos(0.3), 0.0, g.base_z + d * sin(0.3)) for d in (reach - 1.0, reach + 1.0))
    task = Task("away", LOADER, Lines(ends, (10.0,)))
    judged = evaluate(task, rest(task, 0.5))
    assert judged.path_error == pytest.approx(1.0, abs=1e-9)
    assert judged.status == "tool off its path by 1.0000 m at 10.000 s (stage 199)"


def test_a_motion_out_of_reach_is_judged_without_nan():
    """Retracted, the forwarder cannot follow its horizontal path to the end: a finding, not a warning."""
    judged = evaluate(TASKS["forwarder-horizontal"], rest(TASKS["forwarder-horizontal"], 0.0))
    assert judged.status.startswith("tool off its path by ")
    assert not np.isnan([judged.energy_ls, judged.energy_cp]).any()
    assert "nan" not in " ".join(judged.violations)


def test_notes_say_what_the_pump_cannot_do():
    """They are no violations: the planning problem has no such limits."""
    task, motion, _ = along_the_boom(1.5, -0.9)
    plain = evaluate(task, motion)
    assert plain.notes == ()
    weak = replace(LOADER.pump, max_flow=1.0 / 6e4, max_pressure=3e6)
    judged = evaluate(replace(task, machine=replace(task.machine, pump=weak)), motion)
    flow, pressure = judged.notes
    most = f"{plain.pump_flow.max() * 6e4:.1f} l/min at 5.000 s"
    above = plain.time[plain.pump_flow > 1.001 / 6e4]
    lasts = f"for {SAMPLE * above.size:.3f} s between {above[0]:.3f} s and {above[-1]:.3f} s"
    assert flow == f"pump flow {most} is above the pump's 1.0 l/min, {lasts}"
    assert pressure.startswith(f"LS supply {plain.supply_ls.max() / 1e6:.2f} MPa at ")
    assert " s is above the pump's 3.00 MPa, for " in pressure
    assert judged.feasible


def weakened(task, **pump):
    return replace(task, machine=replace(task.machine, pump=replace(task.machine.pump, **pump)))


def test_a_motion_that_the_pump_cannot_deliver_is_not_solved():
    """Limits are kept, but a real pump would starve: what, how much, when and for how long stands in the status."""
    task, motion, _ = along_the_boom(1.5, -0.9)
    plain = evaluate(task, motion)
    assert plain.status == "solved" and plain.deliverable
    judged = evaluate(weakened(task, max_flow=0.5 * float(plain.pump_flow.max())), motion)
    assert judged.feasible and not judged.deliverable
    most = plain.pump_flow.max() * 6e4
    assert judged.status.startswith(
        f"limits kept, but the pump cannot deliver it: {most:.1f} l/min at 5.000 s, the pump gives "
        f"{0.5 * most:.1f} l/min; exceeded for "
    )
    assert judged.status_with("ls") == judged.status_with("cp") == judged.status
    assert repr(judged).startswith(f"NOT SOLVED: {judged.status}. Evaluation(slide, slide: LS ")


def test_each_pump_has_a_pressure_of_its_own_to_keep():
    """A load-sensing supply above the pump's highest pressure is nothing to a constant-pressure pump."""
    task, motion, _ = along_the_boom(1.5, -0.9)
    load = float(evaluate(task, motion).pressure.max())
    low = evaluate(weakened(task, max_pressure=load + 1e6), motion)  # the margin is 2 MPa
    assert low.status_with("cp") == "solved"
    assert low.status_with("ls").startswith(
        f"limits kept, but the pump cannot deliver it: LS supply {1e-6 * load + 2.0:.2f} MPa at "
    )
    weak = evaluate(weakened(task, constant_pressure=load - 1e6), motion)
    assert weak.status_with("ls") == "solved"
    assert f"load pressure {1e-6 * load:.2f} MPa at " in weak.status_with("cp")
    # The pump that a motion was planned for decides what its status says.
    assert low.status != "solved" and weak.status == "solved"
    planned = evaluate(weak.task, replace(motion, cost="cp"))
    assert planned.status == weak.status_with("cp") and not planned.deliverable


@pytest.mark.parametrize("share", [1.0, 0.1])
def test_load_sensing_energy_that_leaves_out_the_work_is_remarked_upon(share):
    """Slower than the driven velocity, a cylinder lifts its load for the margin alone: eq. (41), not a real pump."""
    task, motion, distance = along_the_boom(1.5, -0.9)
    slow = weakened(replace(task, machine=replace(task.machine, driven_velocity=0.2 * share)), ls_margin=0.0)
    judged = evaluate(slow, motion)
    lifted = MASS * LOADER.gravity * distance * sin(0.6)
    peak = 1.875 * distance / 10.0
    if 0.2 * share > peak:  # never driven
        assert judged.energy_ls == 0.0
        (note,) = judged.notes
        assert note == (
            f"the load-sensing energy of 0.00 kJ leaves out {1e-3 * lifted:.2f} kJ of work that cylinders do against "
            "their loads at no more than 200 mm/s, where loads do not count (driven_velocity); a constant-pressure "
            f"pump takes {1e-3 * judged.energy_cp:.2f} kJ"
        )
    else:  # driven most of the way
        assert judged.notes == ()


def test_a_lowered_load_at_any_speed_is_no_reason_for_a_remark():
    task, motion, _ = along_the_boom(1.5, -0.9)
    task = replace(task, path=Lines(task.path.points[::-1], task.path.durations))
    down = from_velocities(SAMPLE, 0.9, -motion.velocity, "slide", "ls")
    assert evaluate(replace(task, machine=replace(task.machine, driven_velocity=0.2)), down).notes == ()


# Smoothing


def rippled(frequency, amplitude=0.02, step=0.005):
    """A slow half sine out and back with a ripple on top, as velocities; the task is a tool at rest."""
    task = Task("ripple", LOADER, Lines(((2.2, 0.0, 1.2),) * 2, (4.0,)), 0.0)
    t = np.linspace(0.0, 4.0, round(4.0 / step) + 1)
    slow = 0.05 * np.sin(np.pi * t / 4.0) ** 2
    ripple = amplitude * np.sin(2.0 * np.pi * frequency * t) * np.sin(np.pi * t / 4.0) ** 2
    return task, from_velocities(step, 0.3, slow + ripple, "ripple", "ls"), t, slow


def amplitude(judged, frequency):
    """Of the extension's velocity at a frequency, in the middle two seconds."""
    t = judged.time
    inner = (t >= 1.0) & (t < 3.0)
    window = np.sin(np.pi * (t[inner] - 1.0) / 2.0) ** 2
    wave = np.exp(-2j * np.pi * frequency * t[inner])
    return 2.0 * abs(np.sum(judged.velocity[inner, -1] * window * wave)) / window.sum()


@pytest.mark.parametrize(("frequency", "gain"), [(20.0, 1 / 257), (10.0, 1 / 17), (5.0, 1 / 2), (2.5, 16 / 17)])
def test_smoothing_is_a_second_order_low_pass_run_both_ways(frequency, gain):
    """At 5 Hz, forth and back: 1 / (1 + (f / 5)^4) of the ripple stays."""
    task, motion, _, _ = rippled(frequency)
    plain, smooth = evaluate(task, motion), evaluate(replace(task, smooth=5.0), motion)
    assert amplitude(smooth, frequency) / amplitude(plain, frequency) == pytest.approx(gain, rel=0.04, abs=2e-4)


def test_smoothing_keeps_both_ends_and_the_slow_motion():
    task, motion, t, slow = rippled(20.0)
    judged = evaluate(replace(task, smooth=5.0), motion)
    c, w = judged.joint_position[:, -1], judged.velocity[:, -1]
    assert (c[0], c[-1]) == pytest.approx((motion.position[0], motion.position[-1]), abs=1e-12)
    assert (w[0], w[-1]) == pytest.approx((motion.velocity[0], motion.velocity[-1]), abs=1e-12)
    assert largest(w - np.interp(judged.time, t, slow)) < 5e-4
    assert largest(c - motion.at(judged.time)[0]) < 5e-4  # no delay
    assert judged.path_error < 1e-12


@pytest.mark.parametrize("cutoff", [1.0, 5.0])
def test_a_motion_that_ends_while_moving_keeps_its_last_velocity(cutoff):
    task, _, t, slow = rippled(20.0)
    motion = from_velocities(0.005, 0.3, slow + 0.05 * t / 4.0, "moving", "ls")
    judged = evaluate(replace(task, smooth=cutoff), motion)
    assert judged.velocity[-1, -1] == pytest.approx(0.05, abs=1e-12)
    assert judged.joint_position[-1, -1] == pytest.approx(motion.position[-1], abs=1e-12)


def test_without_smoothing_the_motion_is_judged_as_it_is():
    task, motion, _, _ = rippled(20.0)
    judged = evaluate(task, motion)
    c, w, u = motion.at(judged.time)
    assert largest(judged.velocity[:, -1] - w) < 1e-12
    assert largest(judged.joint_position[:, -1] - c) < 1e-12
    assert largest(judged.acceleration[:, -1] - u) < 1e-12


def test_smoothed_velocity_and_position_belong_together():
    task, motion, _, _ = rippled(10.0)
    judged = evaluate(replace(task, smooth=5.0), motion)
    c, w, u = judged.joint_position[:, -1], judged.velocity[:, -1], judged.acceleration[:, -1]
    assert largest((c[2:] - c[:-2]) / 0.004 - w[1:-1]) < 2e-5
    assert largest((w[2:] - w[:-2]) / 0.004 - u[1:-1]) < 1e-9


# Result


def test_evaluations_are_read_only_and_describe_themselves():
    task, motion, _ = along_the_boom(1.5, -0.9)
    judged = evaluate(task, motion)
    arrays = [getattr(judged, name) for name in judged.__slots__ if isinstance(getattr(judged, name), np.ndarray)]
    assert len(arrays) == 19
    assert all(not array.flags.writeable for array in arrays)
    use = judged.limit_use
    assert repr(judged) == (
        f"Evaluation(slide, slide: LS {judged.energy_ls / 1e3:.2f} kJ, CP {judged.energy_cp / 1e3:.2f} kJ, "
        f"limit use {use.position:.3f}/{use.velocity:.3f}/{use.acceleration:.3f}, solved)"
    )


@pytest.mark.parametrize("name", ["LS", "velocity", "", "actuator"])
def test_energy_is_known_of_the_two_pumps_alone(name):
    """Any other name used to be answered with the constant-pressure pump's energy."""
    judged = evaluate(TASKS["loader-triangle-small"], rest(TASKS["loader-triangle-small"], 0.6))
    with pytest.raises(InputError, match=f"pump = {name}; must be one of ls, cp"):
        judged.energy(name)
