"""The search of method `dp`: from a task to the best judged motion, over all local minima that a coarse grid shows.

A coarse dynamic program, forward and backward in time, gives the least cost of a motion through every node, and so
the local minima worth following (`local_minima`). Each is refined in tubes, narrow grids around a motion, and polished
with its switches fixed (`fixed_mode`); the best of them are refined further, at last on shorter stages. Load-sensing
costs have many local minima that differ in their switches alone: a tube's motion is polished even where its own cost is
no lower.
The judge measures every candidate, and the best feasible one wins.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from leanboom import resources
from leanboom.components.costs import COSTS
from leanboom.dynamic_programming import grids, local_minima, value_function
from leanboom.dynamic_programming.value_function import Policy, Terminal
from leanboom.evaluation import ranking
from leanboom.evaluation.evaluate import Evaluation, evaluate, judged_cost
from leanboom.fixed_mode import modes
from leanboom.fixed_mode.modes import Modes, Polisher
from leanboom.methods import pseudo_inverse
from leanboom.methods.registry import EFFORTS, Effort, Settings
from leanboom.model.motion import Motion
from leanboom.model.task import Task
from leanboom.problem import feasible_strokes, stages, starts
from leanboom.problem.stages import Problem
from leanboom.progress import Progress, quiet

# Half widths of the first tube, of the stroke range and of the coarse grid's velocities. Level n is 1 / 2^n as wide.
WIDTH, SPREAD = 0.03, 0.12
# Nodes of a tube. With loads velocities count: switches lie where cylinders begin to be driven, a few mm/s apart;
# narrower tubes do with fewer positions. The last where the motion follows an end of feasible extensions that moves.
TUBE, LOADED_TUBE, NARROW_TUBE, RIDING_TUBE = (17, 17), (17, 65), (9, 65), (31, 33)
FIRST_LEVELS, NEXT_LEVELS, LAST_LEVELS = (0,), (0, 2), (1, 2)  # of local minima, the best, finer stages
FINEST_LEVELS = (0, 1, 2)  # with loads, on stages a quarter as long and less
RIDING_LEVELS = (2, 3, 4, 5)  # with loads, where the motion follows a moving end
LEAST_STAGES = 200  # with loads switches begin and end with stages: a short task has shorter ones
SAME = 1e-6  # local minima whose costs differ by less than this share are one
LEADING = 1.002  # local minima within this factor of the best are refined further
PROMISING = 1.0005  # a tube's motion within this factor of the best is polished where loads count
POLISHABLE = 1.3  # a motion that uses a limit up to this much too far is polished where it is cheaper
NEAR = 1.05  # a pseudo-inverse of long steps within this factor of the best is made again with short ones
ELSEWHERE = 0.01  # [m], a pseudo-inverse that ends so far from where it is to end is none of the task
MOVING, TOUCHING = 1e-3, 1e-4  # a limit that moves [m/s], and a motion on it [m]
FINER = 5e-4  # stages are halved again while that gains more than this share
REPAIRABLE, ROOM = 1.05, 0.9995  # limits used up to this much too far are polished again, to below this share
TIGHTENED = 4  # times shorter stages may be, beyond the effort's, where limits had to be tightened
FAR = 5e-3  # a seed that is this share behind the best after a round is not polished again
SETTLED = 1e-4  # polishing ends when it gains less than this share
NARROW = 0.8  # share of the velocities of a grid beyond which a motion asks for a wider grid


def plan(task: Task, cost: str, start: None, tell: Progress, settings: Settings) -> Evaluation:
    """The whole search, judged.

    Args:
        task: The task; it says where the redundant cylinder starts.
        cost: What to minimise, a name of `costs.COSTS`.
        start: Not used.
        tell: Called with what happens and the share done.
        settings: Coarse grid, stages, effort, seeds, and what makes one more of them from a feasible motion.
    """
    search = Search(task, cost, settings.grid, settings.step, EFFORTS[settings.effort], tell)
    best = search.run(settings.seeds)
    if settings.prover is not None and best.feasible and (seed := settings.prover(best.motion)) is not None:
        best = search.look_around(seed)
    return search.logged(best)


def plan_by_polish(task: Task, cost: str, start: None, tell: Progress, settings: Settings) -> Evaluation:
    """The polish alone, from the pseudo-inverse, judged; arguments as in `plan`."""
    search = Search(task, cost, settings.grid, settings.step, EFFORTS[settings.effort], tell)
    return search.logged(search.polish_alone())


class Search:
    """One search: the task, the log, and the best judged motion so far."""

    def __init__(
        self, task: Task, cost: str, grid: tuple[int, int], step: float, effort: Effort = EFFORTS["default"],
        tell: Progress = quiet,
    ):  # fmt: skip
        self.task, self.cost, self.grid, self.effort, self.tell = task, cost, grid, effort, tell
        self.began = time.perf_counter()
        self.log: list[str] = []
        self.best: Evaluation | None = None
        self.tightened: Evaluation | None = None  # the last one polished with tightened limits
        self.loads = COSTS[cost].loads
        self.step = stage_length(task, cost, step)
        self.short = self.step < step
        self.span = task.machine.redundant.velocity_limit  # velocities of the coarse grid reach this far [m/s]
        self._polishers: dict[int, Polisher] = {}  # by number of stages
        self._polished: list[Modes] = []

    def run(self, seeds: Iterable[Motion] = ()) -> Evaluation:
        """The best motion.

        Args:
            seeds: Motions to look around besides those that the coarse grid shows.
        """
        problem = stages.discretise(self.task, self.step)
        start = starts.start_position(problem, self.task.start)
        coarse = [seed for density in self.effort.grids for seed in self.coarse(problem, start, density)]
        found = self.descend_all(problem, coarse, start, FIRST_LEVELS)
        for seed in seeds:
            judged = self.judge(seed, "given motion")
            found.append(judged)
            found.append(self.descend(problem, judged.motion, start, NEXT_LEVELS))
        self.lead(problem, found, start)
        best = self.known_best()
        first = float(best.motion.position[0]) if start is None else start
        other = pseudo_inverse.baseline(self.task, first, self.step)
        if other is not None and (COSTS[self.cost].work or self.rides_on_a_limit(problem)):
            self.polish(problem, other.motion, start is None)  # at times to a lower minimum, or along a moving limit
        self.finer_stages(start)
        if not self.known_best().feasible:
            self.from_other_costs(problem, start)
        self.keep_baseline(problem, other, first)
        return self.known_best()

    def around(self, problem: Problem, seeds: Iterable[Motion], start: float | None, span: float) -> Evaluation:
        """The best motion around given ones, without a coarse program.

        Args:
            problem: The discretised task.
            seeds: The motions.
            start: The start of the redundant cylinder [m]; None where it is free.
            span: Velocity that motions make use of [m/s].
        """
        self.span = span
        found = self.descend_all(problem, seeds, start, FIRST_LEVELS)
        self.lead(problem, found, start)
        self.finer_stages(start)
        return self.known_best()

    def look_around(self, seed: Motion) -> Evaluation:
        """The best motion after one more seed, such as one that a proof has found."""
        problem = stages.discretise(self.task, self.step)
        start = starts.start_position(problem, self.task.start)
        before = self.known_best()
        judged = self.judge(seed, "given motion")
        if judged_cost(judged, self.cost) <= LEADING * judged_cost(before, self.cost):
            self.descend(problem, judged.motion, start, NEXT_LEVELS)
            self.finer_stages(start)
        return self.known_best()

    def known_best(self) -> Evaluation:
        """The best judged motion so far."""
        assert self.best is not None
        return self.best

    def coarse(self, problem: Problem, start: float | None, density: float = 1.0) -> list[Motion]:
        """Motions of the coarse program: one for each local minimum worth following, the best first.

        Velocities reach as far as motions make use of them, and no farther than the limit.

        Args:
            problem: The discretised task.
            start: The start of the redundant cylinder [m]; None where it is free.
            density: Nodes along position and velocity, in those of the grid asked for.
        """
        nodes = round(density * self.grid[0]), round(density * self.grid[1])
        end = starts.end_position(problem, start)

        def shown(policy: Policy) -> list[Motion]:
            if self.effort.minima > 1:
                self.tell("local minima", 0.2)
                most = self.effort.most(problem.stages, self.loads)
                return local_minima.local_minima(local_minima.through(policy, start), self.effort.share, most)
            return [value_function.rollout(policy, value_function.best_start(policy) if start is None else start)]

        policy, minima = coarse_policy(problem, nodes, self.cost, shown, end, self.tell)
        grid = policy.grid
        self.span = float(grid.w_hi[0])
        if start is None:  # given starts are starts, too
            minima += [value_function.rollout(policy, float(each[0])) for each in (problem.lower, problem.upper)]
        self.note(f"coarse {grid.positions}x{grid.velocities}: {len(minima)} motions")
        return minima

    def descend_all(
        self, problem: Problem, seeds: Iterable[Motion], start: float | None, levels: tuple[int, ...]
    ) -> list[Evaluation]:
        """The best motion of `descend` around each of several motions, found in threads beside each other.

        What is found around one is known to the others only afterwards, so results do not depend on the threads.
        """
        self.polisher(problem)  # built once, before threads ask for it
        branches = [(self.branch(), seed) for seed in seeds]
        with ThreadPoolExecutor(resources.threads()) as pool:
            found = list(pool.map(lambda each: each[0].descend(problem, each[1], start, levels), branches))
        for branch, _ in branches:
            self.adopt(branch)
        return found

    def branch(self) -> Search:
        """A search that knows what this one knows, and notes its own findings."""
        other = copy.copy(self)
        other.log, other._polished = [], list(self._polished)
        return other

    def adopt(self, branch: Search) -> None:
        """Take over what a branch has found."""
        self.log += branch.log
        self._polished += [each for each in branch._polished if each not in self._polished]
        if branch.best is not None and (self.best is None or ranking.beats(branch.best, self.best, self.cost)):
            self.best, self.tightened = branch.best, branch.tightened

    def descend(self, problem: Problem, seed: Motion, start: float | None, levels: tuple[int, ...]) -> Evaluation:
        """The best motion found in tubes around a motion, each tube around the best one so far, and by polishing.

        Args:
            problem: The discretised task; `seed` may have other stages.
            seed: The motion to begin around.
            start: The start of the redundant cylinder [m]; None where it is free.
            levels: How narrow the tubes are.
        """
        low, high = feasible_strokes.stroke_range(self.task)
        chain: Evaluation | None = None
        for level in levels:
            self.tell(f"tubes of 1/{2**level} width", 0.3 + 0.1 * level)
            at = starts.ended(problem, seed if chain is None else chain.motion)
            half = 0.5**level
            widths = half * WIDTH * (high - low), half * SPREAD * self.span
            tube = grids.tube_grid(problem, at.position, at.velocity, *widths, *self.nodes(problem, level))
            end = starts.end_position(problem, start)
            policy = value_function.solve(problem, tube, self.cost, end=end)
            moved = value_function.rollout(policy, value_function.best_start(policy) if start is None else start)
            found = self.judge(moved, f"tube of {widths[0]:.4f} m, {widths[1]:.4f} m/s")
            if self.promises(found, chain):
                found = ranking.better(found, self.polish(problem, moved, start is None), self.cost)
            chain = found if chain is None else ranking.better(chain, found, self.cost)
        assert chain is not None
        return chain

    def nodes(self, problem: Problem, level: int) -> tuple[int, int]:
        """Positions and velocities of a tube."""
        if self.rides_on_a_limit(problem):
            return RIDING_TUBE
        if not self.loads:
            return TUBE
        return NARROW_TUBE if level else LOADED_TUBE

    def promises(self, found: Evaluation, chain: Evaluation | None) -> bool:
        """Whether a tube's motion is worth polishing: the first around a local minimum, and what may be better.

        With loads its switches may be the better ones where it costs a little more.
        """
        if not found.feasible and found.worst_use >= POLISHABLE:
            return False
        if self.loads and chain is not None:
            return judged_cost(found, self.cost) <= PROMISING * judged_cost(self.known_best(), self.cost)
        return chain is None or cheaper(found, chain, self.cost)

    def lead(self, problem: Problem, found: list[Evaluation], start: float | None) -> None:
        """Refine the best of some local minima further.

        Without loads the polish of a motion is a local minimum already, unless a limit moves with it.
        """
        best = self.known_best()
        if not self.loads and best.feasible and not self.rides_on_a_limit(problem):
            return
        near = [each for each in found if judged_cost(each, self.cost) <= LEADING * judged_cost(best, self.cost)]
        near = [each for each in near if each.feasible == best.feasible] or [best]
        near.sort(key=lambda each: judged_cost(each, self.cost))
        leaders = near[:1]
        for each in near[1:]:
            if gains(judged_cost(each, self.cost), judged_cost(leaders[-1], self.cost), SAME):
                leaders.append(each)
        levels = NEXT_LEVELS if self.loads else NEXT_LEVELS[1:]
        self.descend_all(problem, [each.motion for each in leaders[: self.effort.leading]], start, levels)
        if self.loads and self.rides_on_a_limit(problem):
            self.descend(problem, self.known_best().motion, start, RIDING_LEVELS)

    def rides_on_a_limit(self, problem: Problem) -> bool:
        """Whether the best motion follows an end of the feasible extensions that itself moves."""
        if self.best is None:
            return False
        position = stages.on_stages(problem, self.best.motion).position
        for end in (problem.lower, problem.upper):
            moves = np.abs(np.gradient(end, problem.step)) > MOVING
            if np.any(moves & (np.abs(position - end) < TOUCHING)):
                return True
        return False

    def finer_stages(self, start: float | None) -> None:
        """Refine on stages half and a quarter as long: switches and moving limits ask for it.

        They are halved again where that paid and loads count or a limit moves, and for short tasks with loads. More
        follow where the best motion keeps its limits between stages by tightened ones alone: shorter stages need less.
        Where shorter stages pay with loads, motions switch at almost every stage; wide tubes find others of that kind.
        """
        factor = 2
        while factor <= self.effort.shortest * (TIGHTENED if self.best is self.tightened else 1):
            before = self.known_best()
            problem = stages.discretise(self.task, self.step / factor)
            self.tell(f"stages of {problem.step:.3g} s", 0.8)
            self.polish(problem, before.motion, start is None)
            if self.loads:
                levels = LAST_LEVELS if factor == 2 else FINEST_LEVELS
                self.descend(problem, self.known_best().motion, start, levels)
            elif self.rides_on_a_limit(problem):
                self.descend(problem, self.known_best().motion, start, LAST_LEVELS[1:])
            gained = gains(judged_cost(before, self.cost), judged_cost(self.known_best(), self.cost), FINER)
            more = gained and (self.loads or self.rides_on_a_limit(problem))
            if before.feasible and not self.short and not more:
                break
            factor *= 2

    def from_other_costs(self, problem: Problem, start: float | None) -> None:
        """Look for a feasible motion with other costs, and from there for a cheap one.

        Whether a motion exists does not depend on the cost: constant-pressure energy and squared velocities are
        smooth enough to be led to a feasible motion where this cost's jumps were not.
        """
        for cost in ("cp", "velocity"):
            if cost == self.cost:
                continue
            self.tell(f"looking for a feasible motion by its {cost} cost", 0.85)
            other = Search(self.task, cost, self.grid, self.step, EFFORTS["quick"])
            seed = other.run_once(problem, start)
            if seed.feasible:
                self.judge(seed.motion, f"feasible motion by its {cost} cost")
                self.descend(problem, seed.motion, start, NEXT_LEVELS)
                self.finer_stages(start)
                return

    def run_once(self, problem: Problem, start: float | None) -> Evaluation:
        """The best motion of one coarse minimum, its tubes and polish, without any other candidate."""
        for seed in self.coarse(problem, start):
            self.descend(problem, seed, start, FIRST_LEVELS)
        if not self.known_best().feasible:
            fine = stages.discretise(self.task, 0.5 * self.step)
            self.polish(fine, self.known_best().motion, start is None)
        return self.known_best()

    def polish(self, problem: Problem, seed: Motion, free: bool, rounds: int = 1) -> Evaluation | None:
        """Fix the modes of a motion, solve the smooth problem, read the modes off the answer, repeat while it pays.

        Args:
            problem: The discretised task.
            seed: The motion.
            free: Whether its start may move.
            rounds: Solutions at most.

        Returns:
            The best motion; None where the modes were polished before or nothing was found.
        """
        polisher = self.polisher(problem)
        best: Evaluation | None = None
        for _ in range(rounds if self.loads else 1):  # without loads no modes, no second round
            at = starts.ended(problem, seed)
            switches = modes.modes(polisher, at)
            if self.loads and any(switches.same_as(known) for known in self._polished):
                break
            self._polished.append(switches)
            with np.errstate(all="ignore"):  # a seed out of reach has no numbers there
                answer, text = modes.solve(polisher, at, switches, free)
            if answer is None:
                self.note(f"polish: {text}")
                break
            judged = self.judge(answer, f"polish of {problem.stages} stages ({text})")
            if not judged.feasible and judged.worst_use < REPAIRABLE:
                judged = self.repair(polisher, judged, switches, free)
            before = best
            best = judged if best is None else ranking.better(best, judged, self.cost)
            seed = judged.motion
            leader = judged_cost(self.known_best(), self.cost)
            behind = judged.feasible and gains(judged_cost(judged, self.cost), leader, FAR)
            settled = before is not None and not gains(
                judged_cost(before, self.cost), judged_cost(judged, self.cost), SETTLED
            )
            if behind or settled:
                break
        return best

    def polisher(self, problem: Problem) -> Polisher:
        """The fixed-mode program of a discretised task."""
        if problem.stages not in self._polishers:
            self._polishers[problem.stages] = modes.build(problem, self.cost)
        return self._polishers[problem.stages]

    def repair(self, polisher: Polisher, judged: Evaluation, switches: Modes, free: bool) -> Evaluation:
        """Polish again with limits tightened by what a polished motion broke between the ends of its intervals."""
        use = judged.limit_use
        flow = min(1.0, ROOM / use.flow) if use.flow_limited else 1.0
        share = min(1.0, ROOM / use.velocity), min(1.0, ROOM / use.acceleration), flow
        answer, text = modes.solve(polisher, judged.motion, switches, free, share)
        if answer is None:
            return judged
        found = self.judge(answer, f"polish with tightened limits ({text})")
        self.tightened = found if self.best is found else self.tightened
        return found

    def polish_alone(self) -> Evaluation:
        """The polish from the pseudo-inverse: nonlinear programming without the dynamic program."""
        problem = stages.discretise(self.task, self.step)
        start = starts.start_position(problem, self.task.start)
        first = starts.start_position(problem, "middle") if start is None else start
        assert first is not None
        seed = self.judge(pseudo_inverse.resolve(self.task, first, "actuator"), "pseudo-inverse")
        self.polish(problem, seed.motion, start is None, rounds=4)
        return self.known_best()

    def keep_baseline(self, problem: Problem, rough: Evaluation | None, start: float) -> None:
        """Take the pseudo-inverse, and polish it, where it is better than the best motion: no plan is worse than it."""
        if rough is not None and judged_cost(rough, self.cost) > NEAR * judged_cost(self.known_best(), self.cost):
            return
        end = starts.end_position(problem, start)
        if rough is not None and end is not None and abs(rough.motion.position[-1] - end) > ELSEWHERE:
            return
        other = pseudo_inverse.baseline(self.task, start)
        if other is not None and ranking.beats(other, self.known_best(), self.cost):
            self.best = other
            self.note(f"the pseudo-inverse is better: {judged_cost(other, self.cost):.4g}; refining from it")
            self.polish(problem, other.motion, False, rounds=4)

    def judge(self, candidate: Motion, name: str) -> Evaluation:
        """Measure a candidate, note it, keep it if it is the best."""
        judged = evaluate(self.task, candidate)
        self.note(f"{name}: {judged_cost(judged, self.cost):.6g}, {judged.status}")
        if self.best is None or ranking.beats(judged, self.best, self.cost):
            self.best = judged
        return judged

    def logged(self, judged: Evaluation) -> Evaluation:
        """A judged motion with the log of this search."""
        return replace(judged, motion=replace(judged.motion, log=judged.motion.log or tuple(self.log)))

    def note(self, text: str) -> None:
        """Add a line to the log."""
        self.log.append(f"{time.perf_counter() - self.began:6.2f} s  {text}")


def coarse_policy(
    problem: Problem, nodes: tuple[int, int], cost: str, shown: Callable[[Policy], list[Motion]],
    end: float | None = None, tell: Progress = quiet, terminal: Terminal | None = None,
) -> tuple[Policy, list[Motion]]:  # fmt: skip
    """The policy over all feasible extensions, with velocities as far as its motions use them, and these motions.

    Args:
        problem: The discretised task.
        nodes: Positions and velocities.
        cost: What to minimise, a name of `costs.COSTS`.
        shown: The motions of a policy that count.
        end: Where they end [m]; None: anywhere.
        tell: Called with what happens and the share done.
        terminal: What ending there costs; None: nothing, at rest.
    """
    limit, span = problem.crane.machine.redundant.velocity_limit, problem.pace
    while True:
        tell(f"coarse dynamic program, velocities up to {span:.3g} m/s", 0.05)
        policy = value_function.solve(problem, grids.full_grid(problem, *nodes, span), cost, terminal, end)
        motions = shown(policy)
        if span >= limit or max(float(np.abs(each.velocity).max()) for each in motions) < NARROW * span:
            return policy, motions
        span = min(limit, 2.0 * span)


def cheaper(one: Evaluation, other: Evaluation, cost: str) -> bool:
    """Whether a judged motion costs less than another, limits aside."""
    return judged_cost(one, cost) < judged_cost(other, cost)


def gains(before: float, after: float, share: float) -> bool:
    """Whether a cost fell by more than a share of its size."""
    return before - after > share * abs(before)


def stage_length(task: Task, cost: str, step: float) -> float:
    """Length of a stage of the search [s]: as asked for, or less with loads on a short task."""
    return task.duration / LEAST_STAGES if COSTS[cost].loads and task.duration < LEAST_STAGES * step else step
