"""The manifest of a folder of recordings: `manifest.csv`, one row a recording; read, checked cell by cell, written.

Rows in messages are counted from 1 and leave the header out.
"""

import difflib
from pathlib import Path, PureWindowsPath

import numpy as np
import pandas as pd
import pandera.pandas as pa

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
    return table.apply(lambda column: column.str.strip())


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
    try:
        _schema(sensor).validate(table, lazy=True)
    except pa.errors.SchemaErrors as errors:
        case = errors.failure_cases.dropna(subset="index").sort_values("index", kind="stable").iloc[0]
        column, remedy = str(case["check"]).split(": ", 1)
        raise _cell_error(path, table, int(case["index"]), column, remedy) from None
    further = [c for c in table if c not in (*REQUIRED, *LABELS)]
    return table.set_index("recording")[["file", "split", *LABELS, *further]]


def _cell_error(path: Path, table: pd.DataFrame, row: int, column: str, remedy: str) -> InputError:
    name, value = table["recording"].iloc[row], table[column].iloc[row]
    return InputError(f"{path}: row {row + 1} ({name}), {column} = {value}: {remedy}")


def _lies_within(file: str) -> bool:
    """Whether a file's name leads nowhere out of the folder, on Windows too. Links in the folder are its owner's."""
    path = PureWindowsPath(str(file))
    # Windows leaves out dots and spaces at the end of a name.
    return not path.anchor and all(part.strip(". ") for part in path.parts)


def _schema(sensor: Sensor) -> pa.DataFrameSchema:
    """What the manifest's cells may hold. Each message is `column: remedy`."""
    chamber, reference = np.array(sensor.chamber_mm) / 2, np.abs(sensor.reference_mm)
    # A line farther off than the chamber's farthest corner, give or take the sphere, never crosses it.
    farthest = float(np.hypot(*(chamber + reference))) + sensor.indenter_diameter_mm

    def column(name: str, check, remedy: str) -> pa.Column:
        return pa.Column(checks=pa.Check(check, error=f"{name}: {remedy}", ignore_na=False), nullable=True)

    def number(name: str, holds, remedy: str) -> pa.Column:
        return column(name, lambda v: v.isna() | (np.isfinite(v) & holds(v)), f"{remedy} or leave it empty")

    positive = (lambda v: v > 0), "must be positive; correct it"
    not_negative = (lambda v: v >= 0), "must not be negative; correct it"
    finite = np.isfinite, "must be finite; correct it"
    numbers = {
        "direction_deg": (
            lambda v: (v >= 0) & (v < 360),
            "must lie in [0, 360) degrees; write the angle modulo 360",
        ),
        "speed_mm_s": positive,
        "offset_mm": (
            lambda v: v.abs() <= farthest,
            f"no line so far off ({farthest:.1f} mm at most) crosses the chamber; correct it",
        ),
        **{"start_x_mm": finite, "start_y_mm": finite, "travel_mm": positive},
        **{"depth_mm": not_negative, "pressure_mpa": not_negative},
        **{"motion_start_s": finite, "motion_end_s": finite},
    }
    names = f"names must be given and differ, and hold {REMEDY}"
    file = (
        f"no file of the folder has such a name (1 to {MOST_LETTERS} letters, neither absolute nor with ..); name one "
        "or take the row out"
    )
    return pa.DataFrameSchema(
        {
            "recording": column("recording", lambda v: v.map(is_plain) & ~v.duplicated(), names),
            "file": column(
                "file", lambda v: (v != "") & (v.str.len() <= MOST_LETTERS) & v.map(_lies_within), file
            ),
            **{name: number(name, *rule) for name, rule in numbers.items()},
        },
        checks=pa.Check(
            lambda t: ~(t["motion_end_s"] <= t["motion_start_s"]),
            error="motion_end_s: must come after motion_start_s; correct one of the two",
            ignore_na=False,
        ),
    )
