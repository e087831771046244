"""The certificate: a proven lower bound on the energy of any motion of a discretised task.

The bound holds for every motion of the discretised problem: the redundant cylinder an exact double integrator over
stages of one step, a stage's energy step x power at its start, feasible extensions at every stage, velocity and
acceleration limits of every moving cylinder at every stage's start, from the given start at rest to rest. It is
not an estimate: coefficients are enclosed over cells with proven remainders (`taylor_model`), costs to go are bounded
over cells (`lower_bounds`), and the rounding of floating-point numbers is covered by `refinement.ROUNDING`.

A cylinder demands pressure above the machine's threshold itself; planned motions stay 1 % inside it, so the
bound holds for motions on the threshold too.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

from leanboom import compiling
from leanboom.budget import Budget
from leanboom.certificate import lower_bounds, refinement, upper_bound, value_slopes
from leanboom.certificate.refinement import Course, Goal, Level, Outlook
from leanboom.certificate.upper_bound import Measured
from leanboom.components.costs import PUMPS
from leanboom.dynamic_programming import value_function
from leanboom.errors import InfeasibleError, InputError
from leanboom.fixed_mode import modes
from leanboom.methods.dp_refined import Search
from leanboom.methods.registry import GRID, STEP
from leanboom.model import motion as motions
from leanboom.model.motion import Motion
from leanboom.model.task import Task
from leanboom.problem import stages, starts
from leanboom.problem.legs import Legs, alone
from leanboom.problem.stages import Problem
from leanboom.progress import Progress
from leanboom.quantities.ranges import STAGE, checked, noted, one_of

HALVINGS = 2  # of a leg's stages at most
SECONDS, GAP = 60.0, 0.5  # time for a proof [s] and gap at which it ends [%], by default


@dataclass(frozen=True, slots=True, eq=False)
class Certificate:
    """A lower bound on the energy of any motion, beside the best motion's energy in the same discretisation."""

    task: Task
    pump: str
    step: float  # length of a stage [s]
    motion: Motion  # the best known motion of the discretised problem
    energy_j: float  # its energy there [J]
    lower_bound_j: float  # no motion takes less [J]
    certify_s: float  # time by the clock, planning not included [s]
    levels: tuple[Level, ...]  # at least one
    reason: str  # why bounding ended
    processor_s: float  # processor time of it, all threads together [s]
    more_time: Outlook | None  # None where time was not what bounding lacked

    @property
    def gap_percent(self) -> float:
        """How much less the best possible motion may take, in percent of the best known one's energy."""
        return refinement.gap_between(self.energy_j, self.lower_bound_j)

    def json(self) -> dict[str, Any]:
        """The keys that `--json` adds: bound and best energy in the same discretisation, and the levels."""
        return {
            "discretised_energy_j": self.energy_j,
            "lower_bound_j": self.lower_bound_j,
            "gap_percent": self.gap_percent,
            "certify_s": self.certify_s,
            "certify_processor_s": self.processor_s,
            "certify_reason": self.reason,
            "certify_levels": [asdict(level) for level in self.levels],
            "certify_more_time": None if self.more_time is None else asdict(self.more_time),
        }

    def __repr__(self) -> str:
        return (
            f"Certificate({self.task.name}, {self.pump}: at least {self.lower_bound_j:.6g} J, best known "
            f"{self.energy_j:.6g} J, gap {self.gap_percent:.2f} % in {self.certify_s:.1f} s)"
        )


