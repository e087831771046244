"""Reproduction: the papers' experiments solved again, our values beside the printed ones.

Every solution is kept in a file of its own, named after a hash of all that it depends on: the task with its machine,
the method, cost and grid, leanboom's version and the sources that solve. So a run that was interrupted goes on where
it stopped, and experiments share their solutions.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ConfigDict, FiniteFloat, model_validator

from leanboom import __version__
from leanboom.dynamic_programming import grids
from leanboom.errors import InputError
from leanboom.fingerprint import fingerprint
from leanboom.io import folders
from leanboom.methods.registry import METHODS, STEP
from leanboom.model.motion import Motion
from leanboom.model.outcome import SOLVED
from leanboom.model.task import Task
from leanboom.planning import summaries
from leanboom.problem import starts
from leanboom.progress import Progress, quiet
from leanboom.study import comparison, processes
from leanboom.study.papers import variations, weights
from leanboom.study.papers.experiments import EXPERIMENTS
from leanboom.study.papers.jobs import COARSE, Job, Line, Record, Records
from leanboom.study.papers.weights import SIGNED

if TYPE_CHECKING:
    from leanboom.evaluation.evaluate import Evaluation

SMOOTH = 5.0  # [Hz], both papers filter their plans before they are measured
CYCLE = 4.0  # how many times as long as its legs a whole cycle takes, roughly
POINTS = 601  # of a motion in its record, at most
CLOSED_LOOP = ("driven_ls_j", "driven_cp_j", "accuracy_ls_m", "accuracy_cp_m")  # numbers of a record
BY_LEG = ("leg_s", "leg_ls_j", "leg_cp_j")  # lists of a record, an entry a leg
FOLDER = "solved"  # of the solutions


@dataclass(frozen=True, slots=True, eq=False)
class Reproduction:
    """Reproduced experiments: the lines of each, and the records of their solutions."""

    lines: tuple[Line, ...]
    records: Mapping[str, Records]  # by experiment, then by the experiment's name for a solution

    def json(self) -> list[dict[str, Any]]:
        """What `reproduce --json` prints."""
        return [
            {
                "experiment": line.experiment,
                "row": line.row,
                "printed": line.printed,
                "ours": line.ours,
                "difference": line.difference,
            }
            for line in self.lines
        ]

    def __repr__(self) -> str:
        beside = sum(line.difference is not None for line in self.lines)
        return f"Reproduction({', '.join(self.records)}: {len(self.lines)} lines, {beside} beside printed values)"


def names(asked: Sequence[str]) -> tuple[str, ...]:
    """The experiments that are asked for, in their order.

    Args:
        asked: Names of `EXPERIMENTS`, or "all"; none mean all.

    Raises:
        InputError: One of them does not exist.
    """
    wrong = [name for name in asked if name not in EXPERIMENTS and name != "all"]
    if wrong:
        raise InputError(f"experiment = {', '.join(wrong)}; must be all or some of {', '.join(EXPERIMENTS)}")
    return tuple(name for name in EXPERIMENTS if not asked or "all" in asked or name in asked)


def reproduce(
    asked: Sequence[str] = (),
    folder: Path = Path("leanboom-reproduce"),
    *,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Reproduction:
    """Solve what experiments need and is not solved yet, and read their values off.

    Solutions run side by side, each in a process of its own: a script calls this below `if __name__ == "__main__":`.

    Args:
        asked: Names of experiments; none mean all.
        folder: Where solutions are kept.
        workers: Solutions at a time; None: one a core.
        progress: Called with what happens and the share done.

    Returns:
        Our values beside the printed ones.

    Raises:
        InputError: An experiment does not exist, or the folder cannot be used.
    """
    wanted = names(asked)
    tell = progress or quiet
    needed = {name: {row: (key(job), job) for row, job in EXPERIMENTS[name].jobs().items()} for name in wanted}
    every = {digest: job for rows in needed.values() for digest, job in rows.values()}
    known = {digest: record for digest in every if (record := _read(folder, digest)) is not None}
    missing = [digest for digest in every if digest not in known]
    # The longest first, so that no core waits for a late one.
    missing.sort(key=lambda digest: -_effort(every[digest]))
    tell(f"{len(known)} of {len(every)} solutions at hand", len(known) / len(every))

    def keep(index: int, result: processes.CallResult) -> None:
        digest = missing[index]
        record = _nothing(result.failure) if result.failed else result.value
        if not result.failed or result.refused:  # what was killed is tried again next time
            _keep(folder, digest, record)
        known[digest] = record
        job = every[digest]
        text = f"{job.task.name}, {job.method} ({job.cost}): {len(known)} of {len(every)} solutions"
        tell(text, len(known) / len(every))

    if missing:
        processes.each(solve, [every[digest] for digest in missing], workers, keep)
    records = {name: {row: known[digest] for row, (digest, _) in rows.items()} for name, rows in needed.items()}
    lines = [line for name in wanted for line in EXPERIMENTS[name].lines(records[name])]
    result = Reproduction(tuple(lines), records)
    for name in wanted:
        rows = [entry for entry in result.json() if entry["experiment"] == name]
        folders.write(folder, {f"{name}.json": (json.dumps(rows, allow_nan=False) + "\n").encode()})
    return result


def key(job: Job) -> str:
    """Name of a solution: a hash of all that it depends on.

    Args:
        job: The job.
    """
    sources = fingerprint("study.papers.reproduction")
    task = asdict(job.task)  # all of it: its repr is for people
    parts = (__version__, sources, task, job.method, job.cost, job.grid, job.driven, job.switched, SMOOTH, STEP)
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:24]


def _effort(job: Job) -> float:
    """How long a job takes, roughly, relative to others."""
    weight = METHODS.find({COARSE: "dp", SIGNED: "sns-actuator"}.get(job.method, job.method)).weight
    weight *= CYCLE if job.task.legs else 1.0
    return (3.0 if job.cost == "ls" else 1.0) * weight * job.task.duration * job.grid[0] * job.grid[1]


def solve(job: Job) -> dict[str, Any]:
    """Solve a job and measure it, as a process of its own does.

    The plan is made without the filter, which may overshoot a limit by some thousandths; its limits are judged as
    planned, its energy and flow as filtered.

    Args:
        job: The job.

    Returns:
        Its record.

    Raises:
        LeanboomError: If the method has no result; the text says why.
    """
    import numpy as np

    from leanboom.dynamic_programming import value_function
    from leanboom.evaluation.evaluate import evaluate
    from leanboom.methods import pseudo_inverse
    from leanboom.problem import stages

    began = time.process_time()
    task = replace(job.task, smooth=None)
    if job.method == COARSE:
        problem = stages.discretise(task, STEP)
        policy = value_function.solve(problem, grids.full_grid(problem, *job.grid), job.cost)
        found = value_function.rollout(policy, _start(task))
        first = evaluate(task, found)
    elif job.method == SIGNED:
        found = pseudo_inverse.resolve(task, _start(task), rule=weights.signed())
        first = evaluate(task, found)
    else:
        plan = comparison.plan_row(task, job.method, job.cost, grid=job.grid)
        found, first = plan.motion, plan.evaluation
    status = next(iter(first.violations), SOLVED)  # the papers know no limits of the pump
    judged = first if task.legs else evaluate(replace(task, smooth=SMOOTH), found)
    at = np.unique(np.linspace(0, judged.time.size - 1, min(POINTS, judged.time.size)).round().astype(int))
    return {
        "status": str(status),
        "energy_ls_j": judged.energy_ls,
        "energy_cp_j": judged.energy_cp,
        "flow_m3": float(np.trapezoid(judged.pump_flow, judged.time)),
        "pressure_pa": float(judged.pressure.max()),
        **_driven(judged.task, found, job.driven),
        "switched_m": _switched(judged.task, found, job.switched),
        **_by_leg(judged),
        "solve_s": float(found.solve_s),
        "cpu_s": time.process_time() - began,
        "time_s": np.round(judged.time[at], 6).tolist(),
        "stroke_m": np.round(judged.length[at, -1], 5).tolist(),
        "supply_ls_pa": np.round(judged.supply_ls[at], -3).tolist(),
    }


def _start(task: Task) -> float:
    """Where a task's motion starts [m]."""
    from leanboom.problem import stages

    start = starts.start_position(stages.discretise(task, STEP), task.start)
    assert start is not None
    return start


