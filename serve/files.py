"""Reads recordings without pandas: CSV with the base install, Parquet where pyarrow is installed."""

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from features.clock import check_clock
from features.errors import InputError
from features.regular_file import check_regular

# As in pipeline/recordings/slide_file.py.
MOST_BYTES = 1 << 32
MOST_SAMPLES = 100_000_000


def read_recording(path: Path, channels: Sequence[str], rate_hz: float) -> np.ndarray:
    """The volts (n, C) of one recording in float64, in the order of `channels`; its clock is checked.

    The file has a column `time_s` in s and one in V for each of `channels`; further columns are ignored.

    Raises:
        InputError: no such file, another kind of file, a missing column, a cell that is no finite number, too few
            samples, a gap in time, or another rate than `rate_hz`.
    """
    kind = path.suffix.lower()
    if kind not in (".csv", ".parquet"):
        raise InputError(f"{path}: neither .csv nor .parquet; turn it into one with 'softslide import'")
    check_regular(path, MOST_BYTES, "name a recording")
    columns = ("time_s", *channels)
    values = _read_csv(path, columns) if kind == ".csv" else _read_parquet(path, columns)
    return checked_volts(path, columns, values, rate_hz)


def checked_volts(
    place: Path | str, columns: Sequence[str], values: np.ndarray, rate_hz: float
) -> np.ndarray:
    """The volts (n, C) of a recording's table (n, 1 + C) with these columns, the first its time in s.

    place: opens an error's message.

    Raises:
        InputError: a cell that is no finite number, too few samples, a gap in time, or another rate than `rate_hz`.
    """
    if len(values) < 2:
        raise InputError(f"{place}: {len(values)} samples, at least two are needed; record it again")
    if (bad := ~np.isfinite(values)).any():
        row, column = (int(n) for n in np.argwhere(bad)[0])
        raise InputError(
            f"{place}: row {row + 1}, column {columns[column]} is {values[row, column]}, not a finite number; "
            "record it again"
        )
    check_clock(place, values[:, 0], rate_hz)
    return np.ascontiguousarray(values[:, 1:])


def _read_csv(path: Path, columns: Sequence[str]) -> np.ndarray:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            header = [name.strip() for name in next(csv.reader(file), [])]
            if not header:
                raise InputError(f"{path}: the file is empty; copy or record it again")
            places = _places(path, header, columns)
            lines = file.readlines()
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text in UTF-8; save it as CSV UTF-8") from None
    except csv.Error as error:
        raise InputError(f"{path}: not a comma-separated table ({error}); write it again") from None
    if not lines:
        return np.empty((0, len(columns)))
    try:
        return np.loadtxt(lines, delimiter=",", usecols=places, ndmin=2, comments=None, quotechar='"')
    except (ValueError, OverflowError):
        raise _broken_cell(path, lines, columns, places) from None


def _broken_cell(
    path: Path, lines: Sequence[str], columns: Sequence[str], places: Sequence[int]
) -> InputError:
    """The error for the first cell that is no number, of a file that is known to have one."""
    try:
        for row, cells in enumerate(csv.reader(lines), 1):
            for column, place in zip(columns, places, strict=True):
                text = cells[place].strip() if place < len(cells) else ""
                try:
                    float(text)
                except ValueError:
                    shown = f"'{text[:40]}'" if text else "empty"
                    return InputError(
                        f"{path}: row {row}, column {column} is {shown}, not a number; correct it"
                    )
    except csv.Error as error:
        return InputError(f"{path}: not a comma-separated table ({error}); write it again")
    return InputError(f"{path}: not a comma-separated table; write it again")


def _read_parquet(path: Path, columns: Sequence[str]) -> np.ndarray:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            _places(path, file.schema_arrow.names, columns)
            if not 0 <= file.metadata.num_rows <= MOST_SAMPLES:
                raise ValueError(f"{file.metadata.num_rows} samples, {MOST_SAMPLES} at most are read")
            table = file.read(columns=list(columns))
            return np.column_stack([np.asarray(table[name], dtype=float) for name in columns])
    except (pa.ArrowException, OSError, ValueError, TypeError, OverflowError, MemoryError) as error:
        if isinstance(error, InputError):
            raise
        reason = " ".join(str(error).split())[:120]
        raise InputError(f"{path}: not a Parquet file of numbers ({reason}); copy it again") from None


def _places(path: Path, present: Sequence[str], columns: Sequence[str]) -> list[int]:
    for column in columns:
        if column not in present:
            has = ", ".join(present)
            raise InputError(f"{path}: column '{column}' is missing (it has {has}); add or rename it")
    return [present.index(column) for column in columns]
