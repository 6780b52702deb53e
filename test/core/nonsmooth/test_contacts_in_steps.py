"""Time-stepped contacts: many of them, beside other rows, idle ones, against closed forms."""

import numpy as np
import pytest
from mechanisms import joint, link, urdf

from mbd_ros.api import scene_from
from mbd_ros.core.geometry.contact_pair import ContactPair

GRAVITY, SIDE = 9.81, 0.2
HALF = SIDE / 2.0
CORNERS = [[x * HALF, y * HALF, -HALF] for x in (-1, 1) for y in (-1, 1)]


def downhill(degrees):
    """Gravity over a plane that falls towards -x."""
    tilt = np.deg2rad(degrees)
    return [float(-GRAVITY * np.sin(tilt)), 0.0, float(-GRAVITY * np.cos(tilt))]


def block(degrees, friction, restitution=0.0, feet=None, height=HALF, **more):
    """A cube on its corners, all eight of them by default."""
    a = "box" if feet is None else {"frame": "box", "points": feet}
    contact = {"type": "rigid", "between": [a, "ground"]}
    contact |= {"friction": float(friction), "restitution": restitution}
    body = {"shape": {"box": [SIDE] * 3}, "mass": 1.0, "pose": {"xyz": [0.0, 0.0, height]}}
    return {"gravity": downhill(degrees), "bodies": {"box": body}, "contacts": [contact], **more}


def stepped(scene, dt, theta=0.5, **options):
    built = scene_from(scene, **options)
    entry = {"type": "moreau_jean", "theta": theta}
    return built, built.simulation(integrator=entry, dt=dt)


def moved(scene, dt, duration, v=None, theta=0.5):
    """States every dt, and the residuals of all steps."""
    built, simulation = stepped(scene, dt, theta)
    x = built.initial
    states = list(simulation.run(x if v is None else x._replace(v=np.array(v)), duration))
    return states, simulation.take_residuals()


def on_the_incline(t, degrees, friction, speed):
    """Closed form of the way uphill (textbook): it slides, stops, and sticks or slides back."""
    up, down = (
        GRAVITY * (np.sin(np.deg2rad(degrees)) + s * friction * np.cos(np.deg2rad(degrees)))
        for s in (1.0, -1.0)
    )
    if speed < 0.0:
        stop = min(t, speed / down)
        return speed * stop - 0.5 * down * stop**2
    stop = min(t, speed / up)
    late = t - stop
    return speed * stop - 0.5 * up * stop**2 - 0.5 * max(down, 0.0) * late**2


@pytest.mark.parametrize(
    ("degrees", "friction", "speed", "error"),
    [
        (15, 0.3, 0.0, 1e-15),
        (30, 0.3, 0.0, 1e-11),
        (20, 0.5, 0.5, 1e-5),
        (30, 0.3, 0.5, 5e-4),
        (15, 0.3, -0.1, 1e-5),
    ],
)
def test_a_block_on_four_feet_slides_and_sticks(degrees, friction, speed, error):
    scene = block(degrees, friction, feet=CORNERS)
    states, residuals = moved(scene, 1e-3, 0.15, [speed, 0, 0, 0, 0, 0])
    for x in states:
        assert x.q[0] == pytest.approx(on_the_incline(x.t, degrees, friction, speed), abs=error)
        assert abs(x.q[2] - HALF) <= 1e-12
    assert max(residuals) <= 1e-8


def test_a_stuck_block_does_not_creep():
    """Two seconds of large steps; feet are of eight corners the four that touch."""
    states, _ = moved(block(15.0, 0.3), 0.02, 2.0)
    assert max(np.abs(x.q[:3] - [0.0, 0.0, HALF]).max() for x in states) <= 1e-14
    assert max(np.abs(x.v).max() for x in states) <= 1e-14


@pytest.mark.parametrize(("theta", "order"), [(1.0, 0.95), (0.5, 1.9)])
def test_a_block_that_turns_downhill_has_the_order_of_the_method(theta, order):
    """mu = tan 30 deg: v (1 + cos phi) stays what it is, phi from the steepest way down."""
    errors, tilt = [], np.tan(np.deg2rad(30.0))
    for dt in (8e-3, 4e-3):
        scene = block(30.0, tilt, feet=CORNERS)
        states, _ = moved(scene, dt, 0.4, [0, 2.0, 0, 0, 0, 0], theta)
        kept = [np.hypot(*x.v[:2]) - x.v[0] for x in states]
        errors.append(np.abs(np.array(kept) - 2.0).max())
    assert np.log2(errors[0] / errors[1]) >= order


