"""How far the sweep is from what this machine could do: `python -m benchmarks.speed`.

Prints the time a state of the backward sweep takes, one thread, beside a floor: the larger of its arithmetic at the
rate this machine reaches on plain vector arithmetic, and its memory traffic at the rate it copies at. Both rates are
measured here, compiled by the same compiler. Then: tables, threads, growth with stages, positions and velocities.

Operations are counted from the loops of `bellman`, one for each addition, multiplication, comparison, minimum or
maximum, divisions and roundings as one too; a hyperbolic tangent as 20. A candidate that is looked at counts, and so
does the one that is not admissible; all corners of a state whose cost is not one line over its controls do.
"""

from __future__ import annotations

import os
import time

import numpy as np
from numba import njit

import leanboom as lb
from benchmarks.run import machine, title
from leanboom import resources
from leanboom.dynamic_programming import bellman, grids, sweeps, value_function
from leanboom.problem import layout, stages

# Operations per state: parts that every cost has, per moving cylinder and in all.
LIMITS, LIMITS_ALL, KEEP, FLOW, FLOW_ALL = 17, 8, 12, 6, 4
INTERPOLATE, NODES_ALL, NODE = 34, 24, 10
LOAD_LINE, SETTLE, SETTLE_ALL, RUNNING, SWITCH = 42, 14, 6, 6, 6


@njit(error_model="numpy")
def arithmetic(a, b, rounds):
    """Four independent chains of multiply and add over arrays that stay in the first cache."""
    for _ in range(rounds):
        for j in range(a.shape[1]):
            a[0, j] = a[0, j] * b[j] + b[j]
            a[1, j] = a[1, j] * b[j] + b[j]
            a[2, j] = a[2, j] * b[j] + b[j]
            a[3, j] = a[3, j] * b[j] + b[j]


def least(function, repetitions: int = 5) -> float:
    """Shortest time of a call [s]."""
    times = []
    for _ in range(repetitions):
        began = time.perf_counter()
        function()
        times.append(time.perf_counter() - began)
    return min(times)


def rates() -> tuple[float, float]:
    """Operations and bytes a second of one thread."""
    a, b = np.ones((4, 128)), np.full(128, 0.5)
    rounds = 100_000
    arithmetic(a, b, 1)
    operations = 8 * 128 * rounds / least(lambda: arithmetic(a, b, rounds))
    source = np.ones(4_000_000)
    target = np.empty_like(source)
    moved = 2 * source.nbytes / least(lambda: np.copyto(target, source))
    return operations, moved


def mixed_share(policy) -> float:
    """Share of states whose cost is not one line over their controls, of every 20th stage and 10th position."""
    t, (stages_, positions, velocities) = policy.tables, policy.values.shape
    row = bellman.empty_row(velocities, t.cylinder.shape[0], velocities)
    shares = []
    for k in range(0, stages_ - 1, 20):
        ahead = bellman.layer(policy.values[k + 1], t.stage, policy.setting, k + 1)
        w = t.stage[k, layout.W_LO] + t.stage[k, layout.DW] * np.arange(velocities)
        for p in range(0, positions, 10):
            c, node, outside = (
                t.stage[k, layout.C_LO] + p * t.stage[k, layout.DC],
                t.coefficients[k, p],
                t.outside[k, p],
            )
            bellman.best_controls(node, outside, c, w, k, t.stage, t.cylinder, policy.setting, ahead, row)
            shares.append(row.state[bellman.PIECEWISE, :velocities].mean())
    return float(np.mean(shares))


def operations(problem, policy) -> tuple[float, float]:
    """Operations a state, and how many velocity nodes it looks at, on average."""
    t, cost = policy.tables, policy.cost
    n, states = t.cylinder.shape[0], policy.grid.velocities
    w = t.stage[:-1, None, layout.W_LO] + t.stage[:-1, None, layout.DW] * np.arange(states)
    node, w = t.coefficients[:-1, :, None], w[:, None, :, None]
    b = node[..., layout.B0] + w * (node[..., layout.B1] + w * node[..., layout.B2])
    half = t.cylinder[:, layout.A_MAX] / np.abs(node[..., layout.B3])
    middle = -b / node[..., layout.B3]
    low, high = (middle - half).max(axis=-1), (middle + half).min(axis=-1)
    # A row looks at the nodes between the least and the largest control of any of its states.
    width = (high.max(axis=-1) - low.min(axis=-1)) * problem.step / t.stage[0, layout.DW]
    nodes = float(np.minimum(width, states).mean())
    count = n * (LIMITS + FLOW) + LIMITS_ALL + KEEP + FLOW_ALL + 2 * INTERPOLATE + NODES_ALL + nodes * NODE
    if cost == "ls":
        corners = (2 + nodes + n * (n + 2)) * (INTERPOLATE + n * RUNNING) + n * (n + 2) * SWITCH
        count += n * (LOAD_LINE + SETTLE) + SETTLE_ALL + mixed_share(policy) * corners
    return count, nodes


