"""The node `digital_twin` over DDS: the whole of a press from one encoder and the torque."""

import math
import time

import numpy as np
import pytest
from deadline import PATIENT
from geometry_msgs.msg import WrenchStamped
from nodes.joint_stream import ACTIVE, MS, parameter_file
from nodes.simulation_client import DEEP
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from mbd_ros.api import load_scene
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.methods.inverse_dynamics.reactions import JointReactions
from msg_adapters.diagnostics import WARN
from msg_adapters.joint_state import write_joint_state
from msg_adapters.time import read_time

NAME = "/digital_twin"
TARGET = ("-m", "mbd_ros.nodes", "digital_twin")
STEP = 5 * MS
JOINTS = ("crank", "coupler", "rocker")


class Press:
    """A simulated press whose crank is turned, and what the twin answers."""

    def __init__(self, probe):
        self.scene, self.probe = load_scene("press"), probe
        self.simulation = self.scene.simulation()
        self.states, self.forces, self.reactions, self.found = [], [], [], []
        self.predictions = []
        create = probe.node.create_subscription
        self._subscriptions = [
            create(JointState, f"{NAME}/joint_states", self.states.append, DEEP),
            create(JointState, f"{NAME}/constraint_forces", self.forces.append, DEEP),
            create(WrenchStamped, f"{NAME}/reactions/crank", self.reactions.append, DEEP),
            create(Float64MultiArray, f"{NAME}/determination", self.found.append, DEEP),
            create(JointTrajectory, f"{NAME}/prediction", self.predictions.append, DEEP),
        ]
        self.publisher = probe.node.create_publisher(JointState, "/joint_states", DEEP)
        self.torque, self.i = np.array([0.5]), 0
        self.y = self.simulation.start(self.scene.initial, self.torque)

    @property
    def x(self):
        return self.simulation.system.expand(self.y)

    def go(self, count, noise=0.0, offset=0.0):
        """So many samples; the newest answer."""
        rng = np.random.default_rng(self.i)
        for _ in range(count):
            self.i += 1
            self.y = self.simulation.advance(self.y, self.torque, self.i * STEP * 1e-9)
            stamp = self.begin + self.i * STEP
            position = self.x.q.copy()
            position += [noise * rng.standard_normal(), 0.0, offset]
            effort = np.array([self.torque[0], 0.0, 0.0])
            message = write_joint_state(
                JointState(), stamp, JOINTS, position=position, effort=effort
            )
            self.probe.publish_until(
                self.publisher,
                message,
                lambda s=stamp: (
                    self.found and self.states and read_time(self.states[-1].header.stamp) >= s
                ),
            )
        return self.states[-1]

    def health(self):
        count = len(self.probe.health)
        self.probe.spin_until(lambda: any(h.name == NAME for h in self.probe.health[count:]))
        return [h for h in self.probe.health if h.name == NAME][-1]


@pytest.fixture
def press(probe, start_node, tmp_path):
    """A function that starts the node and the machine that it hears."""

    def start(**parameters):
        given = {"scene": "press", **PATIENT, "reactions": "[all]", **parameters}
        file = parameter_file(tmp_path, given)
        node = start_node(arguments=("--params-file", str(file)), target=TARGET)
        node.wait_for(ACTIVE)
        machine = Press(probe)
        probe.spin_until(machine.publisher.get_subscription_count)
        probe.spin_until(lambda: probe.node.count_publishers(f"{NAME}/determination"))
        probe.meet(NAME)
        machine.begin = time.time_ns()
        return machine

    return start


