"""Shaft power of the pump: fits against known losses and interpolated tables, one formula for all its users, files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import njit
from scipy.interpolate import RegularGridInterpolator
from typer.testing import CliRunner

import leanboom
from leanboom.cli.app import app
from leanboom.components.costs import COSTS
from leanboom.components.pump_power import ALLOWED, Shaft, at_speed, fit, shaft_of
from leanboom.components.pumps import EfficiencyMap
from leanboom.errors import InputError
from leanboom.evaluation.evaluate import evaluate, judged_cost
from leanboom.formulas import hydraulics
from leanboom.formulas.formula import enable_in_kernels
from leanboom.io.loading import dump_machine, json_schema, load_machine, load_task
from leanboom.methods import smoothed_nlp
from leanboom.model import cost_rates
from leanboom.model import crane as cranes
from leanboom.model.machine import Machine
from leanboom.model.motion import from_velocities
from leanboom.model.task import Lines, Task, sample
from leanboom.planning.planner import run
from leanboom.problem import cost_scale, layout, stage_arrays, stages
from leanboom.report import facts

PUMP = Shaft(0.96, 450.0, 3e-5, 4e8)  # of 81 l/min: idle 0.45 kW, 0.6 kW at 20 MPa, 0.7 kW at full flow
FLOW, PRESSURE = st.floats(0.0, 1.35e-3), st.floats(0.0, 25e6)
DISPLACEMENTS = tuple(45e-6 * share for share in (0.1, 0.25, 0.5, 0.75, 1.0))
PRESSURES = (4e6, 8e6, 14e6, 20e6, 25e6)
enable_in_kernels()


def table(shaft: Shaft, speed: float, displacements=DISPLACEMENTS, pressures=PRESSURES):
    """Efficiencies of a pump with known losses: rows displacements, columns pressures."""
    flow, p = np.meshgrid(speed * np.array(displacements), pressures, indexing="ij")
    power = p * flow / shaft.efficiency + shaft.idle + shaft.leak * p + shaft.drag * flow**2
    return tuple(map(tuple, (p * flow / power).tolist()))


def known(shaft: Shaft = PUMP, speed: float = 30.0) -> EfficiencyMap:
    """The map of a pump with known losses, measured at one speed."""
    return EfficiencyMap(speed, (speed,), DISPLACEMENTS, PRESSURES, (table(shaft, speed),))


def real() -> EfficiencyMap:
    """A map that is no polynomial: leakage that grows with pressure, so a loss in proportion to p^2, and rounding."""
    flow, p = np.meshgrid(30.0 * np.array(DISPLACEMENTS), PRESSURES, indexing="ij")
    power = 1.01 * p * (flow + 5e-13 * p) + 700.0 + 1.4e-5 * p
    rows = np.round(p * flow / power, 3).tolist()
    return EfficiencyMap(30.0, (30.0,), DISPLACEMENTS, PRESSURES, (tuple(map(tuple, rows)),))


def with_map(task: Task, efficiency: EfficiencyMap | float) -> Task:
    pump = replace(task.machine.pump, efficiency=efficiency)
    return replace(task, machine=replace(task.machine, pump=pump))


SHORT = replace(
    with_map(load_task("loader-triangle-small"), known()),
    start="middle",
    path=Lines(((2.6, 0.0, 0.5), (3.2, 0.0, 1.1667)), (6.0,)),
)


# The fit


@given(
    efficiency=st.floats(0.85, 0.99),
    idle=st.floats(0.0, 900.0),
    leak=st.floats(0.0, 6e-5),
    drag=st.floats(0.0, 9e8),
)
def test_known_losses_are_recovered(efficiency, idle, leak, drag):
    shaft = Shaft(efficiency, idle, leak, drag)
    found = fit(known(shaft))
    assert found.largest < 1e-9
    scale = 1e-9 * np.array([1.0, 1e3, 1e-4, 1e9])
    assert np.all(np.abs(np.array(found.shaft) - np.array(shaft)) < 10.0 * scale)


def test_a_map_of_one_efficiency_is_that_constant():
    flat = replace(known(), total=(((0.8,) * 5,) * 5,))
    found = shaft_of(replace(load_machine("loader").pump, efficiency=flat))
    assert found.efficiency == pytest.approx(0.8, rel=1e-12)
    assert hydraulics.pump_power(2e7, 1e-3, *found) == pytest.approx(25e3, rel=1e-12)
    assert fit(flat).largest < 1e-12


def test_power_is_within_the_reported_error_of_the_interpolated_table():
    """At the points by definition; between them the table's own interpolation (of power, bilinear) bends as well."""
    given = real()
    found = fit(given)
    assert 0.003 < found.typical < 0.01 and found.largest < 0.03
    flow, p = 30.0 * np.array(DISPLACEMENTS), np.array(PRESSURES)
    power = p * flow[:, None] / np.array(given.total[0])
    look_up = RegularGridInterpolator((flow, p), power)
    error = np.abs(hydraulics.pump_power(p, flow[:, None], *found.shaft) / power - 1.0)
    assert error.max() == pytest.approx(found.largest, rel=1e-12)
    assert np.unravel_index(error.argmax(), error.shape) == found.worst
    assert np.sqrt(np.mean(error**2)) == pytest.approx(found.typical, rel=1e-12)
    q, s = np.random.default_rng(5).uniform([flow[0], p[0]], [flow[-1], p[-1]], (500, 2)).T
    between = hydraulics.pump_power(s, q, *found.shaft) / look_up((q, s)) - 1.0
    assert np.abs(between).max() < found.largest + 1e-3


