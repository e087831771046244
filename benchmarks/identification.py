"""Identification measured against a machine that is known: `python -m benchmarks.identification`.

A simulated crane is driven through test motions with its sensors' noise and quantisation added, and identified from a
draft that knows drawings and data sheet only. Printed: errors against the truth, coverage of the intervals over seeded
repetitions, time of a ten-minute log, and what plans with draft and identified machine cost on the true one.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import leanboom as lb
from leanboom.identification import base_parameters
from leanboom.identification.identify import Identification, identify
from leanboom.model.machine import Machine
from leanboom.model.task import Lines, Task
from leanboom.report.simulation_page import columns
from leanboom.simulation.controllers import DeadZoneInverse, Rig, Sample

ANGLE, LENGTH, PRESSURE, VOLUME = np.radians(0.0072), 160e-6, 25e3, 5e-6  # steps of the sensors: rad, m, Pa, m^3
STEP_HELD = 1.2  # [s], of a constant command
RATES = np.array([[0.031, 0.05, 0.083, 0.037], [0.09, 0.17, 0.21, 0.11]])  # [Hz]
MIDDLE = np.array([0.0, 0.35, -1.4, 1.8])
REACH = np.array([0.8, 0.5, 0.9, 1.6])
HANDOVER, MOMENT = 8.0, 1e-3  # [s]


class Waves(DeadZoneInverse):
    """Drives all joints along sums of two sines, then with commands held constant, each cylinder by itself."""

    tracking = 60.0  # [s]
    seed = 7  # of the held commands; every seed but this one shifts the waves as well

    def __init__(self, rig: Rig):
        super().__init__(rig)
        machine = rig.plant.crane.machine
        self._start, self._cylinders = rig.joints, machine.cylinders
        ends = [(joint.lower, joint.upper) for joint in machine.joints]
        self._ends = np.array(ends)
        self._shortest = np.array([min(self._length(i, q) for q in pair) for i, pair in enumerate(ends)])
        self._base = machine.geometry.slewing
        self._zone = machine.circuit.dead_zone
        self._rng = np.random.default_rng(self.seed)
        self._phase = 0.0 if self.seed == Waves.seed else self._rng.uniform(0.0, 2.0 * np.pi, (2, 1, len(ends)))
        self._held = np.zeros(len(ends))
        self._until = self.tracking + np.arange(len(ends)) * STEP_HELD / len(ends)
        self._course = self._lengths(np.arange(0.0, self.tracking + 2.0 * MOMENT, MOMENT))

    def _length(self, i: int, q: float) -> float:
        return float(self._cylinders[i].linkage.length_arm_slope(q)[0])

    def _lengths(self, times: np.ndarray) -> np.ndarray:
        """Of the cylinders on their waves, beyond the shortest, (times, cylinders)."""
        share = np.minimum(times / HANDOVER, 1.0)[:, None]
        slow, fast = np.sin(2.0 * np.pi * RATES[:, None] * times[:, None] + self._phase)
        q = (1.0 - share) * self._start + share * (MIDDLE + REACH * (0.8 * slow + 0.2 * fast))
        pairs = zip(self._cylinders, q.T, strict=True)
        return np.stack([each.linkage.length_arm_slope(along)[0] for each, along in pairs], axis=1) - self._shortest

    def command(self, now: Sample) -> np.ndarray:
        """The commands of a sample.

        Args:
            now: The sample.
        """
        if now.time < self.tracking:
            at = round(now.time / MOMENT)
            now.target_position = self._course[at]
            now.target_velocity = (self._course[at + 1] - self._course[at]) / MOMENT
            return super().command(now)
        for i in np.flatnonzero(now.time >= self._until):
            share = (now.joint[i] - self._ends[i, 0]) / (self._ends[i, 1] - self._ends[i, 0])
            length = self._length(i, now.joint[i])
            growing = self._length(i, now.joint[i] + 1e-4) > length
            back = (share > 0.5) == growing  # towards the middle of the range
            side = -1.0 if (back if self._rng.random() < 0.75 else not back) else 1.0
            if share < 0.2 or share > 0.8:
                side = -1.0 if back else 1.0
            # A turning crane is heavy, and the simulation has no relief valves.
            most = 0.08 if self._base and i == 0 else 0.4
            level = self._zone + (1.0 - self._zone) * most * (0.25 + 0.75 * self._rng.random())
            self._held[i] = side * level if self._rng.random() < 0.85 else 0.0
            self._until[i] += STEP_HELD
        return self._held.copy()


def drive(machine: Machine, seconds: float, tracking: float = 60.0, seed: int = Waves.seed) -> dict[str, np.ndarray]:
    """The columns of a simulated run through the test motions.

    Args:
        machine: The true machine, four joints.
        seconds: How long.
        tracking: For how long of it joints follow sines, before commands are held.
        seed: Of the motion.
    """
    task = Task("test-motions", machine, Lines(((5.0, 0.0, 2.0), (5.0, 0.0, 2.1)), (seconds,)), start="middle")
    motion = lb.plan(task, method="sns-actuator", step=0.5)  # of no account: the controller goes its own way
    chosen = type("Chosen", (Waves,), {"tracking": tracking, "seed": seed})
    return columns(lb.simulate(task, motion, controller=chosen, tolerance=1e-5))


def measured(
    run: Mapping[str, np.ndarray], names: tuple[str, ...], seed: int, commanded: tuple[str, ...] | None = None
) -> dict[str, np.ndarray]:
    """What sensors with noise and quantisation show of a run.

    Args:
        run: Its columns.
        names: Of the joints.
        seed: Of the noise.
        commanded: Joints whose commands are logged; None: all.
    """
    rng = np.random.default_rng(seed)

    def seen(values: np.ndarray, step: float) -> np.ndarray:
        return np.round((values + rng.normal(0.0, 0.5 * step, values.size)) / step) * step

    time_s = run["time_s"]
    found = {"time_s": time_s}
    for name in names:
        key, step = (f"{name}_m", LENGTH) if name == "extension" else (f"{name}_rad", ANGLE)
        found[key] = seen(run[key], step)
        for side in "ab":
            found[f"{name}_pressure_{side}_pa"] = seen(run[f"{name}_pressure_{side}_pa"], PRESSURE)
        if commanded is None or name in commanded:
            found[f"{name}_command"] = run[f"{name}_command"]
    found["supply_pa"] = seen(run["supply_pa"], PRESSURE)
    flow = run["pump_flow_m3_s"]
    volume = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(time_s) * (flow[1:] + flow[:-1]))])
    found["pump_volume_m3"] = np.round(volume / VOLUME) * VOLUME
    return found


def write_log(path: Path, table: Mapping[str, np.ndarray]) -> Path:
    """A log as CSV.

    Args:
        path: Where to.
        table: Its columns.
    """
    np.savetxt(
        path, np.stack(list(table.values()), axis=1), delimiter=",", header=",".join(table), comments="", fmt="%.7g"
    )
    return path


def draft_of(machine: Machine) -> Machine:
    """What drawings and a data sheet tell of a machine: its lengths and cylinders, and guesses of all else.

    Args:
        machine: The true machine.
    """
    bodies = tuple(replace(body, mass=150.0, along=1.0, above=0.1, inertia=50.0) for body in machine.bodies)
    cylinders = tuple(
        replace(each, friction=replace(each.friction, coulomb=1000.0, viscous=0.0, steps=None))
        for each in machine.cylinders
    )
    circuit = replace(machine.circuit, delay=0.05, dead_zone=0.3, spool_bandwidth=5.0, edge_flow=1e-3)
    valve = replace(machine.valve, extend_coefficient=1.0, retract_coefficient=1.0, regenerative_ratio=0.5)
    pump = replace(machine.pump, ls_margin=1e6)
    known = tuple(
        each for each in machine.provenance
        if not each.key.startswith("bodies") and ".friction." not in each.key and ".steps" not in each.key
    )  # fmt: skip
    return replace(
        machine,
        name="draft",
        bodies=bodies,
        cylinders=cylinders,
        circuit=circuit,
        valve=valve,
        pump=pump,
        provenance=known,
    )


def truth_of(machine: Machine) -> dict[str, float]:
    """True values of what is estimated, by name.

    Args:
        machine: The true machine.
    """
    values = np.array([v for body in machine.bodies for v in (body.mass, body.along, body.above, body.inertia)])
    sums = base_parameters.base_map(machine, machine.bodies) @ base_parameters.moments(values)[0]
    found = dict(zip(base_parameters.BASE, sums.tolist(), strict=True))
    for cylinder, drive_ in zip(machine.cylinders, machine.drives, strict=True):
        found[f"cylinders.{cylinder.name}.friction.coulomb"] = cylinder.friction.coulomb
        found[f"cylinders.{cylinder.name}.friction.viscous"] = cylinder.friction.viscous
        found[f"cylinders.{cylinder.name}.area_out"] = drive_.area_out
        found[f"cylinders.{cylinder.name}.area_in"] = drive_.area_in
        if cylinder.friction.steps:
            for i, step in enumerate(cylinder.friction.steps):
                found[f"cylinders.{cylinder.name}.friction.steps[{i}]"] = step
        for way in ("out", "in"):
            found[f"valve.{cylinder.name}.dead_zone_{way}"] = machine.circuit.dead_zone
    for name in ("delay", "spool_bandwidth", "dead_zone", "edge_flow", "pump_time_constant", "bulk_modulus"):
        found[f"simulation.{name}"] = getattr(machine.circuit, name)
    for name in ("extend_coefficient", "retract_coefficient", "regenerative_ratio"):
        found[f"valve.{name}"] = getattr(machine.valve, name)
    return found | {"pump.ls_margin": machine.pump.ls_margin}


def errors(
    found: Identification, truth: Mapping[str, float]
) -> list[tuple[str, float, float, float | None, bool | None]]:
    """Name, value, truth, half width and whether the interval covers the truth.

    Args:
        found: The identification.
        truth: True values.
    """
    rows = []
    for each in found.estimates:
        if each.name in truth:
            true = truth[each.name]
            told = each.low is not None and each.high is not None
            half = 0.5 * (each.high - each.low) if told else None  # type: ignore[operator]
            rows.append((each.name, each.value, true, half, each.low <= true <= each.high if told else None))  # type: ignore[operator]
    return rows


def coverage(
    machine: Machine,
    runs: Sequence[Mapping[str, np.ndarray]],
    folder: Path,
    repetitions: int,
    commanded: tuple[str, ...] | None = None,
) -> dict[str, tuple[int, int]]:
    """How many intervals cover the truth over repetitions with other noise, and of how many, by parameter.

    Args:
        machine: The true machine.
        runs: Columns of runs, used in turn.
        folder: For logs.
        repetitions: How many.
        commanded: Joints whose commands are logged; None: all.
    """
    truth, draft = truth_of(machine), draft_of(machine)
    counts: dict[str, tuple[int, int]] = {}
    for seed in range(repetitions):
        log = write_log(folder / "log.csv", measured(runs[seed % len(runs)], machine.names, 1000 + seed, commanded))
        for name, _, _, _, covers in errors(identify([log], draft), truth):
            if covers is not None:
                hit, of = counts.get(name, (0, 0))
                counts[name] = hit + covers, of + 1
    return counts


def cost_of_plans(
    truth: Machine, machines: Mapping[str, Machine], tasks: tuple[str, ...]
) -> dict[str, dict[str, float]]:
    """Energy on the true machine of the plans made with other machines, by task and machine [J].

    Args:
        truth: The true machine.
        machines: The others by name.
        tasks: Bundled tasks.
    """
    found: dict[str, dict[str, float]] = {}
    for name in tasks:
        task = lb.load_task(name)
        row = {}
        for label, machine in {"truth": truth, **machines}.items():
            motion = lb.plan(replace(task, machine=machine), pump="ls", check=False)
            judged = lb.evaluate(replace(task, machine=truth), motion)
            row[label] = judged.energy_ls if judged.feasible else float("nan")
        found[name] = row
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repetitions", type=int, default=200)
    parser.add_argument("--motions", type=int, default=5, help="different motions among the repetitions")
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--long", action="store_true", help="also a log of ten minutes")
    parser.add_argument("--plans", action="store_true", help="also plans with draft and identified machine")
    options = parser.parse_args()
    machine = lb.load_machine("forwarder")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run = drive(machine, options.seconds, 0.5 * options.seconds)
        found = identify([write_log(folder / "log.csv", measured(run, machine.names, 1))], draft_of(machine))
        print(f"{options.seconds:g} s at 500 Hz identified in {found.wall_s:.1f} s")
        for key, value, true, half, covers in errors(found, truth_of(machine)):
            error = f"{100 * (value / true - 1):8.2f} %" if true else f"{value - true:10.3g}"
            width = "not told" if half is None else f"+- {half:.3g}, {'covers' if covers else 'misses'}"
            print(f"{key:42s} {value:11.5g} {true:11.5g} {error} {width}")
        for fit in found.fits:
            print(f"{fit.signal:20s} validation {fit.rms_percent:6.2f} % of full scale")
        if options.plans:
            tasks = ("forwarder-horizontal", "forwarder-vertical", "forwarder-half-cycle")
            rows = cost_of_plans(machine, {"draft": draft_of(machine), "identified": found.machine}, tasks)
            for task, row in rows.items():
                print(task, {key: f"{1e-3 * value:.3f} kJ" for key, value in row.items()})
        if options.long:
            long = drive(machine, 599.0, 300.0)
            log = write_log(folder / "long.csv", measured(long, machine.names, 2))
            began = time.perf_counter()
            identify([log], draft_of(machine))
            print(f"600 s at 500 Hz read and identified in {time.perf_counter() - began:.1f} s")
        if options.repetitions:
            others = [drive(machine, options.seconds, 0.5 * options.seconds, seed) for seed in range(options.motions)]
            counts = coverage(machine, others, folder, options.repetitions)
            for key, (hit, of) in counts.items():
                print(f"{key:42s} {hit:4d} of {of:4d} intervals cover the truth: {100 * hit / of:.1f} %")
            hits, total = (sum(pair[i] for pair in counts.values()) for i in (0, 1))
            print(f"all: {100 * hits / total:.1f} %")


if __name__ == "__main__":
    main()
