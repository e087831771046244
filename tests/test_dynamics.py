"""Rigid-body dynamics against two independent libraries, printed torques, and the conservation of energy.

The oracles know nothing of a telescope's coupling: a body that moves along by a share of the extension gets its
own prismatic joint there, and the coupling q_own = share x q4 is projected onto the crane's four joints.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from leanboom.formulas import dynamics, kinematics
from leanboom.io.loading import load_machine, load_task
from leanboom.model import crane as cranes
from leanboom.model.machine import Body

NAMES = ("forwarder", "loader")
SHARE = st.floats(0.0, 1.0)
RATE = st.floats(-1.0, 1.0)
SHARES = st.tuples(SHARE, SHARE, SHARE)
RATES = st.tuples(RATE, RATE, RATE, RATE)


def crane(name, payload=0.0, gravity=9.81):
    """A bundled crane with a payload."""
    machine = replace(load_machine(name), gravity=gravity)
    return cranes.build(replace(load_task(f"{name}-{TASK[name]}"), machine=machine, payload=payload))


TASK = {"forwarder": "horizontal", "loader": "triangle-large"}
CRANES = {name: crane(name, 475.0 if name == "loader" else 120.0) for name in NAMES}
COUNTERWEIGHT = Body("counterweight", "base", 300.0, -0.8, 0.5, 20.0)  # off the slewing axis
CRANES["forwarder"] = replace(CRANES["forwarder"], bodies=(*CRANES["forwarder"].bodies, COUNTERWEIGHT))


def state(machine, shares):
    """Lift, tilt and extension at shares of their ranges."""
    return [j.lower + s * (j.upper - j.lower) for j, s in zip(machine.joints[-3:], shares, strict=True)]


def coupling(crane):
    """Shares of the telescoping bodies, and the matrix from base, lift, tilt, extension to the oracles' joints."""
    shares = sorted({body.extension_share for body in crane.bodies} - {0.0})
    matrix = np.zeros((3 + len(shares), 4))
    matrix[:3, :3] = np.eye(3)
    matrix[3:, 3] = shares
    return shares, matrix


def inertia_matrix(body):
    """Slender rod along its link; the column's only number is that about the vertical."""
    if body.carrier == "base":
        return np.diag([body.inertia, body.inertia, body.inertia])
    return np.diag([0.0, body.inertia, body.inertia])


class Pinocchio:
    """The crane in Pinocchio: projected mass matrix, gravity torques and velocity torques of its four joints."""

    def __init__(self, crane):
        import pinocchio as pin

        g = crane.machine.geometry
        shares, self.coupling = coupling(crane)
        self.pin, self.model = pin, pin.Model()
        self.model.gravity.linear = np.array([0.0, 0.0, -crane.machine.gravity])
        upward = pin.JointModelRevoluteUnaligned(np.array([0.0, -1.0, 0.0]))  # x towards z
        place = pin.SE3(np.eye(3), np.zeros(3))
        ids = {"base": self.model.addJoint(0, pin.JointModelRZ(), place, "base")}
        place = pin.SE3(np.eye(3), np.array([g.base_x, 0.0, g.base_z]))
        ids["lift"] = self.model.addJoint(ids["base"], upward, place, "lift")
        place = pin.SE3(np.eye(3), np.array([g.boom, 0.0, 0.0]))
        ids["tilt"] = self.model.addJoint(ids["lift"], upward, place, "tilt")
        for share in shares:
            place = pin.SE3(np.eye(3), np.zeros(3))
            ids[share] = self.model.addJoint(ids["tilt"], pin.JointModelPX(), place, f"share {share}")
        for body in crane.bodies:
            centre = np.array([body.along, 0.0, body.above])
            joint = ids[body.extension_share or body.carrier]
            self.model.appendBodyToJoint(
                joint, pin.Inertia(body.mass, centre, inertia_matrix(body)), pin.SE3.Identity()
            )
        self.data = self.model.createData()

    def mass(self, q):
        self.pin.crba(self.model, self.data, self.coupling @ q)
        full = np.triu(self.data.M)
        full = full + np.triu(full, 1).T
        return self.coupling.T @ full @ self.coupling

    def gravity(self, q):
        return self.coupling.T @ self.pin.computeGeneralizedGravity(self.model, self.data, self.coupling @ q)

    def velocity(self, q, v):
        q, v = self.coupling @ q, self.coupling @ v
        moving = self.pin.nonLinearEffects(self.model, self.data, q, v).copy()
        return self.coupling.T @ (moving - self.pin.computeGeneralizedGravity(self.model, self.data, q))


