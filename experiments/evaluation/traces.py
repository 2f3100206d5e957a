"""What a recording shows over time: its subtracted outputs a block at a time, and its static output."""

from dataclasses import replace

import numpy as np
import pandas as pd

from softslide.features.stream.conditioning import Conditioning, block_means
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.heights import alike_mpa, laser_readings_mm
from softslide.pipeline.recordings.stroke import stage_motion

# Of each pressure, recordings whose static output is read; more say the same.
MOST_AT_REST = 8
LEAST_REST_S = 0.4
_MOTION = ("motion_start_s", "motion_end_s", "travel_mm", "speed_mm_s")


def trace(folder: Folder, name: str, conditioning: Conditioning, boards: int = 1) -> pd.DataFrame:
    """A row a block: `time_s`, `travelled_mm` since the motion began, and `a0_vx` ... less the static output, V."""
    recording = folder.load(name)
    row = folder.manifest.loc[name, list(_MOTION)].astype(float).to_dict()
    volts = recording.volts[:, : 3 * boards]
    means = block_means(volts, replace(conditioning, scale=1.0), folder.sensor.sample_rate_hz)
    time = recording.time_s[0] + conditioning.block_s * (np.arange(len(means)) + 0.5)
    rest = time < row["motion_start_s"]
    static = means[rest].mean(axis=0) if rest.any() else means[0]
    since = time - row["motion_start_s"]
    travelled, _ = stage_motion(
        since, row["travel_mm"], row["speed_mm_s"], row["motion_end_s"] - row["motion_start_s"]
    )
    table = pd.DataFrame(means - static, columns=list(folder.sensor.channels[: 3 * boards]))
    return table.assign(time_s=time, travelled_mm=travelled)


def static_outputs(folder: Folder) -> pd.DataFrame:
    """The first board's static output (V, less the zero-g output) of some recordings of each pressure, with a laser's
    reading of the skin's height (mm), NaN without one."""
    zero, known = folder.sensor.accelerometers[0].zero_g_v, folder.manifest["motion_start_s"].notna()
    labels = folder.manifest.assign(laser_mm=laser_readings_mm(folder))[known]
    rows = []
    for _, part in labels.groupby(alike_mpa(labels["pressure_mpa"].dropna()), dropna=False):
        for name, label in part.iloc[:: -(-len(part) // MOST_AT_REST)].iterrows():
            recording = folder.load(str(name))
            rest = recording.time_s < label["motion_start_s"]
            if rest.sum() >= LEAST_REST_S * folder.sensor.sample_rate_hz:
                volts = recording.volts[rest, :2].mean(axis=0) - zero
                rows.append((name, label["pressure_mpa"], label["laser_mm"], *volts))
    return pd.DataFrame(rows, columns=["recording", "pressure_mpa", "laser_mm", "static_x_v", "static_y_v"])
