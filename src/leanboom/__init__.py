"""leanboom plans the motion of redundant hydraulic cranes so that the pump uses the least energy.

import leanboom as lb

task = lb.load_task("forwarder-vertical")
motion = lb.plan(task, pump="ls")
print(lb.evaluate(task, motion))
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from leanboom.certificate import Certificate, certify
    from leanboom.comparison import Comparison, compare
    from leanboom.continuation import Continuation
    from leanboom.errors import InfeasibleError, InputError, LeanboomError
    from leanboom.files import bundled_machines, bundled_tasks, load_machine, load_task
    from leanboom.horizon import plan_receding
    from leanboom.judge import Evaluation, evaluate
    from leanboom.machine import Machine
    from leanboom.motion import Motion
    from leanboom.planner import Plan, plan, run
    from leanboom.replanning import replan
    from leanboom.simulation import Simulation, simulate
    from leanboom.task import Task

__version__ = "0.1.0"

_HOME = {
    "Certificate": "certificate", "certify": "certificate",
    "Comparison": "comparison", "compare": "comparison",
    "Continuation": "continuation",
    "Evaluation": "judge", "InfeasibleError": "errors", "InputError": "errors", "LeanboomError": "errors",
    "Machine": "machine", "Motion": "motion", "Plan": "planner", "Simulation": "simulation", "Task": "task",
    "bundled_machines": "files", "bundled_tasks": "files", "evaluate": "judge", "load_machine": "files",
    "load_task": "files", "plan": "planner", "plan_receding": "horizon", "replan": "replanning", "run": "planner",
    "simulate": "simulation",
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
