"""Parts of a machine are declared once: a linkage and a valve from outside the package do all that the package's do."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, replace
from itertools import pairwise
from math import pi
from pathlib import Path
from typing import ClassVar

import pytest
from typer.testing import CliRunner

from leanboom.cli.app import app
from leanboom.components.circuits import Circuit
from leanboom.components.linkages import LINKAGES, Linkage
from leanboom.components.paths import PATHS, Lines, Retimed, Spline
from leanboom.components.valves import METERING, VALVES, Edges, IndependentMetering, Valve, drive_of
from leanboom.errors import InputError
from leanboom.evaluation.evaluate import evaluate
from leanboom.io import starter
from leanboom.io.loading import dump_machine, dump_task, json_schema, load_machine, load_task
from leanboom.io.schema import MachineKeys, TaskKeys
from leanboom.model.machine import Joints, Machine
from leanboom.model.motion import from_velocities
from leanboom.model.task import Task
from leanboom.quantities.declarations import Section, Variant, declared, meanings
from leanboom.quantities.ranges import Range
from leanboom.quantities.rules import Switch, Word
from leanboom.quantities.types import PositiveLength, Pressure
from leanboom.quantities.units import parse, write
from leanboom.simulation.closed_loop import simulate

LEAD = 2.0 * pi * 0.1146  # of the screw that moves the base as the forwarder's pinion does


@dataclass(frozen=True, slots=True)
class Screw(Linkage):
    """A nut on a screw that turns with the joint."""

    lead: PositiveLength
    """Travel per turn."""

    def length_arm_slope(self, q):
        """Length [m], signed torque arm and its slope at joint position q."""
        return self.lead / (2.0 * pi) * q, self.lead / (2.0 * pi) + 0.0 * q, 0.0 * q


@dataclass(frozen=True, slots=True)
class Throttled(Valve):
    """A valve that leaves the same pressure in every chamber that empties."""

    circuit: ClassVar[Circuit] = METERING
    controller: ClassVar[str] = "adaptive-robust"
    separate: ClassVar[bool] = True

    remaining: Pressure
    """In the chamber that empties."""

    def steady(self, cylinder, pump):
        """Flow areas and pressure lines of a cylinder on this valve."""
        return drive_of(cylinder, pump, self.remaining, self.remaining, 0.0)

    def edges(self, cylinder, circuit):
        """Compensated edges, as large as the circuit says."""
        k = circuit.edge_flow / circuit.edge_drop**0.5
        return Edges(True, circuit.edge_drop, k, k, k, k)

    def resting(self, pump, circuit):
        """The same pressure [Pa]."""
        return self.remaining


@pytest.fixture
def outside(monkeypatch):
    """The two under their names in files; a program of its own says `LINKAGES["screw"] = Screw`."""
    monkeypatch.setitem(LINKAGES, "screw", Screw)
    monkeypatch.setitem(VALVES, "throttled", Throttled)


def file_of(tmp_path, edits=()):
    """The forwarder's file, its base on a screw and its cylinders on throttled valves."""
    machine = load_machine("forwarder")
    text = dump_machine(replace(machine, valve=IndependentMetering(0.0, 0.0)))
    texts = [
        ("type: rack_and_pinion\n      arm: 0.1146 m", f"type: screw\n      lead: {LEAD!r} m"),
        (
            "type: independent_metering\n  back_pressure: 0 Pa\n  offside_pressure: 0 Pa",
            "type: throttled\n  remaining: 3 bar",
        ),
    ]
    for old, new in (*texts, *edits):
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def still(task, step=0.1):
    """A motion that holds the redundant cylinder."""
    return from_velocities(step, 0.8, [0.0] * (round(task.duration / step) + 1), "held", "cp")


