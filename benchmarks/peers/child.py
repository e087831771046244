"""One peer on one task in a process of its own: `python -m benchmarks.peers.child TASK START PUMP PEER LIMIT FILE`.

Writes a `Measured` as JSON to the file, and lines `progress SHARE TEXT` to standard error. The time is that of the
processor from the loaded task to the judged motion; imports and the loading of compiled kernels come before it.
"""

from __future__ import annotations

import importlib
import json
import resource
import sys
import time
from dataclasses import asdict
from pathlib import Path

import leanboom as lb
from benchmarks.peers.roster import PEERS, register
from benchmarks.peers.table import Measured
from leanboom import resources
from leanboom.dynamic_programming import value_function
from leanboom.methods.registry import METHODS
from leanboom.planning import planner


def tell(text: str, share: float) -> None:
    print(f"progress {share:.3f} {text}", file=sys.stderr, flush=True)


def measure(name: str, start: str, pump: str, peer: str) -> Measured:
    """Plan a task by a peer and judge the motion; a peer that finds none says why."""
    task = lb.load_task(name, start=start)
    for package in PEERS[peer]:
        importlib.import_module(package)
    register()
    value_function.prepare()
    METHODS.find(peer).warm_up()
    began = time.process_time()
    try:
        plan = planner.run(task, pump=pump, method=peer, baseline=False, check=False, progress=tell)
    except lb.LeanboomError as error:
        return Measured(peer, time.process_time() - began, resources.peak_memory(), remark=str(error))
    seconds, memory = time.process_time() - began, resources.peak_memory()
    judged, log = plan.evaluation, plan.motion.log
    remark = "; ".join([judged.status, *(log if len(log) == 1 else ())])
    return Measured(peer, seconds, memory, judged.energy(pump), judged.worst_use, judged.feasible, remark)


def main() -> None:
    name, start, pump, peer, limit, file = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_CPU, (int(limit), resource.RLIM_INFINITY))  # SIGXCPU ends the process
    Path(file).write_text(json.dumps(asdict(measure(name, start, pump, peer))), encoding="utf-8")


if __name__ == "__main__":
    main()
