"""The output at rest over a calibration, and how it scatters from slide to slide."""

from typing import NamedTuple

import numpy as np

from features.stream.conditioning import Conditioning, block_means
from models.response_map.slides import LEAST_REST_BLOCKS
from pipeline.recordings.folder import Folder
from pipeline.recordings.heights import HEIGHT

# Of each static output by itself: one step of the article's converter.
LEAST_STATIC_SD_V = 5e-4
LEAST_RECORDINGS = 12  # twice the outputs of two accelerometers; fewer tell no covariance


class StaticScatter(NamedTuple):
    """mean_v: (3 A,) V, all three outputs of each accelerometer; covariance_v2: (3 A, 3 A) V^2."""

    mean_v: np.ndarray
    covariance_v2: np.ndarray


def static_scatter(
    folder: Folder, conditioning: Conditioning, height_mm: float | None = None
) -> StaticScatter | None:
    """Of the folder's recordings, before their motion; None where they are too few.

    height_mm: of recordings at several heights of the skin: the static output at this one, and its scatter about a
    line over the height. None: they have one.
    """
    statics = static_outputs(folder, conditioning)
    if len(statics) < LEAST_RECORDINGS:
        return None
    design = np.ones((len(statics), 1))
    if height_mm is not None:
        off_mm = folder.manifest.loc[list(statics), HEIGHT].to_numpy(float) - height_mm
        design = np.column_stack([design, off_mm])
    return scatter_about(design, np.array(list(statics.values())))


def static_outputs(folder: Folder, conditioning: Conditioning) -> dict[str, np.ndarray]:
    """(3 A,) V before the motion, by name, of the recordings that tell it and rest for long enough."""
    statics = {}
    for name, start_s in folder.manifest["motion_start_s"].dropna().items():
        recording = folder.load(str(name))
        rest = recording.volts[recording.time_s < start_s - conditioning.block_s]
        blocks = block_means(rest, conditioning, folder.sensor.sample_rate_hz)
        if len(blocks) >= LEAST_REST_BLOCKS:
            statics[str(name)] = blocks.mean(axis=0)
    return statics


def scatter_about(design: np.ndarray, statics: np.ndarray) -> StaticScatter:
    """Of statics (n, 3 A) V about their least-squares fit by a design (n, p), whose first column is 1."""
    line = np.linalg.lstsq(design, statics, rcond=None)[0]
    left = statics - design @ line
    covariance = left.T @ left / (len(left) - design.shape[1])
    # Each output's own: where a tilt makes all scatter alike, their differences hardly do.
    return StaticScatter(line[0], covariance + LEAST_STATIC_SD_V**2 * np.eye(len(covariance)))
