"""Compiled runs with contacts from event to event against the plain tier."""

import re
import time

import pytest
from compiled_events import ROBOTS, simulations, table

from mbd_ros.api import load_scene
from mbd_ros.parts.integrators.dop853 import Dop853
from mbd_ros.parts.integrators.dopri5 import Dopri5
from mbd_ros.parts.integrators.rk4 import Rk4
from mbd_ros.scene.from_python import scene_from

SCENES = "package://mbd_ros/config/scenes/"
METHODS = {
    "rk4": Rk4(),
    "dop853": Dop853(),
    "dop853 adaptive": Dop853(tolerance=1e-10),
    "dopri5 adaptive": Dopri5(tolerance=1e-9),
}


def compared(scene, method, dt, duration, near=1e-9):
    """Runs of both: the same events and states near one another; returns the compiled one."""
    compiled, plain = simulations(scene, method, dt)
    rows, wanted = (table(each.run(scene.initial, duration)) for each in (compiled, plain))
    assert [kind(e) for e in compiled.events] == [kind(e) for e in plain.events]
    assert len(plain.events) > 0
    times, those = ([e.t for e in each.events] for each in (compiled, plain))
    assert times == pytest.approx(those, abs=1e-10, rel=0)
    for mine, other in zip(compiled.events, plain.events, strict=True):
        assert mine.impulse == pytest.approx(other.impulse, abs=near)
    assert rows.shape == wanted.shape
    for joint in compiled.system.model.joints:
        if joint.nq == 7:  # a quaternion and its negative are one turn
            at = slice(joint.idx_q + 4, joint.idx_q + 8)
            turned = (rows[:, at] * wanted[:, at]).sum(axis=1) < 0.0
            rows[turned, at] *= -1.0
    assert rows == pytest.approx(wanted, abs=near)
    return compiled


def kind(event):
    """What happened. Directions of slips differ by rounding; so does which point is the first."""
    return {re.sub(r"point_\d", "point", one) for one in event.guards}, [
        way != 0 for way in event.after.mode
    ]


def thrown(restitution=0.5, friction=0.3):
    """A ball with spin that is thrown onto an incline, where it bounces, slides and rolls."""
    plane = {"half_space": [0.0, 0.0, 1.0], "rpy": [0.1, -0.2, 0.0]}
    contact = {"type": "rigid", "between": ["ball", plane], "friction": friction}
    twist = {"linear": [1.0, 0.5, -1.0], "angular": [3.0, -20.0, 5.0]}
    ball = {"shape": {"sphere": 0.1}, "mass": 0.5, "pose": {"xyz": [0.3, 0.2, 0.4]}}
    return scene_from(
        {
            "bodies": {"ball": ball},
            "contacts": [{**contact, "restitution": restitution}],
            "initial": {"twist": {"ball": twist}},
        }
    )


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_a_thrown_ball_bounces_slides_and_rolls_as_in_plain_steps(method):
    compiled = compared(thrown(), method, 0.01, 1.5)
    assert compiled.stepper.handed_over < compiled.steps


def test_a_block_slides_on_four_feet_and_stays_where_it_stops():
    """Three feet of them carry it as well: statics does not say how they share its weight."""
    down = {
        "frame": "block",
        "points": [[x, y, -0.05] for x in (-0.1, 0.1) for y in (-0.05, 0.05)],
    }
    turn = [0.0, -0.3490658503988659, 0.0]
    pose = {"xyz": [-0.017101007166283436, 0.0, 0.04698463103929542], "rpy": turn}
    block = {"shape": {"box": [0.2, 0.1, 0.1]}, "mass": 2.0, "pose": pose}
    plane = {"half_space": [0, 0, 1], "rpy": turn}
    entries = {"contacts": [{"type": "rigid", "between": [down, plane], "friction": 0.5}]}
    entries["initial"] = {"twist": {"block": {"linear": [3.0, 0.0, 0.0]}}}
    compiled = compared(scene_from({"bodies": {"block": block}, **entries}), Rk4(), 0.01, 0.6)
    assert compiled.stepper.handed_over <= 2


