"""Least energy over the duration of a task: its path followed faster and slower, planned afresh each time.

All times of the path are scaled alike. Of a cycle the duration is that of the whole: legs whose duration is a range
share it, as for a `total`; without any, all legs but fastest ones are scaled alike, waiting stays as it is. Slow
motions come first, since fast ones are harder to find; each plan begins with its slower neighbour's motion, made
faster, and is made again where its faster neighbour's, made slower, is better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from leanboom.components.costs import PUMPS
from leanboom.errors import InfeasibleError, InputError
from leanboom.evaluation.evaluate import Evaluation, evaluate
from leanboom.methods.dp_refined import gains
from leanboom.methods.least_duration import shortest_duration, slower
from leanboom.methods.registry import GRID, STEP
from leanboom.model import motion
from leanboom.model.legs import span
from leanboom.model.motion import Motion
from leanboom.model.outcome import Kind, Outcome
from leanboom.model.task import Task
from leanboom.planning import cycles, planner
from leanboom.planning.planner import Plan
from leanboom.problem import least_flow
from leanboom.progress import Progress, quiet
from leanboom.quantities import ranges
from leanboom.quantities.ranges import noted

GAIN = 1e-4  # a motion is made again from one that takes less by more than this share
COUNT = 8  # durations, if none are given
LONGEST = 2.5  # times a task's duration that the last of these is
SHORTEST, ACCURACY = 1.0 / 8.0, 0.05  # least factor that is tried on the duration, and accuracy of the shortest one
COARSE, LONG_STEP = (61, 31), 2.0 * STEP  # grid and stages it is looked for with


@dataclass(frozen=True, slots=True, eq=False)
class Point:
    """A task in one of its durations, with one pump."""

    task: Task
    duration: float  # asked for [s]
    pump: str
    plan: Plan | None  # None where the pump's flow is a limit that this duration cannot keep
    status: Outcome

    @property
    def energy(self) -> float | None:
        """Least energy found [J]; None where no motion keeps every limit."""
        return (
            self.plan.evaluation.energy(self.pump) if self.plan is not None and self.plan.evaluation.feasible else None
        )

    @property
    def baseline(self) -> float | None:
        """Energy of the pseudo-inverse from the same start [J]; None where it does not keep every limit."""
        other = None if self.plan is None else self.plan.baseline
        return other.energy(self.pump) if other is not None and other.feasible else None

    @property
    def solved(self) -> bool:
        """Whether the motion keeps every limit and the pump can deliver it."""
        return self.status.solved

    def json(self) -> dict[str, Any]:
        """The point as `pareto --json` prints it."""
        return {
            "pump": self.pump,
            "duration_s": self.duration,
            "energy_j": self.energy,
            "baseline_j": self.baseline,
            "status": self.status,
        }


@dataclass(frozen=True, slots=True, eq=False)
class Pareto:
    """Least energies over the durations of a task."""

    task: Task
    pumps: tuple[str, ...]
    points: tuple[Point, ...]  # by pump, then by rising duration

    def curve(self, pump: str) -> tuple[Point, ...]:
        """The points of a pump."""
        return tuple(point for point in self.points if point.pump == pump)

    def json(self) -> list[dict[str, Any]]:
        """The points as `pareto --json` prints them."""
        return [point.json() for point in self.points]


def pareto(
    task: Task,
    pump: str | Sequence[str] = "ls",
    *,
    durations: Sequence[float] | None = None,
    grid: tuple[int, int] = GRID,
    step: float = STEP,
    effort: str = "default",
    progress: Progress | None = None,
) -> Pareto:
    """The least energies of a task over its duration.

    Args:
        task: What to do; its path's times are scaled, those of a cycle's legs shared or scaled.
        pump: "ls", "cp" or both: whose energy counts.
        durations: Durations of the whole path, or the whole cycle [s]; None: from the shortest feasible one found to
            2.5 times the task's.
        grid: Position and velocity nodes of the coarse grid.
        step: Length of a stage [s].
        effort: As in `planner.run`.
        progress: Called with what happens and the share done.

    Raises:
        InputError: For arguments or tasks that cannot be used.
        InfeasibleError: If the tool cannot follow the path, or no duration is feasible where none is given.
    """
    pumps = tuple(dict.fromkeys((pump,) if isinstance(pump, str) else pump))
    problems: list[str] = []
    if not pumps or any(name not in PUMPS for name in pumps):
        problems.append(f"pump = {', '.join(pumps) or 'nothing'}; must be some of {', '.join(PUMPS)}")
    if task.timing == "shortest":
        problems.append("timing = shortest; must be fixed or free, since durations scale the path's own timing")
    if task.legs and all(leg.duration == "shortest" for leg in task.legs):
        problems.append("legs; at least one must have a duration other than shortest, since durations scale it")
    given = None if durations is None else [
        noted(problems, ranges.checked, "duration", each, ranges.DURATION) for each in durations
    ]  # fmt: skip
    if given is not None and not given:
        problems.append("durations = nothing; must be at least one time")
    if problems:
        raise InputError("\n".join(problems))
    tell = progress or quiet
    kept = Kept.of(task, pumps[0], tell)
    wanted = usual_durations(task, tell, kept) if given is None else sorted({each for each in given if each})
    tasks = [(each, kept.lasting(each)) for each in wanted]
    settings = {"grid": grid, "step": step, "effort": effort}
    points: list[Point] = []
    for at, name in enumerate(pumps):
        points += _curve(tasks, name, settings, lambda text, share, at=at: tell(text, (at + share) / len(pumps)))
    return Pareto(task, pumps, tuple(points))


@dataclass(frozen=True, slots=True)
class Kept:
    """A task whose duration is to be another, and the times of a cycle that stay as they are."""

    task: Task
    waiting: float  # [s]
    fastest: dict[int, float]  # durations of the fastest legs, by their numbers from 0 [s]

    @classmethod
    def of(cls, task: Task, cost: str, tell: Progress) -> Kept:
        """A task and its times that stay, fastest legs planned for a cost."""
        fast = {i: each.task.duration for i, each in cycles.fastest(task, cost, tell).items()}
        return cls(task, sum(leg.dwell for leg in task.legs), fast)

    @property
    def shared(self) -> bool:
        """Whether legs share the time."""
        return any(isinstance(leg.duration, tuple) for leg in self.task.legs)

    @property
    def staying(self) -> float:
        """Time of waiting and fastest legs [s]."""
        return self.waiting + sum(self.fastest.values())

    @property
    def scaled(self) -> float:
        """Time of all that is scaled, in the task's own timing [s]."""
        if not self.task.legs:
            return self.task.duration
        return sum(leg.timed.duration for i, leg in enumerate(self.task.legs) if i not in self.fastest)

    @property
    def spans(self) -> tuple[float, float]:
        """Least and largest time of the whole where legs share it [s]."""
        ends = [span(leg) for i, leg in enumerate(self.task.legs) if i not in self.fastest]
        return self.staying + sum(low for low, _ in ends), self.staying + sum(high for _, high in ends)

    def lasting(self, duration: float) -> Task:
        """The task in a duration [s].

        Raises:
            InputError: Its legs cannot make it up.
        """
        task = self.task
        if self.shared:
            least, most = self.spans
            if not least - ranges.MOMENT <= duration <= most + ranges.MOMENT:
                raise InputError(
                    f"duration = {duration:g} s; must be from {least:.6g} s to {most:.6g} s, what the legs and waiting "
                    "make up"
                )
            return replace(task, total=min(max(duration, least), most), time_price=None)
        if duration <= self.staying:
            raise InputError(
                f"duration = {duration:g} s; must be above {self.staying:.6g} s, what fastest legs and waiting take"
            )
        factor = (duration - self.staying) / self.scaled
        if not task.legs:
            return slower(task, factor)
        legs = (
            leg if i in self.fastest else leg.lasting(factor * leg.timed.duration) for i, leg in enumerate(task.legs)
        )
        return replace(task, legs=tuple(legs))


