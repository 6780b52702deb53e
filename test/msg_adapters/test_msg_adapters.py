"""Messages of rclpy and of rosbags, there and back, and the ways in which they are wrong."""

import importlib
import struct
from array import array
from functools import partial

import numpy as np
import pytest

from mbd_ros.files.bags.bag_types import from_cdr, new_message
from msg_adapters import diagnostics as diag
from msg_adapters.errors import MessageError
from msg_adapters.joint_state import (
    JointStateReader,
    JointStateWriter,
    read_joint_state,
    write_joint_state,
)
from msg_adapters.joint_state_cdr import JointStateCdrReader, JointStateCdrWriter
from msg_adapters.joint_trajectory import JointMotionWriter
from msg_adapters.markers import Arrow, Cone, MarkerWriter
from msg_adapters.multi_array import MultiArrayCdrWriter, read_multi_array, write_multi_array
from msg_adapters.pose import read_pose, write_pose
from msg_adapters.time import read_time, write_time
from msg_adapters.wrench import read_wrench, write_wrench

STAMP = 1_760_000_000_123_456_789
FIELDS = ("position", "velocity", "effort")
JOINT_STATE, POINT = "sensor_msgs/msg/JointState", "geometry_msgs/msg/Point"


def of_rclpy(msgtype):
    package, _, name = msgtype.split("/")
    module = pytest.importorskip(f"{package}.msg", reason="no ROS messages installed")
    return getattr(module, name)()


@pytest.fixture(params=[of_rclpy, new_message], ids=["rclpy", "rosbags"])
def new(request):
    return request.param


@pytest.fixture
def joint_state(new):
    """A JointState with the values of its fields 1, 2, .. times 1, 10 and 100."""

    def message(names, fields=FIELDS, **values):
        ramp = np.arange(1.0, len(names) + 1)
        scaled = {f: values.get(f, ramp * 10**i) for i, f in enumerate(FIELDS) if f in fields}
        return write_joint_state(new("sensor_msgs/msg/JointState"), STAMP, names, **scaled)

    return message


def test_joint_state_comes_back_as_it_was(joint_state):
    sample = read_joint_state(joint_state(["c", "a", "b"]))
    assert sample.stamp == STAMP
    assert [x.tolist() for x in sample[1:]] == [[1, 2, 3], [10, 20, 30], [100, 200, 300]]


def test_reader_follows_names_from_message_to_message(joint_state):
    reader = JointStateReader(["a", "b", "c"])
    for names, position, extra in (
        ("abc", [1, 2, 3], ()),
        ("cab", [2, 3, 1], ()),
        ("xcyab", [4, 5, 2], ("x", "y")),
        ("abc", [1, 2, 3], ()),
    ):
        sample = reader.read(joint_state(list(names)))
        assert sample.position.tolist() == position
        assert sample.effort.tolist() == [100 * x for x in position]
        assert (reader.missing, reader.extra) == ((), extra)
        assert reader.present.all()


def test_absent_joints_and_fields_are_nan(joint_state):
    reader = JointStateReader(["a", "b", "c"])
    sample = reader.read(joint_state(["c", "x"], fields=("position", "effort")))
    assert np.array_equal(sample.position, [np.nan, np.nan, 1.0], equal_nan=True)
    assert np.array_equal(sample.effort, [np.nan, np.nan, 100.0], equal_nan=True)
    assert np.isnan(sample.velocity).all()
    assert (reader.missing, reader.extra) == (("a", "b"), ("x",))
    assert reader.present.tolist() == [False, False, True]
    nothing = reader.read(joint_state(["x"], fields=()))
    assert all(np.isnan(x).all() for x in nothing[1:])


def test_nan_and_infinity_of_a_message_pass_as_they_are(joint_state):
    values = np.array([np.nan, -np.inf])
    sample = JointStateReader(["a", "b"]).read(joint_state(["a", "b"], velocity=values))
    assert np.array_equal(sample.velocity, values, equal_nan=True)


def test_samples_do_not_share_memory_with_each_other_or_the_message(joint_state):
    reader, msg = JointStateReader(["a", "b"]), joint_state(["b", "a"])
    first, second = reader.read(msg), reader.read(msg)
    msg.position[0] = 7.0
    first.position[0] = 9.0
    assert second.position.tolist() == [2.0, 1.0]
    absent = reader.read(joint_state(["a", "b"], fields=("position",))).effort
    with pytest.raises(ValueError, match="read-only"):
        absent[0] = 1.0


@pytest.mark.parametrize("names", ["ab", "ba", "b", "xba"])
def test_effort_that_is_not_asked_for_is_absent(joint_state, names):
    whole, without = JointStateReader("ab"), JointStateReader("ab", with_effort=False)
    msg = joint_state(list(names))
    expected, sample = whole.read(msg), without.read(msg)
    assert np.array_equal(sample.position, expected.position, equal_nan=True)
    assert np.array_equal(sample.velocity, expected.velocity, equal_nan=True)
    assert np.isnan(sample.effort).all()
    assert not np.isnan(expected.effort).all()


