"""A recording's source files as streams of (time_s, values), read with the reader of their kind, into one slide."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from softslide.features.errors import InputError
from softslide.features.regular_file import check_regular
from softslide.pipeline.importers.import_map import Map
from softslide.pipeline.importers.labels import label_columns, one_value
from softslide.pipeline.importers.readers.chunk import guarded
from softslide.pipeline.importers.readers.registry import READERS
from softslide.pipeline.importers.resampling import (
    ClockReport,
    Samples,
    Uneven,
    checked,
    kept,
    resampled,
    seconds,
    whole,
)
from softslide.pipeline.importers.sources import Source
from softslide.pipeline.importers.units import Converter
from softslide.pipeline.recordings.slide_file import write_slide_in_blocks
from softslide.pipeline.recordings.text_table import numbers

# A day of ten accelerometers at 25.6 kHz as text: files are read in pieces, so that memory does not grow with them.
MOST_BYTES = 1 << 40

# Called with the portion of a recording that is read.
Progress = Callable[[float], None]


@dataclass
class Reading:
    """A recording as it is read: its clock, the value of each label's column, its first time in the file's unit."""

    mapping: Map
    progress: Progress
    clock: ClockReport
    cells: dict[str, Any] = field(default_factory=dict)
    first: int | float | None = None

    def open(self, source: Source) -> tuple[list[Iterator[Samples]], list[int]]:
        """The streams, and where each of the sensor's channels stands in them, side by side."""
        lanes: dict[tuple[str, str], list[str]] = {}
        for channel in self.mapping.sensor.columns:
            signal = self.mapping.channels[channel]
            topic = signal.column.partition(".")[0] if self.mapping.kind == "ros" else ""
            lanes.setdefault((signal.part, topic), []).append(channel)
        streams: list[Iterator[Samples]] = []
        for (part, topic), channels in lanes.items():
            if part not in source.files:
                has = ", ".join(map(str, source.files.values()))
                raise InputError(
                    f"{source.name}: no file of the part '{part}' (there is {has}); add it to the sources"
                )
            path, clock = source.files[part], self.mapping.time
            columns = [self.mapping.channels[channel].column for channel in channels]
            time = f"{topic}.{clock.column}" if topic else clock.column
            # Streams are read side by side, so that the first one's labels and progress are everyone's.
            samples = self._samples(path, time, columns, is_first=not streams)
            streams.append(checked(samples, path, clock, self.clock))
        flat = [channel for channels in lanes.values() for channel in channels]
        return streams, [flat.index(channel) for channel in self.mapping.sensor.columns]

    def _samples(self, path: Path, time: str, columns: Sequence[str], is_first: bool) -> Iterator[Samples]:
        """Times (n,) s and values (n, columns). time: its column; empty: by the rate."""
        if not path.is_dir():
            check_regular(path, MOST_BYTES, "name the lab's files, or their folder")
        kind, row = self.mapping.kind, 0
        labels = label_columns(self.mapping) if is_first else []
        wanted = list(dict.fromkeys([*([time] if time else []), *columns, *labels]))
        layout = [getattr(self.mapping, kind)] if kind in ("csv", "xlsx") else []
        for chunk in guarded(path, kind, READERS[kind].read()(path, wanted, *layout)):
            if is_first:
                self.progress(chunk.done)
            if not len(chunk):  # of a table without rows
                continue
            for label in labels:
                self.cells[label] = one_value(path, label, chunk.columns[label], self.cells.get(label))
            values = np.column_stack([numbers(pd.Series(chunk.columns[column])) for column in columns])
            place = f"{path}: rows {row + 1} to {row + len(chunk)}, {time}"
            if time:
                yield self._seconds(chunk.columns[time], place), values
            else:
                yield np.arange(row, row + len(chunk)) / self.mapping.time.rate_hz, values
            row += len(chunk)

    def _seconds(self, raw: np.ndarray, place: str) -> np.ndarray:
        """Times (n,) in the file's unit -> (n,) s. place: opens an error's message."""
        unit = "ns" if self.mapping.kind == "ros" else self.mapping.time.unit
        stamps = self.mapping.kind == "ros" or unit == "timestamp" or np.issubdtype(raw.dtype, np.datetime64)
        try:
            if self.first is None:
                from_first = stamps or self.mapping.time.origin == "first"
                self.first = whole(raw[:1], unit)[0] if from_first else 0
            return seconds(raw, unit, self.first)
        except (ValueError, TypeError, OverflowError) as error:
            reason = " ".join(str(error).split())[:100]
            raise InputError(
                f"{place} holds no times in {unit} ({reason}); correct the unit under [time]"
            ) from None


def write_even(source: Source, mapping: Map, to_volts: Converter, slide: Path, progress: Progress) -> Reading:
    """Writes the recording's slide: as it stands where it has one even clock, otherwise read once more and resampled.

    Raises:
        InputError: a file is bad, a column is missing, a cell holds no time or no number.
    """
    rate_hz, columns = mapping.sensor.sample_rate_hz, mapping.sensor.columns
    for resample in (False, True):
        reading = Reading(mapping, progress, ClockReport(resampled=resample))
        streams, order = reading.open(source)
        blocks = kept(streams, rate_hz)
        if resample:
            blocks = resampled(streams, source.path, rate_hz, mapping.time.max_gap_s)
        try:
            write_slide_in_blocks(slide, ((t, to_volts(values[:, order])) for t, values in blocks), columns)
            break
        except Uneven:
            continue
    return reading
