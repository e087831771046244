"""leanboom plans the motion of redundant hydraulic cranes so that the pump uses the least energy.

import leanboom as lb

task = lb.load_task("forwarder-vertical")
motion = lb.plan(task, pump="ls")
print(lb.evaluate(task, motion))
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from leanboom.certificate.certificate import Certificate, certify
    from leanboom.errors import InfeasibleError, InputError, LeanboomError
    from leanboom.evaluation.evaluate import Evaluation, evaluate
    from leanboom.evaluation.safe_stop import Continuation
    from leanboom.io.loading import bundled_machines, bundled_tasks, load_machine, load_task
    from leanboom.model.machine import Machine
    from leanboom.model.motion import Motion
    from leanboom.model.task import Task
    from leanboom.planning.planner import Plan, plan, run
    from leanboom.planning.receding_horizon import plan_receding
    from leanboom.planning.replanning import replan
    from leanboom.simulation.closed_loop import Simulation, simulate
    from leanboom.study.comparison import Comparison, compare

__version__ = "0.1.0"

_HOME = {
    "Certificate": "certificate.certificate", "certify": "certificate.certificate",
    "Comparison": "study.comparison", "compare": "study.comparison",
    "Continuation": "evaluation.safe_stop",
    "Evaluation": "evaluation.evaluate", "evaluate": "evaluation.evaluate",
    "InfeasibleError": "errors", "InputError": "errors", "LeanboomError": "errors",
    "Machine": "model.machine",
    "Motion": "model.motion",
    "Plan": "planning.planner", "plan": "planning.planner", "run": "planning.planner",
    "Simulation": "simulation.closed_loop", "simulate": "simulation.closed_loop",
    "Task": "model.task",
    "bundled_machines": "io.loading", "bundled_tasks": "io.loading",
    "load_machine": "io.loading", "load_task": "io.loading",
    "plan_receding": "planning.receding_horizon",
    "replan": "planning.replanning",
}  # fmt: skip

__all__ = [
    "Certificate",
    "Comparison",
    "Continuation",
    "Evaluation",
    "InfeasibleError",
    "InputError",
    "LeanboomError",
    "Machine",
    "Motion",
    "Plan",
    "Simulation",
    "Task",
    "bundled_machines",
    "bundled_tasks",
    "certify",
    "compare",
    "evaluate",
    "load_machine",
    "load_task",
    "plan",
    "plan_receding",
    "replan",
    "run",
    "simulate",
]


def __getattr__(name: str):
    """Import public names when they are first used: starting up stays quick."""
    if name not in _HOME:
        raise AttributeError(f"module 'leanboom' has no attribute {name!r}")
    from importlib import import_module

    value = getattr(import_module(f"leanboom.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
