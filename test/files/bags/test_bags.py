"""Bags: exact round trips, damage and hostile files refused, nothing half-written."""

import os
import random
import resource
import shutil
from array import array

import numpy as np
import pytest
import yaml
from places import RECORDINGS

from mbd_ros.errors import DataError
from mbd_ros.files.bags.bag_reader import messages, raw_blocks, raw_messages, topic_types
from mbd_ros.files.bags.bag_types import new_message
from mbd_ros.files.bags.bag_writer import BagWriter, Rows
from msg_adapters.joint_state import write_joint_state

JOINT_STATE = "sensor_msgs/msg/JointState"
WRENCH = "geometry_msgs/msg/WrenchStamped"
PLACES = ["out", "out.mcap", "out.db3"]
POSITIONS = np.random.default_rng(3).standard_normal((200, 3))


def write_bag(path, positions=POSITIONS):
    """JointState at 100 Hz with a wrench between every two of them."""
    with BagWriter(path) as bag:
        for i, position in enumerate(positions):
            stamp = 10_000_000 * i
            msg = write_joint_state(
                new_message(JOINT_STATE), stamp, list("abc"), position=position
            )
            bag.write("/joint_states", JOINT_STATE, stamp, msg)
            bag.write("/force", WRENCH, stamp + 5_000_000, new_message(WRENCH))
    return path


