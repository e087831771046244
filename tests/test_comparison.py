"""Comparisons: rows in order, failures with their reason, JSON as `plan` prints it, one real small comparison."""

from __future__ import annotations

import io
import json
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

import leanboom as lb
from leanboom.cli import app, result_tables
from leanboom.errors import InputError, LeanboomError
from leanboom.methods.registry import METHODS as REGISTRY
from leanboom.model import motion
from leanboom.model.outcome import SOLVED, Kind, Outcome
from leanboom.planning import planner, summaries
from leanboom.report import figures
from leanboom.study import comparison, processes
from leanboom.study.comparison import Entry
from leanboom.study.papers.experiments import EXPERIMENTS

BROKEN = Outcome(
    Kind.INFEASIBLE, "acceleration of tilt is 0.6000 m/s^2 at 1.000 s (stage 20), beyond its limit 0.5000 by 0.1000"
)
# What each method makes of the task: LS energy [J], or its status.
FATES = {
    "dp (ls)": 10e3,
    "dp (cp)": 12e3,
    "sns-actuator": BROKEN,
    "polish (ls)": 11e3,
    "polish (cp)": 13e3,
    "shooting (ls)": LeanboomError("not converged: Maximum_Iterations_Exceeded after 300 iterations"),
    "shooting (cp)": ValueError("a bug"),
}
WEAK = Outcome(
    Kind.UNDELIVERABLE,
    "limits kept, but the pump cannot deliver it: 132.1 l/min at 3.214 s, the pump gives 100.0 l/min",
)
NOT_CONVERGED = Outcome(Kind.UNCONVERGED, "not converged: Restoration_Failed")
METHODS = ["shooting", "sns-actuator", "polish", "dp:cp", "dp:ls"]


@pytest.fixture(scope="module")
def task():
    return lb.load_task("forwarder-vertical")


@pytest.fixture
def faked(monkeypatch, task):
    """Replaces the solver by one that is done at once, and the processes by a loop."""
    asked = []

    def solve(job):
        one, entry, pumps, _ = job
        asked.append(job)
        fate = FATES[entry.label]
        if isinstance(fate, Exception):
            raise fate
        status, energy = (SOLVED, fate) if isinstance(fate, float) else (fate, 9e3)
        numbers = dict.fromkeys(summaries.KEYS, 1.0) | {"task": one.name, "method": entry.method, "cost": entry.cost}
        # The other way round for the other pump.
        energies = {"ls": energy, "cp": 30e3 - energy}
        made = {p: numbers | {"pump": p, "status": status, "energy_j": energies[p]} for p in pumps}
        return made, motion.from_velocities(0.1, 0.5, np.zeros(61), entry.method, entry.cost)

    def each(function, arguments, workers=None, done=None):
        outcomes = []
        for index, argument in enumerate(arguments):
            try:
                outcomes.append(processes.CallResult(function(argument)))
            except LeanboomError as error:
                outcomes.append(processes.CallResult(failure=str(error), refused=True))
            except ValueError as error:
                outcomes.append(processes.CallResult(failure=f"ValueError: {error}"))
            if done is not None:
                done(index, outcomes[-1])
        return outcomes

    monkeypatch.setattr(comparison, "solve", solve)
    monkeypatch.setattr(comparison.processes, "each", each)
    return asked


def labels(rows):
    return [row.label for row in rows]


def leanboom(*arguments):
    return CliRunner().invoke(app.app, arguments, env={"COLUMNS": "200", "TERM": "dumb", "NO_COLOR": "1"})


def test_feasible_rows_lead_by_energy_then_broken_ones_then_failures(faked, task):
    result = lb.compare(task, methods=METHODS)
    assert labels(result.block("ls", "smallest")) == [
        "dp (ls)", "polish (ls)", "dp (cp)", "polish (cp)", "sns-actuator", "shooting (ls)", "shooting (cp)",
    ]  # fmt: skip
    assert labels(result.block("cp", "smallest"))[:4] == ["polish (cp)", "dp (cp)", "polish (ls)", "dp (ls)"]
    best = result.best("ls", "smallest")
    # The pseudo-inverse takes less energy, but breaks a limit.
    assert best is not None and best.label == "dp (ls)" and best.energy == 10e3
    broken = result.block("ls", "smallest")[4]
    assert (broken.energy, broken.status, broken.feasible) == (9e3, BROKEN, False)
    assert repr(result).startswith("Comparison(forwarder-vertical: 14 rows; ls from smallest: dp (ls) 10.00 kJ")


