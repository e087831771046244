"""Least energy over the duration of a task: its path followed faster and slower, planned afresh each time.

All times of the path are scaled alike. Slow motions come first, since fast ones are harder to find; each plan begins
with its slower neighbour's motion, made faster, and is made again where its faster neighbour's, made slower, is better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from leanboom.components.costs import PUMPS
from leanboom.errors import InfeasibleError, InputError
from leanboom.evaluation.evaluate import Evaluation, evaluate
from leanboom.methods.dp_refined import gains
from leanboom.methods.least_duration import shortest_duration, slower
from leanboom.methods.registry import GRID, STEP
from leanboom.model import motion
from leanboom.model.motion import Motion
from leanboom.model.outcome import Kind, Outcome
from leanboom.model.task import Task, take_single
from leanboom.planning import planner
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
            "duration_s": float(self.task.duration),
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
        task: What to do; its path's times are scaled.
        pump: "ls", "cp" or both: whose energy counts.
        durations: Durations of the whole path [s]; None: from the shortest feasible one found to 2.5 times the task's.
        grid: Position and velocity nodes of the coarse grid.
        step: Length of a stage [s].
        effort: As in `planner.run`.
        progress: Called with what happens and the share done.

    Raises:
        InputError: For arguments or tasks that cannot be used.
        InfeasibleError: If the tool cannot follow the path, or no duration is feasible where none is given.
    """
    take_single(task, "energy against duration")
    pumps = tuple(dict.fromkeys((pump,) if isinstance(pump, str) else pump))
    problems: list[str] = []
    if not pumps or any(name not in PUMPS for name in pumps):
        problems.append(f"pump = {', '.join(pumps) or 'nothing'}; must be some of {', '.join(PUMPS)}")
    if task.timing == "shortest":
        problems.append("timing = shortest; must be fixed or free, since durations scale the path's own timing")
    given = None if durations is None else [
        noted(problems, ranges.checked, "duration", each, ranges.DURATION) for each in durations
    ]  # fmt: skip
    if given is not None and not given:
        problems.append("durations = nothing; must be at least one time")
    if problems:
        raise InputError("\n".join(problems))
    tell = progress or quiet
    wanted = usual_durations(task, tell) if given is None else sorted({each for each in given if each is not None})
    tasks = [slower(task, each / task.duration) for each in wanted]
    settings = {"grid": grid, "step": step, "effort": effort}
    points: list[Point] = []
    for at, name in enumerate(pumps):
        points += _curve(tasks, name, settings, lambda text, share, at=at: tell(text, (at + share) / len(pumps)))
    return Pareto(task, pumps, tuple(points))


def usual_durations(task: Task, tell: Progress = quiet) -> list[float]:
    """Durations from the shortest feasible one found to `LONGEST` times the task's [s], in equal ratios.

    Raises:
        InfeasibleError: No feasible duration was found.
    """
    tell("looking for the shortest feasible duration", 0.0)
    factor = shortest_duration(task, COARSE, LONG_STEP, ACCURACY, least=SHORTEST)
    if factor is None:
        raise InfeasibleError(f"no feasible motion found, also not in 16 times the {task.duration:g} s of the path")
    found = task.duration * np.geomspace(factor, LONGEST * max(1.0, factor), COUNT)
    digits = 10.0 ** (np.floor(np.log10(found)) - 2.0)
    return (np.ceil(found / digits) * digits).round(12).tolist()


def _curve(tasks: list[Task], pump: str, settings: dict[str, Any], tell: Progress) -> list[Point]:
    """The points of a pump, for the same task in rising durations."""
    found: list[Point] = []
    for i, task in enumerate(reversed(tasks)):
        tell(f"{pump}: {task.duration:g} s", i / len(tasks))
        seeds = [] if not found else _motions(found[0], task)
        found.insert(0, _point(task, pump, seeds, settings))
    for i in range(1, len(found)):
        here = found[i].plan
        for seed in _motions(found[i - 1], found[i].task):
            judged = evaluate(found[i].task, seed)
            if judged.feasible and (here is None or worse(here.evaluation, judged, pump)):
                tell(f"{pump}: {found[i].task.duration:g} s again, from a faster motion", i / len(tasks))
                found[i] = _point(found[i].task, pump, [seed], settings)
    return found


def worse(one: Evaluation, other: Evaluation, pump: str) -> bool:
    """Whether a judged motion breaks a limit, or takes clearly more energy than another, which keeps them all."""
    return not one.feasible or gains(one.energy(pump), other.energy(pump), GAIN)


def _point(task: Task, pump: str, seeds: list[Motion], settings: dict[str, Any]) -> Point:
    """A task planned for a pump, with motions to begin with."""
    try:
        least_flow.check(task, settings["step"])
    except InputError as error:  # too fast for the pump: a slower one may do
        return Point(task, pump, None, Outcome(Kind.INFEASIBLE, str(error)))
    plan = planner.run(task, pump=pump, warm_start=seeds, explain=False, check=False, **settings)
    return Point(task, pump, plan, plan.status)


def _motions(point: Point, task: Task) -> list[Motion]:
    """The motion of a point, if it is feasible, with its times scaled to those of a task."""
    if point.plan is None or not point.plan.evaluation.feasible:
        return []
    known = point.plan.motion
    factor = task.duration / known.duration
    velocity, start = known.velocity / factor, float(known.position[0])
    return [motion.from_velocities(factor * known.step, start, velocity, known.method, known.cost)]
