"""Facts on a machine or task known before planning: origin of its values, reach, pressures.

The pressures are static: the cylinder force that carries the crane's own weight in the pose of longest reach, on the
machine's valve. They show slips in masses, lengths and bores that no single value gives away.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from leanboom.components import pump_power
from leanboom.components.pumps import EfficiencyMap
from leanboom.errors import InfeasibleError, LeanboomError, Problem
from leanboom.evaluation import limit_checks
from leanboom.formulas import kinematics
from leanboom.io import loading
from leanboom.io.yaml_source import read, shortened, unusable
from leanboom.methods.registry import STEP
from leanboom.model import crane as cranes
from leanboom.model.machine import Machine
from leanboom.model.task import sample
from leanboom.problem import feasible_strokes, least_flow

if TYPE_CHECKING:
    from leanboom.evaluation.evaluate import Evaluation
    from leanboom.model.task import Task

STATUSES = ("printed", "derived", "identified", "assumed", "unstated")
_ANGLES = 241  # poses looked at for the reach, each way
_AT_THE_MARGIN = 1e-6  # of the elbow's cosine: such extensions end where the arm would be too nearly straight
_TOUCHED = 1.01  # an arm within this many times the margin is as near to straight as plans go
TOO_FAST = 1.02  # shares of a velocity limit that a path may ask for, the coarse look at extensions allowed for
_EXTENSIONS, _SECTIONS = 33, 24  # extensions looked at, and sections of the range of their velocities
_TRIAL = 1000.0  # [kg], forces are affine in the payload


def count(machine: Machine) -> dict[str, int]:
    """Number of a machine's values of each status in `STATUSES`.

    Args:
        machine: The machine, with its provenance.
    """
    found = Counter(entry.status for entry in machine.provenance)
    return {status: found[status] for status in STATUSES}


def assumed(machine: Machine) -> str:
    """Sentence on the number of assumed values of a machine.

    Args:
        machine: The machine, with its provenance.
    """
    counts, total = count(machine), len(machine.provenance)
    if not total:
        return "the machine's values do not say where they come from"
    text = f"{counts['assumed']} of {total} machine values are assumed"
    return text + (f", {counts['unstated']} do not say where they come from" if counts["unstated"] else "")


@dataclass(frozen=True, slots=True)
class Reach:
    """The pose of longest reach, and the static pressures in it; cylinders in joint order."""

    radius: float  # largest tool distance from the slewing axis [m]
    tool_height: float  # in that pose [m]
    highest: float  # largest tool height in any pose [m]
    pressure: tuple[float, ...]  # of the working chamber, no payload [Pa]
    capacity: float  # largest payload at the pump's highest pressure less the margin [kg]


def reach(machine: Machine) -> Reach:
    """The longest reach of a machine and the static pressures there.

    Args:
        machine: The machine.
    """
    g = machine.geometry
    lift, tilt, extension = machine.joints[-3:]
    q2, q3 = np.meshgrid(np.linspace(lift.lower, lift.upper, _ANGLES), np.linspace(tilt.lower, tilt.upper, _ANGLES))
    r, z = kinematics.tool_point(q2, q3, extension.upper, g.base_x, g.base_z, g.boom, g.offset, g.outer)
    at = np.unravel_index(int(r.argmax()), r.shape)
    joints = (float(q2[at]), float(q3[at]), extension.upper)
    empty = _pressures(machine, joints, 0.0)
    loaded = _pressures(machine, joints, _TRIAL)
    room = machine.pump.max_pressure - machine.pump.ls_margin
    masses = [_TRIAL * (room - p) / (q - p) for p, q in zip(empty[-3:-1], loaded[-3:-1], strict=True) if q > p + 1.0]
    return Reach(float(r[at]), float(z[at]), float(z.max()), empty, max(0.0, min(masses, default=0.0)))


def _pressures(machine: Machine, joints: tuple[float, float, float], payload: float) -> tuple[float, ...]:
    """Static pressures [Pa] that carry the crane and a payload [kg] in a pose; 0 for a base."""
    drives = machine.drives
    crane = cranes.Crane(machine, (*machine.bodies, *cranes.load(machine, payload)), drives)
    _, torques = cranes.inertia_and_gravity(crane, *joints)
    found = []
    for cylinder, drive, q, torque in zip(machine.cylinders[-3:], drives[-3:], joints, torques, strict=True):
        force = float(torque) / float(cylinder.linkage.length_arm_slope(q)[1])
        out, back = drive.gain_out * force + drive.back_out, drive.back_in - drive.gain_in * force
        found.append(max(0.0, out if force >= 0.0 else back))
    return (0.0,) * (len(machine.cylinders) - 3) + tuple(found)


def efficiency(machine: Machine) -> str:
    """The pump's efficiency in words: a constant or a map, how well a map is met, where its values come from.

    Args:
        machine: The machine, with its provenance.
    """
    given = machine.pump.efficiency
    entries = [e for e in machine.provenance if e.key.startswith("pump.efficiency")]
    found = Counter(entry.status for entry in entries)
    origin = [f"{found[status]} {status}" if len(entries) > 1 else status for status in STATUSES if found[status]]
    said = f" ({', '.join(origin)})" if origin else ""
    if not isinstance(given, EfficiencyMap):
        return f"{100.0 * given:g} %, constant{said}"
    met = pump_power.fit(given)
    return (
        f"map taken at {60.0 * given.speed:g} rev/min{said}; its powers are met within {100.0 * met.typical:.1f} %, "
        f"at worst {100.0 * met.largest:.1f} %; idle loss {1e-3 * met.shaft.idle:.2f} kW"
    )


def doubts(machine: Machine) -> tuple[str, ...]:
    """Sentences on doubtful values of a machine; none of them is an error.

    Args:
        machine: The machine.
    """
    pump, found = machine.pump, []
    for name, pressure in zip(machine.names, reach(machine).pressure, strict=True):
        if pressure + pump.ls_margin > pump.max_pressure:
            found.append(
                f"holding the empty crane at full reach takes {pressure / 1e6:.1f} MPa in the {name} cylinder, and "
                f"{pump.ls_margin / 1e6:.1f} MPa margin, but the pump gives {pump.max_pressure / 1e6:.1f} MPa"
            )
    given = pump.efficiency
    if isinstance(given, EfficiencyMap) and pump.max_pressure > given.pressures[-1]:
        found.append(
            f"the efficiency map ends at {given.pressures[-1] / 1e6:.1f} MPa, the pump at "
            f"{pump.max_pressure / 1e6:.1f} MPa; powers between them are extrapolated"
        )
    return tuple(found)


@dataclass(frozen=True, slots=True)
class PathFacts:
    """A task's path in numbers."""

    length: float  # [m]
    fastest: float  # largest tool speed [m/s]
    start: tuple[float, float]  # smallest and largest feasible start of the extension cylinder [m]
    folded_up: bool  # whether the outer boom has to be folded up from the boom, all along
    straight: tuple[float, float] | None  # first and last time at which a straight arm limits the extension [s]

    @property
    def notes(self) -> tuple[str, ...]:
        """On which side of the straight pose the crane works, and when that pose is in the way, one sentence each."""
        found = []
        if self.folded_up:
            found.append("the outer boom is folded up: some point of the path cannot be reached with it folded down")
        if self.straight is not None:
            first, last = self.straight
            found.append(
                f"at times from {first:.2f} s to {last:.2f} s a straight arm limits the extension: plans stay "
                f"{np.degrees(kinematics.ELBOW_MARGIN):g} deg away from it"
            )
        return tuple(found)


