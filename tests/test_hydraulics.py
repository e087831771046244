"""Hydraulics against the valves' orifice equations solved numerically, force balances and tables of truth."""

from __future__ import annotations

from dataclasses import replace
from math import pi, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

from leanboom.components.pumps import Pump
from leanboom.components.valves import Connection, Drive, IndependentMetering, MobileValve
from leanboom.formulas import hydraulics
from leanboom.io.loading import load_machine

FORWARDER, LOADER = load_machine("forwarder"), load_machine("loader")
BASE, LIFT, TILT, EXTENSION = FORWARDER.cylinders
DROP = 0.7e6  # [Pa]
K = 3.39e-6  # flow coefficient of the metering-in edge [m^3/(s sqrt(Pa))]
FORCE = st.floats(-2e5, 2e5)
SPEED = st.floats(0.003, 0.4)


def pump(tank=0.0):
    return Pump(20e6, 3e6, 21.5e6, 325 / 6e4, tank)


def line(drive, F, extending):
    """The driven pressure that a `Drive` gives."""
    return drive.gain_out * F + drive.back_out if extending else drive.back_in - drive.gain_in * F


def with_valve(cylinder, tank=0.0, ratio=1.0, extend=1.5, retract=1.9):
    return MobileValve(DROP, extend, retract, ratio).steady(cylinder, pump(tank))


# Pressures


def root(flow_balance, low, high):
    """The pressure at which a monotone flow balance vanishes."""
    return brentq(flow_balance, low, high, xtol=1e-6, rtol=1e-15)


@pytest.mark.parametrize("tank", [0.0, 0.4e6])
@given(F=FORCE, share=st.floats(0.5, 1.5))
def test_standard_spool_extending_solves_its_orifices(tank, F, share):
    """Eqs. (20)-(22): what flows in over P-A at the compensator's drop leaves over B-T against the tank."""
    a, b = TILT.piston_area, TILT.rod_side_area
    edge = share * K  # B-T
    v = K * sqrt(DROP) / a
    p_b = root(lambda p: edge * sqrt(p - tank) - v * b, tank, tank + 5e7)
    p_a = (F + p_b * b) / a
    coefficient = (K * b / (edge * a)) ** 2  # named in eq. (24)
    drive = with_valve(TILT, tank, extend=coefficient)
    assert line(drive, F, extending=True) == pytest.approx(p_a, rel=1e-9, abs=1e-2)
    assert (drive.area_out, drive.area_in) == (a, b)


@pytest.mark.parametrize("tank", [0.0, 0.4e6])
@given(F=FORCE, share=st.floats(0.8, 1.6))
def test_standard_spool_retracting_solves_its_orifices(tank, F, share):
    a, b = TILT.piston_area, TILT.rod_side_area
    edge = share * K  # A-T
    v = K * sqrt(DROP) / b
    p_a = root(lambda p: edge * sqrt(p - tank) - v * a, tank, tank + 5e7)
    p_b = (p_a * a - F) / b
    coefficient = (K * a / (edge * b)) ** 2  # named in eq. (23)
    drive = with_valve(TILT, tank, retract=coefficient)
    assert line(drive, F, extending=False) == pytest.approx(p_b, rel=1e-9, abs=1e-2)


@given(F=FORCE, ratio=st.floats(0.5, 2.0))
def test_differential_spool_extending_solves_its_orifices(F, ratio):
    """Eqs. (20), (25), (26): the rod side flows back through P, so only A - B comes from the pump."""
    a, b = EXTENSION.piston_area, EXTENSION.rod_side_area
    edge = K / ratio  # B-P
    pump_flow = K * sqrt(DROP)

    def balance(p_b):  # of eq. (20): Q_A / A = -Q_B / B
        p_a = (F + p_b * b) / a
        back = edge * sqrt(max(0.0, p_b - p_a - DROP))
        return (pump_flow + back) / a - back / b

    least = (F / a + DROP) / (1.0 - b / a)  # below, nothing flows back
    p_b = root(balance, least, least + 5e8)
    drive = with_valve(EXTENSION, ratio=ratio)
    assert line(drive, F, extending=True) == pytest.approx((F + p_b * b) / a, rel=1e-8, abs=1.0)
    back = edge * sqrt(p_b - (F + p_b * b) / a - DROP)
    v = back / b
    assert drive.area_out * v == pytest.approx(pump_flow, rel=1e-6)
    assert drive.area_in == b