@pytest.mark.parametrize("field", FIELDS)
@pytest.mark.parametrize("length", [1, 3])
def test_array_of_another_length_than_the_names_is_refused(joint_state, new, field, length):
    reader, msg = JointStateReader(["a", "b"]), joint_state(["a", "b"])
    wrong = joint_state([str(i) for i in range(length)])
    setattr(msg, field, getattr(wrong, field))
    with pytest.raises(MessageError, match=f"{field} has {length} values for 2 names"):
        reader.read(msg)
    assert reader.read(joint_state(["b", "a"])).position.tolist() == [2.0, 1.0]


def test_empty_and_repeated_names_are_refused_and_forgotten(joint_state):
    reader = JointStateReader(["a", "b"])
    reader.read(joint_state(["a", "b", "x"]))
    for names, message in (([], "name is empty"), (["b", "a", "b", "a"], "name repeats a, b")):
        with pytest.raises(MessageError, match=message):
            reader.read(joint_state(names))
        assert reader.extra == ("x",)
    with pytest.raises(MessageError, match="name repeats c"):
        read_joint_state(joint_state(["c", "c"]))


def test_writer_refills_one_message(new):
    msg = new("sensor_msgs/msg/JointState")
    writer = JointStateWriter(msg, ["a", "b"], ("position", "effort"))
    for k in range(3):
        assert writer.write(k, position=np.full(2, k), effort=np.full(2, -k)) is msg
        sample = read_joint_state(msg)
        assert (sample.stamp, sample.position[0], sample.effort[1]) == (k, k, -k)
        assert np.isnan(sample.velocity).all()
    with pytest.raises(KeyError, match="velocity"):
        writer.write(0, velocity=np.zeros(2))
    with pytest.raises(ValueError, match="broadcast"):
        writer.write(0, effort=np.zeros(3))
    none = JointStateWriter(new("sensor_msgs/msg/JointState"), [])
    assert list(none.write(STAMP, effort=np.zeros(0)).name) == []


def test_wrench_comes_back_as_it_was_and_must_be_finite(new):
    msg, wrench = new("geometry_msgs/msg/WrenchStamped"), np.arange(1.0, 7.0)
    sample = read_wrench(write_wrench(msg, STAMP, "plate", wrench))
    assert (sample.stamp, sample.frame_id, sample.wrench.tolist()) == (STAMP, "plate", [*wrench])
    for i, bad in enumerate((np.nan, np.inf, -np.inf, np.nan, np.inf, np.nan)):
        broken = wrench.copy()
        broken[i] = bad
        with pytest.raises(MessageError, match="wrench is not finite"):
            read_wrench(write_wrench(msg, STAMP, "plate", broken))


def vector(new, values):
    """A Float64MultiArray, whatever its values."""
    msg = new("std_msgs/msg/Float64MultiArray")
    msg.data = array("d", values)
    return msg


def test_multi_array_has_the_agreed_length_and_finite_values(new):
    msg = new("std_msgs/msg/Float64MultiArray")
    values = read_multi_array(write_multi_array(msg, np.array([1.5, -2.0])), 2)
    assert values.tolist() == [1.5, -2.0]
    values[0] = 9.0
    assert list(msg.data) == [1.5, -2.0]
    with pytest.raises(MessageError, match="data has 2 values, expected 3"):
        read_multi_array(msg, 3)
    with pytest.raises(MessageError, match="data is not finite"):
        read_multi_array(vector(new, [np.nan]), 1)


@pytest.mark.parametrize("stamp", [0, 1, 999_999_999, 1_000_000_000, STAMP, 2**31 * 10**9 - 1, -5])
def test_stamp_comes_back_to_the_nanosecond(new, stamp):
    msg = new("builtin_interfaces/msg/Time")
    write_time(msg, stamp)
    assert read_time(msg) == stamp
    assert 0 <= msg.nanosec < 10**9


def test_diagnostics_come_back_as_they_were():
    msgs = pytest.importorskip("diagnostic_msgs.msg", reason="no ROS messages installed")
    for level in (diag.OK, diag.WARN, diag.ERROR, diag.STALE):
        health = diag.Health("node", level, "a message", {"rate": "100 Hz", "dropped": "3"})
        msg = diag.write_diagnostics(
            msgs.DiagnosticArray(), STAMP, health, msgs.DiagnosticStatus, msgs.KeyValue, "leg"
        )
        assert diag.read_diagnostics(msg) == [health]
        assert read_time(msg.header.stamp) == STAMP
        assert msg.status[0].hardware_id == "leg"


def test_diagnostics_of_a_bag_are_read_alike():
    msg, status, pair = (
        new_message(f"diagnostic_msgs/msg/{name}")
        for name in ("DiagnosticArray", "DiagnosticStatus", "KeyValue")
    )
    pair.key, pair.value = "rate", "1 Hz"
    status.name, status.level, status.message, status.values = "node", 2, "bad", [pair]
    msg.status = [status]
    assert diag.read_diagnostics(msg) == [diag.Health("node", diag.ERROR, "bad", {"rate": "1 Hz"})]


