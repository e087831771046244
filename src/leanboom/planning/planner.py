"""The planner: from a task to the best judged feasible motion, by any method; tasks with legs by `cycles`.

Method `dp` runs the whole chain of the package: a coarse dynamic program over all feasible extensions, tubes
around its motion on ever finer grids, then the polish with the switches fixed. Whatever step a candidate comes
from, the judge measures it, and the best feasible one wins.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from leanboom import compiling, resources
from leanboom.certificate import certificate, lower_bounds, upper_bound
from leanboom.certificate.certificate import Certificate
from leanboom.components.costs import COSTS, PUMPS
from leanboom.dynamic_programming import value_function
from leanboom.errors import InfeasibleError, InputError
from leanboom.evaluation import ranking
from leanboom.evaluation.evaluate import Evaluation, check_measurable, evaluate, judged_cost
from leanboom.methods import closed_cycle, pseudo_inverse
from leanboom.methods.dp_refined import gains, stage_length
from leanboom.methods.least_duration import shortest_duration
from leanboom.methods.registry import EFFORTS, GRID, METHODS, STEP, Method, Settings
from leanboom.model.motion import Motion
from leanboom.model.outcome import Kind, Outcome
from leanboom.model.task import Task
from leanboom.planning import cycles, leg_search
from leanboom.problem import least_flow, stages, starts
from leanboom.progress import Progress, quiet
from leanboom.quantities.ranges import STAGE, noted, one_of
from leanboom.timing import free, shortest

MOTIONS_AT_A_TIME = 8  # judged motions that a search holds at a time
TIMINGS, WORTH = 3, 2e-3  # timings tried one after the other at most, while each saves more than this share
LEAST_STAGE = 1e-3  # [s]
PROOF_SECONDS = 300.0  # time that `thorough` takes for a proof at most [s]
PROVEN = {"ls": 1.0, "cp": 0.3}  # gap at which it ends [%]


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A planned task: the motion, what the judge says of it, and of the pseudo-inverse beside it."""

    task: Task
    pump: str
    motion: Motion
    evaluation: Evaluation
    baseline: Evaluation | None  # sns-actuator from the same start
    peak_memory_bytes: int
    certificate: Certificate | None = None  # of the effort `thorough`

    @property
    def status(self) -> Outcome:
        """`solved`, or a sentence on the violated limit or on what the chosen pump cannot deliver."""
        return self.evaluation.status_with(self.pump)

    @property
    def solved(self) -> bool:
        """Whether the motion keeps every limit and the chosen pump can deliver it."""
        return self.status.solved

    def saving(self, pump: str | None = None) -> float | None:
        """Share of the pseudo-inverse's energy that the plan saves; None where there is nothing to compare.

        Args:
            pump: "ls" or "cp"; by default the chosen pump.

        Returns:
            The share; None for a plan that is not solved, with that pump, and without a pseudo-inverse.
        """
        pump = self.pump if pump is None else pump
        if self.baseline is None or not self.evaluation.status_with(pump).solved:
            return None
        mine, theirs = self.evaluation.energy(pump), self.baseline.energy(pump)
        return 1.0 - mine / theirs if self.baseline.followed and theirs > 0.0 else None

    def __repr__(self) -> str:
        text = f"Plan({self.pump}, {self.evaluation.summary})"
        return self.status.head(text)


