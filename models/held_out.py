"""Errors on lines that a fit has not seen: the folds, and the signed errors of a model's rows."""

import numpy as np

from softslide.features.angles import wrapped_deg
from softslide.features.card import Validity
from softslide.features.vector.energy import energy_width_s
from softslide.pipeline.recordings.windows import LabelledWindows

# Of each quantity that has an interval, the column of the graph's own standard deviation.
DEVIATIONS = {
    "direction_deg": "direction_sd_deg",
    "log_speed": "log_speed_sd",
    "offset_mm": "offset_sd_mm",
    "depth_mm": "depth_sd_mm",
}
# Limits of `Validity` on what a graph says of its own estimate.
OWN_LIMITS = ("misfit", "direction_sd_deg", "log_speed_sd")
WHOLE = 0.99  # a stroke fraction beyond it is the whole stroke
REACH_MM = 1.5  # beyond the outermost recorded line a model may still be believed; lines are 5 mm apart


def line_folds(direction: np.ndarray, offset_mm: np.ndarray, count: int) -> np.ndarray:
    """A fold number (n,) for each item such that slides along one line share a fold. direction: in any unit."""
    lines = np.stack([np.round(direction, 3), np.round(offset_mm, 3)], axis=1)
    _, number = np.unique(lines, axis=0, return_inverse=True)
    return np.ravel(number) % count


def signed_errors(
    rows: np.ndarray, outputs: tuple[str, ...], windows: LabelledWindows
) -> dict[str, np.ndarray]:
    """Errors (n,) of rows (n, K) that begin with the columns `outputs`: direction_deg, log_speed, offset_mm."""
    column = dict(zip(outputs, np.asarray(rows, float).T, strict=False))
    direction = np.degrees(np.arctan2(column["direction_sin"], column["direction_cos"]))
    if "log_speed" in column:
        log_speed = column["log_speed"]
    else:
        log_speed = column["log_speed_width"] - np.log(energy_width_s(windows.volts, windows.elapsed_s))
    return {
        "direction_deg": -wrapped_deg(windows.direction_deg - direction),
        "log_speed": log_speed - np.log(windows.speed_mm_s),
        "offset_mm": column["offset_mm"] - windows.offset_mm,
    }


def believed(rows: np.ndarray, outputs: tuple[str, ...], validity: Validity) -> np.ndarray:
    """Which rows (n, K) are valid by the model's own deviations and misfit -> (n,) bool."""
    column = dict(zip(outputs, np.asarray(rows, float).T, strict=False))
    within = [column[name] <= getattr(validity, name) for name in OWN_LIMITS if name in column]
    return np.all([np.isfinite(rows).all(axis=1), *within], axis=0)


def mean_errors(errors: dict[str, np.ndarray], windows: LabelledWindows) -> dict[str, float]:
    """Mean absolute errors at the whole stroke, by the names of `signed_errors`; empty without such windows."""
    whole = windows.stroke_fraction > WHOLE
    return {name: float(np.abs(e[whole]).mean()) for name, e in errors.items() if whole.any()}


def offset_reach_mm(windows: LabelledWindows) -> float:
    """The largest offset that a model fitted to these windows may be believed at."""
    return float(np.abs(windows.offset_mm).max()) + REACH_MM
