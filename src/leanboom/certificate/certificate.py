"""The certificate: a proven lower bound on the energy of any motion of a discretised task.

The bound holds for every motion of the discretised problem: the redundant cylinder an exact double integrator over
stages of one step, a stage's energy step x power at its start, feasible extensions at every stage, velocity and
acceleration limits of every moving cylinder at every stage's start, from the given start at rest to rest. It is
not an estimate: coefficients are enclosed over cells with proven remainders (`taylor_model`), costs to go are bounded
over cells (`bounds`), and the rounding of floating-point numbers is covered by `ROUNDING`.

A cylinder counts as driven above the machine's `driven_velocity` itself; planned motions stay 1 % inside it, so the
bound holds for motions on the threshold too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import cache, partial
from typing import Any

import numpy as np

from leanboom import compiling, resources
from leanboom.budget import Budget
from leanboom.certificate import lower_bounds, partition, upper_bound, value_slopes
from leanboom.certificate.upper_bound import Measured
from leanboom.components.costs import PUMPS
from leanboom.dynamic_programming import value_function
from leanboom.errors import InfeasibleError, InputError, LeanboomError
from leanboom.fixed_mode import modes
from leanboom.methods.dp_refined import Search
from leanboom.methods.registry import GRID, STEP
from leanboom.model.motion import Motion
from leanboom.model.task import Task
from leanboom.problem import stages, starts
from leanboom.problem.stages import Problem
from leanboom.progress import Progress

SECONDS, GAP = 60.0, 0.5  # time for a proof [s] and gap at which it ends [%], by default
ROUNDING = 1e-9  # share of the bound that covers the rounding of floating-point numbers
ENOUGH = 0.99  # share of the gap asked for by which energies are below the best known one where cells are dropped
PROMISE = 0.5  # share of a level's gap that may be left with the same slopes on the next
HOPELESS = 15.0  # gap [%] at which cells are so large that nothing but smaller ones is worth its time
SLACK = 2e-3  # share of the energy that a motion may save by using limits to the judge's tolerance
FINEST = (1, 1)  # how coarse the first level is where there is time
SURE = 2.0  # times the expected time that must be left for the finest level: what if it does not end?
GROWING = 0.7  # share of the coarsest level's time that grows with the number of cells, at most
LONGER = 0.25  # by which share more time than was spent is worth asking for, at least
EMPTY = 1e-3  # share of the energy below which a bound says nothing
FLAT = 0.05  # order in the number of cells below which gaps do not fall enough to say what smaller cells bring
TIME_IS_OVER = "time is over"
TRUST = 1e-6  # share of the energy by which a check along a motion may be off, rounding of many sums


@dataclass(frozen=True, slots=True)
class Level:
    """One round of bounding: cells of one size."""

    positions: int  # cells between the ends of the feasible extensions where they are largest
    velocities: int  # cells between the velocity limits where they are largest
    cells: int  # cells looked at, all stages together
    lower_bound_j: float  # the best bound so far [J]
    gap_percent: float
    seconds: float  # since the beginning, by the clock
    processor_s: float  # processor time since the beginning, all threads together [s]


@dataclass(frozen=True, slots=True)
class Outlook:
    """What more time would bring: an extrapolation from the levels so far, nothing proven."""

    seconds: float  # to ask for, so that one more level can be expected to end [s]
    gap_percent: float | None  # gap to expect then; None where the levels do not say


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
        return _gap(self.energy_j, self.lower_bound_j)

    def json(self) -> dict[str, Any]:
        """What `--json` adds: the bound beside the best motion's energy in the same discretisation, and its course."""
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


@dataclass(slots=True)
class _Way:
    """A way to choose the slopes of planes."""

    slopes: Callable[[], lower_bounds.GivenSlopes | None]
    coarse: bool = False  # as in `lower_bounds.bound`
    promise: float = 0.0  # gap that it may reach on the next level [%]

    def bound(
        self, kept: partition.Cells, start: float | None, energy: float, clock: Callable[[float], None], limit: float
    ) -> lower_bounds.Bounds:
        """The bound with these slopes."""
        found = lower_bounds.bound(kept, start, clock, self.slopes(), limit, self.coarse)
        self.promise = _gap(energy, found.lower)
        return found


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
        task: What to do; `task.start` says where the redundant cylinder starts.
        pump: "ls" or "cp": whose energy counts.
        motion: The motion to compare with, from the task's start; by default the planner's.
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
    best = upper_bound.improve(
        problem, upper_bound.measure(problem, stages.on_stages(problem, motion), pump), pump, start is None
    )
    if not best.keeps_limits:
        raise InfeasibleError(
            f"the motion breaks a limit at the start of a stage of {problem.step:.4g} s: so long stages may be too "
            "coarse for this task; plan and certify with one step, and a shorter one"
        )
    proof = _Proof(problem, pump, start, best, gap, budget, tell)
    reason = _bound(proof)
    tell("done", 1.0)
    return Certificate(
        task, pump, problem.step, best.motion, best.energy, proof.lower, budget.gone, tuple(proof.levels), reason,
        budget.processor, proof.outlook() if reason == TIME_IS_OVER else None,
    )  # fmt: skip


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
    problems = []
    if pump not in PUMPS:
        problems.append(f"pump = {pump}; must be one of {', '.join(PUMPS)}")
    if not 1e-3 <= step <= 1.0:
        problems.append(f"step = {step:g} s; must be from 0.001 s to 1 s")
    if not seconds > 0.0:
        problems.append(f"seconds = {seconds:g} s; must be above 0")
    if not 0.0 <= gap < 100.0:
        problems.append(f"gap = {gap:g} %; must be from 0 to below 100")
    if problems:
        raise InputError("; ".join(problems))


