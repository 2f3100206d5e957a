"""Sources of samples: a recording, standard input, UDP, a serial port, a ROS 2 topic.

A source yields chunks (volts (n, C) V, time_s (n,) s or None), and () when nothing has come for WAIT_S, or nothing with
a sample in it, so that the reader can stop. The localizer judges the values; here only input that is not a sample at
all is refused.
"""

import io
import queue
import sys
import threading
import time
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np

from softslide.features.card import Card
from softslide.features.errors import InputError
from softslide.serve.address import host_and_port
from softslide.serve.stream.datagrams import Datagrams
from softslide.serve.stream.framing import Chunk, Framing, framing_of

Source = Iterator[Chunk | tuple[()]]
KINDS = (
    "FILE.csv or FILE.parquet plays a recording; '-' reads standard input; udp://HOST:PORT; "
    "serial:///dev/PORT?BAUD (default: 1000000); ros2://TOPIC; in 'serve' ros2+imu://TOPIC"
)
WAIT_S = 0.2
# Of a serial port unless its name says another: that of docs/hardware/stream.ino.
BAUD = 1_000_000
_READ_BYTES = 1 << 16
# Pieces read ahead of the stream; a writer that is faster waits.
_WAITING = 16


def open_source(name: str, card: Card, form: str) -> Source:
    """The live source of that name (KINDS). form: csv or f32, of bytes that come in.

    Raises:
        InputError: no such source, or a package that it needs is missing.
    """
    if name.startswith("ros2+imu://"):
        from softslide.serve.stream.ros import accelerations

        return accelerations(name.removeprefix("ros2+imu://"), card)
    return open_live(name, len(card.columns), form)


def is_live(name: str) -> bool:
    """Whether a source is not a file."""
    return name == "-" or "://" in name


def open_live(name: str, columns: int, form: str) -> Source:
    """A source of samples of so many columns (`Card.columns`) that is not a file.

    Raises:
        InputError: as `open_source`.
    """
    if name == "-":
        return _bytes_from(sys.stdin.buffer, framing_of(form, columns))
    if name.startswith("udp://"):
        return Datagrams(name, *address(name), WAIT_S).chunks(form, columns)
    if name.startswith("serial://"):
        return _serial(name, framing_of(form, columns, strict=False, midway=True))
    if name.startswith("ros2://"):
        from softslide.serve.stream.ros import samples

        return samples(name.removeprefix("ros2://"), columns)
    raise InputError(f"{name}: unknown kind; {KINDS}", "source")


def _bytes_from(stream: BinaryIO, framing: Framing) -> Source:
    """Until the stream ends. A thread reads it: no system but Unix can wait for a pipe with a time limit."""
    # A buffered reader would wait for more than what has come.
    raw = stream.raw if isinstance(stream, io.BufferedReader) else stream
    pieces: queue.Queue[bytes] = queue.Queue(_WAITING)

    def read() -> None:
        while data := raw.read(_READ_BYTES):
            pieces.put(data)
        pieces.put(b"")

    threading.Thread(target=read, name="standard input", daemon=True).start()
    while True:
        try:
            data = pieces.get(timeout=WAIT_S)
        except queue.Empty:
            yield ()
            continue
        if not data:
            break
        yield from framing.read(data)
        yield ()
    yield from framing.end()


def _serial(name: str, framing: Framing) -> Source:
    import serial

    port, _, baud = name.removeprefix("serial://").partition("?")
    if baud and not (baud.isascii() and baud.isdigit()):
        raise InputError(f"{name}: '{baud}' is no baud rate; write serial:///dev/ttyUSB0?{BAUD}", "source")
    try:
        port_open = serial.Serial(port, int(baud or BAUD), timeout=WAIT_S)
    except (OSError, ValueError) as error:
        raise InputError(f"{name}: cannot be opened ({' '.join(str(error).split())})", "source") from None
    return _heard(name, port_open, framing)


def _heard(name: str, port: BinaryIO, framing: Framing) -> Source:
    with port:
        while True:
            try:
                data = port.read(max(1, getattr(port, "in_waiting", 1)))
            except OSError as error:
                raise InputError(f"{name}: the port is gone ({error}); plug it in again", "source") from None
            yield from framing.read(data)
            yield ()


def played(volts: np.ndarray, card: Card, fast: bool) -> Source:
    """A block at a time, at the recorded rate or as fast as possible."""
    size = card.samples_per_block
    begun = time.monotonic()
    for begin in range(0, len(volts), size):
        chunk = volts[begin : begin + size]
        if not fast:
            due = begun + (begin + len(chunk)) / card.sample_rate_hz
            time.sleep(max(0.0, due - time.monotonic()))
        yield chunk, None


def address(name: str) -> tuple[str, int]:
    """HOST and PORT of udp://HOST:PORT; without a host 127.0.0.1.

    Raises:
        InputError: no port.
    """
    host, port = host_and_port(name.removeprefix("udp://"))
    if not port:
        raise InputError(f"{name}: no port; write udp://127.0.0.1:9000")
    return host, port
