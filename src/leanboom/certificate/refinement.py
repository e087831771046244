"""Refinement of the lower bound: levels of smaller cells until the required gap is proven or the time is over.

The first level is so coarse that it always ends. Which of the finer ones is next depends on how long its cells took;
which slopes its planes get, on what each kind of slopes left open on the level before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, partial

import numpy as np

from leanboom import resources
from leanboom.budget import Budget
from leanboom.certificate import lower_bounds, partition, value_slopes
from leanboom.certificate.lower_bounds import Bounds, OutOfTime
from leanboom.certificate.partition import Cells
from leanboom.certificate.position_rows import LEAST_RANGE
from leanboom.certificate.upper_bound import Measured
from leanboom.errors import InfeasibleError, LeanboomError
from leanboom.problem.legs import Legs
from leanboom.progress import Progress

ROUNDING = 1e-9  # share of the bound that covers the rounding of floating-point numbers
ENOUGH = 0.99  # share of the gap asked for by which energies are below the best known one where cells are dropped
GAP_RATIO = 0.5  # of a level's gap to that of the level before, at best, with the same kind of slopes
HOPELESS = 15.0  # gap [%] at which cells are so large that nothing but smaller ones is worth its time
SLACK = 2e-3  # share of the energy that a motion may save by using limits to the judge's tolerance
FINEST = (1, 1)  # how coarse the first level is where there is time
SURE = 2.0  # times the expected time that must be left for the finest level: what if it does not end?
GROWING = 0.7  # share of the coarsest level's time that grows with the number of cells, at most
LONGER = 0.25  # by which share more time than was spent is worth asking for, at least
EMPTY = 1e-3  # share of the energy below which a bound says nothing
FLAT = 0.05  # order in the number of cells below which gaps do not fall enough to say what smaller cells bring
TRUST = 1e-6  # share of the energy by which a check along a motion may be off, rounding of many sums
GAP_REACHED, TIME_IS_OVER = "gap reached", "time is over"
MEMORY_IS_FULL = "smaller cells would not fit into the memory"


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
    """Extrapolated gap after more computing time, from the levels so far; not proven."""

    seconds: float  # to ask for, so that one more level can be expected to end [s]
    gap_percent: float | None  # gap to expect then; None where the levels do not say


@dataclass(frozen=True, slots=True, eq=False)
class Goal:
    """The gap to prove between the best known motion of a discretised problem and the best possible one."""

    legs: Legs
    pump: str
    start: float | None  # of the redundant cylinder [m]; None: anywhere feasible
    end: float | None  # likewise
    best: Measured  # on the stages of all legs
    gap: float  # [%]
    closed: bool = False  # whether motions end where they start, wherever that is

    @property
    def enough(self) -> float:
        """Cut-off energy: cells of which all motions take more are dropped [J]."""
        return self.best.energy * (1.0 + ROUNDING - ENOUGH * self.gap / 100.0)

    def cells(self, times: tuple[int, int]) -> Cells:
        """Cells of whole stages; arguments as in `partition.size`."""
        return partition.whole(self.legs, self.pump, self.best.motion, times)

    def check(self, found: Bounds, whole: bool) -> None:
        """Refuse a bound that cannot be right; `whole` says that no motion leaves the cells."""
        if whole and not np.isfinite(found.lower):
            raise InfeasibleError("proven: no motion of the discretised problem keeps every limit")
        worst = float(lower_bounds.residuals(found, self.best.motion, self.best.costs).min())
        if worst < -TRUST * self.best.energy:
            raise LeanboomError(
                f"the bound contradicts the motion it is compared with by {-worst:.3g} J; nothing is certified"
            )
        if whole and found.lower > (1.0 + SLACK) * self.best.energy:
            raise LeanboomError("the bound is above the energy of the motion it is compared with; nothing is certified")


@dataclass(slots=True, eq=False)
class Course:
    """Progress of a proof: finished levels and the level being computed."""

    goal: Goal
    budget: Budget
    tell: Progress
    lower: float = 0.0  # proven so far [J]
    rate: float = 0.0  # time that a cell of the last level took [s]
    begun: float = 0.0  # time spent when what is under way began [s]
    under_way: tuple[int, int] = (0, 0)  # its cells: of a stage, and all looked at; 0 while not known
    coarse: list[tuple[int, int]] = field(default_factory=list)  # how coarse the coarse levels were
    reason: str = ""  # why it ended
    multiplier: np.ndarray | None = None  # where motions close, as `lower_bounds.bound` has it

    @property
    def gap(self) -> float:
        """Gap that is proven [%]."""
        return gap_between(self.goal.best.energy, self.lower)

    def begin_free(self) -> None:
        """Begin a whole level of closed motions with a free end: with larger cells' multiplier it may say less."""
        if self.goal.closed:
            low, high = float(self.goal.legs.lower[0]), float(self.goal.legs.upper[0])
            self.multiplier = np.array([[low, max(high, low + LEAST_RANGE)], [0.0, 0.0]])

    def bound(
        self, kept: Cells, check: Callable[[float], None], guide: lower_bounds.GivenSlopes | None = None,
        limit: float = np.inf, coarse: bool = False,
    ) -> Bounds:  # fmt: skip
        """Bounds over cells; arguments as in `lower_bounds.bound`.

        Of closed motions each pass tells the next ones which multiplier to take.
        """
        goal = self.goal
        found = lower_bounds.bound(
            kept, goal.start, check, guide, limit, coarse, end=goal.end, multiplier=self.multiplier
        )
        if self.multiplier is not None:
            self.multiplier = lower_bounds.steeper(found, self.multiplier)
        return found

    def clock(self, share: float = 0.0, *, name: str = "") -> None:
        """The check of a pass over cells: it raises OutOfTime when the time is over."""
        if self.budget.over:
            raise OutOfTime
        gap = f"gap so far {self.gap:.2f} %"
        self.tell(f"{name}, {gap}" if name else gap, min(0.99, 0.05 + 0.94 * self.budget.spent / self.budget.seconds))

    def begin(self, kept: Cells | None) -> Callable[[float], None]:
        """Set the level under way; returns its check of time."""
        self.begun = self.budget.spent
        if kept is None:
            self.under_way = 0, 0
            return self.clock
        rows, columns = _size(kept)
        self.under_way = rows * columns, kept.count
        return partial(self.clock, name=f"cells {rows}x{columns}")

    def level(self, size: tuple[int, int], count: int, lower: float) -> Level:
        """The `Level` of so many rows and columns, with so many cells in all."""
        self.rate = (self.budget.spent - self.begun) / max(count, 1)
        self.lower = max(self.lower, lower * (1.0 - ROUNDING))
        return Level(*size, count, self.lower, self.gap, self.budget.gone, self.budget.processor)

    def outlook(self, levels: Sequence[Level]) -> Outlook:
        """The expected gap and time of one more level, from the time a cell took and the fall of the gap."""
        last = levels[-1]
        size, count = self.under_way if self.under_way[1] else (4 * last.positions * last.velocities, 4 * last.cells)
        needed = max(self.begun + self.rate * count, (1.0 + LONGER) * self.budget.spent)
        gap = expected_gap(levels, size, EMPTY * self.goal.best.energy)
        return Outlook(float(f"{needed:.2g}"), None if gap is None else max(gap, self.goal.gap))


