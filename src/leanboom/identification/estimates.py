"""Estimates with intervals: least squares whose errors hang together over time.

Residuals of filtered signals, and of a model that is not the machine, are neither independent nor of one size. Their
covariance is that of a jackknife over blocks of time: how the values change where a block is left out, to first order
(Bell and McCaffrey, Survey Methodology 28 (2002) 169). It assumes no more than that blocks are independent of each
other, and is no narrower where few blocks tell a value.

Weak priors at the draft's values keep in place what the data do not tell. A value counts as identifiable if the data
leave less than a twentieth of its prior variance, and its own is no larger.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from leanboom.identification.logs.checks import Finding
from leanboom.model.machine import Machine

Series = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # time, measured, model, whether used for fitting

BLOCK = 2.0  # [s]
CONFIDENCE = 0.95
KNOWN = 0.05  # share of the prior variance that may be left


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value found in data, in SI units."""

    name: str
    value: float
    low: float | None  # of the 95 % interval; None if the data do not tell
    high: float | None
    identifiable: bool
    note: str = ""  # which motion would tell it, or what it means

    @classmethod
    def within(cls, name: str, value: float, half: float, told: bool = True, note: str = "") -> Estimate:
        """A value in the middle of its interval.

        Args:
            name: Its name.
            value: The value.
            half: Half the width of the interval.
            told: Whether the data tell it; if not, it has no interval.
            note: Which motion would tell it, or what it means.
        """
        low, high = (float(value - half), float(value + half)) if told else (None, None)
        return cls(name, float(value), low, high, told, note)

    def json(self) -> dict[str, float | bool | None]:
        """What `--json` says of it."""
        ends = [None if end is None else float(end) for end in (self.low, self.high)]
        return {"value": float(self.value), "low": ends[0], "high": ends[1], "identifiable": bool(self.identifiable)}


@dataclass(frozen=True, slots=True)
class Fit:
    """How well a model repeats a signal that was not used for fitting it."""

    signal: str
    rms: float  # on validation data, in SI units
    rms_percent: float  # of the largest measured magnitude
    training_rms: float

    def json(self) -> dict[str, float]:
        """What `--json` says of it."""
        return {"rms": self.rms, "rms_percent": self.rms_percent}


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """What a fit found: of linkages, pump, valves, or cylinder forces."""

    machine: Machine  # the draft with what was found
    estimates: tuple[Estimate, ...]
    fits: tuple[Fit, ...] = ()
    series: Mapping[str, Series] = field(default_factory=dict)  # by signal
    remarks: tuple[str, ...] = ()
    faults: tuple[Finding, ...] = ()  # of the logs, that the fit showed
    tables: Mapping[str, np.ndarray] = field(default_factory=dict)  # by joint: velocity [m/s] and command, (points, 2)


def kept(value: float) -> float:
    """A value as a machine file keeps it: six digits, and nothing where it is next to nothing.

    Args:
        value: The value.
    """
    return 0.0 if abs(value) < 1e-9 else float(f"{value:.6g}")


def compare(signal: str, measured: np.ndarray, model: np.ndarray, training: np.ndarray) -> Fit:
    """A fit's errors.

    Args:
        signal: Its name.
        measured: Values, (samples,).
        model: Those of the model.
        training: Which samples were used for fitting.
    """
    error = measured - model
    scale = float(np.abs(measured).max()) or 1.0
    parts = [error[~training], error[training]]
    rms = [float(np.sqrt(np.mean(part * part))) if part.size else 0.0 for part in parts]
    if not parts[0].size:
        rms[0] = rms[1]
    return Fit(signal, rms[0], 100.0 * rms[0] / scale, rms[1])


def blocks_of(time: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Number of the block of time of every sample, rising from 0.

    Args:
        time: Times [s], (samples,).
        part: Uninterrupted parts, (samples,).
    """
    labels = np.stack([part, np.floor(time / BLOCK).astype(int)], axis=1)
    return np.unique(labels, axis=0, return_inverse=True)[1].reshape(-1)


def beginnings(part: np.ndarray, share: float) -> np.ndarray:
    """Mask of the first samples of every part, (samples,).

    Args:
        part: Uninterrupted parts, (samples,).
        share: How many of a part's samples.
    """
    found = np.zeros(part.size, bool)
    for each in np.unique(part):
        inside = np.flatnonzero(part == each)
        found[inside[: int(share * inside.size)]] = True
    return found


def covariance(
    jacobians: Sequence[np.ndarray], residuals: Sequence[np.ndarray], blocks: Sequence[np.ndarray], prior: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Covariance of weighted least squares, what the data alone say, and the factor of a 95 % interval.

    Args:
        jacobians: By groups of rows, (rows, parameters) each.
        residuals: (rows,) each.
        blocks: Block of each row, (rows,) each.
        prior: Inverse prior variances, (parameters,).

    Returns:
        Covariance, (parameters, parameters); posterior variance under independent errors of size 1, likewise; factor.
    """
    n = prior.size
    count = 1 + max((int(b.max()) for b in blocks if b.size), default=0)
    scores, shares = np.zeros((count, n)), np.zeros((count, n, n))
    for jacobian, residual, block in zip(jacobians, residuals, blocks, strict=True):
        np.add.at(scores, block, jacobian * residual[:, None])
        for each in np.unique(block):
            rows = jacobian[block == each]
            shares[each] += rows.T @ rows
    used = np.flatnonzero(np.any(scores != 0.0, axis=1))
    whole = shares.sum(axis=0) + np.diag(prior)
    changes = np.stack([np.linalg.pinv(whole - shares[k], hermitian=True) @ scores[k] for k in used])
    variance = changes.T @ changes * ((used.size - 1) / max(used.size, 1))
    return variance, np.linalg.pinv(whole, hermitian=True), interval_factor(used.size - n)


def robust(residual: np.ndarray) -> np.ndarray:
    """Residuals to go with the derivatives that `least_squares` gives for its loss `soft_l1`: products are scores.

    Args:
        residual: In units of the loss's scale, (rows,).
    """
    return residual * (1.0 + residual**2) ** 0.25


def interval_factor(freedom: int) -> float:
    """Student's factor of a two-sided 95 % interval.

    Args:
        freedom: Degrees of freedom; few are counted as 3.
    """
    from scipy.stats import t

    return float(t.ppf(0.5 + 0.5 * CONFIDENCE, max(freedom, 3)))


def linear_fit(
    columns: np.ndarray, values: np.ndarray, blocks: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Least squares of values on columns none of whose coefficients is below zero.

    Args:
        columns: (samples, coefficients).
        values: (samples,).
        blocks: Block of each sample.

    Returns:
        Coefficients; half widths of their intervals; covariance.
    """
    from scipy.optimize import lsq_linear

    scale = np.linalg.norm(columns, axis=0)
    scale[scale == 0.0] = 1.0
    found = lsq_linear(columns / scale, values, bounds=(0.0, np.inf)).x / scale
    residual = values - columns @ found
    variance, _, factor = covariance([columns], [residual], [blocks], np.full(found.size, 0.0))
    return found, factor * np.sqrt(np.diag(variance)), variance
