"""Phases of a live simulator, over DDS: the simplest walker goes down its slope."""

import numpy as np
import pytest
from deadline import DEADLINE
from nodes.simulation_client import DEEP, NAME, simulated
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float64MultiArray, String

from mbd_ros.api import load_scene

FOUND = load_scene("simplest_walker").path
DT, FASTER = 0.02, 10.0
LATCHED = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
NEWEST = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def offline(duration):
    """Joint states of a run with fixed steps, its events, and its phases."""
    scene = load_scene("simplest_walker").with_(integrator={"type": "rk4"}, dt=DT)
    simulation = scene.simulation()
    states = [(*x.q, *x.v) for x in simulation.run(scene.initial, duration)]
    names = list(scene.phases)
    events = [event for event in simulation.events if event.ends_phase]
    return states, events, [names[0], *(names[event.after.mode[0]] for event in events)]


@pytest.mark.parametrize(
    "duration", [20.0, pytest.param(600.0, marks=[pytest.mark.soak, pytest.mark.timeout(900)])]
)
def test_walk_has_the_bits_of_an_offline_run_and_publishes_each_phase_once(
    domain, tmp_path, duration
):
    """Ten times as fast as the walker would; the samples that came are samples of the run."""
    states, expected, names = offline(duration)
    scene = FOUND.read_text(encoding="utf-8").replace("dt: 0.01", f"dt: {DT}")
    scene = scene.replace("{type: dop853, tolerance: 1.0e-10}", "{type: rk4}")
    more = {"rate": 1.0 / DT, "real_time_factor": FASTER, "paused": "true"}
    phases, events, late = [], [], []
    with simulated(domain, tmp_path, scene, **more) as client:
        subscribe, spin = client.probe.node.create_subscription, client.probe.spin_until
        kept = [
            subscribe(String, f"{NAME}/phase", lambda one: phases.append(one.data), LATCHED),
            subscribe(Float64MultiArray, f"{NAME}/events", events.append, DEEP),
        ]
        spin(lambda: phases and all(one.get_publisher_count() for one in kept))
        client.pause(False)
        patience = DEADLINE + duration  # a busy machine walks slower
        spin(lambda: len(events) >= len(expected) and len(phases) >= len(names), patience)
        client.pause(True)
        client.settle()
        kept.append(subscribe(String, f"{NAME}/phase", lambda one: late.append(one.data), NEWEST))
        spin(lambda: late)
        samples = [client.sample(k) for k in range(len(client.states))]
    at = {x: k for k, x in enumerate(states)}
    moved = [at.get((*one.position, *one.velocity), len(states)) for one in samples]
    walked = moved[len(moved) - moved[::-1].index(0) :]  # from the last reset on
    inside = walked[: int(np.argmax(walked))]  # the run ends a little before
    assert inside and (np.diff(inside) > 0).all() and len(inside) > 0.9 * len(states)
    assert phases[: len(names)] == names and late == phases[-1:]
    times = [dict(zip(labels(one), one.data, strict=True))["time"] for one in events]
    assert times[: len(expected)] == [event.t for event in expected]
    assert len(phases) == len(events) + 1


def labels(message):
    return [dimension.label for dimension in message.layout.dim]
