"""Samples over UDP, and a count of what was lost on the way.

A datagram may begin with a line `#N`, its number: a gap in the numbers is a loss on the network or anywhere else. What
overran this computer's receive buffer, Linux tells besides. Where samples carry no time, what was lost is made up for
by empty samples, so that time does not run short.
"""

import socket
import sys
from collections.abc import Iterator

import numpy as np

from features.errors import InputError
from serve.stream.framing import Chunk, framing_of

# Asked of the system, which grants what it allows: 4 MB hold half a minute of one accelerometer at 1 kHz as text.
BUFFER_BYTES = 1 << 22
# Larger than any datagram.
_READ_BYTES = 1 << 16
# Linux, socket(7): the number of datagrams dropped so far comes beside each one.
_SO_RXQ_OVFL = 40
# A gap of more is a sender that started anew.
MOST_LOST = 100_000


class Datagrams:
    """A socket that listens. lost: datagrams so far that did not come."""

    def __init__(self, name: str, host: str, port: int, wait_s: float) -> None:
        """name: of the source, for messages.

        Raises:
            InputError: nothing can listen there.
        """
        self._name, self.lost = name, 0
        self._dropped = 0
        self._number: int | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise InputError(
                f"{name}: cannot listen there ({error.strerror}); name another port", "source"
            ) from None
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        self._counts = sys.platform == "linux"
        if self._counts:
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
        self._socket.settimeout(wait_s)

    def chunks(self, form: str, channels: int) -> Iterator[Chunk | tuple[()]]:
        """Chunks as they come, () after the time to wait. form, channels: as in serve/stream/framing.py."""
        usual = 0
        try:
            while True:
                try:
                    data, missed = self._received()
                except TimeoutError:
                    yield ()
                    continue
                # A datagram is whole or lost: the rest of one is not the beginning of the next.
                framing = framing_of(form, channels, strict=False)
                pieces = [*framing.read(data), *framing.end()]
                if missed and pieces and pieces[0][1] is None:
                    yield np.full((missed * max(usual, 1), channels), np.nan), None
                yield from pieces
                usual = sum(len(volts) for volts, _ in pieces) or usual
        finally:
            self._socket.close()
            if self.lost:
                print(
                    f"{self._name}: {self.lost} datagrams were lost; send fewer, larger ones, or stamp the samples",
                    file=sys.stderr,
                )

    def _received(self) -> tuple[bytes, int]:
        """The next datagram without its number, and how many before it did not come."""
        if not self._counts:
            data, dropped = self._socket.recv(_READ_BYTES), 0
        else:
            data, beside, _, _ = self._socket.recvmsg(_READ_BYTES, socket.CMSG_SPACE(4))
            told = [int.from_bytes(value, sys.byteorder) for _, kind, value in beside if kind == _SO_RXQ_OVFL]
            dropped = ((told[0] if told else self._dropped) - self._dropped) % (1 << 32)
            self._dropped = told[0] if told else self._dropped
        data, missed = self._without_number(data)
        missed = dropped if missed is None else missed
        self.lost += missed
        return data, missed

    def _without_number(self, data: bytes) -> tuple[bytes, int | None]:
        """The datagram without its number, and how many it skips; None without a number."""
        line, end, rest = data.partition(b"\n")
        digits = line[1:].strip()
        if not (line.startswith(b"#") and end and digits.isdigit() and len(digits) < 20):
            return data, None
        number, before = int(digits), self._number
        self._number = number
        missed = 0 if before is None else number - before - 1
        return rest, missed if 0 <= missed <= MOST_LOST else 0
