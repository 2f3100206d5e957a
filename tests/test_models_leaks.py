"""What a recording's frame gives away (length, rests, travel, the side of its lines) reaches no estimate."""

from pathlib import Path

import numpy as np
import pytest
import torch
from bump_map import bump_map

from softslide.models.cnn.training_windows import SynthesisConfig, WindowSource
from softslide.pipeline.recordings.folder import SAMPLE, read_folder
from softslide.serve.localizer import Localizer

NUMBERS = ("direction_deg", "speed_mm_s", "offset_mm", "x_mm", "y_mm")


@pytest.fixture(scope="module")
def folder():
    return read_folder(SAMPLE).select("calibration").labelled()


@pytest.fixture(scope="module")
def localizer():
    """Of another sensor: what it must not depend on does not need it to be right."""
    return Localizer.load(Path(__file__).parents[1] / "docs" / "examples" / "bundle")


def estimate_at(localizer, volts, count):
    """The estimate once `count` samples were seen, whatever may come later."""
    localizer.reset()
    localizer.feed(volts[:count])
    return np.array([getattr(localizer.read(), name) for name in NUMBERS])


@pytest.fixture(scope="module")
def slide(folder):
    name = folder.manifest.index[20]
    row = folder.manifest.loc[name]
    rate = folder.sensor.sample_rate_hz
    return folder.load(name).volts, round(row.motion_start_s * rate), round(row.motion_end_s * rate)


def test_the_rest_before_does_not_matter(localizer, slide):
    volts, start, end = slide
    plain = estimate_at(localizer, volts, end)
    assert np.isfinite(plain).all()
    rest = volts[: start // 20 * 20]
    longer = np.concatenate([rest, rest, rest, volts])
    # The static output is averaged over other samples: the difference is its noise, not the rest's length.
    found = estimate_at(localizer, longer, end + 3 * len(rest))
    np.testing.assert_allclose(found, plain, rtol=0.02, atol=0.3)


def test_what_comes_after_does_not_matter(localizer, slide):
    volts, _, end = slide
    plain = estimate_at(localizer, volts, end)
    turned_back = np.concatenate([volts[:end], volts[end // 2 : end][::-1]])
    np.testing.assert_array_equal(estimate_at(localizer, turned_back, end), plain)


def test_training_slides_tie_no_side_and_no_travel_to_a_direction():
    # About the chamber's centre: from a point next to it, lines to one side are rarer by geometry alone.
    batch = WindowSource(bump_map(reference_mm=(0.0, 0.0)), 0.02, SynthesisConfig()).draw(
        6000, torch.Generator().manual_seed(2)
    )
    cos, sin, log_speed, offset, along, _ = batch.targets.numpy().T
    for heading in (cos, sin):
        assert abs(np.corrcoef(heading, np.sign(offset))[0, 1]) < 0.06
        assert abs(np.corrcoef(heading, along)[0, 1]) < 0.06
    assert abs(np.corrcoef(log_speed, along)[0, 1]) < 0.06
