"""Who takes part: each peer's name, what it is, the packages it needs, and how it plans a task."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec

from leanboom.model.motion import Motion
from leanboom.model.task import Task
from leanboom.planning import planner

Progress = Callable[[str, float], None]
Solve = Callable[[Task, str, float, Progress], Motion]  # task, pump, start [m], progress


@dataclass(frozen=True, slots=True)
class Peer:
    """A way to plan a task."""

    what: str
    solve: Solve
    needs: tuple[str, ...] = ()  # packages to import, before the clock runs


def planned_by(method: str) -> Solve:
    """A method of `leanboom.planning.planner`."""

    def solve(task: Task, pump: str, start: float, tell: Progress) -> Motion:
        return planner.run(task, pump=pump, method=method, baseline=False, check=False, progress=tell).motion

    return solve


def module(name: str) -> Solve:
    """The `plan` of a module of this package, imported when it is used."""

    def solve(task: Task, pump: str, start: float, tell: Progress) -> Motion:
        return importlib.import_module(f"benchmarks.peers.{name}").plan(task, pump, start, tell)

    return solve


PEERS = {
    "dp": Peer("leanboom: dynamic programming, tubes, polish", planned_by("dp")),
    "dp-paper": Peer("Algorithm 1 of the 4-DOF paper to the letter", planned_by("dp-paper")),
    "pseudospectral": Peer("CasADi + IPOPT collocation, bootstrapped", planned_by("pseudospectral"), ("casadi",)),
    "adaptive-mesh": Peer("maptor: adaptive pseudospectral mesh", module("adaptive_mesh"), ("casadi", "maptor")),
    "via-points": Peer("CMA-ES over via-points, judged", module("via_points"), ("cma",)),
    "node-to-node": Peer("dynamic programming over positions alone", module("node_to_node")),
}
OURS = "dp"


def absent(peer: str) -> str:
    """Why a peer cannot run here, as a sentence; empty: it can."""
    lost = [name for name in PEERS[peer].needs if find_spec(name) is None]
    return f"skipped: package {' and '.join(lost)} is not installed (extra `peers`)" if lost else ""
