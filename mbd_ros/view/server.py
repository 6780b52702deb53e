"""The server of a page: `viser` behind a guard that looks at every connection, websockets too.

`viser` has no passwords. It listens on an address that is told to nobody, and the guard on the one
that people use. It reads the head of each connection's only request, refuses it or passes it on as
it is, and then copies bytes. A page of another site cannot use a browser that may see this one:
its Origin is refused (RFC 6454, RFC 6455 section 10.2), and so is the name of another host where
no token is asked for, which ends DNS rebinding. Nor can it show the page in a frame, where people
would press buttons that they do not see.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import hmac
import io
import ipaddress
import secrets
import socket
from collections.abc import Sequence
from http.client import HTTPException, parse_headers
from http.cookies import CookieError, SimpleCookie
from typing import Any, NamedTuple
from urllib.parse import parse_qs, quote, urlsplit

from mbd_ros.errors import MbdError, printable

LOOPBACK = ("127.0.0.1", "localhost", "::1")
_HEAD = 16_384  # bytes of the head of a request
_PIECE = 65_536  # bytes that are copied at a time
_PATIENCE = 10.0  # s for the head of a request, and for the last bytes of an answer
_PORTS = 100  # that are tried
_WRONG = 0.5  # s that a wrong token costs
_MOST = 64  # connections at once
_FRAMES = ("iframe", "frame", "embed", "object")
_SILENT = (
    OSError,
    ValueError,
    asyncio.TimeoutError,
    asyncio.IncompleteReadError,
    asyncio.LimitOverrunError,
)  # of connections that ask for nothing a page has
_ASK = """<!doctype html><meta charset="utf-8"><title>token</title>
<meta name="viewport" content="width=device-width">
<body style="font-family:sans-serif;margin:3em"><p>{said}
<form><input name="token" type="password" aria-label="token" autofocus autocomplete="off">
<button>show the page</button></form>"""


class PageServer:
    """A `viser` server whose every connection is looked at first.

    Args:
        host: Address to listen on.
        port: Port; the next one that is free where it is taken.
        token: What a browser must know. Empty: none is asked for on this machine, and one is made
            up for another `host`.
        origins: As for `Guard`.

    Attributes:
        viser: The `viser.ViserServer`.
        token: What browsers must know, given or made up.
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
            bound_port = self._listen(host, port)
        except OSError as error:
            self.close()
            raise MbdError(f"host '{host}', port {port}: {error.strerror or error}") from error
        self.address = f"http://{f'[{host}]' if ':' in host else host}:{bound_port}"

    @property
    def address_with_token(self) -> str:
        """Address of the page, with the token that opens it."""
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


def is_loopback(host: str) -> bool:
    """Whether an address is this machine's own, which no other one reaches."""
    if host in LOOPBACK:
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


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


def _is_taken(error: OSError) -> bool:
    import errno

    return error.errno == errno.EADDRINUSE


