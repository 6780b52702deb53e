"""Forces, constraint and actuators of other packages in a simulator: those that the pages show."""

import sys

import numpy as np
import parts_of_pages
import pytest
from nodes.simulation_client import DEEP, NAME, simulated
from places import ROOT
from std_msgs.msg import Float64MultiArray

from mbd_ros.api import load_scene
from mbd_ros.core.loads.inputs import HeldTable

LEG = f"""robot: {{urdf: {ROOT / "config/robots/prosthetic_leg.urdf"}}}
forces:
- {{type: "hard_spring:HardSpring", joint: ankle, stiffness: 30.0, cubic: 40.0}}
- {{type: "escapement:Escapement", joint: ankle, speed: 0.2}}
constraints: [{{type: "level_tool:LevelTool", first: hip_flexion, second: knee, angle: 0.1}}]
actuators:
- {{type: "voltage_motor:VoltageMotor", joint: knee, constant: 1.2, resistance: 0.8}}
- {{type: "wound_motor:WoundMotor", joint: ankle, constant: 1.2, resistance: 0.8, inductance: 0.1}}
initial:
  position: {{hip_flexion: 0.4, knee: -0.3, ankle: -0.001}}
  velocity: {{ankle: 0.5}}
  internal: {{ankle_wound_motor.current: 0.0}}
"""


@pytest.fixture
def modules(tmp_path_factory, monkeypatch):
    """A folder on the path of this process and of the nodes that it starts."""
    folder = tmp_path_factory.mktemp("outside")
    parts_of_pages.write(folder)
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setenv("PYTHONPATH", str(folder), prepend=":")
    yield folder
    for name in parts_of_pages.MODULES:
        sys.modules.pop(name, None)


def test_a_node_moves_them_as_a_run_does(domain, tmp_path, modules):
    """Steps under voltages from ~/commands, against the same steps offline."""
    volts = [6.0, -3.0, 30.0, 0.5, 12.0]  # one beyond the limit
    (tmp_path / "scene.yaml").write_text(LEG, encoding="utf-8")
    scene = load_scene(tmp_path / "scene.yaml", allow_code=True)
    times, other = scene.dt * np.arange(5), 0.3 * np.array(volts)
    simulation = scene.simulation(
        sources={
            "knee_voltage_motor": HeldTable(times, np.reshape(volts, (5, 1))),
            "ankle_wound_motor": HeldTable(times, other[:, None]),
        }
    )
    states = simulation.run(scene.initial, 5 * scene.dt)
    expected = [[x.q[joint.q] for joint in scene.robot.joints] for x in states]
    with simulated(domain, tmp_path, LEG, allow_code="true", paused="true") as client:
        client.pause(True)
        events = []
        subscribe = client.probe.node.create_subscription
        subscription = subscribe(Float64MultiArray, f"{NAME}/events", events.append, DEEP)
        client.probe.spin_until(subscription.get_publisher_count)
        found = [client.newest.position]
        for volt, more in zip(volts, other, strict=True):
            client.command([volt, more])
            found.append(client.step().position)
        client.probe.spin_until(lambda: events)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)
    assert np.abs(np.diff(np.array(expected), axis=0)).max() > 1e-6
    ((offline,), (event,)) = simulation.events, events
    row = dict(zip((one.label for one in event.layout.dim), event.data, strict=True))
    assert offline.guards == ("ankle_escapement.middle",)
    assert row["time"] == pytest.approx(offline.t, abs=1e-14)
    gained = row["ankle.velocity.after"] - row["ankle.velocity.before"]
    assert gained == pytest.approx(0.2, abs=1e-12)
