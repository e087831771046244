"""One formula, wherever it is used: each consumer's motion, limits and rate of cost at random states, and the formulas.

A consumer is one function from a state and a cost to what it makes of them, by name. The formulas are those of
`formulas`, with a cost's terms; a consumer whose own copy differs fails.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from leanboom import load_task
from leanboom.certificate import bellman_bounds, cell_enclosures, partition, position_rows, upper_bound
from leanboom.components.circuits import Circuit
from leanboom.components.costs import COSTS, Supply
from leanboom.components.friction import Friction
from leanboom.components.pump_power import shaft_of
from leanboom.components.valves import Connection, IndependentMetering
from leanboom.dynamic_programming import bellman, grids
from leanboom.evaluation.evaluate import evaluate
from leanboom.fixed_mode import derivatives, modes
from leanboom.formulas import hydraulics
from leanboom.methods import smoothed_nlp
from leanboom.model import crane as cranes
from leanboom.model import motion
from leanboom.model.task import Task
from leanboom.problem import layout, stage_arrays, stages
from leanboom.problem.stages import Problem
from leanboom.simulation import plant, valve_sections
from test_costs import MIXED
from test_kernels import best_of_one
from test_shaft import known, with_map

PUMPS = ("ls", "cp")
MACHINES = ("forwarder-half-cycle", "loader-triangle-small")
MAP = "loader with an efficiency map"
# [m/s]: slower cylinders' friction changes sign, beside the threshold planners keep a distance, and the edge that fills
# a rod side is open by less than the hundredth at which the plant's pump senses all of its pressure.
CLEAR = 0.010
COUNT = 8  # states
HELD = 0.3e6  # [Pa]


@dataclass(frozen=True)
class State:
    """A state of the redundant cylinder at the beginning of a stage."""

    problem: Problem
    k: int
    c: float
    w: float
    u: float

    @property
    def moving(self) -> cranes.Moving:
        """Motion of the whole crane."""
        return cranes.move(self.pose, self.w, self.u)

    @property
    def pose(self) -> cranes.Pose:
        """Its pose."""
        return cranes.pose(self.problem.crane, self.problem.plane[self.k], self.c)

    @property
    def seed(self) -> motion.Motion:
        """A motion through the state, at rest two stages before and after."""
        step, n, velocity = self.problem.step, self.problem.stages, np.zeros(self.problem.stages + 1)
        velocity[self.k], velocity[self.k + 1] = self.w, self.w + step * self.u
        before = 0.5 * step * self.w if self.k else 0.0
        assert self.k + 1 < n
        return motion.from_velocities(step, self.c - before, velocity, "through", "ls")


def the_formulas(state: State, cost: str) -> dict[str, Any]:
    """Rate, motion and forces of the cylinders, and the accelerations that their limits allow the redundant one."""
    crane, moving = state.problem.crane, state.moving
    cylinders, machine, force = crane.machine.cylinders, crane.machine, cranes.forces(state.pose, moving)
    terms, pump = COSTS[cost].terms(cylinders, crane.drives), machine.pump
    total, flow, pressures = 0.0, 0.0, []
    for i, (v, f, d) in enumerate(zip(moving.velocity, force, crane.drives, strict=True)):
        total += terms.square[i] * v * v + (hydraulics.positive_work(v, f) if terms.work else 0.0)
        flow += hydraulics.cylinder_flow(v, terms.area_out[i], terms.area_in[i])
        line = d.gain_out, d.back_out, d.gain_in, d.back_in
        pressures.append(float(hydraulics.pressure_demand(v, f, machine.driven_velocity, *line)))
    if terms.supply is not Supply.NONE:
        supply = pump.ls_margin + max(pressures) if terms.supply is Supply.LOAD_SENSING else pump.constant_pressure
        total += hydraulics.pump_power(supply, flow, *shaft_of(pump))
    still, push = (np.array(cranes.move(state.pose, state.w, u).acceleration) for u in (0.0, 1.0))
    kept = state.problem.moving
    limit = np.array([c.acceleration_limit for c in cylinders])[kept]
    still, change = still[kept], (push - still)[kept]
    middle, half = -still / change, limit / np.abs(change)
    window = np.array([np.max(middle - half), np.min(middle + half)])
    excess = np.abs(moving.velocity) - [c.velocity_limit for c in cylinders]
    return {
        "rate": float(total), "velocity": np.array(moving.velocity), "acceleration": np.array(moving.acceleration),
        "force": np.array(force), "window": window, "allowed": bool(window[0] <= state.u <= window[1]),
        "excess": float(np.maximum(excess[kept], 0.0).sum()), "joints": np.array(moving.joint_acceleration),
        "hardest": limit, "pressure": np.array(pressures),
    }  # fmt: skip


# The consumers.


@lru_cache
def polishers(problem: Problem, cost: str) -> modes.Polisher:
    """The fixed-mode program of a cost."""
    return modes.build(problem, cost)


@lru_cache
def tables(problem: Problem, cost: str) -> grids.Tables:
    """The kernels' arrays on a coarse grid."""
    return grids.tables(problem, grids.full_grid(problem, 3, 3), cost)


