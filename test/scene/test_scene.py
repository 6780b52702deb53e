"""Scene files: what they build, and how everything else is refused (faults 21, 24, 41, 44)."""

import random

import numpy as np
import pytest
from places import ROOT

from mbd_ros.core.model.urdf import MAX_CHARACTERS
from mbd_ros.errors import SceneError
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import description_topic, load_scene
from mbd_ros.scene.reading.coupling_entries import coupling_kinds
from mbd_ros.scene.schema.code_permission import permitting
from mbd_ros.scene.schema.sections import SECTIONS, keys

LEG = (ROOT / "config/robots/prosthetic_leg.urdf").read_text(encoding="utf-8")
FULL = """\
robot:
  urdf: leg.urdf
  gravity: [0, 1.5, -9.81]
  base: fixed
  locked: {ankle: 0.1}
  rename: {hip_flexion: hip}
couplings:
  knee_slide_x: {parent: knee, factor: 1e-2, offset: 0.001}
  knee_slide_y: {parent: knee_slide_x, polynomial: [0.0, 0.1, -0.2]}
paths:
  strap: {points: [{frame: world}, {frame: shank}], joints: {hip: 0.03}}
external_wrenches:
  foot: {frame: foot, expressed_in: world, topic: /plate, point: [0, 0, 0.1], threshold: 20}
  hand: {frame: shank}
forces:
  - {type: joint_spring, joint: knee, stiffness: 30.0}
  - {type: joint_friction, joint: hip, coulomb: 0.4}
constraints:
  - {type: joint_stop, joint: knee, lower: -1.5}
actuators:
  - {type: geared_motor, joint: knee, ratio: 10.0, rotor_inertia: 1e-3}
stabilization: {type: none}
solver: {type: auto, backend: proxqp}
integrator: {type: rk4}
dt: 5e-4
initial: {position: {knee: -0.5}, velocity: {hip: 1.0}}
safe: {type: damping, gain: 2}
"""


@pytest.fixture
def write(tmp_path):
    (tmp_path / "leg.urdf").write_text(LEG, encoding="utf-8")

    def scene(text):
        (tmp_path / "scene.yaml").write_text(text, encoding="utf-8")
        return tmp_path / "scene.yaml"

    return scene


def refusal(path, description=None):
    with pytest.raises(SceneError) as caught:
        load_scene(path, description)
    assert str(caught.value).startswith(f"{path}: ")
    return str(caught.value)


def test_every_section_is_built(write, tmp_path):
    scene = load_scene(write(FULL))
    assert scene.source == str(tmp_path / "leg.urdf")
    assert scene.robot.model.gravity.linear == pytest.approx([0, 1.5, -9.81])
    assert scene.couplings.independent == ("hip", "knee")
    assert coupling_kinds(scene) == {
        "knee_slide_x": "knee (factor)",
        "knee_slide_y": "knee_slide_x (polynomial)",
    }
    assert list(scene.wrenches) == ["foot", "hand"]
    assert [w.topic for w in scene.wrenches.values()] == ["/plate", None]
    assert [type(force).__name__ for force in scene.forces] == ["JointSpring", "JointFriction"]
    assert [type(part).__name__ for part in scene.constraints] == ["JointStop"]
    assert [part.joints for part in scene.actuators] == [("knee",)]
    knee = scene.robot.joint("knee")
    assert scene.robot.model.armature[knee.v] == pytest.approx(0.1)
    assert (scene.solver.type, scene.dt) == ("auto", 5e-4)
    assert type(scene.integrator).__name__ == "Rk4"
    assert type(scene.stabilization).__name__ == "NoStabilization"
    slide = scene.robot.joint("knee_slide_x")
    assert scene.initial.q[[knee.q, slide.q]] == pytest.approx([-0.5, -0.004])
    assert scene.initial.v[scene.robot.joint("hip").v] == 1.0
    assert (scene.safe.type, scene.safe.gain) == ("damping", 2.0)
    assert scene.absent == ("robots", "bodies", "contacts", "muscles", "sensors", "phases")
    solver = scene.inverse_dynamics()
    assert len(solver.solve(*np.ones((3, 2)), [np.ones(6)] * 2).multipliers) == 2


