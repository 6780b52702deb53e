"""Motions, wrenches and torques: the same meaning from table and bag."""

import os
import pty
import sys
import time
from collections import Counter
from contextlib import contextmanager, suppress

import numpy as np
import pytest
from places import RECORDINGS

from mbd_ros.core.state import WrenchSamples
from mbd_ros.errors import DataError
from mbd_ros.files.bags.bag_reader import messages, topic_types
from mbd_ros.files.bags.bag_types import new_message
from mbd_ros.files.bags.bag_writer import BagWriter
from mbd_ros.files.formats import is_bag
from mbd_ros.files.table import Column, Result, Table, time_columns
from mbd_ros.files.tables.csv import read_table
from mbd_ros.jobs.progress import progress
from mbd_ros.motion.recordings import read_motion, read_wrenches
from msg_adapters.time import write_time
from msg_adapters.wrench import write_wrench

JOINT_STATE = "sensor_msgs/msg/JointState"
WRENCH = "geometry_msgs/msg/WrenchStamped"
NAN = float("nan")
SECOND = 1_000_000_000


def table(path, text):
    path.write_text(text)
    return path


def motion_bag(path, samples):
    """Samples are (stamp, names, values a field); log times run at 1 kHz from 5 s."""
    with BagWriter(path) as bag:
        for i, (stamp, names, fields) in enumerate(samples):
            msg = new_message(JOINT_STATE)
            msg.name = names
            write_time(msg.header.stamp, stamp)
            for field, values in fields.items():
                setattr(msg, field, np.array(values, dtype=np.float64))
            bag.write("/joint_states", JOINT_STATE, 5 * SECOND + 1_000_000 * i, msg)
    return path


def at(stamp, names="ab", position=(1.0, 2.0), **fields):
    return stamp, list(names), {"position": position, **fields}


def test_kind_of_file_is_told_by_its_name(tmp_path):
    bags, tables = ["x", "a.mcap", "a.b.db3", str(tmp_path)], ["a.csv", "b.c.csv.gz"]
    assert [is_bag(name) for name in bags + tables] == [True] * 4 + [False] * 2
    for name in ("a.txt", "a.gz", "a.bag"):
        with pytest.raises(DataError, match=rf"{name}: no format has this suffix"):
            is_bag(name)


def test_table_columns_are_found_by_name(tmp_path):
    path = table(
        tmp_path / "m.csv",
        "time,b.position,other.position,a.position,a.velocity\n0,1,9,2,3\n0.1,4,9,5,6\n",
    )
    motion, dropped, by_log_time = read_motion(path, ["a", "b"])[:3]
    assert (motion.names, motion.stamps.tolist()) == (("a", "b"), [0, 100_000_000])
    assert motion.position.tolist() == [[2, 1], [5, 4]]
    np.testing.assert_array_equal(motion.velocity, [[3, NAN], [6, NAN]])
    assert motion.acceleration is None and motion.effort is None
    assert not dropped and not by_log_time


def test_table_lacks_only_joints_that_are_not_required(tmp_path):
    path = table(tmp_path / "m.csv", "time,a.position\n0,1\n")
    with pytest.raises(DataError, match=r"m.csv: no column b.position, c.position; there are: ti"):
        read_motion(path, ["a", "b", "c"])
    position = read_motion(path, ["a", "b"], required=["a"]).motion.position
    np.testing.assert_array_equal(position, [[1, NAN]])
    assert np.isnan(read_motion(path, ["b"], required=[]).motion.position).all()


def test_table_times_outside_of_nanoseconds_are_refused(tmp_path):
    path = table(tmp_path / "m.csv", "time,a.position\n0,1\n1e10,1\n")
    with pytest.raises(DataError, match=r"m.csv: column time: beyond 9e\+09 s"):
        read_motion(path, ["a"])
    table(path, "time,a.position\n0,1\n1e-10,1\n")
    with pytest.raises(DataError, match="line 3, column time: less than 1 ns after"):
        read_motion(path, ["a"])


