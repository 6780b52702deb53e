"""Scenes with other numbers: the same as scenes built anew, in milliseconds."""

import time

import numpy as np
import pytest
from places import ROOT

import mbd_ros as mbd
from mbd_ros.api import load_scene, scene_from
from mbd_ros.core.loads.inputs import Sampled
from mbd_ros.core.model import robot_reader
from mbd_ros.errors import SceneError
from mbd_ros.scene.reading import robot_entry

ENTRIES = {
    "couplings": {"knee_slide_x": {"parent": "knee", "factor": 0.01}},
    "external_wrenches": {"foot": {"frame": "foot", "threshold": 20.0}},
    "forces": [
        {"type": "joint_spring", "joint": "ankle", "stiffness": 30.0, "damping": 0.5},
        {"type": "point_spring", "frame_a": "world", "frame_b": "foot", "stiffness": 200.0},
        {"type": "applied_wrench", "frame": "foot", "force": [10.0, 0.0, 50.0], "name": "push"},
    ],
    "constraints": [{"type": "joint_stop", "joint": "knee", "lower": -1.5, "time_constant": 0.02}],
    "actuators": [
        {"type": "geared_motor", "joint": "knee", "ratio": 50.0, "rotor_inertia": 1.0e-5},
        {"type": "ideal", "joints": ["ankle"]},
    ],
    "integrator": {"type": "dopri5", "tolerance": 1.0e-6},
    "initial": {"position": {"knee": 0.3}},
}
NUMBERS = {
    "ankle_joint_spring.stiffness": 12.5,
    "ankle_joint_spring.rest": 0.1,
    "foot_point_spring.length": 0.2,
    "push.force": [1.0, 2.0, 3.0],
    "knee_joint_stop.lower": -1.2,
    "knee_geared_motor.rotor_inertia": 3.0e-5,
    "ankle_ideal.limit": 80.0,
    "knee_slide_x.factor": 0.02,
    "foot.threshold": 5.0,
    "integrator.tolerance": 1.0e-8,
    "initial.position.knee": 0.7,
}


@pytest.fixture(scope="module")
def leg():
    return scene_from(ENTRIES, urdf="prosthetic_leg")


def pushed(scene):
    """A simulation under inputs beyond what the drives can give."""
    channels = {part.name: len(part.inputs) for part in scene.actuators}
    sources = {
        name: Sampled(lambda t, n=n: np.full(n, 90.0 + t), 1.0e-3) for name, n in channels.items()
    }
    sources["foot"] = Sampled(lambda t: np.array([0.0, 0.0, 10.0, 0.0, 0.0, 0.0]), 1.0)
    return scene.simulation(sources=sources)


def seen(scene):
    """Everything of a scene that a number can change, as bits and words."""
    motion = pushed(scene).run(scene.initial, 0.005)
    return {
        "motion": b"".join(x.q.tobytes() + x.v.tobytes() for x in motion),
        "armature": scene.robot.model.armature.tobytes(),
        "inputs": scene.inputs,
        "limits": [part.limits().tolist() for part in scene.actuators],
        "names": [part.name for part in (*scene.forces, *scene.constraints, *scene.actuators)],
        "entries": scene.entries,
    }


@pytest.mark.parametrize("key", [*NUMBERS, "all"])
def test_other_numbers_are_those_of_a_scene_built_anew(leg, key):
    numbers = NUMBERS if key == "all" else {key: NUMBERS[key]}
    before, changed = seen(leg), leg.with_(numbers)
    anew, found = scene_from(changed.entries), seen(changed)
    assert found == seen(anew)
    assert found["entries"] != before["entries"] == leg.entries
    assert seen(leg) == before


def test_only_what_changes_is_built_again(leg, monkeypatch):
    monkeypatch.setattr(robot_entry, "read_robots", None)
    monkeypatch.setattr(robot_reader, "read_model_source", None)
    softer = leg.with_({"ankle_joint_spring.stiffness": 3.0})
    assert softer.forces[0] is not leg.forces[0]
    assert softer.forces[1:] == leg.forces[1:] and softer.constraints == leg.constraints
    weaker = leg.with_({"knee_geared_motor.limit": 3.0})
    assert weaker.forces == leg.forces and weaker.couplings is leg.couplings
    lighter = leg.with_({"knee_geared_motor.rotor_inertia": 0.0})
    assert lighter.actuators[1] is leg.actuators[1]
    assert lighter.forces[0] is not leg.forces[0]  # was built on the robot with the heavier drive