@pytest.mark.parametrize("rest", ["", "couplings:\nforces:\n", "couplings: {}\nforces: []\n"])
def test_empty_section_is_an_absent_one(write, rest):
    scene = load_scene(write("robot: {urdf: leg.urdf}\n" + rest))
    assert scene.absent == tuple(key for key in keys(SECTIONS)[1:] if key != "gravity")
    assert (coupling_kinds(scene), scene.forces, scene.wrenches) == ({}, (), {})


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("dt: 5e-4", "dt: 0", "dt: 0 s must be finite and > 0"),
        ("dt: 5e-4", "dt: 9e-10", "dt: 9e-10 s, accepted: 1e-09 .. 9e+09 s, since stamps hold"),
        ("dt: 5e-4", "dt: 1e300", "dt: 1e+300 s, accepted: 1e-09 .. 9e+09 s"),
        ("dt: 5e-4", "dt: fast", "dt: expected a number, got 'fast'"),
        ("type: rk4", "type: rk5", "integrator.type: unknown type 'rk5', accepted: adams, dop"),
        (
            "type: rk4",
            "type: rk4, tolerance: 1",
            "integrator: unknown key 'tolerance', accepted: none",
        ),
        ("type: none", "kind: none", "stabilization: key 'type' is missing, accepted: baumgarte,"),
        ("type: none", "type: 3", "stabilization.type: expected a word, got 3"),
        ("{type: rk4}", "{typ: rk4}", "integrator: key 'type' is missing, accepted: adams, dop85"),
        ("{type: rk4}", "dopri5", "mapping, got 'dopri5': write {type: dopri5}"),
        ("{type: rk4}", "rk5", "integrator: expected a mapping, got 'rk5'"),
        ("{type: auto, backend: proxqp}", "kkt", "got 'kkt': write {type: kkt}"),
        ("backend: proxqp", "backend: nope", "solver: solver backend 'nope' is not installed"),
        ("type: auto", "type: fast", "solver: unknown solver type 'fast', accepted: auto, aba"),
        ("{knee: -0.5}", "{nose: 1}", "initial.position: no joint 'nose'; the robot has hip,"),
        (
            "{knee: -0.5}",
            "{knee_slide_x: 1}",
            "initial.position.knee_slide_x: follows knee, leave",
        ),
        ("lower: -1.5", "lower: 9.0", "constraints[0]: joint 'knee': lower 9 must be less than u"),
        ("ratio: 10.0", "ratio: 0.0", "actuators[0].ratio: 0 is out of range, acc"),
        (
            "robot:\n",
            "robotes:\n",
            "unknown key 'robotes', accepted: robot, robots, bodies, gravity",
        ),
        ("urdf:", "urd:", "robot: unknown key 'urd', accepted: urdf, description_topic, gravity"),
        ("urdf: leg.urdf", "", "robot: give either 'urdf', 'osim', 'mjcf' or 'description_topic'"),
        ("leg.urdf", "leg.urdf\n  description_topic: a", "give either 'urdf', 'osim', 'mjcf' or"),
        ("leg.urdf", "log.urdf", "log.urdf: robot description cannot be read: No such file"),
        ("leg.urdf", ".", "it is a directory, not a regular file"),
        ("leg.urdf", "package://mbd_ros/no.urdf", "robot.urdf: package://mbd_ros/no.urdf not fou"),
        ("leg.urdf", "package://mbd_ros//etc/passwd", "leaves the package"),
        ("leg.urdf", "package://mbd_ros/../x.urdf", "leaves the package"),
        ("leg.urdf", "package://../x.urdf", "leaves the package"),
        ("[0, 1.5, -9.81]", "[0, 1.5]", "robot.gravity: expected 3 numbers, got [0.0, 1.5]"),
        ("[0, 1.5, -9.81]", "[0, nan, 1]", "robot.gravity[1]: expected a number, got 'nan'"),
        ("[0, 1.5, -9.81]", "[0, 1_0, 1]", "robot.gravity[1]: expected a number, got '1_0'"),
        ("[0, 1.5, -9.81]", "[0, 0x1, 1]", "robot.gravity[1]: expected a number, got '0x1'"),
        ("[0, 1.5, -9.81]", "[0, yes, 1]", "robot.gravity[1]: expected a number, got 'yes'"),
        ("[0, 1.5, -9.81]", "[0, .inf, 1]", "robot.gravity[1]: expected a number, got '.inf'"),
        ("[0, 1.5, -9.81]", "[0, 1e999, 1]", "robot.gravity[1]: 1e999 is not a finite number"),
        ("base: fixed", "base: flying", "base is 'flying', accepted: fixed, floating"),
        ("ankle: 0.1", "ankle: x", "robot.locked.ankle: expected a number, got 'x'"),
        ("ankle: 0.1", "ancle: 0.1", "locked: joint 'ancle' does not exist; the robot has hip, k"),
        ("hip_flexion: hip", "hip: a", "rename: no joint 'hip'; the robot has hip_flexion, "),
        ("factor: 1e-2", "factor: 0", "knee_slide_x: factor is 0: the joint never moves"),
        ("factor: 1e-2", "polynomial: [1]", "knee_slide_x: 'offset' goes with 'factor' only"),
        ("factor: 1e-2", "factor: 2, spline: {}", "of factor, polynomial, spline, piecewise_pol"),
        ("factor: 1e-2, offset: 0.001", "", "got none"),
        ("polynomial: [0.0, 0.1, -0.2]", "polynomial: []", "a polynomial needs at least one"),
        ("polynomial: [0.0", "polynomial: [.nan", "knee_slide_y.polynomial[0]: expected a number"),
        ("polynomial: [0.0, 0.1, -0.2]", "spline: {x: [1]}", "slide_y.spline: key 'y' is missing"),
        ("polynomial: [0.0, 0.1, -0.2]", "spline: {x: [1, 1], y: [1, 2]}", "two increasing"),
        ("parent: knee_slide_x", "parent: nose", "couplings: coupling knee_slide_y <- nose: pare"),
        ("parent: knee_slide_x", "parent: ankle", "parent: joint 'ankle' is locked at 0.1"),
        ("parent: knee,", "parent: knee_slide_y,", "cycle: knee_slide_x <- knee_slide_y <- kn"),
        ("parent: knee,", "parrent: knee,", "couplings.knee_slide_x: unknown key 'parrent', acc"),
        ("knee_slide_x: {", "hip_flexion: {", "no joint 'hip_flexion'; the robot has hip, "),
        ("frame: foot", "frame: feet", "wrenches.foot: no frame 'feet'; the links are world"),
        ("expressed_in: world", "expressed_in: earth", "foot: no frame 'earth'; the links are"),
        ("topic: /plate", "topic: 3", "external_wrenches.foot.topic: expected a word, got 3"),
        ("topic: /plate", "topic: '///'", "foot.topic: '///' is no ROS topic, accepted: words"),
        ("topic: /plate", "topic: /plate/", "foot.topic: '/plate/' is no ROS topic"),
        ("topic: /plate", "topic: a//b", "foot.topic: 'a//b' is no ROS topic"),
        ("topic: /plate", "topic: ~plate", "foot.topic: '~plate' is no ROS topic"),
        ("topic: /plate", "topic: ''", "foot.topic: '' is no ROS topic"),
        ("  hand: {", "  a b/c: {", "external_wrenches.a b/c: is no ROS name, accepted: letters"),
        ("  hand: {", "  2nd: {", "external_wrenches.2nd: is no ROS name"),
        ("threshold: 20", "threshold: -1", "wrenches.foot.threshold: -1 is out of range"),
        ("threshold: 20", "treshold: 20", "foot: unknown key 'treshold', accepted: frame, expr"),
        ("point: [0, 0, 0.1]", "point: [0]", "foot.point: expected 3 numbers, got [0]"),
        ("type: joint_spring", "type: spring", "forces[0].type: unknown type 'spring', accepted:"),
        ("type: joint_spring,", "", "forces[0]: key 'type' is missing, accepted: applied_wrench,"),
        ("stiffness: 30.0", "stiffnes: 30.0", "forces[0]: unknown key 'stiffnes', accepted: jo"),
        ("stiffness: 30.0", "stiffness: -3", "forces[0].stiffness: -3 is out of range, accept"),
        ("joint: hip", "joint: ankle", "forces[1]: joint 'ankle' is locked at 0.1"),
        ("forces:\n", "forces: {}\nforce:\n", "unknown key 'force'"),
        (FULL, "robot:", "key 'robot' is missing, or robots, or bodies"),
        (FULL, "forces: []", "key 'robot' is missing"),
        (FULL, "robot: {urdf: leg.urdf}\ncouplings: 0", "couplings: expected a mapping, got 0"),
        (FULL, "robot: {urdf: leg.urdf}\nforces: {}", "forces: expected a list, got {}"),
        (FULL, "robot: {urdf: leg.urdf}\nforces: [1]", "forces[0]: expected a mapping, got 1"),
    ],
)
def test_one_wrong_thing_is_named_with_its_key(write, old, new, message):
    assert old in FULL
    assert message in refusal(write(FULL.replace(old, new, 1)))


