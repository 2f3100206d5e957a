"""One slide from a live source: a thread listens, and samples with an even clock come out, or the reason why not."""

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import linprog

from softslide.features.angles import tilt_channels
from softslide.features.clock import RATE_TOLERANCE, check_clock
from softslide.features.errors import InputError
from softslide.features.stream.conditioning import Conditioning
from softslide.pipeline.checks.rail_run import MOST_AT_RAIL, rail_run
from softslide.pipeline.recordings.folder import Recording
from softslide.pipeline.recordings.successive_means import successive_means
from softslide.pipeline.sensor import Sensor
from softslide.serve.stream.framing import Chunk
from softslide.serve.stream.sources import Source, open_live

AGAIN_S = 0.5  # between two attempts to open a source that is gone
POLL_S = 0.05
# Samples arrive in bundles: of a stream without times, the moments of the first and the last are known this well.
ARRIVAL_S = 0.5
BLOCK_S = Conditioning.block_s  # a level is the mean over one
FAINT = 6.0  # times the rest's deviation: a peak below it is no contact
# Shares of the peak from which on the output is off its rest before the stage moves, or after it has stopped.
EARLY, LATE = 0.1, 0.5
NOT_BACK = 0.3  # share of the peak that the output is off its rest by at the end; the lag's remainder is less


class Listener:
    """Collects the samples of a sensor's live source; `close` ends it.

    source, form: as of `open_live`. timeout_s: silence that counts as a pulled cable.
    opened: how often the source was opened; a recording that spans two of them has a hole.
    trouble: why nothing comes, as the source says it; empty while it is open.
    """

    def __init__(self, source: str, sensor: Sensor, form: str, timeout_s: float) -> None:
        self.source, self.sensor, self._form, self._timeout_s = source, sensor, form, timeout_s
        self.opened, self.trouble = 0, ""
        self._chunks = deque[Chunk]()
        self._heard_s, self._closed = -math.inf, threading.Event()
        self._thread = threading.Thread(target=self._run, args=(self._open(),), daemon=True)
        self._thread.start()

    def take(self) -> list[Chunk]:
        """The chunks that have come since the last call."""
        return [self._chunks.popleft() for _ in range(len(self._chunks))]

    def why_silent(self) -> str:
        """Why nothing comes, or has come for so long; empty where samples come."""
        silent = time.monotonic() - self._heard_s > self._timeout_s
        return self.trouble or (f"nothing has come for {self._timeout_s:g} s" if silent else "")

    def wait(self, longest_s: float, say: Callable[[str], None]) -> None:
        """Returns once samples come; says meanwhile why they do not.

        Raises:
            InputError: none came for so long.
        """
        begun_s, said = time.monotonic(), ""
        while self.why_silent():
            reason = self.trouble or "nothing comes"
            if reason != said:
                say(f"waiting for {self.source}: {reason}")
                said = reason
            if time.monotonic() - begun_s > longest_s:
                raise InputError(
                    f"{self.source}: nothing came for {longest_s:g} s; what is recorded is kept, run the same command "
                    "to go on"
                )
            time.sleep(POLL_S)

    def close(self) -> None:
        """Stops listening and closes the source."""
        self._closed.set()
        self._thread.join()

    def _open(self) -> Source:
        return open_live(self.source, len(self.sensor.columns), self._form)

    def _run(self, source: Source | None) -> None:
        while not self._closed.is_set():
            try:
                self._listen(self._open() if source is None else source)
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
                    self._chunks.append(chunk)
                    self._heard_s = time.monotonic()


class Lost(Exception):
    """A slide that cannot be kept. The message says why."""


@dataclass(frozen=True)
class Phases:
    """Of a recording, in s: rest before the motion, time to start the stage in, motion, rest after it."""

    rest_s: float
    start_s: float
    motion_s: float

    @property
    def whole_s(self) -> float:
        """The whole recording's duration."""
        return self.rest_s + self.start_s + self.motion_s + self.rest_s


