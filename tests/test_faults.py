"""A small part of `benchmarks.faults`: mutated files, mutated machines, killed runs; and that faults are found."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from benchmarks import faults

from bundled_texts import written
from leanboom.errors import InputError
from leanboom.io.loading import load_machine, load_task
from leanboom.planning import planner
from leanboom.report import run_folder

SEED = 2017
SHORT = """\
machine: forwarder
payload: 0 kg
path:
  type: lines
  points: [[5.5, 0, 4.0], [5.5, 0, 3.4]]
  durations: [2 s]
start: smallest
"""


@pytest.mark.slow
def test_mutated_files_load_or_are_refused_in_words():
    tally = faults.mutated_files(range(80), SEED)
    assert not tally.finds, "\n".join(map(str, tally.finds))
    assert tally.counts["machine files"] == tally.counts["task files"] == 40
    assert min(tally.counts["loaded"], tally.counts["refused"]) > 9


def test_every_mutation_changes_files():
    for mutation in faults.MUTATIONS:
        rng = np.random.default_rng(SEED)
        texts = faults.TEXTS["machine"]
        changed = {mutation(texts["forwarder"], texts["loader"], rng) for _ in range(10)}
        assert len(changed - {texts["forwarder"]}) > 2, mutation


def _raises(path):
    raise ValueError("could not convert string to float")


def _warns(path):
    warnings.warn("overflow in multiply", RuntimeWarning, stacklevel=1)
    return load_machine(path)


def _is_long_winded(path):
    raise InputError("1" * faults.LONGEST)


def _reads_another(path):
    """A loader of which nothing that is written comes back."""
    return replace(load_machine("loader"), description=path.name)


@pytest.mark.parametrize(
    ("loader", "said"),
    [
        (_raises, "ValueError"),
        (_warns, "RuntimeWarning"),
        (_is_long_winded, "refused in 10000 characters"),
        (_reads_another, "loads as something else"),
    ],
)
def test_a_loader_with_a_fault_is_found(loader, said, monkeypatch):
    monkeypatch.setattr(faults, "mutated", lambda text, other, rng: text.encode())
    finds = faults.mutated_files([4], SEED, machine=loader).finds
    assert len(finds) == 1
    assert said in finds[0].what
    assert finds[0].case == "file 4"


@pytest.mark.slow
def test_plans_of_mutated_machines_are_finite_and_keep_their_limits():
    tally = faults.mutated_plans(range(6), SEED, [SHORT])
    assert not tally.finds, "\n".join(map(str, tally.finds))
    assert tally.counts["solved"] > 0


@pytest.mark.slow
def test_a_plan_that_falls_behind_or_breaks_a_limit_is_found(monkeypatch, tmp_path):
    task = load_task(written(tmp_path, SHORT), start="middle")
    tally = faults.Tally()
    run = planner.run
    swapped = {"dp": "sns-actuator", "dp1": "dp"}
    monkeypatch.setattr(planner, "run", lambda task, *, method="dp", **how: run(task, method=swapped[method], **how))
    with faults._watched(tally, "plan 0", str):
        faults._plan(tally, task, "ls", "dp1")
    monkeypatch.setattr(planner, "run", run)
    monkeypatch.setattr(faults.lb, "evaluate", lambda task, motion: planner.evaluate(slowed(task), motion))
    with faults._watched(tally, "plan 1", str):
        faults._plan(tally, task, "ls", "sns-actuator")
    behind, breaking = (find.what for find in tally.finds)
    assert "ls: dp " in behind
    assert "judged again" in breaking


def slowed(task):
    """The same task for a machine a tenth as fast."""
    cylinders = tuple(replace(c, velocity_limit=0.1 * c.velocity_limit) for c in task.machine.cylinders)
    return replace(task, machine=replace(task.machine, cylinders=cylinders))


@pytest.mark.slow
def test_killed_runs_leave_a_whole_folder_or_none_and_the_next_run_nothing_hidden(tmp_path):
    tally = faults.killed_runs([2, 3], SEED, "sns-actuator", str(written(tmp_path, SHORT)))
    assert not tally.finds, "\n".join(map(str, tally.finds))
    assert tally.counts["runs sent SIGKILL"] == tally.counts["runs sent SIGINT"] == 1


def test_what_a_killed_run_leaves_is_found(monkeypatch, tmp_path):
    monkeypatch.setattr(faults, "_undisturbed", lambda tally, command, out, case: out.mkdir(exist_ok=True))

    def leave(command, out, sent, after, writing):
        out.mkdir(exist_ok=True)
        (out / run_folder.SUMMARY).write_text("{")
        out.with_name(".run.leanboom-new-01234567").mkdir()
        return 'Traceback (most recent call last):\n  File "/usr/lib/leanboom/cli.py"\nKeyboardInterrupt'

    monkeypatch.setattr(faults, "_stopped", leave)
    finds = faults.killed_runs([1], SEED).finds
    assert [find.what.split(":")[0].split(" = ")[0] for find in finds] == [
        "a traceback",
        "run",
        "left beside the folder after an undisturbed run",
    ]


def test_half_of_the_killed_runs_are_to_replace_a_folder_whatever_became_of_those_before(monkeypatch):
    """Once a folder was gone, all later runs began without one."""
    monkeypatch.setattr(faults, "_undisturbed", lambda tally, command, out, case: out.mkdir(exist_ok=True))
    began = []
    monkeypatch.setattr(faults, "_stopped", lambda command, out, *_: began.append(out.exists()) or "")
    monkeypatch.setattr(faults, "_complete", lambda out: None)
    assert not faults.killed_runs(range(20), SEED).finds
    assert 3 <= sum(began[10:]) <= 7
