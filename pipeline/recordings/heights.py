"""The skin's height at each recording: a laser's reading, or what the pressure under the skin makes of those there are.

A skin's height goes about with the cube root of the pressure; where a laser read several pressures they give the power.
"""

import math
from dataclasses import replace

import numpy as np
import pandas as pd

from softslide.features.height import MARGIN_MM
from softslide.pipeline.recordings.folder import Folder

# Column of a manifest in memory: the skin's height, in mm. No file has it: synthetic recordings have a `height_mm`.
HEIGHT = "derived.height_mm"
LASER = "skin_height_mm"  # a laser's reading of it
# Relative: what a regulator holds a pressure by. The skin's height goes with its cube root.
SAME_PRESSURE = 0.02
POWER = 1 / 3
# At the main pressure, where no laser read it: between two benches' 7.2 and 8.1 mm (docs/method.md).
USUAL_MM = 7.5


def main_pressure_mpa(folder: Folder) -> float:
    """The pressure under the skin that the most recordings have, to SAME_PRESSURE; `sensor.toml`'s where none says.

    A gauge's readings differ where the pressure is the same.
    """
    pressures = np.sort(folder.manifest["pressure_mpa"].dropna().to_numpy(float))
    if not len(pressures):
        return folder.sensor.pressure_mpa
    alike = np.searchsorted(pressures, pressures * (1 + SAME_PRESSURE), "right")
    alike -= np.searchsorted(pressures, pressures * (1 - SAME_PRESSURE), "left")
    most = pressures[alike == alike.max()]
    most = most[most <= most[0] * (1 + SAME_PRESSURE)]
    return float(most[(len(most) - 1) // 2])


def alike_mpa(pressures_mpa: pd.Series) -> pd.Series:
    """Pressures (none NaN), those that are the same to SAME_PRESSURE on either side as their median."""
    ordered = pressures_mpa.sort_values()
    lowest, groups = -math.inf, []
    for value in ordered:
        lowest = value if value > lowest * (1 + 2 * SAME_PRESSURE) else lowest
        groups.append(lowest)
    return ordered.groupby(groups).transform("median")[pressures_mpa.index]


def is_other(pressures_mpa: pd.Series, pressure_mpa: float) -> pd.Series:
    """Whether a recording's pressure is another; one that is not known is not."""
    return (pressures_mpa / pressure_mpa - 1).abs() > SAME_PRESSURE


def laser_readings_mm(folder: Folder) -> pd.Series:
    """A laser's reading at each recording, NaN where it is missing or not above zero."""
    if LASER not in folder.manifest:
        return pd.Series(np.nan, folder.manifest.index)
    read = pd.to_numeric(folder.manifest[LASER], errors="coerce").astype(float)
    return read.where((read > 0) & np.isfinite(read))


def pressures_by_laser(folder: Folder) -> pd.Series:
    """The pressure at each recording that a laser's reading shows, MPa, that of `sensor.toml` at the middle reading;
    NaN where it read one height, to what a laser may err by either way."""
    read = laser_readings_mm(folder)
    if not read.max() - read.min() > 2 * MARGIN_MM:
        return pd.Series(np.nan, read.index)
    return folder.sensor.pressure_mpa * (read / read.median()) ** (1 / POWER)


def said_of_heights(folder: Folder) -> str:
    """For people, what is made of calibration slides at several pressures; empty where they have one."""
    main_mpa = main_pressure_mpa(folder)
    others = is_other(folder.manifest["pressure_mpa"], main_mpa)
    if not others.any():
        return ""
    heights = with_heights(folder).manifest[HEIGHT]
    read = int(laser_readings_mm(folder).notna().sum())
    return (
        f"{int(others.sum())} calibration slides are not at {main_mpa:g} MPa as {int((~others).sum())} are: 'train' "
        f"makes cnn one map over heights of the skin ({heights.min():.2f} to {heights.max():.2f} mm; {LASER} of {read} "
        "slides), unless a map of each height predicts held-out lines better; other models leave these slides out"
    )


def with_heights(folder: Folder) -> Folder:
    """The folder with the height of the skin at each recording in the column HEIGHT, where there are several pressures.

    A height is the laser's reading, else that of its pressure, which the readings give.
    """
    main_mpa = main_pressure_mpa(folder)
    pressure = folder.manifest["pressure_mpa"].fillna(main_mpa)
    if not is_other(pressure, main_mpa).any():
        return folder
    read = laser_readings_mm(folder)
    share = np.log(pressure.to_numpy(float) / main_mpa)
    known = read.notna().to_numpy()
    power, at_main_mm = POWER, USUAL_MM
    if known.any():
        log_mm = np.log(read[known].to_numpy())
        if np.ptp(share[known]) > math.log1p(SAME_PRESSURE):
            power = float(np.polyfit(share[known], log_mm, 1)[0])
        at_main_mm = float(np.exp(np.mean(log_mm - power * share[known])))
    heights = read.where(read.notna(), at_main_mm * np.exp(power * share))
    return replace(folder, manifest=folder.manifest.assign(**{HEIGHT: heights}))
