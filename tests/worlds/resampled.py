"""The same recordings at another sample rate."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from softslide.pipeline.recordings.folder import Folder, Recording, write_folder


def resampled(volts: np.ndarray, rate_hz: float, new_rate_hz: float) -> np.ndarray:
    """volts (n, C) V at `new_rate_hz` Hz: each sample is the mean over its time, as of a converter with a filter."""
    total = np.vstack([np.zeros(volts.shape[1]), np.cumsum(volts, axis=0)])
    edges = np.arange(int(len(volts) * new_rate_hz / rate_hz - 1e-9) + 1) * rate_hz / new_rate_hz
    at_edges = np.column_stack([np.interp(edges, np.arange(len(total)), channel) for channel in total.T])
    return np.diff(at_edges, axis=0) * new_rate_hz / rate_hz


def resampled_folder(folder: Folder, new_rate_hz: float, root: Path) -> Folder:
    """A copy of the folder at another rate."""
    rate_hz = folder.sensor.sample_rate_hz

    def at_new_rate(name: str) -> Recording:
        recording = folder.load(name)
        volts = resampled(recording.volts, rate_hz, new_rate_hz)
        return Recording(name, recording.time_s[0] + np.arange(len(volts)) / new_rate_hz, volts)

    sensor = replace(folder.sensor, sample_rate_hz=new_rate_hz)
    return write_folder(root, sensor, folder.manifest, map(at_new_rate, folder.manifest.index))
