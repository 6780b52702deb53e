"""Cameras that go along with a joint."""

from typing import Any

from mbd_ros.core.state import Array


class Follower:
    """Moves the cameras of all browsers as the joint moves that they follow.

    Args:
        server: The `viser.ViserServer`.
    """

    def __init__(self, server: Any) -> None:
        self._server = server
        self._joint: Any = None
        self._place: Array | None = None

    def follow(self, joint: Any, place: Array | None) -> None:
        """Go along.

        Args:
            joint: What is followed; another one is no reason to move.
            place: Where it is [m], shape (3,); None to stay.
        """
        before, is_same = self._place, joint == self._joint
        self._joint, self._place = joint, None if place is None else place.copy()
        if place is None or before is None or not is_same:
            return
        for client in self._server.get_clients().values():
            client.camera.position = client.camera.position + place - before  # looks along
