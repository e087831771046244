"""Edges of cells: on the velocities at which cylinders begin to be driven, and no state falls between two levels."""

from dataclasses import replace

import numpy as np
import pytest

from leanboom import load_task
from leanboom.certificate import cell_enclosures, lower_bounds, partition, position_rows
from leanboom.model import crane as cranes
from leanboom.model import motion
from leanboom.problem import layout, stages
from leanboom.problem.legs import Legs


@pytest.fixture(scope="module")
def problem():
    return stages.discretise(replace(load_task("loader-triangle-small"), start="smallest"), 0.5)


def nominal(kept: partition.Cells, k: int) -> np.ndarray:
    lattice = kept.lattice[k]
    return (
        lattice[cell_enclosures.L_W]
        + (lattice[cell_enclosures.L_J] + np.arange(kept.edges[k].shape[1])) * lattice[cell_enclosures.L_DW]
    )


def test_constant_pressure_leaves_the_lattice(problem):
    kept = partition.whole(Legs((problem,)), "cp")
    for k in range(problem.stages):
        assert np.array_equal(kept.edges[k], np.tile(nominal(kept, k), (kept.positions, 1)))


def test_moved_edges_are_where_cylinders_surely_begin_to_be_driven(problem, rng):
    """Against the crane's own velocities at random positions of the row."""
    kept = partition.whole(Legs((problem,)), "ls")
    threshold = problem.crane.machine.driven_velocity
    moved = 0
    for k in range(0, problem.stages, 5):
        lattice, edges = kept.lattice[k], kept.edges[k]
        shift = edges - nominal(kept, k)
        assert np.all(np.diff(edges, axis=1) > 0.0)
        assert np.abs(shift).max() <= cell_enclosures.SNAP * lattice[cell_enclosures.L_DW]
        for p, r in rng.permutation(np.argwhere(np.abs(shift) > 1e-12))[:20]:
            c = np.linspace(*kept.rows[k][p : p + 2], 9)
            pose = cranes.pose(problem.crane, problem.plane[np.full(9, k)], c)
            speeds = [
                np.abs(cranes.move(pose, edges[p, r], 0.0).velocity[i])
                for i in range(len(problem.crane.machine.cylinders))[problem.moving]
            ]
            moved += 1
            # Some cylinder is beyond its threshold all over the row, and hardly so somewhere.
            assert any(np.all(v > threshold) and v.min() < 1.2 * threshold for v in speeds)
    assert moved > 50


def still(problem) -> motion.Motion:
    """A motion to narrow rows beside: the redundant cylinder is held."""
    held = np.zeros(problem.stages + 1)
    return motion.from_velocities(problem.step, problem.lower[0] + 0.1, held, "still", "cp")


@pytest.mark.parametrize(("pump", "above"), [("cp", 0.1), ("ls", 0.1), ("cp", 0.005)])
def test_rows_are_narrower_near_a_motion_and_fill_the_feasible_extensions(problem, pump, above):
    beside = motion.from_velocities(problem.step, problem.lower[0] + above, np.zeros(problem.stages + 1), "still", pump)
    kept, seen = partition.whole(Legs((problem,)), pump, beside), set()
    narrower, lower = position_rows.FINER[pump]
    ordinary = partition.whole(Legs((problem,)), pump).velocities
    for k, rows in enumerate(kept.rows):
        assert rows[0] == pytest.approx(problem.lower[k], abs=1e-12)
        assert rows[-1] == pytest.approx(problem.upper[k], abs=1e-12)
        width = (problem.upper[k] - problem.lower[k]) / kept.positions
        middle = 0.5 * (rows[1:] + rows[:-1])
        off, from_end = np.abs(middle - beside.position[k]), np.minimum(middle - rows[0], rows[-1] - middle)
        at_end = (
            min(beside.position[k] - problem.lower[k], problem.upper[k] - beside.position[k]) < position_rows.NEAR_END
        )
        seen.add(bool(at_end))
        near, beyond = off < position_rows.NEAR_MOTION - width, off > position_rows.NEAR_MOTION + width
        narrowest = near & at_end & (from_end < position_rows.NEAR_END - width)
        assert np.allclose(np.diff(rows)[narrowest], width / position_rows.NARROWEST)
        assert np.allclose(
            np.diff(rows)[near & (not at_end or from_end > position_rows.NEAR_END + width)], width / narrower
        )
        assert np.allclose(np.diff(rows)[beyond], width)
        if k < problem.stages:
            assert kept.model[k].shape[0] == kept.active[k].shape[0] == rows.size - 1
            assert kept.active[k].shape[1] == kept.velocities[k] == ordinary[k] * (lower if at_end else 1)
    assert (above < position_rows.NEAR_END) in seen


