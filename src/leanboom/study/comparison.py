"""Comparison: one task by every method of the papers, side by side, each measured by the same judge.

A row is a method and the cost it minimises, as in the papers' tables: "dp (cp)" is dynamic programming for the
constant-pressure pump. One solution serves both pumps, since the judge measures the energy of either. Rows are sorted
by energy; behind the solved ones stand those that are too much for the pump, then those that break a limit, then those
without a result, each with its reason.
"""

from __future__ import annotations

import pickle
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from leanboom.components.costs import COSTS, PUMPS
from leanboom.errors import InputError, LeanboomError
from leanboom.evaluation.evaluate import check_measurable
from leanboom.methods.registry import METHODS, STEP, Method
from leanboom.model.motion import Motion
from leanboom.model.outcome import Kind, Outcome
from leanboom.model.task import Start, Task
from leanboom.planning import planner, summaries
from leanboom.planning.planner import Plan
from leanboom.problem import least_flow, stages, starts
from leanboom.progress import Progress, quiet
from leanboom.quantities.ranges import noted
from leanboom.study import processes

SIMULATED = ("simulated_energy_j", "simulated_path_accuracy_m")  # what a simulation adds to a row's summary

_ENTRY = re.compile(r"([^\s:()]+)(?:[:(]([^\s:()]+)\)?)?")


@dataclass(frozen=True, slots=True)
class Entry:
    """A method and the cost it minimises."""

    method: str
    cost: str

    @property
    def label(self) -> str:
        """As the papers write it: method (minimised cost)."""
        return self.method if METHODS.find(self.method).pointwise else f"{self.method} ({self.cost})"


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """The result of one method on the task, for one pump and start."""

    entry: Entry
    pump: str
    start: Start  # as it was asked for
    summary: dict[str, Any]  # what `plan --json` prints; numbers are None where there is no result
    motion: Motion | None

    @property
    def label(self) -> str:
        """The method and its minimised cost."""
        return self.entry.label

    @property
    def energy(self) -> float | None:
        """Energy of the row's pump [J]; None without a result."""
        return self.summary["energy_j"]

    @property
    def simulated(self) -> float | None:
        """Energy of the row's pump in closed loop [J]; None without a simulation that came to its end."""
        return self.summary.get(SIMULATED[0])

    @property
    def status(self) -> Outcome:
        """`solved`, the violated limit, or why there is no result."""
        return self.summary["status"]

    @property
    def solved(self) -> bool:
        """Whether there is a motion that keeps every limit and that the pump can deliver."""
        return self.status.solved

    @property
    def feasible(self) -> bool:
        """Whether there is a motion that keeps every limit, be it too much for the pump."""
        return self.status.feasible

    @property
    def rank(self) -> tuple[int, float]:
        """Sorting key: solved rows, those too much for the pump, those that break a limit, those without result."""
        if self.motion is None or self.energy is None:
            return 3, 0.0
        return (0 if self.solved else 1 if self.feasible else 2), self.energy


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """All rows of a comparison, sorted within each start and pump."""

    task: Task
    pumps: tuple[str, ...]
    starts: tuple[Start, ...]
    rows: tuple[Row, ...]

    def block(self, pump: str, start: Start) -> tuple[Row, ...]:
        """The rows of one pump and start, best first.

        Args:
            pump: One of `pumps`.
            start: One of `starts`.
        """
        return tuple(row for row in self.rows if row.pump == pump and row.start == start)

    def best(self, pump: str, start: Start) -> Row | None:
        """The solved row of least energy; None if there is none.

        Args:
            pump: One of `pumps`.
            start: One of `starts`.
        """
        return next((row for row in self.block(pump, start) if row.solved), None)

    def json(self) -> list[dict[str, Any]]:
        """What `compare --json` prints: one object a row, as `plan --json` prints it."""
        return [row.summary for row in self.rows]

    def __repr__(self) -> str:
        parts = []
        for start in self.starts:
            for pump in self.pumps:
                best = self.best(pump, start)
                found = "none solved" if best is None else f"{best.label} {(best.energy or 0.0) / 1e3:.2f} kJ"
                parts.append(f"{pump} from {start}: {found}")
        return f"Comparison({self.task.name}: {len(self.rows)} rows; {'; '.join(parts)})"


