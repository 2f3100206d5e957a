"""A press in a recording: where and how hard something presses on the skin, and how well the outputs show it."""

from typing import Any

import numpy as np

from softslide.features.errors import InputError
from softslide.pipeline.atlas.atlas import Atlas
from softslide.pipeline.atlas.static_contact import (
    MODEL_SHARE,
    READING_G,
    find_indentation,
    indentation_doubt,
)
from softslide.pipeline.sensor import Sensor

REST_S = 0.5  # what a recording is taken to rest at its start
SETTLED_S = 0.3  # after the touch: the skin's lag is over, and so is most of the way down
MEAN_S = 0.2
# Of an output that differs from that at rest: nine times a block's noise (models/response_map).
TOUCH_G = 0.01
MOST_MISFIT = 3.0  # readings further from any press than three times what is expected are not presses


def press_in(volts: np.ndarray, sensor: Sensor, atlas: Atlas, height_mm: float) -> dict[str, Any]:
    """The press in one recording (n, C) V, of the strongest 0.2 s that begin SETTLED_S after the touch or later.

    height_mm: of the inflated skin. Returns `time_s`, `x_mm`, `y_mm`, `radius_mm`, which holds the place with 90 %,
    `depth_mm` and `force_mn` with `NAME_lo_UNIT` and `NAME_hi_UNIT`, 90 %, and `misfit`, the residual over what is
    expected; `valid` is false where it exceeds MOST_MISFIT, and stands alone where nothing touches.

    Raises:
        InputError: the sensor measures no gravity, or the height lies outside the atlas.
    """
    if not sensor.measures_gravity:
        raise InputError(f"{sensor.name}: presses are found in the solved skin's tilt; it measures none")
    level = atlas.pressure_at(height_mm)
    per_g = np.repeat([a.sensitivity_v_per_g for a in sensor.accelerometers], 3)
    reading = settled_reading(np.arange(len(volts)) / sensor.sample_rate_hz, volts / per_g)
    if reading is None:
        return {"valid": False}
    time_s, reading_g = reading[0], reading[1].reshape(-1, 3)
    found = find_indentation(reading_g, atlas, level)
    doubt = indentation_doubt(reading_g, atlas, level, found)
    misfit = found.misfit_g / float(np.hypot(READING_G, MODEL_SHARE * np.abs(reading_g).max()))
    return {
        "valid": misfit <= MOST_MISFIT,
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
        "misfit": misfit,
    }


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
