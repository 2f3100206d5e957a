"""From bytes to samples: lines of numbers, or frames, with a mark between them or without."""

import binascii
import math
from collections.abc import Iterator

import numpy as np

from softslide.features.errors import InputError

Chunk = tuple[np.ndarray, np.ndarray | None]
# Longer than any line of samples: an unfinished line beyond it is an error.
_LINE_BYTES = 1 << 16


def framing_of(form: str, channels: int, strict: bool = True, midway: bool = False) -> "Framing":
    """A reader of bytes in pieces of any size; it keeps an unfinished sample for the next piece.

    Its `read` gives the samples that bytes complete, its `end` the last one where the end of the stream completes it.
    form: csv, lines of the channels' volts with or without a time in s before them, where a first line of names and
    empty lines are skipped; f32, little-endian float32, one for each channel, whose stream must be read from its
    beginning; or cobs, as in `MarkedFrames`. strict, midway: as in `Lines`.
    """
    if form == "csv":
        return Lines(channels, strict, midway)
    return MarkedFrames(channels) if form == "cobs" else Frames(channels)


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


class MarkedFrames:
    """Frames with zeros between them, each a sample, in bytes without zeros (COBS: S. Cheshire and M. Baker, 1999).

    A frame holds, little-endian, time_s as float64, the channels' volts as float32 and the CRC-16 of these (XMODEM). It
    can be joined anywhere; a frame that arrives damaged is skipped, as a lost sample.
    """

    def __init__(self, channels: int) -> None:
        self._sample = np.dtype([("time_s", "<f8"), ("volts", "<f4", (channels,)), ("crc", "<u2")])
        self._rest = b""

    def read(self, data: bytes) -> Iterator[Chunk]:
        *frames, self._rest = (self._rest + data).split(b"\0")
        if len(self._rest) > _LINE_BYTES:
            raise InputError("a frame does not end; send COBS frames with a zero after each")
        whole = [sample for frame in frames if (sample := self._checked(frame))]
        if whole:
            samples = np.frombuffer(b"".join(whole), self._sample)
            yield samples["volts"], samples["time_s"]

    def end(self) -> Iterator[Chunk]:
        yield from self.read(b"\0")

    def _checked(self, frame: bytes) -> bytes:
        """The sample in a frame; empty if it is none."""
        sample = _unstuffed(frame)
        right = (
            len(sample) == self._sample.itemsize
            and binascii.crc_hqx(sample[:-2], 0) == int.from_bytes(sample[-2:], "little")
            and math.isfinite(np.frombuffer(sample[:8], "<f8")[0])
        )
        return sample if right else b""


def _unstuffed(frame: bytes) -> bytes:
    """What COBS made a frame of; empty if it is not one."""
    found, at = bytearray(), 0
    while at < len(frame):
        count = frame[at]
        if at + count > len(frame):
            return b""
        found += frame[at + 1 : at + count]
        at += count
        if count < 255 and at < len(frame):
            found.append(0)
    return bytes(found)


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


Framing = Lines | Frames | MarkedFrames