def entries(methods: Sequence[str] | None, pumps: Sequence[str]) -> tuple[Entry, ...]:
    """The rows that are asked for.

    Args:
        methods: Names of methods, each with all its costs, or "method:cost"; None: all but those that take minutes.
        pumps: The pumps that are looked at.

    Raises:
        InputError: A method or cost does not exist, or does not apply to the other; all problems are named.
    """
    asked = [name for name in METHODS.names() if not METHODS.find(name).slow] if methods is None else methods
    found: dict[Entry, None] = {}
    problems = []
    for text in asked:
        parts = _ENTRY.fullmatch(text.strip())
        method, cost = parts.groups() if parts else (text.strip(), None)
        if (chosen := noted(problems, METHODS.find, method)) is None:
            continue
        if cost is not None and (problem := _unfit(method, chosen, cost)):
            problems.append(problem)
            continue
        costs = (chosen.compared or pumps) if cost is None else (cost,)
        found |= dict.fromkeys(Entry(method, each) for each in costs)
    if not asked:
        problems.append(f"methods = nothing; choose some of {', '.join(METHODS.names())}")
    if problems:
        raise InputError("\n".join(problems))
    return tuple(found)


def _unfit(method: str, chosen: Method, cost: str) -> str:
    """Sentence on why a method does not minimise a cost; empty if it does."""
    own = chosen.costs or tuple(COSTS)
    if cost in own:
        return ""
    if chosen.pointwise:
        return f"method = {method}:{cost}; a pseudo-inverse minimises {own[0]} at every instant"
    if cost not in COSTS:
        return f"cost = {cost}; must be one of {', '.join(COSTS)}"
    return f"method = {method}:{cost}; minimises {', '.join(own)} alone"


