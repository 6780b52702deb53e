"""The embedded scenes with contacts, against closed forms."""

import numpy as np
import pinocchio as pin
import pytest
from places import ROOT

from mbd_ros.api import load_scene
from mbd_ros.methods.simulation.sample_accelerations import accelerations_at

SCENES = ROOT / "config/scenes"
GRAVITY = 9.81
SIDES = (0.035, -0.035)  # of the sole


def motion(name, duration, **how):
    """Scene, simulation and states of a scene."""
    scene = load_scene(SCENES / f"{name}.yaml")
    simulation = scene.simulation(**how)
    return scene, simulation, list(simulation.run(scene.initial, duration))


def bounces(height, e, count):
    """Times of the first impacts of a ball that falls from rest, and when it rests."""
    falls = np.sqrt(2.0 * height / GRAVITY)
    times = falls * (1.0 + 2.0 * np.cumsum(e ** np.arange(count)) - 2.0)
    return np.append(falls, times[1:]), falls * (1.0 + e) / (1.0 - e)


def test_the_ball_bounces_in_time_and_rests_after_infinitely_many_bounces():
    _, simulation, states = motion("bouncing_ball", 4.5)
    times, rests = bounces(1.0, 0.8, 20)
    found = [event.t for event in simulation.events]
    assert found[:20] == pytest.approx(times, abs=1e-9)
    assert found[-1] == pytest.approx(rests, abs=1e-9)
    assert states[-1].q[2] == pytest.approx(0.1, abs=1e-12)
    assert states[-1].v == pytest.approx(np.zeros(6), abs=1e-12)


def rolling(t):
    """Way, speed and spin of a homogeneous sphere that starts sliding."""
    mu, radius, speed = 0.2, 0.1, 5.0
    a, ends = mu * GRAVITY, 2.0 * speed / (7.0 * mu * GRAVITY)
    slides, late = np.minimum(t, ends), np.maximum(t - ends, 0.0)
    v = speed - a * slides
    return speed * slides - 0.5 * a * slides**2 + v * late, v, 2.5 * a * slides / radius


def test_the_sphere_slides_and_rolls():
    _, _, states = motion("sphere_on_plane", 2.0)
    x, v, spin = rolling(np.array([x.t for x in states]))
    assert [s.q[0] for s in states] == pytest.approx(x, abs=1e-10)
    assert [np.linalg.norm(s.v[:3]) for s in states] == pytest.approx(v, abs=1e-10)
    assert [s.v[4] for s in states] == pytest.approx(spin, abs=1e-9)


SLOPE = float(np.radians(20.0))


def on_the_incline(t, mu=0.5, speed=3.0, angle=SLOPE):
    """Way uphill of a block that brakes and then stays."""
    a = GRAVITY * (np.sin(angle) + mu * np.cos(angle))
    slides = np.minimum(t, speed / a)
    return speed * slides - 0.5 * a * slides**2


def corner_forces(mu, mass=2.0, length=0.2, height=0.1, angle=SLOPE):
    """Normal forces at an edge of a block behind, and before, while friction mu N acts on it."""
    normal = mass * GRAVITY * np.cos(angle)
    tilt = mu * normal * height / 2.0 / length
    return normal / 2.0 - tilt, normal / 2.0 + tilt


UPHILL = np.array((np.cos(SLOPE), 0.0, np.sin(SLOPE)))


def uphill(scene, states):
    return np.array([(x.q[:3] - scene.initial.q[:3]) @ UPHILL for x in states])


def normals(simulation, x):
    """Normal forces of all contacts, by part and feature."""
    return [force[:, 0] for force in forces(simulation, x)]


def forces(simulation, x):
    """Forces in contact frames, of all contacts, shape (n, 3) each."""
    lam = accelerations_at(simulation, x, None, simulation.stepper.forces).lam
    blocks = [block for block in simulation.system.layout.blocks if block.cones()]
    return [lam[block.slots].reshape(-1, 3) for block in blocks]


@pytest.mark.parametrize("method", ["dop853", "rk4"])
def test_the_block_slides_uphill_and_stays(method):
    how = {"integrator": {"type": method}, "dt": 0.05}
    scene, simulation, states = motion("block_on_incline", 0.5, **how)
    t = np.array([x.t for x in states])
    assert uphill(scene, states) == pytest.approx(on_the_incline(t), abs=1e-10)
    (sliding,) = normals(simulation, states[2])
    behind, before = corner_forces(0.5)
    assert sliding[[0, 2]].sum() == pytest.approx(behind, abs=1e-9)
    assert sliding[[1, 3]].sum() == pytest.approx(before, abs=1e-9)
    assert np.all(sliding[4:] == 0.0)


