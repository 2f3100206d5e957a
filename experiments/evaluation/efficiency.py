"""Errors of estimators relative to the Cramer-Rao bound of the calibrated map.

The bound is computed at each window's true line with gain and zero unknown within their spread and the depth known, and
holds for the map and the noise that the calibration found: a sensor that repeats better than its calibration says may
have smaller errors.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from softslide.experiments.evaluation.archive import Archive
from softslide.experiments.evaluation.readout import open_localizer
from softslide.experiments.evaluation.scoring import signed_errors
from softslide.features.errors import InputError
from softslide.models.response_map.card import response_of
from softslide.models.response_map.from_atlas import DESIGN_DRIFT_V_S, DESIGN_ZERO_V
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.windows import labelled_windows

QUANTITIES = ("direction_deg", "log_speed", "offset_mm")
# Stroke fractions whose windows have a bound.
EARLIEST = 0.2
# The bound is taken at the calibration's contact depth; slides of other depths have another.
SAME_DEPTH_MM = 0.02
COLUMNS = {"recording": str, "stroke_fraction": float} | {f"{name}_bound": float for name in QUANTITIES}
# No bound: columns of the right type, so that tables of several recordings can be put together.
NO_BOUNDS = pd.DataFrame(columns=list(COLUMNS)).astype(COLUMNS)


def bounds_of(bundle: Path, folder: Folder, archive: Archive) -> Iterator[pd.DataFrame]:
    """The bounds of a bundle's own response map for the labelled recordings, some at a time; without a map none.

    One row a window of the calibration's depth, of COLUMNS; bounds are standard deviations. A card does not say how
    far the zero is off and drifts: that is taken as before any recording (DESIGN_ZERO_V, DESIGN_DRIFT_V_S).
    """
    if open_localizer(bundle).card.contact is not None:
        yield from archive.tables("bounds", _bounds, bundle, folder.labelled())


def _bounds(bundle: Path, folder: Folder) -> pd.DataFrame:
    # Imported here: torch takes seconds, and bundles without a map have no bound.
    from softslide.models.cnn.cramer_rao import cramer_rao

    card = open_localizer(bundle).card
    response = response_of(card)
    zero_v, drift_v_s = (np.full(response.channels, sd) for sd in (DESIGN_ZERO_V, DESIGN_DRIFT_V_S))
    response = replace(response, zero_v=zero_v, drift_v_s=drift_v_s)
    try:
        windows = labelled_windows(replace(folder, base_motion=card.base), card.conditioning)
    except InputError:
        # The recordings have been read before: none of these is strong enough to be noticed.
        return NO_BOUNDS
    known = np.abs(windows.depth_mm - response.depth_mm) <= SAME_DEPTH_MM
    known &= (windows.stroke_fraction > EARLIEST - 0.05) & np.isfinite(windows.along_mm)
    if not known.any():
        return NO_BOUNDS
    windows = windows[known]
    least = cramer_rao(response, card.conditioning.block_s, windows)
    columns = (windows.recording, windows.stroke_fraction, *least.T)
    return pd.DataFrame(dict(zip(COLUMNS, columns, strict=True)))


def over_bound(scored: pd.DataFrame, bounds: pd.DataFrame) -> dict[str, dict[str, dict[str, float]]]:
    """For each split and stroke fraction `recordings`, and the ratio, to four digits, of rms error and rms bound for
    each of QUANTITIES.

    scored: of `scoring.score`; only its valid estimates count, and their bounds alone.
    """
    table = scored[scored["valid"].astype(bool)].round({"stroke_fraction": 3})
    table = table.merge(bounds.round({"stroke_fraction": 3}), on=["recording", "stroke_fraction"])
    squares = (signed_errors(table) ** 2).join(table[[f"{name}_bound" for name in QUANTITIES]] ** 2)
    groups = squares.groupby([table["split"], table["stroke_fraction"]])
    counts, rms = groups.size(), groups.mean() ** 0.5
    found: dict[str, dict[str, dict[str, float]]] = {}
    for split, fraction in counts.index:
        row = rms.loc[(split, fraction)]
        ratio = {name: float(f"{row[name] / row[f'{name}_bound']:.4g}") for name in QUANTITIES}
        found.setdefault(split, {})[f"{fraction:.1f}"] = {"recordings": int(counts[split, fraction])} | ratio
    return found
