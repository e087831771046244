"""The pump's largest flow as a limit: files and options, the judge, the planner's programs, the certificate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from command_line import leanboom
from leanboom.dynamic_programming import grids, value_function
from leanboom.errors import InputError
from leanboom.evaluation.evaluate import evaluate, judged_cost
from leanboom.io.loading import dump_machine, dump_task, load_machine, load_task
from leanboom.methods import pseudo_inverse
from leanboom.model import crane as cranes
from leanboom.model.motion import from_velocities
from leanboom.model.pump_flow import base_flow, pump_flow
from leanboom.model.task import Leg, Limits, Lines, Task, sample
from leanboom.planning import planner, summaries
from leanboom.planning.receding_horizon import plan_receding
from leanboom.planning.replanning import replan
from leanboom.problem import least_flow, stages

FORWARDER = load_machine("forwarder")
LITRES = 6e4  # [l/min] in 1 m^3/s


def pumped(task: Task, flow: float, limited: bool = True) -> Task:
    """A task whose pump gives a flow [m^3/s]."""
    pump = replace(task.machine.pump, max_flow=flow)
    return replace(task, machine=replace(task.machine, pump=pump), limits=Limits(pump_flow=limited))


def swinging(task: Task, start: float, swing: float, step: float = 0.05):
    """A motion whose redundant cylinder goes out and in, at rest at both ends."""
    count = round(task.duration / step)
    rate = swing * np.sin(2.0 * np.pi * np.arange(count + 1) / count)
    return from_velocities(task.duration / count, start, rate, "swinging", "ls")


# The task


def test_a_task_file_says_that_flow_is_limited(tmp_path):
    text = dump_task(load_task("forwarder-vertical"), "forwarder")
    for written, limited in (("", False), ("limits: {pump_flow: yes}\n", True), ("limits: {pump_flow: no}\n", False),
                             ("limits:\n  pump_flow: true\n", True)):  # fmt: skip
        file = tmp_path / "task.yaml"
        file.write_text(text + written)
        task = load_task(file)
        assert task.limits.pump_flow is limited
        assert task.flow_limit == (task.machine.pump.max_flow if limited else np.inf)
        file.write_text(dump_task(task, "forwarder"))
        assert load_task(file).limits == task.limits
    assert "limits" not in text and load_task("forwarder-vertical", pump_flow_limit=True).limits.pump_flow
    file.write_text(text + "limits: {pump_flow: 1}\n")
    with pytest.raises(InputError, match=r"limits.pump_flow = 1; must be true or false"):
        load_task(file)
    with pytest.raises(InputError, match=r"limits = 1; must be limits"):
        replace(task, limits=True)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"limits.pump_flow = 3; must be true or false"):
        Limits(pump_flow=3)  # type: ignore[arg-type]


# The judge


def test_the_use_of_flow_is_that_of_the_cylinders_by_hand():
    """Extending a cylinder takes its piston side, retracting it the side that its connection says."""
    task = load_task("forwarder-half-cycle")
    judged = evaluate(task, swinging(task, 0.5, 0.05))
    total = np.zeros_like(judged.time)
    for i, cylinder in enumerate(task.machine.cylinders):
        v = judged.velocity[:, i]
        out = cylinder.piston_area - (cylinder.rod_side_area if cylinder.connection.value == "differential" else 0.0)
        back = 0.0 if cylinder.connection.value == "single_acting" else cylinder.rod_side_area
        total += np.where(v > 0.0, out * v, -back * v)
    np.testing.assert_allclose(judged.pump_flow, total, rtol=1e-12, atol=1e-15)
    assert judged.limit_use.flow == pytest.approx(total.max() / task.machine.pump.max_flow, rel=1e-3)
    assert not judged.limit_use.flow_limited


def test_too_much_flow_breaks_a_limit_where_the_task_makes_it_one():
    task = load_task("forwarder-half-cycle")
    free = pseudo_inverse.baseline(task, 0.4)
    assert free is not None and free.feasible
    motion = free.motion
    most = free.limit_use.flow * task.machine.pump.max_flow
    for share, limited, kept in ((1.001, True, True), (0.99, True, False), (0.99, False, True)):
        judged = evaluate(pumped(task, share * most, limited), motion)
        assert judged.feasible is kept
        assert judged.limit_use.flow == pytest.approx(1.0 / share, rel=1e-9)
        assert (judged.worst_use >= judged.limit_use.flow) is limited
    judged = evaluate(pumped(task, 0.5 * most), motion)
    i = int(judged.pump_flow.argmax())
    said = f"pump flow is {LITRES * most:.1f} l/min at {judged.time[i]:.3f} s (stage "
    assert judged.status.startswith(said)
    assert f"beyond its limit {LITRES * 0.5 * most:.1f} by {LITRES * 0.5 * most:.2f}" in judged.status


def test_flow_is_looked_at_between_samples():
    """A path of 6 ms: 2 ms apart, samples miss its largest flow."""
    task = load_task("loader-triangle-small")
    short = replace(task, path=Lines(((2.0, 0.0, 0.5), (2.0, 0.0, 0.502)), (0.006,)))
    judged = evaluate(short, from_velocities(0.003, 0.5, np.zeros(3), "rest", "ls"))
    assert judged.limit_use.flow * short.machine.pump.max_flow > 1.001 * judged.pump_flow.max()


def test_summaries_say_the_use_of_flow():
    task = load_task("forwarder-vertical")
    plan = planner.run(task, pump="cp", method="sns-actuator", baseline=False, check=False)
    use = summaries.summary(plan)["limit_use"]
    assert list(use) == ["position", "velocity", "acceleration", "flow"]
    assert use["flow"] == pytest.approx(plan.evaluation.pump_flow.max() / FORWARDER.pump.max_flow, rel=1e-3)


# The planner


def breaks_between(judged) -> float:
    """Largest use of flow of a judged motion at 100 times as many instants as the judge looks at."""
    task = judged.task
    time = np.linspace(0.0, task.duration, 100 * judged.time.size)
    crane = cranes.build(task)
    c, w, u = judged.motion.at(time)
    pose = cranes.pose(crane, cranes.plane(task.machine, sample(task, time)), c)
    return float(pump_flow(crane.drives, cranes.move(pose, w, u).velocity).max()) / task.machine.pump.max_flow


@pytest.mark.parametrize(
    ("name", "start", "cost", "share"),
    [("forwarder-vertical", "middle", "ls", 0.75), ("forwarder-vertical", "middle", "velocity", 0.99),
     ("loader-triangle-large", "smallest", "cp", 0.8)],
)  # fmt: skip
def test_plans_keep_the_limit_at_all_times(name, start, cost, share):
    """The free plan breaks it; the best motion within it costs more, and uses the limit to its last."""
    task = replace(load_task(name), start=start)
    settings = dict(
        pump="cp" if cost == "cp" else "ls", cost=cost, grid=(61, 41), step=task.duration / 80.0, effort="quick"
    )
    free = planner.run(task, baseline=False, **settings).evaluation
    most = free.limit_use.flow * task.machine.pump.max_flow
    tight = pumped(task, share * most)
    assert not evaluate(tight, free.motion).feasible
    plan = planner.run(tight, baseline=False, **settings)
    assert plan.solved
    use = plan.evaluation.limit_use
    assert breaks_between(plan.evaluation) == pytest.approx(use.flow, abs=1e-4) and use.flow <= 1.001
    assert judged_cost(plan.evaluation, cost) > judged_cost(free, cost)
    assert any("polish" in line and "solved" in line.rpartition(", ")[2] for line in plan.motion.log)


def test_replanned_motions_and_policies_keep_the_limit():
    task = replace(load_task("forwarder-vertical"), start="middle")
    free = planner.run(task, grid=(61, 41), step=0.1, effort="quick", baseline=False).evaluation
    tight = pumped(task, 0.8 * free.limit_use.flow * task.machine.pump.max_flow)
    position, velocity = (float(values[0]) for values in free.motion.at(np.array([1.0]))[:2])
    rest = replan(tight, 1.0, position, velocity)
    assert rest.solved and not rest.stopping
    assert rest.task.limits.pump_flow and rest.evaluation.limit_use.flow <= 1.001
    whole = plan_receding(tight, pump="ls", horizon=4.0, every=1.0)
    assert evaluate(tight, whole).limit_use.flow <= 1.001
    problem = stages.discretise(tight, 0.1)
    policy = value_function.solve(problem, grids.full_grid(problem, 61, 41), "ls")
    kept = policy.replan(1.0, position, velocity)
    assert kept.evaluation.limit_use.flow <= 1.001


def test_other_methods_are_judged_by_the_limit_or_refuse_it():
    task = replace(load_task("forwarder-vertical"), start="middle")
    other = planner.run(task, method="sns-actuator", baseline=False)
    tight = pumped(task, 0.9 * other.evaluation.limit_use.flow * task.machine.pump.max_flow)
    judged = planner.run(tight, method="sns-actuator", baseline=False, check=False)
    assert not judged.evaluation.feasible and judged.status.startswith("pump flow is ")
    for method in ("pseudospectral", "shooting"):
        with pytest.raises(InputError, match=f"method {method} knows no limit of the pump's flow: use dp or polish"):
            planner.run(tight, method=method)
    polished = planner.run(tight, method="polish", baseline=False, step=0.1)
    assert polished.solved and polished.evaluation.limit_use.flow <= 1.001


# Bad input


def test_a_timing_to_be_planned_is_not_refused_beforehand_and_a_leg_is_named():
    """What a path asks for by its own timing says nothing of one that is still to be planned."""
    turn = Task("turn", FORWARDER, slewing(4.0), start="middle")
    tight = pumped(turn, 0.6 * float(base_flow(FORWARDER, cranes.plane(FORWARDER, sample(turn, np.array([2.0]))))[0]))
    assert "slewing alone asks for" in least_flow.excess(tight, 0.1)
    for timing in ("free", "shortest"):
        assert least_flow.excess(replace(tight, timing=timing), 0.1) == ""
    legs = Leg(payload=0.0, path=slewing(16.0)), Leg(payload=0.0, path=Lines(slewing(4.0).points[::-1], (4.0,)))
    cycle = Task("cycle", tight.machine, legs=legs, start="middle", limits=Limits(pump_flow=True))
    assert least_flow.excess(cycle, 0.1).endswith("(leg 2)")
    assert least_flow.excess(replace(cycle, legs=(legs[0], replace(legs[1], duration="shortest"))), 0.1) == ""


def slewing(duration: float) -> Lines:
    return Lines(((5.0, 0.0, 1.0), (0.0, 5.0, 1.0)), (duration,))


def test_a_limit_below_what_slewing_alone_needs_is_refused_with_what_would_do(tmp_path):
    """The base cylinder's velocity is the arm times the rate of the angle: worked out by hand at the path's middle."""
    task = Task("turn", FORWARDER, slewing(4.0), start="middle")
    # Halfway along the chord, at distance 5 / sqrt(2), the tool moves at 15/8 of its mean speed, 5 sqrt(2) m in 4 s.
    rate = (15.0 / 8.0 * 5.0 * np.sqrt(2.0) / 4.0) / (5.0 / np.sqrt(2.0))
    base = FORWARDER.cylinders[0]
    needed = base.linkage.arm * rate * base.piston_area
    tight = pumped(task, 0.5 * needed)
    with pytest.raises(InputError, match="slewing alone") as caught:
        planner.run(tight)
    text = str(caught.value)
    assert f"{LITRES * needed:.1f} l/min at 2.000 s" in text and f"{0.5 * LITRES * needed:.1f} l/min" in text
    assert "8.00 s instead of 4 s" in text
    planner._check(pumped(task, 1.05 * needed, False), "ls", "ls", "dp", (31, 31), 0.1, "default")

    machine = tmp_path / "small-pump.yaml"
    machine.write_text(dump_machine(tight.machine))
    file = tmp_path / "turn.yaml"
    file.write_text(dump_task(tight, "small-pump.yaml"))
    with pytest.raises(InputError, match=r"turn.yaml:\d+: limits.pump_flow = true; slewing alone asks for"):
        load_task(file)


def test_a_limit_below_what_every_extension_needs_is_refused():
    """The least flow by brute force over extensions and velocities, at every stage."""
    task = load_task("forwarder-vertical")
    problem = stages.discretise(task, 0.2)
    found = least_flow.least_flow(problem)
    k = int(found.argmax())
    c = np.linspace(problem.lower[k], problem.upper[k], 200)[:, None]
    w = np.linspace(-1.0, 1.0, 8001) * task.machine.redundant.velocity_limit
    pose = cranes.pose(problem.crane, problem.plane[k], c)
    brute = pump_flow(problem.crane.drives, cranes.move(pose, w, 0.0).velocity).min()
    assert found[k] == pytest.approx(brute, rel=5e-3)
    with pytest.raises(InputError, match="the path, at the best extension, asks for"):
        planner.run(pumped(task, 0.9 * found[k]), step=0.2)
    least_flow.check(pumped(task, 1.001 * found[k]), 0.2)


def test_commands_take_the_limit(tmp_path):
    file = tmp_path / "task.yaml"
    task = load_task("forwarder-vertical")
    (tmp_path / "weak.yaml").write_text(dump_machine(pumped(task, 1.0 / LITRES).machine))
    file.write_text(dump_task(task, "weak.yaml"))
    limited = tmp_path / "limited.yaml"
    limited.write_text(file.read_text() + "limits: {pump_flow: yes}\n")
    told = leanboom("check", str(limited))
    assert told.exit_code == 1 and "the path, at the best extension, asks for" in told.stdout + told.stderr
    for command in ("plan", "certify", "compare"):
        done = leanboom(command, str(file), "--pump-flow-limit")
        assert done.exit_code == 2
        assert "limits.pump_flow = yes; the path, at the best extension, asks for" in done.stderr
