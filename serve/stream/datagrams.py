"""Samples of one sender over UDP, and a count of what was lost on the way.

A datagram may begin with a line `#N`, its number: a gap in the numbers is a loss on the network or anywhere else. Linux
also counts what overran this computer's receive buffer. Where samples carry no time, empty samples take the place of
what was lost, so that time does not run short. Other senders are not heard while the first one sends.
"""

import socket
import sys
import time
from collections.abc import Iterator

import numpy as np

from softslide.features.errors import InputError
from softslide.serve.stream.framing import Chunk, framing_of

# Asked of the system, which grants what it allows: 4 MB hold half a minute of one accelerometer at 1 kHz as text.
BUFFER_BYTES = 1 << 22
# Larger than any datagram.
_READ_BYTES = 1 << 16
# Linux, socket(7): the number of datagrams dropped so far comes with each one.
_SO_RXQ_OVFL = 40
# A gap of more is a sender that started anew.
MOST_LOST = 100_000
# Empty samples in a row: more than any localizer bridges, so that it begins anew. A longer gap is no longer in time.
MOST_EMPTY = 20_000
# s of silence after which another sender is heard, as a new stream.
SILENT_S = 1.0


class Datagrams:
    """A socket that listens. lost: datagrams so far that did not come; others: those of other senders."""

    def __init__(self, name: str, host: str, port: int, wait_s: float) -> None:
        """name: of the source, for messages.

        Raises:
            InputError: nothing can listen there.
        """
        self._name, self.lost, self.others = name, 0, 0
        self._sender: tuple[tuple[str, int], float] | None = None  # and when it last sent
        self._dropped = 0
        self._number: int | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except (OSError, UnicodeError) as error:
            self._socket.close()
            why = getattr(error, "strerror", "no such host")
            raise InputError(f"{name}: cannot listen there ({why}); name another place", "source") from None
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        self._counts = sys.platform == "linux"
        if self._counts:
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
        self._socket.settimeout(wait_s)

    def chunks(self, form: str, channels: int) -> Iterator[Chunk | tuple[()]]:
        """Chunks as they come, () after the time to wait and for a datagram without samples or of another sender.

        form, channels: as in serve/stream/framing.py.
        """
        usual = 0
        try:
            while True:
                try:
                    data, missed = self._received()
                except TimeoutError:
                    data = None
                if data is None:
                    yield ()
                    continue
                # A datagram is whole or lost: the rest of one is not the beginning of the next.
                framing = framing_of(form, channels, strict=False)
                pieces = [*framing.read(data), *framing.end()]
                if missed and pieces and pieces[0][1] is None:
                    yield np.full((min(missed * max(usual, 1), MOST_EMPTY), channels), np.nan), None
                yield from pieces
                if not pieces:
                    yield ()
                usual = sum(len(volts) for volts, _ in pieces) or usual
        finally:
            self._socket.close()
            for count, what in (
                (self.others, "of other senders were left out"),
                (self.lost, "were lost; send fewer, larger ones, or stamp the samples"),
            ):
                if count:
                    print(f"{self._name}: {count} datagrams {what}", file=sys.stderr)

    def _received(self) -> tuple[bytes | None, int]:
        """The next datagram without its number, None if it is another sender's, and how many did not come before it."""
        if not self._counts:
            (data, sender), dropped = self._socket.recvfrom(_READ_BYTES), 0
        else:
            data, ancillary, _, sender = self._socket.recvmsg(_READ_BYTES, socket.CMSG_SPACE(4))
            counts = [
                int.from_bytes(value, sys.byteorder) for _, kind, value in ancillary if kind == _SO_RXQ_OVFL
            ]
            count = counts[0] if counts else self._dropped
            dropped = (count - self._dropped) % (1 << 32)
            self._dropped = count
        now_s = time.monotonic()
        anew = False
        if self._sender is not None and sender != self._sender[0]:
            if now_s - self._sender[1] < SILENT_S:
                self.others += 1
                return None, 0
            anew = True
        self._sender = sender, now_s
        data, missed = self._without_number(data)
        if anew:
            return data, MOST_LOST
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
