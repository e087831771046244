"""Exported tables: a twin of the Octave model function gives the stage costs of the kernels from the file alone."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from benchmarks import export_tables
from scipy.io import loadmat, savemat

from leanboom.dynamic_programming import bellman, grids
from leanboom.errors import InputError
from leanboom.io.loading import load_task
from leanboom.planning.planner import run
from leanboom.problem import layout, stage_arrays, stages

OCTAVE = Path(export_tables.__file__).parent / "octave"
GRID, STEP = (21, 11), 0.5


def model(par, k, c, w, u):
    """Twin of benchmarks/octave/leanboom_model.m, line by line; k from 0 on. Next state, cost [J], broken limits."""
    following = c + par["step"] * (w + 0.5 * par["step"] * u), w + par["step"] * u
    last = par["coefficients"].shape[1]
    x = np.minimum(np.maximum((c - par["c_lo"][k]) / par["dc"][k], 0), last - 1)
    i = np.minimum(np.floor(x), last - 2).astype(int)
    x = x - i

    def between(table):
        return (1 - x) * table[i] + x * table[i + 1]

    flow = par["fixed_flow"][k] * np.ones_like(c)
    pressure = par["fixed_pressure"][k] * np.ones_like(c)
    broken = between(par["outside"][k]) > 0
    for m in range(par["coefficients"].shape[2]):
        a0, a1, b0, b1, b2, b3, f0, f1, f2, f3, coulomb = (
            between(par["coefficients"][k, :, m, q]) for q in range(11)
        )  # fmt: skip
        v = a0 + a1 * w
        acceleration = b0 + w * (b1 + w * b2) + b3 * u
        force = f0 + w * (f1 + w * f2) + f3 * u
        force = force + coulomb * np.tanh(par["sharpness"][m] * v) + par["viscous"][m] * v
        broken = broken | (np.abs(v) > par["velocity_limit"][m])
        broken = broken | (np.abs(acceleration) > par["acceleration_limit"][m])
        flow = flow + np.maximum(par["area_out"][m] * v, -par["area_in"][m] * v)
        asked = (par["gain_out"][m] * force + par["back_out"][m]) * (v > par["epsilon"])
        asked = asked + (par["back_in"][m] - par["gain_in"][m] * force) * (v < -par["epsilon"])
        pressure = np.maximum(pressure, asked * (force * v > 0))
    supply = pressure + par["margin"] if par["pump"] == "ls" else par["supply_cp"]
    power = supply * flow / par["efficiency"] + par["idle"] + par["leak"] * supply + par["drag"] * flow * flow
    return following, par["step"] * power, broken


@pytest.mark.parametrize("name", ["forwarder-horizontal", "loader-triangle-small"])
@pytest.mark.parametrize("pump", ["ls", "cp"])
def test_costs_from_the_file_are_those_of_the_kernels(name, pump, tmp_path, rng):
    """At nodes of three stages, for random admissible controls: to rounding."""
    task = load_task(name)
    file = tmp_path / "tables.mat"
    export_tables.export(task, pump, GRID, STEP, file)
    par = loadmat(file, squeeze_me=True)
    problem = stages.discretise(task, STEP)
    table = grids.tables(problem, grids.full_grid(problem, *GRID), pump)
    setting = stage_arrays.setting(problem, pump, (0.0,) * 5)
    checked = 0
    for k in (1, problem.stages // 2, problem.stages - 1):
        w = table.stage[k, layout.W_LO] + table.stage[k, layout.DW] * np.arange(table.velocities)
        for p in range(GRID[0]):
            c = np.full_like(w, table.stage[k, layout.C_LO] + p * table.stage[k, layout.DC])
            row = bellman.empty_row(w.size, table.coefficients.shape[2], 2)
            node, lowest = table.coefficients[k, p], table.stage[k, layout.FIXED_PRESSURE]
            bellman.limit_controls(node, table.outside[k, p], w, k, table.stage, table.cylinder, setting, row)
            bellman.charge(node, w, k, table.stage, table.cylinder, setting, row)
            if pump == "ls":
                bellman.load_lines(node, w, table.cylinder, setting, lowest, row)
            low, high = row.state[bellman.LOW, : w.size], row.state[bellman.HIGH, : w.size]
            u = low + rng.uniform(0.01, 0.99, size=w.size) * (high - low)
            _, cost, broken = model(par, k, c, w, u)
            wanted = row.state[bellman.OFFSET, : w.size].copy()
            if pump == "ls":
                asked = [bellman.running_cost(u[j], j, pump == "ls", lowest, row.line) for j in range(w.size)]
                wanted += row.state[bellman.RATE, : w.size] * asked
            np.testing.assert_allclose(cost, wanted, rtol=1e-9, atol=1e-6)
            checked += int((~broken).sum())
    assert checked > 100


def test_limits_and_the_next_state(tmp_path):
    task = load_task("loader-triangle-small")
    file = tmp_path / "tables.mat"
    export_tables.export(task, "cp", GRID, STEP, file)
    par = loadmat(file, squeeze_me=True)
    c = np.array([par["c_lo"][3] + 4.5 * par["dc"][3]])
    (position, velocity), _, broken = model(par, 3, c, np.array([0.01]), np.array([0.02]))
    assert velocity == pytest.approx(0.01 + STEP * 0.02)
    assert position == pytest.approx(c + STEP * 0.01 + 0.5 * STEP**2 * 0.02)
    assert not broken[0]
    assert model(par, 3, c, np.array([0.0]), np.array([1.01 * par["acceleration_limit"][-1]]))[2][0]
    assert model(par, 3, c, np.array([1.01 * par["velocity_limit"][-1]]), np.array([0.0]))[2][0]


def test_every_number_has_a_unit_and_what_octave_reads_is_there(tmp_path):
    file = tmp_path / "tables.mat"
    export_tables.export(load_task("loader-triangle-small"), "cp", GRID, STEP, file)
    par = loadmat(file, squeeze_me=True)
    numbers = {name for name, value in par.items() if not name.startswith("__") and np.asarray(value).dtype.kind == "f"}
    assert numbers == set(export_tables.UNITS) == set(par["units"].dtype.names)
    assert len(export_tables.COLUMNS.split()) == len(export_tables.UNITS["coefficients"].split()) == par[
        "coefficients"
    ].shape[-1]  # fmt: skip
    text = "".join(path.read_text(encoding="utf-8") for path in sorted(OCTAVE.glob("*.m")))
    assert set(re.findall(r"\bpar\.(\w+)", text)) <= set(par)


def test_a_motion_that_comes_back_is_judged(tmp_path):
    task = load_task("loader-triangle-small", start="middle")
    plan = run(task, pump="cp", method="sns-actuator", baseline=False, check=False)
    file = tmp_path / "motion.mat"
    motion = plan.motion
    contents = {"task": task.name, "pump": "cp", "step": motion.step, "start": motion.position[0]}
    savemat(file, contents | {"velocity": motion.velocity})
    judged, pump = export_tables.judge(file)
    assert pump == "cp"
    assert judged.energy_cp == pytest.approx(plan.evaluation.energy_cp)


def test_a_free_start_cannot_be_exported(tmp_path):
    with pytest.raises(InputError, match="start = best"):
        export_tables.export(load_task("loader-triangle-small", start="best"), "cp", GRID, STEP, tmp_path / "t.mat")