def test_differential_spool_adds_what_was_worked_out_elsewhere():
    """5.1 MPa in the rod side, 3.0 MPa in the piston side, with equal flow coefficients."""
    drive = with_valve(EXTENSION)
    p_a = drive.back_out
    p_b = p_a * EXTENSION.piston_area / EXTENSION.rod_side_area  # without a force
    assert (p_b / 1e6, p_a / 1e6) == pytest.approx((5.1, 3.0), abs=0.05)


@given(F=FORCE)
def test_differential_spool_retracts_like_a_standard_one(F):
    standard = with_valve(replace(EXTENSION, connection=Connection.STANDARD))
    assert line(with_valve(EXTENSION), F, extending=False) == line(standard, F, extending=False)


@given(F=FORCE)
def test_single_acting_cylinder_holds_its_load_with_one_chamber(F):
    drive = with_valve(LIFT)
    assert line(drive, F, extending=True) * LIFT.piston_area == pytest.approx(F, rel=1e-12)
    assert line(drive, F, extending=False) == 0.0
    assert (drive.area_out, drive.area_in) == (LIFT.piston_area, 0.0)


@pytest.mark.parametrize("back", [0.0, 1e6])
@given(F=FORCE)
def test_independent_metering_balances_the_force(back, F):
    """Eqs. (34)-(35), 3-DOF paper: |F| over the driven area, plus the other side's pressure by the area ratio."""
    cylinder = LOADER.cylinders[0]
    a, b = cylinder.piston_area, cylinder.rod_side_area
    drive = IndependentMetering(back, 1e6).steady(cylinder, LOADER.pump)
    assert line(drive, F, extending=True) * a - back * b == pytest.approx(F, rel=1e-9, abs=1e-6)
    assert back * a - line(drive, F, extending=False) * b == pytest.approx(F, rel=1e-9, abs=1e-6)
    if F > 0.0:  # driven against its load when extending
        assert line(drive, F, extending=True) == pytest.approx(abs(F) / a + b / a * back, rel=1e-12)


def test_independent_metering_plans_with_the_planning_value():
    """Not with the pressure held off-side in the closed loop."""
    for drive in LOADER.drives:
        assert (drive.back_out, drive.back_in) == (0.0, 0.0)


def test_drives_come_in_joint_order():
    drives = FORWARDER.drives
    areas = [(c.piston_area, c.rod_side_area) for c in FORWARDER.cylinders]
    assert [(d.area_out, d.area_in) for d in drives] == [
        areas[0],
        (areas[1][0], 0.0),
        areas[2],
        (areas[3][0] - areas[3][1], areas[3][1]),
    ]


# Areas and flows


def test_areas_are_those_of_the_printed_bores():
    """cm^2 to the digits worked out elsewhere, and against the circle's formula."""
    worked_out = {
        "base": (103.87, 103.87),
        "lift": (113.10, 74.61),
        "tilt": (103.87, 75.59),
        "extension": (38.48, 22.58),
    }
    for cylinder in FORWARDER.cylinders:
        found = cylinder.piston_area * 1e4, cylinder.rod_side_area * 1e4
        assert found == pytest.approx(worked_out[cylinder.name], abs=0.006)
    assert (EXTENSION.piston_area - EXTENSION.rod_side_area) * 1e4 == pytest.approx(15.90, abs=0.006)
    for cylinder, bore, rod in zip(LOADER.cylinders, (0.08, 0.08, 0.05), (0.045, 0.045, 0.03), strict=True):
        assert cylinder.piston_area == pytest.approx(pi * bore**2 / 4, rel=1e-12)
        assert cylinder.rod_side_area == pytest.approx(pi * (bore**2 - rod**2) / 4, rel=1e-12)


def test_base_torque_at_the_highest_pressure():
    """25.6 kNm at 21.5 MPa with one rack."""
    assert BASE.linkage.arm * BASE.piston_area * 21.5e6 / 1e3 == pytest.approx(25.6, abs=0.05)


@pytest.mark.parametrize(
    ("cylinder", "extending", "retracting"),
    [(BASE, 62, 62), (LIFT, 102, 0), (TILT, 93, 68), (EXTENSION, 38, 54)],
    ids=lambda value: getattr(value, "name", None),
)
def test_flows_at_the_velocity_limits(cylinder, extending, retracting):
    """l/min, worked out elsewhere; the lift sinks without the pump."""
    drive = FORWARDER.valve.steady(cylinder, FORWARDER.pump)
    v = np.array([1.0, -1.0]) * cylinder.velocity_limit
    flow = hydraulics.cylinder_flow(v, drive.area_out, drive.area_in) * 6e4
    assert flow == pytest.approx((extending, retracting), abs=0.5)


