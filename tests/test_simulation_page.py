"""What is written of a simulated run, and what of it and of its plan can be read again."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import jinja2
import numpy as np
import pytest

import leanboom as lb
from leanboom.errors import InputError
from leanboom.evaluation.evaluate import evaluate
from leanboom.model.outcome import Kind, Outcome
from leanboom.model.task import Lines
from leanboom.planning import planner
from leanboom.report import plan_page, rendering, run_folder, simulation_page
from leanboom.report.charts import POINTS
from leanboom.simulation import closed_loop
from leanboom.simulation.events import Event
from test_simulation import glide

TASK = replace(
    lb.load_task("loader-triangle-small"), path=Lines(((2.4, 0.0, 0.7), (2.7, 0.0, 1.0)), (2.0,)), name="<lift>"
)
KEYS = [
    "task", "pump", "method", "energy_j", "planned_energy_j", "path_accuracy_m", "balance_error",
    "legs", "wall_s", "realtime_factor", "events", "out",
]  # fmt: skip


@pytest.fixture(scope="module")
def run():
    return closed_loop.simulate(TASK, glide(TASK, 0.5, 0.6), "cp")


@pytest.fixture(scope="module")
def plan(run):
    task = replace(lb.load_task("loader-triangle-small"), path=TASK.path, name="lift")
    judged = evaluate(task, run.motion)
    return planner.Plan(task, "cp", run.motion, judged, None, 1 << 20)


def test_the_summary_has_exactly_the_agreed_keys(run):
    found = simulation_page.summary(run, Path("out"))
    assert list(found) == KEYS
    assert (found["task"], found["pump"], found["method"], found["out"]) == ("<lift>", "cp", "glide", "out")
    assert found["energy_j"] == run.energy and found["planned_energy_j"] == run.planned.energy_cp
    assert simulation_page.summary(run)["out"] is None


def test_events_tell_time_place_and_cause(run):
    marked = replace(run, events=(Event("end", "lift", 1.25, 0.5, "the lift cylinder runs into its extended end"),))
    assert simulation_page.summary(marked)["events"] == [
        {
            "kind": "end", "place": "lift", "time_s": 1.25, "duration_s": 0.5,
            "text": "the lift cylinder runs into its extended end",
        }
    ]  # fmt: skip
    assert "runs into its extended end" in simulation_page.page(marked)


def test_the_samples_are_those_of_the_run(run):
    rows = list(csv.reader(simulation_page.texts(run, Path("out"))["simulation.csv"].splitlines()))
    assert len(rows) == 1 + run.time.size
    table = {name: np.array([float(row[i]) for row in rows[1:]]) for i, name in enumerate(rows[0])}
    assert table["time_s"] == pytest.approx(run.time, abs=1e-6)
    assert table["lift_pressure_a_pa"] == pytest.approx(run.pressure_a[:, 0], rel=1e-6)
    assert table["extension_command_b"] == pytest.approx(run.command[:, 5], abs=1e-6)
    assert table["energy_j"][-1] == pytest.approx(run.energy, rel=1e-6)
    assert table["z_target_m"][-1] == pytest.approx(1.0)


class _Tags(HTMLParser):
    def __init__(self):
        super().__init__()
        self.open, self.sources = [], []

    def handle_starttag(self, tag, attributes):
        if tag not in ("meta", "br"):
            self.open.append(tag)
        self.sources += [value for name, value in attributes if name in ("src", "href")]

    def handle_startendtag(self, tag, attributes):
        pass

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_the_page_is_whole_needs_no_network_and_escapes_names(run):
    page = simulation_page.page(run)
    assert "{{" not in page.split("<script")[0] and "<lift>" not in page
    assert "&lt;lift&gt;" in page and f"{run.energy / 1e3:.2f} kJ" in page
    parser = _Tags()
    parser.feed(page)
    assert parser.open == [] and parser.sources == []
    data = json.loads(page.split('id="data">')[1].split("</script>")[0])
    charts = [
        *data["pump"],
        *(chart for rows in data["rows"].values() for row in rows for chart in row["charts"]),
    ]
    sizes = {len(line["values"]) for chart in charts for line in chart["lines"]}
    assert sizes == {len(data["time"])} and len(data["time"]) <= POINTS
    assert [line["name"] for line in data["pump"][1]["lines"]] == ["planned", "simulated"]
    pressures = data["rows"]["cylinder-charts"][0]["charts"][0]["lines"]
    assert [line["name"] for line in pressures] == ["planned", "piston side", "rod side"]
    assert [group["title"] for group in data["rows"]["joint-charts"]] == ["Positions", "Errors", "Piston velocities"]
    assert len(data["rows"]["cylinder-charts"][0]["charts"]) == 3


def test_words_of_methods_controllers_and_events_are_no_markup(run):
    evil = "<img src=x onerror=alert(1)>"
    marked = replace(
        run,
        controller=evil,
        motion=replace(run.motion, method=evil),
        events=(Event(evil, "lift", 1.25, 0.5, evil),),
        status=Outcome(Kind.INCOMPLETE, evil),
    )
    assert "<img" not in simulation_page.page(marked)


def test_a_fact_that_a_template_names_and_nobody_gives_is_an_error(run):
    with pytest.raises(jinja2.UndefinedError, match="'task' is undefined"):
        rendering.page("simulation", {}, run=run)


def test_an_incomplete_run_says_so(run):
    page = simulation_page.page(
        replace(run, status=Outcome(Kind.INCOMPLETE, "incomplete: the solver gave up at 0.5 s"))
    )
    assert '<p class="badge bad">Incomplete</p>' in page and "the solver gave up at 0.5 s" in page


def test_a_plans_folder_gets_its_simulation_and_gives_way_as_a_whole(run, plan, tmp_path, monkeypatch):
    monkeypatch.setattr(plan_page, "page", lambda plan, grid=None: "<!doctype html>\n")
    folder = run_folder.write(plan, tmp_path / "run")
    kept = {name: (folder / name).read_text(encoding="utf-8") for name in run_folder.FILES}
    run_folder.add(folder, folder, run)
    assert sorted(path.name for path in folder.iterdir()) == sorted((*run_folder.FILES, *simulation_page.FILES))
    assert kept == {name: (folder / name).read_text(encoding="utf-8") for name in run_folder.FILES}
    other = run_folder.write(plan, tmp_path / "other", simulation=run)
    assert (other / "simulation.html").is_file()
    run_folder.write(plan, folder)  # a new plan was not simulated yet
    assert sorted(path.name for path in folder.iterdir()) == sorted(run_folder.FILES)


def test_a_run_folder_reads_as_the_motion_that_was_planned(plan, tmp_path, monkeypatch):
    monkeypatch.setattr(plan_page, "page", lambda plan, grid=None: "<!doctype html>\n")
    task, motion, pump = run_folder.read(run_folder.write(plan, tmp_path / "run"))
    assert pump == "cp" and (motion.method, motion.cost) == ("glide", "none")
    assert task == plan.task
    again = evaluate(task, motion)
    assert again.energy_cp == pytest.approx(plan.evaluation.energy_cp, rel=1e-6)
    assert again.length[:, -1] == pytest.approx(plan.evaluation.length[:, -1], abs=1e-6)


def test_what_is_no_run_folder_is_refused(plan, tmp_path, monkeypatch):
    with pytest.raises(InputError, match="is not a run folder: make one with leanboom plan"):
        run_folder.read(tmp_path)
    monkeypatch.setattr(plan_page, "page", lambda plan, grid=None: "<!doctype html>\n")
    folder = run_folder.write(plan, tmp_path / "run")
    (folder / "trajectory.csv").write_text("time_s,x_m\n0,1\n1,2\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"trajectory\.csv: line 2 lacks finite numbers in time_s"):
        run_folder.read(folder)
