"""What real cranes have besides: a telescope that bends, a load that swings, late and sticky valves, slow sensing."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipk

import leanboom as lb
from leanboom.components.circuits import Circuit
from leanboom.errors import InputError
from leanboom.model import crane as cranes
from leanboom.model.motion import from_velocities
from leanboom.model.task import Lines
from leanboom.simulation import plant
from leanboom.simulation.closed_loop import simulate
from leanboom.simulation.valve_sections import Spools, second_order

FORWARDER = lb.load_task("forwarder-horizontal")
REAL = {"delay_slack": 0.1, "hysteresis": 0.03, "sensing_time": 0.1, "tip_frequency": 2.0, "hanging_length": 1.2}
STEP = 0.002


def having(task, **switches):
    """A task whose machine has some switches on."""
    return replace(task, machine=replace(task.machine, circuit=replace(task.machine.circuit, **switches)))


def held(task, joints):
    """Right-hand side of the tip's coordinates with the joints held still: infinitely heavy booms."""
    tip = plant.build(task).tip
    n, m = len(joints), tip.count
    whole, rate = ca.SX.sym("q", n + m), ca.SX.sym("v", n + m)
    heavy = 1e9
    found = tip.accelerations(
        ca.vertsplit(whole), ca.vertsplit(rate), [heavy], (heavy, 0.0, 0.0, heavy, 0.0, heavy), [ca.SX(0.0)] * n
    )
    at = ca.Function("at", [whole, rate], [ca.vertcat(*found[n:])])
    return lambda _, y: np.concatenate(
        [y[m:], np.asarray(at(np.concatenate([joints, y[:m]]), np.concatenate([np.zeros(n), y[m:]]))).ravel()]
    )


def crossings(task, start, duration):
    """Times at which the tip's first coordinate, let go at rest, passes through its rest place."""
    joints = np.array([0.0, 0.3, -1.0, 1.0])
    tip = plant.build(task).tip
    rest = tip.rest(joints)
    y = np.concatenate([rest + start, np.zeros(tip.count)])

    def through(_, state):
        return state[0] - rest[0]

    return solve_ivp(held(task, joints), (0.0, duration), y, events=through, rtol=1e-9, atol=1e-11).t_events[0]


def test_a_bending_tip_swings_with_the_frequency_of_its_spring():
    """Against f sqrt(1 - z^2) of a damped spring and mass."""
    times = crossings(having(FORWARDER, tip_frequency=2.0, tip_damping=0.1), [0.02], 2.0)
    assert 0.5 / np.diff(times).mean() == pytest.approx(2.0 * np.sqrt(1.0 - 0.1**2), rel=1e-4)


@pytest.mark.parametrize("angle", [0.05, 1.0])
def test_a_hanging_load_swings_with_the_period_of_a_pendulum(angle):
    """Against the elliptic integral, also where a small-angle formula is 7 % short."""
    task = having(FORWARDER, hanging_length=1.2, hanging_damping=0.0)
    period = 4.0 * np.sqrt(1.2 / task.machine.gravity) * ellipk(np.sin(0.5 * angle) ** 2)
    times = crossings(task, [angle, 0.0], 6.0)
    assert 2.0 * np.diff(times).mean() == pytest.approx(period, rel=1e-5)


@pytest.mark.parametrize("switches", [{"tip_frequency": 2.0}, {"hanging_length": 1.2}, REAL])
def test_power_goes_into_motion_height_springs_and_dampers(switches, rng):
    """Of the whole crane in any state: torques and dampers change kinetic and potential energy by their power."""
    task = having(FORWARDER, **switches)
    crane = cranes.build(task)
    whole = plant.build(task)
    tip, layout = whole.tip, whole.layout
    n, m = layout.n, tip.count
    y, torque = ca.SX.sym("y", layout.size), ca.SX.sym("torque", n)
    q = ca.vertsplit(ca.vertcat(y[layout.q], y[layout.bent]))
    v = ca.vertsplit(ca.vertcat(y[layout.v], y[layout.bending]))
    moving = plant._crane_motion(crane, tip, q, v)
    arms = [c.linkage.length_arm_slope(joint)[1] for c, joint in zip(crane.machine.cylinders, q, strict=False)]
    faster = moving.accelerate([t / arm for t, arm in zip(ca.vertsplit(torque), arms, strict=True)])
    energy = sum(whole.energy(y))
    change = ca.SX.zeros(layout.size)
    for part, rate in ((layout.q, v[:n]), (layout.v, faster[:n]), (layout.bent, v[n:]), (layout.bending, faster[n:])):
        change[part] = ca.vertcat(*rate)
    power = ca.Function("power", [y, torque], [ca.jtimes(energy, y, change), ca.dot(torque, y[layout.v]) - moving.lost])
    for _ in range(5):
        state = np.zeros(layout.size)
        state[layout.q] = [rng.uniform(j.lower, j.upper) for j in task.machine.joints]
        state[layout.v] = rng.uniform(-0.5, 0.5, n)
        state[layout.bent], state[layout.bending] = rng.uniform(-0.3, 0.3, m), rng.uniform(-1.0, 1.0, m)
        found, wanted = (float(value) for value in power(state, rng.uniform(-3e4, 3e4, n)))
        assert found == pytest.approx(wanted, rel=1e-9)


