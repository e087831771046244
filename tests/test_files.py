"""Files: bundled data against the printed numbers, what files mean, round trips, schemas."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import fields, replace
from math import pi
from pathlib import Path

import numpy as np
import pytest

from bundled_texts import FORWARDER, HALF_CYCLE, written
from leanboom.components.linkages import Polynomial
from leanboom.components.valves import METERING, Connection, MobileValve
from leanboom.errors import InputError
from leanboom.io.loading import (
    bundled_machines,
    bundled_tasks,
    dump_machine,
    dump_task,
    json_schema,
    load_machine,
    load_task,
)
from leanboom.io.yaml_source import parse
from leanboom.model.machine import Machine
from leanboom.model.task import Lines, Spline, sample
from leanboom.quantities.units import KINDS, slip, write
from leanboom.quantities.units import parse as quantity


def part(machine, name):
    """The cylinder and the joint of a name."""
    index = machine.names.index(name)
    return machine.cylinders[index], machine.joints[index]


# Bundled files


def test_the_bundled_files_are_these():
    assert bundled_machines() == ("forwarder", "loader")
    assert bundled_tasks() == (
        "forwarder-cycle",
        "forwarder-half-cycle",
        "forwarder-horizontal",
        "forwarder-vertical",
        "loader-cycle",
        "loader-triangle-large",
        "loader-triangle-medium",
        "loader-triangle-small",
    )


def test_forwarder_areas_are_those_of_its_printed_diameters():
    machine = load_machine("forwarder")
    areas = [(1e4 * c.piston_area, 1e4 * c.rod_side_area) for c in machine.cylinders]
    expected = [(103.87, 103.87), (113.10, 74.61), (103.87, 75.59), (38.48, 22.58)]
    np.testing.assert_allclose(areas, expected, atol=0.006)
    assert [c.connection for c in machine.cylinders] == [
        Connection.STANDARD,
        Connection.SINGLE_ACTING,
        Connection.STANDARD,
        Connection.DIFFERENTIAL,
    ]


def test_forwarder_limits_pump_and_masses_are_the_stated_ones():
    machine = load_machine("forwarder")
    assert [c.velocity_limit for c in machine.cylinders] == [0.10, 0.15, 0.15, 0.40]
    assert [c.acceleration_limit for c in machine.cylinders] == [0.4] * 4
    assert [(j.lower, j.upper) for j in machine.joints] == [(-pi, pi), (-0.425, 1.097), (-2.75, -0.25), (0.0, 3.7)]
    assert [c.friction.coulomb for c in machine.cylinders] == [15e3, 6e3, 5e3, 3e3]
    assert machine.cylinders[3].friction.steps == (0.8, 1.3, 2.2, 2.7)
    assert [c.friction.joint_velocity for c in machine.cylinders] == [False, False, False, True]
    assert machine.valve == MobileValve(0.7e6, 1.5, 1.9, 1.0)
    pump = machine.pump
    assert (pump.constant_pressure, pump.ls_margin, pump.max_pressure, pump.tank_pressure) == (20e6, 3e6, 21.5e6, 0.0)
    assert pump.max_flow == pytest.approx(325e-3 / 60, rel=1e-15)
    assert machine.driven_velocity == 0.002
    total = sum(body.mass for body in machine.bodies if body.name != "grapple")
    assert total == 1335.0
    # The printed reach: 9.1 m from the slewing axis, tilt at its upper end, fully out.
    g, tilt, out = machine.geometry, machine.joints[2].upper, machine.joints[3].upper
    reach = abs(g.boom + (g.outer + out + 1j * g.offset) * np.exp(1j * tilt)) + g.base_x
    assert reach == pytest.approx(9.1, abs=1e-3)


def test_loader_masses_add_up_to_the_printed_ones_with_the_load():
    machine, task = load_machine("loader"), load_task("loader-triangle-large")
    bodies = {body.name: body for body in machine.bodies}
    assert (bodies["lift_boom"].mass, bodies["tilt_boom"].mass) == (80.11, 33.93)
    assert bodies["extension_boom"].mass + task.payload == pytest.approx(570.19, abs=1e-9)
    assert bodies["extension_boom"].along == machine.payload_along == 1.856
    rods = [80.11 * 1.6**2 / 12, 33.93 * 1.562**2 / 12, 95.19 * 1.562**2 / 12]
    assert [body.inertia for body in machine.bodies] == pytest.approx(rods, abs=6e-4)
    assert not machine.geometry.slewing
    assert machine.names == ("lift", "tilt", "extension")


LENGTHS = [
    # Equally spaced over the joint's range: length [m], torque arm [m].
    ("loader", "lift", [0.78275, 0.94017, 1.09779, 1.23178, 1.32775], [0.33741, 0.37606, 0.34431, 0.27023, 0.17061]),
    ("loader", "tilt", [0.83000, 0.92664, 1.08842, 1.25248, 1.37663], [0.07539, 0.25342, 0.30901, 0.26868, 0.17094]),
    ("forwarder", "lift", [0.91000, 1.05446, 1.22091, 1.38208, 1.52000], [0.31960, 0.42295, 0.44011, 0.39928, 0.32065]),
    (
        "forwarder",
        "tilt",
        [1.74000, 1.64840, 1.52678, 1.37310, 1.19397, 1.01500],
        [-0.15656, -0.21173, -0.27560, -0.33719, -0.37158, -0.32252],
    ),
]


@pytest.mark.parametrize(("machine", "name", "lengths", "arms"), LENGTHS)
def test_linkages_have_the_tabled_lengths_and_arms(machine, name, lengths, arms):
    actuator, joint = part(load_machine(machine), name)
    length, arm, _ = actuator.linkage.length_arm_slope(np.linspace(joint.lower, joint.upper, len(lengths)))
    np.testing.assert_allclose(length, lengths, atol=2e-5)
    np.testing.assert_allclose(arm, arms, atol=2e-5)


@pytest.mark.parametrize("name", ["forwarder", "loader"])
def test_every_length_change_is_the_printed_stroke(name):
    """The loader's tilt is the one that eq. (30) and the public retracted length set: 1.6 mm more than printed."""
    machine = load_machine(name)
    printed = {"forwarder": [0.720, 0.610, 0.725, 1.850], "loader": [0.545, 0.545, 1.040]}[name]
    assert [c.stroke for c in machine.cylinders] == printed
    for actuator, joint in zip(machine.cylinders, machine.joints, strict=True):
        length, _, _ = actuator.linkage.length_arm_slope(np.array([joint.lower, joint.upper]))
        assert abs(length[1] - length[0]) == pytest.approx(
            actuator.stroke, abs=2e-3 if (name, actuator.name) == ("loader", "tilt") else 1e-4
        )


