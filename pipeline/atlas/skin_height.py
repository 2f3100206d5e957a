"""The inflated skin's height at each pressure of a folder, from what its accelerometers read at rest.

The solved design answers which height gives a static tilt. A real skin tilts its boards by another factor: one reading
of the height, by a laser, fits it.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from features.errors import InputError
from pipeline.atlas.atlas import Atlas
from pipeline.atlas.static_contact import height_by_atlas, height_by_formula
from pipeline.recordings.folder import Folder
from pipeline.recordings.heights import LASER, laser_readings_mm

REST_S = 0.5  # what an unlabelled recording is taken to rest at its start


def laser_mm(folder: Folder) -> float:
    """The mean of a laser's readings in mm.

    Raises:
        InputError: the folder has none.
    """
    readings = laser_readings_mm(folder)
    if readings.isna().all():
        raise InputError(
            f"not known: {folder.root / 'manifest.csv'} has no {LASER}; name one in mm", "height"
        )
    return float(readings.mean())


def skin_heights(folder: Folder, atlas: Atlas) -> list[dict[str, Any]]:
    """A row for each pressure, NaN where something is not known.

    `pressure_mpa`, `recordings`; `static_g`, the tilts (A, 2) g at rest; `laser_mm`, the manifest's reading;
    `formula_mm`, the article's formula (section 5.1) at the first accelerometer; `atlas_mm`, the height that the design
    was solved to have such tilts at; `fitted_mm`, the same for tilts over the factor that the laser's reading at the
    pressure nearest to the sensor's gives; `used`, whether this reading was it.

    Raises:
        InputError: the sensor measures no gravity, or the laser's reading lies outside the atlas.
    """
    if not folder.sensor.measures_gravity:
        raise InputError(f"{folder.sensor.name}: the skin's height is read from gravity; it measures none")
    pressure = folder.manifest["pressure_mpa"].fillna(folder.sensor.pressure_mpa)
    laser = laser_readings_mm(folder)
    static_g = pd.Series({name: _static_g(folder, name) for name in folder.manifest.index}, dtype=object)
    factor, used_mpa = _tilt_factor(folder, static_g, laser, pressure, atlas)
    rows = []
    for value in sorted(float(each) for each in pressure.unique()):
        names = pressure.index[pressure == value]
        mean_g = np.mean(list(static_g[names]), axis=0)
        rows.append(
            {
                "pressure_mpa": value,
                "recordings": len(names),
                "static_g": mean_g,
                "laser_mm": float(laser[names].mean()),
                "formula_mm": _formula(folder, mean_g),
                "atlas_mm": _by_atlas(mean_g, atlas),
                "fitted_mm": _by_atlas(mean_g / factor, atlas),
                "used": value == used_mpa,
            }
        )
    return rows


def _tilt_factor(
    folder: Folder, static_g: pd.Series, laser: pd.Series, pressure: pd.Series, atlas: Atlas
) -> tuple[float, float]:
    """By how much the tilts exceed the solved ones of the height that the laser read, and at which pressure, MPa; NaN
    without a reading. Recordings that are for reporting are not used.

    Raises:
        InputError: the laser's reading lies outside the atlas.
    """
    usable = laser.notna() & ~folder.manifest["split"].str.startswith(("test", "track"))
    if not usable.any():
        return np.nan, np.nan
    off = (pressure[usable] - folder.sensor.pressure_mpa).abs()
    names = off.index[off == off.min()]
    solved = atlas.static(atlas.pressure_at(float(laser[names].mean())))[:, :2]
    mean_g = np.mean(list(static_g[names]), axis=0)
    return float((mean_g * solved).sum() / (solved * solved).sum()), float(pressure[names[0]])


def _static_g(folder: Folder, name: str) -> np.ndarray:
    """(A, 2) g along x and y before the motion."""
    recording, start_s = folder.load(name), float(folder.manifest["motion_start_s"][name])
    end_s = recording.time_s[0] + REST_S if np.isnan(start_s) else start_s
    volts = recording.volts[recording.time_s < end_s].mean(axis=0).reshape(-1, 3)[:, :2]
    boards = folder.sensor.accelerometers
    zero, per_g = (np.array([getattr(a, key) for a in boards]) for key in ("zero_g_v", "sensitivity_v_per_g"))
    return (volts - zero[:, None]) / per_g[:, None]


def _formula(folder: Folder, static_g: np.ndarray) -> float:
    try:
        board = folder.sensor.accelerometers[0]
        return abs(height_by_formula(float(static_g[0, 0]), board.x_mm, folder.sensor.chamber_mm[0] / 2))
    except InputError:
        return np.nan


def _by_atlas(static_g: np.ndarray, atlas: Atlas) -> float:
    try:
        return height_by_atlas(static_g, atlas) if np.isfinite(static_g).all() else np.nan
    except InputError:
        return np.nan


def told(rows: list[dict[str, Any]]) -> Iterator[str]:
    """A line for each row, for people; heights in mm."""
    shown = (
        ("laser_mm", "laser"),
        ("formula_mm", "formula"),
        ("atlas_mm", "solved"),
        ("fitted_mm", "fitted"),
    )
    for row in rows:
        heights = ", ".join(
            f"{name} {row[key]:.2f}" + (" (fits the factor)" if key == "laser_mm" and row["used"] else "")
            for key, name in shown
            if np.isfinite(row[key])
        )
        yield f"{row['pressure_mpa']:g} MPa, {row['recordings']} recordings: {heights or 'outside the atlas'}"
