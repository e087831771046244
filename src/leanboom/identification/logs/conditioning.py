"""Logs made ready for fits: one rate, filtered without phase, differentiated, and what was done said.

All channels pass the same Butterworth low pass forwards and backwards, so that none is late against another. Its
cut-off is the frequency at which the first position's spectrum comes near its noise, unless one is given.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from leanboom.errors import InputError
from leanboom.identification.logs.checks import Checked
from leanboom.model.machine import Machine

ORDER = 4  # of the low pass, once each way
RATE = 200.0  # [Hz], most; crane motions are below 20 Hz
CUTOFFS = 2.0, 10.0  # [Hz], least and most that is chosen from the data
ABOVE_NOISE = 25.0  # times the noise's spectral density: beyond, accelerations are noise, which makes inertias small
LEAST_PART = 4.0  # [s], shorter parts between gaps are left out


@dataclass(frozen=True, slots=True, eq=False)
class Data:
    """All logs at one rate. Arrays are (samples,); parts follow each other."""

    rate: float  # [Hz]
    cutoff: float  # [Hz]
    time: np.ndarray  # [s], of its own log
    part: np.ndarray  # number of the uninterrupted part
    inner: np.ndarray  # away from the ends of its part, where the filter is not trusted
    channels: Mapping[str, np.ndarray]  # filtered; commands as they are
    raw: Mapping[str, np.ndarray]  # resampled only
    rates: Mapping[str, np.ndarray]  # first derivatives of positions and lengths, and of pump_volume
    accelerations: Mapping[str, np.ndarray]
    usable: Mapping[str, np.ndarray]  # by joint
    said: tuple[str, ...]

    def low_pass(self, values: np.ndarray) -> np.ndarray:
        """Values that passed the filter of the measured channels.

        Args:
            values: Over all parts, (samples,).
        """
        return np.concatenate([_filter(part, self.rate, self.cutoff) for part in self.split(values)])

    def slope(self, values: np.ndarray) -> np.ndarray:
        """Derivatives of values by time, in each part by itself.

        Args:
            values: Over all parts, (samples,).
        """
        return np.concatenate([np.gradient(part, 1.0 / self.rate) for part in self.split(values)])

    def split(self, values: np.ndarray) -> list[np.ndarray]:
        """Values by parts.

        Args:
            values: Over all parts, (samples,).
        """
        return np.split(values, np.flatnonzero(np.diff(self.part)) + 1)


def condition(logs: Sequence[Checked], machine: Machine, cutoff: float | None = None) -> Data:
    """Resample, filter and differentiate logs.

    Args:
        logs: The checked logs.
        machine: The machine.
        cutoff: Of the low pass [Hz]; None: from the data.

    Raises:
        InputError: No part is long enough, or the logs share no channel.
    """
    shared = set.intersection(*(set(log.signals) for log in logs))
    names = sorted(shared)
    rate = min(RATE, *(1.0 / float(np.median(np.diff(log.log.time))) for log in logs))
    parts: list[dict[str, np.ndarray]] = []
    skipped = 0
    for checked in logs:
        edges = [0, *checked.breaks.tolist(), checked.log.time.size]
        for begin, end in zip(edges[:-1], edges[1:], strict=True):
            here = slice(begin, end)
            time = checked.log.time[here]
            if time[-1] - time[0] < LEAST_PART:
                skipped += 1
                continue
            parts.append(_resampled(checked, here, names, machine, rate))
    if not parts:
        raise InputError(f"log = {logs[0].log.file}; must have an uninterrupted part of at least {LEAST_PART:g} s")
    positions = [name for name in names if name.endswith("_position")]
    chosen = cutoff or _cutoff([part[name] for part in parts for name in positions], rate)
    if not 0.1 <= chosen <= 0.4 * rate:
        raise InputError(f"cutoff = {chosen:g} Hz; must be 0.1 to {0.4 * rate:g} Hz at {rate:g} samples a second")
    channels, unfiltered, rates, accelerations = {}, {}, {}, {}
    for name in names:
        raw = [part[name] for part in parts]
        unfiltered[name] = np.concatenate(raw)
        smooth = raw if name.endswith("_command") else [_filter(values, rate, chosen) for values in raw]
        channels[name] = np.concatenate(smooth)
        if name.endswith(("_position", "_cylinder")) or name == "pump_volume":
            first = [np.gradient(values, 1.0 / rate) for values in smooth]
            rates[name] = np.concatenate(first)
            accelerations[name] = np.concatenate([np.gradient(values, 1.0 / rate) for values in first])
    inner = []
    for part in parts:
        ends = np.zeros(part["time"].size, bool)
        margin = round(rate / chosen)
        ends[margin:-margin] = True
        inner.append(ends)
    how = "given" if cutoff else "where the first position's spectrum comes near its noise"
    said = (
        f"{len(logs)} logs, {sum(p['time'].size for p in parts) / rate:.1f} s in {len(parts)} uninterrupted parts, "
        f"resampled to {rate:g} Hz by linear interpolation"
        + (f"; {skipped} parts shorter than {LEAST_PART:g} s left out" if skipped else ""),
        f"low pass without phase: Butterworth of order {ORDER}, once each way, cut-off {chosen:.3g} Hz ({how})",
        "velocities and accelerations: central differences of the filtered positions; commands are not filtered",
    )
    return Data(
        rate=rate, cutoff=chosen,
        time=np.concatenate([part["time"] for part in parts]),
        part=np.concatenate([np.full(part["time"].size, i) for i, part in enumerate(parts)]),
        inner=np.concatenate(inner), channels=channels, raw=unfiltered, rates=rates, accelerations=accelerations,
        usable={joint: np.concatenate([part[f"usable {joint}"] for part in parts]) > 0.99 for joint in machine.names},
        said=said,
    )  # fmt: skip


def _resampled(
    checked: Checked, here: slice, names: Sequence[str], machine: Machine, rate: float
) -> dict[str, np.ndarray]:
    from scipy.signal import butter, sosfiltfilt

    time = checked.log.time[here]
    new = time[0] + np.arange(int((time[-1] - time[0]) * rate) + 1) / rate
    own = 1.0 / float(np.median(np.diff(time)))
    found = {"time": new}
    alias = butter(ORDER, 0.4 * rate, fs=own, output="sos") if own > 1.5 * rate else None
    for name in names:
        values = checked.signals[name][here]
        if alias is not None and not name.endswith("_command"):
            values = sosfiltfilt(alias, values)
        found[name] = np.interp(new, time, values)
    for joint in machine.names:
        found[f"usable {joint}"] = np.interp(new, time, checked.usable[joint][here].astype(np.float64))
    return found


def _filter(values: np.ndarray, rate: float, cutoff: float) -> np.ndarray:
    from scipy.signal import sosfiltfilt

    return sosfiltfilt(_designed(rate, cutoff), values)


@lru_cache
def _designed(rate: float, cutoff: float) -> np.ndarray:
    """The low pass; a fit asks for the same one hundreds of times."""
    from scipy.signal import butter

    return np.asarray(butter(ORDER, cutoff, fs=rate, output="sos"))


def _cutoff(positions: Sequence[np.ndarray], rate: float) -> float:
    """Where the spectra of positions come near their noise, the lowest of them [Hz]: one filter serves all channels."""
    from scipy.signal import welch

    least, most = CUTOFFS
    most = min(most, 0.4 * rate)
    found = most
    for values in positions:
        if np.ptp(values) == 0.0:
            continue
        frequency, density = welch(values, fs=rate, nperseg=min(values.size, round(8 * rate)), detrend="linear")
        high = (frequency > 0.4 * frequency[-1]) & (frequency < 0.7 * frequency[-1])  # below the anti-alias filter
        noise = float(np.median(density[high]))
        below = frequency[density < ABOVE_NOISE * noise]
        found = min(found, float(below[0]) if below.size else most)
    return max(found, least)
