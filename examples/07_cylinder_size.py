"""A machine changed in Python: does a smaller extension cylinder save energy?

Section 6.2 of the 3-DOF paper asks this of its crane: 45 mm in place of 50 mm bore. Machines are frozen
dataclasses in SI units, so `replace` makes another one; `leanboom.io.loading.dump_machine` would write it to a file.
"""

from dataclasses import replace
from math import pi

import leanboom as lb
from leanboom.components.paths import Lines

DIAGONAL = Lines(points=((1.4, 0.0, 0.5), (3.2, 0.0, 2.5)), durations=(10.0,))  # first edge of the large triangle
GRID, STEP, EFFORT = (41, 31), 0.2, "quick"  # all quicker than the defaults


def with_extension_bore(machine: lb.Machine, bore: float, rod: float) -> lb.Machine:
    """The machine with another extension cylinder of the same stroke; bore and rod in [m]."""
    cylinder = replace(
        machine.redundant,
        piston_area=pi / 4 * bore**2,
        rod_side_area=pi / 4 * (bore**2 - rod**2),
    )
    return replace(machine, name=f"{machine.name}-{1e3 * bore:.0f}", cylinders=(*machine.cylinders[:-1], cylinder))


def main():
    task = replace(lb.load_task("loader-triangle-large"), name="diagonal", path=DIAGONAL)
    reference = {}
    print(f"{'extension':>12} {'pump':>5} {'energy [kJ]':>12} {'change':>7} {'highest LS supply [MPa]':>24}")
    for bore in (0.050, 0.045):
        machine = with_extension_bore(task.machine, bore, rod=0.030)
        for pump in ("ls", "cp"):
            motion = lb.plan(replace(task, machine=machine), pump=pump, grid=GRID, step=STEP, effort=EFFORT)
            judged = lb.evaluate(replace(task, machine=machine), motion)
            energy = judged.energy(pump)
            change = energy / reference.setdefault(pump, energy) - 1
            supply = judged.supply_ls.max() / 1e6
            print(f"{1e3 * bore:9.0f}/30 {pump:>5} {energy / 1e3:12.2f} {change:+7.1%} {supply:24.1f}")


if __name__ == "__main__":
    main()
