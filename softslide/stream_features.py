"""The features of a stream's contacts, for whoever learns from them with tools of their own."""

import numpy as np
import pandas as pd

from softslide.features.errors import InputError
from softslide.features.stream.conditioning import Conditioning, block_means
from softslide.features.stream.tracker import SlideTracker
from softslide.features.vector.feature_vector import feature_names, feature_vector

AXES = (2, 3)


def feature_table(volts: np.ndarray, rate_hz: float, axes: int = 3) -> pd.DataFrame:
    """A row of named features for each contact that slides, by `end_s`, when it was over (s from the first sample).

    A contact that still slides at the end has the last row. volts: (n, axes a sensing element) V, from a moment on at
    which nothing touches. axes: 3, or 2 without V_z, whose features are left out.

    Raises:
        InputError: another shape, or a rate without whole blocks of 20 ms.
    """
    volts = np.asarray(volts, float)
    if axes not in AXES or volts.ndim != 2 or not volts.shape[1] or volts.shape[1] % axes:
        raise InputError(f"volts of shape {volts.shape} are not (n, {axes} a sensing element)")
    if not np.isfinite(volts).all():
        raise InputError("volts hold numbers that are not finite; leave these samples out")
    elements = volts.shape[1] // axes
    whole = np.zeros((len(volts), elements, 3))
    whole[:, :, :axes] = volts.reshape(len(volts), elements, axes)
    conditioning = Conditioning()
    tracker, rows, ends = SlideTracker(conditioning, 3 * elements), [], []
    final = None
    for count, mean in enumerate(block_means(whole.reshape(len(volts), -1), conditioning, rate_hz), 1):
        tracker.push(mean)
        if tracker.final is not final and tracker.final is not None:
            rows.append(feature_vector(tracker.final.volts, tracker.final.elapsed_s))
            ends.append(count * conditioning.block_s)
        final = tracker.final
    window = tracker.window()
    if window is not None and window is not final:
        rows.append(feature_vector(window.volts, window.elapsed_s))
        ends.append(len(volts) / rate_hz)
    names = list(feature_names(elements))
    table = pd.DataFrame(np.reshape(rows, (-1, len(names))), pd.Index(ends, name="end_s", dtype=float), names)
    return table if axes == 3 else table[[name for name in names if "vz" not in name]]
