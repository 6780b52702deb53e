"""The leg with a polycentric knee: its loop, its range, its masses."""

import math

import numpy as np
import pytest
from places import ROOT
from scene_geometry import Mechanism
from scipy.optimize import fsolve

from mbd_ros.api import load_scene

SCENES = ROOT / "config/scenes"


def test_four_bar_leg_hangs_like_the_leg_with_a_sliding_knee():
    four_bar = Mechanism(SCENES / "four_bar_leg.yaml")
    sliding = Mechanism(SCENES / "prosthetic_leg.yaml")
    ours, theirs = (leg.whole() for leg in (four_bar, sliding))
    assert ours.mass == pytest.approx(theirs.mass, abs=1e-9)
    assert ours.lever == pytest.approx(theirs.lever, abs=1e-6)  # URDF numbers of six digits
    assert ours.inertia == pytest.approx(theirs.inertia, abs=1e-6)


def test_four_bar_knee_bends_to_120_degrees_and_closes():
    """One coordinate: the tibial and the posterior joint follow the anterior one."""
    leg = Mechanism(SCENES / "four_bar_leg.yaml")
    (loop,) = leg.entries["constraints"]
    q, reached = np.zeros(leg.model.nv), []
    followers = [leg.robot.joint(name).v for name in ("knee_tibial", "knee_posterior")]
    for anterior in np.linspace(0.0, -1.9238635243075721, 60):
        q[leg.robot.joint("knee_anterior").q] = anterior
        q[followers] += fsolve(
            lambda dq: leg.opening(loop, q, followers, dq), [0.0, 0.0], xtol=1e-10
        )
        assert leg.gap(loop, 0.0, q) <= 1e-12
        reached.append(-math.degrees(anterior + q[followers[0]]))
    assert np.all(np.diff(reached) > 0) and reached[-1] == pytest.approx(120.0, abs=1e-6)
    limited = [joint for joint in leg.robot.joints if joint.name.startswith("knee")]
    assert all(joint.lower < q[joint.q] < joint.upper for joint in limited)


def test_four_bar_knee_swings_out_closed_and_only_loses_energy():
    """The dampers take energy, gravity and the ankle spring give back what they took."""
    scene, leg = load_scene(SCENES / "four_bar_leg.yaml"), Mechanism(SCENES / "four_bar_leg.yaml")
    simulation = scene.simulation()
    states = list(simulation.run(scene.initial, 0.6))
    energy = [simulation.system.energy(x) for x in states]
    assert np.all(np.diff(energy) < 1e-12)
    assert max(gap for x in states for gap in leg.gaps(x.t, x.q)) <= 1e-14
    for joint in (joint for joint in leg.robot.joints if joint.name.startswith("knee")):
        assert all(joint.lower < x.q[joint.q] < joint.upper for x in states)
