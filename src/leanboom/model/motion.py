"""Motion of the redundant cylinder, the result of every method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leanboom.errors import InputError
from leanboom.model import outcome
from leanboom.model.outcome import SOLVED, Outcome
from leanboom.quantities import ranges

_STEP = ranges.Range("time", above=0)
_ARRAYS = ("position", "velocity", "acceleration")
STAGE_HIT = 1e-9  # times this close before a stage, relative to a step, are the stage's
EVEN = 1e-9  # [s], stages that are equally spaced up to this are


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Motion of the redundant cylinder: acceleration piecewise constant between equally spaced stages.

    position[k+1] = position[k] + step velocity[k] + step^2 acceleration[k] / 2 and
    velocity[k+1] = velocity[k] + step acceleration[k], exactly, so the samples are the continuous motion. Only a motion
    taken up between two stages has a first interval of another length, `lead`.
    """

    step: float  # Ts [s]
    position: np.ndarray  # extension of the redundant cylinder beyond its retracted length [m], (stages + 1,)
    velocity: np.ndarray  # [m/s], (stages + 1,)
    acceleration: np.ndarray  # [m/s^2], (stages,)
    method: str  # which method made it, e.g. "dp"
    cost: str  # what that method minimised, e.g. "ls"
    status: Outcome = SOLVED  # "solved", or a sentence naming what is violated, where, when, by how much
    solve_s: float = 0.0  # wall time of solving [s], compilation excluded where it was known
    log: tuple[str, ...] = ()  # how the result came about, one line a step
    lead: float | None = None  # length of the first interval [s], above 0 and up to `step`; None: `step`
    times: np.ndarray | None = None  # of the stages [s], (stages + 1,), rising from 0; None: `step` apart

    def __post_init__(self) -> None:
        ranges.hold(self, "motion", step=_STEP)
        object.__setattr__(self, "status", outcome.read(self.status))
        for name in _ARRAYS:
            object.__setattr__(self, name, _kept(name, getattr(self, name)))
        count = self.acceleration.size
        if count < 1 or self.position.size != count + 1 or self.velocity.size != count + 1:
            raise InputError(
                f"motion has {self.position.size} positions, {self.velocity.size} velocities and {count} "
                "accelerations; must have at least one acceleration, and one more of each of the others"
            )
        if self.lead is not None:
            ranges.hold(self, "motion", lead=ranges.Range("time", above=0, most=self.step))
        if self.times is not None:
            times = _kept("times", self.times)
            if times.size != count + 1 or times[0] != 0.0 or not np.all(np.diff(times) > 0.0):
                raise InputError(f"motion.times; must be {count + 1} times, one for each position, rising from 0")
            object.__setattr__(self, "times", times)

    def __repr__(self) -> str:
        return self.status.head(
            f"Motion({self.method} minimising {self.cost}: {self.position.size - 1} stages of {self.step:g} s, "
            f"{self.position[0]:.4f} m -> {self.position[-1]:.4f} m, {self.status})",
        )

    @property
    def duration(self) -> float:
        """Duration [s]."""
        if self.times is not None:
            return float(self.times[-1])
        return self.step * self.acceleration.size - self._late

    @property
    def breaks(self) -> np.ndarray:
        """Times where the stages meet, both ends included [s]."""
        if self.times is not None:
            return self.times
        return np.maximum(self.step * np.arange(self.acceleration.size + 1) - self._late, 0.0)

    @property
    def _late(self) -> float:
        """Time by which the first interval is shorter than the others [s]."""
        return 0.0 if self.lead is None else self.step - self.lead

    def at(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position [m], velocity [m/s] and acceleration [m/s^2] at times [s]; the ends are held outside.

        Accelerations at a stage are those of the interval that begins there (the last one at the end).
        """
        late = self._late
        time = np.clip(np.asarray(time, dtype=np.float64), 0.0, self.duration) + late
        if self.times is None:
            stage = np.minimum((time / self.step + 1e-9).astype(np.int64), self.acceleration.size - 1)
            dt = time - np.maximum(stage * self.step, late)
        else:
            stage = np.searchsorted(self.times[1:-1], time + STAGE_HIT * self.step, side="right")
            dt = time - self.times[stage]
        u = self.acceleration[stage]
        w = self.velocity[stage]
        return self.position[stage] + dt * (w + 0.5 * dt * u), w + dt * u, u


def from_positions(step: float, position: np.ndarray, method: str, cost: str, **fields) -> Motion:
    """The Motion that starts at rest and passes through given stage positions [m], (stages + 1,).

    Raises:
        InputError: If the step is not above 0, or a position no finite number.
    """
    step, position = ranges.checked("motion.step", step, _STEP), _kept("position", position)
    velocity = np.zeros_like(position)
    for k in range(position.size - 1):
        velocity[k + 1] = 2.0 * (position[k + 1] - position[k]) / step - velocity[k]
    return from_velocities(step, float(position[0]), velocity, method, cost, **fields)


def from_velocities(step: float, start: float, velocity: np.ndarray, method: str, cost: str, **fields) -> Motion:
    """The Motion with given start [m] and stage velocities [m/s], (stages + 1,).

    Raises:
        InputError: If the step is not above 0, or the start or a velocity no finite number.
    """
    step, velocity = ranges.checked("motion.step", step, _STEP), _kept("velocity", velocity)
    acceleration = np.diff(velocity) / step
    moved = np.concatenate([[0.0], np.cumsum(0.5 * step * (velocity[1:] + velocity[:-1]))])
    return Motion(step, start + moved, velocity, acceleration, method, cost, **fields)


def from_velocities_at(times: np.ndarray, start: float, velocity: np.ndarray, method: str, cost: str) -> Motion:
    """The Motion with given start [m] and velocities [m/s] at times rising from 0 [s], (stages + 1,) both."""
    steps = np.diff(times)
    moved = np.concatenate([[0.0], np.cumsum(0.5 * steps * (velocity[1:] + velocity[:-1]))])
    return Motion(
        float(steps.max()), start + moved, velocity, np.diff(velocity) / steps, method, cost, times=times,
    )  # fmt: skip


def ending_at(moved: Motion, end: float) -> Motion:
    """A motion led smoothly to another end [m], from its start: velocities change by a parabola over its time."""
    if moved.position[-1] == end or moved.acceleration.size < 2:
        return moved
    steps = np.diff(moved.breaks)
    share = moved.breaks / moved.duration
    bump = share * (1.0 - share)
    covered = np.sum(0.5 * steps * (bump[1:] + bump[:-1]))
    velocity = moved.velocity + (end - moved.position[-1]) / covered * bump
    position = moved.position[0] + np.concatenate([[0.0], np.cumsum(0.5 * steps * (velocity[1:] + velocity[:-1]))])
    return replace(moved, position=position, velocity=velocity, acceleration=np.diff(velocity) / steps)


def joined(parts: Sequence[Motion]) -> Motion:
    """Motions one after the other as one, with the method and the cost of the first.

    Args:
        parts: The motions, each from where the one before it ends.
    """
    if len(parts) == 1:
        return parts[0]
    begins = np.concatenate([[0.0], np.cumsum([part.duration for part in parts])])
    times = [begin + part.breaks[1:] for begin, part in zip(begins[:-1], parts, strict=True)]
    first = parts[0]
    return Motion(
        max(part.step for part in parts),
        np.concatenate([first.position, *(part.position[1:] for part in parts[1:])]),
        np.concatenate([first.velocity, *(part.velocity[1:] for part in parts[1:])]),
        np.concatenate([part.acceleration for part in parts]),
        first.method,
        first.cost,
        times=np.concatenate([[0.0], *times]),
    )


def between(whole: Motion, since: float, until: float) -> Motion:
    """The part of a motion between two of its times [s], on a clock of its own; its states are those of the motion."""
    inner = whole.breaks[(whole.breaks > since + EVEN) & (whole.breaks < until - EVEN)]
    breaks = np.concatenate([[since], inner, [until]])
    position, velocity, _ = whole.at(breaks)
    middle = 0.5 * (breaks[1:] + breaks[:-1])
    acceleration = whole.at(middle)[2]
    times = breaks - since
    step = times[-1] / acceleration.size
    even = np.all(np.abs(times - step * np.arange(times.size)) < EVEN)
    return replace(
        whole, step=step if even else float(np.diff(times).max()), position=position, velocity=velocity,
        acceleration=acceleration, lead=None, times=None if even else times,
    )  # fmt: skip


def held(position: float, duration: float, method: str, cost: str) -> Motion:
    """The motion that stays at a position [m] for a time [s]."""
    return Motion(duration, np.full(2, position), np.zeros(2), np.zeros(1), method, cost)


def make(step, position, velocity, acceleration, method: str, cost: str, **fields) -> Motion:
    """The Motion of stage positions [m], velocities [m/s], both (stages + 1,), and accelerations [m/s^2], (stages,).

    Raises:
        InputError: If the step is not above 0, a number not finite, or the arrays do not fit together.
    """
    return Motion(step, position, velocity, acceleration, method, cost, **fields)


def _kept(name: str, values: object) -> np.ndarray:
    """An array of a motion as it is kept: float64, contiguous, read-only and finite."""
    try:
        array = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"motion.{name} = {ranges.shown(values)}; must be an array of numbers") from None
    if array.ndim != 1:
        raise InputError(f"motion.{name} has the shape {array.shape}; must have one axis, the stages")
    if not np.isfinite(array).all():
        k = int(np.argmin(np.isfinite(array)))
        raise InputError(f"motion.{name} = {array[k]} at stage {k}; must be finite")
    if array.flags.writeable:
        array = array.copy()
        array.setflags(write=False)
    return array