def test_the_quintic_of_the_tilt_linkage_is_as_close_as_stated():
    machine = load_machine("forwarder")
    tilt, joint = part(machine, "tilt")
    quintic = Polynomial((0.002866, 0.030668, 0.126368, 0.188005, -0.255217, 0.941039))
    q = np.linspace(joint.lower, joint.upper, 501)
    exact, fitted = tilt.linkage.length_arm_slope(q), quintic.length_arm_slope(q)
    assert np.abs(exact[0] - fitted[0]).max() == pytest.approx(0.26e-3, abs=0.02e-3)
    assert np.abs(exact[1] - fitted[1]).max() == pytest.approx(4.8e-3, abs=0.1e-3)


PATHS = [
    # Duration [s], peak speed [m/s], first and last point [m], payload [kg].
    ("forwarder-horizontal", 10.0, 0.600, (4.0, 0.0, 2.0), (7.2, 0.0, 2.0), 0.0),
    ("forwarder-vertical", 6.0, 0.950, (5.5, 0.0, 4.64), (5.5, 0.0, 1.60), 0.0),
    ("forwarder-half-cycle", 15.0, 0.750, (4.30, 0.0, 2.50), (2.10, 5.50, 1.30), 0.0),
    ("loader-triangle-large", 30.0, 0.553, (3.11, 0.0, 0.42), (3.11, 0.0, 0.42), 475.0),
    ("loader-triangle-medium", 30.0, 0.553 * 2 / 3, (2.263333, 0.0, 0.42), (2.263333, 0.0, 0.42), 475.0),
    ("loader-triangle-small", 30.0, 0.553 / 3, (1.416667, 0.0, 0.42), (1.416667, 0.0, 0.42), 475.0),
]