class MuJoCo:
    """The same in MuJoCo, from its own description language, which allows nothing without inertia."""

    LEAST = 1e-12

    def __init__(self, crane):
        import mujoco

        g = crane.machine.geometry
        shares, self.coupling = coupling(crane)

        def bodies(carrier, share=0.0):
            return "".join(
                f'<body><inertial pos="{b.along} 0 {b.above}" mass="{b.mass}" '
                f'diaginertia="{" ".join(str(max(i, self.LEAST)) for i in np.diag(inertia_matrix(b)))}"/></body>'
                for b in crane.bodies
                if b.carrier == carrier and b.extension_share == share
            )

        slides = "".join(f'<body><joint type="slide" axis="1 0 0"/>{bodies("tilt", s)}</body>' for s in shares)
        text = f"""
            <mujoco>
              <compiler angle="radian"/>
              <option gravity="0 0 {-crane.machine.gravity}"/>
              <worldbody>
                <body>
                  <inertial pos="0 0 0" mass="{self.LEAST}" diaginertia="{self.LEAST} {self.LEAST} {self.LEAST}"/>
                  <joint type="hinge" axis="0 0 1"/>{bodies("base")}
                  <body pos="{g.base_x} 0 {g.base_z}"><joint type="hinge" axis="0 -1 0"/>{bodies("lift")}
                    <body pos="{g.boom} 0 0"><joint type="hinge" axis="0 -1 0"/>{bodies("tilt")}{slides}</body>
                  </body>
                </body>
              </worldbody>
            </mujoco>"""
        self.mujoco, self.model = mujoco, mujoco.MjModel.from_xml_string(text)
        self.data = mujoco.MjData(self.model)

    def at(self, q, v):
        self.data.qpos[:], self.data.qvel[:] = self.coupling @ q, self.coupling @ v
        self.mujoco.mj_forward(self.model, self.data)

    def mass(self, q):
        self.at(q, np.zeros(4))
        full = np.zeros((self.model.nv, self.model.nv))
        self.mujoco.mj_fullM(self.model, self.data, full)
        return self.coupling.T @ full @ self.coupling

    def gravity(self, q):
        self.at(q, np.zeros(4))
        return self.coupling.T @ self.data.qfrc_bias

    def velocity(self, q, v):
        self.at(q, v)
        moving = self.data.qfrc_bias.copy()
        return self.coupling.T @ moving - self.gravity(q)


@pytest.fixture(scope="module", params=NAMES)
def ours(request):
    return CRANES[request.param]


@pytest.fixture(scope="module", params=[Pinocchio, MuJoCo], ids=lambda kind: kind.__name__)
def oracle(request, ours):
    return request.param(ours)


def planar(inertia):
    """M22, M23, M24, M33, M34, M44 as a matrix."""
    m22, m23, m24, m33, m34, m44 = inertia
    return np.array([[m22, m23, m24], [m23, m33, m34], [m24, m34, m44]])


@settings(max_examples=40)
@given(shares=SHARES, q1=st.floats(-3.0, 3.0))
def test_inertia_and_gravity_are_those_of_other_libraries(ours, oracle, shares, q1):
    q = np.array([q1, *state(ours.machine, shares)])
    inertia, gravity = cranes.inertia_and_gravity(ours, *q[1:])
    m11, _ = cranes.slewing(ours, q[1:], (0.0, 0.0, 0.0))
    mass = oracle.mass(q)
    assert planar(inertia) == pytest.approx(mass[1:, 1:], rel=1e-11, abs=1e-8)
    assert m11 == pytest.approx(mass[0, 0], rel=1e-11)
    assert mass[0, 1:] == pytest.approx(np.zeros(3), abs=1e-8)  # why slewing may be treated apart
    assert gravity == pytest.approx(oracle.gravity(q)[1:], rel=1e-11, abs=1e-7)


@settings(max_examples=40)
@given(shares=SHARES, v=RATES)
def test_velocity_torques_are_those_of_other_libraries(ours, oracle, shares, v):
    q, v = np.array([0.4, *state(ours.machine, shares)]), np.array(v)
    torques = oracle.velocity(q, v)
    assert cranes.velocity_torques(ours, q[1:], v) == pytest.approx(torques[1:], rel=1e-10, abs=1e-7)
    _, rate = cranes.slewing(ours, q[1:], v[1:])
    assert rate * v[0] == pytest.approx(torques[0], rel=1e-10, abs=1e-7)


def arms(crane, q):
    """Torque arms of lift, tilt and extension."""
    return np.array(
        [c.linkage.length_arm_slope(value)[1] for c, value in zip(crane.machine.cylinders[-3:], q, strict=True)]
    )