def test_a_linkage_and_a_valve_from_outside_are_read_and_written(tmp_path, outside):
    machine = load_machine(file_of(tmp_path))
    assert machine.cylinders[0].linkage == Screw(LEAD)
    assert machine.valve == Throttled(3e5)
    assert machine.circuit == load_machine("forwarder").circuit
    (tmp_path / "again.yaml").write_text(dump_machine(machine), encoding="utf-8")
    assert load_machine(tmp_path / "again.yaml") == replace(machine, name="forwarder")
    assert f"      type: screw\n      lead: {LEAD!r} m  # derived: stroke" in dump_machine(machine)


def test_the_schema_and_the_new_file_know_them(outside):
    schema = json_schema("machine")
    assert {"$ref": "#/$defs/Screw"} in schema["$defs"]["CylinderKeys"]["properties"]["linkage"]["oneOf"]
    screw = schema["$defs"]["Screw"]
    assert screw["required"] == ["type", "lead"]
    assert screw["properties"]["type"] == {"const": "screw"}
    assert screw["properties"]["lead"] == {
        "description": "Travel per turn.",
        "title": "Lead",
        "type": ["string", "number"],
    }
    assert schema["$defs"]["Throttled"]["description"] == Throttled.__doc__
    assert "Type: mobile_valve, independent_metering, throttled." in starter.text("machine")


def test_a_motion_is_judged_on_them(tmp_path, outside):
    """The screw moves the base as the pinion did; the valve leaves 3 bar, as independent metering can."""
    file_of(tmp_path)
    task = load_task("forwarder-half-cycle")
    (tmp_path / "task.yaml").write_text(dump_task(task, "mine.yaml"), encoding="utf-8")
    known = replace(task.machine, valve=IndependentMetering(3e5, 0.0))
    found, expected = (
        evaluate(each, still(each)) for each in (load_task(tmp_path / "task.yaml"), replace(task, machine=known))
    )
    assert found.energy("cp") == pytest.approx(expected.energy("cp"), rel=1e-9)
    assert found.energy("ls") == pytest.approx(expected.energy("ls"), rel=1e-9)


BAD = {
    "its range": (f"lead: {LEAD!r} m", "lead: -1 m", "lead = -1 m; must be above 0"),
    "its keys": (
        f"lead: {LEAD!r} m",
        "leed: 1 m",
        "leed is not a key here; valid keys: type, lead; did you mean lead?",
    ),
    "its name": (
        "type: screw",
        "type: scew",
        "type = scew; must be rack_and_pinion, triangle, four_bar, polynomial, telescope, screw; did you mean screw?",
    ),
}


@pytest.mark.parametrize(("old", "new", "message"), BAD.values(), ids=BAD)
def test_they_are_held_to_what_they_declare(tmp_path, outside, old, new, message):
    with pytest.raises(InputError) as caught:
        load_machine(file_of(tmp_path, [(old, new)]))
    assert f"cylinders.base.linkage.{message}" in str(caught.value)


def test_in_python_they_are_held_to_the_same():
    with pytest.raises(InputError, match="^linkage.lead = 0 m; must be above 0$"):
        Screw(0.0)
    assert Throttled("3 bar").remaining == 3e5


def test_without_a_name_they_are_not_written():
    machine = load_machine("forwarder")
    with pytest.raises(InputError) as caught:
        dump_machine(replace(machine, valve=Throttled(0.0)))
    assert str(caught.value) == "type = Throttled; must be one of mobile_valve, independent_metering"


def test_a_valve_from_outside_is_simulated():
    """By its edges and under its own controller; independent metering that leaves the same pressures does the same."""
    task = replace(load_task("forwarder-vertical"), path=Lines(((5.5, 0.0, 4.0), (5.5, 0.0, 3.9)), (1.0,)))
    first, second = (
        simulate(each, still(each), pump="cp")
        for valve in (Throttled(3e5), IndependentMetering(0.0, 3e5))
        for each in [replace(task, machine=replace(task.machine, valve=valve, circuit=METERING))]
    )
    assert first.controller == "AdaptiveRobust" and first.energy > 0.0
    assert first.energy == second.energy and first.tool.tolist() == second.tool.tolist()