@pytest.mark.parametrize(("name", "duration", "peak", "first", "last", "payload"), PATHS)
def test_tasks_have_the_printed_duration_and_peak_speed(name, duration, peak, first, last, payload):
    task = load_task(name)
    speed = np.linalg.norm(sample(task, np.linspace(0.0, duration, 3001)).velocity, axis=1)
    assert task.duration == duration
    assert speed.max() == pytest.approx(peak, abs=1e-3)
    assert (task.path.points[0], task.path.points[-1]) == (first, last)
    assert (task.name, task.payload, task.start, task.smooth) == (name, payload, "smallest", None)


@pytest.mark.parametrize("name", ["forwarder", "loader"])
def test_every_value_of_a_bundled_machine_states_where_it_comes_from(name):
    provenance = load_machine(name).provenance
    assert [entry.key for entry in provenance if entry.status == "unstated"] == []
    entries = {entry.key: entry for entry in provenance}
    assert len(entries) == len(provenance)
    assert entries["geometry.boom"].status == "printed"
    assert entries["cylinders.lift.linkage.angle"].status == "derived"
    assert entries["gravity"].status == "assumed"


# What files mean


def test_a_value_without_a_status_is_unstated_and_a_comment_speaks_for_its_line(tmp_path):
    text = FORWARDER.replace("boom: 3.504 m        # printed: Table 2", "boom: 3.504 m  # long ago printed")
    text = text.replace(
        "[-0.425 rad, 1.097 rad]       # printed: Table 3", "[-0.425 rad,   # identified: by protractor\n 1.097 rad]"
    )
    entries = {entry.key: entry for entry in load_machine(written(tmp_path, text)).provenance}
    assert (entries["geometry.boom"].status, entries["geometry.boom"].value) == ("unstated", "3.504 m")
    assert (entries["joints.lift[0]"].status, entries["joints.lift[0]"].note) == ("identified", "by protractor")
    assert entries["joints.lift[1]"].status == "unstated"
    assert entries["joints.tilt[1]"].status == "printed"
    assert "cylinders.lift.linkage.type" not in entries


def test_a_bare_number_is_si_and_quantities_round_once(tmp_path):
    text = FORWARDER.replace("max_flow: 325 l/min", "max_flow: 0.005").replace("bore: 120 mm", "bore: 1.2e-1")
    machine = load_machine(written(tmp_path, text))
    assert machine.pump.max_flow == 0.005
    assert machine.cylinders[1].piston_area == load_machine("forwarder").cylinders[1].piston_area
    assert quantity("610 mm", KINDS["length"]) == 0.61
    assert quantity("103.87 cm^2", KINDS["area"]) == 0.010387
    assert quantity("21.5 MPa", KINDS["pressure"]) == 21.5e6
    assert quantity("215 bar", KINDS["pressure"]) == 21.5e6
    assert quantity("180 deg", KINDS["angle"]) == pi
    assert quantity("50 %", KINDS["number"]) == 0.5
    assert quantity("330 N*s/m", KINDS["viscous friction"]) == 330.0


@pytest.mark.parametrize(
    "text",
    ["1 km/h", "0.1 rad", "1 m^2", "one m", "1 m m", "1,5 m", "0x10", "1_0", "", "m", "1e999", "1 m^9^9^9", "1e16",
     "٦ m", "６１０ mm", "६ m", "6 m^２", "1e٣ m", "−5 m"],
)  # fmt: skip
def test_these_are_no_lengths(text):
    assert quantity(text, KINDS["length"]) is None


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_written_quantities_read_back_equal(kind, rng):
    values = [0.0, 1.0, 1 / 3, -1e-9, 2e14, *rng.normal(size=20)]
    assert [quantity(write(value, kind), kind) for value in values] == values
    assert quantity(kind.example, kind) is not None


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_every_unit_that_messages_name_is_read_and_documented(kind):
    assert all(quantity(f"1 {unit}", kind) is not None for unit in kind.units)
    page = (Path(__file__).parents[1] / "docs" / "files.md").read_text(encoding="utf-8")
    assert f"| {kind.name} | {', '.join(f'`{unit}`' for unit in kind.units)} |" in page


