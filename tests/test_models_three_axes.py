"""Sensing elements whose three axes answer to a touch: their map, its inversion, and slides that begin with a touch."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from calibration_slides import slides_of
from dome_map import CHAMBER_MM, dome_map
from touched_skin import SENSOR

from softslide.features.card import Validity
from softslide.features.stream.conditioning import Conditioning
from softslide.features.stream.tracker import SlideState, SlideTracker
from softslide.models.cnn.forward_model import BINS
from softslide.models.cnn.gauss_newton import BIN_GAIN, PLACE_MM, Refinement, RefinementConfig
from softslide.models.cnn.inversion import Inversion
from softslide.models.cnn.training_windows import SynthesisConfig, WindowSource
from softslide.models.held_out import signed_errors
from softslide.models.response_map.calibrate import blank_map, calibrate
from softslide.models.response_map.select import _by_cell
from softslide.models.response_map.slide_fit import CalibrationConfig
from softslide.models.response_map.slides import CalibrationSlide

BLOCK_S = 0.02
TOUCH = Conditioning(touch_axes="xyz", onset="touch")


def slides_over(response, count: int, noise_v: float = 0.0, seed: int = 0) -> list[CalibrationSlide]:
    """Lines from edge to edge of the skin, with a mixture of noise that all three channels share."""
    draw = np.random.default_rng(seed)
    lines = list(zip(draw.uniform(0, 360, count), draw.uniform(-10, 10, count), strict=True))
    slides = slides_of(response, lines, np.full(count, 10.0), np.ones(count), half_mm=14.0)
    for slide in slides:
        shared = draw.standard_normal((len(slide.volts), 1)) * np.array([1.0, -2.0, 0.5])
        slide.volts[:] += noise_v * (shared + 0.1 * draw.standard_normal(slide.volts.shape))
    return slides


def test_the_inversion_finds_slides_that_begin_on_the_skin() -> None:
    response = dome_map()
    config = SynthesisConfig(speed_mm_s=(5.0, 40.0), complete=1.0, paused=0.0, midway=0.0, channel_gain=0.0)
    windows = WindowSource(response, BLOCK_S, config).draw(24, torch.Generator().manual_seed(1)).labelled()
    # No slide begins or ends outside the skin, where this map knows nothing.
    first = windows.along_mm - windows.speed_mm_s * windows.elapsed_s
    angle = np.radians(windows.direction_deg)
    for along in (first, windows.along_mm):
        x = along * np.cos(angle) - windows.offset_mm * np.sin(angle)
        y = along * np.sin(angle) + windows.offset_mm * np.cos(angle)
        assert max(np.abs(x).max(), np.abs(y).max()) < CHAMBER_MM[0] / 2 + 0.5
    rows = Inversion(response, BLOCK_S).predict(windows.volts, windows.elapsed_s)
    errors = signed_errors(rows, Inversion(response, BLOCK_S).outputs, windows)
    assert np.median(np.abs(errors["direction_deg"])) < 1.0
    assert np.median(np.abs(errors["log_speed"])) < 0.02
    assert np.median(np.abs(errors["offset_mm"])) < 0.2


def test_mixed_channels_are_as_if_map_and_signal_were_mixed() -> None:
    """A linear law: whitening inside the refinement equals refining the whitened signal on the whitened map."""
    whitening = np.array([[1.0, 0.3, 0.0], [0.3, 1.2, -0.2], [0.0, -0.2, 0.9]])
    plain = dome_map(floor_v=5e-3, noise_v=np.full(3, 1e-9))
    mixed = replace(plain, coefficients=plain.coefficients @ whitening.T)
    config = SynthesisConfig(complete=1.0, midway=0.0, paused=0.0)
    batch = WindowSource(plain, BLOCK_S, config).draw(40, torch.Generator().manual_seed(4))
    start, log_sd = batch.targets[:, :5] + 0.05, torch.zeros(len(batch.volts), 4)

    def refined(response, volts, weight=1.0):
        refinement = Refinement(response, BLOCK_S, RefinementConfig(steps=6))
        with torch.no_grad():
            columns = refinement(
                volts[:, None].double(), batch.elapsed_s, torch.full((len(volts), 1), weight), start, log_sd
            )
        return columns[1].flatten(1)[:, :4].numpy()

    with torch.no_grad():
        volts = torch.einsum("dc,bct->bdt", torch.tensor(whitening), batch.volts.double())
    inside = refined(replace(plain, whitening=whitening), batch.volts)
    # The table is rounded to half precision, on which the two differ.
    outside = refined(mixed, volts)
    assert np.median(np.abs(inside - outside), axis=0).max() < 2e-3
    assert np.median(np.abs(refined(plain, batch.volts) - outside), axis=0).max() > 2e-3


def test_errors_of_each_bins_place_and_gain_are_part_of_its_covariance() -> None:
    """J' C^-1 J is what the whole covariance of a bin's channels gives, inverted as it stands."""
    response = dome_map(2)
    refinement = Refinement(response, BLOCK_S, RefinementConfig())
    draw = torch.Generator().manual_seed(3)
    rows = torch.randn(4, 2, 3, 7, BINS, generator=draw, dtype=torch.float64)
    inverse = torch.rand(4, 2, 3, 1, 1, generator=draw, dtype=torch.float64) + 0.5
    found = refinement._without_local_errors(rows, inverse)[:, 0, 0].numpy()
    each = rows.permute(0, 4, 1, 2, 3).reshape(4, BINS, 6, 7).numpy()
    local = each[..., 2:5] * np.array([PLACE_MM, PLACE_MM, BIN_GAIN])
    noise = np.eye(6) / inverse.reshape(4, 1, 1, 6).numpy()
    covariance = noise + local @ local.transpose(0, 1, 3, 2)
    np.testing.assert_allclose(
        found, (each.transpose(0, 1, 3, 2) @ np.linalg.inv(covariance) @ each).sum(1), rtol=1e-9, atol=1e-9
    )


def test_calibration_recovers_the_map_and_finds_how_its_residuals_hang_together() -> None:
    truth = dome_map()
    slides = slides_over(truth, 60, noise_v=2e-3)
    found, figures = calibrate(slides, blank_map(SENSOR, 0.5, 2.0), False, CalibrationConfig())
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(-9.0, 10.0), np.arange(-9.0, 10.0)))
    error = found.response(x, y, 0.3) - truth.response(x, y, 0.3)
    assert np.sqrt(np.mean(error**2)) < 2e-3
    assert found.whitening is not None
    # Noise that the channels share in a fixed proportion is pressed down to as much as the others.
    shared = np.array([1.0, -2.0, 0.5]) / np.sqrt(5.25)
    across = np.array([2.0, 1.0, 0.0]) / np.sqrt(5.0)
    assert shared @ found.whitening @ shared < 0.5 * (across @ found.whitening @ across)
    # Another day's gain is allowed for.
    assert figures["gain_sd"] > CalibrationConfig().day_gain_sd


def test_what_is_held_out_by_cells_is_not_fitted_to() -> None:
    slides = slides_over(dome_map(), 12)
    places = {
        held_out: {
            (round(x, 9), round(y, 9))
            for slide in _by_cell(slides, held_out)
            for x, y in zip(*slide.place(0.0, 0.0), strict=True)
        }
        for held_out in (False, True)
    }
    assert not places[False] & places[True]
    assert 0.2 < len(places[True]) / (len(places[True]) + len(places[False])) < 0.5
    cells = {h: {(np.floor(x / 1.5), np.floor(y / 1.5)) for x, y in p} for h, p in places.items()}
    assert not cells[False] & cells[True]


def touch_and_lift(part: float) -> np.ndarray:
    """Block means (m, 3): rest, a touch in mid-block of which a part shows, a motion of 60 blocks, a lift, rest."""
    time = np.arange(60)
    moving = 0.08 * np.stack([np.cos(time / 15), np.sin(time / 9), 1 + 0 * time], axis=1)
    quiet = 1e-4 * np.random.default_rng(0).standard_normal((180, 3))
    quiet[60:120] += moving
    quiet[59] += part * moving[0]
    quiet[120] += part * moving[-1]
    return quiet


@pytest.mark.parametrize("part", [0.0, 0.05, 0.4, 0.7])
def test_a_window_holds_the_motion_between_touch_and_lift_alone(part: float) -> None:
    tracker = SlideTracker(TOUCH, 3)
    blocks = touch_and_lift(part)
    for block in blocks[:110]:
        tracker.push(block)
    window = tracker.window()
    assert window is not None
    assert tracker.state is SlideState.SLIDE
    # Every bin shows the touch's third channel in full.
    np.testing.assert_allclose(window.volts[2], 0.08, atol=2e-3)
    assert 46 <= window.elapsed_s / BLOCK_S <= 50
    for block in blocks[110:]:
        tracker.push(block)
    final = tracker.final
    assert final is not None
    np.testing.assert_allclose(final.volts[2], 0.08, atol=2e-3)
    assert 54 <= final.elapsed_s / BLOCK_S <= 60


def test_an_estimate_is_believed_only_where_a_further_step_would_not_move_it() -> None:
    """From starts that are far off, some windows converge in so many steps and some do not."""
    response, limit = dome_map(), Validity(direction_sd_deg=6.0, log_speed_sd=0.1)
    config = SynthesisConfig(speed_mm_s=(5.0, 40.0), paused=0.0)
    batch = WindowSource(response, BLOCK_S, config).draw(300, torch.Generator().manual_seed(7))
    start = batch.targets[:, :5] + torch.tensor([0.6, 0.6, 0.3, 3.0, 3.0])

    def refined(steps: int, settled: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """Direction (rad, from the start), log speed, offset; and their standard deviations."""
        refinement = Refinement(response, BLOCK_S, RefinementConfig(steps=steps), settled)
        with torch.no_grad():
            _, state, variance, *_ = refinement(
                batch.volts[:, None], batch.elapsed_s, batch.weight, start, torch.zeros(len(start), 4)
            )
        return state.flatten(1)[:, :3].numpy(), variance.flatten(1)[:, :3].numpy() ** 0.5

    (state, sd), (further, _) = refined(6), refined(7)
    believed = (np.degrees(sd[:, 0]) < limit.direction_sd_deg) & (sd[:, 1] < limit.log_speed_sd)
    assert believed.sum() > 50
    moved = np.abs(further - state)
    assert (moved[believed] / sd[believed]).max() < 0.1
    # Without the limit estimates would be believed that are still on their way.
    _, own_sd = refined(6, settled=False)
    np.testing.assert_allclose(own_sd[believed], sd[believed], rtol=1e-6)
    wrong = (np.degrees(own_sd[:, 0]) < limit.direction_sd_deg) & (moved / own_sd > 1.0).any(axis=1)
    assert wrong.sum() > 5
    assert not (wrong & believed).any()
