"""Linkages from joint angles and cylinder lengths measured together, where a drawing is incomplete."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np

from leanboom.components.linkages import Linkage, Polynomial
from leanboom.errors import InputError
from leanboom.identification.cylinder_forces import LEAST_TRAVEL
from leanboom.identification.estimates import KNOWN, Estimate, Fitted, blocks_of, compare, covariance, kept
from leanboom.identification.logs.conditioning import Data
from leanboom.model.machine import Machine
from leanboom.quantities.declarations import declared

RATE = 20.0  # [Hz], of the rows
PRIOR = 0.1  # share of a length, or [rad] of an angle, by which a drawing may be wrong


def fit(data: Data, machine: Machine) -> Fitted | None:
    """Fit the linkages of all joints whose angle and cylinder length are logged; None if there is none.

    Args:
        data: The conditioned logs.
        machine: The draft.
    """
    estimates: list[Estimate] = []
    fits, series = [], {}
    cylinders = list(machine.cylinders)
    every = max(1, round(data.rate / RATE))
    block = blocks_of(data.time, data.part)
    for i, (joint, cylinder) in enumerate(zip(machine.joints, machine.cylinders, strict=True)):
        q, c = (data.channels.get(f"{joint.name}_{what}") for what in ("position", "cylinder"))
        if q is None or c is None or isinstance(cylinder.linkage, Polynomial):
            continue
        rows = np.flatnonzero(data.inner & data.usable[joint.name])[::every]
        if rows.size < 20 or np.ptp(q[rows]) < LEAST_TRAVEL * (joint.upper - joint.lower):
            continue
        training = np.arange(rows.size) % 4 < 3  # every fourth sample validates
        linkage, found = _solve(cylinder.linkage, joint.name, q[rows], c[rows], block[rows], training)
        estimates += found
        model = linkage.length_arm_slope(q[rows])[0]
        fits.append(compare(f"{joint.name}_cylinder", c[rows], model, training))
        series[f"{joint.name}_cylinder"] = (data.time[rows], c[rows], model, training)
        ends = [float(linkage.length_arm_slope(end)[0]) for end in (joint.lower, joint.upper)]
        cylinders[i] = replace(cylinder, linkage=linkage, stroke=abs(ends[1] - ends[0]))
    if not fits:
        return None
    return Fitted(replace(machine, cylinders=tuple(cylinders)), tuple(estimates), tuple(fits), series)


def _solve(
    linkage: Linkage, joint: str, q: np.ndarray, c: np.ndarray, block: np.ndarray, training: np.ndarray
) -> tuple[Linkage, list[Estimate]]:
    from scipy.optimize import least_squares

    names = [each.name for each in fields(linkage) if each.name in declared(type(linkage))]  # type: ignore[arg-type]
    start = np.array([getattr(linkage, name) for name in names])
    angle = np.array([_is_angle(linkage, name) for name in names])
    spread = np.where(angle, PRIOR, PRIOR * np.abs(start) + 1e-3)
    low, high = np.where(angle, start - 1.0, 0.5 * start), np.where(angle, start + 1.0, 2.0 * start)

    def changed(x: np.ndarray) -> Any:
        return replace(linkage, **dict(zip(names, x.tolist(), strict=True)))  # type: ignore[type-var]

    def error(x: np.ndarray) -> np.ndarray:
        try:
            with np.errstate(all="ignore"):
                apart = changed(x).length_arm_slope(q[training])[0] - c[training]
        except InputError:
            return np.full(int(training.sum()), 1.0)
        return np.where(np.isfinite(apart), apart, 1.0)

    def solved(sigma: float) -> Any:
        return least_squares(
            lambda x: np.concatenate([error(x) / sigma, (x - start) / spread]),
            start,
            bounds=(low, high),
            x_scale=spread,
            diff_step=1e-6,
        )

    sigma = max(float(np.sqrt(np.mean(error(solved(1e-3).x) ** 2))), 1e-6)
    found = solved(sigma)
    rows = int(training.sum())
    jacobian = found.jac[:rows]
    variance, posterior, factor = covariance(
        [jacobian], [-error(found.x) / sigma], [block[training]], 1.0 / spread**2
    )  # fmt: skip
    estimates = []
    for j, name in enumerate(names):
        known = bool(posterior[j, j] < KNOWN * spread[j] ** 2)
        half = factor * float(np.sqrt(variance[j, j]))
        value = float(found.x[j])
        note = "" if known else "lengths alone do not tell it: measure it, or move the joint over more of its range"
        key = f"cylinders.{joint}.linkage.{name}"
        estimates.append(Estimate.within(key, value, half, known, note))
    return changed(np.array([kept(value) for value in found.x])), estimates


def _is_angle(linkage: Linkage, name: str) -> bool:
    kind = declared(type(linkage))[name].rule.kind
    return kind is not None and kind.name == "angle"