def compare(
    task: Task,
    pump: str | Sequence[str] = PUMPS,
    *,
    start: Start | Sequence[Start] | None = None,
    methods: Sequence[str] | None = None,
    simulate: bool = False,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Solve a task by every method and sort the results.

    Methods run side by side, each in a process of its own: a script calls this below `if __name__ == "__main__":`.

    Args:
        task: What to do.
        pump: "ls", "cp" or both: whose energy is compared.
        start: Where the redundant cylinder starts, one or more; None: as the task says.
        methods: Names of methods, or "method:cost"; None: all that do not take minutes.
        simulate: Whether every motion is simulated in closed loop; rows are sorted by planned energy all the same.
        workers: Methods at a time; None: one a core.
        progress: Called with what happens and the share done.

    Returns:
        The sorted rows. A method that fails is a row with its reason.

    Raises:
        InputError: For arguments or tasks that cannot be used.
        InfeasibleError: If the tool cannot follow the path, whatever the extension.
    """
    pumps = tuple(dict.fromkeys((pump,) if isinstance(pump, str) else pump))
    if not pumps or any(name not in PUMPS for name in pumps):
        raise InputError(f"pump = {', '.join(pumps) or 'nothing'}; must be some of {', '.join(PUMPS)}")
    given = task.start if start is None else start
    starts = tuple(dict.fromkeys((given,) if isinstance(given, str | float | int) else given))
    if not starts:
        raise InputError("start = nothing; must be smallest, middle, best, or lengths [m]")
    wanted = entries(methods, pumps)
    check_measurable(task, planner.MOTIONS_AT_A_TIME)
    least_flow.check(task, STEP)
    tasks = {each: replace(task, start=each) for each in starts}
    first = {each: _start_position(tasks[each]) for each in starts}
    tell = progress or quiet
    asked = [(tasks[each], entry, pumps, simulate) for each in starts for entry in wanted]
    tell(f"comparing {len(asked)} solutions", 0.0)
    ended = 0

    def report(index: int, result: processes.CallResult) -> None:
        nonlocal ended
        ended += 1
        each, entry, *_ = asked[index]
        how = "failed" if result.failed else "done"
        tell(f"{entry.label} from {each.start} {how}: {ended} of {len(asked)}", ended / len(asked))

    results = processes.each(partial(_solve_with, _added()), asked, workers, report)
    rows = []
    for (each, entry, *_), result in zip(asked, results, strict=True):
        for name in pumps:
            if result.failed:
                reason = result.failure.splitlines()[0]
                rows.append(_failed(each, entry, name, first[each.start], reason, simulate))
            else:
                summaries, motion = result.value
                rows.append(Row(entry, name, each.start, summaries[name], motion))
    order = {(each, name): i for i, (each, name) in enumerate((s, p) for s in starts for p in pumps)}
    rows.sort(key=lambda row: (order[row.start, row.pump], row.rank))
    return Comparison(task, pumps, starts, tuple(rows))


def solve(asked: tuple[Task, Entry, tuple[str, ...], bool]) -> tuple[dict[str, dict[str, Any]], Motion]:
    """One solution, as a process of its own computes it.

    Args:
        asked: The task with its start, the method with its cost, the pumps to judge it with, and whether to simulate.

    Returns:
        Its summary for each pump, and its motion.

    Raises:
        LeanboomError: If the method has no result; the text says why.
    """
    task, entry, pumps, simulate = asked
    plan = plan_row(task, entry.method, entry.cost, pump=pumps[0])
    found = {}
    for pump in pumps:
        found[pump] = {**summaries.summary(replace(plan, pump=pump)), "cost": entry.cost}
        if simulate:
            found[pump] |= _simulated(plan.task, plan.motion, pump)
    return found, plan.motion


def plan_row(task: Task, method: str, cost: str, **settings: Any) -> Plan:
    """The plan of a method and the cost it minimises.

    Args:
        task: What to do.
        method: The method.
        cost: Its cost.
        **settings: Further arguments of `planner.run`.

    Raises:
        LeanboomError: If the method has no result; the text says why.
    """
    own = None if METHODS.find(method).pointwise else cost
    plan = planner.run(task, cost=own, method=method, baseline=False, check=False, **settings)
    if plan.status.kind is Kind.UNCONVERGED:
        raise LeanboomError(plan.status)
    return plan


def _added() -> dict[str, Method]:
    """Methods that were added in this process, for those that compute rows; InputError if they cannot be sent there."""
    for name, method in METHODS.added.items():
        try:
            pickle.dumps(method)
        except Exception:  # of whatever kind: the object decides
            text = "its function must be one of a module, for other processes to import"
            raise InputError(f"method = {name}; {text}") from None
    return METHODS.added


def _solve_with(added: dict[str, Method], asked: tuple) -> Any:
    """The row of `solve` in a process with more methods."""
    METHODS.added.update(added)
    return solve(asked)


def _simulated(task: Task, motion: Motion, pump: str) -> dict[str, float | None]:
    """Closed-loop numbers of a row; all None where the simulation does not reach its end."""
    from leanboom.simulation import closed_loop

    try:
        run = closed_loop.simulate(task, motion, pump)
    except LeanboomError:  # out of the crane's reach
        return dict.fromkeys(SIMULATED)
    return dict(zip(SIMULATED, (run.energy, run.path_accuracy) if run.complete else (None, None), strict=True))


def _start_position(task: Task) -> float | None:
    """Where the redundant cylinder starts [m]; None where that is left to the method."""
    legs = [each for each in task.stretches if not each.waits]
    first = task.stretch(legs[0], task.start) if legs else replace(task, timing="fixed")
    return starts.start_position(stages.discretise(first, STEP), task.start)


def _failed(task: Task, entry: Entry, pump: str, start: float | None, reason: str, simulate: bool) -> Row:
    """The row of a method without a result."""
    known = {
        "task": task.name,
        "machine": task.machine.name,
        "pump": pump,
        "cost": entry.cost,
        "method": entry.method,
        "start_m": start,
        "status": Outcome(Kind.FAILED, reason),
        "duration_s": float(task.duration),
        "limit_use": dict.fromkeys(("position", "velocity", "acceleration", "flow")),
    }
    keys = (*summaries.KEYS, *SIMULATED) if simulate else summaries.KEYS
    return Row(entry, pump, task.start, {key: known.get(key) for key in keys}, None)
