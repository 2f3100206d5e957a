"""`softslide serve` in a process of its own, and its page in a browser."""

import json
import re
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from http.client import HTTPConnection, HTTPMessage
from itertools import islice
from pathlib import Path
from subprocess import DEVNULL, PIPE
from urllib.parse import urlsplit

import numpy as np
from playwright.sync_api import Browser, ConsoleMessage, Locator, Page
from streams import pass_over, still, stream
from websockets.sync.client import ClientConnection, connect

BOARDS = 2
VOLTS = stream(still(0.6), pass_over(1.0), still(0.4), accelerometers=BOARDS)
REST, SLIDE = VOLTS[:600], VOLTS[600:1400]


def started(bundle: Path, source: str, *more: str, stdout: int = PIPE) -> subprocess.Popen:
    """In a process of its own."""
    command = [sys.executable, "-m", "softslide", "serve", "--model", str(bundle), "--source", source, *more]
    return subprocess.Popen(command, stdin=PIPE, stdout=stdout, stderr=PIPE)


@contextmanager
def repeated(say: Callable[[], object]) -> Iterator[None]:
    """Says it over and over, from a thread."""
    heard = threading.Event()

    def speak() -> None:
        while not heard.wait(0.05):
            say()

    speaker = threading.Thread(target=speak)
    speaker.start()
    try:
        yield
    finally:
        heard.set()
        speaker.join()


class Serving:
    """`softslide serve` in a process of its own, fed through standard input.

    Its estimates wait in a pipe, unless `unread`: a full pipe stops the stream.
    """

    def __init__(self, bundle: Path, place: str, source: str, unread: bool, more: Sequence[str]) -> None:
        more = ("--format", "f32", "--page", place, *more)
        self.process = started(bundle, source, *more, stdout=DEVNULL if unread else PIPE)
        assert self.process.stderr is not None
        said = b""
        while not (found := re.search(rb"http://\S+", said)):
            line = self.process.stderr.readline()
            assert line, said
            said += line
        self.address = found[0].decode()

    def feed(self, volts: np.ndarray) -> list[dict]:
        """Sends samples, and waits for the estimates of their whole blocks on standard output, heartbeats aside."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(volts.astype("<f4").tobytes())
        self.process.stdin.flush()
        lines = (json.loads(line) for line in self.process.stdout)
        return list(islice((line for line in lines if line["reason"] != "no_signal"), len(volts) // 20))

    @contextmanager
    def fed(self, volts: np.ndarray) -> Iterator[list[dict]]:
        """Samples keep coming, so that the page goes on showing them. Their estimates so far."""
        pieces, sent = (volts[n : n + 20] for n in range(0, len(volts), 20)), list[dict]()
        with repeated(lambda: sent.extend(self.feed(next(pieces, volts[:0])))):
            yield sent

    def ask(
        self, path: str, method: str = "GET", body: bytes | None = None, **headers: str
    ) -> tuple[int, HTTPMessage, bytes]:
        """Status, headers and content of an answer."""
        port = urlsplit(self.address).port or 0
        with closing(HTTPConnection("127.0.0.1", port, timeout=30)) as connection:
            connection.request(method, path, body, headers)
            with connection.getresponse() as got:
                return got.status, got.headers, got.read()

    def end(self) -> tuple[int, str]:
        """Ends the stream. The exit status and what was said on standard error."""
        _, error = self.process.communicate(timeout=30)
        return self.process.returncode, error.decode()


@contextmanager
def serving(
    bundle: Path, place: str = "0", source: str = "-", unread: bool = False, more: Sequence[str] = ()
) -> Iterator[Serving]:
    running = Serving(bundle, place, source, unread, more)
    try:
        yield running
    finally:
        if running.process.poll() is None:
            running.process.kill()
        running.process.communicate()


def viewer(address: str) -> ClientConnection:
    return connect(f"{address.replace('http', 'ws')}stream", proxy=None)


def upgrade(**headers: str) -> bytes:
    """The request for a stream, as it travels."""
    lines = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13", **headers}
    text = "".join(f"{name}: {value}\r\n" for name, value in lines.items())
    return f"GET /stream HTTP/1.1\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n{text}\r\n".encode()


@contextmanager
def opened(browser: Browser, address: str, lost: bool = False) -> Iterator[Page]:
    """The page; it complains of nothing on the console, unless its server may be `lost`."""
    page = browser.new_page()
    complaints: list[str] = []

    def note(message: ConsoleMessage) -> None:
        if message.type in ("error", "warning"):
            complaints.append(message.text)

    page.on("console", note)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("requestfailed", lambda request: complaints.append(f"{request.url} failed"))
    page.goto(address)
    yield page
    assert lost or complaints == []
    page.close()


def cell(page: Page, title: str) -> Locator:
    """The cell of a number. The page draws after the estimate came: expect its text, do not read it once."""
    return page.get_by_role("row", name=title).get_by_role("cell").first
