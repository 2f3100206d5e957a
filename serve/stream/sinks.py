"""Sinks of estimates: JSON lines on standard output, UDP, ROS 2."""

import socket
import sys
import threading
import time
from queue import SimpleQueue
from typing import Protocol

from softslide.features.errors import InputError
from softslide.features.estimate import Estimate
from softslide.serve.newest import put_newest
from softslide.serve.records import as_json
from softslide.serve.stream.sources import address

KINDS = "'-' writes JSON lines on standard output; udp://HOST:PORT one JSON object a datagram; ros2://TOPIC"


# Lines of a live stream that wait for a reader, a minute of them; beyond it the oldest are dropped.
MOST_WAITING = 3000
# Time, s, that a reader has at the end for those that wait.
END_S = 2.0


class Sink(Protocol):
    """Anything that takes estimates until it is closed."""

    def write(self, estimate: Estimate) -> None:
        """Passes one estimate on."""

    def close(self) -> None:
        """Releases what the sink holds."""


def open_sink(name: str, waits: bool = True) -> Sink:
    """The sink of that name (KINDS). waits: for whoever reads standard output, whom others would have to wait for, too.

    Raises:
        InputError: no such sink, or a package that it needs is missing.
    """
    if name == "-":
        return Lines() if waits else QueuedLines()
    if name.startswith("udp://"):
        return Datagrams(*address(name))
    if name.startswith("ros2://"):
        from softslide.serve.stream.ros import RosSink

        return RosSink(name.removeprefix("ros2://"))
    raise InputError(f"{name}: unknown kind; {KINDS}", "sink")


class Lines:
    """Standard output, flushed after each line, since a reader may be waiting for it."""

    def write(self, estimate: Estimate) -> None:
        sys.stdout.write(as_json(estimate) + "\n")
        sys.stdout.flush()

    def close(self) -> None:
        """Standard output stays open."""


class QueuedLines(Lines):
    """Standard output from a thread of its own: a reader that does not read holds up neither stream nor sinks."""

    def __init__(self) -> None:
        # With when each was handed on, s.
        self._waiting: SimpleQueue[tuple[Estimate, float] | None] = SimpleQueue()
        self._dropped = self._left = False
        self._writer = threading.Thread(target=self._write_all, name="standard output", daemon=True)
        self._writer.start()

    def write(self, estimate: Estimate) -> None:
        if self._left:
            raise BrokenPipeError
        if put_newest(self._waiting, (estimate, time.monotonic()), MOST_WAITING) and not self._dropped:
            self._dropped = True
            print(
                "softslide serve: standard output is not read; its oldest lines are dropped", file=sys.stderr
            )

    def close(self) -> None:
        """Waits for a reader that reads."""
        self._waiting.put(None)
        self._writer.join(END_S)

    def _write_all(self) -> None:
        try:
            while (waiting := self._waiting.get()) is not None:
                estimate, since_s = waiting
                waited_s = time.monotonic() - since_s
                super().write(estimate._replace(age_s=round(estimate.age_s + waited_s, 3)))
        except OSError:
            self._left = True


class Datagrams:
    """UDP; a missing listener, or a network that is gone for a while, is not an error."""

    def __init__(self, host: str, port: int) -> None:
        try:
            self._address = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)[0][4]
        except (OSError, UnicodeError):
            raise InputError(f"udp://{host}:{port}: no such host; name another", "sink") from None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._name, self._lost = f"udp://{host}:{port}", False

    def write(self, estimate: Estimate) -> None:
        try:
            self._socket.sendto(as_json(estimate).encode(), self._address)
        except ConnectionRefusedError:
            return
        except OSError as error:
            if not self._lost:
                print(f"softslide serve: {self._name} cannot be reached ({error.strerror})", file=sys.stderr)
            self._lost = True

    def close(self) -> None:
        self._socket.close()