def capture(
    listener: Listener, name: str, phases: Phases, show: Callable[[float, float], None]
) -> tuple[Recording, np.ndarray]:
    """Records for `phases.whole_s` from now on. Returns the recording, and its clock's line over the monotonic one:
    slope and intercept (2,), s, by the samples that came most promptly.

    show: is given the s recorded and the present level (V).

    Raises:
        Lost: the source went silent or was opened anew, samples are missing or no numbers, or their rate is wrong.
    """
    sensor = listener.sensor
    wanted, begun_s = round(phases.whole_s * sensor.sample_rate_hz), time.monotonic()
    chunks, arrived = _heard(listener, wanted, phases.rest_s, show)
    time_s = _sampled_s(name, chunks, sensor.sample_rate_hz, time.monotonic() - begun_s)
    line = clock_line(np.array([at for at, _ in arrived]), time_s[[n - 1 for _, n in arrived]])
    volts = np.concatenate([volts for volts, _ in chunks])[:wanted]
    volts, base_v = np.split(volts, [len(sensor.channels)], axis=1)
    return Recording(name, time_s[:wanted], volts, base_v=None if sensor.base is None else base_v), line


def _heard(
    listener: Listener, wanted: int, rest_s: float, show: Callable[[float, float], None]
) -> tuple[list[Chunk], list[tuple[float, int]]]:
    """The chunks of so many samples from now on; and as they came, s of the monotonic clock and samples so far."""
    listener.take()
    opened, chunks, arrived, count = listener.opened, list[Chunk](), list[tuple[float, int]](), 0
    rate = listener.sensor.sample_rate_hz
    level = Level(rest_s * rate)
    while count < wanted:
        time.sleep(POLL_S)
        new = listener.take()
        if reason := listener.why_silent():
            raise Lost(reason)
        if listener.opened != opened:
            raise Lost("the source was opened anew; samples are missing")
        if not all(np.isfinite(volts).all() for volts, _ in new):
            raise Lost("a sample is no finite number; see what the source sends")
        if new:
            chunks += new
            count += sum(len(volts) for volts, _ in new)
            arrived.append((time.monotonic(), count))
        show(count / rate, level.of(new))
    return chunks, arrived


def _sampled_s(name: str, chunks: list[Chunk], rate_hz: float, took_s: float) -> np.ndarray:
    """When samples were taken (n,) s, from the first on; by their number where not every chunk has times.

    took_s: of the monotonic clock, for all of them.
    """
    times = [time_s for _, time_s in chunks if time_s is not None]
    if len(times) < len(chunks):
        count = sum(len(volts) for volts, _ in chunks)
        if abs(count / rate_hz - took_s) > ARRIVAL_S + RATE_TOLERANCE * took_s:
            raise Lost(
                f"{count} samples came in {took_s:.1f} s, sensor.toml says {rate_hz:g} Hz; samples were lost, or the "
                "rate is another"
            )
        return np.arange(count) / rate_hz
    time_s = np.concatenate(times)
    time_s = time_s - time_s[0]
    try:
        check_clock(Path(name), time_s, rate_hz)
    except InputError as error:
        raise Lost(str(error).removeprefix(f"{name}: ")) from None
    return time_s


def clock_line(arrived_s: np.ndarray, sampled_s: np.ndarray) -> np.ndarray:
    """Slope and intercept (2,) of moments (n,) s at which samples were taken over those at which they came.

    No sample comes before it is taken: of all lines that say so the nearest one, by linear programming (S. B. Moon, P.
    Skelly, D. Towsley, 1999). Waits of a busy machine do not move it.
    """
    since_s = arrived_s - arrived_s[0]
    rows = np.column_stack([since_s, np.ones_like(since_s)])
    found = linprog(rows.mean(axis=0), A_ub=-rows, b_ub=-sampled_s, bounds=[(None, None)] * 2)
    slope, intercept = found.x
    return np.array([slope, intercept - slope * arrived_s[0]])


