"""Continuation of a task from a state under way: a motion of the rest, or the safest stop.

A stop keeps the tool on its path, where the way is known to be free: path speed and redundant cylinder slow down
evenly, so every cylinder slows down with them, and the shortest such stop that keeps every limit is taken. The
redundant cylinder may stop earlier than the tool, which helps where it nears an end. If no stop keeps every limit,
for instance because the state itself already breaks one, the stop that breaks them least is taken.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from leanboom.evaluation import ranking
from leanboom.evaluation.evaluate import Evaluation, evaluate
from leanboom.model import legs, motion
from leanboom.model.motion import Motion
from leanboom.model.outcome import Kind, Outcome
from leanboom.model.task import Braking, Part, Task

STOPS = tuple(0.1 * 1.25**n for n in range(18))  # how long a stop may take [s]: 0.1 to 4.4
SOONER = (1.0, 0.5, 0.25)  # when the redundant cylinder stands, relative to the tool
STOP_STEPS = 8  # stages of a stop


@dataclass(frozen=True, slots=True, eq=False)
class Continuation:
    """A motion from a state on the way to the end of its task, judged; or a stop."""

    task: Task  # the rest of the task on a clock that begins at `since`; for a stop, the path it brakes on
    since: float  # when it begins on the whole task's clock [s]
    motion: Motion  # on the rest's clock
    evaluation: Evaluation  # what the judge says of it
    stopping: bool  # whether it is the safest stop, because no feasible motion was found

    @property
    def status(self) -> Outcome:
        """`solved`; or why the crane stops, and which limit even the stop breaks; or what the pump cannot deliver."""
        return self.motion.status if self.stopping else self.evaluation.status

    @property
    def solved(self) -> bool:
        """Whether it reaches the end of the task, keeps every limit, and the pump can deliver it."""
        return self.status.solved

    def at(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position [m], velocity [m/s] and acceleration [m/s^2] at times of the whole task [s]; held outside."""
        return self.motion.at(np.asarray(time, dtype=np.float64) - self.since)

    def __repr__(self) -> str:
        text = f"Continuation({self.task.name} from {self.since:g} s: {self.motion.duration:g} s, {self.status})"
        return self.status.head(text)


def rest(task: Task, since: float) -> Task:
    """The rest of a task after a time [s], its own time from 0; with legs, of the one under way and those to come."""
    if task.legs:
        return replace(task, legs=legs.rest(task.legs, since), start="middle", smooth=None)
    return replace(task, path=Part(task.path, since, task.duration), start="middle", smooth=None)


def resume(task: Task, since: float, found: Motion) -> Continuation:
    """Judge a motion of the rest of a task; the safest stop in its place where it breaks a limit.

    Args:
        task: The whole task.
        since: When the motion begins [s].
        found: The motion, on a clock that begins then.

    Returns:
        The motion, or the safest stop.
    """
    left = rest(task, since)
    judged = evaluate(left, found)
    if judged.feasible:
        return Continuation(left, since, found, judged, stopping=False)
    return safest_stop(task, since, float(found.position[0]), float(found.velocity[0]), judged.status)


def safest_stop(task: Task, since: float, position: float, velocity: float, why: str) -> Continuation:
    """The shortest stop on the path that keeps every limit; where none does, the one that breaks them least.

    Args:
        task: The whole task.
        since: When to begin [s].
        position, velocity: State of the redundant cylinder then [m], [m/s].
        why: Why the crane stops, for the status.

    Returns:
        The stop: its motion and the braking path it belongs to.
    """
    best: Evaluation | None = None
    for lasts in STOPS:
        braking = replace(task, path=Braking(task.path, since, lasts), start="middle", smooth=None)
        for share in SOONER:
            judged = evaluate(braking, _slow_down(position, velocity, lasts, share))
            if best is None or ranking.risk(judged) < ranking.risk(best):
                best = judged
        assert best is not None
        if best.feasible:
            break
    assert best is not None
    status = f"no feasible motion: {why}; the crane stops within {best.task.duration:.2f} s"
    if not best.feasible:
        status += f", and even that breaks a limit: {best.status}"
    stop = replace(best.motion, status=Outcome(Kind.STOPPED, status))
    return Continuation(best.task, since, stop, replace(best, motion=stop), stopping=True)


def _slow_down(position: float, velocity: float, lasts: float, share: float) -> Motion:
    """The redundant cylinder at rest after a share of a stop, evenly."""
    shares = np.linspace(0.0, 1.0, STOP_STEPS + 1)
    speed = velocity * np.maximum(0.0, 1.0 - shares / share)
    return motion.from_velocities(lasts / STOP_STEPS, position, speed, "stop", "none")
