"""What the text of the 4-DOF paper says of its bars, which have no numbers: ranges that ratios of energies lie in.

How far a range goes is a reading: "25 %" and "almost twice" are taken with some room, "poor" and "inferior" as at least
so much, "adequate" and "similar" as at most.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf, log

POINTWISE = "P-inv. (j.)", "P-inv. (a.)"
SOLUTIONS = ("DP (LS)", "DP (CP)", "DP (A. En.)", "DP (ext.)", *POINTWISE)  # names as in `printed_values.SOLUTIONS`
PUMPS = "ls", "cp"

Energies = Mapping[str, tuple[float, float]]  # of each of `SOLUTIONS`, with load sensing and constant pressure [J]


@dataclass(frozen=True, slots=True)
class Statement:
    """What the paper says of a path, as a range of ratios."""

    path: str
    text: str
    low: float
    high: float
    ratios: Callable[[Energies], tuple[float, ...]]

    def missing(self, energies: Energies) -> float:
        """Logarithm of the factor by which the ratio that is furthest off misses the range; 0 where all are inside."""
        return max(0.0, *(self._off(ratio) for ratio in self.ratios(energies)))

    def decisive(self, energies: Energies) -> float:
        """The ratio that is furthest off the range, or nearest to one of its ends."""
        return max(self.ratios(energies), key=self._off)

    def _off(self, ratio: float) -> float:
        """Logarithm of the factor beyond the nearer end of the range, negative inside."""
        below = log(self.low / ratio) if self.low > 0.0 else -inf
        above = log(ratio / self.high) if self.high < inf else -inf
        return max(below, above)

    @property
    def span(self) -> str:
        """The range, in words."""
        if self.high == inf:
            return f"at least {self.low:.2f}"
        return f"at most {self.high:.2f}" if self.low == 0.0 else f"{self.low:.2f} to {self.high:.2f}"


def best(energies: Energies, pump: str) -> float:
    """The least energy with a pump [J]."""
    return min(pair[PUMPS.index(pump)] for pair in energies.values())


def _over(pump: str, *names: str) -> Callable[[Energies], tuple[float, ...]]:
    """Energies of solutions over the least one."""
    return lambda energies: tuple(energies[name][PUMPS.index(pump)] / best(energies, pump) for name in names)


def _double(energies: Energies) -> tuple[float, ...]:
    return (best(energies, "cp") / best(energies, "ls"),)


def _same(energies: Energies) -> tuple[float, ...]:
    return tuple(best(energies, "cp") / energies[name][0] for name in POINTWISE)


STATEMENTS = (
    Statement("horizontal", "LS: pseudo-inverses 25 % above the best", 1.20, 1.30, _over("ls", *POINTWISE)),
    Statement("horizontal", "CP: pseudo-inverses about 30 % above the best", 1.23, 1.37, _over("cp", *POINTWISE)),
    Statement("horizontal", "LS: least actuator work is similar", 0.0, 1.06, _over("ls", "DP (A. En.)")),
    Statement("horizontal", "LS: the CP optimum is adequate", 0.0, 1.10, _over("ls", "DP (CP)")),
    Statement("horizontal", "LS: least use of the extension is poor", 1.15, inf, _over("ls", "DP (ext.)")),
    Statement("horizontal", "best CP energy = LS energy of pseudo-inverses", 0.93, 1.07, _same),
    Statement("vertical", "LS: pseudo-inverses almost twice the best", 1.65, 2.05, _over("ls", *POINTWISE)),
    Statement("vertical", "LS: least actuator work is not least energy", 1.02, inf, _over("ls", "DP (A. En.)")),
    Statement("vertical", "LS: the CP optimum is adequate", 0.0, 1.10, _over("ls", "DP (CP)")),
    Statement("vertical", "best CP energy about double the best LS energy", 1.70, 2.30, _double),
    Statement("vertical", "CP: pseudo-inverses are inferior", 1.05, inf, _over("cp", *POINTWISE)),
    Statement("half-cycle", "LS: all solutions are fairly similar", 0.0, 1.20, _over("ls", *SOLUTIONS)),
    Statement("half-cycle", "LS: least actuator work is optimal too", 0.0, 1.03, _over("ls", "DP (A. En.)")),
    Statement("half-cycle", "LS: the joints' pseudo-inverse is comparable", 0.0, 1.10, _over("ls", "P-inv. (j.)")),
    Statement("half-cycle", "CP: pseudo-inverses are inferior", 1.05, inf, _over("cp", *POINTWISE)),
)


def of(path: str) -> tuple[Statement, ...]:
    """The statements on a path."""
    return tuple(statement for statement in STATEMENTS if statement.path == path)
