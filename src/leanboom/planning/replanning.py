"""Plan the rest of a task while it is under way: a coarse dynamic program from any state, quick enough to act on.

The path may have changed: what counts is the task handed in, from the present time on. Around a previous motion one
tube is swept; tables, sweep and judging together take some tens of milliseconds. Without one, a coarse program over
all feasible extensions comes first. Nothing is polished. The search over tubes also serves `horizon`.

With legs it is one dynamic program over all that are left: what the legs to come cost from rest at an extension is the
terminal cost of the leg before, so where they meet moves as well.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace

import numpy as np

from leanboom.components.costs import COSTS
from leanboom.dynamic_programming import grids, value_function
from leanboom.errors import InfeasibleError, InputError
from leanboom.evaluation import ranking, safe_stop
from leanboom.evaluation.evaluate import Evaluation, evaluate, judged_cost
from leanboom.evaluation.limit_checks import REST_TOLERANCE
from leanboom.evaluation.safe_stop import Continuation
from leanboom.model import motion
from leanboom.model.motion import Motion
from leanboom.model.task import Stretch, Task
from leanboom.planning import junctions, leg_search
from leanboom.problem import feasible_strokes, stages, starts
from leanboom.problem.stages import Problem
from leanboom.quantities.ranges import Range, noted, one_of

TUBE = (13, 21)  # nodes of a tube; few positions do, as the tube is narrow
WIDTH, SPREAD = 0.03, 0.12  # first half widths of a tube, of the stroke range and of the velocity limit
SETTLE = 1.0  # time in which a disturbed motion is led back to the planned one [s]
LED = 11  # stages of that at least, ends counted
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
        return self.solve(tube(self.problem, around, half, self.nodes))

    def refine(self, chain: Evaluation, halves: Iterable[float]) -> Evaluation:
        """The best motion of narrower and narrower tubes around a chain of better and better ones."""
        for half in halves:
            found = self.tube(chain.motion, half)
            if self.score(found) < self.score(chain):
                chain = found
        return chain


def tube(problem: Problem, around: Motion, half: float, nodes: tuple[int, int]) -> grids.Grid:
    """The grid of a tube around a motion on a problem's stages, `half` as wide as the first one."""
    low, high = feasible_strokes.stroke_range(problem.task)
    limit = problem.crane.machine.redundant.velocity_limit
    widths = half * WIDTH * (high - low), half * SPREAD * limit
    return grids.tube_grid(problem, around.position, around.velocity, *widths, *nodes)


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
        task: The task as it is now; its path may differ from the one planned before, with legs that of any leg.
        time: Time on the path [s], from 0 to before its end.
        position, velocity: Actual state of the redundant cylinder [m], [m/s].
        pump: "ls" or "cp", or another name of `costs.COSTS`: what to minimise.
        around: A motion on the task's clock to search around, for instance the previous plan: much quicker. Leave it
            out where a path has changed by more than the tube is wide, a few centimetres of extension.
        grid: Position and velocity nodes of the coarse grid that is used without `around`.
        step: Length of a stage [s].

    Returns:
        The best motion found; following `around` is among the candidates. Where none keeps every limit, the safest
        stop; its status says so. With legs, all that is left of them, the extensions between them moved as well.

    Raises:
        InputError: For a time that is not on the path, a state off the feasible extensions, or other bad arguments.
    """
    grid, step = _check(task, time, position, velocity, pump, grid, step, around)
    try:
        rest = safe_stop.rest(_settled(task, around, step), time)
        before = len(task.legs) - len(rest.legs)
        left = _left(rest, step, before)
        _check_position(left[0].problem, time, position)
        if around is None:
            seed = _coarse(left, _left(rest, COARSE * step, before), pump, position, velocity, grid)
        else:
            seed = _followed(left, around, time, pump, position, velocity)
    except InfeasibleError as error:  # the path leads where the tool cannot go
        return _stop(task, time, position, velocity, str(error))
    tubes = [tube(part.problem, near, 1.0, TUBE) for part, near in zip(left, seed, strict=True)]
    best = evaluate(rest, leg_search.joined(rest, _swept(left, tubes, pump, position, velocity)))
    if around is not None or not best.feasible:
        other = evaluate(rest, leg_search.joined(rest, seed))
        best = _better(best, other, pump)
    if not (best.feasible or around is None or (isinstance(around, Continuation) and around.stopping)):
        # A fastest leg leaves nothing to choose, and is there on the stages of its plan alone.
        kept = _kept(rest, around, time, position, velocity)
        first = _swept([_ending(left[0], float(kept[0].position[-1]))], tubes[:1], pump, position, velocity)
        for each in (kept, [*first, *kept[1:]]):
            best = _better(best, evaluate(rest, leg_search.joined(rest, each)), pump)
    if not best.feasible:
        return _stop(task, time, position, velocity, best.status)
    return Continuation(rest, time, best.motion, best, stopping=False)


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """A leg that is left, or the one path, to be planned."""

    problem: Problem
    since: float  # when it begins on the clock of what is left [s]


def _left(rest: Task, step: float, before: int) -> list[_Part]:
    """The legs of what is left of a task, a number of them gone, or its one path, on stages of about `step` [s]."""
    if not rest.legs:
        return [_Part(stages.discretise(rest, min(step, 0.5 * rest.duration)), 0.0)]
    legs, found = [each for each in rest.stretches if not each.waits], []
    for each in legs:
        task = rest.stretch(each, end=rest.end if each is legs[-1] else "free")
        with junctions.named(before + each.leg):
            found.append(_Part(stages.discretise(task, min(step, 0.5 * task.duration)), each.since))
    return found


def _swept(
    left: Sequence[_Part], over: Sequence[grids.Grid], cost: str, position: float, velocity: float
) -> list[Motion]:
    """Motions of one dynamic program over all that is left, on a grid for each leg, from a state [m], [m/s]."""
    policies: list[value_function.Policy] = []
    terminal = None
    for i in reversed(range(len(left))):
        problem = left[i].problem
        policy = value_function.solve(problem, over[i], cost, terminal, starts.end_position(problem, None))
        policies.insert(0, policy)
        if i:
            terminal = value_function.resting(left[i - 1].problem, cost, *value_function.rest_costs(policy))
    found: list[Motion] = []
    for policy in policies:
        found.append(value_function.rollout(policy, position, velocity=velocity))
        position, velocity = float(found[-1].position[-1]), 0.0
    return found


def _coarse(
    left: Sequence[_Part], coarser: Sequence[_Part], cost: str, position: float, velocity: float, nodes: tuple[int, int]
) -> list[Motion]:
    """Motions of a coarse program over all feasible extensions, on longer stages, as motions on the stages."""
    over = [grids.full_grid(part.problem, *nodes) for part in coarser]
    found = [
        stages.on_stages(part.problem, moved)
        for part, moved in zip(left, _swept(coarser, over, cost, position, velocity), strict=True)
    ]
    for i in range(1, len(found)):  # velocities between other stages lead a little elsewhere
        moved = found[i]
        ahead = motion.from_velocities(
            moved.step, float(found[i - 1].position[-1]), moved.velocity, moved.method, moved.cost
        )
        end = starts.end_position(left[i].problem, None)
        found[i] = ahead if end is None else motion.ending_at(ahead, end)
    return found


def _followed(
    left: Sequence[_Part], around: Motion | Continuation, time: float, cost: str, position: float, velocity: float
) -> list[Motion]:
    """Motions that join a given one on the whole task's clock."""
    found: list[Motion] = []
    for part in left:
        found.append(track(Search(part.problem, cost, position, velocity), around, time + part.since))
        position, velocity = float(found[-1].position[-1]), 0.0
    return found


