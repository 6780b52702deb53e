"""`mbd-ros scale`: segments of the size that a static trial shows, masses kept."""

import gzip
import shutil

import numpy as np
import pytest
from places import RECORDINGS

import mbd_ros as mbd
from mbd_ros.cli import main
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.errors import DataError, SceneError
from mbd_ros.features.markers.scale.job import ScaledUrdf, scaled
from mbd_ros.features.markers.scale.task import Measurement, ScaleTask
from mbd_ros.files.table import Column, Result, Table


def places(scene, q):
    """Label -> place of every marker."""
    k = Kinematics(scene.robot)
    k.refresh(q, np.zeros(scene.robot.model.nv))
    return {m.title: k.position(m.point) + scene.robot.origin for m in scene.sensors}


def static(found, noise=0.0):
    """A recording of standing still."""
    rng, columns = np.random.default_rng(0), [Column("time", 0.1 * np.arange(5), "s")]
    for label, place in found.items():
        columns += [
            Column(f"{label}.{a}", place[i] + noise * rng.normal(size=5))
            for i, a in enumerate("xyz")
        ]
    return Result({"samples": Table(columns)})


def whole(link, factor):
    return {link: (Measurement(factor=factor),)}


@pytest.fixture(scope="module")
def leg():
    return mbd.load_scene("marked_leg")


def links_of(scene):
    return list(scene.robot.inertias())


def test_a_leg_that_is_a_tenth_larger_has_all_places_a_tenth_farther(leg):
    """Also with couplings of a sliding knee centre, whose functions are lengths."""
    task = ScaleTask({link: (Measurement(factor=1.1),) for link in links_of(leg)})
    lines = []
    large = scaled(leg, static(places(leg, leg.initial.q)), task, lines.append)
    q = np.zeros(5)
    for name, angle in (("hip_flexion", 0.4), ("knee", -1.0), ("ankle", 0.1)):
        q[leg.robot.joint(name).q] = angle
    q_large = q.copy()
    for scene, each in ((leg, q), (large, q_large)):
        scene.couplings.expand(each, np.zeros(5), np.zeros(5))
    small, found = places(leg, q), places(large, q_large)
    base = leg.robot.origin
    for label, place in found.items():
        np.testing.assert_allclose(place, 1.1 * (small[label] - base) + 1.1 * base, atol=1e-12)
    assert "mass 10.5915 kg -> 10.5915 kg" in lines


def test_masses_keep_their_shares_or_follow_volumes(leg):
    before = {n: i.mass for n, i in leg.robot.inertias().items()}
    trial = static(places(leg, leg.initial.q))
    total = sum(before.values())
    for task, expected in (
        (ScaleTask(whole("shank", 1.2)), before),
        (
            ScaleTask(whole("shank", 1.2), mass=2.0 * total),
            {n: 2.0 * m for n, m in before.items()},
        ),
    ):
        after = scaled(leg, trial, task).robot.inertias()
        assert {n: i.mass for n, i in after.items()} == pytest.approx(expected, rel=1e-12)
    task = ScaleTask(whole("shank", 1.2), by_volume=True)
    after = {n: i.mass for n, i in scaled(leg, trial, task).robot.inertias().items()}
    assert sum(after.values()) == pytest.approx(total, rel=1e-12)
    ratio = after["shank"] / before["shank"] / (after["foot"] / before["foot"])
    assert ratio == pytest.approx(1.2**3, rel=1e-12)


def test_inertia_of_a_box_is_that_of_the_stretched_box():
    """Sides a, b, c about the mass centre: m (b^2 + c^2) / 12, ..; axes turned in the link."""

    def box(m, a, b, c):
        return m / 12.0 * np.diag([b**2 + c**2, a**2 + c**2, a**2 + b**2])

    moments = box(2.0, 0.1, 0.2, 0.3)
    text = (
        "<robot name='r'><link name='a'><inertial><origin xyz='0.1 0.2 0.3' rpy='{rpy}'/>"
        "<mass value='2.0'/><inertia ixx='{0}' iyy='{1}' izz='{2}' ixy='0' ixz='0' iyz='0'/>"
        "</inertial></link></robot>"
    )
    factor = np.array([1.5, 0.8, 1.2])
    straight = ScaledUrdf(text.format(*np.diag(moments), rpy="0 0 0"), {"a": factor}, 3.0, False)
    from xml.etree import ElementTree

    inertial = ElementTree.fromstring(straight.text).find("link/inertial")
    found = [float(inertial.find("inertia").get(key)) for key in ("ixx", "iyy", "izz")]
    expected = np.diag(box(3.0, 0.1 * 1.5, 0.2 * 0.8, 0.3 * 1.2))
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    centre = [float(word) for word in inertial.find("origin").get("xyz").split()]
    np.testing.assert_allclose(centre, factor * [0.1, 0.2, 0.3], rtol=1e-15)
    quarter = f"0 0 {np.pi / 2}"  # its x is the link's y
    turned = ScaledUrdf(text.format(*np.diag(moments), rpy=quarter), {"a": factor}, 3.0, False)
    inertia = ElementTree.fromstring(turned.text).find("link/inertial/inertia")
    found = [float(inertia.get(key)) for key in ("ixx", "iyy", "izz")]
    expected = np.diag(box(3.0, 0.1 * 0.8, 0.2 * 1.5, 0.3 * 1.2))
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_factors_are_measured_and_the_scaled_scene_fits_the_person(leg):
    """A person whose shank is 8 % longer stands still; the model of their size misses nothing."""
    person = scaled(leg, static(places(leg, leg.initial.q)), ScaleTask(whole("shank", 1.08)))
    standing = static(places(person, person.initial.q))
    task = ScaleTask({"shank": (Measurement(pairs=[["shin_front", "shin_side"]]),)})
    lines = []
    found = mbd.Scene.of(scaled(leg, standing, task, lines.append))
    assert "shank: x 1.08, y 1.08, z 1.08" in lines
    fit = found.kinematics(standing, limits=False)
    assert fit["residuals"]["max"].max() < 1e-9
    rough = mbd.Scene.of(leg).kinematics(standing, limits=False)
    assert rough["residuals"]["max"].max() > 1e-3


