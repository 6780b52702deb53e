"""Every package that may be missing is named with what brings it; nodes explain themselves."""

import os
import re
import subprocess
import sys

import pytest
from places import ROOT

from mbd_ros.errors import PACKAGES, install_hint

SCENES = ROOT / "config/scenes"
HIDING = """
import sys
class Hidden:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == {hidden!r}:
            raise ModuleNotFoundError("hidden", name=name)
sys.meta_path.insert(0, Hidden())
from mbd_ros import programs
sys.argv = {words!r}
sys.exit(getattr(programs, {program!r})())
"""


def run(hidden, program, *words):
    text = HIDING.format(hidden=hidden, words=[program, *map(str, words)], program=program)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", text]
    return subprocess.run(command, env=environment, capture_output=True, text=True)


BAG = ("simulate", SCENES / "arm7.yaml", "-t", "0.002", "-o")


@pytest.mark.parametrize(
    ("hidden", "program", "words"),
    [
        ("apsw", "mbd_ros", (*BAG, "{tmp}/out.db3")),
        ("rosbags", "mbd_ros", (*BAG, "{tmp}/out.mcap")),
        ("numpy", "mbd_ros", ("check", SCENES / "arm7.yaml")),
        ("pinocchio", "mbd_ros", ("check", SCENES / "arm7.yaml")),
        ("eigenpy", "mbd_ros", ("check", SCENES / "arm7.yaml")),
        ("yaml", "mbd_ros", ("check", SCENES / "arm7.yaml")),
        ("proxsuite", "mbd_ros", ("simulate", "{qp}", "-t", "0.1", "-o", "{tmp}/out.csv")),
        ("qpsolvers", "mbd_ros", ("check", "{daqp}")),
        ("matplotlib", "mbd_ros", ("demo", "arm", "-o", "{tmp}/demo")),
        ("rclpy", "mbd_ros", ("replay", "{tmp}/bag", SCENES / "arm7.yaml", "-o", "{tmp}/out")),
        ("viser", "mbd_ros", ("view", SCENES / "arm7.yaml", "--no-browser")),
        ("rclpy", "simulator", ()),
        ("sensor_msgs", "inverse_dynamics", ()),
        ("pinocchio", "qp_controller", ()),
        ("rosbags", "reference_player", ()),
        ("viser", "web_view", ("--ros-args", "-p", "scene:=arm7")),
    ],
)
def test_a_missing_package_is_named_with_what_brings_it(hidden, program, words, tmp_path):
    robot = f"robot: {{urdf: {ROOT}/config/robots/arm7.urdf}}\n"
    (tmp_path / "qp.yaml").write_text(
        robot + "constraints: [{type: joint_stop, joint: joint1, upper: 1.0}]\n"
    )
    (tmp_path / "daqp.yaml").write_text(robot + "solver: {type: qp, backend: daqp}\n")
    places = {"tmp": tmp_path, "qp": tmp_path / "qp.yaml", "daqp": tmp_path / "daqp.yaml"}
    ran = run(hidden, program, *(str(word).format(**places) for word in words))
    assert ran.returncode == 2, ran.stdout + ran.stderr
    assert install_hint(hidden) in ran.stderr
    assert "Traceback" not in ran.stderr


def test_everything_that_is_installed_with_the_package_has_a_hint():
    text = (ROOT / "setup.py").read_text(encoding="utf-8")
    wanted = re.search(r"install_requires=\[(.*?)\]", text, re.DOTALL).group(1)
    brought = " ".join(PACKAGES.values())
    assert [name for name in re.findall(r'"(.*?)"', wanted) if name not in brought] == []
    assert install_hint("no_such_module") == ""


NODES = ("inverse_dynamics", "joint_state_projector", "qp_controller", "simulator")


@pytest.mark.parametrize("node", [*NODES, "sliding_mode_controller"])
def test_help_lists_every_parameter_without_ros(node):
    pytest.importorskip("rclpy", reason="the nodes need rclpy")
    ran = run("", node, "--help")
    assert ran.returncode == 0 and ran.stderr == "", ran.stderr
    assert ran.stdout.startswith(f"usage: ros2 run mbd_ros {node} --ros-args")
    given = (ROOT / f"config/nodes/{node}.yaml").read_text(encoding="utf-8")
    names = re.findall(r"^    ([a-z_.]+):", given, re.MULTILINE)
    assert len(names) > 5
    assert [name for name in names if f"  {name} (" not in ran.stdout] == []
    assert "  autostart (default true)\n" in ran.stdout
    assert run("", node, "-h").stdout == ran.stdout


def test_unknown_arguments_are_refused_by_name():
    pytest.importorskip("rclpy", reason="the nodes need rclpy")
    ran = run("", "simulator", "--scene", "x.yaml", "--ros-args", "-p", "rate:=100.0")
    assert ran.returncode == 2
    assert "simulator: unknown argument '--scene'" in ran.stderr and "-p scene:=" in ran.stderr
