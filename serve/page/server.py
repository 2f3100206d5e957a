"""The page's web server: shows every viewer the latest estimate. It runs in a process of its own (process.py).

A viewer asks for each frame, so that at most one is on its way to it: a slow viewer sees fewer frames, not older ones.
"""

import asyncio
import csv
import io
import json
import math
import struct
import threading
import time
from collections import deque
from collections.abc import Callable
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from softslide.features.card import Card
from softslide.features.contact.places import MOST_PLACES, Place
from softslide.features.errors import InputError
from softslide.features.estimate import RECORDED, Contact, Estimate, Reason
from softslide.features.stream.tracker import SlideState
from softslide.serve.page.guard import HEADERS, Guard

# Blocks come 50 times a second; a screen needs no more than this.
FRAME_S = 1 / 40
# After this time without a new estimate the last frame is sent again, so that a viewer that has left is noticed.
SILENCE_S = 1.0
# Time that viewers have at the end to ask for the last frame.
FAREWELL_S = 0.5
# A browser's request has about 1 kB of headers.
MOST_HEADER_BYTES = 1 << 14
# Half-open ones among them; a request is complete within REQUEST_S, the next one of its connection too, and a body
# within BODY_S, or it is refused.
MOST_CONNECTIONS = 512
REQUEST_S = 5.0
BODY_S = 20.0
# A recording as CSV: half an hour at 1 kHz of one accelerometer.
MOST_BYTES = 1 << 26
# Recordings that are estimated at once, each of MOST_BYTES at most; and bytes of all that are here, those on their way
# included: beyond it they are refused.
MOST_BODIES = 4
MOST_HELD_BYTES = MOST_BODIES * MOST_BYTES
# Frames that can be replayed and downloaded: five minutes of blocks of 20 ms, 3 MB.
KEPT = 15_000
STATES, CONTACTS, REASONS = tuple(SlideState), tuple(Contact), tuple(Reason)
# What a frame holds besides time and state; of a word its index.
WORDS: dict[str, tuple[str, ...]] = {"contact": CONTACTS, "reason": REASONS}
PLACES = tuple(f"place_{n}_{name}" for n in range(1, MOST_PLACES + 1) for name in Place._fields)
NUMBERS = (*(name for name in RECORDED if name not in ("time_s", "state", "places")), *PLACES)
_FILES = Path(__file__).with_name("static")


