"""The onset of a slide, from its signal alone; it relates the stage's clock to the DAQ's."""

import numpy as np

from softslide.pipeline.recordings.folder import Recording
from softslide.pipeline.recordings.successive_means import successive_means

BLOCK_S = 0.02
# How far the object is inside the inflated chamber at the onset: the median over the sample's calibration
# slides.
INSIDE_MM = 3.5


def onset_s(recording: Recording) -> float:
    """The moment at which the outputs leave their rest values, in s of the recording; NaN if they never do.

    The deviation is the root mean square over the outputs of 20 ms means, less their mean over the first
    half second. It counts once it stays above a fifth of its peak for a fifth of a second (drift and ripple
    do not stay so); the onset is where it last lay below a tenth.
    """
    rate = (len(recording.time_s) - 1) / (recording.time_s[-1] - recording.time_s[0])
    block = max(round(BLOCK_S * rate), 1)
    count = len(recording.time_s) // block
    if count * BLOCK_S < 1:
        return float("nan")
    means = successive_means(recording.volts, block)
    rest = means[: max(round(0.5 / BLOCK_S), 4)]
    away = np.sqrt(((means - rest.mean(axis=0)) ** 2).mean(axis=1))
    scatter = float(np.sqrt(rest.var(axis=0, ddof=1).mean()))
    peak = float(np.percentile(away, 99))
    stays = round(0.2 / BLOCK_S)
    above = np.convolve(away > max(8 * scatter, 0.2 * peak), np.ones(stays), "valid") == stays
    if not above.any():
        return float("nan")
    below = np.flatnonzero(away[: int(above.argmax())] < max(3 * scatter, 0.1 * peak))
    return float(recording.time_s[(int(below[-1]) + 1 if len(below) else 0) * block])
