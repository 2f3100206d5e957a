"""One slide's file: time and volts, in Parquet or CSV, with nothing missing and an even clock."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from features.errors import InputError
from features.regular_file import check_regular
from pipeline.recordings.text_table import numbers, read_text_table

MISSING = "put it there or take its row out of the manifest"
# An hour of ten accelerometers at 25.6 kHz; beyond it a recording is many.
MOST_BYTES = 1 << 32
MOST_SAMPLES = 100_000_000


def read_slide(path: Path, channels: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Reads time_s (n,) s and volts (n, channels) V as float64; further columns are left alone.

    Raises:
        InputError: no such file, unreadable, empty, a column missing, a cell that is no finite number.
    """
    columns = ["time_s", *channels]
    table = _read_csv(path, columns) if path.suffix.lower() == ".csv" else _read_parquet(path, columns)
    if len(table) < 2:
        raise InputError(f"{path}: {len(table)} samples, at least two are needed; record it again or drop it")
    values = np.empty((len(table), len(columns)))
    for n, column in enumerate(columns):
        cells = numbers(table[column])
        if (bad := ~np.isfinite(cells)).any():
            row = int(bad.argmax())
            raise InputError(
                f"{path}: row {row + 1}, column {column} is {table[column].iloc[row]}, not a finite number; "
                "record it again or drop the recording"
            )
        values[:, n] = cells
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


def _read_parquet(path: Path, columns: list[str]) -> pd.DataFrame:
    check_regular(path, MOST_BYTES, MISSING)
    try:
        with pq.ParquetFile(path) as file:
            _require(path, columns, file.schema_arrow.names)
            if not 0 <= file.metadata.num_rows <= MOST_SAMPLES:
                raise InputError(
                    f"{path}: says it holds {file.metadata.num_rows} samples; {MOST_SAMPLES} at most are read: "
                    "record shorter, or copy it again"
                )
            return file.read(columns=columns).to_pandas()
    except InputError:
        raise
    # A damaged file may hold any type of column, and texts that are none.
    except (pa.ArrowException, OSError, ValueError, TypeError, OverflowError, MemoryError) as error:
        reason = " ".join(str(error).split())[:120]
        empty = path.is_file() and path.stat().st_size == 0
        what = "the file is empty" if empty else f"not a Parquet file ({reason})"
        raise InputError(f"{path}: {what}; copy or record it again") from None


def _read_csv(path: Path, columns: list[str]) -> pd.DataFrame:
    table = read_text_table(path, MISSING, most_bytes=MOST_BYTES, low_memory=False)
    _require(path, columns, list(table.columns))
    return table


def _require(path: Path, columns: list[str], present: list[str]) -> None:
    for column in columns:
        if column not in present:
            has = ", ".join(present)
            raise InputError(f"{path}: column '{column}' is missing (it has {has}); add or rename it")
