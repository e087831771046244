"""The planner: from a task to the best judged feasible motion, by any method.

Method `dp` runs the whole chain of the package: a coarse dynamic program over all feasible extensions, tubes
around its motion on ever finer grids, then the polish with the switches fixed. Whatever step a candidate comes
from, the judge measures it, and the best feasible one wins.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from leanboom import compiling, dp, polish, ranges, stages
from leanboom.errors import InfeasibleError, InputError, LeanboomError
from leanboom.judge import Evaluation, check_measurable, evaluate, judged_cost
from leanboom.motion import Motion, headed
from leanboom.objective import COSTS
from leanboom.polish import Modes, Polisher
from leanboom.stages import Problem
from leanboom.task import Task

METHODS = {
    "dp": "dynamic programming over all extensions, refined in tubes and polished",
    "polish": "nonlinear programming alone: the polish started from the pseudo-inverse",
    "pseudospectral": "Legendre-Gauss-Radau collocation of the smoothed problem, bootstrapped",
    "shooting": "direct multiple shooting in all joints",
    "dp-paper": "Algorithm 1 of the 4-DOF paper to the letter",
    "dp1": "one-state dynamic programming, velocity as control (3-DOF paper)",
    "sns-joint": "joint-limited pseudo-inverse, least joint velocities",
    "sns-actuator": "actuator-limited pseudo-inverse, least cylinder velocities",
    "sns-actuator-weighted": "the same, cylinder velocities weighted by flow areas",
}
PUMPS = ("ls", "cp")

GRID = (141, 71)  # positions and velocities of the coarse program: denser ones end no lower on the bundled tasks
# Tubes: nodes, and half widths in spacings of the coarse grid; level n is 1 / 2^n as wide.
# The second where the motion follows an end of the feasible extensions that moves, the third once it is polished.
TUBE, RIDING_TUBE, LAST_TUBE = (17, 33), (31, 33), (17, 17)
TUBE_WIDTH, TUBE_SPREAD = 4.2, 4.2
FIRST_LEVELS, LAST_LEVELS, FINER_LEVELS = (0, 1), (2, 4), (2, 3)  # around coarse motions, the best, on finer stages
REPEAT, TUBE_REPEATS = 1e-2, 2  # a tube is repeated while the judged cost falls by more than this share
POLISHABLE = 1.3  # a motion that uses a limit up to this much too far is polished where it is cheaper
NEAR = 1.3  # a pseudo-inverse of long steps within this factor of the best is made again with short ones
MOVING, TOUCHING = 1e-3, 1e-4  # a limit that moves [m/s], and a motion on it [m]
FINER = 5e-4  # stages are halved while that gains more than this share
REPAIRABLE, ROOM = 1.05, 0.9995  # limits used up to this much too far are polished again, to below this share
FAR = 5e-3  # a seed that is this share behind the best after a round is not polished again
SETTLED = 1e-4  # polishing ends when it gains less than this share

Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A planned task: the motion, what the judge says of it, and of the pseudo-inverse beside it."""

    task: Task
    pump: str
    motion: Motion
    evaluation: Evaluation
    baseline: Evaluation | None  # sns-actuator from the same start
    peak_memory_bytes: int | None  # None where the system does not say

    @property
    def status(self) -> str:
        """`solved`, or as a sentence what limit is broken, or what the chosen pump cannot deliver."""
        return self.evaluation.status_with(self.pump)

    @property
    def solved(self) -> bool:
        """Whether the motion keeps every limit and the chosen pump can deliver it."""
        return self.status == "solved"

    def saving(self, pump: str | None = None) -> float | None:
        """Share of the pseudo-inverse's energy that the plan saves; None where there is nothing to compare.

        Args:
            pump: "ls" or "cp"; by default the chosen pump.

        Returns:
            The share; None for a plan that is not solved, with that pump, and without a pseudo-inverse.
        """
        pump = self.pump if pump is None else pump
        if self.baseline is None or self.evaluation.status_with(pump) != "solved":
            return None
        mine, theirs = self.evaluation.energy(pump), self.baseline.energy(pump)
        return 1.0 - mine / theirs if self.baseline.followed and theirs > 0.0 else None

    def __repr__(self) -> str:
        text = f"Plan({self.pump}, {self.evaluation.summary})"
        return headed(self.status, text)


