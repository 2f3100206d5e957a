"""Excel workbooks (.xlsx): one sheet, a row of column names, a sample a row."""

import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import openpyxl
import pandas as pd

from softslide.features.errors import InputError
from softslide.pipeline.importers.readers.chunk import CHUNK, Chunk, require

# Excel's 1,048,576 rows of some 40 numbers unpack to about as much; a file made to fill the memory asks for more.
MOST_UNPACKED_BYTES = 2 << 30
# Texts are read whole, before the first row.
MOST_TEXT_BYTES = 64 << 20
TEXTS = "xl/sharedStrings.xml"


@dataclass(frozen=True)
class ExcelLayout:
    """`[xlsx]`: where in the workbook the table is.

    sheet: its name; empty: the first. header_lines: rows before the row of column names. units_row: a row of units
    follows the names.
    """

    sheet: str = ""
    header_lines: int = 0
    units_row: bool = False

    def __post_init__(self) -> None:
        if self.header_lines < 0:
            raise ValueError(f"header_lines is {self.header_lines}; it must not be negative")


def read_workbook(path: Path, columns: Sequence[str], layout: ExcelLayout) -> Iterator[Chunk]:
    """Columns by the names in the header; an empty cell is NaN. Of a formula the value is read that Excel stored.

    Raises:
        InputError: no such sheet or column, or more than a workbook of samples unpacks to.
    """
    _check_size(path)
    book = openpyxl.load_workbook(path, read_only=True, data_only=True)
    try:
        if layout.sheet:
            require(path, [layout.sheet], book.sheetnames, "sheet")
        sheet = book[layout.sheet or book.sheetnames[0]]
        length = max(sheet.max_row or 1, 1)
        # What the file says of its size need not be so.
        sheet.reset_dimensions()
        rows = sheet.iter_rows(min_row=layout.header_lines + 1, values_only=True)
        header = ["" if name is None else str(name).strip() for name in next(rows, ())]
        require(path, columns, header)
        places = [header.index(column) for column in columns]
        samples = _without_empty_end(islice(rows, int(layout.units_row), None))
        done = 0
        while block := list(islice(samples, CHUNK)):
            done += len(block)
            cells = ([row[place] if place < len(row) else None for row in block] for place in places)
            lanes = {name: pd.Series(lane).to_numpy() for name, lane in zip(columns, cells, strict=True)}
            yield Chunk(lanes, min(done / length, 1.0))
    finally:
        book.close()


def _check_size(path: Path) -> None:
    with zipfile.ZipFile(path) as packed:
        sizes = {item.filename: item.file_size for item in packed.infolist()}
    if sum(sizes.values()) > MOST_UNPACKED_BYTES or sizes.get(TEXTS, 0) > MOST_TEXT_BYTES:
        raise InputError(
            f"{path}: unpacks to {sum(sizes.values()) / 1e6:.3g} MB, more than is read of a workbook; save the "
            "sheet as CSV UTF-8"
        )


def _without_empty_end(rows: Iterator[tuple]) -> Iterator[tuple]:
    """The rows up to the last that holds anything: Excel keeps rows whose content was deleted."""
    empty: list[tuple] = []
    for row in rows:
        if all(cell is None for cell in row):
            empty.append(())
        else:
            yield from empty
            empty.clear()
            yield row
