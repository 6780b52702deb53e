"""Compliant contacts: laws of the normal force, friction with creep and with bristles."""

import math

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import mbd_ros as mbd
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.state import State
from mbd_ros.errors import SceneError

G = 9.81
FINE = {"type": "dop853", "tolerance": 1e-12}


def ball(contact, velocity=-2.0, height=0.0, gravity=0.0, **more):
    """A ball of 3 kg and radius 0.1 m over the ground."""
    return mbd.scene_from(
        {
            "bodies": {"ball": {"shape": {"sphere": 0.1}, "mass": 3.0}},
            "gravity": [0.0, 0.0, -gravity],
            "contacts": [{"type": "compliant", "between": ["ball", "ground"], **contact}],
            "initial": {
                "pose": {"ball": {"xyz": [0.0, 0.0, 0.1 + height]}},
                "twist": {"ball": {"linear": [0.0, 0.0, velocity]}},
            },
            "dt": 1e-3,
            **more,
        }
    )


def block(contact, pull, **more):
    """A cube of 2 kg and 0.2 m on the ground, pulled along x by a force at its middle."""
    given = {"type": "compliant", "between": ["cube", "ground"], "stiffness": 2e5, **contact}
    depth = 2.0 * G / (4 * 2e5)
    return mbd.scene_from(
        {
            "bodies": {"cube": {"shape": {"box": [0.2, 0.2, 0.2]}, "mass": 2.0}},
            "contacts": [given],
            "forces": [
                {
                    "type": "prescribed_wrench",
                    "frame": "cube",
                    "expressed_in": "world",
                    "times": [t for t, _ in pull],
                    "wrenches": [[f, 0, 0, 0, 0.1 * f, 0] for _, f in pull],
                }
            ],
            "initial": {"pose": {"cube": {"xyz": [0.0, 0.0, 0.1 - depth]}}},
            "dt": 1e-3,
            **more,
        }
    )


def states(scene, duration, **options):
    simulation = scene.simulation(**options)
    return list(simulation.run(scene.initial, duration)), simulation.system


def test_an_undamped_spring_gives_a_ball_back_after_half_a_period():
    """d = v sqrt(m/k) sin(t sqrt(k/m)), then it leaves as fast as it came."""
    stiffness, mass, speed = 3e4, 3.0, 2.0
    rate = math.sqrt(stiffness / mass)
    found, _ = states(ball({"stiffness": stiffness}, -speed), 0.05, integrator=FINE)
    for x in found:
        t = min(x.t, math.pi / rate)
        depth = speed / rate * math.sin(rate * t) - speed * (x.t - t)
        assert 0.1 - x.q[2] == pytest.approx(depth, abs=1e-9)


LAWS = {
    "linear": ({"stiffness": 3e4, "dissipation": 90.0}, lambda d, v: 3e4 * d + 90.0 * v),
    "hertz": (
        {"law": "hunt_crossley", "stiffness": 1e6, "dissipation": 0.2},
        lambda d, v: 1e6 * d**1.5 * (1.0 + 0.2 * v),
    ),
    "square": (
        {"law": "hunt_crossley", "stiffness": 1e8, "dissipation": 0.7, "exponent": 2.0},
        lambda d, v: 1e8 * d**2 * (1.0 + 0.7 * v),
    ),
}


@pytest.mark.parametrize("name", LAWS)
def test_a_falling_ball_moves_as_equations_written_by_hand(name):
    contact, law = LAWS[name]

    def rates(t, y):
        depth, approach = 0.1 - y[0], -y[1]
        return [y[1], (max(law(depth, approach), 0.0) if depth > 0.0 else 0.0) / 3.0 - G]

    scene = ball(contact, 0.0, 0.05, G)
    found, _ = states(scene, 0.4, integrator={**FINE, "tolerance": 1e-10})
    times = [x.t for x in found]
    by_hand = solve_ivp(
        rates, (0.0, 0.41), [0.15, 0.0], "LSODA", times, rtol=1e-10, atol=1e-12, max_step=1e-3
    )
    assert min(x.q[2] for x in found) < 0.1
    assert np.abs([x.q[2] for x in found] - by_hand.y[0]).max() < 1e-6


@pytest.mark.parametrize("name", LAWS)
def test_a_contact_never_pulls_and_ends_with_the_spring(name):
    contact, _ = LAWS[name]
    scene = ball(contact)
    part, k = scene.parts["contacts"][0], Kinematics(scene.robot)
    for depth in (-1e-3, 0.0, 1e-6, 1e-3, 0.02):
        for speed in (-90.0, -1.0, 0.0, 1.0, 90.0):
            q = scene.initial.q.copy()
            q[2], v = 0.1 - depth, np.array([0.0, 0.0, speed, 0.0, 0.0, 0.0])
            k.refresh(q, v, Reads.JACOBIAN)
            normal = part.multipliers(k, State(0.0, q, v))[0]
            assert normal >= 0.0 and (depth > 0.0 or normal == 0.0)


