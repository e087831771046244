"""Identification: a known crane, driven with noisy sensors, is found again; bad logs are named, never fitted."""

from __future__ import annotations

import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks import identification as known

import leanboom as lb
from command_line import leanboom
from leanboom.errors import InputError
from leanboom.identification import base_parameters, excitation, geometry_fit
from leanboom.identification.identify import identify
from leanboom.identification.logs import channels
from leanboom.identification.logs.checks import check
from leanboom.identification.logs.conditioning import condition
from leanboom.identification.logs.reading import read_log
from leanboom.io.loading import dump_machine
from leanboom.report.identification import field_units
from leanboom.report.identification import page as identification_page

DAY = "2026-01-31"


@pytest.fixture(scope="module")
def truth():
    return lb.load_machine("forwarder")


@pytest.fixture(scope="module")
def draft(truth):
    return known.draft_of(truth)


@pytest.fixture(scope="module")
def run(truth):
    return known.drive(truth, 59.0, 42.0)


@pytest.fixture(scope="module")
def table(truth, run):
    return known.measured(run, truth.names, 1)


@pytest.fixture(scope="module")
def found(draft, table, tmp_path_factory):
    log = known.write_log(tmp_path_factory.mktemp("log") / "log.csv", table)
    return identify([log], draft, date=DAY)


@pytest.fixture
def slow(table):
    """The log at a fifth of its rate, without its last part: faults are found as well there."""
    return {name: values[:20000:5].copy() for name, values in table.items()}


def driving(table, *joints):
    """A table with the valve commands of these joints alone: fits of valves take most of the time."""
    return {n: v for n, v in table.items() if not n.endswith("_command") or n.removesuffix("_command") in joints}


def refusal(slow, draft, tmp_path, **options):
    with pytest.raises(InputError) as caught:
        identify([known.write_log(tmp_path / "log.csv", slow)], draft, **options)
    return str(caught.value)


def test_forces_flow_and_supply_of_the_crane_are_repeated_on_validation_data(found):
    errors = {fit.signal: fit.rms_percent for fit in found.fits}
    for joint in ("base", "lift", "tilt", "extension"):
        assert errors[f"{joint}_force"] < 5.0
    assert errors["supply"] < 5.0
    assert errors["pump_flow"] < 5.0


def test_gravity_and_friction_are_those_of_the_true_crane(found, truth):
    rows = {name: (value, true) for name, value, true, _, _ in known.errors(found, known.truth_of(truth))}
    for name in ("gravity.lift.along", "gravity.tilt.along", "gravity.tilt.above", "gravity.extension.mass"):
        value, true = rows[name]
        assert value == pytest.approx(true, rel=0.03), name
    lift, of = rows["gravity.lift.above"], rows["gravity.lift.along"][1]
    assert abs(lift[0] - lift[1]) < 0.03 * of  # the two are one vector
    for name, (value, true) in rows.items():
        if ".friction.coulomb" in name:
            assert value == pytest.approx(true, rel=0.05), name
        if ".friction.steps" in name:
            assert abs(value - true) < 0.05, name
    assert sum(".friction.steps" in name for name in rows) == 4  # found from the data: the draft has none


def test_valve_delay_and_dead_zone_are_found(found, truth):
    values = {each.name: each.value for each in found.estimates}
    assert values["simulation.dead_zone"] == pytest.approx(truth.circuit.dead_zone, rel=0.02)
    assert abs(values["simulation.delay"] - truth.circuit.delay) < 0.003
    assert values["simulation.spool_bandwidth"] == pytest.approx(truth.circuit.spool_bandwidth, rel=0.05)
    assert values["simulation.pump_time_constant"] == pytest.approx(truth.circuit.pump_time_constant, rel=0.05)
    assert values["simulation.edge_flow"] == pytest.approx(truth.circuit.edge_flow, rel=0.05)
    assert values["pump.ls_margin"] == pytest.approx(truth.pump.ls_margin, rel=0.05)
    # Not spoiled by a load that drives its cylinder: then the chamber that fills is empty.
    assert values["valve.extend_coefficient"] == pytest.approx(truth.valve.extend_coefficient, rel=0.15)
    assert values["valve.retract_coefficient"] == pytest.approx(truth.valve.retract_coefficient, rel=0.05)
    table = found.feed_forward["lift"]
    assert (np.diff(table[:, 0]) >= 0.0).all() and (np.diff(table[:, 1]) > 0.0).all()


