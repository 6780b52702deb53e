"""Contacts that a phase holds in a predicted motion: they push, within their friction cones."""

from functools import cache

import numpy as np
import pytest
import yaml
from prediction_scenes import EFFORT, drives, joint, link, urdf

import mbd_ros as mbd
from mbd_ros.core.state import State
from mbd_ros.errors import NotConvergedError, SceneError
from mbd_ros.scene.schema.locate import find_task

HOLDS = {"stance": {"contacts": ["sole"], "until": {"late": {"time": 10.0}}, "then": "stance"}}
WEIGHT = 3.0 * 9.81


def standing(axis, friction=1.0, points=((0.0, 0.0, 0.0),)):
    """A body of 2 kg that slides on a foot of 1 kg, which is free to move and held."""
    robot = urdf(
        link("rail_x", 0.001),
        link("rail_y", 0.001),
        link("foot", 1.0),
        link("body", 2.0),
        joint("x", "prismatic", "ground", "rail_x", "1 0 0"),
        joint("y", "prismatic", "rail_x", "rail_y", "0 1 0"),
        joint("z", "prismatic", "rail_y", "foot", "0 0 1"),
        joint("slide", "prismatic", "foot", "body", axis),
    )
    between = [
        {"frame": "foot", "points": [list(one) for one in points]},
        {"half_space": [0, 0, 1]},
    ]
    sole = {"name": "sole", "type": "rigid", "between": between, "friction": friction}
    sections = {"contacts": [sole], "phases": HOLDS, "actuators": drives("slide")}
    return mbd.scene_from(sections, urdf=robot)


def on_a_floor(axis):
    """The same body on a foot that cannot move."""
    robot = urdf(link("body", 2.0), joint("slide", "prismatic", "ground", "body", axis))
    return mbd.scene_from({"actuators": drives("slide")}, urdf=robot)


@pytest.mark.parametrize(
    ("axis", "friction", "duration", "force", "named"),
    [
        ("0 0 1", 1.0, 0.35, [-9.81, None], "normal force of sole"),
        ("0.6 0.8 0", 0.3, 0.72, [-0.3 * WEIGHT, 0.3 * WEIGHT], "friction cone of sole"),
    ],
)
def test_a_foot_neither_pulls_nor_slips(axis, friction, duration, force, named):
    """As with a fixed foot and a force that can neither lift it nor push it away."""
    task = {"duration": duration, "goals": EFFORT, "tolerance": 1.0e-4}
    task["end"] = {"slide.position": 0.4, "slide.velocity": 0.0}
    result = standing(axis, friction).predict(task)
    alone = on_a_floor(axis).predict(task | {"bounds": {"slide.effort": force}})
    assert result.metadata["cost"] == pytest.approx(alone.metadata["cost"], rel=1.0e-5)
    assert alone.metadata["active"]
    assert named in [name for name, *_ in result.metadata["active"]]


def test_a_ground_that_is_too_slippery_is_named():
    """The least force that gets there in time is twice what friction holds."""
    task = {"duration": 0.72, "goals": EFFORT}
    task["end"] = {"slide.position": 0.4, "slide.velocity": 0.0}
    with pytest.raises(NotConvergedError, match="blocks: friction cone of sole is at its lower"):
        standing("0.6 0.8 0", 0.1).predict(task)


@pytest.mark.parametrize("across", [(0.0,), (-0.1, 0.1)])
def test_a_foot_on_several_points_is_as_one_on_one_point(across):
    """Where nothing tips it: its points share friction as they like, and no row is said twice."""
    task = {"duration": 0.72, "goals": EFFORT, "tolerance": 1.0e-4}
    task["end"] = {"slide.position": 0.4, "slide.velocity": 0.0}
    one = standing("0.6 0.8 0", 0.3).predict(task)
    points = [(along, y, 0.0) for along in (-0.1, 0.2) for y in across]
    several = standing("0.6 0.8 0", 0.3, points).predict(task)
    assert several.metadata["cost"] == pytest.approx(one.metadata["cost"], rel=1.0e-8)
    assert "friction cone of sole" in [name for name, *_ in several.metadata["active"]]


