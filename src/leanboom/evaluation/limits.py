"""Use of each limit by a motion, and cylinders at an end of their stroke."""

from __future__ import annotations

import numpy as np

from leanboom.evaluation.evaluate import TOLERANCE, Evaluation

END = 0.995  # from this use of its range on, a joint is at its end


def uses(evaluation: Evaluation) -> np.ndarray:
    """Largest use of position, velocity and acceleration limit of each joint, (3, joints).

    Args:
        evaluation: The judged motion.
    """
    e, machine = evaluation, evaluation.task.machine
    velocity = np.abs(e.velocity) / np.array([cylinder.velocity_limit for cylinder in machine.cylinders])
    acceleration = np.abs(e.acceleration) / np.array([cylinder.acceleration_limit for cylinder in machine.cylinders])
    return np.stack([use.max(axis=0) for use in (np.abs(_range_share(e)), velocity, acceleration)])


def _range_share(e: Evaluation) -> np.ndarray:
    """Position of each joint in its range: -1 at its lower end, 1 at its upper, (samples, joints)."""
    lower = np.array([joint.lower for joint in e.task.machine.joints])
    upper = np.array([joint.upper for joint in e.task.machine.joints])
    return (e.joint_position - 0.5 * (lower + upper)) / (0.5 * (upper - lower))


def ends(evaluation: Evaluation) -> dict[str, str]:
    """Cylinders that reach an end of their stroke without passing it, and which: retracted, extended, or both.

    Most motions start at one: a telescope is carried retracted. That is no sign of a limit that stands in the way.

    Args:
        evaluation: The judged motion.
    """
    found = {}
    share, machine = _range_share(evaluation), evaluation.task.machine
    for j, (joint, cylinder) in enumerate(zip(machine.joints, machine.cylinders, strict=True)):
        low, high = float(share[:, j].min()), float(share[:, j].max())
        if max(-low, high) > TOLERANCE:
            continue
        near, far = (float(cylinder.linkage.length_arm_slope(q)[0]) for q in (joint.lower, joint.upper))
        names = ("retracted", "extended") if near <= far else ("extended", "retracted")
        reached = [name for name, at in zip(names, (low <= -END, high >= END), strict=True) if at]
        if reached:
            found[joint.name] = " and ".join(reached)
    return found


def nearest(evaluation: Evaluation) -> str:
    """The limit of velocity, acceleration or flow that is used most, and the cylinders that reach an end, in words.

    Args:
        evaluation: The judged motion.
    """
    use, found = evaluation.limit_use, ends(evaluation)
    shares = {"velocity": use.velocity, "acceleration": use.acceleration}
    if use.flow_limited:
        shares["pump flow"] = use.flow
    kind = max(shares, key=lambda name: shares[name])
    most = f"{kind} {100.0 * shares[kind]:.0f} % used"
    return f"{most}; {at_ends(found)}" if found else most


def at_ends(found: dict[str, str]) -> str:
    """The cylinders at their ends as a phrase.

    Args:
        found: From `ends`.
    """
    return ", ".join(f"{name} at its end: {which}" for name, which in found.items())