def test_effective_areas_are_those_of_the_drawing_where_loads_drive_other_cylinders_too(found, truth):
    """What a driving load lets the tilt draw from the return line spoiled the extension's areas by a fifth."""
    told = [row for row in known.errors(found, known.truth_of(truth)) if ".area_" in row[0] and row[3] is not None]
    assert len(told) >= 4
    for name, value, true, half, _ in told:
        assert value == pytest.approx(true, rel=0.02, abs=5e-5), name
        assert half < 5e-4
    assert any(each.name.startswith("anti_cavitation.tilt") for each in found.estimates)


def test_intervals_cover_the_truth(found, truth):
    """Of one log; over many, the benchmark."""
    hits = [covers for *_, covers in known.errors(found, known.truth_of(truth)) if covers is not None]
    assert len(hits) > 35
    assert sum(hits) >= 0.9 * len(hits)


def test_single_masses_are_not_told_but_their_sums_are(found):
    told = {each.name: each.identifiable for each in found.estimates}
    assert not told["bodies.grapple.mass"]
    assert told["gravity.tilt.along"]
    assert all(each.low is None for each in found.estimates if not each.identifiable)
    assert all(body.mass > 0.0 and body.inertia >= 0.0 for body in found.machine.bodies)


def test_the_machine_file_says_what_was_identified_when_and_from_which_log(found, tmp_path):
    out = tmp_path / "fitted.yaml"
    for name, content in identification_page.files(found, out).items():
        (tmp_path / name).write_bytes(content)
    machine = lb.load_machine(out)
    assert machine.bodies == found.machine.bodies
    assert machine.cylinders == found.machine.cylinders
    assert machine.circuit == found.machine.circuit
    marked = {entry.key: entry for entry in machine.provenance if entry.status == "identified"}
    assert {"simulation.delay", "cylinders.extension.friction.steps[0]", "bodies.lift_boom.mass"} <= set(marked)
    assert DAY in marked["simulation.delay"].note and found.logs[0].digest[:12] in marked["simulation.delay"].note
    assert "in sums" in marked["bodies.grapple.mass"].note
    page = (tmp_path / "fitted.html").read_text(encoding="utf-8")
    assert "NaN" not in page.split("<script>")[0]
    assert re.search(r'extension_force</th><td class="n">[\d.]+ kN<', page)  # not 12345 of nothing
    assert re.search(r'dead_zone</th>(<td class="n">5[23][.\d]*</td>){3}<td>%<', page)
    assert (tmp_path / "fitted_feed_forward.csv").read_text(encoding="utf-8").startswith("joint,velocity_m_s,command")


def test_every_value_is_shown_in_a_unit_of_the_field(found):
    plain = ("coefficient", "ratio")
    assert all(field_units.of_value(each.name)[0] or each.name.endswith(plain) for each in found.estimates)
    assert field_units.shown("simulation.bulk_modulus", 1e9) == "1000"


def test_the_draft_of_the_log_crane_and_its_columns_are_read():
    folder = Path(__file__).parents[1] / "examples" / "patu655"
    machine = lb.load_machine(folder / "machine.yaml")
    assert "lift_command" in channels.read_map(folder / "columns.yaml", machine)


def test_json_has_the_promised_keys_and_only_finite_numbers(found):
    text = json.dumps(found.json(None), allow_nan=False)
    data = json.loads(text)
    assert list(data) == ["parameters", "fit", "out"]
    assert all(set(each) == {"value", "low", "high", "identifiable"} for each in data["parameters"].values())
    assert all(set(each) == {"rms", "rms_percent"} for each in data["fit"].values())


