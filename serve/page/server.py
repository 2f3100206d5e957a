"""The live page: a web server in a thread of its own, which shows every viewer the latest estimate.

The stream overwrites one slot and never waits. A viewer asks for each frame, so that at most one is on its way to it: a
slow viewer sees fewer frames, not older ones.
"""

import asyncio
import json
import secrets
import socket
import struct
import threading
import time
from ipaddress import ip_address
from pathlib import Path
from typing import Any

import numpy as np

from features.card import Card
from features.errors import InputError
from features.estimate import Estimate
from features.stream.tracker import SlideState
from serve.page.guard import HEADERS, Guard

PLACE = "write PORT or HOST:PORT, port 0 for any that is free"
# Blocks come 50 times a second; a screen needs no more than this.
FRAME_S = 1 / 40
# After this time without a new estimate the last frame is sent again, so that a viewer that has left is noticed.
SILENCE_S = 1.0
# Time that viewers have at the end to ask for the last frame.
FAREWELL_S = 0.5
# A browser's request has about 1 kB of headers.
MOST_HEADER_BYTES = 1 << 14
MOST_CONNECTIONS = 64
STATES = tuple(SlideState)
# What a frame holds besides; the words are not shown.
NUMBERS = tuple(name for name in Estimate._fields if name not in ("time_s", "state", "contact", "reason"))
_FILES = Path(__file__).with_name("static")


class Page:
    """Listens once it is made, serves until it is closed."""

    def __init__(self, place: str, card: Card, source: str) -> None:
        """place: [HOST:]PORT; without a host 127.0.0.1. source: the stream's name, to be shown.

        Raises:
            InputError: no such address, it is taken, or the live extra is missing.
        """
        self._about = json.dumps(about(card, source))
        self._latest: tuple[Estimate, np.ndarray] | None = None
        self._ended = False
        self._viewers = 0
        application = self._application()
        listener = _listener(place)
        host, port = listener.getsockname()[:2]
        # Whom this machine's own address does not keep out needs a token.
        token = None if ip_address(host.partition("%")[0]).is_loopback else secrets.token_urlsafe(16)
        self.address = f"http://{f'[{host}]' if ':' in host else host}:{port}/"
        if token is not None:
            self.address += f"?token={token}"
        self._server = _server(Guard(application, token))
        self._thread = threading.Thread(
            target=self._server.run, kwargs={"sockets": [listener]}, name="page", daemon=True
        )
        self._thread.start()

    def show(self, estimate: Estimate, subtracted_v: np.ndarray) -> None:
        """Replaces the estimate shown, and with it the subtracted output (C,) V of the same moment."""
        self._latest = estimate, subtracted_v

    def close(self) -> None:
        """Shows the last estimate, tells viewers that the stream has ended, and frees the address."""
        self._ended = True
        until = time.monotonic() + FAREWELL_S
        while self._viewers and time.monotonic() < until:
            time.sleep(FRAME_S)
        self._server.should_exit = True
        self._thread.join(timeout=5.0)

    def _application(self) -> Any:
        # uvicorn imports it too late for an error in one line.
        import websockets  # noqa: F401
        from fastapi import FastAPI, Response, WebSocket, WebSocketDisconnect
        from fastapi.staticfiles import StaticFiles

        application = FastAPI(openapi_url=None)

        @application.websocket("/stream")
        async def stream(viewer: WebSocket) -> None:
            await viewer.accept()
            self._viewers += 1
            try:
                await self._attend(viewer)
            except WebSocketDisconnect:
                return
            finally:
                self._viewers -= 1

        @application.get("/healthz")
        def healthz() -> dict[str, Any]:
            shown = self._latest
            return {
                "status": "ok",
                "time_s": None if shown is None else shown[0].time_s,
                "viewers": self._viewers,
            }

        @application.get("/model")
        def model() -> Response:
            return Response(self._about, media_type="application/json")

        application.mount("/", StaticFiles(directory=_FILES, html=True))
        return application

    async def _attend(self, viewer: Any) -> None:
        """Serves one viewer: the description, then a frame for each request, until it leaves or the stream ends."""
        await viewer.send_text(self._about)
        shown = None
        while (await viewer.receive())["type"] != "websocket.disconnect":
            shown = await self._next(shown)
            await viewer.send_bytes(frame(*shown) if shown else b"")
            if self._ended and shown is self._latest:
                await viewer.close()
                return
            await asyncio.sleep(FRAME_S)

    async def _next(self, shown: tuple[Estimate, np.ndarray] | None) -> tuple[Estimate, np.ndarray] | None:
        """The first estimate after `shown`; after SILENCE_S, or at the end, the latest one."""
        for _ in range(round(SILENCE_S / FRAME_S)):
            if self._latest is not shown or self._ended:
                break
            await asyncio.sleep(FRAME_S)
        return self._latest


def about(card: Card, source: str) -> dict[str, Any]:
    """What a viewer gets once: the sensor, and the names of the numbers of a frame."""
    return {
        "model": card.model,
        "source": source,
        "sensor": card.sensor,
        "reference_mm": card.reference_mm,
        "states": STATES,
        "numbers": NUMBERS,
        "channels": card.channels,
    }


def frame(estimate: Estimate, subtracted_v: np.ndarray) -> bytes:
    """Little-endian: time_s as float64; as float32 the state's index, the NUMBERS, and the channels (C,) in V."""
    numbers = [STATES.index(estimate.state), *(getattr(estimate, name) for name in NUMBERS)]
    return struct.pack("<d", estimate.time_s) + np.array([*numbers, *subtracted_v], "<f4").tobytes()


def _listener(place: str) -> socket.socket:
    host, _, port = place.rpartition(":")
    if not port.isdigit() or int(port) > 65535:
        raise InputError(f"{place}: no port; {PLACE}", "page")
    try:
        where = socket.getaddrinfo(host.strip("[]") or "127.0.0.1", int(port), type=socket.SOCK_STREAM)[0]
    except OSError as error:
        raise InputError(f"{place}: no such host ({error.strerror}); {PLACE}", "page") from None
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


def _server(application: Any) -> Any:
    import uvicorn

    return uvicorn.Server(
        uvicorn.Config(
            application,
            log_config=None,
            log_level="error",
            access_log=False,
            lifespan="off",
            ws="websockets-sansio",
            ws_max_size=1024,
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=1,
            headers=HEADERS,
            http="h11",
            h11_max_incomplete_event_size=MOST_HEADER_BYTES,
            limit_concurrency=MOST_CONNECTIONS,
        )
    )
