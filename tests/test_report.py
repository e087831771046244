"""The report: self-contained, escaped, its numbers those of the judge."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from leanboom.evaluation import limits
from leanboom.evaluation.energy_breakdown import breakdown
from leanboom.evaluation.evaluate import evaluate
from leanboom.io import loading
from leanboom.model import motion
from leanboom.model.machine import Provenance
from leanboom.planning import planner
from leanboom.report import charts, plan_charts, plan_page, rendering


def held(task, length, method="dp"):
    """The judged motion that leaves the telescope where it is."""
    still = np.zeros(61)
    step = task.duration / (still.size - 1)
    return evaluate(task, motion.from_velocities(step, length, still, method, "ls", log=("first step: 1 < 2",)))


def made(task, plan=0.6713, other: float | None = 0.516):
    judged = held(task, plan)
    baseline = None if other is None else held(task, other)
    return planner.Plan(task, "ls", judged.motion, judged, baseline, 123)


def paced(task, factor):
    """The task in `factor` times its duration."""
    return replace(task, path=replace(task.path, durations=tuple(factor * d for d in task.path.durations)))


@pytest.fixture(scope="module")
def task():
    return loading.load_task("forwarder-vertical")


@pytest.fixture(scope="module")
def plan(task):
    return made(task)


@pytest.fixture(scope="module")
def page(plan):
    return plan_page.page(plan, (11, 7))


def without_bundle(page):
    """The page but for plotly.js, which mentions addresses it never visits."""
    from plotly.offline import get_plotlyjs

    bundle = get_plotlyjs()
    assert page.count(bundle) == 1
    return page.replace(bundle, "")


def data_of(page):
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)[1])


def test_the_page_needs_no_network(page):
    assert "http" not in without_bundle(page).replace("http-equiv", "")
    assert re.findall(r'(?:src|href)\s*=\s*["\']', without_bundle(page)) == []
    assert "default-src 'none'" in page
    assert len(page.encode()) < 6e6


@pytest.mark.parametrize(
    ("share", "said"),
    [
        (0.374, "<strong>37 % less</strong> than the"),
        (0.0024, "<strong>0.2 % less</strong> than the"),
        (-0.0024, "<strong>0.2 % more</strong> than the"),
        (1e-4, "as much as the"),
    ],
)
def test_the_lead_says_how_much_is_saved_however_little(plan, monkeypatch, share, said):
    """A saving of 0.2 % read "0 % less"."""
    monkeypatch.setattr(planner.Plan, "saving", lambda self, pump=None: share)
    assert said in plan_page.page(plan, (11, 7))


def test_the_page_is_complete(page):
    assert page.startswith("<!doctype html>") and page.rstrip().endswith("</html>")
    assert re.findall(r"\{\{\w+\}\}", page) == []
    ids = re.findall(r'\sid="([\w-]+)"', without_bundle(page))
    assert len(ids) == len(set(ids))
    wanted = re.findall(r'getElementById\("([\w-]+)"\)', without_bundle(page))
    assert set(wanted) <= set(ids)


def test_the_summary_states_energies_and_saving(plan, page):
    mine, theirs = plan.evaluation.energy_ls, plan.baseline.energy_ls
    assert f"<strong>{mine / 1e3:.2f} kJ</strong>" in page
    assert f"{theirs / 1e3:.1f} kJ" in page
    assert f"{100 * (1 - mine / theirs):.0f} % less" in page
    assert "All limits kept" in page


def test_assumed_values_are_called_assumed(page):
    assert "61 of 122 machine values are assumed." in page
    assert "cylinders › tilt › linkage › L22" in page
    assert "proportions of two comparable cranes" in page


def test_method_grid_step_and_log_are_told(page):
    assert "11 positions and 7 velocities" in page
    assert "stages of 100 ms" in page
    assert "first step: 1 &lt; 2" in page


def test_text_from_files_is_escaped(plan):
    evil = "</script><img src=x onerror=alert(1)>&"
    machine = replace(
        plan.task.machine, name=evil, description=evil, provenance=(Provenance(evil, evil, "assumed", evil),)
    )
    task = replace(plan.task, name=evil, machine=machine)
    text = plan_page.page(replace(plan, task=task, motion=replace(plan.motion, method=evil, cost=evil, log=(evil,))))
    assert "<img" not in without_bundle(text)
    assert text.count("</script>") == 3


def test_data_cannot_end_its_script(plan, monkeypatch):
    monkeypatch.setattr(plan_charts, "data", lambda plan: {"name": "</script>&"})
    assert data_of(plan_page.page(plan)) == {"name": "</script>&"}


def test_charts_hold_the_judged_values(plan, page):
    data = data_of(page)
    judged = plan.evaluation
    at = np.searchsorted(judged.time, np.array(data["time"]) - 1e-6)
    assert data["time"][-1] == pytest.approx(judged.time[-1])
    lines = {(c["title"], line["name"]): line["values"] for c in data["pump"] for line in c["lines"]}
    np.testing.assert_allclose(lines["Energy so far", "plan"], judged.cumulative_ls[at] / 1e3, rtol=1e-4)
    other = lines["Supply pressure", "pseudo-inverse"]
    np.testing.assert_allclose(other, plan.baseline.supply_ls[at] / 1e6, rtol=1e-4)
    rows = data["rows"]["cylinder-charts"]
    velocity = rows[1]["charts"]
    assert [chart["title"] for chart in velocity] == ["Base", "Lift", "Tilt", "Extension"]
    assert velocity[1]["limits"] == [-0.15, 0.15]
    assert all(chart["unit"] and chart["axis"] for row in rows for chart in row["charts"])


def test_one_script_draws_the_charts_of_plans_and_simulations():
    """Pages of libraries and of identification have maps and fits of their own."""
    drawing = [p.name for p in rendering.FOLDER.iterdir() if "Plotly." in p.read_text(encoding="utf-8")]
    assert sorted(drawing) == ["charts.js", "identification.html.j2", "library.js"]


def test_charts_and_animation_stay_small(task):
    long = made(paced(task, 20.0))
    data = plan_charts.data(long)
    assert len(data["time"]) <= charts.POINTS + 1
    assert len(data["frames"]["plan"]["joints"]) == plan_charts.FRAMES


def test_limit_table_agrees_with_the_judge(plan):
    use = plan.evaluation.limit_use
    np.testing.assert_allclose(limits.uses(plan.evaluation).max(axis=1), [use.position, use.velocity, use.acceleration])


def test_a_plan_without_baseline_says_so(task):
    text = plan_page.page(made(task, other=None))
    assert "the pseudo-inverse cannot follow this path" in text
    assert set(data_of(text)["frames"]) == {"plan"}


def test_an_infeasible_plan_says_so(task):
    text = plan_page.page(made(paced(task, 0.2)))
    assert "No feasible motion" in text and "All limits kept" not in text
    assert "Limit broken: velocity of lift is" in text


def test_a_plan_too_much_for_the_pump_has_no_green_badge(task):
    """It once read `All limits kept`, with the missing flow in a note below."""
    weak = replace(task, machine=replace(task.machine, pump=replace(task.machine.pump, max_flow=5.0 / 6e4)))
    plan = made(weak)
    text = plan_page.page(plan)
    assert 'class="badge bad">Limits kept, but the pump cannot deliver it<' in text
    assert 'class="badge good"' not in text and "All limits kept" not in text and ">Saving<" not in text
    assert 'class="card void"' in text and 'class="bar void"' in text and 'class="card first"' not in text
    assert "plan (not solved)" in text and plan.status.partition(": ")[2] in text


def test_a_motion_the_crane_cannot_reach_still_makes_a_page(task):
    plan = made(task, plan=0.1)
    assert not plan.evaluation.followed
    text = plan_page.page(plan)
    assert "Limit broken: tool off its path" in text and "unknown" in text and '<span class="what">Saving' not in text
    assert None not in data_of(text)["pump"][0]["lines"][0]["values"]


def test_a_crane_that_does_not_slew_has_no_top_view():
    task = loading.load_task("loader-triangle-small")
    judged = evaluate(task, motion.from_velocities(0.1, 0.6, np.zeros(301), "dp", "cp"))
    text = plan_page.page(planner.Plan(task, "cp", judged.motion, judged, None, 0))
    assert 'class="stage one"' in text
    assert all(len(joints) == 4 for joints in data_of(text)["frames"]["plan"]["joints"])


def test_the_drawing_opens_where_postures_differ_most(plan):
    """It once opened where the telescopes' lengths differed, and claimed a difference that was not to be seen."""
    time, apart = plan_charts.postures_apart(plan)
    data = plan_charts.data(plan)
    assert data["opens_at"] == time
    g = plan.task.machine.geometry
    tips = [
        g.boom * np.stack([np.cos(e.joint_position[:, 1]), np.sin(e.joint_position[:, 1])])
        for e in (plan.evaluation, plan.baseline)
    ]
    assert apart >= np.linalg.norm(tips[0] - tips[1], axis=0).max() - 1e-12
    assert "differ most" in plan_page.page(plan) and f"{apart:.2f} m" in plan_page.page(plan)