def plan(
    task: Task,
    pump: str = "ls",
    *,
    cost: str | None = None,
    method: str = "dp",
    grid: tuple[int, int] = GRID,
    step: float = STEP,
    effort: str = "default",
    seconds: float = PROOF_SECONDS,
    gap: float | None = None,
    warm_start: Sequence[Motion] = (),
    check: bool = True,
) -> Motion:
    """The planned motion of a task.

    Args:
        task: What to do; `task.start` says where the redundant cylinder starts.
        pump: "ls" or "cp": whose energy counts.
        cost: What to minimise, a name of `costs.COSTS`; by default the pump's energy.
        method: A name of `methods.registry.METHODS`.
        grid: Position and velocity nodes of the coarse grid.
        step: Length of a stage [s].
        effort: "quick" (one local minimum, no shorter stages), "default" (several), or "thorough": more of them, and a
            proof of how far from the optimum the plan can be, whose best motion is one more seed.
        seconds: Time for the proof [s], as in `certify`.
        gap: Gap at which the proof ends [%]; by default 1 for "ls", 0.3 for "cp".
        warm_start: Motions of this task or of one with tighter limits; the plan is never worse than a feasible one.
        check: Whether to raise where no feasible motion was found.

    Returns:
        The motion; its `status` says whether it keeps every limit, and whether the pump can deliver it.

    Raises:
        InputError: For arguments or tasks that cannot be used, and for one whose timing is planned: `run` has it.
        InfeasibleError: If `check` and no motion keeps every limit, with the best one as its `plan`.
    """
    if task.timing != "fixed":
        raise InputError(f"timing = {task.timing}; a motion alone has no timing of the path: use leanboom.run(task)")
    for i, leg in enumerate(task.legs):
        if not leg.settled:
            raise InputError(
                f"legs[{i}] leaves its timing to be planned; a motion alone has none: use leanboom.run(task)"
            )
    return run(
        task, pump=pump, cost=cost, method=method, grid=grid, step=step, effort=effort, seconds=seconds, gap=gap,
        warm_start=warm_start, baseline=False, check=check,
    ).motion  # fmt: skip


def run(
    task: Task,
    *,
    pump: str = "ls",
    cost: str | None = None,
    method: str = "dp",
    grid: tuple[int, int] = GRID,
    step: float = STEP,
    effort: str = "default",
    seconds: float = PROOF_SECONDS,
    gap: float | None = None,
    warm_start: Sequence[Motion] = (),
    baseline: bool = True,
    check: bool = True,
    explain: bool = True,
    progress: Progress | None = None,
) -> Plan:
    """The judged `Plan` of a task, with progress; arguments as in `plan`.

    Where the timing of the task is `free` or `shortest`, the plan's task has the timing found, as a retimed path.

    Args:
        task: What to do.
        pump: "ls" or "cp".
        cost: What to minimise; by default the pump's energy.
        method: A name of `methods.registry.METHODS`.
        grid: Position and velocity nodes of the coarse grid.
        step: Length of a stage [s].
        effort: "quick" (one local minimum, no shorter stages), "default" (several), or "thorough": more of them, and a
            proof of how far from the optimum the plan can be, whose best motion is one more seed.
        seconds: Time for the proof [s], as in `certify`.
        gap: Gap at which the proof ends [%]; by default 1 for "ls", 0.3 for "cp".
        warm_start: Motions of this task or of one with tighter limits; the plan is never worse than a feasible one.
        baseline: Whether to judge the actuator pseudo-inverse as well.
        check: Whether to raise where no feasible motion was found.
        explain: Whether the status then says what is proven and which duration would do; both take a while.
        progress: Called with what happens and the share done.

    Returns:
        The plan; without `check` it may break limits, as `solved` and `status` say.

    Raises:
        InputError: For arguments or tasks that cannot be used.
        InfeasibleError: If `check` and no motion keeps every limit, with the best one as its `plan`; and if the tool
            cannot follow the path, whatever the extension.
    """
    cost = pump if cost is None else cost
    chosen, grid, step = _check(task, pump, cost, method, grid, step, effort)
    gap = PROVEN[pump] if gap is None else gap
    certificate.check(pump, step, seconds, gap)
    tell = progress or quiet
    again = partial(
        run, pump=pump, cost=cost, method=method, grid=grid, effort=effort, seconds=seconds, gap=gap,
        baseline=baseline, progress=progress,
    )  # fmt: skip
    if task.timing != "fixed":
        return _timed(task, cost, step, warm_start, tell, again, check)
    tell("loading kernels", 0.0)
    with compiling.told(tell):
        value_function.prepare()
        chosen.warm_up()
    began = time.perf_counter()
    proof = _Proof(task, pump, step, seconds, gap, tell)
    proven = effort == "thorough" and not task.legs and certificate.provable(task) and cost == pump
    settings = Settings(grid, step, effort, tuple(warm_start), proof.seek if proven else None)
    if task.legs:
        freed = partial(_freed, again, step)
        best = cycles.plan(task, cost, chosen, tell, settings, freed)
        task = best.task
    else:
        best = _single(task, cost, chosen, tell, settings)
    certified = proof.of(best.motion)
    solve_s = time.perf_counter() - began
    if best.feasible or not (chosen.exhaustive and explain):
        status = best.status_with(pump)
    else:
        status = Outcome(Kind.INFEASIBLE, _explain(best, cost, grid, step, tell))
    done = replace(best.motion, method=method, cost=cost, solve_s=solve_s, status=status)
    best = replace(best, motion=done)
    if not best.feasible:
        best = replace(best, violations=(status, *best.violations[1:]))
    other = _baseline(task, float(done.position[0])) if baseline else None
    tell("done", 1.0)
    found = Plan(task, pump, done, best, other, resources.peak_memory(), certified)
    if check and not best.feasible:
        raise InfeasibleError(status, plan=found, evaluation=best)
    return found


