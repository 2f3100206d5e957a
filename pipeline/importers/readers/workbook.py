"""Excel workbooks (.xlsx): one sheet, a row of column names, a sample a row."""

import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice, repeat
from pathlib import Path

import openpyxl
import pandas as pd
from openpyxl.packaging.manifest import Manifest
from openpyxl.xml.constants import ARC_CONTENT_TYPES, SHARED_STRINGS, WORKSHEET_TYPE
from openpyxl.xml.functions import fromstring

from softslide.features.errors import InputError
from softslide.pipeline.importers.readers.chunk import CHUNK, Chunk, require

# Excel's 1,048,576 rows of some 40 numbers unpack to about as much; a file made to fill the memory asks for more.
MOST_UNPACKED_BYTES = 2 << 30
# Texts are read whole, before the first row.
MOST_TEXT_BYTES = 64 << 20
# So is every other part but the sheets: styles, names, links.
MOST_PART_BYTES = 4 << 20
SHEETS = "xl/worksheets/"
MEDIA = "xl/media/"  # pictures, which are not read
MOST_ROWS = 1 << 20  # of a sheet, as in Excel


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
        InputError: no such sheet or column, a row beyond Excel's last, or more than a workbook of samples unpacks to.
    """
    _check_size(path)
    book = openpyxl.load_workbook(path, read_only=True, data_only=True, keep_links=False)
    try:
        if layout.sheet:
            require(path, [layout.sheet], book.sheetnames, "sheet")
        sheet = book[layout.sheet or book.sheetnames[0]]
        length = max(sheet.max_row or 1, 1)
        # What the file says of its size need not be so.
        sheet.reset_dimensions()
        first = layout.header_lines + 1
        names = next(sheet.iter_rows(min_row=first, max_row=first, values_only=True), ())
        header = ["" if name is None else str(name).strip() for name in names]
        require(path, columns, header)
        places = [header.index(column) for column in columns]
        first += 1 + int(layout.units_row)
        # Cells to the right of the header belong to no column.
        rows = sheet.iter_rows(min_row=first, max_col=len(header), values_only=True)
        samples = _samples(path, rows, first, places)
        done = 0
        while block := list(islice(samples, CHUNK)):
            done += len(block)
            cells = zip(*block, strict=True)
            lanes = {name: pd.Series(lane).to_numpy() for name, lane in zip(columns, cells, strict=True)}
            yield Chunk(lanes, min(done / length, 1.0))
    finally:
        book.close()


def _check_size(path: Path) -> None:
    """Sees what the parts unpack to: by what they are, not by what they are called.

    Raises:
        InputError: one of them, or all together, are more than a workbook of samples has.
    """
    with zipfile.ZipFile(path) as packed:
        sizes = {item.filename: item.file_size for item in packed.infolist()}
        if sizes[ARC_CONTENT_TYPES] > MOST_PART_BYTES:
            raise _too_large(path, ARC_CONTENT_TYPES, sizes[ARC_CONTENT_TYPES])
        kinds = Manifest.from_tree(fromstring(packed.read(ARC_CONTENT_TYPES))).Override
    # A part of two kinds is read as either.
    texts = {part.PartName[1:] for part in kinds if part.ContentType == SHARED_STRINGS}
    others = {part.PartName[1:] for part in kinds if part.ContentType not in (SHARED_STRINGS, WORKSHEET_TYPE)}
    if (total := sum(sizes.values())) > MOST_UNPACKED_BYTES:
        raise _too_large(path, "the whole", total)
    for name, size in sizes.items():
        sheet = name.startswith((SHEETS, MEDIA)) and not name.endswith(".rels") and name not in others
        most = MOST_TEXT_BYTES if name in texts else MOST_UNPACKED_BYTES if sheet else MOST_PART_BYTES
        if size > most:
            raise _too_large(path, name, size)


def _too_large(path: Path, part: str, size: int) -> InputError:
    return InputError(
        f"{path}: {part} unpacks to {size / 1e6:.3g} MB, more than is read of a workbook; save the sheet as CSV UTF-8"
    )


def _samples(path: Path, rows: Iterator[tuple], first: int, places: list[int]) -> Iterator[tuple]:
    """The cells at `places`, up to the last row that holds anything: Excel keeps rows whose content was deleted. first:
    the number of the first row.

    Raises:
        InputError: there are more rows than a sheet has: a cell may stand in any, and all before it are made.
    """
    empty, nothing = 0, (None,) * len(places)
    for number, row in enumerate(rows, first):
        if number > MOST_ROWS:
            raise InputError(
                f"{path}: has rows beyond {MOST_ROWS}, the last of a sheet; save the sheet as CSV UTF-8"
            )
        if row.count(None) == len(row):
            empty += 1
        else:
            yield from repeat(nothing, empty)
            empty = 0
            yield tuple(row[place] for place in places)
