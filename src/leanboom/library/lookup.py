"""Queries of a library: the stored motion of least energy that fits, led over from where the extension is.

library = Library("forwarder-library")
answer = library.query((4.3, 0, 2.5), (2.1, 5.5, 1.3), max_duration=10, extension=0.4)
answer.motion.at(time)

A query asks the index for the nearest way, then for its motions, and reads one of them: however many there are, memory
and time stay. Judging an answer takes some tens of milliseconds more and is asked for by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from leanboom.components.costs import PUMPS
from leanboom.components.paths import quintic
from leanboom.errors import InfeasibleError, InputError
from leanboom.evaluation.evaluate import Evaluation, evaluate
from leanboom.io import loading
from leanboom.library import keys, specification
from leanboom.library.store import MACHINE, Choice, Entry, Store
from leanboom.model import motion
from leanboom.model.machine import Machine
from leanboom.model.motion import Motion
from leanboom.model.task import Task
from leanboom.quantities.ranges import shown

AT = 1e-3  # [m], a query this near to a stored way asks for it
FIRST_LOOK, FARTHER, FAR = 0.05, 3.0, 100.0  # [m], factor, [m]: how far to look for a way
BLEND = 0.5  # share of a motion over which it is led over from another extension


@dataclass(frozen=True, slots=True)
class Answer:
    """A stored motion, led over from the crane's extension."""

    entry: Entry
    apart_m: float  # larger distance of the ends asked for from the stored ones
    motion: Motion

    @property
    def stored(self) -> bool:
        """Whether the way asked for is a stored one."""
        return self.apart_m <= AT

    @property
    def blended_m(self) -> float:
        """How far the motion is led over at its start [m]."""
        return abs(float(self.motion.position[0]) - (self.entry.start_m or 0.0))


