"""The node `state_estimator` over DDS: what it makes of partial, noisy and disordered messages."""

import math
import time
from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from deadline import PATIENT
from geometry_msgs.msg import Vector3
from nodes.joint_stream import ACTIVE, MS, parameter_file
from nodes.simulation_client import DEEP
from places import ROOT
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray

from mbd_ros.api import load_scene
from mbd_ros.core.contracts import Now
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
        self.probe.spin_until(lambda: any(h.name == NAME for h in self.probe.health[count:]))
        return [h for h in self.probe.health if h.name == NAME][-1]


@pytest.fixture
def started(probe, start_node, tmp_path):
    """Starts the node and a machine that it hears."""

    def start(scene="four_bar_leg", **parameters):
        file = parameter_file(tmp_path, {"scene": scene, **PATIENT, **parameters})
        node = start_node(arguments=("--params-file", str(file)), target=TARGET)
        node.wait_for(ACTIVE)
        machine = Machine(probe, scene)
        probe.spin_until(machine.publisher.get_subscription_count)
        probe.spin_until(lambda: probe.node.count_publishers(f"{NAME}/joint_states"))
        probe.meet(NAME)
        machine.begin = time.time_ns()
        return machine

    return start


MEASURED = ("hip_flexion", "knee_anterior", "ankle")


def test_three_encoders_give_the_whole_of_a_four_bar_knee(started):
    machine = started(disturbances=False)
    for i in range(40):
        message = machine.ask(i, MEASURED)
    assert list(message.name) == machine.names
    assert machine.error(39, message) <= 1e-9
    assert machine.error(39, message, "velocity") <= 1e-6
    x = machine.simulation.system.expand(machine.at(39))
    forces = machine.simulation.system.evaluate(x, None).lam
    machine.probe.spin_until(lambda: len(machine.forces) == len(machine.states))
    np.testing.assert_allclose(machine.forces[-1].effort, forces, rtol=0, atol=1e-4)
    labels = [dimension.label for dimension in machine.innovations[-1].layout.dim]
    assert labels[:3] == [f"{name}.position" for name in machine.names[:3]]
    assert labels[-3:] == ["nis", "mean_nis", "correlation"]
    assert all(np.isfinite(m.data).all() for m in machine.innovations)


def test_dropouts_disorder_and_a_frozen_encoder_stay_bounded_and_are_named(started):
    machine, rng = started(), np.random.default_rng(1)
    order = [i for i in range(1, 150) if i % 3]  # a third is lost
    for k in range(4, 80, 9):
        order[k : k + 4] = [*order[k + 1 : k + 4], order[k]]  # 50 ms late
    frozen = None
    machine.ask(0, MEASURED, 1e-4 * rng.standard_normal(3))
    for i in order:
        noise = 1e-4 * rng.standard_normal(3)
        x = machine.simulation.system.expand(machine.at(i))
        at = machine.scene.robot.joint("hip_flexion").q
        if 30 <= i < 60:
            frozen = x.q[at] + noise[0] if frozen is None else frozen
            noise[0] = frozen - x.q[at]
        machine.send(i, MEASURED, noise)
        if i == 59:
            assert machine.probe.wait_health(is_frozen).level == WARN
    machine.probe.spin_until(
        lambda: read_time(machine.states[-1].header.stamp) >= machine.begin + 149 * STEP
    )
    stamps = [read_time(message.header.stamp) for message in machine.states]
    assert stamps == sorted(set(stamps))
    errors = [
        machine.error(round((s - machine.begin) / STEP), m)
        for s, m in zip(stamps, machine.states, strict=True)
    ]
    assert max(errors[5:]) < 0.3 and errors[-1] < 3e-3


def test_estimates_wait_for_the_lag(started):
    """The estimate of a sample comes 50 ms later, with its own stamp: five samples."""
    machine, rng = started(lag=0.05), np.random.default_rng(3)
    for i in range(60):
        machine.send(i, MEASURED, 1e-4 * rng.standard_normal(3))
    machine.probe.spin_until(lambda: len(machine.states) == 55)
    stamps = [read_time(message.header.stamp) for message in machine.states]
    assert stamps == [machine.begin + i * STEP for i in range(55)]
    errors = [machine.error(i, message) for i, message in enumerate(machine.states)]
    assert max(errors) < 1e-3
    assert machine.health().level == OK


def is_frozen(health):
    return health.name == NAME and "hip_flexion.position: frozen" in health.message


def imu(stamp, values, frame):
    message = Imu(
        angular_velocity=Vector3(x=values[0], y=values[1], z=values[2]),
        linear_acceleration=Vector3(x=values[3], y=values[4], z=values[5]),
    )
    write_time(message.header.stamp, stamp)
    message.header.frame_id = frame
    return message


