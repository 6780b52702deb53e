"""Wrenches and references that a page sends to one robot."""

from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.points import Point
from mbd_ros.core.state import Array
from mbd_ros.nodes.shell.shell import Shell
from mbd_ros.scene.built_scene import Scene
from mbd_ros.view.live_robot import Pulled
from msg_adapters.errors import MessageError
from msg_adapters.joint_state_cdr import JointStateCdrWriter
from msg_adapters.wrench import write_wrench

_REFERENCE = "/reference"
_DEPTH = 10
_TIMES = 2  # that a reference is sent
_AGAIN = 1.0  # s in between


class Leading:
    """Pulls links and leads joints of one robot.

    A link that an external load of the scene acts on is pulled by that load; any other one by
    `~/push` of the simulator.

    Args:
        node: The sending node.
        within: Name of a topic in the namespace of the robot.
        tell: Is told why nothing happens.
    """

    def __init__(
        self,
        node: Shell,
        within: Callable[[str], str],
        scene: Scene,
        values: Any,
        tell: Callable[[str], None],
    ) -> None:
        self._node = node
        self._within = within
        self._tell = tell
        self._robot = scene.robot
        self._values = values
        simulator, points = values.simulator, scene.robot.places.points
        self._push = node.publish_to(WrenchStamped, within(f"{simulator}/push"), _DEPTH)
        self._loads: dict[int, tuple[Publisher, Point, str]] = {}
        for wrench in scene.wrenches.values():
            topic = within(wrench.heard_on.replace("~/", f"{simulator}/", 1))
            publisher = node.publish_to(WrenchStamped, topic, _DEPTH)
            joint = points[wrench.carrier.number].joint
            self._loads[joint] = publisher, wrench.about, wrench.expressed_in
        self._joints = _led(scene)
        self._at = [scene.robot.joint(name).q for name in self._joints]
        self._writer = JointStateCdrWriter(self._joints, ("position",))
        self._reference: Publisher | None = None
        self._posture = np.zeros(0)
        self._left = 0
        self._due = 0.0
        self._last: tuple[Publisher, str] | None = None

    def pull(self, pulled: Pulled, k: Kinematics) -> None:
        """Send the force of the mouse.

        Args:
            pulled: The force.
            k: Kinematics at positions.
        """
        push = self._push, self._robot.point(pulled.link), pulled.link
        publisher, about, frame = self._loads.get(pulled.joint, push)
        if not publisher.get_subscription_count():
            topic = self._node.resolve_topic_name(publisher.topic_name)
            asked = ": start the simulator with pushed_links" if publisher is self._push else ""
            self._tell(f"nobody hears {topic}{asked}")
            return
        axes, lever = k.rotation(about).T, pulled.place - k.position(about)
        force = axes @ pulled.force
        wrench = np.concatenate((force, np.cross(axes @ lever, force)))
        self._send(publisher, frame, wrench)
        self._last = publisher, frame

    def let_go(self) -> None:
        """Send that the force ended, once."""
        if self._last is not None:
            self._send(*self._last, np.zeros(6))
            self._last = None

    def lead(self, q: Array) -> None:
        """Send a configuration, shape (nq,), as reference, once its listener is known."""
        topic = self._found()
        if topic is None:
            return
        if self._reference is None or self._reference.topic_name != topic:
            self._reference = self._node.publish_to(JointState, topic, _DEPTH)
        self._posture = q[self._at]
        self._left = _TIMES
        self._due = 0.0

    def tend(self) -> None:
        """Send what is to be sent now.

        A new writer and its reader get to know each other at different times: the last reference
        is sent again.
        """
        reference, now = self._reference, perf_counter()
        if reference is None or not self._left or now < self._due:
            return
        if not reference.get_subscription_count():
            return
        self._left, self._due = self._left - 1, now + _AGAIN
        stamp = self._node.get_clock().now().nanoseconds
        try:
            reference.publish(self._writer.write(stamp, position=self._posture))
        except MessageError as error:
            self._tell(f"target: {error}")

    def _send(self, publisher: Publisher, frame: str, wrench: Array) -> None:
        stamp = self._node.get_clock().now().nanoseconds
        if not np.isfinite(wrench).all():
            return
        try:
            publisher.publish(write_wrench(WrenchStamped(), stamp, frame, wrench))
        except MessageError as error:
            self._tell(f"pull: {error}")

    def _found(self) -> str | None:
        """The topic of references: that of the parameter, or the only one there is."""
        named = self._values.controller
        if named:
            return str(self._node.resolve_topic_name(self._within(named + _REFERENCE)))
        space = self._node.resolve_topic_name(self._within("x"))[:-1]
        kinds = self._node.get_topic_names_and_types()
        found = [
            name
            for name, types in kinds
            if "sensor_msgs/msg/JointState" in types
            and name.startswith(space)
            and name.count("/") == space.count("/") + 1
            and name.endswith(_REFERENCE)
            and self._node.get_subscriptions_info_by_topic(name)
        ]
        if len(found) == 1:
            return found[0]
        several = f"several hear references, choose by parameter controller: {', '.join(found)}"
        self._tell(f"target: {several if found else 'no controller hears references'}")
        return None


def _led(scene: Scene) -> list[str]:
    """Joints that a controller leads: the actuated ones, else all that are independent."""
    actuated = [joint for actuator in scene.actuators for joint in actuator.joints]
    return list(dict.fromkeys(actuated)) or list(scene.couplings.independent)
