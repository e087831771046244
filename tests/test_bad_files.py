"""Bad files: every problem with its exact message, line and column."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from bundled_texts import FORWARDER, HALF_CYCLE, TRIANGLE, written
from leanboom.errors import InputError
from leanboom.files import (
    bundled_tasks,
    dump_machine,
    load_machine,
    load_task,
)
from leanboom.source import MAX_BYTES

TOP_KEYS = (
    "name, description, geometry, joints, cylinders, bodies, payload, valve, pump, driven_velocity, dynamics, "
    "simulation, gravity"
)
CYLINDER_KEYS = (
    "bore, rod, plunger, racks, piston_area, rod_side_area, stroke, linkage, connection, friction, velocity_limit, "
    "acceleration_limit"
)


BAD_MACHINES = {
    "wrong unit": (
        [("boom: 3.504 m", "boom: 3.504 kg")],
        ["14: geometry.boom = 3.504 kg; must be a finite length in mm, cm, m, such as 610 mm"],
    ),
    "unknown unit": (
        [("325 l/min", "325 gal/min")],
        [
            "125: pump.max_flow = 325 gal/min; must be a finite flow in l/min, l/s, cm^3/s, m^3/h, m^3/s, such as "
            "325 l/min; gal is not a unit here"
        ],
    ),
    "a unit in other case": (
        [("21.5 MPa", "215 Bar")],
        [
            "124: pump.max_pressure = 215 Bar; must be a finite pressure in Pa, kPa, MPa, mbar, bar, such as "
            "21.5 MPa; Bar is not a unit here, did you mean bar?"
        ],
    ),
    "a decimal comma": (
        [("boom: 3.504 m", "boom: 3,504 m")],
        [
            "14: geometry.boom = 3,504 m; must be a finite length, such as 610 mm; numbers are written with 0-9 and a "
            "decimal point"
        ],
    ),
    "digits of another script": (
        [("mass: 480 kg", "mass: ٤٨٠ kg")],
        [
            "100: bodies.column.mass = ٤٨٠ kg; must be a finite mass, such as 370 kg; numbers are written with 0-9 and "
            "a decimal point"
        ],
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
    "the word of others": (
        [("connection: single_acting", "connection: double_acting"), ("carrier: lift", "carrier: boom")],
        [
            "52: cylinders.lift.connection = double_acting; must be standard, single_acting, differential; "
            "did you mean standard?",
            "101: bodies.lift_boom.carrier = boom; must be base, lift, tilt; did you mean lift?",
        ],
    ),
    "degrees without a unit": (
        [("[-0.425 rad, 1.097 rad]", "[-24, 62.9]")],
        [
            "21: joints.lift[0] = -24; must have its unit beyond 6.3 rad, since a bare number is in rad",
            "21: joints.lift[1] = 62.9; must have its unit beyond 6.3 rad, since a bare number is in rad",
        ],
    ),
    "millimetres without a unit": (
        [("boom: 3.504 m", "boom: 3504")],
        ["14: geometry.boom = 3504; must have its unit beyond 100 m, since a bare number is in m"],
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
            "joints.lift = [-0.425, 1.097] rad, or be left out"
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
    "bar without a unit": (
        [("max_pressure: 21.5 MPa", "max_pressure: 215")],
        [
            "122: pump.constant_pressure = 20 MPa; must be at most max_pressure = 215 Pa",
            "123: pump.ls_margin = 3 MPa; must be at most max_pressure = 215 Pa",
        ],
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
            "14: geometry.boom = 3.504 kg; must be a finite length in mm, cm, m, such as 610 mm",
            "44: cylinders.lift.bore = -90 mm; must be above 0",
            "62: cylinders.tilt.rod = 160 mm; must be below bore = 115 mm",
            "85: cylinders.extension.stroke = 1.5 m; must be 1.8500 m within 2 %, the change of the cylinder's length "
            "over joints.extension = [0, 3.7] m, or be left out",
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
        [
            "12: path.times = [0 s, 4.2 s, 3 s, 15 s]; "
            "times must begin with 0 and every one be above the one before it, by at least 0.0001 s"
        ],
    ),
    "times late": (
        [("[0 s, 4.2 s", "[1 s, 4.2 s")],
        [
            "12: path.times = [1 s, 4.2 s, 8.55 s, 15 s]; "
            "times must begin with 0 and every one be above the one before it, by at least 0.0001 s"
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
    "no filter at all": (
        [("payload: 0 kg", "smooth: 0 Hz\npayload: 0 kg")],
        ["4: smooth = 0 Hz; must be from 0.01 Hz to 240 Hz"],
    ),
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
        ["12: path.durations[1] = -10 s; must be from 0.0001 s to 3600 s"],
    ),
    "a duration of no time": (
        [("[10 s, 10 s, 10 s]", "[10 s, 0, 2 h]")],
        [
            "12: path.durations[1] = 0; must be from 0.0001 s to 3600 s",
            "12: path.durations[2] = 2 h; must be from 0.0001 s to 3600 s",
        ],
    ),
}


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
        "while scanning for the next token; indent with spaces, not tabs",
    ),
    "no space after a key": (
        "name: x\ngeometry:\n  base_x: 0 m\n  boom:1.60 m\n  base_z: 0 m\n",
        "bad.yaml:4:3: is not valid YAML: could not find expected ':'; while scanning a simple key; "
        "a colon and a space follow a key",
    ),
    "a colon in a text": (
        "description: Crane: PK 50\n",
        "bad.yaml:1:19: is not valid YAML: mapping values are not allowed here; a text with a colon stands in quotes",
    ),
    "a line too far out": (
        "geometry:\n  base_x: 0 m\n boom: 1.60 m\n",
        "bad.yaml:3:2: is not valid YAML: expected <block end>, but found '<block mapping start>'; while parsing a "
        "block mapping; the lines of a section are indented alike",
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
        "bad.yaml:4: payload = 5 m; must be a finite mass in g, kg, t, such as 370 kg",
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


def test_problems_of_the_simulation_are_named(tmp_path):
    text = dump_machine(load_machine("forwarder"))
    text = text.replace("dead_zone: 53 %", "dead_zone: 95 %").replace("dead_volume: 1 l", "dead_volume: 1 m")
    found = " ".join(problems(load_machine, written(tmp_path, text)))
    assert "simulation.dead_zone = 95 %; must be from 0 to 0.9" in found
    assert "simulation.dead_volume = 1 m; must be a finite volume in cm^3, l, m^3, such as 1.5 l" in found
