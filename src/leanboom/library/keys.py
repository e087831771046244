"""Keys of stored motions: digests of everything that a motion depends on, and of nothing else.

A changed number of a machine file changes the keys of exactly the motions that it has a part in: the constant supply
pressure those of the constant-pressure pump, where a payload hangs those that carry one, names and remarks none.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any

from leanboom.methods.registry import GRID, STEP
from leanboom.model.machine import Machine
from leanboom.model.task import Task

UNUSED = ("name", "description", "circuit", "provenance")  # of a machine: words, and what simulation alone knows
OTHER_PUMP = {"ls": "constant_pressure", "cp": "ls_margin"}  # what a motion for a pump does not depend on
HUNG = ("payload_along", "payload_above")
ALWAYS = ("path", "payload", "start", "end", "smooth")  # of a task; of all else, what is as by default is left out
METHOD = "warm-started dp 1"  # changes when motions of earlier builds should be planned again


def plain(value: Any, without: tuple[str, ...] = ()) -> Any:
    """A value as JSON can hold it, dataclasses with their type: equal values give equal texts.

    Args:
        value: The value.
        without: Fields of the outermost dataclass that are left out.
    """
    if isinstance(value, Enum):
        return value.value
    if is_dataclass(value) and not isinstance(value, type):
        held = {each.name: plain(getattr(value, each.name)) for each in fields(value) if each.name not in without}
        return {"": type(value).__name__, **held}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    return value


def machine_key(machine: Machine, pump: str, loaded: bool) -> str:
    """The digest of a machine as motions for a pump depend on it.

    Args:
        machine: The machine.
        pump: "ls" or "cp".
        loaded: Whether the motions carry a payload.
    """
    described = plain(machine, UNUSED if loaded else UNUSED + HUNG)
    del described["pump"][OTHER_PUMP[pump]]
    return _digest(described)


def machine_keys(machine: Machine) -> dict[tuple[str, bool], str]:
    """The digests of a machine by pump and by whether there is a payload.

    Args:
        machine: The machine.
    """
    return {(pump, loaded): machine_key(machine, pump, loaded) for pump in OTHER_PUMP for loaded in (False, True)}


def motion_key(task: Task, pump: str, machine: str) -> str:
    """The key of a motion.

    Args:
        task: Its task.
        pump: "ls" or "cp".
        machine: The digest of its machine.
    """
    # So tasks may get new fields, and those that do not use them keep their keys.
    usual = [e.name for e in fields(task) if e.name not in ALWAYS and getattr(task, e.name) == e.default]
    asked = plain(task, ("name", "machine", "source", *usual))
    return _digest([machine, asked, pump, METHOD, GRID, STEP])


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True, allow_nan=False).encode()).hexdigest()[:32]
