"""Errors of estimators relative to the Cramer-Rao bound of the calibrated map.

The bound is computed at each window's true line with gain and zero unknown within their spread and the depth known, and
holds for the map and the noise that the calibration found: a sensor that repeats better than its calibration says may
have smaller errors.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd

from experiments.evaluation.archive import Archive
from experiments.evaluation.readout import open_localizer
from experiments.evaluation.scoring import signed_errors
from features.errors import InputError
from models.response_map.card import response_of
from models.response_map.from_atlas import DESIGN_DRIFT_V
from models.response_map.map import ResponseMap
from pipeline.recordings.folder import Folder
from pipeline.recordings.windows import LabelledWindows, labelled_windows

# Models whose errors the map's bound applies to.
COMPARED = ("inversion", "cnn")
QUANTITIES = ("direction_deg", "log_speed", "offset_mm")
DISTANCE_MM = (0.0, 5.0, 10.0, 15.0, 22.5)
EARLIEST = 0.2
# The bound is taken at the calibration's contact depth; slides of other depths have another.
SAME_DEPTH_MM = 0.02
COLUMNS = ("recording", "stroke_fraction", *(f"{name}_bound" for name in QUANTITIES))
# No bound: columns of the right type, so that tables of several recordings can be put together.
NO_BOUNDS = pd.DataFrame({name: pd.Series(dtype=str if name == "recording" else float) for name in COLUMNS})


def bound(response: ResponseMap, block_s: float, windows: LabelledWindows) -> pd.DataFrame:
    """One row a window of the calibration's depth: `recording`, `stroke_fraction`, and the bounds,
    standard deviations, as `<quantity>_bound`."""
    # Imported here: torch takes seconds, and bundles without a map have no bound.
    from models.cnn.cramer_rao import cramer_rao

    known = (np.abs(windows.depth_mm - response.depth_mm) <= SAME_DEPTH_MM) & (
        windows.stroke_fraction > EARLIEST - 0.05
    )
    windows = windows[known & np.isfinite(windows.along_mm)]
    if not len(windows):
        return NO_BOUNDS
    least = cramer_rao(response, block_s, windows)
    return pd.DataFrame(
        {"recording": windows.recording, "stroke_fraction": windows.stroke_fraction}
        | {f"{name}_bound": column for name, column in zip(QUANTITIES, least[:, :3].T, strict=True)}
    )


def bounds_of(bundle: Path, folder: Folder, archive: Archive) -> Iterator[pd.DataFrame]:
    """The bounds of a bundle's own response map for the labelled recordings, some at a time; without a map none.

    A card does not say how much the static output drifts: it is taken as calibrations find it (DESIGN_DRIFT_V).
    """
    if open_localizer(bundle).card.contact is not None:
        yield from archive.tables("bounds", _bounds, bundle, folder, list(folder.labelled().manifest.index))


def _bounds(bundle: Path, folder: Folder, names: list[str]) -> pd.DataFrame:
    card = open_localizer(bundle).card
    folder = replace(folder, base_motion=card.base)
    response = response_of(card)
    response = replace(response, drift_v=np.full(response.channels, DESIGN_DRIFT_V))
    try:
        windows = labelled_windows(folder, card.conditioning)
    except InputError:
        # The recordings have been read before: none of these is strong enough to be noticed.
        return NO_BOUNDS
    return bound(response, card.conditioning.block_s, windows)


def ratios(scored: pd.DataFrame, bounds: pd.DataFrame, by: str = "distance_mm") -> pd.DataFrame:
    """Rms errors, rms bounds and their ratios over each bin of distance, or each split, and each stroke fraction.

    scored: from `scoring.score`; only its valid estimates count, and their bounds alone. by: `distance_mm` or `split`.
    """
    keys = ["recording", "stroke_fraction"]
    table = scored[scored["valid"].astype(bool)].round({"stroke_fraction": 3})
    table = table.merge(bounds.round({"stroke_fraction": 3}), on=keys)
    errors = signed_errors(table)
    names = [f"{low:g}-{high:g}" for low, high in pairwise(DISTANCE_MM)]
    table["distance_mm"] = pd.cut(
        table["true_offset_mm"].abs(), DISTANCE_MM, labels=names, include_lowest=True
    )
    squares = {f"{name}_rms": errors[name] ** 2 for name in QUANTITIES}
    squares |= {f"{name}_bound": table[f"{name}_bound"] ** 2 for name in QUANTITIES}
    groups = table.assign(**squares).groupby([by, "stroke_fraction"], observed=True)
    result = groups[list(squares)].mean() ** 0.5
    for name in QUANTITIES:
        result[f"{name}_ratio"] = result[f"{name}_rms"] / result[f"{name}_bound"]
    result.insert(0, "n", groups.size())
    return result.reset_index().astype({by: str})


def over_bound(scored: pd.DataFrame, bounds: pd.DataFrame) -> dict[str, dict[str, dict[str, float]]]:
    """`ratios` for each split and stroke fraction: `recordings`, and a ratio for each of QUANTITIES, to four digits."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    for row in ratios(scored, bounds, "split").to_dict("records"):
        ratio = {name: float(f"{row[f'{name}_ratio']:.4g}") for name in QUANTITIES}
        entry = {"recordings": int(row["n"]), **ratio}
        found.setdefault(row["split"], {})[f"{row['stroke_fraction']:.1f}"] = entry
    return found
