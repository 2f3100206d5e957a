"""What a folder does not cover: each gap is named, and nothing where all is covered."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from sample_folder import sample_folder

import softslide
from softslide.pipeline.checks.coverage import headings, not_covered
from softslide.pipeline.recordings.folder import SAMPLE, read_folder
from softslide.pipeline.sensor import Sensor
from softslide.pipeline.synthesis.slide_plan import crossing


@pytest.fixture(scope="module")
def sensor() -> Sensor:
    return read_folder(SAMPLE).sensor


def slides(sensor: Sensor, directions, offsets, speeds, split: str = "calibration") -> pd.DataFrame:
    """A slide for each direction and offset that crosses the chamber, with the speed of its place in both lists."""
    rows = []
    for k, direction in enumerate(directions):
        for m, offset in enumerate(offsets):
            if line := crossing(float(direction), float(offset), sensor):
                (x, y), travel, _ = line
                rows.append((split, direction, speeds(k, m), offset, x, y, travel))
    columns = ["split", "direction_deg", "speed_mm_s", "offset_mm", "start_x_mm", "start_y_mm", "travel_mm"]
    return pd.DataFrame(rows, columns=columns)


AXES, OFFSETS = (0.0, 90.0, 180.0, 270.0), np.arange(-25.0, 25.1, 5.0)


def mixed(k: int, m: int) -> float:
    return (0.5, 1.0, 2.0, 4.0)[(k + m) % 4]


def test_a_whole_protocol_leaves_nothing_open(sensor: Sensor) -> None:
    assert not_covered(slides(sensor, AXES, OFFSETS, mixed), sensor) == []


@pytest.mark.parametrize(
    ("directions", "offsets", "speeds", "says"),
    [
        (AXES, OFFSETS, lambda k, m: (0.5, 1.0, 2.0, 4.0)[k], "speed and heading are confounded"),
        (AXES, OFFSETS, lambda k, m: 1.0 + 2.0 * (k == 1) * (m % 2), "along one heading alone (90 deg)"),
        (AXES, OFFSETS, lambda k, m: 1.0, "move at 1 to 1 mm/s"),
        ((0.0, 90.0), OFFSETS, mixed, "directions without a slide: 90 to 0 deg"),
        ((0.0, 180.0), (-5.0, 0.0, 5.0), mixed, "no slide passes y from 5.0 to 20.0 mm"),
    ],
)
def test_each_gap_is_named(sensor: Sensor, directions, offsets, speeds, says: str) -> None:
    assert says in " | ".join(not_covered(slides(sensor, directions, offsets, speeds), sensor))


def test_faster_test_slides_are_counted(sensor: Sensor) -> None:
    fast = slides(sensor, (0.0,), (0.0, 5.0), lambda k, m: 9.0, split="test-fast")
    both = pd.concat([slides(sensor, AXES, OFFSETS, mixed), fast], ignore_index=True)
    assert not_covered(both, sensor) == [
        "2 slides of test-fast are faster than any calibration slide (9 to 4 mm/s): their speed is extrapolated"
    ]


def test_a_heading_goes_round_the_circle() -> None:
    found = headings(pd.Series([359.0, 1.0, 90.0, 181.0, 179.0]))
    assert found[0] == found[1] != found[2]
    assert found[3] == found[4]
    assert found.nunique() == 3


def test_without_labels_there_is_nothing_to_calibrate_from(sensor: Sensor) -> None:
    bare = slides(sensor, AXES, OFFSETS, mixed).assign(direction_deg=np.nan)
    assert not_covered(bare, sensor) == [
        "no calibration slide says direction, speed and offset: there is nothing to calibrate from"
    ]


def test_check_says_and_draws_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sample_folder(tmp_path, "split == 'calibration' and direction_deg == 0 and speed_mm_s > 3")
    picture = tmp_path / "coverage.svg"
    assert softslide.main(["check", str(tmp_path), "--picture", str(picture)]) == 0
    said = capsys.readouterr().out
    assert "not covered: directions without a slide: 0 to 0 deg" in said
    assert "not covered: all calibration slides move at" in said
    drawn = picture.read_text()
    assert "direction and speed" in drawn
    softslide.check(tmp_path, picture=picture)
    assert picture.read_text() == drawn
    assert softslide.main(["check", str(tmp_path), "--picture", "coverage.doc"]) == 2
    assert "--picture" in capsys.readouterr().err
