"""Listens to a live source in a thread of its own, and opens it again when it is gone."""

import math
import threading
import time
from collections.abc import Callable
from contextlib import closing
from typing import Any

import numpy as np

from features.errors import InputError
from serve.stream.framing import Chunk
from serve.stream.sources import Source

AGAIN_S = 0.5  # between two attempts to open a source that is gone


class Listener:
    """Collects the samples of a source; `close` ends it.

    opened: how often the source was opened; a recording that spans two of them has a hole.
    trouble: why nothing comes, as the source says it; empty while it is open.
    """

    def __init__(self, reopen: Callable[[], Source]) -> None:
        self.opened, self.trouble = 0, ""
        self._reopen, self._chunks, self._lock = reopen, list[Chunk](), threading.Lock()
        self._heard_s, self._closed = -math.inf, threading.Event()
        self._thread = threading.Thread(target=self._run, args=(reopen(),), daemon=True)
        self._thread.start()

    def take(self) -> list[Chunk]:
        """The chunks that have come since the last call."""
        with self._lock:
            chunks, self._chunks = self._chunks, []
        return chunks

    @property
    def silent_s(self) -> float:
        """How long ago the last sample came; infinite before the first."""
        return time.monotonic() - self._heard_s

    def close(self) -> None:
        """Stops listening and closes the source."""
        self._closed.set()
        self._thread.join()

    def _run(self, source: Source | None) -> None:
        while not self._closed.is_set():
            try:
                self._listen(self._reopen() if source is None else source)
                self.trouble = "it has ended"
            except InputError as error:
                self.trouble = str(error)
            source = None
            self._closed.wait(AGAIN_S)

    def _listen(self, source: Any) -> None:
        self.opened, self.trouble = self.opened + 1, ""
        with closing(source):
            for chunk in source:
                if self._closed.is_set():
                    return
                if chunk:
                    with self._lock:
                        self._chunks.append(chunk)
                    self._heard_s = time.monotonic()


def joined(chunks: list[Chunk], channels: int) -> tuple[np.ndarray, np.ndarray | None]:
    """Chunks as one: volts (n, channels) V, and time_s (n,) s where every one has it."""
    volts = np.concatenate([np.empty((0, channels)), *[volts for volts, _ in chunks]])
    times = [time_s for _, time_s in chunks if time_s is not None]
    return volts, np.concatenate(times) if chunks and len(times) == len(chunks) else None
