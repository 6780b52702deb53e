"""u: channels of the parts of a scene, where they stand, and what gives them."""

from pathlib import Path

import numpy as np
import pytest
from mechanisms import scene_of

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
