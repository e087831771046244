r"""Direct multiple shooting of the full-dimensional problem: the local direct method that stands for fmincon.

Eqs. (11)-(15), 3-DOF paper, whose summed cost is eq. (16): states are positions and velocities of all joints,
controls their accelerations. Nothing is known of redundancy here; the tool stays on its path by an equality
constraint at every stage. One Runge-Kutta step a stage integrates the double integrators exactly. The states are
variables as well ("multiple" shooting), with the same solutions as when only the controls are, and sparse equations.

The path is kept in velocity form, x' = r', with the position error fed back so that it cannot drift,

    J(q) q' - r' - (r - x(q)) / t_r = 0.

The position form, eq. (14), leaves velocities undamped between the stages where accelerations are constant on them.
The tool is measured in the coordinates of the slewing crane: radius, height and base angle.

Costs are smoothed as in `collocation`, limits between the stages drawn in likewise. The start is the actuator
pseudo-inverse.

| symbol | name | unit |
| --- | --- | --- |
| q, v, u | joint positions, velocities, accelerations | rad or m, /s, /s^2 |
| x, r | tool by forward kinematics, tool on its path | m, m, rad |
| t_r | time in which a position error decays | s |
"""

from __future__ import annotations

import time
from dataclasses import dataclass

from leanboom import direct, stages
from leanboom.direct import Progress
from leanboom.errors import InputError
from leanboom.judge import evaluate
from leanboom.motion import Motion
from leanboom.task import Task

METHOD = "shooting"
STEP = 0.05  # [s]
RETURN = 0.5  # [s], t_r
REPAIRS = 4  # solves with limits drawn in where they are exceeded between the stages
DRAWN = 1.2  # limits are drawn in by this share of what they are exceeded by


@dataclass(frozen=True, slots=True)
class Sharpness:
    """One solve of a sequence: how sharply."""

    sharpness: float  # s of eq. (29) [s/m]; [1/kW] where the step is over a cylinder's power
    maximum: float  # e of eq. (36) [MPa^2]
    damping: float  # weight of the squared extension acceleration [kW s^4/m^2]


SEQUENCE = {
    "cp": (Sharpness(500.0, 1.0, 0.1), Sharpness(5000.0, 1.0, 0.01)),
    "ls": (Sharpness(500.0, 1.0, 0.1), Sharpness(1000.0, 0.1, 0.03), Sharpness(2000.0, 0.01, 0.01)),
}


def plan(task: Task, cost: str, start: float, progress: Progress | None = None) -> Motion:
    """Plan a task by direct multiple shooting in all joints, from the actuator pseudo-inverse.

    Args:
        task: The task.
        cost: "ls" or "cp".
        start: Where the redundant cylinder starts [m].
        progress: Called with what happens and the share done.

    Returns:
        The motion of the redundant cylinder: of the solves that converged, the cheapest by the judge that keeps all
        limits. Its status is `solved`; or the limit that even the best of them violates; or, if none converged, how
        IPOPT ended, and then the motion is no result. Its log has a line a solve.

    Raises:
        InputError: If the cost is another one.
        InfeasibleError: If some point of the path cannot be reached.
    """
    if cost not in SEQUENCE:
        raise InputError(f"method {METHOD} minimises {' or '.join(SEQUENCE)}, not {cost}")
    began = time.perf_counter()
    tell = progress or (lambda text, share: None)
    problem = stages.discretise(task, STEP)
    work = _prepare(problem, cost)
    values = _first_guess(problem, start)
    best, last, drawn, log = None, None, None, []
    finest = SEQUENCE[cost][-1]
    for i, sharpness in enumerate((*SEQUENCE[cost], *[finest] * REPAIRS)):
        if i >= len(SEQUENCE[cost]):
            assert last is not None
            drawn = _draw_in(problem, last, drawn)
            if drawn is None:
                break
        tell(f"s = {sharpness.sharpness:g} s/m", min(1.0, i / len(SEQUENCE[cost])))
        answer = _solve(work, sharpness, values, drawn)
        values = answer.values
        last = evaluate(task, _motion(problem, values, cost))
        log.append(
            f"{time.perf_counter() - began:6.2f} s  s = {sharpness.sharpness:g} s/m: {answer.text}, "
            f"judged {last.energy(cost) / 1e3:.4f} kJ, {last.status}"
        )
        if answer.converged and (best is None or direct.better(last, best, cost)):
            best = last
    ...
