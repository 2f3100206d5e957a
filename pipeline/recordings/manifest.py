"""The manifest of a folder of recordings: `manifest.csv`, one row a recording; read, checked cell by cell, written.

Rows in messages are counted from 1 and leave the header out.
"""

import difflib
from collections.abc import Iterator
from pathlib import Path, PureWindowsPath

import numpy as np
import pandas as pd

from softslide.features.errors import InputError
from softslide.features.names import REMEDY, is_plain
from softslide.pipeline.recordings.text_table import read_text_table
from softslide.pipeline.sensor import Sensor

REQUIRED = ("recording", "file", "split")
MOST_LETTERS = 250  # in a file's name; file systems take no more
LABELS = (
    "direction_deg",
    "speed_mm_s",
    "offset_mm",
    "start_x_mm",
    "start_y_mm",
    "travel_mm",
    "depth_mm",
    "pressure_mpa",
    "motion_start_s",
    "motion_end_s",
)


def read_table(path: Path) -> pd.DataFrame:
    """A comma-separated table as texts, cell by cell, so that nothing is guessed before it is checked.

    Raises:
        InputError: the file is missing, empty, or no such table.
    """
    missing = "a folder of recordings needs a manifest.csv"
    table = read_text_table(path, missing, dtype=str, keep_default_na=False, index_col=False)
    # A row that is too short has no text in its last cells.
    return table.apply(lambda column: column.str.strip()).fillna("")


def write_manifest(path: Path, manifest: pd.DataFrame) -> None:
    """Writes the known columns first, then any further ones; labels that are absent stay empty."""
    table = manifest.reset_index()
    columns = [c for c in (*REQUIRED, *LABELS) if c in table]
    table[columns + [c for c in table if c not in columns]].to_csv(path, index=False, lineterminator="\n")


def check_manifest(table: pd.DataFrame, sensor: Sensor, path: Path) -> pd.DataFrame:
    """A manifest as read or as made, with types, ranges and names checked; `Folder.manifest` is what returns.

    Raises:
        InputError: the first cell that is wrong, by row and column.
    """
    for column in REQUIRED:
        if column not in table:
            raise InputError(f"{path}: column '{column}' is missing; add it")
    absent = [label for label in LABELS if label not in table]
    for column in table.columns:
        # A misspelt label would otherwise read as one that the lab never gave.
        if column not in (*REQUIRED, *LABELS) and (near := difflib.get_close_matches(column, absent, 1, 0.8)):
            raise InputError(f"{path}: unknown column '{column}'; is it {near[0]}? Rename it")
    if table.empty:
        raise InputError(f"{path}: no recordings; write one row for each")
    table = table.assign(**dict.fromkeys(absent, np.nan))
    for label in LABELS:
        texts = table[label].replace("", np.nan)
        numbers = pd.to_numeric(texts, errors="coerce").astype(float)
        if (bad := texts.notna() & numbers.isna()).any():
            row = int(bad.to_numpy().argmax())
            raise _cell_error(path, table, row, label, "not a number; write one or leave it empty")
        table[label] = numbers
    wrong = [
        (holds.index(False), column, remedy)
        for column, holds, remedy in _rules(table, sensor)
        if not all(holds)
    ]
    if wrong:
        raise _cell_error(path, table, *min(wrong, key=lambda cell: cell[0]))
    further = [c for c in table if c not in (*REQUIRED, *LABELS)]
    return table.set_index("recording")[["file", "split", *LABELS, *further]]


def _cell_error(path: Path, table: pd.DataFrame, row: int, column: str, remedy: str) -> InputError:
    name, value = table["recording"].iloc[row], table[column].iloc[row]
    return InputError(f"{path}: row {row + 1} ({name}), {column} = {value}: {remedy}")


def _lies_within(file: str) -> bool:
    """Whether a file's name leads nowhere out of the folder, on Windows too. Links in the folder are its owner's."""
    path = PureWindowsPath(file)
    # Windows leaves out dots and spaces at the end of a name.
    return not path.anchor and all(part.strip(". ") for part in path.parts)


def _rules(table: pd.DataFrame, sensor: Sensor) -> Iterator[tuple[str, list[bool], str]]:
    """What the manifest's cells may hold: a column, whether it holds in each row, and what to do where it does not."""
    order = [
        not end <= start for start, end in zip(table["motion_start_s"], table["motion_end_s"], strict=True)
    ]
    yield "motion_end_s", order, "must come after motion_start_s; correct one of the two"
    twice = table["recording"].duplicated()
    plain = [is_plain(name) and not again for name, again in zip(table["recording"], twice, strict=True)]
    yield "recording", plain, f"names must be given and differ, and hold {REMEDY}"
    remedy = (
        f"no file of the folder has such a name (1 to {MOST_LETTERS} letters, neither absolute nor with ..); name one "
        "or take the row out"
    )
    yield "file", [0 < len(file) <= MOST_LETTERS and _lies_within(file) for file in table["file"]], remedy
    chamber, reference = np.array(sensor.chamber_mm) / 2, np.abs(sensor.reference_mm)
    # A line farther off than the chamber's farthest corner, give or take the sphere, never crosses it.
    farthest = float(np.hypot(*(chamber + reference))) + sensor.indenter_diameter_mm
    crosses = f"no line so far off ({farthest:.1f} mm at most) crosses the chamber; correct it"
    turned = "must lie in [0, 360) degrees; write the angle modulo 360"
    positive = pd.Interval(0.0, np.inf, "neither"), "must be positive; correct it"
    not_negative = pd.Interval(0.0, np.inf, "left"), "must not be negative; correct it"
    finite = pd.Interval(-np.inf, np.inf, "neither"), "must be finite; correct it"
    numbers = {
        "direction_deg": (pd.Interval(0.0, 360.0, "left"), turned),
        "offset_mm": (pd.Interval(-farthest, farthest, "both"), crosses),
        **dict.fromkeys(("speed_mm_s", "travel_mm"), positive),
        **dict.fromkeys(("depth_mm", "pressure_mpa"), not_negative),
    }
    for label in LABELS:
        allowed, remedy = numbers.get(label, finite)
        yield label, [bool(np.isnan(v)) or v in allowed for v in table[label]], f"{remedy} or leave it empty"
