"""A cylinder over a plane, beside closed forms: it rolls, stands and tips."""

import numpy as np
import pytest

import mbd_ros

GRAVITY, MU, RADIUS, SPEED = 9.81, 0.2, 0.1, 5.0


def simulated(length, pose, twist, duration, dt):
    drum = {
        "shape": {"cylinder": {"radius": RADIUS, "length": length}},
        **{"mass": 1.0, "free": True, "pose": pose},
    }
    scene = {
        "bodies": {"drum": drum},
        "contacts": [{"type": "rigid", "between": ["drum", "ground"], "friction": MU}],
        "initial": {"twist": {"drum": twist}},
        **{"integrator": {"type": "moreau_jean"}, "dt": dt},
    }
    result = mbd_ros.scene_from(scene).simulate(duration)
    return {column.name: column.values for column in result.tables["samples"].columns}


def test_a_cylinder_on_its_side_slides_until_it_rolls():
    """x = v t - mu g t^2 / 2 until v / (3 mu g), of an inertia m r^2 / 2; then it goes on."""
    pose = {"xyz": [0.0, 0.0, RADIUS], "rpy": [np.pi / 2.0, 0.0, 0.0]}
    found = simulated(0.3, pose, {"linear": [SPEED, 0.0, 0.0]}, 1.0, 1e-3)
    t = found["time"]
    rolls = np.minimum(t, SPEED / (3.0 * MU * GRAVITY))
    x = SPEED * rolls - 0.5 * MU * GRAVITY * rolls**2 + 2.0 / 3.0 * SPEED * (t - rolls)
    assert found["drum.position.x"] == pytest.approx(x, abs=1e-4)
    assert found["drum.position.y"] == pytest.approx(np.zeros(len(t)), abs=1e-10)
    assert np.diff(found["energy"]).max() <= 1e-10


def test_an_upright_cylinder_stands():
    found = simulated(0.3, {"xyz": [0.0, 0.0, 0.15]}, {}, 0.2, 1e-2)
    for axis, height in (("x", 0.0), ("y", 0.0), ("z", 0.15)):
        assert found[f"drum.position.{axis}"] == pytest.approx(height, abs=1e-12)


def test_a_coin_tips_and_lies_flat():
    """It loses its energy where it lands, but for m g times half its thickness."""
    tilt, length = 0.3, 0.01
    height = RADIUS * np.sin(tilt) + 0.5 * length * np.cos(tilt)
    found = simulated(length, {"xyz": [0, 0, height], "rpy": [tilt, 0.0, 0.0]}, {}, 0.4, 1e-2)
    assert found["drum.position.z"][-1] == pytest.approx(0.5 * length, abs=1e-6)
    assert found["drum_contact.gap"].min() >= -1e-9
    assert found["energy"][-1] == pytest.approx(0.5 * GRAVITY * length, abs=1e-6)
    assert np.diff(found["energy"]).max() <= 1e-6 * found["energy"][0]
