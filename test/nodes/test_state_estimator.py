"""The node `state_estimator` over DDS: what it makes of partial, noisy and disordered messages."""

import math
import sys
import time

import numpy as np
import pytest
from geometry_msgs.msg import Vector3
from nodes.conftest import NodeProcess, Probe
from nodes.joint_stream import ACTIVE, MS, parameter_file
from nodes.simulation_client import DEEP
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray

from mbd_ros.core.outputs import Now
from mbd_ros.jobs.domain_claim import claimed_domain
from mbd_ros.scene.reader import load_scene
from msg_adapters.diagnostics import OK, WARN
from msg_adapters.joint_state import write_joint_state
from msg_adapters.time import read_time, write_time

NAME = "/state_estimator"
TARGET = ("-m", "mbd_ros.nodes", "state_estimator")
STEP = 10 * MS


class Machine:
    """A simulated four-bar knee that is measured, and what the node answers."""

    def __init__(self, probe, scene="four_bar_leg"):
        self.scene, self.probe = load_scene(scene), probe
        self.simulation = self.scene.simulation()
        self.names = [joint.name for joint in self.scene.robot.joints]
        self.states, self.innovations, self.forces = [], [], []
        create = probe.node.create_subscription
        self._subscriptions = [
            create(JointState, f"{NAME}/joint_states", self.states.append, DEEP),
            create(JointState, f"{NAME}/constraint_forces", self.forces.append, DEEP),
            create(Float64MultiArray, f"{NAME}/innovations", self.innovations.append, DEEP),
        ]
        self.publisher = probe.node.create_publisher(JointState, "/joint_states", DEEP)
        self.begin = time.time_ns()
        y = self.simulation.start(self.scene.initial, None)
        self.motion = [y]

    def at(self, i):
        """State i of the simulation."""
        while len(self.motion) <= i:
            k = len(self.motion)
            self.motion.append(self.simulation.advance(self.motion[-1], None, k * STEP * 1e-9))
        return self.motion[i]

    def send(self, i, joints, noise=0.0):
        x = self.simulation.system.expand(self.at(i))
        robot = self.scene.robot
        position = np.array([x.q[robot.joint(name).q] for name in joints]) + noise
        stamp = self.begin + i * STEP
        self.publisher.publish(write_joint_state(JointState(), stamp, joints, position=position))

    def ask(self, i, joints, noise=0.0):
        """The answer to a sample."""
        stamp = self.begin + i * STEP
        self.send(i, joints, noise)
        newest = self.probe.spin_until
        newest(lambda: self.states and read_time(self.states[-1].header.stamp) >= stamp)
        return self.states[-1]

    def error(self, i, message, field="position"):
        x, robot = self.simulation.system.expand(self.at(i)), self.scene.robot
        kind, at = {"position": (x.q, "q"), "velocity": (x.v, "v")}[field]
        right = [kind[getattr(robot.joint(name), at)] for name in message.name]
        return float(np.abs(np.array(getattr(message, field)) - right).max())

    def health(self):
        count = len(self.probe.health)
        self.probe.spin_until(
            lambda: any(h.name == NAME for h in self.probe.health[count:]), timeout=3.0
        )
        return [h for h in self.probe.health if h.name == NAME][-1]


@pytest.fixture
def started(tmp_path):
    """Starts the node on a domain of its own."""
    processes = []

    def start(scene="four_bar_leg", **parameters):
        domain = claimed_domain()
        file = parameter_file(tmp_path, {"scene": scene, **parameters})
        command = [sys.executable, *TARGET, "--ros-args", "--params-file", str(file)]
        node = NodeProcess(command, domain)
        probe = Probe(domain)
        processes.append((node, probe))
        node.wait_for(ACTIVE)
        return probe

    yield start
    for node, probe in processes:
        probe.close()
        node.stop()
