"""Outcome of a plan or of a run: a sentence for people, and a kind for programs."""

from __future__ import annotations

from enum import Enum
from typing import Any


class Kind(Enum):
    """Kinds of outcomes of a plan or of a run."""

    SOLVED = "every limit is kept, and the pump can deliver it"
    UNDELIVERABLE = "every limit is kept, but the pump cannot deliver it"
    INFEASIBLE = "a limit is broken"
    UNCONVERGED = "an iteration ended without a result"
    STOPPED = "the crane stops on the way"
    FAILED = "there is no motion at all"
    COMPLETE = "a simulation reached its end"
    INCOMPLETE = "a simulation ended early"


class Outcome(str):
    """A sentence, usable as any text, that knows its kind."""

    __slots__ = ("kind",)
    kind: Kind

    def __new__(cls, kind: Kind, sentence: str) -> Outcome:
        """The outcome of a kind, with its sentence."""
        made = super().__new__(cls, sentence)
        made.kind = kind
        return made

    def __getnewargs__(self) -> tuple[Any, ...]:
        return self.kind, str(self)  # what copies and other processes make it of

    @property
    def solved(self) -> bool:
        """Whether every limit is kept and the pump can deliver the motion."""
        return self.kind is Kind.SOLVED

    @property
    def feasible(self) -> bool:
        """Whether every limit is kept, be it too much for the pump."""
        return self.kind in (Kind.SOLVED, Kind.UNDELIVERABLE)

    def head(self, text: str) -> str:
        """First line of a printed result, with NOT SOLVED and the reason in front where it is not solved.

        Args:
            text: What it is.
        """
        return text if self.solved else f"NOT SOLVED: {self}. {text}"


SOLVED = Outcome(Kind.SOLVED, "solved")
COMPLETE = Outcome(Kind.COMPLETE, "complete")


def read(text: str) -> Outcome:
    """The outcome of a text without a kind: `solved`, or else a limit that is broken."""
    return text if isinstance(text, Outcome) else SOLVED if text == SOLVED else Outcome(Kind.INFEASIBLE, text)