def _better(one: Evaluation, other: Evaluation, cost: str) -> Evaluation:
    """The better of two judged motions, the first where they are equal."""
    return min(one, other, key=lambda judged: ranking.rank(judged, judged_cost(judged, cost)))


def _ending(part: _Part, end: float) -> _Part:
    """A leg that is to end at a length [m]."""
    problem = part.problem
    return replace(part, problem=replace(problem, task=replace(problem.task, end=end)))


def _kept(rest: Task, around: Motion | Continuation, time: float, position: float, velocity: float) -> list[Motion]:
    """What is left of a given motion on its own stages, by legs, a state led back to it as by `track`."""
    whole, begun = (around.motion, around.since) if isinstance(around, Continuation) else (around, 0.0)
    since = time - begun
    legs = [each for each in rest.stretches if not each.waits]
    spans = [(each.since, each.until) for each in legs] or [(0.0, rest.duration)]
    found = [motion.between(whole, since + first, since + last) for first, last in spans]
    known = found[0]
    more = np.linspace(0.0, min(SETTLE, known.duration), LED)
    apart = np.abs(more[:, None] - known.breaks).min(axis=1) > motion.EVEN
    when = np.union1d(known.breaks, more[apart])
    speed = known.at(when)[1] + _led_back(when, position - known.position[0], velocity - known.velocity[0])
    led = motion.from_velocities_at(when, position, speed, known.method, known.cost)
    return [motion.ending_at(led, float(known.position[-1])), *found[1:]]