class Level:
    """How far the tilt outputs are from where they were in the first `samples`."""

    def __init__(self, samples: float) -> None:
        self._samples, self._count, self._mean = samples, 0, np.zeros(1)

    def of(self, chunks: list[Chunk]) -> float:
        """The largest deviation (V) of the last chunk's means; 0 where there is none. Samples that are no numbers are
        left out."""
        off_v = 0.0
        for volts, _ in chunks:
            tilt = volts[:, tilt_channels(volts.shape[1])]
            if not np.isfinite(tilt).all():
                continue
            if self._count < self._samples:
                self._mean = (self._mean * self._count + tilt.sum(axis=0)) / (self._count + len(tilt))
                self._count += len(tilt)
            off_v = float(np.abs(tilt.mean(axis=0) - self._mean).max())
        return off_v


def deviation_v(volts: np.ndarray, rate_hz: float, rest_s: float) -> tuple[np.ndarray, np.ndarray]:
    """What the tilt outputs of samples (n, C) V deviate by from their mean over the rest before: blocks (m, 2 A) V.

    And the rest's own standard deviation between blocks (2 A,) V.
    """
    size = max(1, round(BLOCK_S * rate_hz))
    blocks = successive_means(volts[:, tilt_channels(volts.shape[1])], size)
    rest = blocks[: max(1, int(rest_s / BLOCK_S))]
    return blocks - rest.mean(axis=0), rest.std(axis=0)


def stray(recording: Recording, sensor: Sensor, phases: Phases) -> str:
    """Why the output is not of a stage's motion, which lies between the rests; empty where it may be."""
    away, _ = deviation_v(recording.volts, sensor.sample_rate_hz, phases.rest_s)
    size, at_s = np.abs(away).max(axis=1), BLOCK_S * np.arange(len(away))
    # Of two blocks: what goes on in a rest must not count as its noise.
    noise = float(np.median(np.abs(np.diff(away, axis=0)), axis=0).max())
    early = size[at_s < phases.rest_s - ARRIVAL_S].max(initial=0.0)
    late = size[at_s > phases.whole_s - phases.rest_s].max(initial=0.0)
    if early > max(FAINT * noise, EARLY * size.max()):
        return "the output moves before the stage does; its samples come late, or something else touches the skin"
    if late > max(FAINT * noise, LATE * size.max()):
        return "the output moves after the stage has stopped; its samples come late, or the ball is still on the skin"
    return ""


def remarks(recording: Recording, sensor: Sensor, phases: Phases, touched: bool = True) -> list[str]:
    """What the operator should know of a slide before keeping it: how strong it is, and what looks wrong.

    touched: whether it is a slide; if not, the robot moves and nothing touches.
    """
    away, rest_sd = deviation_v(recording.volts, sensor.sample_rate_hz, phases.rest_s)
    peaks = np.abs(away).max(axis=0)
    strongest = int(peaks.argmax())
    channel = sensor.channels[tilt_channels(len(sensor.channels))[strongest]]
    faint = FAINT * rest_sd[strongest]
    said = [
        f"{recording.time_s[-1]:.1f} s, {len(recording.volts)} samples, peak {1e3 * peaks[strongest]:.1f} mV "
        f"({channel}), rest within {1e3 * rest_sd.max():.1f} mV"
    ]
    if touched and peaks[strongest] < faint:
        said.append(f"no contact shows: the peak is less than {FAINT:g} times the rest's deviation")
    elif touched and np.abs(away[-5:].mean(axis=0)).max() > NOT_BACK * peaks[strongest]:
        said.append(
            "the output does not come back to rest: the object is still on the skin, or the rest is short"
        )
    for name, column in zip(sensor.columns, recording.samples.T, strict=True):
        if column.min() == column.max():
            said.append(f"{name} does not change at all: is it connected?")
        elif rail_run(column) > MOST_AT_RAIL:
            said.append(f"{name} is clipped")
    return said
