"""`mbd-ros predict` on mechanisms whose best motions are known."""

import re
import signal
import subprocess
import sys

import numpy as np
import pytest
from prediction_scenes import (
    PROBLEMS,
    SWING_UP,
    SWING_UP_COST,
    bryson_denham,
    cart_pole,
    coupled_arm,
    four_bar,
    joint,
    link,
    mass,
    rest_to_rest,
)

import mbd_ros as mbd
from mbd_ros.cli import main
from mbd_ros.errors import FAILED, OK, NotConvergedError, SceneError
from mbd_ros.files.table import read_result


@pytest.mark.parametrize("scheme", ["gauss", "radau", "hermite_simpson"])
def test_the_cart_pole_swings_up(scheme):
    """The published minimum, from the published guess, on meshes that it chooses by itself."""
    tolerance = 1.0e-4 if scheme == "hermite_simpson" else 1.0e-7
    mesh = {"scheme": scheme, "intervals": 10}
    result = cart_pole().predict(SWING_UP | {"mesh": mesh, "tolerance": tolerance})
    accepted = 1.0e-4 if scheme == "hermite_simpson" else 1.0e-8
    assert result.metadata["cost"] == pytest.approx(SWING_UP_COST, rel=accepted)
    assert result.metadata["replay"] < 10.0 * tolerance
    peak = np.abs(result["samples"]["slide.effort"]).max()
    assert peak == pytest.approx(13.9839012, rel=1.0e-3)


@pytest.mark.parametrize("name", PROBLEMS)
def test_costs_are_those_of_other_methods(name):
    """At the default tolerance, on the mesh that follows from it; and the inputs lead there."""
    make, accepted = PROBLEMS[name]
    scene, task, cost = make()
    result = scene.predict(task)
    found = result.metadata
    assert found["converged"]
    assert np.abs(result["samples"]["drift.position"]).max() < 1.0e-6  # loops between nodes
    assert found["cost"] == pytest.approx(cost, rel=accepted)
    assert found["error"] < 1.0e-7
    assert found["replay"] < 10.0 * max(found["error"], 1.0e-9)


def test_costates_are_those_of_pontryagin():
    """Of the cart-pole, as multiple shooting gives them: d cost / d state."""
    nodes = cart_pole().predict(SWING_UP)["nodes"]
    first = [3.61895527897, -52.0012190071, 4.85047652753, 4.28990481636]
    last = [3.61895527897, -15.5505222141, -2.3874340304, 3.05838356779]
    names = [
        f"{n}.{kind}.costate" for kind in ("position", "velocity") for n in ("slide", "swing")
    ]
    found = np.array([nodes[name][[0, -1]] for name in names]).T
    np.testing.assert_allclose(found, [first, last], rtol=1.0e-7)


def test_multipliers_of_a_coupling_are_those_of_newton():
    """Both ways of keeping it, at times of the reference; the range is 22.5."""
    for solver in (None, {"type": "kkt"}):
        scene, task, _ = coupled_arm(solver)
        samples = scene.predict(task)["samples"]
        np.testing.assert_allclose(samples["q1.multiplier"][[0, 12]], MULTIPLIERS, atol=2.0e-5)


MULTIPLIERS = [0.344488066213, 0.540692902044]


def test_a_stop_is_kept_open_between_points():
    """As Bryson and Denham's limit of a position; its cost is 4."""
    stop = {"type": "joint_stop", "joint": "slide", "upper": 1.0 / 9.0}
    scene, task, cost = bryson_denham()
    task = {key: task[key] for key in task if key != "bounds"}
    result = scene.with_(constraints=[stop]).predict(task)
    assert result.metadata["cost"] == pytest.approx(cost, rel=1.0e-8)
    assert result["samples"]["slide.position"].max() < 1.0 / 9.0 + 1.0e-7


REACH = {  # of the prosthetic arm: limits of five velocities act along arcs
    "duration": 1.0,
    "end": {"shoulder_flexion.position": 0.8, "*.velocity": 0.0},
    "goals": [{"type": "effort", "weight": 1.0}],
}


def test_limits_that_act_along_arcs_are_kept():
    """The cost is that of 175 intervals, which are four times as many as errors ask for."""
    found = mbd.load_scene("prosthetic_arm").predict(REACH).metadata
    assert found["cost"] == pytest.approx(20.96640882, rel=1.0e-8)
    assert found["iterations"] < 200
    assert found["passed"] < 1.0e-5
    assert found["replay"] < 1.0e-7


def test_a_bound_that_is_passed_between_nodes_is_named():
    """By how much, when, and what is accepted; errors alone would be small enough."""
    task = REACH | {"tolerance": 1.0e-6, "mesh": {"refinements": 2}}
    with pytest.raises(NotConvergedError) as caught:
        mbd.load_scene("prosthetic_arm").predict(task)
    said, metadata = str(caught.value), caught.value.result.metadata
    assert metadata["error"] < 1.0e-6 < metadata["passed"]
    assert re.match(r"\S+\.velocity passes its (upper|lower) bound \S+ by \S+ between nodes", said)
    assert "at t = 0." in said
    assert "3e-08 is accepted" in said
    assert "error between nodes" not in said


