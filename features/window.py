"""The input of every model: the slide so far, in equal bins of time."""

from dataclasses import dataclass

import numpy as np

WINDOW_BINS = 64


@dataclass(frozen=True)
class Window:
    """One window.

    volts: (C, 64) float32 V, bin means of the subtracted output from the trigger to now; elapsed_s: s between the two.
    """

    volts: np.ndarray
    elapsed_s: float