@pytest.mark.slow
def test_a_missing_column_of_the_map_is_named(slow, draft, tmp_path):
    named = {"lift_position": {"column": "z9", "unit": "deg", "scale": 1.0, "zero": 0.0}}
    assert "column z9 of channel lift_position is missing" in refusal(slow, draft, tmp_path, columns=named)


def test_channels_that_are_not_there_are_said_with_what_they_cost(slow, draft, tmp_path):
    del slow["tilt_pressure_a_pa"], slow["supply_pa"]
    found = identify([known.write_log(tmp_path / "log.csv", driving(slow, "tilt"))], draft)
    said = "\n".join(found.said)
    assert "tilt: no pressure_a in the logs; without, no fit of its forces" in said
    assert "no supply in the logs" in said
    assert "tilt_force" not in {fit.signal for fit in found.fits}


@pytest.mark.parametrize(
    ("column", "factor", "unit"),
    [("lift_rad", 180 / np.pi, "deg"), ("lift_pressure_a_pa", 1e-6, "MPa"), ("extension_m", 1e3, "mm")],
)
def test_wrong_units_are_found_by_plausibility(slow, draft, tmp_path, column, factor, unit):
    slow[column] = factor * slow[column]
    if column.endswith("_a_pa"):
        slow["lift_pressure_b_pa"] = factor * slow["lift_pressure_b_pa"]
    text = refusal(slow, draft, tmp_path)
    assert column.rsplit("_", 1)[0].removesuffix("_a") in text and f"it would fit in {unit}" in text


def test_time_that_jumps_back_is_named_with_its_row(slow, draft, tmp_path):
    slow["time_s"][1000:] -= 5.0
    text = refusal(slow, draft, tmp_path)
    assert "time jumps back" in text and "row 1002" in text


def test_a_gap_is_said_and_its_parts_are_fitted_apart(slow, draft, tmp_path):
    cut = {name: np.delete(values, slice(1500, 1700)) for name, values in driving(slow, "lift").items()}
    found = identify([known.write_log(tmp_path / "log.csv", cut)], draft)
    assert [each.kind for each in found.findings] == ["gap"]
    assert "after row 1501" in found.findings[0].text
    assert "2 uninterrupted parts" in found.said[0]


def test_outliers_are_named_and_replaced(slow, draft, tmp_path):
    slow["lift_pressure_a_pa"][[700, 1300]] = 30e6
    log = read_log(known.write_log(tmp_path / "log.csv", slow), draft, {})
    checked = check(log, draft)
    texts = [each.text for each in checked.findings]
    assert len(texts) == 1 and "lift_pressure_a has outliers in rows 702, 1302" in texts[0]
    assert checked.signals["lift_pressure_a"][700] < 20e6


def test_a_stuck_sensor_is_named_with_its_rows(slow, draft, tmp_path):
    slow["tilt_pressure_a_pa"][1000:1400] = slow["tilt_pressure_a_pa"][1000] + 12e3
    checked = check(read_log(known.write_log(tmp_path / "log.csv", slow), draft, {}), draft)
    texts = [each.text for each in checked.findings]
    assert len(texts) == 1 and "tilt_pressure_a is stuck" in texts[0] and "rows 1002 to 1401" in texts[0]
    assert not checked.usable["tilt"][1200] and checked.usable["lift"][1200]


def test_empty_cells_are_named(slow, draft, tmp_path):
    slow["lift_rad"][300:310] = np.nan
    checked = check(read_log(known.write_log(tmp_path / "log.csv", slow), draft, {}), draft)
    assert ["lift_position has no number in rows 302-311" in each.text for each in checked.findings] == [True]


@pytest.mark.parametrize("joint", ["lift", "tilt", "extension"])
def test_swapped_chambers_are_refused(slow, draft, tmp_path, joint):
    a, b = f"{joint}_pressure_a_pa", f"{joint}_pressure_b_pa"
    slow[a], slow[b] = slow[b], slow[a]
    text = refusal(driving(slow), draft, tmp_path)
    assert f"{joint}_pressure_b are swapped" in text


