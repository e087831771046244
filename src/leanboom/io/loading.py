"""Machine and task files: read, checked, resolved and written again.

A file is YAML with units in its values; `docs/files.md` describes every key. Whatever is wrong with a file is said in
one `InputError`, a line for each problem: file, line, key, value and what is allowed. Pydantic, ruamel and pint are
imported when a file is read, not before.
"""

from __future__ import annotations

from collections.abc import Callable, Sized
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

from leanboom.components.cylinders import Cylinder
from leanboom.errors import InputError
from leanboom.model.machine import Body, Joint, Machine, Provenance

if TYPE_CHECKING:
    from leanboom.io.yaml_source import Source
    from leanboom.model.task import Task

_FOLDER = Path(__file__).parents[1] / "data"
_FOLDERS = {"machine": "machines", "task": "tasks", "library": "libraries"}  # of bundled files, by their kind
_STRUCTURE = ("name", "description", "type", "carrier")  # words that need no provenance


def bundled_machines() -> tuple[str, ...]:
    """Names of the machines that come with leanboom."""
    return _bundled("machines")


def bundled_tasks() -> tuple[str, ...]:
    """Names of the tasks that come with leanboom."""
    return _bundled("tasks")


def bundled_libraries() -> tuple[str, ...]:
    """Names of the specifications of motion libraries that come with leanboom."""
    return _bundled("libraries")


def _bundled(folder: str) -> tuple[str, ...]:
    return tuple(sorted(path.stem for path in (_FOLDER / folder).glob("*.yaml")))


def load_machine(name_or_path: str | Path) -> Machine:
    """Load a machine.

    Args:
        name_or_path: Name of a bundled machine, or a machine file.

    Returns:
        The machine, in SI units, with the provenance of its values.

    Raises:
        InputError: There is no such machine, or its file has problems; all of them are named.
    """
    path, source = _open("machine", name_or_path)
    return _machine(source, path)


def load_task(
    name_or_path: str | Path,
    *,
    start: str | float | None = None,
    end: str | float | None = None,
    pump_flow_limit: bool | None = None,
) -> Task:
    """Load a task and its machine.

    Args:
        name_or_path: Name of a bundled task, or a task file.
        start: In place of the file's `start`: "smallest", "middle", "best", or a length of the redundant cylinder
            ("0.3 m", or a number in [m]).
        end: In place of the file's `end`: "free", "same", "smallest", "middle", or a length.
        pump_flow_limit: In place of the file's `limits.pump_flow`: whether the pump's `max_flow` is a limit.

    Returns:
        The task, in SI units.

    Raises:
        InputError: There is no such task, or its file or its machine's file has problems; all of them are named.
    """
    from leanboom.io.checks import check_task
    from leanboom.io.schema import TaskKeys
    from leanboom.model.task import Task

    name, keys, machine, text = load_keys(
        "task", name_or_path, TaskKeys, lambda source, keys, machine: check_task(source, machine)
    )
    scaled = None if keys.duration == "shortest" else keys.duration
    return Task(
        name=name,
        machine=machine,
        path=keys.path if scaled is None else keys.path.slower(scaled / keys.path.duration),
        payload=0.0 if keys.payload is None else keys.payload,
        start=keys.start if start is None else start,
        end=keys.end if end is None else end,
        smooth=keys.smooth,
        limits=keys.limits if pump_flow_limit is None else replace(keys.limits, pump_flow=pump_flow_limit),
        timing="shortest" if keys.duration == "shortest" else keys.timing,
        legs=keys.legs,
        total=keys.total,
        time_price=keys.time_price,
        source=text,
    )


def load_keys(
    kind: str, name_or_path: str | Path, made: type, check: Callable[[Source, Any, Machine | None], None]
) -> tuple[str, Any, Machine, str]:
    """A file that names a machine, read and checked as a whole.

    Args:
        kind: What it is, for messages and bundled names: "task" or "library".
        name_or_path: Name of a bundled file, or a file.
        made: The dataclass of its keys.
        check: Notes what does not fit together; keys or machine are None where they are wrong in themselves.

    Returns:
        Its name, its keys, its machine and its text.

    Raises:
        InputError: There is no such file, or it or its machine's file has problems; all of them are named.
    """
    path, source = _open(kind, name_or_path)
    keys = _section(made, source)
    machine, others = _machine_of(source, path.parent)
    check(source, keys, machine)
    name = _name(keys, source, path)
    source.report(*others)
    assert keys is not None and machine is not None  # else reported
    return name, keys, machine, source.text


def dump_machine(machine: Machine) -> str:
    """The text of a complete machine file that loads as an equal machine, provenance included."""
    from leanboom.io.dumping import machine_text

    return machine_text(machine)


def dump_task(task: Task, machine: str = "machine.yaml") -> str:
    """The text of a complete task file that loads as an equal task.

    Args:
        task: The task.
        machine: Where the task's machine is written, relative to the task file.
    """
    from leanboom.io.dumping import task_text

    return task_text(task, machine)


def json_schema(kind: Literal["machine", "task"]) -> dict[str, Any]:
    """JSON schema of machine or task files, for editors that complete and check keys."""
    from leanboom.io.schema import MachineKeys, TaskKeys
    from leanboom.quantities.declarations import Section

    kinds = {"machine": MachineKeys, "task": TaskKeys}
    if kind not in kinds:
        raise InputError(f"schema = {kind}; must be {', '.join(kinds)}")
    schema = Section(kinds[kind]).json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": f"leanboom {kind} file"}


