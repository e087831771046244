"""The certificate: a proven lower bound on the energy of any motion of a discretised task.

The bound holds for every motion of the discretised problem: the redundant cylinder an exact double integrator over
stages of one step, a stage's energy step x power at its start, feasible extensions at every stage, velocity and
acceleration limits of every moving cylinder at every stage's start, from the given start at rest to rest. It is
not an estimate: coefficients are enclosed over cells with proven remainders (`enclosure`), costs to go are bounded
over cells (`bounds`), and the rounding of floating-point numbers is covered by `ROUNDING`.

A cylinder counts as driven above the machine's `driven_velocity` itself; planned motions stay 1 % inside it, so the
bound holds for motions on the threshold too.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from leanboom import cells, compiling, dp, guide, incumbent, planner, stages
from leanboom.errors import InfeasibleError, InputError, LeanboomError
from leanboom.incumbent import Measured
from leanboom.motion import Motion
from leanboom.planner import PUMPS, Progress
from leanboom.stages import Problem
from leanboom.task import Task

ROUNDING = 1e-9  # share of the bound that covers the rounding of floating-point numbers
ENOUGH = 0.99  # share of the gap asked for by which energies are below the best known one where cells are dropped
PROMISE = 0.5  # share of a level's gap that may be left with the same slopes on the next
HOPELESS = 15.0  # gap [%] at which cells are so large that nothing but smaller ones is worth its time
SLACK = 2e-3  # share of the energy that a motion may save by using limits to the judge's tolerance
TRUST = 1e-6  # share of the energy by which a check along a motion may be off, rounding of many sums


@dataclass(frozen=True, slots=True)
class Level:
    """One round of bounding: cells of one size."""

    positions: int  # cells between the ends of the feasible extensions where they are largest
    velocities: int  # cells between the velocity limits where they are largest
    cells: int  # cells looked at, all stages together
    lower_bound_j: float  # the best bound so far [J]
    gap_percent: float
    seconds: float  # since the beginning


@dataclass(frozen=True, slots=True, eq=False)
class Certificate:
    """A lower bound on the energy of any motion, beside the best motion's energy in the same discretisation."""

    task: Task
    pump: str
    step: float  # length of a stage [s]
    motion: Motion  # the best known motion of the discretised problem
    energy_j: float  # its energy there [J]
    lower_bound_j: float  # no motion takes less [J]
    certify_s: float  # wall time, planning not included [s]
    levels: tuple[Level, ...]
    reason: str  # why bounding ended

    @property
    def gap_percent(self) -> float:
        """How much less the best possible motion may take, in percent of the best known one's energy."""
        return _gap(self.energy_j, self.lower_bound_j)

    def json(self) -> dict[str, float | None]:
        """What `--json` adds: the bound beside the best motion's energy in the same discretisation."""
        return {
            "discretised_energy_j": self.energy_j,
            "lower_bound_j": self.lower_bound_j,
            "gap_percent": self.gap_percent,
            "certify_s": self.certify_s,
        }

    def __repr__(self) -> str:
        return (
            f"Certificate({self.task.name}, {self.pump}: at least {self.lower_bound_j:.6g} J, best known "
            f"{self.energy_j:.6g} J, gap {self.gap_percent:.2f} % in {self.certify_s:.1f} s)"
        )


@dataclass(slots=True)
class _Way:
    """A way to choose the slopes of planes."""

    slopes: Callable[[], cells.GivenSlopes | None]
    promise: float = 0.0  # gap that it may reach on the next level [%]

    def bound(
        self, kept: cells.Cells, start: float | None, energy: float, clock: Callable[[float], None], limit: float
    ) -> cells.Bounds:
        """The bound with these slopes."""
        found = cells.bound(kept, start, clock, self.slopes(), limit)
        self.promise = _gap(energy, found.lower)
        return found


