"""What `fuzz.nodes` fires at: every node with a scene, and a valid message for each input."""

from typing import Any, NamedTuple

import numpy as np
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, WrenchStamped
from nav_msgs.msg import Odometry
from places import ROOT
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import Marker, MarkerArray

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.scene.built_scene import Scene
from msg_adapters.joint_state import write_joint_state
from msg_adapters.markers import write_marker_places
from msg_adapters.time import write_clock, write_time

ROBOTS = ROOT / "config" / "robots"
LEG = ROBOTS / "prosthetic_leg.urdf"
STATES = "/joint_states"
JUDGED = {"timeout": 3600.0, "clock_tolerance": 1e6}
LAW = {"timeout": 60.0, "safe_ramp": 0.0, "clock_tolerance": 1e6}
LOCKED = {"lock_step": "true", "publish_clock": "true", "command_timeout": 1e6}
PRESS = (
    (ROOT / "config" / "scenes" / "press.yaml")
    .read_text()
    .replace("../robots", str(ROBOTS))
    .replace("dt: 1e-3", "dt: 5e-3")  # a fifth of the time
)
SENSING = """robot: {description_topic: robot_description}
external_wrenches: {push: {frame: foot}}
actuators: [{type: ideal, joints: [hip_flexion]}]
sensors:
  foot: {type: imu, frame: foot}
  shank: {type: pose, frame: shank}
  sole: {type: wrench, joint: ankle}
dt: 5e-3
"""
WALKING = "five_link_biped"
PAYLOAD = {**JUDGED, "cutoff": 20.0}
TORQUES = ("joint_torques", "constraint_forces")
ESTIMATES = ("joint_states", "deviations", "innovations")
PROJECTED = ("joint_states", "constraint_forces", "violation")
SHOWN = (STATES, "constraint_forces")


class Subject(NamedTuple):
    """A node under fire. Its inputs and outputs are those that it has in the graph.

    Attributes:
        node: Of `mbd_ros.nodes.table`.
        scene: Of `config/scenes`, or its text.
        parameters: Beside the scene.
        answers: Outputs with a message for each valid one, that answers it first; empty for a
            node that answers otherwise.
        asked: Inputs of the valid messages, relative ones below the node.
        silent: How many valid messages have no answer, while filters settle.
        description: URDF, where the scene takes it from the topic /robot_description.
    """

    node: str
    scene: str
    parameters: dict[str, Any]
    answers: tuple[str, ...]
    asked: tuple[str, ...] = (STATES,)
    silent: int = 0
    description: Any = None


def _controller(node: str, scene: str) -> Subject:
    return Subject(node, scene, LAW, ("commands", "state"))


SUBJECTS = {
    "inverse_arm": Subject("inverse_dynamics", "prosthetic_arm", JUDGED, TORQUES),
    "inverse_four_bar": Subject("inverse_dynamics", "controlled_four_bar", JUDGED, TORQUES),
    "inverse_clock": Subject(
        "inverse_dynamics", "arm7", {**JUDGED, "use_sim_time": "true"}, TORQUES[:1]
    ),
    "inverse_falling_leg": Subject(
        "inverse_dynamics",
        "leg_dropped",
        {**JUDGED, "stance": "minimum-norm", "power": "true"},
        ("joint_torques", "residual/base"),
        asked=("/odometry", STATES),
    ),
    "inverse_walker": Subject(
        "inverse_dynamics",
        WALKING,
        {**JUDGED, "stance": "minimum-norm", "phase_topic": "/phase"},
        TORQUES[:1],
        asked=("/phase", STATES),
    ),
    "inverse_leg": Subject(
        "inverse_dynamics",
        "prosthetic_leg_stance",
        JUDGED,
        TORQUES,
        asked=("/force_plate", STATES),
    ),
    "projector_arm": Subject("joint_state_projector", "prosthetic_arm", JUDGED, PROJECTED),
    "projector_four_bar": Subject("joint_state_projector", "four_bar_leg", JUDGED, PROJECTED),
    "sliding_arm": _controller("sliding_mode_controller", "controlled_arm"),
    "sliding_four_bar": _controller("sliding_mode_controller", "controlled_four_bar"),
    "qp_arm": _controller("qp_controller", "controlled_arm"),
    "qp_four_bar": _controller("qp_controller", "controlled_four_bar"),
    "simulator_four_bar": Subject(
        "simulator", "controlled_four_bar", LOCKED, SHOWN, asked=("commands",)
    ),
    "simulator_leg": Subject(
        "simulator",
        "prosthetic_leg_stance",
        {"publish_clock": "true", "pushed_links": "['*']"},
        (),
    ),
    "twin_press": Subject(
        "digital_twin",
        PRESS,
        {**JUDGED, "reactions": "[all]"},
        (*ESTIMATES, "constraint_forces", "determination", "reactions/crank"),
    ),
    "estimator_leg": Subject(
        "state_estimator",
        SENSING,
        {**JUDGED, "inputs": "commands"},
        ESTIMATES,
        description=LEG,
    ),
    "markers_leg": Subject(
        "marker_kinematics",
        "marked_leg",
        JUDGED,
        ("joint_states", "residuals"),
        asked=("/markers",),
    ),
    "payload_arm": Subject(
        "payload_estimator", "arm7", PAYLOAD, ("payload", "covariance"), silent=11
    ),
    "muscles_leg": Subject(
        "muscle_forces",
        "muscle_leg",
        {**JUDGED, "emg_use": "track", "reactions": "child"},
        ("muscle_forces", "activations", "reserve_forces"),
    ),
    "player_arm": Subject("reference_player", "controlled_arm", {"repeat": "false"}, ()),
    "view_leg": Subject("web_view", "prosthetic_leg_stance", {}, ()),
}