def _driven(task: Task, found: Motion, wanted: bool) -> dict[str, float | None]:
    """Energies and path accuracies in closed loop; None where they are not wanted or the run does not end."""
    from leanboom.simulation import closed_loop

    numbers: dict[str, float | None] = dict.fromkeys(CLOSED_LOOP)
    for pump in ("ls", "cp") if wanted else ():
        run = closed_loop.simulate(task, found, pump)
        if run.complete:
            numbers |= {f"driven_{pump}_j": run.energy, f"accuracy_{pump}_m": run.path_accuracy}
    return numbers


def _switched(task: Task, found: Motion, wanted: bool) -> dict[str, float]:
    """Path accuracies in closed loop with every switch and all of them, by switch and pump; of runs that end."""
    from leanboom.simulation import closed_loop

    accuracies = {}
    for name in (*variations.SWITCHES, variations.ALL) if wanted else ():
        for pump in ("ls", "cp"):
            run = closed_loop.simulate(variations.switched(task, name), found, pump)
            if run.complete:
                accuracies[f"{name}, {pump}"] = run.path_accuracy
    return accuracies


def _by_leg(judged: Evaluation) -> dict[str, list[float]]:
    """Times of legs, waiting before them included, and their energies; empty where the crane cannot follow."""
    shares = {pump: summaries.legs(judged, pump) for pump in ("ls", "cp")}
    found = {"leg_s": [each.dwell + each.duration for each in shares["ls"]]}
    energies = {f"leg_{pump}_j": [each.energy for each in shares[pump] if each.energy is not None] for pump in shares}
    return found | energies