def test_forces_that_jump_are_refused():
    friction = {"type": "dry_friction", "joint": "slide", "limit": 1.0}
    scene, task, _ = rest_to_rest()
    with pytest.raises(SceneError, match="slide_dry_friction"):
        scene.with_(constraints=[friction]).predict(task)


def test_a_number_of_the_scene_is_found():
    """A spring that swings from side to side without any force: pi^2 per kg and s^2."""
    spring = {"type": "joint_spring", "name": "spring", "joint": "slide", "stiffness": 1.0}
    task = {
        "duration": 1.0,
        "start": {"slide.position": 0.5},
        "end": {"slide.position": -0.5, "slide.velocity": 0.0},
        "goals": [{"type": "effort"}],
        "parameters": {"spring.stiffness": [1.0, 30.0]},
    }
    found = mass().with_(forces=[spring]).predict(task).metadata
    assert found["parameters"]["spring.stiffness"] == pytest.approx(np.pi**2, rel=1.0e-6)
    assert found["replay"] < 1.0e-8


def test_a_motion_that_repeats_and_a_function_of_ones_own():
    """A constant force against a spring without a spring: (x - 1)^2 wants x = 1, at no cost."""
    goals = [{"type": "effort"}, lambda q: (q["slide.position"] - 1.0) ** 2]
    result = mass().predict({"duration": 1.0, "periodic": ["slide.velocity"], "goals": goals})
    assert result.metadata["cost"] == pytest.approx(0.0, abs=1.0e-12)
    assert result["samples"]["slide.position"][0] == pytest.approx(1.0, abs=1.0e-6)


def test_what_if(tmp_path):
    """Heavier poles, each from the motion before; then from its file, and from other guesses."""
    scene, out = cart_pole(), tmp_path / "motion.npz"
    masses = {"pole.mass": [0.3, 0.35, 0.4]}
    rough = SWING_UP | {"tolerance": 1.0e-4}
    result = scene.predict(rough | {"continuation": masses})
    costs = result["continuation"]["cost"]
    assert np.all(np.diff(costs) > 3.0)
    result.to(out)
    heavy = scene.with_({"pole.mass": 0.4})
    again = heavy.predict(rough | {"guess": str(out)}).metadata
    assert again["cost"] == pytest.approx(costs[-1], rel=1.0e-5)
    assert heavy.predict(rough | {"starts": 2}).metadata["cost"] <= costs[-1] * (1.0 + 1.0e-5)


def test_goals_of_every_kind():
    """They add up to the cost, and the tracked motion is found again."""
    task = {"duration": [0.5, 2.0], "end": {"slide.position": 1.0, "slide.velocity": 0.0}}
    goals = [
        {"type": "time"},
        {"type": "smoothness", "weight": 1.0e-3},
        {"type": "power", "weight": 0.01},
        {"type": "torque", "weight": 1.0e-3},
        {"type": "final", "of": "slide.position", "target": 2.0},
        {"type": "speed", "of": "slide.position", "target": 0.7},
        {"type": "integral", "of": {"slide.velocity": 0.1}, "power": 2},
    ]
    result = mass().predict(task | {"goals": goals})
    assert result["goals"]["value"].sum() == pytest.approx(result.metadata["cost"], rel=1.0e-9)


def test_a_recorded_motion_is_tracked(tmp_path):
    scene, task, _ = rest_to_rest()
    recorded = scene.predict(task)
    recorded.to(tmp_path / "recorded.npz")
    goal = {"type": "tracking", "of": "slide.position", "weight": 1.0e4}
    goals = [goal | {"file": str(tmp_path / "recorded.npz")}, {"type": "effort", "weight": 1.0e-9}]
    found = scene.predict({"duration": 1.0, "goals": goals, "tolerance": 1.0e-5})
    key = "slide.position"
    np.testing.assert_allclose(found["samples"][key], recorded["samples"][key], atol=1.0e-4)


def test_a_free_body_moves_on_its_manifold():
    """A body in free fall with an arm that swings; its momentum makes it turn."""
    robot = (
        "<robot name='r'>"
        + link("body", 2.0, inertia=0.2)
        + link("arm", 1.0, "0 0 -0.3", 0.03)
        + joint("swing", "continuous", "body", "arm", "0 0.6 0.8")
        + "</robot>"
    )
    twist = {"linear": [0.1, 0.2, 3.0], "angular": [0.5, 0.2, -0.3]}
    sections = {
        "robot": {"base": "floating"},
        "actuators": [{"type": "ideal", "joints": ["swing"]}],
        "initial": {"twist": {"base": twist}},
    }
    scene = mbd.scene_from(sections, urdf=robot)
    task = {"duration": 0.6, "end": {"swing.position": 1.0}, "goals": [{"type": "effort"}]}
    result = scene.predict(task)
    assert result.metadata["replay"] < 1.0e-8
    pose = np.array([result["samples"][f"base.orientation.{axis}"] for axis in "xyzw"])
    np.testing.assert_allclose(np.linalg.norm(pose, axis=0), 1.0, atol=1.0e-12)


