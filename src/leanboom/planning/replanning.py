"""Plan the rest of a task while it is under way: a coarse dynamic program from any state, quick enough to act on.

The path may have changed: what counts is the task handed in, from the present time on. Around a previous motion one
tube is swept; tables, sweep and judging together take some tens of milliseconds. Without one, a coarse program over
all feasible extensions comes first. Nothing is polished. The search over tubes also serves `horizon`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from leanboom.components.costs import COSTS
from leanboom.dynamic_programming import grids, value_function
from leanboom.errors import InfeasibleError, InputError
from leanboom.evaluation import ranking, safe_stop
from leanboom.evaluation.evaluate import Evaluation, evaluate, judged_cost
from leanboom.evaluation.safe_stop import Continuation
from leanboom.model import motion
from leanboom.model.motion import Motion
from leanboom.model.task import Task
from leanboom.problem import feasible_strokes, stages, starts
from leanboom.problem.stages import Problem
from leanboom.quantities.ranges import Range, noted, one_of

TUBE = (13, 21)  # nodes of a tube; few positions do, as the tube is narrow
WIDTH, SPREAD = 0.03, 0.12  # first half widths of a tube, of the stroke range and of the velocity limit
SETTLE = 1.0  # time in which a disturbed motion is led back to the planned one [s]
STATE_TOLERANCE = 1e-3  # [m], how far off the feasible extensions a state may be
STEP = 0.1  # [s]
COARSE = 2.0  # stages of the coarse program are longer by this
SHORTEST = 0.01  # [s], a rest shorter than this is not planned again
STEPS = Range("time", least=0.01, most=1.0)  # stages that make sense


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """A problem to be solved from a given state."""

    problem: Problem
    cost: str
    position: float  # [m]
    velocity: float  # [m/s]
    terminal: value_function.Terminal | None = None  # what the end costs; None: the path ends at rest
    nodes: tuple[int, int] = TUBE  # positions and velocities of a tube

    @property
    def end(self) -> float | None:
        """Where the task ends [m]; None: anywhere."""
        return starts.end_position(self.problem, None)

    def score(self, judged: Evaluation) -> tuple[bool, float, float, float]:
        """Sorting key, the best first: as `ranking.rank`, then by cost."""
        total = judged_cost(judged, self.cost)
        if self.terminal is not None:
            end = np.array([judged.motion.position[-1]]), np.array([judged.motion.velocity[-1]])
            total += float(self.terminal(*end)[0])
        return *ranking.rank(judged, total), total

    def solve(self, grid: grids.Grid) -> Evaluation:
        """The motion of the dynamic program on a grid, judged."""
        policy = value_function.solve(self.problem, grid, self.cost, self.terminal, self.end)
        return evaluate(self.problem.task, value_function.rollout(policy, self.position, velocity=self.velocity))

    def tube(self, around: Motion, half: float) -> Evaluation:
        """The same on a tube around a motion, `half` as wide as the first one."""
        low, high = feasible_strokes.stroke_range(self.problem.task)
        limit = self.problem.crane.machine.redundant.velocity_limit
        widths = half * WIDTH * (high - low), half * SPREAD * limit
        return self.solve(grids.tube_grid(self.problem, around.position, around.velocity, *widths, *self.nodes))

    def refine(self, chain: Evaluation, halves: Iterable[float]) -> Evaluation:
        """The best motion of narrower and narrower tubes around a chain of better and better ones."""
        for half in halves:
            found = self.tube(chain.motion, half)
            if self.score(found) < self.score(chain):
                chain = found
        return chain


def replan(
    task: Task,
    time: float,
    position: float,
    velocity: float,
    *,
    pump: str = "ls",
    around: Motion | Continuation | None = None,
    grid: tuple[int, int] = (25, 41),
    step: float = STEP,
) -> Continuation:
    """Plan the rest of a task from any state on the way.

    Args:
        task: The task as it is now; its path may differ from the one planned before.
        time: Time on the path [s], from 0 to before its end.
        position, velocity: Actual state of the redundant cylinder [m], [m/s].
        pump: "ls" or "cp", or another name of `costs.COSTS`: what to minimise.
        around: A motion on the task's clock to search around, for instance the previous plan: much quicker. Leave it
            out where the path has changed by more than the tube is wide, a few centimetres of extension. With legs it
            must be given: it says where each leg ends.
        grid: Position and velocity nodes of the coarse grid that is used without `around`.
        step: Length of a stage [s].

    Returns:
        The best motion found; following `around` is among the candidates. Where none keeps every limit, the safest
        stop; its status says so. With legs, the rest of the leg under way, to where `around` ends it: later legs stay.

    Raises:
        InputError: For a time that is not on the path, a state off the feasible extensions, or other bad arguments.
    """
    if task.legs:
        return _in_leg(task, time, position, velocity, pump, around, grid, step)
    grid, step = _check(task, time, position, velocity, pump, grid, step, around)
    try:
        rest = safe_stop.rest(starts.settled(task, step), time)
        problem = stages.discretise(rest, min(step, 0.5 * rest.duration))
        _check_position(problem, time, position)
        search = Search(problem, pump, position, velocity)
        if around is None:
            seed = _coarse(rest, search, min(COARSE * step, 0.5 * rest.duration), grid)
        else:
            seed = track(search, around, time)
    except InfeasibleError as error:  # the path leads where the tool cannot go
        return safe_stop.safest_stop(task, time, position, velocity, str(error))
    best = search.tube(seed, 1.0)
    if around is not None or not best.feasible:
        best = min(best, evaluate(rest, seed), key=search.score)
    if not best.feasible:
        return safe_stop.safest_stop(task, time, position, velocity, best.status)
    return Continuation(problem.task, time, best.motion, best, stopping=False)


def _coarse(rest: Task, search: Search, step: float, grid: tuple[int, int]) -> Motion:
    """The motion of a coarse program over all feasible extensions, on the stages of the search."""
    problem = stages.discretise(rest, step)
    policy = value_function.solve(problem, grids.full_grid(problem, *grid), search.cost, end=search.end)
    return stages.on_stages(search.problem, value_function.rollout(policy, search.position, velocity=search.velocity))


def track(search: Search, around: Motion | Continuation, since: float) -> Motion:
    """Motion that starts at a state beside a given one and joins it smoothly within `SETTLE`.

    Args:
        search: The problem and the state.
        around: The motion to follow, on the whole task's clock.
        since: When the problem's clock begins on that clock [s].

    Returns:
        The motion on the problem's stages, at rest at its end unless the search prices its end.
    """
    problem = search.problem
    c, w, _ = around.at(since + problem.time)
    off_c, off_w = search.position - c[0], search.velocity - w[0]
    lasts = min(SETTLE, problem.time[-1])
    s = np.minimum(problem.time / lasts, 1.0)
    # Cubic Hermite from the deviation to none, differentiated.
    speed = w + 6.0 * (s * s - s) / lasts * off_c + (1.0 - s) * (1.0 - 3.0 * s) * off_w
    if search.terminal is None:
        speed[-1] = 0.0
    tracked = motion.from_velocities(problem.step, search.position, speed, "track", search.cost)
    return tracked if search.end is None else motion.ending_at(tracked, search.end)


def _in_leg(
    task: Task, time: float, position: float, velocity: float, pump: str, around: Motion | Continuation | None,
    grid: tuple[int, int], step: float,
) -> Continuation:  # fmt: skip
    """The rest of the leg under way, ending where a motion of the whole task ends it; arguments as in `replan`."""
    if around is None:
        raise InputError(
            f"around = nothing; task {task.name} has legs: hand in its plan's motion, which says where they end"
        )
    under_way = [each for each in task.stretches if each.since <= time < each.until]
    if not under_way:
        raise InputError(f"time = {time:g} s; must be from 0 s to before the end of the task at {task.duration:g} s")
    leg = under_way[0]
    if leg.waits:
        raise InputError(f"time = {time:g} s; the crane waits until {leg.until:g} s: plan again once it moves")
    end = float(around.at(np.array([leg.until]))[0][0])
    if isinstance(around, Motion):
        known: Motion | Continuation = motion.between(around, leg.since, leg.until)
    else:
        known = replace(around, since=around.since - leg.since)
    alone = task.stretch(leg, end=end)
    found = replan(alone, time - leg.since, position, velocity, pump=pump, around=known, grid=grid, step=step)
    return replace(found, since=time)


def _check(task, time, position, velocity, pump, grid, step, around) -> tuple[tuple[int, int], float]:
    """Grid and step as they are used; InputError for arguments that cannot be, all problems at once."""
    problems = []
    if not 0.0 <= time <= task.duration - SHORTEST:
        latest = task.duration - SHORTEST
        problems.append(f"time = {time:g} s; must be from 0 s to {latest:g} s, shortly before the end of the path")
    if not (np.isfinite(position) and np.isfinite(velocity)):
        problems.append(f"state = {position:g} m, {velocity:g} m/s; must be finite")
    noted(problems, one_of, "pump", pump, COSTS)
    if around is not None:
        _check_length(task, around, problems)
    return value_function.sizes(grid, step, STEPS, problems)


def _check_length(task: Task, around: Motion | Continuation, problems: list[str]) -> None:
    """Note a motion that does not end when the task does."""
    if isinstance(around, Continuation):
        last = around.since + around.motion.duration
    else:
        last = around.duration
    if not (isinstance(around, Continuation) and around.stopping) and abs(last - task.duration) > 1e-6 * task.duration:
        problems.append(
            f"around ends at {last:g} s; must end with the task at {task.duration:g} s: hand in a motion of this task, "
            "or leave it out"
        )


def _check_position(problem: Problem, time: float, position: float) -> None:
    intervals = problem.intervals[0]
    if not np.any((intervals[:, 0] - STATE_TOLERANCE <= position) & (position <= intervals[:, 1] + STATE_TOLERANCE)):
        allowed = " or ".join(f"{low:.4f} m to {high:.4f} m" for low, high in intervals)
        raise InputError(
            f"position = {position:g} m at {time:g} s; the tool is on its path there with {allowed}: "
            "check the state, or hand in a path that begins where the tool is"
        )
