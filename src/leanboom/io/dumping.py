"""Machines and tasks written as files again: every value as it was written and where it comes from, or in SI units."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, fields
from enum import Enum
from typing import Any

from pydantic import ValidationError

from leanboom.components.cylinders import Cylinder
from leanboom.components.linkages import LINKAGES
from leanboom.components.paths import PATHS
from leanboom.components.valves import VALVES
from leanboom.errors import InputError
from leanboom.io.checks import areas, stroke
from leanboom.io.schema import AREAS, SHARED, SIZE_KEYS, CylinderKeys, MachineKeys, TaskKeys
from leanboom.io.yaml_source import STATUSES, Key, dotted, scalar, shortened
from leanboom.model.machine import Joint, Machine, Provenance
from leanboom.model.task import Leg, Lines, Retimed, Spline, Task, written
from leanboom.quantities.declarations import Section, Variant, declared
from leanboom.quantities.ranges import Rule
from leanboom.quantities.rules import Listing
from leanboom.quantities.units import KINDS, parse, write

_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_.-]*")  # texts that need no quotes


def machine_text(machine: Machine) -> str:
    """The text of a machine file that loads as this machine, provenance included."""
    origin = {entry.key: entry for entry in machine.provenance}
    data = {
        **{name: getattr(machine, name) for name in SHARED},
        "name": machine.name,
        "geometry": asdict(machine.geometry),
        "joints": {joint.name: [joint.lower, joint.upper] for joint in machine.joints},
        "cylinders": {
            cylinder.name: _cylinder(cylinder, joint, origin)
            for cylinder, joint in zip(machine.cylinders, machine.joints, strict=True)
        },
        "bodies": {body.name: _without(asdict(body), "name") for body in machine.bodies},
        "payload": {"along": machine.payload_along, "above": machine.payload_above},
        "valve": Variant(VALVES).section_of(machine.valve).data(machine.valve),
        "pump": asdict(machine.pump),
        "dynamics": {"coriolis": machine.coriolis, "slewing_inertia": machine.slewing_inertia},
        "simulation": _circuit(machine, origin),
    }
    return _text(Section(MachineKeys), data, f"machine {machine.name}", origin)


def task_text(task: Task, machine: str) -> str:
    """The text of a task file that loads as this task, where `machine` names the machine's file."""
    moved = {"legs": [_leg(task, leg) for leg in task.legs]} if task.legs else _moved(task)
    data = {
        "name": task.name,
        "machine": machine,
        **moved,
        "start": task.start,
        "end": task.end,
        "smooth": task.smooth,
        "limits": asdict(task.limits),
        "timing": task.timing,
        "total": task.total,
        "time_price": task.time_price,
    }
    return _text(Section(TaskKeys), data, f"task {task.name}", {})


def _moved(task: Task) -> dict[str, Any]:
    """Data of a task's payload and path."""
    return {"payload": task.payload, "path": _path(written(task))}


def _leg(task: Task, leg: Leg) -> dict[str, Any]:
    """Data of a leg."""
    path = _path(written(task, leg))
    return {field.name: getattr(leg, field.name) for field in fields(leg)} | {"path": path}


def _path(path: Lines | Spline | Retimed) -> dict[str, Any]:
    return Variant(PATHS).section_of(path).data(path)


def _text(section: Section, data: dict[str, Any], what: str, origin: dict[str, Provenance]) -> str:
    """The text of a file. Values made in Python must keep the same rules as a file's."""
    try:
        made = section.load(data)
    except ValidationError as error:
        problems = [
            f"{what}: {dotted(line['loc'])} = {line['input']}; {line.get('ctx', {}).get('allowed')}"
            for line in error.errors(include_url=False)
        ]
        raise InputError("\n".join(problems)) from None
    return "".join(f"{line}\n" for line in _section(section, made, (), origin)).lstrip("\n")


def _without(values: dict[str, Any], *names: str) -> dict[str, Any]:
    return {name: value for name, value in values.items() if name not in names}


def _cylinder(cylinder: Cylinder, joint: Joint, origin: dict[str, Provenance]) -> dict[str, Any]:
    values = _without(asdict(cylinder), "name", *AREAS)
    given = f"cylinders.{cylinder.name}.stroke" in origin
    if not given and cylinder.stroke == stroke(cylinder.linkage, joint.lower, joint.upper):
        del values["stroke"]  # reading finds the same
    linkage = Variant(LINKAGES).section_of(cylinder.linkage).data(cylinder.linkage)
    values |= {"linkage": linkage, "connection": cylinder.connection.value}
    return _size(cylinder, origin) | values


def _circuit(machine: Machine, origin: dict[str, Provenance]) -> dict[str, Any]:
    """The values given for the simulation, or changed since."""
    defaults = asdict(machine.valve.circuit)
    return {
        name: value
        for name, value in asdict(machine.circuit).items()
        if value != defaults[name] or f"simulation.{name}" in origin
    }


