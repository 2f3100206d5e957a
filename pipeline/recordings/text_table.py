"""The one door for tables of comma-separated text: what they are is found before they are parsed.

A spreadsheet saves many things under the name of a table. Each gets the remedy that helps.
"""

import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from features.errors import InputError
from features.regular_file import read_regular

# A manifest of a hundred thousand recordings has 10 MB.
MOST_BYTES = 1 << 26
# A line of names beyond this is no header.
MOST_HEADER_BYTES = 1 << 16
MOST_COLUMNS = 1000


def read_text_table(
    path: Path, missing: str, delimiter: str = ",", most_bytes: int = MOST_BYTES, **options: Any
) -> pd.DataFrame:
    """The table. missing: what to do where there is no such file. options: of pandas.read_csv.

    Raises:
        InputError: no regular file, too large, another encoding or kind of file, separated by something else, a name
            twice in the header, or rows that do not fit it.
    """
    content = read_regular(path, most_bytes, missing)
    text = _text(path, content)
    header = text.partition("\n")[0].strip("\r")
    if not text.strip():
        raise InputError(f"{path}: the file is empty; write a header and a row for each entry")
    if len(header.encode()) > MOST_HEADER_BYTES or header.count(delimiter) >= MOST_COLUMNS:
        raise InputError(f"{path}: its first line is too long for a header; is it a table?")
    if delimiter == "," and "," not in header and (other := _separator(header)):
        raise InputError(
            f"{path}: separated by {other}, not by commas; save it with commas, and with points in numbers"
        )
    names = [name.strip().strip('"') for name in header.split(delimiter)]
    if twice := [name for n, name in enumerate(names) if name and name in names[:n]]:
        raise InputError(f"{path}: column '{twice[0][:40]}' comes twice; rename or remove one")
    try:
        with warnings.catch_warnings():
            # Cells lost because a row is longer than the header would otherwise be a warning only.
            warnings.simplefilter("error", pd.errors.ParserWarning)
            return pd.read_csv(io.StringIO(text), sep=delimiter, **options)
    except (ValueError, OverflowError, MemoryError, pd.errors.ParserWarning) as error:
        reason = " ".join(str(error).split())[:120]
        raise InputError(f"{path}: not a comma-separated table ({reason}); correct it") from None


def numbers(column: pd.Series) -> np.ndarray:
    """A column as float64; NaN where a cell is no number."""
    try:
        return pd.to_numeric(column, errors="coerce").to_numpy(dtype=float, na_value=np.nan)
    except OverflowError:  # an integer beyond float
        return pd.to_numeric(column.astype(str), errors="coerce").to_numpy(dtype=float, na_value=np.nan)


def _text(path: Path, content: bytes) -> str:
    if content.startswith(b"PK\x03\x04"):
        raise InputError(f"{path}: a workbook or a zip, not text; save the sheet as CSV UTF-8")
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError(f"{path}: in UTF-16; save it as CSV UTF-8")
    if b"\0" in content:
        raise InputError(f"{path}: holds zero bytes, so it is no text or damaged; copy it again")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        row = content.count(b"\n", 0, error.start) + 1
        raise InputError(
            f"{path}: line {row} is not in UTF-8 (as Windows' cp1252 is not); save it as CSV UTF-8"
        ) from None


def _separator(header: str) -> str:
    names = {";": "semicolons", "\t": "tabs", "|": "bars"}
    return next((name for mark, name in names.items() if mark in header), "")