@pytest.mark.parametrize(("share", "typical"), [(0.006, 0.0035), (0.016, 0.0085), (0.032, 0.016)])
def test_leakage_is_met_as_well_as_the_documentation_says(share, typical):
    """A pump whose leakage in proportion to p, so much of its flow at 30 MPa, costs in proportion to p^2."""
    displacements = tuple(45e-6 * part for part in (0.1, 0.2, 0.4, 0.6, 0.8, 1.0))
    pressures = (3e6, 5e6, 10e6, 15e6, 20e6, 25e6, 30e6)
    flow, p = np.meshgrid(30.0 * np.array(displacements), pressures, indexing="ij")
    power = 1.01 * p * (flow + share * flow[-1, 0] * p / 30e6) + 1.35e-5 * p + 740.0
    given = EfficiencyMap(30.0, (30.0,), displacements, pressures, (tuple(map(tuple, (p * flow / power).tolist())),))
    assert 0.8 * typical < fit(given).typical < typical
    assert fit(given).largest < 0.05
    assert fit(given).worst[0] == 0


def test_the_table_at_the_drive_speed_lies_between_its_neighbours():
    tables = tuple(table(PUMP, speed) for speed in (20.0, 25.0, 35.0))
    given = EfficiencyMap(27.5, (20.0, 25.0, 35.0), DISPLACEMENTS, PRESSURES, tables)
    wanted = RegularGridInterpolator((given.speeds, DISPLACEMENTS, PRESSURES), np.array(tables))
    points = np.stack(np.meshgrid(27.5, DISPLACEMENTS, PRESSURES, indexing="ij"), axis=-1)[0]
    np.testing.assert_allclose(at_speed(given), wanted(points), rtol=1e-14)
    for speed, rows in zip(given.speeds, tables, strict=True):
        np.testing.assert_allclose(at_speed(replace(given, speed=speed)), rows, rtol=1e-14)


@given(q=FLOW, p=PRESSURE)
def test_power_rises_with_pressure_and_flow_and_exceeds_what_is_delivered(q, p):
    """Outside the table as well; the idle loss remains where nothing flows."""
    shaft = fit(real()).shaft
    power = hydraulics.pump_power(p, q, *shaft)
    assert power >= p * q + shaft.idle
    assert hydraulics.pump_power(1.1 * p, q, *shaft) >= power
    assert hydraulics.pump_power(p, 1.1 * q, *shaft) >= power
    assert hydraulics.pump_power(0.0, 0.0, *shaft) == shaft.idle > 0.0


# One formula


