"""The 4-DOF paper's proposal for whole loading cycles: the loading half in the shortest time, the return for energy.

The bundled cycles are planned whole, with the loading leg in its written time and in the shortest; beside them the
pseudo-inverse from the smallest extension, which ends where it ends.
"""

from __future__ import annotations

from dataclasses import replace

from leanboom.components.costs import PUMPS
from leanboom.io import loading
from leanboom.methods import registry
from leanboom.model.outcome import SOLVED
from leanboom.model.task import Task
from leanboom.study.papers.jobs import Job, Line, Record, Records

FORWARDER, LOADER = "forwarder-cycle", "loader-cycle"
FASTEST, WRITTEN = "loading in the shortest time", "loading in its written time"
POINTWISE = "pseudo-inverse"


def _written(task: Task) -> Task:
    """A cycle with all legs in their written times."""
    return replace(task, legs=tuple(replace(leg, duration=None) for leg in task.legs))


def jobs() -> dict[str, Job]:
    """The cycles of both cranes, by crane, timing and pump, and the pseudo-inverse of the written times."""
    forwarder, loader = loading.load_task(FORWARDER), loading.load_task(LOADER)
    found = {}
    for pump in PUMPS:
        for name, task in ((f"{FORWARDER}, {FASTEST}", forwarder), (f"{FORWARDER}, {WRITTEN}", _written(forwarder))):
            found[f"{name}, {pump}"] = Job(task, "dp", pump, registry.GRID)
        found[f"{LOADER}, {pump}"] = Job(loader, "dp", pump, registry.GRID)
    for name, task in ((FORWARDER, _written(forwarder)), (LOADER, loader)):
        found[f"{name}, {POINTWISE}"] = Job(replace(task, start="smallest", end="free"), "sns-actuator", "actuator")
    return found


def lines(got: Records) -> list[Line]:
    """Times and energies of every cycle, and what the proposal changes.

    Args:
        got: Records of `jobs`.
    """
    found = []
    for name, record in got.items():
        if name.endswith(POINTWISE):
            for pump in PUMPS:
                found += _of(f"{name}, {pump}", record, pump)
        else:
            found += _of(name, record, name.rsplit(", ", 1)[1])
    for pump in PUMPS:
        fast, slow = (got[f"{FORWARDER}, {timing}, {pump}"] for timing in (FASTEST, WRITTEN))
        for what, new, old in (
            ("time", sum(fast["leg_s"]), sum(slow["leg_s"])),
            ("energy", fast[f"energy_{pump}_j"], slow[f"energy_{pump}_j"]),
        ):
            change = None if new is None or not old else 100.0 * (new / old - 1.0)
            found.append(Line("cycles", f"{FORWARDER}, {FASTEST}, {pump}: change of {what} [%]", None, change))
    return found


def _of(name: str, record: Record, pump: str) -> list[Line]:
    """Time and energies of a cycle, whole and by leg."""
    joules = [record[f"energy_{pump}_j"], *record[f"leg_{pump}_j"]]
    whats = ["energy", *(f"leg {i}" for i in range(1, len(joules)))]
    status = "" if record["status"] == SOLVED else record["status"]
    time = sum(record["leg_s"]) if record["leg_s"] else None
    found = [Line("cycles", f"{name}: time [s]", None, time, status)]
    for what, energy in zip(whats, joules, strict=True):
        found.append(Line("cycles", f"{name}: {what} [kJ]", None, None if energy is None else energy / 1e3, status))
    return found
