"""Plain twins of the kernels: the obvious version of each, one state at a time, every control tried.

Written from the formulas, not from the kernels: a stage's cost is worked out for all controls of a fine set, and
the corners of the piecewise linear problem are added to that set. Slow, and meant to be read.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from leanboom.dynamic_programming import bellman
from leanboom.problem import layout

COSTS = ("ls", "cp", "actuator", "velocity", "extension", "recuperation")
BESIDE = 1e-7  # corners are tried this far on either side of a switch [m/s^2]


@dataclass(frozen=True)
class Small:
    """A problem as the kernels see it; arrays as in `sweeps.sweep`."""

    coefficients: np.ndarray  # (stages + 1, positions, moving, layout.COEFFICIENTS)
    outside: np.ndarray  # [m], (stages + 1, positions)
    stage: np.ndarray  # (stages + 1, layout.STAGE_COLUMNS)
    cylinder: np.ndarray  # (moving, layout.CYLINDER_COLUMNS)
    setting: np.ndarray  # (layout.SETTINGS,)
    terminal: np.ndarray  # (positions, velocities)
    cost: str = field(default="")

    @property
    def stages(self) -> int:
        return self.stage.shape[0] - 1

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """The first arguments of every kernel."""
        return self.coefficients, self.outside, self.stage, self.cylinder, self.setting

    def position(self, k: int, p: int) -> float:
        return float(self.stage[k, layout.C_LO] + p * self.stage[k, layout.DC])

    def velocity(self, k: int, j: int) -> float:
        return float(self.stage[k, layout.W_LO] + j * self.stage[k, layout.DW])


def along_axis(first: float, spacing: float, count: int, value: np.ndarray, slope: float):
    """Cell, share within it and penalty of values on one axis of equally spaced nodes."""
    inside = np.clip(value, first, first + spacing * (count - 1))
    cell = np.clip(np.floor((inside - first) / spacing), 0, count - 2).astype(int)
    share = (inside - first) / spacing - cell
    return cell, share, slope * np.abs(value - inside)


def interpolate(small: Small, ahead: np.ndarray, k: int, c, w) -> np.ndarray:
    """Weighted mean of the four nodes around (c, w), plus what being outside the grid costs."""
    s = small.stage[k]
    c, w = np.broadcast_arrays(np.asarray(c, dtype=float), np.asarray(w, dtype=float))
    i, x, off_c = along_axis(s[layout.C_LO], s[layout.DC], ahead.shape[0], c, small.setting[layout.SLOPE_C])
    j, y, off_w = along_axis(s[layout.W_LO], s[layout.DW], ahead.shape[1], w, small.setting[layout.SLOPE_W])
    mean = sum(
        weight * ahead[i + di, j + dj]
        for di, dj, weight in ((0, 0, (1 - x) * (1 - y)), (0, 1, (1 - x) * y), (1, 0, x * (1 - y)), (1, 1, x * y))
    )
    return mean + off_c + off_w


def state_of_cylinders(row: np.ndarray, w: float, u: np.ndarray):
    """Velocity, acceleration and force without friction of every cylinder, (moving, controls) each."""
    one = np.ones_like(u)
    v = np.stack([(q[layout.A0] + q[layout.A1] * w) * one for q in row])
    powers = (1.0, w, w * w)
    a = np.stack([sum(q[layout.B0 + n] * powers[n] for n in range(3)) + q[layout.B3] * u for q in row])
    f = np.stack([sum(q[layout.F0 + n] * powers[n] for n in range(3)) + q[layout.F3] * u for q in row])
    return v, a, f


def power(small: Small, k: int, row: np.ndarray, w: float, u: np.ndarray) -> np.ndarray:
    """What a stage costs per second for controls u, limits aside."""
    v, _, f = state_of_cylinders(row, w, u)
    s = small.setting
    flow = np.full(u.shape, small.stage[k, layout.FIXED_FLOW])
    pressure = np.full(u.shape, small.stage[k, layout.FIXED_PRESSURE])
    work = np.zeros(u.shape)
    for i, data in enumerate(small.cylinder):
        force = f[i] + row[i, layout.COULOMB] * np.tanh(data[layout.SHARPNESS] * v[i]) + data[layout.VISCOUS] * v[i]
        work += np.where(force * v[i] > 0.0, force * v[i], 0.0)
        if small.cost == "recuperation":
            flow += v[i] * data[layout.AREA_OUT]  # piston side less rod side
        else:
            flow += np.where(v[i] > 0.0, data[layout.AREA_OUT] * v[i], data[layout.AREA_IN] * -v[i])
        extending = data[layout.GAIN_OUT] * force + data[layout.BACK_OUT]
        retracting = -data[layout.GAIN_IN] * force + data[layout.BACK_IN]
        asked = np.where(v[i] > 0.0, extending, retracting)
        counts = (np.abs(v[i]) > s[layout.EPSILON]) & (force * v[i] > 0.0)
        pressure = np.where(counts, np.maximum(pressure, asked), pressure)
    supply = s[layout.SUPPLY] + (pressure if small.cost == "ls" else np.zeros(u.shape))
    pump = supply * flow / s[layout.EFFICIENCY] + s[layout.LEAK] * supply
    pump += s[layout.IDLE] + s[layout.DRAG] * flow**2
    answers = {
        "ls": pump,
        "cp": pump,
        "actuator": work,
        "velocity": (v * v).sum(axis=0),
        "extension": v[-1] ** 2,
        "recuperation": pump,
    }
    return answers[small.cost] + small.stage[k, layout.FIXED_COST]


def admissible(small: Small, k: int, row: np.ndarray, w: float, velocities: int) -> tuple[float, float, float]:
    """Least and largest control that keeps all acceleration limits, and what violated limits cost anyway."""
    s = small.setting
    v, a, _ = state_of_cylinders(row, w, np.zeros(1))
    low, high, cost = -np.inf, np.inf, 0.0
    for i, data in enumerate(small.cylinder):
        cost += s[layout.SLOPE_V] * max(0.0, abs(float(v[i, 0])) - data[layout.V_MAX])
        gain, rest, limit = row[i, layout.B3], float(a[i, 0]), data[layout.A_MAX]
        if abs(gain) <= bellman.MIN_GAIN:
            cost += s[layout.SLOPE_A] * max(0.0, abs(rest) - limit)
            continue
        ends = sorted([(-limit - rest) / gain, (limit - rest) / gain])
        low, high = max(low, ends[0]), min(high, ends[1])
    taken = sum(max(d[layout.FLOW_OUT] * v[i, 0], -d[layout.FLOW_IN] * v[i, 0]) for i, d in enumerate(small.cylinder))
    cost += s[layout.SLOPE_F] * max(0.0, taken - small.stage[k, layout.MOST_FLOW])
    if low > high:
        cost += s[layout.SLOPE_A] * (low - high)
        low = high = 0.5 * (low + high)
    # The next stage's velocity nodes, where there is a control that reaches them.
    ts, first = s[layout.STEP], small.velocity(k + 1, 0)
    reach = (first - w) / ts, (small.velocity(k + 1, velocities - 1) - w) / ts
    if max(low, reach[0]) <= min(high, reach[1]):
        low, high = max(low, reach[0]), min(high, reach[1])
    return low, high, cost


def corners(small: Small, k: int, row: np.ndarray, w: float, velocities: int) -> np.ndarray:
    """Controls where the slope of cost plus value can change, velocity nodes and ends included."""
    low, high, _ = admissible(small, k, row, w, velocities)
    found = [low, high]
    found += [(small.velocity(k + 1, j) - w) / small.setting[layout.STEP] for j in range(velocities)]
    if small.cost in ("ls", "actuator"):
        v, _, f = state_of_cylinders(row, w, np.array([0.0, 1.0]))
        lines = [(0.0, small.stage[k, layout.FIXED_PRESSURE])]
        for i, data in enumerate(small.cylinder):
            speed = v[i, 0]
            force = f[i] + row[i, layout.COULOMB] * np.tanh(data[layout.SHARPNESS] * speed)
            force = force + data[layout.VISCOUS] * speed
            if force[1] != force[0]:
                switch = -force[0] / (force[1] - force[0])
                found += [switch - BESIDE, switch + BESIDE]
            out = speed > 0.0
            gain = data[layout.GAIN_OUT] if out else -data[layout.GAIN_IN]
            back = data[layout.BACK_OUT] if out else data[layout.BACK_IN]
            lines.append((gain * (force[1] - force[0]), gain * force[0] + back))
        found += (
            []
            if small.cost == "actuator"
            else [
                (b1 - b0) / (a0 - a1)
                for n, (a0, b0) in enumerate(lines)
                for a1, b1 in lines[n + 1 :]
                if abs(a0 - a1) > 0.0
            ]
        )
    u = np.array(found)
    return u[(u >= low) & (u <= high)]


def costs_of(small: Small, k: int, row: np.ndarray, outside: float, c: float, w: float, u: np.ndarray, ahead):
    """Stage cost with penalties plus value ahead of controls u, (controls,)."""
    ts = small.setting[layout.STEP]
    _, _, penalty = admissible(small, k, row, w, ahead.shape[1])
    penalty += small.setting[layout.SLOPE_C] * outside
    after = interpolate(small, ahead, k + 1, c + ts * w + 0.5 * ts * ts * u, w + ts * u)
    return ts * power(small, k, row, w, u) + penalty + after


def least(small: Small, k: int, row, outside: float, c: float, w: float, ahead, fine: int = 400) -> tuple[float, float]:
    """Least cost over `fine` equally spaced controls and the corners, and a control that has it."""
    low, high, _ = admissible(small, k, row, w, ahead.shape[1])
    u = np.concatenate([np.linspace(low, high, fine), corners(small, k, row, w, ahead.shape[1])])
    cost = costs_of(small, k, row, outside, c, w, u, ahead)
    return float(cost.min()), float(u[cost.argmin()])


def sweep(small: Small, fine: int = 400) -> np.ndarray:
    """Values of all stages, (stages + 1, positions, velocities)."""
    positions, velocities = small.terminal.shape
    values = np.empty((small.stages + 1, positions, velocities))
    values[-1] = small.terminal
    for k in reversed(range(small.stages)):
        for p in range(positions):
            for j in range(velocities):
                values[k, p, j], _ = least(
                    small, k, small.coefficients[k, p], small.outside[k, p], small.position(k, p),
                    small.velocity(k, j), values[k + 1], fine,
                )  # fmt: skip
    return values


def row_at(small: Small, k: int, c: float) -> tuple[np.ndarray, float]:
    """Coefficients and distance outside at a position between nodes; beyond the ends, those of the end."""
    nodes = small.stage[k, layout.C_LO] + small.stage[k, layout.DC] * np.arange(small.outside.shape[1])
    flat = small.coefficients[k].reshape(nodes.size, -1)
    row = np.array([np.interp(c, nodes, column) for column in flat.T]).reshape(small.coefficients.shape[2:])
    return row, float(np.interp(c, nodes, small.outside[k]))


def cost_of_controls(small: Small, c: float, w: float, controls: np.ndarray) -> float:
    """Sum of the stage costs with penalties of a motion given by its controls."""
    ts, total = small.setting[layout.STEP], 0.0
    for k, u in enumerate(controls):
        row, outside = row_at(small, k, c)
        _, _, penalty = admissible(small, k, row, w, small.terminal.shape[1])
        total += ts * float(power(small, k, row, w, np.array([u]))[0])
        total += penalty + small.setting[layout.SLOPE_C] * outside
        c, w = c + ts * w + 0.5 * ts * ts * u, w + ts * u
    return total