@pytest.mark.parametrize("topic", ["plate", "/plate", "/a_1/_b", "~/plate", "a/b"])
def test_topics_that_ros_knows_are_taken(write, topic):
    scene = load_scene(write(FULL.replace("topic: /plate", f"topic: {topic}")))
    assert scene.wrenches["foot"].topic == topic


@pytest.mark.parametrize(
    ("description", "message"),
    [
        (None, "the description comes from topic /rd, which only a node can read; give 'urdf'"),
        ("", "robot: topic /rd: robot description is empty"),
        ("  \n", "robot: topic /rd: robot description is empty"),
        ("<robot", "robot: topic /rd: not well-formed XML"),
        ("<!DOCTYPE a><robot/>", "robot: topic /rd: DOCTYPE and ENTITY declarations are refused"),
        (
            "x" * (MAX_CHARACTERS + 1),
            f"robot: topic /rd: has {MAX_CHARACTERS + 1} characters, accep",
        ),
        (LEG.replace('mass value="', 'mass value="-'), "topic /rd: link 'residual_limb': mass is"),
    ],
)
def test_description_of_a_topic_is_checked_like_a_file(write, description, message):
    path = write("robot: {description_topic: /rd}")
    assert message in refusal(path, description)


def test_description_of_a_topic_builds_the_robot(write):
    path = write("robot: {description_topic: /rd}")
    assert description_topic(path) == "/rd"
    assert load_scene(path, LEG).source == "topic /rd"
    assert description_topic(write(FULL)) is None


