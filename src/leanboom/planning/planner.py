"""The planner: from a task to the best judged feasible motion, by any method.

Method `dp` runs the whole chain of the package: a coarse dynamic program over all feasible extensions, tubes
around its motion on ever finer grids, then the polish with the switches fixed. Whatever step a candidate comes
from, the judge measures it, and the best feasible one wins.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leanboom import compiling
from leanboom.certificate import certificate, lower_bounds, upper_bound
from leanboom.certificate.certificate import Certificate
from leanboom.components.costs import COSTS, PUMPS
from leanboom.dynamic_programming import value_function
from leanboom.errors import InfeasibleError, InputError
from leanboom.evaluation.evaluate import Evaluation, check_measurable, evaluate
from leanboom.fixed_mode import modes
from leanboom.methods.dp_refined import EFFORTS, GRID, Progress, Search, shortest_duration
from leanboom.model.motion import Motion, headed
from leanboom.model.task import Task
from leanboom.problem import stages, starts
from leanboom.quantities import ranges

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

KEPT = 8  # judged motions that a search holds at a time
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
    peak_memory_bytes: int | None  # None where the system does not say
    certificate: Certificate | None = None  # of the effort `thorough`

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
    effort: str = "default",
    seconds: float = PROOF_SECONDS,
    gap: float | None = None,
    warm_start: Sequence[Motion] = (),
    check: bool = True,
) -> Motion:
    """Plan a task and return its motion.

    Args:
        task: What to do; `task.start` says where the redundant cylinder starts.
        pump: "ls" or "cp": whose energy counts.
        cost: What to minimise, a name of `costs.COSTS`; by default the pump's energy.
        method: A name of `METHODS`.
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
        InputError: For arguments or tasks that cannot be used.
        InfeasibleError: If `check` and no motion keeps every limit, with the best one as its `plan`.
    """
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
    step: float = 0.05,
    effort: str = "default",
    seconds: float = PROOF_SECONDS,
    gap: float | None = None,
    warm_start: Sequence[Motion] = (),
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
        effort: "quick" (one local minimum, no shorter stages), "default" (several), or "thorough": more of them, and a
            proof of how far from the optimum the plan can be, whose best motion is one more seed.
        seconds: Time for the proof [s], as in `certify`.
        gap: Gap at which the proof ends [%]; by default 1 for "ls", 0.3 for "cp".
        warm_start: Motions of this task or of one with tighter limits; the plan is never worse than a feasible one.
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
    grid, step = _check(task, pump, cost, method, grid, step, effort)
    gap = PROVEN[pump] if gap is None else gap
    certificate.check(pump, step, seconds, gap)
    tell = progress or (lambda text, share: None)
    tell("loading kernels", 0.0)
    with compiling.told(tell):
        value_function.prepare()
        if method in ("dp", "polish"):
            modes.prepare()
    began = time.perf_counter()
    search = Search(task, cost, grid, step, EFFORTS[effort], tell)
    best = _by(method, search, warm_start)
    proof = None
    if effort == "thorough" and certificate.provable(task) and method == "dp" and cost == pump and best.feasible:
        best, proof = _prove(search, best, step, seconds, gap)
    solve_s = time.perf_counter() - began
    status = best.status_with(pump) if best.feasible or method != "dp" else _explain(search, best)
    done = replace(
        best.motion, method=method, cost=cost, solve_s=solve_s, log=best.motion.log or tuple(search.log), status=status
    )
    best = replace(best, motion=done)
    if not best.feasible:
        best = replace(best, violations=(status, *best.violations[1:]))
    other = search.baseline(float(done.position[0])) if baseline else None
    tell("done", 1.0)
    found = Plan(task, pump, done, best, other, _peak_memory(), proof)
    if check and not best.feasible:
        raise InfeasibleError(status, plan=found, evaluation=best)
    return found


def _prove(
    search: Search, best: Evaluation, step: float, seconds: float, gap: float
) -> tuple[Evaluation, Certificate | None]:
    """The best motion and its certificate, each with what the other one found."""
    task, pump = search.task, search.cost
    try:
        proof = certificate.certify(
            task, pump, motion=best.motion, step=step, seconds=seconds, gap=gap, progress=search.tell
        )
    except InfeasibleError:  # stages of this length are too coarse for the motion
        return best, None
    best = search.look_around(proof.motion)
    problem = stages.discretise(task, step)
    again = upper_bound.measure(problem, stages.on_stages(problem, best.motion), pump)
    if again.keeps_limits and again.energy < proof.energy_j:
        proof = replace(proof, motion=again.motion, energy_j=again.energy)
    return best, proof


def _peak_memory() -> int | None:
    """The most memory this process has taken [bytes]; None where the system does not say."""
    try:
        import resource  # not on Windows
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def _check(
    task: Task, pump: str, cost: str, method: str, grid: object, step: object, effort: str
) -> tuple[tuple[int, int], float]:
    """Grid and step as they are used; InputError for arguments that cannot be, all problems at once."""
    problems = []
    if pump not in PUMPS:
        problems.append(f"pump = {pump}; must be one of {', '.join(PUMPS)}")
    if cost not in COSTS:
        problems.append(f"cost = {cost}; must be one of {', '.join(COSTS)}")
    if method not in METHODS:
        problems.append(f"method = {method}; must be one of {', '.join(METHODS)}")
    if effort not in EFFORTS:
        problems.append(f"effort = {effort}; must be one of {', '.join(EFFORTS)}")
    nodes, length = value_function.sizes(grid, step, ranges.STAGE, problems)
    check_measurable(task, KEPT)
    value_function.check_memory(int(np.ceil(task.duration / length)), *nodes)
    return nodes, length


def _by(method: str, search: Search, seeds: Sequence[Motion]) -> Evaluation:
    """The best judged motion of a method."""
    if method == "dp":
        return search.run(seeds)
    if method == "polish":
        return search.polish_alone()
    task = search.task
    start = starts.start_position(stages.discretise(task, search.step), task.start)
    if start is None:
        raise InputError(f"start = best; method {method} needs smallest, middle or a length")
    answer = _other_method(method, search, start)
    judged = evaluate(task, answer)
    if answer.status.startswith("not converged"):
        judged = replace(judged, violations=(answer.status, *judged.violations))
    return judged


def _other_method(method: str, search: Search, start: float) -> Motion:
    """The motion of a method that is not this package's own, from a start [m]."""
    task, cost, tell = search.task, search.cost, search.tell
    if method.startswith("sns-"):
        from leanboom.methods import pseudo_inverse

        return pseudo_inverse.resolve(task, start, method.rsplit("-", maxsplit=1)[-1])
    if method == "dp1":
        from leanboom.methods import dp_velocity

        return dp_velocity.plan(task, cost, start)
    if method == "shooting":
        from leanboom.methods import multiple_shooting

        return multiple_shooting.plan(task, cost, start, tell)
    if method == "pseudospectral":
        from leanboom.methods import pseudospectral

        return pseudospectral.plan(task, cost, start, tell)
    from leanboom.methods import dp_paper

    return dp_paper.plan(task, cost, start, progress=lambda share: tell("Algorithm 1", share))


def _explain(search: Search, best: Evaluation) -> str:
    """Why there is no feasible motion: whether that is proven, and the shortest duration found to have one."""
    task, step = search.task, search.step
    search.tell("looking for a proof that there is no motion", 0.9)
    problem = stages.discretise(task, step)
    proven = lower_bounds.excludes_motion(problem, starts.start_position(problem, task.start))
    said = f"no feasible motion{' (proven)' if proven else ' found'}: {best.status}"
    search.tell("looking for the shortest feasible duration", 0.92)
    try:
        factor = shortest_duration(task, search.grid, step)
    except InputError:  # a slower task does not fit into memory
        factor = None
    if factor is None or factor <= 1.0:
        return said
    duration = np.ceil(100.0 * factor * task.duration) / 100.0
    return f"{said}; one was found for {duration:.2f} s instead of {task.duration:.2f} s"
