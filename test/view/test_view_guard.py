"""Who passes the guard of a page: heads of requests on a real socket, without a browser."""

import socket

import pytest
from deadline import DEADLINE

pytest.importorskip("viser", reason="viser is not installed")

from mbd_ros.errors import MbdError
from mbd_ros.view.server import PageServer, is_loopback

TOKEN = "sésame; a=1"
SOCKET = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
KEY = {"Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="}


def free_port():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return taken.getsockname()[1]


@pytest.fixture(scope="module")
def opened():
    """A page that asks for a token, and one of this machine alone that a proxy shows."""
    servers = [
        PageServer("0.0.0.0", free_port(), "x", TOKEN),
        PageServer("127.0.0.1", free_port(), "x", origins=["https://robots.example"]),
    ]
    yield [int(server.address.rpartition(":")[2]) for server in servers]
    for server in servers:
        server.close()


def asked(port, path="/", raw=None, **headers):
    """Status line and headers of the answer to a request, lower case."""
    given = {"Host": f"127.0.0.1:{port}", **{n.replace("_", "-"): v for n, v in headers.items()}}
    lines = [f"GET {path} HTTP/1.1", *(f"{name}: {value}" for name, value in given.items())]
    data = "\r\n".join([*lines, "", ""]).encode("latin-1") if raw is None else raw
    with socket.create_connection(("127.0.0.1", port), timeout=DEADLINE) as link:
        link.sendall(data)
        answer = b""
        while b"\r\n\r\n" not in answer and (piece := link.recv(65536)):
            answer += piece
    return answer.partition(b"\r\n\r\n")[0].decode("latin-1").lower()


def status(*words, **headers):
    """Of the answer; empty where the connection just ends."""
    return [*asked(*words, **headers).split(" "), ""][1]


def test_a_token_is_asked_for_whatever_is_asked(opened):
    port, _ = opened
    right = "/?token=s%C3%A9same%3B%20a%3D1"
    assert status(port) == status(port, "/index.html") == status(port, "/?token=no") == "401"
    assert status(port, Cookie=f"mbd_ros_view_{port}={TOKEN}".encode().decode("latin-1")) == "401"
    assert status(port, **SOCKET, **KEY) == "401"
    assert status(port, right, **SOCKET, **KEY) == "101"
    welcome = asked(port, right)
    assert " 303 " in welcome and "location: ./\r\n" in welcome and "httponly" in welcome
    cookie = welcome.partition("set-cookie: ")[2].partition(";")[0]
    assert status(port, Cookie=cookie) == "200"
    assert status(port, Cookie=cookie, **SOCKET, **KEY) == "101"
    foreign = {"Cookie": cookie, "Origin": "http://elsewhere.example"}
    assert status(port, **foreign, **SOCKET, **KEY) == "403"
    assert "same" not in welcome.replace("samesite", "")


def test_without_a_token_other_names_and_sites_are_refused(opened):
    _, port = opened
    assert status(port) == status(port, Host="localhost") == "200"
    assert status(port, Host="rebound.example") == "403"
    for origin, answer in (
        (f"http://127.0.0.1:{port}", "101"),
        ("https://robots.example", "101"),
        ("https://robots.example.org", "403"),
        ("http://127.0.0.1:1", "403"),
        ("null", "403"),
        ("http://[", ""),
    ):
        assert status(port, Origin=origin, **SOCKET, **KEY) == answer, origin
    framed = {"Sec_Fetch_Dest": "iframe"}
    assert status(port, **framed, Sec_Fetch_Site="cross-site") == "403"
    assert status(port, **framed, Sec_Fetch_Site="same-origin") == "200"


@pytest.mark.parametrize(
    ("raw", "answer"),
    [
        (b"POST / HTTP/1.1\r\nHost: localhost\r\n\r\n", "400"),
        (b"GET / HTTP/1.1\r\nHost: localhost\r\nHost: elsewhere\r\n\r\n", "400"),
        (b"GET / HTTP/1.1\r\nhost: localhost\r\nOrigin: a\r\nORIGIN: b\r\n\r\n", "400"),
        (b"GET http://[ HTTP/1.1\r\nHost: localhost\r\n\r\n", "400"),
        (b"\x00\xff\r\n\r\n", "400"),
        (b"GET / HTTP/1.1\r\nX: " + b"x" * 20_000 + b"\r\n\r\n", ""),
    ],
)
def test_what_is_no_request_of_a_page_gets_no_page(opened, raw, answer):
    _, port = opened
    try:
        found = status(port, raw=raw)
    except ConnectionResetError:
        found = ""
    assert found == answer


def test_a_taken_port_is_followed_by_the_next_one_and_a_foreign_address_is_named(opened):
    _, port = opened
    server = PageServer("127.0.0.1", port, "x")
    assert int(server.address.rpartition(":")[2]) > port
    server.close()
    with pytest.raises(MbdError, match=r"host '192\.0\.2\.1', port 8080: "):
        PageServer("192.0.2.1", 8080, "x")
    assert [is_loopback(host) for host in ("127.0.0.7", "::1", "0.0.0.0", "robot.local")] == [
        *(True, True, False, False)
    ]
