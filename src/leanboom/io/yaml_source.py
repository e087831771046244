"""A YAML 1.2 file as plain data that remembers its lines: only mappings, lists and scalars, nothing executable.

ruamel's scanner and parser deliver events; building the tree from them here keeps line numbers and comments, finds
duplicate keys, and leaves no room for tags, anchors, aliases or deep nesting.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

from leanboom.errors import InputError, Problem

MAX_BYTES = 1 << 20
MAX_DEPTH = 12
MAX_PROBLEMS = 50
STATUSES = ("printed", "derived", "assumed", "identified")

_STATUS = re.compile(rf"[\s,\]}}]*\s#+\s*({'|'.join(STATUSES)})\b\s*[:,]?\s*(.*?)\s*")

_REMEDIES = {  # of what the parser says
    "character '\\t'": "indent with spaces, not tabs",
    "mapping values are not allowed": "a text with a colon stands in quotes",
    "could not find expected ':'": "a colon and a space follow a key",
    "expected <block end>": "the lines of a section are indented alike",
}

Key = tuple[str | int, ...]
Data = dict[str, "Data"] | list["Data"] | str | bool | None


@dataclass
class Source:
    """A file's data, and where each of its values stands.

    Scalars are kept as text, but for `true`, `false` and the null value; what a number or a quantity is, its reader
    decides.
    """

    name: str  # as shown in messages
    text: str
    data: Data = None
    lines: dict[Key, int] = field(default_factory=dict)  # first line of a key or list item, from 1
    ends: dict[Key, tuple[int, int]] = field(default_factory=dict)  # where a scalar's text ends: line from 0, column
    problems: list[Problem] = field(default_factory=list)

    def line(self, key: Key) -> int:
        """Line of a key, or of the nearest enclosing one that exists."""
        while key and key not in self.lines:
            key = key[:-1]
        return self.lines.get(key, 1)

    def value(self, key: Key) -> Data:
        """The data at a key."""
        node = self.data
        for step in key:
            node = node[step]  # type: ignore[index]
        return node

    def add(self, key: Key, found: str, allowed: str, value: str | None = None) -> None:
        """Note a problem at a key: what is found there, and what is allowed."""
        text = "; ".join(part for part in (f"{dotted(key)}{found}", allowed) if part)
        self.problems.append(Problem(self.name, self.line(key), dotted(key), value, allowed, text))

    def refuse(self, key: Key, allowed: str) -> None:
        """Note that the value at a key is not what is allowed there."""
        value = shown(self.value(key))
        self.add(key, f" = {value}", allowed, value)

    def report(self, *others: InputError) -> None:
        """Raise all problems as one InputError, in the order of their lines.

        Args:
            others: What is wrong with other files, to be raised along.
        """
        found = sorted(self.problems, key=lambda problem: problem.line or 0)
        messages = [f"{self.name}:{problem.line}: {problem.text}" for problem in found]
        if len(found) > MAX_PROBLEMS:
            rest = f"and {len(found) - MAX_PROBLEMS} more problems"
            messages[MAX_PROBLEMS:] = [f"{self.name}: {rest}"]
            found[MAX_PROBLEMS:] = [Problem(self.name, None, "", None, "", rest)]
        if messages or others:
            problems = (*found, *(problem for other in others for problem in other.problems))
            raise InputError("\n".join([*messages, *map(str, others)]), problems)

    def statuses(self) -> dict[Key, tuple[str, str]]:
        """Status and note of every scalar, from the comment that ends its line; ("unstated", "") without one.

        A comment speaks for all values of its line: `mass: 120 kg  # printed: Table 1`.
        """
        rows = self.text.split("\n")
        last: dict[int, int] = {}
        for row, column in self.ends.values():
            last[row] = max(column, last.get(row, 0))
        found = {row: _STATUS.fullmatch(rows[row], column) for row, column in last.items() if row < len(rows)}
        result = {}
        for key, (row, _) in self.ends.items():
            match = found.get(row)
            result[key] = (match[1], shortened(match[2], 200)) if match else ("unstated", "")
        return result


def dotted(key: Key) -> str:
    """A key as written in messages and provenance: cylinders.lift.stroke, path.points[1]."""
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in key)
    return shortened(text.removeprefix("."), 120)


def shown(data: Data) -> str:
    """A value as written in messages."""
    if isinstance(data, dict):
        return "a mapping"
    if isinstance(data, list):
        return shortened(f"[{', '.join(shown(item) for item in data[:12])}{', ...' if len(data) > 12 else ''}]", 80)
    if isinstance(data, bool):
        return "true" if data else "false"
    return "nothing" if data is None or data == "" else shortened(data, 80)


def shortened(text: str, length: int) -> str:
    """One printable line of at most a length."""
    text = "".join(c if c.isprintable() else "?" for c in " ".join(text.split()))
    return text if len(text) <= length else f"{text[: length - 3]}..."


def unusable(name: str, text: str, line: int | None = None, column: int | None = None) -> InputError:
    """The error for a file that cannot be used as a whole.

    Args:
        name: The file as it is called in messages.
        text: What is wrong.
        line: Where, from 1; None if nowhere in particular.
        column: Where in the line, from 1.
    """
    where = ":".join(str(part) for part in (name, line, column) if part is not None)
    return InputError(f"{where}: {text}", (Problem(name, line, "", None, "", text),))


def read(path: Path, name: str) -> Source:
    """Read a YAML file.

    Args:
        path: The file.
        name: The file as it is called in messages.

    Returns:
        Its data; problems found so far (duplicate keys) are noted, not raised.

    Raises:
        InputError: The file cannot be read, is above 1 MiB, is no YAML, or holds what is never allowed.
    """
    try:
        with path.open("rb") as stream:
            content = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise unusable(name, f"cannot be read: {error.strerror}") from None
    if len(content) > MAX_BYTES:
        raise unusable(name, "is above 1 MiB; a machine or task file is a few kilobytes")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        byte = content[error.start]
        raise unusable(name, f"is not UTF-8 text; byte {error.start} is 0x{byte:02x}", line) from None
    return parse(text, name)


def parse(text: str, name: str) -> Source:
    """Read YAML text; see `read`."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError
    from ruamel.yaml.reader import ReaderError

    source = Source(name, text)
    try:
        source.data = _Builder(source).build(YAML(typ="safe", pure=True).parse(text))
    except ReaderError as error:
        line = text[: error.position].count("\n") + 1
        code = error.character if isinstance(error.character, int) else ord(error.character)
        raise unusable(name, f"character #x{code:04x} is not allowed in YAML", line) from None
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        if "find expected ':'" in str(error.problem):
            mark = error.context_mark or mark  # where the key begins
        where = (mark.line + 1, mark.column + 1) if mark else ()
        remedy = next((remedy for sign, remedy in _REMEDIES.items() if sign in str(error.problem)), None)
        reason = "; ".join(str(part) for part in (error.problem, error.context, remedy) if part)
        raise unusable(name, f"is not valid YAML: {shortened(reason, 200)}", *where) from None
    except (YAMLError, OverflowError, ValueError) as error:  # the last two: escapes of characters that do not exist
        raise unusable(name, f"is not valid YAML: {shortened(str(error), 200)}") from None
    return source


