"""What one value of a file may be: rules that pydantic applies, and that say in words what they allow.

A rule stands in a type, `Annotated[float, Quantity(ranges.LENGTH)]`. Values arrive as text and leave as SI floats.
"""

from __future__ import annotations

import re
from difflib import get_close_matches
from typing import Any, LiteralString, get_args
from unicodedata import combining, normalize

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from leanboom.components.paths import RISING, rises
from leanboom.model.task import START, start_of
from leanboom.quantities.ranges import Range
from leanboom.quantities.units import KINDS, Kind, expected, is_bare, parse, write


def refusal(allowed: str, key: str = "", kind: LiteralString = "refused") -> PydanticCustomError:
    """The error for a value that is not what is allowed; `key` if it stands one level deeper."""
    return PydanticCustomError(kind, "{allowed}", {"allowed": allowed, "key": key})


def suggestion(name: str, valid: tuple[str, ...]) -> str:
    """The valid names, and which of them was probably meant."""
    close = get_close_matches(name, valid, n=1)
    return f"{', '.join(valid)}{f'; did you mean {close[0]}?' if close else ''}"


class Rule:
    """What a value must be, in words; how it is read; and for quantities of what kind, to write them again."""

    allowed: str = "must be given"
    kind: Kind | None = None
    bare: bool = False  # written without its unit

    def check(self, value: Any) -> Any:
        """The value, ready for its type.

        Raises:
            PydanticCustomError: It is not allowed; made by `refusal`.
        """
        return value

    def described(self, schema: dict[str, Any]) -> dict[str, Any]:
        """The JSON schema of the value as written, from that of its type."""
        return schema

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Check before the type is."""
        return core_schema.no_info_before_validator_function(self.check, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Describe the value as written."""
        return self.described(handler(schema))


class Quantity(Rule):
    """A quantity within bounds in SI units."""

    def __init__(self, allowed: Range, *, any_bare: bool = False):
        self.range, self.kind = allowed, KINDS[allowed.name]
        self.any_bare = any_bare  # bare numbers of any size
        article = "an" if self.kind.name[0] in "aeiou" else "a"
        bounds = f" {allowed.bounds}" if allowed.bounds else ""
        self.allowed = f"must be {article} {self.kind.name}{bounds}, such as {self.kind.example}"

    def check(self, value: Any) -> float:
        """The quantity in SI units."""
        assert self.kind is not None
        number = parse(value, self.kind) if isinstance(value, str) and is_bare(value) else None
        if number is not None and abs(number) > self.kind.bare and not self.any_bare:
            limit, unit = write(self.kind.bare, self.kind), self.kind.unit
            raise refusal(f"must have its unit beyond {limit}, since a bare number is in {unit}")
        try:
            return self.range.read(value)
        except ValueError as error:
            raise refusal(str(error)) from None

    def described(self, schema: dict[str, Any]) -> dict[str, Any]:
        """Text with a unit, or a bare number."""
        assert self.kind is not None
        bare = f"a bare number is in {self.kind.unit}" if self.kind.unit else "without a unit"
        return {"type": ["string", "number"], "description": f"{self.allowed.removeprefix('must be ')}; {bare}"}


class OrMapping(Rule):
    """A quantity, or a mapping in its place, which its own section checks."""

    def __init__(self, quantity: Quantity, keys: str):
        self.quantity, self.kind = quantity, quantity.kind
        self.mapping = f"or a mapping with the keys {keys}"
        self.allowed = f"{quantity.allowed}, {self.mapping}"

    def check(self, value: Any) -> Any:
        """The mapping, or the quantity in SI units."""
        assert self.kind is not None
        if isinstance(value, list):
            raise refusal(f"{expected('', self.kind)}, {self.mapping}")
        return value if isinstance(value, dict) else self.quantity.check(value)

    def described(self, schema: dict[str, Any]) -> dict[str, Any]:
        """The quantity as written, or the mapping."""
        return {"anyOf": [self.quantity.described({}), *(part for part in schema["oneOf"] if "$ref" in part)]}


class Listing(Rule):
    """A list of quantities or of lists, so many as `size` says."""

    def __init__(self, size: str, kind: str, least: int, most: int | None = None, *, bare: bool = False):
        self.allowed = f"must be a list of {size}"
        self.kind, self.bare = KINDS[kind], bare
        self.least, self.most = least, most

    def check(self, value: Any) -> tuple[Any, ...]:
        """The list as a tuple."""
        most = len(value) if self.most is None and isinstance(value, list | tuple) else self.most
        if not isinstance(value, list | tuple) or not self.least <= len(value) <= (most or 0):
            raise refusal(self.allowed)
        return tuple(value)

    def described(self, schema: dict[str, Any]) -> dict[str, Any]:
        """As many items as allowed."""
        return {**schema, "minItems": self.least} | ({"maxItems": self.most} if self.most else {})


