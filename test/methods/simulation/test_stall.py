"""Runs whose steps become too short, and runs that Ctrl-C ends."""

import os
import re
import signal
import subprocess
import sys

import numpy as np
import pytest
from mechanisms import scene_of
from places import ROOT

from mbd_ros.cli import main
from mbd_ros.errors import DivergedError
from mbd_ros.methods.simulation.stall import WINDOW, StallWatch
from mbd_ros.motion.recordings import read_motion

PENDULUM = f"robot: {{urdf: {ROOT}/config/robots/pendulum.urdf}}\n"
CHATTERING = PENDULUM + (
    "forces: [{type: switching_force, velocity: {hinge: [0.0, 1.0]}, above: {hinge: -40.0}, "
    "below: {hinge: 40.0}}]\nintegrator: {type: dopri5, tolerance: 1e-9}\n"
    "initial: {position: {hinge: 0.5}, velocity: {hinge: 1.0}}\n"
)
STIFF = PENDULUM + (
    "forces: [{type: joint_spring, joint: hinge, stiffness: 3e8, damping: 1e3}]\n"
    "integrator: {type: dopri5, tolerance: 1e-6}\ninitial: {position: {hinge: 0.5}}\n"
)


def written(folder, text):
    (folder / "s.yaml").write_text(text, encoding="utf-8")
    return folder / "s.yaml"


def test_a_stalled_run_is_named_and_keeps_what_it_has(capsys, tmp_path):
    scene = written(tmp_path, CHATTERING)
    code = main(["simulate", str(scene), "-t", "10", "-o", str(tmp_path / "o.csv")])
    warned, error = capsys.readouterr().err.splitlines()
    assert code == 1
    reason = (
        r"steps of \S+ s at t = 0\.007\d* s: \S+ of them to the end at 10 s; joint hinge has .*"
    )
    assert re.fullmatch(rf"warning: {reason}; a switching force chatters .*filippov.*", warned)
    assert re.match(rf"mbd-ros simulate: stalled: {reason} chatters", error)
    assert f"8 states so far are in {tmp_path}/o.diverged.csv" in error
    assert len(read_motion(tmp_path / "o.diverged.csv", ["hinge"]).motion.stamps) == 8
    assert not (tmp_path / "o.csv").exists()


def test_the_named_way_out_of_chattering_works(capsys, tmp_path):
    scene = written(tmp_path, CHATTERING)
    words = ["simulate", str(scene), "-t", "10", "-o", str(tmp_path / "o.csv")]
    assert main([*words, "--integrator", "filippov", "--tolerance", "1e-9"]) == 0
    assert "stalled" not in capsys.readouterr().err


@pytest.mark.soak
def test_a_stiff_run_that_gets_to_its_end_is_left_alone(capsys, tmp_path):
    """A rate of 3e4 1/s: short steps all the way, and more of them than a few looks."""
    scene = written(tmp_path, STIFF)
    words = ["simulate", str(scene), "-t", "4", "-o", str(tmp_path / "o.csv"), "--dt", "0.5"]
    assert main(words) == 0
    said, err = capsys.readouterr()
    assert err == ""
    assert int(re.search(r"(\d+) steps", said)[1]) > WINDOW


def looks(steps, end=10.0, dt=1e-3, text=CHATTERING):
    """What a watch says of windows with these mean steps."""
    scene, said = scene_of(text), []
    watch, t = StallWatch(scene.system(), dt, said.append), 0.0
    watch.begin(t)
    for step in steps:
        t += step * WINDOW
        watch.check(scene.initial._replace(t=t), None, end)
    return said


@pytest.mark.parametrize(
    ("steps", "warned"),
    [
        ([1e-3] * 9, False),
        ([1e-8, 1e-8, 1e-4, 1e-8, 1e-8, 1e-4], True),
        ([1e-7] * 9, True),
        ([1e-5] * 9, False),
    ],
    ids=["full steps", "slow for a while", "slow all the way", "stiff, the end near"],
)
def test_a_run_with_hope_goes_on(steps, warned):
    assert len(looks(steps)) == warned


def test_a_run_of_natural_steps_may_be_long():
    assert looks([1e-3] * 9, end=1e9) == []


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        (CHATTERING, "joint hinge has the largest acceleration; a switching force chatters"),
        (STIFF.replace("3e8", "3e16"), "joint hinge is stiff with a rate of 3e+08 1/s"),
        (PENDULUM + "initial: {position: {hinge: 1}}\n", "joint hinge has the largest accelerat"),
    ],
)
def test_a_hopeless_run_ends_with_its_cause(text, cause):
    with pytest.raises(DivergedError) as caught:
        looks([1e-8] * 3, text=text)
    assert str(caught.value).startswith("stalled: steps of 1e-08 s at t = 0.0003 s: 1e+09 of ")
    assert cause in str(caught.value)


def test_a_tick_that_does_not_end_is_an_error_too():
    """What the live simulator calls: it must not stand still for minutes."""
    scene = scene_of(CHATTERING)
    simulation = scene.simulation()
    y = simulation.start(scene.initial)
    y = simulation.advance(y, None, 7e-3)
    with pytest.raises(DivergedError, match=r"stalled: .* joint hinge .*chatters"):
        simulation.advance(y, None, 8e-3)


def test_ctrl_c_keeps_what_there_is(tmp_path):
    scene, out = written(tmp_path, CHATTERING), tmp_path / "bag"
    words = [sys.executable, "-m", "mbd_ros.cli", "simulate", scene, "-t", "10", "-o", out]
    with subprocess.Popen(
        list(map(str, words)), cwd=ROOT, env=os.environ, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr.readline().startswith("warning: steps of ")
        process.send_signal(signal.SIGINT)
        err = process.stderr.read()
    assert process.returncode == 130
    kept = tmp_path / "bag_diverged"
    assert re.search(
        rf"interrupted after t = 0\.007 s; 8 states so far are in {kept}$", err.strip()
    )
    assert "Traceback" not in err
    stamps = read_motion(kept, ["hinge"]).motion.stamps
    assert np.diff(stamps)[1:] == pytest.approx(1e6)
    assert not out.exists()