def test_a_run_with_everything_on_keeps_its_energy_balance_and_passes_farther_from_its_path():
    task = replace(FORWARDER, name="short", path=Lines(((4.5, 0.0, 2.0), (5.0, 0.0, 2.2)), (2.0,)))
    shape = np.linspace(0.0, 1.0, 41)
    motion = from_velocities(0.05, 0.55, 0.1 * 30.0 * (shape * (1.0 - shape)) ** 2, "glide", "ls")
    runs = [simulate(each, motion, "ls") for each in (task, having(task, **REAL))]
    assert all(run.complete and run.balance_error < 1e-4 for run in runs)
    assert runs[1].path_accuracy > 1.2 * runs[0].path_accuracy
    tip = plant.build(having(task, **REAL)).tip
    assert runs[1].tool[0, 2] - runs[0].tool[0, 2] == pytest.approx(
        tip.offset(runs[1].joint_position[:1], tip.rest(runs[1].joint_position[0])[None])[1][0]
    )  # bent down by its load before it moves


def test_without_switches_spools_are_as_before_to_the_last_bit(rng):
    machine = FORWARDER.machine
    spools, (advance, drive) = Spools(machine, STEP), second_order(machine.circuit.spool_bandwidth, STEP)
    state = np.zeros((2, 4))
    for _ in range(50):
        command = rng.uniform(-1.0, 1.0, 4)
        state = advance @ state + np.outer(drive, command)
        spools.move(command, float(rng.uniform(0.0, 30e6)))
        assert np.array_equal(spools._state, state)


def first_move(spools, supply, count=200):
    """Samples until a spool moves after its command has jumped to 1."""
    for k in range(count):
        spools.move(np.ones(4), supply)
        if spools._state[0].any():
            return k
    return count


@pytest.mark.parametrize(("supply", "late"), [(21.5e6, 0.0), (21.5e6 / 2, 0.05), (0.0, 0.1), (30e6, 0.0)])
def test_a_valve_is_later_the_less_its_supply_has(supply, late):
    """Nothing at the pump's highest pressure of 21.5 MPa, all of it without pressure."""
    assert first_move(Spools(having(FORWARDER, delay_slack=0.1).machine, STEP), supply) == round(late / STEP)


def test_commands_do_not_overtake_each_other():
    """A command given at low pressure comes late; the next, at full pressure, waits for it."""
    spools = Spools(having(FORWARDER, delay_slack=0.1).machine, STEP)
    spools.move(np.ones(4), 0.0)
    moved = []
    for _ in range(60):
        spools.move(-np.ones(4), 21.5e6)
        moved.append(float(spools._state[0][0]))
    assert moved[48] == 0.0 and moved[49] < 0.0


def test_a_spool_with_hysteresis_follows_with_play():
    """Slowly to 0.5 and back to 0: half the play short on the way there, half beyond on the way back."""
    spools = Spools(having(FORWARDER, hysteresis=0.04).machine, STEP)
    for share in (*np.linspace(0.0, 0.5, 2000), *np.full(500, 0.5)):
        spools.move(np.full(4, share), 20e6)
    assert spools._state[0] == pytest.approx(0.48)
    for share in (*np.linspace(0.5, 0.2, 2000), *np.full(500, 0.2)):
        spools.move(np.full(4, share), 20e6)
    assert spools._state[0] == pytest.approx(0.22)


def test_a_load_pressure_is_known_by_63_percent_after_its_sensing_time():
    whole = plant.build(having(FORWARDER, sensing_time=0.1))
    layout = whole.layout
    state, inputs = np.zeros(layout.size), np.zeros(4 * layout.n + 1)
    state[layout.q] = [0.0, 0.3, -1.0, 1.0]
    state[layout.a], state[layout.b], state[layout.supply] = 8e6, 1e6, 10e6
    inputs[[4, -1]] = 1.0  # the lift takes oil
    load, known = 8e6, 0.0
    for _ in range(1000):
        state[layout.sense] = known
        known += 1e-4 * float(np.asarray(whole.rates(state, inputs)).ravel()[layout.sense][0])
    assert known / load == pytest.approx(1.0 - np.exp(-1.0), abs=2e-4)


def test_a_tip_needs_a_mass_at_the_tool():
    """The loader has none of its own, only its payload."""
    task = having(lb.load_task("loader-triangle-small"), hanging_length=1.0)
    assert plant.build(task).tip.masses == pytest.approx((95.0, 380.0))
    with pytest.raises(
        InputError, match=r"^simulation.hanging_length = 1; must be 0 for machine loader, which has no "
    ):
        plant.build(replace(task, payload=0.0))


def test_all_is_off_without_a_word():
    assert {key: getattr(Circuit(), key) for key in REAL} == dict.fromkeys(REAL, 0.0)
    assert plant.build(FORWARDER).tip is None
    assert plant.build(FORWARDER).layout.size == 21
