"""Errors of predictions against a manifest's labels, and their summaries.

An estimate that its model marks as not valid does not count: it enters no error, and is counted as missing.
"""

from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from softslide.features.angles import wrapped_deg
from softslide.features.departure import beyond_rim_mm
from softslide.features.estimate import interval_ends
from softslide.pipeline.sensor import Sensor
from softslide.pipeline.synthesis.slide_plan import chord

# What is scored, and the unit each error is shown in.
QUANTITIES = {
    "direction_deg": "deg",
    "speed_percent": "%",
    "offset_mm": "mm",
    "offset_percent": "%",
    "position_mm": "mm",
    "position_percent": "%",
}
# Those of a slide at its end that tables and figures show, in a word.
WORDS = {"direction_deg": "direction", "speed_percent": "speed", "offset_mm": "distance"}
# The column of predictions that each quantity is the error of.
ESTIMATES = {
    "direction_deg": "direction_deg",
    "speed_percent": "speed_mm_s",
    "offset_mm": "offset_mm",
    "offset_percent": "offset_mm",
    "position_mm": "x_mm",
    "position_percent": "x_mm",
}
# Quantities with an interval, by the contract's column.
INTERVALS = ("direction_deg", "speed_mm_s", "offset_mm")
AXES = ("X forward", "Y forward", "X backward", "Y backward")
BETWEEN = ("0 to 90 deg", "90 to 180 deg", "180 to 270 deg", "270 to 360 deg")
# A slide this close to an axis counts as one of the article's X- or Y-slides.
AXIS_TOLERANCE_DEG = 1.0
ROUNDING = 1e-9  # of mm and mm/s in labels computed from angles


def signed_errors(table: pd.DataFrame) -> pd.DataFrame:
    """Estimate minus label, as `direction_deg` (the shorter way round), `log_speed` and `offset_mm`.

    table: estimates and, with the prefix `true_`, labels; NaN where either is missing.
    """
    direction = (table["direction_deg"] - table["true_direction_deg"]).to_numpy(dtype=float)
    ratio = (table["speed_mm_s"] / table["true_speed_mm_s"]).to_numpy(dtype=float)
    # What has stopped has a ratio of 0.
    with np.errstate(divide="ignore"):
        errors = {"direction_deg": wrapped_deg(direction), "log_speed": np.log(ratio)}
    return pd.DataFrame(errors, table.index).assign(offset_mm=table["offset_mm"] - table["true_offset_mm"])


def score(predictions: pd.DataFrame, manifest: pd.DataFrame, sensor: Sensor) -> pd.DataFrame:
    """Joins the labels to the predictions and adds one column of absolute errors for each of QUANTITIES.

    predictions: the contract's columns; manifest: `Folder.manifest`. The labels' columns get the prefix
    `true_`. `offset_percent` is relative to the line's distance. The place is the contact's: where an object has left
    the skin, the one at which it left. `position_percent` is the article's: the
    larger of the error along the motion over the travel since the chamber's edge, and of the distance's.
    `travelled_mm` is that travel. `*_covered`: whether an interval holds the label, 0 or 1. NaN where
    there is no label or no valid estimate.
    """
    labels = manifest.drop(columns="file").add_prefix("true_").rename(columns={"true_split": "split"})
    table = predictions.join(labels, on="recording")
    estimated = table.where(table["valid"].astype(bool))
    direction = np.deg2rad(table["true_direction_deg"])
    along_x, along_y = np.cos(direction), np.sin(direction)

    errors = signed_errors(estimated)
    table["direction_deg_error"] = errors["direction_deg"].abs()
    table["speed_percent_error"] = 100 * np.expm1(errors["log_speed"]).abs()
    off = errors["offset_mm"].abs()
    table["offset_mm_error"] = off
    table["offset_percent_error"] = _percent(off, table["true_offset_mm"].abs())

    path = table["stroke_fraction"] * table["true_travel_mm"]
    beyond = beyond_rim_mm(sensor.indenter_diameter_mm, table["true_depth_mm"].fillna(0.0).to_numpy())
    left = _over(table, sensor, beyond)[1]
    touched = np.minimum(path, np.where(np.isnan(left), np.inf, left))
    dx = estimated["x_mm"] - (table["true_start_x_mm"] + touched * along_x)
    dy = estimated["y_mm"] - (table["true_start_y_mm"] + touched * along_y)
    table["travelled_mm"] = path - _over(table, sensor)[0]
    table["position_mm_error"] = np.hypot(dx, dy)
    forward = _percent((dx * along_x + dy * along_y).abs(), table["travelled_mm"])
    sideways = _percent((dy * along_x - dx * along_y).abs(), table["true_offset_mm"].abs())
    table["position_percent_error"] = np.maximum(forward, sideways)

    for column in INTERVALS:
        low, high = (estimated[end] for end in interval_ends(column))
        truth = table[f"true_{column}"]
        if column == "direction_deg":
            # Measured from the lower bound, so that an interval across 0 degrees needs no case of its own.
            inside = ((truth - low) % 360.0 <= (high - low) % 360.0) | (high - low >= 360.0)
        else:
            inside = (low <= truth) & (truth <= high)
        table[f"{column}_covered"] = inside.astype(float).where(low.notna() & high.notna() & truth.notna())
    return table