def _single(task: Task, cost: str, method: Method, tell: Progress, settings: Settings) -> Evaluation:
    """The judged motion of a task without legs by a method; arguments as in `methods.registry`."""
    start = None if method.free_start else starts.start_position(stages.discretise(task, settings.step), task.start)
    minimised = method.costs[0] if method.pointwise and method.costs else cost
    if task.start == "best" and task.end == "same":
        cycle = closed_cycle.best_cycle(task, cost, settings.grid, settings.step, tell).motion
        settled = replace(task, start=float(cycle.position[0]))
        settings = replace(settings, seeds=(*settings.seeds, cycle))
    else:
        settled = starts.settled(task, settings.step)
    answer = method.plan(settled, minimised, start, tell, settings)
    return evaluate(settled, answer) if isinstance(answer, Motion) else answer


def _freed(again: Callable[..., Plan], step: float, leg: Task, known: Motion) -> Evaluation:
    """The judged motion of a leg, its speed along the path planned from a motion in its own timing."""
    return again(leg, step=step, warm_start=(known,), baseline=False, check=False).evaluation


def _baseline(task: Task, start: float) -> Evaluation | None:
    """The actuator pseudo-inverse from a start [m], its end free, judged; None where it cannot follow the path."""
    return leg_search.baseline(task, start) if task.legs else pseudo_inverse.baseline(replace(task, end="free"), start)


def _timed(
    task: Task, cost: str, step: float, warm_start: Sequence[Motion], tell: Progress, again: Callable[..., Plan],
    check: bool,
) -> Plan:  # fmt: skip
    """The plan of a task whose timing is planned, too.

    Args:
        task: The task.
        cost: What to minimise.
        step: Length of a stage [s].
        warm_start: Motions of the task by the path's own timing.
        tell: Called with what happens and the share done.
        again: `run`, for a task with a fixed timing.
        check: Whether to raise where no feasible motion was found.
    """
    began = time.perf_counter()
    if task.timing == "shortest":
        fastest = shortest.plan(task, cost, tell)
        best = again(
            fastest.task, step=max(fastest.motion.step, LEAST_STAGE), warm_start=(fastest.motion,), check=check
        )
    else:
        best = again(replace(task, timing="fixed"), step=step, warm_start=warm_start, check=False)
        for _ in range(TIMINGS):
            count, before = stages.count(task.duration, stage_length(task, cost, step)), best
            for each in free.proposals(best.evaluation, task, cost, count, tell):
                found = again(each.task, step=step, warm_start=(each.motion,), check=False)
                best = found if ranking.beats(found.evaluation, best.evaluation, cost) else best
            spent, left = (judged_cost(each.evaluation, cost) for each in (before, best))
            if best is before or (before.evaluation.feasible and not gains(spent, left, WORTH)):
                break
        if check and not best.evaluation.feasible:
            raise InfeasibleError(best.status, plan=best, evaluation=best.evaluation)
    motion = replace(best.motion, solve_s=time.perf_counter() - began)
    return replace(best, motion=motion, evaluation=replace(best.evaluation, motion=motion))


