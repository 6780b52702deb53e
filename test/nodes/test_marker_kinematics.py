"""The node `marker_kinematics` over DDS."""

import math
import sys
import time

import numpy as np
import pytest
from deadline import PATIENT
from nodes.joint_stream import ACTIVE, MS, parameter_file
from nodes.node_process import NodeProcess
from nodes.probe import Probe
from nodes.simulation_client import DEEP
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from visualization_msgs.msg import Marker, MarkerArray

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.jobs.domain_claim import claimed_domain
from mbd_ros.scene.reader import load_scene
from msg_adapters.diagnostics import OK, WARN
from msg_adapters.markers import write_marker_places

NAME = "/marker_kinematics"
TARGET = ("-m", "mbd_ros.nodes", "marker_kinematics")
STEP = 5 * MS  # 200 Hz


class Leg:
    """A swinging leg whose markers are seen, and what the node answers."""

    def __init__(self, probe):
        self.scene, self.probe = load_scene("marked_leg"), probe
        self.k = Kinematics(self.scene.robot)
        self.labels = [marker.title for marker in self.scene.sensors]
        self.states, self.residuals = [], []
        create = probe.node.create_subscription
        self._subscriptions = [
            create(JointState, f"{NAME}/joint_states", self.states.append, DEEP),
            create(Float64MultiArray, f"{NAME}/residuals", self.residuals.append, DEEP),
        ]
        self.publisher = probe.node.create_publisher(MarkerArray, "/markers", DEEP)
        self.begin = time.time_ns()

    def q(self, i):
        """Joints at sample i: hip, knee and ankle swing at 1 Hz, the knee centre follows."""
        scene, t = self.scene, i * STEP * 1e-9
        swing = {"hip_flexion": 0.3, "knee": 0.4, "ankle": 0.2}
        q = np.zeros(scene.robot.model.nq)
        for name, size in swing.items():
            q[scene.robot.joint(name).q] = size * math.sin(2.0 * math.pi * t)
        q[scene.robot.joint("knee").q] -= 0.6
        scene.couplings.expand(q, np.zeros(len(q)), np.zeros(len(q)))
        return q

    def places(self, i):
        q = self.q(i)
        self.k.refresh(q, np.zeros(len(q)))
        origin = self.scene.robot.origin
        return np.array([self.k.position(s.point) + origin for s in self.scene.sensors])

    def send(self, i, places=None, labels=None, stamp=None):
        places = self.places(i) if places is None else places
        stamp = self.begin + i * STEP if stamp is None else stamp
        labels = self.labels if labels is None else labels
        message = write_marker_places(MarkerArray(), stamp, labels, places, Marker)
        self.publisher.publish(message)
        return message

    def ask(self, i, **changes):
        """The answer to a sample."""
        seen = len(self.states)
        self.send(i, **changes)
        self.probe.spin_until(lambda: min(len(self.states), len(self.residuals)) > seen)
        return self.states[-1]

    def health(self):
        count = len(self.probe.health)
        self.probe.spin_until(lambda: any(h.name == NAME for h in self.probe.health[count:]))
        return [h for h in self.probe.health if h.name == NAME][-1]


@pytest.fixture(scope="module")
def leg(tmp_path_factory):
    folder = tmp_path_factory.mktemp("node")
    file = parameter_file(folder, {"scene": "marked_leg", "cutoff": 20.0, **PATIENT})
    with claimed_domain() as domain:
        node = NodeProcess(
            [sys.executable, *TARGET, "--ros-args", "--params-file", str(file)], domain
        )
        try:
            with Probe(domain) as probe:
                node.wait_for(ACTIVE)
                leg = Leg(probe)
                probe.spin_until(leg.publisher.get_subscription_count)
                probe.spin_until(lambda: probe.node.count_publishers(f"{NAME}/joint_states"))
                probe.spin_until(lambda: leg.send(0) and leg.states)
                probe.state(NAME)  # all that was sent is answered
                yield leg
                assert node.stop() == 0, node.log
                assert "Traceback" not in node.log
        finally:
            if node.process.poll() is None:
                node.process.kill()
                node.wait()


def test_joints_and_velocities_follow_the_markers_at_200_hz_of_stamps(leg):
    leg.begin = time.time_ns()
    first = len(leg.states)
    for i in range(200):
        leg.ask(i)
    names = [joint.name for joint in leg.scene.robot.joints]
    for i, state in enumerate(leg.states[first:]):
        assert list(state.name) == names
        np.testing.assert_allclose(state.position, leg.q(i), atol=1e-9)
        assert np.isfinite(state.velocity).all()
    hip = names.index("hip_flexion")
    speed = np.array([state.velocity[hip] for state in leg.states[first + 50 :]])
    t = 0.005 * np.arange(50, 200)
    exact = 0.3 * 2.0 * math.pi * np.cos(2.0 * math.pi * (t - 0.016))  # the filter lags by 16 ms
    assert np.abs(speed - exact).max() < 0.15
    assert all(len(message.data) == 3 for message in leg.residuals)
    assert max(message.data[1] for message in leg.residuals[first:]) < 1e-8


def test_missing_and_unknown_markers_are_no_fault(leg):
    leg.begin = time.time_ns()
    places = leg.places(0)
    places[[1, 5]] = np.nan
    state = leg.ask(0, places=places)
    np.testing.assert_allclose(state.position, leg.q(0), atol=1e-9)
    state = leg.ask(1, labels=[*leg.labels, "wand"], places=np.vstack([leg.places(1), [9, 9, 9]]))
    np.testing.assert_allclose(state.position, leg.q(1), atol=1e-9)
    health = leg.health()
    assert health.level == OK and health.values["markers ignored"] == "wand"


def test_bad_messages_are_dropped_and_named_and_nothing_is_published(leg):
    leg.begin = time.time_ns()
    leg.ask(0)
    count = len(leg.states)
    leg.send(1, places=np.full((8, 3), np.nan))  # no marker at all
    leg.send(2, labels=[f"x{i}" for i in range(8)])  # none of the scene
    leg.send(3, labels=["toe"] * 8)
    leg.send(4, places=np.full((8, 3), 1e300))
    leg.probe.state(NAME)  # handled
    assert len(leg.states) == count
    values = leg.health().values
    assert int(values["dropped.malformed"]) == 2 and int(values["dropped.unsolved"]) == 2
    state = leg.ask(5)
    np.testing.assert_allclose(state.position, leg.q(5), atol=1e-9)
    assert all(math.isfinite(x) for s in leg.states for x in (*s.position, *s.velocity))


def test_markers_that_do_not_fit_are_reported(leg):
    leg.begin = time.time_ns()
    places = leg.places(0)
    places[7] += [2.0, 0.0, 0.0]
    leg.ask(0, places=places)
    health = leg.health()
    assert health.level == WARN and "markers miss by" in health.message
    state = leg.ask(1)
    np.testing.assert_allclose(state.position, leg.q(1), atol=1e-8)
