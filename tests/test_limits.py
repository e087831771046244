"""Use of limits: a retracted telescope is at its end and no alarm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from leanboom.evaluation import limits
from leanboom.evaluation.evaluate import evaluate
from leanboom.io.loading import load_task
from leanboom.model import motion
from leanboom.problem import starts


@pytest.fixture(scope="module")
def judged():
    """The forwarder's vertical path from the shortest extension, then held: tilt starts at an end of its stroke."""
    task = load_task("forwarder-vertical")
    from leanboom.problem import stages

    start = starts.start_position(stages.discretise(task, 0.05), "smallest")
    return evaluate(task, motion.from_velocities(0.1, start, np.zeros(61), "dp", "ls"))


def test_uses_agree_with_the_judge(judged):
    use = judged.limit_use
    np.testing.assert_allclose(limits.uses(judged).max(axis=1), [use.position, use.velocity, use.acceleration])


def test_a_cylinder_at_its_end_is_said_to_be_there(judged):
    """`position 100 % used` once stood beside `all kept`, for a cylinder that merely starts retracted."""
    assert judged.limit_use.position == pytest.approx(1.0, abs=1e-3)
    found = limits.ends(judged)
    assert set(found) == {"tilt"}
    shorter = judged.length[0, 2] <= judged.length[:, 2].mean()
    assert found["tilt"] == ("retracted" if shorter else "extended")
    text = limits.nearest(judged)
    assert text.startswith(("velocity ", "acceleration ")) and "position" not in text
    assert text.endswith(f"; tilt at its end: {found['tilt']}")


def test_a_broken_position_limit_is_no_end(judged):
    joints = list(judged.task.machine.joints)
    middle = 0.5 * (joints[2].lower + joints[2].upper)
    joints[2] = replace(joints[2], **{"lower" if judged.joint_position[0, 2] < middle else "upper": middle})
    task = replace(judged.task, machine=replace(judged.task.machine, joints=tuple(joints)))
    assert "tilt" not in limits.ends(evaluate(task, judged.motion))