class Server:
    """Serves from a thread once it is made, until it is closed."""

    def __init__(
        self,
        listener: Any,
        description: str,
        token: tuple[str, bool],
        zero: Callable[[], None],
        predict: Callable[[bytes], dict[str, Any]],
    ) -> None:
        """listener: a socket that listens. token: with whether only this machine can connect, as in `Guard`.
        description: of `about`, as JSON. zero: asks for a new static output.
        predict: the estimate of a recording in CSV."""
        self._about, self._zero, self._predict = description, zero, predict
        self._kept: deque[bytes] = deque(maxlen=KEPT)
        self._ended = False
        self._viewers = 0
        self._held_bytes = 0
        self._server = _server(Guard(self._application(), *token))
        self._thread = threading.Thread(
            target=self._server.run, kwargs={"sockets": [listener]}, name="page", daemon=True
        )
        self._thread.start()

    @property
    def _latest(self) -> bytes | None:
        return self._kept[-1] if self._kept else None

    def wait(self) -> None:
        """Returns once it answers."""
        while self._thread.is_alive() and not self._server.started:
            time.sleep(FRAME_S)

    def show(self, shown: bytes) -> None:
        """Replaces the frame shown."""
        self._kept.append(shown)

    def close(self) -> None:
        """Shows the last estimate, informs viewers that the stream has ended, and frees the address."""
        self._ended = True
        until = time.monotonic() + FAREWELL_S
        while self._viewers and time.monotonic() < until:
            time.sleep(FRAME_S)
        self._server.should_exit = True
        self._thread.join(timeout=5.0)

    def _application(self) -> Any:
        from fastapi import FastAPI, HTTPException, Request, Response, WebSocket, WebSocketDisconnect
        from fastapi.concurrency import run_in_threadpool
        from fastapi.staticfiles import StaticFiles

        application = FastAPI(title="softslide", docs_url=None, redoc_url=None)
        bodies = asyncio.Semaphore(MOST_BODIES)

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
            time_s = None if shown is None else struct.unpack_from("<d", shown)[0]
            return {"status": "ok", "time_s": time_s, "viewers": self._viewers}

        @application.get("/model")
        def model() -> Response:
            return Response(self._about, media_type="application/json")

        @application.get("/frames")
        def frames() -> Response:
            return Response(b"".join(self._kept), media_type="application/octet-stream")

        @application.get("/estimates.csv")
        def estimates() -> Response:
            named = {"Content-Disposition": "attachment; filename=estimates.csv"}
            table = as_csv(list(self._kept), json.loads(self._about)["channels"])
            return Response(table, media_type="text/csv", headers=named)

        @application.post("/zero")
        def zero() -> dict[str, str]:
            self._zero()
            return {"status": "ok"}

        @application.post(
            "/predict", openapi_extra={"requestBody": {"content": {"text/csv": {}}, "required": True}}
        )
        async def predict(request: Request) -> dict[str, Any]:
            """The estimate at the end of a recording: CSV with time_s (s) and each channel (V)."""
            sent = bytearray()
            try:
                try:
                    async with asyncio.timeout(BODY_S):
                        async for part in request.stream():
                            sent += part
                            self._held_bytes += len(part)
                            if len(sent) > MOST_BYTES:
                                raise HTTPException(413, f"more than {MOST_BYTES >> 20} MB")
                            if self._held_bytes > MOST_HELD_BYTES:
                                raise HTTPException(503, "too many recordings at once; send it later")
                except TimeoutError:
                    raise HTTPException(408, f"not sent within {BODY_S:g} s") from None
                async with bodies:
                    return await run_in_threadpool(self._predict, bytes(sent))
            except InputError as error:
                raise HTTPException(422, str(error)) from None
            finally:
                self._held_bytes -= len(sent)

        application.mount("/", StaticFiles(directory=_FILES, html=True))
        return application

    async def _attend(self, viewer: Any) -> None:
        """Serves one viewer: the description, then a frame for each request, until it leaves or the stream ends."""
        await viewer.send_text(self._about)
        shown: bytes | None = None
        while (await viewer.receive())["type"] != "websocket.disconnect":
            shown = await self._next(shown)
            await viewer.send_bytes(shown or b"")
            if self._ended and shown is self._latest:
                await viewer.close()
                return
            await asyncio.sleep(FRAME_S)

    async def _next(self, shown: bytes | None) -> bytes | None:
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
        "words": WORDS,
        "numbers": NUMBERS,
        "channels": card.channels,
    }


def frame(estimate: Estimate, subtracted_v: np.ndarray) -> bytes:
    """Little-endian: time_s as float64; as float32 the state's index, the NUMBERS and the channels (C,) in V.

    Of a word its index in WORDS; NaN for places that there are not.
    """
    values = estimate._asdict() | dict(zip(PLACES, chain(*estimate.places), strict=False))
    numbers = [STATES.index(estimate.state)]
    for name in NUMBERS:
        value = values.get(name, math.nan)
        numbers.append(WORDS[name].index(value) if name in WORDS else value)
    return struct.pack("<d", estimate.time_s) + np.array([*numbers, *subtracted_v], "<f4").tobytes()


def as_csv(frames: list[bytes], channels: list[str]) -> str:
    """Frames as a table: time and state, NUMBERS with words as words, the subtracted output in V; empty: not known."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["time_s", "state", *NUMBERS, *(f"{channel}_subtracted_v" for channel in channels)])
    for shown in frames:
        state, *values = np.frombuffer(shown, "<f4", offset=8).tolist()
        cells = [f"{value:.7g}" if np.isfinite(value) else "" for value in values]
        for name, words in WORDS.items():
            place = NUMBERS.index(name)
            cells[place] = words[int(values[place])]
        writer.writerow([f"{struct.unpack_from('<d', shown)[0]:.6f}", STATES[int(state)], *cells])
    return text.getvalue()


def _server(application: Any) -> Any:
    import uvicorn
    from uvicorn.protocols.http.h11_impl import H11Protocol

    class InTime(H11Protocol):
        """Closes a connection that has sent no whole request within REQUEST_S of its opening, or of its last answer."""

        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self.loop.call_later(REQUEST_S, self._close_unasked, None)

        def on_response_complete(self) -> None:
            # Before the next request, which may have come already.
            self.loop.call_later(REQUEST_S, self._close_unasked, self.cycle)
            super().on_response_complete()

        def _close_unasked(self, last: Any) -> None:
            # A viewer's stream has left the connections that answer requests.
            if self.cycle is last and self in self.connections:
                self.transport.close()

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
            http=InTime,
            h11_max_incomplete_event_size=MOST_HEADER_BYTES,
            limit_concurrency=MOST_CONNECTIONS,
        )
    )