class Library:
    """A library that is open for queries, from one process or thread."""

    def __init__(self, folder: str | Path, machine: Machine | None = None):
        """Open a library.

        Args:
            folder: Its folder.
            machine: The machine that its motions are for, if that is to be checked.

        Raises:
            InputError: There is no library, it is of another machine, or its format is not known here.
        """
        self.store = Store(Path(folder))
        if machine is not None:
            self._check_machine(machine)

    def close(self) -> None:
        """Close it."""
        self.store.close()

    def __enter__(self) -> Library:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def query(
        self,
        origin: Sequence[float],
        goal: Sequence[float],
        *,
        max_duration: float | None = None,
        payload: float = 0.0,
        pump: str = "ls",
        extension: float | None = None,
    ) -> Answer:
        """The stored motion of least energy that fits, along the nearest way.

        Args:
            origin: Where the tool is [m].
            goal: Where it goes [m].
            max_duration: Longest duration [s]; None: any.
            payload: What the tool carries [kg]; motions of the least stored payload that is no smaller fit.
            pump: "ls" or "cp".
            extension: Where the redundant cylinder is [m], in its stroke; None: where the motion of least energy
                starts. Of motions that differ in their start, the one that starts nearest fits.

        Returns:
            The motion; not judged again.

        Raises:
            InputError: An argument cannot be used, or the library is damaged.
            InfeasibleError: Nothing fits; the text says what there is.
        """
        origin, goal = _point("from", origin), _point("to", goal)
        if pump not in PUMPS:
            raise InputError(f"pump = {shown(pump)}; must be {' or '.join(PUMPS)}")
        numbers = {"max_duration": max_duration, "payload": payload, "extension": extension}
        for name, value in numbers.items():
            if value is not None and not (np.isfinite(value) and value >= 0.0):
                raise InputError(f"{name} = {shown(value)}; must be a number from 0 on, in SI units")
        way, apart = self._nearest(origin, goal)
        entry = self._fitting(way, pump, payload, max_duration, extension)
        stored = self.store.motion(entry)
        return Answer(entry, apart, stored if extension is None else led_over(stored, extension))

    def movement(self, origin: Sequence[float], goal: Sequence[float], pump: str = "ls") -> list[Entry]:
        """All stored motions along the nearest way with a pump, by payload, duration and start.

        Args:
            origin, goal: Its ends [m].
            pump: "ls" or "cp".
        """
        way, _ = self._nearest(_point("from", origin), _point("to", goal))
        found = self.store.entries("way = ? AND pump = ?", (way, pump))
        return sorted(found, key=lambda each: (each.payload, each.duration, each.start))

    def machine(self) -> Machine:
        """The machine of the library."""
        return loading.load_machine(self.store.folder / MACHINE)

    def task(self, answer: Answer) -> Task:
        """The task of a stored motion, beginning where the answer's motion does.

        Args:
            answer: The answer.
        """
        return task_of(answer.entry, self.machine(), float(answer.motion.position[0]))

    def judged(self, answer: Answer) -> Evaluation:
        """An answer, judged along its stored way.

        Args:
            answer: The answer.
        """
        return evaluate(self.task(answer), answer.motion)

    def _check_machine(self, machine: Machine) -> None:
        theirs, ours = keys.machine_keys(self.machine()), keys.machine_keys(machine)
        if theirs != ours:
            name = self.store.facts()["machine"]
            other = f"machine {machine.name}" if machine.name != name else f"a machine {name} with other values"
            raise InputError(f"library = {self.store.folder}; holds motions of machine {name}, asked for is {other}")

    def _nearest(self, origin: tuple, goal: tuple) -> tuple[int, float]:
        """The nearest way, and how far it is away [m]."""
        within = FIRST_LOOK
        while within < FAR:
            best = self.store.nearest_way(origin, goal, within)
            if best is not None and best[1] <= within:
                return best
            within *= FARTHER
        raise InfeasibleError(f"the library in {self.store.folder} holds no motion near that")

    def _fitting(self, way: int, pump: str, payload: float, longest: float | None, extension: float | None) -> Entry:
        """The motion of least energy along a way that fits."""
        there = self.store.choices(way, pump)
        if not there:
            why = self.store.entries("way = ? AND pump = ?", (way, pump))
            said = f": {why[0].status}" if why else f" with pump {pump}"
            raise InfeasibleError(f"the library holds no motion along the nearest way{said}")
        heavy = [each for each in there if each.payload >= payload]
        if not heavy:
            most = max(each.payload for each in there)
            raise InfeasibleError(f"payload = {payload:g} kg; the library holds motions of up to {most:g} kg there")
        least = min(each.payload for each in heavy)
        quick = [each for each in heavy if each.payload == least and each.duration <= (longest or np.inf) + 1e-9]
        if not quick:
            first = min(each.duration for each in heavy if each.payload == least)
            raise InfeasibleError(f"max_duration = {longest:g} s; the quickest stored motion there takes {first:g} s")
        if extension is not None:
            nearest: dict[float, Choice] = {}
            for each in quick:
                best = nearest.get(each.duration)
                if best is None or abs(each.start_m - extension) < abs(best.start_m - extension):
                    nearest[each.duration] = each
            quick = list(nearest.values())
        chosen = min(quick, key=lambda each: each.energy_j)
        for entry in self.store.entries("key = ?", (chosen.key,)):
            return entry
        raise InputError(f"library = {self.store.folder}; a build has taken motion {chosen.key} out: ask again")


def task_of(entry: Entry, machine: Machine, start: float | None = None) -> Task:
    """The task of a stored motion.

    Args:
        entry: The motion.
        machine: The machine.
        start: Where the redundant cylinder starts [m]; None: as stored.
    """
    path = specification.shape_of(entry.shape).path(entry.origin, entry.goal, entry.duration)
    first = entry.start_m if start is None else start
    begin = "smallest" if first is None else max(0.0, first)
    end = "free" if entry.end_m is None else max(0.0, entry.end_m)
    return specification.asked("stored", machine, path, entry.payload, begin, end)


def led_over(stored: Motion, extension: float) -> Motion:
    """A motion that starts at another extension and is led to a stored one by a quintic; it ends as that does.

    Args:
        stored: The motion.
        extension: Where the redundant cylinder is [m].
    """
    away = extension - float(stored.position[0])
    if away == 0.0:
        return stored
    count = max(2, round(BLEND * stored.acceleration.size))
    rate = np.zeros(stored.velocity.size)
    rate[: count + 1] = quintic(np.linspace(0.0, 1.0, count + 1), count * stored.step)[1]
    rate /= stored.step * rate.sum()  # ends are 0: the sum is that of trapezoids
    velocity = stored.velocity - away * rate
    return motion.from_velocities(stored.step, extension, velocity, stored.method, stored.cost)


def _point(name: str, value: Sequence[float]) -> tuple[float, float, float]:
    try:
        point = tuple(float(each) for each in value)
    except (TypeError, ValueError):
        point = ()
    if len(point) != 3 or not np.isfinite(point).all():
        raise InputError(f"{name} = {shown(value)}; must be three numbers x, y, z in m")
    return point  # type: ignore[return-value]
