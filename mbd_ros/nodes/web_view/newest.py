"""The newest message of each topic, as bytes: what comes in between is never read."""

from collections.abc import Callable
from typing import Any

from rclpy.qos import QoSProfile, ReliabilityPolicy

from mbd_ros.nodes.shell.serialized import message_of
from mbd_ros.nodes.shell.shell import Shell
from msg_adapters.errors import MessageError

NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class Newest:
    """Hears a topic, and gives its newest message once.

    Args:
        node: The hearing node.
        kind: Message class.
        topic: Relative or absolute name.

    Attributes:
        count: Messages since it was set to 0.
    """

    def __init__(self, node: Shell, kind: type, topic: str) -> None:
        self._node, self._kind, self._topic = node, kind, topic
        self.count, self._cdr = 0, b""
        node.subscribe(kind, topic, self._take, NEWEST, raw=True)

    def _take(self, cdr: bytes) -> None:
        self._cdr, self.count = cdr, self.count + 1

    def read(self, read: Callable[[bytes], Any]) -> Any:
        """What a function reads of the newest bytes; None where they are bad, or none are new."""
        cdr, self._cdr = self._cdr, b""
        if not cdr:
            return None
        try:
            return read(cdr)
        except MessageError as error:
            where = self._node.resolve_topic_name(self._topic)
            self._node.drop("malformed", f"{where}: {error}")
            return None

    def message(self, read: Callable[[Any], Any]) -> Any:
        """The same of the newest message."""
        return self.read(lambda cdr: read(message_of(cdr, self._kind)))
