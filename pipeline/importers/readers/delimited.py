"""Delimited text: any delimiter, header lines, decimal comma, a row of units."""

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from softslide.features.errors import InputError
from softslide.pipeline.importers.readers.chunk import CHUNK, Chunk, require


@dataclass(frozen=True)
class CsvLayout:
    """`[csv]`: how the text is laid out.

    header_lines: lines before the line of column names. units_row: a row of units follows the names.
    open_end: a last line without a line end is whole; otherwise it means that the file was cut short.
    """

    delimiter: str = ","
    decimal: str = "."
    header_lines: int = 0
    units_row: bool = False
    encoding: str = "utf-8-sig"
    open_end: bool = False

    def __post_init__(self) -> None:
        if len(self.delimiter) != 1 or len(self.decimal) != 1 or self.delimiter == self.decimal:
            raise ValueError("delimiter and decimal must be one character each, and differ")
        if self.header_lines < 0:
            raise ValueError(f"header_lines is {self.header_lines}; it must not be negative")


def read_delimited(path: Path, columns: Sequence[str], layout: CsvLayout) -> Iterator[Chunk]:
    """Columns by the names in the header; a cell that is not a number comes as text, an empty one as NaN."""
    size = path.stat().st_size
    if not layout.open_end and size and not _ends_with_a_line(path):
        raise InputError(
            f"{path}: the last line has no line end, so the file may be cut short; copy it again, "
            "or set open_end = true under [csv] if it is whole"
        )
    skip = list(range(layout.header_lines)) + ([layout.header_lines + 1] if layout.units_row else [])
    options: dict[str, Any] = {"skiprows": skip, "low_memory": False}
    options |= {"sep": layout.delimiter, "decimal": layout.decimal, "encoding": layout.encoding}
    with warnings.catch_warnings(), path.open("rb") as file:
        # Cells lost because a row is longer than the header would otherwise be a warning only.
        warnings.simplefilter("error", pd.errors.ParserWarning)
        require(path, columns, pd.read_csv(path, nrows=0, **options).columns)
        with pd.read_csv(file, usecols=list(columns), chunksize=CHUNK, **options) as tables:
            for table in tables:
                yield Chunk({name: table[name].to_numpy() for name in columns}, file.tell() / size)


def _ends_with_a_line(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(-1, 2)
        return file.read(1) in b"\r\n"
