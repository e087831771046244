"""Methods and controllers from outside the package: added by a program, or brought by an installed package."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

import leanboom as lb
from command_line import leanboom, words
from leanboom.errors import InputError
from leanboom.methods import pseudo_inverse
from leanboom.methods.registry import METHODS, Method, Settings
from leanboom.model import motion
from leanboom.model.outcome import SOLVED, Kind, Outcome
from leanboom.simulation import plant
from leanboom.simulation.controllers import Rig
from leanboom.simulation.registry import CONTROLLERS

TASK = replace(lb.load_task("forwarder-vertical"), start="middle")
TASK = replace(TASK, path=TASK.path.slower(0.2))


def held(task, cost, start, tell, settings):
    """The extension stands still: no good plan, but a motion."""
    assert isinstance(settings, Settings)
    tell("holding", 0.5)
    return motion.from_velocities(task.duration / 20, start, np.zeros(21), "held", cost)


def given_up(task, cost, start, tell, settings):
    return replace(held(task, cost, start, tell, settings), status=Outcome(Kind.UNCONVERGED, "not converged: tired"))


HELD = Method("the extension is held", held)
PACKAGE = '''
from test_registry import held
from leanboom.methods.registry import Method

HELD = Method("the extension is held", held, costs=("cp",), compared=("cp",))


class Proportional:
    """A controller of a few lines."""

    def __init__(self, rig):
        self.dead_zone = rig.plant.crane.machine.circuit.dead_zone

    def command(self, now):
        share = 0.3 * now.target_velocity + (now.target_position - now.position)
        return share + self.dead_zone * (2 * (share > 0) - 1)
'''
ENTRY_POINTS = """
[leanboom.methods]
outside = extra_cranes:HELD
broken = extra_cranes:MISSING
wrong = extra_cranes:Proportional
[leanboom.controllers]
proportional = extra_cranes:Proportional
"""


@pytest.fixture
def added():
    """A method and a controller that a program adds."""
    METHODS.add("held", HELD)
    CONTROLLERS.add("slack", lambda rig: _Slack())
    yield
    METHODS.added.clear()
    CONTROLLERS.added.clear()


class _Slack:
    def command(self, now):
        return np.zeros(now.position.size)


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """A package with entry points, as it would be after its installation."""
    (tmp_path / "extra_cranes.py").write_text(PACKAGE, encoding="utf-8")
    folder = tmp_path / "extra_cranes-1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: extra-cranes\nVersion: 1.0\n", encoding="utf-8")
    (folder / "entry_points.txt").write_text(ENTRY_POINTS, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)


def test_an_added_method_plans_and_is_judged(added):
    told = []
    plan = lb.run(TASK, method="held", check=False, progress=lambda text, share: told.append(text))
    assert (plan.motion.method, plan.motion.cost) == ("held", "ls") and "holding" in told
    assert plan.evaluation.energy_ls == lb.evaluate(TASK, plan.motion).energy_ls > 0.0
    assert plan.baseline is not None


def test_a_method_that_chooses_no_start_needs_one(added):
    with pytest.raises(InputError, match=r"^start = best; method held needs smallest, middle or a length$"):
        lb.run(replace(TASK, start="best"), method="held")


def test_a_method_may_give_up(added):
    """What its method calls no result is none, whatever limits it keeps."""
    METHODS.add("held", replace(HELD, function=given_up))
    plan = lb.run(TASK, method="held", check=False)
    assert plan.status == plan.motion.status == "not converged: tired" and not plan.evaluation.feasible
    assert plan.status.kind is Kind.UNCONVERGED and plan.evaluation.status.kind is Kind.UNCONVERGED


def test_methods_from_outside_are_compared_in_processes_of_their_own(added, installed):
    rows = {row.label: row for row in lb.compare(TASK, "cp", methods=["held", "outside"]).rows}
    assert set(rows) == {"held (cp)", "outside (cp)"}
    energy = lb.run(TASK, method="held", pump="cp", check=False).evaluation.energy_cp
    assert rows["held (cp)"].energy == rows["outside (cp)"].energy == energy


def test_a_method_that_cannot_be_sent_to_another_process_is_refused(added):
    METHODS.add("local", Method("local", lambda *_: None))
    with pytest.raises(InputError, match=r"^method = local; its function must be one of a module"):
        lb.compare(TASK, methods=["local"])


def test_added_names_are_listed_where_a_name_is_wrong(added):
    with pytest.raises(InputError, match=r"method = nope; must be one of dp, polish, .*sns-actuator-weighted, held"):
        lb.run(TASK, method="nope")
    with pytest.raises(
        InputError, match=r"^controller = nope; must be one of dead-zone-inverse, adaptive-robust, slack"
    ):
        lb.simulate(TASK, pseudo_inverse.resolve(TASK, 0.6), controller="nope")


@pytest.mark.parametrize("name", ["dp", "two words", "a:b", ""])
def test_names_of_leanboom_and_names_that_cannot_be_written_are_refused(name):
    with pytest.raises(InputError, match=f"^method = {name}; "):
        METHODS.add(name, HELD)
    assert METHODS.added == {}


def test_an_installed_package_brings_a_method(installed):
    plan = lb.run(TASK, method="outside", pump="cp", check=False)
    assert plan.motion.method == "outside"
    with pytest.raises(InputError, match="method outside minimises cp, not ls"):
        lb.run(TASK, method="outside")


def test_controllers_from_outside_drive_by_their_names(installed, added):
    still = held(TASK, "ls", 0.6, lambda *_: None, Settings())
    run = lb.simulate(TASK, still, controller="proportional")
    assert run.complete and run.controller == "Proportional"
    assert lb.simulate(TASK, still, controller="slack").energy != run.energy


@pytest.mark.parametrize(("name", "controller"), [("forwarder", "adaptive-robust"), ("loader", "dead-zone-inverse")])
def test_a_controller_of_the_other_kind_of_valve_is_refused(name, controller):
    """By name it can be chosen for any machine; an assertion failed."""
    task = TASK if name == "forwarder" else lb.load_task("loader-triangle-small")
    rig = Rig(plant.build(task), np.zeros(len(task.machine.cylinders)), 0.002)
    with pytest.raises(InputError, match=f"^controller = {controller}; drives "):
        CONTROLLERS.find(controller)(rig)


def test_help_lists_what_is_installed_and_messages_name_the_package(installed):
    assert "outside" in words(leanboom("plan", "--help").stdout)
    assert "outside" in words(leanboom("compare", "--help").stdout)
    assert "proportional" in words(leanboom("simulate", "--help").stdout)
    answer = leanboom("plan", "forwarder-vertical", "--method", "broken")
    assert answer.exit_code == 2
    assert answer.stderr.startswith(
        "leanboom: method = broken; package extra-cranes brings it and cannot be imported: "
    )
    answer = leanboom("compare", "forwarder-vertical", "--methods", "wrong")
    assert answer.exit_code == 2
    assert answer.stderr == "leanboom: method = wrong; is type, must be a leanboom.methods.registry.Method\n"
    answer = leanboom("simulate", "forwarder-vertical", "--controller", "nope")
    assert answer.exit_code == 2
    assert answer.stderr.endswith("must be one of dead-zone-inverse, adaptive-robust, proportional\n")


def test_an_outcome_is_its_sentence_and_keeps_its_kind():
    """Statuses were told apart by how their sentences begin."""
    status = Outcome(Kind.STOPPED, "the crane stops")
    again = pickle.loads(pickle.dumps(status))
    assert again == status == "the crane stops" and again.kind is Kind.STOPPED
    still = motion.from_velocities(0.1, 0.5, np.zeros(3), "test", "ls", status="solved")
    assert still.status is SOLVED and replace(still, status="too fast").status.kind is Kind.INFEASIBLE
