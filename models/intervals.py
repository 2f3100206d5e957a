"""Intervals that hold: a model's own standard deviations, corrected on lines that it has not seen.

Split conformal prediction on the ratio |error| / sqrt(sd^2 + floor^2): its 90 % quantile over held-out windows is the
interval's scale, whatever the errors' distribution. The floor is what a Gaussian with that deviation makes likeliest:
the part of the error that the model does not know of.
"""

import math

import numpy as np

from features.card import Interval

COVERAGE = 0.9


def conformal_interval(errors: np.ndarray, sd: np.ndarray, coverage: float = COVERAGE) -> Interval:
    """errors, sd (n,) in one unit; sd all zero gives a constant half-width.

    Raises:
        ValueError: there are no errors to calibrate on.
    """
    errors, sd = np.abs(np.asarray(errors, float)), np.asarray(sd, float)
    if not errors.size:
        raise ValueError("no held-out errors to calibrate an interval on")
    typical = max(float(np.median(errors)), 1e-9)
    floors = typical * np.geomspace(0.02, 5.0, 40)
    variance = sd[:, None] ** 2 + floors**2
    # Heavy tails must not set the floor: errors count up to four times their median.
    clipped = np.minimum(errors, 4 * typical)[:, None]
    floor = float(floors[np.argmin((np.log(variance) + clipped**2 / variance).mean(axis=0))])
    ratios = np.sort(errors / np.hypot(sd, floor))
    rank = min(math.ceil(coverage * (len(ratios) + 1)), len(ratios)) - 1
    return Interval(scale=float(ratios[rank]), floor=floor)


def angle_error_deg(estimate_deg: np.ndarray, truth_deg: np.ndarray) -> np.ndarray:
    """Signed difference in (-180, 180]."""
    return -((truth_deg - estimate_deg + 180.0) % 360.0 - 180.0)


def line_folds(direction_deg: np.ndarray, offset_mm: np.ndarray, count: int) -> np.ndarray:
    """A fold number (n,) for each item such that slides along one line share a fold."""
    lines = np.stack([np.round(direction_deg, 3), np.round(offset_mm, 3)], axis=1)
    _, number = np.unique(lines, axis=0, return_inverse=True)
    return np.ravel(number) % count