def test_a_ball_bounces_and_rests_after_a_finite_time():
    """Flights of e = 0.8 from 0.1 m add up to sqrt(2 h / g) (1 + e) / (1 - e)."""
    ball = {"shape": {"sphere": 0.1}, "mass": 1.0, "pose": {"xyz": [0.0, 0.0, 0.2]}}
    contact = {"type": "rigid", "between": ["ball", "ground"], "friction": 0.3, "restitution": 0.8}
    dt, first = 1e-3, np.sqrt(0.2 / GRAVITY)
    states, residuals = moved({"bodies": {"ball": ball}, "contacts": [contact]}, dt, 1.4)
    z, v = np.array([(x.q[2] - 0.1, x.v[2]) for x in states]).T
    t = np.array([x.t for x in states])
    hits = t[1:][np.diff(v) > 0.0][:6]
    assert hits == pytest.approx(first * (1.0 + 1.6 * (1 - 0.8 ** np.arange(6)) / 0.2), abs=2 * dt)
    rest = first * 9.0
    assert np.abs(z[t > rest]).max() <= 1e-9 and np.abs(v[t > rest]).max() <= 1e-9
    assert np.abs(v[t < rest - 15.0 * dt][-9:]).max() > 0.0
    assert z.min() >= -1e-9 and max(residuals) <= 1e-8


def impulses(scene, dt, count, **options):
    """Normal impulses over dt, of the last of some steps from rest."""
    built, simulation = stepped(scene, dt, **options)
    y = simulation.start(built.initial)
    for _ in range(count):
        y = simulation.stepper.step(y, None)
    assert np.abs(y.v).max() <= 1e-9
    return simulation.stepper.impulses[::3] / dt


def test_a_heavy_box_on_two_light_ones_rests():
    """Forces of the interfaces are the weights above them, mass ratio 1e6."""
    masses, contacts, bodies = (1.0, 1.0, 1e6), [], {}
    for i, mass in enumerate(masses):
        pose = {"xyz": [0.0, 0.0, HALF + i * SIDE]}
        bodies[f"box{i}"] = {"shape": {"box": [SIDE] * 3}, "mass": mass, "pose": pose}
        top = {"frame": f"box{i - 1}", "half_space": [0, 0, 1], "xyz": [0.0, 0.0, HALF]}
        between = [{"frame": f"box{i}", "points": CORNERS}, top if i else "ground"]
        contacts.append({"type": "rigid", "between": between, "friction": 0.5})
    found = impulses({"bodies": bodies, "contacts": contacts}, 1e-3, 3).reshape(3, 4).sum(axis=1)
    weights = GRAVITY * np.cumsum(masses[::-1])[::-1]
    assert found == pytest.approx(weights, rel=1e-8)


@pytest.mark.parametrize("steps", [2, 60])
def test_feet_share_what_statics_does_not_split(steps):
    """Square table of 4 kg under a load of 1 kg: the split of least norm, N_i as of springs."""
    feet, at = [(1, 1), (-1, 1), (-1, -1), (1, -1)], np.array((0.5, -0.25))
    table = urdf(link("table", 5.0, (*(0.1 * at).tolist(), 0.0), (1.0, 1.0, 1.0)))
    points = [[0.5 * x, 0.5 * y, 0.0] for x, y in feet]
    contact = {"type": "rigid", "between": [{"frame": "table", "points": points}, "ground"]}
    scene = {"robot": {"base": "floating"}, "contacts": [contact | {"friction": 0.5}]}
    expected = [GRAVITY * (1.0 + 0.25 * (1.0 + at @ foot)) for foot in feet]
    assert impulses(scene, 1e-3, steps, urdf=table) == pytest.approx(expected, rel=1e-9)


RAILS = urdf(
    *(link("world"), link("one", 2.0), link("other", 3.0)),
    joint("x", "prismatic", "world", "one", (1, 0, 0)),
    joint("y", "prismatic", "world", "other", (0, 1, 0)),
)
"""Two carts on level rails."""


def test_a_wall_dry_friction_and_a_coupling_share_one_problem():
    """A force drives both carts against dry friction on one; the other runs into a wall."""
    wall = {"half_space": [-1, 0, 0], "xyz": [0.1, 0.0, 0.0]}
    contact = {"type": "rigid", "between": [{"frame": "one", "sphere": 0.0}, wall]}
    scene = {
        "couplings": {"y": {"parent": "x", "factor": 2.0}},
        "contacts": [contact | {"friction": 0.4}],
        "constraints": [{"type": "dry_friction", "joint": "y", "limit": 1.5}],
        "forces": [{"type": "joint_torque", "joint": "x", "torque": 17.0}],
    }
    built, simulation = stepped(scene, 2e-3, urdf=RAILS)
    states = list(simulation.run(built.initial, 0.5))
    a = (17.0 - 2.0 * 1.5) / (2.0 + 4.0 * 3.0)  # of the first cart
    for x in states:
        assert x.q[0] == pytest.approx(min(0.5 * a * x.t**2, 0.1), abs=1e-12)
        assert x.q[1] == pytest.approx(2.0 * x.q[0], abs=1e-12)
    assert np.abs(states[-1].v).max() <= 1e-12


