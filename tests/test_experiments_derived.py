"""Labels that a lab left out: every command derives them as `train` does, and says so."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from front_door import call
from small_bundle import write_small_bundle

import softslide
from softslide.experiments.derived_labels import derived
from softslide.features.stream.conditioning import Conditioning
from softslide.models.response_map.from_atlas import SensorSpread
from softslide.models.response_map.select import calibrated_map
from softslide.models.response_map.slide_fit import CalibrationConfig
from softslide.pipeline.atlas.library import atlas_at_hand
from softslide.pipeline.recordings.at_rest import conditioning_for
from softslide.pipeline.recordings.derived_labels import recordings_to_learn_from, with_derived_labels
from softslide.pipeline.recordings.folder import SAMPLE, Folder, read_folder, write_folder

MOMENTS = ["motion_start_s", "motion_end_s"]
SLIDES = 8  # of each kind of split, along both axes and forward and backward


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    """Slides of the sample along the axes, with all their labels."""
    sample = read_folder(SAMPLE)
    axis = sample.manifest[sample.manifest["direction_deg"] % 90 == 0]
    kind = axis["split"].str.partition("-")[0]
    table = axis.groupby([kind, "direction_deg"]).head(SLIDES // 4)
    recordings = (sample.load(str(name)) for name in table.index)
    return write_folder(tmp_path_factory.mktemp("derived") / "full", sample.sensor, table, recordings)


@pytest.fixture(scope="module")
def bare(full: Folder) -> Folder:
    """The same without offset and moments, and of the start the coordinate across the line alone."""
    table, along = full.manifest.copy(), full.manifest["direction_deg"] % 180 == 0
    table[["offset_mm", *MOMENTS]] = np.nan
    table.loc[along, "start_x_mm"] = np.nan
    table.loc[~along, "start_y_mm"] = np.nan
    recordings = (full.load(str(name)) for name in table.index)
    return write_folder(full.root.parent / "bare", full.sensor, table, recordings)


def test_one_coordinate_gives_the_offset_of_a_line_along_an_axis(full: Folder, bare: Folder) -> None:
    found = with_derived_labels(bare).manifest["offset_mm"]
    np.testing.assert_allclose(found, full.manifest["offset_mm"], atol=0.01)


def test_off_the_axes_one_coordinate_gives_no_offset(full: Folder) -> None:
    table = full.manifest.assign(direction_deg=30.0, offset_mm=np.nan, start_x_mm=np.nan)
    assert with_derived_labels(replace(full, manifest=table)).manifest["offset_mm"].isna().all()


def test_the_motion_is_the_one_that_train_finds(
    full: Folder, bare: Folder, capsys: pytest.CaptureFixture[str]
) -> None:
    found = derived(bare.select("calibration"))
    assert f"offset_mm of {SLIDES}" in capsys.readouterr().err
    learned, conditioning = recordings_to_learn_from(bare), Conditioning()
    conditioning, atlas = conditioning_for(learned, conditioning), atlas_at_hand(bare.sensor)
    fitted = calibrated_map(learned, atlas, conditioning, CalibrationConfig(), SensorSpread())
    columns = [*MOMENTS, "offset_mm", "travel_mm", "depth_mm"]
    pd.testing.assert_frame_equal(found.manifest[columns], fitted.folder.manifest[columns])


def test_evaluate_tests_the_same_bounds(full: Folder, bare: Folder, tmp_path: Path) -> None:
    bundle = write_small_bundle(tmp_path / "bundle", full.sensor)
    tested: dict[str, dict[str, int]] = {}
    for folder in (full, bare):
        out = tmp_path / folder.root.name
        words = ("evaluate", "--model", bundle, "--recordings", folder.root, "--out", out)
        call(*words, "--no-report", "--jobs", 1)
        bounds = json.loads((out / "metrics.json").read_text())["bounds"]
        tested[folder.root.name] = {
            bound["name"]: bound["recordings"] for bound in bounds if bound["pass"] is not None
        }
    assert tested["full"]
    assert tested["bare"] == tested["full"]


def test_check_finds_what_to_calibrate_from(bare: Folder, capsys: pytest.CaptureFixture[str]) -> None:
    softslide.main(["check", str(bare.root)])
    said = capsys.readouterr()
    assert "nothing to calibrate from" not in said.out
    assert "where on the skin the slides are is not said" not in said.out
    assert "motion_start_s of" in said.err
