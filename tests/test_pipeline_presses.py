"""Presses: where and how hard, and how far that is from certain."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from article_skin import ATLAS, BOARD, FORCE, MIRRORED, SENSOR, of_design
from front_door import refused
from small_bundle import write_small_bundle

import softslide
from softslide.pipeline.atlas.atlas import Atlas, write_atlas
from softslide.pipeline.atlas.presses import MOST_MISFIT, press_in, settled_reading
from softslide.pipeline.recordings.folder import Folder, Recording, write_folder
from softslide.pipeline.sensor import Sensor

HEIGHT_MM = 7.1
RATE_HZ = 500.0
# x, y, depth in mm.
FOUR = [(5.0, 0.0), (-5.0, 0.0), (0.0, 5.0), (0.0, -5.0)]
PLACES = [(-12.0, 7.0, 0.5), (9.0, -11.0, 0.8), (2.0, 14.0, 0.4), (-5.0, -6.0, 0.6), (15.0, 4.0, 0.7)]


@pytest.fixture(scope="module")
def four_boards() -> Atlas:
    """The shipped atlas with its board at (5, 0) also at (-5, 0), (0, 5), (0, -5), by mirroring and turning the skin as
    if each were the only one: what the estimator sees of several boards, though no skin that was solved."""

    def turned(board: np.ndarray) -> np.ndarray:
        """By a quarter: (x, y) to (-y, x); along x becomes along y."""
        there = np.swapaxes(board, 1, 2)[:, ::-1].copy()
        vector = there.copy()
        for first in (0, 3):
            vector[..., first], vector[..., first + 1] = -there[..., first + 1], there[..., first]
        return vector[[0, 2, 1]] * np.array([1.0, -1.0, 1.0])[:, None, None, None, None, None]

    boards = [BOARD, MIRRORED, turned(BOARD), turned(MIRRORED)]
    parts = np.concatenate([*boards, FORCE], axis=-1)
    return of_design(sensor_with(FOUR), parts=parts, statics=np.concatenate([ATLAS.statics] * 4, axis=1))


def sensor_with(places: list[tuple[float, float]]) -> Sensor:
    part = SENSOR.accelerometers[0]
    parts = tuple(dataclasses.replace(part, name=f"a{n}", x_mm=x, y_mm=y) for n, (x, y) in enumerate(places))
    return dataclasses.replace(SENSOR, accelerometers=parts, sample_rate_hz=RATE_HZ)


def pressed(atlas: Atlas, sensor: Sensor, root: Path, gain: float = 1.02, count: int = len(PLACES)) -> Folder:
    """A recording of each of PLACES: rest, a touch that comes down in half a second, rest on the skin, lift; and one of
    nothing. The sensor answers 2 % more than solved, with noise."""
    rng, level = np.random.default_rng(4), atlas.pressure_at(HEIGHT_MM)
    shape = np.interp(np.arange(0.0, 6.0, 1 / RATE_HZ), [1.0, 1.5, 4.0, 4.5], [0.0, 1.0, 1.0, 0.0])
    recordings, rows = [], []
    for n, (x, y, depth) in enumerate([*PLACES[:count], (0.0, 0.0, 0.0)]):
        answer = np.zeros((atlas.boards, 3))
        if depth:
            answer = gain * atlas.response(np.array([x]), np.array([y]), None, depth, level)[0]
        tilt = atlas.static(level)[None] + shape[:, None, None] * answer
        noise = rng.normal(0, 0.004, (len(shape), 3 * atlas.boards))
        volts = 1.65 + 0.8 * tilt.reshape(len(shape), -1) + noise
        recordings.append(Recording(f"p{n}", np.arange(len(shape)) / RATE_HZ, volts))
        rows.append({"recording": f"p{n}", "split": "test"})
    return write_folder(root, sensor, pd.DataFrame(rows), recordings)


def found_in(folder: Folder, atlas: Atlas) -> list[dict]:
    names = folder.manifest.index
    return [press_in(folder.load(str(name)).volts, folder.sensor, atlas, HEIGHT_MM) for name in names]


def off_mm(rows: list[dict]) -> np.ndarray:
    pairs = zip(rows, PLACES, strict=False)
    return np.array([np.hypot(row["x_mm"] - x, row["y_mm"] - y) for row, (x, y, _) in pairs])


def test_four_accelerometers_are_sharp_and_one_is_not_and_says_so(four_boards: Atlas, tmp_path: Path) -> None:
    several, alone = four_boards, ATLAS
    many = found_in(pressed(several, sensor_with(FOUR), tmp_path / "four"), several)
    one = found_in(pressed(alone, sensor_with(FOUR[:1]), tmp_path / "one"), alone)
    assert off_mm(many).max() < 1.5
    level = several.pressure_at(HEIGHT_MM)
    for sharp, vague, (x, y, depth) in zip(many, one, PLACES, strict=False):
        assert sharp["radius_mm"] < 2.0
        force = 1e3 * several.force(np.array([x]), np.array([y]), None, depth, level)[0, 2]
        for row in (sharp, vague):
            assert row["force_lo_mn"] <= force <= row["force_hi_mn"]
            assert row["depth_lo_mm"] - 0.1 <= depth <= row["depth_hi_mm"] + 0.1
            assert row["misfit"] < MOST_MISFIT
    assert (off_mm(one) <= [row["radius_mm"] for row in one[: len(PLACES)]]).mean() >= 0.8
    mean_mm = [np.mean([row["radius_mm"] for row in rows[: len(PLACES)]]) for rows in (many, one)]
    assert mean_mm[1] > 2 * mean_mm[0]
    assert "x_mm" not in many[-1]


def test_the_command_reads_each_press_and_needs_a_height(four_boards: Atlas, tmp_path: Path, capsys) -> None:
    write_atlas(four_boards, tmp_path / "four.npz")
    folder = pressed(four_boards, sensor_with(FOUR), tmp_path / "four", count=1)
    bundle = write_small_bundle(tmp_path / "bundle", folder.sensor)
    files = [str(folder.root / file) for file in folder.manifest["file"]]
    named = ["predict", "--presses", "--model", str(bundle), "--atlas", str(tmp_path / "four.npz")]
    assert softslide.main([*named, "--height", str(HEIGHT_MM), *files]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert off_mm(rows[:1]).max() < 1.5
    assert rows[0]["valid"]
    assert rows[1] == {"recording": "p1", "file": files[1], "valid": False}
    assert "--height" in refused(capsys, *named, *files)


def test_what_is_not_a_press_shows_by_its_misfit(tmp_path: Path) -> None:
    """Outputs ten times as large as any press of this skin."""
    folder = pressed(ATLAS, sensor_with([(5.0, 0.0)]), tmp_path / "hard", gain=10.0, count=1)
    row = found_in(folder, ATLAS)[0]
    assert row["misfit"] > MOST_MISFIT
    assert not row["valid"]


def test_the_reading_is_the_strongest_after_the_touch_has_settled() -> None:
    time = np.arange(0.0, 4.0, 0.002)
    output = np.zeros((len(time), 3))
    output[(time >= 1.0) & (time < 1.1), 0] = 0.5  # the jolt of a touch
    output[time >= 1.1, 0] = 0.05
    output[(time >= 2.0) & (time < 2.5), 0] = 0.08
    found = settled_reading(time, output + 0.3)
    assert found is not None
    assert 2.0 <= found[0] <= 2.31
    assert found[1] == pytest.approx([0.08, 0.0, 0.0], abs=1e-9)
    assert settled_reading(time, np.zeros((len(time), 3))) is None