@pytest.mark.parametrize(
    ("name", "payload", "q", "torques", "forces"),
    [
        ("forwarder", 0, (0.3, -1.0, 1.0), (39386.3, 10639.0, -2322.5), (89.24, -29.54, -4.65)),
        ("forwarder", 0, (0.117, -0.25, 3.7), (51729.7, 21774.9, -478.1), (117.84, -67.51, -0.96)),
        ("forwarder", 0, (0.8, -1.6, 0.5), (29526.6, 8743.9, -2586.2), (76.75, -29.63, -5.17)),
        ("loader", 475, (0.90673, -1.52200, 0.2), None, (51.832, 31.109, -3.228)),
        ("loader", 475, (1.15799, -1.75903, 0.6), None, (61.067, 39.591, -3.163)),
    ],
)
def test_static_torques_and_forces_worked_out_elsewhere(name, payload, q, torques, forces):
    """Gravity alone, 9.81 m/s^2: torques to 0.1 N m, forces to the last digit of kN."""
    ours = crane(name, payload)
    _, gravity = cranes.inertia_and_gravity(ours, *q)
    if torques:
        assert gravity == pytest.approx(torques, abs=0.06)
    assert np.array(gravity) / arms(ours, q) / 1e3 == pytest.approx(forces, abs=0.006 if torques else 0.0011)


@pytest.mark.parametrize(
    ("load", "lift", "tilt", "lift_pressure", "tilt_pressure"),
    [(0.0, 51.7, 21.8, 10.4, 8.9), (420.0, 90.1, 45.8, 18.1, 18.8)],
    ids=["230 kg", "650 kg"],
)
def test_static_pressures_at_full_reach(load, lift, tilt, lift_pressure, tilt_pressure):
    """9.10 m out, 1.61 m up: the grapple's 230 kg are a body, the rest of the 650 kg a payload."""
    ours = crane("forwarder", load)
    q = (0.117, -0.25, 3.7)
    _, gravity = cranes.inertia_and_gravity(ours, *q)
    assert np.array(gravity[:2]) / 1e3 == pytest.approx((lift, tilt), abs=0.06)
    force = np.array(gravity) / arms(ours, q)
    _, lift_cylinder, tilt_cylinder, _ = ours.machine.cylinders
    assert force[0] / lift_cylinder.piston_area / 1e6 == pytest.approx(lift_pressure, abs=0.06)
    assert -force[1] / tilt_cylinder.rod_side_area / 1e6 == pytest.approx(tilt_pressure, abs=0.06)


def height(body, q2, q3, q4, geometry):
    """Height of a body's centre of mass above the lift joint."""
    if body.carrier == "lift":
        return body.along * np.sin(q2) + body.above * np.cos(q2)
    along = body.along + body.extension_share * q4
    return kinematics.tool_point(q2, q3, along, 0.0, 0.0, geometry.boom, body.above, 0.0)[1]


def potential(crane, q2, q3, q4):
    """Potential energy, from the heights of the bodies."""
    m, g = crane.machine, crane.machine.geometry
    return sum(b.mass * m.gravity * height(b, q2, q3, q4, g) for b in crane.bodies if b.carrier != "base")


@given(shares=SHARES)
def test_gravity_torques_are_the_slope_of_the_potential_energy(ours, shares):
    q = np.array(state(ours.machine, shares))
    h = 1e-4
    slopes = [(potential(ours, *(q + h * e)) - potential(ours, *(q - h * e))) / (2.0 * h) for e in np.eye(3)]
    assert cranes.inertia_and_gravity(ours, *q)[1] == pytest.approx(slopes, rel=1e-6, abs=1e-3)


@given(shares=SHARES, v=RATES)
def test_kinetic_energy_is_positive(ours, shares, v):
    q = state(ours.machine, shares)
    matrix = planar(cranes.inertia_and_gravity(ours, *q)[0])
    assert np.linalg.eigvalsh(matrix).min() > 0.0
    assert cranes.slewing(ours, q, v[1:])[0] > 0.0


@given(shares=SHARES, v=RATES)
def test_slewing_rate_is_the_derivative_of_the_slewing_inertia(ours, shares, v):
    q, v = np.array(state(ours.machine, shares)), np.array(v[1:])
    h = 1e-4
    ends = [cranes.slewing(ours, q + k * h * v, v)[0] for k in (-1, 1)]
    rate = cranes.slewing(ours, q, v)[1]
    assert rate == pytest.approx((ends[1] - ends[0]) / (2.0 * h), rel=1e-6, abs=1e-3)


