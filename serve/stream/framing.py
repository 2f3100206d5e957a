"""From bytes to samples: lines of numbers, or frames of float32."""

import math
from collections.abc import Iterator
from typing import Protocol

import numpy as np

from softslide.features.errors import InputError

Chunk = tuple[np.ndarray, np.ndarray | None]
# Longer than any line of samples: an unfinished line beyond it is an error.
_LINE_BYTES = 1 << 16


def framing_of(form: str, channels: int, strict: bool = True, midway: bool = False) -> "Framing":
    """A reader of bytes in pieces of any size; it keeps an unfinished sample for the next piece.

    form: csv, lines of the channels' volts with or without a time in s before them, where a first line of names and
    empty lines are skipped; or f32, little-endian float32, one for each channel. strict, midway: as in `Lines`; frames
    have no mark of where they begin, so that a stream of them must be read from its beginning.
    """
    return Lines(channels, strict, midway) if form == "csv" else Frames(channels)


class Framing(Protocol):
    """Bytes in, chunks out."""

    def read(self, data: bytes) -> Iterator[Chunk]:
        """The samples that these bytes complete."""

    def end(self) -> Iterator[Chunk]:
        """The last sample, where the end of the stream completes it."""


class Frames:
    """float32 frames one after the other."""

    def __init__(self, channels: int) -> None:
        self._channels, self._rest = channels, b""

    def read(self, data: bytes) -> Iterator[Chunk]:
        data = self._rest + data
        whole = len(data) - len(data) % (4 * self._channels)
        self._rest = data[whole:]
        if whole:
            yield np.frombuffer(data[:whole], dtype="<f4").reshape(-1, self._channels), None

    def end(self) -> Iterator[Chunk]:
        yield from ()


class Lines:
    """Lines of comma-separated numbers. The first valid one decides whether a time comes before the volts.

    strict: a line that is not a sample is an error; otherwise it is skipped, as a lost sample.
    midway: the stream may be joined in the middle of a line, which is then dropped: the rest of one could pass for
    a sample.
    """

    def __init__(self, channels: int, strict: bool, midway: bool = False) -> None:
        self._channels, self._strict, self._midway = channels, strict, midway
        self._rest, self._line, self._size = b"", 0, 0

    def read(self, data: bytes) -> Iterator[Chunk]:
        if self._midway:
            _, end, data = data.partition(b"\n")
            self._midway = not end
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > _LINE_BYTES:
            raise InputError(f"line {self._line + 1} does not end; send one sample a line, or float32 frames")
        rows = [row for line in lines if (row := self._row(line)) is not None]
        if rows:
            table = np.array(rows)
            yield (table[:, 1:], table[:, 0]) if self._size > self._channels else (table, None)

    def end(self) -> Iterator[Chunk]:
        yield from self.read(b"\n")

    def _row(self, line: bytes) -> list[float] | None:
        self._line += 1
        text = line.decode("utf-8", "replace").strip()
        if not text:
            return None
        try:
            row = [float(cell) if cell.strip() else math.nan for cell in text.split(",")]
            wrong = self._wrong(row)
        except ValueError:
            if self._line == 1:
                return None
            wrong = f"'{text[:60]}' is no line of numbers; send volts"
        if not wrong:
            self._size = len(row)
            return row
        if self._strict:
            raise InputError(f"line {self._line}: {wrong}")
        return None

    def _wrong(self, row: list[float]) -> str:
        if len(row) not in (self._channels, self._channels + 1):
            return f"{len(row)} numbers; send {self._channels} volts, or time_s (s) and these"
        if self._size not in (0, len(row)):
            return "time_s comes and goes; send it always or never"
        if len(row) > self._channels and not math.isfinite(row[0]):
            return f"time_s is {row[0]}; send a finite time in s"
        return ""
