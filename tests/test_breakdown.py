"""Where energy goes: parts worked out by hand, and parts that sum to the judge's energy whatever the motion."""

from __future__ import annotations

from dataclasses import fields, replace
from math import sin

import numpy as np
import pytest

from leanboom.components.pumps import EfficiencyMap
from leanboom.evaluation.energy_breakdown import Breakdown, breakdown
from leanboom.evaluation.evaluate import SAMPLE, evaluate
from leanboom.formulas import kinematics
from leanboom.io.loading import load_machine, load_task
from leanboom.model import motion
from leanboom.model.task import Lines, Task

LOADER = load_machine("loader")
NEAR, FAR, LASTS, PAYLOAD = 0.1, 0.9, 10.0, 475.0
MASS = 95.19 + PAYLOAD  # what the extension moves


def slide(back=False, **pump):
    """The loader's telescope slides its tool along a rising boom, out or back; nothing else moves."""
    g, (q2, q3) = LOADER.geometry, (1.5, -0.9)
    ends = [kinematics.tool_point(q2, q3, q4, g.base_x, g.base_z, g.boom, g.offset, g.outer) for q4 in (NEAR, FAR)]
    points = tuple((r, 0.0, z) for r, z in ends)
    machine = replace(LOADER, driven_velocity=1e-5, pump=replace(LOADER.pump, **pump))
    task = Task("slide", machine, Lines(points[::-1] if back else points, (LASTS,)), PAYLOAD)
    t = np.linspace(0.0, 1.0, round(LASTS / SAMPLE) + 1)
    speed = (FAR - NEAR) * 30.0 * t**2 * (1.0 - t) ** 2 / LASTS * (-1.0 if back else 1.0)
    return evaluate(task, motion.from_velocities(SAMPLE, FAR if back else NEAR, speed, "slide", "ls"))


def test_sliding_a_load_up_is_work_and_margin():
    judged = slide()
    found = breakdown(judged, "ls")
    lifted = MASS * LOADER.gravity * (FAR - NEAR) * sin(0.6)
    volume = LOADER.cylinders[-1].piston_area * (FAR - NEAR)
    assert found.work == pytest.approx(lifted, rel=1e-4)
    assert found.margin == pytest.approx(2e6 * volume, rel=1e-5)
    nothing = 1e-4 * judged.energy_ls
    assert max(found.back_pressure, found.throttled, found.lowered, found.pump) < nothing


def test_with_constant_pressure_what_the_load_does_not_need_is_throttled():
    found = breakdown(slide(), "cp")
    lifted = MASS * LOADER.gravity * (FAR - NEAR) * sin(0.6)
    volume = LOADER.cylinders[-1].piston_area * (FAR - NEAR)
    assert found.work == pytest.approx(lifted, rel=1e-4) and found.margin == 0.0
    assert found.throttled == pytest.approx(20e6 * volume - lifted, rel=1e-4)


def test_a_lowered_load_gives_the_pump_nothing_and_its_oil_is_throttled():
    found = breakdown(slide(back=True), "cp")
    volume = LOADER.cylinders[-1].rod_side_area * (FAR - NEAR)
    assert found.lowered == pytest.approx(20e6 * volume, rel=1e-4)
    assert found.work == pytest.approx(0.0, abs=1.0) and found.throttled == pytest.approx(0.0, abs=1.0)


def test_an_efficiency_is_the_pumps_loss():
    found, whole = breakdown(slide(efficiency=0.8), "ls"), breakdown(slide(), "ls")
    assert found.pump == pytest.approx(0.25 * whole.total, rel=1e-9)
    assert found.work == pytest.approx(whole.work, rel=1e-12)


@pytest.mark.parametrize("name", ["forwarder-half-cycle", "loader-triangle-small"])
@pytest.mark.parametrize("pump", ["ls", "cp"])
def test_the_parts_sum_to_the_energy_and_none_is_negative(name, pump):
    """Regenerative, single-acting and standard cylinders, an efficiency map with losses of its own, a moving boom."""
    task = load_task(name)
    total = tuple(tuple(0.6 + 0.1 * i + 0.02 * j for j in range(3)) for i in range(3))
    measured = EfficiencyMap(30.0, (30.0,), (20e-6, 60e-6, 100e-6), (5e6, 15e6, 25e6), (total,))
    task = replace(task, machine=replace(task.machine, pump=replace(task.machine.pump, efficiency=measured)))
    t = np.linspace(0.0, task.duration, 201)
    speed = 0.05 * np.sin(2.0 * np.pi * t / task.duration * 2.0)
    judged = evaluate(task, motion.from_velocities(t[1], 0.6, speed, "swing", "ls"))
    found = breakdown(judged, pump)
    assert judged.energy(pump) > 0.0
    assert found.total == pytest.approx(judged.energy(pump), rel=1e-12)
    assert all(getattr(found, field.name) >= -1e-9 * found.total for field in fields(Breakdown))
    assert found.pump > 0.0 and found.work > 0.0 and found.lowered > 0.0
