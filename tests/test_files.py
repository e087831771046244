"""Files: bundled data against the printed numbers, round trips, and every bad file with its exact message."""

from __future__ import annotations

import random
import subprocess
import sys
from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np
import pytest

import leanboom
from leanboom.errors import InputError
from leanboom.files import (
    bundled_machines,
    bundled_tasks,
    dump_machine,
    dump_task,
    json_schema,
    load_machine,
    load_task,
)
from leanboom.linkages import cylinder
from leanboom.machine import METERING, Connection, MobileValve, Polynomial
from leanboom.source import MAX_BYTES, parse
from leanboom.task import Lines, Spline, sample
from leanboom.units import KINDS, write
from leanboom.units import parse as quantity

PACKAGE = Path(leanboom.__file__).parent
FORWARDER = (PACKAGE / "machines/forwarder.yaml").read_text()
HALF_CYCLE = (PACKAGE / "tasks/forwarder-half-cycle.yaml").read_text()
TRIANGLE = (PACKAGE / "tasks/loader-triangle-large.yaml").read_text()
TOP_KEYS = (
    "name, description, geometry, joints, cylinders, bodies, payload, valve, pump, driven_velocity, dynamics, "
    "simulation, gravity"
)
CYLINDER_KEYS = (
    "bore, rod, plunger, racks, piston_area, rod_side_area, stroke, linkage, connection, friction, velocity_limit, "
    "acceleration_limit"
)


def part(machine, name):
    """The cylinder and the joint of a name."""
    index = machine.names.index(name)
    return machine.cylinders[index], machine.joints[index]


# Bundled files


