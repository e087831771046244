"""The run folder: exact contents, all or nothing, and nobody else's files."""

from __future__ import annotations

import csv
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from leanboom.errors import InputError
from leanboom.evaluation.evaluate import evaluate
from leanboom.io import loading
from leanboom.model import motion
from leanboom.planning import planner, summaries
from leanboom.report import plan_page, run_folder


@pytest.fixture(scope="module")
def plan():
    task = loading.load_task("forwarder-vertical", start=0.6713)
    judged = evaluate(task, motion.from_velocities(0.1, 0.6713, np.zeros(61), "dp", "ls", solve_s=0.5))
    return planner.Plan(task, "ls", judged.motion, judged, None, 1 << 20)


@pytest.fixture(autouse=True)
def _small_report(monkeypatch):
    monkeypatch.setattr(plan_page, "page", lambda plan, grid=None: "<!doctype html>\n")


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_summary_has_the_agreed_keys_and_types(plan):
    found = summaries.summary(plan, Path("out"))
    assert list(found) == [
        "task", "machine", "pump", "cost", "method", "start_m", "end_m", "status", "duration_s", "energy_j",
        "energy_ls_j", "energy_cp_j", "legs", "limit_use", "path_error_m", "solve_s", "peak_memory_bytes", "out",
    ]  # fmt: skip
    assert list(found["limit_use"]) == ["position", "velocity", "acceleration", "flow"]
    words = {key: value for key, value in found.items() if isinstance(value, str)}
    assert words == {
        "task": "forwarder-vertical", "machine": "forwarder", "pump": "ls", "cost": "ls", "method": "dp",
        "status": "solved", "out": "out",
    }  # fmt: skip
    numbers = [value for key, value in found.items() if key not in (*words, "legs", "limit_use", "peak_memory_bytes")]
    assert all(type(value) is float for value in [*numbers, *found["limit_use"].values()])
    assert type(found["peak_memory_bytes"]) is int
    assert found["energy_j"] == found["energy_ls_j"] == plan.evaluation.energy_ls
    assert summaries.summary(plan)["out"] is None


def test_numbers_that_are_not_finite_are_null():
    assert summaries._finite(float("nan")) is None
    assert summaries._finite(np.float64(2.0)) == 2.0


def test_the_folder_holds_five_files(plan, tmp_path):
    out = run_folder.write(plan, tmp_path / "deep" / "run")
    assert names(out) == sorted(run_folder.FILES)
    assert names(out.parent) == ["run"]
    assert json.loads((out / "summary.json").read_text(encoding="utf-8")) == summaries.summary(plan, out)


def test_task_and_machine_load_as_they_were(plan, tmp_path):
    out = run_folder.write(plan, tmp_path / "run")
    assert loading.load_task(out / "task.yaml") == plan.task
    assert loading.load_machine(out / "machine.yaml") == plan.task.machine


def test_columns_are_exactly_those_agreed(plan):
    joints = [f"{name}_{unit}" for name in ("base", "lift", "tilt") for unit in ("rad", "rad_s", "rad_s2")]
    cylinders = [
        f"{name}_{what}"
        for name in ("base", "lift", "tilt", "extension")
        for what in ("cylinder_m", "cylinder_m_s", "cylinder_m_s2", "force_n", "pressure_pa", "flow_m3_s")
    ]
    expected = [
        "time_s", "x_m", "y_m", "z_m", *joints, "extension_m", "extension_m_s", "extension_m_s2", *cylinders,
        "pump_flow_m3_s", "supply_ls_pa", "supply_cp_pa", "power_ls_w", "power_cp_w", "energy_ls_j", "energy_cp_j",
    ]  # fmt: skip
    assert list(run_folder.columns(plan.evaluation)) == expected


def test_trajectory_holds_every_sample_of_the_judge(plan, tmp_path):
    out = run_folder.write(plan, tmp_path / "run")
    with (out / "trajectory.csv").open(newline="", encoding="utf-8") as stream:
        rows = list(csv.reader(stream))
    judged = plan.evaluation
    assert len(rows) == 1 + judged.time.size
    values = np.array(rows[1:], dtype=float)
    table = dict(zip(rows[0], values.T, strict=True))
    np.testing.assert_allclose(np.diff(table["time_s"]), 0.002, rtol=1e-6)
    expected = {
        "z_m": judged.tool[:, 2], "lift_rad_s2": judged.joint_acceleration[:, 1],
        "extension_m": judged.joint_position[:, 3], "tilt_cylinder_m": judged.length[:, 2],
        "tilt_cylinder_m_s": judged.velocity[:, 2], "lift_force_n": judged.force[:, 1],
        "lift_pressure_pa": judged.pressure[:, 1], "tilt_flow_m3_s": judged.flow[:, 2],
        "supply_ls_pa": judged.supply_ls, "power_cp_w": judged.power_cp, "energy_ls_j": judged.cumulative_ls,
    }  # fmt: skip
    for name, column in expected.items():
        np.testing.assert_allclose(table[name], column, rtol=1e-9, atol=1e-300, err_msg=name)


