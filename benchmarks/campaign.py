"""How far default plans are from the best known, on random tasks of random cranes: `python -m benchmarks.campaign`.

A task is drawn by its number: a bundled machine with other lengths, limits, masses, margins and thresholds;
a straight line, several lines or a spline through points reached by random joint positions; a payload from nothing to
about capacity; a start. Tasks without a motion that a coarse program finds are left out.

Each is planned with default settings and looked at again: on other grids, with half the step, with `thorough` effort
if asked for, by the other methods, from random motions if asked for, and through relations that must hold between
plans. Every motion found on the way that is feasible for the task itself counts as known. Printed are the shares by
which default plans are dearer than the best known motion, how often a relation is broken, and the worst numbers, by
which a task can be drawn again.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.interpolate import CubicSpline

import leanboom as lb
from benchmarks.random_tasks import DIRECT, QUICK
from leanboom.components.linkages import FourBar, Linkage, Polynomial, RackAndPinion, Triangle
from leanboom.dynamic_programming import grids, value_function
from leanboom.formulas import kinematics
from leanboom.methods import dp_refined
from leanboom.methods.registry import GRID
from leanboom.model.machine import Geometry, Machine
from leanboom.model.motion import Motion, from_velocities
from leanboom.model.task import Lines, Spline, Task
from leanboom.planning import planner
from leanboom.problem import stages, starts

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
        policy = value_function.solve(problem, grids.full_grid(problem, 71, 35), "cp")
        start = starts.start_position(problem, task.start)
        found = lb.evaluate(
            task, value_function.rollout(policy, value_function.best_start(policy) if start is None else start)
        )
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


def scaled(task: Task, factor: float) -> Task:
    """A similar task: all lengths times a factor, at the same times and pressures.

    Areas grow with the factor and masses stay, so velocities, accelerations, gravity and forces grow with the factor;
    inertias, flows, powers and energies with its square. Friction that grows over the stroke does so per metre, which
    nothing scales: there is no similar task.
    """
    machine = task.machine

    def grown(part, lengths: tuple[str, ...] = (), squares: tuple[str, ...] = ()):
        changed = {name: factor * getattr(part, name) for name in lengths}
        return replace(part, **changed, **{name: factor**2 * getattr(part, name) for name in squares})

    def linkage(one: Linkage) -> Linkage:
        match one:
            case RackAndPinion():
                return grown(one, ("arm",))
            case Triangle():
                return grown(one, ("long", "short"))
            case FourBar():
                return grown(one, ("L21", "L22", "L23", "L24", "L25"))
            case Polynomial():
                return Polynomial(tuple(factor * c for c in one.coefficients))
            case _:
                return one  # a ratio

    def cylinder(one):
        sharp = one.friction.sharpness
        turns = one.friction.joint_velocity and one.name != "extension"
        friction = replace(
            one.friction, coulomb=factor * one.friction.coulomb, sharpness=sharp if turns else sharp / factor
        )
        grow = ("piston_area", "rod_side_area", "stroke", "velocity_limit", "acceleration_limit")
        return replace(grown(one, grow), friction=friction, linkage=linkage(one.linkage))

    *turning, extension = machine.joints
    geometry: Geometry = grown(machine.geometry, ("base_x", "base_z", "boom", "offset", "outer"))
    similar = replace(
        grown(machine, ("payload_along", "payload_above", "driven_velocity", "gravity")),
        geometry=geometry, joints=(*turning, grown(extension, ("lower", "upper"))),
        cylinders=tuple(map(cylinder, machine.cylinders)),
        bodies=tuple(grown(body, ("along", "above"), ("inertia",)) for body in machine.bodies),
        pump=grown(machine.pump, (), ("max_flow",)),
    )  # fmt: skip
    points = tuple(tuple(factor * x for x in point) for point in task.path.points)
    start = task.start if isinstance(task.start, str) else factor * task.start
    return replace(task, machine=similar, path=replace(task.path, points=points), start=start)


def back(task: Task) -> Task:
    """The task's straight lines there and back."""
    points, durations = task.path.points, task.path.durations
    return replace(task, path=Lines(points + points[-2::-1], durations + durations[::-1]))


def there_and_back(task: Task, pump: str, ours: planner.Plan) -> float:
    """By what share there and back costs more than the plan and the one back from where it ends; -inf without one."""
    home = Lines(task.path.points[::-1], task.path.durations[::-1])
    end = float(np.clip(ours.motion.position[-1], 0.0, task.machine.redundant.stroke))
    single = planned(replace(task, path=home, start=end), pump)
    if single is None:
        return -np.inf
    both = planned(back(task), pump)
    alone = ours.evaluation.energy(pump) + single.evaluation.energy(pump)
    return np.inf if both is None else both.evaluation.energy(pump) / alone - 1.0


def relations(task: Task) -> Iterator[tuple[str, Task, float]]:
    """Tasks whose plans must not cost more than so many times the task's own."""
    yield "acceleration limits x 3", limits(task, acceleration=3.0), 1.0
    yield "limits x 1.5", limits(task, 1.5, 1.5), 1.0
    yield "velocity limits x 100", limits(task, 100.0), 1.0
    similar = all(cylinder.friction.steps is None for cylinder in task.machine.cylinders)
    for factor in (0.1, 10.0) if similar else ():
        yield f"lengths x {factor:g}", scaled(task, factor), factor**2
    if task.start != "best":
        yield "start: best", replace(task, start="best"), 1.0


