"""A plan: a CSV with a row for each slide to record, in the columns of a manifest."""

from pathlib import Path

import pandas as pd

from features.errors import InputError
from pipeline.recordings.base_motion import BASE_SPLIT
from pipeline.recordings.manifest import LABELS, check_manifest, read_table
from pipeline.sensor import Sensor
from pipeline.staging import writing

# What a stage is set to, and how long the motion takes.
NEEDED = ("direction_deg", "speed_mm_s", "start_x_mm", "start_y_mm", "travel_mm")


def read_plan(path: Path, sensor: Sensor) -> pd.DataFrame:
    """The slides by name, with `split` and the manifest's labels as columns; those not given are NaN.

    Slides without a name are called p01, p02, ...; without a split they are `calibration`. Rows of the split `base`, of
    a robot that moves, need no label.

    Raises:
        InputError: no such file, no rows, a label that a stage needs is missing, a cell is wrong, or a row is of a base
            that the sensor has not.
    """
    table = read_table(path)
    if "recording" not in table:
        table["recording"] = [f"p{n:02d}" for n in range(1, len(table) + 1)]
    table = table.assign(split=table.get("split", "calibration"), file="-")
    plan = check_manifest(table, sensor, path)
    of_base = plan["split"] == BASE_SPLIT
    if of_base.any() and sensor.base is None:
        raise InputError(
            f"{path}: {plan.index[of_base][0]} is of the split '{BASE_SPLIT}', and sensor.toml has no [base]"
        )
    for column in NEEDED:
        if (empty := plan[column].isna() & ~of_base).any():
            row = int(empty.to_numpy().argmax())
            raise InputError(
                f"{path}: row {row + 1} ({plan.index[row]}), {column} is empty; a stage needs it, write it"
            )
    return plan[["split", *LABELS]]


def write_plan(path: Path, plan: pd.DataFrame) -> None:
    """Writes a plan, in the order of its rows.

    Raises:
        InputError: the file cannot be written.
    """
    with writing(path, "name another file"):
        plan.to_csv(path, index=False, lineterminator="\n")
