"""The time a computation may take: processor time, so that what others do on the machine does not use it up.

A budget of 60 s is 60 s of processor time on every processor this process uses, and ends after `PATIENCE` times 60 s
by the clock at the latest. On an idle machine both are nearly the same.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from leanboom import resources

PATIENCE = 2.0  # times the seconds asked for, by the clock, after which a budget ends whatever the processors did


def processors() -> int:
    """Processors that the threads of this process can use at once."""
    return min(resources.threads(), resources.cores())


@dataclass(frozen=True, slots=True)
class Budget:
    """Seconds that may be spent, from when the budget is made."""

    seconds: float  # [s]
    shared: int = field(default_factory=processors)
    began: float = field(default_factory=time.perf_counter)
    began_processor: float = field(default_factory=time.process_time)

    @property
    def gone(self) -> float:
        """Time by the clock so far [s]."""
        return time.perf_counter() - self.began

    @property
    def processor(self) -> float:
        """Processor time so far, all threads together [s]."""
        return time.process_time() - self.began_processor

    @property
    def spent(self) -> float:
        """Time counted [s]: processor time on every processor, or time by the clock over `PATIENCE` if more."""
        return max(self.processor / self.shared, self.gone / PATIENCE)

    @property
    def over(self) -> bool:
        """Whether the whole budget is spent."""
        return self.spent > self.seconds
