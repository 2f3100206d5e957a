"""What a folder's calibration slides leave open: directions, lines and speeds without a slide, and what is confounded.

From labels alone; the signal may still be sound. Each sentence says what is missing and what would mend it.
"""

import numpy as np
import pandas as pd

from softslide.pipeline.recordings.learned import CALIBRATION
from softslide.pipeline.sensor import Sensor

SAME_HEADING_DEG = 15.0
SAME_SPEED = 0.1  # of log speed: a stage's speeds differ by more
# Directions are named where this much of the circle has no slide. The article's four leave 90 deg, which a response map
# bridges by its model of friction.
WIDEST_GAP_DEG = 100.0
# Recorded lines 5 mm apart are what maps are calibrated from; with 10 mm the splines, 2.5 mm apart, rest on the prior.
WIDEST_GAP_MM = 10.0
# A line this near to the chamber's rim hardly moves the skin.
RIM_MM = 5.0
# Speeds separate the skin's lag from the map only where they differ by this factor at least.
LEAST_SPEED_RATIO = 2.0
FASTER = 1.05  # than the fastest calibration slide: beyond it a speed is extrapolated


def not_covered(manifest: pd.DataFrame, sensor: Sensor) -> list[str]:
    """What the calibration slides leave open, a sentence each; empty where they leave nothing that is looked for.

    manifest: `Folder.manifest`. Slides without direction, speed or offset say nothing of it.
    """
    known = manifest[manifest[["direction_deg", "speed_mm_s", "offset_mm"]].notna().all(axis=1)]
    learned = known[known["split"].str.startswith(CALIBRATION)]
    if learned.empty:
        return ["no calibration slide says direction, speed and offset: there is nothing to calibrate from"]
    return [*_confounded(learned), *_directions(learned), *_lines(learned, sensor), *_speeds(learned, known)]


def headings(direction_deg: pd.Series) -> pd.Series:
    """A number for each slide's heading: directions nearer than SAME_HEADING_DEG to the next share one."""
    order = direction_deg.sort_values()
    steps = order.diff().fillna(0.0) > SAME_HEADING_DEG
    numbers = steps.cumsum()
    # 359 and 1 deg are one heading.
    if order.iloc[0] + 360 - order.iloc[-1] <= SAME_HEADING_DEG:
        numbers = numbers % numbers.iloc[-1] if numbers.iloc[-1] else numbers
    return numbers.reindex(direction_deg.index)


def _confounded(learned: pd.DataFrame) -> list[str]:
    """Speeds that go with one heading only: their effects cannot be separated."""
    heading, logs = headings(learned["direction_deg"]), np.log(learned["speed_mm_s"])
    if heading.nunique() < 2 or np.ptp(logs) < SAME_SPEED:
        return []
    ranges = logs.groupby(heading).agg(np.ptp)
    if (ranges < SAME_SPEED).all():
        return [
            "speed and heading are confounded: each heading has one speed, so that friction, the skin's lag and the "
            "speed cannot be separated; record two speeds along one heading at least"
        ]
    if (ranges >= SAME_SPEED).sum() == 1:
        varied = learned["direction_deg"][heading == ranges.idxmax()].median()
        return [
            f"speeds differ along one heading alone ({varied:.0f} deg): whether the lag is the same along others is "
            "not known; record another speed along a second heading"
        ]
    return []


def _directions(learned: pd.DataFrame) -> list[str]:
    """Gaps in the circle of directions."""
    directions = np.sort(learned["direction_deg"].unique())
    gaps = np.diff(np.append(directions, directions[0] + 360.0))
    wide = [
        f"{low:.0f} to {(low + gap) % 360:.0f} deg"
        for low, gap in zip(directions, gaps, strict=True)
        if gap > WIDEST_GAP_DEG
    ]
    return [f"directions without a slide: {', '.join(wide)}; motion there is extrapolated"] if wide else []


def _lines(learned: pd.DataFrame, sensor: Sensor) -> list[str]:
    """Parts of the chamber, along x or y, that no slide passes."""
    placed = learned.dropna(subset=["start_x_mm", "start_y_mm", "travel_mm"])
    if placed.empty:
        return ["where on the skin the slides are is not said (start_x_mm, start_y_mm, travel_mm)"]
    angle = np.deg2rad(placed["direction_deg"])
    steps, lines = np.linspace(0, 1, 60), []
    for axis, name, part in ((0, "x", np.cos(angle)), (1, "y", np.sin(angle))):
        start = placed[f"start_{name}_mm"].to_numpy()[:, None]
        passed = (start + (placed["travel_mm"] * part).to_numpy()[:, None] * steps).ravel()
        reach = sensor.chamber_mm[axis] / 2 - RIM_MM
        marks = np.concatenate([[-reach], np.sort(passed[np.abs(passed) < reach]), [reach]])
        for low, gap in zip(marks, np.diff(marks), strict=False):
            if gap > WIDEST_GAP_MM:
                lines.append(
                    f"no slide passes {name} from {low:.1f} to {low + gap:.1f} mm; the map is a guess there"
                )
    return lines


def _speeds(learned: pd.DataFrame, known: pd.DataFrame) -> list[str]:
    """A single speed, and test slides faster than any calibration slide."""
    speeds, lines = learned["speed_mm_s"], []
    if speeds.max() < LEAST_SPEED_RATIO * speeds.min():
        lines.append(
            f"all calibration slides move at {speeds.min():.3g} to {speeds.max():.3g} mm/s: the skin's lag, which "
            f"grows with the speed, is not known; record one {LEAST_SPEED_RATIO:g} times as fast"
        )
    others = known[~known["split"].str.startswith(CALIBRATION)]
    faster = others[others["speed_mm_s"] > FASTER * speeds.max()]
    if len(faster):
        lines.append(
            f"{len(faster)} slides of {', '.join(sorted(set(faster['split'])))} are faster than any calibration slide "
            f"({faster['speed_mm_s'].max():.3g} to {speeds.max():.3g} mm/s): their speed is extrapolated"
        )
    return lines