@pytest.mark.parametrize("prefix", ["AMENT_PREFIX_PATH", "own"])
def test_package_addresses_are_found(write, tmp_path, monkeypatch, prefix):
    name = "package://mbd_ros/config/robots/pendulum.urdf"
    if prefix == "AMENT_PREFIX_PATH":
        share = tmp_path / "install/share/hip_description/urdf"
        share.mkdir(parents=True)
        (share / "hip.urdf").write_text(LEG, encoding="utf-8")
        monkeypatch.setenv(prefix, f"/nowhere:{tmp_path / 'install'}")
        name = "package://hip_description/urdf/hip.urdf"
    scene = load_scene(write(f"robot: {{urdf: '{name}'}}"))
    assert scene.source.endswith(name.rsplit("/", 1)[1])


OUTSIDE = """
import numpy as np
from mbd_ros.core.contracts import Load
from mbd_ros.scene.reading.coupling_entries import coupling_kinds
class Push(Load):
    def __init__(self, robot, *, size: float):
        self.tau = np.full(robot.model.nv, size)
    def force(self, k, x, u):
        return self.tau
class Broken:
    def __init__(self, robot):
        pass
"""


def test_part_of_another_package_needs_no_line_here(write, tmp_path, monkeypatch):
    (tmp_path / "outside_parts.py").write_text(OUTSIDE)
    monkeypatch.syspath_prepend(str(tmp_path))
    plain = load_scene(write("robot: {urdf: leg.urdf}")).inverse_dynamics()
    text = "robot: {urdf: leg.urdf}\nforces: [{type: 'outside_parts:Push', size: 2}]"
    x = np.zeros(5)
    with permitting(True):
        pushed = load_scene(write(text)).inverse_dynamics()
        assert pushed.solve(x, x, x).tau == pytest.approx(plain.solve(x, x, x).tau - 2.0)
        assert "forces[0]: unknown key 'sise', accepted: size" in refusal(
            write(text.replace("size", "sise"))
        )
        assert "not a class with a method 'force'" in refusal(
            write(text.replace("Push', size: 2", "Broken'"))
        )


def test_solvers_of_one_scene_do_not_disturb_each_other(write):
    """Each has its own data, also when their calls alternate."""
    scene = load_scene(write(FULL))
    rng, loads = np.random.default_rng(0), [np.ones(6)] * 2
    x, y = rng.normal(size=(2, 3, 2))
    one, other = scene.inverse_dynamics(), scene.inverse_dynamics()
    alone = one.solve(*x, loads)
    other.batch(*y[:, None], [w[None] for w in loads])
    other.solve(*y, loads)
    again = one.solve(*x, loads)
    assert np.array_equal(alone.tau, again.tau)
    assert np.array_equal(alone.multipliers, again.multipliers)


def damaged(text, dice):
    """One to three words exchanged, or characters lost or doubled."""
    words = ["nan", "1e999", "0", "-1", "{}", "[]", "null", "knee", "foot", "!!x", "&a", "*a", "'"]
    words += ['"\\0"', "1" * 400, "true", "os:system", ":", ",", "\t", "\n", "é", "package://", ""]
    for _ in range(dice.randint(1, 3)):
        i = dice.randrange(len(text))
        if dice.random() < 0.6:
            start = max(text.rfind(" ", 0, i), text.rfind("\n", 0, i)) + 1
            end = start + len(text[start:].split(maxsplit=1)[0]) if text[start:].split() else i
            text = text[:start] + dice.choice(words) + text[end:]
        else:
            text = text[:i] + dice.choice(("", text[i] * 2)) + text[i + 1 :]
    return text


def test_random_damage_never_raises_anything_else(write):
    """300 mutations of a whole scene: a SceneError that names the file, or a scene."""
    dice, refused = random.Random(11), 0
    for _ in range(300):
        path = write(damaged(FULL, dice))
        try:
            assert isinstance(load_scene(path), Scene)
        except SceneError as error:
            assert str(error).startswith(f"{path}: ")
            refused += 1
    assert 150 < refused < 300


def test_backends_that_there_are_are_listed_once(write):
    listed = refusal(write(FULL.replace("backend: proxqp", "backend: nope"))).partition("are ")[2]
    names = listed.split(", ")
    assert "proxqp" in names
    assert len(set(names)) == len(names)
