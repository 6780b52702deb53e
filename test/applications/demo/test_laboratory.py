"""The page from files of a laboratory to the load of the knee, on a public walking trial."""

import gzip
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from places import RECORDINGS, ROOT

import mbd_ros as mbd
from mbd_ros.cli import main

PAGE = ROOT / "docs/laboratory.md"
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
QUOTED = re.compile(r"^    (?!ros2|  )(.+)$", re.MULTILINE)
FILES = {  # of the page -> of the recording; the trial has no static one, and its model is scaled
    "generic.osim": "marker_ik/raw/subject01.osim",
    "subject.osim": "marker_ik/raw/subject01.osim",
    "static.trc": "marker_ik/raw/subject01_walk.trc",
    "walk.trc": "marker_ik/raw/subject01_walk.trc",
    "ik_setup.xml": "marker_ik/raw/walk_Setup_IK.xml",
    "grf.xml": "muscles/raw/subject01_walk_grf.xml",
    "subject01_walk_grf.mot": "muscles/raw/subject01_walk_grf.mot",
    "reserves.xml": "muscles/raw/gait10dof_Reserve_Actuators.xml",
}


@pytest.fixture
def laboratory(tmp_path, monkeypatch):
    """A working folder with the files that the page names."""
    sources = {name: RECORDINGS / "gait10dof" / f"{path}.gz" for name, path in FILES.items()}
    for name, path in sources.items():
        (tmp_path / name).write_bytes(gzip.decompress(path.read_bytes()))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def blocks():
    return BLOCK.findall(PAGE.read_text(encoding="utf-8"))


def test_the_commands_of_the_page(laboratory, capsys):
    """They say what is quoted; the knee is loaded as OpenSim's JointReaction finds it."""
    for kind, block in blocks():
        if kind == "yaml":
            Path(block.split("\n", 1)[0].removeprefix("# ")).write_text(block)
        for line in block.splitlines() if kind == "" else ():
            assert main(shlex.split(line)[1:]) == 0, line
    said = capsys.readouterr().out
    quoted = QUOTED.findall(BLOCK.sub("", PAGE.read_text(encoding="utf-8")))
    assert len(quoted) > 8
    # Residuals of the optimum are rounding.
    assert [q for q in quoted if "largest residual" not in q and q not in said] == []
    load = mbd.read_result("forces.sto")["samples"]["tibia_r.load.force_y"]
    with gzip.open(RECORDINGS / "gait10dof/muscles/joint_reactions.csv.gz") as file:
        found = np.genfromtxt(file, delimiter=",", names=True)
    peak = found["knee_r_on_tibia_r_in_tibia_r_fy"].min()
    assert load.min() == pytest.approx(peak, rel=0.01)  # of other kinematics and another filter


def test_the_lines_of_python_of_the_page(laboratory, capsys):
    (code,) = [block for kind, block in blocks() if kind == "python"]
    names = {}
    exec(code, names)
    assert capsys.readouterr().out.endswith("3436 N, 4.83 body weights\n")
    assert names["moments"]["samples"].rows == 151


def test_the_scene_of_the_nodes_of_the_page(laboratory):
    (block,) = [b for kind, b in blocks() if kind == "yaml" and b.startswith("# live")]
    Path("live.yaml").write_text(block)
    told = mbd.load_scene("live.yaml").check()
    assert "wrench      left on calcn_l, expressed in world, topic ~/wrench/left" in told
    assert told.count("\nmuscle ") == 18