def levels(course: Course) -> Iterator[Level]:
    """Levels of ever smaller cells, at least one, until the gap or the time is reached (`course.reason`)."""
    goal = course.goal
    course.tell("enclosing the crane's motion over cells", 0.05)
    found, level = coarse_level(course, partition.COARSE[0], hurry=False)
    yield level
    try:
        yield from _finer_levels(course, found)
    except OutOfTime:
        course.reason = TIME_IS_OVER
        under_way = course.begun, course.under_way
        for times in partition.COARSE:
            # A bound of nothing says nothing: cells small enough for more, whatever the clock says.
            if course.lower < EMPTY * goal.best.energy and times not in course.coarse:
                yield coarse_level(course, times, hurry=False)[1]
        course.begun, course.under_way = under_way


def coarse_level(course: Course, times: tuple[int, int], hurry: bool) -> tuple[Bounds, Level]:
    """A level of coarse cells, finished whatever the time unless `hurry` is set."""
    goal, kept = course.goal, course.goal.cells(times)

    def bound() -> Bounds:
        clock = course.begin(kept)
        return course.bound(kept, clock if hurry else lambda share: None, coarse=True)

    course.begin_free()
    found = bound()
    if goal.closed:
        with suppress(OutOfTime):
            found = max(found, bound(), key=lambda each: each.lower)
    goal.check(found, True)
    course.coarse.append(times)
    return found, course.level(_size(kept), kept.count, min(found.lower, goal.best.energy))


