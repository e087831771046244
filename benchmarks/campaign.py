"""How far default plans are from the best known, on random tasks of random cranes: `python -m benchmarks.campaign`.

A task is drawn by its number: a bundled machine with other lengths, limits, masses, margins and thresholds;
a straight line, several lines or a spline through points reached by random joint positions; a payload from nothing to
about capacity; a start. Tasks without a motion that a coarse program finds are left out.

Each is planned with default settings and looked at again: on other grids, with half the step, with `thorough` effort
if asked for, by the other methods, and through relations that must hold between plans. Every motion found on the way
that is feasible for the task itself counts as known. Printed are the shares by which default plans are dearer than the
best known motion, how often a relation is broken, and the worst numbers, by which a task can be drawn again.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

import leanboom as lb
from leanboom import dp, kinematics, planner, stages
from leanboom.machine import Machine
from leanboom.motion import Motion
from leanboom.task import Lines, Spline, Task

METHODS = ("sns-actuator", "dp1", "polish")
DIRECT = ("pseudospectral", "shooting")
LOOKS = {
    "grid 201x101": {"grid": (201, 101)},
    "grid 71x35": {"grid": (71, 35)},
    "half the step": {"step": 0.025},
}
SAME = 1e-3  # relations hold to this share


def random_machine(rng: np.random.Generator) -> Machine:
    """A bundled machine, or one like it with other numbers."""
    machine = lb.load_machine(("forwarder", "loader")[int(rng.integers(2))])
    if rng.random() < 0.25:
        return machine

    def vary(spread: float) -> float:
        return float(np.exp(rng.uniform(-spread, spread)))

    geometry = replace(
        machine.geometry, boom=machine.geometry.boom * vary(0.08), outer=machine.geometry.outer * vary(0.08)
    )
    cylinders = tuple(
        replace(c, velocity_limit=c.velocity_limit * vary(0.3), acceleration_limit=c.acceleration_limit * vary(0.5))
        for c in machine.cylinders
    )
    bodies = tuple(replace(b, mass=b.mass * vary(0.15), inertia=b.inertia * vary(0.15)) for b in machine.bodies)
    pump = replace(
        machine.pump,
        ls_margin=machine.pump.ls_margin * vary(0.3),
        constant_pressure=machine.pump.constant_pressure * vary(0.1),
    )
    return replace(
        machine, geometry=geometry, cylinders=cylinders, bodies=bodies, pump=pump,
        driven_velocity=machine.driven_velocity * vary(0.3),
    )  # fmt: skip


def _point(machine: Machine, rng: np.random.Generator) -> tuple[float, float, float]:
    """A tool position reached by random joint positions, beside the pillar and not far below the ground."""
    g = machine.geometry
    reach = g.boom + g.outer
    while True:
        q2, q3, q4 = (rng.uniform(j.lower, j.upper) for j in machine.joints[-3:])
        r, z = kinematics.tool_point(q2, q3, q4, g.base_x, g.base_z, g.boom, g.offset, g.outer)
        if r > 0.25 * reach and -0.3 * reach < z < 1.5 * reach:
            turn = rng.uniform(-1.0, 1.0) if g.slewing else 0.0
            return float(r * np.cos(turn)), float(r * np.sin(turn)), float(z)


def random_task(number: int) -> Task:
    """Task of a number: the same on every machine."""
    rng = np.random.default_rng(7000 + number)
    machine = random_machine(rng)
    kind = ("line", "lines", "spline")[number % 3]
    points = tuple(_point(machine, rng) for _ in range(2 if kind == "line" else 3 + int(rng.integers(2))))
    legs = 0.1 + np.array([np.linalg.norm(np.subtract(a, b)) for a, b in zip(points[:-1], points[1:], strict=True)])
    durations = tuple(float(t) for t in rng.uniform(3.0, 9.0) * legs / legs.sum())
    path = Lines(points, durations)
    if kind == "spline":
        path = Spline(points, (0.0, *(float(t) for t in np.cumsum(durations))))
    capacity = 420.0 if machine.geometry.slewing else 120.0
    payload = float(capacity * rng.random()) if rng.random() < 0.7 else 0.0
    return Task(f"random-{number}", machine, path, payload, str(rng.choice(["smallest", "middle", "best"])))


def has_motion(task: Task) -> bool:
    """Whether a coarse program finds a motion that keeps all limits, or nearly."""
    try:
        problem = stages.discretise(task, 0.05)
        policy = dp.solve(problem, stages.full_grid(problem, 71, 35), "cp")
        start = dp.start_position(problem, task.start)
        found = lb.evaluate(task, dp.rollout(policy, dp.best_start(policy) if start is None else start))
        return found.feasible or found.worst_use < 1.05
    except lb.LeanboomError:
        return False


def limits(task: Task, velocity: float = 1.0, acceleration: float = 1.0) -> Task:
    """The same task with other limits."""
    cylinders = tuple(
        replace(c, velocity_limit=velocity * c.velocity_limit, acceleration_limit=acceleration * c.acceleration_limit)
        for c in task.machine.cylinders
    )
    return replace(task, machine=replace(task.machine, cylinders=cylinders))


def relations(task: Task) -> Iterator[tuple[str, Task]]:
    """Tasks whose plans must not cost more than the task's own."""
    yield "acceleration limits x 3", limits(task, acceleration=3.0)
    yield "limits x 1.5", limits(task, 1.5, 1.5)
    yield "velocity limits x 100", limits(task, 100.0)
    if task.start != "best":
        yield "start: best", replace(task, start="best")