@njit
def in_kernel(p, q, efficiency, idle, leak, drag):
    """The power, and the two parts a kernel makes of it: what no pressure costs, and the rate of pressure."""
    rate = hydraulics.pump_power(1.0, q, efficiency, 0.0, leak, 0.0)
    return hydraulics.pump_power(p, q, efficiency, idle, leak, drag), hydraulics.pump_losses(
        0.0, q, idle, leak, drag
    ) + p * rate


def test_numpy_kernel_and_casadi_agree():
    rng = np.random.default_rng(8)
    p, q = rng.uniform(0.0, 25e6, 200), rng.uniform(-1e-3, 1.35e-3, 200)
    wanted = hydraulics.pump_power(p, q, *PUMP)
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    symbolic = ca.Function("power", [x, y], [hydraulics.pump_power(x, y, *PUMP)])
    kilowatts = hydraulics.pump_power(1e-6 * p, 1e3 * q, *PUMP.in_kilowatts())
    np.testing.assert_array_equal([in_kernel(a, b, *PUMP)[0] for a, b in zip(p, q, strict=True)], wanted)
    np.testing.assert_array_equal([float(symbolic(a, b)) for a, b in zip(p, q, strict=True)], wanted)
    np.testing.assert_allclose([in_kernel(a, b, *PUMP)[1] for a, b in zip(p, q, strict=True)], wanted, rtol=1e-13)
    np.testing.assert_allclose(1e3 * kilowatts, wanted, rtol=1e-12)


@given(q=st.floats(-1e-3, 1e-3), p=PRESSURE, efficiency=st.floats(0.1, 1.0))
def test_a_constant_efficiency_gives_the_very_numbers_of_a_division(q, p, efficiency):
    pump = replace(SHORT.machine.pump, efficiency=efficiency)
    assert shaft_of(pump) == (efficiency, 0.0, 0.0, 0.0)
    assert hydraulics.pump_power(p, q, *shaft_of(pump)) == p * q / efficiency
    assert in_kernel(p, q, *shaft_of(pump)) == (p * q / efficiency, p * (q / efficiency))


def test_every_user_of_the_power_counts_the_same():
    """The judge against the formula written out, and the one-state program and the smoothed power against the judge."""
    count = 60
    velocity = 0.08 * np.sin(2.0 * np.pi * np.arange(count + 1) / count)
    middle = 0.5 * sum(stages.discretise(SHORT, 0.1).intervals[0][0])
    judged = evaluate(SHORT, from_velocities(0.1, middle, velocity, "test", "ls"))
    q = judged.pump_flow
    for power, p in ((judged.power_ls, judged.supply_ls), (judged.power_cp, judged.supply_cp)):
        wanted = p * q / PUMP.efficiency + PUMP.idle + PUMP.leak * p + PUMP.drag * q**2
        np.testing.assert_allclose(power, wanted, rtol=1e-9)
    crane = cranes.build(SHORT)
    pose = cranes.pose(crane, cranes.plane(SHORT.machine, sample(SHORT, judged.time)), judged.length[:, -1])
    moving = cranes.move(pose, judged.velocity[:, -1], judged.acceleration[:, -1])
    slow = np.abs(np.abs(judged.velocity) - SHORT.machine.driven_velocity).min(axis=1) < 1e-4
    for cost, power in (("ls", judged.power_ls), ("cp", judged.power_cp)):
        counted = cost_rates.rate(crane, cost, tuple(judged.velocity.T), tuple(judged.force.T))
        np.testing.assert_allclose(counted, power, rtol=1e-12)
        smooth = 1e3 * smoothed_nlp.smooth_power(crane, pose, moving, cost, 1e6, 1e-8)
        assert np.abs(smooth - power)[~slow].max() < 1e-3 * power.max()
    areas = [c.piston_area - c.rod_side_area for c in SHORT.machine.cylinders]
    net = judged.velocity @ areas
    wanted = 20e6 * net / PUMP.efficiency + PUMP.idle + PUMP.leak * 20e6 + PUMP.drag * net**2
    integral = np.trapezoid(wanted, judged.time)
    assert judged_cost(judged, "recuperation") == pytest.approx(integral, rel=1e-9)


