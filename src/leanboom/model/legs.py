"""Legs of a task: paths one after the other, each with a payload of its own; the crane rests between them.

What is on the tool changes at rest: with the tool rests the redundant cylinder. So every leg is a motion from rest to
rest, and all that a leg hands on to the next is where that cylinder stands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated, Any

import numpy as np

from leanboom.components.paths import PATHS, Joined, Lines, Part, Path
from leanboom.errors import InputError
from leanboom.quantities import ranges
from leanboom.quantities.declarations import Variant, hold_declared
from leanboom.quantities.ranges import Refused, Rule
from leanboom.quantities.rules import Word
from leanboom.quantities.types import LeastMass, Time
from leanboom.quantities.units import KINDS, Kind, slip

APART = 1e-4  # [m], legs meet where they are no farther apart
AT_REST = 1e-6  # [m/s], of the tool

Fault = tuple[tuple[str | int, ...], object, str]  # where in a task file, the value there, and what it must be


class _LegTime(Rule):
    """A duration, the range of one, or the word `shortest`."""

    _allowed = "must be a time such as 8 s, a range of times such as [6 s, 12 s], or shortest"

    @property
    def kind(self) -> Kind:
        """What its quantities measure."""
        return KINDS["time"]

    def check(self, value: Any) -> str | float | tuple[float, float]:
        """The word, the time [s], or the ends of the range [s]."""
        if value == "shortest":
            return value
        try:
            if not isinstance(value, list | tuple):
                return ranges.DURATION.number(value)
            low, high = (ranges.DURATION.number(each) for each in value)
        except (Refused, ValueError):
            raise Refused(self.allowed + (slip(value, self.kind) if isinstance(value, str) else "")) from None
        if low >= high:
            raise Refused("is an empty range: the second time must be above the first")
        return low, high

    def kept(self, key: str, value: Any) -> str | float | tuple[float, float]:
        """The same of a value handed over in Python."""
        try:
            return self.check(value)
        except Refused as error:
            raise InputError(f"{key} = {ranges.shown(value)}; {error}") from None

    def described(self, schema: dict[str, Any]) -> dict[str, Any]:
        """A time, two times, or the word."""
        time = ranges.DURATION.described({})
        return {"anyOf": [time, {"type": "array", "items": time, "minItems": 2, "maxItems": 2}]}


@dataclass(frozen=True, slots=True, kw_only=True)
class Leg:
    """One path from rest to rest, with a payload of its own."""

    payload: LeastMass
    """Hangs at the machine's payload point, from the end of the leg before it on."""
    dwell: Time = 0.0
    """Waiting before the leg, at rest."""
    path: Annotated[Path, Variant(PATHS)]
    """What the tool does; it begins where the leg before it ends."""
    duration: Annotated[Any, _LegTime()] | None = None
    """In place of the path's own, which is made faster or slower: a time, a range to choose from, or shortest."""
    timing: Annotated[str, Word("fixed", "free")] = "fixed"
    """Whether the path's timing is kept, or speed along it planned as well, in the same time."""

    def __post_init__(self) -> None:
        if not isinstance(self.path, Path):
            raise InputError(f"path = {ranges.shown(self.path)}; must be a path such as leanboom.model.task.Lines")
        hold_declared(self, "")

    @property
    def timed(self) -> Path:
        """The path in the leg's duration; in the nearest to its own one where that is to be chosen."""
        own, asked = self.path.duration, self.duration
        if asked is None or isinstance(asked, str):
            return self.path
        wanted = asked if isinstance(asked, float) else min(max(own, asked[0]), asked[1])
        return self.path if wanted == own else self.path.slower(wanted / own)

    @property
    def settled(self) -> bool:
        """Whether its timing is known: nothing is left to choose."""
        return self.timing == "fixed" and (self.duration is None or isinstance(self.duration, float))

    def lasting(self, duration: float) -> Leg:
        """The leg in a time [s]."""
        return replace(self, duration=duration)


@dataclass(frozen=True, slots=True)
class Stretch:
    """One leg, or the waiting before it, on the clock of the whole task."""

    leg: int  # from 0
    waits: bool
    path: Path
    since: float  # [s]
    until: float  # [s]

    @property
    def said(self) -> str:
        """What messages call it, with the time from which theirs count."""
        what = f"waiting before leg {self.leg + 1}" if self.waits else f"leg {self.leg + 1}"
        return f"{what}, from {self.since:g} s on"