def test_an_earlier_run_folder_is_replaced(plan, tmp_path):
    out = run_folder.write(plan, tmp_path / "run")
    (out / "report.html").write_text("old", encoding="utf-8")
    run_folder.write(plan, out)
    assert (out / "report.html").read_text(encoding="utf-8") == "<!doctype html>\n"
    assert names(tmp_path) == ["run"]


def test_an_empty_folder_is_used(plan, tmp_path):
    (tmp_path / "run").mkdir()
    run_folder.write(plan, tmp_path / "run")
    assert names(tmp_path / "run") == sorted(run_folder.FILES)


def test_a_folder_with_anything_else_is_refused(plan, tmp_path):
    out = run_folder.write(plan, tmp_path / "run")
    (out / "notes.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(InputError, match=r"holds notes\.txt: give a new or empty folder, or an earlier run folder"):
        run_folder.write(plan, out)
    assert (out / "notes.txt").read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize("content", ["", "[]", '{"task": "x"}', "\x00"])
def test_a_folder_whose_summary_is_another_is_refused(plan, tmp_path, content):
    (tmp_path / "summary.json").write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match="was not written by leanboom"):
        run_folder.write(plan, tmp_path)
    assert names(tmp_path) == ["summary.json"]


def test_files_links_and_the_current_folder_are_refused(plan, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("", encoding="utf-8")
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    with pytest.raises(InputError, match="is a file"):
        run_folder.write(plan, tmp_path / "file")
    with pytest.raises(InputError, match="cannot be written"):
        run_folder.write(plan, tmp_path / "file" / "run")
    with pytest.raises(InputError, match="is a symbolic link"):
        run_folder.write(plan, tmp_path / "link")
    with pytest.raises(InputError, match="cannot be written"):
        run_folder.write(plan, Path("a\0b"))
    monkeypatch.chdir(tmp_path / "real")
    with pytest.raises(InputError, match="is or holds the current folder"):
        run_folder.write(plan, Path())
    assert names(tmp_path) == ["file", "link", "real"]


@pytest.mark.parametrize("failure", [OSError(28, "No space left on device"), KeyboardInterrupt()])
@pytest.mark.parametrize("existing", [False, True])
def test_a_failure_midway_leaves_nothing(plan, tmp_path, monkeypatch, failure, existing):
    out = tmp_path / "run"
    if existing:
        run_folder.write(plan, out)
        (out / "report.html").write_text("old", encoding="utf-8")
    write = Path.write_bytes

    def failing(path, *args, **kwargs):
        if path.name == "trajectory.csv":
            raise failure
        return write(path, *args, **kwargs)

    monkeypatch.setattr(Path, "write_bytes", failing)
    with pytest.raises(InputError if isinstance(failure, OSError) else KeyboardInterrupt):
        run_folder.write(plan, out)
    assert names(tmp_path) == (["run"] if existing else [])
    if existing:
        assert (out / "report.html").read_text(encoding="utf-8") == "old"


def test_a_failed_swap_puts_the_earlier_folder_back(plan, tmp_path, monkeypatch):
    out = run_folder.write(plan, tmp_path / "run")
    (out / "report.html").write_text("old", encoding="utf-8")
    rename = Path.rename

    def failing(path, target):
        if "-new-" in path.name:
            raise OSError(5, "Input/output error")
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", failing)
    with pytest.raises(InputError, match="Input/output error"):
        run_folder.write(plan, out)
    assert names(tmp_path) == ["run"]
    assert (out / "report.html").read_text(encoding="utf-8") == "old"


@pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX systems")
def test_the_folder_is_as_readable_as_any_other(plan, tmp_path):
    (tmp_path / "plain").mkdir()
    out = run_folder.write(plan, tmp_path / "run")
    assert out.stat().st_mode == (tmp_path / "plain").stat().st_mode


def _rows(run, change):
    """Rewrite a run folder's samples, [time, length, velocity] each, as text."""
    with (run / "trajectory.csv").open(newline="", encoding="utf-8") as stream:
        rows = list(csv.reader(stream))
    at = [rows[0].index(name) for name in ("time_s", "extension_cylinder_m", "extension_cylinder_m_s")]
    for i, row in enumerate(rows[1:]):
        for j, value in zip(at, change(i, *(row[j] for j in at)), strict=True):
            row[j] = value
    with (run / "trajectory.csv").open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows(rows)


EDITED = {
    "a time of NaN": (lambda i, t, x, v: ("nan" if i == 9 else t, x, v), r"line 11 lacks finite numbers in time_s"),
    "velocities of NaN": (lambda i, t, x, v: (t, x, "NaN"), "line 2 lacks finite numbers"),
    "an infinite length": (lambda i, t, x, v: (t, "inf", v), "line 2 lacks finite numbers"),
    "text": (lambda i, t, x, v: (t, x, "fast" if i == 3 else v), "line 5 lacks finite numbers"),
    "a field too long": (lambda i, t, x, v: (t, x, "1" * 140_000 if i == 3 else v), "lacks finite numbers"),
    "times of zero": (lambda i, t, x, v: ("0", x, v), "times must rise evenly from 0"),
    "falling times": (lambda i, t, x, v: (str(6.0 - float(t)), x, v), "times must rise evenly from 0"),
    "negative times": (lambda i, t, x, v: (str(-float(t)), x, v), "times must rise evenly from 0"),
    "a time twice": (lambda i, t, x, v: ("0.01" if i == 6 else t, x, v), r"time_s = 0.01 s in sample 6; times must"),
    "half the time": (lambda i, t, x, v: (str(0.5 * float(t)), x, v), "ends at 3 s; the task ends at 6 s"),
    "another length": (
        lambda i, t, x, v: (t, "0.3" if i == 50 else x, v),
        r"extension_cylinder_m = 0.3 m at 0.1 s; the velocities before lead to 0.6713 m",
    ),
    "immense velocities": (lambda i, t, x, v: (t, x, "1e308"), r"motion.position = inf at stage 1; must be finite"),
}


@pytest.mark.parametrize(("change", "message"), EDITED.values(), ids=EDITED)
def test_edited_trajectories_are_refused_with_the_reason(plan, tmp_path, change, message):
    """Some ended in a traceback, others were accepted and refused later: "position of lift is nan"."""
    run = run_folder.write(plan, tmp_path / "run")
    assert run_folder.read(run)[1].position == pytest.approx(plan.motion.position[0])
    _rows(run, change)
    with pytest.raises(InputError, match=message) as refusal:
        run_folder.read(run)
    assert str(refusal.value).startswith(f"{run / 'trajectory.csv'}: ")


def test_a_motion_whose_stages_lie_between_samples_is_read_as_it_was(plan, tmp_path, rng):
    """Of a fastest motion samples alone told of accelerations a fifth beyond their limit."""
    steps = np.linspace(0.0137, 0.0142, 430)
    steps *= 6.0 / steps.sum()
    speed = np.cumsum(rng.uniform(-1e-3, 1e-3, 431))
    speed = np.where(np.arange(431) % 430 == 0, 0.0, speed)
    moved = motion.from_velocities_at(np.concatenate([[0.0], np.cumsum(steps)]), 0.6713, speed, "dp", "ls")
    judged = evaluate(plan.task, moved)
    again = run_folder.read(run_folder.write(replace(plan, motion=moved, evaluation=judged), tmp_path / "run"))[1]
    middle = 0.5 * (moved.breaks[1:] + moved.breaks[:-1])
    np.testing.assert_allclose(again.at(middle)[2], moved.acceleration, atol=1e-5)
    use = evaluate(plan.task, again).limit_use.acceleration
    assert use == pytest.approx(judged.limit_use.acceleration, rel=1e-4)


HEAD = "time_s,extension_cylinder_m,extension_cylinder_m_s,extension_cylinder_m_s2"


@pytest.mark.parametrize("content", [f"{HEAD}\n0,0,0,0\n", "", "a,b\n1,2\n"])
def test_trajectories_without_samples_are_refused(plan, tmp_path, content):
    run = run_folder.write(plan, tmp_path / "run")
    (run / "trajectory.csv").write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match=r"trajectory.csv: .* plan again"):
        run_folder.read(run)