def test_idle_contacts_are_not_looked_at(monkeypatch):
    """A cube in free flight has no more gaps evaluated than it has to, and keeps its bits."""
    looks = []
    gaps = ContactPair.gaps
    monkeypatch.setattr(ContactPair, "gaps", lambda self, k: looks.append(1) or gaps(self, k))
    scene = block(0.0, 0.5, height=5.0)
    thrown = [1.0, 0.0, 0.0, 1.0, 2.0, 3.0]
    states, _ = moved(scene, 1e-3, 0.2, thrown)
    assert len(looks) <= 10
    free, _ = moved(scene | {"contacts": []}, 1e-3, 0.2, thrown)
    assert states[-1].q.tobytes() == free[-1].q.tobytes()


@pytest.mark.parametrize(
    ("height", "thrown"), [(0.12, [1.0, 0.5, 0.0, 1.0, 2.0, 3.0]), (HALF, [0.0] * 6)]
)
def test_a_checkpoint_goes_on_with_the_same_bits(height, thrown):
    """Thrown, and at rest, where steps know the impulses of earlier ones."""
    scene = block(10.0, 0.4, 0.3, height=height)
    built, simulation = stepped(scene, 2e-3)
    start = built.initial._replace(v=np.array(thrown))
    samples = simulation.run(start, 0.3)
    for _ in range(80):
        next(samples)
    kept = simulation.checkpoint()
    whole = list(samples)
    _, other = stepped(scene, 2e-3)
    again = list(other.run(kept, 0.3))
    assert [x.q.tobytes() for x in again] == [x.q.tobytes() for x in whole]
    assert [x.v.tobytes() for x in again] == [x.v.tobytes() for x in whole]
    assert other.stepper.impulses.tobytes() == simulation.stepper.impulses.tobytes()


def test_a_cube_that_falls_on_a_corner_never_gains_energy_nor_sinks_in():
    """Its inertia is a multiple of 1, so that steps keep the energy of its free flight."""
    scene = block(0.0, 0.5, 0.3, height=0.3)
    scene["bodies"]["box"]["pose"]["rpy"] = [0.4, 0.7, 0.2]
    states, residuals = moved(scene, 1e-3, 0.8, [1.0, 0.5, 0.0, 3.0, -2.0, 1.0])
    energy, low = [], []
    for x in states:
        (a, b, c), w = x.q[3:6], x.q[6]
        third = (2.0 * (a * c - w * b), 2.0 * (b * c + w * a), 1.0 - 2.0 * (a * a + b * b))
        low.append(x.q[2] - HALF * np.abs(third).sum())
        kinetic = 0.5 * (x.v[:3] @ x.v[:3] + SIDE**2 / 6.0 * x.v[3:] @ x.v[3:])
        energy.append(kinetic + GRAVITY * x.q[2])
    assert min(low) >= -1e-9 and abs(low[-1]) <= 1e-9
    assert np.diff(energy).max() <= 1e-7 * np.ptp(energy)
    assert max(residuals) <= 1e-8


def test_a_box_that_tumbles_to_rest_leaves_rounding_of_the_laws():
    """Vertices on one edge depend on one another: their rates must not ask for what is rigid."""
    pose = {"xyz": [0.0, 0.0, 0.4], "rpy": [0.3, 0.4, 0.1]}
    body = {"shape": {"box": [0.2, 0.1, 0.1]}, "mass": 1.0, "pose": pose}
    contact = {"type": "rigid", "between": ["box", "ground"], "friction": 0.5, "restitution": 0.3}
    scene = {"bodies": {"box": body}, "contacts": [contact]}
    states, residuals = moved(scene, 0.01, 1.5, [0.5, 0, 0, 1, 2, 3])
    assert max(residuals) <= 1e-10
    assert np.abs(states[-1].v).max() <= 1e-9


def test_steps_are_divided_where_a_body_turns_far_beside_a_contact():
    """A drum that spins 2.4 rad a step of 10 ms lands: energy falls, as the laws say."""
    drum = {"shape": {"cylinder": {"radius": 0.018, "length": 0.036}}, "mass": 0.12}
    twist = {"drum": {"linear": [-1.0, 0.0, 0.0], "angular": [2.0, 239.0, 1.0]}}
    scene = scene_from(
        {
            "bodies": {
                "drum": {**drum, "pose": {"xyz": [0.0, 0.0, 0.06], "rpy": [1.0, 0.2, 0.0]}}
            },
            "contacts": [
                {
                    "type": "rigid",
                    "between": ["drum", "ground"],
                    "friction": 3.0,
                    "restitution": 0.8,
                }
            ],
            "integrator": {"type": "moreau_jean"},
            "initial": {"twist": twist},
            "dt": 0.01,
        }
    )
    simulation = scene.simulation()
    energy = np.array([simulation.system.energy(x) for x in simulation.run(scene.initial, 0.5)])
    assert np.diff(energy).max() <= 1e-3 * energy[0]
    assert energy[-1] < 0.99 * energy[0]
