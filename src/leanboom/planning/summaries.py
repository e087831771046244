"""A plan's numbers in SI units, as `summary.json` and `--json` have them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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


def _finite(value: Any) -> float | None:
    number = float(value)
    return number if math.isfinite(number) else None
