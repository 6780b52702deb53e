"""Messages of the simulator, of rclpy and of rosbags, there and back, and how they are wrong."""

import importlib
from array import array

import numpy as np
import pytest

from mbd_ros.files.bags.bag_types import new_message
from msg_adapters.commands import CommandReader
from msg_adapters.errors import MessageError
from msg_adapters.joint_state import write_joint_state
from msg_adapters.joint_trajectory import JointMotionWriter, read_joint_motion
from msg_adapters.markers import Arrow, Cone, MarkerWriter
from msg_adapters.multi_array import write_multi_array
from msg_adapters.time import read_clock, read_time, write_clock

STAMP = 1_760_000_000_123_456_789
NAN = float("nan")


def of_rclpy(msgtype):
    package, _, name = msgtype.split("/")
    module = pytest.importorskip(f"{package}.msg", reason="no ROS messages installed")
    return getattr(module, name)()


@pytest.fixture(params=[of_rclpy, new_message], ids=["rclpy", "rosbags"])
def new(request):
    return request.param


def test_clock(new):
    assert read_clock(write_clock(new("rosgraph_msgs/msg/Clock"), STAMP)) == STAMP


# ---------------------------------------------------------------------- commands


def efforts(new, names, values, **more):
    message = new("sensor_msgs/msg/JointState")
    return write_joint_state(message, STAMP, names, effort=np.array(values), **more)


def test_a_vector_comes_in_the_order_of_the_parameter(new):
    reader = CommandReader(["c", "a", "b"], ["a", "b", "c"])
    message = write_multi_array(new("std_msgs/msg/Float64MultiArray"), np.array([3.0, 1.0, 2.0]))
    assert reader.read_vector(message).tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ([1.0], "data has 1 values, expected 2"),
        ([], "data has 0 values, expected 2"),
        ([1.0, NAN], "data is not finite"),
        ([1.0, -np.inf], "data is not finite"),
    ],
)
def test_a_bad_vector_is_refused(new, values, reason):
    message = new("std_msgs/msg/Float64MultiArray")
    message.data = array("d", values)
    with pytest.raises(MessageError, match=reason):
        CommandReader("ab", "ab").read_vector(message)


@pytest.mark.parametrize("order", [[0, 1, 2], [2, 0, 1]])
def test_efforts_go_by_name(new, order):
    reader = CommandReader("cab", "abc")
    names, values = np.array(list("abc"))[order], np.array([1.0, 2.0, 3.0])[order]
    read = reader.read_named(message := efforts(new, names.tolist(), values))
    assert read.tolist() == [1.0, 2.0, 3.0]
    message.effort[0] = 9.0  # a refilled message changes no command that is held
    assert read.tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("names", "values", "reason"),
    [
        ([], [], "name is empty"),
        (["a", "a"], [1.0, 2.0], "name repeats a"),
        (["a", "c"], [1.0, 2.0], "unknown names c; accepted: a, b"),
        (["a", "b", "c"], [1.0, 2.0, 3.0], "unknown names c; accepted: a, b"),
        (["a"], [1.0], "names b are missing"),
        (["b", "a"], [1.0, NAN], "effort is absent or not finite"),
        (["b", "a"], [1.0, np.inf], "effort is absent or not finite"),
    ],
)
def test_bad_efforts_are_refused_and_the_next_good_ones_are_not(new, names, values, reason):
    reader = CommandReader("ab", "ab")
    for _ in range(2):
        with pytest.raises(MessageError, match=reason):
            reader.read_named(efforts(new, names, values))
        assert reader.read_named(efforts(new, ["b", "a"], [2.0, 1.0])).tolist() == [1.0, 2.0]


def test_efforts_of_another_length_or_none_are_refused():
    message = efforts(of_rclpy, ["a", "b"], [1.0, 2.0])
    message.effort = [1.0]
    with pytest.raises(MessageError, match="effort has 1 values for 2 names"):
        CommandReader("ab", "ab").read_named(message)
    message.effort = []
    with pytest.raises(MessageError, match="effort is absent"):
        CommandReader("ab", "ab").read_named(message)


def test_a_joint_stands_for_its_only_actuator_and_units_say_where_values_stand(new):
    """A spring takes a position, a gear the torque of its motor: no effort of its joint."""
    inputs = ["spring", "gear", "free"]
    takes = {"spring": "position of the motor side", "gear": "torque of the motor"}
    joints = {"ankle": "spring", "knee": "gear", "hip": "free"}
    reader = CommandReader(["hip", "gear", "ankle"], inputs, joints, takes, ["spring"])
    vector = write_multi_array(new("std_msgs/msg/Float64MultiArray"), np.array([3.0, 2.0, 1.0]))
    assert reader.read_vector(vector).tolist() == [1.0, 2.0, 3.0]
    good = efforts(new, ["hip", "gear", "ankle"], [3.0, 2.0, NAN], position=np.array([0, 0, 1.0]))
    assert reader.read_named(good).tolist() == [1.0, 2.0, 3.0]
    for names, message in (
        (["hip", "gear", "ankle"], "no command of ankle, which takes the position"),
        (["hip", "knee", "spring"], "no command of knee, .* name of that input is gear"),
        (["hip", "gear", "spring"], "effort or position is absent or not finite"),
        (["hip", "gear"], "names ankle are missing"),
        (["hip", "gear", "ankle", "toe"], "unknown names toe; accepted: ankle, knee, hip"),
    ):
        with pytest.raises(MessageError, match=message):
            reader.read_named(efforts(new, names, np.arange(float(len(names)))))


