"""Inverse dynamics of motions with contacts whose forces are known."""

import numpy as np
import pytest
from mechanisms import joint, link, urdf

import mbd_ros as mbd
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.errors import DataError
from mbd_ros.files.table import Column, Result, Table

G, MASS = 9.81, 2.5
MOTOR = urdf(
    *(link("world"), link("a"), link("b"), link("bob", MASS)),
    joint("x", "prismatic", "world", "a", (1, 0, 0)),
    joint("y", "prismatic", "a", "b", (0, 1, 0)),
    joint("z", "prismatic", "b", "bob", (0, 0, 1)),
)
BALL = {"shape": {"sphere": 0.1}, "mass": 2.0}
THROWN = {
    "pose": {"ball": {"xyz": [0.0, 0.0, 0.3]}},
    "twist": {"ball": {"linear": [4.0, 1.0, 0.0], "angular": [0.0, 0.0, 3.0]}},
}


def thrown(slope=0.1, away=(0.0, 0.0, 0.0), **more):
    """A ball that falls onto a slope."""
    plane = {"half_space": [slope, 0.0, 1.0], "xyz": list(away)}
    entry = {"type": "rigid", "between": ["ball", plane], "friction": 0.3}
    place = [away[0], away[1], away[2] + 0.3]
    start = {**THROWN, "pose": {"ball": {"xyz": place}}}
    bodies = {"bodies": {"ball": BALL}, "contacts": [entry], "initial": start}
    return mbd.scene_from(bodies | {"dt": 0.01} | more)


def without_contacts(result, dropped=lambda name: "_contact." in name):
    """The motion alone."""
    columns = [one for one in result["samples"].columns if not dropped(one.name)]
    return Result({"samples": Table(columns)})


def residual(result, body="ball"):
    """Force and moment that nothing carries, shape (n, 6)."""
    words = [f"{kind}_{axis}" for kind in ("force", "torque") for axis in "xyz"]
    return np.column_stack([result["samples"][f"{body}.residual.{word}"] for word in words])


@pytest.mark.parametrize("method", ["dopri5", "moreau_jean"])
@pytest.mark.parametrize("away", [(0.0, 0.0, 0.0), (100.0, -50.0, 20.0)])
def test_nothing_is_left_of_a_free_body(method, away):
    scene = thrown(away=away, integrator={"type": method})
    result = scene.simulate(0.3)
    assert np.ptp(result["samples"]["ball_contact.normal"]) > 15.0  # it flies, and it slides
    for options in ({}, {"bounds": True}):
        found = scene.inverse(result, **options)
        assert np.abs(residual(found)).max() <= 1e-9
        assert not any("not known" in text for text in found.metadata["remarks"])


def test_the_residual_of_unknown_contacts_is_their_force():
    """In closed form: the ball slides on a level plane, mu of its weight against its way."""
    scene = thrown(slope=0.0, initial={**THROWN, "pose": {"ball": {"xyz": [0.0, 0.0, 0.1]}}})
    result = scene.simulate(0.2)
    found = scene.inverse(without_contacts(result))
    (remark,) = found.metadata["remarks"]
    assert remark.startswith(
        "warning: the result: no column ball_contact.normal, ball_contact.friction_x, "
        "ball_contact.friction_y: the forces of contact ball_contact are not known"
    )
    left = residual(found)
    assert np.linalg.norm(left[:, :3], axis=1) == pytest.approx(2.0 * G * np.hypot(1.0, 0.3))
    assert np.linalg.norm(left[:, 3:], axis=1) == pytest.approx(0.1 * 0.3 * 2.0 * G)


def test_measured_wrenches_stand_for_contacts():
    """A force plate below the ball: the wrench about the origin of the world, in its axes."""
    plate = {"plate": {"frame": "ball", "expressed_in": "world"}}
    start = {**THROWN, "pose": {"ball": {"xyz": [0.0, 0.0, 0.1]}}}
    scene = thrown(slope=0.0, initial=start)
    result = scene.simulate(0.2)
    table = result["samples"]
    measured = [table.column("time")]
    for kind, named in (("force", "force"), ("torque", "torque"), ("point", "centre_of_pressure")):
        measured += [
            Column(f"plate.{kind}.{axis}", table[f"ball_contact.{named}_{axis}"]) for axis in "xyz"
        ]
    alone = scene.with_(external_wrenches=plate)
    given = Result({"samples": Table(measured)})
    found = alone.inverse(without_contacts(result), wrenches=given)
    assert np.abs(residual(found)).max() <= 1e-9
    assert "the loads plate act" in found.metadata["remarks"][0]