def test_an_imu_is_heard_beside_an_encoder(started, tmp_path):
    """The IMU on the foot says how the ankle moves, which no encoder measures."""
    scene = tmp_path / "leg.yaml"
    scene.write_text(
        "robot: {urdf: package://mbd_ros/config/robots/prosthetic_leg.urdf, "
        "locked: {knee: -0.4, knee_slide_x: 0.0, knee_slide_y: 0.0}}\n"
        "sensors: {foot: {type: imu, frame: foot}}\n"
    )
    machine = started(str(scene), disturbances=False)
    sensor, simulation = machine.scene.sensors[0], machine.simulation
    publisher = machine.probe.node.create_publisher(Imu, f"{NAME}/imu/foot", DEEP)
    machine.probe.spin_until(publisher.get_subscription_count)
    system = simulation.system
    for i in range(100):
        machine.ask(i, ("hip_flexion",))
        x = system.expand(machine.at(i))
        found = system.evaluate(x, None)
        system.k.refresh(x.q, x.v)
        values = sensor.measure(system.k, x, Now(found.a, found.lam)).tolist()
        publisher.publish(imu(machine.begin + i * STEP, values, "foot"))
    machine.probe.spin_until(lambda: len(machine.states) == 200)
    assert machine.error(99, machine.states[-1]) < 0.02
    count = len(machine.states)
    publisher.publish(imu(machine.begin + 100 * STEP, values, "shank"))
    publisher.publish(imu(machine.begin + 100 * STEP, [math.nan] * 6, "foot"))
    machine.probe.state(NAME)  # handled
    assert len(machine.states) == count


def test_unknown_numbers_and_the_covariance_are_published_on_request(started):
    known = ["foot.payload=0.1", "ankle.position.offset=0.01"]
    given = {"parameters": known, "covariance": True, "disturbances": False}
    told = {}
    machine = started(**given)
    create = machine.probe.node.create_subscription
    kept = [
        create(Float64MultiArray, f"{NAME}/{topic}", partial(told.__setitem__, topic), DEEP)
        for topic in ("parameters", "covariance", "deviations")
    ]
    machine.probe.spin_until(lambda: machine.probe.node.count_publishers(f"{NAME}/covariance"))
    machine.probe.meet(NAME)
    for i in range(10):
        machine.ask(i, MEASURED)
    machine.probe.spin_until(lambda: len(told) == len(kept))
    assert machine.health().level == OK
    names = [dimension.label for dimension in told["parameters"].layout.dim]
    unknown = ["foot.payload", "ankle.position.offset"]
    assert names == [*unknown, *(f"{name}.deviation" for name in unknown)]
    rows, columns = told["covariance"].layout.dim
    labels = [dimension.label for dimension in told["deviations"].layout.dim]
    assert rows.label.split(",") == columns.label.split(",") == labels
    assert labels[-2:] == unknown and rows.size == columns.stride == len(labels)
    P = np.reshape(told["covariance"].data, (rows.size, columns.size))
    np.testing.assert_allclose(np.sqrt(P.diagonal()), told["deviations"].data, atol=1e-9)
    np.testing.assert_allclose(told["parameters"].data[2:], told["deviations"].data[-2:])
    np.testing.assert_allclose(P, P.T, atol=1e-12)


def test_an_overrun_never_blocks_and_is_flagged(started):
    """No time at all for the horizon: every answer still comes, by the filter alone."""
    given = {"estimator": "moving_horizon", "deadline": 0.0}
    machine = started(disturbances=False, **given)
    x, robot = machine.simulation.system.expand(machine.at(0)), machine.scene.robot
    position = np.array([x.q[robot.joint(name).q] for name in MEASURED])
    for i in range(60):
        stamp = machine.begin + i * MS // 10
        message = write_joint_state(JointState(), stamp, MEASURED, position=position)
        machine.publisher.publish(message)
    machine.probe.spin_until(lambda: len(machine.states) == 60)
    health = machine.health()
    assert health.level == WARN and "late: filter alone" in health.message
    assert machine.error(0, machine.states[-1]) < 0.01