def test_friction_creeps_as_stated_and_slides_with_coulombs_force():
    """At a share w of break-away the slip r = v/creep solves (3 r - r^3) / 2 = w."""
    mu, creep, mass = 0.5, 2e-3, 2.0
    contact = {"friction": mu, "creep": creep, "dissipation": 400.0}
    for share in (0.1, 0.95):
        force = share * mu * mass * G
        scene = block(contact, [(0.0, force), (9.0, force)])
        found, _ = states(scene, 0.25, integrator={"type": "gauss_legendre"}, dt=1e-3)
        r = brentq(lambda r, w=share: 0.5 * (3.0 * r - r**3) - w, 0.0, 1.0)
        assert found[-1].v[0] == pytest.approx(r * creep, rel=1e-6)
    scene = block(contact, [(0.0, 20.0), (9.0, 20.0)])
    found, _ = states(scene, 0.25, integrator={"type": "rk4"}, dt=1e-4)
    acceleration = 20.0 / mass - mu * G
    gained = found[-1].v[0] - found[1500].v[0]
    assert gained == pytest.approx(acceleration * (found[-1].t - found[1500].t), rel=1e-6)


BRISTLE = {
    **{"friction": 0.5, "bristle_stiffness": 1e5, "bristle_damping": 300.0},
    "dissipation": 400.0,
}


def test_a_bristle_holds_a_constant_load_without_creep():
    force = 0.9 * 0.5 * 2.0 * G
    scene = block(BRISTLE, [(0.0, force), (99.0, force)])
    found, _ = states(scene, 2.0, integrator={"type": "gauss_legendre", "stages": 1}, dt=2e-3)
    late = np.array([x.q[0] for x in found if x.t > 1.0])
    assert np.ptp(late) < 1e-13
    assert abs(found[-1].v[0]) < 1e-13  # m/s: 6e-12 m in 60 s
    part, (z, x) = scene.parts["contacts"][0], (found[-1].z, found[-1])
    k = Kinematics(scene.robot)
    k.refresh(x.q, x.v, Reads.JACOBIAN)
    assert part.multipliers(k, x)[1::3].sum() == pytest.approx(-force, rel=1e-9)
    assert -1e5 * z[::2][part.multipliers(k, x)[::3] > 0.0].sum() == pytest.approx(-force)


def test_a_bristle_does_not_walk_under_a_load_that_swings():
    """0.5 +- 0.3 of break-away at 20 Hz: LuGre walks 0.25 mm/s; here the motion is linear."""
    most, f = 0.5 * 2.0 * G, 20.0
    times = np.arange(0.0, 1.0005, 5e-4)
    pull = [(t, most * (0.5 + 0.3 * math.sin(2.0 * math.pi * f * t))) for t in times.tolist()]
    scene = block(BRISTLE, pull)
    found, _ = states(scene, 0.9, integrator={"type": "gauss_legendre"}, dt=1e-3)
    means = [np.mean([x.q[0] for x in found[i : i + 50]]) for i in range(300, 851, 50)]
    assert np.ptp(means) / 0.55 < 1e-9  # m/s
    swing = np.ptp([x.q[0] for x in found[300:850]])
    assert 0.3 * most / 4e5 < 0.5 * swing < 0.6 * most / 4e5


def test_a_bristle_that_slips_lags_by_its_share_of_the_load():
    """Dragged along a circle at a large distance, the deflection follows the slip."""
    part = block(BRISTLE, [(0.0, 0.0), (1.0, 0.0)]).parts["contacts"][0]
    law, limit = part.friction_law, 5.0
    z, dt = (0.0, 0.0), 1e-5
    for step in range(20000):
        angle = 1e-3 * step
        slip = 0.1 * math.cos(0.001 * angle), 0.1 * math.sin(0.001 * angle)
        rate = law.rate(z, slip, limit)
        z = z[0] + dt * rate[0], z[1] + dt * rate[1]
        assert math.hypot(*law.force(z, slip, limit)) <= limit * (1.0 + 1e-12)
    assert math.hypot(*z) == pytest.approx(limit / 1e5, rel=1e-3)
    fx, fy = law.force(z, slip, limit)
    assert fx * slip[1] - fy * slip[0] == pytest.approx(0.0, abs=1e-2 * limit * 0.1)
    assert fx * slip[0] + fy * slip[1] < 0.0
    assert law.rate((1e-3, 0.0), (0.0, 0.0), 0.0)[0] == pytest.approx(-1e5 / 300.0 * 1e-3)