def test_one_encoder_gives_all_joints_and_all_reactions(press):
    machine = press(measured="[crank]", disturbances=False)
    message = machine.go(60)
    x, system = machine.x, machine.simulation.system
    assert list(message.name) == list(JOINTS)
    np.testing.assert_allclose(message.position, x.q, rtol=0, atol=1e-9)
    np.testing.assert_allclose(message.velocity, x.v, rtol=0, atol=1e-8)
    now = system.evaluate(x, machine.torque)
    machine.probe.spin_until(lambda: len(machine.forces) == len(machine.states))
    np.testing.assert_allclose(machine.forces[-1].effort, now.lam, rtol=0, atol=1e-6)
    rows = ConstraintRows(system.layout.blocks, system.robot.model.nv)
    solver = JointReactions(machine.scene.robot, rows, (), system.loads.forces)
    expected = solver.solve(x, now.a, now.lam).local[0]
    machine.probe.spin_until(lambda: len(machine.reactions) == len(machine.states))
    found = machine.reactions[-1]
    force = found.wrench.force
    assert found.header.frame_id == "crank"
    np.testing.assert_allclose((force.x, force.y, force.z), expected[:3], rtol=0, atol=1e-6)


def test_the_motion_that_follows_is_predicted_on_request(press):
    machine = press(measured="[crank]", disturbances=False, horizon=0.2)
    refused = machine.probe.call(Trigger, f"{NAME}/predict", Trigger.Request())
    assert not refused.success and refused.message == "nothing is estimated yet"
    machine.go(40)
    answer = machine.probe.call(Trigger, f"{NAME}/predict", Trigger.Request())
    assert answer.success, answer.message
    machine.probe.spin_until(lambda: machine.predictions)
    prediction = machine.predictions[-1]
    assert len(prediction.points) == 20
    machine.go(40)
    np.testing.assert_allclose(prediction.points[-1].positions, machine.x.q, rtol=0, atol=1e-7)


def test_a_dead_centre_is_flagged_before_it_is_reached(press):
    """The rocker is measured; where it turns round it says nothing of the crank."""
    machine = press(measured="[rocker]", disturbances=False)
    signs = []
    for _ in range(120):
        machine.go(1)
        signs.append(math.copysign(1.0, machine.x.v[2]))
    machine.probe.spin_until(lambda: len(machine.found) == len(machine.states))
    numbers = np.array([message.data for message in machine.found])
    assert np.isfinite(numbers).all()
    turn = next(k for k in range(1, 120) if signs[k] != signs[k - 1])
    flagged = numbers[:, 3] > 0.0
    assert flagged[turn - 9 : turn].all() and not flagged[: turn - 12].any()
    assert (numbers[turn - 9 : turn, 2] <= 0.05).all()
    assert numbers[turn - 1, 0] > 5.0 * numbers[0, 0]


def test_a_joint_that_disagrees_is_an_alarm(press):
    machine = press(measured="[crank]", disturbances=False)
    machine.go(20, noise=1e-4)
    machine.go(20, noise=1e-4, offset=0.05)
    health = machine.health()
    assert health.level == WARN and "rocker: off by" in health.message


def test_a_fault_is_named(press):
    machine = press(
        measured="[crank]",
        hypotheses='["friction doubles: bearing.coulomb=0.4, bearing.viscous=0.1", '
        '"spring loses a fifth: spring.stiffness=3.2"]',
    )
    machine.go(100, noise=1e-4)
    x = machine.x
    faulty = machine.scene.with_({"bearing.coulomb": 0.4, "bearing.viscous": 0.1})
    machine.simulation = faulty.simulation()
    machine.y = machine.simulation.start(x, machine.torque)
    machine.torque = np.array([1.0])
    machine.go(240, noise=1e-4)
    assert "fault: friction doubles" in machine.health().message


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"measured": "[wheel]"}, "unknown joints wheel; accepted: crank, coupler, rocker"),
        ({"hypotheses": '["nothing"]'}, "accepted: <name>: <part>.<argument>=<number>"),
        ({"hypotheses": '["soft: spring.stifness=1.0"]'}, "stifness"),
    ],
)
def test_parameters_that_do_not_fit_are_named(start_node, tmp_path, parameters, said):
    file = parameter_file(tmp_path, {"scene": "press", **parameters})
    node = start_node(arguments=("--params-file", str(file)), target=TARGET)
    node.wait_for(said)
    assert "Traceback" not in node.log