class Guard:
    """Passes requests on to a server of this machine, if they may pass.

    Args:
        host: Address of that server.
        token: What a browser must know; empty where everybody on this machine may pass.
        origins: Addresses of pages that may open websockets besides the own one, such as
            `https://robots.example`.
    """

    def __init__(self, host: str, port: int, token: str = "", origins: Sequence[str] = ()) -> None:
        self._inner, self._token = (host, port), token
        self._origins = {urlsplit(origin).netloc.lower() for origin in origins}
        self._proof = hashlib.sha256(token.encode()).hexdigest()
        self._open, self._cookie = 0, "mbd_ros_view"
        self._server: asyncio.Server | None = None

    async def listen(self, host: str, port: int) -> None:
        """Begin to listen; OSError where the port is taken or the address is not ours."""
        self._server = await asyncio.start_server(self._serve, host, port, limit=_HEAD)
        self._cookie = f"mbd_ros_view_{port}"  # browsers share cookies among ports

    async def close(self) -> None:
        """Listen no more."""
        if self._server is not None:
            self._server.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._open += 1
        try:
            raw = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), _PATIENCE)
            head = _read(raw)
            answer = await self._answer(head) if head else _response(400, "no request of a page")
            if answer is None:
                await self._pass_on(raw, reader, writer)
            else:
                writer.write(answer)
        except _SILENT:
            pass
        finally:
            self._open -= 1
            await _ended(writer)

    async def _answer(self, head: _Head) -> bytes | None:
        """Return the answer that refuses a request or takes its token; None to pass it on."""
        if self._open > _MOST:
            return _response(503, f"{_MOST} browsers are connected already")
        if refused := self._foreign(head):
            return _response(403, refused)
        if not self._token:
            return None
        if head.tokens:
            if not self._is_right(head.tokens):
                await asyncio.sleep(_WRONG)
                return _response(401, "" if head.is_socket else _ASK.format(said="Wrong token."))
            return None if head.is_socket else self._welcome(head)
        if hmac.compare_digest(_cookie(head, self._cookie).encode(), self._proof.encode()):
            return None
        said = "This page asks for a token: its log names it, or whoever started it."
        return _response(401, "" if head.is_socket else _ASK.format(said=said))

    def _foreign(self, head: _Head) -> str:
        """Why it comes from a page that is not this one; empty otherwise."""
        host = head.headers.get("host", "").lower()
        if not self._token and _name(host) not in (*LOOPBACK, *map(_name, self._origins)):
            return "without a token this page has the names 127.0.0.1 and localhost alone"
        origin = head.headers.get("origin")
        if origin is not None and urlsplit(origin).netloc.lower() not in (host, *self._origins):
            return "a page of another site may not use this one; see parameter origins"
        framed = head.headers.get("sec-fetch-dest") in _FRAMES
        if framed and head.headers.get("sec-fetch-site") not in ("same-origin", "none"):
            return "a page of another site may not show this one within itself"
        return ""

    def _is_right(self, tokens: Sequence[str]) -> bool:
        return hmac.compare_digest(tokens[0].encode(), self._token.encode())

    def _welcome(self, head: _Head) -> bytes:
        """Keep the proof in the browser, and the token out of its address."""
        cookie = f"Set-Cookie: {self._cookie}={self._proof}; HttpOnly; SameSite=Lax\r\n"
        place = f"./{head.path.rpartition('/')[2]}"
        return _response(303, "", f"{cookie}Location: {place}\r\n")

    async def _pass_on(
        self, raw: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        """Copy both ways until one ends; who reads slowly is not read from either."""
        there, onwards = await asyncio.open_connection(*self._inner)
        onwards.write(raw)
        copies = [asyncio.ensure_future(_copy(reader, onwards))]
        copies.append(asyncio.ensure_future(_copy(there, writer)))
        try:
            await asyncio.wait(copies, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for copy in copies:
                copy.cancel()
            await asyncio.gather(*copies, return_exceptions=True)
            onwards.close()


def _read(raw: bytes) -> _Head | None:
    """The head of a GET; None for anything else."""
    line, _, rest = raw.partition(b"\r\n")
    words = line.decode("latin-1").split(" ")
    if len(words) != 3 or words[0] != "GET" or words[2] != "HTTP/1.1":
        return None
    try:
        headers = parse_headers(io.BytesIO(rest))
        parts = urlsplit(words[1])
        tokens = parse_qs(parts.query, max_num_fields=20).get("token", [])
    except (HTTPException, ValueError):
        return None
    names = [name.lower() for name in headers]
    if any(names.count(name) > 1 for name in ("host", "origin", "cookie", "upgrade")):
        return None
    return _Head(parts.path, tokens, {n.lower(): str(value) for n, value in headers.items()})


class _Head(NamedTuple):
    """The head of a request.

    Attributes:
        tokens: What the query calls so.
        headers: Of the request.
    """

    path: str
    tokens: list[str]
    headers: dict[str, str]

    @property
    def is_socket(self) -> bool:
        """Whether it opens a websocket."""
        return self.headers.get("upgrade", "").lower() == "websocket"


def _response(status: int, body: str, headers: str = "") -> bytes:
    words = {303: "See Other", 400: "Bad Request", 401: "Unauthorized", 403: "Forbidden"}
    data = body.encode()
    head = (
        f"HTTP/1.1 {status} {words.get(status, 'Service Unavailable')}\r\n{headers}"
        f"Content-Type: text/html; charset=utf-8\r\nContent-Length: {len(data)}\r\n"
        "Cache-Control: no-store\r\nConnection: close\r\n\r\n"
    )
    return head.encode() + data


async def _ended(writer: asyncio.StreamWriter) -> None:
    """Close a connection once its last bytes are out, or after a while without them."""
    try:
        writer.close()
        await asyncio.wait_for(writer.wait_closed(), _PATIENCE)
    except (OSError, asyncio.TimeoutError):
        writer.transport.abort()


def _cookie(head: _Head, name: str) -> str:
    try:
        found = SimpleCookie(head.headers.get("cookie", "")).get(name)
    except CookieError:
        return ""
    return found.value if found else ""


def _name(netloc: str) -> str:
    """The host of an address without its port."""
    return urlsplit(f"//{netloc}").hostname or ""


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while data := await reader.read(_PIECE):
        writer.write(data)
        await writer.drain()
