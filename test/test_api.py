"""The package as Python users and notebooks see it."""

import re
import subprocess
import sys
from importlib.metadata import version

import numpy as np
import pytest

import mbd_ros as mbd

HEAVY = ("dask", "matplotlib", "pandas", "proxsuite", "pyarrow", "rclpy", "rosbags", "scipy")


def imported(code):
    """Top-level modules of a fresh interpreter after some lines."""
    lines = f"{code}\nimport sys\nprint(*sorted({{m.partition('.')[0] for m in sys.modules}}))"
    ran = subprocess.run([sys.executable, "-c", lines], capture_output=True, text=True, check=True)
    return set(ran.stdout.split())


def test_importing_the_package_imports_nothing_else():
    modules = imported("import mbd_ros")
    assert modules.isdisjoint({*HEAVY, "numpy", "pinocchio", "yaml"})


def test_a_scene_that_is_simulated_and_inverted_imports_what_it_needs():
    modules = imported(
        "import mbd_ros as mbd\n"
        "scene = mbd.load_scene('empty')\n"
        "scene.inverse(scene.simulate(0.1))"
    )
    assert {"numpy", "pinocchio"} <= modules
    assert modules.isdisjoint(HEAVY)


def test_every_public_name_is_there():
    assert set(dir(mbd)) >= {"load_scene", "scene_from", "Scene", "Result", "MbdError"}
    assert all(getattr(mbd, name) is not None for name in dir(mbd))
    assert mbd.__version__ == version("mbd_ros")
    with pytest.raises(AttributeError, match="'nothing'"):
        mbd.nothing  # noqa: B018


def test_from_a_scene_to_torques_with_files_and_without(tmp_path):
    scene = mbd.load_scene("prosthetic_arm").with_(initial={"position": {"shoulder_flexion": 0.5}})
    motion = scene.simulate(0.5)
    torques = scene.inverse(motion)
    assert np.abs(torques["samples"]["shoulder_flexion.effort"]).max() < 1e-9  # it fell freely
    motion.to(tmp_path / "motion.npz")
    assert scene.inverse(tmp_path / "motion.npz")["samples"] == torques["samples"]
    torques.plot(tmp_path / "torques.svg")
    assert (tmp_path / "torques.svg").read_text(encoding="utf-8").count("<path") > 10


def test_a_scene_stays_one_with_jobs(tmp_path):
    scene = mbd.scene_from({"dt": 0.01}, urdf="arm7")
    heavier = scene.with_inertias({"link1": (5.0, np.zeros(3), 0.1 * np.eye(3))})
    for one in (scene, scene.with_(dt=0.02), heavier):
        assert isinstance(one, mbd.Scene)
        assert one.simulate(0.1)["samples"].rows == round(0.1 / one.dt) + 1


def test_code_of_others_needs_a_word():
    entries = {"forces": [{"type": "colorsys:rgb_to_hsv"}]}
    with pytest.raises(mbd.MbdError, match="names code of others"):
        mbd.scene_from(entries, urdf="arm7")
    with pytest.raises(mbd.MbdError, match="not a class"):
        mbd.scene_from(entries, urdf="arm7", allow_code=True)


def test_an_error_is_one_sentence_and_one_traceback():
    ran = subprocess.run(
        [sys.executable, "-c", "import mbd_ros as mbd; mbd.load_scene('arm8')"],
        capture_output=True,
        text=True,
    )
    assert ran.stderr.count("Traceback") == 1
    assert "arm8" in ran.stderr.splitlines()[-1]
    assert "arm7" in ran.stderr.splitlines()[-1]


def test_a_robot_alone():
    robot = mbd.read_robot("arm7")
    assert len(robot.joints) == 7
    assert len(repr(robot).splitlines()) <= 10


def test_a_notebook_shows_the_lines_of_check():
    shown = repr(mbd.load_scene("four_bar_leg").check())
    said = r"^constraint  shank_loop_closure, LoopClosure, bilateral: force_x \[N\]"
    assert re.search(said, shown, re.MULTILINE)
    assert ".." not in shown.splitlines()[1]
