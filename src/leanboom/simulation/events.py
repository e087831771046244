"""Events of a simulated run that deviate from the plan: time, place and cause, one sentence each.

| kind | what happened |
| --- | --- |
| saturation | a valve was asked for more than it opens |
| supply | a valve's compensator ran out of margin: the supply was too low for its load |
| pump | the pump was asked for more flow or pressure than it has |
| cavitation | a chamber was sucked below the tank's pressure |
| end | a piston ran into its cylinder's end |
| limit | a cylinder was faster than its limit |
| solver | the solver gave up |
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from leanboom.evaluation.evaluate import Evaluation
from leanboom.model.task import Task

SHORTEST = 0.05  # [s], shorter ones are left out, and gaps as short are bridged
FULL = 0.999  # of a command, from where it counts as saturated
SUCTION = 0.02e6  # [Pa] below the tank
SHORT = 0.05e6  # [Pa], by how much a compensator's drop may be short
CONTACT = 2e-4  # [m] beyond the end
BEYOND = 1.05  # of a velocity limit


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened from a time on for a while."""

    kind: str  # saturation, supply, pump, cavitation, end, limit or solver
    place: str  # a cylinder's name, pump or plant
    time: float  # when it began [s]
    duration: float  # [s]
    text: str  # what it was, with its largest value

    def json(self) -> dict[str, str | float]:
        """The event as JSON has it."""
        return {
            "kind": self.kind, "place": self.place, "time_s": round(self.time, 4),
            "duration_s": round(self.duration, 4), "text": self.text,
        }  # fmt: skip


def find(
    task: Task, arrays: dict[str, np.ndarray], observed: dict[str, np.ndarray], planned: Evaluation
) -> tuple[Event, ...]:
    """The events of a run, in the order of their times.

    Args:
        task: The task.
        arrays: The run's arrays by their names in `Simulation`.
        observed: What the plant showed besides, by name.
        planned: The plan.
    """
    time, machine, pump = arrays["time"], task.machine, task.machine.pump
    found: list[Event] = []
    tank = pump.tank_pressure
    commands = arrays["command"].reshape(time.size, len(machine.cylinders), -1)
    for i, cylinder in enumerate(machine.cylinders):
        name = cylinder.name
        asked = np.abs(commands[:, i]).max(axis=1)
        for begin, end in _spans(asked > FULL, time):
            found.append(_event("saturation", name, time, begin, end, f"the {name} valve is fully open"))
        short = observed["starved"][:, i]
        for begin, end in _spans(short > SHORT, time):
            lacks = short[begin : end + 1].max() / 1e6
            text = f"the supply is {lacks:.2f} MPa too low for the {name} valve's compensator"
            found.append(_event("supply", name, time, begin, end, text))
        lowest = np.minimum(arrays["pressure_a"][:, i], arrays["pressure_b"][:, i])
        for begin, end in _spans(lowest < tank - SUCTION, time):
            low = lowest[begin : end + 1].min() / 1e6
            text = f"the {name} cylinder's oil cavitates, {low - tank / 1e6:.2f} MPa against the tank"
            found.append(_event("cavitation", name, time, begin, end, text))
        for begin, end in _spans(_pressed(observed["end"][:, i], machine.full_force(cylinder)), time):
            which = "retracted" if observed["end"][begin : end + 1, i].sum() > 0.0 else "extended"
            found.append(_event("end", name, time, begin, end, f"the {name} cylinder runs into its {which} end"))
        speed = np.abs(arrays["velocity"][:, i])
        for begin, end in _spans(speed > BEYOND * cylinder.velocity_limit, time):
            fastest = speed[begin : end + 1].max()
            text = f"the {name} cylinder moves at {fastest:.3f} m/s, its limit is {cylinder.velocity_limit:g} m/s"
            found.append(_event("limit", name, time, begin, end, text))
    flow = arrays["pump_flow"]
    for begin, end in _spans(flow > FULL * pump.max_flow, time):
        found.append(
            _event("pump", "pump", time, begin, end, f"the pump gives all its {pump.max_flow * 6e4:.0f} l/min")
        )
    wanted = observed["sense"].max(axis=1) + pump.ls_margin
    for begin, end in _spans((wanted > pump.max_pressure) & (observed["wanted"][:, 0] == pump.max_pressure), time):
        high = wanted[begin : end + 1].max() / 1e6
        text = f"loads ask for {high:.1f} MPa, the pump has {pump.max_pressure / 1e6:g} MPa"
        found.append(_event("pump", "pump", time, begin, end, text))
    return tuple(sorted(found, key=lambda event: event.time))


def _pressed(force: np.ndarray, strongest: float) -> np.ndarray:
    """Whether a cylinder's end is pressed beyond contact."""
    from leanboom.simulation.plant import END_TRAVEL

    return np.abs(force) > CONTACT / END_TRAVEL * strongest


def _event(kind: str, place: str, time: np.ndarray, begin: int, end: int, text: str) -> Event:
    return Event(kind, place, float(time[begin]), float(time[end] - time[begin]), text)


def _spans(condition: np.ndarray, time: np.ndarray) -> Iterator[tuple[int, int]]:
    """First and last sample of every stretch that holds long enough; short gaps are bridged."""
    if time.size < 2:
        return
    least = max(1, round(SHORTEST / float(time[1] - time[0])))
    at = np.flatnonzero(condition)
    if at.size == 0:
        return
    breaks = np.flatnonzero(np.diff(at) > least)
    firsts, lasts = at[np.concatenate([[0], breaks + 1])], at[np.concatenate([breaks, [at.size - 1]])]
    for first, last in zip(firsts.tolist(), lasts.tolist(), strict=True):
        if last - first >= least:
            yield first, last