# ---------------------------------------------------------------------- motion


def test_a_motion_comes_back_as_it_was(new):
    kinds = ("JointTrajectory", "JointTrajectoryPoint")
    writer = JointMotionWriter(*(new(f"trajectory_msgs/msg/{kind}") for kind in kinds), ["b", "a"])
    writer.write(1, *np.zeros((4, 2)))
    values = np.arange(8.0).reshape(4, 2)
    motion = read_joint_motion(writer.write(STAMP, *values))
    assert (motion.stamp, motion.names) == (STAMP, ("b", "a"))
    np.testing.assert_array_equal(motion[2:], values)


def test_a_trajectory_that_is_no_motion_is_refused(new):
    message = new("trajectory_msgs/msg/JointTrajectory")
    with pytest.raises(MessageError, match="0 points, expected 1"):
        read_joint_motion(message)
    point = new("trajectory_msgs/msg/JointTrajectoryPoint")
    JointMotionWriter(message, point, ["a"]).write(STAMP, *np.zeros((4, 1)))
    message.joint_names = ["a", "b"]
    with pytest.raises(MessageError, match="positions has 1 values for 2 names"):
        read_joint_motion(message)


# ---------------------------------------------------------------------- markers


def test_arrows_begin_at_the_point_and_grow_with_the_force(new):
    writer = MarkerWriter(
        new("visualization_msgs/msg/MarkerArray"),
        lambda: new("visualization_msgs/msg/Marker"),
        lambda: new("geometry_msgs/msg/Point"),
        "torso",
    )
    for force in (1.0, 50.0):
        load = np.array([0.0, 0.0, force])
        arrows = [Arrow("shank", np.array([1.0, 2.0, 3.0]), load), Arrow("bar", load, -load)]
        shank, bar = writer.write(STAMP, arrows, 0.01).markers
        assert (shank.ns, bar.ns, shank.id, bar.id) == ("shank", "bar", 0, 1)
        assert shank.header.frame_id == "torso"
        assert read_time(shank.header.stamp) == STAMP
        assert (shank.type, shank.action) == (0, 0)
        assert shank.color.a > 0.0
        assert shank.scale.x > 0.0
        tail, head = shank.points
        assert [tail.x, tail.y, tail.z] == [1.0, 2.0, 3.0]
        assert [head.x, head.y, head.z] == pytest.approx([1.0, 2.0, 3.0 + 0.01 * force])


def turned(orientation, vector):
    """A vector turned by a quaternion, by Rodrigues' formula."""
    axis, w = np.array((orientation.x, orientation.y, orientation.z)), orientation.w
    return vector + 2.0 * np.cross(axis, np.cross(axis, vector) + w * vector)


@pytest.mark.parametrize(
    "normal", [(0, 0, 40.0), (0, 0, -40.0), (3.0, -4.0, 0), (-1.0, 2.0, -2.0), (1e-9, 0, -3.0)]
)
def test_cones_open_around_the_normal_force(new, normal):
    """The height is that of the arrow of the normal force, the width mu times that."""
    writer = MarkerWriter(
        new("visualization_msgs/msg/MarkerArray"),
        lambda: new("visualization_msgs/msg/Marker"),
        lambda: new("geometry_msgs/msg/Point"),
        "world",
    )
    normal, place = np.array(normal, dtype=float), np.array((1.0, 2.0, 3.0))
    arrow = Arrow("foot", place, normal)
    for mu in (0.5, 0.0, 2.0):
        writer.write(STAMP, [arrow], 0.01, [Cone("foot.cone", place, normal, mu)])
        drawn, cone = writer.msg.markers
        assert (drawn.ns, cone.ns, drawn.id, cone.id) == ("foot", "foot.cone", 0, 1)
        assert (cone.type, cone.action) == (11, 0 if mu else 2)  # without width it is deleted
        if mu:
            points = np.array([(p.x, p.y, p.z) for p in cone.points])
            assert np.hypot(*points[1:3, :2].T) == pytest.approx(1.0) and len(points) % 3 == 0
            scaled = points * (cone.scale.x, cone.scale.y, cone.scale.z)
            ends = np.array([turned(cone.pose.orientation, point) for point in scaled[1:3]])
            height = 0.01 * np.linalg.norm(normal)
            along = ends @ normal / np.linalg.norm(normal)
            assert along == pytest.approx([height, height])
            assert np.linalg.norm(ends, axis=1) == pytest.approx(height * np.hypot(1.0, mu))
            assert (cone.pose.position.x, cone.pose.position.z) == (1.0, 3.0)


@pytest.mark.parametrize("name", ["commands", "joint_trajectory", "markers", "time"])
def test_adapters_need_no_ros(name):
    source = importlib.import_module(f"msg_adapters.{name}").__file__
    with open(source, encoding="utf-8") as file:
        text = file.read()
    assert "rclpy" not in text
    assert "_msgs" not in "".join(line for line in text.splitlines() if "import" in line)
