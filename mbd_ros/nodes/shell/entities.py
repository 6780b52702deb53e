"""Publishers, subscriptions and timers of a node, and how long they live."""

from collections.abc import Callable
from typing import Any

from mbd_ros.nodes.shell.health import Endpoint

_Owned = list[tuple[Any, Callable[[], None]]]


class Entities:
    """Destroys entities together with the configuration or activation that made them.

    Attributes:
        endpoints: Topics under watch.
    """

    def __init__(self) -> None:
        self.endpoints: list[Endpoint] = []
        self._of_node: _Owned = []
        self._of_configuration: _Owned = []
        self._of_activation: _Owned = []

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

        later = self._of_node if state == "unconfigured" else self._of_configuration
        owned = self._of_activation if state == "activating" else later
        owned.append((entity, forget))

    def drop(self, entity: Any) -> None:
        """Destroy one entity before its time."""
        for owned in (self._of_node, self._of_configuration, self._of_activation):
            for entry in [e for e in owned if e[0] is entity]:
                owned.remove(entry)
                entry[1]()

    def release(self) -> None:
        """Destroy what the configuration and its activation made, the newest first."""
        self.release_activation()
        _empty(self._of_configuration)

    def release_activation(self) -> None:
        """Destroy what the activation made, the newest first."""
        _empty(self._of_activation)


def _empty(owned: _Owned) -> None:
    while owned:
        owned.pop()[1]()
