"""Predicted motions of what wrenches drive, and of what may not move sideways."""

import math

import numpy as np
import pytest
from prediction_scenes import EFFORT, drives, joint, link, urdf

import mbd_ros as mbd
from mbd_ros.errors import SceneError

TURN = math.pi / 2.0


def satellite(**sections):
    """A body of 1 kg and 1 kg m^2 about all axes, in free space."""
    robot = f"<robot name='r'>{link('body', 1.0, inertia=1.0)}</robot>"
    given = {"robot": {"base": "floating", "gravity": [0.0, 0.0, 0.0]}}
    return mbd.scene_from(given | sections, urdf=robot)


def turned(angle):
    """At rest where it was, after a turn about z."""
    pose = {"base.orientation.z": math.sin(angle / 2.0), "base.orientation.w": math.cos(angle / 2)}
    still = {"base.orientation.x": 0.0, "base.orientation.y": 0.0, "*velocity*": 0.0}
    return {**pose, **still, "base.position.*": 0.0}


def test_external_wrenches_with_bounds_drive_a_free_body():
    """Least effort of a turn from rest to rest is 12 angle^2 / T^3; other components are zero."""
    scene = satellite(external_wrenches={"base_residual": {"frame": "body"}})
    task = {"duration": 2.0, "end": turned(TURN), "goals": EFFORT}
    with pytest.raises(SceneError, match="nothing drives.*external_wrenches with bounds"):
        scene.predict(task)
    result = scene.predict(task | {"bounds": {"base_residual.M?": [None, None]}})
    assert result.metadata["cost"] == pytest.approx(12.0 * TURN**2 / 8.0, rel=1.0e-10)
    assert result.metadata["residuals"] == {}
    wrong = {**turned(TURN), "base.orientation.w": 1.0}
    with pytest.raises(
        SceneError, match="base.orientation: a quaternion .* must have norm 1, not 1.22"
    ):
        scene.predict(task | {"bounds": {"base_residual.M?": [None, None]}, "end": wrong})


def test_a_wrench_of_the_scene_is_no_residual_by_its_name():
    """It stays zero beside the wrench that drives the base, which gets another name."""
    scene = satellite(external_wrenches={"base_residual": {"frame": "body"}})
    task = {"duration": 2.0, "end": turned(TURN), "goals": EFFORT, "driven_by": "joints"}
    result = scene.predict(task)
    assert result.metadata["cost"] == pytest.approx(12.0 * TURN**2 / 8.0, rel=1.0e-10)
    with pytest.raises(SceneError, match=r"base_residual_2\.Fx"):
        scene.predict(task | {"bounds": {"wrong": 1.0}})


def sled():
    """A runner that does not slip sideways: a force along it and a torque drive it."""
    robot = urdf(
        link("rail_x", 1.0e-6),
        link("rail_y", 1.0e-6),
        link("sled", 1.0, "0 0 0", 0.1),
        joint("x", "prismatic", "ground", "rail_x", "1 0 0"),
        joint("y", "prismatic", "rail_x", "rail_y", "0 1 0"),
        joint("turn", "continuous", "rail_y", "sled", "0 0 1"),
    )
    runner = {"type": "knife_edge", "frame": "sled", "direction": [0, 1, 0]}
    sections = {"robot": {"gravity": [0, 0, 0]}, "constraints": [runner]}
    sections |= {"actuators": drives("turn"), "external_wrenches": {"drive": {"frame": "sled"}}}
    return mbd.scene_from(sections, urdf=robot)


def test_a_sled_gets_sideways_without_slipping():
    """Rows that no position states: parking 0.5 m to the side, at the same heading."""
    end = {"x.position": 1.0, "y.position": 0.5, "turn.position": 0.0, "*.velocity": 0.0}
    task = {"duration": 2.0, "bounds": {"drive.Fx": [None, None]}, "end": end, "goals": EFFORT}
    result = sled().predict(task)
    assert result.metadata["replay"] < 1.0e-6
    angle, v = result["samples"]["turn.position"], result["samples"]
    aside = v["y.velocity"] * np.cos(angle) - v["x.velocity"] * np.sin(angle)
    np.testing.assert_allclose(aside, 0.0, atol=1.0e-6)


def test_four_rotors_carry_a_body_to_another_place():
    """Each pushes along its axis alone; hovering for as long takes a little less."""
    places = {"front": "0.2 0 0", "left": "0 0.2 0", "back": "-0.2 0 0", "right": "0 -0.2 0"}
    arms = [
        f"<link name='{name}'/>" + joint(f"to_{name}", "fixed", "body", name, "1 0 0", place)
        for name, place in places.items()
    ]
    robot = f"<robot name='r'>{link('body', 1.0, inertia=0.02)}{''.join(arms)}</robot>"
    rotors = {f"{name}_rotor": {"frame": name} for name in places}
    sections = {"robot": {"base": "floating"}, "external_wrenches": rotors}
    end = {
        "base.position.x": 2.0,
        "base.position.y": 1.0,
        "base.position.z": 1.0,
        "*velocity*": 0.0,
    }
    end |= {f"base.orientation.{axis}": 0.0 for axis in "xyz"}
    task = {"duration": 2.0, "bounds": {"*_rotor.Fz": [0.0, 6.0]}, "end": end, "goals": EFFORT}
    result = mbd.scene_from(sections, urdf=robot).predict(task)
    hovering = 2.0 * 9.81**2 / 4.0
    assert hovering < result.metadata["cost"] < 1.1 * hovering
    assert result.metadata["replay"] < 1.0e-6


@pytest.mark.soak
def test_free_bodies_that_go_where_they_like():
    """The springs and bodies of the free flyer move by themselves; straight lines lead nowhere."""
    task = {"duration": 2.0, "end": {"swing.position": 0.0, "twist.position": 0.5}}
    result = mbd.load_scene("free_flyer").predict(task | {"goals": EFFORT})
    assert result.metadata["iterations"] < 50
    assert result.metadata["replay"] < 1.0e-6