def chosen(kept: partition.Cells, rng: np.random.Generator, columns) -> tuple[np.ndarray, ...]:
    """Some cells of every stage, of the given columns of its window."""
    found = []
    for active in kept.active:
        some = np.full(active.shape, np.inf)
        some[:, columns] = np.where(rng.random(active[:, columns].shape) < 0.3, 0.0, np.inf)
        found.append(some)
    return tuple(found)


def unknown(kept: partition.Cells) -> lower_bounds.Bounds:
    """Bounds that say nothing."""
    planes = tuple(np.zeros((*active.shape, 4)) for active in kept.active)
    return lower_bounds.Bounds(kept, planes, np.zeros(kept.active[0].shape))


@pytest.mark.slow
@pytest.mark.parametrize("pump", ["cp", "ls"])
def test_smaller_cells_hold_every_state_of_the_cells_kept(problem, rng, pump):
    kept = partition.whole(Legs((problem,)), pump, still(problem))
    for columns, rows_too in ((slice(14, 26), True), ([0, -1], True), (slice(8, 20), False)):  # at the sides as well
        excess = chosen(kept, rng, columns)
        finer = lower_bounds.refine(unknown(kept), excess, rows_too)
        assert finer.positions == (2 if rows_too else 1) * kept.positions
        for k in range(problem.stages):
            for p, r in rng.permutation(np.argwhere(np.isfinite(excess[k])))[:60]:
                slow, fast = kept.edges[k][p, r : r + 2]
                for w in slow + (fast - slow) * np.array([0.001, rng.random(), 0.999]):
                    row = int(np.searchsorted(finer.rows[k], rng.uniform(*kept.rows[k][p : p + 2]))) - 1
                    edges = finer.edges[k][row]
                    assert edges[0] <= w <= edges[-1]
                    assert finer.active[k][row, int(np.searchsorted(edges, w)) - 1] < np.inf
        assert finer.count < 8 * sum(int(np.isfinite(e).sum()) for e in excess)
        kept = finer


@pytest.mark.parametrize(("share", "moved"), [(0.3, 0), (1.7, 2), (39.6, 0)])
def test_edges_on_the_velocity_limits_stay(share, moved):
    """A threshold beside a limit moves no edge inward: states between would be in no cell."""
    limit, height, epsilon = 0.2, 0.01, 1e-4
    model = np.zeros((1, 1, layout.COEFFICIENTS, 4))
    model[0, 0, layout.A0, 0], model[0, 0, layout.A1, 0] = epsilon + limit - share * height, 1.0
    setting = np.zeros(layout.SETTINGS)
    setting[layout.EPSILON], setting[layout.SENSING] = epsilon, 1.0
    edges = np.zeros((1, 41))
    cell_enclosures.place_edges(model, setting, np.array([-limit, height, 0.0]), edges)
    plain = -limit + height * np.arange(41)
    assert (edges[0, 0], edges[0, -1]) == pytest.approx((-limit, limit), abs=1e-12)
    changed = np.nonzero(np.abs(edges[0] - plain) > 1e-6)[0].tolist()
    assert changed == ([moved] if moved else [])