@pytest.mark.parametrize("cost", COSTS)
def test_kernels_are_told_the_losses_and_penalties_know_their_size(cost):
    problem = stages.discretise(SHORT, 0.5)
    setting = stage_arrays.setting(problem, cost, (0.0,) * 5)
    columns = [layout.EFFICIENCY, layout.IDLE, layout.LEAK, layout.DRAG]
    pumped = cost in ("ls", "cp", "recuperation")
    np.testing.assert_allclose(setting[columns], PUMP if pumped else (1.0, 0.0, 0.0, 0.0), rtol=1e-9)
    constant = stages.discretise(with_map(SHORT, 0.96), 0.5)
    scales = cost_scale.energy_scale(problem, cost), cost_scale.energy_scale(constant, cost)
    assert scales[0] > scales[1] if pumped else scales[0] == scales[1]


@pytest.mark.parametrize("pump", ["ls", "cp"])
def test_a_plan_with_a_map_is_never_worse_than_the_actuator_pseudo_inverse(pump):
    plan = run(SHORT, pump=pump, grid=(31, 15), step=0.3)
    usual = run(SHORT, pump=pump, method="sns-actuator", baseline=False).evaluation
    assert plan.evaluation.feasible
    assert plan.evaluation.energy(pump) <= usual.energy(pump) * (1.0 + 1e-9)
    idle = 6.0 * PUMP.idle
    assert plan.evaluation.energy(pump) > idle


# Files

LOADER = (Path(leanboom.__file__).parent / "data/machines/loader.yaml").read_text()
CONSTANT = "efficiency: 1                 # printed: constant, cancels in every comparison\n"
MAP = """efficiency:
    speed: 1650 rpm                                     # assumed
    speeds: [1500 rev/min, 30 rev/s]                    # printed: data sheet
    displacements: [15 cm^3/rev, 30 cm^3/rev, 55 cm^3/rev]   # printed
    pressures: [5 MPa, 150 bar, 25 MPa]                 # printed
    total:
      -
        - [0.66, 0.80, 0.82]                            # printed: figure 3
        - [78 %, 0.88, 0.89]                            # printed: figure 3
        - [0.84, 0.91, 0.92]                            # assumed
      -
        - [0.64, 0.78, 0.80]                            # printed: figure 4
        - [0.76, 0.86, 0.88]                            # printed: figure 4
        - [0.81, 0.90, 0.91]                            # assumed: figure 4 ends before
"""


def saved(folder, *edits) -> Path:
    """A machine file with a map, and edits that all must apply."""
    text = LOADER.replace(CONSTANT, MAP)
    for old, new in edits:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path = folder / "crane.yaml"
    path.write_text(text)
    return path


def loaded(folder, *edits) -> Machine:
    return load_machine(saved(folder, *edits))


def test_a_map_is_read_in_si_units(tmp_path):
    given = loaded(tmp_path).pump.efficiency
    assert isinstance(given, EfficiencyMap)
    assert (given.speed, given.speeds) == (27.5, (25.0, 30.0))
    assert given.displacements == (15e-6, 30e-6, 55e-6)
    assert given.pressures == (5e6, 15e6, 25e6)
    assert given.total[0][1] == (0.78, 0.88, 0.89) and given.total[1][2] == (0.81, 0.90, 0.91)
    assert fit(given).typical < ALLOWED


def test_a_map_is_written_as_it_was_read(tmp_path):
    machine = loaded(tmp_path)
    text = dump_machine(machine)
    again = tmp_path / "again.yaml"
    again.write_text(text)
    assert load_machine(again) == machine
    assert "        - [78 %, 0.88, 0.89]  # printed: figure 3\n" in text
    mixed = loaded(tmp_path, ("[0.84, 0.91, 0.92]  ", "[0.84, 0.91,   # printed\n          0.92]"))
    again.write_text(dump_machine(mixed))
    assert load_machine(again) == mixed
    changed = replace(machine, pump=replace(machine.pump, efficiency=replace(machine.pump.efficiency, speed=26.0)))
    text = dump_machine(changed)
    again.write_text(text)
    assert load_machine(again).pump == changed.pump
    assert "    speed: 26 rev/s\n" in text


