"""Labels that follow from others: what a lab left out, as far as no sample has to be read for it."""

from dataclasses import replace

import numpy as np
import pandas as pd

from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.heights import (
    is_other,
    main_pressure_mpa,
    pressures_by_laser,
    with_heights,
)
from softslide.pipeline.recordings.learned import CALIBRATION
from softslide.pipeline.recordings.truth import truth_path

LINE = ("direction_deg", "speed_mm_s", "offset_mm")
# Column of a manifest in memory: whether the place along the line is found in the signal, good to a few mm.
UNTIMED = "derived.untimed"
AXIS = 1e-6  # the cosine of a line along an axis with the other one
USUAL_DEPTH_MM = 0.5  # contact depth of the article's recordings, where no slide says


def recordings_to_learn_from(folder: Folder, several_heights: bool = False) -> Folder:
    """The recordings of the splits `calibration*` and `train*` whose line is known, with what follows from it: those of
    the pressure that most of them have, which the sensor of the folder then has.

    several_heights: those of other pressures too, each with the skin's height (pipeline/recordings/heights.py).
    """
    known = with_derived_labels(folder.select(*CALIBRATION)).labelled()
    pressure_mpa = main_pressure_mpa(known)
    known = replace(known, sensor=replace(known.sensor, pressure_mpa=pressure_mpa))
    if several_heights:
        return with_heights(known)
    return replace(known, manifest=known.manifest[~is_other(known.manifest["pressure_mpa"], pressure_mpa)])


def with_derived_labels(folder: Folder) -> Folder:
    """Fills absent labels from the others: a slide at one speed along a line needs no more than some of them.

    speed = travel / duration and the other way round; end = start + travel / speed and the other way round; offset
    from a start and a direction (docs/format.md), along an axis from the coordinate across it; depth of a slide: the
    median of the others', or USUAL_DEPTH_MM; pressure, where none is noted, from a laser's readings of the skin. A
    recording with a truth file keeps its labels: it need not be a slide.
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
    fill("offset_mm", _share(np.cos(a), y) - _share(np.sin(a), x))
    usual = table["depth_mm"].median()
    # A press, which has no direction, keeps an unknown depth.
    depth = pd.Series(USUAL_DEPTH_MM if np.isnan(usual) else usual, table.index)
    fill("depth_mm", depth.where(table["direction_deg"].notna()))
    if table["pressure_mpa"].isna().all():
        fill("pressure_mpa", pressures_by_laser(folder))
    return replace(folder, manifest=table)


def _share(part: pd.Series, coordinate: pd.Series) -> pd.Series:
    """part * coordinate, which need not be known where the part is 0."""
    return (part * coordinate).mask(part.abs() < AXIS, 0.0)


def why_not_labelled(folder: Folder, several_heights: bool = False) -> dict[str, str]:
    """For each recording that is not learned from, why: the labels of LINE that it lacks, or another pressure.

    several_heights: as in `recordings_to_learn_from`.
    """
    absent = folder.manifest[list(LINE)].isna()
    lacking = {
        str(name): "no " + ", ".join(label for label in LINE if row[label])
        for name, row in absent.iterrows()
        if row.any()
    }
    if several_heights:
        return lacking
    known = folder.labelled()
    pressure_mpa, each = main_pressure_mpa(known), known.manifest["pressure_mpa"]
    others = each[is_other(each, pressure_mpa)]
    span = " to ".join(dict.fromkeys(f"{value:g}" for value in (others.min(), others.max())))
    why = f"pressure_mpa is {span}, that of most is {pressure_mpa:g}: a model is for one pressure"
    return lacking | dict.fromkeys(map(str, others.index), why)
