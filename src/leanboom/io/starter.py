"""Machine and task files to begin with: right as they are, every key explained, every value to be replaced.

They are made of the bundled machines and of what the schema says of its keys, so they cannot fall behind either.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from leanboom.errors import InputError
from leanboom.io import loading
from leanboom.io.schema import MachineKeys, TaskKeys
from leanboom.io.yaml_source import Key, Source, parse, unusable
from leanboom.model.machine import Machine
from leanboom.quantities.declarations import Section, Variant, meanings
from leanboom.quantities.ranges import Range
from leanboom.quantities.rules import Word

_KINDS = ("machine", "task")

_MACHINE = """\
# A crane, to be made yours: every value below is an example, of a small loader crane.
# Replace the values, and say at the end of each line where yours come from: printed (in a data sheet), derived
# (computed from printed values), identified (measured on the machine) or assumed; a note may follow after a colon.
# If yours does not slew: slewing: false, and leave out joints.base and cylinders.base.
# Quantities have units: 610 mm, 21.5 MPa, 80 l/min, 30 deg. Keys in comments are optional.
# Check it with: leanboom check FILE
"""
_TASK = """\
# A task, to be made yours: which machine moves its tool along which path, with how much on it.
# Keys in comments are optional.
# Check it with: leanboom check FILE; plan it with: leanboom plan FILE --out run
"""


def text(kind: Literal["machine", "task"]) -> str:
    """The text of a file to begin with, which loads as it is.

    Args:
        kind: Of which kind.

    Raises:
        InputError: There is no such kind.
    """
    if kind not in _KINDS:
        raise InputError(f"kind = {kind}; must be {', '.join(_KINDS)}")
    if kind == "machine":
        return _MACHINE + _explained(Section(MachineKeys), loading.dump_machine(_example()))
    task = replace(loading.load_task("loader-triangle-small"), name="my-task")
    return _TASK + _explained(Section(TaskKeys), loading.dump_task(task, "loader"))


def write(kind: Literal["machine", "task"], path: Path) -> None:
    """Write a file to begin with where there is none.

    Args:
        kind: Of which kind.
        path: The file.

    Raises:
        InputError: There is something already, or the file cannot be written.
    """
    content = text(kind)
    try:
        with path.open("x", encoding="utf-8") as stream:
            stream.write(content)
    except FileExistsError:
        raise unusable(str(path), "is there already; give the name of a new file") from None
    except OSError as error:
        raise unusable(str(path), f"cannot be written: {error.strerror}") from None
    except ValueError:
        raise unusable(str(path), "is a name no file can have") from None


def _example() -> Machine:
    """The loader on the forwarder's slewing base and with its kind of valve."""
    arm, base = loading.load_machine("loader"), loading.load_machine("forwarder")
    column = base.bodies[0]
    of_base = ("joints.base", "cylinders.base", f"bodies.{column.name}", "valve")
    entries = [entry for entry in arm.provenance if not entry.key.startswith(("valve", "simulation"))]
    entries += [entry for entry in base.provenance if entry.key.startswith(of_base)]
    entries = [replace(entry, value="true") if entry.key == "geometry.slewing" else entry for entry in entries]
    return replace(
        arm,
        name="my-crane",
        description="Which crane this is",
        geometry=replace(arm.geometry, slewing=True),
        joints=(base.joints[0], *arm.joints),
        cylinders=(base.cylinders[0], *arm.cylinders),
        bodies=(column, *arm.bodies),
        valve=base.valve,
        circuit=base.valve.circuit,
        provenance=tuple(replace(entry, status="assumed", note="example") for entry in entries),
    )


def _explained(whole: Section, content: str) -> str:
    """A file's text with a comment above each key, once for each kind of section, and its other keys as comments."""
    source = parse(content, whole.made.__name__)
    rows = content.splitlines()
    before: dict[int, list[str]] = {}
    after: dict[int, list[str]] = {}
    seen: set[Section] = set()
    for section, key in _sections(whole, whole.load(source.data), ()):
        if section in seen or key not in source.lines:  # a section that is left out has no line
            continue
        seen.add(section)
        indent = "  " * len(key)
        for name in section.fields:
            here = (*key, name)
            if here in source.lines:
                before[source.lines[here]] = _told(section, name, indent)
            else:
                after.setdefault(_last(source, key), []).extend(_offered(section, name, indent))
    lines = [""]
    for number, row in enumerate(rows, 1):
        lines += [*before.get(number, ()), row, *after.get(number, ())]
    return "".join(f"{line}\n" for line in lines)


def _told(section: Section, name: str, indent: str) -> list[str]:
    """What a key means, as a comment; nothing where its name says it."""
    meaning, rule = meanings(section.made).get(name), section.fields[name].rule
    words = [meaning] if meaning else []
    if isinstance(rule, Word | Variant):
        words.append(f"{'Type' if isinstance(rule, Variant) else 'One of'}: {', '.join(rule.choices)}.")
    return [f"{indent}# {' '.join(words)}"] if words else []


def _offered(section: Section, name: str, indent: str) -> list[str]:
    """A key that a file leaves out, as a comment, with what it means; the keys of a section below it."""
    rule = section.fields[name].rule
    told = _told(section, name, indent)
    if isinstance(rule, Section):
        below = [line for key in rule.fields for line in _offered(rule, key, indent + "  ")]
        return [*told, f"{indent}# {name}:", *below]
    example = rule.kind.example if isinstance(rule, Range) else "..."
    return [*told, f"{indent}# {name}: {example}"]


def _sections(section: Section, made: Any, key: Key) -> Iterator[tuple[Section, Key]]:
    """A section and all within it, with their keys."""
    yield section, key
    for name, field in section.fields.items():
        value = getattr(made, name)
        parts = {(name, inner): part for inner, part in value.items()} if isinstance(value, dict) else {(name,): value}
        for inner, part in parts.items():
            deeper = None if part is None else field.rule.section_of(part)
            if deeper is not None:
                yield from _sections(deeper, part, (*key, *inner))


def _last(source: Source, key: Key) -> int:
    """The last line of a section."""
    return max(line for other, line in source.lines.items() if other[: len(key)] == key)
