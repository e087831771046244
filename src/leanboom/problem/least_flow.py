"""Least flow that a path asks of the pump, over all extensions and all velocities of the redundant cylinder.

At a position all cylinders' velocities are affine in that of the redundant one, so their flow is convex and piecewise
linear in it: least where one of them stands still.
"""

from __future__ import annotations

import numpy as np

from leanboom.errors import InputError
from leanboom.formulas import hydraulics
from leanboom.model.pump_flow import base_fault, base_flow, fault
from leanboom.model.task import Task
from leanboom.problem import layout, stages
from leanboom.problem.stage_arrays import coefficients
from leanboom.problem.stages import Problem

POSITIONS = 65  # looked at in the feasible extensions of a stage
COARSE = 1.01  # times the pump's flow that these may ask for: between them it may be less


def least_flow(problem: Problem) -> np.ndarray:
    """Least flow at every stage among some extensions [m^3/s], (stages + 1,)."""
    positions = problem.lower[:, None] + (problem.upper - problem.lower)[:, None] * np.linspace(0.0, 1.0, POSITIONS)
    found = coefficients(problem, positions)
    a0, a1 = found[..., layout.A0], found[..., layout.A1]
    limit = problem.crane.machine.redundant.velocity_limit
    with np.errstate(all="ignore"):  # a cylinder that the redundant one does not move stands still nowhere
        still = np.clip(np.nan_to_num(-a0 / a1), -limit, limit)
    flow = np.zeros_like(still)
    for m, drive in enumerate(problem.crane.drives[problem.moving]):
        velocity = a0[..., m, None] + a1[..., m, None] * still
        flow += hydraulics.cylinder_flow(velocity, drive.area_out, drive.area_in)
    return flow.min(axis=(1, 2)) + base_flow(problem.crane.machine, problem.plane)


def excess(task: Task, step: float) -> str:
    """What a path asks of the pump beyond a limit of its flow, whatever the extension does; empty where it may do.

    Of a timing that is still to be planned nothing is known.

    Args:
        task: The task, or a whole cycle.
        step: Length of a stage [s].
    """
    if not task.limits.pump_flow:
        return ""
    if not task.legs:
        what = _excess(task, step) if task.timing == "fixed" else ""
        return f"limits.pump_flow = yes; {what}" if what else ""
    for each in task.stretches:
        if not each.waits and task.legs[each.leg].settled and (what := _excess(task.stretch(each), step)):
            return f"limits.pump_flow = yes; {what} (leg {each.leg + 1})"
    return ""


def _excess(task: Task, step: float) -> str:
    """The same of a task whose one path has its timing."""
    what = base_fault(task.machine, task.path)
    if not what:
        problem = stages.discretise(task, step)
        flow = least_flow(problem)
        if flow.max() > COARSE * task.flow_limit:
            what = fault(task, "the path, at the best extension,", problem.time, flow)
    return what


def check(task: Task, step: float) -> None:
    """Raise InputError where a task limits the pump's flow to less than its path asks for; arguments as in `excess`."""
    if what := excess(task, step):
        raise InputError(what)
