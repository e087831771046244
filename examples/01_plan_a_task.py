"""Plan a bundled task, print what it saves, and write its run folder.

Usage: python 01_plan_a_task.py [FOLDER]. Without a folder a temporary one is used.
"""

import sys
import tempfile
from pathlib import Path

import leanboom as lb
from leanboom.report import run_folder

GRID, STEP = (61, 41), 0.1  # coarser than the defaults: quicker


def main():
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp(prefix="leanboom-"))
    task = lb.load_task("forwarder-vertical")
    print(f"{task.name}: {task.duration:g} s with the {task.machine.name}")

    plan = lb.run(task, pump="ls", grid=GRID, step=STEP)
    mine, today = plan.evaluation, plan.baseline
    print(f"planned: {mine.energy_ls / 1e3:.2f} kJ, pseudo-inverse: {today.energy_ls / 1e3:.2f} kJ (LS pump)")
    print(f"saved: {plan.saving():.0%}; status: {plan.status}")
    use = mine.limit_use
    print(f"limits used: position {use.position:.0%}, velocity {use.velocity:.0%}, acceleration {use.acceleration:.0%}")

    print("how it came about:")
    for line in plan.motion.log:
        print("   ", line)

    out = run_folder.write(plan, folder / "run", GRID)
    print("written:", ", ".join(sorted(path.name for path in out.iterdir())))


if __name__ == "__main__":
    main()
