"""Test motions that make a machine's parameters identifiable, as tasks inside its limits.

Candidates go through poses drawn from the joints' ranges, at several extensions and speeds. Each is driven by the
actuator pseudo-inverse; those that break a limit are slowed down or dropped. Of the rest a few are chosen one
after another, each so that the condition number of the base parameters, scaled by their sizes, becomes least together
with those before.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from leanboom.errors import InfeasibleError, InputError
from leanboom.evaluation.evaluate import Evaluation, evaluate
from leanboom.formulas import kinematics
from leanboom.identification import base_parameters
from leanboom.identification.base_parameters import Motion
from leanboom.model.machine import Machine
from leanboom.model.task import Lines, Task
from leanboom.planning.planner import plan
from leanboom.progress import Progress, quiet

CANDIDATES, CHOSEN = 8, 4
STAGE = 0.1  # [s], of their motions
POINTS = 5  # of a candidate's path
SPEEDS = 0.3, 0.9  # [m/s], of the tool, mean over a line
SLOWER, TRIES = 1.5, 5
EVERY = 50  # of the judge's samples, for a row
SEED = 20170506
INNER = 0.08, 0.92  # shares of the joints' ranges
GROUND = 0.3  # [m], the tool stays above


@dataclass(frozen=True, slots=True, eq=False)
class Excitation:
    """Test motions and what they are worth."""

    tasks: tuple[Task, ...]
    starts: tuple[float, ...]  # of the redundant cylinder [m]
    before: float  # condition number with an ordinary motion
    after: float  # with all test motions
    rank_before: int
    rank_after: int
    wanted: int  # base parameters

    def json(self, out: Path | None = None) -> dict[str, Any]:
        """What `--json` prints.

        Args:
            out: Where the task files are.
        """
        return {
            "condition": {"before": self.before, "after": self.after},
            "rank": {"before": self.rank_before, "after": self.rank_after, "of": self.wanted},
            "tasks": [task.name for task in self.tasks],
            "out": None if out is None else str(out),
        }


def propose(
    machine: Machine, *, chosen: int = CHOSEN, candidates: int = CANDIDATES, progress: Progress | None = None
) -> Excitation:
    """Propose test motions.

    Args:
        machine: The draft.
        chosen: How many.
        candidates: Out of how many.
        progress: Called with what happens and the share done.

    Raises:
        InputError: No candidate keeps the limits.
    """
    tell = progress or quiet
    rng = np.random.default_rng(SEED)
    found: list[tuple[Task, list[np.ndarray]]] = []
    for i in range(candidates):
        tell("trying test motions", i / candidates)
        task = _candidate(machine, rng, i)
        driven = _driven(task)
        if driven is not None:
            found.append((driven[0], _columns(machine, driven[1])))
    if not found:
        raise InputError(f"machine = {machine.name}; no test motion keeps its limits; check joints and velocity limits")
    ordinary = min(
        found,
        key=lambda pair: float(np.ptp(np.asarray(pair[0].path.values(np.array([0.0, pair[0].duration]))[0])[:, 2])),
    )
    first = [column[: column.shape[0] // (POINTS - 1)] for column in ordinary[1]]  # one line from rest to rest
    rank_before, before = base_parameters.condition(first, machine, machine.bodies)
    picked: list[int] = []
    rank_after, after = 0, np.inf
    total: Sequence[np.ndarray] = []
    for _ in range(min(chosen, len(found))):
        scores = []
        for j, (_, columns) in enumerate(found):
            if j not in picked:
                joined = _joined(total, columns)
                rank, number = base_parameters.condition(joined, machine, machine.bodies)
                scores.append((-rank, number, j))
        best = min(scores)
        if picked and best[1] >= after:
            break
        rank_after, after = -best[0], best[1]
        picked.append(best[2])
        total = _joined(total, found[best[2]][1])
    tasks = tuple(replace(found[j][0], name=f"excitation-{i + 1}") for i, j in enumerate(picked))
    return Excitation(
        tasks,
        tuple(float(task.start) for task in tasks),
        before,
        after,
        rank_before,
        rank_after,
        len(base_parameters.BASE),
    )


def files(found: Excitation, machine: str) -> dict[str, bytes]:
    """The task files by their names, and what they are worth.

    Args:
        found: The test motions.
        machine: What the tasks call the machine: a bundled name or a path.
    """
    from leanboom.io.loading import dump_task

    texts = {f"{task.name}.yaml": dump_task(task, machine) for task in found.tasks}
    return {name: text.encode() for name, text in texts.items()} | {
        "excitation.json": (json.dumps(found.json(), indent=2) + "\n").encode()
    }


def _candidate(machine: Machine, rng: np.random.Generator, i: int) -> Task:
    """A path through random poses, its extension starting in the first of them."""
    g, boom = machine.geometry, machine.joints[-3:]
    speed = SPEEDS[0] + (SPEEDS[1] - SPEEDS[0]) * float(rng.random())
    points: list[tuple[float, float, float]] = []
    start = 0.0
    while len(points) < POINTS:
        share = INNER[0] + (INNER[1] - INNER[0]) * rng.random(3)
        q2, q3, q4 = (j.lower + s * (j.upper - j.lower) for j, s in zip(boom, share, strict=True))
        r, z = kinematics.tool_point(q2, q3, q4, g.base_x, g.base_z, g.boom, g.offset, g.outer)
        turn = 0.6 * (float(rng.random()) - 0.5) if g.slewing else 0.0
        if z < GROUND or r < 1.0 + abs(g.base_x):
            continue
        if not points:
            start = float(machine.redundant.linkage.length_arm_slope(q4)[0])
        points.append((float(r * np.cos(turn)), float(r * np.sin(turn)), float(z)))
    lengths = [float(np.linalg.norm(np.subtract(b, a))) for a, b in zip(points[:-1], points[1:], strict=True)]
    path = Lines(tuple(points), tuple(max(1.0, length / speed) for length in lengths))
    return Task(f"candidate-{i + 1}", machine, path, start=start)


def _driven(task: Task) -> tuple[Task, Evaluation] | None:
    """A task slow enough for its limits, and its motion; None if no speed helps."""
    for _ in range(TRIES):
        try:
            judged = evaluate(task, plan(task, method="sns-actuator", step=STAGE, check=False))
        except (InfeasibleError, InputError):
            return None
        if judged.feasible:
            return task, judged
        assert isinstance(task.path, Lines)
        task = replace(task, path=task.path.slower(SLOWER))
    return None


def _columns(machine: Machine, judged: Evaluation) -> list[np.ndarray]:
    rows = slice(None, None, EVERY)
    motion = Motion(
        *(tuple(values[rows].T) for values in (judged.joint_position, judged.joint_velocity, judged.joint_acceleration))
    )
    return base_parameters.moment_columns(machine, machine.bodies, motion)


def _joined(first: Sequence[np.ndarray], second: Sequence[np.ndarray]) -> list[np.ndarray]:
    return [np.concatenate(pair) for pair in zip(first, second, strict=True)] if first else list(second)
