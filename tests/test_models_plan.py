"""Planned slides: the errors that a map's own errors cause, and the slides that lessen them."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import least_squares

import softslide
from softslide.experiments.acquisition.plan import COLUMNS, DIRECTIONS_DEG
from softslide.experiments.acquisition.record import read_plan
from softslide.experiments.acquisition.slides_to_test import draw_tests
from softslide.experiments.evaluation.bounds import read_bounds
from softslide.features.errors import InputError
from softslide.models.design.line_information import GAIN_SD, LINE_SPEED_MM_S, Line, places
from softslide.models.design.plan import (
    Unknowns,
    _line_error,
    _line_errors,
    _observation,
    _posterior,
    _variances,
    plan_slides,
)
from softslide.models.response_map.from_atlas import SensorSpread
from softslide.models.response_map.slide_fit import CalibrationConfig
from softslide.pipeline.atlas.atlas import Atlas, read_atlas
from softslide.pipeline.recordings.folder import SAMPLE, read_folder
from softslide.pipeline.recordings.learned import learned_lines

CONFIG, SPREAD = CalibrationConfig(), SensorSpread()
FOLDER = read_folder(SAMPLE)
SENSOR, CANDIDATES = FOLDER.sensor, FOLDER.select("calibration").manifest


@pytest.fixture(scope="module")
def atlas() -> Atlas:
    return read_atlas()


@pytest.fixture(scope="module")
def unknowns(atlas: Atlas) -> Unknowns:
    return Unknowns(atlas, SENSOR, 0.5, CONFIG, SPREAD)


@pytest.mark.parametrize(("direction", "offset"), [(0.3, 4.0), (2.0, -9.0), (4.4, 12.0)])
def test_a_wrong_map_misleads_least_squares_as_predicted(
    unknowns: Unknowns, direction: float, offset: float
) -> None:
    """The prediction is linear; a small error of the map must mislead a fit by just so much."""
    along = np.arange(-20.0, 20.0, 2.0)
    wrong = 0.02 * np.random.default_rng(1).normal(size=unknowns.size)
    reference_mm = unknowns.response.reference_mm
    x, y = places(reference_mm, direction, offset, along)
    rows, *_ = unknowns.rows(x, y, direction, LINE_SPEED_MM_S)
    response = unknowns.response
    change = rows.times(wrong[:, None]).reshape(response.channels, -1).T
    truth = response.response(x, y, direction) + change
    noise_v = float(np.median(response.noise_v)) * np.sqrt(2 * 0.01 + 0.5)

    def residuals(p: np.ndarray) -> np.ndarray:
        way = along[-1] + p[3] - (along[-1] - along) * np.exp(p[1])
        x, y = places(reference_mm, direction + p[0], offset + p[2], way)
        volts = np.exp(p[4]) * response.response(x, y, direction + p[0]) + p[5:]
        return np.concatenate(
            [((truth - volts) / noise_v).ravel(), [p[4] / GAIN_SD], p[5:] / response.zero_v]
        )

    found = least_squares(residuals, np.zeros(5 + response.channels), x_scale="jac").x[:3]
    predicted = _line_error(unknowns, Line(direction, offset, along)) @ wrong
    assert np.abs(predicted).max() > 1e-4
    assert found == pytest.approx(predicted, rel=0.1, abs=0.1 * np.abs(predicted).max())


def test_a_channel_depends_on_the_parameters_and_on_its_own_modes(unknowns: Unknowns) -> None:
    rows, volts, _ = unknowns.rows(np.array([1.0, 2.0]), np.array([3.0, 3.0]), 0.3, 2.0)
    whole = rows.times(np.eye(unknowns.size))
    assert whole.shape == (volts.size, unknowns.size)
    first, second = whole.reshape(volts.shape[1], len(volts), -1)[:, 0]
    parameters = rows.by_parameter.shape[2]
    modes = (unknowns.size - parameters) // volts.shape[1]
    assert not first[parameters + modes :].any()
    assert not second[parameters : parameters + modes].any()
    assert (first[parameters : parameters + modes] == second[parameters + modes :]).all()
    matrix = np.random.default_rng(2).normal(size=(unknowns.size, 3))
    assert rows.times(matrix) == pytest.approx(whole @ matrix)


def test_every_slide_lessens_every_error(unknowns: Unknowns) -> None:
    errors = _line_errors(unknowns, SENSOR, np.random.default_rng(0))
    observations = [_observation(unknowns, row, CONFIG) for _, row in CANDIDATES.iloc[:6].iterrows()]
    variances = [_variances(errors, _posterior(unknowns.size, observations, range(n))) for n in range(7)]
    for before, after in pairwise(variances):
        assert (after <= before * (1 + 1e-9)).all()
        assert after.sum() < before.sum()


def test_the_same_slide_again_says_less_than_another_line(unknowns: Unknowns) -> None:
    errors = _line_errors(unknowns, SENSOR, np.random.default_rng(0))
    here, there = (CANDIDATES[CANDIDATES["offset_mm"].abs() == k].iloc[0] for k in (0.0, 10.0))
    observations = [_observation(unknowns, row, CONFIG) for row in (here, here, there)]
    twice, both = (_variances(errors, _posterior(unknowns.size, observations, k)) for k in ((0, 1), (0, 2)))
    assert (both.mean(axis=1) < twice.mean(axis=1)).all()


@pytest.mark.long
def test_a_plan_is_better_than_any_random_choice(atlas: Atlas, unknowns: Unknowns) -> None:
    plan = plan_slides(CANDIDATES, 6, SENSOR, atlas, 0.5, CONFIG, SPREAD)
    assert len(set(plan.chosen)) == 6
    errors = _line_errors(unknowns, SENSOR, np.random.default_rng(7))
    observations = [_observation(unknowns, row, CONFIG) for _, row in CANDIDATES.iterrows()]

    def product(chosen: list[int]) -> float:
        return float(
            np.prod(_variances(errors, _posterior(unknowns.size, observations, chosen)).mean(axis=1))
        )

    random = np.random.default_rng(3)
    drawn = [list(random.choice(len(CANDIDATES), 6, replace=False)) for _ in range(20)]
    # Lines that it was not chosen for.
    assert product(plan.chosen) < min(product(chosen) for chosen in drawn)
    assert (plan.deviations < plan.before).all()


def test_the_command_writes_what_record_reads(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    out, picture = tmp_path / "plan.csv", tmp_path / "plan.svg"
    given = ["plan", "--sensor", str(SAMPLE / "sensor.toml"), "--out", str(out), "--slides", "3"]
    given += ["--tests", "2"]
    status = softslide.main(
        [*given, "--picture", str(picture), "--directions", "0", "90", "180", "270", "--speeds", "8", "2"]
    )
    assert status == 0
    assert "mm expected from the map" in capsys.readouterr().out
    plan = read_plan(out, SENSOR)
    assert list(plan.index) == ["p01", "t01", "p02", "t02", "p03"]
    # Speeds in turn: where all slides have one, the skin's lag is not known.
    assert list(plan.loc[plan["split"] == "calibration", "speed_mm_s"]) == [2.0, 8.0, 2.0]
    assert picture.read_text().lstrip().startswith("<?xml")
    x_ref, y_ref = SENSOR.reference_mm
    for row in plan.itertuples():
        angle = np.deg2rad(row.direction_deg)
        offset = -np.sin(angle) * (row.start_x_mm - x_ref) + np.cos(angle) * (row.start_y_mm - y_ref)
        assert offset == pytest.approx(row.offset_mm, abs=2e-3)


def test_slides_to_test_with_are_of_every_bound_along_other_lines() -> None:
    tests = draw_tests(12, CANDIDATES.reset_index()[list(COLUMNS)], SENSOR, DIRECTIONS_DEG, (1.0, 4.0), 0.4)
    for bound in read_bounds():
        assert any(
            (area := bound.area_mm(row.direction_deg)) is not None
            and area[0] <= abs(row.offset_mm) <= area[1]
            and bound.speed_mm_s[0] <= row.speed_mm_s <= bound.speed_mm_s[1]
            for row in tests.itertuples()
        ), bound.name
    both = pd.concat([CANDIDATES, tests.set_index("recording")])
    assert not learned_lines(both)[tests["recording"]].any()
    assert tests["speed_mm_s"].between(1.0, 4.0).all()
    assert set(tests["direction_deg"]) <= set(DIRECTIONS_DEG)
    assert set(tests["depth_mm"]) == {0.4}


def test_a_stage_that_moves_along_one_axis_has_tests_along_it() -> None:
    learned = CANDIDATES.reset_index()[list(COLUMNS)]
    tests = draw_tests(6, learned, SENSOR, (0.0, 180.0), (1.0, 4.0), 0.5)
    assert set(tests["direction_deg"]) <= {0.0, 180.0}
    with pytest.raises(InputError, match="crosses the chamber"):
        draw_tests(1, learned, replace(SENSOR, chamber_mm=(10.0, 10.0)), (0.0,), (1.0,), 0.5)


def test_candidates_are_a_manifests_calibration_slides(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    out = tmp_path / "plan.csv"
    given = ["plan", "--sensor", str(SAMPLE / "sensor.toml"), "--candidates", str(SAMPLE / "manifest.csv")]
    assert softslide.main([*given, "--out", str(out), "--slides", "2"]) == 0
    manifest = read_folder(SAMPLE).manifest
    chosen = manifest.loc[pd.read_csv(out)["recording"]]
    assert len(chosen) == 2
    assert chosen["split"].str.startswith("calibration").all()
    capsys.readouterr()
    assert softslide.main([*given, "--out", str(out), "--slides", "100"]) == 2
    assert "100: there are" in capsys.readouterr().err
