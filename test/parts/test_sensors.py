"""Sensors of a scene: what they measure, its derivative, and what simulations show of them."""

import numpy as np
import pinocchio as pin
import pytest

import mbd_ros as mbd
from mbd_ros.core.contracts import Measures
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.state import State
from mbd_ros.errors import SceneError

TOE = {"type": "marker", "frame": "foot", "xyz": [0.12, 0.01, -0.02], "label": "L.Toe"}


def leg(base="fixed", **sections):
    entries = {"robot": {"base": base}, "sensors": {"toe": TOE}, **sections}
    return mbd.scene_from(entries, urdf="prosthetic_leg")


@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_marker_is_where_pinocchio_puts_its_link(base):
    """Position by frame placement; Jacobian by central differences in the tangent, 1e-9."""
    scene = leg(base)
    model, (toe,), rng = scene.robot.model, scene.sensors, np.random.default_rng(0)
    k, data = Kinematics(scene.robot), pin.Data(scene.robot.model)
    q = pin.integrate(model, scene.robot.neutral(), rng.uniform(-0.8, 0.8, model.nv))
    v = np.zeros(model.nv)

    def measured(step):
        at = pin.integrate(model, q, step)
        k.refresh(at, v)
        return toe.measure(k, State(0.0, at, v), None)

    pin.framesForwardKinematics(model, data, q)
    expected = data.oMf[scene.robot.frame("foot")].act(np.array(TOE["xyz"]))
    np.testing.assert_allclose(measured(v), expected + scene.robot.origin, atol=1e-15)
    steps = 1e-6 * np.eye(model.nv)
    slopes = np.column_stack([(measured(step) - measured(-step)) / 2e-6 for step in steps])
    measured(v)
    np.testing.assert_allclose(toe.jacobian(k, State(0.0, q, v)), slopes, atol=1e-9)


def test_marker_says_what_it_measures():
    scene = leg()
    (toe,) = scene.sensors
    assert (toe.name, toe.title, toe.unit, toe.level) == ("toe", "L.Toe", "m", Measures.POSITION)
    assert leg(sensors={"toe": {**TOE, "label": ""}}).sensors[0].title == "toe"
    k, x = Kinematics(scene.robot), scene.initial
    np.testing.assert_array_equal(toe.covariance(k, x), 1e-6 * np.eye(3))
    assert any(line == "sensor      toe, Marker on foot" for line in scene.check().splitlines())


def test_simulation_shows_markers_and_a_scene_without_sensors_none():
    scene = leg(initial={"position": {"ankle": 0.2}})
    samples = scene.simulate(0.01)["samples"]
    k, (toe,) = Kinematics(scene.robot), scene.sensors
    joints = scene.robot.joints
    q = np.array([samples[f"{joint.name}.position"][-1] for joint in joints])
    k.refresh(q, np.zeros(len(q)))
    shown = [samples[f"toe.position_{axis}"][-1] for axis in "xyz"]
    np.testing.assert_allclose(shown, toe.measure(k, State(0.0, q, q), None), atol=1e-15)
    assert samples.column("toe.position_x").unit == "m"
    assert not any("toe" in name for name in leg(sensors=None).simulate(0.01)["samples"])


@pytest.mark.parametrize(
    ("entry", "text"),
    [
        ({**TOE, "frame": "fot"}, "no frame 'fot'"),
        ({**TOE, "xyz": [0.0, 1.0]}, "xyz"),
        ({**TOE, "weight": -1.0}, "weight"),
        ({**TOE, "type": "beacon"}, "unknown type 'beacon', accepted: accelerometer, effort"),
    ],
)
def test_bad_entries_are_named(entry, text):
    with pytest.raises(SceneError, match=text) as failure:
        leg(sensors={"toe": entry})
    assert "sensors.toe" in str(failure.value)


def test_names_without_dots():
    with pytest.raises(SceneError, match=r"L\.Toe"):
        leg(sensors={"L.Toe": TOE})
