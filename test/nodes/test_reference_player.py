"""The node that leads a controller: nothing is lost, whoever comes first."""

import numpy as np
import pytest
from places import ROOT
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from mbd_ros.files.bags.bag_writer import BagWriter
from mbd_ros.scene.reader import load_scene
from msg_adapters.diagnostics import ERROR, OK, WARN
from msg_adapters.joint_trajectory import read_joint_trajectory

TARGET = ("-m", "mbd_ros.nodes", "reference_player")
SCENES = ROOT / "config/scenes"
ALL = ("controlled_arm", "controlled_arm7", "controlled_leg", "controlled_four_bar")


def trajectories(probe):
    """What arrives, for a listener that comes after the node, and answers later still."""
    probe.wait_health(lambda h: h.level == WARN and "waiting for the controller" in h.message)
    got = []
    probe.node.create_subscription(JointTrajectory, "/joint_trajectory", got.append, 10)
    probe.meet("/reference_player")
    assert got == []
    states = probe.node.create_publisher(JointState, "/state", 10)
    probe.spin_until(states.get_subscription_count)
    states.publish(JointState())
    probe.spin_until(lambda: got)
    probe.wait_health(lambda h: h.level == OK and h.message == "leading")
    return got


@pytest.mark.parametrize("name", ALL)
def test_a_course_moves_every_joint_of_a_scene_within_its_limits(start_node, probe, name):
    scene = SCENES / f"{name}.yaml"
    node = start_node(arguments=["-p", f"scene:={scene}", "-p", "repeat:=false"], target=TARGET)
    (message,) = trajectories(probe)
    trajectory, built = read_joint_trajectory(message), load_scene(scene)
    joints = built.controlled_joints()
    assert trajectory.names == joints.names
    assert trajectory.stamp == 0
    start = joints.positions(built.initial)
    np.testing.assert_allclose(trajectory.position[[0, -1]], [start, start], atol=1e-9)
    np.testing.assert_allclose(trajectory.velocity[[0, -1]], 0.0, atol=1e-9)
    rates = np.gradient(trajectory.position, trajectory.times, axis=0)
    np.testing.assert_allclose(trajectory.velocity[1:-1], rates[1:-1], atol=0.02)
    changes = np.gradient(trajectory.velocity, trajectory.times, axis=0)
    np.testing.assert_allclose(trajectory.acceleration[1:-1], changes[1:-1], atol=0.1)
    for k, joint in enumerate(joints.joints):
        assert joint.lower <= trajectory.position[:, k].min()
        assert trajectory.position[:, k].max() <= joint.upper
        assert np.abs(trajectory.velocity[:, k]).max() <= 0.5 * joint.max_velocity
        assert np.ptp(trajectory.position[:, k]) > 0.05
    assert node.stop() == 0


def test_the_trajectory_of_a_bag_begins_when_it_is_sent_and_is_repeated(
    start_node, probe, tmp_path
):
    message = JointTrajectory(joint_names=["wrist"])
    message.header.stamp.sec = 77
    for t in (0, 1):
        point = JointTrajectoryPoint(positions=[0.1 * t])
        point.time_from_start.sec = t
        message.points.append(point)
    kind, topic = "trajectory_msgs/msg/JointTrajectory", "/lead"
    with BagWriter(tmp_path / "bag") as writer:
        writer.write(topic, kind, 5, serialize_message(message))
    start_node(arguments=["-p", f"bag:={tmp_path / 'bag'}"], target=TARGET)
    got = trajectories(probe)
    assert (got[0].header.stamp.sec, got[0].points) == (0, message.points)
    probe.spin_until(lambda: len(got) > 2)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (["-p", "scene:=/no/such.yaml"], "/no/such.yaml"),
        (["-p", "bag:=/no/such/bag"], "/no/such/bag"),
        ([], "parameter 'scene' must be given"),
    ],
)
def test_bad_input_leaves_it_unconfigured_with_the_reason(start_node, probe, given, text):
    node = start_node(arguments=given, target=TARGET)
    health = probe.wait_health(lambda h: h.level == ERROR)
    assert text in health.message
    assert health.values["state"] == "unconfigured"
    assert node.stop() == 0
