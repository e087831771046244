"""Where the extension starts decides much of the energy: smallest, middle, best, and a length of your own."""

from dataclasses import replace

import leanboom as lb

STEP, EFFORT = 0.1, "quick"  # both quicker than the defaults


def main():
    task = lb.load_task("forwarder-vertical")
    print(f"{task.name}, load-sensing pump")
    print(f"{'start':>10} {'from [m]':>9} {'to [m]':>7} {'LS [kJ]':>8} {'pseudo-inverse [kJ]':>20}")
    found = {}
    for start in ("smallest", "middle", 0.8, "best"):
        plan = lb.run(replace(task, start=start), pump="ls", step=STEP, effort=EFFORT)
        found[start] = plan.evaluation.energy_ls
        path = plan.motion.position
        print(
            f"{start:>10} {path[0]:9.3f} {path[-1]:7.3f} {found[start] / 1e3:8.2f} "
            f"{plan.baseline.energy_ls / 1e3:20.2f}"
        )
    # The pseudo-inverse of the last row starts where the plan found its best start.
    print(f"the best start saves {1 - found['best'] / found['smallest']:.0%} against the smallest")
    print("what it takes to bring the extension there beforehand is not counted")


if __name__ == "__main__":
    main()
