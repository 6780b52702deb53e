"""`mbd-ros inverse` of many motions: what single calls give, bit for bit."""

import numpy as np
import pytest
from places import ROOT

from mbd_ros.cli import main
from mbd_ros.files.bags.bag_types import new_message
from mbd_ros.files.bags.bag_writer import BagWriter
from mbd_ros.files.tables.csv import write_table
from msg_adapters.joint_state import write_joint_state

SCENE = ROOT / "config/scenes/prosthetic_arm.yaml"
FIELDS = ("position", "velocity", "acceleration")


@pytest.fixture
def joints():
    from mbd_ros.scene.reader import load_scene

    return load_scene(SCENE).couplings.independent


def table(path, joints, phase):
    t = np.arange(300) / 200
    w = 2 + np.arange(len(joints))
    angles = [0.2 * w**k * np.sin(np.outer(t, w) + phase + k * np.pi / 2) for k in range(3)]
    columns = [f"{joint}.{field}" for field in FIELDS for joint in joints]
    write_table(path, ["time", *columns], np.column_stack([t, *angles]))
    return path


def bag(path, joints):
    with BagWriter(path) as writer:
        for i in range(200):
            message, stamp = new_message("sensor_msgs/msg/JointState"), 10**18 + i * 5_000_000
            position = 0.2 * np.sin(2e-2 * i + np.arange(len(joints)))
            write_joint_state(message, stamp, joints, position=position)
            writer.write("/joint_states", "sensor_msgs/msg/JointState", stamp, message)
    return path


def inverse(*words):
    return main(["inverse", str(SCENE), *map(str, words)])


@pytest.fixture
def motions(tmp_path, joints):
    """Two tables, one of them packed, and a bag."""
    (tmp_path / "in").mkdir()
    return [
        table(tmp_path / "in/slow.csv", joints, 0.0),
        table(tmp_path / "in/fast.csv.gz", joints, 1.0),
        bag(tmp_path / "in/live.mcap", joints),
    ]


@pytest.mark.parametrize("how", [(), ("--workers", 1), ("--scheduler", "local:2")])
def test_every_result_is_that_of_a_single_call(tmp_path, motions, capsys, how):
    if "--scheduler" in how:
        pytest.importorskip("distributed")
    (tmp_path / "single").mkdir()
    options = ["--derivatives", "zero-phase", "--parts"]
    assert inverse(*motions, "-o", tmp_path / "many/of", *options, *how) == 0
    said = capsys.readouterr()
    assert sorted(line.partition(":")[0] for line in said.out.splitlines()) == sorted(
        map(str, motions)
    )
    assert said.err == ""
    for motion in motions:
        assert inverse(motion, "-o", tmp_path / "single" / motion.name, *options) == 0
        one, many = tmp_path / "single" / motion.name, tmp_path / "many/of" / motion.name
        assert one.read_bytes() == many.read_bytes()
    assert {p.name for p in (tmp_path / "many/of").iterdir()} == {m.name for m in motions}


def test_those_that_fail_are_named_and_the_others_done(tmp_path, motions, capsys):
    broken = tmp_path / "in/broken.csv"
    broken.write_text("time,elbow.position\n0,what\n", encoding="utf-8")
    absent = tmp_path / "in/absent.csv"
    out = tmp_path / "out"
    words = [*motions[:2], broken, absent, "-o", out]
    assert inverse(*words) == 2
    said = capsys.readouterr()
    assert "2 of 4 motions failed" in said.err
    assert f"{broken}: " in said.err and f"{absent}: " in said.err
    assert len(said.out.splitlines()) == 2
    assert {p.name for p in out.iterdir()} == {"slow.csv", "fast.csv.gz"}


def test_results_that_would_meet_or_replace_a_motion_are_refused(
    tmp_path, motions, joints, capsys
):
    (tmp_path / "other").mkdir()
    twin = table(tmp_path / "other/slow.csv", joints, 2.0)
    before = motions[0].read_bytes()
    assert inverse(*motions, twin, "-o", tmp_path / "out") == 2
    assert "have the same name" in capsys.readouterr().err
    assert inverse(*motions, "-o", tmp_path / "in") == 2
    assert "would overwrite it" in capsys.readouterr().err
    assert motions[0].read_bytes() == before
    assert inverse(*motions, "-o", motions[0]) == 2
    assert inverse(motions[0], "-o", tmp_path / "o.csv", "--workers", 2) == 2
    assert not (tmp_path / "out").exists()
