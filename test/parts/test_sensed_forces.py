"""Poses, efforts and wrenches as sensors: what they measure, and what estimators make of them."""

import numpy as np
import pinocchio as pin
import pytest

from mbd_ros import load_scene, scene_from
from mbd_ros.core.contracts import Now
from mbd_ros.core.kinematics.poses import (
    nearest_rotation_vector,
    quaternion_vector,
    vector_quaternion,
)
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.features.estimation.estimation import build_estimation
from mbd_ros.features.estimation.task import EstimateTask
from mbd_ros.features.estimation.tracker import Tracker
from mbd_ros.methods.inverse_dynamics.reactions import SystemReactions
from mbd_ros.methods.simulation.noisy_sensors import NoisySensors

STEP = 0.002


def felt(scene, x, u=None):
    """What the sensors of a scene measure at a state, without noise."""
    system = scene.system()
    found = system.evaluate(x, u)
    reactions = SystemReactions(system).at(x, u, found.a, found.lam)
    system.k.refresh(x.q, x.v)
    now = Now(found.a, found.lam, reactions)
    return [sensor.measure(system.k, x, now) for sensor in scene.sensors], found


def test_an_effort_sensor_feels_all_that_acts_in_its_joint():
    """Beside inverse dynamics of the motion under gravity, an external push and joint springs."""
    sensors = {
        "torque": {"type": "effort", "joint": "knee", "offset": 0.5},
        "wrench": {"type": "wrench", "joint": "knee"},
    }
    loads = {"push": {"frame": "foot"}}
    springs = [{"type": "joint_spring", "joint": "knee", "stiffness": 20.0, "rest": -0.2}]
    robot = {"locked": {"knee_slide_x": 0.0, "knee_slide_y": 0.0}}
    given = {"sensors": sensors, "external_wrenches": loads, "forces": springs, "robot": robot}
    scene = scene_from(given, urdf="prosthetic_leg")
    model, rng = scene.robot.model, np.random.default_rng(1)
    x = scene.initial._replace(q=rng.normal(size=model.nq), v=rng.normal(size=model.nv))
    push = rng.normal(size=6)
    (torque, wrench), found = felt(scene, x, push)
    data = model.createData()
    own = np.array(pin.rnea(model, data, x.q, x.v, found.a))
    frame = scene.robot.frame("foot")
    pin.computeFrameJacobian(model, data, x.q, frame, pin.LOCAL)
    pushed = pin.computeFrameJacobian(model, data, x.q, frame, pin.LOCAL).T @ push
    at = scene.robot.joint("knee").v
    expected = own[at] - pushed[at]
    spring = -20.0 * (x.q[scene.robot.joint("knee").q] + 0.2)
    assert expected == pytest.approx(spring, abs=1e-10)  # nothing else acts in the knee
    assert torque[0] - 0.5 == pytest.approx(expected, abs=1e-10)
    axis = scene.robot.axis(scene.robot.joint("knee"))
    assert wrench.dot(axis) == pytest.approx(expected, abs=1e-10)


def test_a_pose_is_that_of_its_link_and_keeps_its_turns():
    scene = scene_from(
        {"sensors": {"seen": {"type": "pose", "frame": "foot"}}}, urdf="prosthetic_leg"
    )
    model = scene.robot.model
    q = np.random.default_rng(2).normal(size=model.nq)
    ((x, y, z, *turn),), _ = felt(scene, scene.initial._replace(q=q))
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    there = data.oMf[scene.robot.frame("foot")]
    np.testing.assert_allclose([x, y, z], there.translation + scene.robot.origin, atol=1e-12)
    np.testing.assert_allclose(pin.exp3(np.array(turn)), there.rotation, atol=1e-12)
    vector = np.array([3.0, 0.5, -0.2])
    same = quaternion_vector(vector_quaternion(vector))
    np.testing.assert_allclose(pin.exp3(same), pin.exp3(vector), atol=1e-12)
    beyond = vector * (1.0 + 0.2 / np.linalg.norm(vector))  # more than half a turn
    short = quaternion_vector(vector_quaternion(beyond))
    np.testing.assert_allclose(nearest_rotation_vector(short, vector), beyond, atol=1e-12)


