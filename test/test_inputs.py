"""u: channels of the parts of a scene, where they stand, and what gives them."""

from pathlib import Path

import numpy as np
import pytest
from mechanisms import scene_of

from mbd_ros.core.state import State

ROBOTS = Path(__file__).parents[1] / "config/robots"
LEG = f"robot: {{urdf: {ROBOTS / 'prosthetic_leg.urdf'}}}\n"
DRIVES = """actuators:
- {type: ideal, joints: [knee, hip_flexion], limit: 50.0}
- {type: series_elastic, joint: ankle, stiffness: 300.0}
"""


def test_every_input_has_a_unit_bounds_and_a_safe_value():
    inputs = scene_of(LEG + DRIVES).inputs
    assert [channel.unit for channel in inputs.channels] == ["N·m", "N·m", "rad"]
    assert [channel.upper for channel in inputs.channels] == [50.0, 50.0, np.inf]
    assert not inputs.safe.any()


def test_scenes_that_share_parts_have_slots_of_their_own():
    """A section that is kept, beside another number of inputs before it."""
    first = scene_of(LEG + DRIVES)
    elastic = first.actuators[1]
    fewer = first.holding(actuators=(elastic,))
    assert (elastic.u, first.actuators[1].u) == (slice(2, 3), slice(2, 3))
    assert fewer.actuators[0].u == slice(0, 1)
    assert len(fewer.inputs.channels) == 1
    assert first.with_(dt=0.01).actuators == first.actuators
    u = np.array([3.0, 5.0, 0.1])
    loads = first.system().loads
    x = first.initial
    tau = loads.actuator_torque(None, x, u)
    driven = [first.robot.joint(name).v for name in ("knee", "hip_flexion", "ankle")]
    assert tau[driven] == pytest.approx([3.0, 5.0, 30.0])
    assert loads.command(tau[driven], x) == pytest.approx(u)


@pytest.mark.parametrize(
    "drive",
    [
        "{type: ideal, joints: [knee, ankle], limit: 50.0}",
        "{type: geared_motor, joint: knee, ratio: -50.0, viscous: 1.0e-3, limit: 0.4}",
        "{type: series_elastic, joint: ankle, stiffness: 300.0, damping: 2.0}",
    ],
)
def test_columns_are_the_slopes_of_an_affine_force_within_its_bounds(drive):
    """force(u) = force(0) + columns u, at random states and inputs."""
    scene = scene_of(f"{LEG}actuators: [{drive}]\n")
    (part,), rng, nv = scene.actuators, np.random.default_rng(1), scene.robot.model.nv
    lower, upper = (np.clip([c[i] for c in part.inputs], -9.0, 9.0) for i in (2, 3))
    for q, v in rng.normal(size=(20, 2, nv)):
        x, u = State(0.0, q, v), rng.uniform(lower, upper)
        columns = part.columns(None, x)
        assert columns.shape == (nv, len(part.inputs))
        expected = part.force(None, x, np.zeros(len(u))) + columns @ u
        np.testing.assert_allclose(part.force(None, x, u), expected, rtol=1e-13, atol=1e-12)


@pytest.mark.parametrize(
    "drive",
    [
        "{type: geared_motor, joint: knee, ratio: 50.0, efficiency: 0.8}",
        "{type: series_elastic, joint: ankle, stiffness: 300.0, limit: 20.0}",
    ],
)
def test_a_force_that_is_not_affine_has_no_columns(drive):
    (part,) = scene_of(f"{LEG}actuators: [{drive}]\n").actuators
    assert part.columns(None, scene_of(LEG).initial) is None
