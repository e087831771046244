"""The closed loop: what it must keep (energy, tracking, tolerance), what it must report, and how it is extended."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import leanboom as lb
from leanboom.components.pumps import EfficiencyMap
from leanboom.components.valves import METERING
from leanboom.errors import InputError
from leanboom.model import motion
from leanboom.model.motion import from_velocities
from leanboom.model.task import Leg, Lines
from leanboom.report import simulation_page
from leanboom.simulation import closed_loop, controllers, integrator, plant
from leanboom.simulation.adaptive_robust import AdaptiveRobust
from leanboom.simulation.closed_loop import simulate

STEP = 0.05


def glide(task, first, last):
    """The redundant cylinder gliding smoothly between two lengths [m]."""
    count = round(task.duration / STEP)
    s = np.linspace(0.0, 1.0, count + 1)
    velocity = (last - first) * 30 * s**2 * (1 - s) ** 2 / task.duration
    return from_velocities(STEP, first, velocity, "glide", "none")


FORWARDER = replace(
    lb.load_task("forwarder-horizontal"), path=Lines(((4.6, 0.0, 2.0), (6.4, 0.6, 2.3)), (5.0,)), name="reach"
)
LOADER = replace(
    lb.load_task("loader-triangle-small"), path=Lines(((2.4, 0.0, 0.7), (2.9, 0.0, 1.4)), (5.0,)), name="lift"
)
MOTIONS = {"forwarder": (FORWARDER, glide(FORWARDER, 0.55, 1.05)), "loader": (LOADER, glide(LOADER, 0.5, 0.7))}
CASES = [(name, pump) for name in MOTIONS for pump in ("ls", "cp")]


@pytest.fixture(scope="module")
def runs():
    return {(name, pump): simulate(*MOTIONS[name], pump) for name, pump in CASES}


@pytest.mark.parametrize("case", CASES, ids="-".join)
def test_energy_is_found_again_within_half_a_percent(runs, case):
    """What the pump gives is kinetic and potential energy, friction, valve losses and compressed oil."""
    run = runs[case]
    assert run.complete
    assert run.balance["pump"] > 3e3
    assert run.balance_error < 5e-3  # what is promised
    assert run.balance_error < 1e-5  # what is found: every term counts
    assert min(run.balance["valves"], run.balance["friction"]) > 0.02 * run.balance["pump"]  # each would be missed


@pytest.mark.parametrize("case", CASES, ids="-".join)
def test_pump_work_is_supply_pressure_times_flow(runs, case):
    run = runs[case]
    assert run.energy == pytest.approx(np.trapezoid(run.supply * run.pump_flow, run.time), rel=2e-3)
    assert run.cumulative[-1] == pytest.approx(np.trapezoid(run.power, run.time), rel=2e-3)


@pytest.mark.parametrize("case", CASES, ids="-".join)
def test_a_finer_tolerance_changes_the_energy_by_less_than_a_thousandth(runs, case):
    name, pump = case
    finer = simulate(*MOTIONS[name], pump, tolerance=0.5 * integrator.TOLERANCE)
    assert finer.energy == pytest.approx(runs[case].energy, rel=1e-3)
    assert not np.array_equal(finer.velocity, runs[case].velocity)


@pytest.mark.parametrize("pump", ["ls", "cp"])
def test_adaptive_robust_control_keeps_joints_within_a_hundredth(runs, pump):
    assert runs["loader", pump].joint_error.max() < 0.01


def test_adaptive_robust_control_does_not_swing_a_heavy_base():
    """The forwarder's slewing gear moves the cylinder's mass of 800 t; gains in proportion to it would be too hasty."""
    circuit = replace(METERING, edge_flow=FORWARDER.machine.circuit.edge_flow)
    machine = replace(FORWARDER.machine, valve=LOADER.machine.valve, circuit=circuit)
    run = simulate(replace(FORWARDER, machine=machine), MOTIONS["forwarder"][1], "cp")
    assert run.controller == "AdaptiveRobust"
    assert run.joint_error.max() < 0.015


@pytest.mark.parametrize("pump", ["ls", "cp"])
def test_dead_zone_inverse_control_keeps_the_path_as_well_as_the_paper(runs, pump):
    """Table 4 has 0.04 m to 0.35 m; the valve's delay must show."""
    run = runs["forwarder", pump]
    assert run.path_accuracy < 0.35
    assert run.joint_error.max() > 2e-3


