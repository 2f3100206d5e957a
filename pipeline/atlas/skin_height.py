"""The inflated skin's height at each pressure of a folder, from what its accelerometers read at rest.

The solved design answers which height gives a static tilt. A real skin tilts its boards by another factor: one reading
of the height, by a laser, fits it.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd

from softslide.features.errors import InputError
from softslide.pipeline.atlas.atlas import Atlas
from softslide.pipeline.atlas.static_contact import height_by_atlas, height_by_formula
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.heights import alike_mpa, is_other, laser_readings_mm, main_pressure_mpa
from softslide.pipeline.recordings.learned import REPORTING

# A row's heights, in mm, and what people call them.
HEIGHTS = {
    "laser_mm": "laser",
    "formula_mm": "article's formula",
    "atlas_mm": "solved",
    "fitted_mm": "fitted",
}


def heights_to_report(folder: Folder) -> bool:
    """Whether the recordings were made at several pressures, or a laser read the skin's height."""
    several = is_other(folder.manifest["pressure_mpa"], main_pressure_mpa(folder)).any()
    return folder.sensor.measures_gravity and bool(several or laser_readings_mm(folder).notna().any())


def skin_heights(
    folder: Folder, rest_v: Mapping[str, np.ndarray], atlas: Atlas | None
) -> list[dict[str, Any]]:
    """A row for each pressure, NaN where something is not known.

    rest_v: (C,) V at rest of the recordings that could be read, by name. atlas: of the design; None: not solved.
    `pressure_mpa`, `recordings`; `static_g`, the tilts (A, 2) g at rest; `laser_mm`, the manifest's reading;
    `formula_mm`, the article's formula (section 5.1) at the first accelerometer; `atlas_mm`, the height that the design
    was solved to have such tilts at; `fitted_mm`, the same for tilts over the factor that the laser's reading at the
    pressure nearest to the sensor's gives; `used`, whether this reading was it.
    """
    names = [name for name, volts in rest_v.items() if np.isfinite(volts).all()]
    table = folder.manifest.loc[names]
    pressure = alike_mpa(table["pressure_mpa"].fillna(folder.sensor.pressure_mpa))
    laser = laser_readings_mm(folder)[names]
    boards, half_mm = folder.sensor.accelerometers, folder.sensor.chamber_mm[0] / 2
    zero, per_g = (np.array([getattr(a, key) for a in boards]) for key in ("zero_g_v", "sensitivity_v_per_g"))
    static_g = pd.Series(
        {name: (rest_v[name].reshape(-1, 3)[:, :2] - zero[:, None]) / per_g[:, None] for name in names},
        dtype=object,
    )
    # Recordings that are for reporting are not used.
    usable = laser[laser.notna() & ~table["split"].str.startswith(REPORTING)].index
    factor, used_mpa = _tilt_factor(folder.sensor.pressure_mpa, static_g, laser[usable], pressure, atlas)
    rows = []
    for value in sorted(float(each) for each in pressure.unique()):
        here = pressure.index[pressure == value]
        mean_g = np.mean(list(static_g[here]), axis=0)
        rows.append(
            {
                "pressure_mpa": value,
                "recordings": len(here),
                "static_g": mean_g.tolist(),
                "laser_mm": float(laser[here].mean()),
                "formula_mm": abs(_or_nan(height_by_formula, float(mean_g[0, 0]), boards[0].x_mm, half_mm)),
                "atlas_mm": np.nan if atlas is None else _or_nan(height_by_atlas, mean_g, atlas),
                "fitted_mm": _or_nan(height_by_atlas, mean_g / factor, atlas),
                "used": value == used_mpa,
            }
        )
    return rows


def _tilt_factor(
    at_mpa: float, static_g: pd.Series, laser: pd.Series, pressure: pd.Series, atlas: Atlas | None
) -> tuple[float, float]:
    """By how much the tilts exceed the solved ones of the height that the laser read, and at which pressure, MPa; NaN
    without a reading, or where the atlas has no such height."""
    off = (pressure[laser.index] - at_mpa).abs()
    names = off.index[off == off.min()]
    try:
        if atlas is None or not len(names):
            return np.nan, np.nan
        solved = atlas.static(atlas.pressure_at(float(laser[names].mean())))[:, :2]
    except InputError:
        return np.nan, np.nan
    mean_g = np.mean(list(static_g[names]), axis=0)
    return float((mean_g * solved).sum() / (solved * solved).sum()), float(pressure[names[0]])


def _or_nan(height_mm: Callable[..., float], reading_g: Any, *known: Any) -> float:
    """The height of a reading, NaN where it has none."""
    try:
        return height_mm(reading_g, *known) if np.isfinite(reading_g).all() else np.nan
    except InputError:
        return np.nan


def height_lines(rows: list[dict[str, Any]]) -> Iterator[str]:
    """A line for each row, for people; heights in mm."""
    for row in rows:
        heights = ", ".join(
            f"{name} {row[key]:.2f}" + (" (fits the factor)" if key == "laser_mm" and row["used"] else "")
            for key, name in HEIGHTS.items()
            if np.isfinite(row[key])
        )
        yield f"{row['pressure_mpa']:g} MPa, {row['recordings']} recordings: {heights or 'outside the atlas'}"
    if rows and np.isnan([[row["laser_mm"], row["atlas_mm"]] for row in rows]).all():
        yield "the article's formula alone is far off on most skins; 'check --atlas' reads the solved design"