def test_huge_trajectories_are_refused_before_they_are_read(plan, tmp_path):
    run = run_folder.write(plan, tmp_path / "run")
    with (run / "trajectory.csv").open("ab") as stream:
        stream.truncate(run_folder.MAX_TRAJECTORY + 1)
    with pytest.raises(InputError, match=r"trajectory.csv: is above 512 MiB"):
        run_folder.read(run)


@pytest.mark.parametrize("content", ["[" * 100_000, '{"a":' * 100_000, "{} " * 600_000, "1" * 5000])
def test_summaries_that_are_none_are_refused(plan, tmp_path, content):
    """Deep nesting ended in a RecursionError."""
    run = run_folder.write(plan, tmp_path / "run")
    (run / "summary.json").write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match="is not a run folder"):
        run_folder.read(run)
    with pytest.raises(InputError, match="was not written by leanboom"):
        run_folder.check(run)


@pytest.mark.parametrize(("key", "value"), [("pump", "gas"), ("pump", ["ls"]), ("method", None), ("cost", 1.0)])
def test_summaries_with_wrong_words_are_refused(plan, tmp_path, key, value):
    run = run_folder.write(plan, tmp_path / "run")
    found = json.loads((run / "summary.json").read_text(encoding="utf-8"))
    (run / "summary.json").write_text(json.dumps(found | {key: value}), encoding="utf-8")
    with pytest.raises(InputError, match=rf"summary.json: {key} = .*; must be "):
        run_folder.read(run)
