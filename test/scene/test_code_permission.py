"""A scene that names code of others runs none of it unasked, whoever reads the scene."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from places import ROOT

from mbd_ros.cli import main
from mbd_ros.errors import SceneError
from mbd_ros.files.tables.csv import write_table
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.schema.code_permission import is_permitted, permitting

URDF = ROOT / "config/robots/arm7.urdf"
TOLD = """
from pathlib import Path
import numpy as np
from mbd_ros.core.contracts import Load
Path(__file__).with_suffix(".ran").touch()
class Push(Load):
    def __init__(self, robot):
        self._tau = np.full(robot.model.nv, 2.0)
    def force(self, k, x, u):
        return self._tau
class Keep:
    def correct(self):
        pass
"""


@pytest.fixture
def foreign(tmp_path, monkeypatch):
    """A scene with parts of a module that leaves a mark when it is imported."""
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    (folder / "told_parts.py").write_text(TOLD)
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setenv("PYTHONPATH", str(folder), prepend=":")
    monkeypatch.delitem(sys.modules, "told_parts", raising=False)
    scene = tmp_path / "scene.yaml"
    scene.write_text(f"robot: {{urdf: {URDF}}}\nforces:\n- {{type: 'told_parts:Push'}}\n")
    return scene


@pytest.fixture
def has_run(foreign):
    return (foreign.parent / "elsewhere/told_parts.ran").exists


@pytest.fixture
def motions(foreign):
    """Two tables of the joints of the arm at rest."""
    names = [f"joint{i}" for i in range(1, 8)]
    columns = [f"{n}.{f}" for f in ("position", "velocity", "acceleration") for n in names]
    rows = np.zeros((5, 22))
    rows[:, 0] = np.arange(5) * 0.01
    paths = [foreign.with_name(name) for name in ("one.csv", "two.csv")]
    for path in paths:
        write_table(path, ["time", *columns], rows)
    return [str(path) for path in paths]


def commands(scene, motions):
    out = str(scene.with_name("out"))
    return {
        "check": ["check", str(scene)],
        "simulate": ["simulate", str(scene), "-t", "0.01", "-o", f"{out}.csv"],
        "inverse": ["inverse", str(scene), motions[0], "-o", f"{out}.csv"],
        "inverse of two": ["inverse", str(scene), *motions, "-o", out, "--workers", "2"],
        "report": ["report", str(scene), "--only", "left_out", "--quick", "-o", out],
        "replay": ["replay", motions[0], str(scene), "-o", out],
    }


@pytest.mark.parametrize(
    "which", ["check", "simulate", "inverse", "inverse of two", "report", "replay"]
)
def test_no_command_imports_anything_unasked(which, foreign, motions, has_run, capsys):
    if which == "replay":
        pytest.importorskip("rclpy", reason="replay starts a node: pip install 'mbd_ros[ros]'")
    before = sorted(foreign.parent.iterdir())
    assert main(commands(foreign, motions)[which]) == 2
    said = capsys.readouterr().err
    assert f"{foreign}: names code of others" in said
    assert "forces[0].type 'told_parts:Push'" in said
    assert "--allow-code" in said and "parameter allow_code" in said
    assert not has_run() and "told_parts" not in sys.modules
    assert sorted(foreign.parent.iterdir()) == before


@pytest.mark.parametrize("which", ["check", "simulate", "inverse", "inverse of two", "report"])
def test_every_command_passes_the_permission_on(which, foreign, motions, has_run, capsys):
    assert main([*commands(foreign, motions)[which], "--allow-code"]) == 0
    said = capsys.readouterr().out
    assert has_run()
    assert not is_permitted()
    if which == "check":
        file = foreign.parent / "elsewhere/told_parts.py"
        assert f"forces[0].type: told_parts:Push from {file}" in said
    if which == "report":
        numbers = json.loads((foreign.parent / "out/report.json").read_text(encoding="utf-8"))
        (item,) = numbers["items"]
        assert "failed" not in item["outcome"] and item["outcome"]["evaluation"] > 0.0


def test_on_a_cluster_it_goes_along(foreign, motions, has_run):
    pytest.importorskip("distributed", reason="pip install 'mbd_ros[dask]'")
    words = ["inverse", str(foreign), *motions, "-o", str(foreign.with_name("out"))]
    assert main([*words, "--scheduler", "local:1", "--allow-code"]) == 0
    assert has_run()


def test_all_that_is_named_is_listed_at_once(foreign, has_run, capsys):
    more = "stabilization: {type: 'told_parts:Keep'}\nintegrator: {type: 'a.b:C'}\n"
    foreign.write_text(foreign.read_text() + more)
    assert main(["check", str(foreign)]) == 2
    said = capsys.readouterr().err
    for text in ("forces[0].type 'told", "stabilization.type 'told", "integrator.type 'a.b:C'"):
        assert text in said
    assert not has_run()


def test_an_integrator_named_on_the_command_line_needs_it_too(tmp_path, capsys):
    scene = tmp_path / "scene.yaml"
    scene.write_text(f"robot: {{urdf: {URDF}}}\n")
    words = ["simulate", str(scene), "-t", "0.1", "-o", str(tmp_path / "o.csv")]
    assert main([*words, "--integrator", "antigravity:Rise"]) == 2
    assert "names code of others" in capsys.readouterr().err
    assert "antigravity" not in sys.modules


def test_a_module_that_is_not_found_is_told_with_where_it_was_looked_for(foreign, monkeypatch):
    """Neither beside the scene nor, for the installed command, in the current folder."""
    foreign.write_text(foreign.read_text().replace("told_parts", "beside_scene"))
    foreign.with_name("beside_scene.py").write_text(TOLD)
    with permitting(True), pytest.raises(SceneError) as caught:
        load_scene(foreign)
    assert "forces[0].type: type 'beside_scene:Push': No module named" in str(caught.value)
    assert str(foreign.parent / "elsewhere") in str(caught.value)
    assert "PYTHONPATH adds a folder" in str(caught.value)
    assert "of the scene is not searched" in str(caught.value)
    program = Path(sys.executable).with_name("mbd-ros")
    words = [str(program), "check", str(foreign), "--allow-code"]
    ran = subprocess.run(words, cwd=foreign.parent, capture_output=True, text=True)
    assert ran.returncode == 2 and "No module named 'beside_scene'" in ran.stderr


def test_a_module_with_a_mistake_is_an_error_of_the_scene(foreign):
    (foreign.parent / "elsewhere/told_parts.py").write_text("class Push(:\n")
    with permitting(True), pytest.raises(SceneError, match=r"told_parts:Push'.*told_parts.py"):
        load_scene(foreign)
