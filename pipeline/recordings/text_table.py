"""Tables of comma-separated text, as pandas has them."""

import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from softslide.features.errors import InputError
from softslide.features.table_text import table_text

MOST_BYTES = 1 << 26  # a manifest of a hundred thousand recordings has 10 MB


def read_text_table(path: Path, missing: str, delimiter: str = ",", **options: Any) -> pd.DataFrame:
    """The table. missing: what to do where there is no such file. options: of pandas.read_csv.

    Raises:
        InputError: as `features.table_text.table_text`, or rows that do not fit the header.
    """
    text = table_text(path, missing, MOST_BYTES, delimiter)
    try:
        with warnings.catch_warnings():
            # Cells lost because a row is longer than the header would otherwise be a warning only.
            warnings.simplefilter("error", pd.errors.ParserWarning)
            return pd.read_csv(io.StringIO(text), sep=delimiter, **options)
    except (ValueError, OverflowError, MemoryError, pd.errors.ParserWarning) as error:
        reason = " ".join(str(error).split())[:120]
        raise InputError(f"{path}: not a comma-separated table ({reason}); correct it") from None


def numbers(column: pd.Series) -> np.ndarray:
    """A column as float64; NaN where a cell is not a number."""
    try:
        return pd.to_numeric(column, errors="coerce").to_numpy(dtype=float, na_value=np.nan)
    except OverflowError:  # an integer beyond float
        return pd.to_numeric(column.astype(str), errors="coerce").to_numpy(dtype=float, na_value=np.nan)
