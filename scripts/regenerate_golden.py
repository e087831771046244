"""Measure the golden numbers of tests/golden again: `python scripts/regenerate_golden.py`.

One file a bundled machine: what a coarse dynamic program and the actuator pseudo-inverse cost on one of its tasks.
Run it only after a change that is meant to move these numbers, and say in the change log why they moved.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from leanboom.dynamic_programming import grids, value_function
from leanboom.evaluation.evaluate import Evaluation, evaluate
from leanboom.io.loading import bundled_machines, load_task
from leanboom.methods import pseudo_inverse
from leanboom.problem import stages, starts

FOLDER = Path(__file__).resolve().parents[1] / "tests" / "golden"
TASKS = {"forwarder": "forwarder-half-cycle", "loader": "loader-triangle-small"}
GRID, STEP = (61, 41), 0.1  # nodes, [s]
TOLERANCE = 5e-3
REASON = "rounding differs between processors, and a tie that tips changes a coarse grid's motion by some tenths of 1 %"


def numbers(evaluation: Evaluation) -> dict[str, float]:
    """What is kept of a judged motion."""
    return {
        "energy_ls_j": evaluation.energy_ls,
        "energy_cp_j": evaluation.energy_cp,
        "end_m": float(evaluation.motion.position[-1]),
        "position_use": evaluation.limit_use.position,
    }


def measure(machine: str) -> dict:
    """The golden numbers of a bundled machine."""
    task = replace(load_task(TASKS[machine]), start="middle")
    problem = stages.discretise(task, STEP)
    start = starts.start_position(problem, task.start)
    assert start is not None
    found = {}
    for cost in ("ls", "cp"):
        policy = value_function.solve(problem, grids.full_grid(problem, *GRID), cost)
        found[f"dp-{cost}"] = numbers(evaluate(task, value_function.rollout(policy, start)))
    found["sns-actuator"] = numbers(evaluate(task, pseudo_inverse.resolve(task, start)))
    return {
        "task": task.name,
        "start": task.start,
        "grid": list(GRID),
        "step_s": STEP,
        "tolerance": TOLERANCE,
        "reason": REASON,
        "numbers": found,
    }


def main() -> None:
    """Write one file a machine."""
    FOLDER.mkdir(exist_ok=True)
    for machine in bundled_machines():
        text = json.dumps(measure(machine), indent=2) + "\n"
        (FOLDER / f"{machine}.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
