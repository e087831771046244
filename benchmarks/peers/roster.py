"""Who takes part: methods of leanboom, other people's as methods, and the packages that they need."""

from __future__ import annotations

from importlib.util import find_spec

from leanboom.methods.registry import METHODS, Method

SMOOTH = ("ls", "cp")  # costs
OTHERS = {
    "adaptive-mesh": Method("maptor: adaptive pseudospectral mesh", "benchmarks.peers.adaptive_mesh:plan", SMOOTH),
    "via-points": Method("CMA-ES over via-points, judged", "benchmarks.peers.via_points:plan", SMOOTH),
    "node-to-node": Method("dynamic programming over positions alone", "benchmarks.peers.node_to_node:plan", SMOOTH),
}
# Peers, and the packages that are imported before the clock runs.
PEERS: dict[str, tuple[str, ...]] = {
    "dp": (),
    "dp-paper": (),
    "pseudospectral": ("casadi",),
    "adaptive-mesh": ("casadi", "maptor"),
    "via-points": ("cma",),
    "node-to-node": (),
}
OURS = "dp"


def sentence(peer: str) -> str:
    """What a peer is."""
    return (OTHERS[peer] if peer in OTHERS else METHODS.find(peer)).sentence


def register() -> None:
    """Let the planner find other people's methods by their names."""
    for name, method in OTHERS.items():
        METHODS.add(name, method)


def absent(peer: str) -> str:
    """Why a peer cannot run here, as a sentence; empty: it can."""
    lost = [name for name in PEERS[peer] if find_spec(name) is None]
    return f"skipped: package {' and '.join(lost)} is not installed (extra `peers`)" if lost else ""
