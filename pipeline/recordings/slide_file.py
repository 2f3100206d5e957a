"""One slide's file: time and volts, in Parquet or CSV, with nothing missing and an even clock."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from softslide.features.recording_file import read_samples


def read_slide(path: Path, channels: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Reads time_s (n,) s and volts (n, channels) V as float64; further columns are left alone.

    Raises:
        InputError: as `features.recording_file.read_samples`.
    """
    values = read_samples(path, ("time_s", *channels), "put it there or take its row out of the manifest")
    return values[:, 0].copy(), values[:, 1:].copy()


def write_slide(path: Path, time_s: np.ndarray, volts: np.ndarray, channels: Sequence[str]) -> None:
    """Writes Parquet: time in float64, volts in float32 where that loses nothing, else in float64."""
    columns: dict[str, np.ndarray] = {"time_s": np.asarray(time_s, dtype=float)}
    for n, channel in enumerate(channels):
        values = np.asarray(volts[:, n], dtype=float)
        narrow = values.astype(np.float32)
        columns[channel] = narrow if np.array_equal(narrow, values) else values
    pq.write_table(pa.table(columns), path, **_encoding(channels))


def write_slide_in_blocks(
    path: Path, blocks: Iterable[tuple[np.ndarray, np.ndarray]], channels: Sequence[str]
) -> None:
    """Writes Parquet in float64 as the blocks of (time_s, volts) come; a slide need not fit in memory."""
    schema = pa.schema([(column, pa.float64()) for column in ("time_s", *channels)])
    with pq.ParquetWriter(path, schema, **_encoding(channels)) as writer:
        for time_s, volts in blocks:
            writer.write_table(pa.table([time_s, *np.asarray(volts, dtype=float).T], schema=schema))


def read_slide_in_blocks(path: Path, channels: Sequence[str]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Blocks of (time_s, volts) of a slide that this module wrote."""
    with pq.ParquetFile(path) as file:
        for batch in file.iter_batches(200_000, columns=["time_s", *channels]):
            yield (
                batch.column("time_s").to_numpy(),
                np.column_stack([batch.column(c).to_numpy() for c in channels]),
            )


def _encoding(channels: Sequence[str]) -> dict[str, Any]:
    return {
        "compression": "zstd",
        "compression_level": 9,
        "use_dictionary": list(channels),
        "column_encoding": {"time_s": "BYTE_STREAM_SPLIT"},
    }
