"""Costs as data: the terms of every cost, one formula for all that use them, and a new cost in one entry."""

from __future__ import annotations

import numpy as np
import pytest

from leanboom import load_task
from leanboom.components import costs
from leanboom.components.costs import COSTS, Cost, Supply
from leanboom.errors import InputError
from leanboom.evaluation.evaluate import judged_cost
from leanboom.model import cost_rates
from leanboom.model import crane as cranes
from leanboom.planning import planner

MIXED = Cost(
    "mixed", "constant-pressure energy, and the lift cylinder's squared velocity",
    supply=Supply.CONSTANT, square=lambda count: (0.0,) * (count - 3) + (2e7, 0.0, 0.0),
)  # fmt: skip


@pytest.fixture
def mixed(monkeypatch):
    """A cost from outside the package: one entry."""
    monkeypatch.setitem(COSTS, "mixed", MIXED)
    return "mixed"


def test_terms_are_the_numbers_of_the_papers_costs():
    crane = cranes.build(load_task("forwarder-vertical"))
    drives, cylinders = crane.drives, crane.machine.cylinders
    ls, cp = cost_rates.terms_of(crane, "ls"), cost_rates.terms_of(crane, "cp")
    assert ls.area_out == cp.area_out == tuple(d.area_out for d in drives)
    assert ls.area_in == cp.area_in == tuple(d.area_in for d in drives)
    assert (ls.supply, cp.supply) == (Supply.LOAD_SENSING, Supply.CONSTANT)
    net = cost_rates.terms_of(crane, "recuperation")
    assert net.area_out == tuple(c.piston_area - c.rod_side_area for c in cylinders)
    assert net.area_in == tuple(-a for a in net.area_out)
    assert cost_rates.terms_of(crane, "velocity").square == (1.0,) * 4
    assert cost_rates.terms_of(crane, "extension").square == (0.0, 0.0, 0.0, 1.0)
    work = cost_rates.terms_of(crane, "actuator")
    assert work.work and work.area_out == work.area_in == work.square == (0.0,) * 4


def test_work_and_a_load_sensing_supply_do_not_go_together():
    with pytest.raises(InputError, match="cost both = work and a load-sensing supply; must be one of them"):
        Cost("both", "", supply=Supply.LOAD_SENSING, work=True)


def test_a_pump_without_name_is_refused():
    with pytest.raises(InputError, match="pump = LS; must be one of ls, cp"):
        costs.of_pump("LS", 1, 2)


def test_a_new_cost_is_planned_polished_and_judged(mixed):
    """Its plan costs less than those for others, the polish takes part, and the judge measures energy and squares."""
    task = load_task("forwarder-vertical", start="middle")
    found = {
        cost: planner.run(task, cost=cost, grid=(41, 21), step=0.1, baseline=False).evaluation
        for cost in ("cp", "velocity", mixed)
    }
    mine = judged_cost(found[mixed], mixed)
    assert found[mixed].feasible
    assert mine < 0.999 * judged_cost(found["cp"], mixed) and mine < judged_cost(found["velocity"], mixed)
    assert any("polish" in line for line in found[mixed].motion.log)
    lift = found[mixed].velocity[:, 1]
    squares = np.trapezoid(2e7 * lift**2, found[mixed].time)
    assert mine == pytest.approx(found[mixed].energy_cp + squares, rel=1e-9)