@dataclass(slots=True, eq=False)
class _Proof:
    """What is proven so far, and what is under way."""

    problem: Problem
    pump: str
    start: float | None
    best: Measured
    gap: float
    budget: Budget
    tell: Progress
    levels: list[Level] = field(default_factory=list)
    whole: list[tuple[int, int]] = field(default_factory=list)  # how coarse the levels of whole stages were
    lower: float = 0.0
    rate: float = 0.0  # time that a cell of the last level took [s]
    begun: float = 0.0  # time spent when what is under way began [s]
    under_way: tuple[int, int] = (0, 0)  # its cells: of a stage, and all looked at; 0 while not known

    @property
    def enough(self) -> float:
        """Energy of motions that need no closer look [J]."""
        return self.best.energy * (1.0 + ROUNDING - ENOUGH * self.gap / 100.0)

    @property
    def reached(self) -> bool:
        """Whether the gap asked for is proven."""
        return _gap(self.best.energy, self.lower) <= self.gap

    def clock(self, share: float = 0.0, *, name: str = "") -> None:
        """The check of a pass over cells: end it when the time is over."""
        if self.budget.over:
            raise lower_bounds.OutOfTime
        gap = f"gap so far {_gap(self.best.energy, self.lower):.2f} %"
        self.tell(f"{name}, {gap}" if name else gap, min(0.99, 0.05 + 0.94 * self.budget.spent / self.budget.seconds))

    def begin(self, kept: partition.Cells | None) -> Callable[[float], None]:
        """Note what is under way; returns its clock."""
        self.begun = self.budget.spent
        if kept is None:
            self.under_way = 0, 0
            return self.clock
        rows, columns = _size(kept)
        self.under_way = rows * columns, kept.count
        return partial(self.clock, name=f"cells {rows}x{columns}")

    def add(self, size: tuple[int, int], count: int, lower: float) -> None:
        """One more level, and what it proves."""
        self.rate = (self.budget.spent - self.begun) / max(count, 1)
        self.lower = max(self.lower, lower * (1.0 - ROUNDING))
        gap = _gap(self.best.energy, self.lower)
        self.levels.append(Level(*size, count, self.lower, gap, self.budget.gone, self.budget.processor))

    def check(self, found: lower_bounds.Bounds, whole: bool) -> None:
        """Refuse a bound that cannot be right; `whole` says that no motion leaves the cells."""
        if whole and not np.isfinite(found.lower):
            raise InfeasibleError("proven: no motion of the discretised problem keeps every limit")
        _check_along(found, self.best)
        if whole and found.lower > (1.0 + SLACK) * self.best.energy:
            raise LeanboomError("the bound is above the energy of the motion it is compared with; nothing is certified")

    def bound_coarse(self, times: tuple[int, int], hurry: bool) -> lower_bounds.Bounds:
        """A level of coarse cells, finished whatever the clock says unless there is a hurry."""
        kept = partition.whole(self.problem, self.pump, self.best.motion, times)
        clock = self.begin(kept)
        found = lower_bounds.bound(kept, self.start, clock if hurry else lambda share: None, coarse=True)
        self.check(found, True)
        self.whole.append(times)
        self.add(_size(kept), kept.count, min(found.lower, self.best.energy))
        return found

    def in_time(self) -> tuple[int, int] | None:
        """How coarse the finest whole level is that can be expected to end in time; None where none can.

        On a busy machine a minute is not like the one before: the finest level needs twice the time it should take.
        """
        for times in (FINEST, *reversed(partition.COARSE[1:])):
            size = partition.size(self.problem, self.pump, self.best.motion, times)
            takes = GROWING * self.rate * size.count * (SURE if times == FINEST else 1.0)
            if self.budget.spent + takes <= self.budget.seconds and partition.memory_of(self.problem, size) < _memory():
                return times
        return None

    def outlook(self) -> Outlook:
        """What more time would bring, from how long a cell took and how the gap fell from level to level."""
        last = self.levels[-1]
        size, count = self.under_way if self.under_way[1] else (4 * last.positions * last.velocities, 4 * last.cells)
        needed = max(self.begun + self.rate * count, (1.0 + LONGER) * self.budget.spent)
        empty = EMPTY * self.best.energy
        known = {e.positions * e.velocities: e.gap_percent for e in self.levels if e.lower_bound_j >= empty}
        gap = None
        if len(known) > 1:
            (few, wide), (many, narrow) = sorted(known.items())[-2:]
            order = min(np.log(wide / narrow) / np.log(many / few), 1.0)
            gap = max(narrow * (many / max(size, many)) ** order, self.gap) if order > FLAT else None
        return Outlook(float(f"{needed:.2g}"), gap)


