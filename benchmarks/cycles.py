"""What planning a whole cycle is worth: the bundled cycles planned whole, leg after leg, and by the pseudo-inverse.

python -m benchmarks.cycles prints the table of docs/choosing.md, every leg in its written time, a row as soon as it is
known, with the processor time of both ways of planning. Leg after leg means: the first leg from its best start, every
other one from where the one before ends, the last one back to that start.
"""

from __future__ import annotations

import time
from dataclasses import replace

import leanboom as lb
from leanboom.components.costs import PUMPS
from leanboom.planning import leg_search

CYCLES = ("forwarder-cycle", "loader-cycle")


def leg_after_leg(task: lb.Task, pump: str) -> float:
    """Energy of the legs planned one after another [J]."""
    legs = [each for each in task.stretches if not each.waits]
    ends: list[float] = []
    total = 0.0
    for leg in legs:
        end = ends[0] if leg is legs[-1] else "free"
        plan = lb.run(task.stretch(leg, ends[-1] if ends else task.start, end), pump=pump, baseline=False)
        assert plan.solved, plan.status
        total += plan.evaluation.energy(pump)
        ends += [float(plan.motion.position[i]) for i in ((-1,) if ends else (0, -1))]
    return total


def main() -> None:
    print("| task | pump | cycle, kJ | leg after leg, kJ | pseudo-inverse, kJ | processor time, s | leg after leg, s |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for name in CYCLES:
        task = lb.load_task(name)
        task = replace(task, legs=tuple(replace(leg, duration=None) for leg in task.legs))
        for pump in PUMPS:
            began = time.process_time()
            plan = lb.run(task, pump=pump, baseline=False)
            whole = time.process_time() - began
            assert plan.solved, plan.status
            began = time.process_time()
            greedy = leg_after_leg(task, pump)
            parts = time.process_time() - began
            other = leg_search.baseline(task, float(plan.motion.position[0]))
            assert other is not None
            broken = "" if other.feasible else " (breaks a limit)"
            energies = (
                f"{1e-3 * plan.evaluation.energy(pump):.1f} | {1e-3 * greedy:.1f} | {1e-3 * other.energy(pump):.1f}"
            )
            print(f"| {name} | {pump.upper()} | {energies}{broken} | {whole:.0f} | {parts:.0f} |", flush=True)


if __name__ == "__main__":
    main()
