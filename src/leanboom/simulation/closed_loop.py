"""The closed loop: a planned motion driven by pump, valves and controller, and its energies.

Every 2 ms the controller sees cylinders and targets and sets the valves; the plant moves on by itself in between. The
plan is what the judge makes of the motion. After the path's end the targets stay for a second: valves are late.
Whatever ends a run early, the part before it is kept and marked incomplete.

A task with legs is one run. Where its payload changes, the crane is at rest by plan: positions, velocities and
pressures go on, the bodies become others, and a controller is made for them. What the change brings along or takes
away, height and what is left of velocity, counts neither as work nor as loss.
"""

from __future__ import annotations

import time as clock
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from typing import Any

import numpy as np

from leanboom.components.costs import PUMPS, Supply
from leanboom.components.pump_power import shaft_of
from leanboom.errors import InputError
from leanboom.evaluation.evaluate import SAMPLE, Evaluation, evaluate
from leanboom.formulas import hydraulics, kinematics
from leanboom.model.cost_rates import supply_of
from leanboom.model.motion import Motion
from leanboom.model.outcome import COMPLETE, Kind, Outcome
from leanboom.model.task import Task, sample
from leanboom.progress import Progress, quiet
from leanboom.quantities.ranges import one_of
from leanboom.simulation import controllers, events, path_accuracy, plant
from leanboom.simulation.controllers import Factory, Rig, Sample
from leanboom.simulation.events import Event
from leanboom.simulation.integrator import TOLERANCE, Integrator, SolverError
from leanboom.simulation.plant import Plant
from leanboom.simulation.registry import CONTROLLERS
from leanboom.simulation.valve_sections import Spools

SETTLE = 1.0  # [s], the crane is watched after its path has ended
NEXT_TO_NOTHING = 0.01  # share of a run's energy: a plan of less is not compared with it
REPORTED = 500  # samples between two reports of progress


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """A motion driven in closed loop. Arrays are (samples,) or (samples, cylinders), joint order."""

    task: Task
    motion: Motion
    pump: str  # "ls" or "cp"
    controller: str  # its class
    planned: Evaluation  # what the judge makes of the motion
    status: Outcome  # `complete`, or why the run ended early
    events: tuple[Event, ...]  # in the order of their times
    time: np.ndarray  # [s], (samples,)
    tool: np.ndarray  # [m], (samples, 3)
    tool_target: np.ndarray  # [m], (samples, 3)
    joint_position: np.ndarray  # [rad] or [m], (samples, cylinders)
    joint_target: np.ndarray  # (samples, cylinders)
    joint_velocity: np.ndarray
    position: np.ndarray  # of the pistons, beyond retracted [m]
    velocity: np.ndarray  # [m/s]
    command: np.ndarray  # of the valves, -1 to 1; (samples, cylinders), twice as many columns with two ports each
    pressure_a: np.ndarray  # [Pa]
    pressure_b: np.ndarray  # [Pa]
    force: np.ndarray  # of the pressures on the pistons [N]
    supply: np.ndarray  # [Pa], (samples,)
    pump_flow: np.ndarray  # [m^3/s], (samples,)
    power: np.ndarray  # the pump takes [W], (samples,)
    cumulative: np.ndarray  # energy so far [J], (samples,)
    balance: dict[str, float]  # where the energy given to the oil has gone [J]
    wall_s: float  # time the run took, without building the plant and judging the plan

    @property
    def complete(self) -> bool:
        """Whether the run reached its end."""
        return self.status.kind is Kind.COMPLETE

    @property
    def verdict(self) -> Outcome:
        """`solved`, or a sentence on why the run ended early or on the violations of its plan."""
        return self.planned.status_with(self.pump) if self.complete else self.status

    @property
    def solved(self) -> bool:
        """Whether the run reached its end, and drove a plan that keeps every limit and that the pump can deliver."""
        return self.verdict.solved

    @property
    def energy(self) -> float:
        """Energy of the pump [J]."""
        return float(self.cumulative[-1])

    @property
    def planned_energy(self) -> float:
        """Judged energy of the pump [J]."""
        return self.planned.energy(self.pump)

    @property
    def change(self) -> float | None:
        """Share by which the pump took more than planned; None where there is nothing to compare.

        That is after a run that ended early, beside a plan that breaks a limit, and beside one of next to no energy.
        """
        if not (self.complete and self.planned.feasible and self.planned_energy > NEXT_TO_NOTHING * self.energy):
            return None
        return self.energy / self.planned_energy - 1.0

    @property
    def balance_error(self) -> float:
        """Share of the pump's work that is not found again in the crane, its valves and its oil."""
        given = self.balance["pump"]
        left = sum(value for name, value in self.balance.items() if name != "pump")
        return abs(given - left) / given if given > 0.0 else abs(left)

    def spent(self, since: float, until: float) -> float:
        """Energy of the pump between two times [s] [J]; times beyond the run's end are its end."""
        before, after = np.interp([since, until], self.time, self.cumulative)
        return float(after - before)

    @property
    def joint_error(self) -> np.ndarray:
        """Largest distance of every joint from its target, (cylinders,) [rad], [m] for the extension."""
        return np.abs(self.joint_position - self.joint_target).max(axis=0)

    @property
    def path_accuracy(self) -> float:
        """Largest distance of the tool's path from the commanded one, by ISO 9283 [m]."""
        return self.accuracy_between(0.0, np.inf)

    def accuracy_between(self, since: float, until: float) -> float:
        """The same of what is commanded between two times [s] [m]."""
        return path_accuracy.path_accuracy(self.time, self.tool_target, self.tool, since, until)

    @property
    def realtime_factor(self) -> float:
        """Simulated seconds in a second of computing."""
        return float(self.time[-1]) / max(self.wall_s, 1e-9)

    def __repr__(self) -> str:
        return self.verdict.head(
            f"Simulation({self.task.name}, {self.motion.method}, {self.pump}: {self.energy / 1e3:.2f} kJ, planned "
            f"{self.planned_energy / 1e3:.2f} kJ, path accuracy {self.path_accuracy:.3f} m, {len(self.events)} "
            f"events, {self.status})",
        )