def _size(cylinder: Cylinder, origin: dict[str, Provenance]) -> dict[str, Any]:
    """The diameters a cylinder's areas were computed from, if they still are; else the areas."""
    written: dict[str, Any] = {}
    for name in SIZE_KEYS:
        entry = origin.get(f"cylinders.{cylinder.name}.{name}")
        if entry is not None:
            written[name] = parse(entry.value, declared(CylinderKeys)[name].rule.kind or KINDS["number"])
    if None not in written.values() and areas(written) == cylinder.areas:
        return written
    return dict(zip(AREAS, cylinder.areas, strict=True))


def _section(section: Section, made: Any, key: Key, origin: dict[str, Provenance]) -> list[str]:
    """Lines of a section's keys; those with their default value and no origin are left out."""
    indent = "  " * len(key)
    lines = [f"{indent}type: {section.tag}"] if section.tag else []
    after_section = False
    for name, field in section.fields.items():
        value, here = getattr(made, name), (*key, name)
        value = value.value if isinstance(value, Enum) else value
        known = any(entry == dotted(here) or entry.startswith(f"{dotted(here)}.") for entry in origin)
        if value is None or (not known and not field.required and value == field.default):
            continue
        deeper = isinstance(value, dict) or field.rule.section_of(value) is not None or _sections(field.rule, value)
        if not key and (deeper or after_section):
            lines.append("")
        after_section = deeper
        lines += _entry(value, here, field.rule, origin)
    return lines


def _sections(rule: Rule, value: Any) -> bool:
    """Whether a value is a list of sections."""
    return isinstance(rule, Listing) and isinstance(value, tuple) and rule.item.section_of(value[0]) is not None


def _entry(value: Any, key: Key, rule: Rule, origin: dict[str, Provenance]) -> list[str]:
    """Lines of one key, indented by its depth."""
    indent = "  " * (len(key) - 1)
    name = f"{indent}{key[-1]}:"
    section = rule.section_of(value)
    if section is not None:
        return [name, *_section(section, value, key, origin)]
    if isinstance(value, dict):
        return [name] + [line for inner, part in value.items() for line in _entry(part, (*key, inner), rule, origin)]
    if isinstance(rule, Listing) and _sections(rule, value):
        return [name] + [line for i, part in enumerate(value) for line in _item(part, (*key, i), rule, origin)]
    if not isinstance(value, tuple):
        return [f"{name} {_scalar(value, key, rule, origin)}{_comment(value, key, rule, origin)}"]
    return _listed(name, value, key, rule, origin)


def _item(value: Any, key: Key, rule: Listing, origin: dict[str, Provenance]) -> list[str]:
    """Lines of a section that is an item of a list: a dash before the first of them."""
    lines = _section(rule.item.section_of(value), value, key, origin)
    indent = "  " * len(key)
    return [f"{indent[:-2]}- {lines[0].removeprefix(indent)}", *lines[1:]]


def _listed(lead: str, values: tuple, key: Key, rule: Rule, origin: dict[str, Provenance]) -> list[str]:
    """Lines of a list after its key or dash: in one line if one comment speaks for all its values."""
    if not isinstance(values[0], tuple):
        comments = {_comment(part, (*key, i), rule, origin) for i, part in enumerate(values)}
        if len(comments) == 1:
            return [f"{lead} {_flow(values, key, rule, origin)}{comments.pop()}"]
    lines = [lead]
    dash = " " * (len(lead) - len(lead.lstrip()) + 2) + "-"
    for i, part in enumerate(values):
        here = (*key, i)
        if isinstance(part, tuple):
            lines += _listed(dash, part, here, rule, origin)
        else:
            lines.append(f"{dash} {_scalar(part, here, rule, origin)}{_comment(part, here, rule, origin)}")
    return lines


def _flow(values: tuple, key: Key, rule: Rule, origin: dict[str, Provenance]) -> str:
    return f"[{', '.join(_scalar(part, (*key, i), rule, origin) for i, part in enumerate(values))}]"


def _source(value: Any, key: Key, rule: Rule, origin: dict[str, Provenance]) -> Provenance | None:
    """Where a value comes from; None if that is not known, or was said of another value."""
    entry = origin.get(dotted(key))
    if entry is None:
        return None
    known = scalar(entry.value) if rule.kind is None or isinstance(value, str) else parse(entry.value, rule.kind)
    return entry if known == value or entry.value == str(value) else None


def _scalar(value: Any, key: Key, rule: Rule, origin: dict[str, Provenance]) -> str:
    """A value as it was written, if it still has that value; else in SI units."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return value if _PLAIN.fullmatch(value) and scalar(value) == value else json.dumps(value, ensure_ascii=False)
    entry = _source(value, key, rule, origin)
    if entry is not None:
        return entry.value
    return write(value, KINDS["number"] if rule.bare or rule.kind is None else rule.kind)


def _comment(value: Any, key: Key, rule: Rule, origin: dict[str, Provenance]) -> str:
    entry = _source(value, key, rule, origin)
    if entry is None or entry.status not in STATUSES:
        return ""
    note = shortened(entry.note, 200)
    return f"  # {entry.status}: {note}" if note else f"  # {entry.status}"
