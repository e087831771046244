"""Which statements of the 4-DOF paper hold at once, and for which crane and paths: `python -m benchmarks.forwarder`.

The paper's bars have no numbers; its text says how energies compare, `study.papers.statements`. Free are what is not
printed: the pins (the assumed ones, or those of a public model), masses, friction, and where the three paths are and
which way the straight ones go; durations, lengths and peak speeds are printed.

Places of each path are sampled over their bounds and judged on four cranes of each pins, `CRANES`, each with more
friction or mass than the one before. Paths share the crane and nothing else, so every crane has its best place of each
path; those of the best crane are refined by Nelder and Mead's simplex. The misfit is the root of the sum, over all
statements, of the squared logarithm of the factor that is missing to the range. Motions are `plan`'s from a coarse grid
and of little effort; the best motion for a pump is the best of all at hand.

What is judged is kept in a file, and a search that was interrupted goes on there. A quarter of an hour of one
core (`LEANBOOM_THREADS=1`). `--closed-loop` simulates the refined places as well;
`--explaining` shows the crane and places of `forwarder.explaining` instead.
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import minimize
from scipy.stats import qmc

import leanboom as lb
from leanboom.errors import InfeasibleError, LeanboomError
from leanboom.evaluation.evaluate import evaluate
from leanboom.methods import pseudo_inverse
from leanboom.model.motion import Motion
from leanboom.model.task import Task
from leanboom.planning import planner
from leanboom.problem import stages, starts
from leanboom.simulation import closed_loop
from leanboom.study.papers import forwarder
from leanboom.study.papers.forwarder import HalfCycle
from leanboom.study.papers.statements import POINTWISE, Energies, Statement, of
from leanboom.study.papers.variations import heavier

LENGTH = {"horizontal": 3.20, "vertical": 3.04}  # [m], from printed duration and peak speed
# Bounds of a place. Straight paths: x and z of the end nearer to the crane, or lower [m], and above 0.5 which way they
# are driven: outwards, downwards. Half-cycle: the numbers of `HalfCycle` [m].
BOUNDS = {
    "horizontal": ([3.3, 0.0, 0.0], [5.7, 3.5, 1.0]),
    "vertical": ([3.8, -0.5, 0.0], [8.0, 2.5, 1.0]),
    "half-cycle": ([3.8, 1.8, 2.6, 4.0, 0.0], [5.2, 3.2, 3.8, 7.5, 1.8]),
}
PINS = "assumed", "public"
GRID, STEP, SMOOTH = (41, 21), 0.05, 5.0  # of plans; [s] of stages; [Hz], as the paper filters
FOLDER = Path("leanboom-forwarder")


@dataclass(frozen=True)
class Crane:
    """A crane of the search."""

    masses: float  # of the bundled ones
    friction: float  # of base, lift and tilt, of highest pressure times piston area
    extension: float  # friction on the extension's first plateau [kN]


# As bundled, about; with the public model's friction; the extension's twice as much; and heavier besides.
CRANES = Crane(1.0, 0.025, 3.0), Crane(1.0, 0.10, 5.5), Crane(1.0, 0.10, 12.0), Crane(1.3, 0.10, 12.0)


def task_of(crane: Crane, pins: str, path: str, place: tuple[float, ...]) -> Task:
    """The task along a path at a place, by a crane."""
    task = lb.load_task(f"forwarder-{path}", start="smallest")
    if path == "half-cycle":
        task = replace(task, path=HalfCycle(*place).path())
    else:
        x, z, away = place
        dx, dz = (LENGTH[path], 0.0) if path == "horizontal" else (0.0, LENGTH[path])
        if (away > 0.5) == (path == "horizontal"):
            task = forwarder.straight(task, x, z, dx, dz)
        else:
            task = forwarder.straight(task, x + dx, z + dz, -dx, -dz)
    task = replace(task, machine=forwarder.pinned(task.machine, pins))
    machine = forwarder.rubbing(task.machine, crane.friction, 1e3 * crane.extension)
    return heavier(replace(task, machine=machine), crane.masses)


def judged(task: Task, motions: Mapping[str, Motion]) -> Energies:
    """Energies of motions, filtered as in the paper.

    Raises:
        InfeasibleError: One leaves the path.
    """
    found = {name: evaluate(replace(task, smooth=SMOOTH), motion) for name, motion in motions.items()}
    if not all(one.followed for one in found.values()):
        raise InfeasibleError("a motion leaves the path")
    return {name: (one.energy_ls, one.energy_cp) for name, one in found.items()}


def driven(task: Task, motions: Mapping[str, Motion]) -> Energies:
    """Energies of the same in closed loop."""
    smooth = replace(task, smooth=SMOOTH)
    runs = {
        name: (closed_loop.simulate(smooth, motion, "ls"), closed_loop.simulate(smooth, motion, "cp"))
        for name, motion in motions.items()
    }
    return {name: (ls.energy, cp.energy) for name, (ls, cp) in runs.items()}


def solve(tasks: Sequence[Task]) -> list[dict[str, Motion]]:
    """Motions of all solutions of tasks that differ in masses and friction alone.

    Raises:
        LeanboomError: The path cannot be followed.
    """
    start = starts.start_position(stages.discretise(tasks[0], STEP), "smallest")
    if start is None:
        raise InfeasibleError("no start")
    still = {}  # masses and friction do not matter
    for name, variant in zip(POINTWISE, ("joint", "actuator"), strict=True):
        still[name] = pseudo_inverse.resolve(tasks[0], start, variant, step=STEP)
    for name, cost in (("DP (CP)", "cp"), ("DP (ext.)", "extension")):
        still[name] = planned(tasks[0], cost, ())
    answers: list[dict[str, Motion]] = []
    for task in tasks:
        seeds = (still["DP (CP)"], *(answers[-1][name] for name in ("DP (LS)", "DP (A. En.)") if answers))
        loads = {name: planned(task, cost, seeds) for name, cost in (("DP (LS)", "ls"), ("DP (A. En.)", "actuator"))}
        answers.append(still | loads)
    return answers


def planned(task: Task, cost: str, seeds: Sequence[Motion]) -> Motion:
    """The plan for a cost from a coarse grid."""
    return planner.run(
        task, cost=cost, grid=GRID, step=STEP, effort="quick", warm_start=seeds, baseline=False, explain=False
    ).motion


class Kept:
    """Energies of what was judged before, in a file."""

    def __init__(self, folder: Path):
        folder.mkdir(parents=True, exist_ok=True)
        self.file = folder / "judged.jsonl"
        lines = self.file.read_text().splitlines() if self.file.exists() else []
        self.known: dict[str, list[Energies]] = dict(json.loads(line) for line in lines)

    def energies(self, pins: str, path: str, place: tuple[float, ...], cranes: Sequence[Crane]) -> list[Energies]:
        """Energies of all solutions by each crane; none where the path cannot be followed."""
        key = json.dumps([pins, path, place, [astuple(crane) for crane in cranes]])
        if key not in self.known:
            try:
                tasks = [task_of(crane, pins, path, place) for crane in cranes]
                found = [judged(task, motions) for task, motions in zip(tasks, solve(tasks), strict=True)]
            except LeanboomError:
                found = []
            self.known[key] = found
            with self.file.open("a") as file:
                file.write(json.dumps([key, found]) + "\n")
        return self.known[key]


def squares(path: str, energies: Energies) -> float:
    """Sum of the squares of what is missing."""
    return sum(statement.missing(energies) ** 2 for statement in of(path))


def sampled(path: str, count: int, seed: int) -> list[tuple[float, ...]]:
    """Places of a path."""
    low, high = BOUNDS[path]
    points = qmc.scale(qmc.Halton(len(low), rng=seed).random(count), low, high)
    return [tuple(point) for point in points.round(3).tolist()]


def row(statement: Statement, energies: Energies) -> str:
    """A statement beside its ratios."""
    ratios = ", ".join(f"{ratio:.2f}" for ratio in statement.ratios(energies))
    return (
        f"  {'holds' if not statement.missing(energies) else '-':5s} {statement.text:48s} {statement.span:14s} {ratios}"
    )


def refined(kept: Kept, pins: str, path: str, crane: Crane, place: tuple[float, ...], count: int) -> tuple[float, ...]:
    """The place of least misfit near a given one, by Nelder and Mead's simplex; a direction stays.

    Args:
        kept: What was judged before.
        pins, path, crane: What the place is judged for.
        place: Where the search begins.
        count: At most so many places are judged.
    """
    free = len(place) - (path != "half-cycle")
    low, high = (np.array(ends[:free]) for ends in BOUNDS[path])

    def off(x: np.ndarray) -> float:
        here = tuple(x.round(3).tolist()) + place[free:]
        found = kept.energies(pins, path, here, [crane])
        return squares(path, found[0]) if found else 10.0

    first = np.array(place[:free])
    simplex = np.vstack([first, first + 0.12 * (high - low) * np.diag((-1.0) ** np.arange(free))])
    options = {"initial_simplex": simplex.clip(low, high), "maxfev": count, "xatol": 5e-3, "fatol": 1e-5}
    answer = minimize(off, first, method="Nelder-Mead", bounds=list(zip(low, high, strict=True)), options=options)
    return tuple(answer.x.round(3).tolist()) + place[free:]


def search(kept: Kept, pins: str, count: int, seed: int) -> tuple[Crane, dict[str, tuple[float, ...]]]:
    """The crane of least misfit, with its places, out of samples; prints what every crane has."""
    ways: dict[Crane, dict[str, tuple[float, tuple[float, ...], Energies]]] = {crane: {} for crane in CRANES}
    for path in BOUNDS:
        for place in sampled(path, count, seed):
            for crane, energies in zip(CRANES, kept.energies(pins, path, place, CRANES), strict=False):
                entry = squares(path, energies), place, energies
                ways[crane][path] = min(ways[crane].get(path, entry), entry, key=lambda one: one[0])
    off = {crane: sum(entry[0] for entry in found.values()) for crane, found in ways.items()}
    print(f"\n{pins} pins\n| masses | friction | extension | misfit | hold | " + " | ".join(BOUNDS) + " |")
    for crane, found in ways.items():
        held = [(path, s) for path, (_, _, e) in found.items() for s in of(path) if not s.missing(e)]
        places = " | ".join(str(entry[1]) for entry in found.values())
        values = f"| {crane.masses} | {crane.friction} | {crane.extension} kN | {off[crane] ** 0.5:.2f} | {len(held)} |"
        print(values, places, "|", flush=True)
    best = min(off, key=off.__getitem__)
    return best, {path: entry[1] for path, entry in ways[best].items()}


def apart(kept: Kept) -> None:
    """Statements of one path that nothing judged so far has at once, and the least that is missing to both."""
    print("\nnever together:")
    for path in BOUNDS:
        known = [one for key, found in kept.known.items() if json.loads(key)[1] == path for one in found]
        for a, b in itertools.combinations(of(path), 2):
            least = min((max(a.missing(one), b.missing(one)) for one in known), default=0.0)
            if least > 0.0:
                print(f"  {path}: {a.text} / {b.text}: a factor of {np.exp(least):.2f} is missing")


def show(path: str, task: Task, simulate: bool) -> None:
    """What is said of a path, beside a task's ratios: as planned, and in closed loop if asked for."""
    (motions,) = solve([task])
    for what, energies in (
        ("planned", judged(task, motions)),
        *([("driven", driven(task, motions))] if simulate else []),
    ):
        print(f" {what}, misfit {squares(path, energies) ** 0.5:.3f}")
        print("\n".join(row(statement, energies) for statement in of(path)), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.forwarder", description="Which statements hold at once")
    parser.add_argument("--pins", choices=PINS, action="append", help="only these")
    parser.add_argument("--samples", type=int, default=6, help="places of each path")
    parser.add_argument("--refine", type=int, default=14, help="places judged around the best one of each path")
    parser.add_argument("--seed", type=int, default=1, help="of the samples")
    parser.add_argument("--closed-loop", action="store_true", help="simulate the refined places")
    parser.add_argument("--folder", type=Path, default=FOLDER, help="where what is judged is kept")
    parser.add_argument("--explaining", action="store_true", help="show what `forwarder.explaining` has, no search")
    options = parser.parse_args()
    began = time.process_time()
    if options.explaining:
        for path in BOUNDS:
            print(path)
            show(path, forwarder.explaining(lb.load_task(f"forwarder-{path}"), path), options.closed_loop)
        return
    kept = Kept(options.folder)
    for pins in options.pins or PINS:
        crane, places = search(kept, pins, options.samples, options.seed)
        print(f"\nrefined: {pins} pins, {crane}")
        for path, place in places.items():
            there = refined(kept, pins, path, crane, place, options.refine)
            print(f"{path} {there}")
            show(path, task_of(crane, pins, path, there), options.closed_loop)
    apart(kept)
    print(f"\n{time.process_time() - began:.0f} s of processor time")


if __name__ == "__main__":
    main()