def simulate(
    task: Task,
    motion: Motion,
    pump: str = "ls",
    *,
    controller: Factory | str | None = None,
    tolerance: float = TOLERANCE,
    progress: Progress | None = None,
) -> Simulation:
    """The `Simulation` of a motion in closed loop with the full hydraulics.

    Args:
        task: The task the motion belongs to.
        motion: Motion of the redundant cylinder, from any method.
        pump: "ls" load-sensing or "cp" constant pressure.
        controller: A controller's class, see `controllers`, or a name of `registry.CONTROLLERS`; None: that of the
            papers for the machine's valve.
        tolerance: Relative tolerance of the solver.
        progress: Called with what happens and the share done.

    Returns:
        The run. If the solver gives up it holds what came before, and says so in `status`.

    Raises:
        InputError: The motion does not last as long as the task, or leaves the crane's reach; pump or controller do not
            exist; or the controller's answer cannot be used.
    """
    one_of("pump", pump, PUMPS)
    wanted = task.machine.valve.controller if controller is None else controller
    factory = CONTROLLERS.find(wanted) if isinstance(wanted, str) else wanted
    planned = evaluate(task, motion)
    if not planned.followed:
        raise InputError(f"the motion leaves the crane's reach: {planned.status}; simulate one that keeps its path")
    tell = progress or quiet
    tell("building the plant", 0.0)
    targets = _targets(planned)
    parts = _parts(task, targets)
    chosen = [factory(Rig(part.plant, targets.joint[part.first].copy(), targets.step)) for part in parts]
    began = clock.perf_counter()
    run = _Run(parts, targets, planned, pump, tolerance)
    status = run.drive(chosen, tell)
    result = _result(run, motion, pump, factory, status)
    return replace(result, wall_s=clock.perf_counter() - began)


@dataclass(frozen=True, slots=True, eq=False)
class _Targets:
    """A plan on equal samples, from its start to its end; arrays are (samples, cylinders)."""

    time: np.ndarray  # [s], (samples,)
    joint: np.ndarray  # [rad] or [m]
    position: np.ndarray  # of the pistons, beyond retracted [m]
    velocity: np.ndarray  # [m/s]
    acceleration: np.ndarray  # [m/s^2]

    @property
    def step(self) -> float:
        """Time between samples [s]."""
        return float(self.time[1] - self.time[0])

    @property
    def count(self) -> int:
        """Samples of a whole run after its first one: until the crane has been watched for `SETTLE` besides."""
        return self.time.size - 1 + round(SETTLE / self.step)