def test_bag_joints_are_found_by_name_in_every_message(tmp_path):
    path = motion_bag(
        tmp_path / "m",
        [
            at(1, "ab", velocity=(3.0, 4.0)),
            at(2, "xba", (0.0, 2.5, 1.5), effort=(0.0, NAN, 7.0)),
            at(3, "a", (1.75,), velocity=(np.inf,)),
        ],
    )
    motion, dropped, by_log_time = read_motion(path, ["a", "b"], required=["a"])[:3]
    assert motion.stamps.tolist() == [1, 2, 3] and not by_log_time and not dropped
    np.testing.assert_array_equal(motion.position, [[1, 2], [1.5, 2.5], [1.75, NAN]])
    np.testing.assert_array_equal(motion.velocity, [[3, 4], [NAN, NAN], [NAN, NAN]])
    np.testing.assert_array_equal(motion.effort, [[NAN, NAN], [7, NAN], [NAN, NAN]])
    assert motion.acceleration is None


def test_velocity_and_effort_that_are_never_measured_are_none(tmp_path):
    path = motion_bag(tmp_path / "m.db3", [at(1), at(2, velocity=(NAN, NAN))])
    motion = read_motion(path, ["a", "b"]).motion
    assert motion.velocity is None and motion.effort is None


def test_bad_messages_are_dropped_and_counted_by_reason(tmp_path):
    path = motion_bag(
        tmp_path / "m.mcap",
        [
            at(10),
            at(20, "", ()),
            at(30, "aa"),
            at(40, position=(NAN, 1.0)),
            at(50, position=(NAN, np.inf)),
            at(60, "a", (1.0,)),
            at(70, position=()),
            at(10),
            at(5),
            at(80, velocity=(3.0,)),
            at(90),
        ],
    )
    motion, dropped, _ = read_motion(path, ["a", "b"])[:3]
    assert motion.stamps.tolist() == [10, 90]
    assert dropped == {
        "name is empty": 1,
        "name repeats a": 1,
        "position of a is missing or not finite": 1,
        "position of a, b is missing or not finite": 2,
        "position of b is missing or not finite": 1,
        "velocity has 1 values for 2 names": 1,
        "stamp is not newer than all before": 2,
    }


def test_required_joint_that_is_nowhere_is_named(tmp_path):
    path = motion_bag(tmp_path / "m", [at(1), at(2)])
    with pytest.raises(DataError, match="m: topic /joint_states: no joint c; there are: a, b"):
        read_motion(path, ["a", "c"])
    with pytest.raises(DataError, match="no topic /other; there are: /joint_states"):
        read_motion(path, ["a"], topic="/other")
    path = motion_bag(tmp_path / "n", [at(1, position=(NAN, 0.0))])
    with pytest.raises(DataError, match="no usable message, dropped: {'position of a is missing"):
        read_motion(path, ["a"])


def test_one_zero_stamp_makes_all_stamps_those_of_the_log(tmp_path):
    path = motion_bag(tmp_path / "m", [at(7), at(0), at(3)])
    motion, dropped, by_log_time = read_motion(path, ["a"])[:3]
    assert motion.stamps.tolist() == [5 * SECOND + 1_000_000 * i for i in range(3)]
    assert by_log_time and not dropped


LOADS = ",".join(f"l.{field}.{axis}" for field in ("force", "torque", "point") for axis in "xyz")


def test_force_at_a_point_has_its_torque_about_the_origin(tmp_path):
    """A force of 2 N along y at x = 3 m turns with 6 N·m about z."""
    path = table(tmp_path / "w.csv", f"time,{LOADS}\n0,0,2,0,0.5,0,1,3,0,0\n")
    samples = read_wrenches(path, {"l": None})["l"]
    assert samples.wrench.tolist() == [[0, 2, 0, 0.5, 0, 7]]
    assert samples.stamps.tolist() == [0] and samples.frame_id == ""


def test_missing_point_counts_only_where_there_is_force(tmp_path):
    lines = "0,0,0,0,0,0,4,nan,nan,nan\n1,0,1e-9,0,0,0,4,nan,nan,nan\n"
    path = table(tmp_path / "w.csv", f"time,{LOADS}\n{lines}")
    wrench = read_wrenches(path, {"l": None})["l"].wrench
    assert wrench[0].tolist() == [0, 0, 0, 0, 0, 4]
    assert np.isfinite(wrench[1, :3]).all() and np.isnan(wrench[1, 3:]).any()
    table(path, f"time,{LOADS}\n0,0,nan,0,0,0,4,0,0,0\n")
    with pytest.raises(DataError, match="line 2, column l.force.y: 'nan' is not a plain finite"):
        read_wrenches(path, {"l": None})


