"""The timing of least energy for a given duration: speed along the path and redundancy together.

From a planned motion the joint program with the smoothed energy finds a better timing near by. What it finds is a
proposal: the planner looks for the redundancy on it again, and the judge says whether it is better.
"""

from __future__ import annotations

from dataclasses import replace

from leanboom.evaluation.evaluate import Evaluation
from leanboom.methods.smoothed_nlp import Level
from leanboom.model import crane as cranes
from leanboom.model.task import Task
from leanboom.progress import Progress, quiet
from leanboom.timing import along, courses
from leanboom.timing.program import Program
from leanboom.timing.shortest import ends_of

MOST = 120  # intervals
LEVELS = {"cp": (Level(2000.0, 1.0, 0.01),), "ls": (Level(500.0, 0.1, 0.03), Level(1000.0, 0.1, 0.01))}
OPTIONS = {"max_iter": 80}  # an answer need not be optimal: the judge measures it


def proposals(planned: Evaluation, task: Task, cost: str, stages: int, tell: Progress = quiet) -> list[Evaluation]:
    """Motions with a timing near that of a planned one, judged; their tasks have a fixed timing.

    Args:
        planned: The planned motion, of a task with a fixed timing.
        task: The task as it was asked for, for start and end.
        cost: "ls" or "cp".
        stages: Stages of the plan: a timing has as many intervals, or a whole share of them.
        tell: Called with what happens and the share done.
    """
    here = replace(task, path=planned.task.path, timing="fixed")
    shape, crane = along.shape_of(here), cranes.build(here)
    intervals = stages // -(-stages // MOST)
    course = courses.of_motion(here, shape, planned.motion, intervals)
    program = Program(here, crane, shape, cost, ends_of(here), task.flow_limit)
    found = []
    for number, level in enumerate(LEVELS[cost]):
        tell(f"timing of less energy, {level}", 0.5 + 0.1 * number)
        if len(course.counts) > 1:  # first how long each segment takes
            _, course = program.solve(course, level, here.duration, even=False, options=OPTIONS)
            course = courses.evened(course, intervals)
        _, course = program.solve(course, level, here.duration, options=OPTIONS)
        found.append(courses.judged(here, shape, course, cost, here.duration))
    return found
