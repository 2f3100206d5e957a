"""Laws of the splines, and of a map's calibration on slides whose truth is known."""

import math
from dataclasses import replace

import numpy as np
import pytest
from bump_map import bump_map
from calibration_slides import slides_of
from hypothesis import given
from hypothesis import strategies as st

from softslide.models.response_map.calibrate import MAP_VARIANCE, RIM_MM, calibrate, zero_errors
from softslide.models.response_map.from_atlas import SensorSpread, prior_map
from softslide.models.response_map.map import spline_basis, spline_coefficients
from softslide.models.response_map.slide_fit import CalibrationConfig
from softslide.pipeline.atlas.atlas import DEFAULT_SENSOR, read_atlas
from softslide.pipeline.sensor import read_sensor

HALF_MM = 30.0


@given(st.floats(-HALF_MM, HALF_MM))
def test_splines_sum_to_one_inside_and_reproduce_straight_lines(position):
    basis = spline_basis(np.array([position]), HALF_MM)[0]
    centres = -HALF_MM + 2.5 * (np.arange(len(basis)) - 1)
    assert basis.sum() == pytest.approx(1.0, abs=1e-12)
    assert basis @ centres == pytest.approx(position, abs=1e-10)


def test_splines_vanish_beyond_their_range():
    assert not spline_basis(np.array([-40.0, 37.6]), HALF_MM).any()


def test_coefficients_give_back_a_smooth_surface():
    grid = np.arange(-30.0, 30.1, 1.0)
    x, y = np.meshgrid(grid, grid, indexing="ij")
    values = np.stack([np.sin(x / 9) * np.cos(y / 11)], axis=2)
    coefficients = spline_coefficients(values, HALF_MM)
    basis = spline_basis(grid, HALF_MM)
    again = np.einsum("ni,ijc,mj->nmc", basis, coefficients, basis)
    # Fourth order in the spacing: (2.5 / 9)^4 / 400.
    np.testing.assert_allclose(again, values, atol=5e-5)


LINES = [(d, o) for d in (0.0, 90.0, 180.0, 270.0, 37.0, 142.0, 255.0) for o in np.arange(-20.0, 21.0, 5.0)]


def error_of(found, truth):
    x, y = np.meshgrid(np.arange(-20.0, 21.0, 2.0), np.arange(-20.0, 21.0, 2.0))
    gaps = [
        found.response(x.ravel(), y.ravel(), a) - truth.response(x.ravel(), y.ravel(), a) for a in (0.7, 3.9)
    ]
    return float(np.sqrt(np.mean(np.square(gaps))))


@pytest.fixture(scope="module")
def calibrated():
    truth = bump_map()
    rng = np.random.default_rng(1)
    speeds, gains = rng.uniform(0.5, 12.0, len(LINES)), 1 + 0.02 * rng.standard_normal(len(LINES))
    slides = slides_of(truth, LINES, speeds, gains / gains.mean(), 1.4e-3, lag_s=0.02)
    blank = truth.scaled(0.0)
    return truth, slides, calibrate(slides, blank, False, CalibrationConfig())


def test_calibration_finds_the_map_the_lag_and_the_spread_of_gains(calibrated):
    truth, _, (found, report) = calibrated
    assert error_of(found, truth) < 1.5e-3  # of a largest output of 0.13 V
    assert found.lag_s == pytest.approx(0.02, abs=0.004)
    assert found.gain_sd == pytest.approx(0.02, rel=0.4)
    assert report["outliers"] == 0


def test_how_the_residual_grows_with_the_output_is_estimated(calibrated):
    """One of white noise does not; one that is a share of the output is that share, and little where there is none."""
    truth, slides, (found, _) = calibrated
    assert found.weak_floor_v == pytest.approx(found.floor_v, rel=0.2)
    largest = max(np.abs(slide.volts).max() for slide in slides)
    assert found.floor_share * largest < 0.5 * found.floor_v
    ripple = [1 + 0.1 * np.sin(slide.travelled_mm + n)[:, None] for n, slide in enumerate(slides)]
    uneven = [replace(slide, volts=slide.volts * each) for slide, each in zip(slides, ripple, strict=True)]
    found, _ = calibrate(uneven, truth.scaled(0.0), False, CalibrationConfig())
    # Rms over both channels, of which one is the largest.
    assert found.floor_share == pytest.approx(0.05, rel=0.3)
    assert found.weak_floor_v < 0.5 * found.floor_v