def test_a_pose_alone_shows_a_free_body_that_tumbles():
    """Through half a turn and more, where the rotation vector jumps; 1 mm and 5 mrad of noise."""
    sensors = {"seen": {"type": "pose", "frame": "box"}}
    scene = load_scene("free_flyer").with_(sensors=sensors)
    joints = [joint.name for joint in scene.robot.joints]
    found = build_estimation(scene, EstimateTask(), joints, [])
    process, simulation = found.process, found.scene.simulation()
    base = next(base for base in scene.robot.bases if base.name == "box")
    v = scene.initial.v.copy()
    v[base.v] = 0.1, 0.0, 0.2, 0.5, 4.0, 3.0
    y = simulation.start(found.scene.initial._replace(v=v), None)
    noisy = NoisySensors(process.sensors.sensors, 4)
    found.estimator.begin(process.consistent(scene.initial), found.prior, 0.0)
    tracker, turns = Tracker(found.estimator, process.sensors), []
    for k in range(1, 180):
        y = simulation.advance(y, None, 0.005 * k)
        x = simulation.system.expand(y)
        now = simulation.system.evaluate(x)
        values = np.concatenate(noisy.at(simulation.system, x, Now(now.a, now.lam), k))
        tracker.add_sample(0.005 * k, values, None)
        turns.append(np.linalg.norm(values[process.sensors.names.index("seen.rotation_x") :][:3]))
    assert max(turns) > 3.0
    off = process.minus(y, tracker.belief.x)
    nv = scene.robot.model.nv
    assert np.abs(off[base.v]).max() < 0.02 and np.abs(off[nv:][base.v]).max() < 0.15
    assert tracker.restarts == 0


def test_noise_of_forces_is_that_which_is_asked_for():
    sensors = {"torque": {"type": "effort", "joint": "knee", "noise": 0.2}}
    scene = scene_from({"sensors": sensors}, urdf="prosthetic_leg")
    live = scene.simulation()
    x = live.system.expand(live.start(scene.initial))
    found = live.system.evaluate(x)
    reactions = SystemReactions(live.system).at(x, None, found.a, found.lam)
    noisy, now = NoisySensors(scene.sensors, 5), Now(found.a, found.lam, reactions)
    told = [noisy.at(live.system, x, now, k)[0][0] for k in range(400)]
    assert noisy.needs_reactions and 0.17 < np.std(told) < 0.23
    with pytest.raises(ModelError, match="torque needs reactions"):
        noisy.at(live.system, x, Now(found.a, found.lam), 0)


def test_measured_efforts_show_an_unknown_torque_at_once():
    """A drive that nobody knows of: its torque sensor says what it does within a few samples."""
    sensors = {"torque": {"type": "effort", "joint": "joint4", "noise": 0.02}}
    scene = load_scene("arm7").with_(sensors=sensors)
    joints = [joint.name for joint in scene.robot.joints]
    found = build_estimation(scene, EstimateTask(disturbance=("joint4",)), joints, [])
    found.estimator.begin(found.process.start, 1e-4 * found.prior, 0.0)
    tracker, rng = Tracker(found.estimator, found.process.sensors), np.random.default_rng(6)
    simulation = found.scene.simulation()
    y = simulation.start(found.scene.initial._replace(z=np.array([4.0])), None)
    noise = np.sqrt(found.process.sensors.covariance(y).diagonal())
    for k in range(1, 26):
        y = simulation.advance(y, None, STEP * k)
        values = found.process.sensors.values(y, None)
        tracker.add_sample(STEP * k, values + noise * rng.standard_normal(len(noise)), None)
    x = found.process.simulation.system.expand(tracker.belief.x)
    assert found.unknown_efforts(x)[0] == pytest.approx(4.0, abs=0.2)


def test_unknown_joints_are_named():
    with pytest.raises(SceneError, match="no joint 'kne'"):
        scene_from({"sensors": {"a": {"type": "effort", "joint": "kne"}}}, urdf="prosthetic_leg")
