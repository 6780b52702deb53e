"""The node `payload_estimator` over DDS: a payload, a robot at rest, and bad input."""

import sys
import time
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from deadline import PATIENT
from geometry_msgs.msg import InertiaStamped
from identification_data import fourier
from nodes.joint_stream import ACTIVE, MS, parameter_file
from nodes.node_process import NodeProcess
from nodes.probe import Probe
from nodes.simulation_client import DEEP
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from mbd_ros.api import load_scene
from mbd_ros.errors import SceneError
from mbd_ros.jobs.domain_claim import claimed_domain
from mbd_ros.nodes.payload_estimator.pipeline import PayloadPipeline
from msg_adapters.diagnostics import OK, WARN
from msg_adapters.joint_state import write_joint_state

NAME = "/payload_estimator"
TARGET = ("-m", "mbd_ros.nodes", "payload_estimator")
STEP = 5 * MS  # 200 Hz
HELD = pin.Inertia(1.7, np.array([0.01, -0.02, 0.09]), np.diag([0.004, 0.005, 0.003]))


class Arm:
    """An arm that holds something, and what the node says of it."""

    def __init__(self, probe):
        self.scene, self.probe = load_scene("arm7"), probe
        given = self.scene.robot.inertias()["flange"]
        self._solver = self.scene.with_inertias({"flange": given + HELD}).inverse_dynamics()
        self.names = list(self.scene.couplings.independent)
        self.payloads, self.covariances = [], []
        create = probe.node.create_subscription
        self._subscriptions = [
            create(InertiaStamped, f"{NAME}/payload", self.payloads.append, DEEP),
            create(Float64MultiArray, f"{NAME}/covariance", self.covariances.append, DEEP),
        ]
        self.publisher = probe.node.create_publisher(JointState, "/joint_states", DEEP)

    def send(self, stamp, position, effort):
        message = JointState(name=self.names)
        write_joint_state(message, stamp, self.names)
        message.position, message.effort = position.tolist(), effort.tolist()
        message.velocity = []
        self.publisher.publish(message)

    def play(self, begin, motion, effort=None):
        """Joint states at 200 Hz of stamps; no more are on their way than a reader keeps."""
        tau = self._solver.batch(*motion, []).tau if effort is None else effort
        for i, (position, torque) in enumerate(zip(motion[0], tau, strict=True)):
            self.send(begin + i * STEP, position, torque)
            if i % 10 == 9:
                self.probe.state(NAME)  # handled

    def health(self):
        count = len(self.probe.health)
        heard = self.probe.health
        self.probe.spin_until(lambda: any(h.name == NAME for h in heard[count:]))
        return [h for h in heard if h.name == NAME][-1]


@pytest.fixture
def arm(tmp_path):
    given = {"scene": "arm7", "frame": "flange", "memory": 4.0}
    file = parameter_file(tmp_path, {**given, **PATIENT})
    with claimed_domain() as domain:
        node = NodeProcess(
            [sys.executable, *TARGET, "--ros-args", "--params-file", str(file)], domain
        )
        try:
            with Probe(domain) as probe:
                node.wait_for(ACTIVE)
                arm = Arm(probe)
                probe.spin_until(arm.publisher.get_subscription_count)
                probe.spin_until(lambda: probe.node.count_publishers(f"{NAME}/payload"))
                probe.meet(NAME)
                yield arm
                assert node.stop() == 0, node.log
                assert "Traceback" not in node.log
        finally:
            if node.process.poll() is None:
                node.process.kill()
                node.wait()


def test_a_moving_arm_tells_what_it_holds_and_one_at_rest_does_not(arm):
    begin, t = time.time_ns(), np.arange(0.0, 6.0, STEP * 1e-9)
    motion = fourier(7, t, 1, frequency=0.2, amplitude=0.4)
    arm.play(begin, motion)
    arm.probe.spin_until(lambda: len(arm.payloads) > 200)
    arm.probe.spin_until(lambda: len(arm.covariances) >= len(arm.payloads))
    newest, covariance = arm.payloads[-1], arm.covariances[-1]
    assert newest.header.frame_id == "flange"
    assert newest.inertia.m == pytest.approx(1.7, abs=0.03)
    com = newest.inertia.com
    assert [com.x, com.y, com.z] == pytest.approx(HELD.lever, abs=5e-3)
    assert covariance.layout.dim[0].label == "mass.mass"
    C = np.reshape(covariance.data, (10, 10))
    assert np.linalg.eigvalsh(C)[0] > -1e-12 and C[0, 0] < 0.05**2
    health = arm.health()
    assert health.level == OK, health
    assert health.values["mass"].startswith("1.7") or health.values["mass"].startswith("1.69")

    assert arm.probe.call(Trigger, f"{NAME}/reset", Trigger.Request()).success
    begin = begin + 7_000_000_000
    posture = np.tile(motion[0][0], (len(t), 1))
    arm.play(begin, (posture, 0.0 * posture, 0.0 * posture))
    health = arm.health()
    assert health.level == WARN and "does not show" in health.message
    assert "Ixx" in health.message and "mass," not in health.message
    seen = len(arm.payloads)
    arm.play(begin + 7_000_000_000, (posture[:50],) * 3, effort=np.nan * posture[:50])
    health = arm.health()
    assert health.level == WARN and "no effort of joint1" in health.message
    assert all(np.isfinite(m.inertia.m) for m in arm.payloads[seen:])


@pytest.mark.parametrize(
    ("scene", "said"),
    [
        ("four_bar_leg", "without loops; record the motion"),
        ("free_flyer", "without free bases; hold the base"),
    ],
)
def test_a_scene_that_it_does_not_serve_is_refused_with_what_to_do(scene, said):
    with pytest.raises(SceneError, match=said):
        PayloadPipeline(SimpleNamespace(scene=scene), None)