def _targets(planned: Evaluation) -> _Targets:
    """Targets of a plan: that of a single path has equal samples already, those of legs are a little unequal."""
    machine, lasts = planned.task.machine, planned.task.duration
    time = np.linspace(0.0, lasts, max(2, round(lasts / SAMPLE) + 1))
    joints, length, velocity, acceleration = (
        np.stack([np.interp(time, planned.time, column) for column in values.T], axis=1)
        for values in (planned.joint_position, planned.length, planned.velocity, planned.acceleration)
    )
    shortest = [
        plant.retracted(c, joint.lower, joint.upper)[0]
        for c, joint in zip(machine.cylinders, machine.joints, strict=True)
    ]
    return _Targets(time, joints, length - np.array(shortest), velocity, acceleration)


@dataclass(frozen=True, slots=True)
class _Part:
    """A part of a run with one payload, between two samples."""

    plant: Plant
    first: int
    last: int


def _parts(task: Task, targets: _Targets) -> list[_Part]:
    """The parts of a run: a payload is on the tool from the end of the leg before it on."""
    if not task.legs:
        return [_Part(plant.build(task), 0, targets.count)]
    same = [list(each) for _, each in groupby(task.stretches, lambda each: task.legs[each.leg].payload)]
    ends = [round(each[-1].until / targets.step) for each in same[:-1]]
    return [
        _Part(plant.build(task.stretch(each[0])), first, last)
        for each, (first, last) in zip(same, pairwise([0, *ends, targets.count]), strict=True)
        if first < last
    ]


class _Run:
    """One run, sample by sample, and what it records."""

    def __init__(
        self, parts: Sequence[_Part], targets: _Targets, planned: Evaluation, pump: str, tolerance: float,
    ):  # fmt: skip
        self.parts, self.targets, self.planned = parts, targets, planned
        machine, first = planned.task.machine, parts[0].plant
        self.layout, self.step, self.samples = first.layout, targets.step, targets.count
        self.spools = Spools(machine, self.step)
        self.edges = np.zeros((self.samples + self.spools.delay + 2, 4 * len(machine.cylinders)))
        self.commands = np.zeros((self.samples + 1, self.spools.count))
        start = targets.joint[0]
        state = controllers.resting(first, controllers.static_loads(first, start))
        state[self.layout.q] = start
        if first.tip:
            state[self.layout.bent] = first.tip.rest(start)
        if pump == "cp":
            state[self.layout.supply] = supply_of(machine.pump, Supply.CONSTANT)[0]
        self.states = np.empty((self.samples + 1, self.layout.size))
        self.states[0] = state
        self.reached = 0
        self.load_sensing, self.tolerance = pump == "ls", tolerance

    def drive(self, chosen: Sequence[controllers.Controller], tell: Progress) -> Outcome:
        """Run to the end, with a controller for each part; `complete`, or why it ended early."""
        try:
            for part, controller in zip(self.parts, chosen, strict=True):
                self._drive(part, controller, tell)
        except SolverError as error:
            return Outcome(Kind.INCOMPLETE, f"incomplete: {error} at {self.reached * self.step:.3f} s")
        self.commands[-1] = self.commands[-2]
        return COMPLETE

    def _drive(self, part: _Part, controller: controllers.Controller, tell: Progress) -> None:
        """Run a part to its end; SolverError where that is not reached."""
        layout, n, targets = self.layout, self.layout.n, self.targets
        delay, last = self.spools.delay, targets.time.size - 1
        still = np.zeros(n)
        integrator = Integrator(
            part.plant, self.states[part.first], self.edges, load_sensing=self.load_sensing, step=self.step,
            ahead=delay, tolerance=self.tolerance, since=part.first,
        )  # fmt: skip
        for k in range(part.first, part.last):
            if k % REPORTED == 0:
                tell("simulating", k / self.samples)
            state, moved, at = self.states[k], integrator.measure(), min(k, last)
            now = Sample(
                time=k * self.step,
                joint=state[layout.q],
                position=moved[:n],
                velocity=moved[n:],
                pressure_a=state[layout.a],
                pressure_b=state[layout.b],
                supply=float(state[layout.supply]),
                target_position=targets.position[at],
                target_velocity=targets.velocity[at] if k < last else still,
                target_acceleration=targets.acceleration[at] if k < last else still,
            )
            np.clip(self._answer(controller, now), -1.0, 1.0, out=self.commands[k])
            self.edges[k + delay + 1] = self.spools.move(self.commands[k], now.supply)
            self.states[k + 1] = integrator.advance(k + 1)
            self.reached = k + 1

    def _answer(self, controller: controllers.Controller, now: Sample) -> np.ndarray:
        answer = np.asarray(controller.command(now), dtype=np.float64)
        if answer.shape != (self.spools.count,) or not np.isfinite(answer).all():
            name = type(controller).__name__
            raise InputError(
                f"controller {name} answers {answer.tolist()} at {now.time:.3f} s; must be {self.spools.count} finite "
                "commands from -1 to 1"
            )
        return answer

    def recorded(self) -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, float]]:
        """States up to where the run came, (samples, size), what is observed in them, and energy gained by bodies [J].

        What is observed is (samples,) or (samples, cylinders).
        """
        states = self.states[: self.reached + 1]
        inputs = np.empty((states.shape[0], self.edges.shape[1] + 1))
        inputs[:, :-1], inputs[:, -1] = self.edges[: states.shape[0]], float(self.load_sensing)
        seen: dict[str, list[np.ndarray]] = {}
        gained = {"kinetic": 0.0, "potential": 0.0}
        for part in self.parts:
            if part.first > self.reached:
                break
            # Where the payload changes, a sample is observed with that before.
            here = slice(part.first + (part.first > 0), min(part.last, self.reached) + 1)
            values = part.plant.observe(states[here].T, inputs[here].T)
            moved = np.asarray(part.plant.measure(states[here].T).full()).T
            n = self.layout.n
            for name, value in (
                *((name, np.asarray(value.full()).T) for name, value in zip(plant.OBSERVED, values, strict=True)),
                ("position", moved[:, :n]),
                ("velocity", moved[:, n:]),
            ):
                seen.setdefault(name, []).append(value)
            ends = part.plant.energy(states[[part.first, here.stop - 1]].T)
            for name, value in zip(gained, ends, strict=True):
                begin, end = np.asarray(value.full()).ravel()
                gained[name] += float(end - begin)
        return states, {name: np.concatenate(values) for name, values in seen.items()}, gained


