"""Bad task files, and files that are no machine or task at all: every problem with its exact message and line."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from bundled_texts import FORWARDER, HALF_CYCLE, TRIANGLE, edited, problems, written
from leanboom.errors import InputError
from leanboom.io.loading import bundled_tasks, load_machine, load_task
from leanboom.io.yaml_source import MAX_BYTES

TOP_KEYS = (
    "name, description, geometry, joints, cylinders, bodies, payload, valve, pump, driven_velocity, dynamics, "
    "simulation, gravity"
)

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
        ["6: path.type = splin; must be lines, spline, retimed; did you mean spline?"],
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
