"""Peers side by side: `python -m benchmarks.peers [--tasks ...] [--starts ...] [--pump ...] [--peers ...] [--limit S]`.

A table for each task, start and pump. Every peer runs in a process of its own, on one thread, one after the other, and
is stopped after a limit of processor time, which other programs disturb little. What each peer is, and the tables of a
run, are in docs/peers.md.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.peers.roster import PEERS, absent, sentence
from benchmarks.peers.table import Measured, lines

TASKS = ("forwarder-vertical", "loader-triangle-large")
STARTS = ("smallest", "middle")
LIMIT = 300  # [s] of the processor
ONE_THREAD = dict.fromkeys(("LEANBOOM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def run(task: str, start: str, pump: str, peer: str, limit: int) -> Measured:
    """Measure a peer in a process of its own.

    Args:
        task: A bundled task, or a file.
        start: Where the redundant cylinder starts: smallest, middle or a length [m].
        pump: "ls" or "cp".
        peer: A name of `PEERS`.
        limit: Processor time after which it is stopped [s].
    """
    missing = absent(peer)
    if missing:
        return Measured(peer, remark=missing)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "measured.json"
        command = [sys.executable, "-m", "benchmarks.peers.child", task, start, pump, peer, str(limit), str(file)]
        share, last = 0.0, ""
        with subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env={**os.environ, **ONE_THREAD}
        ) as child:
            assert child.stderr is not None
            for line in child.stderr:
                if line.startswith("progress "):
                    share = float(line.split()[1])
                    show(f"{task}, {start}, {pump}: {peer} {share:4.0%}")
                elif line.strip():
                    last = line.strip()
        show("")
        if file.exists():
            return Measured(**json.loads(file.read_text(encoding="utf-8")))
        if child.returncode == -signal.SIGXCPU:
            return Measured(peer, remark=f"stopped after {limit} s, {share:.0%} done")
        return Measured(peer, remark=f"failed: {last}")


def show(text: str) -> None:
    """Progress, on a terminal only."""
    if sys.stderr.isatty():
        print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)


def chosen(text: str, known: tuple[str, ...]) -> list[str]:
    """Names separated by commas."""
    names = text.split(",")
    unknown = [name for name in names if name not in known]
    if unknown:
        raise argparse.ArgumentTypeError(f"{', '.join(unknown)}; must be of {', '.join(known)}")
    return names


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", type=lambda text: text.split(","), default=list(TASKS), help="bundled, or files")
    parser.add_argument("--starts", type=lambda text: text.split(","), default=list(STARTS), help="or lengths in m")
    parser.add_argument("--pump", type=lambda text: chosen(text, ("ls", "cp")), default=["ls", "cp"])
    parser.add_argument("--peers", type=lambda text: chosen(text, tuple(PEERS)), default=list(PEERS))
    parser.add_argument("--limit", type=int, default=LIMIT, help="processor time of one peer [s]")
    arguments = parser.parse_args()
    print("\n".join(f"{name}: {sentence(name)}" for name in arguments.peers))
    print(f"each on one thread, stopped after {arguments.limit} s of the processor; (!): breaks a limit")
    for task in arguments.tasks:
        for start in arguments.starts:
            for pump in arguments.pump:
                rows = [run(task, start, pump, peer, arguments.limit) for peer in arguments.peers]
                print("\n".join(["", f"{task}, start {start}, {pump}", "", *lines(rows)]), flush=True)


if __name__ == "__main__":
    main()