UNKNOWN = {
    "10 in": ("length", "in", ""),
    "10 inch": ("length", "inch", ""),
    "10 mmm": ("length", "mmm", ""),
    "10 cm²": ("area", "cm²", "cm^2"),
    "10 psi": ("pressure", "psi", ""),
    "10 kp/cm^2": ("pressure", "kp", ""),
    "10 Bar": ("pressure", "Bar", "bar"),
    "21 mpa": ("pressure", "mpa", "MPa"),
    "10 gal/min": ("flow", "gal", ""),
    "10 L/Min": ("flow", "Min", "l/min"),
    "10 KG": ("mass", "KG", "kg"),
    "10 °": ("angle", "°", ""),
    "330 Ns/m": ("viscous friction", "Ns", "N s/m"),
    "1800 1/min": ("rotational speed", "1/min", ""),
    "2 m/s2": ("acceleration", "m/s2", "m/s^2"),
}


@pytest.mark.parametrize(("text", "expected"), UNKNOWN.items(), ids=UNKNOWN)
def test_a_unit_that_is_none_here_is_named(text, expected):
    kind, part, meant = expected
    assert quantity(text, KINDS[kind]) is None
    assert slip(text, KINDS[kind]) == f"; {part} is not a unit here{f', did you mean {meant}?' if meant else ''}"


def test_the_wrong_kind_of_unit_is_still_a_unit():
    assert slip("10 rad", KINDS["length"]) == ""
    assert slip("0.5 m", KINDS["number"]) == ""


@pytest.mark.parametrize("name", bundled_machines())
def test_a_stroke_that_is_left_out_is_the_change_of_length(tmp_path, name):
    whole = load_machine(name)
    text = "".join(line for line in dump_machine(whole).splitlines(True) if not line.startswith("    stroke:"))
    machine = load_machine(written(tmp_path, text))
    for mine, theirs, joint in zip(machine.cylinders, whole.cylinders, machine.joints, strict=True):
        ends = [float(mine.linkage.length_arm_slope(q)[0]) for q in (joint.lower, joint.upper)]
        assert mine.stroke == pytest.approx(abs(ends[1] - ends[0]), rel=1e-12)
        assert mine.stroke == pytest.approx(theirs.stroke, abs=2e-3)
    again = dump_machine(machine)
    assert "stroke:" not in again
    assert load_machine(written(tmp_path, again)) == machine


def test_a_stroke_that_was_changed_in_python_is_written(tmp_path):
    machine = load_machine("loader")
    text = "".join(line for line in dump_machine(machine).splitlines(True) if not line.startswith("    stroke:"))
    machine = load_machine(written(tmp_path, text))
    lift = replace(machine.cylinders[0], stroke=0.546)
    changed = dump_machine(replace(machine, cylinders=(lift, *machine.cylinders[1:])))
    assert changed.count("stroke: 0.546 m") == 1
    assert load_machine(written(tmp_path, changed)).cylinders[0].stroke == 0.546


def test_two_racks_double_the_base_areas(tmp_path):
    one, two = load_machine("forwarder"), load_machine(written(tmp_path, FORWARDER.replace("racks: 1 ", "racks: 2 ")))
    assert two.cylinders[0].piston_area == 2.0 * one.cylinders[0].piston_area
    assert two.cylinders[0].rod_side_area == 2.0 * one.cylinders[0].rod_side_area


def test_a_task_names_a_machine_file_relative_to_itself(tmp_path, monkeypatch):
    folder = tmp_path / "crane"
    folder.mkdir()
    written(folder, FORWARDER.replace("name: forwarder\n", "").replace("3.504 m", "3.6 m"), "mine.yaml")
    task = written(folder, HALF_CYCLE.replace("machine: forwarder", "machine: mine.yaml"), "short-cycle.yaml")
    monkeypatch.chdir(tmp_path)
    loaded = load_task("crane/short-cycle.yaml")
    assert loaded.machine.geometry.boom == 3.6
    assert (loaded.name, loaded.machine.name) == ("short-cycle", "mine")
    assert loaded.source == task.read_text()


@pytest.mark.parametrize(("start", "expected"), [("best", "best"), ("30 cm", 0.3), (0.25, 0.25), (None, "smallest")])
def test_a_start_given_by_the_caller_replaces_the_files(start, expected):
    assert load_task("forwarder-horizontal", start=start).start == expected


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ("fast", "start = fast; must be smallest, middle, best, or a length of the redundant cylinder such as 0.3 m"),
        (-1, "start = -1; must be smallest, middle, best, or a length of the redundant cylinder such as 0.3 m"),
        (5.0, "start = 5; must be from 0 to 1.85 m, the stroke of the extension cylinder"),
    ],
)
def test_a_wrong_start_is_refused(start, message):
    with pytest.raises(InputError) as caught:
        load_task("forwarder-horizontal", start=start)
    assert str(caught.value) == message