def test_one_solution_serves_both_pumps(faked, task):
    lb.compare(task, methods=["dp:ls"])
    assert [(entry.label, pumps) for _, entry, pumps, _ in faked] == [("dp (ls)", ("ls", "cp"))]


def test_a_motion_is_simulated_in_the_timing_that_was_planned(monkeypatch, task):
    """It lasts as long as that; in the path's own timing there was no simulation, and a dash in its column."""
    faster, driven = replace(task, path=task.path.slower(0.5)), []
    judged = lb.evaluate(faster, motion.held(0.7, 3.0, "dp", "cp"))
    plan = planner.Plan(faster, "cp", judged.motion, judged, None, 1)
    monkeypatch.setattr(comparison, "plan_row", lambda *asked, **settings: plan)
    monkeypatch.setattr(comparison, "_simulated", lambda task, motion, pump: driven.append(task) or {})
    comparison.solve((replace(task, timing="shortest"), Entry("dp", "cp"), ("cp",), True))
    assert driven == [faster]
    assert comparison._start_position(replace(task, timing="shortest", start=0.7)) == 0.7


def test_a_failed_method_is_a_row_without_numbers(faked, task):
    rows = {(row.label, row.pump): row for row in lb.compare(task, methods=["shooting", "dp:ls"]).rows}
    failed = rows["shooting (ls)", "cp"]
    assert tuple(failed.summary) == summaries.KEYS
    assert failed.status == "not converged: Maximum_Iterations_Exceeded after 300 iterations"
    assert failed.motion is None and not failed.feasible
    numbers = ("energy_j", "energy_ls_j", "energy_cp_j", "path_error_m", "solve_s", "peak_memory_bytes")
    assert all(failed.summary[key] is None for key in numbers)
    assert set(failed.summary["limit_use"].values()) == {None}
    assert failed.summary["start_m"] == pytest.approx(0.4102, abs=1e-3)
    assert rows["shooting (cp)", "ls"].status == "ValueError: a bug"


def test_every_method_is_compared_unless_it_takes_minutes():
    found = labels(comparison.entries(None, ("ls", "cp")))
    assert found[:5] == ["dp (ls)", "dp (cp)", "dp (actuator)", "dp (velocity)", "dp (extension)"]
    assert {"dp1 (ls)", "dp1 (cp)", "polish (ls)", "shooting (cp)", "pseudospectral (ls)"} < set(found)
    assert found[-3:] == ["sns-joint", "sns-actuator", "sns-actuator-weighted"]
    assert not any("dp-paper" in label for label in found)
    assert labels(comparison.entries(["dp-paper"], ("cp",))) == ["dp-paper (cp)"]
    assert labels(comparison.entries(["dp(ls)", "dp:ls"], ("cp",))) == ["dp (ls)"]


@pytest.mark.parametrize(
    ("methods", "message"),
    [
        (["best"], "method = best; must be one of dp, polish, pseudospectral, shooting, dp1, dp-paper, sns-joint,"),
        (["dp:heat"], "cost = heat; must be one of "),
        (["sns-joint:ls"], "method = sns-joint:ls; a pseudo-inverse minimises joint-velocity at every instant"),
        (["shooting:velocity"], "method = shooting:velocity; minimises ls, cp alone"),
        ([], "methods = nothing; choose some of dp, "),
    ],
)
def test_methods_that_do_not_exist_or_do_not_apply(task, methods, message):
    with pytest.raises(InputError) as error:
        lb.compare(task, methods=methods)
    assert str(error.value).startswith(message)


def test_other_arguments_that_cannot_be_used(task):
    with pytest.raises(InputError, match=r"^pump = hp; must be some of ls, cp$"):
        lb.compare(task, "hp")
    with pytest.raises(InputError, match=r"^start = 0\.1 m; feasible at the beginning of this path: "):
        lb.compare(task, start=0.1)


def test_a_point_wise_method_cannot_choose_the_start(task):
    """Not an error of the comparison: the other methods can."""
    result = lb.compare(task, "ls", start="best", methods=["sns-joint"], workers=1)
    assert result.best("ls", "best") is None
    assert result.rows[0].status == "start = best; method sns-joint needs smallest, middle or a length"


