"""Markers of motion capture as messages, there and back."""

import numpy as np
import pytest
from visualization_msgs.msg import Marker, MarkerArray

from msg_adapters.errors import MessageError
from msg_adapters.markers import MarkerPlaceReader, write_marker_places

LABELS = ("heel", "toe", "knee")
PLACES = np.array([[0.1, 0.2, 0.3], [1.0, -2.0, 3.0], [0.0, 0.0, 0.5]])


def array(labels=LABELS, places=PLACES, stamp=1_500_000_007, frame="lab"):
    return write_marker_places(MarkerArray(), stamp, labels, np.asarray(places), Marker, frame)


def test_what_is_written_is_read_in_the_order_of_the_reader():
    reader = MarkerPlaceReader(["toe", "heel"])
    sample = reader.read(array())
    assert sample.stamp == 1_500_000_007 and reader.frame == "lab"
    np.testing.assert_array_equal(sample.places, PLACES[[1, 0]])
    assert reader.extra == ("knee",) and reader.missing == ()


def test_markers_that_are_not_seen_are_nan():
    """Left out by the writer, deleted, or somewhere that is no number."""
    reader, gone = MarkerPlaceReader(LABELS), PLACES.copy()
    gone[0] = np.nan
    message = array(places=gone)
    assert [marker.ns for marker in message.markers] == ["toe", "knee"]
    message.markers[1].action = Marker.DELETE
    sample = reader.read(message)
    assert np.isnan(sample.places[[0, 2]]).all() and reader.missing == ("heel", "knee")
    message.markers[0].pose.position.y = float("inf")
    assert np.isnan(reader.read(message).places).all()


def test_text_names_a_marker_where_it_has_any():
    message = array()
    message.markers[0].text = "toe"
    message.markers[1].text = "heel"
    np.testing.assert_array_equal(MarkerPlaceReader(["heel"]).read(message).places, PLACES[[1]])


def test_messages_that_cannot_be_used_are_named():
    reader = MarkerPlaceReader(LABELS)
    with pytest.raises(MessageError, match="markers is empty"):
        reader.read(MarkerArray())
    with pytest.raises(MessageError, match="two markers are called toe"):
        reader.read(array(labels=("toe", "toe", "knee")))
    message = array()
    message.markers[2].header.frame_id = "camera"
    with pytest.raises(MessageError, match="several frames: lab, camera"):
        reader.read(message)
    message = array()
    message.markers[0].header.stamp.nanosec = 2_000_000_000
    with pytest.raises(MessageError, match="nanosec"):
        reader.read(message)
