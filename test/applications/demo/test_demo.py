"""What the demo is made of: task, scenes, gains, folder, page."""

import re
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
import yaml
from demo import Task
from places import ROOT

from mbd_ros.applications.demo import loop
from mbd_ros.applications.demo.files import (
    MASS_SCALE,
    MODEL,
    RATE,
    replacing_folder,
    write_gains,
)
from mbd_ros.applications.demo.page import Content, Table, lines, page
from mbd_ros.applications.demo.task import LAWS, ROBOTS, trajectory
from mbd_ros.cli import main
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.state import NONE
from mbd_ros.errors import DataError
from mbd_ros.scene.reader import load_scene

CONFIG = ROOT / "config"
ORIGINALS = {
    "controlled_arm": "prosthetic_arm",
    "controlled_leg": "prosthetic_leg",
    "controlled_four_bar": "four_bar_leg",
    "controlled_arm7": "arm7",
}


@pytest.fixture(scope="module", params=ROBOTS)
def task(request, tmp_path_factory):
    return Task(request.param, tmp_path_factory.mktemp(request.param), 10.0)


# ---------------------------------------------------------------------- what is asked


def test_the_reference_begins_at_rest_and_is_its_own_integral(task):
    """Each step against the integral of its derivatives by their values at both ends."""
    t, q, v, a = task.trajectory
    np.testing.assert_allclose(q[0], task.start, atol=1e-15)
    assert not v[0].any() and not a[0].any()
    steps = np.diff(t)[:, None]
    hermite = q[:-1] + steps * (v[:-1] + v[1:]) / 2 + steps**2 * (a[:-1] - a[1:]) / 12
    np.testing.assert_allclose(q[1:], hermite, atol=2e-6)  # h^5 / 720 of the fifth derivative
    change = v[:-1] + steps * (a[:-1] + a[1:]) / 2
    np.testing.assert_allclose(v[1:], change, atol=3e-3)  # h^3 / 12 of the third


def test_the_reference_is_within_the_limits_however_long_it_lasts():
    for robot in ROBOTS.values():
        joints = load_scene(robot.scene).controlled_joints()
        start = joints.positions(load_scene(robot.scene).initial)
        asked = trajectory(robot, start, 60.0)
        for i, joint in enumerate(joints.joints):
            assert joint.lower < asked.q[:, i].min() and asked.q[:, i].max() < joint.upper
            assert np.abs(asked.v[:, i]).max() < 0.9 * joint.max_velocity


def test_the_disturbance_is_a_fifth_of_the_largest_gravity_torque(tmp_path):
    """By inverse dynamics at rest, an independent way to the torques that hold the arm."""
    task = Task("arm", tmp_path, 10.0)
    inverse, zero = task.scene.inverse_dynamics(), np.zeros(4)
    held = np.array([inverse.solve(q, zero, zero).tau for q in task.trajectory.q])
    np.testing.assert_allclose(task.added.size, 0.2 * np.abs(held).max(axis=0), rtol=1e-9)
    np.testing.assert_allclose(np.abs(task.added.torque).max(axis=0), task.added.size, rtol=2e-3)


def test_the_plant_is_the_scene_with_the_disturbance_and_the_model_30_percent_lighter(task):
    plant, scene = task.plant, task.scene
    model = load_scene(task.folder / MODEL).robot.model
    assert pin.computeTotalMass(plant.robot.model) == pin.computeTotalMass(scene.robot.model)
    for true, believed in zip(plant.robot.model.inertias[1:], model.inertias[1:], strict=True):
        expected = MASS_SCALE * true.toDynamicParameters()
        np.testing.assert_allclose(believed.toDynamicParameters(), expected, atol=1e-15)
    assert (len(plant.forces), plant.dt) == (len(scene.forces) + 1, 1 / RATE)
    x = scene.holding(forces=()).initial._replace(t=1.01)
    torque = plant.forces[-1].force(Kinematics, x, NONE)[[j.v for j in task.truth.joints]]
    middle = (task.added.torque[50] + task.added.torque[51]) / 2
    np.testing.assert_allclose(torque, middle, atol=1e-9)


def test_gains_of_sliding_mode_withstand_model_error_and_disturbance(task):
    found = list(task.mismatches())
    least = np.abs([m.disturbance for m in found]).max(axis=0) / MASS_SCALE
    assert np.all(np.array(task.gains["gains.gain"]) > 1.2 * least)
    for m in found[::20]:
        np.testing.assert_allclose(m.effectiveness, MASS_SCALE * np.eye(len(least)), atol=1e-9)


@pytest.mark.parametrize("law", LAWS)
def test_every_law_takes_the_gains_of_every_robot(law, tmp_path):
    from mbd_ros.scene.schema.registry import resolve

    for robot in ROBOTS.values():
        scene = load_scene(robot.scene)
        gains = write_gains(tmp_path, robot, law, scene)
        named = {k.removeprefix("gains."): v for k, v in gains.items() if k.startswith("gains.")}
        for name, value in named.items():
            named[name] = value[0] if len(value) == 1 else value
        resolve("controllers", law, "test")(scene.controlled_joints(), **named)


# ---------------------------------------------------------------------- files of the package