def test_json_is_a_list_of_what_plan_prints(faked):
    answer = leanboom(*"compare forwarder-vertical --json --methods dp:ls,shooting --start smallest,middle".split())
    assert answer.exit_code == 0
    rows = json.loads(answer.stdout)
    assert len(rows) == 2 * 2 * 3 and all(tuple(row) == summaries.KEYS for row in rows)
    assert {row["pump"] for row in rows} == {"ls", "cp"}
    assert "leanboom: dp (ls) from middle done: 4 of 6" in answer.stderr


def test_people_get_a_table_with_the_reasons(faked):
    answer = leanboom("compare", "forwarder-vertical", "--methods", ",".join(METHODS), "--pump", "ls")
    assert answer.exit_code == 0
    lines = [line.split() for line in answer.stdout.splitlines()]
    assert ["dp", "(ls)", "10.00", "1.000", "1.0", "best"] in lines
    assert any("not converged: Maximum_Iterations_Exceeded" in line for line in answer.stdout.splitlines())


@pytest.fixture
def weak(monkeypatch):
    """One method is too much for the pump."""
    monkeypatch.setitem(FATES, "dp (ls)", WEAK)


def test_what_the_pump_cannot_deliver_is_no_best_row_and_no_failure(faked, weak, task):
    result = lb.compare(task, methods=METHODS)
    block = result.block("ls", "smallest")
    assert labels(block)[:5] == ["polish (ls)", "dp (cp)", "polish (cp)", "dp (ls)", "sns-actuator"]
    best = result.best("ls", "smallest")
    assert best is not None and best.label == "polish (ls)"
    assert block[3].feasible and not block[3].solved and not block[4].feasible
    answer = leanboom("compare", "forwarder-vertical", "--methods", "dp:ls", "--pump", "ls")
    assert answer.exit_code == 0
    assert WEAK in answer.stderr and WEAK in answer.stdout and "beyond the pump" in answer.stdout
    assert "9.00" in answer.stdout and "1.000" not in answer.stdout  # no ratio, no best
    assert figures.energies(result) != figures.energies(lb.compare(task, methods=["polish", "sns-actuator"]))


def test_a_motion_for_one_pump_alone_is_marked_in_both_bars(task):
    """Its label is one: the bars of a motion that one of the pumps cannot deliver once had different names."""
    still = motion.from_velocities(0.1, 0.5, np.zeros(61), "dp", "ls")
    made = [
        comparison.Row(Entry("dp", "ls"), pump, "smallest", {"energy_j": 5e3, "status": status, "solve_s": 1.0}, still)
        for pump, status in (("ls", WEAK), ("cp", SOLVED))
    ]
    result = comparison.Comparison(task, ("ls", "cp"), ("smallest",), tuple(made))
    assert figures.energies(result).startswith(b"\x89PNG") and figures.trajectories(result).startswith(b"\x89PNG")


@pytest.mark.parametrize("width", [50, 30])
def test_a_narrow_terminal_cuts_no_number(faked, task, width):
    """At 50 columns the table once ended in an ellipsis in place of energies and times."""
    result = lb.compare(task, methods=METHODS)
    text = io.StringIO()
    result_tables.comparison(Console(file=text, width=width), result, None)
    assert "…" not in text.getvalue()
    words = text.getvalue().split()
    for row in result.rows:
        assert row.energy is None or f"{row.energy / 1e3:.2f}" in words
        assert row.label.split()[0] in words
    assert BROKEN.rsplit(maxsplit=1)[-1] + "." in words


def test_without_a_feasible_row_the_exit_code_says_so(faked):
    answer = leanboom("compare", "forwarder-vertical", "--methods", "sns-actuator")
    assert answer.exit_code == 1
    assert "no method found a feasible motion" in answer.stderr
    assert "best" not in answer.stdout


def test_the_folder_holds_rows_bars_and_motions(faked, tmp_path):
    out = tmp_path / "new"
    arguments = ("compare", "forwarder-vertical", "--methods", ",".join(METHODS), "--out", str(out))
    assert leanboom(*arguments).exit_code == 0
    assert sorted(path.name for path in out.iterdir()) == ["comparison.json", "energies.png", "trajectories.png"]
    assert len(json.loads((out / "comparison.json").read_text())) == 14
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in out.glob("*.png"))
    assert leanboom(*arguments).exit_code == 0  # an earlier comparison gives way
    (out / "diary.txt").write_text("dear")
    answer = leanboom(*arguments)
    assert answer.exit_code == 2 and "holds diary.txt" in answer.stderr