@given(v=st.floats(-0.5, 0.5), area_out=st.floats(1e-4, 1e-2), area_in=st.floats(0.0, 1e-2))
def test_pump_flow_is_that_of_equation_37(v, area_out, area_in):
    expected = v * (area_out if v > 0.0 else -area_in if v < 0.0 else 0.5 * (area_out - area_in))
    assert hydraulics.cylinder_flow(v, area_out, area_in) == pytest.approx(expected, rel=1e-15)
    assert hydraulics.cylinder_flow(v, area_out, area_in) >= 0.0


def test_reused_return_flow_is_that_of_equation_37_of_the_3dof_paper():
    assert hydraulics.cylinder_flow(0.2, 2.0, -2.0) == pytest.approx(0.4)
    assert hydraulics.cylinder_flow(-0.2, 2.0, -2.0) == pytest.approx(-0.4)


# Demanded pressures, eq. (41)

EPSILON = 0.002
DRIVE = Drive(5e-3, 3e-3, 1 / 5e-3, 0.6e6, 1 / 3e-3, 2.0e6)


def counted(v, F, drive=DRIVE, epsilon=EPSILON):
    return hydraulics.pressure_demand(v, F, epsilon, drive.gain_out, drive.back_out, drive.gain_in, drive.back_in)


@pytest.mark.parametrize(
    ("v", "F", "pressure"),
    [
        (0.1, 3e4, 6.6e6),  # raises its load: F / A + back
        (-0.1, -3e4, 12e6),  # pulls its load: |F| / B + back
        (0.1, -3e4, 0.0),  # the load pulls it out
        (-0.1, 3e4, 0.0),  # the load pushes it in
        (0.0019, 3e4, 0.0),  # slower than epsilon: not driven
        (-0.0019, -3e4, 0.0),
        (0.0, 3e4, 0.0),
        (0.002, 3e4, 3.3e6),  # H(0) = 1/2 at the threshold
        (-0.002, -3e4, 6e6),
        (0.0021, 3e4, 6.6e6),
        (-0.0021, -3e4, 12e6),
        (0.1, 0.0, 0.3e6),  # H(0) = 1/2 without a load
        (-0.1, 0.0, 1e6),
        (0.0, 0.0, 0.0),
    ],
)
def test_demanded_pressures(v, F, pressure):
    assert counted(v, F) == pytest.approx(pressure, rel=1e-12, abs=1e-9)


@given(v=st.floats(-0.4, 0.4), F=st.floats(-3e5, 3e5))
def test_demanded_pressure_is_equation_41(v, F):
    """Written out with an `if` for every Heaviside step."""

    def step(x):
        return 0.5 if x == 0.0 else float(x > 0.0)

    p_a = F / 5e-3 + 0.6e6
    p_b = -F / 3e-3 + 2.0e6
    expected = (p_a * step(v - EPSILON) + p_b * step(-v - EPSILON)) * step(F * v)
    assert counted(v, F) == pytest.approx(expected, rel=1e-12, abs=1e-9)


@given(v=st.floats(-0.4, 0.4), F=FORCE)
def test_a_demanded_pressure_is_never_negative(v, F):
    for drive in (*FORWARDER.drives, *LOADER.drives):
        assert counted(v, F, drive) >= -1e-300  # F v may underflow to zero


@given(v=SPEED, F=st.floats(1.0, 2e5))
def test_a_pump_gives_at_least_the_work_its_cylinder_does(v, F):
    """Demanded pressure times pump flow covers force times velocity, extending and retracting."""
    for drive in (*FORWARDER.drives, *LOADER.drives):
        for sign in (1.0, -1.0):
            flow = hydraulics.cylinder_flow(sign * v, drive.area_out, drive.area_in)
            if flow > 0.0:
                assert counted(sign * v, sign * F, drive) * flow >= F * v * (1.0 - 1e-12)


# Power


def test_pump_power():
    """20 MPa x 60 l/min = 20 kW at the pump, 25 kW with an efficiency of 0.8."""
    assert hydraulics.pump_power(20e6, 1e-3, 1.0, 0.0, 0.0, 0.0) == pytest.approx(20e3)
    assert hydraulics.pump_power(20e6, 1e-3, 0.8, 0.0, 0.0, 0.0) == pytest.approx(25e3)


@given(v=st.floats(-0.4, 0.4), F=FORCE)
def test_actuator_work_counts_only_when_positive(v, F):
    assert hydraulics.positive_work(v, F) == max(F * v, 0.0)