class Seeds:
    """Valid messages for the inputs of a node.

    Args:
        scene: Of the node.
        begin: Stamp of the first one [ns].
        step: Between two of them [ns].
    """

    def __init__(self, scene: Scene, begin: int, step: int) -> None:
        self.scene, self._begin, self._step = scene, begin, step
        self.joints = [joint.name for joint in scene.robot.joints]
        self.driven = [name for part in scene.actuators for name in part.joints]
        self._makers = {
            JointState: self._joint_state,
            Float64MultiArray: self._numbers,
            JointTrajectory: self._trajectory,
            WrenchStamped: self._stamped(WrenchStamped),
            Odometry: self._odometry,
            Imu: self._stamped(Imu),
            PoseStamped: self._pose,
            MarkerArray: self._markers,
            DiagnosticArray: self._diagnostics,
            String: lambda topic, k: String(data="step"),
            Clock: lambda topic, k: write_clock(Clock(), self.stamp(k)),
        }

    def of(self, kind: type, topic: str, k: int = 0) -> Any:
        """A valid message.

        Args:
            kind: Type of the message; an input of a type that is none of these is a KeyError.
            topic: Absolute.
            k: Number of the message: joints swing a little.
        """
        return self._makers[kind](topic, k)

    def stamp(self, k: int) -> int:
        """Of message k [ns]."""
        return self._begin + k * self._step

    def _swing(self, k: int) -> Any:
        q = self.scene.initial.q.copy()
        first = self.scene.robot.joints[0]
        q[first.q] += 0.05 * np.sin(0.3 * k)
        return q

    def _joint_state(self, topic: str, k: int) -> Any:
        if topic.endswith("joint_commands"):
            effort = np.full(len(self.driven), 0.1 * np.sin(0.3 * k))
            return write_joint_state(JointState(), self.stamp(k), self.driven, effort=effort)
        q = self._swing(k)[[joint.q for joint in self.scene.robot.joints]]
        values = {"position": q, "velocity": 0.0 * q, "effort": 0.0 * q}
        if topic.endswith("/reference"):
            del values["effort"]
        return write_joint_state(JointState(), self.stamp(k), self.joints, **values)

    def _numbers(self, topic: str, k: int) -> Any:
        if topic.endswith("/emg"):
            names = [muscle.name for muscle in self.scene.muscles]
            msg = Float64MultiArray(data=[0.1] * len(names))
            dims = [MultiArrayDimension(label=name, size=1, stride=1) for name in names]
            msg.layout.dim = dims
            return msg
        data = np.zeros(len(self.driven))
        data[:1] = 0.5 * np.sin(0.3 * k)
        return Float64MultiArray(data=data.tolist())

    def _trajectory(self, topic: str, k: int) -> Any:
        names = list(self.scene.controlled_joints().names)
        start = self.scene.controlled_joints().positions(self.scene.initial).tolist()
        msg = JointTrajectory(joint_names=names)
        write_time(msg.header.stamp, self.stamp(k))
        for i in range(1, 4):
            since = Duration(sec=i)
            zero = [0.0] * len(names)
            msg.points.append(
                JointTrajectoryPoint(positions=start, velocities=zero, time_from_start=since)
            )
        return msg

    def _stamped(self, kind: type) -> Any:
        """Makes messages of numbers that are 0, for whatever frame the node expects."""

        def make(topic: str, k: int) -> Any:
            msg = kind()
            write_time(msg.header.stamp, self.stamp(k))
            return msg

        return make

    def _pose(self, topic: str, k: int) -> Any:
        msg = PoseStamped()
        write_time(msg.header.stamp, self.stamp(k))
        msg.pose.orientation.w = 1.0
        return msg

    def _odometry(self, topic: str, k: int) -> Any:
        msg = Odometry()
        write_time(msg.header.stamp, self.stamp(k))
        msg.pose.pose.orientation.w = 1.0
        return msg

    def _markers(self, topic: str, k: int) -> Any:
        robot, q = self.scene.robot, self._swing(k)
        q[robot.joint("knee").q if "knee" in self.joints else 0] -= 0.6
        self.scene.couplings.expand(q, np.zeros(len(q)), np.zeros(len(q)))
        kinematics = Kinematics(robot)
        kinematics.refresh(q, np.zeros(robot.model.nv))
        seen = [sensor for sensor in self.scene.sensors if hasattr(sensor, "point")]
        places = np.array([kinematics.position(s.point) + robot.origin for s in seen])
        labels = [sensor.title for sensor in seen]
        return write_marker_places(
            MarkerArray(), self.stamp(k), labels, places.reshape(-1, 3), Marker
        )

    def _diagnostics(self, topic: str, k: int) -> Any:
        values = [KeyValue(key="real-time factor reached", value="1")]
        status = DiagnosticStatus(name="/other", message="fine", values=values)
        msg = DiagnosticArray(status=[status])
        write_time(msg.header.stamp, self.stamp(k))
        return msg
