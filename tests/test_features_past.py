"""Estimates with a lag: each hypothesis's past, corrected by what is measured after it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from streams import write_csv
from tracked_map import TWO_BOARDS, noisy_map, touched, tracker, volts_along

import softslide
from softslide.features.contact.hypotheses import correct, remember, remembering, started
from softslide.features.errors import InputError
from softslide.features.estimate import Estimate
from softslide.pipeline.atlas.atlas import read_atlas
from softslide.pipeline.synthesis.distribution import Distribution
from softslide.pipeline.synthesis.specimen import draw_specimen
from softslide.pipeline.synthesis.synthesize import noise_of, plan, record, sensor_of
from softslide.serve.localizer import Localizer

BUNDLE = Path(__file__).parents[1] / "docs" / "examples" / "bundle"
LAG_S = 0.5


def test_a_measurement_corrects_the_past_as_the_joint_gaussian_says() -> None:
    random = np.random.default_rng(0)
    count, size = 3, 13
    bank = remembering(
        started(random.normal(size=(count, size)), np.ones((count, size)), np.zeros(count), False), 2
    )
    root = random.normal(size=(count, size + 4, size + 4))
    joint = root @ root.transpose(0, 2, 1)
    remember(bank)
    bank.covariance = joint[:, :size, :size].copy()
    bank.past_cross[:, 0] = joint[:, size:, :size]
    bank.past_covariance[:, 0] = joint[:, size:, size:]
    mean = np.concatenate([bank.state, bank.past[:, 0]], axis=1)
    slope, noise, gap = (
        random.normal(size=(count, 2, size)),
        0.3 * np.eye(2),
        random.normal(size=(count, 2, 1)),
    )
    inverse = np.linalg.inv(slope @ bank.covariance @ slope.transpose(0, 2, 1) + noise)
    correct(bank, slope.transpose(0, 2, 1), inverse @ gap, inverse)
    # The same by the formula of a Kalman filter over state and past together.
    wide = np.concatenate([slope, np.zeros((count, 2, 4))], axis=2)
    gain = joint @ wide.transpose(0, 2, 1) @ np.linalg.inv(wide @ joint @ wide.transpose(0, 2, 1) + noise)
    mean += (gain @ gap)[..., 0]
    joint = joint - gain @ wide @ joint
    assert bank.state == pytest.approx(mean[:, :size])
    assert bank.past[:, 0] == pytest.approx(mean[:, size:])
    assert bank.past_covariance[:, 0] == pytest.approx(joint[:, size:, size:])
    assert bank.past_cross[:, 0] == pytest.approx(joint[:, size:, :size])
    # Of before there is nothing.
    assert np.isnan(bank.past[:, 1]).all()


def test_a_corner_is_seen_where_it_was_from_what_comes_after_it() -> None:
    along = np.arange(-20.0, 0.0, 0.05)
    corner = np.concatenate(
        [np.column_stack([along, 0 * along + 4]), np.column_stack([0 * along, along + 24])]
    )
    response, blocks = noisy_map(places=TWO_BOARDS), 25
    followed = tracker(response, lag_blocks=blocks)
    volts = volts_along(response, corner)
    live, past = [], []
    for v, touch in zip(volts, touched(volts), strict=True):
        live.append(followed.push(v, bool(touch), np.ones(len(v), dtype=bool)))
        past.append(followed.past(blocks))
    at_once, later = (
        [np.hypot(*(track.mean[2:] - [0.0, 2.5])) for track in tracks if track is not None]
        for tracks in (live[len(along) :][:30], past[blocks:][len(along) :][:30])
    )
    assert len(at_once) == len(later) == 30
    assert np.mean(later) < 0.7 * np.mean(at_once)


@pytest.fixture(scope="module")
def volts() -> np.ndarray:
    """Of a slide that stops, (n, 3) V."""
    atlas, slides = read_atlas(), Distribution(stopping=1.0, turning=0.0, speed_mm_s=(4.0, 13.0))
    specimen = draw_specimen(sensor_of(atlas), slides, 301)
    slide = replace(plan(200, 301, atlas, sensor_of(atlas), slides), rest_after_s=1.0)
    return record(slide, specimen, atlas, noise_of(200, 301)).volts


def estimates(lag_s: float, volts: np.ndarray, size: int) -> list[Estimate]:
    localizer = Localizer.load(BUNDLE, lag_s=lag_s)
    pushed = [e for begin in range(0, len(volts), size) for e in localizer.push(volts[begin : begin + size])]
    return pushed + localizer.rest()


def test_with_a_lag_every_moment_has_its_estimate_and_slides_are_known_earlier(volts: np.ndarray) -> None:
    live, lagging = estimates(0.0, volts, 1000), estimates(LAG_S, volts, 1000)
    assert [e.time_s for e in lagging] == [e.time_s for e in live]
    assert str(estimates(LAG_S, volts, 777)) == str(lagging)
    first = [next(e.time_s for e in each if e.valid) for each in (live, lagging)]
    assert first[1] < first[0]
    assert sum(e.valid for e in lagging) > sum(e.valid for e in live)
    # The newest ones have nothing after them.
    assert str(lagging[-1]) == str(live[-1])


def test_serve_writes_as_many_lines_with_a_lag(
    volts: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_csv(tmp_path / "slide.csv", volts)
    times = []
    for lag in ((), ("--lag", "0.5")):
        words = ("serve", "--model", str(BUNDLE), "--source", str(path), "--fast", *lag)
        assert softslide.main(list(words)) == 0
        times.append([json.loads(line)["time_s"] for line in capsys.readouterr().out.splitlines()])
    assert times[0] == times[1]


def test_a_lag_that_is_none_is_refused(bundle: Path) -> None:
    with pytest.raises(InputError, match="5 s is not from 0 to 2 s"):
        Localizer.load(BUNDLE, lag_s=5.0)
    with pytest.raises(InputError, match="follows no contacts"):
        Localizer.load(bundle, lag_s=LAG_S)
