"""Tasks with legs: files, the judge, plans of whole cycles, and what takes single paths alone."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import leanboom as lb
from bundled_texts import edited, problems, written
from command_line import leanboom
from leanboom.certificate import lower_bounds, value_slopes
from leanboom.certificate.certificate import certify
from leanboom.components.pumps import EfficiencyMap
from leanboom.errors import InputError, LeanboomError
from leanboom.io.loading import dump_machine, dump_task
from leanboom.methods.dp_refined import Search
from leanboom.methods.registry import EFFORTS
from leanboom.model import motion
from leanboom.model.task import Leg, Lines, Part
from leanboom.planning import cycles, junctions, leg_search, planner, summaries, time_sharing
from leanboom.problem import stages
from leanboom.report import run_folder
from leanboom.study import comparison, pareto, processes

DOWN, UP = ([5.5, 0.0, 4.64], [5.5, 0.0, 1.60]), ([5.5, 0.0, 1.60], [5.5, 0.0, 4.64])
VERTICAL = lb.load_task("forwarder-vertical", start="middle")
CYCLE = lb.Task(
    name="cycle",
    machine=VERTICAL.machine,
    legs=(
        Leg(payload=0.0, path=Lines(DOWN, (5.0,))),
        Leg(payload=250.0, dwell=2.0, path=Lines(UP, (6.0,))),
    ),
    start="middle",
    end="same",
)
QUICK = {"grid": (41, 21), "step": 0.2, "effort": "quick"}
FILE = dump_task(CYCLE, "forwarder")


@pytest.fixture(scope="module")
def plan():
    return planner.run(CYCLE, pump="cp", **QUICK)


def held(task, at):
    """The motion that stands still through all stretches, at the position given for each [m]."""
    parts = [motion.held(x, each.until - each.since, "held", "cp") for x, each in zip(at, task.stretches, strict=True)]
    return motion.joined(parts)


# Files


def test_a_cycle_is_written_and_read(tmp_path):
    ranged = replace(
        CYCLE,
        legs=(CYCLE.legs[0].lasting("5500 ms"), replace(CYCLE.legs[1], duration=(5.0, 9.0))),
        total=14.0,
    )
    again = lb.load_task(written(tmp_path, dump_task(ranged, "forwarder"), "cycle.yaml"))
    assert again == ranged
    assert (again.duration, again.payload) == (5.5 + 2.0 + 6.0, 250.0)
    assert again.legs[0].duration == 5.5


RANGE = ("dwell: 2 s", "dwell: 2 s\n    duration: [7 s, 9 s]")


@pytest.mark.parametrize(
    ("edits", "more", "message"),
    [
        ([], "payload: 3 kg", "payload = 3 kg; must be left out, since each of the legs has its own"),
        ([], "path: {type: lines}", "path = a mapping; must be left out, since each of the legs has its own"),
        ([("payload: 250 kg", "payloud: 250 kg")], "", "legs[1].payload is missing; must be a mass at least 0"),
        ([("[5.5, 0, 1.6]\n        - [5.5, 0, 4.64]", "[5.5, 0, 1.7]\n        - [5.5, 0, 4.64]")], "",
         "legs[1].path.points[0] = [5.5, 0, 1.7]; must be [5.5, 0, 1.6], where leg 1 ends"),
        ([("dwell: 2 s", "duration: [9 s, 8 s]")], "",
         "legs[1].duration = [9 s, 8 s]; is an empty range: the second time must be above the first"),
        ([("dwell: 2 s", "duration: slow")], "",
         "legs[1].duration = slow; must be a time such as 8 s, a range of times such as [6 s, 12 s], or shortest"),
        ([RANGE], "total: 13 s", "total = 13 s; must be at least 14 s, the sum of the shortest legs and waiting"),
        ([RANGE], "total: 17 s", "total = 17 s; must be at most 16 s, the sum of the longest legs and waiting"),
        ([RANGE], "total: 15 s\ntime_price: 2 kW", "time_price = 2 kW; must be left out where total is given"),
        ([], "total: 17 s", "total = 17 s; needs a leg whose duration is a range"),
        ([], "time_price: 2 kg", "time_price = 2 kg; must be a finite power in W, kW, such as 2 kW"),
    ],
)  # fmt: skip
def test_what_does_not_fit_together_is_named_with_line_and_leg(tmp_path, edits, more, message):
    found = problems(lb.load_task, written(tmp_path, edited(FILE, edits) + f"{more}\n"))
    assert any(message in line and line.startswith("bad.yaml:") for line in found), found


def test_a_task_without_legs_needs_path_and_payload(tmp_path):
    found = problems(lb.load_task, written(tmp_path, "machine: forwarder\nstart: middle\n"))
    assert [line.partition("; ")[0] for line in found] == [
        "bad.yaml:1: path is missing", "bad.yaml:1: payload is missing",
    ]  # fmt: skip


def test_a_payload_changes_at_rest_alone():
    moving = Part(Lines(DOWN, (5.0,)), 0.0, 2.5)
    with pytest.raises(InputError, match=r"legs\[0\].path = .*; must begin and end at rest: the payload changes there"):
        replace(CYCLE, legs=(Leg(payload=0.0, path=moving),))
    begun = replace(CYCLE, legs=(Leg(payload=0.0, path=Part(Lines(DOWN, (5.0,)), 2.5, 5.0)), CYCLE.legs[1]))
    assert begun.duration == pytest.approx(2.5 + 2.0 + 6.0)  # what is left of a cycle under way
    with pytest.raises(InputError, match="path = .*; must be left out, since each of the legs has its own"):
        replace(VERTICAL, legs=CYCLE.legs)


# The judge


def test_a_cycle_is_judged_leg_by_leg():
    """Its energies are the sums of those of its legs, which carry what hangs on each; nothing flows while it waits."""
    whole = lb.evaluate(CYCLE, held(CYCLE, (0.7, 0.7, 0.7)))
    assert whole.feasible
    alone = [
        lb.evaluate(replace(VERTICAL, path=leg.path, payload=leg.payload), motion.held(0.7, lasts, "held", "cp"))
        for leg, lasts in zip(CYCLE.legs, (5.0, 6.0), strict=True)
    ]
    assert whole.energy_ls == pytest.approx(sum(each.energy_ls for each in alone), rel=1e-12)
    assert np.all(np.diff(whole.time) > 0.0) and whole.time[-1] == pytest.approx(13.0)
    waits = (whole.time > 5.0) & (whole.time < 7.0)
    assert np.all(whole.pump_flow[waits] == 0.0) and np.all(whole.power_ls[waits] == 0.0)
    shares = summaries.legs(whole, "cp")
    assert [leg.energy for leg in shares] == pytest.approx([each.energy_cp for each in alone])
    assert whole.limit_use.worst == max(each.limit_use.worst for each in alone)


def test_legs_begin_where_the_one_before_ends_and_the_cycle_closes():
    jumping = lb.evaluate(CYCLE, held(CYCLE, (0.7, 0.7002, 0.7002)))
    begins = "leg 2, from 7 s on: the extension begins at 0.7002 m, but was at 0.7000 m"
    assert jumping.violations == (begins, "the extension ends at 0.7002 m, and must end at 0.7000 m (end: same)")
    assert lb.evaluate(CYCLE, held(CYCLE, (0.7, 0.70005, 0.70005))).feasible


def test_the_waiting_of_a_pump_with_an_efficiency_map_costs_its_losses_at_rest():
    levels, shares = (5e6, 15e6, 25e6), (((0.6, 0.7, 0.72), (0.75, 0.82, 0.84), (0.8, 0.86, 0.88)),)
    lossy = EfficiencyMap(30.0, (30.0,), (20e-6, 60e-6, 200e-6), levels, shares)
    machine = CYCLE.machine
    cycle = replace(CYCLE, machine=replace(machine, pump=replace(machine.pump, efficiency=lossy)))
    whole = lb.evaluate(cycle, held(cycle, (0.7, 0.7, 0.7)))
    at_rest = whole.power_ls[(whole.time > 5.5) & (whole.time < 6.5)]
    assert at_rest.min() == at_rest.max() > 0.0
    assert "the losses of its efficiency map at rest" in summaries.waiting(whole, "ls")


def test_a_limit_is_broken_in_a_leg():
    fast = replace(CYCLE, legs=(CYCLE.legs[0].lasting(1.0), CYCLE.legs[1]))
    judged = lb.evaluate(fast, held(fast, (0.7, 0.7, 0.7)))
    assert judged.violations[0].startswith("leg 1, from 0 s on: ")


# Plans


def test_a_closed_cycle_with_two_payloads_is_planned_and_costs_no_more_than_legs_planned_one_after_another(plan):
    assert plan.solved
    assert plan.motion.position[-1] == pytest.approx(plan.motion.position[0], abs=1e-9)
    assert plan.saving() > 0.0
    first = planner.run(replace(VERTICAL, path=CYCLE.legs[0].path), pump="cp", baseline=False, **QUICK)
    second = replace(
        VERTICAL, path=CYCLE.legs[1].path, payload=250.0, start=float(first.motion.position[-1]),
        end=float(first.motion.position[0]),
    )  # fmt: skip
    greedy = first.evaluation.energy_cp + planner.run(second, pump="cp", baseline=False, **QUICK).evaluation.energy_cp
    assert plan.evaluation.energy_cp <= greedy * (1.0 + 1e-6)


@pytest.mark.slow
def test_no_pair_of_extensions_on_a_grid_makes_a_cheaper_cycle():
    """Every start and every extension between the legs, each leg planned by itself; with the best start of all."""
    free = replace(CYCLE, start="best")
    found = planner.run(free, pump="cp", baseline=False, **QUICK)
    given = junctions.chain(free, "cp", (41, 21), 0.25)
    at = [np.linspace(low + 1e-6, high - 1e-6, 4) for low, high in (given.inner[2], given.inner[1])]
    costs = []
    for start, middle in product(*at):
        legs = [given.leg(0, float(start), float(middle)), given.leg(1, float(middle), float(start))]
        plans = [
            Search(leg, "cp", (31, 15), 0.25, EFFORTS["quick"]).run_once(stages.discretise(leg, 0.25), leg.start)
            for leg in legs
        ]
        if all(each.feasible for each in plans):
            costs.append(sum(each.energy_cp for each in plans))
    assert len(costs) > 8
    assert found.evaluation.energy_cp <= 1.001 * min(costs)


def test_legs_begin_within_the_stroke_where_a_motion_ends_beyond_it(plan, monkeypatch):
    """A pseudo-inverse in a hurry ended 0.1 um outside, and that was no start of the next leg."""
    beyond = VERTICAL.machine.redundant.stroke + 1e-7

    def hurried(task, start):
        return replace(plan.baseline, motion=motion.held(beyond, task.duration, "held", "cp"))

    monkeypatch.setattr(leg_search.pseudo_inverse, "baseline", hurried)
    assert leg_search.baseline(CYCLE, 0.71).motion.position[-1] == beyond
    given = junctions.chain(CYCLE, "cp", (21, 11), 0.5)
    assert given.leg(1, beyond, -1e-7).end == given.inner[2][0]


@pytest.mark.slow
def test_a_method_that_leaves_the_end_free_plans_legs_one_after_another():
    free = replace(CYCLE, end="free")
    found = planner.run(free, pump="cp", method="sns-actuator", check=False, **QUICK)
    assert found.evaluation.energy_cp == pytest.approx(found.baseline.energy_cp)
    assert "legs" not in str(found.status)
    with pytest.raises(InputError, match="end = same; method sns-actuator cannot lead the motion to an end"):
        planner.run(CYCLE, pump="cp", method="sns-actuator", **QUICK)


def test_the_run_folder_of_a_cycle_holds_it_whole(plan, tmp_path):
    out = run_folder.write(plan, tmp_path / "run")
    task, again, _ = run_folder.read(out)
    assert task.legs == CYCLE.legs
    judged = lb.evaluate(task, again)
    assert judged.feasible
    assert judged.energy_cp == pytest.approx(plan.evaluation.energy_cp, rel=1e-4)
    kept = json.loads((out / "summary.json").read_text())
    assert [leg["payload_kg"] for leg in kept["legs"]] == [0.0, 250.0]
    assert [leg["dwell_s"] for leg in kept["legs"]] == [0.0, 2.0]
    assert sum(leg["energy_j"] for leg in kept["legs"]) == pytest.approx(kept["energy_j"])
    assert "The legs" in (out / "report.html").read_text()


def test_an_ordinary_task_is_one_leg(tmp_path):
    summary = summaries.summary(planner.run(VERTICAL, pump="cp", baseline=False, **QUICK))
    assert summary["legs"] == [
        {"duration_s": 6.0, "dwell_s": 0.0, "energy_j": summary["energy_j"], "payload_kg": 0.0}
    ]  # fmt: skip


@pytest.mark.slow
def test_commands_show_plan_and_simulate_a_cycle_with_its_pump_flow_limited(plan, tmp_path):
    """The pump has 90 % of what the plan without that limit asks for."""
    small = replace(CYCLE.machine.pump, max_flow=0.9 * float(plan.evaluation.pump_flow.max()))
    written(tmp_path, dump_machine(replace(CYCLE.machine, pump=small)), "small.yaml")
    file = str(written(tmp_path, dump_task(CYCLE, "small.yaml"), "cycle.yaml"))
    shown = leanboom("tasks", file)
    assert "Leg 2 after waiting 2 s" in shown.stdout
    assert json.loads(leanboom("tasks", file, "--json").stdout)["legs"][1]["dwell_s"] == 2.0
    assert leanboom("check", file).exit_code == 0
    asked = "--pump", "cp", "--effort", "quick", "--grid", "41x21", "--step", "0.2", "--out", str(tmp_path / "run")
    made = leanboom("plan", file, "--pump-flow-limit", *asked)
    assert made.exit_code == 0, made.stderr
    assert "The crane waits 2 s, and no oil flows" in made.stdout
    kept = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert plan.evaluation.energy_cp < kept["energy_j"] and 0.9 < kept["limit_use"]["flow"] <= 1.001
    driven = leanboom("simulate", str(tmp_path / "run"))
    assert driven.exit_code == 0, driven.stderr
    assert "While the crane waits, 2 s, the pump takes" in " ".join(driven.stdout.split())
    legs = json.loads((tmp_path / "run" / "simulation.json").read_text())["legs"]
    assert [leg["planned_energy_j"] for leg in legs] == pytest.approx([leg["energy_j"] for leg in kept["legs"]], 1e-3)


def test_a_receding_horizon_says_why_it_takes_no_cycle():
    text = "task cycle has 2 legs; a receding horizon, which knows no leg to come, takes a task with one path and one"
    with pytest.raises(InputError, match=text):
        lb.plan_receding(CYCLE)


# Studies


def test_methods_are_compared_on_a_cycle_and_those_that_cannot_plan_it_say_so(monkeypatch):
    def each(function, arguments, workers=None, done=None):
        found = []
        for argument in arguments:
            try:
                found.append(processes.CallResult(function(argument)))
            except LeanboomError as error:
                found.append(processes.CallResult(failure=str(error), refused=True))
        return found

    monkeypatch.setattr(comparison.processes, "each", each)
    run = planner.run
    monkeypatch.setattr(planner, "run", lambda task, **given: run(task, **given, **QUICK))
    methods = ["sns-actuator", "pseudospectral:cp"]
    free = lb.compare(replace(CYCLE, end="free"), "cp", methods=methods[:1]).rows[0]
    assert free.solved and [leg["payload_kg"] for leg in free.summary["legs"]] == [0.0, 250.0]
    fast = replace(CYCLE, start="best", legs=(CYCLE.legs[0], replace(CYCLE.legs[1], duration="shortest")))
    for row in lb.compare(fast, "cp", methods=methods).rows:
        assert row.motion is None and row.summary["start_m"] is None
        assert row.status == (
            f"end = same; method {row.entry.method} cannot lead the motion to an end: use dp or polish; start = best; "
            f"method {row.entry.method} needs smallest, middle or a length; legs[1].duration = shortest; method "
            f"{row.entry.method} keeps the timing of the path: use dp"
        )


def test_a_cycle_lasts_as_long_as_is_asked_for():
    """Legs are scaled alike, waiting and fastest legs stay; where legs have ranges they share the total."""
    kept = pareto.Kept(CYCLE, 2.0, {})
    assert [leg.timed.duration for leg in kept.lasting(13.0).legs] == pytest.approx([5.0, 6.0])
    assert [leg.timed.duration for leg in kept.lasting(24.0).legs] == pytest.approx([10.0, 12.0])
    fast = replace(CYCLE, legs=(CYCLE.legs[0], replace(CYCLE.legs[1], duration="shortest")))
    longer = pareto.Kept(fast, 2.0, {1: 3.5}).lasting(15.5)
    assert [leg.duration for leg in longer.legs] == [pytest.approx(10.0), "shortest"]
    with pytest.raises(InputError, match="duration = 5 s; must be above 5.5 s, what fastest legs and waiting take"):
        pareto.Kept(fast, 2.0, {1: 3.5}).lasting(5.0)
    ranged = replace(CYCLE, legs=(replace(CYCLE.legs[0], duration=(4.0, 8.0)), CYCLE.legs[1]), time_price=50.0)
    kept = pareto.Kept(ranged, 2.0, {})
    assert (kept.lasting(14.0).total, kept.lasting(14.0).time_price) == (14.0, None)
    assert pareto.usual_durations(ranged, kept=kept)[:: pareto.COUNT - 1] == pytest.approx([12.0, 16.0])
    with pytest.raises(InputError, match="duration = 17 s; must be from 12 s to 16 s, what the legs and waiting make"):
        kept.lasting(17.0)
    every = replace(CYCLE, legs=tuple(replace(leg, duration="shortest") for leg in CYCLE.legs))
    with pytest.raises(InputError, match="legs; at least one must have a duration other than shortest"):
        pareto.pareto(every)


def test_a_cycles_motion_is_made_slower_leg_by_leg(plan):
    point = pareto.Point(CYCLE, 13.0, "cp", plan, plan.status)
    assert point.json()["duration_s"] == 13.0
    longer = pareto.Kept(CYCLE, 2.0, {}).lasting(24.0)
    (seed,) = pareto._motions(point, longer)
    for time, before in ((5.0, 2.5), (11.0, 6.0), (18.0, 10.0), (24.0, 13.0)):
        assert state(seed, time)[0] == pytest.approx(state(plan.motion, before)[0], abs=1e-9)
    assert lb.evaluate(longer, seed).feasible


@pytest.mark.slow
def test_energy_over_the_duration_of_a_cycle(plan):
    found = pareto.pareto(CYCLE, "cp", durations=[16.0, 13.0], **QUICK)
    assert [point.json()["duration_s"] for point in found.points] == [13.0, 16.0]
    assert all(point.solved and point.energy < point.baseline for point in found.points)
    assert found.points[0].energy <= plan.evaluation.energy_cp * (1.0 + 1e-6)


def test_a_motion_alone_holds_no_timing_of_legs():
    with pytest.raises(InputError, match=r"legs\[0\] leaves its timing to be planned; a motion alone has none: use"):
        lb.plan(replace(CYCLE, legs=(replace(CYCLE.legs[0], timing="free"), CYCLE.legs[1])))


def test_a_start_that_the_cycle_cannot_come_back_to_is_named_with_its_leg():
    apart = replace(CYCLE, legs=(Leg(payload=0.0, path=lb.load_task("forwarder-horizontal").path),), start="smallest")
    with pytest.raises(InputError, match=r"leg 1: end = same, and the start is .* m; feasible at the end of this path"):
        planner.run(apart, pump="cp", **QUICK)


# Proofs, and on the way


def test_a_cycle_is_bounded_as_a_whole(plan, monkeypatch):
    """The bound and what the plan takes are of the same stages; the motion of the certificate is of the whole task."""
    monkeypatch.setattr(value_slopes, "GRID", (101, 51))
    monkeypatch.setattr(value_slopes, "TUBE", (51, 51))
    closed, inner = [], lower_bounds.steeper
    monkeypatch.setattr(lower_bounds, "steeper", lambda *given: closed.append(task.start) or inner(*given))
    for task in (CYCLE, replace(CYCLE, start="best")):
        proof = certify(task, "cp", motion=plan.motion, step=0.2, seconds=1.0, gap=5.0)
        assert proof.levels and 0.0 < proof.lower_bound_j <= proof.energy_j
        assert proof.energy_j == pytest.approx(plan.evaluation.energy_cp, rel=0.02)
        assert proof.motion.duration == pytest.approx(task.duration)
        assert proof.motion.position[[0, -1]] == pytest.approx(plan.motion.position[[0, -1]])
        assert proof.json()["certify_levels"]
    assert set(closed) == {"best"}  # where the start is given, so is the end
    with pytest.raises(InputError, match="motion = nothing; task cycle has legs, whose certificate needs the motion"):
        certify(CYCLE, "cp")


def state(found, time):
    return tuple(float(each[0]) for each in found.at(np.array([time]))[:2])


def test_the_rest_of_a_leg_and_the_legs_to_come_are_planned_again(plan):
    """Off the plan, or with another load to come: no dearer than the leg led back and the later one as planned."""
    for cycle, off in ((CYCLE, 0.03), (replace(CYCLE, legs=(CYCLE.legs[0], replace(CYCLE.legs[1], payload=600.0))), 0)):
        c, w = state(plan.motion, 2.0)
        rest = lb.replan(cycle, 2.0, c + off, w, pump="cp", around=plan.motion)
        assert rest.solved and rest.since == 2.0 and rest.motion.duration == pytest.approx(11.0)
        assert [leg.payload for leg in rest.task.legs] == [leg.payload for leg in cycle.legs]
        assert rest.motion.position[-1] == pytest.approx(plan.motion.position[0], abs=1e-9)
        leg, _, last = cycle.stretches
        here = cycle.stretch(leg, end=state(plan.motion, 5.0)[0])
        first = motion.between(plan.motion, leg.since, leg.until)
        alone = lb.replan(here, 2.0, c + off, w, pump="cp", around=first)
        kept = lb.evaluate(cycle.stretch(last), motion.between(plan.motion, last.since, last.until))
        assert rest.evaluation.energy_cp <= 1.002 * (alone.evaluation.energy_cp + kept.energy_cp)


def test_the_legs_to_come_are_planned_again_from_a_coarse_program(plan):
    rest = lb.replan(CYCLE, 2.0, *state(plan.motion, 2.0), pump="cp")
    assert rest.solved and rest.evaluation.energy_cp <= 1.03 * plan.evaluation.spent("cp", 2.0, 13.0)


def test_a_cycle_is_planned_again_while_waiting_and_in_its_last_leg(plan):
    waiting = lb.replan(CYCLE, 6.0, state(plan.motion, 6.0)[0] + 2e-3, 0.0, pump="cp", around=plan.motion)
    assert waiting.solved and waiting.task.legs[0].dwell == pytest.approx(1.0)
    assert waiting.motion.duration == pytest.approx(7.0)
    again = lb.replan(CYCLE, 9.5, *state(waiting, 9.5), pump="cp", around=waiting)
    assert again.solved and again.task.payload == 250.0 and again.motion.duration == pytest.approx(3.5)
    for time, velocity, message in (
        (6.0, 0.01, r"velocity = 0.01 m/s at 6 s; must be 0: the crane waits until 7 s"),
        (4.995, 0.0, r"time = 4.995 s; must be up to 4.99 s, shortly before the end of leg 1, or from that end at 5 s"),
    ):
        with pytest.raises(InputError, match=message):
            lb.replan(CYCLE, time, 0.7, velocity, around=plan.motion)
    with pytest.raises(InputError, match="end = same, start = best; where the cycle began is not known: hand in its"):
        lb.replan(replace(CYCLE, start="best"), 1.0, 0.7, 0.0)


def test_where_a_leg_to_come_is_out_of_reach_the_crane_stops_on_the_leg_under_way(plan):
    far = replace(CYCLE.legs[1], path=Lines((UP[0], (15.0, 0.0, 4.64)), (6.0,)))
    stop = lb.replan(replace(CYCLE, legs=(CYCLE.legs[0], far)), 2.0, *state(plan.motion, 2.0), pump="cp")
    assert stop.stopping and stop.since == 2.0 and stop.evaluation.feasible
    assert stop.status.startswith("no feasible motion: leg 2: the path leaves the crane's reach at 2.")


# Time shared among legs


def test_time_is_shared_so_that_the_sum_of_costs_is_least():
    """Costs a / T: for a total, durations are as the roots of a; at a price, T is the root of a over it."""
    task = replace(CYCLE, legs=tuple(replace(leg, duration=(1.0, 9.0)) for leg in CYCLE.legs), total=8.0)
    times = np.linspace(1.0, 9.0, 41)
    curves = [(times, 100.0 / times), (times, 400.0 / times)]
    spans = [(1.0, 9.0)] * 2
    found = time_sharing._shared(task, curves, spans, [3.0, 3.0])
    assert sum(found) + 2.0 == pytest.approx(8.0, abs=1e-9)
    assert found == pytest.approx([2.0, 4.0], abs=0.03)
    priced = replace(task, total=None, time_price=25.0)
    assert time_sharing._shared(priced, curves, spans, [3.0, 3.0]) == pytest.approx([2.0, 4.0], abs=0.03)
    broken = [(times, np.where(times < 3.0, np.inf, 100.0 / times)), curves[1]]
    assert time_sharing._shared(task, broken, spans, [3.0, 3.0]) == pytest.approx([3.0, 3.0], abs=0.03)


@pytest.mark.slow
def test_a_duration_is_chosen_at_the_price_of_time():
    """A pump with losses that rise with the square of its flow likes it slow, time is paid for: no other is better."""
    levels, shares = (5e6, 15e6, 25e6), (((0.8, 0.86, 0.88), (0.7, 0.79, 0.82), (0.55, 0.68, 0.74)),)
    lossy = EfficiencyMap(30.0, (30.0,), (40e-6, 100e-6, 200e-6), levels, shares)
    machine = replace(CYCLE.machine, pump=replace(CYCLE.machine.pump, efficiency=lossy))
    leg = Leg(payload=0.0, path=Lines(DOWN, (4.0,)), duration=(3.0, 9.0))
    task = replace(CYCLE, machine=machine, legs=(leg,), end="free", time_price=50.0)
    fine = QUICK | {"step": 0.1}
    found = planner.run(task, pump="cp", baseline=False, **fine)
    chosen = found.task.duration
    assert 3.2 < chosen < 8.8

    def total(duration):
        fixed = replace(task, legs=(leg.lasting(duration),), time_price=None)
        return planner.run(fixed, pump="cp", baseline=False, **fine).evaluation.energy_cp + 50.0 * duration

    best = found.evaluation.energy_cp + 50.0 * chosen
    for other in (0.85 * chosen, 1.15 * chosen):
        assert best <= total(other) * 1.0005


# Timing


@pytest.mark.slow
def test_a_fastest_leg_comes_first_and_the_others_meet_it(plan, monkeypatch):
    """What is fastest between other extensions is slower: they are its own, and the rest of the cycle fits in."""
    asked = []

    def fastest(task, cost, tell):
        asked.append((task.start, task.end, task.payload))
        quicker = replace(task, path=task.path.slower(0.8), start=0.8, end=0.6)
        return planner.run(quicker, pump=cost, baseline=False, **QUICK).evaluation

    monkeypatch.setattr(cycles.shortest, "plan", fastest)
    legs = CYCLE.legs[0], replace(CYCLE.legs[1], duration="shortest")
    found = planner.run(replace(CYCLE, start="best", legs=legs), pump="cp", baseline=False, **QUICK)
    assert asked == [("best", "free", 250.0)]
    assert found.solved and found.task.duration == pytest.approx(5.0 + 2.0 + 0.8 * 6.0)
    meet = found.motion.at(np.array([0.0, 5.0, found.task.duration]))[0]
    assert meet == pytest.approx([0.6, 0.8, 0.6], abs=1e-6)
    assert [leg.duration for leg in found.task.legs] == [None, None]
    planner.run(replace(CYCLE, start=0.6, legs=legs), pump="cp", baseline=False, **QUICK)
    assert asked[1] == ("best", 0.6, 250.0)


@pytest.mark.slow
def test_speed_along_a_leg_is_freed_between_the_extensions_found(plan, monkeypatch):
    """The leg is planned again with a free timing from the motion known, and no worse one is taken."""
    asked, run = [], planner.run

    def freed(task, **given):
        asked.append(task)
        return run(replace(task, timing="fixed"), **given)

    monkeypatch.setattr(planner, "run", freed)
    legs = replace(CYCLE.legs[0], timing="free"), CYCLE.legs[1]
    found = run(replace(CYCLE, legs=legs), pump="cp", baseline=False, **QUICK)
    assert [(task.timing, task.start, task.end) for task in asked] == [
        ("free", pytest.approx(found.motion.position[0]), pytest.approx(found.motion.at(np.array([5.0]))[0][0]))
    ]
    assert found.evaluation.energy_cp <= plan.evaluation.energy_cp * (1.0 + 1e-6)
    assert all(leg.settled for leg in found.task.legs)


# Motions of legs


def test_motions_are_joined_and_cut_again():
    ramp = motion.from_velocities(0.5, 0.2, [0.0, 0.1, 0.1, 0.0], "dp", "cp")
    still = motion.held(float(ramp.position[-1]), 0.7, "dp", "cp")
    whole = motion.joined([ramp, still, ramp])
    assert whole.duration == pytest.approx(3.7)
    time = np.linspace(0.0, 1.5, 31)
    np.testing.assert_allclose(whole.at(time)[0], ramp.at(time)[0], atol=1e-15)
    again = motion.between(whole, 0.0, 1.5)
    assert (again.times, again.step) == (None, pytest.approx(0.5))
    np.testing.assert_allclose(again.position, ramp.position, atol=1e-12)
    inside = motion.between(whole, 0.25, 1.75)
    np.testing.assert_allclose(inside.at(time[:20])[1], whole.at(time[:20] + 0.25)[1], atol=1e-12)
    with pytest.raises(InputError, match="motion.times; must be 4 times, one for each position, rising from 0"):
        replace(ramp, times=[0.0, 0.5, 0.4, 1.0])
