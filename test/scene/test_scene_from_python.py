"""Scenes without files: from a mapping, with other sections, with other inertias."""

import re
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from places import ROOT

from mbd_ros.api import load_scene, scene_from
from mbd_ros.cli import main
from mbd_ros.core.contracts import Load
from mbd_ros.core.model.robot_reader import read_robot, with_inertias
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.scene import from_python
from mbd_ros.scene.schema.strict_yaml import read_mapping

SCENES, ROBOTS = ROOT / "config/scenes", ROOT / "config/robots"
LEG = (ROBOTS / "prosthetic_leg.urdf").read_text(encoding="utf-8")
SPRING = {"type": "joint_spring", "joint": "knee", "stiffness": 30.0}
MOTOR = {"type": "geared_motor", "joint": "knee", "ratio": 10.0, "rotor_inertia": 1e-3}


class Push(Load):
    """A force of one's own."""

    def __init__(self, robot, *, size: float):
        self._tau = np.full(robot.model.nv, size)

    def force(self, k, x, u):
        return self._tau


class Silent:
    def __init__(self, robot):
        pass


@pytest.fixture
def leg():
    return load_scene(SCENES / "prosthetic_leg.yaml")


def motion(scene, duration=0.01):
    return [np.concatenate((x.q, x.v)) for x in scene.simulation().run(scene.initial, duration)]


@pytest.mark.parametrize("name", ["arm7", "prosthetic_leg", "four_bar_leg", "controlled_leg"])
def test_a_mapping_builds_what_its_file_builds(name):
    path = SCENES / f"{name}.yaml"
    entries = read_mapping(path)
    urdf = (path.parent / entries["robot"].pop("urdf")).resolve()
    scene, filed = scene_from(entries, urdf=urdf), load_scene(path)
    assert np.array_equal(motion(scene), motion(filed))
    assert (scene.path, scene.name, scene.source) == (None, "scene", str(urdf))
    lines = [line for line in scene.check().splitlines() if not line.startswith("cost")]
    assert [line.replace(str(urdf), "*") for line in lines[1:]] == [
        line.replace(filed.source, "*") for line in filed.check().splitlines()[1:-1]
    ]


@pytest.mark.parametrize(
    ("urdf", "source"),
    [
        (ROBOTS / "prosthetic_leg.urdf", str(ROBOTS / "prosthetic_leg.urdf")),
        ("prosthetic_leg", "prosthetic_leg.urdf"),
        ("package://mbd_ros/config/robots/prosthetic_leg.urdf", "prosthetic_leg.urdf"),
        (LEG, "URDF text"),
    ],
)
def test_a_robot_is_a_file_a_name_or_text(urdf, source):
    scene = scene_from({"robot": {"gravity": (0, 0, -1.62)}}, urdf=urdf)
    assert scene.source.endswith(source)
    assert scene.robot.name == "prosthetic_leg"
    assert scene.robot.model.gravity.linear[2] == -1.62
    assert scene.with_(dt=2e-3).robot is scene.robot


def test_a_relative_path_starts_from_the_current_folder(monkeypatch):
    monkeypatch.chdir(ROBOTS)
    scene = scene_from({"robot": {"urdf": "arm7.urdf"}})
    assert scene.source == "arm7.urdf"


def test_a_description_of_a_topic_serves_too():
    entries = {"robot": {"description_topic": "/rd"}}
    scene = from_python.scene_from(entries, description=LEG)
    assert scene.source == "topic /rd"


def test_values_of_python_stand_for_those_of_a_file():
    force = {**SPRING, "stiffness": np.float64(30), "rest": np.array(0.1)}
    scene = scene_from({"forces": (force,), "dt": np.float32(0.5), "couplings": None}, urdf=LEG)
    assert scene.entries["forces"] == [{**SPRING, "rest": 0.1}]
    assert (scene.dt, len(scene.forces)) == (0.5, 1)


