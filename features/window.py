"""What every model reads: the slide so far, in equal bins of time."""

from dataclasses import dataclass

import numpy as np

WINDOW_BINS = 64


@dataclass(frozen=True)
class Window:
    """volts (C, 64) float32 V: bin means of the subtracted output over [trigger, now]; elapsed_s: its length."""

    volts: np.ndarray
    elapsed_s: float
