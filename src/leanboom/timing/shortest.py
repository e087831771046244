"""The least time in which a path can be followed, over its speed and all redundancy resolutions.

The joint program is solved from several motions, each the fastest one with its strokes: those of a dynamic program
without accelerations, those of the pseudo-inverse, and the least, the middle and the largest feasible ones. What the
program leaves above limits between the ends of its intervals is taken back by slowing the whole motion a little.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from leanboom.components.paths import Lines, Spline
from leanboom.errors import InfeasibleError, LeanboomError
from leanboom.evaluation.evaluate import Evaluation
from leanboom.methods import pseudo_inverse
from leanboom.methods.smoothed_nlp import USABLE_SHARE, Level
from leanboom.model import crane as cranes
from leanboom.model.task import Limits, Task
from leanboom.problem import stages, starts
from leanboom.progress import Progress, quiet
from leanboom.timing import along, courses, seeds
from leanboom.timing.courses import Course
from leanboom.timing.program import Ends, Program
from leanboom.timing.time_optimal import LEAST_TIME

INTERVALS = 200  # of the motion
COARSER = 3  # times as few are enough to tell which motion to begin from
POINTS, LEAST_POINTS = 160, 40  # of the path, in seeds; between two corners
SLOWLY = 6.0  # times the quickest way in which the pseudo-inverse follows the path
DAMPING = Level(1.0, 1.0, 1e-3)
NEARLY = 1.005  # times the coarse duration that is no reason to refine another motion


def plan(task: Task, cost: str, tell: Progress = quiet, intervals: int = INTERVALS) -> Evaluation:
    """The fastest motion found, judged; its task has a fixed timing and the pump's flow as a limit.

    Args:
        task: The task; its own timing does not matter.
        cost: What else is minimised, for the record.
        tell: Called with what happens and the share done.
        intervals: Intervals of the motion.

    Raises:
        InfeasibleError: If the path cannot be reached, or no motion was found.
        InputError: If the path has no timing that can be planned.
    """
    task = replace(task, timing="fixed", limits=Limits(pump_flow=True))
    crane, flow, ends = cranes.build(task), task.machine.pump.max_flow, ends_of(task)
    tell("shortest time, without accelerations", 0.0)
    points = _points(along.shape_of(task))
    stroke, reached = seeds.quickest(task, crane, along.shape_of(task), points, ends, flow)
    shape = _brisk(along.shape_of(task), points, reached)
    task = replace(task, path=shape)
    program = Program(task, crane, shape, "time", ends, flow)
    coarse = []
    found = _seeds(task, crane, shape, ends, stroke)
    for number, (name, strokes) in enumerate(found.items()):
        tell(f"shortest time, from {name}", 0.1 + 0.5 * number / len(found))
        begun = courses.of_strokes(task, crane, shape, _points(shape), strokes, intervals // COARSER)
        course = _solved(program, begun)
        if course is not None:
            coarse.append(course)
    coarse.sort(key=lambda each: each.time[-1])
    best: Evaluation | None = None
    for course in coarse:
        tell("shortest time, on shorter intervals", 0.7)
        fine = _solved(program, courses.evened(course, intervals))
        judged = None if fine is None else _within_limits(courses.judged(task, shape, fine, cost))
        if judged is not None and (best is None or judged.task.duration < best.task.duration):
            best = judged
        if best is not None and best.task.duration < NEARLY * course.time[-1]:
            break
    if best is None:
        raise InfeasibleError("no motion along the path was found that keeps all limits, however slow")
    return best


def ends_of(task: Task) -> Ends:
    """Where the redundant cylinder may start and end."""
    problem = stages.discretise(task, 0.5 * task.duration)
    start = starts.start_position(problem, task.start)
    end = starts.end_position(problem, start)
    (first, last) = problem.intervals[0], problem.intervals[-1]
    return Ends(
        (float(first[0, 0]), float(first[-1, 1])) if start is None else (start, start),
        (float(last[0, 0]), float(last[-1, 1])) if end is None else (end, end),
        task.end == "same" and start is None,
    )


def _points(shape: Lines | Spline) -> np.ndarray:
    """Own times of a seed's points [s], corners among them and as many in each segment."""
    edges = courses.corners(shape)
    counts = (max(LEAST_POINTS, POINTS // (edges.size - 1)),) * (edges.size - 1)
    return courses.ticks(edges, counts)


def _brisk(shape: Lines | Spline, points: np.ndarray, reached: np.ndarray) -> Lines | Spline:
    """A shape whose own timing is about as fast as can be: then rates are about 1 in every segment.

    Args:
        shape: The shape.
        points: Own times [s], (points,).
        reached: When they are reached the quickest way [s], (points,).
    """
    if isinstance(shape, Spline):
        return shape.slower(max(reached[-1], LEAST_TIME) / shape.duration)
    lasting = np.maximum(np.diff(np.interp(shape.breaks, points, reached)), LEAST_TIME)
    return Lines(shape.points, tuple(lasting.tolist()))


def _seeds(
    task: Task, crane: cranes.Crane, shape: Lines | Spline, ends: Ends, quickest: np.ndarray
) -> dict[str, np.ndarray]:
    """Strokes at the points of a path to begin from [m], (points,), by what they are."""
    tau = _points(shape)
    grid, _ = seeds.strokes(task, crane, shape, tau, ends)
    found = {"the quickest strokes": quickest}
    slow = replace(task, path=shape.slower(SLOWLY))
    try:
        held = pseudo_inverse.resolve(slow, float(np.mean(ends.start)))
        found["the pseudo-inverse"] = along.strokes(slow, held, SLOWLY * tau)
    except LeanboomError:  # it finds no way; the others may
        pass
    return found | {
        "the least strokes": grid[:, 0], "middle strokes": grid.mean(axis=1), "the largest strokes": grid[:, -1]
    }  # fmt: skip


def _solved(program: Program, course: Course) -> Course | None:
    """The fastest course found from another one, all intervals equally long; None where the program has none."""
    if len(course.counts) > 1:  # first how long each segment takes
        answer, found = program.solve(course, DAMPING, even=False)
        if not answer.converged:
            return None
        course = courses.evened(found, course.time.size - 1)
    answer, course = program.solve(course, DAMPING)
    return course if answer.converged else None


def _within_limits(found: Evaluation) -> Evaluation | None:
    """A motion, slowed until it keeps its limits between the ends of its intervals; None where that does not help."""
    use = found.limit_use
    shares = use.velocity / USABLE_SHARE, (use.acceleration / USABLE_SHARE) ** 0.5, use.flow / USABLE_SHARE
    factor = max(1.0, *shares)
    found = courses.slowed(found, factor) if factor > 1.0 else found
    return found if found.feasible else None