def certify(
    task: Task,
    pump: str = "ls",
    *,
    motion: Motion | None = None,
    step: float = STEP,
    seconds: float = SECONDS,
    gap: float = GAP,
    progress: Progress | None = None,
) -> Certificate:
    """Prove how far a plan can be from the global optimum of its discretised problem.

    Args:
        task: What to do; `task.start` says where the redundant cylinder starts. With legs, the task of a plan.
        pump: "ls" or "cp": whose energy counts.
        motion: The motion to compare with, from the task's start; by default the planner's. Of legs it must be given.
        step: Length of a stage [s].
        seconds: Time after which bounding ends, planning not included [s]: processor time on every processor used,
            and twice as much by the clock at most. The coarsest level is finished however short it is.
        gap: Gap at which bounding ends [%].
        progress: Called with what happens and the share done.

    Returns:
        The certificate; its bound is valid whenever it ended.

    Raises:
        InputError: For arguments or tasks that cannot be used.
        InfeasibleError: If it is proven that no motion keeps all limits, or none was found to compare with.
    """
    tell = progress or (lambda text, share: None)
    check(pump, step, seconds, gap)
    if not provable(task):
        raise InputError("pump.efficiency is a map; a certificate needs a constant efficiency")
    if task.legs and motion is None:
        raise InputError(f"motion = nothing; task {task.name} has legs, whose certificate needs the motion of a plan")
    if motion is None:
        motion = _planned(task, pump, step, tell)
    tell("loading kernels of the bounds", 0.0)
    with compiling.told(tell):
        value_function.prepare()
        modes.prepare()
        lower_bounds.prepare()
        value_slopes.prepare()
    budget = Budget(seconds)
    if abs(motion.duration - task.duration) > 1e-6 * task.duration:
        raise InputError(f"motion takes {motion.duration:g} s; the task takes {task.duration:g} s")
    tell("best motion of the discretised problem", 0.02)
    legs, parts = _best_known(task, motion, pump, step)
    start = starts.start_position(legs.problems[0], task.start)
    if start is not None and abs(motion.position[0] - start) > 1e-6:
        raise InputError(f"motion starts at {motion.position[0]:.4f} m; the task's start is {start:.4f} m")
    if not all(part.keeps_limits for part in parts):
        longest = max(problem.step for problem in legs.problems)
        raise InfeasibleError(
            f"the motion breaks a limit at the start of a stage of {longest:.4g} s: so long stages may be too "
            "coarse for this task; plan and certify with one step, and a shorter one"
        )
    best = upper_bound.joined(parts)
    end, closed = starts.end_position(legs.problems[-1], start), task.end == "same" and start is None
    course = Course(Goal(legs, pump, start, end, best, gap, closed), budget, tell)
    levels = tuple(refinement.levels(course))
    tell("done", 1.0)
    step = max(problem.step for problem in legs.problems)
    return Certificate(
        task, pump, step, _whole(task, parts), best.energy, course.lower, budget.gone, levels, course.reason,
        budget.processor, course.outlook(levels) if course.reason == refinement.TIME_IS_OVER else None,
    )  # fmt: skip


def _best_known(task: Task, motion: Motion, pump: str, step: float) -> tuple[Legs, list[Measured]]:
    """A task's discretised legs, and the best known motion of each, from where `motion` begins it to where it ends it.

    The motion of a path alone with a free start may move its start.

    Args:
        task: The task.
        motion: A motion of the whole task.
        pump: "ls" or "cp".
        step: Length of a stage [s].
    """
    if not task.legs:
        problem = stages.discretise(task, step)
        known = upper_bound.measure(problem, starts.ended(problem, motion), pump)
        free = task.start == "best" and task.end != "same"
        return Legs((problem,)), [upper_bound.improve(problem, known, pump, free)]
    moves = [each for each in task.stretches if not each.waits]
    found = [
        _best_leg(leg, motions.between(motion, each.since, each.until), pump, step, HALVINGS)
        for leg, each in zip(alone(task), moves, strict=True)
    ]
    return Legs(tuple(problem for problem, _ in found)), [best for _, best in found]


def _best_leg(leg: Task, part: Motion, pump: str, step: float, halvings: int) -> tuple[Problem, Measured]:
    """A leg, discretised, and its best known motion between the ends of one.

    Stages are halved where that keeps no limits on them: in a leg of the shortest time there may be no other motion.
    """
    problem = stages.discretise(leg, step)
    pinned = replace(problem, task=replace(leg, start=float(part.position[0]), end=float(part.position[-1])))
    known = upper_bound.measure(pinned, starts.ended(pinned, part), pump)
    best = upper_bound.improve(pinned, known, pump, False)
    if best.keeps_limits or not halvings:
        return problem, best
    return _best_leg(leg, part, pump, 0.5 * step, halvings - 1)


def _whole(task: Task, parts: list[Measured]) -> Motion:
    """The motion of a task made of those of its legs, at rest between them."""
    if not task.legs:
        return parts[0].motion
    found = []
    for each in task.stretches:
        leg = parts[each.leg].motion
        held = motions.held(float(leg.position[0]), each.until - each.since, leg.method, leg.cost)
        found.append(held if each.waits else leg)
    return motions.joined(found)


def provable(task: Task) -> bool:
    """Whether a task's energy can be bounded: not with a map of the pump's efficiency."""
    return isinstance(task.machine.pump.efficiency, float | int)


def _planned(task: Task, pump: str, step: float, tell: Progress) -> Motion:
    """The planner's motion of a task; InfeasibleError where none keeps all limits."""
    value_function.check_memory(stages.count(task.duration, step), *GRID)
    tell("loading kernels", 0.0)
    with compiling.told(tell):
        value_function.prepare()
        modes.prepare()
    best = Search(task, pump, GRID, step, tell=tell).run()
    if not best.feasible:
        raise InfeasibleError(f"no feasible motion found: {best.status}", evaluation=best)
    return best.motion


def check(pump: str, step: float, seconds: float, gap: float) -> None:
    """Raise InputError for arguments of `certify` that cannot be used, all problems at once."""
    problems: list[str] = []
    noted(problems, one_of, "pump", pump, PUMPS)
    noted(problems, checked, "step", step, STAGE)
    if not seconds > 0.0:
        problems.append(f"seconds = {seconds:g} s; must be above 0")
    if not 0.0 <= gap < 100.0:
        problems.append(f"gap = {gap:g} %; must be from 0 to below 100")
    if problems:
        raise InputError("; ".join(problems))