def test_command_writes_a_scene_or_nothing(leg, tmp_path, capsys):
    trial, task = tmp_path / "static.csv", tmp_path / "task.yaml"
    static(places(leg, leg.initial.q)).to(trial)
    text = "scale:\n  name: tall\n  mass: 12.0\n  segments:\n    shank: {factor: 1.1, axes: z}\n"
    task.write_text(text + "    foot: [{pairs: [[heel, toe]], axes: x}, {factor: 0.9, axes: y}]\n")
    words = ["scale", "marked_leg", str(trial), str(task), "-o", str(tmp_path / "out")]
    assert main(words) == 0
    tall = mbd.load_scene(tmp_path / "out" / "tall.yaml")
    assert sum(i.mass for i in tall.robot.inertias().values()) == pytest.approx(12.0)
    toe = tall.parts["sensors"]["toe"]
    np.testing.assert_allclose(toe.xyz, [0.14, 0.9 * 0.02, -0.04], atol=1e-12)
    assert "shank: x 1, y 1, z 1.1" in capsys.readouterr().out
    task.write_text(task.read_text().replace("tall", "CON"))  # no file of Windows has this name
    assert main(words) == 0
    assert mbd.load_scene(tmp_path / "out" / "_CON.yaml").robot.model.nv == tall.robot.model.nv
    task.write_text("scale:\n  segments:\n    shank: {pairs: [[heel, to]]}\n")
    assert main([*words[:-1], str(tmp_path / "none")]) != 0
    assert "no marker to in the scene; the nearest is toe" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{segments: {}}", "segments: is empty"),
        ("{segments: {shank: {}}}", "expected either pairs or a factor"),
        ("{segments: {shank: {factor: 1.0, axes: w}}}", "accepted: some of x, y and z"),
        ("{segments: {shank: {factor: -1.0}}}", "out of range"),
        ("{segments: {shank: {pairs: [[heel]]}}}", "expected 2"),
        ("{segments: {shank: {factor: 1.0}}, name: a b}", "accepted are letters, digits and _"),
    ],
)
def test_bad_tasks(leg, tmp_path, text, words):
    path = tmp_path / "task.yaml"
    path.write_text(f"scale: {text}")
    with pytest.raises(SceneError, match=words):
        scaled(leg, static(places(leg, leg.initial.q)), path)


def test_bad_measurements(leg):
    found = places(leg, leg.initial.q)
    pairs = {"foot": (Measurement(pairs=[["heel", "toe"]]),)}
    with pytest.raises(DataError, match="no frame 'shnk'"):
        scaled(leg, static(found), ScaleTask(whole("shnk", 1.0)))
    with pytest.raises(DataError, match="foot would be scaled by .*check the unit"):
        scaled(leg, static({n: 10.0 * p for n, p in found.items()}), ScaleTask(pairs))
    unseen = {**found, "toe": np.full(3, np.nan)}
    with pytest.raises(DataError, match="heel and toe are never seen together"):
        scaled(leg, static(unseen), ScaleTask(pairs))


def test_a_model_of_opensim_scales_with_paths_and_muscles(tmp_path):
    """Uniformly by 1.1: places, lengths of paths and of fibres, at bent knees too."""
    source = RECORDINGS / "gait10dof/marker_ik" / "raw" / "subject01.osim.gz"
    model = tmp_path / "subject01.osim"
    with gzip.open(source) as packed, model.open("wb") as plain:
        shutil.copyfileobj(packed, plain)
    scene = mbd.load_scene(model)
    bodies = [link for link, inertia in scene.robot.inertias().items() if inertia.mass]
    task = ScaleTask({link: (Measurement(factor=1.1),) for link in bodies})
    large = scaled(scene, static(places(scene, scene.initial.q)), task)
    q = scene.initial.q.copy()
    for name in ("hip_flexion_r", "knee_angle_r", "knee_angle_l", "lumbar_extension"):
        q[scene.robot.joint(name).q] = -0.4
    k = {}
    for key, each, factor in (("small", scene, 1.0), ("large", large, 1.1)):
        at = q.copy()
        for name in ("pelvis_tx", "pelvis_ty"):
            at[each.robot.joint(name).q] *= factor
        each.couplings.expand(at, np.zeros(len(q)), np.zeros(len(q)))
        k[key] = at
    small, found = places(scene, k["small"]), places(large, k["large"])
    for label in small:
        np.testing.assert_allclose(found[label], 1.1 * small[label], atol=1e-12)
    both = zip(scene.entries["muscles"], large.entries["muscles"], strict=True)
    for before, after in both:
        for key in ("optimal_fiber_length", "tendon_slack_length"):
            assert after[key] / before[key] == pytest.approx(1.1, rel=1e-9)
