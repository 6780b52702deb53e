"""Embedded scenes by name: on the command line, in Python, from a checkout and from a wheel."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT

from mbd_ros.cli import main
from mbd_ros.errors import SceneError
from mbd_ros.features.tools.scenes import about_scene
from mbd_ros.scene.reader import description_topic, load_scene
from mbd_ros.scene.schema.locate import embedded_scenes, find_scene

SCENES = ROOT / "config/scenes"


def test_every_scene_file_has_its_name():
    assert embedded_scenes()["arm7"] == SCENES / "arm7.yaml"
    assert embedded_scenes()["benchmark/x06_chain"] == SCENES / "benchmark/x06_chain.yaml"
    assert set(embedded_scenes().values()) == set(SCENES.rglob("*.yaml"))


@pytest.mark.parametrize("name", ["arm7", "benchmark/a01_pendulum"])
def test_a_name_and_its_file_are_the_same_scene(name):
    scene = load_scene(name)
    assert scene.path == SCENES / f"{name}.yaml"
    assert scene.robot.model == load_scene(SCENES / f"{name}.yaml").robot.model
    assert description_topic(name) is None


@pytest.mark.parametrize(
    "name", ["empty", "package://mbd_ros/config/scenes/empty.yaml", SCENES / "empty.yaml"]
)
def test_the_command_line_takes_name_package_and_file(capsys, name):
    assert main(["check", str(name)]) == 0
    assert capsys.readouterr().out.startswith(f"scene       {SCENES / 'empty.yaml'}\n")


def test_a_file_without_suffix_goes_before_an_embedded_scene(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert find_scene("empty") == SCENES / "empty.yaml"
    (tmp_path / "empty").mkdir()
    assert find_scene("empty") == SCENES / "empty.yaml"
    (tmp_path / "empty").rmdir()
    shutil.copy(ROOT / "config/robots/pendulum.urdf", tmp_path)
    (tmp_path / "empty").write_text("robot: {urdf: pendulum.urdf}\ndt: 0.5\n", encoding="utf-8")
    assert load_scene("empty").dt == 0.5
    assert find_scene("./empty") == Path("empty")


def test_a_name_with_a_suffix_is_a_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SceneError, match="empty.yaml: scene file cannot be read: No such file"):
        load_scene("empty.yaml")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("arm8", "nearest: arm7;"),
        ("x06_chian", "nearest: benchmark/x06_chain, "),
        ("benchmark/x06_chian", "nearest: benchmark/x06_chain, "),
        ("../scenes/arm7", "there is no such file, and no embedded scene of that name"),
        ("", "there is no such file, and no embedded scene of that name"),
    ],
)
def test_an_unknown_name_says_the_nearest(capsys, name, said):
    with pytest.raises(SceneError) as caught:
        load_scene(name)
    assert said in str(caught.value)
    assert "`mbd-ros scenes` lists them" in str(caught.value)
    assert main(["check", name]) == 2
    assert capsys.readouterr() == ("", f"mbd-ros check: {caught.value}\n")


def test_a_report_takes_names_too(capsys, tmp_path):
    """What is wrong with one is said before anything runs."""
    assert main(["report", "arm7", "arm8", "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert said.startswith("mbd-ros report: arm8: there is no such file") and "arm7;" in said
    assert not (tmp_path / "out").exists()


def test_scenes_lists_all_with_a_line_each(capsys):
    assert main(["scenes"]) == 0
    rows = [line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines()]
    assert [name for name, _ in rows] == list(embedded_scenes())
    assert dict(rows)["arm7"] == "A generic 7-joint arm: seven independent joints, no couplings"


def test_no_scene_lacks_its_line_and_no_two_share_one():
    lines = [about_scene(path) for path in embedded_scenes().values()]
    assert all(len(line) > 20 for line in lines)
    assert len(set(lines)) == len(lines)


def test_a_wheel_in_an_empty_folder_knows_the_names(tmp_path):
    """Installed as pip does it with --target, in a process that sees no checkout."""
    copy, target, empty = (tmp_path / name for name in ("source", "target", "empty"))
    empty.mkdir()
    copy.mkdir()
    for name in ("setup.py", "setup.cfg", "pyproject.toml", "package.xml", "LICENSE"):
        shutil.copy(ROOT / name, copy)
    for name in ("mbd_ros", "msg_adapters", "resource", "launch", "config"):
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    words = ["install", "--quiet", "--no-deps", "--no-index", "--no-build-isolation"]
    pip = [sys.executable, "-m", "pip", *words, "--target", target, copy]
    subprocess.run(pip, check=True)

    def run(*given):
        code = "import sys; from mbd_ros.cli import main; sys.exit(main())"
        return subprocess.run(
            [sys.executable, "-c", code, *given],
            env={**os.environ, "PYTHONPATH": str(target)},
            cwd=empty,
            capture_output=True,
            text=True,
            check=True,
        ).stdout

    assert f"scene       {target / 'share/mbd_ros/config/scenes/arm7.yaml'}\n" in run(
        "check", "arm7"
    )
    assert [line.split()[0] for line in run("scenes").splitlines()] == list(embedded_scenes())
