"""Gap of the certificate against time, for bundled tasks, starts and pumps: `python -m benchmarks.certificate`.

All tasks, starts and pumps take about an hour; name some to have less.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import leanboom as lb

STARTS = ("smallest", "middle", "best")
PUMPS = ("cp", "ls")
SINGLE = tuple(name for name in lb.bundled_tasks() if not lb.load_task(name).legs)  # tasks with one path


def table(tasks: list[str], starts: list[str], pumps: list[str], seconds: float, gap: float) -> None:
    """Print one row a case: the gap of every level of cells and when it was reached."""
    print(f"{'task':<24}{'pump':<6}{'start':<10}{'best known':>12}{'at least':>12}{'gap':>8}  gap after seconds")
    for name in tasks:
        for pump in pumps:
            for start in starts:
                proof = lb.certify(replace(lb.load_task(name), start=start), pump, seconds=seconds, gap=gap)
                course = ", ".join(f"{level.gap_percent:.2f} % {level.seconds:.0f} s" for level in proof.levels)
                course += f"; {proof.processor_s:.0f} s of processor time"
                print(
                    f"{name:<24}{pump:<6}{start:<10}{proof.energy_j / 1e3:>9.3f} kJ{proof.lower_bound_j / 1e3:>9.3f} kJ"
                    f"{proof.gap_percent:>6.2f} %  {course} ({proof.reason})",
                    flush=True,
                )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tasks", nargs="*", default=SINGLE, metavar="TASK", help="by default all bundled")
    parser.add_argument("--start", action="append", choices=STARTS, help="by default all")
    parser.add_argument("--pump", action="append", choices=PUMPS, help="by default both")
    parser.add_argument("--seconds", type=float, default=120.0, help="time for each bound")
    parser.add_argument("--gap", type=float, default=0.5, help="gap [%%] at which bounding ends")
    given = parser.parse_args()
    table(list(given.tasks), given.start or list(STARTS), given.pump or list(PUMPS), given.seconds, given.gap)


if __name__ == "__main__":
    main()