def test_a_motor_does_what_it_did_beside_a_contact():
    """Efforts of a run come back: the contact is no part of them."""
    entry = {"type": "rigid", "between": [{"frame": "bob", "sphere": 0.05}, "ground"]}
    sections = {
        "actuators": [{"type": "ideal", "joints": list("xyz")}],
        "contacts": [entry | {"friction": 0.4}],
        "initial": {"position": {"z": 0.06}},
        "dt": 0.01,
    }
    scene = mbd.scene_from(sections, urdf=MOTOR)
    times = np.linspace(0.0, 0.5, 51)
    push = np.column_stack((14.0 * np.sin(25.0 * times), 3.0 * times, -2.0 * times))
    columns = [Column(f"{name}.effort", u) for name, u in zip("xyz", push.T, strict=True)]
    efforts = Result({"samples": Table([Column("time", times), *columns])})
    result = scene.simulate(0.5, efforts=efforts)
    assert len(set(result["samples"]["bob_contact.state"])) == 3
    found, alone = scene.inverse(result), scene.inverse(without_contacts(result))
    for name in "xyz":
        given = result["samples"][f"{name}.effort"]
        assert found["samples"][f"{name}.effort"] == pytest.approx(given, abs=1e-9)
    normal = alone["samples"]["z.effort"] - result["samples"]["z.effort"]
    assert normal == pytest.approx(result["samples"]["bob_contact.normal"], abs=1e-9)


def test_a_mechanism_with_a_loop_stands_on_a_known_contact():
    """A passive four-bar leg falls onto a floor: none of its joints needs an effort."""
    leg = mbd.load_scene("four_bar_leg")
    k = Kinematics(leg.robot)
    k.refresh(leg.initial.q, leg.initial.v, Reads.POSITION)
    shank = k.position(leg.robot.point("shank")) + leg.robot.origin
    floor = {"half_space": [0.0, 0.0, 1.0], "xyz": [0.0, 0.0, float(shank[2] - 0.03)]}
    entry = {"type": "rigid", "between": [{"frame": "shank", "sphere": 0.02}, floor]}
    scene = leg.with_(contacts=[entry | {"friction": 0.5}], forces=[])
    result = scene.simulate(0.2, integrator="rk4", dt=0.005)
    assert result["samples"]["shank_contact.state"][-1] == 2.0
    for given, least in ((result, 0.0), (without_contacts(result), 1.0)):
        found = scene.inverse(given)["samples"]
        efforts = [np.abs(found[name]).max() for name in found if name.endswith(".effort")]
        assert len(efforts) == 5 and least <= max(efforts) <= (100.0 if least else 1e-9)


def test_a_contact_is_known_as_a_whole_or_not_at_all():
    result = thrown().simulate(0.05)
    given = without_contacts(result, lambda name: name == "ball_contact.friction_y")
    with pytest.raises(DataError, match=r"the result: no column ball_contact.friction_y, or it"):
        thrown().inverse(given)


def test_bristles_are_known_by_their_forces():
    """A ball with bristles: with columns nothing is left of it, without they are named."""
    entry = {"type": "compliant", "between": ["ball", "ground"], "friction": 0.3}
    entry |= {"stiffness": 1e4, "dissipation": 50.0}
    bristles = {"bristle_stiffness": 1e4, "bristle_damping": 30.0}
    for kind in ({"creep": 0.02}, bristles):
        scene = thrown(slope=0.0, contacts=[entry | kind], dt=1e-3, integrator={"type": "rk4"})
        result = scene.simulate(0.3)
        assert np.abs(residual(scene.inverse(result))).max() <= 1e-9
        assert 1.0 in result["samples"]["ball_contact.state"]
    alone = without_contacts(result)
    with pytest.raises(
        DataError, match=r"no column ball_contact.normal, .*friction_y: contact ba"
    ):
        scene.inverse(alone)


def test_a_bag_carries_the_forces_of_contacts_beside_its_motion(tmp_path):
    """A ball at rest on its slope: nothing is left of it; without the topic its weight is."""
    start = {"pose": {"ball": {"xyz": [0.0, 0.0, 0.1]}}}
    scene = thrown(slope=0.0, initial=start)
    result = scene.simulate(0.5)
    result.to(tmp_path / "rest.mcap")
    found = scene.inverse(tmp_path / "rest.mcap", derivatives="zero-phase")
    assert np.abs(residual(found)).max() <= 1e-9
    assert not any("not known" in text for text in found.metadata["remarks"])
    result.metadata["topics"].pop("/constraint_forces")
    result.to(tmp_path / "motion.mcap")
    found = scene.inverse(tmp_path / "motion.mcap", derivatives="zero-phase")
    assert residual(found)[:, 2] == pytest.approx(2.0 * G, rel=1e-9)
    assert any("not known" in text for text in found.metadata["remarks"])