def near_deg(direction: Any, other_deg: float, turn_deg: float = 360.0) -> Any:
    """Whether a direction, or each of several, lies within AXIS_TOLERANCE_DEG of another, after any number of turns."""
    times = 360.0 / turn_deg
    return abs(wrapped_deg(times * (direction - other_deg))) < times * AXIS_TOLERANCE_DEG


def summary(scored: pd.DataFrame) -> dict[str, Any]:
    """Mean, 95th percentile and maximum of each quantity's error over the rows, with the worst recording.

    `recordings` and `valid_share` count all rows; each quantity's `n` those with an estimate and a label.
    """
    result: dict[str, Any] = {
        "recordings": int(scored["recording"].nunique()),
        "valid_share": float(scored["valid"].mean()) if len(scored) else None,
    }
    for quantity in QUANTITIES:
        error = scored[f"{quantity}_error"].dropna()
        result[quantity] = {"n": len(error)}
        if len(error):
            result[quantity] |= {
                "mean": float(error.mean()),
                "p95": float(np.percentile(error, 95)),
                "max": float(error.max()),
                "worst": str(scored["recording"][error.index[int(error.argmax())]]),
            }
    return result | {f"{column}_coverage": held for column, held in coverage(scored).items()}


def coverage(scored: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """For each of INTERVALS how many intervals there are, `n`, and the `share` of them that holds the label."""
    found: dict[str, dict[str, Any]] = {}
    for column in INTERVALS:
        covered = scored[f"{column}_covered"].dropna()
        found[column] = {"n": len(covered)}
        if len(covered):
            found[column]["share"] = float(covered.mean())
    return found


def along_the_stroke(scored: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """A summary for each stroke fraction, keyed 0.1, 0.2, ... 1.0."""
    return _groups(scored, scored["stroke_fraction"].map("{:.1f}".format))


def by_direction(scored: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """The article's four directions, and what lies between them."""
    direction = scored["true_direction_deg"]
    names = pd.Series("", index=scored.index)
    for quarter, sector in enumerate(BETWEEN):
        names[(direction // 90 == quarter) & (names == "")] = sector
        names[near_deg(direction, 90 * quarter)] = AXES[quarter]
    return _groups(scored, pd.Categorical(names.where(names != ""), (*AXES, *BETWEEN)))


def by_distance(scored: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """Bins of the line's distance from the reference point, cut where the article's areas end."""
    return _binned(scored, scored["true_offset_mm"].abs(), (0, 2.5, 5, 10, 17.5, 25), "mm")


def by_speed(scored: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """Bins of speed: three up to the article's 4 mm/s, two beyond."""
    return _binned(scored, scored["true_speed_mm_s"], (0, 1, 2, 4, 8, 13), "mm/s")


def _binned(scored: pd.DataFrame, values: pd.Series, edges: tuple[float, ...], unit: str) -> dict[str, Any]:
    names = [f"{low:g} to {high:g} {unit}" for low, high in pairwise(edges)] + [f"over {edges[-1]:g} {unit}"]
    return _groups(scored, pd.cut(values, [*edges, np.inf], labels=names, include_lowest=True))


def _groups(scored: pd.DataFrame, by: Any) -> dict[str, dict[str, Any]]:
    """A summary for each group that some row is in. by: as `DataFrame.groupby` takes it."""
    return {str(name): summary(rows) for name, rows in scored.groupby(by, observed=True)}


def _percent(error: pd.Series, size: pd.Series) -> pd.Series:
    """error / size in percent; NaN where size is nothing but rounding."""
    return 100 * error / size.where(size > ROUNDING)


def _over(
    table: pd.DataFrame, sensor: Sensor, beyond_mm: np.ndarray | float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Distances in mm from each slide's start to where its line enters and leaves the chamber and so much around it;
    NaN if it never does."""
    direction = np.deg2rad(table["true_direction_deg"].to_numpy(float))
    along = np.column_stack([np.cos(direction), np.sin(direction)])
    # A heading of nothing but rounding would be divided by: the line then runs along this side.
    along[np.abs(along) < 1e-9] = 0.0
    start = table[["true_start_x_mm", "true_start_y_mm"]].to_numpy(float)
    half = np.array(sensor.chamber_mm) / 2 + np.broadcast_to(beyond_mm, len(table))[:, None]
    known = np.isfinite(start + along).all(axis=1)
    ways = [
        chord(*line) if is_known else None for *line, is_known in zip(start, along, half, known, strict=True)
    ]
    enter, leave = np.array([way or (np.nan, np.nan) for way in ways]).reshape(-1, 2).T
    return enter, leave
