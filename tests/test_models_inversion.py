"""The reference estimator and the bound that it is held against."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from bump_map import bump_map
from dome_map import dome_map

from softslide.models.cnn.cramer_rao import cramer_rao
from softslide.models.cnn.inversion import Inversion
from softslide.models.cnn.training_windows import SynthesisConfig, WindowSource
from softslide.models.held_out import signed_errors
from softslide.models.response_map.map import ResponseMap
from softslide.pipeline.recordings.windows import LabelledWindows

BLOCK_S = 0.02
WHOLE = SynthesisConfig(
    speed_mm_s=(1.0, 8.0), complete=1.0, paused=0.0, midway=0.0, depth_mm=0.0, channel_gain=0.0
)


def drawn(response: ResponseMap, count: int, **changes) -> LabelledWindows:
    """Whole slides over a formula's map, with its noise."""
    source = WindowSource(response, BLOCK_S, replace(WHOLE, **changes))
    return source.draw(count, torch.Generator().manual_seed(2)).labelled()


@pytest.mark.parametrize(
    ("response", "count", "speed_mm_s"), [(bump_map(), 60, (1.0, 8.0)), (dome_map(), 16, (10.0, 11.0))]
)
def test_the_inversion_comes_near_the_bound_from_no_start_at_all(response, count, speed_mm_s):
    windows = drawn(response, count, speed_mm_s=speed_mm_s)
    windows = windows[np.abs(windows.offset_mm) < 12]
    inversion = Inversion(response, BLOCK_S)
    rows = inversion.predict(windows.volts, windows.elapsed_s)
    errors = np.stack([*signed_errors(rows, inversion.outputs, windows).values()], axis=1)
    least = cramer_rao(response, BLOCK_S, windows)
    assert least.shape == errors.shape
    # Rms over slides, each in its own bound: one for an estimator as good as can be.
    ratio = np.sqrt(np.median((errors / least) ** 2, axis=0)) / 0.6745
    assert (ratio > 0.5).all()
    assert (ratio < 2.0).all()


def test_the_bound_follows_the_noise_and_no_label_of_the_place():
    windows = drawn(bump_map(), 40)
    quiet, loud = (
        bump_map(
            noise_v=np.full(2, noise),
            zero_v=np.full(2, 1e-7),
            drift_v_s=np.full(2, 1e-9),
            floor_v=1e-7,
            level_v=1e-7,
            gain_sd=1e-4,
        )
        for noise in (0.05, 0.1)
    )
    least = cramer_rao(quiet, BLOCK_S, windows)
    assert (least > 0).all()
    # Twice the noise is twice the bound, but where the priors on depth and gain already hold the offset.
    ratio = cramer_rao(loud, BLOCK_S, windows) / least
    assert np.median(ratio, axis=0) == pytest.approx([2.0, 2.0, 2.0], rel=0.05)
    # A slide that is over stands still while its label moves on.
    late = replace(windows, along_mm=windows.along_mm + 4.0)
    usual = cramer_rao(bump_map(), BLOCK_S, windows)
    near = np.abs(windows.offset_mm) < 10
    assert cramer_rao(bump_map(), BLOCK_S, late)[near] == pytest.approx(usual[near], rel=0.05)
