"""A folder of recordings of one short slide, labelled at will."""

from pathlib import Path

import numpy as np
import pandas as pd

from softslide.pipeline.recordings.folder import Folder, Recording, write_folder
from softslide.pipeline.sensor import Accelerometer, Sensor

RATE_HZ = 200.0
SENSOR = Sensor(
    "trial", RATE_HZ, (50.0, 50.0), 4.0, 6.0, 0.035, (5.0, 0.0), 5e-4, (Accelerometer("a0", 5.0, 0.0),)
)
LABELS = {
    "direction_deg": 0.0,
    "speed_mm_s": 14.5,
    "offset_mm": 8.0,
    "start_x_mm": -29.0,
    "start_y_mm": 8.0,
    "travel_mm": 58.0,
    "depth_mm": 0.5,
    "pressure_mpa": 0.035,
    "motion_start_s": 1.0,
    "motion_end_s": 5.0,
}


def a_slide(name: str, amplitude_v: float) -> Recording:
    """Six seconds: rest, then a pass that swings V_x both ways and V_y one way."""
    time_s = np.arange(round(6 * RATE_HZ)) / RATE_HZ
    s = np.clip((time_s - 1.0) / 4.0, 0.0, 1.0)
    pulse = np.sin(np.pi * s) ** 2
    volts = 1.65 + amplitude_v * np.column_stack([-pulse * np.cos(np.pi * s), pulse, 0.1 * pulse])
    return Recording(name, time_s + 0.25, volts)


def a_folder(root: Path, **rows: dict) -> Folder:
    """Recordings named as the keyword arguments, each labelled as LABELS unless given otherwise."""
    manifest = pd.DataFrame(
        [{"recording": name, "split": "test", **LABELS, **row} for name, row in rows.items()]
    )
    slides = (a_slide(name, 0.1 + 0.02 * n) for n, name in enumerate(rows))
    return write_folder(root, SENSOR, manifest, slides)
