"""Names of earlier versions: the error names the new one."""

from types import SimpleNamespace

import numpy as np
import pytest

from mbd_ros.cli import main
from mbd_ros.errors import DataError
from mbd_ros.files.bags.bag_reader import raw_messages
from mbd_ros.files.table import Column, Table
from mbd_ros.scene.schema import renamed as names
from mbd_ros.scene.schema.renamed import RENAMED


@pytest.fixture
def old_name(monkeypatch):
    """Enters what was called otherwise in some earlier version."""

    def enter(kind, old, new):
        monkeypatch.setattr(names, "RENAMED", {**RENAMED, kind: {**RENAMED[kind], old: new}})

    return enter


def test_an_old_column_is_told_its_new_name(old_name):
    old_name("column", "angle", "position")
    table = Table([Column("time", np.zeros(1), "s"), Column("knee.position", np.zeros(1), "rad")])
    with pytest.raises(
        DataError, match=r"no column knee\.angle; knee\.angle is called knee\.posi"
    ):
        table.column("knee.angle")


def test_old_commands_and_options_are_told_their_new_names(old_name, capsys):
    old_name("command", "inspect", "check")
    with pytest.raises(SystemExit) as caught:
        main(["inspect", "arm7"])
    assert caught.value.code == 2
    assert "no command 'inspect'; inspect is called check now; accepted" in capsys.readouterr().err
    old_name("option", "--method", "--integrator")
    with pytest.raises(SystemExit) as caught:
        main(["simulate", "arm7", "-t", "1", "-o", "o.csv", "--method=rk4"])
    assert caught.value.code == 2
    said = capsys.readouterr().err
    assert said.startswith("usage: mbd-ros simulate")
    assert "unrecognized arguments: --method=rk4; --method is called --integrator now" in said


def test_an_old_topic_is_told_its_new_name(old_name, tmp_path):
    old_name("topic", "/torques", "/joint_torques")
    out = tmp_path / "bag"
    motion = tmp_path / "motion.csv"
    motion.write_text("time,hinge.position,hinge.velocity,hinge.acceleration\n0,0,0,0\n1,0,0,0\n")
    assert main(["inverse", "empty", str(motion), "-o", str(out)]) == 0
    with pytest.raises(DataError, match="no topic /torques; /torques is called /joint_torques no"):
        list(raw_messages(out, {"/torques": "sensor_msgs/msg/JointState"}))


def test_an_old_parameter_is_told_its_new_name(old_name):
    from mbd_ros.nodes.shell.parameters import Declared

    old_name("parameter", "speed", "rate")
    node = SimpleNamespace(_specs={"rate": None, "scene": None})
    said = "'speed' is unknown; speed is called rate now; accepted: rate, scene"
    assert Declared._unknown(node, "speed") == said