def from_random_motions(task: Task, pump: str, count: int, number: int) -> Iterator[Motion]:
    """Motions that the search descends to from random ones: smooth courses through five random extensions."""
    rng = np.random.default_rng(number)
    problem = stages.discretise(task, 0.05)
    start = starts.start_position(problem, task.start)
    node = np.linspace(0.0, 1.0, problem.stages + 1)
    for _ in range(count):
        knots = np.linspace(0.0, 1.0, 5)
        share = CubicSpline(knots, rng.random(knots.size), bc_type="clamped")(node)
        position = problem.lower + np.clip(share, 0.0, 1.0) * (problem.upper - problem.lower)
        if start is not None:
            position += (start - position[0]) * (1.0 - node) ** 4
        velocity = np.gradient(position, problem.step)
        velocity[[0, -1]] = 0.0
        seed = from_velocities(problem.step, float(position[0]), velocity, "random", pump)
        one = dp_refined.Search(task, pump, GRID, problem.step)
        found = one.descend(problem, seed, start, dp_refined.NEXT_LEVELS)
        if found.feasible:
            yield found.motion


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


@dataclass
class Tally:
    """What the plans of one pump lost, and how often relations between them were broken."""

    pump: str
    losses: list[tuple[float, str]] = field(default_factory=list)  # share above the best known motion, and of what
    gaps: list[float] = field(default_factory=list)  # proven [%]
    relations: dict[str, list[tuple[float, str]]] = field(default_factory=dict)  # shares above what was to hold

    def look_again(self, task: Task, number: int, arguments: argparse.Namespace) -> None:
        """Plan a task and look for anything better, in every other way."""
        ours = planned(task, self.pump)
        energy = np.inf if ours is None else ours.evaluation.energy(self.pump)
        best, winner = energy, "default"
        for name, motion in self.others(task, number, arguments):
            if known(task, self.pump, motion) < best:
                best, winner = known(task, self.pump, motion), name
        if np.isfinite(best):
            self.losses.append((energy / best - 1.0, f"{task.name} {self.pump} by {winner}"))
            if self.losses[-1][0] > SAME:
                print(f"{task.name} {self.pump}: {winner} {best:.1f} J, default {energy:.1f} J", flush=True)
        if ours is None:
            return
        for name, other_task, times in relations(task):
            other = planned(other_task, self.pump)
            more = np.inf if other is None else other.evaluation.energy(self.pump) / (times * energy) - 1.0
            self.relations.setdefault(name, []).append((more, task.name))
        if isinstance(task.path, Lines):
            more = there_and_back(task, self.pump, ours)
            self.relations.setdefault("there and back", []).append((more, task.name))

    def others(self, task: Task, number: int, arguments: argparse.Namespace) -> Iterator[tuple[str, Motion]]:
        """Motions found in other ways, by what found them."""
        ways = dict(LOOKS)
        if task.start != "best":
            ways |= {method: {"method": method} for method in QUICK + (DIRECT if arguments.direct else ())}
        for name, options in ways.items():
            if (other := planned(task, self.pump, **options)) is not None:
                yield name, other.motion
        if arguments.proof:
            proven = planned(task, self.pump, effort="thorough", seconds=arguments.proof)
            if proven is not None:
                yield "thorough", proven.motion
                if proven.certificate is not None:
                    self.gaps.append(proven.certificate.gap_percent)
        if (narrow := planned(limits(task, acceleration=0.7), self.pump)) is not None:
            yield "narrow limits", narrow.motion
        for motion in from_random_motions(task, self.pump, arguments.random, number):
            yield "a random motion", motion

    def report(self) -> None:
        """Print the shares and the worst tasks."""
        shares = np.array([share for share, _ in self.losses])
        print(
            f"{self.pump}: {len(shares)} plans; dearer than the best known by more than 0.1 %: {np.sum(shares > SAME)},"
            f" 0.5 %: {np.sum(shares > 5e-3)}; 90 %, 98 %, 100 % within "
            + ", ".join(f"{100 * np.quantile(shares, q):.3f} %" for q in (0.9, 0.98, 1.0))
        )
        for share, name in sorted(self.losses, reverse=True)[:5]:
            print(f"   {100 * share:+.3f} %  {name}")
        if self.gaps:
            wanted = planner.PROVEN[self.pump]
            print(
                f"   proven gaps of {len(self.gaps)} plans: {100 * np.mean(np.array(self.gaps) <= wanted):.0f} % at "
                f"most {wanted} %; 50 %, 90 %, 100 % within "
                + ", ".join(f"{np.quantile(self.gaps, q):.2f} %" for q in (0.5, 0.9, 1.0))
            )
        for name, rows in self.relations.items():
            worst = max(rows)
            print(
                f"   {name}: {len(rows)} plans, dearer by more than 0.1 % in {sum(more > SAME for more, _ in rows)}, "
                f"at worst {100 * worst[0]:+.3f} % ({worst[1]})"
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tasks", type=int, default=300)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--pumps", default="ls,cp")
    parser.add_argument("--proof", type=float, default=0.0, help="seconds of `thorough` for a proof; 0: without")
    parser.add_argument("--direct", action="store_true", help="also collocation and shooting (minutes a task)")
    parser.add_argument("--random", type=int, default=0, help="random motions to descend from, a task")
    arguments = parser.parse_args()
    value_function.prepare()
    began, done, number = time.perf_counter(), 0, arguments.first
    tallies = [Tally(pump) for pump in arguments.pumps.split(",")]
    while done < arguments.tasks:
        task, number = random_task(number), number + 1
        if not has_motion(task):
            continue
        done += 1
        for tally in tallies:
            tally.look_again(task, number, arguments)
        if done % 10 == 0:
            print(f"{done} tasks, {time.perf_counter() - began:.0f} s", flush=True)
        if done % 10 == 0 or done == arguments.tasks:
            for tally in tallies:
                tally.report()


if __name__ == "__main__":
    main()
