"""Files to begin with: they load, are checked and planned as they are, and explain what the schema knows."""

from __future__ import annotations

import re

import pytest
from typer.testing import CliRunner

from leanboom.cli import app
from leanboom.errors import InputError
from leanboom.io import loading, starter
from leanboom.io.schema import MachineKeys, TaskKeys
from leanboom.io.yaml_source import STATUSES
from leanboom.planning import planner
from leanboom.quantities.declarations import OrSection, Section, Variant, meanings
from leanboom.report import facts


def leanboom(*arguments):
    return CliRunner().invoke(app.app, arguments, env={"COLUMNS": "160", "TERM": "dumb", "NO_COLOR": "1"})


@pytest.mark.parametrize("kind", ["machine", "task"])
def test_a_new_file_is_right_as_it_is(tmp_path, kind):
    path = tmp_path / "new.yaml"
    result = leanboom("new", kind, str(path))
    assert result.exit_code == 0, result.stderr
    assert f"leanboom check {path}" in result.stdout
    assert leanboom("new", kind).stdout == path.read_text(encoding="utf-8") == starter.text(kind)
    checked = facts.check(str(path))
    assert (checked.error, checked.kind) == (None, kind)
    assert checked.machine is not None and facts.doubts(checked.machine) == ()
    assert leanboom("check", str(path)).exit_code == 0


@pytest.mark.slow
def test_the_new_task_is_planned_on_the_new_machine(tmp_path):
    starter.write("machine", tmp_path / "crane.yaml")
    text = starter.text("task")
    assert "\nmachine: loader\n" in text
    (tmp_path / "task.yaml").write_text(text.replace("machine: loader", "machine: crane.yaml"), encoding="utf-8")
    plan = planner.run(loading.load_task(tmp_path / "task.yaml"), grid=(41, 21), step=0.2, baseline=False)
    assert plan.evaluation.feasible
    assert plan.task.machine.names == ("base", "lift", "tilt", "extension")


def test_every_value_of_the_new_machine_says_that_it_is_an_example(tmp_path):
    path = tmp_path / "crane.yaml"
    starter.write("machine", path)
    machine = loading.load_machine(path)
    assert {(entry.status, entry.note) for entry in machine.provenance} == {("assumed", "example")}
    assert all(status in starter.text("machine").split("geometry:")[0] for status in STATUSES)


def sections(rule):
    """The sections a file may have, told apart by their type or not."""
    if isinstance(rule, Variant):
        parts = rule.sections
    elif isinstance(rule, OrSection):
        parts = (rule.section,)
    else:
        parts = () if rule.section_of(None) is None else (rule.section_of(None),)
    found = set(parts)
    return found.union(*(sections(field.rule) for part in parts for field in part.fields.values()))


@pytest.mark.parametrize(("kind", "made"), [("machine", MachineKeys), ("task", TaskKeys)])
def test_every_key_of_a_section_that_is_there_is_given_or_offered(kind, made):
    """Sections told apart by their type, such as linkages, are there as far as the examples have them."""
    text = starter.text(kind)
    others = "FourBar|Polynomial|IndependentMetering|Efficiency|Circuit|Spline|Retimed"
    for section in sections(Section(made)):
        if re.match(others, section.made.__name__):
            continue
        for name in section.fields:
            assert re.search(rf"^ *(# )?{name}:", text, re.MULTILINE), f"{section.made.__name__}.{name}"
            assert f"# {meanings(section.made).get(name, '')}" in text


def test_nothing_is_overwritten(tmp_path):
    path = tmp_path / "precious.yaml"
    path.write_text("mine", encoding="utf-8")
    result = leanboom("new", "machine", str(path))
    assert result.exit_code == 2
    assert result.stderr == f"leanboom: {path}: is there already; give the name of a new file\n"
    assert path.read_text(encoding="utf-8") == "mine"
    missing = leanboom("new", "task", str(tmp_path / "nowhere" / "task.yaml"))
    assert missing.exit_code == 2
    assert "cannot be written: No such file or directory" in missing.stderr
    with pytest.raises(InputError, match="a name no file can have"):
        starter.write("task", tmp_path / "a\0b")
    assert leanboom("new", "crane").exit_code == 2
    with pytest.raises(InputError, match="must be machine, task"):
        starter.text("crane")
