"""Intervals that hold, and the largest misfit of a valid estimate, from lines that a fit has not seen.

Split conformal prediction on the ratio |error| / sqrt(sd^2 + floor^2): its 90 % quantile over held-out windows is the
interval's scale, whatever the errors' distribution. The floor, the part of the error that the model does not know of,
is the one that spreads this coverage most evenly over windows of small and of large deviation.
"""

import math

import numpy as np

from softslide.features.card import COVERAGE, Interval

LEAST_WINDOWS = 20  # to set intervals on: with fewer a 90 % quantile is the largest error
LEAST_FLOOR = 1e-3  # of the largest error: the middle of the floors that are tried
SAME = 1e-4  # answers that differ by less than this share of their range are one value
CHANCE = 0.02  # of an estimate of a slide of the calibration's kind to be rejected
# Times the median: the misfit of a fit that ended in a wrong minimum, as of 0.1 to 1.2 % of the held-out windows of
# three sensors (experiments/LOG.md). The limit must not follow those.
WRONG_MINIMUM = 10.0
# With fewer nothing says how far misfits scatter, and no estimate is believed.
LEAST_SLIDES = 5
OFTEN = 5  # times that each value is answered on average, where answers are values of a list
GROUPS = 5  # of equally many windows, by their deviation


def conformal_rank(windows: int, slides: int, coverage: float) -> int:
    """Which of so many sorted values of held-out windows, from 0, bounds a further one with the coverage: windows of
    one slide are alike, so that slides count for how many there are. With few slides it is the largest."""
    return min(math.ceil(coverage * (1 + 1 / slides) * windows - 1e-9), windows) - 1


def misfit_limit(misfit: np.ndarray, slide: np.ndarray) -> float:
    """The limit for misfits (n,) of windows, and which slide (n,) each is of; 0 with fewer than LEAST_SLIDES slides."""
    misfit = np.asarray(misfit, float)
    if (count := len(np.unique(slide))) < LEAST_SLIDES:
        return 0.0
    ordinary = np.sort(misfit[misfit <= WRONG_MINIMUM * np.median(misfit)])
    return float(ordinary[conformal_rank(len(ordinary), count, 1.0 - CHANCE)])


def conformal_interval(
    errors: np.ndarray,
    sd: np.ndarray,
    slide: np.ndarray,
    least: float = 0.0,
) -> Interval:
    """errors, sd (n,) in one unit, one at least; sd all zero gives a constant half-width.

    slide: (n,), which slide each is of: windows of one slide err alike, so that only slides count for how many there
        are (hierarchical conformal prediction, Lee, Barber and Willett 2023, as if each had equally many windows; with
        fewer than nine slides the largest ratio).
    least: half-width below which the held-out errors show nothing (`step_between`).
    """
    errors, sd = np.abs(np.asarray(errors, float)), np.asarray(sd, float)
    rank = conformal_rank(len(errors), len(np.unique(slide)), COVERAGE)
    # A model that is mostly right to the last bit has a median of 0.
    floors = max(float(np.median(errors)), LEAST_FLOOR * float(errors.max()), 1e-9) * np.geomspace(
        0.02, 5.0, 60
    )
    groups = np.array_split(np.argsort(sd, kind="stable"), min(GROUPS, len(errors)))
    shown = Interval(scale=1.0, floor=least)
    least_uneven, interval = math.inf, shown
    for floor in floors:
        ratios = errors / np.hypot(sd, floor)
        scale = float(np.sort(ratios)[rank])
        uneven = sum((float(np.mean(ratios[group] <= scale)) - COVERAGE) ** 2 for group in groups)
        if uneven < least_uneven - 1e-12:
            least_uneven, interval = uneven, Interval(scale=scale, floor=float(floor))
    return interval if interval.half_width(0.0) >= least else shown


def step_between(answers: np.ndarray, period: float | None = None) -> float:
    """The largest step between the few values that a model answers, in their unit; 0 of one whose answers vary freely.

    What lies between such values it cannot show, and labels that are these values do not show it: their errors are 0.
    answers: (n,). period: 360 of directions, whose last value is followed by the first.
    """
    answers = np.asarray(answers, float)
    if period is not None:
        answers = answers % period
    grain = max(float(np.ptp(answers)), np.finfo(float).tiny) * SAME
    values = np.unique(np.round(answers / grain)) * grain
    if len(answers) < OFTEN * len(values):
        return 0.0
    if period is not None:
        values = np.append(values, values[0] + period)
    return float(np.diff(values).max(initial=0.0))