def path(task: Task) -> PathFacts:
    """The path of a task in numbers, checked for reach and speed all along.

    Args:
        task: The task.

    Raises:
        InfeasibleError: If the tool cannot be everywhere on its path, or not that fast, whatever the extension does;
            or if that asks for more than a limited flow of the pump.
    """
    time = limit_checks.times(task.path, np.linspace(0.0, task.duration, 1001))
    points = sample(task, time)
    length = float(np.linalg.norm(np.diff(points.point, axis=0), axis=1).sum())
    fastest = float(np.linalg.norm(points.velocity, axis=1).max())
    crane = cranes.build(task)
    plane = cranes.plane(task.machine, points)
    intervals = feasible_strokes.feasible_strokes(task, crane, plane, time)
    low, high = (np.array([ends.ravel()[i] for ends in intervals]) for i in (0, -1))
    haste = least_haste(crane, plane, low, high)
    worst = int(haste.argmax())
    if haste[worst] > TOO_FAST and task.timing == "fixed":
        raise InfeasibleError(
            f"the path is too fast for the cylinders at {time[worst]:.3f} s, where the tool moves at "
            f"{np.linalg.norm(points.velocity[worst]):.3g} m/s: whatever the extension does, one of them would have to "
            f"move at {haste[worst]:.3g} times its velocity limit; give the path more time there"
        )
    if what := least_flow.excess(task, STEP):
        raise InfeasibleError(what)
    nearest = np.abs(cranes.elbow_cosine(crane, plane, np.stack([low, high]) / crane.ratio)).max(axis=0)
    at = time[nearest > kinematics.BENT - _AT_THE_MARGIN]
    return PathFacts(
        length,
        fastest,
        (float(low[0]), float(high[0])),
        crane.side == kinematics.ELBOW_DOWN,
        (float(at[0]), float(at[-1])) if at.size else None,
    )


