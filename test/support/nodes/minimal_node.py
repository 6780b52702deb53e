"""The smallest node on the shell: answers each joint state, and fails in the ways asked for."""

import sys
from typing import Any

from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from mbd_ros.errors import DataError, SceneError
from mbd_ros.nodes.shell.parameters import Parameter
from mbd_ros.nodes.shell.process import run
from mbd_ros.nodes.shell.shell import Shell
from msg_adapters.diagnostics import OK

SENSOR = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)


class Minimal(Shell):
    """Echo with a safe command; the first joint name of a message chooses what happens."""

    NAME = "minimal"
    PARAMETERS = (
        Parameter("gain", float, "Gain [-].", 1.0, low=0.0, high=100.0, read_only=False),
        Parameter(
            "weights", list[float], "Weights [-].", (1.0, 2.0), low=0.0, length=2, read_only=False
        ),
        Parameter("joints", list[str], "Joints in order.", ()),
        Parameter("refuse", str, "Reason not to configure.", "", read_only=False),
        Parameter("reliable_input", bool, "Ask for reliable joint states.", False),
    )

    def configure_core(self) -> None:
        """Make the topics, unless told to refuse or to crash."""
        if self.parameters.refuse == "crash":
            raise ValueError("configure crashed")
        if self.parameters.refuse:
            raise SceneError(self.parameters.refuse)
        self.resets: list[str] = []
        self.tuned = "never"
        self.out = self.publish_to(JointState, "~/out", 10)
        self.safe_command = self.publish_to(String, "~/safe", 10)
        qos = 10 if self.parameters.reliable_input else SENSOR
        self.subscribe(JointState, "in", self.answer, qos, single_publisher=True)

    def answer(self, msg: Any) -> None:
        """Echo, or fail as named."""
        if msg.name:
            if msg.name[0] == "mbd_error":
                raise DataError("column 'knee' is empty")
            if msg.name[0] == "crash":
                raise ValueError("a bug")
            if msg.name[0] == "drop":
                self.drop("malformed", "joint_states: too short")
                return
        self.out.publish(msg)

    def retune(self, values: Any) -> None:
        """Note the new gain; 13 is refused by the core."""
        if values.gain == 13.0:
            raise DataError("gain 13 makes the filter unstable")
        self.tuned = f"{self.parameters.gain} -> {values.gain}"

    def reset(self, reason: str) -> None:
        """Note the reason."""
        self.resets.append(reason)

    def safe(self) -> None:
        """Say so."""
        self.safe_command.publish(String(data="safe"))

    def health(self) -> tuple[int, str, dict[str, str]]:
        """Everything the tests look at."""
        values = {key: str(value) for key, value in self.parameters._asdict().items()}
        return OK, "fine", {**values, "resets": "|".join(self.resets), "tuned": self.tuned}


if __name__ == "__main__":
    sys.exit(run(Minimal))
