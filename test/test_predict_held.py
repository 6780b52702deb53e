"""Contacts that a phase holds in a predicted motion: they push, within their friction cones."""

from functools import cache

import numpy as np
import pytest
import yaml
from prediction_scenes import EFFORT, drives, joint, link, urdf

import mbd_ros as mbd
from mbd_ros.core.state import State
from mbd_ros.errors import NotConvergedError, SceneError, SolveError
from mbd_ros.scene.locate import find_task

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


def test_a_foot_on_several_points_is_refused():
    """Its multipliers are not determined: what points share among them is nobody's equation."""
    scene = standing("1 0 0", points=((0.0, -0.1, 0.0), (0.0, 0.1, 0.0)))
    task = {"duration": 1.0, "end": {"slide.position": 0.1}, "goals": EFFORT}
    with pytest.raises(SceneError, match="sole is held at several points.*accepted: one point"):
        scene.predict(task)


def test_contacts_that_hold_the_same_are_named():
    """Heel and toe: each of them keeps the foot from sliding."""
    scene = standing("1 0 0")
    sole = scene.entries["contacts"][0]
    two = [dict(sole) | {"name": name} for name in ("heel", "toe")]
    phases = {"stance": HOLDS["stance"] | {"contacts": ["heel", "toe"]}}
    task = {"duration": 1.0, "end": {"slide.position": 0.1}, "goals": EFFORT}
    with pytest.raises(SolveError, match="depend on each other.*heel.normal.*toe.normal"):
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
