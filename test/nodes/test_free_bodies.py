"""A free-flying arm over DDS: the simulator publishes odometry, inverse dynamics reads it."""

import sys
from functools import partial

import numpy as np
import pytest
from deadline import PATIENT
from geometry_msgs.msg import WrenchStamped
from mechanisms import floating_body
from nav_msgs.msg import Odometry
from nodes.joint_stream import ACTIVE, parameter_file
from nodes.node_process import NodeProcess
from nodes.simulation_client import DEEP, simulated
from sensor_msgs.msg import JointState

from mbd_ros.features.inverse_dynamics.job import inverse
from mbd_ros.features.simulation.job import simulate
from mbd_ros.files.body_columns import POSE, TWIST, names_of
from mbd_ros.files.table import Column, Result, Table
from mbd_ros.scene.reader import load_scene
from msg_adapters.joint_state import read_joint_state
from msg_adapters.pose import read_odometry
from msg_adapters.time import read_time
from msg_adapters.wrench import read_wrench

TARGET = ("-m", "mbd_ros.nodes", "inverse_dynamics")
JOINTS = ("left_swing", "right_slide")
TICK, TICKS, CUTOFF = 1e-3, 60, 20.0
MORE = f"""robot: {{base: floating, urdf: %s}}
dt: 0.001
integrator: {{type: rk4}}
actuators: [{{type: ideal, joints: [{", ".join(JOINTS)}]}}]
bodies:
  box: {{shape: {{box: [0.1, 0.3, 0.5]}}, mass: 2.0, pose: {{xyz: [1.0, 0.0, 2.0]}}}}
  ball: {{shape: {{sphere: 0.1}}, mass: 1.0}}
initial:
  velocity: {{left_swing: 2.0}}
  twist: {{box: {{linear: [0.1, 0.2, 0.3], angular: [3.0, -1.0, 0.5]}}}}
"""
BODIES = {
    "base": ("/odometry", "trunk"),
    "box": ("/box/odometry", "box"),
    "ball": ("/ball/odometry", "ball"),
}


def commands(k):
    return np.array([2.0 * np.sin(20.0 * k * TICK), np.cos(30.0 * k * TICK)])


class Answers:
    """What both nodes publish, by stamp."""

    def __init__(self, probe):
        self.poses, self.torques = {name: {} for name in BODIES}, {}
        self.wrenches = {name: {} for name in BODIES}
        create, node = probe.node.create_subscription, "/inverse_dynamics"
        self._kept = [
            create(JointState, f"{node}/joint_torques", self._torque, DEEP),
        ]
        for name, (topic, _) in BODIES.items():
            take, of = partial(self._pose, name), f"{node}/residual/{name}"
            self._kept.append(create(Odometry, topic, take, DEEP))
            self._kept.append(create(WrenchStamped, of, partial(self._wrench, name), DEEP))
        probe.spin_until(lambda: all(one.get_publisher_count() for one in self._kept))

    def clear(self):
        for each in (*self.poses.values(), self.torques, *self.wrenches.values()):
            each.clear()

    def has(self, count):
        """Whether so many samples are answered."""
        every = (*self.poses.values(), self.torques, *self.wrenches.values())
        return all(len(each) >= count for each in every)

    def _pose(self, name, message):
        frames = message.header.frame_id, message.child_frame_id
        assert frames == ("world", BODIES[name][1])
        sample = read_odometry(message)
        self.poses[name][sample.stamp] = np.concatenate((sample.pose, sample.twist))

    def _torque(self, message):
        assert tuple(message.name) == JOINTS
        self.torques[read_time(message.header.stamp)] = read_joint_state(message)

    def _wrench(self, name, message):
        sample = read_wrench(message)
        assert sample.frame_id == BODIES[name][1]
        self.wrenches[name][sample.stamp] = sample.wrench


def live(domain, folder, text):
    """Poses of the simulator and answers of inverse dynamics, under commands in lock step."""
    options = {"lock_step": "true", "publish_clock": "true"}
    with simulated(domain, folder, text, **options) as client:
        (own := folder / "inverse").mkdir()
        tuned = {"use_sim_time": "true", "cutoff": CUTOFF, **PATIENT}
        file = parameter_file(own, {"scene": folder / "local.yaml", **tuned})
        words = [*TARGET, "--ros-args", "--params-file", str(file)]
        node = NodeProcess([sys.executable, *words], domain)
        try:
            node.wait_for(ACTIVE)
            answers = Answers(client.probe)
            client.repeat(client.reset, lambda: answers.has(1))
            client.settle()
            answers.clear()
            for k in range(TICKS):
                client.command(commands(k))
                client.probe.spin_until(lambda k=k: answers.has(k + 1))
            told = client.probe.wait_health(lambda h: "topics not heard" in h.values)
            assert told.values["topics not heard"] == "none"
            assert node.stop() == 0
        finally:
            if node.process.poll() is None:
                node.process.kill()
                node.wait()
    return answers


def test_live_is_offline_to_the_bit_and_inverse_dynamics_hears_the_base(domain, tmp_path):
    (tmp_path / "robot.urdf").write_text(floating_body(), encoding="utf-8")
    text = MORE % (tmp_path / "robot.urdf")
    (tmp_path / "local.yaml").write_text(text, encoding="utf-8")
    answers = live(domain, tmp_path, text)
    scene, times = load_scene(tmp_path / "local.yaml"), np.arange(TICKS) * TICK
    told = zip(JOINTS, np.array([commands(k) for k in range(TICKS)]).T, strict=True)
    columns = [Column("time", times), *(Column(f"{name}.command", u) for name, u in told)]
    run = simulate(scene, TICKS * TICK, efforts=Result({"samples": Table(columns)}))
    stamps = [(k + 1) * 1_000_000 for k in range(TICKS)]
    for body, poses in answers.poses.items():
        names = [*names_of(body, POSE), *names_of(body, TWIST)]
        offline = np.column_stack([run["samples"][name] for name in names])
        np.testing.assert_array_equal([poses[stamp] for stamp in stamps], offline[1:])
    run.to(tmp_path / "bag")
    found = inverse(scene, tmp_path / "bag", derivatives="causal", cutoff=CUTOFF)["samples"]
    for stamp, row in zip(stamps, range(1, TICKS + 1), strict=True):
        torque = [found[f"{name}.effort"][row] for name in JOINTS]
        assert answers.torques[stamp].effort == pytest.approx(torque, abs=1e-9)
        for body, wrenches in answers.wrenches.items():
            parts = [f"{body}.residual.{w}_{x}" for w in ("force", "torque") for x in "xyz"]
            root = [found[part][row] for part in parts]
            assert wrenches[stamp] == pytest.approx(root, abs=1e-9)
