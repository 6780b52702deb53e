"""A browser without a picture: speaks the protocol of viser's page over a real websocket."""

import time
from typing import Any

import msgspec.msgpack
import viser
import zstandard
from deadline import DEADLINE
from viser import _messages
from websockets.sync.client import connect

WORDS = viser.__version__


class PageClient:
    """Hears what a page is told, and says what people do there.

    Args:
        address: Of the page.
        **options: Of the connection.

    Attributes:
        state: (type, name or uuid) -> the newest message of an entity of the page.
    """

    def __init__(self, address: str, **options: Any) -> None:
        self.state: dict[tuple[str, str], dict[str, Any]] = {}
        subprotocols = [f"viser-v{WORDS}"]
        self.socket = connect(
            address.replace("http", "ws", 1), subprotocols=subprotocols, max_size=None, **options
        )
        turn, place = (1.0, 0.0, 0.0, 0.0), (3.0, 3.0, 3.0)
        middle, up = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
        camera = (turn, place, 1.0, 0.01, 100.0, 800, 1280, middle, up)
        self.say(_messages.ViewerCameraMessage(*camera))

    def say(self, message: Any) -> None:
        """Send a message as a page does."""
        self.socket.send(msgspec.msgpack.encode(message.as_serializable_dict()))

    def hear(self, seconds: float) -> list[dict[str, Any]]:
        """All messages of so many seconds."""
        end, heard = time.monotonic() + seconds, []
        while (left := end - time.monotonic()) > 0.0:
            try:
                heard += self._decoded(self.socket.recv(timeout=left))
            except TimeoutError:
                break
        return heard

    def wait_for(self, done: Any) -> dict[str, Any]:
        """The first message from now on that satisfies `done`."""
        end = time.monotonic() + DEADLINE
        while time.monotonic() < end:
            for message in self.hear(0.05):
                if done(message):
                    return message
        raise AssertionError("never said")

    def labelled(self, label: str) -> dict[str, Any]:
        """The element of the panel with that label."""
        end = time.monotonic() + DEADLINE
        while time.monotonic() < end:
            for message in self.state.values():
                if (message.get("props") or {}).get("label") == label and "uuid" in message:
                    return message
            self.hear(0.1)
        raise AssertionError(f"no {label}")

    def set(self, label: str, value: Any) -> None:
        """Give an element of the panel a value, or press it."""
        uuid = self.labelled(label)["uuid"]
        self.say(_messages.GuiUpdateMessage(uuid, {"value": value}))

    def close(self) -> None:
        """Go away."""
        self.socket.close()

    def _decoded(self, data: Any) -> list[dict[str, Any]]:
        size = int.from_bytes(data[8:16], "little")
        plain = zstandard.ZstdDecompressor().decompress(data[16 : 16 + size])
        messages = msgspec.msgpack.decode(plain)["messages"]
        for message in messages:
            key = str(message.get("name") or message.get("uuid"))
            self.state[message["type"], key] = message
        return list(messages)
