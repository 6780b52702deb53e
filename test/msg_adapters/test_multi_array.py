"""Serialized vectors against the serializers of rclpy and of rosbags."""

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from std_msgs.msg import Float64MultiArray

from mbd_ros.files.bags.bag_types import from_cdr, to_cdr
from msg_adapters.multi_array import MultiArrayCdrWriter, read_multi_array

TYPE = "std_msgs/msg/Float64MultiArray"


@pytest.mark.parametrize("size", [1, 2, 3, 8])
def test_agrees_with_both_serializers(size):
    writer = MultiArrayCdrWriter(size)
    for seed in range(2):
        values = np.random.default_rng(seed).normal(size=size)
        cdr = writer.write(values)
        message, bag_message = deserialize_message(cdr, Float64MultiArray), from_cdr(cdr, TYPE)
        assert bytes(to_cdr(bag_message, TYPE)) == cdr
        assert (len(message.layout.dim), message.layout.data_offset) == (0, 0)
        assert np.array_equal(read_multi_array(message, size), values)


@pytest.mark.parametrize("names", [("a",), ("ab", "c.ü_x", "d" * 7)])
def test_labels_agree_with_both_serializers(names):
    writer, values = MultiArrayCdrWriter(len(names), names), [0.5 * i for i in range(len(names))]
    cdr = writer.write(values)
    message, bag_message = deserialize_message(cdr, Float64MultiArray), from_cdr(cdr, TYPE)
    assert bytes(to_cdr(bag_message, TYPE)) == cdr
    assert tuple(one.label for one in message.layout.dim) == names
    assert list(message.data) == values
