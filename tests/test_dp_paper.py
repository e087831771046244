"""Algorithm 1: interpolation, enumeration of all controls on a tiny problem, one state worked with plain numbers."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from leanboom.errors import InputError
from leanboom.evaluation.evaluate import evaluate
from leanboom.io.loading import load_task
from leanboom.methods import dp_paper
from leanboom.model import crane as cranes
from leanboom.problem import stages


def lattice(cost, stages_=3):
    """A problem whose Euler steps land on nodes: controls move the velocity by -1, 0 or 1 node, it the position."""
    task = load_task("forwarder-vertical")
    program = dp_paper.model(task, cost, (9, 3, 3), task.duration / stages_)
    spacing = program.positions[1] - program.positions[0]
    step = program.problem.step
    # Choose the normalising values so that one velocity node is one position node a step, one control node one
    # velocity node a step.
    c_max = program.scale[0]
    v_max = spacing * c_max / step
    return replace(program, scale=(c_max, v_max, v_max / step))


@pytest.mark.parametrize("cost", ["ls", "cp", "actuator", "velocity", "extension", "recuperation"])
def test_equals_enumeration_of_all_controls(cost):
    program = lattice(cost)
    start, table = dp_paper.backward(program)
    c, v, a = program.positions[:, None, None], program.velocities[:, None], program.controls[None, :]
    prices = [dp_paper.running_cost(program, k, c, v, a) * np.ones((9, 3, 3)) for k in range(3)]
    for i, j in itertools.product(range(9), range(3)):
        totals = {}
        for choice in itertools.product(range(3), repeat=3):
            x, y, total = i, j, 0.0
            for k, control in enumerate(choice):
                total += prices[k][x, y, control]
                x, y = x + (y - 1), y + (control - 1)
                total += program.penalty * ((not 0 <= x <= 8) + (not 0 <= y <= 2))
                x, y = min(max(x, 0), 8), min(max(y, 0), 2)
            totals[choice] = total
        assert start[i, j] == pytest.approx(min(totals.values()), rel=1e-9)
        chosen = int(np.argmin(np.abs(program.controls - table[0, i, j])))
        assert min(t for choice, t in totals.items() if choice[0] == chosen) == pytest.approx(start[i, j], rel=1e-9)


def test_forward_simulation_pays_the_cost_to_go():
    """On the lattice nothing is interpolated, so the stage costs along the motion add up to J_0."""
    program = lattice("cp")
    start, table = dp_paper.backward(program)
    first = int(start[:, 1].argmin())
    c, v, a = dp_paper.forward(program, table, program.scale[0] * program.positions[first])
    total = sum(float(dp_paper.running_cost(program, k, c[k], v[k], a[k])) for k in range(3))
    assert total == pytest.approx(start[first, 1], rel=1e-9)
    np.testing.assert_allclose(np.diff(c), program.problem.step * program.scale[1] / program.scale[0] * v[:-1])


def test_blocks_of_positions_do_not_change_the_result(monkeypatch, rng):
    program = dp_paper.model(load_task("loader-triangle-large"), "ls", (13, 7, 5), 1.0)
    ahead = rng.uniform(0.0, 1e4, (13, 7))
    whole = dp_paper.backward_stage(program, 3, ahead)
    monkeypatch.setattr(dp_paper, "BLOCK", 70)  # two positions at a time
    for a, b in zip(whole, dp_paper.backward_stage(program, 3, ahead), strict=True):
        np.testing.assert_array_equal(a, b)


def test_one_state_worked_with_plain_numbers(rng):
    """Lines 5-13 at one state, each control by itself with scalars, J_{k+1} interpolated by SciPy."""
    from scipy.interpolate import RegularGridInterpolator

    program = dp_paper.model(load_task("loader-triangle-large"), "cp", (21, 11, 7), 0.5)
    ahead = rng.uniform(0.0, 1e4, (21, 11))
    value = RegularGridInterpolator((program.positions, program.velocities), ahead)
    best, chosen = dp_paper.backward_stage(program, 8, ahead)
    problem, machine = program.problem, program.problem.task.machine
    i, j = 9, 6
    c, v = program.positions[i], program.velocities[j]
    totals = []
    for a in program.controls:
        pose = cranes.pose(problem.crane, problem.plane[8], c * 1.04)
        moving = cranes.move(pose, 0.2 * v, 0.5 * a)
        flow = sum(
            max(x.piston_area * w, -x.rod_side_area * w)
            for x, w in zip(machine.cylinders, moving.velocity, strict=True)
        )
        broken = sum(abs(w) > 0.2 for w in moving.velocity) + sum(abs(w) > 0.5 for w in moving.acceleration)
        c_next, v_next = c + 0.5 * 0.2 / 1.04 * v, v + 0.5 * 0.5 / 0.2 * a
        broken += abs(v_next) > 1.0
        later = value((min(max(c_next, 0.0), 1.0), min(max(v_next, -1.0), 1.0)))
        totals.append(20e6 * flow + program.penalty * broken + float(later))
    assert best[i, j] == pytest.approx(min(totals), rel=1e-9)
    assert chosen[i, j] == program.controls[int(np.argmin(totals))]


def test_interpolation_is_exact_for_bilinear_tables_and_held_outside():
    program = dp_paper.model(load_task("forwarder-vertical"), "cp", (7, 5, 3), 1.0)
    table = 2.0 + 3.0 * program.positions[:, None] - program.velocities + 4.0 * np.outer(*_states(program))
    c, v = np.array([0.0, 0.31, 0.98, 1.0]), np.array([-1.0, 0.2, -0.77, 1.0])
    np.testing.assert_allclose(dp_paper.interpolate(program, table, c, v), 2 + 3 * c - v + 4 * c * v, atol=1e-12)
    assert dp_paper.interpolate(program, table, 1.4, -3.0) == pytest.approx(table[-1, 0])


def _states(program):
    return program.positions, program.velocities


def test_plan_follows_the_path_inside_the_limits_and_reports_progress():
    task = load_task("forwarder-vertical")
    problem = stages.discretise(task, 0.1)
    shares = []
    start = float(0.5 * (problem.lower[0] + problem.upper[0]))
    motion = dp_paper.plan(task, "cp", start, lambda _, share: shares.append(share), grid=(41, 31, 15), step=0.1)
    judged = evaluate(task, motion)
    assert judged.path_error < 1e-6
    assert judged.limit_use.position <= 1.001
    assert judged.limit_use.velocity <= 1.001
    assert judged.energy_cp < 32e3  # less than any pseudo-inverse from there
    assert motion.position[0] == start and motion.velocity[0] == 0.0
    assert (motion.method, motion.cost) == ("dp-paper", "cp")
    assert shares == sorted(shares) and len(shares) == problem.stages and shares[-1] == 1.0


def test_default_grids_are_the_papers():
    assert dp_paper.default_grid(load_task("forwarder-vertical")) == (356, 101, 151)
    assert dp_paper.default_grid(load_task("loader-triangle-small")) == (125, 101, 201)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [({"cost": "fuel"}, "cost = fuel; must be one of ls"), ({"grid": (9, 1, 9)}, "grid = 9x1x9")],
)
def test_wrong_input_is_named(arguments, message):
    with pytest.raises(InputError, match=message):
        dp_paper.plan(**({"task": load_task("forwarder-vertical"), "cost": "cp", "start": 0.5} | arguments))