def test_a_motion_is_written_and_read_again(tmp_path, capsys):
    """From files, as the command line takes them."""
    task = tmp_path / "task.yaml"
    task.write_text(
        "predict: {duration: 1.0, end: {shoulder_flexion.position: 0.8, '*.velocity': 0.0},\n"
        "  goals: [{type: effort}], tolerance: 1.0e-3}\n"
    )
    out = tmp_path / "motion.npz"
    assert main(["predict", "prosthetic_arm", str(task), "-o", str(out)]) == OK
    assert "simulated again" in capsys.readouterr().out
    result = read_result(out)
    assert result.metadata["converged"] is True
    assert result["samples"]["shoulder_flexion.position"][-1] == pytest.approx(0.8, abs=1e-9)


IMPOSSIBLE = {  # what is asked of the cart-pole besides its swing-up -> what the message names
    "a force that is too small": ({"bounds": {"slide.effort": [-2.0, 2.0]}}, "slide.effort"),
    "a time that is too short": ({"duration": 0.2}, "slide.effort"),
    "a speed that is too small": ({"bounds": {"slide.velocity": [-0.3, 0.3]}}, "slide.velocity"),
    "a pendulum that may not pass": ({"bounds": {"swing.velocity": [-1, 1]}}, "swing.velocity"),
    "a link that cannot be there": ({"end": {"pole.position.y": 0.2}}, "pole.position.y"),
    "a place out of reach": (
        {"end": {"slide.position": 0.0, "cart.position.x": 1.0}},
        "cart.position.x",
    ),
}
CONTRADICTORY = {
    "an end beyond its bounds": ({"bounds": {"slide.position": [-0.2, 0.5]}}, "slide.position"),
    "a start beyond its bounds": ({"start": {"slide.position": 3.0}}, "slide.position"),
    "a force beyond its limit": ({"bounds": {"slide.effort": [30.0, 40.0]}}, "slide.effort"),
    "bounds of which nothing is left": ({"bounds": {"slide.position": [2.0, -2.0]}}, "slide"),
    "an end without a value": ({"end": {"slide.effort": 1.0}}, "slide.effort"),
    "an unknown quantity": ({"end": {"slid.position": 1.0}}, "slide.position"),
    "a time of nothing": ({"duration": 0.0}, "duration: a duration must be above 0 s"),
    "no goal": ({"goals": []}, "goals"),
    "a joint that does not travel": ({"periodic": True, "travel": ["slid"]}, "no joint 'slid'"),
    "a function without a value": ({"goals": [lambda q: None]}, "it returns None"),
    "a mass as an unknown": ({"parameters": {"cart.mass": [0.5, 2.0]}}, "(continuation)"),
    "durations beside one of all": (
        {"phases": [{"duration": 1.0}]},
        "predict.duration: give the duration",
    ),
}


@pytest.mark.parametrize("name", IMPOSSIBLE)
def test_what_stands_against_a_motion_is_named(name):
    """And the last iterate is kept."""
    more, named = IMPOSSIBLE[name]
    with pytest.raises(NotConvergedError, match=re.escape(named)) as caught:
        cart_pole().predict(SWING_UP | more)
    assert caught.value.result.metadata["converged"] is False
    assert caught.value.result["samples"].rows > 1


@pytest.mark.parametrize("name", CONTRADICTORY)
def test_a_contradiction_is_refused(name):
    more, named = CONTRADICTORY[name]
    with pytest.raises(SceneError, match=re.escape(named)):
        cart_pole().predict(SWING_UP | more)


def test_a_loop_may_say_the_same_twice():
    """A plane four-bar that is closed in space: the row across the plane is no row at all."""
    scene, task, cost = four_bar()
    (closure,) = scene.entries["constraints"]
    whole = scene.with_(constraints=[dict(closure) | {"kind": "revolute", "directions": "xyz"}])
    assert whole.predict(task).metadata["cost"] == pytest.approx(cost, rel=1.0e-8)


def test_a_loop_that_cannot_close_is_named():
    scene, task, _ = four_bar()
    with pytest.raises(NotConvergedError, match="closure of loops"):
        scene.predict(task | {"end": {"rocker.position": 0.0}})


def test_an_interrupted_motion_keeps_its_last_iterate(tmp_path):
    """Ctrl-C while the solver works: it ends after an iteration, and says so."""
    task, out = tmp_path / "task.yaml", tmp_path / "motion.npz"
    task.write_text(
        "predict: {duration: 2.0, end: {cart.position: 1.0, pole.position: 3.14159, \n"
        "  '*.velocity': 0.0}, goals: [{type: effort}], tolerance: 1.0e-13,\n"
        "  mesh: {intervals: 60, degree: 3}}\n"
    )
    words = [sys.executable, "-m", "mbd_ros", "predict", "cart_pole", str(task), "-o", str(out)]
    ran = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    assert ran.stdout is not None
    assert ran.stdout.readline().startswith("mesh 1")
    ran.send_signal(signal.SIGINT)
    said, _ = ran.communicate()
    assert ran.returncode == FAILED
    assert "interrupted" in said
    assert read_result(out).metadata["converged"] is False