def stretches(legs: Sequence[Leg]) -> tuple[Stretch, ...]:
    """All legs and the waiting between them, in order."""
    found, since = [], 0.0
    for i, leg in enumerate(legs):
        path = leg.timed
        parts = [(True, _rest(path, leg.dwell))] if leg.dwell > 0.0 else []
        for waits, part in [*parts, (False, path)]:
            found.append(Stretch(i, waits, part, since, since + part.duration))
            since += part.duration
    return tuple(found)


def at(legs: Sequence[Leg], time: float) -> Stretch:
    """The leg under way at a time [s], or the waiting; where two meet, the later one."""
    found = stretches(legs)
    return next((each for each in found if time < each.until), found[-1])


def rest(legs: Sequence[Leg], since: float) -> tuple[Leg, ...]:
    """What is left of legs after a time [s]: of the one under way, or of its waiting, and all to come."""
    here = at(legs, since)
    first, later = legs[here.leg], legs[here.leg + 1 :]
    if here.waits:
        return replace(first, dwell=here.until - since), *later
    path = here.path if since <= here.since else Part(here.path, since - here.since, here.path.duration)
    return replace(first, path=path, dwell=0.0, duration=None), *later


def joined(legs: Sequence[Leg]) -> Joined:
    """The path of all legs, waiting included."""
    return Joined(tuple(each.path for each in stretches(legs)))


def _rest(path: Path, duration: float) -> Lines:
    """Waiting where a path begins, for a time [s]."""
    point = _ends(path)[0][0]
    return Lines((tuple(point.tolist()),) * 2, (duration,))


def _ends(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Points [m] and velocities [m/s] of the tool at the beginning and the end of a path, (2, 3) each."""
    point, velocity, _ = path.values(np.array([0.0, path.duration]))
    return point, velocity


def faults(legs: Sequence[Leg | None], total: float | None, time_price: float | None) -> list[Fault]:
    """Contradictions between legs.

    Args:
        legs: The legs; None for those that are wrong in themselves.
        total: Time that the whole takes [s]; None: as its legs do.
        time_price: What a second costs [W]; None: nothing.
    """
    found: list[Fault] = []
    for i, leg in enumerate(legs):
        # The first leg of what is left of a task is under way.
        if leg is not None and np.abs(_ends(leg.path)[1][1 if i == 0 else 0 :]).max() > AT_REST:
            found.append((("legs", i, "path"), leg.path, "must begin and end at rest: the payload changes there"))
    for i, (before, leg) in enumerate(pairwise(legs), 1):
        if before is None or leg is None:
            continue
        left, met = _ends(before.path)[0][1], _ends(leg.path)[0][0]
        if np.linalg.norm(met - left) > APART:
            at = ", ".join(f"{value:g}" for value in left)
            found.append((("legs", i, "path", "points", 0), met.tolist(), f"must be [{at}], where leg {i} ends"))
    whole = [leg for leg in legs if leg is not None]
    if len(whole) == len(legs):
        found += _shared_time(whole, total, time_price)
    return found


def _shared_time(legs: Sequence[Leg], total: float | None, time_price: float | None) -> list[Fault]:
    """What is wrong with time that legs share."""
    found: list[Fault] = []
    open_ones = [leg for leg in legs if not isinstance(leg.duration, float | None)]
    for key, value in (("total", total), ("time_price", time_price)):
        if value is not None and not any(isinstance(leg.duration, tuple) for leg in open_ones):
            found.append(((key,), value, "needs a leg whose duration is a range, such as [6 s, 12 s]"))
            return found
    if total is not None and time_price is not None:
        found.append((("time_price",), time_price, "must be left out where total is given"))
    if total is not None and not any(leg.duration == "shortest" for leg in open_ones):
        least, most = (sum(leg.dwell + span(leg)[end] for leg in legs) for end in (0, 1))
        if total < least - 1e-9:
            found.append(
                (("total",), total, f"must be at least {least:.6g} s, the sum of the shortest legs and waiting")
            )
        elif total > most + 1e-9:
            found.append((("total",), total, f"must be at most {most:.6g} s, the sum of the longest legs and waiting"))
    return found


def span(leg: Leg) -> tuple[float, float]:
    """Shortest and longest duration that a leg may have [s]; its own one where that is not to be chosen."""
    if isinstance(leg.duration, tuple):
        return leg.duration
    own = leg.timed.duration
    return own, own