@pytest.mark.parametrize("name", ORIGINALS)
def test_a_controlled_scene_is_the_scene_it_names_with_actuators_and_stops(name):
    read = [
        yaml.safe_load((CONFIG / "scenes" / f"{stem}.yaml").read_text(encoding="utf-8"))
        for stem in (name, ORIGINALS[name])
    ]
    own, original = ({k: v for k, v in r.items() if k not in ("initial", "dt")} for r in read)
    actuators = own.pop("actuators")
    stops, *others = own.pop("constraints")
    assert stops == {"type": "joint_stop", "joints": ["all"]}
    assert own | ({"constraints": others} if others else {}) == original
    scene = load_scene(CONFIG / "scenes" / f"{name}.yaml")
    for entry in actuators:
        for joint in entry["joints"]:
            assert entry["limit"] == scene.robot.joint(joint).max_effort


def test_layouts_name_topics_of_the_demo():
    rviz = yaml.safe_load((CONFIG / "rviz/demo.rviz").read_text(encoding="utf-8"))
    shown = rviz["Visualization Manager"]["Displays"]
    kinds = [display["Class"].rpartition("/")[2] for display in shown]
    assert kinds == ["Grid", "RobotModel", "TF", "MarkerArray"]
    assert shown[3]["Topic"]["Value"] == f"{loop.SIMULATOR}/markers"
    contact = yaml.safe_load((CONFIG / "rviz/contact.rviz").read_text(encoding="utf-8"))
    *first, body = contact["Visualization Manager"]["Displays"]
    assert [display["Class"].rpartition("/")[2] for display in first] == kinds
    assert first[3]["Topic"]["Value"] == f"{loop.SIMULATOR}/markers"
    assert body["Topic"]["Value"] == "/box/odometry"
    joints = load_scene(ROBOTS["arm"].scene).actuated
    layout = ElementTree.parse(CONFIG / "plotjuggler/demo.xml")
    curves = [curve.get("name") for curve in layout.iter("curve")]
    own, torques = loop.loop_state("/sliding_mode_controller"), loop.TORQUES
    for i, joint in enumerate(joints):
        wanted = {f"{own}/{joint}/position", f"{own}/{joint}/velocity"}
        wanted |= {f"{loop.COMMANDS}/data[{i}]", f"{torques}/{joint}/effort"}
        assert wanted <= set(curves)
    assert len(curves) == 4 * len(joints)


# ---------------------------------------------------------------------- output


def fail_in(out):
    with replacing_folder(out, ["a", "b"]) as folder:
        (folder / "b").write_text("2")
        raise ValueError("now")


def test_a_folder_takes_its_place_whole_or_not_at_all(tmp_path):
    out = tmp_path / "out"
    with replacing_folder(out, ["a", "b"]) as folder:
        (folder / "a").write_text("1")
        assert not out.exists()
    with pytest.raises(ValueError, match="now"):
        fail_in(out)
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    assert [p.name for p in out.iterdir()] == ["a"]
    with replacing_folder(out, ["a", "b"]) as folder:
        (folder / "b").write_text("2")
    assert [p.name for p in out.iterdir()] == ["b"]
    (out / "mine").touch()
    with pytest.raises(DataError, match="holds mine"), replacing_folder(out, ["a", "b"]):
        pass
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_the_page_escapes_and_refers_to_nothing_outside():
    table = Table("A < B", ("joint", "x"), [("<b>", "1")])
    content = Content(
        "T", "f", ["x & y"], ["<i>"], ("", "<u>"), {"C": b"\x89PNG"}, [table], {"k": "v"}
    )
    text = page(content)
    assert "<script" not in text and "<b>" not in text and "<i>" not in text and "<u>" not in text
    assert "x &amp; y" in text and "A &lt; B" in text
    assert set(re.findall(r'(?:src|href)="([a-z]+):', text)) == {"data"}
    assert "default-src 'none'" in text and "width=device-width" in text


def test_lines_of_a_table_are_aligned():
    table = Table("T", ("joint", "x [m]"), [("a", "1"), ("longer", "12.5")])
    assert list(lines(table)) == ["", "T", "  joint   x [m]", "  a           1", "  longer   12.5"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("demo --time 1 -o OUT", "mbd-ros demo: time 1 s: accepted are 2 to 60 s"),
        ("demo --time nan -o OUT", "mbd-ros demo: time nan s: accepted"),
        ("demo -o FILE", "exists and is no folder, not replaced"),
        ("demo -o FULL", "holds mine, which is not of a demo; not replaced"),
        ("demo -o OUT/deeper", "does not exist"),
    ],
)
def test_bad_input_is_2_with_one_line_on_stderr_and_nothing_left(capsys, tmp_path, words, message):
    (tmp_path / "file").touch()
    (tmp_path / "full").mkdir()
    (tmp_path / "full/mine").touch()
    before = sorted(tmp_path.rglob("*"))
    for word in ("OUT", "FILE", "FULL"):
        words = words.replace(word, str(tmp_path / word.lower()))
    assert main(words.split()) == 2
    said = capsys.readouterr()
    assert said.out == "" and message in said.err and said.err.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == before
