"""What planning the timing of a path is worth: every bundled task with its own timing, a free one, and the shortest.

python -m benchmarks.timing [TASK...] prints the tables of docs/timing.md, a row as soon as it is known.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import leanboom as lb
from leanboom.components.costs import PUMPS
from leanboom.io.loading import bundled_tasks


def row(*cells: object) -> None:
    print("|", " | ".join(map(str, cells)), "|", flush=True)


def kilojoules(plan: lb.Plan) -> str:
    return f"{1e-3 * plan.evaluation.energy(plan.pump):.2f}"


def shortest(names: list[str]) -> None:
    row(
        "task",
        "own timing, s",
        "shortest, s",
        "LS, kJ",
        "CP, kJ",
        "velocity",
        "acceleration",
        "pump flow",
        "found in, s",
    )
    row(*["---"] * 9)
    for name in names:
        task = lb.load_task(name)
        plan = lb.run(replace(task, timing="shortest"), baseline=False)
        assert plan.solved, plan.status
        judged, use = plan.evaluation, plan.evaluation.limit_use
        shares = (f"{100.0 * share:.1f} %" for share in (use.velocity, use.acceleration, use.flow))
        energies = (f"{1e-3 * energy:.2f}" for energy in (judged.energy_ls, judged.energy_cp))
        row(name, f"{task.duration:g}", f"{plan.task.duration:.3f}", *energies, *shares, f"{plan.motion.solve_s:.0f}")


def free(names: list[str]) -> None:
    row("task", "pump", "own timing, kJ", "free, kJ", "saved", "found in, s")
    row(*["---"] * 6)
    for name in names:
        for pump in PUMPS:
            task = lb.load_task(name)
            fixed = lb.run(task, pump=pump, baseline=False)
            plan = lb.run(replace(task, timing="free"), pump=pump, baseline=False)
            assert plan.solved and plan.evaluation.energy(pump) <= fixed.evaluation.energy(pump)
            saved = 1.0 - plan.evaluation.energy(pump) / fixed.evaluation.energy(pump)
            seconds = f"{plan.motion.solve_s:.0f}"
            row(name, pump.upper(), kilojoules(fixed), kilojoules(plan), f"{100.0 * saved:.1f} %", seconds)


if __name__ == "__main__":
    chosen = sys.argv[1:] or list(bundled_tasks())
    shortest(chosen)
    print()
    free(chosen)