def test_missing_wrench_columns_and_topics_are_named(tmp_path):
    path = table(tmp_path / "w.csv", f"time,{LOADS.removesuffix(',l.point.z')}\n0{',0' * 8}\n")
    with pytest.raises(DataError, match=r"w.csv: no column l.point.z; there are: time, l.force.x"):
        read_wrenches(path, {"l": None})
    with pytest.raises(DataError, match=r"no column r.force.x, .*r.torque.z; there are"):
        read_wrenches(path, {"r": None})
    bag = wrench_bag(tmp_path / "w", [(1, "ground", np.ones(6))])
    with pytest.raises(DataError, match="load l names no topic"):
        read_wrenches(bag, {"l": None})
    assert read_wrenches(tmp_path / "nowhere.csv", {}) == {}


def wrench_bag(path, samples):
    with BagWriter(path) as bag:
        for i, (stamp, frame, wrench) in enumerate(samples):
            msg = write_wrench(new_message(WRENCH), stamp, frame, wrench)
            bag.write("/plate", WRENCH, i, msg)
    return path


def test_wrenches_of_a_bag_drop_what_is_not_finite_or_old(tmp_path):
    one = np.arange(6.0)
    samples = [(5, "g", one), (6, "g", one * NAN), (4, "g", one), (7, "g", -one)]
    path, dropped = wrench_bag(tmp_path / "w.db3", samples), Counter()
    read = read_wrenches(path, {"l": "/plate", "r": "plate"}, dropped=dropped)
    assert dropped == {"/plate: wrench is not finite": 1, "stamp is not newer than all before": 1}
    for samples in read.values():
        assert isinstance(samples, WrenchSamples) and samples.frame_id == "g"
        assert samples.stamps.tolist() == [5, 7]
        assert samples.wrench.tolist() == [one.tolist(), (-one).tolist()]


def test_wrench_topic_that_changes_its_frame_is_refused(tmp_path):
    path = wrench_bag(tmp_path / "w", [(1, "a", np.ones(6)), (2, "b", np.ones(6))])
    with pytest.raises(DataError, match="topic /plate: frame_id changes between a, b"):
        read_wrenches(path, {"l": "/plate"})


FIELDS = ("position", "velocity", "acceleration", "effort", "gravity", "external")
TOPICS = {
    "/joint_torques": {"effort": "effort", "position": "position", "velocity": "velocity"},
    "/constraint_forces": {"effort": "multiplier"},
    "/joint_torques/gravity": {"effort": "gravity"},
    "/joint_torques/external": {"effort": "external"},
}


def torques(begin=1000 * SECOND):
    """Two independent joints, one dependent, two parts, 50 samples at 1 kHz."""
    rng = np.random.default_rng(4)
    names = [f"{joint}.{field}" for field in FIELDS for joint in ("hip", "knee")]
    columns = [Column(name, rng.standard_normal(50)) for name in (*names, "slide.multiplier")]
    stamps = 1_000_000 * np.arange(50) + begin
    return Result({"samples": Table([*time_columns(stamps), *columns])}, {"topics": TOPICS})


@pytest.mark.parametrize("name", ["t.csv", "t.csv.gz", "t", "t.mcap", "t.db3"])
def test_torques_come_back_as_they_were(tmp_path, name):
    path, written = tmp_path / name, torques()
    written.to(path)
    assert [item.name for item in tmp_path.iterdir()] == [name]
    topic = {} if name.startswith("t.csv") else {"topic": "/joint_torques"}
    motion = read_motion(path, ["hip", "knee"], **topic).motion
    assert (motion.stamps == 1_000_000 * np.arange(50) + 1000 * SECOND).all()
    for field in ("position", "velocity", "effort", *(() if topic else ("acceleration",))):
        for i, joint in enumerate(("hip", "knee")):
            ours = written["samples"][f"{joint}.{field}"]
            assert getattr(motion, field)[:, i].tobytes() == ours.tobytes()


def test_table_of_torques_has_parts_and_multipliers(tmp_path):
    written = torques()["samples"]
    torques().to(tmp_path / "t.csv")
    read = read_table(tmp_path / "t.csv")
    columns = [f"{joint}.{field}" for field in FIELDS for joint in ("hip", "knee")]
    assert read.columns == ("time", *columns, "slide.multiplier")
    assert (read.values[:, 9] == written["hip.gravity"]).all()
    assert (read.values[:, -1] == written["slide.multiplier"]).all()