def usual_durations(task: Task, tell: Progress = quiet, kept: Kept | None = None) -> list[float]:
    """Durations from the shortest feasible one found to `LONGEST` times the task's [s], in equal ratios.

    Args:
        task: The task.
        tell: Called with what happens and the share done.
        kept: The task with its times that stay, if it has legs; those that share time go from their least to their
            largest.

    Raises:
        InfeasibleError: No feasible duration was found.
    """
    staying, scaled = (0.0, task.duration) if kept is None else (kept.staying, kept.scaled)
    if kept is not None and kept.shared:
        least, most = kept.spans
        return np.round(np.geomspace(least, most, COUNT), 6).clip(least, most).tolist()
    tell("looking for the shortest feasible duration", 0.0)
    moving = [each for each in task.stretches if not each.waits and task.legs[each.leg].duration != "shortest"]
    paths = [task.stretch(each, "best") for each in moving] or [task]
    factors = [shortest_duration(each, COARSE, LONG_STEP, ACCURACY, least=SHORTEST) for each in paths]
    if None in factors:
        raise InfeasibleError(f"no feasible motion found, also not in 16 times the {scaled:g} s of the path")
    factor = max(each for each in factors if each is not None)
    found = staying + scaled * np.geomspace(factor, LONGEST * max(1.0, factor), COUNT)
    digits = 10.0 ** (np.floor(np.log10(found)) - 2.0)
    return (np.ceil(found / digits) * digits).round(12).tolist()


