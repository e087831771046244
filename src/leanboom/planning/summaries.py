"""A plan's numbers in SI units, as `summary.json` and `--json` have them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from leanboom.evaluation.evaluate import Evaluation
    from leanboom.planning.planner import Plan


KEYS = (
    "task",
    "machine",
    "pump",
    "cost",
    "method",
    "start_m",
    "end_m",
    "status",
    "duration_s",
    "energy_j",
    "energy_ls_j",
    "energy_cp_j",
    "legs",
    "limit_use",
    "path_error_m",
    "solve_s",
    "peak_memory_bytes",
    "out",
)


def summary(plan: Plan, out: Path | None = None) -> dict[str, Any]:
    """A plan's numbers in SI units, as `summary.json` and `--json` have them.

    The energies of a motion that the crane cannot follow are None.

    Args:
        plan: The plan.
        out: Its run folder, if it has one.
    """
    judged = plan.evaluation
    use = judged.limit_use
    values = {
        "task": plan.task.name,
        "machine": plan.task.machine.name,
        "pump": plan.pump,
        "cost": plan.motion.cost,
        "method": plan.motion.method,
        "start_m": _finite(plan.motion.position[0]),
        "end_m": _finite(plan.motion.position[-1]),
        "status": plan.status,
        "duration_s": _finite(plan.task.duration),
        "energy_j": judged.energy(plan.pump) if judged.followed else None,
        "energy_ls_j": judged.energy_ls if judged.followed else None,
        "energy_cp_j": judged.energy_cp if judged.followed else None,
        "legs": [leg.json() for leg in legs(judged, plan.pump)],
        "limit_use": {
            "position": _finite(use.position),
            "velocity": _finite(use.velocity),
            "acceleration": _finite(use.acceleration),
            "flow": _finite(use.flow),
        },
        "path_error_m": _finite(judged.path_error),
        "solve_s": _finite(plan.motion.solve_s),
        "peak_memory_bytes": plan.peak_memory_bytes,
        "out": None if out is None else str(out),
    }
    return {key: values[key] for key in KEYS}


@dataclass(frozen=True, slots=True)
class LegShare:
    """A leg's part of a judged motion; a task without legs is one of them."""

    payload: float  # [kg]
    dwell: float  # [s]
    duration: float  # of the path, waiting not counted [s]
    energy: float | None  # of the leg and the waiting before it [J]; None where the crane cannot follow the motion

    def json(self) -> dict[str, float | None]:
        """The same as `--json` prints it."""
        return {
            "duration_s": self.duration, "dwell_s": self.dwell, "energy_j": self.energy, "payload_kg": self.payload,
        }  # fmt: skip


def legs(judged: Evaluation, pump: str) -> tuple[LegShare, ...]:
    """The legs of a judged motion; their energies sum to that of the whole.

    Args:
        judged: The motion.
        pump: "ls" or "cp".
    """
    task = judged.task
    if not task.legs:
        return (LegShare(task.payload, 0.0, task.duration, judged.energy(pump) if judged.followed else None),)
    moving = [each for each in task.stretches if not each.waits]
    return tuple(
        LegShare(
            leg.payload, leg.dwell, each.until - each.since,
            judged.spent(pump, each.since - leg.dwell, each.until) if judged.followed else None,
        )
        for leg, each in zip(task.legs, moving, strict=True)
    )  # fmt: skip


def waiting(judged: Evaluation, pump: str) -> str:
    """Sentence on what the pump takes while the crane waits between legs.

    Args:
        judged: The motion of a task with legs.
        pump: "ls" or "cp".
    """
    waits = [each for each in judged.task.stretches if each.waits]
    spent = sum(judged.spent(pump, each.since, each.until) for each in waits)
    lasts = sum(each.until - each.since for each in waits)
    why = "the losses of its efficiency map at rest" if spent else "since a constant efficiency has no losses at rest"
    return f"The crane waits {lasts:g} s, and no oil flows: the pump takes {spent / 1e3:.2f} kJ then, {why}."


def _finite(value: Any) -> float | None:
    number = float(value)
    return number if math.isfinite(number) else None