# Round trips


@pytest.mark.parametrize("name", bundled_tasks())
def test_a_dumped_task_and_machine_load_equal(tmp_path, name):
    task = replace(load_task(name), smooth=5.0, start=1 / 3)
    written(tmp_path, dump_machine(task.machine), "machine.yaml")
    again = load_task(written(tmp_path, dump_task(task), "task.yaml"))
    assert again == task
    assert again.machine.provenance == task.machine.provenance
    assert dump_machine(again.machine) == dump_machine(task.machine)


def test_a_changed_value_is_dumped_in_si_units_without_its_old_status(tmp_path):
    machine = load_machine("forwarder")
    lift = replace(machine.cylinders[1], piston_area=0.012, velocity_limit=0.2)
    changed = replace(machine, cylinders=(machine.cylinders[0], lift, *machine.cylinders[2:]), gravity=9.81)
    text = dump_machine(changed)
    again = load_machine(written(tmp_path, text))
    assert replace(again, provenance=()) == replace(changed, provenance=())
    statuses = {entry.key: entry.status for entry in again.provenance}
    assert statuses["cylinders.lift.piston_area"] == statuses["cylinders.lift.velocity_limit"] == "unstated"
    assert statuses["gravity"] == "unstated"
    assert statuses["cylinders.tilt.bore"] == "printed"
    assert "    bore: 115 mm  # printed: Table 1\n" in text


def test_a_machine_that_no_file_could_hold_is_not_dumped():
    machine = load_machine("loader")
    with pytest.raises(InputError) as caught:
        dump_machine(replace(machine, name="a loader"))
    assert str(caught.value).startswith("machine a loader: name = a loader; must be up to 64 letters, digits")


# Schema and start-up


def closed(schema):
    """Whether every object of a schema refuses unknown keys, or names them freely as bodies do."""
    objects = [schema, *schema["$defs"].values()]
    return all(part.get("additionalProperties") is False for part in objects)


def test_the_schemas_know_every_key_of_the_bundled_files():
    for kind, text in (("machine", FORWARDER), ("task", HALF_CYCLE)):
        schema = json_schema(kind)
        data = parse(text, "file").data
        assert set(data) <= set(schema["properties"])
        assert set(schema["required"]) <= set(data)
        assert closed(schema)
    machine = json_schema("machine")
    geometry = machine["$defs"]["Geometry"]
    assert geometry["required"] == ["base_x", "base_z", "boom", "offset", "outer", "slewing"]
    assert geometry["properties"]["boom"]["type"] == ["string", "number"]
    assert machine["$defs"]["CylinderKeys"]["properties"]["connection"]["enum"] == [
        "standard",
        "single_acting",
        "differential",
    ]


def test_an_unknown_schema_is_refused():
    with pytest.raises(InputError, match="^schema = crane; must be machine, task$"):
        json_schema("crane")  # type: ignore[arg-type]


def test_importing_files_loads_nothing_heavy():
    heavy = {"numpy", "scipy", "pydantic", "ruamel", "pint", "numba"}
    code = f"import sys, leanboom.io.loading; print(*{heavy} & set(sys.modules))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == ""


def test_the_kinds_of_path_are_told_apart():
    assert isinstance(load_task("forwarder-half-cycle").path, Spline)
    assert isinstance(load_task("forwarder-vertical").path, Lines)


def test_the_examples_of_the_documentation_load(tmp_path):
    page = (Path(__file__).parents[1] / "docs/files.md").read_text()
    blocks = page.split("```yaml\n")[1:]
    machine, cycle, task = [
        text.split("```")[0] for text in blocks if "start: best" in text or "yard" in text.split("```")[0]
    ]
    crane = load_machine(written(tmp_path, machine, "yard-crane.yaml"))
    assert (crane.name, crane.pump.efficiency, crane.pump.ls_margin) == ("yard-crane", 0.85, 2e6)
    unload = load_task(written(tmp_path, task, "unload.yaml"))
    assert (unload.machine, unload.start, unload.smooth) == (crane, "best", 5.0)
    legs = load_task(written(tmp_path, cycle, "cycle.yaml")).legs
    assert [(leg.payload, leg.dwell) for leg in legs] == [(0.0, 0.0), (250.0, 2.0)]