def test_a_valve_that_says_nothing_of_its_edges_is_not_simulated(monkeypatch):
    monkeypatch.delattr(Throttled, "edges")
    task = load_task("forwarder-vertical")
    task = replace(task, machine=replace(task.machine, valve=Throttled(0.0)))
    with pytest.raises(InputError, match="^valve = Throttled; has no `edges`, by which the simulation knows a valve$"):
        simulate(task, still(task), pump="cp")


# Command and documentation


@pytest.mark.parametrize("kind", ["machine", "task"])
def test_the_command_prints_the_schema(kind):
    result = CliRunner().invoke(app, ["schema", kind])
    assert (result.exit_code, result.stderr) == (0, "")
    assert json.loads(result.stdout) == json_schema(kind)


def tables(page):
    """The cells of a page's tables, row by row, by the heading above; the first row is that of column names."""
    found, heading = {}, ""
    for line in page.splitlines():
        if line.startswith("#"):
            heading = line.strip("# ")
        elif line.startswith("| ") and not line.startswith("| ---"):
            found.setdefault(heading, []).append([cell.strip() for cell in line.strip("|").split(" | ")])
    return found


TABLES = tables((Path(__file__).parents[1] / "docs" / "files.md").read_text(encoding="utf-8"))


def keys(section, prefix=""):
    """The single values of a section, by their keys."""
    return {f"{prefix}{name}": field for name, field in section.fields.items()}


def told(field):
    """How the second column begins: unit and range, or the words."""
    rule = field.rule
    if isinstance(rule, Range):
        unit = "" if rule.bounds.startswith("from") else rule.kind.unit  # its ends have units
        return ", ".join(part for part in (unit, rule.bounds) if part)
    if isinstance(rule, Word):
        return ", ".join(f"`{word}`" for word in rule.choices)
    return "switch" if isinstance(rule, Switch) else ""


def default(field):
    """What the second column says of a default."""
    if field.required or field.default in (None, ""):
        return "default"
    if isinstance(field.default, bool):
        return f"default `{str(field.default).lower()}`"
    return f"default {write(field.default, field.rule.kind) if field.default else 0}"


def of_machine(*names):
    """Sections of a machine file: their single values."""
    return {name: field for name, field in keys(Section(MachineKeys)).items() if name in names}


MACHINE = Section(MachineKeys).fields
VALVE_KEYS = {key: field for each in Variant(VALVES).sections for key, field in keys(each, "valve.").items()}
PARTS = {
    "Machine file": of_machine("name", "description", "gravity", "driven_velocity"),
    "geometry": keys(MACHINE["geometry"].rule),
    "bodies": keys(MACHINE["bodies"].rule.section_of(None)),
    "payload, valve, pump, dynamics": {
        **keys(MACHINE["payload"].rule, "payload."), **VALVE_KEYS, **keys(MACHINE["pump"].rule, "pump."),
        **keys(MACHINE["dynamics"].rule, "dynamics."),
    },
    "Efficiency map": keys(MACHINE["pump"].rule.fields["efficiency"].rule.section),
}  # fmt: skip


@pytest.mark.parametrize(("heading", "declared"), PARTS.items(), ids=PARTS)
def test_the_tables_of_the_files_page_hold_the_declared_keys_units_and_defaults(heading, declared):
    rows = [row for row in TABLES[heading][1:] if row[0] != "`valve.type`"]
    assert [name for row in rows for name in re.findall(r"`([\w.]+)`", row[0])] == list(declared)
    for row in rows:
        for name in re.findall(r"`([\w.]+)`", row[0]):
            field = declared[name]
            assert row[1].startswith(told(field)), f"{name}: {row[1]}; {told(field)}"
            assert (default(field) in row[1]) != field.required, f"{name}: {row[1]}; {default(field)}"