def leaning(**soles):
    """A body of 10 kg that an ankle holds over a foot with a heel and a toe, in a plane."""
    robot = urdf(
        link("rail", 0.001),
        link("post", 0.001),
        link("foot", 1.0, "0.05 0 0.02", 0.01),
        link("body", 10.0, "0 0 0.8", 1.0),
        joint("x", "prismatic", "ground", "rail", "1 0 0"),
        joint("z", "prismatic", "rail", "post", "0 0 1"),
        joint("pitch", "continuous", "post", "foot", "0 1 0"),
        joint("ankle", "continuous", "foot", "body", "0 1 0", "0 0 0.05"),
    )
    ground = {"half_space": [0, 0, 1]}
    contacts = [
        {"name": name, "type": "rigid", "between": [{"frame": "foot", "points": points}, ground]}
        | {"friction": 0.8}
        for name, points in soles.items()
    ]
    sections = {"contacts": contacts, "actuators": drives("ankle")}
    sections["phases"] = {"stance": HOLDS["stance"] | {"contacts": list(soles)}}
    return mbd.scene_from(sections | {"initial": {"position": {"ankle": -0.1}}}, urdf=robot)


def test_a_foot_does_not_tip():
    """One contact with its centre of pressure, and two that push, whose friction is shared."""
    heel, toe = [[-0.1, 0.0, 0.0]], [[0.2, 0.0, 0.0]]
    task = {"duration": 1.0, "goals": EFFORT, "tolerance": 1.0e-5}
    task["end"] = {"ankle.position": 0.1, "ankle.velocity": 0.0}
    flat, two = (
        one.predict(task) for one in (leaning(sole=heel + toe), leaning(heel=heel, toe=toe))
    )
    assert flat.metadata["cost"] == pytest.approx(two.metadata["cost"], rel=1.0e-8)
    assert flat.metadata["active"][0][0] == "centre of pressure of sole"
    assert {name for name, *_ in two.metadata["active"]} == {
        "normal force of heel",
        "normal force of toe",
    }


def landing(*, turns):
    """A body on a spring-less leg falls on a flat foot, which may turn or not."""
    turning = joint("pitch", "continuous" if turns else "fixed", "post", "foot", "0 1 0")
    robot = urdf(
        link("rail", 0.001),
        link("post", 0.001),
        link("foot", 1.0, "0 0 0.02", 0.01),
        link("body", 2.0, "0.01 0 0", 0.01),
        joint("x", "prismatic", "ground", "rail", "1 0 0"),
        joint("z", "prismatic", "rail", "post", "0 0 1"),
        turning,
        joint("leg", "prismatic", "foot", "body", "0.1 0 1", "0 0 0.3"),
    )
    points = [[-0.1, 0.0, 0.0], [0.15, 0.0, 0.0]] if turns else [[0.0, 0.0, 0.0]]
    between = [{"frame": "foot" if turns else "post", "points": points}, {"half_space": [0, 0, 1]}]
    sole = {"name": "sole", "type": "rigid", "between": between, "friction": 0.8}
    flight = {"contacts": [], "until": {"down": {"touch_down": "sole"}}, "then": "stance"}
    stance = {"contacts": ["sole"], "until": {"late": {"time": 9.0}}, "then": "flight"}
    sections = {"contacts": [sole], "phases": {"flight": flight, "stance": stance}}
    sections |= {"actuators": drives("leg"), "initial": {"position": {"z": 0.1}}}
    return mbd.scene_from(sections, urdf=robot)


def test_a_flat_foot_strikes():
    """The impact at heel and toe is that of a foot that cannot turn, on one point."""
    free = {"phase": "flight", "duration": [0.05, 0.5], "bounds": {"leg.effort": 0.0}}
    held = {"phase": "stance", "duration": 0.4, "end": {"leg.position": 0.0, "leg.velocity": 0.0}}
    task = {"phases": [free, held], "goals": EFFORT, "mesh": {"intervals": 3}}
    flat, point = (landing(turns=turns).predict(task).metadata for turns in (True, False))
    assert flat["cost"] == pytest.approx(point["cost"], rel=1.0e-8)
    assert flat["duration"][0] == pytest.approx(np.sqrt(2.0 * 0.1 / 9.81), rel=1.0e-8)


def test_contacts_that_hold_the_same_are_named():
    """Heel and toe of a foot that cannot turn: which of them carries the load is open."""
    scene = standing("1 0 0")
    sole = scene.entries["contacts"][0]
    two = [dict(sole) | {"name": name} for name in ("heel", "toe")]
    phases = {"stance": HOLDS["stance"] | {"contacts": ["heel", "toe"]}}
    task = {"duration": 1.0, "end": {"slide.position": 0.1}, "goals": EFFORT}
    with pytest.raises(SceneError, match="heel constrain the same motion.*use one contact"):
        scene.with_(contacts=two, phases=phases).predict(task)


SPRING, REST = 800.0, 0.5  # N/m, m


