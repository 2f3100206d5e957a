"""Speeds that a way and its duration do not allow, and the unit that they look like."""

import numpy as np
import pandas as pd

from softslide.pipeline.sensor import Sensor

# What one of each unit is in mm/s.
SPEEDS = {"cm/s": 10.0, "m/s": 1000.0, "mm/min": 1 / 60}
# A slide's travel over its duration is its speed within this share: stages take their time to speed up and to stop.
NEAR_SPEED = 0.2


def impossible_speed(manifest: pd.DataFrame, sensor: Sensor) -> tuple[float, str]:
    """How many times the way of speed and moments of motion the way was, the median, and why that is wrong; "" if not.

    The way is `travel_mm`; where no recording says, it is the chamber's width, which slides cross.
    """
    duration = manifest["motion_end_s"] - manifest["motion_start_s"]
    ratio = (manifest["travel_mm"] / (manifest["speed_mm_s"] * duration)).dropna()
    near, way = NEAR_SPEED, "travel_mm"
    if ratio.empty:
        ratio = (np.mean(sensor.chamber_mm) / (manifest["speed_mm_s"] * duration)).dropna()
        # A slide may cross less than half of the chamber, or begin well outside it.
        near, way = 1.2, "the chamber's width"
    if ratio.empty:
        return 1.0, ""
    factor = float(ratio.median())
    if abs(np.log(factor)) <= 1.5 * near:
        return 1.0, ""
    units = [unit for unit, mm_s in SPEEDS.items() if abs(np.log(factor / mm_s)) <= near]
    guess = " or ".join(units)
    remedy = f"they look like {guess}: convert them to mm/s" if guess else "check speeds and moments"
    return factor, f"times the way that speed_mm_s and the moments of motion give is {way}; {remedy}"
