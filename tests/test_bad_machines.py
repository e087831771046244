"""Bad machine files: every problem with its exact message and line."""

from __future__ import annotations

import pytest

from bundled_texts import FORWARDER, edited, problems, written
from leanboom.io.loading import dump_machine, load_machine

CYLINDER_KEYS = (
    "bore, rod, plunger, racks, piston_area, rod_side_area, stroke, linkage, connection, friction, velocity_limit, "
    "acceleration_limit"
)

BAD_MACHINES = {
    "wrong unit": (
        [("boom: 3.504 m", "boom: 3.504 kg")],
        ["14: geometry.boom = 3.504 kg; must be a finite length in mm, cm, m, such as 610 mm"],
    ),
    "unknown unit": (
        [("325 l/min", "325 gal/min")],
        [
            "125: pump.max_flow = 325 gal/min; must be a finite flow in l/min, l/s, cm^3/s, m^3/h, m^3/s, such as "
            "325 l/min; gal is not a unit here"
        ],
    ),
    "a unit in other case": (
        [("21.5 MPa", "215 Bar")],
        [
            "124: pump.max_pressure = 215 Bar; must be a finite pressure in Pa, kPa, MPa, mbar, bar, such as "
            "21.5 MPa; Bar is not a unit here, did you mean bar?"
        ],
    ),
    "a decimal comma": (
        [("boom: 3.504 m", "boom: 3,504 m")],
        [
            "14: geometry.boom = 3,504 m; must be a finite length, such as 610 mm; numbers are written with 0-9 and a "
            "decimal point"
        ],
    ),
    "digits of another script": (
        [("mass: 480 kg", "mass: ٤٨٠ kg")],
        [
            "100: bodies.column.mass = ٤٨٠ kg; must be a finite mass, such as 370 kg; numbers are written with 0-9 and "
            "a decimal point"
        ],
    ),
    "nan": (
        [("mass: 480 kg", "mass: .nan")],
        ["100: bodies.column.mass = .nan; must be a finite mass, such as 370 kg"],
    ),
    "infinite": (
        [("inertia: 60 kg m^2", "inertia: 1e999 kg m^2")],
        ["100: bodies.column.inertia = 1e999 kg m^2; must be a finite inertia, such as 420 kg m^2"],
    ),
    "negative mass": ([("mass: 480 kg", "mass: -1 kg")], ["100: bodies.column.mass = -1 kg; must be above 0"]),
    "negative bore": ([("bore: 120 mm", "bore: -90 mm")], ["44: cylinders.lift.bore = -90 mm; must be above 0"]),
    "out of range": (
        [("efficiency: 1 ", "efficiency: 1.5 ")],
        ["127: pump.efficiency = 1.5; must be above 0 and at most 1"],
    ),
    "share out of range": (
        [("extension_share: 0.5", "extension_share: 150 %")],
        ["104: bodies.telescope_1.extension_share = 150 %; must be from 0 to 1"],
    ),
    "unknown key": (
        [("    rod: 70 mm", "    rodd: 70 mm")],
        [f"45: cylinders.lift.rodd is not a key here; valid keys: {CYLINDER_KEYS}; did you mean rod?"],
    ),
    "missing key": (
        [("    velocity_limit: 0.15 m/s          # printed: Table 3\n", "")],
        ["43: cylinders.lift.velocity_limit is missing; must be a velocity above 0, such as 0.15 m/s"],
    ),
    "missing section": (
        [
            ("payload:               # hangs at the tool\n  along: 2.13 m        # derived: geometry.outer\n", ""),
            ("  above: 0.376 m       # derived: geometry.offset\n", ""),
        ],
        ["5: payload is missing; must be a mapping with the keys along, above"],
    ),
    "no value": (
        [("stroke: 610 mm", "stroke:")],
        ["46: cylinders.lift.stroke = nothing; must be a finite length, such as 610 mm"],
    ),
    "duplicate key": (
        [("    rod: 70 mm", "    bore: 70 mm\n    rod: 70 mm")],
        ["45: cylinders.lift.bore is given twice; first in line 44"],
    ),
    "wrong word": (
        [("connection: single_acting", "connection: single")],
        [
            "52: cylinders.lift.connection = single; must be standard, single_acting, differential; "
            "did you mean single_acting?"
        ],
    ),
    "the word of others": (
        [("connection: single_acting", "connection: double_acting"), ("carrier: lift", "carrier: boom")],
        [
            "52: cylinders.lift.connection = double_acting; must be standard, single_acting, differential; "
            "did you mean standard?",
            "101: bodies.lift_boom.carrier = boom; must be base, lift, tilt; did you mean lift?",
        ],
    ),
    "degrees without a unit": (
        [("[-0.425 rad, 1.097 rad]", "[-24, 62.9]")],
        [
            "21: joints.lift[0] = -24; must have its unit beyond 6.3 rad, since a bare number is in rad",
            "21: joints.lift[1] = 62.9; must have its unit beyond 6.3 rad, since a bare number is in rad",
        ],
    ),
    "millimetres without a unit": (
        [("boom: 3.504 m", "boom: 3504")],
        ["14: geometry.boom = 3504; must have its unit beyond 100 m, since a bare number is in m"],
    ),
    "wrong linkage": (
        [("type: triangle", "type: triangel")],
        [
            "48: cylinders.lift.linkage.type = triangel; must be rack_and_pinion, triangle, four_bar, polynomial, "
            "telescope; did you mean triangle?"
        ],
    ),
    "no linkage type": (
        [("      type: triangle\n", "")],
        [
            "47: cylinders.lift.linkage.type is missing; must be rack_and_pinion, triangle, four_bar, polynomial, "
            "telescope"
        ],
    ),
    "key inside a linkage": (
        [("short: 0.442257 m", "shrt: 0.442257 m")],
        [
            "47: cylinders.lift.linkage.short is missing; must be a length above 0, such as 610 mm",
            "50: cylinders.lift.linkage.shrt is not a key here; valid keys: type, long, short, angle; "
            "did you mean short?",
        ],
    ),
    "not a switch": ([("slewing: true", "slewing: 1")], ["17: geometry.slewing = 1; must be true or false"]),
    "unsafe name": (
        [("name: forwarder", "name: ../../x")],
        ["5: name = ../../x; must be up to 64 letters, digits, '-' and '_', the first a letter or digit"],
    ),
    "unsafe name of a body": (
        [("  column: {", "  the column: {")],
        [
            "100: bodies.the column has a wrong name; must be up to 64 letters, digits, '-' and '_', "
            "the first a letter or digit"
        ],
    ),
    "half a range": (
        [("[-0.425 rad, 1.097 rad]", "[-0.425 rad]")],
        ["21: joints.lift = [-0.425 rad]; must be a list of two angles, lower and upper end"],
    ),
    "range upside down": (
        [("[-0.425 rad, 1.097 rad]", "[1.097 rad, -0.425 rad]")],
        ["21: joints.lift = [1.097 rad, -0.425 rad]; the lower end must be below the upper end"],
    ),
    "rod above bore": (
        [("rod: 70 mm", "rod: 130 mm")],
        ["45: cylinders.lift.rod = 130 mm; must be below bore = 120 mm"],
    ),
    "rod equal to bore": (
        [("rod: 70 mm", "rod: 120 mm")],
        ["45: cylinders.lift.rod = 120 mm; must be below bore = 120 mm"],
    ),
    "two sizes": (
        [("    rod: 70 mm", "    plunger: 70 mm")],
        [
            "43: cylinders.lift has bore = 120 mm, plunger = 70 mm; its size must be given as bore and rod, as plunger "
            "(and racks), or as piston_area and rod_side_area"
        ],
    ),
    "three racks": ([("racks: 1 ", "racks: 3 ")], ["30: cylinders.base.racks = 3; must be 1 or 2"]),
    "areas the wrong way round": (
        [("bore: 120 mm", "piston_area: 70 cm^2"), ("rod: 70 mm", "rod_side_area: 113 cm^2")],
        ["45: cylinders.lift.rod_side_area = 113 cm^2; must be at most piston_area = 70 cm^2"],
    ),
    "differential without a difference": (
        [("connection: standard", "connection: differential")],
        ["35: cylinders.base.connection = differential; must be standard or single_acting, since both areas are equal"],
    ),
    "steps on the lift": (
        [
            (
                "      viscous: 0 N s/m                # assumed\n    velocity_limit: 0.15",
                "      steps: [1, 2, 3, 4]\n    velocity_limit: 0.15",
            )
        ],
        ["56: cylinders.lift.friction.steps = [1, 2, 3, 4]; only the extension cylinder may have steps"],
    ),
    "steps out of order": (
        [("[0.8 m, 1.3 m, 2.2 m, 2.7 m]", "[0.8 m, 1.3 m, 1.2 m, 2.7 m]")],
        [
            "94: cylinders.extension.friction.steps = [0.8 m, 1.3 m, 1.2 m, 2.7 m]; "
            "every value must be above the one before it"
        ],
    ),
    "impossible triangle": (
        [("angle: 0.9755593 rad", "angle: 2.5 rad")],
        [
            "47: cylinders.lift.linkage = triangle; must have a torque arm over joints.lift = [-0.425, 1.097] rad, "
            "but passes a dead centre at 0.642 rad"
        ],
    ),
    "four-bar too short to close": (
        [("L24: 0.503 m", "L24: 0.05 m")],
        [
            "64: cylinders.tilt.linkage = four_bar; must close over joints.tilt = [-2.75, -0.25] rad, "
            "but does not at -2.750 rad"
        ],
    ),
    "four-bar off its branch": (
        [("a22: 1.963 rad", "a22: 3 rad")],
        [
            "64: cylinders.tilt.linkage = four_bar; must close over joints.tilt = [-2.75, -0.25] rad, "
            "but does not at -0.655 rad"
        ],
    ),
    "stroke beside the linkage": (
        [("stroke: 610 mm", "stroke: 650 mm")],
        [
            "46: cylinders.lift.stroke = 650 mm; must be 0.6100 m within 2 %, the change of the cylinder's length over "
            "joints.lift = [-0.425, 1.097] rad, or be left out"
        ],
    ),
    "extension without telescope": (
        [("type: telescope\n      ratio: 0.5", "type: rack_and_pinion\n      arm: 0.5")],
        ["87: cylinders.extension.linkage.type = rack_and_pinion; must be telescope"],
    ),
    "telescope on a rotating joint": (
        [("type: rack_and_pinion\n      arm: 0.1146 m", "type: telescope\n      ratio: 0.1146")],
        ["33: cylinders.base.linkage.type = telescope; must not be telescope on a rotating joint"],
    ),
    "base without slewing": (
        [("slewing: true", "slewing: false")],
        [
            "20: joints.base is given; must be left out since geometry.slewing = false",
            "26: cylinders.base is given; must be left out since geometry.slewing = false",
        ],
    ),
    "slewing without base": (
        [("  base: [-180 deg, 180 deg]           # printed: Table 3\n", "")],
        ["19: joints.base is missing; must be given since geometry.slewing = true"],
    ),
    "telescoping lift boom": (
        [("carrier: tilt, mass: 115 kg", "carrier: lift, mass: 115 kg")],
        ["104: bodies.telescope_1.extension_share = 0.5; must be 0 unless the carrier is tilt"],
    ),
    "pump below its supply": (
        [("max_pressure: 21.5 MPa", "max_pressure: 150 bar")],
        ["122: pump.constant_pressure = 20 MPa; must be at most max_pressure = 150 bar"],
    ),
    "bar without a unit": (
        [("max_pressure: 21.5 MPa", "max_pressure: 215")],
        [
            "122: pump.constant_pressure = 20 MPa; must be at most max_pressure = 215 Pa",
            "123: pump.ls_margin = 3 MPa; must be at most max_pressure = 215 Pa",
        ],
    ),
    "several at once, of every kind": (
        [
            ("boom: 3.504 m", "boom: 3.504 kg"),
            ("bore: 120 mm", "bore: -90 mm"),
            ("rod: 60 mm", "rod: 160 mm"),
            ("stroke: 1850 mm", "stroke: 1.5 m"),
            ("mass: 480 kg", "mass: -1 kg"),
            ("efficiency: 1 ", "efficency: 1 "),
        ],
        [
            "14: geometry.boom = 3.504 kg; must be a finite length in mm, cm, m, such as 610 mm",
            "44: cylinders.lift.bore = -90 mm; must be above 0",
            "62: cylinders.tilt.rod = 160 mm; must be below bore = 115 mm",
            "85: cylinders.extension.stroke = 1.5 m; must be 1.8500 m within 2 %, the change of the cylinder's length "
            "over joints.extension = [0, 3.7] m, or be left out",
            "100: bodies.column.mass = -1 kg; must be above 0",
            "121: pump.efficiency is missing; must be a number above 0 and at most 1, such as 0.5, or a mapping with "
            "the keys speed, speeds, displacements, pressures, total",
            "127: pump.efficency is not a key here; valid keys: constant_pressure, ls_margin, max_pressure, max_flow, "
            "tank_pressure, efficiency; did you mean efficiency?",
        ],
    ),
}


@pytest.mark.parametrize(("edits", "expected"), BAD_MACHINES.values(), ids=BAD_MACHINES)
def test_bad_machine_file(tmp_path, edits, expected):
    found = problems(load_machine, written(tmp_path, edited(FORWARDER, edits)))
    assert found == [f"bad.yaml:{text}" for text in expected]


def test_problems_of_the_simulation_are_named(tmp_path):
    text = dump_machine(load_machine("forwarder"))
    text = text.replace("dead_zone: 53 %", "dead_zone: 95 %").replace("dead_volume: 1 l", "dead_volume: 1 m")
    found = " ".join(problems(load_machine, written(tmp_path, text)))
    assert "simulation.dead_zone = 95 %; must be from 0 to 0.9" in found
    assert "simulation.dead_volume = 1 m; must be a finite volume in cm^3, l, m^3, such as 1.5 l" in found