def test_the_map_of_the_documentation_is_this_one(tmp_path):
    page = (Path(__file__).parents[1] / "docs/files.md").read_text()
    block = next(text for text in page.split("```yaml\n") if text.startswith("efficiency:\n")).split("```")[0]
    path = tmp_path / "crane.yaml"
    path.write_text(LOADER.replace(CONSTANT, block.replace("\n", "\n  ").rstrip() + "\n"))
    assert load_machine(path).pump == loaded(tmp_path).pump


def test_a_map_that_no_file_could_hold_is_refused_in_python(tmp_path):
    given = loaded(tmp_path).pump.efficiency
    with pytest.raises(InputError) as caught:
        replace(given, total=(((0.5, 2.0), (0.5, 0.5)),))
    assert str(caught.value) == "pump.efficiency.total[0][0][1] = 2; must be above 0 and at most 1"
    with pytest.raises(InputError) as caught:
        replace(given, speeds=(30.0, 25.0))
    assert str(caught.value) == "pump.efficiency.speeds = [30, 25]; every value must be above the one before it"


BAD_MAPS = {
    "above one": (
        ("[0.66, 0.80, 0.82]", "[0.66, 1.2, 0.82]"),
        "118: pump.efficiency.total[0][0][1] = 1.2; must be above 0 and at most 1",
    ),
    "zero": (
        ("[0.66, 0.80, 0.82]", "[0, 0.80, 0.82]"),
        "118: pump.efficiency.total[0][0][0] = 0; must be above 0 and at most 1",
    ),
    "not a number": (
        ("[0.66, 0.80, 0.82]", "[.nan, 0.80, 0.82]"),
        "118: pump.efficiency.total[0][0][0] = .nan; must be a finite number, such as 0.5",
    ),
    "falling pressures": (
        ("[5 MPa, 150 bar, 25 MPa]", "[5 MPa, 25 MPa, 150 bar]"),
        "115: pump.efficiency.pressures = [5 MPa, 25 MPa, 150 bar]; every value must be above the one before it",
    ),
    "equal displacements": (
        ("[15 cm^3/rev, 30", "[30 cm^3/rev, 30"),
        "114: pump.efficiency.displacements = [30 cm^3/rev, 30 cm^3/rev, 55 cm^3/rev]; "
        "every value must be above the one before it",
    ),
    "one pressure": (
        ("[5 MPa, 150 bar, 25 MPa]", "[5 MPa]"),
        "115: pump.efficiency.pressures = [5 MPa]; must be a list of at least two pressures",
    ),
    "a volume for a displacement": (
        ("15 cm^3/rev", "15 cm^3"),
        "114: pump.efficiency.displacements[0] = 15 cm^3; must be a finite displacement in cm^3/rev, l/rev, "
        "m^3/rev, such as 45 cm^3/rev",
    ),
    "a short row": (
        ("[78 %, 0.88, 0.89]", "[78 %, 0.88]"),
        "119: pump.efficiency.total[0][1] has 2 entries; must have 3, one for each of pressures",
    ),
    "a missing row": (
        ("        - [0.84, 0.91, 0.92]                            # assumed\n", ""),
        "118: pump.efficiency.total[0] has 2 entries; must have 3, one for each of displacements",
    ),
    "a missing table": (
        ("[1500 rev/min, 30 rev/s]", "[1500 rev/min, 30 rev/s, 2000 rpm]"),
        "116: pump.efficiency.total has 2 entries; must have 3, one for each of speeds",
    ),
    "a flat table": (
        ("total:\n      -\n        - [0.66, 0.80, 0.82]  ", "total:\n      -\n        - 0.66"),
        "118: pump.efficiency.total[0][0] = 0.66; must be a list of efficiencies, one for each of pressures",
    ),
    "a speed beyond": (
        ("speed: 1650 rpm", "speed: 2200 rpm"),
        "112: pump.efficiency.speed = 2200 rpm; must be from 1500 rev/min to 30 rev/s, the ends of speeds",
    ),
    "a flow beyond": (
        ("max_flow: 80 l/min", "max_flow: 95 l/min"),
        "109: pump.max_flow = 95 l/min; must be at most 90.75 l/min, speed times the last of efficiency.displacements",
    ),
    "a slip of the pen": (
        ("[0.64, 0.78, 0.80]", "[0.64, 0.78, 0.08]"),
        "116: pump.efficiency.total is no map of a pump: losses that rise with pressure and flow meet its powers "
        "within 13.4 %; must be within 3 %; farthest off, by 36 %, is 0.45 at 1650 rpm, 15 cm^3/rev, 25 MPa",
    ),
    "a missing key": (
        ("    pressures: [5 MPa, 150 bar, 25 MPa]                 # printed\n", ""),
        "111: pump.efficiency.pressures is missing; must be a list of at least two pressures",
    ),
    "a wrong key": (
        ("    speeds: [", "    speds: ["),
        "111: pump.efficiency.speeds is missing; must be a list of at least one speed\n"
        "113: pump.efficiency.speds is not a key here; valid keys: speed, speeds, displacements, pressures, total; "
        "did you mean speeds?",
    ),
}