def total_energy(crane, q, v):
    """Kinetic and potential energy; q and v of base, lift, tilt, extension."""
    matrix = planar(cranes.inertia_and_gravity(crane, *q[1:])[0])
    m11, _ = cranes.slewing(crane, q[1:], v[1:])
    return 0.5 * v[1:] @ matrix @ v[1:] + 0.5 * m11 * v[0] ** 2 + potential(crane, *q[1:])


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", range(3))
def test_a_crane_left_to_itself_keeps_energy_and_angular_momentum(name, seed):
    """Swinging and slewing without valves or friction for two seconds."""
    ours = CRANES[name]
    rng = np.random.default_rng(seed)
    start = np.array([0.0, *state(ours.machine, rng.uniform(0.3, 0.7, 3)), *rng.uniform(-0.5, 0.5, 4)])

    def rates(_, y):
        q, v = y[:4], y[4:]
        inertia, gravity = cranes.inertia_and_gravity(ours, *q[1:])
        m11, rate = cranes.slewing(ours, q[1:], v[1:])
        load = np.array(gravity) + cranes.velocity_torques(ours, q[1:], v)
        return np.array([*v, -rate * v[0] / m11, *np.linalg.solve(planar(inertia), -load)])

    path = solve_ivp(rates, (0.0, 2.0), start, method="DOP853", rtol=1e-10, atol=1e-10, t_eval=np.linspace(0, 2, 21))
    energy = np.array([total_energy(ours, y[:4], y[4:]) for y in path.y.T])
    momentum = np.array([cranes.slewing(ours, y[1:4], y[5:])[0] * y[4] for y in path.y.T])
    kinetic = energy - [potential(ours, *y[1:4]) for y in path.y.T]
    assert np.ptp(kinetic) > 1e3  # something happens
    assert np.ptp(energy) < 1e-6 * np.ptp(kinetic)
    assert np.ptp(momentum) < 1e-8 * np.abs(momentum).max()


def test_a_rod_resists_slewing_across_but_not_along_itself():
    assert dynamics.slewing_inertia(0.0, 10.0, 7.0, 0.0) == 7.0
    assert dynamics.slewing_inertia(0.0, 10.0, 7.0, np.pi / 2) == pytest.approx(0.0, abs=1e-15)
    assert dynamics.slewing_inertia(2.0, 10.0, 7.0, 0.0) == 47.0


def test_a_payload_is_a_point_mass_at_the_tool():
    with_load, without = crane("forwarder", 420.0), crane("forwarder")
    (load,) = set(with_load.bodies) - set(without.bodies)
    assert load == Body("payload", "tilt", 420.0, 2.13, 0.376, 0.0, 1.0)
    g = with_load.machine.geometry
    q = (0.3, -1.2, 1.7)
    _, loaded = cranes.inertia_and_gravity(with_load, *q)
    _, empty = cranes.inertia_and_gravity(without, *q)
    slopes = kinematics.jacobian(*q, g.boom, g.offset, g.outer)[3:]  # of the tool's height
    assert np.subtract(loaded, empty) == pytest.approx(420.0 * 9.81 * np.array(slopes), rel=1e-12)


def test_heaviside_is_one_half_at_zero():
    assert dynamics.heaviside(np.array([-2.0, -1e-300, 0.0, 1e-300, 3.0])).tolist() == [0.0, 0.0, 0.5, 1.0, 1.0]


def test_extension_friction_has_three_plateaus_and_two_ramps():
    """Eqs. (A3)-(A4): 3.0, 4.5 and 6.0 kN, without a jump at any of the four positions."""
    steps = (0.8, 1.3, 2.2, 2.7)
    q = np.array([0.0, 0.8, 1.05, 1.3, 1.8, 2.2, 2.45, 2.7, 3.7])
    level = 3.0 * dynamics.stepped_coulomb(q, *steps)
    assert level == pytest.approx([3.0, 3.0, 3.75, 4.5, 4.5, 4.5, 5.25, 6.0, 6.0], abs=1e-12)
    around = 3.0 * dynamics.stepped_coulomb(np.add.outer(np.array(steps), [-1e-9, 1e-9]), *steps)
    assert around[:, 0] == pytest.approx(around[:, 1], abs=1e-8)


@given(v=st.floats(-0.4, 0.4))
def test_friction_opposes_motion(v):
    force = dynamics.friction(v, 3000.0, 2000.0, 150.0)
    assert force == -dynamics.friction(-v, 3000.0, 2000.0, 150.0)
    assert force * v >= 0.0
    assert abs(force) <= 3000.0 + 150.0 * abs(v)


def test_friction_away_from_standstill_is_coulomb_plus_viscous():
    assert dynamics.friction(0.01, 3000.0, 2000.0, 150.0) == pytest.approx(3001.5, rel=1e-12)
    assert dynamics.friction(0.0005, 3000.0, 2000.0, 0.0) == pytest.approx(3000.0 * np.tanh(1.0), rel=1e-12)
