"""The server of a page: `viser` behind a guard."""

import asyncio
import contextlib
import io
import ipaddress
import secrets
import socket
from collections.abc import Sequence
from typing import Any
from urllib.parse import quote

from mbd_ros.errors import MbdError, printable
from mbd_ros.view.guard import LOOPBACK, Guard

_PORTS = 100  # that are tried
_PATIENCE = 10.0  # s


class PageServer:
    """A `viser` server whose every connection is looked at first.

    Args:
        host: Address to listen on.
        port: Port; the next one that is free where it is taken.
        label: Title of the panel.
        token: What a browser must know. Empty: none is asked for on this machine, and one is made
            up for another `host`.
        origins: As for `Guard`.

    Attributes:
        viser: The `viser.ViserServer`.
        token: As given or made up.
        address: Of the page, without token.
        departures: How many browsers went away.

    Raises:
        MbdError: Nothing can be listened to there.
    """

    def __init__(
        self, host: str, port: int, label: str, token: str = "", origins: Sequence[str] = ()
    ) -> None:
        self.token = token or ("" if is_loopback(host) else secrets.token_urlsafe(16))
        self.viser = started(label)
        self.viser.gui.configure_theme(show_logo=False, show_share_button=False)
        self.departures = 0
        self.viser.on_client_disconnect(self._note_departure)
        self._guard = Guard(self.viser.get_host(), self.viser.get_port(), self.token, origins)
        try:
            found = self._listen(host, port)
        except OSError as error:
            self.close()
            raise MbdError(f"host '{host}', port {port}: {error.strerror or error}") from error
        self.address = f"http://{f'[{host}]' if ':' in host else host}:{found}"

    @property
    def address_with_token(self) -> str:
        """Of the page, for whoever may see it."""
        return f"{self.address}/?token={quote(self.token)}" if self.token else self.address

    @property
    def browsers(self) -> int:
        """How many are connected."""
        return len(self.viser.get_clients())

    async def _note_departure(self, _: Any) -> None:
        self.departures += 1

    def close(self) -> None:
        """End it."""
        self._do(self._guard.close())
        stop(self.viser)

    def _listen(self, host: str, port: int) -> int:
        for tried in range(port, min(port + _PORTS, 65536)):
            try:
                self._do(self._guard.listen(host, tried))
            except OSError as error:
                if error.errno is None or not _is_taken(error):
                    raise
                continue
            return tried
        raise MbdError(f"port {port} and {_PORTS - 1} after it are taken")

    def _do(self, work: Any) -> None:
        loop = self.viser.get_event_loop()
        asyncio.run_coroutine_threadsafe(work, loop).result(_PATIENCE)


def started(label: str) -> Any:
    """A `viser.ViserServer` on an address of this machine that is told to nobody."""
    import viser  # takes long, and is asked for by pages alone

    with contextlib.redirect_stdout(io.StringIO()):  # it greets there
        server = viser.ViserServer(
            host=_hidden_address(), port=0, label=printable(label), verbose=False
        )
    server.request_share_url = lambda: None  # any page could ask for a public address
    return server


def _hidden_address() -> str:
    """One of 16 million addresses of this machine, as Linux has them; else the only one.

    Pages of other sites may try all ports of 127.0.0.1, but not of all of these.
    """
    address = ".".join(["127", *(str(1 + secrets.randbelow(254)) for _ in range(3))])
    try:
        with socket.socket() as tried:
            tried.bind((address, 0))
    except OSError:
        return LOOPBACK[0]
    return address


def stop(server: Any) -> None:
    """End it."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


def is_loopback(host: str) -> bool:
    """Whether an address is this machine's own, which no other one reaches."""
    if host in LOOPBACK:
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _is_taken(error: OSError) -> bool:
    import errno

    return error.errno == errno.EADDRINUSE
