"""The largest misfit that a slide of this sensor may have, from slides that the fit has not seen."""

import math

import numpy as np

# Of an estimate of a slide of the calibration's kind to be taken for none. A fit that ended in a wrong minimum has a
# misfit of ten and more, in a third of a percent of bench-a's held-out windows: the limit must not follow those.
CHANCE = 0.02
# With fewer nothing says how far misfits scatter, and no estimate is believed.
LEAST_SLIDES = 5


def misfit_limit(misfit: np.ndarray, slide: np.ndarray) -> float:
    """The limit for misfits (n,) of windows, and which slide (n,) each is of; 0 with fewer than LEAST_SLIDES slides.

    Split conformal prediction as in models/intervals.py, whatever the distribution: windows of one slide are alike, so
    that slides count for how many there are. With fewer than 49 slides it is the largest misfit.
    """
    if (count := len(np.unique(slide))) < LEAST_SLIDES:
        return 0.0
    misfit = np.sort(np.asarray(misfit, float))
    rank = math.ceil((1.0 - CHANCE) * (1.0 + 1.0 / count) * len(misfit) - 1e-9)
    return float(misfit[min(rank, len(misfit)) - 1])