def floor() -> None:
    title("Backward sweep, one thread: time a state against the floor of this machine")
    task = lb.load_task("forwarder-half-cycle")
    problem = stages.discretise(task, 0.05)
    with one_thread():
        for cost in ("cp", "ls"):
            grid = grids.full_grid(problem, 201, 101)
            policy = value_function.solve(problem, grid, cost)
            table, steep = policy.tables, policy.setting
            values, terminal = policy.values.copy(), policy.values[-1].astype(float)
            arrays = table.coefficients, table.outside, table.stage, table.cylinder, steep
            states = problem.stages * grid.positions * grid.velocities
            # Side by side, the best of each: other work on the machine slows now the one, now the other.
            took, speed, bandwidth = np.inf, 0.0, 0.0
            for _ in range(10):
                took = min(took, least(lambda a=arrays, v=values, e=terminal: sweeps.sweep(*a, e, v), 1) / states)
                speed, bandwidth = np.maximum((speed, bandwidth), rates())
            count, nodes = operations(problem, policy)
            row = table.coefficients.shape[2] * layout.COEFFICIENTS * 8
            traffic = 8 + 8 + 4 + row / grid.velocities  # ahead, here, stored value, table
            floors = count / speed, traffic / bandwidth
            print(
                f"plain vector arithmetic {speed / 1e9:.1f} operations a ns; copying {bandwidth / 1e9:.1f} bytes a ns"
            )
            print(
                f"{cost}: {1e9 * took:.1f} ns a state, {count:.0f} operations ({nodes:.1f} nodes looked at), "
                f"{traffic:.0f} bytes; floor {1e9 * max(floors):.1f} ns (arithmetic {1e9 * floors[0]:.1f}, "
                f"memory {1e9 * floors[1]:.1f}); ratio {took / max(floors):.1f}"
            )
            tables = least(lambda g=grid, c=cost: grids.tables(problem, g, c), 3) / (
                (problem.stages + 1) * grid.positions
            )
            print(f"    tables: {1e9 * tables:.0f} ns a node, {1e9 * tables / grid.velocities:.1f} ns a state")


class one_thread:  # noqa: N801
    """Sweeps in this block use one thread."""

    def __enter__(self) -> None:
        self.before = os.environ.get("LEANBOOM_THREADS")
        os.environ["LEANBOOM_THREADS"] = "1"

    def __exit__(self, *_: object) -> None:
        os.environ.pop("LEANBOOM_THREADS")
        if self.before is not None:
            os.environ["LEANBOOM_THREADS"] = self.before


def scaling() -> None:
    title("Threads: 201 x 101 x 300, ls")
    problem = stages.discretise(lb.load_task("forwarder-half-cycle"), 0.05)
    grid = grids.full_grid(problem, 201, 101)
    with one_thread():
        alone = least(lambda: value_function.solve(problem, grid, "ls"), 3)
    most = resources.threads()
    shared = least(lambda: value_function.solve(problem, grid, "ls"), 3)
    print(f"1 thread {alone:.3f} s; {most} threads {shared:.3f} s; {alone / shared:.2f} times as fast")


def growth() -> None:
    title("Growth: solving, tables included, ls [ns a state]")
    task = lb.load_task("forwarder-half-cycle")
    print(f"{'stages':>8}{'positions':>11}{'velocities':>12}{'s':>9}{'ns a state':>12}")
    for step, positions, velocities in (
        (0.1, 201, 101), (0.05, 201, 101), (0.025, 201, 101),
        (0.05, 101, 101), (0.05, 401, 101), (0.05, 201, 51), (0.05, 201, 201),
    ):  # fmt: skip
        problem = stages.discretise(task, step)
        grid = grids.full_grid(problem, positions, velocities)
        took = least(lambda p=problem, g=grid: value_function.solve(p, g, "ls"), 2)
        states = problem.stages * grid.positions * grid.velocities
        print(f"{problem.stages:>8}{grid.positions:>11}{grid.velocities:>12}{took:>9.3f}{1e9 * took / states:>12.1f}")


def main() -> None:
    machine()
    value_function.prepare()
    floor()
    scaling()
    growth()


if __name__ == "__main__":
    main()