def test_what_the_sensors_of_a_simulator_tell_is_heard(probe, start_node, tmp_path):
    """Simulator and estimator at 200 Hz, with noise and a delay: all joints are estimated.

    In simulated time: where the machine has too much to do, stamps still fit the motion.
    """
    scene = tmp_path / "press.yaml"
    text = (ROOT / "config/scenes/press.yaml").read_text(encoding="utf-8")
    text = text.replace("../robots", "package://mbd_ros/config/robots").replace(
        "noise: 1.0e-4}", "noise: 1.0e-4, delay: 0.02}"
    )
    text = text.replace("actuators:\n- {type: ideal, joints: [crank], limit: 5.0}\n", "")
    scene.write_text(text, encoding="utf-8")
    exact, measured, answers, waits = {}, {}, {}, []

    def heard(kept, message):
        kept[read_time(message.header.stamp)] = np.array(message.position)

    def take(message):
        heard(measured, message)
        if exact:
            waits.append(max(exact) - read_time(message.header.stamp))

    def errors(of):
        return [np.abs(of[stamp] - exact[stamp]).max() for stamp in sorted(of.keys() & exact)]

    create = probe.node.create_subscription
    kept = [
        create(JointState, "/simulator/measured_joint_states", take, DEEP),
        create(JointState, "/joint_states", partial(heard, exact), DEEP),
        create(JointState, f"{NAME}/joint_states", partial(heard, answers), DEEP),
    ]
    given = {"scene": str(scene), "inputs": "none", "memory": 0.5}
    given["use_sim_time"] = "true"
    file = parameter_file(tmp_path, {**given, **PATIENT})
    remap = ("-r", "joint_states:=/simulator/measured_joint_states")
    start_node(arguments=("--params-file", str(file), *remap), target=TARGET).wait_for(ACTIVE)
    given = {"scene": str(scene), "rate": 200.0, "seed": 3, "publish_clock": "true"}
    file = parameter_file(tmp_path, given)
    target = ("-m", "mbd_ros.nodes", "simulator")
    start_node(arguments=("--params-file", str(file)), target=target).wait_for(ACTIVE)
    probe.spin_until(lambda: len(answers.keys() & exact) > 300)
    noise = [measured[stamp][0] - exact[stamp][0] for stamp in measured.keys() & exact]
    assert 0.7e-4 < np.std(noise) < 1.4e-4
    assert np.median(waits) >= 15 * MS
    assert max(errors(answers)[100:]) < 2e-3
    assert len(kept) == 3


@pytest.mark.soak
@pytest.mark.timeout(900)
@pytest.mark.parametrize("estimator", ["extended_kalman", "moving_horizon"])
def test_ten_minutes_at_500_hz(probe, start_node, tmp_path, estimator):
    """The 7-joint arm within its limits: nothing is lost, nothing grows, errors stay small."""
    scene, seconds, rate = load_scene("arm7"), 600 if estimator == "extended_kalman" else 60, 500
    given = {"scene": "arm7", "estimator": estimator}
    file = parameter_file(tmp_path, {**given, **PATIENT})
    node = start_node(arguments=("--params-file", str(file)), target=TARGET)
    node.wait_for(ACTIVE)
    worst, count, begin = np.zeros(2), 0, time.time_ns()
    names = [joint.name for joint in scene.robot.joints]
    w, model = 2.0 * np.pi * np.linspace(0.1, 0.3, 7), scene.robot.model
    data, rng = model.createData(), np.random.default_rng(5)

    def motion(t):
        return 0.8 * np.sin(w * t), 0.8 * w * np.cos(w * t), -0.8 * w * w * np.sin(w * t)

    def take(message):
        nonlocal count
        count += 1
        t = (read_time(message.header.stamp) - begin) * 1e-9
        if t > 5.0:
            q, v, _ = motion(t)
            off = np.abs(message.position - q).max(), np.abs(message.velocity - v).max()
            np.maximum(worst, off, out=worst)

    create = probe.node.create_subscription
    kept = create(JointState, f"{NAME}/joint_states", take, DEEP)
    publisher = probe.node.create_publisher(JointState, "/joint_states", DEEP)
    probe.spin_until(publisher.get_subscription_count)
    probe.spin_until(lambda: probe.node.count_publishers(f"{NAME}/joint_states"))
    begin, sent = time.time_ns(), 0
    cpu = node.cpu_seconds()
    while sent < seconds * rate:
        due = min((time.time_ns() - begin) * rate // 1_000_000_000, seconds * rate)
        for k in range(sent, due):
            t = k / rate
            tau = np.array(pin.rnea(model, data, *motion(t - 0.5 / rate)))
            position = motion(t)[0] + 1e-4 * rng.standard_normal(7)
            stamp = begin + round(k * 1e9 / rate)
            message = write_joint_state(JointState(), stamp, names, position=position, effort=tau)
            publisher.publish(message)
        sent = max(sent, due)
        probe.spin_for(0.001)
    probe.spin_for(1.0)
    spent = 1e3 * (node.cpu_seconds() - cpu) / sent
    told = f"{count} of {sent} answered, {spent:.3f} ms of CPU each, worst {worst}"
    assert kept is not None and count >= 0.999 * sent, told
    assert worst[0] < 1e-3 and worst[1] < 0.3, told
    assert spent < {"extended_kalman": 1.5, "moving_horizon": 6.0}[estimator], told