@pytest.mark.parametrize("lossy", [False, True], ids=["constant", "map"])
def test_a_pumps_efficiency_counts_in_what_it_takes_and_nowhere_else(runs, lossy):
    pump = LOADER.machine.pump
    rows = ((0.6, 0.7), (0.72, 0.8)) if lossy else ()
    known = EfficiencyMap(25.0, (25.0,), (2e-5, 6e-5), (5e6, 20e6), (rows,)) if lossy else 0.8
    machine = replace(LOADER.machine, pump=replace(pump, efficiency=known))
    run = simulate(replace(LOADER, machine=machine), MOTIONS["loader"][1], "cp")
    assert run.balance["pump"] == pytest.approx(runs["loader", "cp"].balance["pump"], rel=1e-9)
    assert run.energy == pytest.approx(np.trapezoid(run.power, run.time), rel=2e-3)
    assert run.energy > 1.2 * run.balance["pump"]
    if not lossy:
        assert run.energy == pytest.approx(run.balance["pump"] / 0.8)


def test_off_side_chambers_are_held_at_one_megapascal(runs):
    run = runs["loader", "cp"]
    moving = (run.time > 1.5) & (run.time < 4.0)
    off_side = np.minimum(run.pressure_a, run.pressure_b)[moving]
    assert off_side.mean(axis=0) == pytest.approx([1e6] * 3, rel=0.25)
    assert off_side.min() > 0.5e6 and off_side.max() < 1.6e6
    assert run.pressure_a[moving, 0].min() > 3e6  # the other one carries the load


def test_energies_stand_beside_the_plan(runs):
    for (_, pump), run in runs.items():
        assert run.planned_energy == pytest.approx(run.planned.energy(pump))
        assert 0.8 < run.energy / run.planned_energy < 1.6
        assert run.change == run.energy / run.planned_energy - 1.0
    for name in MOTIONS:
        assert runs[name, "ls"].energy < runs[name, "cp"].energy


def test_nothing_moves_before_the_valve_has_waited(runs):
    run = runs["forwarder", "cp"]
    began = run.time[np.flatnonzero(np.abs(run.command).max(axis=1) > 0.53)[0]]
    moved = run.time[np.flatnonzero(np.abs(run.velocity[:, -1]) > 1e-4)[0]]
    assert moved - began > 0.155


def test_a_run_says_what_it_is(runs):
    run = runs["forwarder", "ls"]
    text = repr(run)
    assert "reach" in text and "complete" in text and "kJ" in text
    assert run.time[-1] == pytest.approx(FORWARDER.duration + closed_loop.SETTLE)
    assert run.realtime_factor > 1.0
    assert run.controller == "DeadZoneInverse"
    with pytest.raises(ValueError, match="read-only"):
        run.supply[0] = 0.0


# What is reported.


def kinds(run):
    return {event.kind for event in run.events}


def test_a_pump_that_is_too_small_is_reported_with_time_and_cause():
    machine = replace(FORWARDER.machine, pump=replace(FORWARDER.machine.pump, max_flow=30e-3 / 60))
    run = simulate(replace(FORWARDER, machine=machine), MOTIONS["forwarder"][1], "cp")
    (event, *_) = [event for event in run.events if event.kind == "pump"]
    assert 0.5 < event.time < 4.0 and event.place == "pump"
    assert event.text == "the pump gives all its 30 l/min"
    assert "supply" in kinds(run)
    assert run.pump_flow.max() <= 30e-3 / 60 * (1 + 1e-9)
    assert run.balance_error < 5e-3


def test_a_load_above_the_pumps_pressure_is_reported():
    machine = replace(FORWARDER.machine, pump=replace(FORWARDER.machine.pump, max_pressure=5e6))
    run = simulate(replace(FORWARDER, machine=machine), MOTIONS["forwarder"][1])
    assert any(event.text.endswith("the pump has 5 MPa") for event in run.events)
    assert run.supply.max() < 5.01e6


def test_a_valve_that_is_too_small_is_reported():
    circuit = replace(FORWARDER.machine.circuit, edge_flow=10e-3 / 60)
    run = simulate(
        replace(FORWARDER, machine=replace(FORWARDER.machine, circuit=circuit)), MOTIONS["forwarder"][1], "cp"
    )
    assert any(event.kind == "saturation" and event.duration > 0.5 for event in run.events)


class Push:
    """Opens one valve all the way, whatever happens."""

    index, level = 3, 1.0

    def __init__(self, rig):
        self.command_ = np.zeros(rig.plant.layout.n)
        self.command_[self.index] = self.level

    def command(self, now):
        return self.command_


def test_a_cylinder_that_hits_its_end_and_its_limit_is_reported():
    run = simulate(*MOTIONS["forwarder"], "cp", controller=Push)
    ends = [event for event in run.events if event.kind == "end"]
    assert [event.place for event in ends] == ["extension"]
    assert "extended end" in ends[0].text
    assert any(event.kind == "limit" and event.place == "extension" for event in run.events)
    assert run.position[:, 3].max() < 1.85 + 2e-3
    assert run.balance_error < 5e-3