def test_a_class_stands_for_its_name():
    pushed = scene_from({"forces": [{"type": Push, "size": 2.0}]}, urdf="pendulum")
    assert isinstance(pushed.forces[0], Push) and pushed.code == {}
    still = scene_from(urdf="pendulum")
    at_rest = np.zeros((3, 1))
    torques = [s.inverse_dynamics().solve(*at_rest).tau[0] for s in (still, pushed)]
    assert torques[0] - torques[1] == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"forces": [{**SPRING, "type": "spring"}]}, "forces[0].type: unknown type 'spring', acc"),
        ({"forces": [{"type": Silent}]}, "forces[0].type: type 'Silent' is not a class with a m"),
        ({"forces": [{"type": Push}]}, "forces[0]: key 'size' is missing"),
        ({"forces": [{**SPRING, "rest": np.nan}]}, "forces[0].rest: nan is not a finite number"),
        ({"forces": [{**SPRING, "rest": 10**20}]}, "forces[0].rest: 1000000000000000000"),
        ({"forces": [{**SPRING, "rest": 1j}]}, "forces[0].rest: expected a number, a word, a li"),
        ({"forces": [{1: 2}]}, "forces[0]: a key must be a word, got 1"),
        ({"force": []}, "unknown key 'force', accepted: robot, robots, bodies"),
        ({"dt": "fast"}, "dt: expected a number, got 'fast'"),
        ({"robot": {"urdf": "a.urdf"}}, "robot: its description is given twice"),
        ({"robot": {"base": "flying"}}, "robot: base is 'flying', accepted"),
        ({"robot": 3}, "robot: expected a mapping, got 3"),
        ({"initial": {"position": {"nose": 1}}}, "initial.position: no joint 'nose'; the robot"),
        ({"integrator": "rk4"}, "integrator: expected a mapping, got 'rk4': write {type: rk4}"),
        ({"forces": [{"type": "elsewhere:Push"}]}, "names code of others, of which nothing was"),
    ],
)
def test_a_mistake_is_named_with_its_key(entries, message):
    with pytest.raises(SceneError) as caught:
        scene_from(entries, urdf=LEG)
    assert str(caught.value).startswith(f"scene: {message}")


def test_what_refers_to_itself_is_refused():
    endless = []
    endless.append(endless)
    with pytest.raises(SceneError, match="nested deeper than 32"):
        scene_from({"forces": endless}, urdf=LEG)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({}, "scene: key 'robot' is missing"),
        (
            {"urdf": "arm8"},
            "scene: robot.urdf: 'arm8' is no file, no URDF text and no embedded rob",
        ),
        ({"urdf": "no/such.urdf"}, "scene: robot.urdf: no/such.urdf: robot description cannot be"),
        ({"urdf": LEG, "description": LEG}, "scene: robot: its description is given twice"),
    ],
)
def test_a_robot_that_is_not_there_is_named(words, message):
    with pytest.raises(SceneError) as caught:
        from_python.scene_from({}, **words)
    assert str(caught.value).startswith(message)


def test_sections_are_replaced_and_removed(leg):
    scene = leg.with_(forces=[SPRING], actuators=[MOTOR], integrator={"type": "rk4"}, dt=2e-3)
    assert [type(part).__name__ for part in scene.forces] == ["JointSpring"]
    assert (type(scene.integrator).__name__, scene.dt) == ("Rk4", 2e-3)
    knee = scene.robot.joint("knee")
    assert scene.robot.model.armature[knee.v] == pytest.approx(0.1)
    assert leg.robot.model.armature[knee.v] == 0.0
    assert (scene.path, scene.name) == (None, f"{leg.path} (changed)")
    bare = scene.with_(forces=None, actuators=None, integrator=None)
    assert (bare.forces, bare.actuators, bare.integrator, bare.dt) == ((), (), None, 2e-3)
    assert bare.name == scene.name
    assert bare.robot.model.armature[knee.v] == 0.0
    assert np.array_equal(motion(bare), motion(leg.with_(dt=2e-3)))


def test_what_a_section_does_not_change_is_kept(leg):
    scene = leg.with_(forces=[SPRING])
    assert scene.robot is leg.robot and scene.couplings is leg.couplings
    again = scene.with_(dt=1e-4)
    assert again.forces[0] is scene.forces[0] and again.parts["initial"] is leg.parts["initial"]
    driven = scene.with_(actuators=[MOTOR])
    assert driven.couplings is scene.couplings
    assert driven.forces[0] is not scene.forces[0]  # was built on the robot without the drive