def test_the_cylinders_of_the_files_page_are_the_declared_ones():
    """Three tables below one heading: the cylinder's keys, the linkages', those of the friction."""
    cells = TABLES["cylinders"]
    starts = [i for i, row in enumerate(cells) if row[0] in ("key", "type")]
    cylinder, linkages, friction = (cells[a + 1 : b] for a, b in pairwise([*starts, len(cells)]))
    section = MACHINE["cylinders"].rule.fields["lift"].rule
    names = [name for row in cylinder for name in re.findall(r"`(\w+)`", row[0])]
    assert names == list(section.fields)
    for row in cylinder:
        first = re.findall(r"`(\w+)`", row[0])[0]
        assert row[1].startswith(told(section.fields[first])), f"{first}: {row[1]}"
    found = {row[0].strip("`"): re.findall(r"\w+", " ".join(re.findall(r"`([^`]+)`", row[1]))) for row in linkages}
    assert found == {each.tag: list(each.fields) for each in Variant(LINKAGES).sections}
    declared = keys(section.fields["friction"].rule)
    assert [row[0].strip("`") for row in friction] == list(declared)
    for row in friction:
        field = declared[row[0].strip("`")]
        assert row[1].startswith(told(field)) and (default(field) in row[1]) != field.required, row


def test_the_simulation_of_the_files_page_has_the_defaults_of_each_valve():
    rows = TABLES["simulation"][1:]
    declared = keys(MACHINE["simulation"].rule)
    assert [row[0].strip("`") for row in rows] == list(declared)
    for row in rows:
        name, rule = row[0].strip("`"), declared[row[0].strip("`")].rule
        assert row[1].startswith(told(declared[name])), f"{name}: {row[1]}; {told(declared[name])}"
        for cell, valve in zip(row[2:4], VALVES.values(), strict=True):
            assert parse(cell, rule.kind) == pytest.approx(getattr(valve.circuit, name), rel=1e-12), f"{name}: {cell}"


def test_the_task_of_the_files_page_has_the_declared_keys():
    paths = [f"path.{name}" for each in Variant(PATHS).sections for name in each.fields]
    task = keys(Section(TaskKeys))
    limits = keys(task.pop("limits").rule, "limits.")
    expected = [*list(task)[:3], "path.type", *dict.fromkeys(paths), *list(task)[4:], *limits]
    rows = TABLES["Task file"][1:]
    assert [row[0].strip("`") for row in rows] == expected
    for name in ("payload", "smooth"):
        row = next(row for row in rows if row[0] == f"`{name}`")
        assert row[1].startswith(told(task[name])) and (default(task[name]) in row[1]) != task[name].required, row


def test_keys_of_files_are_fields_of_machine_and_task():
    """What a key is called there is taken from where it is declared, with its range and its meaning."""
    for keys_made, part, prefix in ((TaskKeys, Task, ""), (MACHINE["payload"].rule.made, Machine, "payload_"),
                                    (MACHINE["dynamics"].rule.made, Machine, "")):  # fmt: skip
        shared = [name for name in declared(keys_made) if prefix + name in declared(part)]
        assert len(shared) >= 2
        for name in shared:
            given, own = declared(keys_made)[name].rule, declared(part)[prefix + name].rule
            assert (type(given), given.allowed) == (type(own), own.allowed)
            assert meanings(keys_made)[name] == meanings(part)[prefix + name]
    assert tuple(PATHS.values()) == (Lines, Spline, Retimed) and MACHINE["joints"].rule.made is Joints


def test_a_path_in_python_may_last_longer_than_in_a_file():
    path = Lines(((5.5, 0.0, 4.0), (5.5, 0.0, 3.0)), (5000.0,))
    with pytest.raises(InputError) as caught:
        dump_task(replace(load_task("forwarder-vertical"), path=path))
    assert "path.durations[0] = 5000.0; must be from 0.0001 s to 3600 s" in str(caught.value)
