"""Times of a file to an even clock at the sensor's rate, chunk by chunk.

A recording may come in several streams (a file for each axis, a ROS topic for each accelerometer), each
with times of its own. Streams that share one even clock keep their samples to the last bit. Otherwise every
stream is put onto the grid t0 + k / rate: the sample itself where one lies within 5 % of a step, a straight
line elsewhere.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from softslide.features.clock import RATE_TOLERANCE
from softslide.features.errors import InputError
from softslide.pipeline.importers.import_map import PER_SECOND, Clock

# Steps that deviate by less than this portion of a step count as even.
EVEN = 0.05
# Range of the mean rate over the sensor's; an irregular source may have lost or repeated samples. Outside it
# the rate is a different one.
RATE_RANGE = (0.8, 1.25)

Samples = tuple[np.ndarray, np.ndarray]


class Uneven(Exception):
    """The streams do not share one even clock."""


@dataclass
class ClockReport:
    """What was seen of one recording's clock while it was read."""

    samples: int = 0
    largest_gap_s: float = 0.0
    resampled: bool = False


def seconds(raw: np.ndarray, unit: str, origin: int | float) -> np.ndarray:
    """Times (n,) in their unit -> (n,) s since `origin`, in that unit too; whole numbers lose nothing.

    Raises:
        ValueError: a cell is not a time.
    """
    return np.asarray(whole(raw, unit) - origin, dtype=float) / PER_SECOND[unit]


def whole(raw: np.ndarray, unit: str) -> np.ndarray:
    """Times as numbers in their unit: int64 where the file has whole ones; timestamps in ns since 1970."""
    if unit == "timestamp" or np.issubdtype(raw.dtype, np.datetime64):
        stamps = pd.DatetimeIndex(
            pd.to_datetime(raw, utc=True, format="ISO8601" if raw.dtype == object else None)
        )
        if stamps.hasnans:
            raise ValueError("a timestamp is empty")
        return stamps.as_unit("ns").asi8
    return raw if np.issubdtype(raw.dtype, np.integer) else pd.to_numeric(raw, errors="raise").astype(float)


def checked(stream: Iterator[Samples], path: Path, clock: Clock, report: ClockReport) -> Iterator[Samples]:
    """The stream as it is, with every sample finite, time increasing, and no gap beyond the clock's limit.

    Raises:
        InputError: by row, counted from 1 over the whole stream.
    """
    row, last = 0, np.nan
    for time_s, values in stream:
        broken = ~(np.isfinite(time_s) & np.isfinite(values).all(axis=1))
        if broken.any():
            bad = row + int(broken.argmax()) + 1
            raise InputError(
                f"{path}: row {bad} has a cell that is empty or no finite number; correct or drop it"
            )
        steps = np.diff(time_s, prepend=last)
        at = int(np.nanargmin(steps)) if len(steps) > 1 or row else 0
        if steps[at] <= 0:
            raise InputError(
                f"{path}: row {row + at + 1}: time does not increase; sort the samples or give rate_hz"
            )
        gap = float(np.nanmax(steps)) if len(steps) > 1 or row else 0.0
        if gap > clock.max_gap_s:
            at = row + int(np.nanargmax(steps)) + 1
            raise InputError(
                f"{path}: row {at}: a gap of {gap:.4g} s, more than [time] max_gap_s = {clock.max_gap_s:g}; "
                "split the file there, or allow it in the map"
            )
        report.largest_gap_s = max(report.largest_gap_s, gap)
        row, last = row + len(time_s), time_s[-1]
        yield time_s, values
    report.samples = max(report.samples, row)
    if row < 2:
        raise InputError(f"{path}: {row} samples, at least two are needed; drop the file")


def kept(streams: Sequence[Iterator[Samples]], rate_hz: float) -> Iterator[Samples]:
    """Streams that share one even clock, side by side: (n,) s and (n, all columns).

    Raises:
        Uneven: they do not.
    """
    first, last, count = np.nan, np.nan, 0
    for time_s, values in _side_by_side(streams, rate_hz):
        if (np.abs(np.diff(time_s, prepend=last) * rate_hz - 1) > EVEN).any():
            raise Uneven
        first = first if count else time_s[0]
        last, count = time_s[-1], count + len(time_s)
        yield time_s, values
    # Even steps that are all a little long still make another rate; jitter at the ends does not.
    steps = count - 1
    if count and abs(steps / (last - first) / rate_hz - 1) > RATE_TOLERANCE + EVEN / steps:
        raise Uneven