def test_bag_of_torques_has_a_topic_for_forces_and_parts(tmp_path):
    written = torques()["samples"]
    torques().to(tmp_path / "t")
    read = {topic: [] for topic in TOPICS}
    assert set(topic_types(tmp_path / "t")) == {*TOPICS, "/samples", "/result"}
    for topic, log_time, msg in messages(tmp_path / "t", dict.fromkeys(TOPICS, JOINT_STATE)):
        assert log_time == msg.header.stamp.sec * SECOND + msg.header.stamp.nanosec
        read[topic].append(msg)
    for topic, fields in TOPICS.items():
        names = ["slide"] if topic == "/constraint_forces" else ["hip", "knee"]
        ours = np.column_stack([written[f"{name}.{fields['effort']}"] for name in names])
        assert (np.array([msg.effort for msg in read[topic]]) == ours).all()
        assert all(msg.name == names for msg in read[topic])


def test_times_that_messages_cannot_hold_are_refused(tmp_path):
    for begin in (-1000 * SECOND, 2**31 * SECOND):
        with pytest.raises(DataError, match="t: "):
            torques(begin).to(tmp_path / "t")
    assert list(tmp_path.iterdir()) == []


def test_recorded_robot_with_and_without_stamps_is_the_same_motion():
    folder, joints = RECORDINGS / "panda", [f"fer_joint{i}" for i in range(1, 8)]
    stamped = read_motion(folder / "bag", joints)
    bare = read_motion(folder / "panda_exciting_trajectory.db3", joints)
    assert (stamped.by_log_time, bare.by_log_time) == (False, True)
    assert not stamped.dropped and not bare.dropped
    assert (np.diff(stamped.motion.stamps) == np.diff(bare.motion.stamps)).all()
    for field in ("position", "velocity", "effort"):
        values = getattr(stamped.motion, field)
        assert values.shape == (727, 7) and (values == getattr(bare.motion, field)).all()


def test_recorded_walk_is_the_same_in_table_and_bag():
    """The bag is the table interpolated to 200 Hz, so only the common first sample is equal."""
    folder, joints = RECORDINGS / "gait10dof/walk", ["hip_flexion_r", "knee_angle_r"]
    table_motion = read_motion(folder / "motion.csv.gz", joints).motion
    bag_motion = read_motion(folder / "bag", joints).motion
    assert len(table_motion.stamps) == 151 and len(bag_motion.stamps) == 500
    assert table_motion.acceleration.shape == (151, 2)
    np.testing.assert_allclose(bag_motion.position[0], table_motion.position[0], atol=1e-9)
    loads = {"right": "/force_plate/right", "left": "/force_plate/left"}
    from_table = read_wrenches(folder / "external_wrenches.csv.gz", loads)
    from_bag = read_wrenches(folder / "bag", loads)
    for name in loads:
        assert from_bag[name].frame_id == "ground"
        # the table gives nine digits of forces near 1 kN
        np.testing.assert_allclose(
            from_bag[name].wrench[0], from_table[name].wrench[0], rtol=0, atol=1e-6
        )


@contextmanager
def terminal_as_stderr(monkeypatch):
    """Yield the list that holds, after the block, all that stderr, a terminal, was sent."""
    master, slave = pty.openpty()
    shown: list[bytes] = []
    with os.fdopen(slave, "w") as terminal, monkeypatch.context() as patch:
        patch.setattr(sys, "stderr", terminal)
        yield shown
    with os.fdopen(master, "rb", buffering=0) as screen, suppress(OSError):
        # the kernel hands the writes over piece by piece, and ends them with an input/output error
        while piece := screen.read(4096):
            shown.append(piece)


def test_progress_on_a_terminal_is_rare_and_cleared(monkeypatch):
    began = time.monotonic()
    with terminal_as_stderr(monkeypatch) as shown:
        assert list(progress(range(1000), 1000, "reading")) == list(range(1000))
        periods = (time.monotonic() - began) / 0.2
    written = b"".join(shown)
    assert written.startswith(b"\rreading 0 %\r") and written.endswith(b"\r\x1b[K")
    assert written.count(b"%") <= 1 + periods


def test_progress_shows_the_share_that_is_done(monkeypatch):
    monkeypatch.setattr("mbd_ros.jobs.progress.PERIOD", 0.0)
    with terminal_as_stderr(monkeypatch) as shown:
        assert sum(1 for _ in progress("abcd", 4, "x")) == 4
    assert b"".join(shown).startswith(b"\rx 0 %\rx 25 %\rx 50 %\rx 75 %")


def test_progress_without_a_terminal_is_silent(capfd):
    assert list(progress([1, 2], 2, "reading")) == [1, 2]
    assert capfd.readouterr() == ("", "")
