"""Intervals cover what they promise on errors they were not calibrated on."""

import numpy as np
import pytest

from softslide.models.held_out import line_folds
from softslide.models.intervals import conformal_interval


@pytest.mark.parametrize("tail", [np.inf, 3.0])
def test_ninety_percent_are_covered_whatever_the_tail(tail):
    rng = np.random.default_rng(0)
    sd = rng.uniform(0.1, 3.0, 8000)
    noise = rng.standard_normal(8000) if tail == np.inf else rng.standard_t(tail, 8000)
    errors = 1.7 * noise * np.hypot(sd, 0.4)
    interval = conformal_interval(errors[:4000], sd[:4000], np.arange(4000))
    half = np.array([interval.half_width(s) for s in sd[4000:]])
    assert 0.88 < np.mean(np.abs(errors[4000:]) <= half) < 0.92


def test_windows_of_one_slide_count_as_one():
    """The mean coverage over many calibrations on 36 slides, ten windows each that err alike: 34 / 37, not 33 / 37."""
    rng = np.random.default_rng(2)
    slide = np.repeat(np.arange(36), 10)
    covered: dict[bool, list[float]] = {True: [], False: []}
    for _ in range(400):
        errors, fresh = np.repeat(rng.standard_normal(36), 10), np.abs(rng.standard_normal(400))
        for grouped, values in covered.items():
            interval = conformal_interval(errors, np.zeros(360), slide if grouped else np.arange(360))
            values.append(float(np.mean(fresh <= interval.half_width(0.0))))
    assert np.mean(covered[True]) == pytest.approx(34 / 37, abs=0.007)
    assert np.mean(covered[False]) == pytest.approx(33 / 37, abs=0.007)


def test_slides_along_one_line_share_a_fold():
    fold = line_folds(np.array([0.0, 0.0, 90.0, 0.0]), np.array([5.0, 5.0, 5.0, -5.0]), 4)
    assert fold[0] == fold[1]
    assert len(set(fold)) == 3


def test_confident_and_doubtful_windows_are_covered_alike():
    rng = np.random.default_rng(1)
    sd = rng.choice([0.1, 2.0], 6000)
    errors = rng.standard_normal(6000) * np.hypot(1.5 * sd, 0.5)
    interval = conformal_interval(errors, sd, np.arange(6000))
    for value in (0.1, 2.0):
        assert 0.88 < np.mean(np.abs(errors[sd == value]) <= interval.half_width(value)) < 0.92