def heights(states):
    """Of all bodies, shape (n, bodies)."""
    return np.array([x.q[2::7] for x in states])


def test_the_stack_stays_under_its_load():
    """1 000 tons on two boxes of 1 kg; every corner of every box stays where it is."""
    _, simulation, states = motion("stack", 0.02, dt=2e-3)
    assert heights(states) == pytest.approx(np.tile((0.1, 0.3, 0.5), (len(states), 1)), abs=1e-9)
    assert np.abs([x.v for x in states]).max() <= 1e-9
    assert max(simulation.stepper.residuals) <= 1e-8


def table_forces(mass=4.0, load=1.0, sx=0.5, sy=-0.25):
    """The split of smallest norm among feet at (1, 1), (-1, 1), (-1, -1), (1, -1)."""
    ex, ey = np.array((1, -1, -1, 1)), np.array((1, 1, -1, -1))
    return GRAVITY * (mass + load * (1.0 + sx * ex + sy * ey)) / 4.0


@pytest.mark.parametrize("method", ["dop853", "moreau_jean"])
def test_the_table_shares_its_weight_with_the_least_norm(method):
    how = {"integrator": {"type": method}, "dt": 5e-3}
    _, simulation, states = motion("four_legged_table", 0.05, **how)
    (split,) = normals(simulation, states[-1])
    assert split == pytest.approx(table_forces(), rel=1e-9)
    assert np.abs(states[-1].q[:3]).max() <= 1e-12


@pytest.mark.parametrize(
    ("method", "dt", "duration"),
    [
        ("dop853", 0.1, 0.1),
        ("moreau_jean", 5.0, 60.0),  # in parts of 50 ms
        pytest.param("moreau_jean", 0.1, 60.0, marks=pytest.mark.soak),  # in parts of 1 ms
    ],
)
def test_the_gripper_holds_the_box(method, dt, duration):
    """Pads press with 0.6 N m over 2 x 50 mm; the box neither slips nor creeps in a minute."""
    how = {"integrator": {"type": method}, "dt": dt}
    scene, simulation, states = motion("gripper", duration, **how)
    (base,) = scene.robot.bases
    fallen = [(x.q - scene.initial.q)[base.q][:3] for x in states]
    assert np.abs(fallen).max() <= 1e-9
    assert max(np.abs(x.v).max() for x in states) <= 1e-10
    for pad in normals(simulation, states[-1]):
        assert pad == pytest.approx(1.5, rel=1e-9)
    pads = forces(simulation, states[-1])
    friction = [np.linalg.norm(pad[:, 1:].sum(axis=0)) for pad in pads]
    assert friction == pytest.approx([0.25 * GRAVITY, 0.25 * GRAVITY], rel=1e-9)
    if method == "moreau_jean":
        assert max(simulation.stepper.residuals) <= 1e-8


def test_the_leg_falls_and_stands_on_its_foot():
    """Free fall to the closed form; then the floor carries its weight, below its mass centre."""
    scene, simulation, states = motion("leg_dropped", 2.5, dt=5e-3)
    falls = np.sqrt(2.0 * 0.05 / GRAVITY)
    t, z = np.array([(x.t, x.q[2]) for x in states if x.t < falls]).T
    assert z == pytest.approx(0.05 - 0.5 * GRAVITY * t**2, abs=1e-12)
    model, data = scene.robot.model, scene.robot.model.createData()
    weight = pin.computeTotalMass(model) * GRAVITY
    (pressing,), q = normals(simulation, states[-1]), states[-1].q
    assert np.all(pressing >= 0.0)
    assert pressing.sum() == pytest.approx(weight, rel=1e-5)
    centre = pin.centerOfMass(model, data, q)
    pin.framesForwardKinematics(model, data, q)
    foot = data.oMf[model.getFrameId("foot")]
    corners = [foot.act(np.array((a, b, -0.06825))) for a in (-0.0665, 0.1995) for b in SIDES]
    assert np.array(corners)[:, 2] == pytest.approx(0.0, abs=1e-9)
    pressed = pressing @ np.array(corners)[:, :2] / pressing.sum()
    assert pressed == pytest.approx(centre[:2], abs=2e-5)
    assert max(simulation.stepper.residuals) <= 1e-8
