"""The plant against physics worked out by other means: printed equations, closed solutions, another simulator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from leanboom.components.circuits import Circuit
from leanboom.components.friction import Friction
from leanboom.components.valves import METERING
from leanboom.formulas import fluid
from leanboom.io.loading import load_machine, load_task
from leanboom.model import crane as cranes
from leanboom.simulation import controllers, plant, valve_sections
from leanboom.simulation.integrator import Integrator
from test_dynamics import MuJoCo, crane

STEP = 0.01
FORWARDER = cranes.build(load_task("forwarder-horizontal"))
LOADER = cranes.build(load_task("loader-triangle-large"))
RETURN = 0.3e6  # counter-pressure of the forwarder [Pa]


def without_friction(crane_, viscous=0.0):
    """A crane whose cylinders do not rub, or only in proportion to their velocity."""
    machine = crane_.machine
    cylinders = tuple(replace(c, friction=Friction(0.0, 1.0, viscous)) for c in machine.cylinders)
    return replace(crane_, machine=replace(machine, cylinders=cylinders))


def with_pump(crane_, **values):
    return replace(crane_, machine=replace(crane_.machine, pump=replace(crane_.machine.pump, **values)))


def held_valve(crane_, load, shares, seconds, mass=300.0, load_sensing=False):
    """State of the rig after valves were held open by shares (out positive, in negative), and what is observed."""
    stand = plant.assemble(crane_, controllers.rig(crane_, np.array(load, dtype=float), mass))
    count = round(seconds / STEP)
    edges = np.zeros((count + 12, 4 * stand.layout.n))
    for i, share in enumerate(shares):
        out, back = max(share, 0.0), max(-share, 0.0)
        edges[1:, 4 * i : 4 * i + 4] = (out, back, back, out)
    start = controllers.resting(stand, np.array(load, dtype=float))
    if not load_sensing:
        start[stand.layout.supply] = crane_.machine.pump.constant_pressure
    integrator = Integrator(stand, start, edges, load_sensing=load_sensing, step=STEP, ahead=10)
    states = [start, *(integrator.advance(k).copy() for k in range(1, count + 1))]
    return stand.layout, np.array(states), stand


# Steady states, eqs. (20)-(28).

AMPLE = with_pump(without_friction(FORWARDER), max_flow=1.0)
DROP = 0.7e6


def areas(index):
    cylinder = FORWARDER.machine.cylinders[index]
    return cylinder.piston_area, cylinder.rod_side_area


def test_extending_chambers_settle_on_eqs_23_and_24():
    """Base and tilt push a load: p_B = Coeff. dp_c + p_T, p_A from the force."""
    load = [20e3, 60e3, 30e3, 8e3]
    layout, states, _ = held_valve(AMPLE, load, [0.3] * 4, 3.0)
    for i in (0, 2):
        a, b = areas(i)
        rod = 1.5 * DROP + RETURN
        assert states[-1, layout.b][i] == pytest.approx(rod, rel=2e-3)
        assert states[-1, layout.a][i] == pytest.approx(load[i] / a + b / a * rod, rel=2e-3)


def test_a_single_acting_cylinder_settles_on_its_load_alone():
    """Nothing but friction damps it: the oil that it drives out meets no throttle."""
    rubbing = with_pump(without_friction(FORWARDER, viscous=10e3), max_flow=1.0)
    layout, states, _ = held_valve(rubbing, [0.0, 60e3, 0.0, 0.0], [0.0, 0.3, 0.0, 0.0], 3.0)
    force = 60e3 + 10e3 * states[-1, layout.v][1]
    assert states[-1, layout.a][1] == pytest.approx(force / areas(1)[0], rel=1e-3)
    assert states[-1, layout.b][1] == 0.0


def test_retracting_chambers_settle_on_eqs_23_and_24():
    """Base, tilt and extension pull a load: p_A = Coeff. dp_c + p_T, p_B from the force."""
    load = [-20e3, 0.0, -30e3, -8e3]
    layout, states, _ = held_valve(AMPLE, load, [-0.3, 0.0, -0.3, -0.1], 3.0)
    for i in (0, 2, 3):
        a, b = areas(i)
        piston = 1.9 * DROP + RETURN
        assert states[-1, layout.a][i] == pytest.approx(piston, rel=2e-3)
        assert states[-1, layout.b][i] == pytest.approx(-load[i] / b + a / b * piston, rel=2e-3)


def test_a_differential_spool_settles_on_eqs_27_and_28():
    layout, states, _ = held_valve(AMPLE, [0.0, 0.0, 0.0, 8e3], [0.0, 0.0, 0.0, 0.1], 3.0)
    a, b = areas(3)
    rod = 8e3 / (a - b) + (b**2 * a / (a - b) ** 3 + a / (a - b)) * DROP  # K_vPA / K_vBP = 1
    assert states[-1, layout.b][3] == pytest.approx(rod, rel=2e-3)
    assert states[-1, layout.a][3] == pytest.approx(8e3 / a + rod * b / a, rel=2e-3)


@pytest.mark.parametrize(
    ("index", "share", "area"),
    [(0, 0.3, "a"), (0, -0.3, "b"), (2, 0.3, "a"), (2, -0.3, "b"), (3, 0.1, "rod"), (3, -0.1, "b")],
)
def test_steady_velocities_are_those_of_eq_20(index, share, area):
    """Flow of the compensated edge over the area it feeds; the differential spool's over the rod's."""
    load = [0.0] * 4
    load[index] = np.sign(share) * 5e3
    shares = [0.0] * 4
    shares[index] = share
    layout, states, _ = held_valve(AMPLE, load, shares, 3.0)
    a, b = areas(index)
    velocity = np.sign(share) * abs(share) * 170e-3 / 60 / {"a": a, "b": b, "rod": a - b}[area]
    assert states[-1, layout.v][index] == pytest.approx(velocity, rel=2e-3)


def test_a_compensator_out_of_margin_lets_less_through():
    """0.2 MPa are left of the 0.7 MPa that the compensator would hold: flow falls with the root."""
    a, b = areas(0)
    rod = 1.5 * 0.2e6 + RETURN  # the return throttle passes less as well
    load = 8e6 * a - rod * b
    short = with_pump(AMPLE, constant_pressure=8.2e6)
    layout, states, _ = held_valve(short, [load, 0.0, 0.0, 0.0], [0.3, 0.0, 0.0, 0.0], 4.0)
    assert states[-1, layout.v][0] == pytest.approx(0.3 * 170e-3 / 60 / a * np.sqrt(0.2 / 0.7), rel=5e-3)


def test_metered_edges_pass_the_same_flow_whatever_the_load():
    ample = with_pump(without_friction(LOADER), max_flow=1.0)
    ample = replace(ample, machine=replace(ample.machine, circuit=replace(METERING, seal_friction=0.0)))
    found = []
    for load in (5e3, 40e3):
        layout, states, _ = held_valve(ample, [load, load, 2e3], [0.2, 0.2, 0.2], 3.0)
        found.append(states[-1, layout.v])
    assert found[0] == pytest.approx(found[1], rel=5e-3)


def test_anti_cavitation_fills_a_chamber_that_its_load_pulls_open():
    """The load runs ahead of the oil: the filling chamber stays at the return line's pressure, not below the tank's."""
    layout, states, _ = held_valve(AMPLE, [0.0, 0.0, -60e3, 0.0], [0.0, 0.0, 0.3, 0.0], 3.0)
    a, b = areas(2)
    assert states[-1, layout.a][2] == pytest.approx(RETURN, abs=0.3e6)
    assert states[-1, layout.a][2] > 0.0
    through_valve = 0.3 * 170e-3 / 60 / a
    assert states[-1, layout.v][2] > 1.3 * through_valve


# The pump.


def test_a_load_sensing_pump_follows_with_its_time_constant():
    """Lift under 60 kN, its valve barely open: from the margin to load plus margin, 63 % after 0.2 s."""
    layout, states, _ = held_valve(AMPLE, [0.0, 60e3, 0.0, 0.0], [0.0, 0.02, 0.0, 0.0], 3.0, load_sensing=True)
    supply = states[:, layout.supply]
    final = 60e3 / areas(1)[0] + 3e6
    assert supply[-1] == pytest.approx(final, rel=1e-3)
    after = round(0.2 / STEP) + 1  # the valve opens during the first step
    assert (supply[after] - supply[0]) / (final - supply[0]) == pytest.approx(1.0 - np.exp(-1.0), abs=0.03)


def test_a_load_sensing_pump_stops_at_its_highest_pressure():
    low = with_pump(AMPLE, max_pressure=6e6)
    layout, states, _ = held_valve(low, [0.0, 60e3, 0.0, 0.0], [0.0, 0.02, 0.0, 0.0], 3.0, load_sensing=True)
    assert states[-1, layout.supply] == pytest.approx(6e6, rel=1e-3)


def test_a_pump_gives_no_more_than_all_its_flow():
    """Two cylinders ask for twice what there is: the supply breaks down and their speeds share the flow."""
    asked = 2 * 0.5 * 170e-3 / 60
    small = with_pump(AMPLE, max_flow=0.5 * asked)
    layout, states, stand = held_valve(small, [5e3, 0.0, 5e3, 0.0], [0.5, 0.0, 0.5, 0.0], 4.0)
    v = states[-1, layout.v]
    taken = v[0] * areas(0)[0] + v[2] * areas(2)[0]
    assert taken == pytest.approx(0.5 * asked, rel=5e-3)
    assert states[-1, layout.supply] < 3e6


# A cylinder as a spring.


def test_a_locked_cylinder_swings_as_the_analytic_second_order_system():
    """Motion m x'' = -B (A^2/V_A + B^2/V_B) x about its equilibrium, let go 40 % above its load."""
    mass, load, i = 2000.0, 30e3, 2
    crane_ = without_friction(FORWARDER)
    stand = plant.assemble(crane_, controllers.rig(crane_, np.array([0.0, 0.0, load, 0.0]), mass))
    layout = stand.layout
    a, b = areas(i)
    start = np.zeros(layout.size)
    start[layout.a], start[layout.b], start[layout.supply] = 8e6, 5e6, 3e6
    start[layout.a.start + i] = (1.4 * load + 5e6 * b) / a
    edges = np.zeros((400, 16))
    integrator = Integrator(stand, start, edges, load_sensing=False, step=0.002, ahead=5)
    times = 0.002 * np.arange(1, 251)
    moved = np.array([integrator.advance(k)[layout.q][i] for k in range(1, 251)])
    stroke = 0.725
    stiffness = 1e9 * (a**2 / (1e-3 + a * stroke / 2) + b**2 / (1e-3 + b * stroke / 2))
    analytic = 0.4 * load / stiffness * (1.0 - np.cos(np.sqrt(stiffness / mass) * times))
    assert np.sqrt(stiffness / mass) * times[-1] > 6 * np.pi  # several swings
    assert np.abs(moved - analytic).max() < 5e-3 * analytic.max()


@pytest.mark.parametrize("share", [0.1, 0.9])
def test_closed_chambers_follow_eqs_18_and_19_wherever_the_piston_is(share):
    """The lift of the loader with closed valves: volumes from lengths by the law of cosines, not from the plant."""
    built = plant.of(LOADER)
    layout, machine = built.layout, LOADER.machine
    y = np.zeros(layout.size)
    y[layout.q] = [joint.lower + share * (joint.upper - joint.lower) for joint in machine.joints]
    y[layout.v] = [0.3, 0.0, 0.0]
    y[layout.a], y[layout.b], y[layout.supply] = 8e6, 3e6, 10e6
    rates = np.asarray(built.rates(y, np.zeros(13))).ravel()
    link, cylinder = machine.cylinders[0].linkage, machine.cylinders[0]

    def length(q):
        return np.sqrt(link.long**2 + link.short**2 - 2 * link.long * link.short * np.cos(q + link.angle))

    x = length(y[0]) - length(machine.joints[0].lower)
    travel = length(machine.joints[0].upper) - length(machine.joints[0].lower)
    v = 0.3 * (length(y[0] + 1e-6) - length(y[0] - 1e-6)) / 2e-6
    a, b = cylinder.piston_area, cylinder.rod_side_area
    assert rates[layout.a][0] == pytest.approx(-1e9 * a * v / (0.5e-3 + a * x), rel=1e-6)
    assert rates[layout.b][0] == pytest.approx(1e9 * b * v / (0.5e-3 + b * (travel - x)), rel=1e-6)
    assert rates[layout.a][1] == 0.0  # the tilt is locked


def test_cylinder_ends_push_back_and_never_pull():
    x = np.array([-1e-3, 0.0, 0.3, 0.6, 0.601])
    force = fluid.end_force(x, 0.0, 0.6, 1e8)
    assert force == pytest.approx([1e5, 0.0, 0.0, 0.0, -1e5])
    assert fluid.end_force(-1e-3, -0.2, 0.6, 1e8) == pytest.approx(2e5)  # damped by the approach
    assert fluid.end_force(-1e-3, 5.0, 0.6, 1e8) == 0.0
    assert fluid.end_force(0.601, -5.0, 0.6, 1e8) == 0.0


# Rigid bodies.


@pytest.mark.parametrize(("name", "payload"), [("forwarder", 120.0), ("loader", 475.0)])
def test_accelerations_are_those_of_another_simulator(name, payload, rng):
    """MuJoCo moves the same bodies under the torques that forces on the pistons make by virtual work."""
    ours = crane(name, payload, gravity=9.81)
    oracle = MuJoCo(ours)
    built = plant.of(ours)
    layout, n = built.layout, built.layout.n
    for _ in range(5):
        q = np.array([j.lower + rng.uniform(0.2, 0.8) * (j.upper - j.lower) for j in ours.machine.joints])
        v = rng.uniform(-0.3, 0.3, n)
        y = np.zeros(layout.size)
        y[layout.q], y[layout.v], y[layout.supply] = q, v, 1e7
        y[layout.a], y[layout.b] = rng.uniform(2e6, 1e7, n), rng.uniform(2e6, 1e7, n)
        u = np.zeros(4 * n + 1)
        found = np.asarray(built.rates(y, u)).ravel()[layout.v]
        observed = dict(zip(plant.OBSERVED, (np.asarray(x.full()).ravel() for x in built.observe(y, u)), strict=True))
        areas_a = np.array([c.piston_area for c in ours.machine.cylinders])
        areas_b = np.array([c.rod_side_area for c in ours.machine.cylinders])
        force = y[layout.a] * areas_a - y[layout.b] * areas_b
        assert observed["force"] == pytest.approx(force, rel=1e-12)
        arms = np.empty(n)
        for i in range(n):  # piston travel per joint, by differences
            ends = []
            for side in (-1e-5, 1e-5):
                at = y.copy()
                at[i] += side
                ends.append(np.asarray(built.measure(at)).ravel()[i])
            arms[i] = (ends[1] - ends[0]) / 2e-5
        torque = arms * (force - observed["friction"] + observed["end"])
        full_q, full_v = (q, v) if n == 4 else (np.array([0.0, *q]), np.array([0.0, *v]))
        keep = slice(4 - n, 4)
        bias = oracle.gravity(full_q) + oracle.velocity(full_q, full_v)
        expected = np.linalg.solve(oracle.mass(full_q)[keep, keep], torque - bias[keep])
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-6)


# Valves by themselves.


def test_spools_wait_and_lag():
    """Nothing for 0.16 s; and a sine of the bandwidth comes through with 0.707 of its height."""
    spools = valve_sections.Spools(load_machine("forwarder"), 0.002)
    assert spools.delay == 80
    open_machine = replace(load_machine("forwarder"), circuit=Circuit(dead_zone=0.0))
    spools = valve_sections.Spools(open_machine, 0.0005)
    travel = []
    for k in range(4000):
        shares = spools.move(np.full(4, np.sin(2 * np.pi * 8.0 * 0.0005 * k)), 20e6)
        opened = shares[0] - shares[1]
        travel.append(np.sign(opened) * 0.5 * (np.sqrt(1.0 + 8.0 * abs(opened)) - 1.0))
    assert max(travel[2000:]) == pytest.approx(np.sqrt(0.5), rel=0.01)


def test_the_dead_zone_opens_nothing():
    assert fluid.opening(0.53, 0.53) == 0.0
    assert fluid.opening(0.531, 0.53) > 0.0
    assert fluid.opening(-0.9, 0.53) == 0.0
    assert fluid.opening(1.0, 0.53) == 1.0


def test_what_passes_a_section_keeps_energy(rng):
    """Power from the supply is power into the chambers, to the tank and left in the valve, for every kind of valve."""
    for crane_ in (FORWARDER, LOADER):
        for cylinder in crane_.machine.cylinders:
            section = valve_sections.section(crane_.machine, cylinder)
            for _ in range(20):
                edges = tuple(rng.uniform(0, 1) * side for side in rng.permutation([1.0, 1.0, 0.0, 0.0]))
                a, b, supply = rng.uniform(-0.2e6, 20e6, 3)
                flow = valve_sections.flows(section, edges, a, b, supply)
                assert supply * flow.pump == pytest.approx(a * flow.a + b * flow.b + flow.loss, rel=1e-9, abs=1e-6)
