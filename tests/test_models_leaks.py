"""What a recording's frame gives away (length, rests, travel, the side of its lines) reaches no estimate."""

from pathlib import Path

import numpy as np
import torch
from bump_map import bump_map

from softslide.models.cnn.training_windows import SynthesisConfig, WindowSource
from softslide.pipeline.recordings.folder import SAMPLE, read_folder
from softslide.serve.localizer import Localizer

BUNDLE = Path(__file__).parents[1] / "docs" / "examples" / "bundle"
NUMBERS = ("direction_deg", "speed_mm_s", "offset_mm", "x_mm", "y_mm")


def test_the_rest_before_does_not_matter():
    """Of a bundle of another sensor: what it must not depend on does not need it to be right."""
    folder = read_folder(SAMPLE).select("calibration").labelled()
    name = folder.manifest.index[20]
    volts = folder.load(name).volts
    start, end = (
        round(folder.manifest.at[name, f"motion_{at}_s"] * folder.sensor.sample_rate_hz)
        for at in ("start", "end")
    )
    rest = volts[: start // 20 * 20]
    localizer, found = Localizer.load(BUNDLE), []
    for before in ([], [rest, rest, rest]):
        localizer.reset()
        localizer.feed(np.concatenate([*before, volts[:end]]))
        found.append([getattr(localizer.read(), name) for name in NUMBERS])
    plain, longer = found
    assert np.isfinite(plain).all()
    # The static output is averaged over other samples: the difference is its noise, not the rest's length.
    np.testing.assert_allclose(longer, plain, rtol=0.02, atol=0.3)


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
