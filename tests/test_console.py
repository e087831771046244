"""Tables in narrow terminals: every number and every word is there, whatever the width."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from leanboom.cli import machine_tables, result_tables
from leanboom.cli.console import add_row, new_table, say, show
from leanboom.evaluation.evaluate import evaluate
from leanboom.io import loading
from leanboom.model import motion
from leanboom.planning import planner
from leanboom.study.papers.jobs import Line


def printed(width, function, *arguments):
    text = io.StringIO()
    function(Console(file=text, width=width, highlight=False), *arguments)
    return text.getvalue()


@pytest.fixture(scope="module")
def plan():
    task = loading.load_task("forwarder-vertical", start=0.6713)
    judged = evaluate(task, motion.from_velocities(0.1, 0.6713, np.zeros(61), "dp", "ls"))
    other = evaluate(task, motion.from_velocities(0.1, 0.516, np.zeros(61), "sns-actuator", "velocity"))
    return planner.Plan(task, "ls", judged.motion, judged, other, 64 << 20)


@pytest.mark.parametrize("width", [160, 50, 40, 20])
def test_a_plans_table_keeps_its_numbers(plan, width):
    """At 50 columns energies once ended in an ellipsis."""
    text = printed(width, result_tables.plan, plan, None, "forwarder")
    assert "…" not in text
    for judged in (plan.evaluation, plan.baseline):
        assert all(f"{judged.energy(pump) / 1e3:.2f}" in text.split() for pump in planner.PUMPS)
    assert f"{100 * plan.saving('ls'):.1f}" in text


@pytest.mark.parametrize("width", [160, 50, 30])
def test_tables_of_machines_and_tasks_keep_their_numbers(width):
    machines = [loading.load_machine(name) for name in loading.bundled_machines()]
    tasks = [loading.load_task(name) for name in loading.bundled_tasks()]
    text = "".join(
        (
            printed(width, machine_tables.machine_detail, machines[0]),
            printed(width, machine_tables.machine_list, machines),
            printed(width, machine_tables.task_list, tasks),
            printed(width, machine_tables.task_detail, tasks[0]),
        )
    )
    assert "…" not in text
    words = text.split()
    for cylinder in machines[0].cylinders:
        assert f"{cylinder.stroke:.3f}" in words and f"{cylinder.velocity_limit:g}" in words
    assert all(f"{task.duration:g}" in words for task in tasks)


def test_where_numbers_do_not_fit_side_by_side_each_has_a_line():
    table = new_table("Name", "large\nkJ", "larger\nkJ", "note", numbers=2)
    table.columns[-1].justify = "left"
    add_row(table, "first", "123456.789", "9876543.210", "")
    text = printed(20, show, table)
    assert text.splitlines() == ["first", "  large kJ: 123456.789", "  larger kJ: 9876543.210"]
    assert printed(80, show, table).split()[-3:] == ["first", "123456.789", "9876543.210"]


def test_reproduced_values_keep_their_numbers_in_narrow_terminals():
    class Made:
        records = {"table2": {}}
        lines = (Line("table2", "pseudo-inverse (actuator)", 1.234, 1.345, "other friction"),)

    words = printed(40, result_tables.reproduction, Made, {"table2": "Table 2"}).split()
    assert {"1.234", "1.345", "+0.111", "friction"} <= set(words)


def test_an_unsolved_plan_has_no_saving_in_its_table(plan):
    weak = replace(plan.task.machine.pump, max_flow=5.0 / 6e4)
    task = replace(plan.task, machine=replace(plan.task.machine, pump=weak))
    text = printed(160, result_tables.plan, replace(plan, evaluation=evaluate(task, plan.motion)), None, "forwarder")
    (row,) = [line for line in text.splitlines() if line.startswith("load-sensing pump (chosen)")]
    assert row.split()[-1] == "-" and "NOT SOLVED" in text and "all kept" not in text


@pytest.mark.parametrize("terminal", [True, False])
def test_lines_wrap_at_spaces_in_a_terminal_and_keep_names_in_one_piece(terminal):
    """A terminal wrapped inside words; what goes into a file keeps its lines."""
    path = "/folder/" + "of-a-long-name/" * 5 + "report.html"
    text = f"Report    {path} and a sentence that goes on for more than a narrow line"
    said = io.StringIO()
    say(Console(file=said, width=40, force_terminal=terminal, color_system=None), text)
    lines = said.getvalue().splitlines()
    assert " ".join(" ".join(lines).split()) == " ".join(text.split())
    assert path in said.getvalue()
    assert (len(lines) > 1) == terminal
    assert not terminal or all(len(line) <= 40 or path in line for line in lines)