def _machine_of(source: Source, folder: Path) -> tuple[Machine | None, tuple[InputError, ...]]:
    """The machine of a task file; or None and what is wrong with the machine's own file."""
    from leanboom.io.yaml_source import read

    wanted = source.data.get("machine") if isinstance(source.data, dict) else None
    if not isinstance(wanted, str):
        return None, ()
    found = _find("machine", wanted, folder)
    if found is None:
        source.refuse(("machine",), _choices("machine", wanted))
        return None, ()
    path, name = found
    try:
        return _machine(read(path, name), path), ()
    except InputError as error:
        return None, (error,)


def _open(kind: str, wanted: str | Path) -> tuple[Path, Source]:
    """The machine or task file a caller means, read."""
    from leanboom.io.yaml_source import read, shortened

    found = _find(kind, wanted, Path())
    if found is None:
        raise InputError(f"{kind} = {shortened(str(wanted), 200) or 'nothing'}; {_choices(kind, str(wanted))}")
    return found[0], read(*found)


def _find(kind: str, wanted: str | Path, folder: Path) -> tuple[Path, str] | None:
    """File of a machine or task, and what to call it in messages; None if there is none.

    Args:
        kind: One of `_FOLDERS`.
        wanted: Bundled name or path; a `Path` is never a bundled name.
        folder: What a relative path is relative to.
    """
    if isinstance(wanted, str) and wanted in _bundled(_FOLDERS[kind]):
        return _FOLDER / _FOLDERS[kind] / f"{wanted}.yaml", f"{wanted}.yaml"
    path = folder / wanted
    try:
        return (path, str(path)) if path.is_file() else None
    except (OSError, ValueError):  # a name no file can have
        return None


def _choices(kind: str, wanted: str) -> str:
    from leanboom.quantities.rules import suggestion

    return f"must be a file or a bundled {kind}: {suggestion(wanted[:200], _bundled(_FOLDERS[kind]))}"


def _machine(source: Source, path: Path) -> Machine:
    """The machine of a file that was read."""
    from leanboom.io.checks import check_machine
    from leanboom.io.schema import SHARED, MachineKeys

    keys = _section(MachineKeys, source)
    check_machine(source)
    name = _name(keys, source, path)
    source.report()
    assert keys is not None  # else reported
    ranges = {joint: ends for joint, ends in asdict(keys.joints).items() if ends is not None}
    given = {key: value for key, value in asdict(keys.simulation).items() if value is not None}
    return Machine(
        name=name,
        joints=tuple(Joint(joint, *ends) for joint, ends in ranges.items()),
        cylinders=tuple(_cylinder(joint, getattr(keys.cylinders, joint), ends) for joint, ends in ranges.items()),
        bodies=tuple(Body(name=name, **asdict(body)) for name, body in keys.bodies.items()),
        payload_along=keys.payload.along,
        payload_above=keys.payload.above,
        pump=keys.pump,
        coriolis=keys.dynamics.coriolis,
        slewing_inertia=keys.dynamics.slewing_inertia,
        circuit=replace(keys.valve.circuit, **given),
        provenance=_provenance(source),
        **{name: getattr(keys, name) for name in SHARED},
    )


def _name(keys: object, source: Source, path: Path) -> str:
    """The name that a file gives, or one made of its own name; that neither does is noted as a problem."""
    from leanboom.quantities.rules import Name

    name = getattr(keys, "name", None) or Name.made_of(path.stem)
    if not name:
        missing = " is missing, and the file's name has no letter or digit to make one of"
        source.add(("name",), missing, Name().allowed)
    return name


def _cylinder(name: str, keys: Any, ends: tuple[float, float]) -> Cylinder:
    from leanboom.io.checks import areas, size, stroke
    from leanboom.io.schema import AREAS

    found = areas(size(keys))
    assert found is not None  # checked
    values = {field.name: getattr(keys, field.name) for field in fields(Cylinder) if field.name != "name"}
    values |= zip(AREAS, found, strict=True)
    if keys.stroke is None:
        values["stroke"] = stroke(keys.linkage, *ends)
    return Cylinder(name, **values)


def _provenance(source: Source) -> tuple[Provenance, ...]:
    from leanboom.io.yaml_source import dotted, shown

    return tuple(
        Provenance(dotted(key), shown(source.value(key)), *status)
        for key, status in source.statuses().items()
        if key[-1] not in _STRUCTURE and source.value(key) not in (None, "")  # nothing written: the default holds
    )


def _section(made: type, source: Source) -> Any:
    """The instance made of a file's data; None if problems were noted."""
    from pydantic import ValidationError

    from leanboom.quantities.declarations import Section

    try:
        return Section(made).load(source.data)
    except ValidationError as error:
        for line in error.errors(include_url=False):
            context, key = line.get("ctx", {}), line["loc"]
            key = (*key, context["key"]) if context["key"] else key
            if line["type"] == "missing":
                source.add(key, " is missing", context["allowed"])
            elif line["type"] == "counted":
                source.add(key, f" has {len(cast(Sized, source.value(key)))} entries", context["allowed"])
            elif line["type"] == "unknown":
                source.add(key, " is not a key here", f"valid keys: {context['allowed']}")
            elif key and key[-1] == "[key]":  # pydantic's word for a wrong key of a mapping
                source.add(key[:-1], " has a wrong name", context["allowed"])
            elif key:
                source.refuse(key, context["allowed"])
            else:
                source.add((), "", f"the file {context['allowed']}")
        return None
