"""The one result every method returns: how the redundant cylinder moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


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
    status: str = "solved"  # "solved", or a sentence naming what is violated, where, when, by how much
    solve_s: float = 0.0  # wall time of solving [s], compilation excluded where it was known
    log: tuple[str, ...] = ()  # how the result came about, one line a step
    lead: float | None = None  # length of the first interval [s], above 0 and up to `step`; None: `step`

    def __repr__(self) -> str:
        return headed(
            self.status,
            f"Motion({self.method} minimising {self.cost}: {self.position.size - 1} stages of {self.step:g} s, "
            f"{self.position[0]:.4f} m -> {self.position[-1]:.4f} m, {self.status})",
        )

    @property
    def duration(self) -> float:
        """How long the motion lasts [s]."""
        return self.step * self.acceleration.size - self._late

    @property
    def _late(self) -> float:
        """How much shorter than the others the first interval is [s]."""
        return 0.0 if self.lead is None else self.step - self.lead

    def at(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position [m], velocity [m/s] and acceleration [m/s^2] at times [s]; the ends are held outside.

        Accelerations at a stage are those of the interval that begins there (the last one at the end).
        """
        late = self._late
        time = np.clip(np.asarray(time, dtype=np.float64), 0.0, self.duration) + late
        stage = np.minimum((time / self.step + 1e-9).astype(np.int64), self.acceleration.size - 1)
        dt = time - np.maximum(stage * self.step, late)
        u = self.acceleration[stage]
        w = self.velocity[stage]
        return self.position[stage] + dt * (w + 0.5 * dt * u), w + dt * u, u


def headed(status: str, text: str) -> str:
    """What a result prints as: what it is, behind NOT SOLVED and the reason where it is none."""
    return text if status == "solved" else f"NOT SOLVED: {status}. {text}"


def from_positions(step: float, position: np.ndarray, method: str, cost: str, **fields) -> Motion:
    """The Motion that starts at rest and passes through given stage positions [m], (stages + 1,)."""
    position = np.asarray(position, dtype=np.float64)
    velocity = np.zeros_like(position)
    for k in range(position.size - 1):
        velocity[k + 1] = 2.0 * (position[k + 1] - position[k]) / step - velocity[k]
    return from_velocities(step, float(position[0]), velocity, method, cost, **fields)


def from_velocities(step: float, start: float, velocity: np.ndarray, method: str, cost: str, **fields) -> Motion:
    """The Motion with given start [m] and stage velocities [m/s], (stages + 1,)."""
    velocity = np.asarray(velocity, dtype=np.float64)
    acceleration = np.diff(velocity) / step
    position = start + np.concatenate([[0.0], np.cumsum(0.5 * step * (velocity[1:] + velocity[:-1]))])
    return make(step, position, velocity, acceleration, method, cost, **fields)


def make(step, position, velocity, acceleration, method: str, cost: str, **fields) -> Motion:
    """A Motion whose arrays are float64, contiguous and read-only."""
    arrays = [np.array(a, dtype=np.float64, order="C") for a in (position, velocity, acceleration)]
    for array in arrays:
        array.setflags(write=False)
    return Motion(float(step), *arrays, method=method, cost=cost, **fields)