def test_pose_comes_back_as_it_was_and_must_be_one(new):
    msg, pose = new("geometry_msgs/msg/PoseStamped"), np.array([1.0, 2.0, 3.0, 0.6, 0.0, 0.0, 0.8])
    sample = read_pose(write_pose(msg, STAMP, "world", pose))
    assert (sample.stamp, sample.frame_id, sample.pose.tolist()) == (STAMP, "world", [*pose])
    for i, value, said in ((0, np.nan, "pose is not finite"), (6, 5.0, "length")):
        broken = pose.copy()
        broken[i] = value
        with pytest.raises(MessageError, match=said):
            read_pose(write_pose(msg, STAMP, "world", broken))


@pytest.mark.parametrize("name", ["diagnostics", "joint_state", "multi_array", "time", "wrench"])
def test_adapters_come_in_pairs(name):
    module = importlib.import_module(f"msg_adapters.{name}")
    own = [f for f, value in vars(module).items() if value.__class__.__name__ == "function"]
    own = [f for f in own if getattr(module, f).__module__ == module.__name__]
    readers = {f[5:] for f in own if f.startswith("read_")}
    writers = {f[6:] for f in own if f.startswith("write_")}
    assert readers == writers
    assert readers


@pytest.mark.parametrize(("sec", "nanosec"), [(0, 10**9), (2**31 - 1, 2**32 - 1), (-1, 2**31)])
def test_a_stamp_that_no_message_can_carry_back_is_refused(new, sec, nanosec):
    msg = new("builtin_interfaces/msg/Time")
    msg.sec, msg.nanosec = sec, nanosec
    with pytest.raises(MessageError, match=f"nanosec is {nanosec}, accepted: 0 to 999999999"):
        read_time(msg)
    cdr = bytearray(JointStateCdrWriter(["a"]).write(5, position=1.0))
    reader = JointStateCdrReader(JointStateReader(["a"]), lambda cdr: from_cdr(cdr, JOINT_STATE))
    assert reader.read(bytes(cdr)).stamp == 5
    cdr[4:12] = struct.pack("<iI", sec, nanosec)
    with pytest.raises(MessageError, match=f"nanosec is {nanosec}"):
        reader.read(bytes(cdr))  # in place
    fresh = JointStateCdrReader(JointStateReader(["a"]), lambda cdr: from_cdr(cdr, JOINT_STATE))
    with pytest.raises(MessageError, match=f"nanosec is {nanosec}"):
        fresh.read(bytes(cdr))  # as message


@pytest.mark.parametrize("stamp", [2**31 * 10**9, 2**31 * 10**9 + 5, -(2**31) * 10**9 - 1])
def test_a_stamp_that_no_message_can_carry_is_not_written(new, stamp):
    with pytest.raises(MessageError, match="does not fit into a message"):
        write_time(new("builtin_interfaces/msg/Time"), stamp)
    with pytest.raises(MessageError, match="does not fit into a message"):
        JointStateCdrWriter(["a"]).write(stamp, position=1.0)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_every_writer_of_a_node_refuses_what_is_not_finite(new, bad):
    good, lost = np.array([1e300, -1e300, 1.0]), np.array([0.0, 2.0, bad])
    refused = pytest.raises(MessageError, match="not finite")
    names = ["a", "b", "c"]
    for fields in (FIELDS, ("position", "effort"), ("effort",)):
        writer = JointStateCdrWriter(names, fields)
        writer.write(1, **dict.fromkeys(fields, good))  # squares overflow, the numbers do not
        for field in fields:
            with refused as caught:
                writer.write(2, **{**dict.fromkeys(fields, good), field: lost})
            assert f"{field} is not finite at index 2" in str(caught.value)
    with refused:
        write_multi_array(new("std_msgs/msg/Float64MultiArray"), lost)
    with refused:
        MultiArrayCdrWriter(3).write(lost.tolist())
    message = new("trajectory_msgs/msg/JointTrajectory")
    motion = JointMotionWriter(message, new("trajectory_msgs/msg/JointTrajectoryPoint"), names)
    motion.write(1, good, good, good, good)
    with refused:
        motion.write(1, good, good, lost, good)
    classes = partial(new, "visualization_msgs/msg/Marker"), partial(new, POINT)
    arrows = MarkerWriter(new("visualization_msgs/msg/MarkerArray"), *classes, "world")
    with refused:
        arrows.write(1, [Arrow("bar", np.zeros(3), lost)], 0.01)
    with refused:
        arrows.write(1, [Arrow("bar", lost, np.zeros(3))], 0.01)
    cones = MarkerWriter(new("visualization_msgs/msg/MarkerArray"), *classes, "world")
    for place, normal in ((lost, good), (good, lost)):
        with refused:
            cones.write(1, [], 0.01, [Cone("foot", place[:3], normal[:3], 0.5)])