def test_the_other_end_is_told_apart():
    class Pull(Push):
        level = -1.0

    run = simulate(*MOTIONS["forwarder"], "cp", controller=Pull)
    (event,) = [event for event in run.events if event.kind == "end"]
    assert event.place == "extension" and "retracted end" in event.text
    assert run.position[:, 3].min() > -2e-3


def test_a_tank_under_pressure_keeps_the_balance():
    machine = replace(FORWARDER.machine, pump=replace(FORWARDER.machine.pump, tank_pressure=0.5e6))
    run = simulate(replace(FORWARDER, machine=machine), MOTIONS["forwarder"][1])
    assert run.pressure_b[:, 1] == pytest.approx(0.5e6)  # the lift's rod side breathes from the tank
    assert run.balance_error < 1e-5


def test_a_held_cylinder_is_driven_for_a_large_error_alone():
    built = plant.build(LOADER)
    joints = simulate(*MOTIONS["loader"], "cp").joint_position[0]

    def commands(errors):
        still = np.zeros(3)
        state = controllers.resting(built, controllers.static_loads(built, joints))
        a, b = state[built.layout.a], state[built.layout.b]
        controller = AdaptiveRobust(controllers.Rig(built, joints, 0.002))
        position = np.full(3, 0.2)
        return controller.command(
            controllers.Sample(0.0, joints, position, still, a, b, 1e7, position + errors, still, still)
        )

    assert (commands(np.full(3, 0.003)) == 0.0).all()
    out, back = commands(np.full(3, 0.01)), commands(np.full(3, -0.01))
    assert out[0] > 0.0 >= out[1]  # P-A and B-T
    assert back[1] > 0.0 >= back[0]  # P-B and A-T


def test_cavitation_is_reported():
    """Without anti-cavitation from a return line under pressure, a load that runs ahead sucks its chamber empty."""

    class Drop(Push):
        index, level = 2, 1.0

    circuit = replace(FORWARDER.machine.circuit, counter_pressure=0.0)
    machine = replace(FORWARDER.machine, circuit=circuit)
    run = simulate(replace(FORWARDER, machine=machine, payload=600.0), MOTIONS["forwarder"][1], "cp", controller=Drop)
    assert any(event.kind == "cavitation" and event.place == "tilt" for event in run.events)


def test_a_solver_that_gives_up_leaves_what_came_before(monkeypatch):
    advance = integrator.Integrator.advance

    def stuck(self, sample):
        if sample == 801:
            raise integrator.SolverError("the solver gave up: it was told to")
        return advance(self, sample)

    monkeypatch.setattr(integrator.Integrator, "advance", stuck)
    run = simulate(*MOTIONS["forwarder"], "ls")
    assert not run.complete
    assert run.status == "incomplete: the solver gave up: it was told to at 1.600 s"
    assert run.time.size == 801 and run.time[-1] == pytest.approx(1.6)
    assert run.events[-1].kind == "solver" and run.events[-1].time == pytest.approx(1.6)
    assert 0.0 < run.energy < 5e3 and np.isfinite(run.path_accuracy)


# Controllers of one's own, and what cannot be used.


def test_a_controller_of_ones_own_takes_a_few_lines():
    class Proportional:
        def __init__(self, rig):
            self.dead_zone = rig.plant.crane.machine.circuit.dead_zone

        def command(self, now):
            share = 0.3 * now.target_velocity + (now.target_position - now.position)
            return np.sign(share) * self.dead_zone + share

    run = simulate(*MOTIONS["forwarder"], "cp", controller=Proportional)
    assert run.complete and run.controller == "Proportional"
    assert run.joint_error.max() < 0.5


@pytest.mark.parametrize(
    ("answer", "message"),
    [(np.zeros(3), "must be 4 finite commands"), (np.array([0.0, np.nan, 0.0, 0.0]), "must be 4 finite commands")],
    ids=["shape", "nan"],
)
def test_a_controllers_unusable_answer_is_refused(answer, message):
    class Wrong:
        def __init__(self, rig):
            pass

        def command(self, now):
            return answer

    with pytest.raises(InputError, match=message):
        simulate(*MOTIONS["forwarder"], "cp", controller=Wrong)


def test_unknown_pumps_and_motions_out_of_reach_are_refused():
    with pytest.raises(InputError, match="pump = gas; must be one of ls, cp"):
        simulate(*MOTIONS["forwarder"], "gas")
    far = replace(FORWARDER, path=Lines(((4.6, 0.0, 2.0), (14.0, 0.0, 2.3)), (5.0,)))
    with pytest.raises(InputError, match="reach"):
        simulate(far, MOTIONS["forwarder"][1], "cp")


