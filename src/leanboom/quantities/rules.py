"""Rules for values other than single quantities: lists, words, switches, texts and names."""

from __future__ import annotations

import re
from collections.abc import Callable
from difflib import get_close_matches
from typing import Any
from unicodedata import combining, normalize

from leanboom.errors import InputError, Problem
from leanboom.quantities.ranges import Refused, Rule, listed, shown
from leanboom.quantities.units import Kind


def suggestion(name: str, valid: tuple[str, ...]) -> str:
    """The valid names, and which of them was probably meant."""
    close = get_close_matches(name, valid, n=1)
    return f"{', '.join(valid)}{f'; did you mean {close[0]}?' if close else ''}"


class Listing(Rule):
    """A list of quantities or of lists, so many as `size` says."""

    def __init__(
        self,
        size: str,
        item: Rule,
        least: int,
        most: int | None = None,
        *,
        order: Callable[[Any], Any] | None = None,
        bare: bool = False,
    ):
        self.size, self.item, self.least, self.most, self._order, self._bare = size, item, least, most, order, bare
        self._allowed = f"must be a list of {size}"

    @property
    def kind(self) -> Kind | None:
        """What its quantities measure."""
        return self.item.kind

    @property
    def bare(self) -> bool:
        """Whether its quantities are written without their unit."""
        return self._bare

    def check(self, value: Any) -> tuple[Any, ...]:
        """The list as a tuple."""
        most = len(value) if self.most is None and isinstance(value, list | tuple) else self.most
        if not isinstance(value, list | tuple) or not self.least <= len(value) <= (most or 0):
            raise Refused(self.allowed)
        return tuple(value)

    def finish(self, value: Any) -> Any:
        """The list, if its items are in order."""
        return value if self._order is None else self._order(value)

    def kept(self, key: str, value: Any) -> tuple[Any, ...]:
        """A list handed over in Python as a tuple, its quantities in SI units."""
        given = listed(key, value, self.size, self.least, self.most)
        kept = tuple(self.item.kept(f"{key}[{i}]", item) for i, item in enumerate(given))
        try:
            return self.finish(kept)
        except Refused as error:
            raise InputError(f"{key} = [{', '.join(map(shown, kept))}]; {error}") from None

    def described(self, schema: dict[str, Any]) -> dict[str, Any]:
        """As many items as allowed."""
        return {**schema, "minItems": self.least} | ({"maxItems": self.most} if self.most else {})


class Word(Rule):
    """A text out of a few."""

    def __init__(self, *choices: str, **others: str):
        self.choices, self._allowed = choices, f"must be {', '.join(choices)}"
        self.others = others  # words of other people, and what they call so here

    def check(self, value: Any) -> str:
        """The word."""
        if value not in self.choices:
            meant = self.others.get(str(value))
            choices = f"{', '.join(self.choices)}; did you mean {meant}?" if meant else ""
            raise Refused(f"must be {choices or suggestion(str(value), self.choices)}")
        return value

    def described(self, schema: dict[str, Any]) -> dict[str, Any]:
        """One of the words."""
        return {"enum": list(self.choices)}


class Switch(Rule):
    """True or false; in files also the words yes and no."""

    _allowed = "must be true or false"
    _words = {"yes": True, "no": False}  # YAML 1.2 takes them for texts

    def check(self, value: Any) -> bool:
        """The truth value."""
        value = self._words.get(value, value) if isinstance(value, str) else value
        if not isinstance(value, bool):
            raise Refused(self.allowed)
        return value

    def kept(self, key: str, value: Any) -> bool:
        """The truth value."""
        try:
            return self.check(value)
        except Refused as error:
            raise InputError(f"{key} = {shown(value)}; {error}") from None

    def described(self, schema: dict[str, Any]) -> dict[str, Any]:
        """A truth value or its word."""
        return {"enum": [True, False, *self._words]}


class OneOrTwo(Rule):
    """One or two."""

    _allowed = "must be 1 or 2"

    def check(self, value: Any) -> int:
        """The number."""
        if isinstance(value, bool) or value not in (1, 2, "1", "2"):
            raise Refused(self.allowed)
        return int(value)

    def described(self, schema: dict[str, Any]) -> dict[str, Any]:
        """One of the two."""
        return {"enum": [1, 2]}


class Text(Rule):
    """A text of any length, in one line."""

    _allowed = "must be a text"

    def check(self, value: Any) -> str:
        """The text, its white space reduced."""
        if not isinstance(value, str):
            raise Refused(self.allowed)
        return " ".join(value.split())


class Name(Rule):
    """A name that is safe in a file's name."""

    pattern = "[A-Za-z0-9][A-Za-z0-9_-]{0,63}"

    _allowed = "must be up to 64 letters, digits, '-' and '_', the first a letter or digit"

    def check(self, value: Any) -> str:
        """The name."""
        if not isinstance(value, str) or not re.fullmatch(self.pattern, value):
            raise Refused(self.allowed)
        return value

    @staticmethod
    def made_of(text: str) -> str:
        """The name nearest to a text: letters without their marks, '-' for the rest; empty where nothing is left."""
        letters = "".join(c for c in normalize("NFKD", text) if not combining(c))
        return re.sub("[^A-Za-z0-9_-]+", "-", letters).strip("-_")[:64]

    def described(self, schema: dict[str, Any]) -> dict[str, Any]:
        """The same as a pattern."""
        return {"type": "string", "pattern": f"^{self.pattern}$"}


def counted(key: str, values: tuple[Any, ...], count: int, why: str) -> None:
    """Raise InputError unless there are so many values.

    Args:
        key: What the message calls them.
        values: The values.
        count: How many there must be.
        why: The same in words.
    """
    if len(values) != count:
        text, allowed = f"{key} has {len(values)} entries", f"must have {count}, {why}"
        raise InputError(f"{text}; {allowed}", (Problem("", None, key, None, allowed, text),))


def rising(values: tuple[float, ...]) -> tuple[float, ...]:
    """The values, if every one is above the one before it."""
    if any(b <= a for a, b in zip(values, values[1:], strict=False)):
        raise Refused("every value must be above the one before it")
    return values


def ordered(ends: tuple[float, float]) -> tuple[float, float]:
    """The ends of a range, if in order."""
    if ends[0] >= ends[1]:
        raise Refused("the lower end must be below the upper end")
    return ends
