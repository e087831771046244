"""Path accuracy by ISO 9283: how far the tool passes from its commanded path, whenever it passes.

At points of the commanded path a plane is laid across it, and the distance is taken to where the attained path
crosses that plane. So a tool that is late but on its path is accurate; Table 4 of the 4-DOF paper gives the largest
distance of each run. The standard averages thirty runs; a simulation repeats itself, so one is enough.
"""

from __future__ import annotations

import numpy as np

WINDOW = 2.0  # [s], how far in time the attained crossing may be from the commanded point
SLOWEST = 1e-3  # [m/s], slower points of the commanded path have no direction to lay a plane across
EVERY = 0.02  # [s], between the points that are looked at


def path_accuracy(
    time: np.ndarray, commanded: np.ndarray, attained: np.ndarray, since: float = 0.0, until: float = np.inf
) -> float:
    """Largest distance of the attained path from the commanded one, AT_p of ISO 9283 [m].

    Args:
        time: Equally spaced times of all samples [s], (samples,).
        commanded: Commanded tool positions [m], (samples, 3); held after the path's end.
        attained: Attained tool positions [m], (samples, 3).
        since, until: Times between which the commanded path is looked at [s].

    Returns:
        The distance, 0 for a tool that was to stay; where the attained path crosses no plane, that to its nearest
        point within the window.
    """
    if time.size < 2:
        return 0.0
    step = float(time[1] - time[0])
    velocity = np.gradient(commanded, step, axis=0)
    reach, every = round(WINDOW / step), max(1, round(EVERY / step))
    speed = np.linalg.norm(velocity, axis=1)
    worst = 0.0
    looks = np.flatnonzero(speed > SLOWEST)[::every]
    for i in looks[(time[looks] >= since) & (time[looks] <= until)]:
        first = max(0, int(i) - reach)
        around = attained[first : int(i) + reach + 1] - commanded[i]
        across = around @ (velocity[i] / speed[i])
        crossing = np.flatnonzero((across[:-1] <= 0.0) & (across[1:] > 0.0))
        if crossing.size == 0:
            distance = float(np.linalg.norm(around, axis=1).min())
        else:
            # Of several crossings, as at a corner, the one nearest in time to where the tool should be.
            j = crossing[np.abs(crossing - (int(i) - first)).argmin()]
            share = across[j] / (across[j] - across[j + 1])
            distance = float(np.linalg.norm(around[j] + share * (around[j + 1] - around[j])))
        worst = max(worst, distance)
    return worst
