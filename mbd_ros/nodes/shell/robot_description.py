"""The topic with the robot description that a scene may wait for."""

from collections.abc import Callable
from contextlib import suppress
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription
from std_msgs.msg import String

from mbd_ros.errors import MbdError
from mbd_ros.nodes.shell.shell import Shell
from mbd_ros.scene.reader import description_topic
from mbd_ros.scene.schema.code_permission import permitting

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class RobotDescription:
    """Builds what a node makes of its scene, once the robot description is there.

    Where the scene names a topic for its robot, the node starts with the first description that
    comes on it; a later one replaces the robot whole or is refused.

    Args:
        node: The node. Its parameters must hold scene and allow_code.
        build: Replaces the scene and what was built from it, or raises an MbdError and keeps it.
            It is given the URDF, or None where the scene has its robot.
        replace: Takes the URDF of another robot while the node is configured, or raises an
            MbdError and keeps the old one; `build` if omitted.

    Attributes:
        urdf: The newest description; None before the first, or where no topic has it.
        is_built: Whether `build` ever succeeded.
    """

    def __init__(
        self,
        node: Shell,
        build: Callable[[str | None], None],
        replace: Callable[[str], None] | None = None,
    ) -> None:
        self._node = node
        self._build = build
        self._replace = replace or build
        self.is_built = False
        self.urdf: str | None = None
        self._topic: str | None = None
        self._subscription: Subscription | None = None
        self._listen(node.parameters.scene)

    def build(self) -> None:
        """Build; for `configure_core`.

        Raises:
            MbdError: The description has not come yet, or the scene cannot be built.
        """
        if self._topic is not None and self.urdf is None:
            raise MbdError(f"waiting for the robot description on {self._topic}")
        with permitting(self._node.parameters.allow_code):
            self._build(self.urdf)
        self.is_built = True

    def follow(self, values: Any) -> None:
        """Listen for the robot of another scene; for `prepare`."""
        if values.scene != self._node.parameters.scene:
            self._listen(values.scene)

    def _listen(self, scene: str | None) -> None:
        topic = None
        if scene:
            with suppress(MbdError):  # `build` says it
                topic = description_topic(scene)
        if topic == self._topic:
            return
        if self._subscription is not None:
            self._node.unsubscribe(self._subscription)
        self._topic = topic
        self.urdf = None
        self._subscription = None
        if topic is not None:
            self._subscription = self._node.subscribe(
                String, topic, self._take, LATCHED, always=True
            )

    def _take(self, msg: Any) -> None:
        node = self._node
        if not self.is_built or not node.configured:
            self.urdf = msg.data
            node.try_start()
            return
        if msg.data == self.urdf:
            return  # its publisher came back
        try:
            with permitting(node.parameters.allow_code):
                self._replace(msg.data)
        except MbdError as error:
            node.drop("robot_description", f"new robot description refused: {error}")
            return
        self.urdf = msg.data
        node.get_logger().info("new robot description in use")