def _curve(tasks: list[tuple[float, Task]], pump: str, settings: dict[str, Any], tell: Progress) -> list[Point]:
    """The points of a pump, for the same task in rising durations [s]."""
    found: list[Point] = []
    for i, (duration, task) in enumerate(reversed(tasks)):
        tell(f"{pump}: {duration:g} s", i / len(tasks))
        seeds = [] if not found else _motions(found[0], task)
        found.insert(0, _point(task, duration, pump, seeds, settings))
    for i in range(1, len(found)):
        here = found[i]
        for seed in _motions(found[i - 1], here.task):
            judged = evaluate(_timed(here), seed)
            if judged.feasible and (here.plan is None or worse(here.plan.evaluation, judged, pump)):
                tell(f"{pump}: {here.duration:g} s again, from a faster motion", i / len(tasks))
                found[i] = _point(here.task, here.duration, pump, [seed], settings)
    return found


def _timed(point: Point) -> Task:
    """The task of a point, with the timing of its fastest legs."""
    return point.task if point.plan is None or not point.task.legs else point.plan.task


def worse(one: Evaluation, other: Evaluation, pump: str) -> bool:
    """Whether a judged motion breaks a limit, or takes clearly more energy than another, which keeps them all."""
    return not one.feasible or gains(one.energy(pump), other.energy(pump), GAIN)


def _point(task: Task, duration: float, pump: str, seeds: list[Motion], settings: dict[str, Any]) -> Point:
    """A task planned for a pump, with motions to begin with."""
    try:
        least_flow.check(task, settings["step"])
    except InputError as error:  # too fast for the pump: a slower one may do
        return Point(task, duration, pump, None, Outcome(Kind.INFEASIBLE, str(error)))
    plan = planner.run(task, pump=pump, warm_start=seeds, explain=False, check=False, **settings)
    return Point(task, duration, pump, plan, plan.status)


def _motions(point: Point, task: Task) -> list[Motion]:
    """The motion of a point, if it is feasible, with its times scaled to those of a task."""
    if point.plan is None or not point.plan.evaluation.feasible:
        return []
    known = point.plan.motion
    if not task.legs:
        return [_scaled(known, task.duration / known.duration)]
    if any(isinstance(leg.duration, tuple) for leg in task.legs):
        return []  # time is shared otherwise
    parts = []
    for each in point.plan.task.stretches:
        leg, lasted = task.legs[each.leg], each.until - each.since
        stays = each.waits or leg.duration == "shortest"
        part = motion.between(known, each.since, each.until)
        parts.append(part if stays else _scaled(part, leg.timed.duration / lasted))
    return [motion.joined(parts)]


def _scaled(known: Motion, factor: float) -> Motion:
    """A motion that takes `factor` times as long."""
    velocity, start = known.velocity / factor, float(known.position[0])
    if known.times is None:
        return motion.from_velocities(factor * known.step, start, velocity, known.method, known.cost)
    return motion.from_velocities_at(factor * known.times, start, velocity, known.method, known.cost)
