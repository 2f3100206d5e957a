"""What was so at each moment of a recording: `slides/NAME.truth.csv` next to `slides/NAME.parquet`.

Columns: time_s, on an even clock of any rate; x_mm, y_mm of the indenter's centre; vx_mm_s, vy_mm_s; contact, 0 or 1;
depth_mm of the indenter's lowest point below the flat skin's face, which is negative over it.
"""

from pathlib import Path

import numpy as np
import pandas as pd

from softslide.features.errors import InputError
from softslide.pipeline.recordings.text_table import numbers, read_text_table

COLUMNS = ("time_s", "x_mm", "y_mm", "vx_mm_s", "vy_mm_s", "contact", "depth_mm")
# Cells that may be empty: a lab may not know how deep.
_OPTIONAL = ("depth_mm",)
# Times are often written to no more than a millisecond.
_CLOCK_S = 0.0011
# A velocity must be the place's slope to within this, mm/s, or this share of the highest speed: corners, and ramps
# between two rows, leave some.
_SLOPE_MM_S, _SLOPE_SHARE = 0.1, 0.1
# Of the rows, which may be off: next to corners, turns and stops.
_SLOPE_ROWS = 0.05


def truth_path(slide: Path) -> Path:
    """Where the truth of a slide's file is, if there is any."""
    return slide.with_name(f"{slide.stem}.truth.csv")


def write_truth(path: Path, truth: pd.DataFrame) -> None:
    """Writes the columns of `COLUMNS`, to 0.1 um and 0.1 um/s."""
    shown = {c: [("%d" if c == "contact" else "%.4f") % v for v in truth[c]] for c in COLUMNS}
    pd.DataFrame(shown).to_csv(path, index=False, lineterminator="\n")


def read_truth(path: Path) -> pd.DataFrame:
    """Reads and checks a truth file; further columns are left alone.

    Raises:
        InputError: a column or a number is missing, the clock is not even, contact is neither 0 nor 1, or velocity is
            not the slope of the place.
    """
    table = read_text_table(path, "write it next to its slide")
    for column in COLUMNS:
        if column not in table and column not in _OPTIONAL:
            raise InputError(f"{path}: column '{column}' is missing; add it")
    table = table.reindex(columns=list(COLUMNS))
    for column in COLUMNS:
        values = numbers(table[column])
        allowed = table[column].isna().to_numpy() & (column in _OPTIONAL)
        if (bad := ~(np.isfinite(values) | allowed)).any():
            raise InputError(
                f"{path}: row {bad.argmax() + 1}, column {column} is not a finite number; write one"
            )
        table[column] = values
    if len(table) < 3:
        raise InputError(f"{path}: {len(table)} rows; at least three are needed")
    if (bad := ~np.isin(table["contact"].to_numpy(), (0.0, 1.0))).any():
        raise InputError(f"{path}: row {bad.argmax() + 1}, contact is neither 0 nor 1; write one")
    step = np.diff(table["time_s"])
    usual = float(np.median(step))
    if (bad := np.abs(step - usual) > 0.01 * abs(usual) + _CLOCK_S).any() or usual <= 0:
        raise InputError(
            f"{path}: row {bad.argmax() + 2}, time_s does not go on in even steps of {usual:g} s; write it evenly"
        )
    for place, speed in (("x_mm", "vx_mm_s"), ("y_mm", "vy_mm_s")):
        _check_slope(path, table, place, speed)
    return table


def _check_slope(path: Path, table: pd.DataFrame, place: str, speed: str) -> None:
    slope = np.gradient(table[place].to_numpy(), table["time_s"].to_numpy())
    said = table[speed].to_numpy()
    off = np.abs(slope - said) > max(_SLOPE_MM_S, _SLOPE_SHARE * np.abs(slope).max())
    if off.mean() > _SLOPE_ROWS:
        row = int(off.argmax())
        raise InputError(
            f"{path}: row {row + 1}, {speed} = {said[row]:g} where {place} changes by {slope[row]:.3g} mm/s; "
            "correct one of the two"
        )
