"""Pseudo-inverses: the saturation against hand-worked cases and a linear programme, the motions against the judge."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog, lsq_linear

import saturation
from bundled_texts import SINGLE
from leanboom.errors import InfeasibleError, InputError
from leanboom.evaluation.evaluate import evaluate
from leanboom.io.loading import load_task
from leanboom.methods import pseudo_inverse
from leanboom.model import crane as cranes
from leanboom.model.task import sample
from leanboom.problem import stages

TASKS = SINGLE


def start_of(problem, name):
    low, high = problem.lower[0], problem.upper[0]
    return float(low if name == "smallest" else 0.5 * (low + high))


def areas(task):
    cylinders = task.machine.cylinders
    return np.array([c.piston_area for c in cylinders]), np.array([c.rod_side_area for c in cylinders])


@pytest.mark.parametrize(
    ("wanted", "upper", "velocity", "scale"),
    [
        (1.5, [1.0, 1.0, 1.0], [0.5, 0.5, 0.5], 1.0),  # nothing saturates: x / 3 each
        (2.4, [0.5, 1.0, 1.0], [0.5, 0.95, 0.95], 1.0),  # one saturates, the others share the rest
        (2.4, [0.5, 0.8, 2.0], [0.5, 0.8, 1.1], 1.0),  # two saturate, one after the other
        (6.0, [1.0, 1.0, 1.0], [1.0, 1.0, 1.0], 0.5),  # all at their limits: half the task
    ],
)
def test_saturation_worked_by_hand(wanted, upper, velocity, scale):
    found, s = saturation.sns(np.ones((1, 3)), np.array([wanted]), -np.ones(3), np.array(upper))
    np.testing.assert_allclose(found, velocity, atol=1e-12)
    assert s == pytest.approx(scale)


def test_weights_by_hand():
    """Eq. (9): with one row of ones the velocities go as 1 / W."""
    found, scale = saturation.sns(np.ones((1, 2)), np.array([3.0]), -9 * np.ones(2), 9 * np.ones(2), np.array([1, 2]))
    np.testing.assert_allclose(found, [2.0, 1.0])
    assert scale == 1.0


def test_a_joint_saturated_too_early_is_freed_again():
    """Greedy saturation runs out of joints here, though [2, 3, 0] follows the task: 4-3+0 = 1, 4+6-0 = 10."""
    jacobian = np.array([[2.0, -1.0, 1.0], [2.0, 2.0, -1.0]])
    found, scale = saturation.sns(jacobian, np.array([1.0, 10.0]), np.array([-2, -1, -1]), np.array([2, 3, 3]))
    np.testing.assert_allclose(found, [2.0, 3.0, 0.0], atol=1e-8)
    assert scale == pytest.approx(1.0)


def test_saturation_against_a_linear_programme(rng):
    """Bounds kept, tool moved by scale times the task, and the scale is the largest that the box has."""
    saturated = scaled = 0
    for trial in range(150):
        rows = int(rng.integers(1, 4))
        joints = rows + int(rng.integers(0, 4))
        jacobian, wanted = rng.normal(size=(rows, joints)), rng.normal(size=rows) * rng.uniform(0.1, 4.0)
        lower, upper = -rng.uniform(0.0, 1.0, joints), rng.uniform(0.1, 1.0, joints)
        weights = rng.uniform(0.2, 5.0, joints) if trial % 2 else None
        velocity, scale = saturation.sns(jacobian, wanted, lower, upper, weights)
        largest = linprog(
            np.append(np.zeros(joints), -1.0),
            A_eq=np.hstack([jacobian, -wanted[:, None]]),
            b_eq=np.zeros(rows),
            bounds=[*zip(lower, upper, strict=True), (0.0, 1.0)],
        ).x[-1]
        assert np.all(velocity >= lower) and np.all(velocity <= upper)
        np.testing.assert_allclose(jacobian @ velocity, scale * wanted, atol=1e-7)
        assert scale == pytest.approx(largest, abs=1e-6)
        metric = np.ones(joints) if weights is None else weights
        inverse = jacobian.T / metric[:, None]
        plain = inverse @ np.linalg.solve(jacobian @ inverse, wanted)
        if np.all(plain > lower) and np.all(plain < upper):
            np.testing.assert_allclose(velocity, plain, atol=1e-10)
        saturated += scale == 1.0 and not np.allclose(velocity, plain)
        scaled += scale < 1.0
    assert saturated > 10 and scaled > 10  # the trials cover all cases


def test_least_norm_against_bounded_least_squares(rng):
    for _ in range(40):
        jacobian, weights = rng.normal(size=(2, 5)), rng.uniform(0.2, 5.0, 5)
        upper = rng.uniform(0.2, 1.0, 5)
        seed = rng.uniform(-upper, upper)
        found = saturation._least_norm(jacobian, -upper, upper, 1.0 / weights, seed)
        np.testing.assert_allclose(jacobian @ found, jacobian @ seed, atol=1e-9)
        system = np.vstack([1e4 * jacobian, np.diag(np.sqrt(weights))])
        oracle = lsq_linear(system, np.append(1e4 * jacobian @ seed, np.zeros(5)), (-upper, upper), tol=1e-13).x
        assert found @ (weights * found) <= oracle @ (weights * oracle) + 1e-6


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"task_velocity": np.ones(2)}, "needs a task velocity of 1"),
        ({"lower": 2.0 * np.ones(3)}, "lower bound of joint 0"),
        ({"weights": np.array([1.0, 0.0, 1.0])}, "weights must be above 0"),
        ({"jacobian": np.zeros((1, 3))}, "depend on each other"),
    ],
)
def test_wrong_input_is_named(changes, message):
    good = {"jacobian": np.ones((1, 3)), "task_velocity": np.ones(1), "lower": -np.ones(3), "upper": np.ones(3)}
    with pytest.raises(InputError, match=message), np.errstate(divide="ignore"):
        saturation.sns(**(good | changes))


def test_a_box_without_an_answer_is_said():
    with pytest.raises(InfeasibleError, match="holds it still"):
        saturation.sns(np.ones((1, 2)), np.array([-1.0]), np.ones(2), 2.0 * np.ones(2))


@pytest.mark.parametrize("name", ["forwarder-vertical", "loader-triangle-large"])
def test_closed_form_equals_the_general_saturation(name, rng):
    """On a crane, clipping to the interval of allowed velocities is `sns` with the crane's Jacobian."""
    task = load_task(name)
    problem = stages.discretise(task, 0.1)
    n = len(task.machine.cylinders) - problem.moving.start
    limit = np.array([c.velocity_limit for c in task.machine.cylinders])[problem.moving]
    clipped = 0
    for k in rng.integers(1, problem.stages, 25):
        stroke = rng.uniform(problem.lower[k], problem.upper[k])
        pose = cranes.pose(problem.crane, problem.plane[k], stroke)
        arms = np.array([arm for _, arm, _ in pose.cylinders])[problem.moving]
        jacobian = np.array(pose.jacobian).reshape(2, n) / arms  # tool velocity per cylinder velocity
        tool = 2.5 * np.array([problem.plane.vr[k], problem.plane.vz[k]])  # hurried, so that limits are met
        plane = cranes.Plane(problem.plane.r[k], problem.plane.z[k], *tool, 0.0, 0.0)
        line = pseudo_inverse.velocity_line(problem.crane, plane, stroke)
        low, high = pseudo_inverse.velocity_bounds(problem, line)
        if low >= high:
            continue
        free = pseudo_inverse.least_velocity(line, "actuator", *areas(task))
        velocity, scale = saturation.sns(jacobian, tool, -limit, limit)
        assert scale == pytest.approx(1.0)
        assert velocity[-1] == pytest.approx(min(max(free, low), high), abs=1e-9)
        clipped += not low < free < high
    assert clipped > 0


