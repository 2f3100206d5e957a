"""The one reader of recordings' files: CSV with the base install, Parquet where pyarrow is installed."""

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from softslide.features.errors import InputError
from softslide.features.regular_file import check_regular
from softslide.features.table_text import table_text

# An hour of ten accelerometers at 25.6 kHz; beyond it a recording is many.
MOST_BYTES = 1 << 32
MOST_SAMPLES = 100_000_000


def read_samples(path: Path, columns: Sequence[str], missing: str = "name a recording") -> np.ndarray:
    """The values (n, C) of these columns, float64; further ones are left alone. missing: what to do where there is no
    such file.

    Raises:
        InputError: no such file, another kind of file, a missing column, fewer than two rows, or a cell that is no
            finite number.
    """
    kind = path.suffix.lower()
    if kind not in (".csv", ".parquet"):
        raise InputError(f"{path}: neither .csv nor .parquet; turn it into one with 'softslide import'")
    read = _read_csv if kind == ".csv" else _read_parquet
    values = read(path, columns, missing)
    if len(values) < 2:
        raise InputError(
            f"{path}: {len(values)} samples, at least two are needed; record it again or drop it"
        )
    if (bad := ~np.isfinite(values)).any():
        row, column = (int(n) for n in np.argwhere(bad)[0])
        raise InputError(
            f"{path}: row {row + 1}, column {columns[column]} is {values[row, column]}, not a finite number; "
            "record it again or drop the recording"
        )
    return values


def _read_csv(path: Path, columns: Sequence[str], missing: str) -> np.ndarray:
    lines = table_text(path, missing, MOST_BYTES).splitlines()
    try:
        header = [name.strip() for name in next(csv.reader(lines[:1]), [])]
    except csv.Error as error:
        raise InputError(f"{path}: not a comma-separated table ({error}); write it again") from None
    places = _places(path, header, columns)
    if len(lines) < 2:
        return np.empty((0, len(columns)))
    try:
        return np.loadtxt(
            lines, delimiter=",", skiprows=1, usecols=places, ndmin=2, comments=None, quotechar='"'
        )
    except (ValueError, OverflowError):
        raise _broken_line(path, lines[1:], columns, places) from None


def _broken_line(
    path: Path, lines: Sequence[str], columns: Sequence[str], places: Sequence[int]
) -> InputError:
    """The error for the first cell that is not a number, of a file that is known to have one."""
    try:
        for row, cells in enumerate(csv.reader(lines), 1):
            texts = (cells[place].strip() if place < len(cells) else "" for place in places)
            if error := _broken_cell(path, row, columns, texts):
                return error
    except csv.Error as error:
        return InputError(f"{path}: not a comma-separated table ({error}); write it again")
    return InputError(f"{path}: not a comma-separated table; write it again")


def _broken_cell(path: Path, row: int, columns: Sequence[str], cells: Iterable[object]) -> InputError | None:
    for column, cell in zip(columns, cells, strict=True):
        try:
            float(cell)  # type: ignore[arg-type]
        except (ValueError, TypeError):
            shown = f"'{str(cell)[:40]}'" if cell else "empty"
            return InputError(f"{path}: row {row}, column {column} is {shown}, not a number; correct it")
    return None


def _read_parquet(path: Path, columns: Sequence[str], missing: str) -> np.ndarray:
    import pyarrow as pa
    import pyarrow.parquet as pq

    check_regular(path, MOST_BYTES, missing)
    try:
        with pq.ParquetFile(path) as file:
            _places(path, file.schema_arrow.names, columns)
            if not 0 <= file.metadata.num_rows <= MOST_SAMPLES:
                raise InputError(
                    f"{path}: says it holds {file.metadata.num_rows} samples; {MOST_SAMPLES} at most are read: "
                    "record shorter, or copy it again"
                )
            table = file.read(columns=list(columns))
        for column in columns:
            if pa.types.is_string(table[column].type) or pa.types.is_large_string(table[column].type):
                for row, cell in enumerate(table[column].to_pylist(), 1):
                    if error := _broken_cell(path, row, (column,), (cell,)):
                        raise error
        return np.column_stack([np.asarray(table[name], dtype=float) for name in columns])
    except InputError:
        raise
    # A damaged file may hold any type of column, and texts that are not text.
    except (pa.ArrowException, OSError, ValueError, TypeError, OverflowError, MemoryError) as error:
        reason = " ".join(str(error).split())[:120]
        what = (
            "the file is empty" if path.stat().st_size == 0 else f"not a Parquet file of numbers ({reason})"
        )
        raise InputError(f"{path}: {what}; copy or record it again") from None


def _places(path: Path, present: Sequence[str], columns: Sequence[str]) -> list[int]:
    for column in columns:
        if column not in present:
            has = ", ".join(present)
            raise InputError(f"{path}: column '{column}' is missing (it has {has}); add or rename it")
    return [present.index(column) for column in columns]
