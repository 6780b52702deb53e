"""A node made from a scene, whose robot description may come on a topic."""

from collections.abc import Sequence
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


class SceneNode(Shell):
    """Builds a scene, once its robot description is there.

    Subclasses override `build` and may override `replace`. Parameters must hold scene and
    allow_code.
    """

    def __init__(self, argv: Sequence[str] = ()) -> None:
        super().__init__(argv)
        self.is_built = False
        self._description: str | None = None
        self._description_topic: str | None = None
        self._descriptions: Subscription | None = None
        self._listen_for_description(self.parameters.scene)

    def build(self, description: str | None) -> None:
        """Replace the scene and what was built from it, or raise an MbdError and keep it.

        Args:
            description: URDF, where the scene takes it from a topic.
        """
        raise NotImplementedError

    def replace(self, description: str) -> None:
        """Take another robot while configured, or raise an MbdError and keep the old one."""
        self.build(description)

    def configure_core(self) -> None:
        """Build."""
        if self._description_topic is not None and self._description is None:
            raise MbdError(f"waiting for the robot description on {self._description_topic}")
        with permitting(self.parameters.allow_code):
            self.build(self._description)
        self.is_built = True

    def prepare(self, values: Any) -> None:
        """Listen for the robot of another scene."""
        if values.scene != self.parameters.scene:
            self._listen_for_description(values.scene)

    def _listen_for_description(self, scene: str | None) -> None:
        topic = None
        if scene:
            with suppress(MbdError):  # configure_core says it
                topic = description_topic(scene)
        if topic == self._description_topic:
            return
        if self._descriptions is not None:
            self.unsubscribe(self._descriptions)
        self._description_topic, self._description, self._descriptions = topic, None, None
        if topic is not None:
            take = self._on_description
            self._descriptions = self.subscribe(String, topic, take, LATCHED, always=True)

    def _on_description(self, msg: Any) -> None:
        """Start with the first description; a later one replaces the robot whole or is refused."""
        if not self.is_built or not self.configured:
            self._description = msg.data
            self.try_start()
            return
        if msg.data == self._description:
            return  # its publisher came back
        try:
            with permitting(self.parameters.allow_code):
                self.replace(msg.data)
        except MbdError as error:
            self.drop("robot_description", f"new robot description refused: {error}")
            return
        self._description = msg.data
        self.get_logger().info("new robot description in use")
