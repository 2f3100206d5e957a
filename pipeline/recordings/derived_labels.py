"""Labels that follow from others: what a lab left out, as far as no sample has to be read for it."""

from dataclasses import replace

import numpy as np
import pandas as pd

from pipeline.recordings.folder import Folder
from pipeline.recordings.truth import truth_path

LINE = ("direction_deg", "speed_mm_s", "offset_mm")
USUAL_DEPTH_MM = 0.5  # contact depth of the article's recordings, where no slide says


def recordings_to_learn_from(folder: Folder) -> Folder:
    """The recordings of the splits `calibration*` and `train*` whose line is known, with what follows from it."""
    return with_derived_labels(folder.select("calibration", "train")).labelled()


def with_derived_labels(folder: Folder) -> Folder:
    """Fills absent labels from the others: a slide at one speed along a line needs no more than some of them.

    speed = travel / duration and the other way round; end = start + travel / speed and the other way round; offset
    from a start and a direction (docs/format.md); depth: the median of the others', or USUAL_DEPTH_MM. A recording
    with a truth file keeps its labels: it need not be such a slide.
    """
    table = folder.manifest.copy()
    free = np.array([not truth_path(folder.root / file).is_file() for file in table["file"]], dtype=bool)

    def fill(label: str, values: pd.Series) -> None:
        absent = table[label].isna() & free
        table.loc[absent, label] = values[absent]

    duration = table["motion_end_s"] - table["motion_start_s"]
    fill("speed_mm_s", table["travel_mm"] / duration)
    fill("travel_mm", table["speed_mm_s"] * duration)
    fill("motion_end_s", table["motion_start_s"] + table["travel_mm"] / table["speed_mm_s"])
    fill("motion_start_s", table["motion_end_s"] - table["travel_mm"] / table["speed_mm_s"])
    a = np.deg2rad(table["direction_deg"])
    x, y = (table[f"start_{axis}_mm"] - at for axis, at in zip("xy", folder.sensor.reference_mm, strict=True))
    fill("offset_mm", np.cos(a) * y - np.sin(a) * x)
    usual = table["depth_mm"].median()
    fill("depth_mm", pd.Series(USUAL_DEPTH_MM if np.isnan(usual) else usual, table.index))
    return replace(folder, manifest=table)


def why_not_labelled(folder: Folder) -> dict[str, str]:
    """For each recording whose line is not known, why: the labels of LINE that it lacks."""
    absent = folder.manifest[list(LINE)].isna()
    return {
        str(name): "no " + ", ".join(label for label in LINE if row[label])
        for name, row in absent.iterrows()
        if row.any()
    }
