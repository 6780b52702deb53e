"""Publishers, subscriptions and timers of a node, and how long they live."""

from collections.abc import Callable
from typing import Any

from mbd_ros.nodes.health import Endpoint


class Entities:
    """Destroys with a configuration or an activation what was made in it.

    Attributes:
        endpoints: Topics under watch.
    """

    def __init__(self) -> None:
        self.endpoints: list[Endpoint] = []
        self._of_configuration: list[Callable[[], None]] = []
        self._of_activation: list[Callable[[], None]] = []

    def keep(
        self, state: str, destroy: Callable[[Any], Any], entity: Any, *watch: Endpoint
    ) -> None:
        """Remember an entity.

        Args:
            state: Of the life cycle; what is made before any configuration stays.
            destroy: Destroys the entity.
            entity: Publisher, subscription or timer.
            watch: Its topic.
        """
        self.endpoints += watch

        def forget() -> None:
            self.endpoints = [kept for kept in self.endpoints if kept not in watch]
            destroy(entity)

        if state == "activating":
            self._of_activation.append(forget)
        elif state != "unconfigured":
            self._of_configuration.append(forget)

    def release(self) -> None:
        """Destroy what the configuration and its activation made, the newest first."""
        self.release_activation()
        _empty(self._of_configuration)

    def release_activation(self) -> None:
        """Destroy what the activation made, the newest first."""
        _empty(self._of_activation)


def _empty(owned: list[Callable[[], None]]) -> None:
    while owned:
        owned.pop()()