THREE = [[0.3, 0.0, 0.0], [-0.2, 0.25, 0.0], [-0.2, -0.25, 0.0]]
FOUR = [[x, y, 0.0] for x in (-0.25, 0.25) for y in (-0.25, 0.25)]
STOOLS = {
    "three": ([THREE], (0.0, 0.0)),
    "four": ([FOUR], (0.0, 0.0)),
    "far": ([THREE], (80.0, -60.0)),
    "two stools": ([THREE, FOUR], (0.0, 0.0)),
}
ONE_NEAR = ("three", "four")  # feet that the others have as well


def stools(feet, at):
    """Stools that fall on all of their feet, bounce, and turn as they slide."""
    bodies, contacts, twists = {}, [], {}
    for i, points in enumerate(feet):
        name, pose = f"stool_{i}", {"xyz": [at[0] + 3.0 * i, at[1], 0.3 + 0.05 * i]}
        bodies[name] = {"shape": {"box": [0.5, 0.5, 0.2]}, "mass": 2.0, "pose": pose}
        between = [{"frame": name, "points": points}, "ground"]
        laws = {"friction": 0.3, "restitution": 0.2}
        contacts.append({"type": "rigid", "between": between, **laws})
        twists[name] = {"linear": [1.5, 0.3, 0.0], "angular": [0.0, 0.0, 3.0]}
    return scene_from({"bodies": bodies, "contacts": contacts, "initial": {"twist": twists}})


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.soak if n in ONE_NEAR else ()) for n in STOOLS],
)
def test_stools_turn_as_they_slide_without_a_plain_step(name):
    compiled = compared(stools(*STOOLS[name]), Rk4(), 0.01, 0.5)
    assert compiled.stepper.plain_steps == 0


@pytest.mark.parametrize(
    "feet", [pytest.param(THREE, marks=pytest.mark.soak), FOUR], ids=["three", "four"]
)
def test_stools_with_an_event_in_every_fifth_step_cost_a_fraction_of_plain_steps(feet):
    """Measured: 6 and 8 times less, warm, the shortest of several."""
    scene, seconds = stools([feet], (0.0, 0.0)), ([], [])
    both = simulations(scene, Rk4(), 0.01)
    for _ in range(12):
        for simulation, times in zip(both, seconds, strict=True):
            begin = time.process_time()
            list(simulation.run(scene.initial, 0.5))
            times.append(time.process_time() - begin)
    assert len(both[0].events) == 10
    assert 4.0 * min(seconds[0]) < min(seconds[1])


def test_a_sphere_begins_to_roll_at_a_third_of_the_cost_of_plain_steps():
    """Measured: 14 times less; a shared machine needs some margin."""
    scene, seconds = load_scene(f"{SCENES}sphere_on_plane.yaml"), ([], [])
    assert compared(scene, Rk4(), 0.01, 1.5).stepper.handed_over <= 2
    both = simulations(scene, Rk4(), 0.01)
    for _ in range(3):
        for simulation, times in zip(both, seconds, strict=True):
            begin = time.process_time()
            list(simulation.run(scene.initial, 1.5))
            times.append(time.process_time() - begin)
    assert 3.0 * min(seconds[0]) < min(seconds[1])


def reaching(friction, height):
    """An arm whose flange falls onto an inclined plane."""
    plane = {"half_space": [0.1, 0.0, 1.0], "xyz": [0.0, 0.0, height]}
    between = [{"frame": "flange", "sphere": 0.05}, plane]
    contact = {"type": "rigid", "between": between, "friction": friction, "restitution": 0.3}
    stiffness, damping = (6, 1, 1, 1, 1, 1, 0.5), (2, 2, 1, 0.5, 0.02, 0.01, 0.0005)
    springs = [
        {"type": "joint_spring", "joint": f"joint{i}", "stiffness": k, "damping": d}
        for i, (k, d) in enumerate(zip(stiffness, damping, strict=True), 1)
    ]
    start = {"joint1": 0.3, "joint2": 0.6, "joint3": 0.5, "joint4": 1.2, "joint6": 0.8}
    entries = {"contacts": [contact], "forces": springs, "initial": {"position": start}}
    return scene_from({"robot": {"urdf": ROBOTS + "arm7.urdf"}, **entries})


def test_an_arm_that_meets_a_rough_plane_bounces_and_sticks_as_in_plain_steps():
    compiled = compared(reaching(3.0, 0.9), Rk4(), 1e-3, 0.3)
    assert compiled.stepper.handed_over < compiled.steps
