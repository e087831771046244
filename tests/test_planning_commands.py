"""The commands that plan: what they hand on, where results go, exit codes, and messages that say what to change."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from command_line import leanboom, words
from leanboom.cli import terminal
from leanboom.components import costs
from leanboom.dynamic_programming import value_function
from leanboom.errors import InfeasibleError
from leanboom.evaluation.evaluate import evaluate
from leanboom.io import folders, loading
from leanboom.methods.registry import METHODS
from leanboom.model import motion
from leanboom.planning import planner, summaries
from leanboom.report import run_folder
from leanboom.study import comparison
from leanboom.study.papers import reproduction

TASKS = (
    "forwarder-cycle, forwarder-half-cycle, forwarder-horizontal, forwarder-vertical, loader-cycle, "
    "loader-triangle-large, loader-triangle-medium, loader-triangle-small"
)


@pytest.fixture(scope="module")
def planned():
    """A plan that holds the telescope, made without a solver."""
    task = loading.load_task("forwarder-vertical", start=0.6713)
    judged = evaluate(task, motion.from_velocities(0.1, 0.6713, np.zeros(61), "dp", "ls", solve_s=0.5))
    other = evaluate(task, motion.from_velocities(0.1, 0.516, np.zeros(61), "sns-actuator", "velocity"))
    return planner.Plan(task, "ls", judged.motion, judged, other, 64 << 20)


@pytest.fixture
def calls(monkeypatch, planned):
    """Replaces the planner by one that is done at once; what it was asked is kept."""
    asked = []

    def run(task, **settings):
        settings.pop("progress")("loading", 0.0)
        asked.append((task, settings))
        return planned

    monkeypatch.setattr(planner, "run", run)
    return asked


def test_plan_prints_json_and_nothing_else(calls, planned):
    result = leanboom("plan", "forwarder-vertical", "--json")
    assert result.exit_code == 0
    assert result.stderr == ""
    found = json.loads(result.stdout)
    assert found == summaries.summary(planned)
    assert tuple(found) == summaries.KEYS


def test_plan_hands_its_options_on(calls):
    leanboom(
        *"plan forwarder-vertical --pump cp --cost actuator --method dp1 --grid 41x21 --start".split(), "45 cm",
        "--step", "100 ms", "--effort", "quick", "--seconds", "2 min", "--gap", "3 %",
    )  # fmt: skip
    task, settings = calls[0]
    assert task.start == 0.45
    chosen = {"pump": "cp", "cost": "actuator", "method": "dp1", "grid": (41, 21), "step": 0.1}
    assert settings == chosen | {"effort": "quick", "seconds": 120.0, "gap": 3.0, "check": False}


def test_plan_without_options_uses_the_stated_defaults(calls):
    leanboom("plan", "forwarder-vertical")
    task, settings = calls[0]
    assert task.start == "smallest"
    defaults = {"pump": "ls", "cost": None, "method": "dp", "grid": (121, 61), "step": 0.05, "effort": "default"}
    assert settings == defaults | {"seconds": 300.0, "gap": None, "check": False}


def test_a_plan_the_pump_cannot_deliver_ends_well_but_never_reads_solved(monkeypatch, planned):
    """Limits are kept, so the exit code is 0; JSON, table and standard error say what the pump lacks."""
    task = planned.task
    weak = replace(task, machine=replace(task.machine, pump=replace(task.machine.pump, max_flow=5.0 / 6e4)))
    judged = evaluate(weak, planned.motion)
    monkeypatch.setattr(planner, "run", lambda *_, **__: replace(planned, task=weak, evaluation=judged))
    told = leanboom("plan", "forwarder-vertical", "--json")
    status = json.loads(told.stdout)["status"]
    assert status.startswith("limits kept, but the pump cannot deliver it: ") and "the pump gives 5.0 l/min" in status
    assert told.exit_code == 0 and told.stderr == f"leanboom: {status}\n"
    shown = leanboom("plan", "forwarder-vertical")
    assert shown.exit_code == 0 and "all kept" not in shown.stdout and "%  \n" not in shown.stdout
    assert "NOT SOLVED" in shown.stdout and status in words(shown.stdout)


def test_plan_tells_people_energies_saving_limits_and_assumptions(calls, planned):
    result = leanboom("plan", "forwarder-vertical")
    mine, theirs = planned.evaluation.energy_ls, planned.baseline.energy_ls
    text = words(result.stdout)
    assert result.exit_code == 0 and result.stderr == ""
    saving = f"{mine / 1e3:.2f} {theirs / 1e3:.2f} {100 * (1 - mine / theirs):.1f} %"
    assert f"load-sensing pump (chosen) {saving}" in text
    assert "Limits all kept" in text
    assert "61 of 122 machine values are assumed (leanboom check forwarder)." in text


def test_plan_writes_a_run_folder(calls, tmp_path):
    result = leanboom("plan", "forwarder-vertical", "--out", str(tmp_path / "run"))
    assert result.exit_code == 0
    assert str(tmp_path / "run" / "report.html") in result.stdout
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == sorted(run_folder.FILES)


def test_plan_refuses_a_strange_folder_before_it_plans(calls, tmp_path):
    (tmp_path / "precious").write_text("", encoding="utf-8")
    result = leanboom("plan", "forwarder-vertical", "--out", str(tmp_path))
    assert result.exit_code == 2
    assert "holds precious: give a new or empty folder" in result.stderr
    assert calls == []


def test_no_command_works_for_a_place_it_cannot_write(calls, monkeypatch, tmp_path):
    """A folder below a file was refused when all was computed."""

    def solved(*_, **__):
        raise AssertionError("work began")

    monkeypatch.setattr(comparison, "compare", solved)
    monkeypatch.setattr(reproduction, "reproduce", solved)
    (tmp_path / "file").touch()
    below = ("--out", str(tmp_path / "file" / "x"))
    for command in (
        ("plan", "forwarder-vertical", *below), ("simulate", "forwarder-vertical", *below),
        ("compare", "forwarder-vertical", *below), ("reproduce", "table2", *below),
        ("reproduce", "table2", "--out", str(tmp_path / "kept"), "--docs", str(tmp_path / "file" / "x")),
    ):  # fmt: skip
        result = leanboom(*command)
        assert result.exit_code == 2, command
        assert f"x; cannot be written: {tmp_path / 'file'} is a file, not a folder\n" in result.stderr
    assert calls == []
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_no_command_works_for_a_place_where_another_run_will_write(calls, monkeypatch, tmp_path):
    monkeypatch.setattr(comparison, "compare", lambda *_, **__: pytest.fail("work began"))
    out = tmp_path / "run"
    with folders.reserved(out):
        for command in ("plan", "simulate", "compare"):
            result = leanboom(command, "forwarder-vertical", "--out", str(out))
            assert result.exit_code == 2
            assert result.stderr.startswith(f"leanboom: out = {out}; another run of leanboom writes there: ")
    assert calls == []
    assert leanboom("plan", "forwarder-vertical", "--out", str(out)).exit_code == 0


BAD = {
    "task": (("nope",), f"leanboom: task = nope; must be a file or a bundled task: {TASKS}\n"),
    "grid": (
        ("forwarder-vertical", "--grid", "201"),
        "leanboom: grid = 201; must be positions x velocities, such as 201x101\n",
    ),
    "two at once": (
        ("forwarder-vertical", "--grid", "ax3", "--step", "-1"),
        "leanboom: grid = ax3; must be positions x velocities, such as 201x101\n"
        "step = -1; must be a time above 0, such as 0.05 or '50 ms'\n",
    ),
    "step": (
        ("forwarder-vertical", "--step", "5 mm"),
        "leanboom: step = 5 mm; must be a time above 0, such as 0.05 or '50 ms'\n",
    ),
    "no unit": (
        ("forwarder-vertical", "--step", "50 ticks"),
        "leanboom: step = 50 ticks; must be a time above 0, such as 0.05 or '50 ms'; ticks is not a unit here\n",
    ),
    "digits of another script": (
        ("forwarder-vertical", "--grid", "٤١x２１", "--step", "٠.١", "--start", "٠.٥ m"),
        "leanboom: grid = ٤١x２１; must be positions x velocities, such as 201x101\n"
        "step = ٠.١; must be a time above 0, such as 0.05 or '50 ms'; numbers are written with 0-9 and a decimal "
        "point\n",
    ),
    "start in feet": (
        ("forwarder-vertical", "--start", "2 ft"),
        "leanboom: start = 2 ft; must be smallest, middle, best, or a length of the redundant cylinder such as "
        "0.3 m; ft is not a unit here\n",
    ),
    "start": (
        ("forwarder-vertical", "--start", "largest"),
        "leanboom: start = largest; must be smallest, middle, best, or a length of the redundant cylinder such as "
        "0.3 m\n",
    ),
}


@pytest.mark.parametrize(("arguments", "message"), BAD.values(), ids=BAD)
def test_plan_refuses_bad_input(calls, arguments, message):
    result = leanboom("plan", *arguments)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr == message
    assert calls == []


@pytest.mark.parametrize("gap", ["٥", "half", "0.5 m", "1_0"])
def test_certify_refuses_a_gap_that_is_no_number_of_per_cent(calls, gap):
    result = leanboom("certify", "forwarder-vertical", "--gap", gap)
    assert result.exit_code == 2
    assert result.stderr.startswith(f"leanboom: gap = {gap}; must be a number of per cent, such as 0.5")
    assert calls == []


@pytest.mark.parametrize("option", ["--method", "--cost"])
def test_unknown_methods_and_costs_list_the_valid_ones(option):
    result = leanboom("plan", "forwarder-vertical", option, "nope")
    assert result.exit_code == 2
    names = METHODS.names() if option == "--method" else costs.COSTS
    assert all(name in result.stderr for name in names)


def test_no_feasible_motion_exits_with_1(monkeypatch):
    def run(task, **settings):
        raise InfeasibleError("the tool is out of reach at 1.00 s (stage 20)")

    monkeypatch.setattr(planner, "run", run)
    result = leanboom("plan", "forwarder-vertical", "--json")
    assert result.exit_code == 1
    assert result.stdout == ""
    assert result.stderr == "leanboom: the tool is out of reach at 1.00 s (stage 20)\n"


@pytest.fixture
def broken(monkeypatch, planned):
    """A plan that breaks limits, for the planner's answer: the task's own path, in a fifth of the time."""
    task = planned.task
    fast = type(task)(task.name, task.machine, type(task.path)(task.path.points, (1.2,)))
    judged = evaluate(fast, motion.from_velocities(0.1, 0.6713, np.zeros(13), "dp", "ls"))
    monkeypatch.setattr(planner, "run", lambda *_, **__: planner.Plan(fast, "ls", judged.motion, judged, None, 0))
    return judged


def test_an_infeasible_plan_is_shown_and_exits_with_1(broken):
    result = leanboom("plan", "forwarder-vertical", "--json")
    assert result.exit_code == 1
    assert json.loads(result.stdout)["status"] == broken.status != "solved"
    assert result.stderr == f"leanboom: {broken.status}\n"
    assert "Violated" in leanboom("plan", "forwarder-vertical").stdout


def test_an_infeasible_plan_is_driven_without_a_comparison_and_exits_with_1(broken, tmp_path):
    """It ended with 0, and took "+42015418.2 %" where a jump of the tool had cost the plan nothing."""
    file = tmp_path / "fast.yaml"
    file.write_text(loading.dump_task(broken.task, "forwarder"), encoding="utf-8")
    result = leanboom("simulate", str(file), "--out", str(tmp_path / "run"))
    assert result.exit_code == 1, result.stderr
    assert result.stderr.endswith(f"leanboom: {broken.status}\n")
    assert re.search(r"Energy +[0-9.]+ kJ simulated, [0-9.]+ kJ planned\n", result.stdout)
    page = (tmp_path / "run" / "simulation.html").read_text(encoding="utf-8")
    assert re.search(r"takes <strong>[0-9.]+ kJ</strong>, beside the [0-9.]+ kJ of the plan", page)


def test_ctrl_c_exits_with_130_and_leaves_nothing(monkeypatch, tmp_path):
    def run(task, **settings):
        raise KeyboardInterrupt

    monkeypatch.setattr(planner, "run", run)
    result = leanboom("plan", "forwarder-vertical", "--out", str(tmp_path / "run"))
    assert result.exit_code == 130
    assert "Traceback" not in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_slow_beginning_is_told_on_standard_error(monkeypatch, planned):
    import time

    def run(task, **settings):
        settings["progress"]("loading kernels", 0.0)
        time.sleep(0.3)
        return planned

    monkeypatch.setattr(planner, "run", run)
    monkeypatch.setattr(terminal, "PATIENCE", 0.05)
    result = leanboom("plan", "forwarder-vertical", "--json")
    assert result.stderr == "leanboom: loading kernels\n"
    assert json.loads(result.stdout)["status"] == "solved"


def test_a_baseline_is_planned_from_end_to_end(monkeypatch, tmp_path):
    monkeypatch.setattr(value_function, "prepare", lambda: None)  # the pseudo-inverse needs no kernel
    out = tmp_path / "run"
    result = leanboom("plan", "forwarder-vertical", "--method", "sns-actuator", "--out", str(out), "--json")
    assert result.exit_code == 0, result.stderr
    found = json.loads(result.stdout)
    assert found == json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert found["energy_j"] == pytest.approx(17.16e3, rel=0.01)
    assert found["method"] == "sns-actuator"


SIMULATED = [
    "task", "pump", "method", "energy_j", "planned_energy_j", "path_accuracy_m", "balance_error",
    "legs", "wall_s", "realtime_factor", "events", "out",
]  # fmt: skip


def test_simulate_prints_json_and_nothing_else(calls):
    result = leanboom("simulate", "forwarder-vertical", "--json")
    assert result.exit_code == 0, result.stderr
    found = json.loads(result.stdout)
    assert list(found) == SIMULATED
    assert found["out"] is None and found["pump"] == "ls"
    assert calls[0][1]["method"] == "dp"


def test_simulate_adds_to_a_run_folder_and_tells_people(calls, tmp_path):
    out = tmp_path / "run"
    assert leanboom("plan", "forwarder-vertical", "--out", str(out)).exit_code == 0
    result = leanboom("simulate", str(out), "--pump", "cp")
    assert result.exit_code == 0, result.stderr
    assert "kJ simulated" in result.stdout and "simulation.html" in result.stdout
    kept = json.loads((out / "simulation.json").read_text(encoding="utf-8"))
    assert list(kept) == SIMULATED and kept["pump"] == "cp" and kept["out"] == str(out)
    assert (out / "report.html").is_file()
    again = leanboom("simulate", str(out), "--out", str(tmp_path / "other"), "--json")
    assert json.loads(again.stdout)["pump"] == "ls"  # what the folder was planned for
    assert (tmp_path / "other" / "trajectory.csv").is_file()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("forwarder-vertical", "--pump", "gas"), "pump = gas; must be one of ls, cp"),
        (("nowhere",), "must be a file or a bundled task"),
        ((".", "--method", "dp"), "leave --method out"),
        ((".",), "is not a run folder"),
    ],
)
def test_simulate_refuses_bad_input(calls, arguments, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = leanboom("simulate", *arguments)
    assert result.exit_code == 2
    assert message in words(result.stderr)
    assert result.stdout == ""


def test_an_incomplete_simulation_is_kept_and_exits_with_1(calls, tmp_path, monkeypatch):
    from leanboom.simulation import integrator

    advance = integrator.Integrator.advance

    def stuck(self, sample):
        if self._step < 0.005:  # the controller's table is measured in longer ones
            raise integrator.SolverError("the solver gave up: it was told to")
        return advance(self, sample)

    monkeypatch.setattr(integrator.Integrator, "advance", stuck)
    result = leanboom("simulate", "forwarder-vertical", "--out", str(tmp_path / "run"), "--json")
    assert result.exit_code == 1
    assert json.loads(result.stdout)["events"][-1]["kind"] == "solver"
    assert "incomplete: the solver gave up" in result.stderr
    assert (tmp_path / "run" / "simulation.html").is_file()
