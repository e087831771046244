"""A small part of `benchmarks.campaign`: plans of a random task; worse plans and broken relations are found."""

from argparse import Namespace
from dataclasses import replace

import numpy as np
import pytest
from benchmarks import campaign

import leanboom as lb
from leanboom.components.costs import PUMPS
from leanboom.model import motion

NUMBER = 39  # a short task of the loader
TASK = campaign.random_task(NUMBER)
ALONE = Namespace(proof=0.0, direct=False, random=0)


@pytest.fixture(autouse=True)
def few_looks(monkeypatch):
    """One other grid, and no method that takes long."""
    monkeypatch.setattr(campaign, "LOOKS", {"grid 71x35": {"grid": (71, 35)}})


def test_a_task_is_the_same_whenever_it_is_drawn():
    assert campaign.random_task(NUMBER) == TASK
    assert campaign.random_task(NUMBER + 1) != TASK


@pytest.mark.slow
@pytest.mark.parametrize("pump", PUMPS)
def test_nothing_beats_the_default_plan(pump, monkeypatch):
    if pump == "ls":  # its plans take ten times as long: no relations here
        monkeypatch.setattr(campaign, "relations", lambda task: ())
        monkeypatch.setattr(campaign, "there_and_back", lambda *arguments: 0.0)
    tally = campaign.Tally(pump)
    tally.look_again(TASK, NUMBER, ALONE)
    ((loss, _),) = tally.losses
    assert loss <= campaign.SAME
    assert "there and back" in tally.relations
    for rows in tally.relations.values():
        assert max(rows)[0] <= campaign.SAME


@pytest.mark.slow
def test_a_plan_that_another_look_beats_is_found(monkeypatch, capsys):
    """A default plan from another start than the best one loses to the one that the other grid finds."""
    free, plan = replace(TASK, start="best"), campaign.planned

    def poor(task, pump, **options):
        return plan(task if options else replace(task, start="smallest"), pump, **options)

    monkeypatch.setattr(campaign, "planned", poor)
    monkeypatch.setattr(campaign, "relations", lambda task: [("twice the cost", task, 0.5)])
    tally = campaign.Tally("cp")
    tally.look_again(free, NUMBER, ALONE)
    assert tally.losses[0][0] > campaign.SAME
    assert tally.relations["twice the cost"][0][0] > 0.9
    tally.report()
    assert "dearer by more than 0.1 % in 1" in capsys.readouterr().out


@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_a_similar_task_takes_energy_in_proportion_to_the_square_of_its_lengths(factor):
    node = np.linspace(0.0, 1.0, 41)
    slow = 0.02 * np.sin(np.pi * node) ** 2
    moved = [motion.from_velocities(TASK.duration / 40, f * 0.3, f * slow, "dp", "ls") for f in (1.0, factor)]
    one, other = lb.evaluate(TASK, moved[0]), lb.evaluate(campaign.scaled(TASK, factor), moved[1])
    for pump in PUMPS:
        assert other.energy(pump) == pytest.approx(factor**2 * one.energy(pump), rel=1e-9)
    assert other.worst_use == pytest.approx(one.worst_use, rel=1e-9)
