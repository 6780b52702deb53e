"""`mbd-ros predict` on mechanisms whose best motions are known."""

import re
import signal
import subprocess
import sys

import numpy as np
import pytest
from prediction_scenes import PROBLEMS, SWING_UP, SWING_UP_COST, cart_pole, coupled_arm, four_bar

from mbd_ros.cli import main
from mbd_ros.errors import FAILED, OK, NotConvergedError, SceneError
from mbd_ros.files.formats import read_result


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
    found = scene.predict(task).metadata
    assert found["converged"]
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


def test_a_loop_stays_closed_between_nodes():
    samples = four_bar()[0].predict(four_bar()[1])["samples"]
    assert np.abs(samples["drift.position"]).max() < 1.0e-6


def test_a_motion_is_written_and_read_again(tmp_path, capsys):
    """From files, as the command line takes them."""
    task = tmp_path / "task.yaml"
    task.write_text(
        "predict: {duration: 1.0, end: {shoulder_flexion.position: 0.8, '*.velocity': 0.0},\n"
        "  goals: [{type: effort}], tolerance: 1.0e-3}\n"
    )
    out = tmp_path / "motion.npz"
    assert main(["predict", "prosthetic_arm", str(task), "-o", str(out)]) == OK
    assert "integrated again" in capsys.readouterr().out
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
    "no goal": ({"goals": []}, "goals"),
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
    said, _ = ran.communicate(timeout=100)
    assert ran.returncode == FAILED
    assert "interrupted" in said
    assert read_result(out).metadata["converged"] is False
