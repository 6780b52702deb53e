"""Serialized joint states against the serializers of rclpy and of rosbags."""

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from mbd_ros.files.bags.bag_types import from_cdr, to_cdr
from msg_adapters.errors import MessageError
from msg_adapters.joint_state import JointStateReader, write_joint_state
from msg_adapters.joint_state_cdr import FIELDS, JointStateCdrReader, JointStateCdrWriter

TYPE, STAMP = "sensor_msgs/msg/JointState", 123_456_789_012_345


class Deserializer:
    """Counts how often a message object had to be made."""

    def __init__(self):
        self.calls = 0

    def __call__(self, cdr):
        self.calls += 1
        return deserialize_message(cdr, JointState)


def make(names, fields, seed=0):
    values = np.random.default_rng(seed).normal(size=(3, len(names)))
    return {field: values[FIELDS.index(field)] for field in fields}


@pytest.mark.parametrize("length", [1, 2, 3, 4, 9])
@pytest.mark.parametrize("joints", [1, 2, 7])
@pytest.mark.parametrize("fields", [FIELDS, ("position", "effort"), ("effort",)])
def test_every_alignment_agrees_with_both_serializers(length, joints, fields):
    names = [f"{i}".ljust(length, "x") for i in range(joints)]
    values = make(names, fields)
    cdr = JointStateCdrWriter(names, fields).write(STAMP, **values)
    bag_message, message = from_cdr(cdr, TYPE), deserialize_message(cdr, JointState)
    assert bytes(to_cdr(bag_message, TYPE)) == cdr
    assert list(message.name) == names
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == STAMP
    reader = JointStateCdrReader(JointStateReader(names[::-1]), Deserializer())
    for form in (cdr, serialize_message(message), cdr, cdr):  # rclpy pads, so layouts alternate
        sample = reader.read(form)
        assert sample.stamp == STAMP
        for field in FIELDS:
            expected = values.get(field, np.full(joints, np.nan))
            assert np.array_equal(getattr(message, field), values.get(field, []))
            assert np.array_equal(getattr(sample, field)[::-1], expected, equal_nan=True)


def test_only_a_new_layout_makes_a_message():
    make_message = Deserializer()
    reader = JointStateCdrReader(JointStateReader(["a", "b"]), make_message)
    pair, swapped = JointStateCdrWriter(["a", "b"]), JointStateCdrWriter(["b", "a"])
    zero = dict.fromkeys(FIELDS, 0.0)
    for i in range(5):
        reader.read(pair.write(i, **zero))
    assert make_message.calls == 1
    sample = reader.read(swapped.write(9, **{**zero, "position": np.array([1.0, 2.0])}))
    assert make_message.calls == 2
    assert sample.position.tolist() == [2.0, 1.0]


def test_lengths_that_trade_places_are_another_layout():
    """Same size and names, but velocity instead of position."""
    reader = JointStateCdrReader(JointStateReader(["a"]), Deserializer())
    reader.read(JointStateCdrWriter(["a"], ["position"]).write(1, position=1.0))
    sample = reader.read(JointStateCdrWriter(["a"], ["velocity"]).write(2, velocity=3.0))
    assert np.isnan(sample.position).all()
    assert sample.velocity.tolist() == [3.0]


def test_malformed_messages_are_refused_every_time():
    message = write_joint_state(JointState(), 1, ["a", "b"], position=0.0)
    message.position = [1.0]
    reader = JointStateCdrReader(JointStateReader(["a", "b"]), Deserializer())
    for _ in range(2):
        with pytest.raises(MessageError, match="position has 1 values for 2 names"):
            reader.read(serialize_message(message))


def test_answers_do_not_change_with_the_next_message():
    names = ["a", "b"]
    reader = JointStateCdrReader(JointStateReader(names), Deserializer())
    writer = JointStateCdrWriter(names)
    first = reader.read(writer.write(1, position=1.0, velocity=2.0, effort=3.0))
    first = reader.read(writer.write(1, position=1.0, velocity=2.0, effort=3.0))
    reader.read(writer.write(2, position=7.0, velocity=8.0, effort=9.0))
    assert first.position.tolist() == [1.0, 1.0]
    assert first.velocity.tolist() == [2.0, 2.0]
