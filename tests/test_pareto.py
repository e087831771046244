"""Energy over duration: scaled paths, neighbours' motions, what is told of durations that cannot be."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from command_line import leanboom
from leanboom.errors import InputError
from leanboom.io.loading import load_task
from leanboom.methods.least_duration import shortest_duration, slower
from leanboom.model.task import Limits
from leanboom.planning import planner
from leanboom.study import pareto as study

VERTICAL = replace(load_task("forwarder-vertical"), start="middle")
QUICK = {"grid": (41, 31), "step": 0.2, "effort": "quick"}


@pytest.fixture(scope="module")
def found():
    return study.pareto(VERTICAL, "cp", durations=[9.0, 5.0, 1.0], **QUICK)


def test_the_path_is_scaled_and_energies_are_those_of_plans(found):
    assert [point.task.duration for point in found.points] == pytest.approx([1.0, 5.0, 9.0])
    for point in found.points[1:]:
        assert point.task == slower(VERTICAL, point.task.duration / 6.0) and point.solved
        assert point.plan is not None and point.energy == point.plan.evaluation.energy_cp
        assert point.baseline == point.plan.baseline.energy_cp
        np.testing.assert_allclose(point.task.path.points, VERTICAL.path.points)
    alone = planner.run(found.points[1].task, pump="cp", baseline=False, **QUICK).evaluation.energy_cp
    assert found.points[1].energy <= alone * 1.0001


def test_a_duration_without_a_motion_has_no_energy_and_says_why(found):
    first = found.points[0]
    assert (first.energy, first.baseline, first.solved) == (None, None, False)
    assert "beyond its limit" in first.status and "was found for" not in first.status
    assert list(first.json()) == ["pump", "duration_s", "energy_j", "baseline_j", "status"]
    assert study._motions(first, found.points[1].task) == []


def test_neighbours_begin_with_each_others_motions(found, monkeypatch):
    """The same positions at the same share of the duration; a slower motion begins the faster one."""
    slow, fast = found.points[2], found.points[1]
    (led,) = study._motions(slow, fast.task)
    share = np.linspace(0.0, 1.0, 50)
    np.testing.assert_allclose(
        led.at(share * fast.task.duration)[0], slow.plan.motion.at(share * slow.task.duration)[0], atol=1e-9
    )
    seeds = {}

    def planned(task, *, warm_start, **settings):
        seeds.setdefault(task.duration, []).append(len(warm_start))
        return next(point.plan for point in found.points if point.task == task)

    monkeypatch.setattr(planner, "run", planned)
    study.pareto(VERTICAL, "cp", durations=[5.0, 9.0], **QUICK)
    assert seeds[9.0][0] == 0 and seeds[5.0][0] == 1


def test_a_slower_motion_is_made_again_from_a_better_faster_one(found, monkeypatch):
    slow, fast = found.points[2], found.points[1]
    asked = []

    def planned(task, *, warm_start, **settings):
        asked.append((task.duration, len(warm_start)))
        return fast.plan if task == fast.task else slow.plan

    monkeypatch.setattr(planner, "run", planned)
    study.pareto(VERTICAL, "cp", durations=[5.0, 9.0], **QUICK)
    assert asked == [(9.0, 0), (5.0, 1)]  # no better
    monkeypatch.setattr(study, "gains", lambda before, after, share: True)
    study.pareto(VERTICAL, "cp", durations=[5.0, 9.0], **QUICK)
    assert asked[2:] == [(9.0, 0), (5.0, 1), (9.0, 1)]


def test_a_duration_too_short_for_the_pump_is_told_as_such():
    pump = replace(VERTICAL.machine.pump, max_flow=25.0 / 6e4)
    task = replace(VERTICAL, machine=replace(VERTICAL.machine, pump=pump), limits=Limits(pump_flow=True))
    first, second = study.pareto(task, durations=[4.0, 9.0], **QUICK).points
    assert first.plan is None and first.status.startswith("limits.pump_flow = yes; the path, at the best extension,")
    assert second.solved and second.plan.evaluation.limit_use.flow <= 1.001


def test_durations_range_from_the_shortest_to_well_beyond_the_tasks(monkeypatch):
    monkeypatch.setattr(study, "shortest_duration", lambda *task, least: 0.51234)
    times = study.usual_durations(VERTICAL)
    assert len(times) == study.COUNT and times[0] == 3.08 and times[-1] == pytest.approx(15.0, rel=1e-9)
    assert np.ptp(np.diff(np.log(times))) < 0.02
    monkeypatch.setattr(study, "shortest_duration", lambda *task, least: None)
    with pytest.raises(Exception, match="no feasible motion found, also not in 16 times the 6 s"):
        study.usual_durations(VERTICAL)


def test_the_shortest_duration_may_be_below_the_tasks():
    slow = slower(VERTICAL, 4.0)
    factor = shortest_duration(slow, (31, 21), 0.3, 0.3, least=1.0 / 8.0)
    assert factor is not None and 1.0 / 8.0 <= factor < 0.4
    assert shortest_duration(slow, (31, 21), 0.3) == 1.0


def test_the_command_prints_points_and_writes_files(tmp_path, monkeypatch, found):
    monkeypatch.setattr(study, "pareto", lambda task, pump, durations, effort, progress: replace(found, pumps=("cp",)))
    out = tmp_path / "out"
    done = leanboom(
        "pareto", "forwarder-vertical", "--durations", "1,5 s,9", "--pump", "cp", "--json", "--out", str(out)
    )
    assert done.exit_code == 0, done.output
    rows = json.loads(done.stdout)
    assert rows == found.json() and rows == json.loads((out / "pareto.json").read_text())
    assert {path.name for path in out.iterdir()} == {"pareto.json", "pareto.csv", "pareto.png"}
    lines = (out / "pareto.csv").read_text().splitlines()
    assert lines[0] == "pump,duration_s,energy_j,baseline_j,status" and len(lines) == 4
    assert (out / "pareto.png").read_bytes().startswith(b"\x89PNG")
    table = leanboom("pareto", "forwarder-vertical", "--pump", "cp").stdout
    assert f"{found.points[1].energy / 1e3:.2f}" in table and "constant-pressure pump, energy against duration" in table
    none = replace(found, points=found.points[:1])
    monkeypatch.setattr(study, "pareto", lambda task, pump, durations, effort, progress: none)
    assert leanboom("pareto", "forwarder-vertical", "--json").exit_code == 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--durations", "6,fast"), "durations = fast; must be a time above 0"),
        (("--durations", ","), "durations = nothing; must be at least one time"),
        (("--durations", "6", "--pump", "big"), "pump = big; must be some of ls, cp"),
        (("--durations", "0.00001"), "duration = "),
        (("--durations", "6", "--effort", "much"), "effort = much; must be one of"),
    ],
)
def test_wrong_options_are_told(options, message):
    done = leanboom("pareto", "forwarder-vertical", *options)
    assert done.exit_code == 2 and message in done.stderr
    with pytest.raises(InputError, match="timing = shortest"):
        study.pareto(replace(load_task("forwarder-vertical"), timing="shortest"), durations=[6.0])
