"""Draw the README's picture: python scripts/picture.py (writes docs/figures/two-ways.png)."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np

import leanboom as lb
from leanboom.evaluation.evaluate import Evaluation

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

PLAN, TODAY = "#0b5c8c", "#9aa5b1"
AT = (0.0, 0.45, 0.8, 1.0)  # moments drawn, as shares of the duration


def posture(judged: Evaluation, i: int) -> np.ndarray:
    """Lift joint, tilt joint, corner and tool in the boom's plane [m], (4, 2)."""
    g = judged.task.machine.geometry
    q2, q3, q4 = judged.joint_position[i, -3:]
    lift = np.array([g.base_x, g.base_z])
    tilt = lift + g.boom * np.array([np.cos(q2), np.sin(q2)])
    corner = tilt + g.offset * np.array([-np.sin(q2 + q3), np.cos(q2 + q3)])
    tool = corner + (g.outer + q4) * np.array([np.cos(q2 + q3), np.sin(q2 + q3)])
    return np.array([lift, tilt, corner, tool])


def main() -> None:
    """Plan, draw, save."""
    plan = lb.run(lb.load_task("forwarder-half-cycle"), pump="ls")
    today = plan.baseline
    assert today is not None
    figure, (crane, energy) = plt.subplots(1, 2, figsize=(10, 3.9), width_ratios=(1.5, 1))
    for judged, colour, name in ((today, TODAY, "pseudo-inverse"), (plan.evaluation, PLAN, "leanboom")):
        for share in AT:
            line = posture(judged, int(share * (judged.time.size - 1)))
            crane.plot(
                *line.T, color=colour, lw=3 if colour == PLAN else 2.2, alpha=0.35 + 0.6 * share, marker="o", ms=3
            )
        energy.plot(judged.time, judged.cumulative_ls / 1e3, color=colour, lw=2)
        energy.annotate(
            f"{name}\n{judged.energy_ls / 1e3:.1f} kJ", (judged.time[-1], judged.energy_ls / 1e3), color=colour,
            ha="right", va="bottom", xytext=(-6, 4), textcoords="offset points",
        )  # fmt: skip
    radius = np.hypot(*plan.evaluation.tool[:, :2].T)
    crane.plot(radius, plan.evaluation.tool[:, 2], color="#17212b", lw=1, ls=":")
    crane.set(xlabel="distance from the slewing axis [m]", ylabel="height [m]", aspect="equal")
    crane.set_title("same tool path, two ways to follow it (later is darker)", fontsize=10, loc="left")
    energy.set(xlabel="time [s]", ylabel="energy of the load-sensing pump [kJ]", ylim=(0, 1.2 * today.energy_ls / 1e3))
    energy.set_title("what the pump spends", fontsize=10, loc="left")
    for axes in (crane, energy):
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.25)
    figure.tight_layout()
    path = Path(__file__).parent.parent / "docs" / "figures" / "two-ways.png"
    path.parent.mkdir(exist_ok=True)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