def _bound(proof: _Proof) -> str:
    """Bound on ever smaller cells until the gap or the time is reached; returns why it ended."""
    proof.tell("enclosing the crane's motion over cells", 0.05)
    found = proof.bound_coarse(partition.COARSE[0], hurry=False)
    try:
        return _refine(proof, found)
    except lower_bounds.OutOfTime:
        under_way = proof.begun, proof.under_way
        for times in partition.COARSE:
            # A bound of nothing says nothing: cells small enough for more, whatever the clock says.
            if proof.lower < EMPTY * proof.best.energy and times not in proof.whole:
                proof.bound_coarse(times, hurry=False)
        proof.begun, proof.under_way = under_way
        return TIME_IS_OVER


def _refine(proof: _Proof, found: lower_bounds.Bounds) -> str:
    """Go on from the bounds of the coarsest level; returns why it ended, raises OutOfTime."""
    problem, best, times, whole = proof.problem, proof.best, proof.in_time(), False
    kept = None
    if times == FINEST:
        kept, whole = partition.whole(problem, proof.pump, best.motion), True
    elif times is not None and not proof.reached:
        found = proof.bound_coarse(times, hurry=True)
    viable = (kept or found.cells).viable
    ways = [_Way(lambda: None, coarse=kept is None)]
    if value_slopes.memory(problem) < _memory():
        ways.append(_Way(cache(lambda: value_slopes.make(problem, proof.pump, viable, best.motion).slopes)))
    while not proof.reached:
        if kept is None:
            excess = lower_bounds.reach(found, proof.enough, proof.begin(None))
            if lower_bounds.memory(found.cells, excess) > _memory():
                return "smaller cells would not fit into the memory"
            # Where power has no jumps, halving the first rows gains next to nothing beside halving velocities.
            rows_too = not whole or proof.pump == "ls" or _gap(best.energy, proof.lower) > HOPELESS
            kept, whole = lower_bounds.refine(found, excess, rows_too), False
            if kept is None:  # no motion stays in the cells
                rows, columns = _size(found.cells)
                proof.add(((2 if rows_too else 1) * rows, 2 * columns), 0, min(proof.enough, best.energy))
                break
        # Whole stages are bounded without a limit: their bound is checked against the best motion's energy.
        clock, limit = proof.begin(kept), np.inf if whole else proof.enough
        found = _tightest(kept, proof.start, best.energy, proof.gap, ways, clock, limit)
        proof.check(found, whole)
        outside = best.energy if whole else min(proof.enough, best.energy)  # no motion that leaves the cells takes less
        proof.add(_size(kept), kept.count, min(found.lower, outside))
        kept = None
    return "gap reached"


def _memory() -> float:
    """Memory that bounding may take [bytes]."""
    return 0.5 * resources.free_memory()


def _size(kept: partition.Cells) -> tuple[int, int]:
    """Rows and columns of a stage's cells, narrower ones apart."""
    return kept.positions, int(kept.velocities.min())


def _tightest(
    kept: partition.Cells, start: float | None, energy: float, gap: float, ways: list[_Way],
    clock: Callable[[float], None], limit: float,
) -> lower_bounds.Bounds:  # fmt: skip
    """The highest bound by the way that promises most, and by others while they promise more than was found."""
    first, *others = sorted(ways, key=lambda each: each.promise)
    best = first.bound(kept, start, energy, clock, limit)
    for way in others:
        left = _gap(energy, best.lower)
        if left > HOPELESS:
            way.promise = max(way.promise, left)
            continue
        if left <= max(gap, way.promise):
            break
        try:
            found = way.bound(kept, start, energy, clock, limit)
        except lower_bounds.OutOfTime:
            break
        best = found if found.lower > best.lower else best
    for way in ways:
        way.promise *= PROMISE
    return best


def _check_along(found: lower_bounds.Bounds, best: Measured) -> None:
    """A bound that contradicts a motion is wrong: refuse to certify with it."""
    worst = float(lower_bounds.residuals(found, best.motion, best.costs).min())
    if worst < -TRUST * best.energy:
        raise LeanboomError(
            f"the bound contradicts the motion it is compared with by {-worst:.3g} J; nothing is certified"
        )


def _gap(energy: float, lower: float) -> float:
    return 100.0 * max(0.0, energy - lower) / energy if energy > 0.0 else 0.0