def test_check_takes_bristles_and_says_what_inverse_dynamics_lacks():
    text = block(BRISTLE, [(0.0, 0.0), (1.0, 0.0)]).check()
    assert "inverse     from columns of the forces of cube_contact alone, which has" in text
    assert "one acceleration" in text and "window      cube_contact: stiffness 2e+05 N/m" in text
    assert "cube_contact.vertex_0_bristle_x [m], starts at 0" in text


TABLE = """<robot name="legs"><link name="base"><inertial><mass value="4"/>
<inertia ixx="0.04" iyy="0.05" izz="0.06" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="shin"><inertial><origin xyz="0 0 -0.1"/><mass value="1"/>
<inertia ixx="0.004" iyy="0.004" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="tail"><inertial><origin xyz="0.1 0 0"/><mass value="0.5"/>
<inertia ixx="0.001" iyy="0.004" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="knee" type="revolute"><parent link="base"/><child link="shin"/><axis xyz="0 1 0"/>
<limit lower="-9" upper="9" effort="1" velocity="1"/></joint>
<joint name="wag" type="revolute"><parent link="base"/><child link="tail"/><axis xyz="0 1 0"/>
<limit lower="-9" upper="9" effort="1" velocity="1"/></joint></robot>"""


def walker(contact, **sections):
    """A floating base with two joints whose shin touches the ground and a free ball."""
    return mbd.scene_from(
        {
            "robot": {"base": "floating"},
            "bodies": {"ball": {"shape": {"sphere": 0.08}, "mass": 1.0}},
            "contacts": [
                {
                    **{"type": "compliant", "between": [shin, other], "stiffness": 2e4},
                    **contact,
                }
                for shin, other in (
                    ({"frame": "shin", "points": [[0, 0, -0.2], [0.05, 0.03, -0.2]]}, "ground"),
                    ({"frame": "base", "box": [0.2, 0.2, 0.1]}, "ground"),
                    ({"frame": "tail", "capsule": {"radius": 0.03, "length": 0.2}}, "ball"),
                    ("ball", {"half_space": [0.2, 0.1, 1.0], "xyz": [0, 0, -0.05]}),
                )
            ],
            **sections,
        },
        urdf=TABLE,
    )


SECTIONS = {
    "floating": {},
    "coupled": {"couplings": {"wag": {"parent": "knee", "factor": -0.5}}},
    "far": {"initial": {"pose": {"base": {"xyz": [100.0, -50.0, 0.0]}}}},
}


@pytest.mark.parametrize("name", SECTIONS)
def test_forces_of_springs_are_the_slopes_of_their_energy(name):
    """Without friction and dampers, against central differences, of all pairs at random poses."""
    scene = walker({"law": "hunt_crossley", "exponent": 2.0}, **SECTIONS[name])
    model, rng, touched = scene.robot.model, np.random.default_rng(5), 0
    k, zero = Kinematics(scene.robot), np.zeros(scene.robot.model.nv)
    for _ in range(30):
        q = pin.integrate(model, scene.initial.q, rng.normal(0.0, 0.15, model.nv))
        for part in scene.parts["contacts"]:

            def energy(dq, q=q, part=part):
                k.refresh(there := pin.integrate(model, q, dq), zero, Reads.POSITION)
                return part.potential(k, State(0.0, there, zero))

            k.refresh(q, zero, part.reads)
            force = part.force(k, State(0.0, q, zero), np.zeros(0))
            units = 1e-6 * np.eye(model.nv)
            slope = [(energy(-unit) - energy(unit)) / 2e-6 for unit in units]
            touched += bool(force.any())
            assert force == pytest.approx(slope, abs=1e-6 * (1.0 + np.abs(force).max()))
    assert touched > 40


@pytest.mark.parametrize(
    ("name", "friction"), [("floating", "creep"), ("coupled", "bristle"), ("far", "bristle")]
)
def test_friction_is_in_its_cone_and_contacts_take_energy(name, friction):
    law = {"creep": 0.2} if friction == "creep" else {k: BRISTLE[k] for k in list(BRISTLE)[1:3]}
    contact = {"friction": 0.6, "dissipation": 20.0, **law}
    scene = walker(contact, **SECTIONS[name])
    found, system = states(scene, 0.02, integrator={**FINE, "tolerance": 1e-8})
    energies = [system.energy(system.reduce(x)) for x in found]
    assert np.diff(energies).max() < 1e-7 * np.ptp(energies)
    assert energies[-1] < energies[0] - 0.1
    k, most = Kinematics(scene.robot), 0.0
    for x in found[::10]:
        k.refresh(x.q, x.v, Reads.JACOBIAN)
        for part in scene.parts["contacts"]:
            lam = part.multipliers(k, x).reshape(-1, 3)
            slip = part.pair.jacobian(k).dot(x.v).reshape(-1, 3)
            sides = np.hypot(lam[:, 1], lam[:, 2])
            assert (sides <= 0.6 * lam[:, 0] * (1.0 + 1e-12)).all()
            if friction == "creep":
                assert np.abs(lam[:, 1] * slip[:, 2] - lam[:, 2] * slip[:, 1]).max() < 1e-9
                assert (lam[:, 1] * slip[:, 1] + lam[:, 2] * slip[:, 2]).max() <= 0.0
            most = max(most, lam[:, 0].max())
    assert most > 10.0


