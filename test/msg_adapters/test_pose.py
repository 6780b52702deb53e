"""Odometry messages against the serializers of rclpy and of rosbags, and how they are wrong."""

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message

from mbd_ros.files.bags.bag_types import from_cdr, to_cdr
from msg_adapters.errors import MessageError
from msg_adapters.pose import OdometryCdrWriter, read_odometry

TYPE, STAMP = "nav_msgs/msg/Odometry", 123_456_789_012_345
POSE = np.array([1.0, -2.0, 3.0, 0.1, 0.5, -0.5, 0.7])
POSE[3:] /= np.linalg.norm(POSE[3:])
TWIST = np.arange(6.0) / 7.0


@pytest.mark.parametrize("frames", [("world", "trunk"), ("", "x"), ("a" * 7, "left/hand")])
def test_agrees_with_both_serializers(frames):
    writer = OdometryCdrWriter(*frames)
    cdr = writer.write(STAMP, POSE, TWIST)
    bag_message, message = from_cdr(cdr, TYPE), deserialize_message(cdr, Odometry)
    assert bytes(to_cdr(bag_message, TYPE)) == cdr
    assert not any(message.pose.covariance) and not any(message.twist.covariance)
    for form in (bag_message, message):
        sample = read_odometry(form)
        assert sample[:3] == (STAMP, *frames)
        assert np.array_equal(sample.pose, POSE) and np.array_equal(sample.twist, TWIST)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda pose: pose * 0.0, "orientation has the length 0, a quaternion has 1"),
        (lambda pose: pose * np.nan, "pose is not finite"),
    ],
)
def test_a_pose_that_is_none_is_refused(change, reason):
    message = from_cdr(OdometryCdrWriter("", "").write(1, POSE, TWIST), TYPE)
    at, turn, pose = message.pose.pose.position, message.pose.pose.orientation, change(POSE)
    at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w = pose
    with pytest.raises(MessageError, match=reason):
        read_odometry(message)


def test_another_link_is_refused_by_name():
    message = from_cdr(OdometryCdrWriter("odom", "foot").write(1, POSE, TWIST), TYPE)
    assert read_odometry(message, "left/foot").frame_id == "odom"
    with pytest.raises(MessageError, match="child_frame_id is foot, expected left/trunk"):
        read_odometry(message, "left/trunk")


def test_a_twist_that_is_not_measured_is_absent_and_never_sent():
    message = from_cdr(OdometryCdrWriter("", "").write(1, POSE, TWIST), TYPE)
    message.twist.twist.angular.y = np.inf
    assert np.array_equal(np.isnan(read_odometry(message).twist), [0, 0, 0, 0, 1, 0])
    with pytest.raises(MessageError, match="twist is not finite at index 2"):
        OdometryCdrWriter("", "").write(1, POSE, TWIST * [1, 1, np.nan, 1, 1, 1])