def files(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("place", PLACES)
def test_round_trip_is_exact_to_the_bit(tmp_path, place):
    path = write_bag(tmp_path / place)
    assert files(tmp_path) == [place]
    assert topic_types(path) == {"/joint_states": JOINT_STATE, "/force": WRENCH}
    read = list(messages(path, {"/joint_states": JOINT_STATE}))
    assert np.array([msg.position for _, _, msg in read]).tobytes() == POSITIONS.tobytes()
    assert [time for _, time, _ in read] == [10_000_000 * i for i in range(200)]
    assert read[7][2].name == ["a", "b", "c"] and len(read[7][2].velocity) == 0


@pytest.mark.parametrize("place", PLACES)
def test_raw_messages_come_in_order_and_copy_to_an_equal_bag(tmp_path, place):
    raw = list(raw_messages(write_bag(tmp_path / place)))
    times = [message.log_time for message in raw]
    assert times == sorted(times) and len(raw) == 400
    with BagWriter(tmp_path / "copy") as bag:
        for message in raw:
            bag.write(message.topic, message.msgtype, message.log_time, message.cdr)
    assert list(raw_messages(tmp_path / "copy")) == raw


@pytest.mark.parametrize("count", [1, 31, 32, 33, 100])
@pytest.mark.parametrize("place", ["out.mcap", "out.db3"])
def test_blocks_of_any_length_are_the_messages_one_by_one(tmp_path, place, count):
    """Two topics, of which the second has every other time of the first, and then later ones."""
    rng, parts = np.random.default_rng(count), []
    for k, topic in enumerate("ab"):
        times = 10 + (k + 1) * np.arange(count, dtype=np.int64)
        cdr = rng.integers(0, 256, (count, 8 + 4 * k), dtype=np.uint8)
        parts.append(Rows(f"/{topic}", JOINT_STATE, times, cdr))
    with BagWriter(tmp_path / place) as bag:
        bag.write_rows(parts)
    each = [
        (int(t), part.topic, bytes(row))
        for part in parts
        for t, row in zip(*part[2:], strict=True)
    ]
    found = [(raw.log_time, raw.topic, raw.cdr) for raw in raw_messages(tmp_path / place)]
    assert found == sorted(each, key=lambda one: one[0])
    for part in parts:
        blocks = list(raw_blocks(tmp_path / place, part.topic, JOINT_STATE))
        assert np.concatenate([block.rows() for block in blocks]).tobytes() == part.cdr.tobytes()


def test_folder_is_mcap_named_after_itself(tmp_path):
    path = write_bag(tmp_path / "out")
    info = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert files(path) == ["metadata.yaml", "out.mcap"]
    assert (info["storage_identifier"], info["relative_file_paths"]) == ("mcap", ["out.mcap"])


def test_messages_of_several_files_are_put_in_order(tmp_path):
    path = write_bag(tmp_path / "out", POSITIONS[:2])
    shutil.copy(path / "out.mcap", path / "again.mcap")
    text = (path / "metadata.yaml").read_text()
    info = yaml.safe_load(text)
    info["rosbag2_bagfile_information"]["relative_file_paths"].append("again.mcap")
    for topic in info["rosbag2_bagfile_information"]["topics_with_message_count"]:
        topic["message_count"] *= 2
    (path / "metadata.yaml").write_text(yaml.safe_dump(info))
    times = [message.log_time for message in raw_messages(path)]
    assert times == [0, 0, 5_000_000, 5_000_000, 10_000_000, 10_000_000, 15_000_000, 15_000_000]


def test_new_message_holds_zeros_and_takes_array_fields(tmp_path):
    pose = new_message("geometry_msgs/msg/PoseWithCovarianceStamped")
    assert pose.pose.covariance.tolist() == [0.0] * 36 and pose.header.stamp.sec == 0
    msg = new_message("std_msgs/msg/Float64MultiArray")
    msg.data = array("d", [1.5, -2.5])
    with BagWriter(tmp_path / "x") as bag:
        bag.write("/c", "std_msgs/msg/Float64MultiArray", 0, msg)
    ((_, _, read),) = messages(tmp_path / "x")
    assert read.data.tolist() == [1.5, -2.5] and isinstance(msg.data, array)
    with pytest.raises(DataError, match="my/msg/Own: not a message type of ROS 2 Jazzy"):
        new_message("my/msg/Own")


def test_topics_that_do_not_fit_are_named(tmp_path):
    path = write_bag(tmp_path / "out.mcap")
    with pytest.raises(
        DataError, match=r"no topic /joints; there are: /force \(geometry.*/joint_"
    ):
        list(messages(path, {"/joints": JOINT_STATE}))
    with pytest.raises(
        DataError, match="topic /force has type geom.*, expected sensor_msgs/msg/J"
    ):
        list(messages(path, {"/force": JOINT_STATE}))
    with BagWriter(tmp_path / "none") as bag:
        assert bag.path == tmp_path / "none"
    with pytest.raises(DataError, match="none: no messages on any topic"):
        list(messages(tmp_path / "none"))


def test_what_is_no_bag_is_refused(tmp_path):
    with pytest.raises(DataError, match="x: does not exist"):
        topic_types(tmp_path / "x")
    with pytest.raises(DataError, match="no metadata.yaml in it"):
        topic_types(tmp_path)
    (tmp_path / "x.txt").touch()
    with pytest.raises(DataError, match=r"expected a rosbag2 folder, \.mcap or \.db3 file"):
        topic_types(tmp_path / "x.txt")
    os.mkfifo(tmp_path / "pipe.mcap")
    with pytest.raises(DataError, match="not a bag"):
        topic_types(tmp_path / "pipe.mcap")


def read_or_refuse(path):
    """Whether the bag was read; any error other than DataError that names it fails the test."""
    try:
        return len(list(messages(path))) == 40
    except DataError as error:
        assert str(path) in str(error)
        return False


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
def test_truncated_file_is_refused(tmp_path, suffix):
    path = write_bag(tmp_path / f"x{suffix}", POSITIONS[:20])
    good = path.read_bytes()
    assert read_or_refuse(path)
    sizes = {len(good) * i // 200 for i in range(200)} | set(range(len(good) - 50, len(good)))
    for size in sorted(sizes):
        path.write_bytes(good[:size])
        assert not read_or_refuse(path), f"read whole although cut at {size}"


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
def test_flipped_bits_never_raise_anything_else(tmp_path, suffix):
    path = write_bag(tmp_path / f"x{suffix}", POSITIONS[:20])
    good, rng, refused = path.read_bytes(), random.Random(5), 0
    for _ in range(400):
        data = bytearray(good)
        for _ in range(rng.choice((1, 8))):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        path.write_bytes(data)
        refused += not read_or_refuse(path)
    assert 0 < refused < 400  # a flip inside a number cannot be noticed


def test_damaged_compressed_bag_is_refused(tmp_path):
    """The recorded bags carry zstd chunks, which BagWriter does not write."""
    good = (RECORDINGS / "arm26/elbow" / "bag" / "bag.mcap").read_bytes()
    path, rng, refused = tmp_path / "x.mcap", random.Random(6), 0
    for _ in range(150):
        data = bytearray(good)
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        path.write_bytes(data)
        try:
            list(messages(path))
        except DataError as error:
            refused += "x.mcap" in str(error)
    assert refused > 30


def test_damaged_metadata_is_refused(tmp_path):
    path = write_bag(tmp_path / "out", POSITIONS[:20])
    good, rng, refused = (path / "metadata.yaml").read_bytes(), random.Random(8), 0
    for i in range(300):
        data = bytearray(good)
        data[rng.randrange(len(data))] = rng.randrange(256)
        (path / "metadata.yaml").write_bytes(data if i % 3 else data[: rng.randrange(len(data))])
        refused += not read_or_refuse(path)
    assert refused > 150


@pytest.mark.parametrize(
    "text", ["[" * 100_000, "a: &a [*a]", "rosbag2_bagfile_information: 3", ""]
)
def test_senseless_metadata_is_refused(tmp_path, text):
    path = write_bag(tmp_path / "out", POSITIONS[:2])
    (path / "metadata.yaml").write_text(text)
    with pytest.raises(DataError, match=r"out(/metadata\.yaml)?: "):
        topic_types(path)


def test_lost_messages_are_noticed(tmp_path):
    path = write_bag(tmp_path / "out", POSITIONS[:20])
    text = (path / "metadata.yaml").read_text()
    (path / "metadata.yaml").write_text(text.replace("message_count: 20", "message_count: 21"))
    with pytest.raises(
        DataError, match="messages lost by topic: {'/joint_states': 1, '/force': 1}"
    ):
        list(messages(path))


def test_another_definition_of_a_type_is_refused(tmp_path):
    path = write_bag(tmp_path / "out", POSITIONS[:2])
    text = (path / "metadata.yaml").read_text()
    (path / "metadata.yaml").write_text(text.replace("RIHS01_a13", "RIHS01_b13"))
    with pytest.raises(DataError, match="JointState was recorded with another definition"):
        list(messages(path, {"/joint_states": JOINT_STATE}))


@pytest.mark.parametrize("name", ["../secret.mcap", "out/../secret.mcap", "/etc/passwd", ".."])
def test_metadata_that_names_files_outside_is_refused(tmp_path, name):
    path = write_bag(tmp_path / "out", POSITIONS[:2])
    shutil.copy(path / "out.mcap", tmp_path / "secret.mcap")
    shutil.copy(path / "out.mcap", path / "secret.mcap")  # what rosbags itself would read
    text = (path / "metadata.yaml").read_text()
    (path / "metadata.yaml").write_text(text.replace("- out.mcap", f"- {name}"))
    with pytest.raises(DataError, match="relative_file_paths: .* leads out of the bag"):
        topic_types(path)


@pytest.mark.parametrize("name", ["out.mcap", "metadata.yaml"])
def test_link_out_of_the_bag_is_refused(tmp_path, name):
    path = write_bag(tmp_path / "out", POSITIONS[:2])
    (path / name).rename(tmp_path / name)
    (path / name).symlink_to(tmp_path / name)
    with pytest.raises(DataError, match=f"{name}: is a link that leads out of the bag"):
        topic_types(path)


def test_metadata_may_name_a_missing_file_or_be_huge_without_harm(tmp_path):
    path = write_bag(tmp_path / "out", POSITIONS[:2])
    (path / "out.mcap").unlink()
    with pytest.raises(DataError, match=r"'out\.mcap' is no file of the bag"):
        topic_types(path)
    (path / "metadata.yaml").write_text("#" * 10_000_001)
    with pytest.raises(DataError, match="has 10000001 bytes, accepted are 1048576"):
        topic_types(path)


def test_address_characters_in_a_sqlite_path_are_refused(tmp_path):
    """Opening a#b.db3 by its address would open the file a."""
    (tmp_path / "a#b.db3").touch()
    with pytest.raises(DataError, match="must not contain"):
        topic_types(tmp_path / "a#b.db3")
    with pytest.raises(DataError, match="must not contain"), BagWriter(tmp_path / "c?d.db3"):
        pass
    assert files(tmp_path) == ["a#b.db3"]


@pytest.mark.parametrize("old", [False, True])
@pytest.mark.parametrize("place", PLACES)
def test_failure_in_the_middle_leaves_what_was_there(tmp_path, place, old):
    path = tmp_path / place
    if old:
        write_bag(path, POSITIONS[:3])

    def failing():
        yield from POSITIONS[:50]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_bag(path, failing())
    assert files(tmp_path) == ([place] if old else [])
    if old:
        assert len(list(messages(path))) == 6


@pytest.mark.parametrize("place", PLACES)
def test_full_disk_is_reported_and_nothing_is_left(tmp_path, place):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, hard))
    try:
        with pytest.raises(DataError, match=f"{place}: cannot be written"):
            write_bag(tmp_path / place)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert files(tmp_path) == []