def test_the_bundled_files_are_these():
    assert bundled_machines() == ("forwarder", "loader")
    assert bundled_tasks() == (
        "forwarder-half-cycle",
        "forwarder-horizontal",
        "forwarder-vertical",
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
    ("loader", "lift", [0.82500, 0.95191, 1.10460, 1.25094, 1.37000], [0.23223, 0.33823, 0.35589, 0.31332, 0.23262]),
    ("loader", "tilt", [0.82500, 0.92665, 1.08885, 1.25016, 1.37000], [0.08819, 0.25812, 0.30634, 0.26193, 0.16255]),
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
    length, arm, _ = cylinder(actuator.linkage, np.linspace(joint.lower, joint.upper, len(lengths)))
    np.testing.assert_allclose(length, lengths, atol=2e-5)
    np.testing.assert_allclose(arm, arms, atol=2e-5)


@pytest.mark.parametrize("name", ["forwarder", "loader"])
def test_every_length_change_is_the_printed_stroke(name):
    machine = load_machine(name)
    printed = {"forwarder": [0.720, 0.610, 0.725, 1.850], "loader": [0.545, 0.545, 1.040]}[name]
    assert [c.stroke for c in machine.cylinders] == printed
    for actuator, joint in zip(machine.cylinders, machine.joints, strict=True):
        length, _, _ = cylinder(actuator.linkage, np.array([joint.lower, joint.upper]))
        assert abs(length[1] - length[0]) == pytest.approx(actuator.stroke, abs=1e-4)


def test_the_quintic_of_the_tilt_linkage_is_as_close_as_stated():
    machine = load_machine("forwarder")
    tilt, joint = part(machine, "tilt")
    quintic = Polynomial((0.002866, 0.030668, 0.126368, 0.188005, -0.255217, 0.941039))
    q = np.linspace(joint.lower, joint.upper, 501)
    exact, fitted = cylinder(tilt.linkage, q), cylinder(quintic, q)
    assert np.abs(exact[0] - fitted[0]).max() == pytest.approx(0.26e-3, abs=0.02e-3)
    assert np.abs(exact[1] - fitted[1]).max() == pytest.approx(4.8e-3, abs=0.1e-3)


PATHS = [
    # Duration [s], peak speed [m/s], first and last point [m], payload [kg].
    ("forwarder-horizontal", 10.0, 0.600, (4.0, 0.0, 2.0), (7.2, 0.0, 2.0), 0.0),
    ("forwarder-vertical", 6.0, 0.950, (5.5, 0.0, 4.64), (5.5, 0.0, 1.60), 0.0),
    ("forwarder-half-cycle", 15.0, 0.750, (4.30, 0.0, 2.50), (2.10, 5.50, 1.30), 0.0),
    ("loader-triangle-large", 30.0, 0.505, (1.4, 0.0, 0.5), (1.4, 0.0, 0.5), 475.0),
    ("loader-triangle-medium", 30.0, 0.505 * 2 / 3, (2.0, 0.0, 0.5), (2.0, 0.0, 0.5), 475.0),
    ("loader-triangle-small", 30.0, 0.505 / 3, (2.6, 0.0, 0.5), (2.6, 0.0, 0.5), 475.0),
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
    assert entries["cylinders.lift.linkage.short"].status == "derived"
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
    ["1 km/h", "0.1 rad", "1 m^2", "one m", "1 m m", "1,5 m", "0x10", "1_0", "", "m", "1e999", "1 m^9^9^9", "1e16"],
)
def test_these_are_no_lengths(text):
    assert quantity(text, KINDS["length"]) is None


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_written_quantities_read_back_equal(kind, rng):
    values = [0.0, 1.0, 1 / 3, -1e-9, 2e14, *rng.normal(size=20)]
    assert [quantity(write(value, kind), kind) for value in values] == values
    assert quantity(kind.example, kind) is not None


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
        (5.0, "start = 5.0; must be from 0 to 1.85 m, the stroke of the extension cylinder"),
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
        dump_machine(replace(machine, pump=replace(machine.pump, efficiency=2.0)))
    assert str(caught.value) == "machine loader: pump.efficiency = 2.0; must be above 0 and at most 1"


# Bad files

BAD_MACHINES = {
    "wrong unit": (
        [("boom: 3.504 m", "boom: 3.504 kg")],
        ["14: geometry.boom = 3.504 kg; must be a finite length, such as 610 mm"],
    ),
    "unknown unit": (
        [("325 l/min", "325 gal/min")],
        ["125: pump.max_flow = 325 gal/min; must be a finite flow, such as 325 l/min"],
    ),
    "nan": (
        [("mass: 480 kg", "mass: .nan")],
        ["100: bodies.column.mass = .nan; must be a finite mass, such as 370 kg"],
    ),
    "infinite": (
        [("inertia: 60 kg m^2", "inertia: 1e999 kg m^2")],
        ["100: bodies.column.inertia = 1e999 kg m^2; must be a finite inertia, such as 420 kg m^2"],
    ),
    "negative mass": ([("mass: 480 kg", "mass: -1 kg")], ["100: bodies.column.mass = -1 kg; must be above 0"]),
    "negative bore": ([("bore: 120 mm", "bore: -90 mm")], ["44: cylinders.lift.bore = -90 mm; must be above 0"]),
    "out of range": (
        [("efficiency: 1 ", "efficiency: 1.5 ")],
        ["127: pump.efficiency = 1.5; must be above 0 and at most 1"],
    ),
    "share out of range": (
        [("extension_share: 0.5", "extension_share: 150 %")],
        ["104: bodies.telescope_1.extension_share = 150 %; must be from 0 to 1"],
    ),
    "unknown key": (
        [("    rod: 70 mm", "    rodd: 70 mm")],
        [f"45: cylinders.lift.rodd is not a key here; valid keys: {CYLINDER_KEYS}; did you mean rod?"],
    ),
    "missing key": (
        [("    velocity_limit: 0.15 m/s          # printed: Table 3\n", "")],
        ["43: cylinders.lift.velocity_limit is missing; must be a velocity above 0, such as 0.15 m/s"],
    ),
    "missing section": (
        [
            ("payload:               # hangs at the tool\n  along: 2.13 m        # derived: geometry.outer\n", ""),
            ("  above: 0.376 m       # derived: geometry.offset\n", ""),
        ],
        ["5: payload is missing; must be a mapping with the keys along, above"],
    ),
    "no value": (
        [("stroke: 610 mm", "stroke:")],
        ["46: cylinders.lift.stroke = nothing; must be a finite length, such as 610 mm"],
    ),
    "duplicate key": (
        [("    rod: 70 mm", "    bore: 70 mm\n    rod: 70 mm")],
        ["45: cylinders.lift.bore is given twice; first in line 44"],
    ),
    "wrong word": (
        [("connection: single_acting", "connection: single")],
        [
            "52: cylinders.lift.connection = single; must be standard, single_acting, differential; "
            "did you mean single_acting?"
        ],
    ),
    "wrong linkage": (
        [("type: triangle", "type: triangel")],
        [
            "48: cylinders.lift.linkage.type = triangel; must be rack_and_pinion, triangle, four_bar, polynomial, "
            "telescope; did you mean triangle?"
        ],
    ),
    "no linkage type": (
        [("      type: triangle\n", "")],
        [
            "47: cylinders.lift.linkage.type is missing; must be rack_and_pinion, triangle, four_bar, polynomial, "
            "telescope"
        ],
    ),
    "key inside a linkage": (
        [("short: 0.442257 m", "shrt: 0.442257 m")],
        [
            "47: cylinders.lift.linkage.short is missing; must be a length above 0, such as 610 mm",
            "50: cylinders.lift.linkage.shrt is not a key here; valid keys: type, long, short, angle; "
            "did you mean short?",
        ],
    ),
    "not a switch": ([("slewing: true", "slewing: 1")], ["17: geometry.slewing = 1; must be true or false"]),
    "unsafe name": (
        [("name: forwarder", "name: ../../x")],
        ["5: name = ../../x; must be up to 64 letters, digits, '-' and '_', the first a letter or digit"],
    ),
    "unsafe name of a body": (
        [("  column: {", "  the column: {")],
        [
            "100: bodies.the column has a wrong name; must be up to 64 letters, digits, '-' and '_', "
            "the first a letter or digit"
        ],
    ),
    "half a range": (
        [("[-0.425 rad, 1.097 rad]", "[-0.425 rad]")],
        ["21: joints.lift = [-0.425 rad]; must be a list of two angles, lower and upper end"],
    ),
    "range upside down": (
        [("[-0.425 rad, 1.097 rad]", "[1.097 rad, -0.425 rad]")],
        ["21: joints.lift = [1.097 rad, -0.425 rad]; the lower end must be below the upper end"],
    ),
    "rod above bore": (
        [("rod: 70 mm", "rod: 130 mm")],
        ["45: cylinders.lift.rod = 130 mm; must be below bore = 120 mm"],
    ),
    "rod equal to bore": (
        [("rod: 70 mm", "rod: 120 mm")],
        ["45: cylinders.lift.rod = 120 mm; must be below bore = 120 mm"],
    ),
    "two sizes": (
        [("    rod: 70 mm", "    plunger: 70 mm")],
        [
            "43: cylinders.lift has bore = 120 mm, plunger = 70 mm; its size must be given as bore and rod, as plunger "
            "(and racks), or as piston_area and rod_side_area"
        ],
    ),
    "three racks": ([("racks: 1 ", "racks: 3 ")], ["30: cylinders.base.racks = 3; must be 1 or 2"]),
    "areas the wrong way round": (
        [("bore: 120 mm", "piston_area: 70 cm^2"), ("rod: 70 mm", "rod_side_area: 113 cm^2")],
        ["45: cylinders.lift.rod_side_area = 113 cm^2; must be at most piston_area = 70 cm^2"],
    ),
    "differential without a difference": (
        [("connection: standard", "connection: differential")],
        ["35: cylinders.base.connection = differential; must be standard or single_acting, since both areas are equal"],
    ),
    "steps on the lift": (
        [
            (
                "      viscous: 0 N s/m                # assumed\n    velocity_limit: 0.15",
                "      steps: [1, 2, 3, 4]\n    velocity_limit: 0.15",
            )
        ],
        ["56: cylinders.lift.friction.steps = [1, 2, 3, 4]; only the extension cylinder may have steps"],
    ),
    "steps out of order": (
        [("[0.8 m, 1.3 m, 2.2 m, 2.7 m]", "[0.8 m, 1.3 m, 1.2 m, 2.7 m]")],
        [
            "94: cylinders.extension.friction.steps = [0.8 m, 1.3 m, 1.2 m, 2.7 m]; "
            "every value must be above the one before it"
        ],
    ),
    "impossible triangle": (
        [("angle: 0.9755593 rad", "angle: 2.5 rad")],
        [
            "47: cylinders.lift.linkage = triangle; must have a torque arm over joints.lift = [-0.425, 1.097] rad, "
            "but passes a dead centre at 0.642 rad"
        ],
    ),
    "four-bar too short to close": (
        [("L24: 0.503 m", "L24: 0.05 m")],
        [
            "64: cylinders.tilt.linkage = four_bar; must close over joints.tilt = [-2.75, -0.25] rad, "
            "but does not at -2.750 rad"
        ],
    ),
    "four-bar off its branch": (
        [("a22: 1.963 rad", "a22: 3 rad")],
        [
            "64: cylinders.tilt.linkage = four_bar; must close over joints.tilt = [-2.75, -0.25] rad, "
            "but does not at -0.655 rad"
        ],
    ),
    "stroke beside the linkage": (
        [("stroke: 610 mm", "stroke: 650 mm")],
        [
            "46: cylinders.lift.stroke = 650 mm; must be 0.6100 m within 2 %, the change of the cylinder's length over "
            "joints.lift = [-0.425, 1.097] rad"
        ],
    ),
    "extension without telescope": (
        [("type: telescope\n      ratio: 0.5", "type: rack_and_pinion\n      arm: 0.5")],
        ["87: cylinders.extension.linkage.type = rack_and_pinion; must be telescope"],
    ),
    "telescope on a rotating joint": (
        [("type: rack_and_pinion\n      arm: 0.1146 m", "type: telescope\n      ratio: 0.1146")],
        ["33: cylinders.base.linkage.type = telescope; must not be telescope on a rotating joint"],
    ),
    "base without slewing": (
        [("slewing: true", "slewing: false")],
        [
            "20: joints.base is given; must be left out since geometry.slewing = false",
            "26: cylinders.base is given; must be left out since geometry.slewing = false",
        ],
    ),
    "slewing without base": (
        [("  base: [-180 deg, 180 deg]           # printed: Table 3\n", "")],
        ["19: joints.base is missing; must be given since geometry.slewing = true"],
    ),
    "telescoping lift boom": (
        [("carrier: tilt, mass: 115 kg", "carrier: lift, mass: 115 kg")],
        ["104: bodies.telescope_1.extension_share = 0.5; must be 0 unless the carrier is tilt"],
    ),
    "pump below its supply": (
        [("max_pressure: 21.5 MPa", "max_pressure: 150 bar")],
        ["122: pump.constant_pressure = 20 MPa; must be at most max_pressure = 150 bar"],
    ),
    "several at once, of every kind": (
        [
            ("boom: 3.504 m", "boom: 3.504 kg"),
            ("bore: 120 mm", "bore: -90 mm"),
            ("rod: 60 mm", "rod: 160 mm"),
            ("stroke: 1850 mm", "stroke: 1.5 m"),
            ("mass: 480 kg", "mass: -1 kg"),
            ("efficiency: 1 ", "efficency: 1 "),
        ],
        [
            "14: geometry.boom = 3.504 kg; must be a finite length, such as 610 mm",
            "44: cylinders.lift.bore = -90 mm; must be above 0",
            "62: cylinders.tilt.rod = 160 mm; must be below bore = 115 mm",
            "85: cylinders.extension.stroke = 1.5 m; must be 1.8500 m within 2 %, the change of the cylinder's length "
            "over joints.extension = [0, 3.7] m",
            "100: bodies.column.mass = -1 kg; must be above 0",
            "121: pump.efficiency is missing; must be a number above 0 and at most 1, such as 0.5, or a mapping with "
            "the keys speed, speeds, displacements, pressures, total",
            "127: pump.efficency is not a key here; valid keys: constant_pressure, ls_margin, max_pressure, max_flow, "
            "tank_pressure, efficiency; did you mean efficiency?",
        ],
    ),
}

BAD_TASKS = {
    "unknown machine": (
        [("machine: forwarder", "machine: forwader")],
        ["3: machine = forwader; must be a file or a bundled machine: forwarder, loader; did you mean forwarder?"],
    ),
    "no machine": (
        [("machine: forwarder\n", "")],
        ["3: machine is missing; must be a text"],
    ),
    "too few times": (
        [("8.55 s, ", "")],
        ["12: path.times has 3 entries; must have 4, as many as points"],
    ),
    "times falling": (
        [("8.55 s", "3 s")],
        ["12: path.times = [0 s, 4.2 s, 3 s, 15 s]; times must begin with 0 and every one be above the one before it"],
    ),
    "times late": (
        [("[0 s, 4.2 s", "[1 s, 4.2 s")],
        [
            "12: path.times = [1 s, 4.2 s, 8.55 s, 15 s]; "
            "times must begin with 0 and every one be above the one before it"
        ],
    ),
    "times for durations": (
        [("type: spline", "type: lines")],
        [
            "5: path.durations is missing; must be a list of at least one time",
            "12: path.times is not a key here; valid keys: type, points, durations",
        ],
    ),
    "unknown path": (
        [("type: spline", "type: splin")],
        ["6: path.type = splin; must be lines, spline; did you mean spline?"],
    ),
    "point in a plane": (
        [("[4.30, 0, 2.50]", "[4.30, 2.50]")],
        ["8: path.points[0] = [4.30, 2.50]; must be a list of three lengths x, y, z"],
    ),
    "infinite point": (
        [("[4.30, 0, 2.50]", "[4.30, 0, .inf]")],
        ["8: path.points[0][2] = .inf; must be a finite length, such as 610 mm"],
    ),
    "unknown start": (
        [("start: smallest", "start: smalest")],
        ["13: start = smalest; must be smallest, middle, best, or a length of the redundant cylinder such as 0.3 m"],
    ),
    "start beyond the stroke": (
        [("start: smallest", "start: 2 m")],
        ["13: start = 2 m; must be from 0 to 1.85 m, the stroke of the extension cylinder"],
    ),
    "negative payload": ([("payload: 0 kg", "payload: -3 kg")], ["4: payload = -3 kg; must be at least 0"]),
    "no filter at all": ([("payload: 0 kg", "smooth: 0 Hz\npayload: 0 kg")], ["4: smooth = 0 Hz; must be above 0"]),
    "sideways on a machine that does not slew": (
        [("machine: forwarder", "machine: loader"), ("[2.10, 5.50, 1.30]", "[2.10, 0, 1.30]")],
        [
            "9: path.points[1] = [4.25, 0.90, 3.30]; y must be 0, since machine loader does not slew",
            "10: path.points[2] = [3.60, 2.90, 3.30]; y must be 0, since machine loader does not slew",
        ],
    ),
}

BAD_LINES = {
    "too few durations": (
        [("[10 s, 10 s, 10 s]", "[10 s, 10 s]")],
        ["12: path.durations has 2 entries; must have 3, one less than points"],
    ),
    "negative duration": (
        [("[10 s, 10 s, 10 s]", "[10 s, -10 s, 10 s]")],
        ["12: path.durations[1] = -10 s; must be above 0 and at most 3600 s"],
    ),
    "a duration of no time": (
        [("[10 s, 10 s, 10 s]", "[10 s, 0, 2 h]")],
        [
            "12: path.durations[1] = 0; must be above 0 and at most 3600 s",
            "12: path.durations[2] = 2 h; must be above 0 and at most 3600 s",
        ],
    ),
}


def written(folder, text, name="bad.yaml"):
    """A file with this text."""
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def edited(text, edits):
    """The text with replacements that all must apply."""
    for old, new in edits:
        assert old in text
        text = text.replace(old, new, 1)
    return text


def problems(load, path):
    """What loading a bad file says, without the file's folder."""
    with pytest.raises(InputError) as caught:
        load(path)
    return str(caught.value).replace(f"{path.parent}/", "").split("\n")


@pytest.mark.parametrize(("edits", "expected"), BAD_MACHINES.values(), ids=BAD_MACHINES)
def test_bad_machine_file(tmp_path, edits, expected):
    found = problems(load_machine, written(tmp_path, edited(FORWARDER, edits)))
    assert found == [f"bad.yaml:{text}" for text in expected]


@pytest.mark.parametrize(("edits", "expected"), BAD_TASKS.values(), ids=BAD_TASKS)
def test_bad_task_file(tmp_path, edits, expected):
    found = problems(load_task, written(tmp_path, edited(HALF_CYCLE, edits)))
    assert found == [f"bad.yaml:{text}" for text in expected]


@pytest.mark.parametrize(("edits", "expected"), BAD_LINES.values(), ids=BAD_LINES)
def test_bad_path_of_lines(tmp_path, edits, expected):
    found = problems(load_task, written(tmp_path, edited(TRIANGLE, edits)))
    assert found == [f"bad.yaml:{text}" for text in expected]


BAD_TEXTS = {
    "empty": ("", f"bad.yaml:1: the file must be a mapping with the keys {TOP_KEYS}"),
    "a list": ("- 1\n- 2\n", f"bad.yaml:1: the file must be a mapping with the keys {TOP_KEYS}"),
    "unclosed list": (
        edited(FORWARDER, [("bore: 120 mm", "bore: [120 mm")]),
        "bad.yaml:45:5: is not valid YAML: expected ',' or ']', but got '<scalar>'; while parsing a flow sequence",
    ),
    "tab": (
        "name: x\n\tboom: 1\n",
        "bad.yaml:2:1: is not valid YAML: found character '\\t' that cannot start any token; "
        "while scanning for the next token",
    ),
    "alias bomb": (
        "a: &a [x, x]\n" + "".join(f"{b}: &{b} [*{a}, *{a}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)),
        "bad.yaml:1: anchors and aliases (& and *) are not allowed; write the value out",
    ),
    "alias alone": (
        "a: *b\n",
        "bad.yaml:1: anchors and aliases (& and *) are not allowed; write the value out",
    ),
    "executable tag": (
        "name: x\ndescription: !!python/object/apply:os.system [ls]\n",
        "bad.yaml:2: tags (tag:yaml.org,2002:python/object/apply:os.system) are not allowed; write the value alone",
    ),
    "deep nesting": ("a: " + "[" * 100_000, "bad.yaml:1: is nested deeper than 12 levels"),
    "deep blocks": ("\n".join(" " * i + "a:" for i in range(900)), "bad.yaml:14: is nested deeper than 12 levels"),
    "too big": ("#" * (MAX_BYTES + 1), "bad.yaml: is above 1 MiB; a machine or task file is a few kilobytes"),
    "two documents": ("a: 1\n---\nb: 2\n", "bad.yaml:2: a second document begins; one file holds one machine or task"),
    "list as key": ("? [a, b]\n: 1\n", "bad.yaml:1: a key must be a plain word"),
    "not UTF-8": (b"name: x\ndescription: caf\xe9\n", "bad.yaml:2: is not UTF-8 text; byte 24 is 0xe9"),
    "character that does not exist": (
        'name: "\\U99999999"\n',
        "bad.yaml: is not valid YAML: Python int too large to convert to C int",
    ),
    "control character": ("name: a\0b\n", "bad.yaml:1: character #x0000 is not allowed in YAML"),
}


@pytest.mark.parametrize(("text", "expected"), BAD_TEXTS.values(), ids=BAD_TEXTS)
def test_text_that_is_no_machine(tmp_path, text, expected):
    assert problems(load_machine, written(tmp_path, text)) == [expected]


def test_a_file_of_just_one_mebibyte_is_read(tmp_path):
    padding = "#" * (MAX_BYTES - len(FORWARDER.encode()) - 1)
    assert load_machine(written(tmp_path, f"{FORWARDER}{padding}\n")) == load_machine("forwarder")


def test_a_flood_of_problems_is_cut_off(tmp_path):
    found = problems(load_machine, written(tmp_path, FORWARDER + "".join(f"key{i}: 1\n" for i in range(60))))
    assert len(found) == 51
    assert found[-1] == "bad.yaml: and 10 more problems"


def test_problems_of_a_task_and_of_its_machine_come_together(tmp_path):
    written(tmp_path, FORWARDER.replace("mass: 480 kg", "mass: 0 kg"), "mine.yaml")
    edits = [("machine: forwarder", "machine: mine.yaml"), ("payload: 0 kg", "payload: 5 m")]
    assert problems(load_task, written(tmp_path, edited(HALF_CYCLE, edits))) == [
        "bad.yaml:4: payload = 5 m; must be a finite mass, such as 370 kg",
        "mine.yaml:100: bodies.column.mass = 0 kg; must be above 0",
    ]


MISSING = [
    (
        load_machine,
        "laoder",
        "machine = laoder; must be a file or a bundled machine: forwarder, loader; did you mean loader?",
    ),
    (load_machine, "", "machine = nothing; must be a file or a bundled machine: forwarder, loader"),
    (load_machine, "a\0b", "machine = a?b; must be a file or a bundled machine: forwarder, loader"),
    (
        load_machine,
        Path("loader"),
        "machine = loader; must be a file or a bundled machine: forwarder, loader; did you mean loader?",
    ),
    (
        load_task,
        "none.yaml",
        f"task = none.yaml; must be a file or a bundled task: {', '.join(bundled_tasks())}",
    ),
]


@pytest.mark.parametrize(("load", "name", "message"), MISSING)
def test_a_name_that_is_neither_bundled_nor_a_file(tmp_path, monkeypatch, load, name, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError) as caught:
        load(name)
    assert str(caught.value) == message


def test_a_mutilated_file_loads_or_is_refused_by_its_name(tmp_path):
    """Random damage never ends in anything but a machine or an InputError."""
    dice = random.Random(1)
    pieces = [
        " ",
        "\n",
        ":",
        "- ",
        "[",
        "{",
        "}",
        "]",
        "&a ",
        "*a",
        "!!x ",
        "'",
        '"',
        "#",
        "|",
        "%YAML 9.9\n",
        "\t",
        "-1",
        "\u2028",
        "\\U99999999",
        "0",
    ]
    refused = 0
    for _ in range(60):
        text = FORWARDER
        for _ in range(dice.randint(1, 4)):
            at = dice.randrange(len(text))
            text = text[:at] + dice.choice(pieces) + text[at + dice.randint(0, 3) :]
        try:
            load_machine(written(tmp_path, text))
        except InputError as error:
            refused += 1
            assert all("bad.yaml" in line for line in str(error).split("\n"))
    assert refused > 20


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
    geometry = machine["$defs"]["GeometryKeys"]
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
    code = f"import sys, leanboom.files; print(*{heavy} & set(sys.modules))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == ""


def test_the_kinds_of_path_are_told_apart():
    assert isinstance(load_task("forwarder-half-cycle").path, Spline)
    assert isinstance(load_task("forwarder-vertical").path, Lines)


def test_the_examples_of_the_documentation_load(tmp_path):
    page = (Path(__file__).parents[1] / "docs/files.md").read_text()
    blocks = page.split("```yaml\n")[1:]
    machine, task = [text.split("```")[0] for text in blocks if "start: best" in text or "yard" in text.split("```")[0]]
    crane = load_machine(written(tmp_path, machine, "yard-crane.yaml"))
    assert (crane.name, crane.pump.efficiency, crane.pump.ls_margin) == ("yard-crane", 0.85, 2e6)
    unload = load_task(written(tmp_path, task, "unload.yaml"))
    assert (unload.machine, unload.start, unload.smooth) == (crane, "best", 5.0)


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


def test_problems_of_the_simulation_are_named(tmp_path):
    text = dump_machine(load_machine("forwarder"))
    text = text.replace("dead_zone: 53 %", "dead_zone: 95 %").replace("dead_volume: 1 l", "dead_volume: 1 m")
    found = " ".join(problems(load_machine, written(tmp_path, text)))
    assert "simulation.dead_zone = 95 %; must be from 0 to 0.9" in found
    assert "simulation.dead_volume = 1 m; must be a finite volume, such as 1.5 l" in found