class Word(Rule):
    """A text out of a few."""

    def __init__(self, *choices: str, **others: str):
        self.choices = choices
        self.others = others  # words of other people, and what they call so here
        self.allowed = f"must be {', '.join(choices)}"

    def check(self, value: Any) -> str:
        """The word."""
        if value not in self.choices:
            meant = self.others.get(str(value))
            choices = f"{', '.join(self.choices)}; did you mean {meant}?" if meant else ""
            raise refusal(f"must be {choices or suggestion(str(value), self.choices)}")
        return value

    def described(self, schema: dict[str, Any]) -> dict[str, Any]:
        """One of the words."""
        return {"enum": list(self.choices)}


class Variant(Rule):
    """A section that is one of several, told apart by its key `type`."""

    def __init__(self, *choices: str):
        self.choices = choices
        self.allowed = f"must be a mapping with the key type: {', '.join(choices)}"

    def check(self, value: Any) -> Any:
        """The section, of a known type."""
        if not isinstance(value, dict):
            raise refusal(self.allowed)
        if "type" not in value:
            raise refusal(f"must be {', '.join(self.choices)}", "type", "missing")
        if value["type"] not in self.choices:
            raise refusal(f"must be {suggestion(str(value['type']), self.choices)}", "type")
        return value


class Switch(Rule):
    """True or false."""

    allowed = "must be true or false"

    def check(self, value: Any) -> bool:
        """The truth value."""
        if not isinstance(value, bool):
            raise refusal(self.allowed)
        return value


class OneOrTwo(Rule):
    """One or two."""

    allowed = "must be 1 or 2"

    def check(self, value: Any) -> int:
        """The number."""
        if isinstance(value, bool) or value not in (1, 2, "1", "2"):
            raise refusal(self.allowed)
        return int(value)

    def described(self, schema: dict[str, Any]) -> dict[str, Any]:
        """One of the two."""
        return {"enum": [1, 2]}


class Text(Rule):
    """A text of any length, in one line."""

    allowed = "must be a text"

    def check(self, value: Any) -> str:
        """The text, its white space reduced."""
        if not isinstance(value, str):
            raise refusal(self.allowed)
        return " ".join(value.split())


class Name(Rule):
    """A name that is safe in a file's name."""

    pattern = "[A-Za-z0-9][A-Za-z0-9_-]{0,63}"
    allowed = "must be up to 64 letters, digits, '-' and '_', the first a letter or digit"

    def check(self, value: Any) -> str:
        """The name."""
        if not isinstance(value, str) or not re.fullmatch(self.pattern, value):
            raise refusal(self.allowed)
        return value

    @staticmethod
    def made_of(text: str) -> str:
        """The name nearest to a text: letters without their marks, '-' for the rest; empty where nothing is left."""
        letters = "".join(c for c in normalize("NFKD", text) if not combining(c))
        return re.sub("[^A-Za-z0-9_-]+", "-", letters).strip("-_")[:64]

    def described(self, schema: dict[str, Any]) -> dict[str, Any]:
        """The same as a pattern."""
        return {"type": "string", "pattern": f"^{self.pattern}$"}


class Start(Rule):
    """Where the redundant cylinder starts."""

    allowed = START
    kind = KINDS["length"]

    def check(self, value: Any) -> str | float:
        """One of the words, or a length [m]."""
        try:
            return start_of(value)
        except ValueError as error:
            raise refusal(str(error)) from None


def rule_of(metadata: list[Any], annotation: Any) -> Rule | None:
    """The rule of a field, also of an optional one; None if it has none."""
    inner = get_args(annotation)
    found = [*metadata, *(getattr(inner[0], "__metadata__", ()) if inner else ())]
    return next((part for part in found if isinstance(part, Rule)), None)


def rising(values: tuple[float, ...]) -> tuple[float, ...]:
    """The values, if every one is above the one before it."""
    if any(b <= a for a, b in zip(values, values[1:], strict=False)):
        raise refusal("every value must be above the one before it")
    return values


def rising_from_zero(values: tuple[float, ...]) -> tuple[float, ...]:
    """The times, if they begin with 0 and rise."""
    if not rises(values):
        raise refusal(RISING)
    return values


def ordered(ends: tuple[float, float]) -> tuple[float, float]:
    """The ends of a range, if in order."""
    if ends[0] >= ends[1]:
        raise refusal("the lower end must be below the upper end")
    return ends