def planned(task: Task, pump: str, **options) -> planner.Plan | None:
    """A plan, or none where none is feasible."""
    try:
        found = planner.run(task, pump=pump, baseline=False, check=False, **options)
    except lb.LeanboomError:
        return None
    return found if found.evaluation.feasible else None


def known(task: Task, pump: str, motion: Motion) -> float:
    """Energy of a motion in a task [J]; inf where it breaks a limit of it."""
    judged = lb.evaluate(task, motion)
    return judged.energy(pump) if judged.feasible else np.inf


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tasks", type=int, default=300)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--pumps", default="ls,cp")
    parser.add_argument("--proof", type=float, default=0.0, help="seconds of `thorough` for a proof; 0: without")
    parser.add_argument("--direct", action="store_true", help="also collocation and shooting (minutes a task)")
    arguments = parser.parse_args()
    dp.prepare()
    began, done, number = time.perf_counter(), 0, arguments.first
    gaps: dict[str, list[float]] = {}
    lost: dict[str, list[tuple[float, str]]] = {pump: [] for pump in arguments.pumps.split(",")}
    broken: dict[str, list[tuple[float, str]]] = {}
    while done < arguments.tasks:
        task, number = random_task(number), number + 1
        if not has_motion(task):
            continue
        done += 1
        for pump, losses in lost.items():
            ours = planned(task, pump)
            energy = np.inf if ours is None else ours.evaluation.energy(pump)
            best, winner = energy, "default"
            looks = {name: planned(task, pump, **options) for name, options in LOOKS.items()}
            if arguments.proof:
                looks["thorough"] = proven = planned(task, pump, effort="thorough", seconds=arguments.proof)
                if proven is not None and proven.certificate is not None:
                    gaps.setdefault(pump, []).append(proven.certificate.gap_percent)
            if task.start != "best":
                looks |= {m: planned(task, pump, method=m) for m in METHODS + (DIRECT if arguments.direct else ())}
            looks["narrow limits"] = planned(limits(task, acceleration=0.7), pump)
            for name, other in looks.items():
                if other is not None and known(task, pump, other.motion) < best:
                    best, winner = known(task, pump, other.motion), name
            if np.isfinite(best):
                losses.append((energy / best - 1.0, f"{task.name} {pump} by {winner}"))
                if losses[-1][0] > SAME:
                    print(f"{task.name} {pump}: {winner} {best:.1f} J, default {energy:.1f} J", flush=True)
            for name, wider in relations(task) if ours is not None else ():
                other = planned(wider, pump)
                more = np.inf if other is None else other.evaluation.energy(pump) / energy - 1.0
                broken.setdefault(f"{name}, {pump}", []).append((more, task.name))
        if done % 10 == 0:
            print(f"{done} tasks, {time.perf_counter() - began:.0f} s", flush=True)
    for pump, losses in lost.items():
        shares = np.array([share for share, _ in losses])
        print(
            f"{pump}: {len(losses)} plans; dearer than the best known by more than 0.1 %: {np.sum(shares > SAME)}, "
            f"0.5 %: {np.sum(shares > 5e-3)}; 90 %, 98 %, 100 % within "
            + ", ".join(f"{100 * np.quantile(shares, q):.3f} %" for q in (0.9, 0.98, 1.0))
        )
        for share, name in sorted(losses, reverse=True)[:5]:
            print(f"   {100 * share:+.3f} %  {name}")
    for pump, found in gaps.items():
        enough = np.mean(np.array(found) <= planner.PROVEN[pump])
        print(
            f"{pump}: proven gaps of {len(found)} plans: {100 * enough:.0f} % at most {planner.PROVEN[pump]} %; "
            f"50 %, 90 %, 100 % within " + ", ".join(f"{np.quantile(found, q):.2f} %" for q in (0.5, 0.9, 1.0))
        )
    for name, rows in broken.items():
        worst = max(rows)
        print(
            f"{name}: {len(rows)} plans, dearer by more than 0.1 % in {sum(more > SAME for more, _ in rows)}, "
            f"at worst {100 * worst[0]:+.3f} % ({worst[1]})"
        )


if __name__ == "__main__":
    main()