@pytest.mark.parametrize("place", PLACES)
def test_own_bag_is_replaced(tmp_path, place):
    write_bag(tmp_path / place)
    write_bag(tmp_path / place, POSITIONS[:5])
    assert len(list(messages(tmp_path / place))) == 10
    assert files(tmp_path) == [place]


def foreign_bag(path):
    """A bag folder as another program writes it: without our mark."""
    write_bag(path, POSITIONS[:2])
    text = (path / "metadata.yaml").read_text()
    (path / "metadata.yaml").write_text(text.replace("written_by: mbd_ros", "written_by: robot"))


OCCUPANTS = {
    "foreign": (foreign_bag, "out"),
    "with more": (lambda path: (write_bag(path) / "notes.txt").touch(), "out"),
    "folder": (lambda path: path.mkdir(), "out"),
    "file": (lambda path: path.write_text("x"), "out"),
    "mcap": (lambda path: path.write_bytes(b"\x89MCAP0\r\n"), "out.mcap"),
    "link": (lambda path: path.symlink_to(write_bag(path.with_name("x.mcap"))), "out.mcap"),
    "link to nothing": (lambda path: path.symlink_to("nowhere"), "out.db3"),
}


@pytest.mark.parametrize("occupant", OCCUPANTS)
def test_anything_else_is_not_replaced(tmp_path, occupant):
    occupy, place = OCCUPANTS[occupant]
    occupy(tmp_path / place)
    before = files(tmp_path)
    with pytest.raises(DataError, match=f"{place}: exists and is not a bag written by mbd_ros"):
        write_bag(tmp_path / place)
    assert files(tmp_path) == before