def plan(
    task: Task,
    pump: str = "ls",
    *,
    cost: str | None = None,
    method: str = "dp",
    grid: tuple[int, int] = GRID,
    step: float = 0.05,
    check: bool = True,
) -> Motion:
    """Plan a task and return its motion.

    Args:
        task: What to do; `task.start` says where the redundant cylinder starts.
        pump: "ls" or "cp": whose energy counts.
        cost: What to minimise, a name of `objective.COSTS`; by default the pump's energy.
        method: A name of `METHODS`.
        grid: Position and velocity nodes of the coarse grid.
        step: Length of a stage [s].
        check: Whether to raise where no feasible motion was found.

    Returns:
        The motion; its `status` says whether it keeps every limit, and whether the pump can deliver it.

    Raises:
        InputError: For arguments or tasks that cannot be used.
        InfeasibleError: If `check` and no motion keeps every limit, with the best one as its `plan`.
    """
    return run(task, pump=pump, cost=cost, method=method, grid=grid, step=step, baseline=False, check=check).motion


def run(
    task: Task,
    *,
    pump: str = "ls",
    cost: str | None = None,
    method: str = "dp",
    grid: tuple[int, int] = GRID,
    step: float = 0.05,
    baseline: bool = True,
    check: bool = True,
    progress: Progress | None = None,
) -> Plan:
    """Plan a task and judge the result, with progress; arguments as in `plan`.

    Args:
        task: What to do.
        pump: "ls" or "cp".
        cost: What to minimise; by default the pump's energy.
        method: A name of `METHODS`.
        grid: Position and velocity nodes of the coarse grid.
        step: Length of a stage [s].
        baseline: Whether to judge the actuator pseudo-inverse as well.
        check: Whether to raise where no feasible motion was found.
        progress: Called with what happens and the share done.

    Returns:
        The plan; without `check` it may break limits, as `solved` and `status` say.

    Raises:
        InputError: For arguments or tasks that cannot be used.
        InfeasibleError: If `check` and no motion keeps every limit, with the best one as its `plan`; and if the tool
            cannot follow the path, whatever the extension.
    """
    cost = pump if cost is None else cost
    grid, step = _check(task, pump, cost, method, grid, step)
    tell = progress or (lambda text, share: None)
    tell("loading kernels", 0.0)
    with compiling.told(tell):
        dp.prepare()
        if method in ("dp", "polish"):
            polish.prepare()
    began = time.perf_counter()
    solver = _Run(task, cost, grid, step, tell, began)
    best = solver.by(method)
    seconds = time.perf_counter() - began
    status = best.status_with(pump) if best.feasible or method != "dp" else solver.explain(best)
    done = replace(
        best.motion, method=method, cost=cost, solve_s=seconds, log=best.motion.log or tuple(solver.log), status=status
    )
    best = replace(best, motion=done)
    if not best.feasible:
        best = replace(best, violations=(status, *best.violations[1:]))
    other = solver.baseline(float(done.position[0])) if baseline else None
    tell("done", 1.0)
    found = Plan(task, pump, done, best, other, _peak_memory())
    if check and not best.feasible:
        raise InfeasibleError(status, plan=found, evaluation=best)
    return found


def _peak_memory() -> int | None:
    """The most memory this process has taken [bytes]; None where the system does not say."""
    try:
        import resource  # not on Windows
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def _check(task: Task, pump: str, cost: str, method: str, grid: object, step: object) -> tuple[tuple[int, int], float]:
    """Grid and step as they are used; InputError for arguments that cannot be, all problems at once."""
    problems = []
    if pump not in PUMPS:
        problems.append(f"pump = {pump}; must be one of {', '.join(PUMPS)}")
    if cost not in COSTS:
        problems.append(f"cost = {cost}; must be one of {', '.join(COSTS)}")
    if method not in METHODS:
        problems.append(f"method = {method}; must be one of {', '.join(METHODS)}")
    nodes, length = dp.sizes(grid, step, ranges.STAGE, problems)
    check_measurable(task, kept=8)
    dp.check_memory(int(np.ceil(task.duration / length)), *nodes)
    return nodes, length