def _finer_levels(course: Course, found: Bounds) -> Iterator[Level]:
    """Levels from the bounds of the coarsest one on; raises OutOfTime."""
    goal, budget, whole, kept = course.goal, course.budget, False, None
    legs, best = goal.legs, goal.best
    sizes = {times: partition.size(legs, goal.pump, best.motion, times) for times in (FINEST, *partition.COARSE[1:])}
    needed = {times: (size.count, partition.memory_of(legs, size)) for times, size in sizes.items()}
    times = finest_in_time(needed, course.rate, budget.seconds - budget.spent, room())
    if times == FINEST:
        kept, whole = goal.cells(FINEST), True
        course.begin_free()
    elif times is not None and course.gap > goal.gap:
        found, level = coarse_level(course, times, hurry=True)
        yield level
    viable, coarse = (kept or found.cells).viable, kept is None
    guides: list[Callable[[], lower_bounds.GivenSlopes | None]] = [lambda: None]
    if value_slopes.memory(legs) < room():
        given = legs, goal.pump, viable, best.motion, goal.end
        guides.append(cache(lambda: value_slopes.make(*given, course.multiplier).slopes))
    expected = (0.0,) * len(guides)
    while course.gap > goal.gap:
        if kept is None:
            excess = lower_bounds.reach(found, goal.enough, course.begin(None))
            if lower_bounds.memory(found.cells, excess) > room():
                course.reason = MEMORY_IS_FULL
                return
            # Where power has no jumps, halving the first rows gains next to nothing beside halving velocities.
            rows_too = not whole or goal.pump == "ls" or course.gap > HOPELESS
            kept, whole = lower_bounds.refine(found, excess, rows_too), False
            if kept is None:  # no motion stays in the cells
                rows, columns = _size(found.cells)
                yield course.level(((2 if rows_too else 1) * rows, 2 * columns), 0, min(goal.enough, best.energy))
                break
        # Whole stages are bounded without a limit: their bound is checked against the best motion's energy.
        clock, limit = course.begin(kept), np.inf if whole else goal.enough

        def bound(way: int, kept: Cells = kept, clock=clock, limit: float = limit) -> Bounds:
            return course.bound(kept, clock, guides[way](), limit, coarse and way == 0)

        found, expected = tightest(bound, expected, best.energy, goal.gap)
        goal.check(found, whole)
        outside = best.energy if whole else min(goal.enough, best.energy)  # no motion that leaves the cells takes less
        yield course.level(_size(kept), kept.count, min(found.lower, outside))
        kept = None
    course.reason = GAP_REACHED


def tightest(
    bound: Callable[[int], Bounds], expected: tuple[float, ...], energy: float, gap: float
) -> tuple[Bounds, tuple[float, ...]]:
    """The highest bound by the slopes of least expected gap, and by the others where theirs may be less.

    Args:
        bound: Bounds the level with slopes of a kind; raises OutOfTime.
        expected: Gap that each kind of slopes may leave on this level, at best [%].
        energy: Energy of the best known motion [J].
        gap: Gap asked for [%].

    Returns:
        The bound, and the gaps to expect on the next level.
    """
    first, *others = sorted(range(len(expected)), key=lambda way: expected[way])
    best, left = bound(first), list(expected)
    left[first] = gap_between(energy, best.lower)
    for way in others:
        still = gap_between(energy, best.lower)
        if still > HOPELESS:
            left[way] = max(left[way], still)
            continue
        if still <= max(gap, left[way]):
            break
        try:
            found = bound(way)
        except OutOfTime:
            break
        left[way] = gap_between(energy, found.lower)
        best = found if found.lower > best.lower else best
    return best, tuple(GAP_RATIO * each for each in left)


def finest_in_time(
    needed: dict[tuple[int, int], tuple[int, float]], rate: float, seconds: float, memory: float
) -> tuple[int, int] | None:
    """Coarseness of the finest whole level expected to end in time; None where none is.

    On a busy machine a minute is not like the one before: the finest level needs twice the time it should take.

    Args:
        needed: Number of cells and memory [bytes] of levels, by how coarse they are.
        rate: Time that a cell of the coarsest level took [s].
        seconds: Time left [s].
        memory: Memory that may be taken [bytes].
    """
    for times in sorted(needed):
        count, size = needed[times]
        if GROWING * rate * count * (SURE if times == FINEST else 1.0) <= seconds and size < memory:
            return times
    return None


def expected_gap(levels: Sequence[Level], size: int, empty: float) -> float | None:
    """Gap [%] of a level with `size` cells a stage, from the two finest ones whose bound is above `empty` [J].

    None where they do not say.
    """
    known = {e.positions * e.velocities: e.gap_percent for e in levels if e.lower_bound_j >= empty}
    if len(known) < 2:
        return None
    (few, wide), (many, narrow) = sorted(known.items())[-2:]
    order = min(np.log(wide / narrow) / np.log(many / few), 1.0)
    return narrow * (many / max(size, many)) ** order if order > FLAT else None


def gap_between(energy: float, lower: float) -> float:
    """Gap between an energy and a proven lower bound [%]."""
    return 100.0 * max(0.0, energy - lower) / energy if energy > 0.0 else 0.0


def room() -> float:
    """Memory that bounding may take [bytes]."""
    return 0.5 * resources.free_memory()


def _size(kept: Cells) -> tuple[int, int]:
    """Rows and columns of a stage's cells, narrower ones apart."""
    return kept.positions, int(kept.velocities.min())