def _result(
    run: _Run, motion: Motion, pump: str, factory: Any, status: Outcome
) -> Simulation:  # one place where everything recorded is named
    planned, layout, targets = run.planned, run.layout, run.targets
    task, machine = planned.task, planned.task.machine
    states, observed, gained = run.recorded()
    count = states.shape[0]
    time = run.step * np.arange(count)
    q = states[:, layout.q].copy()
    g = machine.geometry
    r, z = kinematics.tool_point(q[:, -3], q[:, -2], q[:, -1], g.base_x, g.base_z, g.boom, g.offset, g.outer)
    tip = run.parts[0].plant.tip
    if tip:
        bent = tip.offset(q, states[:, layout.bent])
        r, z = r + bent[0], z + bent[1]
    turned = q[:, 0] if g.slewing else np.zeros(count)
    target = targets.joint[np.minimum(np.arange(count), targets.time.size - 1)]
    supply, flow = states[:, layout.supply].copy(), observed["pump_flow"][:, 0]
    energies = states[:, layout.energy]
    # What is in proportion to p Q was integrated with the motion; the losses of an efficiency map follow here.
    shaft = shaft_of(machine.pump)
    losses = hydraulics.pump_losses(supply, flow, shaft.idle, shaft.leak, shaft.drag)
    lost = np.concatenate([[0.0], np.cumsum(0.5 * run.step * (losses[1:] + losses[:-1]))])
    balance = dict(zip(plant.ENERGIES, energies[-1].tolist(), strict=True)) | gained
    arrays = {
        "time": time,
        "tool": np.stack([r * np.cos(turned), r * np.sin(turned), z], axis=1),
        "tool_target": sample(task, time).point,
        "joint_position": q,
        "joint_target": target,
        "joint_velocity": states[:, layout.v].copy(),
        "position": observed["position"],
        "velocity": observed["velocity"],
        "command": run.commands[:count].copy(),
        "pressure_a": states[:, layout.a].copy(),
        "pressure_b": states[:, layout.b].copy(),
        "force": observed["force"],
        "supply": supply,
        "pump_flow": flow,
        "power": hydraulics.pump_power(supply, flow, *shaft),
        "cumulative": energies[:, 0] / shaft.efficiency + lost,
    }
    for array in arrays.values():
        array.setflags(write=False)
    found = events.find(task, arrays, observed, planned)
    if status.kind is not Kind.COMPLETE:
        found = (*found, Event("solver", "plant", float(time[-1]), 0.0, status))
    return Simulation(
        task=task, motion=motion, pump=pump, controller=getattr(factory, "__name__", type(factory).__name__),
        planned=planned, status=status, events=found, balance=balance, wall_s=0.0, **arrays,
    )  # fmt: skip
