"""What a log may hold: channels, their units, and how the columns of a file are matched with them.

A channel is a quantity of the machine, or of a joint with its name before it: `lift_position`, `lift_pressure_a`,
`supply`. `leanboom simulate` writes columns under these names; those of other logs are named in a column map.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from leanboom.errors import InputError
from leanboom.model.machine import Machine
from leanboom.quantities.rules import suggestion
from leanboom.quantities.units import KINDS, Kind, parse, slip

TIME = "time"
JOINT_CHANNELS = {
    "position": "angle of the joint, or travel of the extension",
    "cylinder": "length of the cylinder from pin to pin",
    "pressure_a": "pressure on the piston side",
    "pressure_b": "pressure on the rod side",
    "command": "command of the valve as a share of the full one, above 0 extending",
}
MACHINE_CHANNELS = {
    "supply": "pressure of the pump",
    "tank": "pressure of the return line",
    "pump_flow": "flow of the pump",
    "pump_volume": "volume that the pump has delivered so far",
}
_KINDS = {
    "time": "time", "cylinder": "length", "pressure_a": "pressure", "pressure_b": "pressure", "command": "number",
    "supply": "pressure", "tank": "pressure", "pump_flow": "flow", "pump_volume": "volume",
}  # fmt: skip
_ENDINGS = {
    "s": "s", "rad": "rad", "deg": "deg", "m": "m", "mm": "mm", "pa": "Pa", "bar": "bar", "mpa": "MPa",
    "m3_s": "m^3/s", "l_min": "l/min", "m3": "m^3", "l": "l",
}  # fmt: skip
_HEADER = re.compile(r"(?P<name>.*?)\s*[\[(](?P<unit>[^\])]*)[\])]")
_KEYS = ("column", "unit", "scale", "zero")


@dataclass(frozen=True, slots=True)
class Column:
    """Where a channel stands in a file: value in SI units = factor x (as written - zero)."""

    channel: str
    name: str  # of the column, as the file has it
    unit: str  # as stated or taken
    factor: float
    zero: float = 0.0


def kind_of(channel: str) -> Kind:
    """What a channel measures.

    Args:
        channel: Its name.
    """
    last = next((_KINDS[each] for each in _KINDS if channel == each or channel.endswith(f"_{each}")), None)
    return KINDS[last or ("length" if channel.startswith("extension") else "angle")]


def channels_of(machine: Machine) -> dict[str, str]:
    """All channels of a machine's logs and what each is.

    Args:
        machine: The machine.
    """
    joints = {f"{joint}_{name}": text for joint in machine.names for name, text in JOINT_CHANNELS.items()}
    return {TIME: "time", **joints, **MACHINE_CHANNELS}


def read_map(path: Path, machine: Machine) -> dict[str, dict[str, Any]]:
    """A column map: for each channel its `column`, and where needed `unit`, `scale` and `zero`.

    Args:
        path: The YAML file.
        machine: The machine whose channels it names.

    Raises:
        InputError: It cannot be read, or names what there is not.
    """
    from leanboom.io.yaml_source import read

    source = read(path, str(path))
    known = channels_of(machine)
    if not isinstance(source.data, dict):
        raise InputError(f"{path}: must be a mapping of channels to columns, such as lift_position: z1 [deg]")
    found: dict[str, dict[str, Any]] = {}
    for channel, given in source.data.items():
        key = (channel,)
        entry = {"column": given} if isinstance(given, str) else given
        if channel not in known:
            source.add(key, " is no channel", suggestion(channel, tuple(known)))
        elif not isinstance(entry, dict) or not isinstance(entry.get("column"), str):
            source.refuse(key, "must be the name of a column, or a mapping with the keys " + ", ".join(_KEYS))
        elif strange := [name for name in entry if name not in _KEYS]:
            source.add((*key, strange[0]), " is not a key here", f"valid keys: {', '.join(_KEYS)}")
        else:
            numbers: dict[str, Any] = {"column": entry["column"], "unit": entry.get("unit")}
            for name, default in (("scale", 1.0), ("zero", 0.0)):
                value = default if name not in entry else parse(str(entry[name]), KINDS["number"])
                if value is None or (name == "scale" and value == 0.0):
                    source.refuse((*key, name), "must be a number" + (" other than 0" if name == "scale" else ""))
                numbers[name] = value
            found[channel] = numbers
    source.report()
    return found


def match(
    headers: Sequence[str], machine: Machine, named: Mapping[str, Mapping[str, Any]], file: str
) -> dict[str, Column]:
    """The columns of a file by channel.

    Args:
        headers: Names of the columns.
        machine: The machine.
        named: A column map; what it does not name is found by the names of the channels.
        file: The file as it is called in messages.

    Raises:
        InputError: A column of the map is not there, or its unit does not fit.
    """
    found: dict[str, Column] = {}
    problems = []
    taken = {entry["column"] for entry in named.values()}
    for channel, entry in named.items():
        name = entry["column"]
        if name not in headers:
            problems.append(
                f"{file}: column {name} of channel {channel} is missing; {suggestion(name, tuple(headers))}"
            )
            continue
        unit, kind = entry["unit"] or _stated(name), kind_of(channel)
        factor = _factor(unit, kind)
        if factor is None and not entry["unit"] and entry["scale"] != 1.0:
            unit, factor = "", 1.0  # such as volts of a command: the scale says what they mean
        if factor is None:
            other = "" if entry["unit"] else f"; or give a scale to {kind.unit or 'shares'}"
            problems.append(
                f"{channel}: unit = {unit}; must be {', '.join(kind.units)}{slip(f'1 {unit}', kind)}{other}"
            )
            continue
        found[channel] = Column(channel, name, unit or kind.unit, factor * entry["scale"], entry["zero"])
    if problems:
        raise InputError("\n".join(problems))
    known = channels_of(machine)
    for header in headers:
        if header in taken:
            continue
        for channel in known:
            if channel not in found and (column := _fits(header, channel)):
                found[channel] = column
                break
    if TIME not in found:
        raise InputError(
            f"{file}: no column of times; name one time_s, or give a column map with time: NAME. Columns here: "
            f"{', '.join(headers[:20])}{', ...' if len(headers) > 20 else ''}"
        )
    return found


def _fits(header: str, channel: str) -> Column | None:
    """The column, if a header names a channel: by its name, its name and [unit], or its name and an ending."""
    stated = _HEADER.fullmatch(header)
    base = (stated["name"] if stated else header).strip().lower()
    kind = kind_of(channel)
    unit = stated["unit"] if stated else ""
    stems = (channel, channel.removesuffix("_position"))
    if base == channel or (unit and base in stems):
        factor = _factor(unit, kind)
        return None if factor is None else Column(channel, header, unit or kind.unit, factor)
    for ending, unit in _ENDINGS.items():
        if base in {f"{stem}_{ending}" for stem in stems}:
            factor = _factor(unit, kind)
            return None if factor is None else Column(channel, header, unit, factor)
    return None


def _stated(header: str) -> str:
    """The unit in brackets at the end of a header; empty without one."""
    stated = _HEADER.fullmatch(header)
    return stated["unit"] if stated else ""


def _factor(unit: str | None, kind: Kind) -> float | None:
    """One of a unit in SI; None if it measures something else."""
    return parse(f"1 {unit}" if unit else "1", kind)
