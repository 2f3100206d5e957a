"""The skin's height from static tilts, with the factor that one reading of a laser gives."""

import json

import numpy as np
import pandas as pd
import pytest
from article_skin import ATLAS, SENSOR

import softslide
from softslide.pipeline.atlas.skin_height import height_lines, heights_to_report, skin_heights
from softslide.pipeline.recordings.folder import SAMPLE, Folder, Recording, read_folder, write_folder

HEIGHTS_MM, PRESSURES_MPA, FACTOR = (5.5, 7.0, 8.5), (0.03, 0.035, 0.04), 0.8


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    """A skin whose board tilts by 0.8 of what is solved, at rest at three pressures; a laser at the middle one."""
    recordings, rows = [], []
    for n, (height, pressure) in enumerate(zip(HEIGHTS_MM, PRESSURES_MPA, strict=True)):
        static = ATLAS.static(ATLAS.pressure_at(height))[0] * [FACTOR, FACTOR, 1.0]
        noise = np.random.default_rng(n).normal(0.0, 0.005, (1000, 3))
        recordings.append(Recording(f"r{n}", np.arange(1000) / 1000.0, 1.65 + 0.8 * static + noise))
        laser = height if pressure == SENSOR.pressure_mpa else np.nan
        rows.append((f"r{n}", "calibration", pressure, laser))
    manifest = pd.DataFrame(rows, columns=["recording", "split", "pressure_mpa", "skin_height_mm"])
    return write_folder(tmp_path_factory.mktemp("heights") / "skin", SENSOR, manifest, recordings)


def rows_of(folder: Folder) -> list[dict]:
    rest_v = {str(name): folder.load(str(name)).volts.mean(axis=0) for name in folder.manifest.index}
    return skin_heights(folder, rest_v, ATLAS)


def test_one_reading_of_a_laser_makes_the_solved_design_right_at_other_pressures(folder: Folder) -> None:
    rows = rows_of(folder)
    assert [row["used"] for row in rows] == [False, True, False]
    for row, height in zip(rows, HEIGHTS_MM, strict=True):
        assert row["fitted_mm"] == pytest.approx(height, rel=0.02)
        # Without it the solved tilts give another height, or none that was solved.
        assert not abs(row["atlas_mm"] / height - 1) < 0.1


@pytest.mark.parametrize("change", [{"skin_height_mm": np.nan}, {"split": "test"}])
def test_without_a_laser_or_in_a_test_nothing_is_fitted(folder: Folder, change: dict) -> None:
    other = Folder(folder.root, folder.sensor, folder.manifest.assign(**change))
    assert all(np.isnan(row["fitted_mm"]) for row in rows_of(other))
    assert not any(row["used"] for row in rows_of(other))


def test_check_says_a_line_for_each_pressure(folder: Folder, capsys: pytest.CaptureFixture[str]) -> None:
    softslide.main(["check", str(folder.root)])
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("skin height: ")]
    assert [line.split()[2] for line in lines] == ["0.03", "0.035", "0.04"]
    assert "fits the factor" in lines[1]
    softslide.main(["check", str(folder.root), "--json"])
    rows = json.loads(capsys.readouterr().out)["skin_heights"]
    assert rows[1]["laser_mm"] == HEIGHTS_MM[1]
    assert rows[0]["laser_mm"] is None


def test_check_says_how_little_the_formula_is_worth(folder: Folder) -> None:
    rows = rows_of(folder)
    bare = [
        row | {"laser_mm": np.nan, "atlas_mm": np.nan, "fitted_mm": np.nan, "used": False} for row in rows
    ]
    assert "far off" in list(height_lines(bare))[-1]
    assert not any("far off" in line for line in height_lines(rows))


def test_check_says_nothing_of_heights_where_there_is_one_pressure() -> None:
    assert not heights_to_report(read_folder(SAMPLE))
