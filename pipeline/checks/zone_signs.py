"""The article's contact zones as a test of the wiring: the sign that each output must have, given the labels.

Pressing the skin at x < x0 of an accelerometer lowers its v_x, pressing at y < y0 lowers its v_y (the
article's zones 1 to 4). A labelled slide says where the object is at each moment, hence which sign is due.
"""

import numpy as np
import pandas as pd

from softslide.pipeline.recordings.folder import Recording
from softslide.pipeline.recordings.signed_offset import signed_offset
from softslide.pipeline.recordings.successive_means import successive_means
from softslide.pipeline.sensor import Sensor

# Nearer than this along an axis the sign is not sure: off the chamber's centre an output turns up to 5 mm next to its
# board (2,770 sound synthetic and emulated slides, experiments/LOG.md). Farther than that the board hardly tilts.
NEAR_MM, FAR_MM = 4.5, 20.0
# A start that lies farther off the labelled line than this is not on it.
LINE_TOLERANCE_MM = 0.5
NEEDED = ("direction_deg", "speed_mm_s", "offset_mm", "motion_start_s", "motion_end_s")


def line_mismatch_mm(labels: pd.Series, sensor: Sensor) -> float:
    """How far the labelled start lies off the line of direction and offset; NaN if one is absent."""
    angle = np.deg2rad(labels["direction_deg"])
    x, y = np.array([labels["start_x_mm"], labels["start_y_mm"]], dtype=float) - sensor.reference_mm
    return float(signed_offset(angle, x, y) - labels["offset_mm"])


def start_mm(labels: pd.Series, sensor: Sensor) -> np.ndarray:
    """Where the motion starts, (2,) mm from the chamber's centre.

    The labelled start where it is given and lies on the labelled line, with the chamber ahead; otherwise the
    line alone is believed, and the motion is taken as centred on the chamber.
    """
    angle = np.deg2rad(labels["direction_deg"])
    along, left = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    start = np.array([labels["start_x_mm"], labels["start_y_mm"]], dtype=float)
    if abs(line_mismatch_mm(labels, sensor)) <= LINE_TOLERANCE_MM and start @ along < 0:
        return start
    foot = left * (labels["offset_mm"] + left @ np.array(sensor.reference_mm))
    return foot - along * labels["speed_mm_s"] * (labels["motion_end_s"] - labels["motion_start_s"]) / 2


def contact_path(time_s: np.ndarray, labels: pd.Series, sensor: Sensor) -> np.ndarray:
    """Where the object is, (n, 2) mm from the chamber's centre; NaN before and after the motion."""
    angle = np.deg2rad(labels["direction_deg"])
    since = time_s - labels["motion_start_s"]
    way = np.where((since >= 0) & (time_s <= labels["motion_end_s"]), since * labels["speed_mm_s"], np.nan)
    return start_mm(labels, sensor) + way[:, None] * np.array([np.cos(angle), np.sin(angle)])


def rests_on_skin(labels: pd.Series, sensor: Sensor) -> bool:
    """Whether the motion ends over the chamber: the object then rests on the skin. False where no label says."""
    end = contact_path(np.array([labels["motion_end_s"]]), labels, sensor)[0]
    return bool((np.abs(end) < np.array(sensor.chamber_mm) / 2).all())


def sign_agreement(recording: Recording, labels: pd.Series, sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
    """How far each output follows the sign due: (accelerometers, 3 outputs, 2 axes), cosines in [-1, 1]; and, of the
    same shape, the root mean square of what is compared, V.

    Entry [k, i, j] compares output i (v_x, v_y, v_z, less the rest before the slide) of accelerometer k with
    the sign due along axis j: +1 agrees, -1 inverted, 0 unrelated. A well-wired board has [k, 0, 0] and
    [k, 1, 1] near +1. NaN where the labels or the path do not say.
    """
    agreement = np.full((len(sensor.accelerometers), 3, 2), np.nan)
    compared_v = np.zeros_like(agreement)
    if labels[list(NEEDED)].isna().any():
        return agreement, compared_v
    # Means over hundredths of a second: the noise goes, the slide stays.
    count = max(int(sensor.sample_rate_hz / 100), 1)
    time_s, volts = (successive_means(values, count) for values in (recording.time_s, recording.volts))
    rest = time_s < labels["motion_start_s"]
    if rest.sum() < 2:
        return agreement, compared_v
    path = contact_path(time_s, labels, sensor)
    volts = volts - volts[rest].mean(axis=0)
    for k, part in enumerate(sensor.accelerometers):
        away = path - (part.x_mm, part.y_mm)
        close = np.hypot(away[:, 0], away[:, 1]) < FAR_MM
        for j in range(2):
            known = close & (np.abs(away[:, j]) > NEAR_MM)
            if known.sum() < 10:
                continue
            due = np.sign(away[known, j])
            for i in range(3):
                output = volts[known, 3 * k + i]
                size_v = np.linalg.norm(output) / np.sqrt(len(due))
                agreement[k, i, j] = output @ due / (size_v * len(due)) if size_v > 0 else 0.0
                compared_v[k, i, j] = size_v
    return agreement, compared_v
