"""The scenes that controllers move stay finite and within their limits, however badly led."""

import numpy as np
import pytest
from places import ROOT

from mbd_ros.api import load_scene

SCENES = ROOT / "config/scenes"


@pytest.mark.parametrize("seconds", [1.0, pytest.param(2.0, marks=pytest.mark.soak)])
@pytest.mark.parametrize("rate", [20.0, pytest.param(50.0, marks=pytest.mark.soak)])
@pytest.mark.parametrize("name", ["arm", "arm7", "four_bar", "leg"])
def test_a_slow_and_clipped_loop_stays_at_the_stops(name, rate, seconds):
    """A stiff law with clipped torques; without stops joints went 0.9 to 38 rad beyond."""
    scene = load_scene(SCENES / f"controlled_{name}.yaml")
    simulation, joints = scene.simulation(), scene.controlled_joints()
    limits = np.concatenate([actuator.limits() for actuator in scene.actuators])
    lower, upper = (
        np.array([getattr(j, end) for j in joints.joints]) for end in ("lower", "upper")
    )
    y, driven = simulation.start(scene.initial), 0.0
    for _ in range(int(seconds * rate)):
        x = simulation.system.expand(y)
        q, v = joints.positions(x), joints.velocities(x)
        effort = np.clip(-400.0 * (q - 0.3) - 40.0 * v, -limits, limits)
        driven = max(driven, float((np.abs(effort) / limits).max()))
        y = simulation.advance(y, effort, y.t + 1.0 / rate)
        q = joints.positions(simulation.system.expand(y))
        assert np.isfinite(q).all()
        assert (np.maximum(lower - q, q - upper) < 0.02).all(), (y.t, q)
    assert driven == 1.0 and len(simulation.events) > 10  # stops were met