@dataclass(slots=True)
class _Proof:
    """A certificate of a motion, with its arguments."""

    task: Task
    pump: str
    step: float
    seconds: float
    gap: float
    tell: Progress
    made: Certificate | None = None

    def seek(self, motion: Motion) -> Motion | None:
        """The best motion that the proof of another one finds; None where there is no proof."""
        try:
            self.made = certificate.certify(
                self.task, self.pump, motion=motion, step=self.step, seconds=self.seconds, gap=self.gap,
                progress=self.tell,
            )  # fmt: skip
        except InfeasibleError:  # stages of this length are too coarse for the motion
            return None
        return self.made.motion

    def of(self, motion: Motion) -> Certificate | None:
        """The certificate, of a motion that is better in its discretised problem; None without a proof."""
        if self.made is None:
            return None
        problem = stages.discretise(self.task, self.step)
        again = upper_bound.measure(problem, stages.on_stages(problem, motion), self.pump)
        if again.keeps_limits and again.energy < self.made.energy_j:
            return replace(self.made, motion=again.motion, energy_j=again.energy)
        return self.made


def _check(
    task: Task, pump: str, cost: str, method: str, grid: object, step: object, effort: str
) -> tuple[Method, tuple[int, int], float]:
    """Method, grid and step as they are used; InputError for arguments that cannot be, all problems at once."""
    problems: list[str] = []
    noted(problems, one_of, "pump", pump, PUMPS)
    noted(problems, one_of, "cost", cost, COSTS)
    chosen = noted(problems, METHODS.find, method)
    noted(problems, one_of, "effort", effort, EFFORTS)
    if chosen is not None and cost in COSTS and not chosen.minimises(cost):
        problems.append(f"method {method} minimises {' or '.join(chosen.costs or ())}, not {cost}")
    if chosen is not None and task.end != "free" and not chosen.ends:
        able = " or ".join(name for name in METHODS.names() if METHODS.find(name).ends)
        problems.append(f"end = {task.end}; method {method} cannot lead the motion to an end: use {able}")
    if chosen is not None and task.limits.pump_flow and not chosen.flow:
        problems.append(f"limits.pump_flow = yes; method {method} knows no limit of the pump's flow: use dp or polish")
    if chosen is not None and task.start == "best" and not chosen.free_start:
        problems.append(f"start = best; method {method} needs smallest, middle or a length")
    for key, word in _planned_timings(task):
        if chosen is not None and not chosen.timing:
            able = " or ".join(name for name in METHODS.names() if METHODS.find(name).timing)
            problems.append(f"{key} = {word}; method {method} keeps the timing of the path: use {able}")
        if word == "free" and cost in COSTS and cost not in PUMPS:
            problems.append(
                f"{key} = free; a timing is planned for the energy of a pump, {' or '.join(PUMPS)}, not {cost}"
            )
    nodes, length = value_function.sizes(grid, step, STAGE, problems)
    check_measurable(task, MOTIONS_AT_A_TIME)
    value_function.check_memory(stages.count(task.duration, length), *nodes)
    least_flow.check(task, length)
    assert chosen is not None  # or it would be among the problems
    return chosen, nodes, length


def _planned_timings(task: Task) -> list[tuple[str, str]]:
    """Keys of a task, and their words, that leave the speed along a path to be planned."""
    found = [] if task.timing == "fixed" else [("timing", task.timing)]
    for i, leg in enumerate(task.legs):
        if isinstance(leg.duration, str):
            found.append((f"legs[{i}].duration", leg.duration))
        elif leg.timing != "fixed":
            found.append((f"legs[{i}].timing", leg.timing))
    return found


def _explain(found: Evaluation, cost: str, grid: tuple[int, int], step: float, tell: Progress) -> str:
    """Sentence on infeasibility: whether it is proven, and the shortest duration found feasible."""
    task, status = found.task, found.status
    if task.legs:
        return f"no feasible motion found: {status}"
    step = stage_length(task, cost, step)
    tell("looking for a proof that there is no motion", 0.9)
    problem = stages.discretise(task, step)
    proven = lower_bounds.excludes_motion(problem, starts.start_position(problem, task.start))
    said = f"no feasible motion{' (proven)' if proven else ' found'}: {status}"
    tell("looking for the shortest feasible duration", 0.92)
    try:
        factor = shortest_duration(task, grid, step)
    except InputError:  # a slower task does not fit into memory
        factor = None
    if factor is None or factor <= 1.0:
        return said
    duration = np.ceil(100.0 * factor * task.duration) / 100.0
    return f"{said}; one was found for {duration:.2f} s instead of {task.duration:.2f} s"