@pytest.mark.parametrize(
    ("sections", "message"),
    [
        ({"forces": [{**SPRING, "rate": 1}]}, "forces[0]: unknown key 'rate', accepted: joint"),
        ({"speed": 1}, "unknown key 'speed', accepted: robot, robots, bodies"),
        ({"robot": None}, "key 'robot' is missing"),
        ({"dt": 0}, "dt: 0 s must be finite and > 0"),
    ],
)
def test_a_mistake_in_a_new_section_names_the_scene(leg, sections, message):
    with pytest.raises(SceneError) as caught:
        leg.with_(**sections)
    assert str(caught.value).startswith(f"{leg.path} (changed): {message}")


def test_paths_of_a_changed_scene_start_from_its_file(leg):
    scene = leg.with_(robot={"urdf": "../robots/arm7.urdf"}, couplings=None)
    assert scene.robot.name == "arm7"


def test_code_that_was_permitted_stays_so(tmp_path, monkeypatch):
    (tmp_path / "own_parts.py").write_text(
        "from mbd_ros.core.contracts import Load\n"
        "class Push(Load):\n def __init__(self, robot): pass\n"
        " def force(self, k, x, u): return 0.0\n"
        "class Pull(Push): pass\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    scene = scene_from({"forces": [{"type": "own_parts:Push"}]}, urdf="pendulum", allow_code=True)
    assert scene.with_(dt=2e-3).code == {"forces[0].type": "own_parts:Push"}
    assert len(scene.with_(actuators=[{"type": "ideal", "joints": ["hinge"]}]).forces) == 1
    with pytest.raises(SceneError, match="names code of others"):
        scene.with_(forces=[{"type": "own_parts:Pull"}])


def edited(link, mass, com, tensor):
    """The leg's URDF with an inertia written into its text."""
    tree = ElementTree.fromstring(LEG)
    inertial = next(e for e in tree.findall("link") if e.get("name") == link).find("inertial")
    words = {"xyz": " ".join(map(repr, com)), "rpy": "0 0 0"}
    inertial.find("origin").attrib.update(words)
    inertial.find("mass").set("value", repr(mass))
    for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        inertial.find("inertia").set(f"i{'xyz'[i]}{'xyz'[j]}", repr(tensor[i][j]))
    return ElementTree.tostring(tree, encoding="unicode")


TENSOR = [[0.02, 0.001, 0.0], [0.001, 0.03, -0.002], [0.0, -0.002, 0.015]]
GIVEN = (1.25, [0.01, -0.02, -0.1], TENSOR)


@pytest.mark.parametrize("link", ["shank", "foot", "residual_limb"])
@pytest.mark.parametrize("as_object", [True, False])
def test_other_inertias_are_those_of_an_edited_description(link, as_object):
    """To the last bit, locked links (the foot) included."""
    inertia = pin.Inertia(GIVEN[0], *map(np.array, GIVEN[1:])) if as_object else GIVEN
    options = {"locked": {"ankle": 0.2}, "rename": {"hip_flexion": "hip"}}
    old = read_robot(LEG, **options)
    robot = with_inertias(old, {link: inertia})
    wanted = read_robot(edited(link, *GIVEN), **options)
    for ours, theirs, before in zip(
        *(r.model.inertias for r in (robot, wanted, old)), strict=True
    ):
        assert np.array_equal(ours.matrix(), theirs.matrix())
        assert before is not ours
    assert robot.joints == old.joints and robot.locked == old.locked
    assert not all(
        np.array_equal(a.matrix(), b.matrix())
        for a, b in zip(robot.model.inertias, old.model.inertias, strict=True)
    )


def test_inertias_of_links_are_read_back():
    robot = read_robot(LEG)
    found = with_inertias(robot, {"shank": GIVEN}).inertias()
    assert np.array_equal(
        found["shank"].matrix(), pin.Inertia(GIVEN[0], *map(np.array, GIVEN[1:])).matrix()
    )
    assert list(found) == list(robot.inertias())
    same = with_inertias(robot, robot.inertias())
    assert same.model.inertias[1].isApprox(robot.model.inertias[1], 1e-14)
    assert pin.computeTotalMass(same.model) == pytest.approx(pin.computeTotalMass(robot.model))


def test_a_scene_takes_other_inertias(leg):
    driven = leg.with_(actuators=[MOTOR])
    heavy = driven.with_inertias({"shank": GIVEN}).with_inertias({"foot": GIVEN})
    wanted = with_inertias(read_robot(LEG), {"shank": GIVEN, "foot": GIVEN}).model.inertias
    assert all(a == b for a, b in zip(heavy.robot.model.inertias, wanted, strict=True))
    assert np.array_equal(heavy.robot.model.armature, driven.robot.model.armature)
    again = with_inertias(heavy.robot, {})
    assert np.array_equal(again.model.armature, driven.robot.model.armature)
    assert not np.array_equal(motion(heavy), motion(driven))


@pytest.mark.parametrize(
    ("inertias", "message"),
    [
        ({"shin": GIVEN}, "no link 'shin'; the links are world, "),
        ({"shank": (-1.0, *GIVEN[1:])}, "link 'shank': mass is -1 kg, but must not be negative"),
        ({"shank": (np.nan, *GIVEN[1:])}, "link 'shank': <mass value='nan'>: expected a finite"),
        ({"shank": (1.0, [0, 0], TENSOR)}, "link 'shank': expected a pinocchio.Inertia, or mass"),
        ({"shank": 3.0}, "link 'shank': expected a pinocchio.Inertia, or mass [kg]"),
        ({"shank": (1.0, [0, 0, 0], np.triu(TENSOR))}, "link 'shank': inertia is not symmetric"),
        ({"shank": (1.0, [0, 0, 0], np.diag([1.0, 1.0, 9.0]))}, "violates the triangle inequali"),
        ({"shank": (1.0, [0, 0, 0], -np.eye(3))}, "link 'shank': inertia is not positive definit"),
    ],
)
def test_inertias_are_checked_as_those_of_a_description(leg, inertias, message):
    with pytest.raises(ModelError) as caught:
        with_inertias(leg.robot, inertias)
    assert message in str(caught.value)
    with pytest.raises(SceneError, match=re.escape(f"{leg.path} (changed): robot: ")) as caught:
        leg.with_inertias(inertias)
    assert message in str(caught.value)


def test_doubtful_inertias_are_said(leg):
    scene = leg.with_inertias({"shank": (1.0, [0, 0, 0], np.zeros((3, 3)))})
    assert "link 'shank': a point mass, all moments of inertia are 0" in scene.check()


def test_check_says_what_the_command_prints(leg, capsys):
    assert main(["check", str(leg.path)]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert leg.check().splitlines()[:-1] == printed[:-1]
    assert printed[-1].startswith("cost")


SHOWN = ["arm7", "prosthetic_leg", "four_bar_leg", "prosthetic_arm", "controlled_arm7"]


@pytest.mark.parametrize("name", SHOWN)
def test_a_scene_is_shown_in_ten_lines(name):
    scene = load_scene(name)
    for text in (repr(scene), repr(scene.robot)):
        assert len(text.splitlines()) <= 10
        assert max(map(len, text.splitlines())) < 250
    lines = repr(scene).splitlines()
    assert lines[0] == f"Scene {scene.path}"
    assert scene.robot.name in lines[1] and str(len(scene.robot.joints)) in lines[1]
    assert all(any(name in line for line in lines) for name in scene.entries if name in KINDS)


KINDS = ("couplings", "external_wrenches", "constraints", "forces", "actuators")


def test_a_notebook_shows_a_table_in_which_names_are_escaped():
    urdf = LEG.replace('robot name="prosthetic_leg"', 'robot name="&lt;b&gt;"')
    page = scene_from({"forces": [SPRING] * 40}, urdf=urdf)._repr_html_()
    table = ElementTree.fromstring(page)
    assert [row.find("th").text for row in table.findall("tr")] == ["robot", "forces", "run"]
    assert "&lt;b&gt;" in page and "40: JointSpring" in page and len(page) < 1500


def test_messages_of_a_scene_without_a_file_have_a_name():
    with pytest.raises(SceneError, match=r"^scene: solver: unknown solver type 'fast'"):
        scene_from(urdf=LEG).system(solver={"type": "fast"})