def test_how_much_of_the_residual_is_of_the_place_is_estimated(calibrated):
    """Of slides that waver along their line it is what they waver by."""
    truth, slides, (steady, _) = calibrated
    wavering = []
    for n, slide in enumerate(slides):
        ahead = replace(
            slide, travelled_mm=slide.travelled_mm + 0.15 * math.sqrt(2) * np.sin(slide.travelled_mm + n)
        )
        off, on = (truth.response(*each.place(0.0, 0.02), each.direction_rad) for each in (ahead, slide))
        wavering.append(replace(slide, volts=slide.volts + off - on))
    found, _ = calibrate(wavering, truth.scaled(0.0), False, CalibrationConfig())
    assert found.place_mm == pytest.approx(0.15, rel=0.25)
    assert steady.place_mm < 0.05
    assert found.level_v < 0.5 * found.floor_v


def test_a_slide_with_a_wrong_label_is_left_out(calibrated):
    truth, slides, _ = calibrated
    wrong = replace(slides[3], direction_rad=slides[3].direction_rad + np.pi / 2)
    blank = replace(truth, coefficients=0 * truth.coefficients)
    found, report = calibrate([*slides[:3], wrong, *slides[4:]], blank, False, CalibrationConfig())
    assert report["outliers"] == 1
    assert error_of(found, truth) < 3e-3


def test_a_good_prior_makes_up_for_recordings():
    truth = bump_map()
    few = slides_of(
        truth, [(0.0, 5.0), (90.0, -5.0), (180.0, 10.0), (45.0, 0.0)], [1.0, 2.0, 3.0, 4.0], np.ones(4)
    )
    near = truth.scaled(0.95)
    blank = truth.scaled(0.0)
    informed, _ = calibrate(few, near, True, CalibrationConfig())
    alone, _ = calibrate(few, blank, False, CalibrationConfig())
    assert error_of(informed, truth) < 0.5 * error_of(alone, truth)
    assert error_of(informed, truth) < error_of(near, truth)


def test_a_stretch_counts_by_the_inverse_of_its_variance():
    """Two slides over each line that disagree: one of 1 block a stretch, one of 50. The fit is linear in the volts."""
    truth = bump_map()
    blank, once = truth.scaled(0.0), CalibrationConfig(iterations=1)
    speeds = {1: 25.0, 50: 0.5}
    slides = {
        blocks: slides_of(truth, LINES, np.full(len(LINES), speed), np.ones(len(LINES)))
        for blocks, speed in speeds.items()
    }
    assert all(slide.blocks == blocks for blocks, group in slides.items() for slide in group)

    def fitted(changed):
        both = [
            replace(slide, volts=slide.volts + (5e-3 if blocks == changed else 0.0))
            for blocks, group in slides.items()
            for slide in group
        ]
        return calibrate(both, blank, False, once)[0].coefficients

    unchanged = fitted(None)
    short, long = (np.abs(fitted(blocks) - unchanged).sum() for blocks in (1, 50))
    assert long / short == pytest.approx((1 + MAP_VARIANCE) / (1 / 50 + MAP_VARIANCE), rel=1e-6)
    assert long / short > 2  # averaging counts, if less than 50 times


def test_the_map_is_silent_on_the_rim_whatever_the_slides_show_inside():
    """Slides that end inside the chamber while they still show 50 mV: a spline alone would carry that on outwards."""
    truth = bump_map()
    slides = slides_of(truth, LINES, np.full(len(LINES), 2.0), np.ones(len(LINES)))
    short = []
    for slide in slides:
        inside = np.max(np.abs(slide.place(0.0, 0.0)), axis=0) < 20.0
        part = {"travelled_mm": slide.travelled_mm[inside], "speed_mm_s": slide.speed_mm_s[inside]}
        if inside.any():
            short.append(replace(slide, volts=np.full((int(inside.sum()), 2), 0.05), **part))
    found, _ = calibrate(short, truth.scaled(0.0), False, CalibrationConfig())
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(-15.0, 16.0, 5.0), np.arange(-15.0, 16.0, 5.0)))
    assert found.response(x, y, 0.3) == pytest.approx(0.05, rel=0.05)
    half = truth.chamber_mm[0] / 2 + RIM_MM
    along = np.arange(-half, half, 1.0)
    rim = np.full(len(along), half + 0.5)
    for x, y in ((rim, along), (-rim, along), (along, rim), (along, -rim)):
        assert np.abs(found.response(x, y, 0.3)).max() < 0.15 * 0.05