def test_a_position_of_the_wrong_sign_is_refused(slow, draft, tmp_path):
    slow["base_rad"] = -slow["base_rad"]
    text = refusal(driving(slow, "base", "lift"), draft, tmp_path)
    assert "base_position falls while base_command is above 0" in text


def test_too_little_motion_is_said(slow, draft, tmp_path):
    slow["tilt_rad"] = slow["tilt_rad"][0] + 0.01 * (slow["tilt_rad"] - slow["tilt_rad"][0])
    found = identify([known.write_log(tmp_path / "log.csv", driving(slow, "tilt"))], draft)
    assert any(each.kind == "motion" and "tilt moves over" in each.text for each in found.findings)
    assert "tilt_force" not in {fit.signal for fit in found.fits}


def test_bodies_of_which_a_log_tells_nothing_stay_as_drafted(slow, draft, tmp_path, rng):
    """The lift alone moves, and little, its pressure wanders: that made masses of tonnes behind the crane."""
    few = {n: v for n, v in slow.items() if n.startswith(("time", "lift_rad", "lift_pressure"))}
    middle = few["lift_rad"][0]
    few["lift_rad"] = middle + 0.2 * (few["lift_rad"] - middle)
    few["lift_pressure_a_pa"] += 3e6 * np.interp(few["time_s"], np.arange(41.0), rng.normal(size=41))
    found = identify([known.write_log(tmp_path / "log.csv", few)], draft)
    assert not any(each.identifiable for each in found.estimates if each.name.startswith("gravity"))
    assert found.machine.bodies == draft.bodies
    assert any("keeps the draft's bodies" in line for line in found.said)


def test_a_log_without_motion_is_refused(slow, draft, tmp_path):
    still = {n: v if n == "time_s" else np.full_like(v, 0.0 if "command" in n else v[0]) for n, v in slow.items()}
    assert "moves over 0.0 % of its range" in refusal(still, draft, tmp_path)


def test_a_column_map_reads_other_names_units_and_signs(slow, draft, tmp_path):
    path = tmp_path / "columns.yaml"
    path.write_text(
        "time: t\nlift_position: {column: 'z1 [deg]', scale: -1}\n"
        "lift_command: {column: 'U1 [V]', zero: 5, scale: 0.2}\n",
        encoding="utf-8",
    )
    slow["z1 [deg]"] = -np.degrees(slow.pop("lift_rad"))
    slow["U1 [V]"] = 5.0 + 5.0 * slow.pop("lift_command")
    slow["t"] = slow.pop("time_s")
    named = channels.read_map(path, draft)
    log = read_log(known.write_log(tmp_path / "log.csv", slow), draft, named)
    assert log.signals["lift_position"] == pytest.approx(-np.radians(slow["z1 [deg]"]), abs=1e-6)
    assert log.signals["lift_command"] == pytest.approx(0.2 * (slow["U1 [V]"] - 5.0), abs=1e-5)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("lift_angle: x\n", "is no channel"),
        ("time: {column: t, unlt: s}\n", "is not a key here"),
        ("- x\n", "must be a mapping"),
    ],
)
def test_a_wrong_column_map_is_refused_with_what_to_write(draft, tmp_path, text, said):
    path = tmp_path / "columns.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=said):
        channels.read_map(path, draft)


@pytest.mark.parametrize("ending", ["mat", "mf4", "mcap"])
def test_other_formats_hold_the_same_as_csv(slow, draft, tmp_path, ending):
    path = tmp_path / f"log.{ending}"
    if ending == "mat":
        from scipy.io import savemat

        savemat(path, slow)
    elif ending == "mf4":
        from asammdf import MDF, Signal

        file = MDF()
        file.append([Signal(v, slow["time_s"], name=n) for n, v in slow.items() if n != "time_s"])
        file.save(path)
        file.close()
    else:
        from mcap.writer import Writer

        with path.open("wb") as stream:
            writer = Writer(stream)
            writer.start()
            channel = writer.register_channel(topic="/crane", message_encoding="json", schema_id=0)
            for i, t in enumerate(slow["time_s"]):
                values = {n: float(v[i]) for n, v in slow.items() if n != "time_s"}
                writer.add_message(channel, log_time=round(1e9 * t), publish_time=0, data=json.dumps(values).encode())
            writer.finish()
    named = (
        {"lift_position": {"column": "crane.lift_rad", "unit": "rad", "scale": 1.0, "zero": 0.0}}
        if ending == "mcap"
        else {}
    )
    log = read_log(path, draft, named)
    assert log.signals["lift_position"] == pytest.approx(slow["lift_rad"][: log.time.size], abs=1e-6)