@pytest.mark.parametrize(
    ("axis", "guard", "start", "stretched", "within"),
    [
        ("0 0 1", "lift_off", (0.3, 0.0), 9.81 / SPRING, [0.05, 0.15]),
        ("0.6 0.8 0", "slip", (0.5, 1.0), 0.5 * WEIGHT / SPRING, [0.01, 0.05]),
    ],
)
def test_a_force_ends_a_phase(axis, guard, start, stretched, within):
    """A spring swings, without effort, until it lifts its foot or pulls it away."""
    scene, free = standing(axis, 0.5), {"contacts": [], "then": "free"}
    held = {"contacts": ["sole"], "until": {"off": {guard: "sole"}}, "then": "free"}
    spring = {"type": "joint_spring", "joint": "slide", "stiffness": SPRING, "rest": REST}
    scene = scene.with_(
        phases={"held": held, "free": free | {"until": {"late": {"time": 9.0}}}}, forces=[spring]
    )
    names = ("slide.position", "slide.velocity")
    task = {"start": dict(zip(names, start, strict=True)), "goals": EFFORT}
    phases = [{"phase": "held", "duration": within}, {"phase": "free", "duration": 0.1}]
    task |= {"phases": phases, "mesh": {"intervals": 4}}
    result = scene.predict(task | {"guess": {"slide.position": [start[0], 0.5, 0.5]}})
    rate, middle = np.sqrt(SPRING / 2.0), REST - (guard == "lift_off") * 2.0 * 9.81 / SPRING
    swing, phase = np.hypot(start[0] - middle, start[1] / rate), np.arctan2
    begin = phase(start[1] / rate, start[0] - middle)  # x - middle = swing cos(begin - rate t)
    taken = (begin - np.arccos((REST + stretched - middle) / swing)) % (2.0 * np.pi) / rate
    assert result.metadata["duration"][0] == pytest.approx(taken, abs=1.0e-6)


# ---------------------------------------------------------------------- a step of five links


def rougher(friction):
    """The biped on another ground."""
    scene = mbd.load_scene("five_link_biped")
    soles = [dict(one) | {"friction": friction} for one in scene.entries["contacts"]]
    return scene.with_(contacts=soles)


def step_task():
    task = yaml.safe_load(find_task("biped_step").read_text())["predict"]
    return task | {"tolerance": 1.0e-4}


@cache
def on_ice():
    """Its step on a ground with a friction of 0.25; freely it uses 0.355."""
    return rougher(0.25).predict(step_task())


def test_a_step_stays_in_the_cone_between_nodes_too():
    samples, metadata = on_ice()["samples"], on_ice().metadata
    share = np.abs(samples["left_sole.friction_x"]) / samples["left_sole.normal"]
    assert share.max() == pytest.approx(0.25, abs=1.0e-3)
    assert metadata["cost"] == pytest.approx(622.188, rel=1.0e-4)
    assert metadata["replay"] < 1.0e-5
    assert "friction cone of left_sole forwards" in [name for name, *_ in metadata["active"]]


def test_its_impact_is_one_that_the_simulator_accepts():
    """Whose check of impulses knows nothing of the program."""
    scene, samples = rougher(0.25), on_ice()["samples"]
    joints, phased = scene.robot.joints, scene.phased_system()
    q, v = np.zeros(scene.robot.model.nq), np.zeros(scene.robot.model.nv)
    for one in joints:
        q[one.q], v[one.v] = (samples[f"{one.name}.{key}"][-1] for key in ("position", "velocity"))
    struck = phased.phases[0].exits[0].reset.after(State(0.7, q, v))
    begin = [samples[f"{one.name}.velocity"][0] for one in joints]
    np.testing.assert_allclose(struck.x.v[[one.v for one in joints]], begin, atol=1.0e-6)


def test_a_share_of_friction_is_kept_and_conditions_may_say_the_same_twice():
    """The height of the foot at the start follows from the strike."""
    task = step_task() | {"grip": 0.5}
    task["start"] = task["start"] | {"left_foot.position.z": 0.0}
    found = rougher(0.5).predict(task).metadata
    assert found["cost"] == pytest.approx(on_ice().metadata["cost"], rel=1.0e-6)


def test_a_bound_of_a_force_is_kept_between_nodes_and_named():
    task = step_task()
    task["bounds"] = task["bounds"] | {"left_sole.normal": [190.0, None]}
    result = rougher(0.8).predict(task)
    assert result["samples"]["left_sole.normal"].min() == pytest.approx(190.0, abs=0.1)
    assert "left_sole.normal" in [name for name, *_ in result.metadata["active"]]
