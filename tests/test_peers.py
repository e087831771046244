"""The peers' benchmark: node-to-node programs against brute force, splines, the table, and who is absent."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from benchmarks.peers import adaptive_mesh, child, node_to_node, roster, via_points
from benchmarks.peers.__main__ import run
from benchmarks.peers.table import Measured, lines

from leanboom.dynamic_programming import value_function
from leanboom.errors import InfeasibleError
from leanboom.evaluation.evaluate import evaluate
from leanboom.io.loading import load_task
from leanboom.methods.registry import METHODS, Settings
from leanboom.model import crane as cranes
from leanboom.model.task import sample
from leanboom.problem import cost_scale, stages, starts
from leanboom.progress import quiet


@pytest.fixture(scope="module")
def problem() -> stages.Problem:
    return stages.discretise(load_task("forwarder-vertical", start="middle"), 0.5)


def test_the_cheapest_path_is_that_of_all_paths(rng):
    """Five layers of one to four nodes, a third of the edges missing."""
    sizes = [1, 4, 3, 4, 2]
    for _ in range(20):
        edges = [rng.uniform(size=(a, b)) for a, b in itertools.pairwise(sizes)]
        edges = [np.where(rng.uniform(size=e.shape) < 0.33, np.inf, e) for e in edges]
        every = {
            path: sum(edge[i, j] for edge, i, j in zip(edges, path[:-1], path[1:], strict=True))
            for path in itertools.product(*map(range, sizes))
        }
        path, cost = node_to_node.cheapest_path(sizes, edges.__getitem__)
        assert cost == pytest.approx(min(every.values()))
        assert math.isinf(cost) or every[tuple(path.tolist())] == cost


def test_the_whole_program_is_that_of_all_paths(problem):
    """Three stages of the crane itself: the same path by trying all."""
    start = starts.start_position(problem, "middle")
    nodes = node_to_node.feasible_nodes(problem, start, 4)[:4]
    powers = [node_to_node.edge_power(problem, "ls", k, nodes[k], nodes[k + 1]) for k in range(3)]
    assert nodes[0].tolist() == [start]
    totals = {p: powers[0][0, p[0]] + powers[1][p[0], p[1]] + powers[2][p[1], p[2]] for p in np.ndindex(4, 4, 4)}
    path, cost = node_to_node.cheapest_path([n.size for n in nodes], powers.__getitem__)
    assert cost == min(totals.values()) == totals[tuple(path[1:].tolist())]


def test_edges_are_as_fast_as_their_ends_are_apart_and_no_faster_than_allowed(problem):
    here = np.linspace(problem.lower[3], problem.upper[3], 6)
    there = np.linspace(problem.lower[4], problem.upper[4], 5)
    power = node_to_node.edge_power(problem, "cp", 3, here, there)
    assert power.shape == (6, 5)
    lengths = [
        np.array([np.broadcast_to(c[0], n.shape) for c in cranes.pose(problem.crane, problem.plane[k], n).cylinders])
        for k, n in ((3, here), (4, there))
    ]
    speed = np.abs(lengths[1][:, None, :] - lengths[0][:, :, None]) / problem.step
    limits = np.array([c.velocity_limit for c in problem.crane.machine.cylinders])
    possible = np.all(speed <= limits[:, None, None] * (1.0 + 1e-9), axis=0)
    assert possible.any() and not possible.all()
    np.testing.assert_array_equal(np.isfinite(power), possible)
    assert np.all(power[possible] > 0.0)


def test_a_path_of_nodes_becomes_a_motion_through_them_at_rest_at_both_ends(rng):
    position = 0.5 + 0.01 * np.cumsum(rng.normal(size=9))
    motion = node_to_node.through_nodes(0.2, position, "cp")
    assert motion.position[::2] == pytest.approx(position, abs=1e-12)
    assert motion.velocity[0] == motion.velocity[-1] == 0.0


def test_no_path_is_an_error(problem, monkeypatch):
    """The two ends of the feasible extensions are too far from the middle."""
    monkeypatch.setattr(node_to_node, "NODES", 2)
    with pytest.raises(InfeasibleError, match="no path over 2 nodes a stage keeps the velocity limits"):
        node_to_node.plan(problem.task, "cp", starts.start_position(problem, "middle"), quiet, Settings())


def test_splines_keep_the_start_and_end_at_rest(rng):
    task = load_task("forwarder-vertical")
    fine = stages.discretise(task, via_points.STEP)
    shares = rng.uniform(0.3, 0.6, size=via_points.POINTS)
    motion = via_points.spline_motion(fine, 1.0, shares, "ls")
    assert motion.position[0] == 1.0
    assert motion.velocity[0] == motion.velocity[-1] == 0.0
    assert via_points.shares_of(fine, motion) == pytest.approx(shares, abs=1e-3)


def test_the_price_rises_with_every_limit_used_too_far_and_beyond_reach():
    task = load_task("forwarder-vertical", start="middle")
    fine = stages.discretise(task, via_points.STEP)
    start = starts.start_position(fine, "middle")
    scale = cost_scale.energy_scale(fine, "cp")

    def price(shares):
        judged = evaluate(task, via_points.spline_motion(fine, start, shares, "cp"))
        return judged, via_points.priced(fine, judged, "cp", scale)

    calm, wild = np.full(via_points.POINTS, 0.5), np.tile([0.3, 0.7], via_points.POINTS // 2)
    judged, least = price(calm)
    assert judged.feasible and least == judged.energy_cp / scale
    judged, more = price(wild)
    assert not judged.feasible and more > judged.energy_cp / scale + via_points.PENALTY * (judged.limit_use.worst - 1)
    judged, most = price(np.full(via_points.POINTS, 9.0))
    assert not judged.followed and via_points.UNREACHED < most < np.inf


@pytest.mark.parametrize("name", ["forwarder-half-cycle", "loader-triangle-large", "forwarder-horizontal"])
def test_paths_as_polynomials_are_the_paths(name):
    """Straight segments and splines, with their velocities and accelerations."""
    task = load_task(name)
    for piece in adaptive_mesh.pieces(task):
        time = np.linspace(piece.begin, piece.end, 7)[1:-1]
        found = adaptive_mesh.on_path(piece.coefficients, time - piece.begin)
        reference = sample(task, time)
        for values, wanted in zip(found, (reference.point, reference.velocity, reference.acceleration), strict=True):
            np.testing.assert_allclose(np.stack(np.broadcast_arrays(*values), axis=1), wanted, atol=1e-9)


@pytest.mark.slow
def test_maptor_plans_what_collocation_plans(monkeypatch):
    """On the first mesh and level, within 3 % of the optimum: neighbouring intervals of its answer share a point."""
    pytest.importorskip("maptor")
    monkeypatch.setattr(adaptive_mesh, "MESHES", 1)
    monkeypatch.setattr(adaptive_mesh, "LEVELS", adaptive_mesh.LEVELS[:1])
    task = load_task("forwarder-vertical", start="middle")
    start = starts.start_position(stages.discretise(task, 0.05), "middle")
    motion = adaptive_mesh.plan(task, "cp", start, quiet, Settings())
    judged = evaluate(task, motion)
    assert motion.position[0] == start and judged.feasible
    assert 20.0e3 < judged.energy_cp < 1.03 * 20.05e3
    assert motion.log == ("1 meshes, 20 points in the last, its error above the aim",)


def test_the_table_is_relative_to_dp_and_marks_broken_limits():
    rows = [
        Measured("dp", 2.0, 100 * 2**20, 5000.0, 1.0, True, "solved"),
        Measured("via-points", 100.0, 150 * 2**20, 6000.0, 1.25, False, "velocity of lift | too high"),
        Measured("adaptive-mesh", remark="skipped"),
    ]
    table = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines(rows)]
    assert table[2] == ["dp", "2.0", "1.0", "100", "5.00", "+0.0 %", "1.000", "solved"]
    assert table[3] == ["via-points", "100.0", "50.0", "150", "6.00 (!)", "+20.0 %", "1.250",
                        "velocity of lift / too high"]  # fmt: skip
    assert table[4] == ["adaptive-mesh", "", "", "", "", "", "", "skipped"]
    assert len({len(line) for line in lines(rows)}) == 1
    alone = lines(rows[1:])
    assert "nan" not in "".join(alone) and "+" not in alone[2]


def test_an_absent_package_is_named(monkeypatch):
    monkeypatch.setattr(roster, "find_spec", lambda name: None if name == "cma" else True)
    assert roster.absent("via-points") == "skipped: package cma is not installed (extra `peers`)"
    assert roster.absent("dp") == ""
    row = run("forwarder-vertical", "smallest", "cp", "via-points", 1)
    assert row.remark.startswith("skipped: package cma") and math.isnan(row.seconds)


def test_a_peer_that_takes_too_long_is_stopped():
    row = run("forwarder-vertical", "smallest", "cp", "dp-paper", 1)
    assert row.remark == "stopped after 1 s, 0% done"


@pytest.fixture
def registered():
    """What a peer's process adds to the registry is taken out again."""
    yield
    METHODS.added.clear()


def test_a_peer_is_measured(monkeypatch, registered):
    """Without loading the kernels, which this peer does not use."""
    monkeypatch.setattr(value_function, "prepare", lambda: None)
    monkeypatch.setattr(node_to_node, "NODES", 41)
    row = child.measure("forwarder-vertical", "smallest", "cp", "node-to-node")
    assert row.energy > 0.0 and row.seconds > 0.0 and row.peak_bytes > 2**20 and row.remark


def test_a_start_that_peers_do_not_know_is_a_row(monkeypatch, registered):
    monkeypatch.setattr(value_function, "prepare", lambda: None)
    assert child.measure("forwarder-vertical", "best", "cp", "node-to-node").remark.startswith("start = best")