def kernel(state: State, cost: str) -> dict[str, Any]:
    """Bellman's equation at a node; the control is pinned by a grid ahead with one tiny interval of velocities."""
    problem, k = state.problem, state.k
    stage = tables(problem, cost).stage.copy()
    stage[k + 1, [layout.W_LO, layout.DW]] = state.w + problem.step * state.u, 1e-12
    cylinder = stage_arrays.cylinder_table(problem, cost)
    node = stage_arrays.coefficients(problem, np.full((problem.stages + 1, 1), state.c))[k, 0]
    row, at = bellman.empty_row(1, node.shape[0], 2), (0.0, np.array([state.w]), k, stage, cylinder)
    bellman.limit_controls(node, *at, stage_arrays.setting(problem, cost, (0.0, 0.0, 1.0, 0.0, 0.0)), row)
    low, high, base = (float(row.state[name, 0]) for name in (bellman.LOW, bellman.HIGH, bellman.OFFSET))
    setting, ahead = stage_arrays.setting(problem, cost, (0.0,) * 5), np.zeros((3, 3))
    value, used = best_of_one(node, 0.0, state.c, state.w, k, stage, cylinder, setting, ahead)
    found = {"excess": base - problem.step * stage[k, layout.FIXED_COST]}
    found |= {"window": np.array([low, high])} if low < high else {}  # none is told as its middle
    return found | ({"rate": value / problem.step} if abs(used - state.u) < 1e-9 else {})


def fixed_mode(state: State, cost: str) -> dict[str, Any]:
    """The fixed-mode program, its supply and flows the least that its limits allow."""
    problem, k, polisher = state.problem, state.k, polishers(state.problem, cost)
    switches = modes.modes(polisher, state.seed)
    mode = modes._mode_parameters(polisher, switches)
    program = modes._program(polisher, state.seed, switches, mode, False, (1.0,) * 3)
    n = mode.shape[-1]
    point, value = derivatives.empty_point(problem.stages, n), derivatives.empty_limits(problem.stages, n)
    point.state[:, 0], point.state[:, 1] = state.seed.position, state.seed.velocity
    point.control[:] = state.seed.acceleration
    jet, moved = np.empty((problem.stages + 1, n, 3, layout.COEFFICIENTS)), np.empty((n, 3, derivatives.DERIVATIVES))
    derivatives.jets(program, point.state[:, 0].copy(), jet)
    derivatives.evaluate(program, point, jet, moved, value)
    g, node = value.end[k, 0], value.node[k]
    point.local[k, 0, 1:] = np.maximum(-g[3 * n + 1 : 5 * n + 1 : 2], -g[3 * n + 2 : 5 * n + 1 : 2])
    point.local[k, 0, 0] = max(-g[3 * n], *np.where(mode[0, k, derivatives.ALPHA] > 0.0, -g[2 * n : 3 * n], 0.0))
    derivatives.move(program, k, 0, point, jet, moved)
    rate = derivatives.rate(program, k, 0, point, moved) / derivatives.MILLI
    return {
        "rate": rate + stage_arrays.path_determined(problem, cost)[2][k], "velocity": node[2::2] + program.low[k, 1:],
        "acceleration": 0.5 * (g[0 : 2 * n : 2] - g[1 : 2 * n : 2]), "force": moved[:, derivatives.F, derivatives.X],
        "hardest": 0.5 * (g[0 : 2 * n : 2] + g[1 : 2 * n : 2]),
    }  # fmt: skip


def smoothed(state: State, cost: str) -> dict[str, Any]:
    """The direct methods' power, sharp."""
    return {"rate": 1e3 * smoothed_nlp.smooth_power(state.problem.crane, state.pose, state.moving, cost, 1e8, 1e-18)}