def test_what_cannot_be_written_is_refused(tmp_path):
    with pytest.raises(DataError, match="directory .*no does not exist"):
        write_bag(tmp_path / "no" / "out")
    with pytest.raises(DataError, match=r"'\.txt' is no bag"):
        write_bag(tmp_path / "out.txt")
    with BagWriter(tmp_path / "x") as bag:
        bag.write("/a", JOINT_STATE, 0, new_message(JOINT_STATE))
        with pytest.raises(DataError, match="topic /a: -1 ns is no time"):
            bag.write("/a", JOINT_STATE, -1, new_message(JOINT_STATE))
        with pytest.raises(DataError, match=f"topic /a has type {JOINT_STATE}, not {WRENCH}"):
            bag.write("/a", WRENCH, 0, new_message(WRENCH))
        with pytest.raises(DataError, match="topic /b: a/msg/B is no type"):
            bag.write("/b", "a/msg/B", 0, b"")


@pytest.mark.parametrize("name", ["bag", "bag/bag.mcap", "panda_exciting_trajectory.db3"])
def test_recorded_robot_is_read_whole(name):
    """The .db3 carries no type definitions."""
    path = RECORDINGS / "panda" / name
    read = list(messages(path, {"/joint_states": JOINT_STATE}))
    assert len(read) == 727
    assert sorted(read[0][2].name) == [f"fer_joint{i}" for i in range(1, 8)]
