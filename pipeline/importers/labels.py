"""Labels of a recording: from a fixed value, a column, the file's name or a sheet."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from softslide.features.errors import InputError
from softslide.pipeline.importers.import_map import Label, Map
from softslide.pipeline.recordings.text_table import read_text_table

Row = dict[str, str | float]


def read_sheet(mapping: Map) -> dict[str, dict[Any, str]]:
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
    for column in (mapping.sheet.key, *(label.sheet for label in mapping.labels.values() if label.sheet)):
        if column not in table:
            raise InputError(f"{path}: column '{column}' is missing; correct its name in the map")
    keys = table[mapping.sheet.key].str.strip()
    if keys.duplicated().any():
        row = int(keys.duplicated().to_numpy().argmax())
        raise InputError(f"{path}: row {row + 1}: '{keys.iloc[row]}' comes twice; keep one row a recording")
    return dict(zip(keys, table.to_dict("records"), strict=True))


def recording_name(mapping: Map, path: Path, groups: Mapping[str, str]) -> str:
    """The recording that a file belongs to: its label, the pattern's `recording`, where _ stands for /, or its name."""
    label = mapping.labels.get("recording", Label(name="recording"))
    name = groups.get(label.name, "").replace("/", "_") or path.stem
    return str(label.values.get(name, name))


def label_row(
    mapping: Map, name: str, source: Path, groups: Mapping[str, str], sheet: dict, cells: dict
) -> Row:
    """The manifest's row of one recording; labels that its sources leave empty are left out.

    groups: of the file name's pattern. sheet: `read_sheet`. cells: the one value of each label's column.

    Raises:
        InputError: the sheet has no such row, or a text is not a number.
    """
    row: Row = {"recording": name, "split": ""}
    for target, label in mapping.labels.items():
        if target == "recording":
            continue
        text: Any = label.value
        if label.column:
            text = cells[label.column]
        elif label.name:
            text = groups.get(label.name) or ""
        elif label.sheet and mapping.sheet is not None:
            if name not in sheet:
                place = mapping.path.parent / mapping.sheet.file
                raise InputError(
                    f"{place}: no row '{name}' in column '{mapping.sheet.key}' for {source}; add it"
                )
            text = sheet[name][label.sheet].strip()
        text = label.values.get(str(text), text)
        if target == "split":
            row[target] = str(text)
        elif not (text == "" or (isinstance(text, float) and np.isnan(text))):
            decimal = mapping.sheet.decimal if label.sheet and mapping.sheet else "."
            try:
                row[target] = float(str(text).replace(decimal, ".")) * label.scale
            except ValueError:
                raise InputError(
                    f"{source}: {target} is '{text}', no number; correct it or give it a value in the map"
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