@pytest.fixture(scope="module")
def deepened():
    """Slides at three depths over a map whose change with depth is 1.5 times the design's and 0.1 of itself."""
    design = bump_map()
    slope = 1.5 * design.depth_slope * np.array([1.0, 0.5]) + 0.1 * design.coefficients[0]
    truth = replace(design, depth_slope=slope)
    design = replace(design, depth_slope=design.depth_slope * np.array([1.0, 0.5]))
    rng = np.random.default_rng(2)
    depths = rng.choice([0.3, 0.5, 0.9], len(LINES), p=[0.2, 0.6, 0.2])
    gains = 1 + 0.02 * rng.standard_normal(len(LINES))
    slides = slides_of(truth, LINES, np.full(len(LINES), 3.0), gains / gains.mean(), 1.4e-3, depths_mm=depths)
    return design, truth, slides


def test_slides_of_several_depths_tell_how_the_response_changes_with_depth(deepened):
    design, truth, slides = deepened
    blank = replace(design, coefficients=0 * design.coefficients)
    found, _ = calibrate(slides, blank, False, CalibrationConfig())
    size = np.abs(truth.depth_slope).max()
    assert np.abs(design.depth_slope - truth.depth_slope).max() > 0.4 * size
    assert np.abs(found.depth_slope - truth.depth_slope).max() < 0.12 * size
    assert error_of(found, truth) < 1.5e-3
    assert found.depth_sd_mm == pytest.approx(0.4)  # from 0.5 to 0.9


def test_slides_of_one_depth_leave_the_change_with_depth_as_it_is(deepened):
    design, _, slides = deepened
    blank = replace(design, coefficients=0 * design.coefficients)
    found, _ = calibrate([s for s in slides if s.depth_mm == 0.5], blank, False, CalibrationConfig())
    assert np.array_equal(found.depth_slope, design.depth_slope)
    assert found.depth_sd_mm == 0.0


def test_the_rim_stays_where_it_is_however_far_the_response_reaches():
    """The skin is clamped at the chamber's edge: nothing answers beyond it, also where the design is widened."""
    atlas, sensor = read_atlas(), read_sensor(DEFAULT_SENSOR)
    wide, _ = prior_map(atlas, sensor, [], 0.5, SensorSpread(width=(0.2, 0.05)))
    plain, _ = prior_map(atlas, sensor, [], 0.5, SensorSpread(width=(0.0, 0.05)))
    along = np.arange(-20.0, 21.0, 1.0)
    for depth in (0.5, 1.0):
        inside, beyond = (wide.at(depth).response(np.full(41, x), along, 0.0) for x in (15.0, 26.5))
        assert np.abs(beyond).max() < 0.02 * np.abs(inside).max()
        narrower = np.abs(plain.at(depth).response(np.full(41, 18.0), along, 0.0)).max()
        assert np.abs(wide.at(depth).response(np.full(41, 18.0), along, 0.0)).max() > 1.1 * narrower


def test_slides_count_by_their_weight():
    """Two sets of slides over maps of which one answers by a fifth more: the map is near that of the heavier set."""
    truth = bump_map()
    blank = truth.scaled(0.0)
    ones = np.ones(len(LINES))
    sets = [slides_of(m, LINES, 3.0 * ones, ones, 1.4e-3) for m in (truth, truth.scaled(1.2))]
    size = []
    for weights in ((1.0, 0.01), (0.01, 1.0)):
        slides = [replace(s, weight=w) for each, w in zip(sets, weights, strict=True) for s in each]
        # Gains that are known: else each slide has its own.
        found, _ = calibrate(slides, blank, False, CalibrationConfig(gain_sd=1e-4, iterations=1))
        size.append(
            (found.coefficients[0] * truth.coefficients[0]).sum() / (truth.coefficients[0] ** 2).sum()
        )
    assert size == pytest.approx([1.0, 1.2], abs=0.02)


@pytest.mark.parametrize("drift_v_s", [0.0, 4e-5])
def test_errors_of_the_zero_and_its_drift_are_parted_by_how_long_slides_last(drift_v_s: float) -> None:
    """Slides of 3 to 150 s whose zeros are off by 0.6 mV and go on straight."""
    random, zero_v = np.random.default_rng(3), 6e-4
    lasts_s = np.exp(random.uniform(np.log(3.0), np.log(150.0), 400))
    drifts = lasts_s / 2 * drift_v_s * random.standard_normal((2, 400))
    found_v, found_v_s = zero_errors((zero_v * random.standard_normal((2, 400)) + drifts).T, lasts_s)
    assert found_v == pytest.approx([zero_v] * 2, rel=0.15)
    assert found_v_s == pytest.approx([drift_v_s] * 2, rel=0.15, abs=5e-6)
