"""The target moves while the crane is on its way: re-plan from the state it is in, again and again.

The boom is also nudged now and then. After four seconds the logs turn out to lie elsewhere; the path is led over to
them, and every second the rest of it is planned anew from where the telescope really is. A pseudo-inverse following the
same changed path, undisturbed, is what a crane does today.
"""

from dataclasses import replace

import numpy as np

import leanboom as lb
from leanboom.components.paths import Moved

STEP = 0.1  # longer than the default: quicker
NUDGE = 0.01, 0.01  # what the telescope is off at every new plan, at most [m], [m/s]


def main():
    task = lb.load_task("forwarder-half-cycle", start="middle")
    changed = replace(task, path=Moved(task.path, offset=(0.3, -0.7, 0.3), since=4.0, over=5.0))
    rng = np.random.default_rng(1)
    for pump in ("ls", "cp"):
        plan = lb.run(task, pump=pump, step=STEP, baseline=False)
        spent = np.interp(4.0, plan.evaluation.time, energy_so_far(plan.evaluation, pump))
        following = None
        now = 4.0
        motion = plan.motion
        while now < changed.duration:
            position, velocity, _ = motion.at(now)
            position, velocity = (
                float(x + rng.uniform(-n, n)) for x, n in zip((position, velocity), NUDGE, strict=True)
            )
            following = lb.replan(changed, now, position, velocity, pump=pump, around=following, step=STEP)
            assert not following.stopping, following.status
            until = min(now + 1.0, changed.duration)
            judged = following.evaluation
            spent += np.interp(until - now, judged.time, energy_so_far(judged, pump))
            motion, now = following, until
        today = lb.run(changed, pump=pump, method="sns-actuator", baseline=False, check=False).evaluation
        known = lb.run(changed, pump=pump, step=STEP, baseline=False).evaluation
        missed = np.linalg.norm(following.evaluation.tool[-1] - known.tool[-1])
        print(f"{pump}: the tool ends {1e3 * missed:.1f} mm from its new target")
        print(f"    re-planned {spent / 1e3:.1f} kJ, pseudo-inverse {today.energy(pump) / 1e3:.1f} kJ ({today.status})")
        print(f"    had the new target been known from the beginning: {known.energy(pump) / 1e3:.1f} kJ")


def energy_so_far(judged, pump):
    return judged.cumulative_ls if pump == "ls" else judged.cumulative_cp


if __name__ == "__main__":
    main()
