"""Recordings of a skin over a magnetometer whose response has a formula: a touch, a slide at an even speed, a lift."""

from pathlib import Path

import numpy as np
import pandas as pd
from dome_map import CHAMBER_MM, dome_map

from softslide.pipeline.recordings.folder import Folder, Recording, write_folder
from softslide.pipeline.sensor import Accelerometer, Sensor

RATE_HZ = 200.0
REST_S = 1.0
UNIT = 1000.0  # the formula's 0.1 are 100 uT
NOISE = 1.0  # uT
ZERO = np.array([400.0, -150.0, 7500.0])  # the field of the skin's own magnets, uT
SENSOR = Sensor(
    "a printed skin",
    RATE_HZ,
    CHAMBER_MM,
    8.0,
    10.0,
    0.001,
    (0.0, 0.0),
    0.1,
    (Accelerometer("a0", 0.0, 0.0, kind="magnetometer", unit="uT"),),
    origin="synthetic",
)


def recorded(
    direction_deg: float, offset_mm: float, speed_mm_s: float, seed: int
) -> tuple[np.ndarray, dict[str, float]]:
    """Outputs (n, 3) uT of one slide across the skin, and its labels."""
    a, half = np.radians(direction_deg), CHAMBER_MM[0] / 2
    ahead, left = np.array([np.cos(a), np.sin(a)]), np.array([-np.sin(a), np.cos(a)])
    foot = offset_mm * left
    # From edge to edge of the skin; no line is quite along an axis.
    edges = [sorted([(-half - p) / d, (half - p) / d]) for p, d in zip(foot, ahead, strict=True)]
    first, last = max(edge[0] for edge in edges), min(edge[1] for edge in edges)
    rest = round(REST_S * RATE_HZ)
    along = np.arange(first, last, speed_mm_s / RATE_HZ)
    place = foot + along[:, None] * ahead
    shown = np.zeros((len(along) + rest + rest // 2, 3))
    shown[rest : rest + len(along)] = UNIT * dome_map().response(place[:, 0], place[:, 1], a)
    noise = NOISE * np.random.default_rng(seed).standard_normal(shown.shape)
    labels = {
        "direction_deg": direction_deg,
        "speed_mm_s": speed_mm_s,
        "offset_mm": offset_mm,
        "start_x_mm": place[0, 0],
        "start_y_mm": place[0, 1],
        "travel_mm": along[-1] - first,
        "depth_mm": 0.5,
        "motion_start_s": rest / RATE_HZ,
        "motion_end_s": (rest + len(along) - 1) / RATE_HZ,
    }
    return ZERO + shown + noise, labels


def write_skin(root: Path, calibration: int, test: int) -> Folder:
    """A folder of so many slides of each split, along lines that are drawn."""
    draw = np.random.default_rng(0)
    recordings, rows = [], []
    for n in range(calibration + test):
        split = "calibration" if n < calibration else "test"
        line = draw.uniform(0, 360), draw.uniform(-9, 9), np.exp(draw.uniform(np.log(15), np.log(40)))
        outputs, labels = recorded(*line, seed=n)
        name = f"{split}-{n}"
        recordings.append(Recording(name, np.arange(len(outputs)) / RATE_HZ, outputs))
        rows.append({"recording": name, "split": split, **labels})
    return write_folder(root, SENSOR, pd.DataFrame(rows), recordings)
