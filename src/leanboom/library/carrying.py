"""Stored motions led to tasks that are not stored: another way near by, or a start too far from the stored ones."""

from __future__ import annotations

from dataclasses import dataclass, replace

from leanboom.errors import LeanboomError
from leanboom.evaluation.evaluate import Evaluation, evaluate
from leanboom.library import specification
from leanboom.library.lookup import Answer, Library, task_of
from leanboom.library.warm_starts import COARSE, WARM, Known, carried_over
from leanboom.methods.dp_refined import Search
from leanboom.methods.registry import STEP
from leanboom.model.task import Task
from leanboom.planning.planner import Plan, run
from leanboom.problem import stages, starts


@dataclass(frozen=True, slots=True, eq=False)
class Offer:
    """A judged answer to a query: the stored motion, or what became of it on its way to the task asked for."""

    answer: Answer
    evaluation: Evaluation
    polished: bool  # whether it was planned again around the stored motion
    fresh: Plan | None  # of the same task, to compare with

    @property
    def energy_j(self) -> float:
        """Energy of the pump it is planned for [J]."""
        return self.evaluation.energy(self.answer.entry.pump)

    @property
    def solved(self) -> bool:
        """Whether it keeps every limit and the pump can deliver it."""
        return self.evaluation.status_with(self.answer.entry.pump).solved

    @property
    def more_than_fresh(self) -> float | None:
        """Share by which it takes more energy than a fresh plan; None where there is none."""
        if self.fresh is None or not self.fresh.solved:
            return None
        return self.energy_j / self.fresh.evaluation.energy(self.answer.entry.pump) - 1.0


def offer(library: Library, answer: Answer, origin: tuple, goal: tuple, *, fresh: bool = True) -> Offer:
    """Judge an answer for the ends that were asked for; where it does not fit them, lead it there.

    Args:
        library: The library.
        answer: Its answer.
        origin, goal: The ends that were asked for [m].
        fresh: Whether to plan the task anew beside, where the stored motion had to be led to it.

    Returns:
        The judged motion of the task asked for.
    """
    pump = answer.entry.pump
    if answer.stored:
        judged = library.judged(answer)
        if judged.status_with(pump).solved:
            return Offer(answer, judged, False, None)
    task = library.task(answer)
    if not answer.stored:
        path = specification.shape_of(answer.entry.shape).path(tuple(origin), tuple(goal), answer.entry.duration)
        task = replace(task, name="asked", path=path)
    judged = polished(task, pump, library, answer)
    return Offer(answer, judged, True, run(task, pump=pump, baseline=False, check=False) if fresh else None)


def polished(task: Task, pump: str, library: Library, answer: Answer) -> Evaluation:
    """The best motion around a stored one that was led to another task.

    Args:
        task: The other task.
        pump: "ls" or "cp".
        library: The library.
        answer: The stored motion.
    """
    stored = Known(task_of(answer.entry, library.machine()), library.store.motion(answer.entry))
    search = Search(task, pump, COARSE, STEP, WARM)
    problem = stages.discretise(task, search.step)
    start = starts.start_position(problem, task.start)
    return search.around(problem, [carried_over(stored, problem, start)], start, problem.pace)


@dataclass(frozen=True, slots=True)
class Checked:
    """What a second look at stored motions found."""

    checked: int
    wrong: tuple[str, ...]  # keys of motions that the judge sees otherwise than the index
    damaged: tuple[str, ...]  # files that are not as they were written


def verify(library: Library, sample: int | None = None, seed: int = 0) -> Checked:
    """Judge stored motions again.

    Args:
        library: The library.
        sample: How many of them, at random; None: all.
        seed: Of the choice.
    """
    import numpy as np

    entries = library.store.entries("segment NOTNULL ORDER BY key")
    damaged = library.store.damaged()
    if sample is not None and sample < len(entries):
        chosen = np.random.default_rng(seed).choice(len(entries), sample, replace=False)
        entries = [entries[k] for k in sorted(chosen)]
    machine, wrong = library.machine(), []
    for entry in entries:
        try:
            judged = evaluate(task_of(entry, machine), library.store.motion(entry))
        except LeanboomError:
            wrong.append(entry.key)
            continue
        energy = judged.energy(entry.pump)
        if not judged.status_with(entry.pump).solved or abs(energy - (entry.energy_j or 0.0)) > 1e-6 * energy:
            wrong.append(entry.key)
    return Checked(len(entries), tuple(wrong), tuple(str(number) for number in damaged))
