"""One backward sweep serves every start: the values of a policy, and its motions from several starts.

`plan` does more than this: it refines the motion in tubes and polishes it. The policy alone is for questions about
many starts at once, and for a look inside.
"""

import numpy as np

import leanboom as lb
from leanboom.dynamic_programming import grids, value_function
from leanboom.problem import layout, stages


def main():
    task = lb.load_task("forwarder-vertical")
    problem = stages.discretise(task, 0.1)
    policy = value_function.solve(problem, grids.full_grid(problem, 121, 81), "ls")
    print(policy)

    # Values at rest at stage 0, over the positions of that stage's grid: the predicted cost of every start.
    first = policy.tables.stage[0]
    positions = first[layout.C_LO] + first[layout.DC] * np.arange(policy.grid.positions)
    rest = policy.grid.velocities // 2  # the middle velocity node is zero
    values = policy.values[0, :, rest]
    assert abs(first[layout.W_LO] + rest * first[layout.DW]) < 1e-12

    print(f"{'start [m]':>10} {'predicted [kJ]':>15} {'judged [kJ]':>12}  status")
    for i in np.linspace(0, positions.size - 1, 6).astype(int):
        judged = lb.evaluate(task, value_function.rollout(policy, float(positions[i])))
        print(f"{positions[i]:10.4f} {values[i] / 1e3:15.2f} {judged.energy_ls / 1e3:12.2f}  {judged.status}")
    print(f"least predicted: {value_function.best_start(policy):.4f} m")


if __name__ == "__main__":
    main()
