"""What an experiment needs solved, and what it says: jobs, their records, lines beside printed values."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from leanboom.model.task import Task

GRID = (201, 101)
COARSE = "coarse"  # one sweep on one grid: no tubes, no polish

Record = Mapping[str, Any]
Records = Mapping[str, Record]


@dataclass(frozen=True, slots=True)
class Job:
    """A solution that an experiment needs."""

    task: Task
    method: str  # a name of `registry.METHODS`, COARSE or SIGNED
    cost: str
    grid: tuple[int, int] = GRID
    driven: bool = False  # whether its motion is simulated in closed loop as well
    switched: bool = False  # whether so with every one of `SWITCHES` too


@dataclass(frozen=True, slots=True)
class Line:
    """A printed value and ours; either may be missing."""

    experiment: str
    row: str
    printed: float | None
    ours: float | None
    why: str = ""  # why they differ, or why there is none of ours

    @property
    def difference(self) -> float | None:
        """Ours less printed."""
        return None if self.ours is None or self.printed is None else self.ours - self.printed


@dataclass(frozen=True, slots=True)
class Experiment:
    """One table, figure or claim of the papers."""

    title: str
    jobs: Callable[[], dict[str, Job]]
    lines: Callable[[Records], list[Line]]


def ratio(over: Record, under: Record, quantity: str) -> float | None:
    """One solution's quantity over another's; None where either has none.

    Args:
        over, under: Records.
        quantity: A key of both.
    """
    a, b = over[quantity], under[quantity]
    return None if a is None or not b else a / b


def percent(new: Record, old: Record, quantity: str) -> float | None:
    """Change from one solution to another in percent; None where either has none.

    Args:
        new, old: Records.
        quantity: A key of both.
    """
    change = ratio(new, old, quantity)
    return None if change is None else 100.0 * (change - 1.0)
