"""Sinks of estimates: JSON lines on standard output, UDP, ROS 2."""

import json
import socket
import sys
from contextlib import suppress
from typing import Protocol

from features.errors import InputError
from features.estimate import Estimate
from serve.records import record
from serve.stream.sources import address

KINDS = "'-' writes JSON lines on standard output; udp://HOST:PORT one JSON object a datagram; ros2://TOPIC"


class Sink(Protocol):
    """Anything that takes estimates until it is closed."""

    def write(self, estimate: Estimate) -> None:
        """Passes one estimate on."""

    def close(self) -> None:
        """Releases what the sink holds."""


def open_sink(name: str) -> Sink:
    """The sink of that name (KINDS).

    Raises:
        InputError: no such sink, or a package that it needs is missing.
    """
    if name == "-":
        return Lines()
    if name.startswith("udp://"):
        return Datagrams(*address(name))
    if name.startswith("ros2://"):
        from serve.stream.ros import RosSink

        return RosSink(name.removeprefix("ros2://"))
    raise InputError(f"{name}: unknown kind; {KINDS}", "sink")


class Lines:
    """Standard output, flushed after each line, since a reader may be waiting for it."""

    def write(self, estimate: Estimate) -> None:
        sys.stdout.write(_text(estimate) + "\n")
        sys.stdout.flush()

    def close(self) -> None:
        """Standard output stays open."""


class Datagrams:
    """UDP; a missing listener is not an error."""

    def __init__(self, host: str, port: int) -> None:
        try:
            self._address = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)[0][4]
        except OSError as error:
            raise InputError(f"udp://{host}:{port}: no such host ({error.strerror})", "sink") from None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def write(self, estimate: Estimate) -> None:
        with suppress(ConnectionRefusedError):
            self._socket.sendto(_text(estimate).encode(), self._address)

    def close(self) -> None:
        self._socket.close()


def _text(estimate: Estimate) -> str:
    return json.dumps(record(estimate), allow_nan=False)
