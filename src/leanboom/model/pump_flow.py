"""Flow that cylinders take from the pump together, eq. (37), and what a path asks for whatever the extension does.

A path that takes twice as long needs half the flow at every point of it: velocities are in proportion to 1 / duration.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from leanboom.components.paths import Path
from leanboom.components.valves import Drive
from leanboom.formulas import hydraulics
from leanboom.model import crane as cranes
from leanboom.model.machine import Machine
from leanboom.model.task import Task, sample

SAMPLES = 2001  # of a path
LITRES_PER_MINUTE = 6e4  # in 1 m^3/s


def pump_flow(drives: Sequence[Drive], velocity: Sequence[Any]) -> Any:
    """Flow that some cylinders take from the pump together [m^3/s].

    Args:
        drives: Of all cylinders of a crane.
        velocity: Of each cylinder, or of the last ones [m/s], arrays that broadcast.
    """
    last = list(drives)[len(drives) - len(velocity) :]
    return sum(hydraulics.cylinder_flow(v, d.area_out, d.area_in) for v, d in zip(velocity, last, strict=True))


def base_flow(machine: Machine, plane: cranes.Plane) -> np.ndarray:
    """Flow of the base cylinder, which the path alone moves [m^3/s]; zeros for a machine that does not slew."""
    if not machine.geometry.slewing:
        return np.zeros_like(plane.q1)
    _, arm, _ = machine.cylinders[0].linkage.length_arm_slope(plane.q1)
    return hydraulics.cylinder_flow(arm * plane.v1, machine.drives[0].area_out, machine.drives[0].area_in)


def base_fault(machine: Machine, path: Path) -> str:
    """Why a path cannot be followed within the pump's flow, by slewing alone; empty where it can.

    Args:
        machine: The machine.
        path: A path that suits it.
    """
    task = Task("path", machine, path, start="middle")
    time = np.unique(np.concatenate([np.linspace(0.0, path.duration, SAMPLES), path.breaks]))
    with np.errstate(all="ignore"):  # a path through the slewing axis has no base angle there: reported elsewhere
        flow = np.nan_to_num(base_flow(machine, cranes.plane(machine, sample(task, time))))
    return fault(task, "slewing alone", time, flow)


def fault(task: Task, what: str, time: np.ndarray, flow: np.ndarray) -> str:
    """What a path asks of the pump beyond its largest flow, and what would do; empty where it asks for no more.

    Args:
        task: The task.
        what: What asks for the flow.
        time: [s], (times,).
        flow: Least flow at these times [m^3/s], (times,).
    """
    i, most = int(flow.argmax()), task.machine.pump.max_flow
    if flow[i] <= most:
        return ""
    needed, given = (LITRES_PER_MINUTE * value for value in (flow[i], most))
    return (
        f"{what} asks for {needed:.1f} l/min at {time[i]:.3f} s, above the pump's max_flow of {given:.1f} l/min: give "
        f"the path {np.ceil(100.0 * task.duration * flow[i] / most) / 100.0:.2f} s instead of {task.duration:g} s, or "
        f"the pump {np.ceil(10.0 * needed) / 10.0:.1f} l/min"
    )
