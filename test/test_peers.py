"""Other packages on the same scenes; nothing fails where they are not installed."""

import importlib.util

import numpy as np
import pytest

from mbd_ros.report import peers
from mbd_ros.report.contenders import task_of
from mbd_ros.report.converged import known
from mbd_ros.report.pareto import Point
from mbd_ros.report.peers_text import compose, ratio
from mbd_ros.report.reference_problems import SCENES
from mbd_ros.scene import load_scene

needs_mujoco = pytest.mark.skipif(
    importlib.util.find_spec("mujoco") is None,
    reason="mujoco is not installed: pip install mujoco",
)
needs_drake = pytest.mark.skipif(
    importlib.util.find_spec("pydrake") is None, reason="drake is not installed: pip install drake"
)
TIMES = (0.05, 0.1)


def off(name, run):
    """Largest distance of a peer to the converged motion [rad]."""
    motion = known(f"{SCENES}/{name}.yaml", TIMES)
    states, seconds = run.run(TIMES)
    assert seconds > 0
    pairs = zip(states, motion.states, strict=True)
    return max(np.abs(x.q - theirs.q).max() for x, theirs in pairs)


def task(name):
    return task_of(load_scene(f"{SCENES}/{name}.yaml"))


def test_a_peer_that_is_missing_is_named_with_its_install_line(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert peers.items([], False) == []
    text = " ".join(peers.section([]).text)
    assert "pip install mujoco" in text and "pip install drake" in text


def test_ratio_is_taken_at_equal_error():
    ours = [Point(1.0, 1e-4), Point(2.0, 1e-6)]
    theirs = [Point(4.0, 1e-3), Point(40.0, 1e-5), Point(400.0, 1e-7)]
    assert ratio(ours, theirs, 1e-6) == pytest.approx(40.0 * 10**0.5 / 2.0)
    assert ratio(ours, theirs, 1e-8) is None


def test_a_demand_that_does_not_hold_is_said():
    def runs(package, cost):
        known_run = {"package": package, "setup": "x", "solver": "auto", "stabilization": None}
        known_run |= {"integrator": {"type": "rk4"}, "dt": 1e-3, "seconds": cost}
        return known_run | {"position": 1e-9, "configuration": 1e-9}

    outcome = {"runs": [runs("mbd_ros", 1.0), runs("MuJoCo", 2.0)], "agreement": 1e-12}
    section = compose([("arm7_swing", outcome | {"check": "x", "setups": []})], [])
    assert any("does not hold" in row[-1] for row in section.tables[0].rows)


def test_scenes_of_a_user_have_no_peers():
    assert peers.items([f"{SCENES}/arm7_swing.yaml"], False) == []


@needs_mujoco
@pytest.mark.parametrize(
    ("name", "allowed"),
    [("arm7_swing", 1e-8), ("arm7_swing_coupled", 1e-7), ("x02_four_bar_1e-2", 1e-5)],
)
def test_mujoco_runs_the_same_scene(name, allowed):
    """Order 4 at 0.2 ms; constraints are as stiff as MuJoCo takes them."""
    from mbd_ros.report.mujoco_peer import MujocoRun

    assert off(name, MujocoRun(task(name), "mjINT_RK4", 2e-4, 1.0, True)) < allowed


@needs_drake
def test_drake_runs_the_same_scene():
    from mbd_ros.report.drake_peer import DrakeRun

    assert off("arm7_swing", DrakeRun(task("arm7_swing"), "runge_kutta5", 1e-9)) < 1e-7