def test_what_a_machine_says_of_the_simulation_counts_and_the_rest_follows_its_valve(tmp_path):
    text = dump_machine(load_machine("loader"))
    head, tail = text.split("simulation:\n")
    tail = tail.split("\n\n", 1)[1]
    bare = load_machine(Path(written(tmp_path, head + tail)))
    assert bare.circuit == METERING
    assert "simulation:" not in dump_machine(bare)
    some = f"{head}simulation:\n  delay: 20 ms  # identified: step of the valve\n  dead_zone: 4 %\n\n{tail}"
    machine = load_machine(Path(written(tmp_path, some)))
    assert machine.circuit == replace(METERING, delay=0.02, dead_zone=0.04)
    assert "  delay: 20 ms  # identified: step of the valve\n" in dump_machine(machine)
    changed = replace(machine, circuit=replace(machine.circuit, bulk_modulus=1.2e9))
    assert load_machine(Path(written(tmp_path, dump_machine(changed)))).circuit == changed.circuit


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("yard.v2.yaml", "yard-v2"),
        ("my task (1).yaml", "my-task-1"),
        ("K\u00fcbel \u00d8 [\u00e4lt].yaml", "Kubel-alt"),
        ("._-draft.yaml", "draft"),
        (f"{'x' * 100}.yaml", "x" * 64),
    ],
)
def test_any_file_name_gives_a_name_that_can_be_written_again(tmp_path, file, name):
    """Such files were planned, and refused when the run folder was written."""
    task, machine = load_task("forwarder-vertical"), load_machine("forwarder")
    for text in (dump_task(task, f"M {file}"), dump_machine(machine)):
        own = re.sub(r"^name: .*\n", "", text, flags=re.MULTILINE)
        assert own != text
        (tmp_path / (f"M {file}" if "geometry" in own else file)).write_text(own, encoding="utf-8")
    loaded = load_task(tmp_path / file)
    assert loaded.name == name and loaded.machine.name.startswith("M-")
    (tmp_path / "machine.yaml").write_text(dump_machine(loaded.machine), encoding="utf-8")
    (tmp_path / "task.yaml").write_text(dump_task(loaded), encoding="utf-8")
    assert load_task(tmp_path / "task.yaml") == loaded


@pytest.mark.parametrize("file", ["\u65e5\u672c.yaml", "---.yaml"])
def test_a_file_name_without_letters_needs_a_name_inside(tmp_path, file):
    text = dump_task(load_task("forwarder-vertical"), "forwarder")
    (tmp_path / file).write_text(text, encoding="utf-8")
    assert load_task(tmp_path / file).name == "forwarder-vertical"
    (tmp_path / file).write_text(text.replace("name: forwarder-vertical\n", ""), encoding="utf-8")
    with pytest.raises(InputError, match=r"name is missing, and the file's name has no letter or digit"):
        load_task(tmp_path / file)


def test_a_key_without_a_value_is_as_good_as_absent(tmp_path):
    for nothing in ("", "~", "null", "\u2028"):
        path = tmp_path / "machine.yaml"
        path.write_text(FORWARDER.replace("dead_volume: 1 l ", f"dead_volume: {nothing}\n#"), encoding="utf-8")
        loaded = load_machine(path)
        assert all(entry.key != "simulation.dead_volume" for entry in loaded.provenance)
        path.write_text(dump_machine(loaded), encoding="utf-8")
        assert load_machine(path) == loaded


def test_gravity_is_the_same_by_default_in_a_file_and_in_python(tmp_path):
    """9.80665 m/s^2, standard gravity, was 9.81 m/s^2 where a machine was made in Python."""
    text = re.sub(r"\ngravity:.*", "", dump_machine(load_machine("loader")))
    assert "gravity" not in text
    file = tmp_path / "loader.yaml"
    file.write_text(text, encoding="utf-8")
    stated = {f.name: getattr(load_machine("loader"), f.name) for f in fields(Machine) if f.name != "gravity"}
    assert load_machine(str(file)).gravity == Machine(**stated).gravity == 9.80665