def test_the_same_rows_give_the_same_picture(faked, task):
    result = lb.compare(task, methods=METHODS)
    assert figures.energies(result) == figures.energies(result)


def test_solving_calls_the_planner_as_plan_does(monkeypatch, task):
    """Status and numbers are those of the planner, for each pump; a pseudo-inverse has a cost of its own."""
    called = []
    judged = lb.evaluate(task, motion.from_velocities(0.1, 0.6, np.zeros(61), "sns-joint", "ls"))

    def run(one, **settings):
        called.append(settings)
        return lb.Plan(one, "ls", judged.motion, judged, None, 7)

    monkeypatch.setattr(comparison.planner, "run", run)
    found, made = comparison.solve((task, Entry("sns-joint", "joint-velocity"), ("ls", "cp"), False))
    assert called == [{"pump": "ls", "cost": None, "method": "sns-joint", "baseline": False, "check": False}]
    assert made is judged.motion
    assert found["cp"]["energy_j"] == judged.energy_cp and found["ls"]["energy_j"] == judged.energy_ls
    assert found["ls"]["cost"] == "joint-velocity"


@pytest.mark.slow
def test_a_simulated_comparison_has_the_closed_loops_energy_beside_the_plans(monkeypatch, task):
    judged = lb.evaluate(task, motion.from_velocities(0.1, 0.6713, np.zeros(61), "sns-joint", "ls"))
    monkeypatch.setattr(comparison.planner, "run", lambda one, **_: lb.Plan(one, "ls", judged.motion, judged, None, 7))
    found, made = comparison.solve((task, Entry("sns-joint", "joint-velocity"), ("ls", "cp"), True))
    for pump in ("ls", "cp"):
        run = lb.simulate(task, made, pump)
        assert found[pump]["simulated_energy_j"] == run.energy
        assert found[pump]["simulated_path_accuracy_m"] == run.path_accuracy
    row = comparison.Row(Entry("sns-joint", "joint-velocity"), "ls", "smallest", found["ls"], made)
    text = io.StringIO()
    result_tables.comparison(
        Console(file=text, width=160), comparison.Comparison(task, ("ls",), ("smallest",), (row,)), None
    )
    assert "simulated" in text.getvalue() and f"{row.simulated / 1e3:.2f}" in text.getvalue()


def test_a_motion_out_of_reach_is_not_simulated(monkeypatch, task):
    far = lb.evaluate(task, motion.from_velocities(0.1, 5.0, np.zeros(61), "sns-joint", "ls"))
    monkeypatch.setattr(comparison.planner, "run", lambda one, **_: lb.Plan(one, "ls", far.motion, far, None, 7))
    found, _ = comparison.solve((task, Entry("sns-joint", "joint-velocity"), ("ls",), True))
    assert found["ls"]["simulated_energy_j"] is None and found["ls"]["simulated_path_accuracy_m"] is None


def test_a_failed_method_is_not_simulated(faked, task):
    (row,) = lb.compare(task, "ls", methods=["shooting:ls"], simulate=True).rows
    assert tuple(row.summary) == (*summaries.KEYS, *comparison.SIMULATED) and row.simulated is None


def test_a_program_that_did_not_converge_is_no_result(monkeypatch, task):
    still = motion.from_velocities(0.1, 0.6, np.zeros(61), "shooting", "ls", status=NOT_CONVERGED)
    judged = lb.evaluate(task, still)
    monkeypatch.setattr(comparison.planner, "run", lambda one, **_: lb.Plan(one, "ls", still, judged, None, 7))
    with pytest.raises(LeanboomError, match=r"^not converged: Restoration_Failed$"):
        comparison.solve((task, Entry("shooting", "ls"), ("ls",), False))


def test_a_real_comparison(task):
    short = replace(task, start="middle")
    result = lb.compare(short, "cp", methods=["dp:cp", "sns-actuator"])
    dp, pointwise = result.rows
    assert dp.label == "dp (cp)" and dp.feasible and pointwise.motion is not None
    assert dp.energy == pytest.approx(lb.evaluate(short, dp.motion).energy_cp, rel=1e-12)
    assert (dp.energy or 0.0) < (pointwise.energy or 0.0)


def test_help_names_every_method_and_experiment():
    words = " ".join(leanboom("compare", "--help").stdout.replace("│", " ").split())
    assert all(name in words for name in REGISTRY.names())
    words = " ".join(leanboom("reproduce", "--help").stdout.replace("│", " ").split())
    assert all(name in words for name in EXPERIMENTS)
