"""A recording's source files as streams of (time_s, values), read with the reader of their kind."""

from collections.abc import Callable, Iterator
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

# A day of ten accelerometers at 25.6 kHz as text: files are read in pieces, so that memory does not grow with them.
MOST_BYTES = 1 << 40


@dataclass
class Source:
    """One recording's files: part -> path (the part is "" where one file holds everything)."""

    name: str
    groups: dict[str, str]
    files: dict[str, Path] = field(default_factory=dict)


@dataclass
class Reading:
    """Found while a recording is read: its clock, the labels' columns, the first time."""

    clock: ClockReport = field(default_factory=ClockReport)
    cells: dict[str, Any] = field(default_factory=dict)
    first: int | float | None = None


def write_even(
    source: Source,
    mapping: Map,
    progress: Callable[[float], None],
    write: Callable[[Iterator[Samples]], None],
) -> Reading:
    """Hands the recording to `write` as blocks of (time_s, raw values in `Sensor.columns` order).

    As it stands where it has one even clock; otherwise once more from its beginning, resampled.
    progress: called with the portion read.
    """
    rate, gap = mapping.sensor.sample_rate_hz, mapping.time.max_gap_s
    path = next(iter(source.files.values()))
    for resample in (False, True):
        order, streams, reading = _open(source, mapping, progress)
        reading.clock.resampled = resample
        blocks = resampled(streams, path, rate, gap) if resample else kept(streams, rate)
        try:
            write((time_s, values[:, order]) for time_s, values in blocks)
            break
        except Uneven:
            continue
    return reading


def _open(
    source: Source, mapping: Map, progress: Callable[[float], None]
) -> tuple[list[int], list[Iterator[Samples]], Reading]:
    """The streams of a recording; order: where each of the sensor's channels stands in them, side by side."""
    reading = Reading()
    lanes: dict[tuple[str, str], list[str]] = {}
    for channel in mapping.sensor.columns:
        signal = mapping.channels[channel]
        topic = signal.column.partition(".")[0] if mapping.kind == "ros" else ""
        lanes.setdefault((signal.part, topic), []).append(channel)
    streams = []
    for n, ((part, topic), channels) in enumerate(lanes.items()):
        if part not in source.files:
            has = ", ".join(map(str, source.files.values()))
            raise InputError(
                f"{source.name}: no file of the part '{part}' (there is {has}); add it to the sources"
            )
        labels = label_columns(mapping) if n == 0 else []
        columns = [mapping.channels[channel].column for channel in channels]
        path = source.files[part]
        # Streams are read side by side, so that the first one's progress is everyone's.
        samples = _samples(path, topic, columns, labels, mapping, reading, None if n else progress)
        streams.append(checked(samples, path, mapping.time, reading.clock))
    flat = [channel for channels in lanes.values() for channel in channels]
    return [flat.index(channel) for channel in mapping.sensor.columns], streams, reading


def _samples(
    path: Path,
    topic: str,
    columns: list[str],
    labels: list[str],
    mapping: Map,
    reading: Reading,
    progress: Callable[[float], None] | None,
) -> Iterator[Samples]:
    if not path.is_dir():
        check_regular(path, MOST_BYTES, "name the lab's files, or their folder")
    clock = mapping.time
    unit = "ns" if mapping.kind == "ros" else clock.unit
    time = [f"{topic}.{clock.column}" if topic else clock.column] if clock.column else []
    row = 0
    wanted = list(dict.fromkeys([*time, *columns, *labels]))
    layouts: dict[str, Any] = {"csv": mapping.csv, "xlsx": mapping.xlsx}
    layout = (layouts[mapping.kind],) if mapping.kind in layouts else ()
    for chunk in guarded(path, mapping.kind, READERS[mapping.kind].read()(path, wanted, *layout)):
        if progress:
            progress(chunk.done)
        for label in labels:
            reading.cells[label] = one_value(path, label, chunk.columns[label], reading.cells.get(label))
        numbers = (pd.to_numeric(pd.Series(chunk.columns[column]), errors="coerce") for column in columns)
        values = np.column_stack([each.to_numpy(dtype=float, na_value=np.nan) for each in numbers])
        if not time:
            yield np.arange(row, row + len(chunk)) / clock.rate_hz, values
        elif len(chunk):
            raw = chunk.columns[time[0]]
            try:
                if reading.first is None:
                    stamps = unit == "timestamp" or topic or np.issubdtype(raw.dtype, np.datetime64)
                    reading.first = whole(raw[:1], unit)[0] if stamps or clock.origin == "first" else 0
                time_s = seconds(raw, unit, reading.first)
            except (ValueError, TypeError, OverflowError) as error:
                reason = " ".join(str(error).split())[:100]
                raise InputError(
                    f"{path}: rows {row + 1} to {row + len(chunk)}, {time[0]} holds no times in {unit} "
                    f"({reason}); correct the unit under [time]"
                ) from None
            yield time_s, values
        row += len(chunk)
