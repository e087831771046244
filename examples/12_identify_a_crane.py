"""A crane of one's own: a draft full of guesses, a log of the crane at work, and what plans cost before and after.

The bundled forwarder stands for the crane; of it, the fit sees the log alone, with the noise and steps of sensors.
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import leanboom as lb
from leanboom.components.paths import Lines
from leanboom.identification.identify import identify
from leanboom.report.simulation_page import columns

CRANE = lb.load_machine("forwarder")
POINTS = ((4, 0, 2.5), (7.5, 0.4, 1), (4, -0.4, 0.8), (6.8, 0, 3.5), (4.4, 0.4, 3), (7.8, 0, 1.8), (4.2, -0.4, 2.2))
STEPS = {"_rad": 1.3e-4, "extension_m": 1.6e-4, "_pa": 25e3}  # of sensors: rad, m, Pa


def drafted():
    """What drawings tell, and guesses of masses, friction and valves."""
    bodies = tuple(replace(each, mass=150.0, along=1.0, above=0.1, inertia=50.0) for each in CRANE.bodies)
    cylinders = [replace(c, friction=replace(c.friction, coulomb=1e3, steps=None)) for c in CRANE.cylinders]
    circuit = replace(CRANE.circuit, delay=0.05, dead_zone=0.3)
    pump = replace(CRANE.pump, ls_margin=1e6)
    return replace(CRANE, name="draft", bodies=bodies, cylinders=tuple(cylinders), circuit=circuit, pump=pump)


def log(path):
    """Write a log of the crane under way through some points: 250 rows a second."""
    task = lb.load_task("forwarder-horizontal")
    task = replace(task, name="work", path=Lines(POINTS, (4.5,) * (len(POINTS) - 1)), start="middle")
    seen, rng = columns(lb.simulate(task, lb.plan(task, method="sns-actuator", check=False))), np.random.default_rng(1)
    for name, values in seen.items():
        for ending, step in STEPS.items():
            if name.endswith(ending):
                seen[name] = step * np.round(values / step + rng.normal(0.0, 0.5, values.size))
    table = np.stack(list(seen.values()), axis=1)[::2]
    np.savetxt(path, table, delimiter=",", header=",".join(seen), comments="", fmt="%.7g")


def main(folder):
    log(folder / "log.csv")
    found = identify([folder / "log.csv"], drafted())
    for fit in found.fits:
        print(f"{fit.signal:>20}: {fit.rms_percent:.2f} % of full scale on validation data")
    task = lb.load_task("forwarder-horizontal")
    for name, machine in (("draft", drafted()), ("identified", found.machine), ("crane itself", CRANE)):
        motion = lb.plan(replace(task, machine=machine), pump="ls", effort="quick", check=False)
        there = lb.evaluate(task, motion)
        print(f"planned with the {name}: {there.energy_ls / 1e3:.2f} kJ on the crane, {there.status}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp()))
