"""The live page answers only whom it should, and in bounds."""

import http.client
import socket
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from test_serve_page import Serving, serving, upgrade
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from softslide.serve.page.server import MOST_BODIES, REQUEST_S


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
        for each in opened[70 : 70 + MOST_BODIES - 1]:
            each.sendall(b"POST /predict HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 9\r\n\r\ntime")
        assert running.ask("/healthz")[0] == 200
        with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=20)) as connection:
            connection.request("POST", "/predict", body=b"time_s\n1\n")
            assert connection.getresponse().status == 422
        opened[0].settimeout(3 * REQUEST_S)
        assert opened[0].recv(1) == b""
