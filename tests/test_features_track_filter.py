"""The track filter: less noise, no bias, recovery from outliers, and no change where there is no slide."""

import math

import numpy as np
import pytest

from features.estimate import Estimate
from features.stream.tracker import SlideState
from features.track_filter import PATIENCE, TrackFilter

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
        yield Estimate(
            time_s=n * BLOCK_S,
            state=state,
            direction_deg=degrees % 360,
            direction_lo_deg=degrees % 360 - 1.645,
            direction_hi_deg=degrees % 360 + 1.645,
            speed_mm_s=mm_s,
            speed_lo_mm_s=mm_s - 1.645 * speed * SD["speed"],
            speed_hi_mm_s=mm_s + 1.645 * speed * SD["speed"],
            offset_mm=offset,
            offset_lo_mm=offset - 1.645 * SD["place"],
            offset_hi_mm=offset + 1.645 * SD["place"],
            x_mm=start[0] + n * BLOCK_S * speed * math.cos(angle) + dx * SD["place"],
            y_mm=start[1] + n * BLOCK_S * speed * math.sin(angle) + dy * SD["place"],
            valid=valid,
        )


@pytest.mark.parametrize("heading_deg", [0.0, 135.0, 359.9])
def test_a_steady_track_passes_unchanged(heading_deg):
    track = TrackFilter()
    for given in estimates(300, heading_deg, noise=0.0):
        told = track.update(given)
        for name, value in given._asdict().items():
            assert getattr(told, name) == pytest.approx(value, abs=1e-6, nan_ok=True), name


def test_noise_falls_and_nothing_is_biased():
    raw = list(estimates(2000, 40.0, noise=1.0))
    track = TrackFilter()
    told = [track.update(given) for given in raw][200:]
    raw = raw[200:]
    for name, truth in (("direction_deg", 40.0), ("speed_mm_s", 3.0)):
        before, after = (np.array([getattr(e, name) for e in given]) - truth for given in (raw, told))
        assert after.std() < 0.5 * before.std()
        assert abs(after.mean()) < 0.1 * before.std()
    assert all(e.direction_hi_deg - e.direction_lo_deg == pytest.approx(3.29) for e in told)


def test_estimates_that_are_not_valid_pass_unchanged():
    track = TrackFilter()
    for given in (*estimates(5, 10.0, 1.0, valid=False), *estimates(5, 10.0, 1.0, state=SlideState.ENDED)):
        assert track.update(given) is given


def test_one_outlier_is_refused_and_many_in_a_row_are_taken():
    track = TrackFilter()
    for given in estimates(200, 0.0, noise=0.0):
        told = track.update(given)
    wild = list(estimates(201 + PATIENCE, 180.0, noise=0.0, start=(20.0, -8.0)))[200:]
    assert abs(track.update(wild[0]).direction_deg - told.direction_deg) < 1e-6
    for given in wild[1:]:
        told = track.update(given)
    assert told.direction_deg == pytest.approx(180.0, abs=1e-6)


def test_the_end_of_a_slide_resets_the_filter():
    track = TrackFilter()
    for given in estimates(200, 0.0, noise=0.0):
        track.update(given)
    track.update(next(estimates(1, 0.0, 0.0, state=SlideState.ENDED)))
    fresh = next(estimates(1, 180.0, noise=0.0, start=(20.0, -8.0)))
    assert track.update(fresh).direction_deg == pytest.approx(180.0)
