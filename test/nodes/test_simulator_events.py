"""Events of a live simulator, over DDS."""

import math

import numpy as np
import pytest
from nodes.simulation_client import DEEP, NAME, simulated
from std_msgs.msg import Float64MultiArray

from mbd_ros.api import load_scene

HEIGHT, E, TICK, COUNT = 0.5, 0.6, 0.01, 90
URDF = """<robot name="r"><link name="world"/><link name="mass"><inertial><mass value="2"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="slide" type="prismatic"><parent link="world"/><child link="mass"/><axis xyz="0 0 1"/>
<limit lower="-9" upper="9" effort="0" velocity="0"/></joint></robot>
"""
SCENE = f"""robot: {{urdf: mass.urdf}}
initial: {{position: {{slide: {HEIGHT}}}}}
constraints: [{{type: joint_stop, joint: slide, lower: 0.0, restitution: {E}}}]
integrator: {{type: rk4}}
"""


def test_every_event_is_published_once_with_both_sides(domain, tmp_path):
    """Two bounces in closed form; the joint states are those of the run, to the bit."""
    (tmp_path / "mass.urdf").write_text(URDF, encoding="utf-8")
    path = tmp_path / "local.yaml"
    path.write_text(SCENE, encoding="utf-8")
    run = load_scene(path).simulation(), load_scene(path).initial
    expected = list(run[0].run(run[1], COUNT * TICK))
    with simulated(domain, tmp_path, SCENE, rate=1 / TICK, paused="true") as client:
        events = []
        subscribe = client.probe.node.create_subscription
        subscription = subscribe(Float64MultiArray, f"{NAME}/events", events.append, DEEP)
        client.probe.spin_until(subscription.get_publisher_count)
        for k in range(1, COUNT + 1):
            sample = client.step()
            x = expected[round(k * TICK / run[0].dt)]
            assert (sample.position[0], sample.velocity[0]) == (x.q[0], x.v[0])
        client.probe.spin_until(lambda: len(events) >= 2)
        client.probe.state(NAME)  # nothing else was said before
    rows = [dict(zip(labels(one), one.data, strict=True)) for one in events]
    fall = math.sqrt(2.0 * HEIGHT / 9.81)
    speed = 9.81 * fall
    assert [row["time"] for row in rows] == pytest.approx([fall, fall * (1 + 2 * E)], abs=1e-9)
    for row, before in zip(rows, speed * E ** np.arange(2), strict=True):
        assert row["slide.velocity.before"] == pytest.approx(-before, abs=1e-9)
        assert row["slide.velocity.after"] == pytest.approx(E * before, abs=1e-9)
        assert row["slide_joint_stop.force.impulse"] == pytest.approx(2 * (1 + E) * before)


def labels(message):
    return [dimension.label for dimension in message.layout.dim]
