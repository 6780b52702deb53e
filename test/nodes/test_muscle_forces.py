"""The node `muscle_forces` over DDS: the solver's numbers by name, bad input, its pace."""

import numpy as np
import pytest
import yaml
from deadline import PATIENT
from geometry_msgs.msg import WrenchStamped
from muscle_arm import NAMES, SCENE, URDF
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from mbd_ros.features.muscles.task import muscles_task
from mbd_ros.scene.reader import load_scene
from msg_adapters.time import read_time

NODE = "/muscle_forces"
JOINTS = ["shoulder", "elbow"]
STEP = 5_000_000  # ns


class Arm:
    """A running node, what it says, and the scene that it runs."""

    def __init__(self, start_node, probe, folder, scene=SCENE, **parameters):
        (folder / "arm.urdf").write_text(URDF)
        path = folder / "arm.yaml"
        path.write_text(yaml.safe_dump({"robot": {"urdf": "arm.urdf"}, **scene}))
        given = {"scene": str(path), **PATIENT, **parameters}
        self.scene, self.probe = load_scene(path), probe
        self.process = start_node(
            yaml.safe_dump({NODE: {"ros__parameters": given}}),
            target=("-m", "mbd_ros.nodes", "muscle_forces"),
        )
        self.forces, self.activations, self.reserves, self.loads = [], [], [], []
        own = probe.node.create_subscription
        own(JointState, f"{NODE}/muscle_forces", self.forces.append, 500)
        own(Float64MultiArray, f"{NODE}/activations", self.activations.append, 500)
        own(JointState, f"{NODE}/reserve_forces", self.reserves.append, 500)
        own(WrenchStamped, f"{NODE}/joint_loads/lower", self.loads.append, 500)
        self._states = probe.node.create_publisher(JointState, "/joint_states", 500)
        self._emg = probe.node.create_publisher(Float64MultiArray, f"{NODE}/emg", 10)
        self.process.wait_for("]: active")
        probe.spin_until(self._states.get_subscription_count)
        probe.meet(NODE)
        self.begin = int(probe.node.get_clock().now().nanoseconds)

    def send(self, k, position, velocity):
        """Sample k; speeds are given, accelerations are the derivatives of the filter."""
        message = JointState(name=JOINTS, position=list(position), velocity=list(velocity))
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(self.begin + k * STEP, 10**9)
        self._states.publish(message)

    def measure(self, **activations):
        """Activations on ~/emg."""
        message = Float64MultiArray(data=list(activations.values()))
        dims = [MultiArrayDimension(label=name, size=1, stride=1) for name in activations]
        message.layout.dim = dims
        self._emg.publish(message)

    def held(self, count, position):
        """Answers to a pose that is held still."""
        for k in range(count):
            self.send(k, position, [0.0, 0.0])
        self.probe.spin_until(lambda: len(self.forces) >= count)
        return self.forces[count - 1]

    def expected(self, position, **options):
        """Shares of the same pose, by the solver."""
        task = muscles_task(self.scene, {"reserves": 1.0, **options}, "test")
        z, still = np.array([position]), np.zeros((1, 2))
        return task.solver(self.scene).solve(np.zeros(1), z, still, still)


def dropped(arm, reason):
    health = [h for h in arm.probe.health if h.name == NODE]
    return int(health[-1].values.get(f"dropped.{reason}", 0)) if health else 0


def test_answers_are_the_numbers_of_the_solver_by_name(start_node, probe, tmp_path):
    arm = Arm(start_node, probe, tmp_path, reactions="child", links=["lower"])
    pose = [0.5, -0.7]
    answer, shares = arm.held(20, pose), arm.expected(pose)
    probe.spin_until(lambda: min(map(len, (arm.activations, arm.reserves, arm.loads))) >= 20)
    assert list(answer.name) == NAMES
    assert read_time(answer.header.stamp) == arm.begin + 19 * STEP
    assert answer.effort == pytest.approx(shares.force[0], rel=1e-6)
    assert answer.position == pytest.approx(shares.frames.length[0], abs=1e-9)
    assert answer.velocity == pytest.approx(np.zeros(6), abs=1e-6)
    activations = arm.activations[19]
    assert [dimension.label for dimension in activations.layout.dim] == NAMES
    assert activations.data == pytest.approx(shares.activation[0], abs=1e-7)
    assert list(arm.reserves[19].name) == ["shoulder_reserve", "elbow_reserve"]
    assert arm.reserves[19].effort == pytest.approx(shares.reserve[0], abs=1e-6)
    load = arm.loads[19]
    table = load_of(arm, pose, shares)
    force = load.wrench.force
    assert [force.x, force.y, force.z] == pytest.approx(table[:3], abs=1e-4)
    assert load.header.frame_id == "lower"
    health = probe.wait_health(lambda h: h.name == NODE and h.level == b"\0"[0])
    assert health.message == "muscle forces published"
    assert health.values["shared by"] == "activation, exponent 2"
    assert health.values["passive force"] == "left out"


def load_of(arm, pose, shares):
    from mbd_ros.core.state import State

    task = muscles_task(arm.scene, {"reserves": 1.0, "reactions": "child"}, "test")
    loads, still = task.loads(arm.scene), np.zeros(2)
    x = State(0.0, np.array(pose), still)
    total, _ = loads.solve(x, still, shares.force[0], shares.reserve[0])
    return total[[one.link for one in loads.joint_links].index("lower")]


def test_measured_activations_are_a_lower_bound_while_they_stand(start_node, probe, tmp_path):
    arm = Arm(start_node, probe, tmp_path, emg_use="least", emg_max_age=PATIENT["timeout"])
    arm.measure(flexor=0.4, extensor=0.3, unknown=0.1)
    arm.measure(flexor=2.0)  # refused
    probe.wait_health(lambda h: h.name == NODE and dropped(arm, "emg") == 1)
    answer = arm.held(5, [0.2, -0.2])
    probe.spin_until(lambda: len(arm.activations) >= 5)
    found = dict(zip(answer.name, arm.activations[4].data, strict=True))
    assert found["flexor"] >= 0.4 - 1e-9
    assert found["extensor"] >= 0.3 - 1e-9
    assert found["front"] < 0.3


def test_a_motion_beyond_the_muscles_is_dropped_with_what_lacks(start_node, probe, tmp_path):
    weak = {**SCENE, "muscles": [{**m, "max_isometric_force": 1.0} for m in SCENE["muscles"]]}
    arm = Arm(start_node, probe, tmp_path, scene=weak, reserves=0.0)
    for k in range(5):
        arm.send(k, [1.0, 0.3], [0.0, 0.0])
    health = probe.wait_health(lambda h: h.name == NODE and dropped(arm, "unsolved") >= 5)
    assert "muscles and reserves cannot produce the motion: shoulder lacks" in health.message
    assert not arm.forces


def test_a_scene_without_muscles_is_refused(start_node, probe, tmp_path):
    (tmp_path / "arm.urdf").write_text(URDF)
    path = tmp_path / "arm.yaml"
    path.write_text("robot: {urdf: arm.urdf}\n")
    text = yaml.safe_dump({NODE: {"ros__parameters": {"scene": str(path)}}})
    node = start_node(text, target=("-m", "mbd_ros.nodes", "muscle_forces"))
    node.wait_for("the scene has no muscles")
    assert node.stop() == 0
