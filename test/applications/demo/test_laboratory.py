"""The page from files of a laboratory to the load of the knee, on a public walking trial."""

import gzip
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from places import ROOT

import mbd_ros as mbd
from mbd_ros.cli import main

PAGE = ROOT / "docs/laboratory.md"
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
QUOTED = re.compile(r"^    (?!ros2|  )(.+)$", re.MULTILINE)
FILES = {  # of the page -> of the data; the trial has no static one, and its model is scaled
    "generic.osim": "gait10dof_marker_ik/raw/subject01.osim",
    "subject.osim": "gait10dof_marker_ik/raw/subject01.osim",
    "static.trc": "gait10dof_marker_ik/raw/subject01_walk.trc",
    "walk.trc": "gait10dof_marker_ik/raw/subject01_walk.trc",
    "ik_setup.xml": "gait10dof_marker_ik/raw/walk_Setup_IK.xml",
    "grf.xml": "gait10dof18musc_muscles/raw/subject01_walk_grf.xml",
    "subject01_walk_grf.mot": "gait10dof18musc_muscles/raw/subject01_walk_grf.mot",
    "reserves.xml": "gait10dof18musc_muscles/raw/gait10dof_Reserve_Actuators.xml",
}


@pytest.fixture
def laboratory(data_dir, tmp_path, monkeypatch):
    """A working folder with the files that the page names."""
    sources = {name: data_dir / "opensim" / f"{path}.gz" for name, path in FILES.items()}
    if lost := [path.name for path in sources.values() if not path.is_file()]:
        pytest.skip(f"no {lost[0]} among the recorded data")
    for name, path in sources.items():
        (tmp_path / name).write_bytes(gzip.decompress(path.read_bytes()))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def blocks():
    return BLOCK.findall(PAGE.read_text(encoding="utf-8"))


def test_the_commands_of_the_page(laboratory, data_dir, capsys):
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
    with gzip.open(data_dir / "opensim/gait10dof18musc_muscles/joint_reactions.csv.gz") as file:
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
