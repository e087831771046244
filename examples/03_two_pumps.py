"""A plan for the load-sensing pump and one for the constant-pressure pump, each measured with both pumps.

A CP pump takes power in proportion to flow, whatever the load, so its best motion displaces least oil. An LS pump
follows the highest load pressure, so it pays to avoid high pressures while much oil flows.
"""

import leanboom as lb

GRID, STEP, EFFORT = (61, 41), 0.2, "quick"  # all quicker than the defaults


def main():
    task = lb.load_task("forwarder-horizontal", start="middle")
    print(f"{task.name}, from the middle of the feasible extensions")
    print(f"{'planned for':>12} {'LS [kJ]':>8} {'CP [kJ]':>8} {'oil [l]':>8} {'mean LS supply [MPa]':>21}")
    judged = {}
    for pump in ("ls", "cp"):
        motion = lb.plan(task, pump=pump, grid=GRID, step=STEP, effort=EFFORT)
        one = judged[pump] = lb.evaluate(task, motion)
        litres = one.energy_cp / task.machine.pump.constant_pressure * task.machine.pump.efficiency * 1e3
        supply = one.supply_ls.mean() / 1e6
        print(f"{pump:>12} {one.energy_ls / 1e3:8.2f} {one.energy_cp / 1e3:8.2f} {litres:8.3f} {supply:21.2f}")
    ls, cp = judged["ls"], judged["cp"]
    print(f"on the LS pump the plan for CP takes {cp.energy_ls / ls.energy_ls - 1:+.1%}")
    print(f"on the CP pump the plan for LS takes {ls.energy_cp / cp.energy_cp - 1:+.1%}")


if __name__ == "__main__":
    main()