@pytest.mark.parametrize("variant", pseudo_inverse.METHODS)
def test_least_velocity_against_a_search(variant, rng):
    task = load_task("loader-triangle-large")
    problem = stages.discretise(task, 0.5)
    out, back = areas(task)
    for k in rng.integers(1, problem.stages, 10):
        stroke = rng.uniform(problem.lower[k], problem.upper[k])
        line = pseudo_inverse.velocity_line(problem.crane, problem.plane[k], stroke)
        found = pseudo_inverse.least_velocity(line, variant, out, back)
        w = found + np.linspace(-0.1, 0.1, 2001)[:, None]
        joint, cylinder = line.joint0 + line.joint1 * w, line.cylinder0 + line.cylinder1 * w
        norm = {
            "joint": joint**2,
            "actuator": cylinder**2,
            "weighted": np.where(cylinder > 0.0, out, back) * cylinder**2,
        }[variant].sum(axis=1)
        assert int(norm.argmin()) == 1000


@pytest.mark.parametrize("start", ["smallest", "middle"])
@pytest.mark.parametrize("name", TASKS)
def test_motions_stay_on_the_path_and_inside_position_and_velocity_limits(name, start):
    task = load_task(name)
    motion = pseudo_inverse.resolve(task, start_of(stages.discretise(task, 0.05), start), "actuator", step=0.02)
    judged = evaluate(task, motion)
    assert judged.path_error < 1e-6
    assert judged.limit_use.position <= 1.001
    assert judged.limit_use.velocity <= 1.001
    assert motion.velocity[0] == motion.velocity[-1] == 0.0
    assert abs(motion.velocity[-2]) < 2e-3  # comes to rest by itself


