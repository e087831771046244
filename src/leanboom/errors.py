"""Exceptions of leanboom: one base class, one class per exit code of the command line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


class LeanboomError(Exception):
    """Base of everything leanboom raises on purpose; its text is meant for the user."""

    exit_code = 2


@dataclass(frozen=True, slots=True)
class Problem:
    """A problem of a file: line, key, value, and the allowed values."""

    file: str  # as shown in messages
    line: int | None  # from 1
    key: str  # dotted; empty if the file as a whole is meant
    value: str | None  # as written; None if it is none, or more than one
    allowed: str  # what must be there; empty if nothing can
    text: str  # the whole message, after file and line


class InputError(LeanboomError):
    """A file, an argument or an option that cannot be used; the text says what to change."""

    exit_code = 2

    def __init__(self, text: str, problems: tuple[Problem, ...] = ()):
        super().__init__(text)
        self.problems = problems  # of a file, one by one


class InfeasibleError(LeanboomError):
    """No motion satisfies the limits; the text names stage, time, limit and amount.

    `plan` and `evaluation` are those of the best motion found, to look at what stands in the way; None where there is
    none.
    """

    exit_code = 1

    def __init__(self, text: str, *, plan: Any = None, evaluation: Any = None) -> None:
        super().__init__(text)
        self.plan = plan
        self.evaluation = evaluation
