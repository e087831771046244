"""Motion libraries measured: `python -m benchmarks.library [--motions 100000] [--fresh 20] [--dask]`.

Queries: motions are made up, their ways lie at random in a work area, their velocities are noise. Printed is how long
random queries take once warm, between stored places and with an extension to lead over from, by the clock and by
processor time; and how much memory they took. With --fresh, energies of `forwarder-small` against plans made by
themselves; with --dask, its time on a local Dask cluster against that in processes.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from itertools import islice
from pathlib import Path

import numpy as np
import psutil

from leanboom.library import engine, keys, specification
from leanboom.library.lookup import Library, task_of
from leanboom.library.specification import Straight
from leanboom.library.store import Entry, Store
from leanboom.model import motion
from leanboom.planning.planner import run

DURATIONS, PAYLOADS, PUMPS, STARTS = (6.0, 8.0, 10.0, 12.0, 15.0), (0.0, 200.0), ("ls", "cp"), (0.0, 0.9)
LOW, HIGH = np.array([-6.0, -7.0, 0.0]), np.array([8.0, 7.0, 4.0])  # [m], of the work area
STAGE = 0.05  # [s]
WARM = 200  # queries before any counts


def fill(store: Store, motions: int, rng: np.random.Generator) -> None:
    """Fill a library with motions that are made up.

    Args:
        store: The library.
        motions: How many.
        rng: Where they lie.
    """
    shape = json.dumps(keys.plain(Straight()), sort_keys=True)
    each = len(DURATIONS) * len(PAYLOADS) * len(PUMPS) * len(STARTS)
    batch, number = [], 0
    for _ in range(motions // each):
        origin, goal = map(tuple, rng.uniform(LOW, HIGH, (2, 3)).tolist())
        for duration in DURATIONS:
            for payload in PAYLOADS:
                for pump in PUMPS:
                    for start in STARTS:
                        velocity = rng.normal(0.0, 0.1, round(duration / STAGE) + 1)
                        moved = motion.from_velocities(STAGE, start, velocity, "dp", pump)
                        energy = float(rng.uniform(1e4, 1e5))
                        entry = Entry(
                            f"{number:032x}", "", origin, goal, shape, pump, payload, duration, str(start), start,
                            None, True, "solved", energy, 1.2 * energy, 0.0, None, None,
                        )  # fmt: skip
                        batch.append((entry, moved))
                        number += 1
        if len(batch) >= 4000:
            store.add(batch)
            batch = []
    store.add(batch)


def ask(library: Library, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Times of random queries, by the clock and of the processor [s], (queries,) each.

    Args:
        library: The library.
        count: How many count.
        rng: What they ask for.
    """
    wall, processor = np.empty(count), np.empty(count)
    questions = ((rng.uniform(LOW, HIGH, (2, 3)).tolist(), rng.uniform(0.0, 1.8)) for _ in range(WARM + count))
    for (origin, goal), extension in islice(questions, WARM):
        library.query(origin, goal, extension=extension)
    for i, ((origin, goal), extension) in enumerate(questions):
        began = time.perf_counter(), time.process_time()
        library.query(origin, goal, max_duration=10.0, payload=100.0, extension=extension)
        wall[i], processor[i] = time.perf_counter() - began[0], time.process_time() - began[1]
    return wall, processor


def queries(motions: int, count: int) -> None:
    """Print how long random queries take.

    Args:
        motions: Of the library.
        count: Of the queries.
    """
    rng = np.random.default_rng(20170506)
    with tempfile.TemporaryDirectory() as name:
        began = time.perf_counter()
        with Store(Path(name), write=True) as store:
            fill(store, motions, rng)
        print(f"{motions} motions written in {time.perf_counter() - began:.0f} s")
        with Library(name) as library:
            before = psutil.Process().memory_info().rss
            for label, times in zip(("clock", "processor"), ask(library, count, rng), strict=True):
                middle, high = 1e3 * np.quantile(times, [0.5, 0.99])
                print(f"{count} queries, {label}: median {middle:.2f} ms, 99th percentile {high:.2f} ms")
            print(
                f"memory: {(psutil.Process().memory_info().rss - before) / 1e6:.1f} MB more than before the first query"
            )


def against_fresh_plans(folder: Path, count: int) -> None:
    """Print by what share motions of a built library take more energy than plans of the same tasks.

    Args:
        folder: Of the library.
        count: How many of its motions, evenly chosen.
    """
    shares = []
    with Library(folder) as library:
        entries = library.store.entries("segment NOTNULL ORDER BY key")
        for entry in entries[:: max(1, len(entries) // count)][:count]:
            fresh = run(task_of(entry, library.machine()), pump=entry.pump, baseline=False, check=False)
            shares.append((entry.energy_j or 0.0) / fresh.evaluation.energy(entry.pump) - 1.0)
    print(f"{len(shares)} motions: {100 * np.mean(shares):+.3f} % on average, {100 * max(shares):+.3f} % at worst, "
          f"{100 * min(shares):+.3f} % at best against plans by themselves")  # fmt: skip


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--motions", type=int, default=100_000)
    parser.add_argument("--queries", type=int, default=10_000)
    parser.add_argument("--fresh", type=int, default=0, help="motions of forwarder-small to plan by themselves")
    parser.add_argument("--dask", action="store_true", help="also builds on Dask")
    options = parser.parse_args()
    if options.motions:
        queries(options.motions, options.queries)
    with tempfile.TemporaryDirectory() as name:
        made = specification.load("forwarder-small")
        for label, cluster in (("processes", None), ("dask", engine.LOCAL)):
            if options.dask or (options.fresh and cluster is None):
                summary = engine.build(made, Path(name) / label, workers=1, cluster=cluster)
                print(f"{summary.solved} of {summary.total} motions by {label}: {summary.build_s:.1f} s")
        if options.fresh:
            against_fresh_plans(Path(name) / "processes", options.fresh)


if __name__ == "__main__":
    main()
