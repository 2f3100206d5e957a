"""The live page answers only whom it should, and in bounds."""

import http.client
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from served import Serving, serving, upgrade
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from softslide.serve.page import server
from softslide.serve.page.server import BODY_S, MOST_BODIES, REQUEST_S


@pytest.fixture(scope="module")
def running(bundle: Path) -> Iterator[Serving]:
    with serving(bundle) as local:
        yield local


@pytest.fixture(scope="module")
def everywhere(bundle: Path) -> Iterator[Serving]:
    with serving(bundle, "0.0.0.0:0") as known:
        yield known


@pytest.mark.parametrize("path", ["/", "/healthz", "/model", "/page.js"])
def test_a_host_of_another_name_is_refused(running: Serving, path: str) -> None:
    """A page elsewhere whose name resolves to this machine asks for its own name."""
    assert running.ask(path)[0] == 200
    assert running.ask(path, Host="localhost:1")[0] == 200
    for host in ("evil.example", "evil.example:80", "127.0.0.1.evil.example", "", "localhost.evil.example:9"):
        assert running.ask(path, Host=host)[0] == 403, host


def test_a_stream_for_another_host_or_origin_is_refused(running: Serving) -> None:
    port = urlsplit(running.address).port
    with connect(f"ws://127.0.0.1:{port}/stream", proxy=None) as view:
        assert view.recv(timeout=20)
    for headers in ({"Host": "evil.example"}, {"Origin": "http://evil.example"}):
        with socket.create_connection(("127.0.0.1", port)) as raw:
            raw.sendall(upgrade(**{"Host": f"127.0.0.1:{port}", **headers}))
            assert b" 403 " in raw.recv(4096).splitlines()[0]


def test_answers_forbid_what_a_page_does_not_need(running: Serving) -> None:
    headers = running.ask("/")[1]
    assert "default-src 'self'" in headers["Content-Security-Policy"]
    assert headers["X-Content-Type-Options"] == "nosniff"


def test_a_request_without_end_is_refused(running: Serving) -> None:
    with socket.create_connection(("127.0.0.1", urlsplit(running.address).port)) as raw:
        raw.settimeout(20)
        try:
            raw.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: " + b"x" * 1_000_000)
            got = raw.recv(4096)
        except ConnectionError:
            got = b""
    assert b" 200 " not in got
    assert running.ask("/healthz")[0] == 200


def test_other_machines_need_the_token(everywhere: Serving) -> None:
    token = urlsplit(everywhere.address).query
    assert len(token) > 20
    for path in ("/", "/model", "/?token=", "/?token=wrong", "/?token=%ff"):
        assert everywhere.ask(path)[0] == 403, path
    status, headers, _ = everywhere.ask(f"/?{token}")
    assert status == 200
    cookie = headers["Set-Cookie"].partition(";")[0]
    assert everywhere.ask("/model", Cookie=cookie)[0] == 200
    assert everywhere.ask("/model", Cookie=f"{cookie.partition('=')[0]}=wrong")[0] == 403
    with pytest.raises(InvalidStatus):
        connect(f"ws://127.0.0.1:{urlsplit(everywhere.address).port}/stream", proxy=None)


def test_requests_that_are_never_finished_hold_nobody_up(running: Serving) -> None:
    port = urlsplit(running.address).port
    assert port is not None
    with ExitStack() as held:
        opened = [
            held.enter_context(closing(socket.create_connection(("127.0.0.1", port)))) for _ in range(100)
        ]
        for each in opened[:70]:
            each.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n")
        for each in opened[70 : 70 + 3 * MOST_BODIES]:
            each.sendall(body(9, b"time"))
        assert running.ask("/healthz")[0] == 200
        with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=BODY_S / 2)) as connection:
            connection.request("POST", "/predict", body=b"time_s\n1\n")
            assert connection.getresponse().status == 422
        opened[0].settimeout(3 * REQUEST_S)
        assert opened[0].recv(1) == b""


def body(size: int, sent: bytes) -> bytes:
    """The request for an estimate, with so much of its body, as it travels."""
    return f"POST /predict HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: {size}\r\n\r\n".encode() + sent


def test_half_a_request_after_a_whole_one_is_closed_in_time(running: Serving) -> None:
    """After answers of every kind, also to a request whose body does not end."""
    place = ("127.0.0.1", urlsplit(running.address).port)
    asked = [
        b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n",
        b"POST /zero HTTP/1.1\r\nHost: evil.example\r\nContent-Length: 9999\r\n\r\n",
    ]
    with ExitStack() as held:
        opened = [held.enter_context(closing(socket.create_connection(place, 30))) for _ in range(60)]
        for n, each in enumerate(opened):
            each.sendall(asked[n % 3])
            assert each.recv(1 << 16).startswith((b"HTTP/1.1 200", b"HTTP/1.1 403"))
            each.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n")
        begun = time.monotonic()
        for each in opened:
            assert ended(each)
        assert time.monotonic() - begun < 3 * REQUEST_S


def ended(connection: socket.socket) -> bool:
    """Whether the other side has closed it before the time was over, whatever it still said."""
    try:
        while connection.recv(1 << 16):
            pass
    except ConnectionError:
        return True
    except TimeoutError:
        return False
    return True


def test_connections_are_kept_for_the_next_request(running: Serving) -> None:
    """An answer's timer does not end a connection that has asked since."""
    with closing(http.client.HTTPConnection("127.0.0.1", urlsplit(running.address).port, timeout=20)) as kept:
        kept.connect()
        line = kept.sock
        for pause_s in (0.6 * REQUEST_S, 0.6 * REQUEST_S, 0.0):
            kept.request("GET", "/healthz")
            assert kept.getresponse().read()
            time.sleep(pause_s)
        assert kept.sock is line


def test_recordings_beyond_what_memory_holds_are_refused_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Until one that was being sent has gone."""
    monkeypatch.setattr(server, "MOST_HELD_BYTES", 1000)
    with ExitStack() as held:
        listener = held.enter_context(closing(socket.create_server(("127.0.0.1", 0))))
        place = listener.getsockname()
        page = server.Server(listener, "{}", ("token", True), lambda: None, lambda sent: {"bytes": len(sent)})
        held.enter_context(closing(page))
        page.wait()

        def answer() -> bytes:
            with socket.create_connection(place, 10) as other:
                other.sendall(body(200, bytes(200)))
                return other.recv(1 << 16).split(b" ", 2)[1]

        with socket.create_connection(place, 10) as stalled:
            stalled.sendall(body(2000, bytes(900)))
            until = time.monotonic() + BODY_S / 2
            while answer() != b"503" and time.monotonic() < until:
                pass
            assert answer() == b"503"
        until = time.monotonic() + BODY_S / 2
        while answer() != b"200" and time.monotonic() < until:
            pass
        assert [answer() for _ in range(5)] == 5 * [b"200"]
