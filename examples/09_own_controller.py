"""A controller of one's own on the simulated crane, beside the papers' one: energy and tracking in closed loop."""

from dataclasses import replace

import numpy as np

import leanboom as lb
from leanboom.components.paths import Lines
from leanboom.simulation.controllers import DeadZoneInverse

REACH = Lines(points=((4.6, 0.0, 2.0), (6.4, 0.0, 2.3)), durations=(5.0,))


class Foresight(DeadZoneInverse):
    """The papers' controller, told of the desired velocity as early as the valves are late."""

    def __init__(self, rig):
        super().__init__(rig)
        self.lead = rig.plant.crane.machine.circuit.delay

    def command(self, now):
        """Commands for the velocity that will be wanted when the valves answer."""
        ahead = now.target_velocity + self.lead * now.target_acceleration
        return super().command(replace(now, target_velocity=ahead))


class Patient:
    """Nothing but the position error, behind the dead zone: any class with these two methods will do."""

    def __init__(self, rig):
        self.dead_zone = rig.plant.crane.machine.circuit.dead_zone

    def command(self, now):
        """Commands in proportion to the errors, none for small ones."""
        share = 2.0 * (now.target_position - now.position)
        return np.where(np.abs(share) > 0.01, share + np.sign(share) * self.dead_zone, 0.0)


def main():
    task = replace(lb.load_task("forwarder-horizontal"), name="reach", path=REACH)
    motion = lb.run(task, method="sns-actuator", baseline=False, check=False).motion
    print(f"{'controller':>16} {'pump':>5} {'planned [kJ]':>13} {'driven [kJ]':>12} {'path accuracy [m]':>18}")
    for controller in (DeadZoneInverse, Foresight, Patient):
        for pump in ("ls", "cp"):
            run = lb.simulate(task, motion, pump, controller=controller)
            planned, driven = run.planned_energy / 1e3, run.energy / 1e3
            print(f"{run.controller:>16} {pump:>5} {planned:13.2f} {driven:12.2f} {run.path_accuracy:18.3f}")


if __name__ == "__main__":
    main()
