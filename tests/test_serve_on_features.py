"""A model on features answers by itself; what the tracker does not follow along that line is not valid."""

from dataclasses import replace

import numpy as np
import pytest
from bump_slides import bump_folder, bump_sensor, lines, slide_volts
from streams import pushed

from softslide.features.card import read_card, write_card
from softslide.features.estimate import Estimate
from softslide.features.stream.tracker import SlideState
from softslide.models.classical.gaussian_process import GpConfig
from softslide.models.export.bundle import write_bundle
from softslide.models.registry import fit_model, model_named
from softslide.pipeline.synthesis.no_contact import SIGNALS, untouched
from softslide.serve.localizer import Localizer

SENSOR = bump_sensor(boards=1)
STATIC_V = np.array([1.65, 1.65, 2.45])


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    root = tmp_path_factory.mktemp("on-features")
    calibrated = lines((0.0, 90.0, 180.0, 270.0), np.arange(-9.0, 10.0, 3.0), (4.0, 8.0))
    folder = bump_folder(root / "lab", SENSOR, {"calibration": calibrated})
    fitted = fit_model(model_named("gp"), folder, GpConfig(search_rows=60))
    write_bundle(fitted, SENSOR, fitted.windows, {}, root / "bundle")
    return root / "bundle"


def answer(localizer: Localizer, volts: np.ndarray) -> Estimate:
    """Of a slide that is over."""
    localizer.reset()
    localizer.feed(volts)
    return localizer.read()


def share_of_tilts_and_steps(localizer: Localizer) -> float:
    """Of the moments that something seems to slide while nothing touches, those that are valid."""
    valid = []
    for kind in ("tilt", "step"):
        for seed in range(2):
            random = np.random.default_rng(seed)
            volts = untouched(SENSOR, STATIC_V, SIGNALS[kind], 8.0, random)
            found = pushed(localizer, volts)
            valid += [each.valid for each in found if each.state is not SlideState.REST]
    return float(np.mean(valid))


def test_a_slide_is_valid_and_the_model_s_own_answer(bundle, tmp_path):
    alone = tmp_path / "alone"
    alone.mkdir()
    (alone / "model.onnx").write_bytes((bundle / "model.onnx").read_bytes())
    write_card(replace(read_card(bundle / "model.json"), contact=None), alone / "model.json")
    allowed, free = Localizer.load(bundle), Localizer.load(alone)
    for seed, (direction, offset, speed) in enumerate(lines((0.0, 180.0), (-4.0, 5.0), (6.0,))):
        volts = slide_volts(SENSOR, direction, offset, speed, 100 + seed)
        found, of_free = answer(allowed, volts), answer(free, volts)
        assert found.valid
        assert found.state is SlideState.ENDED
        assert (found.direction_deg, found.offset_mm) == (of_free.direction_deg, of_free.offset_mm)
    assert share_of_tilts_and_steps(allowed) < 0.1
    assert share_of_tilts_and_steps(free) > 0.5
