"""Recordings of a small skin with a formula: each board tilts towards the contact. Rest, slide, rest; seeded noise."""

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pandas as pd

from softslide.pipeline.recordings.folder import Folder, Recording, write_folder
from softslide.pipeline.sensor import Accelerometer, Sensor

RATE_HZ = 500.0
HALF_MM = 18.0  # a slide begins and ends this far from the foot of its perpendicular
REST_S = 1.0
NOISE_V = 0.004
COLUMNS = [
    *("recording", "split", "direction_deg", "speed_mm_s", "offset_mm", "start_x_mm", "start_y_mm"),
    *("travel_mm", "depth_mm", "pressure_mpa", "motion_start_s", "motion_end_s"),
]


def bump_sensor(boards: int = 2) -> Sensor:
    """Boards at x = -4 and 4 mm, or one at 0, in a chamber of 30 mm."""
    places = {1: [0.0], 2: [-4.0, 4.0]}[boards]
    accelerometers = tuple(Accelerometer(f"a{n}", x, 0.0) for n, x in enumerate(places))
    return Sensor("bump", RATE_HZ, (30.0, 30.0), 4.0, 6.0, 0.035, (0.0, 0.0), 5e-4, accelerometers)


def answer(sensor: Sensor, x_mm: np.ndarray, y_mm: np.ndarray, direction_deg: float = math.nan) -> np.ndarray:
    """Subtracted output (n, 3 A) V for a contact at (n,) places; moving in a direction, or pressing if it is NaN."""
    edge = np.clip(17.0 - np.maximum(abs(x_mm), abs(y_mm)), 0.0, 3.0) / 3.0
    drag = np.nan_to_num([math.cos(math.radians(direction_deg)), math.sin(math.radians(direction_deg))])
    columns = []
    for board in sensor.accelerometers:
        u, w = x_mm - board.x_mm, y_mm - board.y_mm
        bell = np.exp(-(u**2 + w**2) / (2 * 6.0**2)) * edge
        vx, vy = (0.025 * u + 0.006 * drag[0]) * bell, (0.03 * w + 0.006 * drag[1]) * bell
        columns += [vx, vy, -(vx**2 + vy**2) / 1.6]
    return np.stack(columns, axis=1)


def as_recorded(sensor: Sensor, signal: np.ndarray, seed: int, noise_v: float = NOISE_V) -> np.ndarray:
    """Volts (n, C) with gravity, noise and the converter's steps, of a subtracted signal (n, C) V."""
    gravity = np.tile([1.65, 1.65, 2.45], len(sensor.accelerometers))
    noise = np.random.default_rng(seed).normal(0.0, noise_v, signal.shape)
    return np.round((gravity + signal + noise) / sensor.adc_step_v) * sensor.adc_step_v


def at_rest(sensor: Sensor, seconds: float) -> np.ndarray:
    """A subtracted signal (n, C) V of nothing."""
    return np.zeros((round(seconds * RATE_HZ), len(sensor.channels)))


def slide(sensor: Sensor, direction_deg: float, offset_mm: float, speed_mm_s: float) -> np.ndarray:
    """The subtracted signal (n, C) V of one slide at an even speed."""
    s = np.arange(-HALF_MM, HALF_MM, speed_mm_s / RATE_HZ)
    cos, sin = math.cos(math.radians(direction_deg)), math.sin(math.radians(direction_deg))
    return answer(sensor, s * cos - offset_mm * sin, s * sin + offset_mm * cos, direction_deg)


def slide_volts(
    sensor: Sensor, direction_deg: float, offset_mm: float, speed_mm_s: float, seed: int
) -> np.ndarray:
    """Rest, a slide and rest as recorded, (n, C) V."""
    rest, moving = at_rest(sensor, REST_S), slide(sensor, direction_deg, offset_mm, speed_mm_s)
    return as_recorded(sensor, np.concatenate([rest, moving, rest]), seed)


def lines(
    directions: Iterable[float], offsets: Iterable[float], speeds: Iterable[float]
) -> list[tuple[float, float, float]]:
    """Every direction (deg) with every offset (mm), the speeds (mm/s) in turn."""
    pairs, speeds = [(a, o) for a in directions for o in offsets], list(speeds)
    return [(a, o, speeds[n % len(speeds)]) for n, (a, o) in enumerate(pairs)]


def bump_folder(root: Path, sensor: Sensor, splits: dict[str, list[tuple[float, float, float]]]) -> Folder:
    """A folder of slides along `lines`, by split."""
    rows, recordings = [], []
    for split, slides in splits.items():
        for direction_deg, offset_mm, speed_mm_s in slides:
            name = f"s{len(rows):03d}"
            volts = slide_volts(sensor, direction_deg, offset_mm, speed_mm_s, seed=len(rows))
            recordings.append(Recording(name, np.arange(len(volts)) / RATE_HZ, volts))
            cos, sin = math.cos(math.radians(direction_deg)), math.sin(math.radians(direction_deg))
            start = (-HALF_MM * cos - offset_mm * sin, -HALF_MM * sin + offset_mm * cos)
            moments = (REST_S, REST_S + 2 * HALF_MM / speed_mm_s)
            how = (2 * HALF_MM, 0.5, 0.035)
            rows.append((name, split, direction_deg, speed_mm_s, offset_mm, *start, *how, *moments))
    return write_folder(root, sensor, pd.DataFrame(rows, columns=COLUMNS), recordings)