@pytest.mark.parametrize(("edit", "expected"), BAD_MAPS.values(), ids=BAD_MAPS)
def test_bad_map(tmp_path, edit, expected):
    path = saved(tmp_path, edit)
    with pytest.raises(InputError) as caught:
        load_machine(path)
    assert str(caught.value).replace(f"{path}:", "") == expected


def test_a_list_is_no_efficiency(tmp_path):
    path = tmp_path / "crane.yaml"
    path.write_text(LOADER.replace(CONSTANT, "efficiency: [0.8, 0.9]\n"))
    with pytest.raises(InputError) as caught:
        load_machine(path)
    assert str(caught.value) == (
        f"{path}:111: pump.efficiency = [0.8, 0.9]; must be a finite number, such as 0.5, or a mapping with the keys "
        "speed, speeds, displacements, pressures, total"
    )


def test_the_schema_allows_a_number_and_a_map():
    schema = json_schema("machine")["$defs"]
    number, mapping = schema["Pump"]["properties"]["efficiency"]["anyOf"]
    assert number["type"] == ["string", "number"] and mapping == {"$ref": "#/$defs/EfficiencyMap"}
    assert schema["EfficiencyMap"]["properties"]["total"]["items"]["items"]["minItems"] == 2


# What is said


def test_check_tells_how_well_a_map_is_met_and_what_is_assumed(tmp_path):
    path = saved(tmp_path)
    result = CliRunner().invoke(app, ["check", str(path)])
    said = " ".join(result.stdout.split())
    found = fit(load_machine(path).pump.efficiency)
    assert "map taken at 1650 rev/min (20 printed, 7 assumed); its powers are met within" in said
    assert f"within {100 * found.typical:.1f} %, at worst {100 * found.largest:.1f} %; idle loss" in said
    assert "pump.efficiency.total[1][2][0] 0.81 figure 4 ends before" in said
    assert facts.efficiency(load_machine("loader")) == "100 %, constant (printed)"


def test_machines_prints_what_became_of_a_map(tmp_path):
    path = saved(tmp_path)
    result = CliRunner().invoke(app, ["machines", str(path), "--json"])
    found = json.loads(result.stdout)["pump"]["efficiency"]
    met = fit(load_machine(path).pump.efficiency)
    assert found["speed_rev_s"] == 27.5
    assert found["shaft"]["idle_w"] == met.shaft.idle
    assert (found["typical_error"], found["largest_error"]) == (met.typical, met.largest)


def test_pressures_beyond_the_map_are_doubtful(tmp_path):
    machine = loaded(tmp_path, ("max_pressure: 25 MPa", "max_pressure: 30 MPa"))
    assert facts.doubts(machine) == (
        "the efficiency map ends at 25.0 MPa, the pump at 30.0 MPa; powers between them are extrapolated",
    )