def cell(state: State, cost: str) -> dict[str, Any]:
    """The certificate's bound over a cell of next to no size, into one as small."""
    problem, k, tiny = state.problem, state.k, 1e-10
    step, limit = problem.step, problem.crane.machine.redundant.velocity_limit
    rows, ahead = np.array([state.c - tiny, state.c + tiny]), state.c + step * (state.w + 0.5 * step * state.u)
    w = state.w + step * state.u
    bounds = np.array([[-2.0 * limit, 2.0 * limit]])
    stage = cell_enclosures.Stage(
        position_rows._enclosed(problem, np.array([k]), np.array([state.c]), np.array([tiny])), rows,
        np.array([[state.w - tiny, state.w + tiny]]), bounds, np.array([w - tiny, 2.0 * tiny, 0.0]),
        np.array([ahead - 1e-3, ahead + 1e-3]), np.array([[w - tiny, w + tiny]]), bounds,
        partition._fixed(problem, cost)[k], stage_arrays.cylinder_table(problem, cost),
        stage_arrays.setting(problem, cost, (0.0,) * 5, share=1.0),
    )  # fmt: skip
    planes, found = np.zeros((1, 1, 4)), np.zeros((1, 1))
    bellman_bounds.backward(stage, 0, 1, True, np.zeros((1, 1)), planes, planes, found, np.zeros((0, 0)))
    allowed = bool(np.isfinite(found[0, 0]))
    return {"allowed": allowed, **({"rate": found[0, 0] / step} if allowed else {})}


def known_motion(state: State, cost: str) -> dict[str, Any]:
    """The energy of a motion that a certificate compares its bound with."""
    return {"rate": upper_bound.measure(state.problem, state.seed, cost).costs[state.k] / state.problem.step}


def judge(state: State, cost: str) -> dict[str, Any]:
    """The judged motion through the state."""
    found = evaluate(state.problem.task, state.seed)
    at = int(np.argmin(np.abs(found.time - state.k * state.problem.step)))
    power = found.power_ls if cost == "ls" else found.power_cp
    return {
        "rate": power[at], "velocity": found.velocity[at], "acceleration": found.acceleration[at],
        "force": found.force[at], "pressure": found.pressure[at], "joints": found.joint_acceleration[at],
    }  # fmt: skip


def steady_plant(state: State, cost: str) -> dict[str, Any]:
    """The simulated crane under chamber pressures at which every cylinder keeps its velocity."""
    problem, moving, n = state.problem, state.moving, len(state.moving.velocity)
    machine, built = problem.crane.machine, plant.of(problem.crane)
    force = cranes.forces(state.pose, moving)
    y, u, flow, high = np.zeros(built.layout.size), np.zeros(4 * n + 1), 0.0, 60e6
    y[built.layout.q], y[built.layout.v] = (0.0,) * (n - 3) + state.pose.q, moving.joint_velocity
    for i, (cylinder, v, f) in enumerate(zip(machine.cylinders, moving.velocity, force, strict=True)):
        section = valve_sections.section(machine, cylinder)
        pressures, shares = steady(section, machine, cylinder, v, f, high)
        y[built.layout.a.start + i], y[built.layout.b.start + i] = pressures
        u[4 * i : 4 * i + 4] = shares
        flow += valve_sections.flows(section, shares, *pressures, high).pump
    y[built.layout.supply], u[-1] = high, cost == "ls"
    seen = dict(zip(plant.OBSERVED, built.observe(y, u), strict=True))
    supply, against = float(seen["wanted"]), np.array(force) * moving.velocity > 0.0  # a load ahead asks for nothing
    rates, sense = np.array(built.rates(y, u)).ravel(), np.array(seen["sense"]).ravel()
    counted = np.where(against, sense, 0.0)
    # Where a load that runs ahead is all that the pump senses, planning counts nothing.
    known = cost == "cp" or counted.max() == sense.max()
    return ({"rate": hydraulics.pump_power(supply, flow, *shaft_of(machine.pump))} if known else {}) | {
        "force": np.array(seen["force"]).ravel(), "joints": rates[built.layout.v][-3:],
        "velocity": np.array(built.measure(y)).ravel()[n:],
        "pressure": counted,
    }  # fmt: skip


