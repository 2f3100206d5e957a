"""Presses in recordings: where and how hard something presses on the skin, and how well the outputs tell."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from features.errors import InputError
from pipeline.atlas.atlas import Atlas
from pipeline.atlas.static_contact import (
    MODEL_SHARE,
    READING_G,
    find_indentation,
    indentation_doubt,
)
from pipeline.recordings.folder import Folder

REST_S = 0.5  # what a recording is taken to rest at its start
SETTLED_S = 0.3  # after the touch: the skin's lag is over, and so is most of the way down
MEAN_S = 0.2
TOUCH_G = (
    0.01  # of an output that differs from that at rest: nine times a block's noise (models/response_map)
)
MOST_MISFIT = 3.0  # readings further from any press than three times what is expected are none


def presses(folder: Folder, atlas: Atlas, height_mm: float) -> Iterator[dict[str, Any]]:
    """A row for each recording, of the strongest 0.2 s that begin SETTLED_S after the touch or later.

    height_mm: of the inflated skin. A row holds `recording`, `time_s`, `x_mm`, `y_mm`, `radius_mm`, which holds the
    place with 90 %, `depth_mm` and `force_mn` with `NAME_lo_UNIT` and `NAME_hi_UNIT`, 90 %, and `misfit`, the residual
    over what is expected; none of them but the name where nothing touches.

    Raises:
        InputError: the sensor measures no gravity, or the height lies outside the atlas.
    """
    if not folder.sensor.measures_gravity:
        raise InputError(
            f"{folder.sensor.name}: presses are found in the solved skin's tilt; it measures none"
        )
    level = atlas.pressure_at(height_mm)
    per_g = np.array([a.sensitivity_v_per_g for a in folder.sensor.accelerometers])
    for name in folder.manifest.index:
        row: dict[str, Any] = {"recording": str(name)}
        recording = folder.load(str(name))
        reading = settled_reading(recording.time_s, recording.volts / np.repeat(per_g, 3))
        if reading is not None:
            time_s, reading_g = reading[0], reading[1].reshape(-1, 3)
            found = find_indentation(reading_g, atlas, level)
            doubt = indentation_doubt(reading_g, atlas, level, found)
            expected_g = np.hypot(READING_G, MODEL_SHARE * np.abs(reading_g).max())
            row |= {
                "time_s": time_s,
                "x_mm": found.x_mm,
                "y_mm": found.y_mm,
                "radius_mm": doubt.radius_mm,
                "depth_mm": found.depth_mm,
                "depth_lo_mm": doubt.depth_mm[0],
                "depth_hi_mm": doubt.depth_mm[1],
                "force_mn": 1e3 * found.force_n,
                "force_lo_mn": 1e3 * doubt.force_n[0],
                "force_hi_mn": 1e3 * doubt.force_n[1],
                "misfit": found.misfit_g / expected_g,
            }
        yield row


def settled_reading(time_s: np.ndarray, output_g: np.ndarray) -> tuple[float, np.ndarray] | None:
    """When the strongest MEAN_S begin, s, and their mean (C,) less that at rest, of outputs (n, C) g.

    None: nothing touches. The touch is where a mean over MEAN_S of V_x or V_y first leaves rest by TOUCH_G.
    """
    count = max(int(np.searchsorted(time_s, time_s[0] + MEAN_S)), 1)
    rest = output_g[time_s < time_s[0] + REST_S].mean(axis=0)
    total = np.concatenate([np.zeros((1, output_g.shape[1])), np.cumsum(output_g - rest, axis=0)])
    means = (total[count:] - total[:-count]) / count
    size = np.abs(means.reshape(len(means), -1, 3)[:, :, :2]).max(axis=(1, 2))
    touched = np.flatnonzero(size > TOUCH_G)
    if not len(touched):
        return None
    settled = int(np.searchsorted(time_s, time_s[touched[0]] + SETTLED_S))
    if settled >= len(means):
        return None
    best = settled + int(size[settled:].argmax())
    return float(time_s[best]), means[best]


def told(rows: list[dict[str, Any]]) -> Iterator[str]:
    """A line for each row, for people."""
    for row in rows:
        if "x_mm" not in row:
            yield f"{row['recording']}: no touch"
            continue
        text = (
            f"{row['recording']}: ({row['x_mm']:.1f}, {row['y_mm']:.1f}) mm within {row['radius_mm']:.1f} mm, "
            f"{row['depth_mm']:.2f} mm deep ({row['depth_lo_mm']:.2f} to {row['depth_hi_mm']:.2f}), "
            f"{row['force_mn']:.0f} mN ({row['force_lo_mn']:.0f} to {row['force_hi_mn']:.0f})"
        )
        yield text + (f"; fits no press, misfit {row['misfit']:.1f}" if row["misfit"] > MOST_MISFIT else "")