def test_a_missing_extra_is_one_sentence(slow, draft, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "asammdf", None)
    path = tmp_path / "log.mf4"
    path.write_bytes(b"MDF")
    with pytest.raises(InputError, match=r"needs the package asammdf; install it with: pip install 'leanboom\[logs\]'"):
        read_log(path, draft, {})


@pytest.mark.parametrize("content", ["", "time_s,lift_rad\n", "a,b\n1,2\n", "time_s;lift_rad\n1,5;2,5\n" * 300])
def test_a_file_that_is_no_log_is_refused(draft, tmp_path, content):
    path = tmp_path / "log.csv"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match="log.csv"):
        identify([path], draft)


def test_a_linkage_is_found_from_angles_and_cylinder_lengths(truth, slow, tmp_path):
    linkage = truth.cylinders[1].linkage
    slow["lift_cylinder_m"] = np.round(linkage.length_arm_slope(slow["lift_rad"])[0], 4)
    wrong = replace(linkage, long=linkage.long + 0.03, short=linkage.short - 0.02, angle=linkage.angle + 0.04)
    cylinders = list(truth.cylinders)
    cylinders[1] = replace(cylinders[1], linkage=wrong)
    machine = replace(truth, cylinders=tuple(cylinders))
    checked = check(read_log(known.write_log(tmp_path / "log.csv", slow), machine, {}), machine)
    found = geometry_fit.fit(condition([checked], machine), machine)
    assert found is not None
    for name, value in (("long", linkage.long), ("short", linkage.short), ("angle", linkage.angle)):
        assert getattr(found.machine.cylinders[1].linkage, name) == pytest.approx(value, abs=2e-3)
    assert found.fits[0].rms < 2e-4


def test_base_parameters_hold_all_that_forces_tell(truth, rng):
    """Moments with the same sums give the same boom forces, at any motion that does not slew."""
    motion = base_parameters.Motion(
        *(tuple(np.zeros(40) if i == 0 else rng.uniform(0.2, 1.0, 40) for i in range(4)) for _ in range(3))
    )
    columns = np.concatenate(base_parameters.moment_columns(truth, truth.bodies, motion)[1:])
    base = base_parameters.base_map(truth, truth.bodies)
    hidden = np.eye(base.shape[1]) - np.linalg.pinv(base) @ base
    assert np.abs(columns @ hidden).max() < 1e-6 * np.abs(columns).max()
    assert np.linalg.matrix_rank(base) == len(base_parameters.BASE)


def test_test_motions_keep_limits_and_tell_more(truth):
    found = excitation.propose(truth, chosen=2, candidates=2)
    assert found.after < found.before
    assert found.rank_after == found.wanted
    texts = excitation.files(found, "forwarder")
    assert b"machine: forwarder" in texts["excitation-1.yaml"]


def test_the_command_prints_json_alone_and_writes_its_files(slow, draft, tmp_path, monkeypatch):
    known.write_log(tmp_path / "log.csv", driving(slow, "lift"))
    (tmp_path / "draft.yaml").write_text(dump_machine(draft), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    answer = leanboom("identify", "log.csv", "--machine", "draft.yaml", "--out", "fitted.yaml", "--json")
    assert answer.exit_code == 0, answer.stderr
    assert json.loads(answer.stdout)["out"] == "fitted.yaml"
    assert {"fitted.yaml", "fitted.html", "fitted_feed_forward.csv"} <= {path.name for path in tmp_path.iterdir()}