def steady(section, machine, cylinder, v, force, supply):
    """Chamber pressures [Pa] and open shares of edges at which a cylinder keeps a velocity under a force.

    One spool opens both edges alike; two leave the valve's resting pressure in the chamber that empties. A load that
    runs ahead is held by the edge it drives oil through, and the other chamber keeps `HELD`.
    """
    (area_a, area_b), out, single = cylinder.areas, v > 0.0, cylinder.connection is Connection.SINGLE_ACTING

    def chambers(emptied):
        other = (force + area_b * emptied) / area_a if out else (area_a * emptied - force) / area_b
        return (other, emptied) if out else (emptied, other)

    def flows(into, from_, emptied):
        edges = (into, 0.0, 0.0, from_) if out else (0.0, from_, into, 0.0)
        a, b = chambers(emptied)
        found = valve_sections.flows(section, edges, a, 0.0 if single else b, supply)
        return (found.a - area_a * v, found.b + area_b * v), edges

    filling, emptying = (0, 1) if out else (1, 0)
    if single and not out:
        emptied = force / area_a
        share = brentq(lambda from_: flows(0.0, from_, emptied)[0][0], 0.0, 1.0, xtol=1e-14)
        return (emptied, 0.0), flows(0.0, share, emptied)[1]

    def settled(into):
        """Share of the edge that oil leaves by, and pressure of the chamber that empties."""
        if single:
            return 0.0, 0.0
        if machine.valve.separate:
            return held(machine.valve.resting(machine.pump, machine.circuit))
        return into, brentq(lambda e: flows(into, into, e)[0][emptying], 0.0, 1e14, rtol=1e-14)

    def held(emptied):
        return brentq(lambda share: flows(0.0, share, emptied)[0][emptying], 0.0, 1.0, xtol=1e-14), emptied

    def lacks(into, leaving):
        return flows(into, *leaving(into))[0][filling]

    def opened(leaving):
        return brentq(lacks, 1e-3, 1.0, (leaving,), xtol=1e-14)

    leaving = settled
    fills_by_itself = lacks(1e-3, settled) > 0.0
    if not single and (fills_by_itself or chambers(settled(opened(settled))[1])[filling] < HELD):
        at = held((area_a * HELD - force) / area_b if out else (area_b * HELD + force) / area_a)
        leaving = lambda into: at  # noqa: E731
    into = opened(leaving)
    share, emptied = leaving(into)
    return chambers(emptied), flows(into, share, emptied)[1]


def tasks() -> dict[str, Task]:
    """Both machines, with friction, and what planning leaves out by default counted."""
    found = {}
    for name in MACHINES:
        task = load_task(name, start="middle")
        machine = task.machine
        cylinders = tuple(replace(c, friction=Friction(2e3, 2000.0, 4e3, c.friction.steps)) for c in machine.cylinders)
        valve = IndependentMetering(1e6, 1e6) if machine.valve.separate else machine.valve
        found[name] = replace(
            task, machine=replace(
                machine, cylinders=cylinders, valve=valve, coriolis=True, circuit=Circuit(counter_pressure=0.0),
                pump=replace(machine.pump, max_pressure=100e6),
            ),
        )  # fmt: skip
    found[MAP] = with_map(found[MACHINES[1]], known())
    return found


PROBLEMS = {name: stages.discretise(task, 0.1) for name, task in tasks().items()}


@lru_cache
def states(name: str, fastest: float) -> list[State]:
    """Random states in which no cylinder is near to being held; in every second one, where found, all loads run ahead.

    In every fourth the acceleration is beyond the limits.
    """
    rng, problem = np.random.default_rng(11), PROBLEMS[name]
    found: list[State] = []
    for draw in range(3000):
        if len(found) == COUNT:
            break
        k = int(rng.integers(1, problem.stages - 2))
        c = problem.lower[k] + rng.uniform(0.2, 0.8) * (problem.upper[k] - problem.lower[k])
        w = rng.choice([-1.0, 1.0]) * rng.uniform(0.03, 0.3 if len(found) % 2 else fastest)
        state = State(problem, k, float(c), float(w), 0.3 * rng.normal() if len(found) % 4 < 3 else 2.0)
        moving = state.moving
        against = np.array(cranes.forces(state.pose, moving)) * moving.velocity > 0.0
        if np.min(np.abs(moving.velocity)) > CLEAR and (
            draw > 300 or len(found) % 2 != np.any(against[problem.moving])
        ):
            found.append(state)
    return found


CONSUMERS = {
    kernel: (*COSTS, "mixed"), fixed_mode: (*COSTS, "mixed"), smoothed: PUMPS, cell: PUMPS, known_motion: PUMPS,
    judge: PUMPS, steady_plant: PUMPS,
}  # fmt: skip
CASES = [(name, one, cost) for name in MACHINES for one, some in CONSUMERS.items() for cost in some]
CASES += [(MAP, one, cost) for one in CONSUMERS if one is not cell for cost in PUMPS]  # that bounds no maps


@pytest.mark.parametrize(("name", "consumer", "cost"), CASES, ids=[f"{b.__name__}, {c}, {a}" for a, b, c in CASES])
def test_every_consumer_uses_the_formulas(monkeypatch, name, consumer, cost):
    """Motion, forces, limits and rate of cost, each where the consumer has it; the plant's gates are smooth."""
    monkeypatch.setitem(COSTS, "mixed", MIXED)
    close, compared = 1e-4 if consumer is steady_plant else 2e-6, set()
    for state in states(name, 1.0 if consumer is kernel else 0.3):  # velocities beyond limits cost
        wanted = the_formulas(state, cost)
        for what, value in consumer(state, cost).items():
            own = np.atleast_1d(wanted[what])[-np.size(value) :]  # of the last cylinders where it is not of all
            np.testing.assert_allclose(np.atleast_1d(value), own, rtol=close, atol=1e-8, err_msg=what)
            compared.add(what)
    assert "rate" in compared
