"""How a delimited text is laid out, from its first lines."""

import csv
import re
from pathlib import Path

from softslide.features.errors import InputError
from softslide.pipeline.importers.readers.delimited import CsvLayout

LEAST_ROWS = 3
LOOKED_AT = 1 << 16  # bytes: hundreds of rows
DELIMITERS = (";", "\t", ",", "|", " ")
NUMBER = re.compile(r"\s*[-+]?\d*[.,]?\d+(?:[eE][-+]?\d+)?\s*$")
TIMESTAMP = re.compile(r"\s*\d{4}-\d\d-\d\d[T ]\d\d:\d\d")


def guess_layout(path: Path) -> tuple[CsvLayout, list[str], list[str], list[list[str]]]:
    """The layout, the columns' names, their units (empty where no row has them), and the first rows of cells.

    Raises:
        InputError: the text has no rows of numbers below a row of names.
    """
    with path.open("rb") as file:
        content = file.read(LOOKED_AT)
    encoding = "utf-8-sig"
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError as error:
        cut = error.start >= len(content) - 3 and len(content) == LOOKED_AT
        encoding = encoding if cut else "cp1252"
        text = content.decode(encoding, errors="replace")
    lines = text.splitlines()
    # The last one may be cut short.
    lines = lines[:-1] if len(content) == LOOKED_AT else lines
    found = [(_rows(lines, delimiter), delimiter) for delimiter in DELIMITERS]
    (first, rows), delimiter = max(found, key=lambda each: len(each[0][1]) * len((each[0][1] or [[]])[0]))
    if len(rows) < LEAST_ROWS or first == 0:
        raise InputError(f"{path}: no rows of numbers below a row of names; name a table, or give its kind")
    above = [next(csv.reader([line], delimiter=delimiter)) for line in lines[:first]]
    units_row = first > 1 and len(above[-2]) == len(rows[0]) == len(above[-1])
    names = above[-2] if units_row else above[-1]
    if len(names) != len(rows[0]):
        raise InputError(f"{path}: line {first + 1} has {len(rows[0])} cells below {len(names)} names")
    comma = delimiter != "," and any("," in cell for cell in rows[0] if NUMBER.match(cell))
    layout = CsvLayout(delimiter, "," if comma else ".", first - 1 - units_row, units_row, encoding)
    units = [unit.strip(" []()") for unit in above[-1]] if units_row else [""] * len(names)
    return layout, names, units, rows


def _rows(lines: list[str], delimiter: str) -> tuple[int, list[list[str]]]:
    """Where the longest run of lines of as many numbers begins, and its cells; at least two numbers a line."""
    best: tuple[int, list[list[str]]] = (0, [])
    start = 0
    run: list[list[str]] = []
    for number, cells in enumerate(csv.reader(lines, delimiter=delimiter)):
        numeric = [bool(NUMBER.match(cell)) for cell in cells]
        # Of commas between digits those are decimal that a delimiter leaves.
        if len(cells) > 1 and (all(numeric) or (TIMESTAMP.match(cells[0]) and all(numeric[1:]))):
            if run and len(cells) != len(run[0]):
                run = []
            start = start if run else number
            run.append(cells)
        else:
            run = []
        if len(run) > len(best[1]):
            best = (start, run)
    return best
