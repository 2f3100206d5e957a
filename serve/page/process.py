"""The live page next to the stream, in a process of its own.

Requests of any kind take no time of the interpreter that serves the robot. The stream never waits: what the page does
not take in time is dropped, and when the page dies the stream goes on.
"""

import importlib.util
import json
import logging
import multiprocessing
import os
import secrets
import signal
import socket
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from ipaddress import ip_address
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np

from softslide.features.card import Card
from softslide.features.errors import InputError
from softslide.features.estimate import Estimate
from softslide.features.safe_path import safe_path
from softslide.serve.address import host_and_port
from softslide.serve.newest import put_newest
from softslide.serve.page.server import FAREWELL_S, Server, about, frame

PLACE = "write PORT or HOST:PORT, port 0 for any that is free"
NEEDED = ("fastapi", "uvicorn", "websockets")
# Estimates that wait for the page, two seconds of them; beyond it the oldest are dropped.
MOST_WAITING = 100
# Time that the page's process has to start, s: a second where the machine has little else to do.
START_S = 60.0
# Time that the page's process has to end, before it is ended, s.
END_S = 10.0 + FAREWELL_S
# Of the page's process, so that it yields to the stream where they share a core.
NICENESS = 5


class Page:
    """Listens once it is made, serves until it is closed."""

    def __init__(
        self,
        place: str,
        card: Card,
        source: str,
        bundle: Path,
        height_mm: float | None = None,
        unsigned: bool = False,
    ) -> None:
        """place: [HOST:]PORT; without a host 127.0.0.1. source: the stream's name, to be shown. bundle, height_mm,
        unsigned: as in `serve.predict`, for recordings that are sent to the page.

        Raises:
            InputError: no such address, or it is taken.
            ModuleNotFoundError: the live extra is missing.
        """
        for name in NEEDED:
            if importlib.util.find_spec(name) is None:
                raise ModuleNotFoundError(f"No module named '{name}'", name=name)
        listener = _listener(place)
        host, port = listener.getsockname()[:2]
        alone, token = ip_address(host.partition("%")[0]).is_loopback, secrets.token_urlsafe(16)
        self.address = f"http://{f'[{host}]' if ':' in host else host}:{port}/"
        if not alone:
            self.address += f"?token={token}"
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=run_page,
            args=(
                theirs,
                listener,
                json.dumps(about(card, source)),
                (token, alone),
                partial(answer, bundle, height_mm, unsigned),
            ),
            daemon=True,
        )
        with safe_path():
            self._process.start()
        theirs.close()
        listener.close()
        # A short recording would be over before its page is there.
        try:
            started = self._pipe.poll(START_S) and self._pipe.recv_bytes()
        except (EOFError, OSError):
            started = b""
        if not started:
            self._process.kill()
            raise InputError(f"{place}: the page's process did not start; serve without it", "page")
        self._waiting: SimpleQueue[tuple[Estimate, np.ndarray] | None] = SimpleQueue()
        self._zero = False
        self._gone_said = False
        self._sender = threading.Thread(target=self._send, name="page", daemon=True)
        self._sender.start()
        self._listener = threading.Thread(target=self._listen, name="page's requests", daemon=True)
        self._listener.start()

    def show(self, estimate: Estimate, subtracted_v: np.ndarray) -> None:
        """Passes on the estimate to be shown, with the subtracted output (C,) V of the same moment. Never waits."""
        put_newest(self._waiting, (estimate, subtracted_v), MOST_WAITING)

    def zero_wanted(self) -> bool:
        """Whether a viewer has asked for a new static output since the last call."""
        wanted, self._zero = self._zero, False
        return wanted

    def close(self) -> None:
        """Lets the page show the last estimate and say goodbye, and frees the address."""
        self._waiting.put(None)
        self._sender.join(END_S)
        self._process.join(END_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        elif self._process.exitcode:
            # What was sent to it while it died had still room in the pipe.
            self._say_gone()

    def _say_gone(self) -> None:
        if not self._gone_said:
            print("softslide serve: the page has ended; the stream goes on", file=sys.stderr)
        self._gone_said = True

    def _send(self) -> None:
        """Sends what waits until the end, or until the page is gone."""
        try:
            while (shown := self._waiting.get()) is not None:
                self._pipe.send_bytes(frame(*shown))
            self._pipe.send_bytes(b"")
        except OSError:
            self._say_gone()

    def _listen(self) -> None:
        """Notes requests until the page is gone."""
        with suppress(EOFError, OSError):
            while True:
                self._pipe.recv_bytes()
                self._zero = True


def run_page(
    pipe: Connection,
    listener: socket.socket,
    description: str,
    token: tuple[str, bool],
    predict: Callable[[bytes], dict[str, Any]],
) -> None:
    """The page's process: shows the frames that come through the pipe, until an empty one, or the stream is gone."""
    # Ctrl-C ends the stream, and that the page.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    # Whoever sends nonsense must not fill the terminal of the stream.
    logging.disable(logging.CRITICAL)
    server = Server(listener, description, token, lambda: pipe.send_bytes(b"zero"), predict)
    server.wait()
    try:
        pipe.send_bytes(b"ready")
        while shown := pipe.recv_bytes():
            server.show(shown)
    except (EOFError, OSError):
        os._exit(1)
    server.close()


def answer(bundle: Path, height_mm: float | None, unsigned: bool, recording: bytes) -> dict[str, Any]:
    """What `softslide predict` says of a recording in CSV, but for its name.

    Raises:
        InputError: it is not a recording, or not of this bundle's sensor; or the bundle is refused by now.
    """
    # A page that nobody asks this needs no ONNX Runtime.
    from softslide.serve.predict import predict

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.csv"
        path.write_bytes(recording)
        try:
            (estimate,) = predict(bundle, [path], height_mm=height_mm, unsigned=unsigned)
        except InputError as error:
            raise InputError(str(error).replace(f"{path}", "recording")) from None
    return {name: value for name, value in estimate.items() if name not in ("recording", "file")}


def _listener(place: str) -> socket.socket:
    host, port = host_and_port(place)
    if port is None:
        raise InputError(f"{place}: no port; {PLACE}", "page")
    try:
        where = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except (OSError, UnicodeError):
        raise InputError(f"{place}: no such host; {PLACE}", "page") from None
    listener = socket.socket(where[0], socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind(where[4])
        listener.listen()
    except OSError as error:
        listener.close()
        raise InputError(
            f"{place}: cannot listen there ({error.strerror}); name another port, or 0 for any",
            "page",
        ) from None
    return listener
