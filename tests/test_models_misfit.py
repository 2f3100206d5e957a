"""Models on features know what is not of their kind, and their intervals do not claim more than was shown."""

from pathlib import Path

import numpy as np
import pytest
from bump_slides import as_recorded, at_rest, bump_folder, bump_sensor, lines, slide_volts
from streams import pushed

from softslide.features.estimate import Reason
from softslide.models.export.bundle import write_bundle
from softslide.models.intervals import CHANCE, LEAST_SLIDES, conformal_interval, misfit_limit, step_between
from softslide.models.registry import fit_model, model_named
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.windows import labelled_windows
from softslide.serve.localizer import Localizer

SENSOR = bump_sensor(1)
INTERPOLATION = model_named("interpolation")
EACH_ITS_OWN = np.arange(80)  # slides of so many windows


@pytest.fixture(scope="module")
def axes(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    """Slides along the axes alone."""
    calibration = lines((0, 90, 180, 270), (-9, -6, -3, 3, 6, 9), (12, 20))
    return bump_folder(tmp_path_factory.mktemp("axes"), SENSOR, {"calibration": calibration})


@pytest.fixture(scope="module")
def localizer(axes: Folder, tmp_path_factory: pytest.TempPathFactory) -> Localizer:
    """The interpolation: every model on features gets its misfit and limits in the same way."""
    fitted = fit_model(INTERPOLATION, axes, INTERPOLATION.config())
    out = tmp_path_factory.mktemp("interpolation") / "bundle"
    write_bundle(fitted, SENSOR, labelled_windows(axes, fitted.conditioning), {}, out)
    return Localizer.load(out)


def test_slides_like_those_learnt_from_are_valid(localizer: Localizer) -> None:
    for direction_deg in (0.0, 90.0, 180.0, 270.0):
        last = pushed(localizer, slide_volts(SENSOR, direction_deg, 4.0, 16.0, seed=7))[-1]
        assert last.valid, last.reason
        assert last.misfit < localizer.card.validity.misfit


@pytest.mark.parametrize("cycle_s", [0.2, 0.6])
def test_what_is_no_slide_is_not_valid(localizer: Localizer, cycle_s: float) -> None:
    """Sums of sines of a slide's size in V_x and V_y."""
    random = np.random.default_rng(5)
    time_s = np.arange(3000) / SENSOR.sample_rate_hz
    hertz, phase = random.uniform(0.5, 1.5, (8, 1, 3)) / cycle_s, random.uniform(0.0, 6.28, (8, 1, 3))
    waves = np.sin(2 * np.pi * hertz * time_s[:, None] + phase).sum(axis=0)
    signal = np.concatenate([at_rest(SENSOR, 1.5), 0.03 * (waves - waves[0]) * [1.0, 1.0, 0.0]])
    estimates = pushed(localizer, as_recorded(SENSOR, signal, seed=1))
    reasons = {estimate.reason for estimate in estimates}
    assert Reason.NOT_THIS_SENSOR in reasons
    assert np.mean([estimate.valid for estimate in estimates]) < 0.02


def test_a_direction_that_no_recording_showed_is_held_by_the_interval_or_not_valid(
    localizer: Localizer,
) -> None:
    for direction_deg in (72.0, 108.0, 198.0):
        last = pushed(localizer, slide_volts(SENSOR, direction_deg, 2.0, 16.0, seed=3))[-1]
        assert not last.valid or last.direction_lo_deg <= direction_deg <= last.direction_hi_deg
        assert not last.valid or last.direction_hi_deg - last.direction_lo_deg > 5.0


def test_nothing_is_valid_where_too_few_slides_show_what_is_usual(tmp_path: Path) -> None:
    folder = bump_folder(tmp_path / "lab", SENSOR, {"calibration": lines((0,), (-8, -4, 3, 7), (12,))})
    fitted = fit_model(INTERPOLATION, folder, INTERPOLATION.config())
    assert fitted.validity.misfit == 0.0
    write_bundle(fitted, SENSOR, labelled_windows(folder, fitted.conditioning), {}, tmp_path / "bundle")
    estimates = Localizer.load(tmp_path / "bundle").push(slide_volts(SENSOR, 0.0, 2.0, 12.0, seed=3))
    assert np.isfinite([estimate.speed_mm_s for estimate in estimates]).any()
    assert not any(estimate.valid for estimate in estimates)


@pytest.mark.parametrize("slides", [30, 200])
def test_further_slides_exceed_the_limit_as_rarely_as_promised(slides: int) -> None:
    """Windows of one slide are alike, which must not count as more evidence."""
    random = np.random.default_rng(0)
    beyond = []
    for _ in range(400):
        own = np.exp(random.normal(0.0, 0.6, slides))
        windows = np.repeat(own, 7) * random.uniform(0.5, 1.0, 7 * slides)
        limit = misfit_limit(windows, np.repeat(np.arange(slides), 7))
        fresh = np.exp(random.normal(0.0, 0.6, 400)) * random.uniform(0.5, 1.0, 400)
        beyond.append(float(np.mean(fresh > limit)))
    assert 0.4 * CHANCE < np.mean(beyond) < 1.2 * CHANCE


def test_fits_that_ended_in_a_wrong_minimum_set_no_limit() -> None:
    """Of few slides a single one would: a limit of 300 holds nothing off."""
    misfit, slide = np.linspace(0.5, 2.0, 24), np.arange(24)
    lost = np.concatenate([misfit, [300.0, 40.0]])
    assert misfit_limit(lost, np.arange(26)) == misfit_limit(misfit, slide) == 2.0


def test_few_slides_give_no_limit() -> None:
    few = np.arange(LEAST_SLIDES - 1)
    assert misfit_limit(np.ones(len(few)), few) == 0.0


def test_a_model_that_answers_few_values_cannot_tell_what_lies_between() -> None:
    answers = np.tile([0.0, 90.0, 180.0, 270.0], 20)
    assert step_between(answers, 360.0) == pytest.approx(90.0, rel=1e-3)
    assert step_between(answers[answers != 90.0], 360.0) == pytest.approx(180.0, rel=1e-3)
    assert step_between(np.tile([5.0, 5.0 + 1e-9, 15.0], 20)) == pytest.approx(10.0, rel=1e-3)
    assert step_between(np.random.default_rng(0).normal(0.0, 1.0, 80)) == 0.0


def test_errors_of_nothing_do_not_make_an_interval_of_nothing() -> None:
    assert conformal_interval(np.zeros(80), np.zeros(80), EACH_ITS_OWN, 40.5).half_width(0.0) == 40.5
    wide = conformal_interval(np.linspace(-9.0, 9.0, 80), np.zeros(80), EACH_ITS_OWN, 2.0)
    assert wide == conformal_interval(np.linspace(-9.0, 9.0, 80), np.zeros(80), EACH_ITS_OWN)