@pytest.mark.parametrize("variant", ["joint", "weighted"])
@pytest.mark.parametrize("name", ["forwarder-horizontal", "loader-triangle-medium"])
def test_other_norms_keep_limits_too(name, variant):
    task = load_task(name)
    motion = pseudo_inverse.resolve(task, start_of(stages.discretise(task, 0.05), "smallest"), variant, step=0.02)
    judged = evaluate(task, motion)
    assert max(judged.path_error * 1e3, judged.limit_use.position, judged.limit_use.velocity) <= 1.001


def test_vertical_path_of_the_4dof_crane():
    """Judged energies of the actuator pseudo-inverse from the smallest extension, to 1 %."""
    task = load_task("forwarder-vertical")
    motion = pseudo_inverse.resolve(task, start_of(stages.discretise(task, 0.05), "smallest"))
    judged = evaluate(task, motion)
    assert judged.energy_cp == pytest.approx(53.7e3, rel=0.01)
    assert judged.energy_ls == pytest.approx(17.2e3, rel=0.01)
    assert (motion.method, motion.cost) == ("sns-actuator", "velocity")


def test_midpoint_rule_is_of_second_order():
    """Halving the step quarters the change of the end position, where no limit is met."""
    task = load_task("forwarder-vertical")
    start = start_of(stages.discretise(task, 0.05), "middle")
    ends = [pseudo_inverse.resolve(task, start, step=step).position[-1] for step in (0.08, 0.04, 0.02, 0.01)]
    changes = np.abs(np.diff(ends))
    assert np.all(np.log2(changes[:-1] / changes[1:]) > 1.5)


def test_foresight_is_what_keeps_the_velocity_limit():
    """On the large triangle the feasible extensions shrink faster than the cylinder moves: it must leave in time."""
    task = load_task("loader-triangle-large")
    problem = stages.discretise(task, 0.02)
    middle = cranes.plane(task.machine, sample(task, problem.time[:-1] + 0.5 * problem.step))
    points = [middle[k] for k in range(problem.stages)]
    viable = pseudo_inverse.viable_strokes(problem, middle, points)
    moved_in = viable[:, 0] - problem.lower
    assert moved_in.max() > 0.005
    fastest = task.machine.redundant.velocity_limit
    assert np.diff(problem.lower).max() / problem.step > 1.1 * fastest
    assert np.diff(viable[:, 0]).max() / problem.step <= 1.001 * fastest


def test_unknown_variant_is_named():
    with pytest.raises(InputError, match="variant = other; must be one of joint, actuator, weighted"):
        pseudo_inverse.resolve(load_task("forwarder-vertical"), 0.5, "other")
