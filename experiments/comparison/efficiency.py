"""Errors of estimators relative to the Cramer-Rao bound of the calibrated map.

The bound is computed at each window's true line with gain and zero unknown within their spread and the depth known, and
holds for the map and the noise that the calibration found: a sensor that repeats better than its calibration says may
have smaller errors.
"""

from itertools import pairwise

import numpy as np
import pandas as pd

from experiments.evaluation.scoring import signed_errors
from models.cnn.cramer_rao import cramer_rao
from models.response_map.map import ResponseMap
from pipeline.recordings.windows import LabelledWindows

# Models whose errors the map's bound applies to.
COMPARED = ("inversion", "cnn")
QUANTITIES = ("direction_deg", "log_speed", "offset_mm")
DISTANCE_MM = (0.0, 5.0, 10.0, 15.0, 22.5)
EARLIEST = 0.2
# The bound is taken at the calibration's contact depth; slides of other depths have another.
SAME_DEPTH_MM = 0.02


def bound(response: ResponseMap, block_s: float, windows: LabelledWindows) -> pd.DataFrame:
    """One row a window of the calibration's depth: `recording`, `stroke_fraction`, and the bounds,
    standard deviations, as `<quantity>_bound`."""
    known = (np.abs(windows.depth_mm - response.depth_mm) <= SAME_DEPTH_MM) & (
        windows.stroke_fraction > EARLIEST - 0.05
    )
    windows = windows[known]
    least = cramer_rao(response, block_s, windows)
    return pd.DataFrame(
        {"recording": windows.recording, "stroke_fraction": windows.stroke_fraction}
        | {f"{name}_bound": column for name, column in zip(QUANTITIES, least[:, :3].T, strict=True)}
    )


def ratios(scored: pd.DataFrame, bounds: pd.DataFrame) -> pd.DataFrame:
    """Rms errors, rms bounds and their ratios over each bin of distance and each stroke fraction.

    scored: from `scoring.score`; only its valid estimates count, and their bounds alone.
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
    groups = table.assign(**squares).groupby(["distance_mm", "stroke_fraction"], observed=True)
    result = groups[list(squares)].mean() ** 0.5
    for name in QUANTITIES:
        result[f"{name}_ratio"] = result[f"{name}_rms"] / result[f"{name}_bound"]
    result.insert(0, "n", groups.size())
    return result.reset_index().astype({"distance_mm": str})
