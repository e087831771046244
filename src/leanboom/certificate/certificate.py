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

from dataclasses import asdict, dataclass
from typing import Any

from leanboom import compiling
from leanboom.budget import Budget
from leanboom.certificate import lower_bounds, refinement, upper_bound, value_slopes
from leanboom.certificate.refinement import Course, Goal, Level, Outlook
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
from leanboom.progress import Progress
from leanboom.quantities.ranges import STAGE, checked, noted, one_of

BY_LEGS = "each leg bounded from and to any extension"
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
    levels: tuple[Level, ...]  # at least one; none of a task with legs
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
    if task.legs:
        return _of_legs(task, pump, motion, step, seconds, gap, tell)
    if motion is None:
        motion = _planned(task, pump, step, tell)
    tell("loading kernels of the bounds", 0.0)
    with compiling.told(tell):
        value_function.prepare()
        modes.prepare()
        lower_bounds.prepare()
        value_slopes.prepare()
    budget = Budget(seconds)
    problem = stages.discretise(task, step)
    start = starts.start_position(problem, task.start)
    if start is not None and abs(motion.position[0] - start) > 1e-6:
        raise InputError(f"motion starts at {motion.position[0]:.4f} m; the task's start is {start:.4f} m")
    if abs(motion.step * motion.acceleration.size - task.duration) > 1e-6 * task.duration:
        raise InputError(
            f"motion takes {motion.step * motion.acceleration.size:g} s; the task takes {task.duration:g} s"
        )
    tell("best motion of the discretised problem", 0.02)
    known = upper_bound.measure(problem, stages.on_stages(problem, motion), pump)
    best = upper_bound.improve(problem, known, pump, start is None and task.end != "same")
    if not best.keeps_limits:
        raise InfeasibleError(
            f"the motion breaks a limit at the start of a stage of {problem.step:.4g} s: so long stages may be too "
            "coarse for this task; plan and certify with one step, and a shorter one"
        )
    end = starts.end_position(problem, start)
    course = Course(Goal(problem, pump, start, end, best, gap), budget, tell)
    levels = tuple(refinement.levels(course))
    tell("done", 1.0)
    return Certificate(
        task, pump, problem.step, best.motion, best.energy, course.lower, budget.gone, levels, course.reason,
        budget.processor, course.outlook(levels) if course.reason == refinement.TIME_IS_OVER else None,
    )  # fmt: skip


def _of_legs(
    task: Task, pump: str, motion: Motion | None, step: float, seconds: float, gap: float, tell: Progress
) -> Certificate:
    """The certificate of a task with legs: the sum of bounds of its legs.

    Each leg is bounded from and to any extension, but for a given start or end of the whole. Whatever the extensions
    between legs are, no leg takes less, so no cycle takes less than all of them; what the legs hand on to each other
    is left out, so the gap is larger than that of one leg.
    """
    if motion is None:
        raise InputError(f"motion = nothing; task {task.name} has legs, whose certificate needs the motion of a plan")
    if abs(motion.duration - task.duration) > 1e-6 * task.duration:
        raise InputError(
            f"motion takes {motion.duration:g} s; the task takes {task.duration:g} s: use that of the plan"
        )
    legs = [each for each in task.stretches if not each.waits]
    lower = energy = clock = processor = 0.0
    for i, each in enumerate(legs):
        part = motions.between(motion, each.since, each.until)
        start = task.start if i == 0 else "best"
        end = task.end if i == len(legs) - 1 and task.end != "same" else "free"
        if task.end == "same" and i == len(legs) - 1 and task.start != "best":
            end = float(motion.position[-1])
        leg = task.stretch(each, start, end)
        proof = certify(leg, pump, motion=part, step=step, seconds=seconds / len(legs), gap=gap, progress=tell)
        problem = stages.discretise(leg, step)
        energy += upper_bound.measure(problem, stages.on_stages(problem, part), pump).energy
        lower, clock, processor = lower + proof.lower_bound_j, clock + proof.certify_s, processor + proof.processor_s
    return Certificate(task, pump, step, motion, energy, lower, clock, (), BY_LEGS, processor, None)


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
