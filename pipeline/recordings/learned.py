"""What is learned from a folder's calibration slides: lines that a test should not be along, and contact depths."""

import numpy as np
import pandas as pd

# Beginnings of the names of splits that are learned from, and of those that are for reporting alone.
CALIBRATION, REPORTING = ("calibration", "train"), ("test", "track")
# Slides this near to each other in direction and offset run along one line: a stage repeats better than that.
SAME_LINE_DEG = 0.5
SAME_LINE_MM = 0.05
SAME_DEPTH_MM = 0.01


def learned_lines(manifest: pd.DataFrame) -> pd.Series:
    """For each recording the calibration slide along whose line it runs, "" if there is none.

    manifest: `Folder.manifest` with all splits. A calibration slide runs along its own line or an earlier one's.
    """
    learned = manifest[manifest["split"].str.startswith(CALIBRATION)]
    names = []
    for direction, offset in manifest[["direction_deg", "offset_mm"]].to_numpy(float):
        turn = np.abs((learned["direction_deg"] - direction + 180) % 360 - 180)
        same = (turn < SAME_LINE_DEG) & ((learned["offset_mm"] - offset).abs() < SAME_LINE_MM)
        names.append(str(learned.index[int(same.argmax())]) if same.any() else "")
    return pd.Series(names, index=manifest.index, dtype=object)


def learned_depths_mm(manifest: pd.DataFrame) -> tuple[float, ...]:
    """Contact depths of the calibration slides, ascending; without any the median of all. Empty: no depth is given."""
    depth = manifest["depth_mm"].dropna()
    learned = depth[manifest.loc[depth.index, "split"].str.startswith(CALIBRATION)]
    if learned.empty:
        return () if depth.empty else (float(depth.median()),)
    return tuple(sorted(set(learned.tolist())))