def test_postures_that_do_not_differ_are_not_claimed_to(task):
    text = plan_page.page(made(task, 0.6713, 0.67131))
    assert "differ most" not in text and "in nearly the same posture" in text


def test_side_and_top_view_are_equally_high_and_to_one_scale(plan):
    crane = plan_charts.data(plan)["crane"]
    (_, _, low, high), (_, _, right, left) = crane["side"], crane["above"]
    assert high - low == pytest.approx(left - right, abs=2e-3)
    assert low < 0.0


def test_a_manager_finds_an_hours_energy_fuel_and_where_it_goes(plan, page):
    kilowatts = plan.evaluation.energy_ls / plan.task.duration / 1e3
    assert f"takes {kilowatts:.2f} kWh, about {kilowatts / 3.5:.2g} l of diesel" in page
    assert "Assumed: all of it comes from a diesel engine with 35 % efficiency and 36 MJ in a litre" in page
    assert f"{breakdown(plan.evaluation, 'ls').margin / 1e3:.2f} kJ" in page and "Load-sensing margin" in page


def test_an_end_of_a_stroke_is_told_in_words(task):
    start = 0.40952
    text = plan_page.page(made(task, start, start))
    assert "tilt at its end: retracted" in text and ">at its end: retracted</td>" in text


def test_spikes_of_forces_are_friction(plan, page):
    """What the caption says: without Coulomb friction no force changes by more than a little within 10 ms."""
    assert "its Coulomb friction (base 15 kN, lift 6 kN, tilt 5 kN, extension 3 kN) fades or changes sign" in page
    machine = plan.task.machine
    free = tuple(replace(c, friction=replace(c.friction, coulomb=0.0)) for c in machine.cylinders)
    smooth = replace(plan.task, machine=replace(machine, cylinders=free))
    t = np.linspace(0.0, 6.0, 61)
    creeping = motion.from_velocities(0.1, 0.6713, 1e-3 * np.sin(2.0 * np.pi * t), "creep", "ls")

    def jump(task):
        return np.abs(np.diff(evaluate(task, creeping).force[::5, -1])).max()

    assert jump(plan.task) > 5.0 * jump(smooth)
    assert "Coulomb" not in plan_page.page(replace(plan, task=smooth))
