"""What a recording shows over time: its subtracted outputs, a block at a time."""

from dataclasses import replace

import numpy as np
import pandas as pd

from softslide.features.stream.conditioning import Conditioning, block_means
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.stroke import stage_motion

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
