"""Intervals of a depth that the calibration has not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_bundle import OUTPUTS, write_small_bundle
from streams import a_sensor
from tracked_map import noisy_map

from softslide.features.card import read_card
from softslide.features.estimate import SPEED_PER_DEPTH, decode
from softslide.features.stream.tracker import SlideState
from softslide.features.window import WINDOW_BINS, Window
from softslide.models.response_map.card import contact_calibration


def test_speed_and_depth_are_less_sure_beyond_the_calibrations_depth(tmp_path: Path) -> None:
    contact = contact_calibration(noisy_map())
    bundle = write_small_bundle(tmp_path / "model", a_sensor(), contact=contact)
    card = replace(read_card(bundle / "model.json"), outputs=(*OUTPUTS, "depth_mm"))
    window = Window(np.full((3, WINDOW_BINS), 0.1), 5.0)
    half = []
    for off_mm in (0.0, 0.03, 0.54, -0.54):
        row = np.array([1.0, 0.0, 0.7, 5.0, 0.0, contact.depth_mm + off_mm])
        found = decode(row, card, window, SlideState.SLIDE, 1.0, np.nan)
        half.append(np.log(found.speed_hi_mm_s / found.speed_mm_s))
    assert half[1] == pytest.approx(half[0])
    for each in half[2:]:
        assert each - half[0] == pytest.approx(0.5 * SPEED_PER_DEPTH)