METHODS = [
    ("rk4", 1e-4), ("dopri5", 1e-4), ("adams", 1e-4), ("semi_implicit_euler", 2e-5),
    ("gauss_legendre", 2e-4), ("generalized_alpha", 1e-4), ("moreau_jean", 2e-4),
]  # fmt: skip


@pytest.mark.parametrize(("method", "dt"), METHODS, ids=lambda value: str(value))
def test_every_integrator_takes_bristles(method, dt):
    """A weight on a rail that bounces and rubs, against equations written by hand."""
    rails = [("x", "world", "slide"), ("z", "slide", "weight")]
    links = "".join(
        f'<link name="{child}"><inertial><mass value="{mass}"/><inertia ixx="1" iyy="1" izz="1" '
        f'ixy="0" ixz="0" iyz="0"/></inertial></link>'
        for child, mass in (("slide", 0.5), ("weight", 1.5))
    )
    joints = "".join(
        f'<joint name="{name}" type="prismatic"><parent link="{a}"/><child link="{b}"/>'
        f'<axis xyz="{int(name == "x")} 0 {int(name == "z")}"/>'
        '<limit lower="-9" upper="9" effort="1" velocity="1"/></joint>'
        for name, a, b in rails
    )
    urdf = f'<robot name="rails"><link name="world"/>{links}{joints}</robot>'
    contact = {
        **{"type": "compliant", "between": [{"frame": "weight", "sphere": 0.0}, "ground"]},
        **{"stiffness": 2e4, "dissipation": 40.0, "friction": 0.5},
        **{"bristle_stiffness": 1e4, "bristle_damping": 60.0},
    }
    start = {"position": {"z": 0.002}, "velocity": {"x": 0.3}}
    scene = mbd.scene_from({"contacts": [contact], "initial": start}, urdf=urdf)

    def rates(t, y):
        _, z, vx, vz, bend = y
        normal = max(-2e4 * z - 40.0 * vz, 0.0) if z < 0.0 else 0.0
        trial = 1e4 * bend + 60.0 * vx
        if not normal:
            return [vx, vz, 0.0, -G, -1e4 / 60.0 * bend]
        rub = min(max(trial, -0.5 * normal), 0.5 * normal)
        sticks = abs(trial) <= 0.5 * normal
        bent = vx if sticks else (rub - 1e4 * bend) / 60.0
        return [vx, vz, -rub / 2.0, normal / 1.5 - G, bent]

    end = solve_ivp(
        rates, (0.0, 0.06), [0.0, 0.002, 0.3, 0.0, 0.0], rtol=1e-9, atol=1e-12, max_step=1e-4
    ).y[:, -1]
    found, _ = states(scene, 0.06, integrator={"type": method}, dt=dt)
    x = found[-1]
    assert np.concatenate((x.q, x.v)) == pytest.approx(end[:4], abs=2e-4)
    assert x.z[0] == pytest.approx(end[4], abs=2e-6)


@pytest.mark.parametrize(
    ("contact", "message"),
    [
        ({"friction": 0.5}, "needs creep"),
        ({"friction": -0.5, "creep": 1e-3}, "friction: -0.5 is out of range"),
        ({"friction": 0.5, "creep": 0.0}, "creep: 0 is out of range"),
        ({"friction": 0.5, "bristle_stiffness": 1e4}, "both bristle_stiffness and"),
        ({**BRISTLE, "creep": 1e-3}, "not both"),
        ({"exponent": 1.5}, "exponent is accepted with law: hunt_crossley only"),
        ({"stiffness": 0.0}, "stiffness: 0 is out of range"),
        ({"dissipation": -1.0}, "dissipation: -1 is out of range"),
        ({"law": "hertz"}, "law: expected one of linear, hunt_crossley"),
        ({"restitution": 0.5}, "unknown key 'restitution'"),
        ({"friction": [0.5, 0.5], "creep": 1e-3}, "expected one number or 1"),
    ],
)
def test_bad_contacts_are_refused_by_key(contact, message):
    with pytest.raises(SceneError, match=message) as caught:
        ball({"stiffness": 1e4, **contact})
    assert "contacts[0]" in str(caught.value)
