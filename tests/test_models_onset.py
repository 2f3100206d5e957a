"""Slides whose labels do not tell when they were where: the others' arithmetic, the signal's onset, the map's shift."""

from dataclasses import replace

import numpy as np
import pytest
from bump_map import bump_map
from bump_slides import bump_folder, bump_sensor
from calibration_slides import slides_of

from softslide.features.stream.conditioning import Conditioning
from softslide.models.response_map.calibrate import calibrate
from softslide.models.response_map.from_atlas import SensorSpread
from softslide.models.response_map.onset import with_onsets
from softslide.models.response_map.slide_fit import CalibrationConfig, fit_slide
from softslide.pipeline.atlas.library import atlas_of
from softslide.pipeline.recordings.derived_labels import (
    UNTIMED,
    recordings_to_learn_from,
    with_derived_labels,
)
from softslide.pipeline.recordings.folder import SAMPLE, Folder, read_folder
from softslide.pipeline.recordings.manifest import LABELS

MOMENTS, START = ("motion_start_s", "motion_end_s"), ("start_x_mm", "start_y_mm")
SLIDES = 8  # of the sample, along both axes and forward and backward


def without(folder: Folder, *labels: str) -> Folder:
    table = folder.manifest.copy()
    table[list(labels)] = np.nan
    return replace(folder, manifest=table)


def gaps_mm(found: Folder, truth: Folder) -> np.ndarray:
    """Along each line, how far the place found at the middle of the labelled motion is off."""
    gaps = []
    for name, labels in truth.manifest.iterrows():
        row, a = found.manifest.loc[name], np.deg2rad(labels["direction_deg"])
        along = np.array([np.cos(a), np.sin(a)])
        start, true_start = (r[list(START)].to_numpy(float) for r in (row, labels))
        since = labels[list(MOMENTS)].mean() - row[list(MOMENTS)].mean()
        travelled = row["travel_mm"] / 2 + row["speed_mm_s"] * since
        gaps.append(along @ (start - true_start) + travelled - labels["travel_mm"] / 2)
    return np.array(gaps)


@pytest.fixture(scope="module")
def learnable() -> Folder:
    folder = recordings_to_learn_from(read_folder(SAMPLE))
    axis = folder.manifest[folder.manifest["direction_deg"] % 90 == 0]
    chosen = axis.groupby("direction_deg").head(SLIDES // 4)
    assert len(chosen) == SLIDES
    return replace(folder, manifest=chosen)


@pytest.mark.parametrize("label", [x for x in LABELS if x not in ("direction_deg", *START, "pressure_mpa")])
def test_a_label_that_follows_from_the_others_is_not_missed(learnable: Folder, label: str) -> None:
    found = with_derived_labels(without(learnable, label)).manifest[label]
    # A stage's ramps, 0.1 s at most, are no part of a speed or a moment that is derived.
    ramp = learnable.manifest["speed_mm_s"].max() * 0.1
    np.testing.assert_allclose(found, learnable.manifest[label], atol=ramp, rtol=0.01)


def test_a_path_with_its_truth_keeps_its_labels(learnable: Folder, tmp_path) -> None:
    bare = without(learnable, "speed_mm_s")
    files = []
    for name in bare.manifest.index:
        (tmp_path / f"{name}.truth.csv").touch()
        files.append(f"{name}.parquet")
    bare = replace(bare, root=tmp_path, manifest=bare.manifest.assign(file=files))
    assert with_derived_labels(bare).manifest["speed_mm_s"].isna().all()


@pytest.mark.parametrize("absent", [(*MOMENTS, *START, "travel_mm"), MOMENTS, START])
def test_the_signal_shows_the_onset_that_labels_lack(learnable: Folder, absent: tuple[str, ...]) -> None:
    bare = with_derived_labels(without(learnable, *absent))
    assert bare.manifest[list(absent)].isna().all(axis=None)
    atlas = atlas_of(learnable.sensor)
    found, left_out = with_onsets(bare, atlas, Conditioning(), SensorSpread(), CalibrationConfig())
    assert found.manifest[UNTIMED].all()
    assert not left_out
    # Eight slides of a design that is not quite this sensor's: 0.14 mm with 35 (experiments/LOG.md).
    gaps = gaps_mm(found, learnable)
    assert np.sqrt(np.mean(gaps**2)) < 0.5
    for label in set(MOMENTS) - set(absent):
        np.testing.assert_array_equal(found.manifest[label], learnable.manifest[label])


def test_a_slide_that_nothing_shows_is_left_out_with_its_reason(tmp_path) -> None:
    far, near = (0.0, 17.0, 4.0), (0.0, 3.0, 4.0)
    folder = bump_folder(tmp_path / "lab", bump_sensor(1), {"calibration": [far, near]})
    bare = without(folder, *MOMENTS, *START, "travel_mm")
    found, left_out = with_onsets(
        bare, None, Conditioning(trigger_v=0.01), SensorSpread(), CalibrationConfig()
    )
    assert list(left_out) == ["s000"]
    assert "onset" in left_out["s000"]
    # Without an atlas the energy's centre stands for the accelerometer's place, friction aside.
    assert abs(gaps_mm(found, folder)[1]) < 2.0


def test_the_place_of_an_untimed_slide_is_fitted_to_the_map() -> None:
    truth = replace(bump_map(), noise_v=np.full(2, 1.4e-3))
    (slide,) = slides_of(truth, [(0.0, 4.0)], [2.0], [1.0], 1.4e-3)
    away = replace(slide, timed=False, travelled_mm=slide.travelled_mm + 1.5)
    assert fit_slide(away, truth, CalibrationConfig()).shift_mm == pytest.approx(1.5, abs=0.05)


def test_untimed_slides_say_nothing_of_the_lag() -> None:
    """The same shifts that grow with the speed: a lag where the labels are believed, else places."""
    truth = bump_map()
    lines = [(d, o) for d in (0.0, 90.0, 180.0, 270.0) for o in (-8.0, 0.0, 8.0)]
    slides = slides_of(truth, lines, np.linspace(1.0, 12.0, len(lines)), np.ones(len(lines)), lag_s=0.02)
    untimed = [replace(slide, timed=False) for slide in slides]
    believed, taken = (calibrate(given, truth, True, CalibrationConfig())[0] for given in (slides, untimed))
    assert believed.lag_s > 0.005
    assert taken.lag_s == 0.0
