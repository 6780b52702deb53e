"""Forces of time-stepped contacts at samples: gaps and slips are 0 there to the order alone."""

import numpy as np
import pytest
from mechanisms import joint, link, urdf

import mbd_ros as mbd
from mbd_ros.core.geometry.contact_outputs import SLIP, STICK

G, HALF, ABOUT = 9.81, 0.5, 0.08  # m/s^2, m, kg·m^2: half the length of a rod, inertia across it


def rod(degrees, mu, *, along=0.0, turning=0.0, **more):
    """A rod of 1 kg on its lower end, in the plane of x and z, and how its end moves."""
    slope = float(np.radians(degrees))
    s, c = np.sin(slope), np.cos(slope)
    body = {"shape": {"box": [2.0 * HALF, 0.01, 0.01]}, "mass": 1.0}
    body |= {"inertia": [1e-3, ABOUT, ABOUT]}
    body["pose"] = {"xyz": [0.0, 0.0, float(HALF * s)], "rpy": [0.0, slope, 0.0]}
    end = {"frame": "rod", "points": [[HALF, 0.0, 0.0]]}
    # In axes of the body: the end moves along x of the world, the rod turns about the end.
    twist = {"linear": [float(along * c), 0.0, float(along * s + HALF * turning)]}
    twist["angular"] = [0.0, float(turning), 0.0]
    entry = {"type": "rigid", "between": [end, "ground"], "friction": mu}
    sections = {"bodies": {"rod": body}, "contacts": [entry], "initial": {"twist": {"rod": twist}}}
    return mbd.scene_from(sections | {"dt": 1e-3, "integrator": {"type": "moreau_jean"}} | more)


def residual(found):
    """The largest force or moment that nothing carries."""
    table = found["samples"]
    return max(np.abs(table[name]).max() for name in table if ".residual." in name)


def test_a_rod_that_tips_over_its_end_sticks_in_every_sample():
    """N = m (g + z'') of the mass centre on a circle, at the angle and rate of each sample."""
    scene = rod(70.0, 2.0)
    result = scene.simulate(0.3)
    table = result["samples"]
    half = 2.0 * np.arctan2(table["rod.orientation.y"], table["rod.orientation.w"])
    rate = table["rod.angular_velocity.y"]
    slope, speed = half, -rate  # the angle over the ground falls as the rod turns about -y
    assert speed[-1] != 0.0 and slope[-1] < slope[0] - 0.1
    bend = -G * HALF * np.cos(slope) / (ABOUT + HALF**2)
    normal = G + HALF * (bend * np.cos(slope) - speed**2 * np.sin(slope))
    along = HALF * (bend * np.sin(slope) + speed**2 * np.cos(slope))
    assert set(table["rod_contact.state"]) == {STICK}
    assert table["rod_contact.normal"] == pytest.approx(normal, rel=1e-9)
    assert np.abs(table["rod_contact.force_x"]) == pytest.approx(np.abs(along), rel=1e-9)
    assert np.abs(table["rod_contact.gap"]).max() > 1e-13  # no state says that it touches
    assert residual(scene.inverse(result)) <= 1e-9


def test_a_rod_that_slides_shows_the_forces_of_an_event_driven_run():
    """Away from the paradox friction is mu N against the slip; both methods agree to O(dt^2)."""
    table = rod(55.0, 0.5, along=-2.0).simulate(0.1)["samples"]
    exact = rod(55.0, 0.5, along=-2.0, integrator={"type": "dop853"}).simulate(0.1)["samples"]
    assert set(table["rod_contact.state"]) == {SLIP}
    for name in ("normal", "force_x", "force_z"):
        expected = exact[f"rod_contact.{name}"]
        assert table[f"rod_contact.{name}"] == pytest.approx(expected, rel=1e-4, abs=1e-4)


def test_where_no_accelerations_exist_the_forces_of_a_step_are_shown():
    """Painlevé's rod jams: 1/m - l^2 cos (mu sin - cos) / I < 0 at the start."""
    slope, mu = np.radians(55.0), 1.8
    s, c = np.sin(slope), np.cos(slope)
    assert 1.0 + HALF**2 * c * (c - mu * s) / ABOUT < 0.0
    scene = rod(55.0, mu, along=2.0)
    result = scene.simulate(0.02)
    table, remarks = result["samples"], result.metadata["remarks"]
    (said,) = (text for text in remarks if "Painlevé" in text)
    assert said.startswith("no consistent accelerations at 1 samples, the first at t = 0 s")
    assert table["rod_contact.normal"][0] > 10.0 * G  # an impulse in one step
    friction = np.hypot(table["rod_contact.friction_x"], table["rod_contact.friction_y"])
    assert (friction <= mu * table["rod_contact.normal"] * (1.0 + 1e-9)).all()
    assert residual(scene.inverse(result)) <= 1e-9 * table["rod_contact.normal"][0]


def test_other_rows_beside_a_contact_keep_their_laws():
    """A slide with dry friction moves a foot over the ground until it comes to rest."""
    chain = ("world", "a", "foot")
    text = urdf(
        *(link("world"), link("a", 0.5), link("foot", 2.0)),
        joint("x", "prismatic", *chain[:2], (1, 0, 0)),
        joint("z", "prismatic", *chain[1:], (0, 0, 1)),
    )
    entry = {"type": "rigid", "between": [{"frame": "foot", "sphere": 0.05}, "ground"]}
    sections = {
        "contacts": [entry | {"friction": 0.3}],
        "constraints": [
            {"type": "dry_friction", "joint": "x", "limit": 2.0},
            {"type": "joint_stop", "joint": "x", "upper": 5.0},
        ],
        "initial": {"position": {"z": 0.05}, "velocity": {"x": 1.0}},
        "dt": 1e-3,
        "integrator": {"type": "moreau_jean"},
    }
    table = mbd.scene_from(sections, urdf=text).simulate(0.4)["samples"]
    moves = table["x.velocity"] > 1e-3
    stop = 2.5 / (2.0 + 0.3 * 2.0 * G)  # s: mass over both frictions
    assert moves.sum() == pytest.approx(stop / 1e-3, abs=2)
    assert table["x_dry_friction.force"][moves] == pytest.approx(-2.0, rel=1e-12)
    assert table["foot_contact.force_x"][moves] == pytest.approx(-0.3 * 2.0 * G, rel=1e-9)
    assert table["foot_contact.normal"] == pytest.approx(2.0 * G, rel=1e-9)
    assert set(table["x_joint_stop.force"]) == {0.0}
    rest = table["time"] > stop + 0.01
    assert table["x.acceleration"][rest] == pytest.approx(0.0, abs=1e-9)