@pytest.mark.parametrize(
    ("key", "share"), [("ankle_joint_spring.stiffness", 0.5), ("knee_geared_motor.ratio", 1.5)]
)
def test_a_number_costs_a_share_of_building_the_scene(leg, key, share):
    """Of processor time, by turns; another rotor inertia at the joint builds every part again."""
    ours, whole = [], []
    for i in range(10):
        begin = time.process_time()
        leg.with_({key: 10.0 + i})
        between = time.process_time()
        scene_from(ENTRIES, urdf="prosthetic_leg")
        ours.append(between - begin)
        whole.append(time.process_time() - between)
    assert min(ours) < share * min(whole), (min(ours), min(whole))


def test_numbers_hold_beside_new_sections_and_before_them():
    leg = mbd.load_scene("prosthetic_leg")
    spring = {"type": "joint_spring", "joint": "knee", "stiffness": 30.0}
    scene = leg.with_({"knee_joint_spring.stiffness": np.float64(4.0)}, forces=[spring], dt=2e-3)
    assert isinstance(scene, mbd.Scene) and scene.dt == 2e-3
    assert scene.entries["forces"] == [{**spring, "stiffness": 4.0}]
    assert scene.with_({"initial.position.hip_flexion": 1}).initial.q[0] == 1.0
    assert leg.with_({}).entries == leg.entries


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ({"ankle_joint_spring": 1.0}, "expected <name>.<argument>, got 'ankle_joint_spring'"),
        ({"ankle_joint_spring.": 1.0}, "expected <name>.<argument>, got 'ankle_joint_spring.'"),
        ({3: 1.0}, "expected <name>.<argument>, got 3"),
        (
            {"ancle_joint_spring.rest": 1.0},
            "rest: nothing is called 'ancle_joint_spring'; there a",
        ),
        (
            {"ankle_joint_spring.stif": 1.0},
            "forces[0]: unknown key 'stif', accepted: joint, stiff",
        ),
        (
            {"ankle_joint_spring.stiffness": -1},
            "forces[0].stiffness: -1 is out of range, accepted",
        ),
        ({"ankle_joint_spring.stiffness": np.nan}, "stiffness: nan is not a finite number"),
        ({"ankle_joint_spring.joint": "knee"}, "joint: expected a number, got 'knee'"),
        ({"ankle_joint_spring.joint": 3}, "forces[0].joint: expected a word, got 3"),
        (
            {"ankle_joint_spring.rest": True},
            "ankle_joint_spring.rest: expected a number, got True",
        ),
        ({"ankle_joint_spring.rest.a": 1}, "forces[0].rest: expected a number, got {'a': 1}"),
        ({"push.force": [1.0]}, "forces[2].force: expected 3 numbers, got [1.0]"),
        ({"push.name": 1.0}, "forces[2].name: expected a name of up to 255 letters"),
        ({"knee_slide_x.factor": 0.0}, "factor is 0: the joint never moves"),
        ({"dt.length": 1.0}, "dt: expected a number, got {'length': 1.0}"),
    ],
)
def test_a_mistake_is_named(leg, numbers, message):
    with pytest.raises(SceneError) as caught:
        leg.with_(numbers)
    assert message in str(caught.value)


def test_parts_that_no_entry_made_have_no_numbers(leg):
    held = leg.holding(forces=(*leg.forces, leg.forces[0]))
    with pytest.raises(SceneError, match="nothing is called 'ankle_joint_spring'"):
        held.with_({"ankle_joint_spring.stiffness": 1.0})


def test_a_changed_file_keeps_its_folder():
    leg = load_scene(ROOT / "config/scenes/prosthetic_leg.yaml")
    assert leg.with_({"initial.position.knee": 0.1}).name == f"{leg.path} (changed)"


def test_inertias_of_links_are_numbers_of_a_scene():
    """About the mass centre, in the axes of the link; moments follow the mass unless given."""
    scene = load_scene("prosthetic_leg")
    before = scene.robot.inertias()["shank"]
    moments = [0.03, 0.0, 0.001, 0.03, 0.0, 0.005]
    changed = scene.with_({"shank.mass": 2.0 * before.mass, "shank.com": [0.0, 0.01, -0.2]})
    after = changed.robot.inertias()["shank"]
    assert after.mass == pytest.approx(2.0 * before.mass)
    assert after.lever == pytest.approx([0.0, 0.01, -0.2])
    assert after.inertia == pytest.approx(2.0 * before.inertia)
    given = changed.with_({"shank.inertia": moments}).robot.inertias()["shank"].inertia
    assert given[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]] == pytest.approx(moments)
    with pytest.raises(SceneError, match="nothing is called 'shnak'; there are shank"):
        scene.with_({"shnak.mass": 1.0})