class _Builder:
    """Turns parser events into data, iteratively over events and to a bounded depth."""

    def __init__(self, source: Source):
        self.source = source

    def build(self, events) -> Data:
        """The data of the file's only document."""
        from ruamel.yaml import events as kinds

        self.kinds = kinds
        self.events = (event for event in events if not isinstance(event, kinds.StreamStartEvent))
        event = next(self.events)
        if isinstance(event, kinds.StreamEndEvent):
            return None
        data = self.node(next(self.events), (), 0)
        next(self.events)  # end of the document
        event = next(self.events)
        if isinstance(event, kinds.DocumentStartEvent):
            raise self.refusal(event, "a second document begins; one file holds one machine or task")
        return data

    def refusal(self, event, text: str) -> InputError:
        return unusable(self.source.name, text, event.start_mark.line + 1)

    def node(self, event, key: Key, depth: int) -> Data:
        """The data of the node that begins with an event."""
        kinds = self.kinds
        if isinstance(event, kinds.AliasEvent) or getattr(event, "anchor", None):
            raise self.refusal(event, "anchors and aliases (& and *) are not allowed; write the value out")
        if event.tag is not None:
            tag = shortened(event.tag, 60)
            raise self.refusal(event, f"tags ({tag}) are not allowed; write the value alone")
        if depth > MAX_DEPTH:
            raise self.refusal(event, f"is nested deeper than {MAX_DEPTH} levels")
        self.source.lines.setdefault(key, event.start_mark.line + 1)
        if isinstance(event, kinds.ScalarEvent):
            self.source.ends[key] = (event.end_mark.line, event.end_mark.column)
            return scalar(event.value) if event.implicit[0] else event.value
        if isinstance(event, kinds.SequenceStartEvent):
            items: list[Data] = []
            while not isinstance(event := next(self.events), kinds.SequenceEndEvent):
                items.append(self.node(event, (*key, len(items)), depth + 1))
            return items
        return self.mapping(key, depth)

    def mapping(self, key: Key, depth: int) -> Data:
        """The data of a mapping whose start was seen; of a duplicate key the first value counts."""
        result: dict[str, Data] = {}
        while not isinstance(event := next(self.events), self.kinds.MappingEndEvent):
            if not isinstance(event, self.kinds.ScalarEvent):
                raise self.refusal(event, "a key must be a plain word")
            line = event.start_mark.line + 1
            name = event.value
            here = (*key, name)
            if name in result:
                first = self.source.lines[here]
                text = f"{dotted(here)} is given twice; first in line {first}"
                self.source.problems.append(Problem(self.source.name, line, dotted(here), None, "", text))
                self.node(next(self.events), (*key, f"{name} (twice, line {line})"), depth + 1)
                continue
            self.source.lines[here] = line
            result[name] = self.node(next(self.events), here, depth + 1)
        return result


def scalar(text: str) -> str | bool | None:
    """A plain scalar by YAML 1.2's core schema, numbers left as text."""
    if text in ("true", "True", "TRUE"):
        return True
    if text in ("false", "False", "FALSE"):
        return False
    return None if text in ("", "~", "null", "Null", "NULL") else text