class _Run:
    """One planning run: the problem, the log, and the best judged motion so far."""

    def __init__(self, task: Task, cost: str, grid: tuple[int, int], step: float, tell: Progress, began: float):
        self.task, self.cost, self.grid, self.step, self.tell = task, cost, grid, step, tell
        self.log: list[str] = []
        self.began = began
        self.best: Evaluation | None = None
        self.polisher: Polisher | None = None

    def by(self, method: str) -> Evaluation:
        """The best judged motion of a method."""
        if method == "dp":
            return self.dynamic_program()
        if method == "polish":
            return self.polish_alone()
        start = dp.start_position(stages.discretise(self.task, self.step), self.task.start)
        if start is None:
            raise InputError(f"start = best; method {method} needs smallest, middle or a length")
        answer = self.other_method(method, start)
        judged = evaluate(self.task, answer)
        if answer.status.startswith("not converged"):
            judged = replace(judged, violations=(answer.status, *judged.violations))
        return judged

    def other_method(self, method: str, start: float) -> Motion:
        """The motion of a method that is not this package's own, from a start [m]."""
        tell = self.tell
        if method.startswith("sns-"):
            from leanboom import pseudo_inverse

            return pseudo_inverse.resolve(self.task, start, method.rsplit("-", maxsplit=1)[-1])
        if method == "dp1":
            from leanboom import dp1

            return dp1.plan(self.task, self.cost, start)
        if method == "shooting":
            from leanboom import shooting

            return shooting.plan(self.task, self.cost, start, tell)
        if method == "pseudospectral":
            from leanboom import collocation

            return collocation.plan(self.task, self.cost, start, tell)
        from leanboom import dp_paper

        return dp_paper.plan(self.task, self.cost, start, progress=lambda share: tell("Algorithm 1", share))

    def dynamic_program(self) -> Evaluation:
        """Design points 1 to 8: coarse sweeps, tubes, polish, judge."""
        problem = stages.discretise(self.task, self.step)
        start = dp.start_position(problem, self.task.start)
        low, high = stages.stroke_range(self.task)
        width = TUBE_WIDTH * (high - low) / (self.grid[0] - 1)
        spread = TUBE_SPREAD * 2.0 * problem.crane.machine.redundant.velocity_limit / (self.grid[1] - 1)
        # LS has several valleys: a second grid, half as fine, at times finds a better one.
        for share in (1, 2) if self.cost == "ls" else (1,):
            self.tell(f"coarse dynamic program {share}", 0.35 * share - 0.3)
            grid = stages.full_grid(problem, *(max(3, size // share) for size in self.grid))
            coarse = dp.solve(problem, grid, self.cost)
            first = dp.best_start(coarse) if start is None else start
            seed = self.judge(dp.rollout(coarse, first), f"coarse {grid.positions}x{grid.velocities}")
            del coarse
            self.refine(problem, seed, start, width, spread, FIRST_LEVELS, rounds=1)
        assert self.best is not None
        loads, rides = self.cost in ("ls", "actuator"), self.rides_on_a_limit(problem)
        other = self.baseline(float(self.best.motion.position[0]) if start is None else start, self.step)
        if other is not None and (rides or self.cost == "actuator"):
            self.polish(problem, other, start is None)  # at times from a better valley, or along a moving limit
        # Look around what the polish found: it has moved on from where its modes came from. Without loads there are no
        # modes, so one tube tells whether there is anything to find.
        self.refine(problem, self.best, start, width, spread, LAST_LEVELS if loads else LAST_LEVELS[:1])
        if rides or self.rides_on_a_limit(problem):
            self.finer_stages(start, width, spread)
        if other is None or judged_cost(other, self.cost) < NEAR * judged_cost(self.best, self.cost):
            other = self.baseline(float(self.best.motion.position[0]) if start is None else start)
        if other is not None and beats(other, self.best, self.cost):
            self.best = other
            self.note(f"the pseudo-inverse is better: {judged_cost(other, self.cost):.4g}; refining from it")
            self.polish(problem, other, False)
        return self.best

    def rides_on_a_limit(self, problem: Problem) -> bool:
        """Whether the best motion follows an end of the feasible extensions that itself moves."""
        assert self.best is not None
        position = stages.on_stages(problem, self.best.motion).position
        for end in (problem.lower, problem.upper):
            moves = np.abs(np.gradient(end, problem.step)) > MOVING
            if np.any(moves & (np.abs(position - end) < TOUCHING)):
                return True
        return False

    def finer_stages(self, start: float | None, width: float, spread: float) -> None:
        """Refine on stages half and a quarter as long while it pays: along a moving limit control must be finer."""
        for factor in (2, 4):
            assert self.best is not None
            before = self.best
            self.polisher = None
            problem = stages.discretise(self.task, self.step / factor)
            self.polish(problem, self.best, start is None, rounds=1)
            self.refine(problem, self.best, start, width, spread, FINER_LEVELS, rounds=1)
            gained = gains(judged_cost(before, self.cost), judged_cost(self.best, self.cost), FINER)
            if before.feasible and not gained:
                break
        self.polisher = None

    def refine(
        self, problem: Problem, seed: Evaluation, start: float | None, width: float, spread: float,
        levels: tuple[int, ...], rounds: int = 4,
    ) -> None:  # fmt: skip
        """Tubes around a motion, then the polish of the best, and of a cheaper one that breaks a limit a little."""
        chain, cheap = seed, None
        nodes = RIDING_TUBE if self.rides_on_a_limit(problem) else LAST_TUBE if levels == LAST_LEVELS else TUBE
        for level in levels:
            self.tell(f"tubes of 1/{2**level} width", 0.4 + 0.1 * level)
            half = 0.5**level
            for _ in range(TUBE_REPEATS):
                before = judged_cost(chain, self.cost)
                at = stages.on_stages(problem, chain.motion)
                tube = stages.tube_grid(problem, at.position, at.velocity, half * width, half * spread, *nodes)
                policy = dp.solve(problem, tube, self.cost)
                first = dp.best_start(policy) if start is None else start
                found = self.judge(dp.rollout(policy, first), f"tube of {half * width:.4f} m, {half * spread:.4f} m/s")
                if beats(found, chain, self.cost):
                    chain = found
                elif not found.feasible and found.worst_use < POLISHABLE:
                    cheap = found if cheap is None or cheaper(found, cheap, self.cost) else cheap
                if not gains(before, judged_cost(chain, self.cost), REPEAT):
                    break
        assert self.best is not None
        if chain is not seed or rounds == 1:
            self.polish(problem, chain, start is None, rounds)
        if cheap is not None and cheaper(cheap, self.best, self.cost):
            self.polish(problem, cheap, start is None)

    def polish(self, problem: Problem, chain: Evaluation, free: bool, rounds: int = 4) -> None:
        """Fix the modes of a motion, solve the smooth problem, read the modes off the answer, repeat while it pays."""
        if not chain.followed:
            return  # out of reach somewhere: nothing to start from
        self.tell("polish", 0.75)
        polisher = self.polisher = self.polisher or polish.build(problem, self.cost)
        done = None
        if not polisher.loads:
            rounds = 1  # no modes, no second round
        for _ in range(rounds):
            before = judged_cost(chain, self.cost)
            seed = stages.on_stages(problem, chain.motion)
            switches = polish.modes(polisher, seed)
            if done is not None and switches.same_as(done):
                break
            answer, text = polish.solve(polisher, seed, switches, free)
            done = switches
            if answer is None:
                self.note(f"polish: {text}")
                break
            judged = self.judge(answer, f"polish ({text})")
            if not judged.feasible and judged.worst_use < REPAIRABLE:
                judged = self.repair(polisher, judged, switches, free)
            if beats(judged, chain, self.cost):
                chain = judged
            after = judged_cost(chain, self.cost)
            assert self.best is not None
            behind = chain.feasible and gains(after, judged_cost(self.best, self.cost), FAR)
            if behind or not gains(before, after, SETTLED):
                break

    def repair(self, polisher: Polisher, judged: Evaluation, switches: Modes, free: bool) -> Evaluation:
        """Polish again with room for what a polished motion broke between the ends of its intervals."""
        use = judged.limit_use
        share = min(1.0, ROOM / use.velocity), min(1.0, ROOM / use.acceleration)
        answer, text = polish.solve(polisher, judged.motion, switches, free, share)
        if answer is None:
            return judged
        return self.judge(answer, f"polish with room between stages ({text})")

    def polish_alone(self) -> Evaluation:
        """The polish from the pseudo-inverse: nonlinear programming without the dynamic program."""
        from leanboom import pseudo_inverse

        problem = stages.discretise(self.task, self.step)
        start = dp.start_position(problem, self.task.start)
        first = dp.start_position(problem, "middle") if start is None else start
        assert first is not None
        seed = self.judge(pseudo_inverse.resolve(self.task, first, "actuator"), "pseudo-inverse")
        self.polish(problem, seed, start is None)
        assert self.best is not None
        return self.best

    def baseline(self, start: float, step: float | None = None) -> Evaluation | None:
        """The actuator pseudo-inverse from a start [m], judged; None where it cannot follow the path.

        Its own step [s] is short and takes time; as a first guess a stage's will do.
        """
        from leanboom import pseudo_inverse

        try:
            step = pseudo_inverse.STEP if step is None else step
            return evaluate(self.task, pseudo_inverse.resolve(self.task, start, "actuator", step))
        except LeanboomError:
            return None

    def judge(self, candidate: Motion, name: str) -> Evaluation:
        """Measure a candidate, note it, keep it if it is the best."""
        judged = evaluate(self.task, candidate)
        self.note(f"{name}: {judged_cost(judged, self.cost):.6g}, {judged.status}")
        if self.best is None or beats(judged, self.best, self.cost):
            self.best = judged
        return judged

    def note(self, text: str) -> None:
        """Add a line to the log."""
        self.log.append(f"{time.perf_counter() - self.began:6.2f} s  {text}")

    def explain(self, best: Evaluation) -> str:
        """Why there is no feasible motion, and the shortest duration that would have one."""
        self.tell("looking for the shortest feasible duration", 0.9)
        try:
            factor = shortest_duration(self.task, self.grid, self.step)
        except InputError:  # a slower task does not fit into memory
            factor = None
        if factor is None or factor <= 1.0:
            return f"no feasible motion found: {best.status}"
        duration = np.ceil(100.0 * factor * self.task.duration) / 100.0
        return (
            f"no feasible motion: {best.status}; the path needs at least about "
            f"{duration:.2f} s instead of {self.task.duration:.2f} s"
        )


def beats(one: Evaluation, other: Evaluation, cost: str) -> bool:
    """Whether a judged motion is better than another: feasible first, then cheaper."""
    if one.feasible != other.feasible:
        return one.feasible
    if not one.feasible:
        return one.worst_use < other.worst_use
    return judged_cost(one, cost) < judged_cost(other, cost)


def cheaper(one: Evaluation, other: Evaluation, cost: str) -> bool:
    """Whether a judged motion costs less than another, limits aside."""
    return judged_cost(one, cost) < judged_cost(other, cost)


def gains(before: float, after: float, share: float) -> bool:
    """Whether a cost fell by more than a share of its size."""
    return before - after > share * abs(before)


def slower(task: Task, factor: float) -> Task:
    """The same task taking `factor` times as long."""
    return replace(task, path=task.path.slower(factor))


def shortest_duration(
    task: Task, grid: tuple[int, int], step: float, accuracy: float = 0.01, most: float = 16.0
) -> float | None:
    """Smallest factor on a task's duration at which a coarse plan keeps every limit; None up to `most`.

    Args:
        task: The task.
        grid: Position and velocity nodes.
        step: Length of a stage [s].
        accuracy: Relative accuracy of the factor, and the margin added to it.
        most: Largest factor tried.

    Returns:
        The factor, margin included; 1 where the task itself is feasible.
    """

    def feasible(factor: float) -> bool:
        slow = slower(task, factor)
        problem = stages.discretise(slow, step)
        start = dp.start_position(problem, task.start)
        policy = dp.solve(problem, stages.full_grid(problem, *grid), "cp")
        return evaluate(slow, dp.rollout(policy, dp.best_start(policy) if start is None else start)).feasible

    if feasible(1.0):
        return 1.0
    bad, good = 1.0, 2.0
    while not feasible(good):
        bad, good = good, 2.0 * good
        if good > most:
            return None
    while good - bad > accuracy * good:
        middle = 0.5 * (good + bad)
        good, bad = (middle, bad) if feasible(middle) else (good, middle)
    return good * (1.0 + accuracy)
