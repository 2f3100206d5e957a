"""Labels of a recording: from a fixed value, a column, the file's name or a sheet."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from softslide.features.errors import InputError
from softslide.pipeline.importers.import_map import Map
from softslide.pipeline.importers.readers.chunk import require
from softslide.pipeline.importers.sources import Source
from softslide.pipeline.recordings.text_table import read_text_table

Row = dict[str, str | float]
SheetRows = dict[str, dict[Any, str]]


def read_sheet(mapping: Map) -> SheetRows:
    """The sheet's rows by their key; empty where the map has none.

    Raises:
        InputError: the file is missing, a column is missing, a key comes twice.
    """
    if mapping.sheet is None:
        return {}
    path = mapping.path.parent / mapping.sheet.file
    table = read_text_table(
        path, "correct [sheet] in the map", mapping.sheet.delimiter, dtype=str, keep_default_na=False
    )
    columns = [label.sheet for label in mapping.labels.values() if label.sheet]
    require(path, [mapping.sheet.key, *columns], table.columns)
    keys = table[mapping.sheet.key].str.strip()
    if keys.duplicated().any():
        row = int(keys.duplicated().to_numpy().argmax())
        raise InputError(f"{path}: row {row + 1}: '{keys.iloc[row]}' comes twice; keep one row a recording")
    return dict(zip(keys, table.to_dict("records"), strict=True))


def label_row(mapping: Map, source: Source, sheet: SheetRows, cells: dict[str, Any]) -> Row:
    """The manifest's row of one recording; labels that its sources leave empty are left out.

    cells: the one value of each label's column.

    Raises:
        InputError: the sheet has no such row, or a text is not a number.
    """
    row: Row = {"recording": source.name, "split": ""}
    for target, label in mapping.labels.items():
        if target == "recording":
            continue
        text, decimal = label.value, "."
        if label.column:
            text = cells[label.column]
        elif label.name:
            text = source.groups.get(label.name) or ""
        elif label.sheet and mapping.sheet:
            decimal = mapping.sheet.decimal
            if source.name not in sheet:
                raise InputError(
                    f"{mapping.path.parent / mapping.sheet.file}: no row '{source.name}' in column "
                    f"'{mapping.sheet.key}' for {source.path}; add it"
                )
            text = sheet[source.name][label.sheet].strip()
        text = label.values.get(str(text), text)
        if target == "split":
            row[target] = str(text)
        elif not (text == "" or (isinstance(text, float) and np.isnan(text))):
            try:
                row[target] = float(str(text).replace(decimal, ".")) * label.scale
            except ValueError:
                raise InputError(
                    f"{source.path}: {target} is '{text}', no number; correct it or give it a value in the map"
                ) from None
    return row


def label_columns(mapping: Map) -> list[str]:
    """The data columns that hold labels."""
    return sorted({label.column for label in mapping.labels.values() if label.column})


def one_value(path: Path, column: str, values: np.ndarray, so_far: Any) -> Any:
    """The value that a label's column holds throughout.

    Raises:
        InputError: it changes.
    """
    first = values[0] if so_far is None else so_far
    same = (values == first) | (pd.isna(values) & pd.isna(first))
    if not same.all():
        other = values[int(np.argmin(same))]
        raise InputError(
            f"{path}: label column '{column}' holds {first} and {other}; split the file by recording"
        )
    return first