def certify(
    task: Task,
    pump: str = "ls",
    *,
    motion: Motion | None = None,
    step: float = 0.05,
    seconds: float = 60.0,
    gap: float = 0.5,
    progress: Progress | None = None,
) -> Certificate:
    """Prove how far a plan can be from the global optimum of its discretised problem.

    Args:
        task: What to do; `task.start` says where the redundant cylinder starts.
        pump: "ls" or "cp": whose energy counts.
        motion: The motion to compare with, from the task's start; by default the planner's.
        step: Length of a stage [s].
        seconds: Time after which bounding ends, planning not included [s].
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
    if not isinstance(task.machine.pump.efficiency, float | int):
        raise InputError("pump.efficiency is a map; a certificate needs a constant efficiency")
    if motion is None:
        motion = planner.run(task, pump=pump, step=step, baseline=False, progress=progress).motion
    tell("loading kernels of the bounds", 0.0)
    with compiling.told(tell):
        dp.prepare()
        cells.prepare()
        guide.prepare()
    began = time.perf_counter()
    problem = stages.discretise(task, step)
    start = dp.start_position(problem, task.start)
    if start is not None and abs(motion.position[0] - start) > 1e-6:
        raise InputError(f"motion starts at {motion.position[0]:.4f} m; the task's start is {start:.4f} m")
    if abs(motion.step * motion.acceleration.size - task.duration) > 1e-6 * task.duration:
        raise InputError(
            f"motion takes {motion.step * motion.acceleration.size:g} s; the task takes {task.duration:g} s"
        )
    tell("best motion of the discretised problem", 0.02)
    best = incumbent.improve(
        problem, incumbent.measure(problem, stages.on_stages(problem, motion), pump), pump, start is None
    )
    if not best.keeps_limits:
        raise InfeasibleError(
            f"the motion breaks a limit at the start of a stage of {problem.step:.4g} s: so long stages may be too "
            "coarse for this task; plan and certify with one step, and a shorter one"
        )
    levels, reason = _bound(problem, pump, start, best, began, seconds, gap, tell)
    tell("done", 1.0)
    return Certificate(
        task, pump, problem.step, best.motion, best.energy, levels[-1].lower_bound_j if levels else 0.0,
        time.perf_counter() - began, levels, reason,
    )  # fmt: skip


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


def _bound(
    problem: Problem, pump: str, start: float | None, best: Measured, began: float, seconds: float, gap: float,
    tell: Progress,
) -> tuple[tuple[Level, ...], str]:  # fmt: skip
    """Bound on ever smaller cells until the gap or the time is reached."""
    levels: list[Level] = []
    lower = 0.0
    enough = best.energy * (1.0 + ROUNDING - ENOUGH * gap / 100.0)  # motions that take more need no closer look
    outside = best.energy  # no motion that leaves the cells takes less
    tell("enclosing the crane's motion over cells", 0.05)
    kept: cells.Cells | None = cells.whole(problem, pump, best.motion)
    ways = [_Way(lambda: None)]
    if guide.memory(problem) < 0.5 * dp.free_memory():
        known = cache(lambda viable=kept.viable: guide.make(problem, pump, viable, best.motion).slopes)
        ways.append(_Way(known))
    size = kept.positions, int(kept.velocities.min())
    while kept is not None:
        name = f"cells {size[0]}x{size[1]}, gap so far {_gap(best.energy, lower):.2f} %"
        clock = _clock(began, seconds, name, tell)
        try:
            found = _tightest(kept, start, best.energy, gap, ways, clock, enough if levels else np.inf)
            if not np.isfinite(found.lower) and not levels:
                raise InfeasibleError("proven: no motion of the discretised problem keeps every limit")
            _check_along(found, best)
            if not levels and found.lower > (1.0 + SLACK) * best.energy:
                raise LeanboomError(
                    "the bound is above the energy of the motion it is compared with; nothing is certified"
                )
            lower = max(lower, min(found.lower, outside) * (1.0 - ROUNDING))
            gone = time.perf_counter() - began
            levels.append(Level(*size, kept.count, lower, _gap(best.energy, lower), gone))
            if levels[-1].gap_percent <= gap:
                return tuple(levels), "gap reached"
            excess, outside = cells.reach(found, enough, clock), min(enough, best.energy)
            if cells.memory(kept, excess) > 0.5 * dp.free_memory():
                return tuple(levels), "smaller cells would not fit into the memory"
            # Where power has no jumps, halving the first rows gains next to nothing beside halving velocities.
            rows_too = pump == "ls" or len(levels) > 1 or levels[-1].gap_percent > HOPELESS
            size = (2 if rows_too else 1) * size[0], 2 * size[1]
            kept = cells.refine(found, excess, rows_too)
        except cells.OutOfTime:
            return tuple(levels), "time is over"
    lower = outside * (1.0 - ROUNDING)  # no motion stays in the cells
    gone = time.perf_counter() - began
    levels.append(Level(*size, 0, lower, _gap(best.energy, lower), gone))
    return tuple(levels), "gap reached"


def _tightest(
    kept: cells.Cells, start: float | None, energy: float, gap: float, ways: list[_Way],
    clock: Callable[[float], None], limit: float,
) -> cells.Bounds:  # fmt: skip
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
        except cells.OutOfTime:
            break
        best = found if found.lower > best.lower else best
    for way in ways:
        way.promise *= PROMISE
    return best


def _clock(began: float, seconds: float, name: str, tell: Progress) -> Callable[[float], None]:
    def clock(share: float) -> None:
        gone = time.perf_counter() - began
        if gone > seconds:
            raise cells.OutOfTime
        tell(name, min(0.99, 0.05 + 0.94 * gone / seconds))

    return clock


def _check_along(found: cells.Bounds, best: Measured) -> None:
    """A bound that contradicts a motion is wrong: refuse to certify with it."""
    worst = float(cells.residuals(found, best.motion, best.costs).min())
    if worst < -TRUST * best.energy:
        raise LeanboomError(
            f"the bound contradicts the motion it is compared with by {-worst:.3g} J; nothing is certified"
        )


def _gap(energy: float, lower: float) -> float:
    return 100.0 * max(0.0, energy - lower) / energy if energy > 0.0 else 0.0