def test_the_table_is_what_the_valve_does():
    """Base: flow of the open edge over the area, both ways; zero from one end of the dead zone to the other."""
    from leanboom.model import crane as cranes

    tables = controllers.measured_table(cranes.build(FORWARDER))
    velocity, command = tables[0].T
    assert (np.diff(velocity) > 0.0).all() and command[0] == -1.0 and command[-1] == 1.0
    share = np.maximum(np.abs(command) - 0.53, 0.0) / 0.47
    expected = np.sign(command) * 0.5 * share * (1.0 + share) * 170e-3 / 60 / FORWARDER.machine.cylinders[0].piston_area
    assert velocity == pytest.approx(expected, rel=0.05, abs=5e-4)


def test_a_payload_does_not_change_the_table():
    from leanboom.model import crane as cranes

    plain = controllers.measured_table(cranes.build(FORWARDER))
    assert controllers.measured_table(cranes.build(replace(FORWARDER, payload=300.0))) is plain


# Cycles

OUT, BACK = ((2.4, 0.0, 0.7), (2.6, 0.0, 1.0)), ((2.6, 0.0, 1.0), (2.4, 0.0, 0.7))
SHARES = (0.6, 0.7, 0.72), (0.75, 0.82, 0.84), (0.8, 0.86, 0.88)
LOSSY = EfficiencyMap(30.0, (30.0,), (20e-6, 60e-6, 200e-6), (5e6, 15e6, 25e6), (SHARES,))
CYCLE = lb.Task(
    name="cycle",
    machine=replace(LOADER.machine, pump=replace(LOADER.machine.pump, efficiency=LOSSY)),
    legs=(
        Leg(payload=0.0, path=Lines(OUT, (1.5003,))),  # of other samples than 2 ms
        Leg(payload=300.0, dwell=2.5, path=Lines(BACK, (1.5,))),
    ),
    start=0.5,
    end="same",
)


@pytest.fixture(scope="module")
def cycle():
    parts = [glide(CYCLE.stretch(CYCLE.stretches[0]), 0.5, 0.6), motion.held(0.6, 2.5, "held", "none")]
    parts[0] = motion.ending_at(replace(parts[0], step=1.5003 / 30), 0.6)
    return simulate(CYCLE, motion.joined([*parts, glide(CYCLE.stretch(CYCLE.stretches[2]), 0.6, 0.5)]), "ls")


def test_a_cycle_is_driven_as_one_run_whose_payload_changes_between_legs(cycle):
    """The first leg is as alone; then the cylinders carry the load, and what it brings along is nobody's work."""
    assert cycle.complete
    assert cycle.time[-1] == pytest.approx(CYCLE.duration + closed_loop.SETTLE, abs=2e-3)
    assert cycle.balance_error < 1e-5
    first = CYCLE.stretches[0]
    alone = simulate(CYCLE.stretch(first), motion.between(cycle.motion, first.since, first.until), "ls")
    until = round(first.until / cycle.time[1])
    np.testing.assert_allclose(cycle.power[:until], alone.power[:until], rtol=2e-3, atol=1.0)
    np.testing.assert_allclose(cycle.joint_target[:until], alone.joint_target[:until], atol=1e-4)
    waits = CYCLE.stretches[1]
    at = round((waits.until - 0.1) / cycle.time[1])
    load = controllers.static_loads(plant.build(CYCLE.stretch(waits)), cycle.joint_position[at])
    assert cycle.force[at, -3] == pytest.approx(load[-3], rel=0.05)
    assert cycle.force[at, -3] > cycle.force[until, -3] + 1e3  # [N], of the lift cylinder
    assert np.abs(cycle.joint_position[-1] - cycle.joint_position[0]).max() < 0.01


def test_the_waiting_of_a_cycle_costs_what_the_pump_loses_at_rest(cycle):
    """Once the controller has lifted the load to its place."""
    planned = float(np.interp(3.9, cycle.planned.time, cycle.planned.power_ls))
    assert planned > 100.0
    assert cycle.power[(cycle.time > 3.8) & (cycle.time < 3.9)] == pytest.approx(planned, rel=0.01)


def test_a_cycle_is_told_leg_by_leg(cycle):
    found = simulation_page.summary(cycle)["legs"]
    assert [leg["payload_kg"] for leg in found] == [0.0, 300.0]
    assert sum(leg["energy_j"] for leg in found) == pytest.approx(cycle.energy)
    assert sum(leg["planned_energy_j"] for leg in found) == pytest.approx(cycle.planned_energy)
    assert max(leg["path_accuracy_m"] for leg in found) == cycle.path_accuracy > 0.0
    assert ">300 kg</td>" in simulation_page.page(cycle)
    early = {name: getattr(cycle, name)[:500] for name in ("time", "tool", "tool_target", "cumulative")}
    ended = simulation_page.legs(replace(cycle, **early))
    assert [leg.energy is None for leg in ended] == [False, True]