def _nothing(reason: str) -> dict[str, Any]:
    """The record of a solution that failed."""
    numbers = ("energy_ls_j", "energy_cp_j", "flow_m3", "pressure_pa", *CLOSED_LOOP, "solve_s", "cpu_s")
    return {
        "status": reason,
        **dict.fromkeys(numbers),
        "switched_m": {},
        **{name: [] for name in BY_LEG},
        "time_s": [],
        "stroke_m": [],
        "supply_ls_pa": [],
    }


class _Kept(BaseModel):
    """Schema of a record: finite numbers, all of them where the solution is one, and samples of equal count."""

    model_config = ConfigDict(extra="forbid", strict=True)

    status: str
    energy_ls_j: FiniteFloat | None
    energy_cp_j: FiniteFloat | None
    flow_m3: FiniteFloat | None
    pressure_pa: FiniteFloat | None
    driven_ls_j: FiniteFloat | None
    driven_cp_j: FiniteFloat | None
    accuracy_ls_m: FiniteFloat | None
    accuracy_cp_m: FiniteFloat | None
    switched_m: dict[str, FiniteFloat]
    leg_s: list[FiniteFloat]
    leg_ls_j: list[FiniteFloat]
    leg_cp_j: list[FiniteFloat]
    solve_s: FiniteFloat | None
    cpu_s: FiniteFloat | None
    time_s: list[FiniteFloat]
    stroke_m: list[FiniteFloat]
    supply_ls_pa: list[FiniteFloat]

    @model_validator(mode="after")
    def _belongs_together(self) -> _Kept:
        numbers = (self.energy_ls_j, self.energy_cp_j, self.flow_m3, self.pressure_pa, self.solve_s, self.cpu_s)
        if None in numbers and (self.status == SOLVED or self.time_s):
            raise ValueError("a solution has all its numbers")
        if not len(self.time_s) == len(self.stroke_m) == len(self.supply_ls_pa):
            raise ValueError("samples must be equal in number")
        return self


class _Sealed(BaseModel):
    """The file of a record, with a hash that shows when its content was changed or belongs to another solution."""

    model_config = ConfigDict(extra="forbid", strict=True)

    record: _Kept
    sha256: str


def _seal(digest: str, record: Record) -> str:
    """The hash that a record is kept with."""
    text = json.dumps([digest, record], sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _keep(folder: Path, digest: str, record: Record) -> None:
    """Write a record; the file appears whole or not at all."""
    record = _Kept.model_validate(dict(record)).model_dump()
    text = json.dumps({"record": record, "sha256": _seal(digest, record)}, allow_nan=False) + "\n"
    folders.write(folder, {f"{FOLDER}/{digest}.json": text.encode()})


def _read(folder: Path, digest: str) -> Record | None:
    """A kept record; None if there is none, or it is not as it was written: then it is solved again."""
    try:
        kept = _Sealed.model_validate_json((folder / FOLDER / f"{digest}.json").read_bytes())
    except (OSError, ValueError):
        return None
    record = kept.record.model_dump()
    return record if _seal(digest, record) == kept.sha256 else None