def _side_by_side(streams: Sequence[Iterator[Samples]], rate_hz: float) -> Iterator[Samples]:
    held: list[Samples | None] = [None] * len(streams)
    while True:
        held = [part or next(stream, None) for part, stream in zip(held, streams, strict=True)]
        parts = [part for part in held if part]
        if not parts:
            return
        if len(parts) < len(streams):
            raise Uneven
        length = min(len(time_s) for time_s, _ in parts)
        time_s = parts[0][0][:length]
        if any((np.abs(other[:length] - time_s) * rate_hz > EVEN).any() for other, _ in parts[1:]):
            raise Uneven
        yield time_s, np.hstack([values[:length] for _, values in parts])
        held = [(t[length:], v[length:]) if len(t) > length else None for t, v in parts]


class _Lane:
    """A stream on its way onto the grid: the samples that the next ticks need, and how many there were."""

    def __init__(self, stream: Iterator[Samples]) -> None:
        self.stream = stream
        self.time_s, self.values = next(stream)
        self.start, self.count, self.is_over = self.time_s[0], len(self.time_s), False

    def read(self) -> None:
        """One more block behind those that are held."""
        time_s, values = next(self.stream, (self.time_s[:0], self.values[:0]))
        self.is_over = not len(time_s)
        self.count += len(time_s)
        self.time_s, self.values = np.append(self.time_s, time_s), np.concatenate([self.values, values])

    def drop_before(self, moment: float) -> None:
        """Drops the samples before the last one that comes before a moment."""
        at = max(int(np.searchsorted(self.time_s, moment)) - 1, 0)
        self.time_s, self.values = self.time_s[at:], self.values[at:]

    def on_grid(self, grid: np.ndarray, rate_hz: float) -> np.ndarray:
        """The values (n, c) at the grid's moments: a sample's own where one is near, else a straight line."""
        time_s, values = self.time_s, self.values
        # Of one sample alone both are that one.
        after = np.clip(np.searchsorted(time_s, grid), 1, len(time_s) - 1)
        before = np.maximum(after - 1, 0)
        span = np.where(after > before, time_s[after] - time_s[before], 1.0)
        weight = np.clip((grid - time_s[before]) / span, 0, 1)[:, None]
        line = values[before] * (1 - weight) + values[after] * weight
        for near in (before, after):
            hit = np.abs(time_s[near] - grid) * rate_hz <= EVEN
            line[hit] = values[near[hit]]
        return line


def resampled(
    streams: Sequence[Iterator[Samples]], path: Path, rate_hz: float, max_gap_s: float
) -> Iterator[Samples]:
    """Every stream on the one grid that they all cover: (n,) s and (n, all columns).

    Raises:
        InputError: the rate is not the sensor's, or a stream starts or ends apart from the others.
    """
    lanes = [_Lane(stream) for stream in streams]
    start = max(lane.start for lane in lanes)
    if (apart := start - min(lane.start for lane in lanes)) > max_gap_s:
        raise InputError(f"{path}: its streams start {apart:.4g} s apart; align them or map them apart")
    tick = 0
    while True:
        for lane in lanes:
            # One that ends behind the others' grid is read on until it covers the next tick or is over.
            while not lane.is_over and lane.time_s[-1] < start + (tick + 1) / rate_hz:
                lane.read()
        reach = min(lane.time_s[-1] for lane in lanes)
        until = int(np.floor((reach - start) * rate_hz + EVEN)) + 1
        if until <= tick:
            break
        grid = start + np.arange(tick, until) / rate_hz
        yield grid, np.hstack([lane.on_grid(grid, rate_hz) for lane in lanes])
        tick = until
        for lane in lanes:
            lane.drop_before(grid[-1])
    for lane in lanes:
        while not lane.is_over:
            lane.drop_before(lane.time_s[-1])
            lane.read()
        rate = (lane.count - 1) / (lane.time_s[-1] - lane.start)
        if not RATE_RANGE[0] <= rate / rate_hz <= RATE_RANGE[1]:
            raise InputError(
                f"{path}: its samples come at {rate:.6g} Hz, the sensor says sample_rate_hz = {rate_hz:.6g}; "
                "correct the sensor.toml that the map names, or the unit of time"
            )
    ends = [lane.time_s[-1] for lane in lanes]
    if (apart := max(ends) - min(ends)) > max_gap_s:
        raise InputError(f"{path}: its streams end {apart:.4g} s apart; a file may be cut short")
