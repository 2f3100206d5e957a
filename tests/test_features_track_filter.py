"""The track filter: less noise, no bias, recovery from outliers, and no change where there is no slide."""

import math

import numpy as np
import pytest

from softslide.features.estimate import Estimate
from softslide.features.stream.tracker import SlideState
from softslide.features.track_filter import PATIENCE, TrackFilter

BLOCK_S = 0.02
SD = {"turn": math.radians(1.0), "speed": 0.05, "place": 0.2}


def estimates(count, heading_deg, noise, speed=3.0, valid=True, state=SlideState.SLIDE, start=(-20.0, 4.0)):
    """A straight slide's estimates, each with errors of its own in direction, speed and place, and true intervals."""
    generator = np.random.default_rng(1)
    for n in range(count):
        turn, faster, dx, dy = noise * generator.normal(size=4)
        angle = math.radians(heading_deg)
        degrees, mm_s = heading_deg + math.degrees(turn * SD["turn"]), speed * (1 + faster * SD["speed"])
        offset = start[1] * math.cos(angle) - start[0] * math.sin(angle)
        way = n * BLOCK_S * speed
        place = {
            "x_mm": start[0] + way * math.cos(angle) + dx * SD["place"],
            "y_mm": start[1] + way * math.sin(angle) + dy * SD["place"],
        }
        intervals = bounds("direction", "deg", degrees % 360, 1.0)
        intervals |= bounds("speed", "mm_s", mm_s, speed * SD["speed"])
        intervals |= bounds("offset", "mm", offset, SD["place"])
        yield Estimate(n * BLOCK_S, state, valid=valid, **place, **intervals)


def bounds(name, unit, value, sd):
    half = 1.645 * sd
    return {f"{name}_{unit}": value, f"{name}_lo_{unit}": value - half, f"{name}_hi_{unit}": value + half}


@pytest.mark.parametrize("heading_deg", [0.0, 135.0, 359.9])
def test_a_steady_track_passes_unchanged(heading_deg):
    track = TrackFilter()
    for given in estimates(300, heading_deg, noise=0.0):
        smooth = track.update(given)
        for name, value in given._asdict().items():
            assert getattr(smooth, name) == pytest.approx(value, abs=1e-6, nan_ok=True), name


def test_noise_falls_and_nothing_is_biased():
    raw = list(estimates(2000, 40.0, noise=1.0))
    track = TrackFilter()
    smooth = [track.update(given) for given in raw][200:]
    raw = raw[200:]
    for name, truth in (("direction_deg", 40.0), ("speed_mm_s", 3.0)):
        before, after = (np.array([getattr(e, name) for e in given]) - truth for given in (raw, smooth))
        assert after.std() < 0.5 * before.std()
        assert abs(after.mean()) < 0.1 * before.std()
    assert all(e.direction_hi_deg - e.direction_lo_deg == pytest.approx(3.29) for e in smooth)


def test_estimates_that_are_not_valid_pass_unchanged():
    track = TrackFilter()
    for given in (*estimates(5, 10.0, 1.0, valid=False), *estimates(5, 10.0, 1.0, state=SlideState.ENDED)):
        assert track.update(given) is given


def test_one_outlier_is_refused_and_many_in_a_row_are_taken():
    track = TrackFilter()
    for given in estimates(200, 0.0, noise=0.0):
        smooth = track.update(given)
    wild = list(estimates(201 + PATIENCE, 180.0, noise=0.0, start=(20.0, -8.0)))[200:]
    assert abs(track.update(wild[0]).direction_deg - smooth.direction_deg) < 1e-6
    for given in wild[1:]:
        smooth = track.update(given)
    assert smooth.direction_deg == pytest.approx(180.0, abs=1e-6)


def test_the_end_of_a_slide_resets_the_filter():
    track = TrackFilter()
    for given in estimates(200, 0.0, noise=0.0):
        track.update(given)
    track.update(next(estimates(1, 0.0, 0.0, state=SlideState.ENDED)))
    fresh = next(estimates(1, 180.0, noise=0.0, start=(20.0, -8.0)))
    assert track.update(fresh).direction_deg == pytest.approx(180.0)
