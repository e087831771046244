"""Receding horizon: plan along a path that is known only some seconds ahead, and again as it comes to be known.

Every `every` seconds the motion over the known part of the path is planned from the present state, and its beginning
is carried out. Nothing of the path beyond the horizon is used. A terminal cost at the horizon's end, from the known end
point alone, stands for the unknown rest (see `TerminalCost`); once the end of the path is in sight, the motion ends at
rest there and is carried out as planned.

The closed-up motion keeps the limits of every stage, because each plan does over its whole horizon and only its
beginning is used: `horizon` - `every` seconds remain to react to what comes into sight. Two measures keep the next
plan feasible too. The terminal cost makes the redundant cylinder able to stop before the ends of its feasible
extensions at the horizon's end. And the rest of the previous plan is always among the candidates, so a plan is only
given up for a better one. This is no proof: a path may turn, beyond the horizon, to where no motion from the present
state leads.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from leanboom.components.costs import COSTS, PUMPS
from leanboom.dynamic_programming import grids, value_function
from leanboom.errors import InfeasibleError, InputError
from leanboom.evaluation.evaluate import Evaluation, check_measurable, evaluate
from leanboom.evaluation.safe_stop import Continuation
from leanboom.formulas import hydraulics
from leanboom.methods.registry import STEP
from leanboom.model import crane as cranes
from leanboom.model import motion
from leanboom.model.cost_rates import demanded_pressure, supply_of
from leanboom.model.motion import Motion
from leanboom.model.task import Part, Task, take_single
from leanboom.planning.replanning import Search, track
from leanboom.problem import feasible_strokes, stages, starts
from leanboom.problem.stages import Problem
from leanboom.quantities.ranges import STAGE, checked, noted, one_of

# See `TerminalCost`. Tuned on the bundled loader tasks: a third or three times the value loses up to 8 %, at 3 s.
RETRACTION_MARGIN, RETRACTION_VALUE = 0.8, 0.15
BRAKE = 0.5  # share of the acceleration limit that stopping before an end may take
LEVELS = tuple(0.5**level for level in range(6))  # tubes around the coarse motion
TUBE = (31, 25)  # their nodes
# Denser than `registry.GRID`: this coarse program alone chooses among local minima, no search over several follows.
# With 101 x 51 nodes forwarder-vertical from the middle takes 6 % more (ls).
GRID = (141, 71)
LATER_LEVELS = LEVELS[2:]  # tubes around the rest of the previous plan


@dataclass(frozen=True, slots=True)
class TerminalCost:
    """Terminal cost of a state at the end of the horizon: room to retract, and stopping before the end of a stroke.

    Room to retract is worth energy: a tool that comes nearer takes little from the pump while the telescope retracts,
    and much once it cannot and the other cylinders lift instead. A metre of room costs up to `value` where there is
    none left, in proportion less up to `margin`. And a velocity at which the cylinder cannot stop before an end of its
    feasible extensions costs like leaving them.
    """

    low: float  # smallest feasible extension at the horizon's end [m]
    high: float  # largest [m]
    margin: float  # distance from the smallest that is enough [m]
    value: float  # value of retraction at the smallest extension [J/m]
    brake: float  # deceleration counted on [m/s^2]
    slope: float  # penalty beyond an end [J/m]

    def __call__(self, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """TerminalCost [J] of positions [m] and velocities [m/s], arrays that broadcast."""
        stops = position + 0.5 * velocity * np.abs(velocity) / self.brake
        beyond = np.maximum(0.0, self.low - stops) + np.maximum(0.0, stops - self.high)
        short = np.maximum(0.0, 1.0 - (position - self.low) / self.margin)
        return 0.5 * self.value * self.margin * short**2 + self.slope * beyond


def terminal_cost(problem: Problem, cost: str) -> TerminalCost:
    """The terminal cost of a problem, from its last point alone.

    Room is worth a share of what it takes to move the redundant cylinder by a metre, the tool standing at the last
    point: supply pressure there times the flow of all cylinders.
    """
    crane, machine, moving = problem.crane, problem.crane.machine, problem.moving
    low, high = float(problem.lower[-1]), float(problem.upper[-1])
    pose = cranes.pose(crane, problem.plane[-1], 0.5 * (low + high))
    still, forth = cranes.move(pose, 0.0, 0.0), cranes.move(pose, 1.0, 0.0)
    flow, highest = 0.0, 0.0
    for i in range(len(crane.drives))[moving]:
        drive, load = crane.drives[i], still.load[i]
        flow += float(hydraulics.cylinder_flow(forth.velocity[i] - still.velocity[i], drive.area_out, drive.area_in))
        highest = max(highest, float(demanded_pressure(crane, i, np.sign(load), load)))  # 1 m/s against its load
    constant, shaft = supply_of(machine.pump, COSTS[cost].supply)
    supply = constant + (highest if COSTS[cost].loads else 0.0)
    shortest, longest = feasible_strokes.stroke_range(problem.task)
    return TerminalCost(
        low,
        high,
        RETRACTION_MARGIN * (longest - shortest),
        RETRACTION_VALUE * float(hydraulics.pump_power(supply, flow, *shaft)),
        BRAKE * machine.redundant.acceleration_limit,
        value_function.slopes(problem, cost)[0],
    )


def plan_receding(
    task: Task,
    *,
    pump: str = "ls",
    horizon: float = 3.0,
    every: float = 0.5,
    grid: tuple[int, int] = GRID,
    step: float = STEP,
    check: bool = True,
    progress: Callable[[str, float], None] | None = None,
) -> Motion:
    """Plan a task as if its path were known only some seconds ahead.

    Args:
        task: The task; `start` must not be `best`, which needs the whole path. Its duration is known from the
            beginning, for equal stages alone.
        pump: "ls" or "cp": whose energy counts.
        horizon: How far ahead the path is known [s]; rounded to whole stages.
        every: Time between two plans [s], up to the horizon; rounded to whole stages.
        grid: Position and velocity nodes of the coarse grid over a horizon.
        step: Length of a stage [s].
        check: Whether to raise where the motion breaks a limit.
        progress: Called with what happens and the share done.

    Returns:
        The motion of the whole task as it was carried out; its `status` says whether it keeps every limit.

    Raises:
        InputError: For arguments that cannot be used, such as a horizon shorter than a stage.
        InfeasibleError: If `check` and the motion breaks a limit, with the judged motion as its `evaluation`.
    """
    take_single(task, "a receding horizon, which knows no leg to come,")
    grid, step = _check(task, pump, horizon, every, grid, step)
    value_function.prepare()
    began = time.perf_counter()
    task = starts.settled(task, step)
    count = stages.count(task.duration, step)
    step = task.duration / count
    ahead, often = max(2, round(horizon / step)), max(1, round(every / step))
    start = starts.start_position(
        stages.discretise(replace(task, path=Part(task.path, 0.0, 2 * step), smooth=None), step), task.start
    )
    assert start is not None
    speed = np.zeros(count + 1)
    position, first, log, previous = start, 0, [], None
    while first < count:
        last = first + ahead
        last = count if last >= count - 1 else last  # no rest of a single stage
        if progress is not None:
            progress(f"plan at {first * step:.1f} s of {task.duration:g} s", first / count)
        judged = _plan(task, pump, grid, step, (first, last, count), position, float(speed[first]), previous)
        taken = last - first if last == count else min(often, last - first)
        found = judged.motion
        log.append(f"{first * step:7.2f} s  {judged.energy(pump):.6g} J to {last * step:.2f} s, {judged.status}")
        speed[first : first + taken + 1] = found.velocity[: taken + 1]
        position = float(found.position[taken])
        previous = Continuation(judged.task, first * step, found, judged, stopping=False)
        first += taken
    whole = motion.from_velocities(step, start, speed, "receding", pump)
    judged = evaluate(task, whole)
    status = judged.status_with(pump)
    if check and not judged.feasible:
        text = f"{status}; a horizon longer than {horizon:g} s leaves more time to react"
        raise InfeasibleError(text, evaluation=judged)
    return replace(whole, status=status, solve_s=time.perf_counter() - began, log=tuple(log))


def _plan(
    task: Task,
    cost: str,
    grid: tuple[int, int],
    step: float,
    span: tuple[int, int, int],
    position: float,
    velocity: float,
    previous: Continuation | None,
) -> Evaluation:
    """The best motion found over the known stages `first` to `last` of `count`."""
    first, last, count = span
    until = task.duration if last == count else last * step
    end = task.end if last == count else "free"
    known = replace(task, path=Part(task.path, first * step, until), start="middle", end=end, smooth=None)
    problem = stages.discretise(known, step)
    terminal = None if last == count else terminal_cost(problem, cost)
    search = Search(problem, cost, position, velocity, terminal, TUBE)
    best = search.refine(search.solve(grids.full_grid(problem, *grid)), LEVELS)
    if previous is None:
        return best
    other = search.refine(evaluate(known, track(search, previous, first * step)), LATER_LEVELS)
    return min(best, other, key=search.score)


def _check(
    task: Task, pump: str, horizon: float, every: float, grid: tuple[int, int], step: float
) -> tuple[tuple[int, int], float]:
    """Grid and step as they are used; InputError for arguments that cannot be, all problems at once."""
    problems = []
    noted(problems, one_of, "pump", pump, PUMPS)
    nodes, length = noted(problems, value_function.nodes, grid), noted(problems, checked, "step", step, STAGE)
    if length is None:
        pass
    elif not horizon >= 2.0 * step:
        problems.append(f"horizon = {horizon:g} s; must be at least two stages, {2.0 * step:g} s")
    elif not step <= every <= horizon:
        problems.append(f"every = {every:g} s; must be from one stage, {step:g} s, to the horizon, {horizon:g} s")
    if task.start == "best":
        problems.append("start = best; needs the whole path, choose smallest, middle or a length")
    if nodes is None or length is None or problems:
        raise InputError("; ".join(problems))
    check_measurable(task)
    return nodes, length
