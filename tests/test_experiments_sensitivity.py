"""The study of the skin: what its figures are, and that friction alone separates forth from back."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from experiments.studies.skin_sensitivity import (
    DEPTH_MM,
    HEIGHT_MM,
    SHOWN,
    STEP_MM,
    draw,
    extreme,
    figures,
    variants,
    width,
)
from pipeline.atlas.atlas import DEFAULT_SENSOR
from pipeline.sensor import check_design, read_sensor

ALONG = np.arange(-25.0, 25.0 + STEP_MM / 2, STEP_MM)


def test_an_extreme_is_found_between_the_samples() -> None:
    assert extreme(ALONG, -((ALONG - 7.3) ** 2)) == pytest.approx(7.3)


def test_the_width_of_a_bell_is_its_deviation_over_root_two() -> None:
    """The square of exp(-x^2 / (2 s^2)) has the variance s^2 / 2."""
    assert width(ALONG, np.exp(-((ALONG - 1.0) ** 2) / (2 * 5.0**2))) == pytest.approx(
        5.0 / np.sqrt(2), rel=1e-3
    )


def test_every_variant_is_a_design_and_changes_something() -> None:
    seen = list(variants(read_sensor(DEFAULT_SENSOR)))
    for changed, _, sensor, _, _ in seen:
        check_design(sensor, changed)
    assert len({(sensor, height, depth) for _, _, sensor, height, depth in seen}) == len(seen)


@pytest.mark.long
def test_friction_separates_forth_from_back(tmp_path: Path) -> None:
    """On a coarse mesh."""
    sensor = read_sensor(DEFAULT_SENSOR)
    coarse = replace(sensor, mesh=replace(sensor.mesh, size_mm=5.0))
    rows = [
        figures(replace(coarse, skin=replace(sensor.skin, friction=friction)), HEIGHT_MM, DEPTH_MM)
        for friction in (0.0, 0.4)
    ]
    assert set(rows[0]) == set(SHOWN)
    assert abs(rows[0]["hysteresis_mm"]) < 0.1
    assert rows[1]["hysteresis_mm"] > 0.5
    assert rows[0]["static_deg"] == rows[1]["static_deg"] > 5.0
    for row in rows:
        assert 10.0 < row["extremes_mm"] < 22.0
    picture = tmp_path / "study.svg"
    draw(
        pd.DataFrame([{"changed": "design", "to": "", **rows[0]}, {"changed": "f", "to": "0.4", **rows[1]}]),
        picture,
    )
    assert picture.read_text().startswith("<?xml")