def least_haste(crane: cranes.Crane, plane: cranes.Plane, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The velocities that a path asks for, in velocity limits: of the fastest cylinder, the extension at its best.

    At a pose all velocities are affine in that of the extension, so the largest share of a limit is a convex function
    of it and its least value is found by sections.

    Args:
        crane: The crane.
        plane: The tool's motion at some times.
        low, high: Ends of the feasible extensions then [m], (times,).

    Returns:
        Shares of the limits, (times,).
    """
    strokes = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, _EXTENSIONS)
    here = plane[:, None]
    pose = cranes.pose(crane, here, strokes)
    still, forth = cranes.move(pose, 0.0, 0.0).velocity, cranes.move(pose, 1.0, 0.0).velocity
    rows = [
        np.broadcast_arrays(v0 / cylinder.velocity_limit, (v1 - v0) / cylinder.velocity_limit, strokes)[:2]
        for v0, v1, cylinder in zip(still, forth, crane.machine.cylinders, strict=True)
    ]

    def largest(w: np.ndarray) -> np.ndarray:
        return np.max([np.abs(offset + slope * w) for offset, slope in rows], axis=0)

    right = largest(np.zeros_like(strokes)) * crane.machine.redundant.velocity_limit  # beyond, it is the fastest itself
    left = -right
    for _ in range(_SECTIONS):
        first, second = left + (right - left) / 3.0, right - (right - left) / 3.0
        lower = largest(first) < largest(second)
        left, right = np.where(lower, left, first), np.where(lower, second, right)
    shares = np.where(cranes.position_margin(crane, here, strokes) >= -1e-9, largest(0.5 * (left + right)), np.inf)
    return shares.min(axis=1)


def straight(judged: Evaluation) -> tuple[str, ...]:
    """Where a motion's arm is as nearly straight, or folded up, as it may be, as a sentence; or nothing.

    Args:
        judged: The motion.
    """
    room = np.minimum(judged.bend, np.pi - judged.bend)
    i = int(room.argmin())
    if room[i] > _TOUCHED * kinematics.ELBOW_MARGIN:
        return ()
    pose = "straight" if judged.bend[i] < 0.5 * np.pi else "folded up"
    return (f"{pose} to within {np.degrees(room[i]):.1f} deg at {judged.time[i]:.3f} s, as near as plans go",)


@dataclass(frozen=True, slots=True)
class Checked:
    """The result of checking one file."""

    file: str  # as asked for: a path or a bundled name
    kind: Literal["machine", "task"] | None  # None if the file cannot be read
    found: Machine | Task | None  # None if something is wrong with the file
    path: PathFacts | None  # of a task whose path can be reached
    error: LeanboomError | None  # what is wrong, with the file or with the task's path

    @property
    def machine(self) -> Machine | None:
        """The machine itself, or that of the task."""
        return self.found if isinstance(self.found, Machine | None) else self.found.machine

    @property
    def complaint(self) -> str:
        """The problem, with the name of the file."""
        return str(self.error) if getattr(self.error, "problems", ()) else f"{self.file}: {self.error}"

    def json(self) -> dict[str, Any]:
        """The same as `check --json` prints it."""
        problems = [asdict(problem) for problem in getattr(self.error, "problems", ())]
        if self.error is not None and not problems:
            told = Problem(self.file, None, "", None, "", str(self.error))
            problems = [asdict(told)]
        notes = () if self.machine is None else doubts(self.machine)
        notes += () if self.path is None else self.path.notes
        return {
            "file": self.file,
            "kind": self.kind,
            "name": None if self.found is None else self.found.name,
            "machine": None if self.machine is None else self.machine.name,
            "values": None if self.machine is None else count(self.machine),
            "problems": problems,
            "notes": list(notes),
        }


def check(name: str) -> Checked:
    """Check a machine or a task.

    Args:
        name: Bundled name or path of a file.
    """
    kind = found = None
    try:
        kind = _kind(name)
        found = loading.load_task(name) if kind == "task" else loading.load_machine(name)
        facts = None if isinstance(found, Machine) else path(found)
    except LeanboomError as error:
        return Checked(name, kind, found, None, error)
    return Checked(name, kind, found, facts, None)


def _kind(name: str) -> Literal["machine", "task"]:
    """Whether a bundled name or a file is a machine or a task.

    Raises:
        InputError: There is no such thing, or the file cannot be read.
    """
    if name in loading.bundled_machines():
        return "machine"
    if name in loading.bundled_tasks():
        return "task"
    try:
        is_file = Path(name).is_file()
    except (OSError, ValueError):  # a name no file can have
        is_file = False
    if not is_file:
        raise unusable(
            shortened(name, 200) or "nothing",
            f"is no file and no bundled name; machines: {', '.join(loading.bundled_machines())}; "
            f"tasks: {', '.join(loading.bundled_tasks())}",
        )
    keys = read(Path(name), name).data
    return "task" if isinstance(keys, dict) and ("path" in keys or "machine" in keys) else "machine"
