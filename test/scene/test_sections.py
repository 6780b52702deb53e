"""The table of the sections: order, and what other packages add to it."""

import shutil
import sys

import numpy as np
import pytest
from installed_package import install
from places import ROOT

from mbd_ros.applications.report.peers.translation import common_ground
from mbd_ros.cli import main
from mbd_ros.errors import SceneError
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.schema.code_permission import permitting
from mbd_ros.scene.schema.registry import METHODS, PARTS
from mbd_ros.scene.schema.sections import SECTIONS, TASKS, Form, Section, keys, ordered

URDF = ROOT / "config/robots/pendulum.urdf"
MODULE = '''
"""Winds that push a joint: a section of another package."""

import numpy as np

from mbd_ros.core.contracts import Load
from mbd_ros.scene.schema.sections import Form, Section


class Steady(Load):
    def __init__(self, robot, *, joint: str, torque: float):
        self.joint = robot.joint(joint)
        self._tau = np.zeros(robot.model.nv)
        self._tau[self.joint.v] = torque

    def force(self, k, x, u):
        return self._tau


SECTION = Section(
    "winds",
    Form.NAMED,
    offers=("force",),
    check="wind: {name}, {kind}{at}",
    types={"steady": "mbd_ros_winds:Steady"},
)
'''
WINDS = "winds:\n  mistral: {type: steady, joint: hinge, torque: 2.0}\n"


@pytest.mark.parametrize("table", [SECTIONS, TASKS])
def test_a_table_has_an_order(table):
    done = []
    for section in ordered(table):
        assert set(section.after) <= set(done)
        done.append(section.key)
    assert sorted(done) == sorted(keys(table)) and len(set(done)) == len(done)


@pytest.mark.parametrize(
    ("after", "message"),
    [
        (("robot", "strings"), "section 'cables' comes after unknown strings; there are robot,"),
        (("cables",), "sections wait for each other: cables"),
        (("knots",), "sections wait for each other: cables, knots"),
    ],
)
def test_cycles_and_unknown_names_are_refused(after, message):
    table = (
        *SECTIONS,
        Section("cables", Form.LIST, after=after),
        Section("knots", Form.LIST, after=("cables",)),
    )
    with pytest.raises(SceneError) as caught:
        ordered(table[:-1] if "knots" not in message else table)
    assert message in str(caught.value)


def test_the_registry_reads_the_table():
    """Every kind of part of a scene has a line, whose methods the registry asks for."""
    kinds = {section.parts: section.offers for section in SECTIONS if section.parts}
    assert {**kinds, "controllers": ("effort",), "estimators": ("predict", "correct")} == METHODS
    assert set(METHODS) == set(PARTS)


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Folder into which pip has installed a package with a section."""
    folder, modules = tmp_path_factory.mktemp("package"), {"mbd_ros_winds": MODULE}
    entries = {"winds": "mbd_ros_winds:SECTION"}
    return install(folder, "mbd_ros_winds", modules, "mbd_ros.sections", entries)


@pytest.fixture
def windy(installed, tmp_path, monkeypatch):
    """A scene with that section, in a process that finds the package."""
    monkeypatch.syspath_prepend(str(installed))
    monkeypatch.delitem(sys.modules, "mbd_ros_winds", raising=False)
    scene = tmp_path / "scene.yaml"
    scene.write_text(f"robot: {{urdf: {URDF}}}\n{WINDS}", encoding="utf-8")
    return scene


def test_a_section_of_others_is_code_of_others(windy, capsys):
    assert main(["check", str(windy)]) == 2
    said = capsys.readouterr().err
    assert f"{windy}: names code of others, of which nothing was imported: winds" in said
    assert "'mbd_ros_winds:SECTION'" in said and "--allow-code" in said
    assert "mbd_ros_winds" not in sys.modules


def test_a_section_of_others_is_checked_and_acts(windy, tmp_path, capsys):
    assert main(["check", str(windy), "--allow-code"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "wind        mistral, Steady at hinge" in lines
    assert any(line.startswith("code        winds: mbd_ros_winds:SECTION from ") for line in lines)
    ours, theirs = (tmp_path / name for name in ("ours.csv", "theirs.csv"))
    words = ["-t", "0.05", "--allow-code", "-o"]
    assert main(["simulate", str(windy), *words, str(theirs)]) == 0
    force = "forces: [{type: joint_torque, joint: hinge, torque: 2.0}]\n"
    windy.write_text(windy.read_text(encoding="utf-8").replace(WINDS, force), encoding="utf-8")
    assert main(["simulate", str(windy), *words, str(ours)]) == 0
    motions = [np.loadtxt(p, delimiter=",", skiprows=1, usecols=range(4)) for p in (ours, theirs)]
    assert np.array_equal(*motions)
    assert motions[0][-1, 1] > 0.005


def test_parts_of_a_section_of_others_are_kept_by_key(windy):
    with permitting(True):
        scene = load_scene(windy)
    assert list(scene.parts["winds"]) == ["mistral"]
    assert scene.forces == (scene.parts["winds"]["mistral"],)
    assert scene.code == {"winds": "mbd_ros_winds:SECTION"}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("type: steady", "type: gusty", "winds.mistral.type: unknown type 'gusty', accepted: st"),
        ("torque: 2.0", "torqe: 2.0", "winds.mistral: unknown key 'torqe', accepted: joint, tor"),
        ("joint: hinge", "joint: knee", "winds.mistral: no joint 'knee'; the robot has hinge"),
        (WINDS, "winds: []", "winds: expected a mapping, got []"),
        ("winds:", "wind:", "unknown key 'wind', accepted: robot, robots, bodies"),
    ],
)
def test_mistakes_in_it_are_named_like_any(windy, old, new, message):
    windy.write_text(windy.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    with permitting(True), pytest.raises(SceneError) as caught:
        load_scene(windy)
    assert f"{windy}: {message}" in str(caught.value)


def test_peers_are_not_told_of_it(windy):
    """Left out by name, and taken from the scene that peers are compared with."""
    with permitting(True):
        ground = common_ground(load_scene(windy))
    assert ground.left == ("winds (section of others)",)
    assert ground.scene.forces == () and "winds" not in ground.scene.parts


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"winds",', '"breezes",', "winds: 'mbd_ros_winds:SECTION' is no Section with the key"),
        ("SECTION = Section(", "OTHER = Section(", "winds: entry point 'mbd_ros_winds:SECTION': "),
        ("import numpy", "import no_such_module_\nimport numpy", "No module named 'no_such_modul"),
        ("{kind}{at}", "{knd}{at}", "winds: text of check: unknown knd, accepted: kind, name, at"),
        ('("force",)', '("force",), after=("sails",)', "comes after unknown sails"),
        ('("force",)', '("force", "sail")', "'steady' is not a class with a method 'sail'"),
    ],
)
def test_a_package_with_a_mistake_is_an_error_of_the_scene(
    windy, tmp_path, monkeypatch, installed, old, new, message
):
    copy = tmp_path / "site"
    shutil.copytree(installed, copy)
    module = copy / "mbd_ros_winds.py"
    assert old in MODULE
    module.write_text(MODULE.replace(old, new), encoding="utf-8")
    monkeypatch.syspath_prepend(str(copy))
    with permitting(True), pytest.raises(SceneError) as caught:
        load_scene(windy)
    assert str(windy) in str(caught.value) and message in str(caught.value)