def _led_back(time: np.ndarray, off_c: float, off_w: float) -> np.ndarray:
    """Velocities [m/s] at times from 0 on [s] that take a deviation [m], [m/s] away within `SETTLE`."""
    lasts = min(SETTLE, time[-1])
    s = np.minimum(time / lasts, 1.0)
    # Cubic Hermite from the deviation to none, differentiated.
    return 6.0 * (s * s - s) / lasts * off_c + (1.0 - s) * (1.0 - 3.0 * s) * off_w


def _stop(task: Task, time: float, position: float, velocity: float, why: str) -> Continuation:
    """The safest stop from a state, on the path of the leg under way; arguments as in `safe_stop.safest_stop`."""
    if not task.legs:
        return safe_stop.safest_stop(task, time, position, velocity, why)
    here = task.at(time)
    found = safe_stop.safest_stop(task.stretch(here), time - here.since, position, velocity, why)
    return replace(found, since=time)


def _settled(task: Task, around: Motion | Continuation | None, step: float) -> Task:
    """The task with its end as a length, or free; arguments as in `replan`."""
    if not isinstance(task.end, str) or task.end == "free":
        return task
    first = last = task
    if task.legs:
        moving = [each for each in task.stretches if not each.waits]
        first, last = task.stretch(moving[0], task.start), task.stretch(moving[-1])
    end = task.end
    if end == "same" and task.start == "best":
        if around is None or (isinstance(around, Continuation) and around.stopping):
            raise InputError(
                "end = same, start = best; where the cycle began is not known: hand in its plan's motion as around, or "
                "that length as the start"
            )
        end = float(around.at(np.array([task.duration]))[0][0])
    elif end == "same":
        end = starts.start_position(stages.discretise(first, step), task.start)
    assert end is not None
    with junctions.named(len(task.legs) - 1) if task.legs else nullcontext():
        return replace(task, end=starts.end_position(stages.discretise(replace(last, end=end), step), None))


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
    speed = w + _led_back(problem.time, search.position - c[0], search.velocity - w[0])
    if search.terminal is None:
        speed[-1] = 0.0
    tracked = motion.from_velocities(problem.step, search.position, speed, "track", search.cost)
    return tracked if search.end is None else motion.ending_at(tracked, search.end)


def _check(task, time, position, velocity, pump, grid, step, around) -> tuple[tuple[int, int], float]:
    """Grid and step as they are used; InputError for arguments that cannot be, all problems at once."""
    problems = []
    if not 0.0 <= time <= task.duration - SHORTEST:
        latest = task.duration - SHORTEST
        problems.append(f"time = {time:g} s; must be from 0 s to {latest:g} s, shortly before the end of the path")
    elif task.legs:
        problems += _between_legs(task.at(time), time, velocity)
    if not (np.isfinite(position) and np.isfinite(velocity)):
        problems.append(f"state = {position:g} m, {velocity:g} m/s; must be finite")
    noted(problems, one_of, "pump", pump, COSTS)
    if around is not None:
        _check_length(task, around, problems)
    return value_function.sizes(grid, step, STEPS, problems)


def _between_legs(here: Stretch, time: float, velocity: float) -> list[str]:
    """What is wrong with a time shortly before the end of a leg, or with a velocity while the crane waits."""
    if here.waits and abs(velocity) > REST_TOLERANCE:
        return [f"velocity = {velocity:g} m/s at {time:g} s; must be 0: the crane waits until {here.until:g} s"]
    if not here.waits and time > here.until - SHORTEST:
        until = f"{here.until - SHORTEST:g} s, shortly before the end of leg {here.leg + 1}"
        return [f"time = {time:g} s; must be up to {until}, or from that end at {here.until:g} s on"]
    return []


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
