"""A folder of recordings comes back as written, and a broken one is refused in one line."""

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from streams import RATE_HZ, a_sensor, still, stream
from trial_folder import SENSOR, a_folder, a_slide

import softslide
from softslide.features.clock import check_clock
from softslide.features.errors import InputError
from softslide.pipeline.recordings.folder import SAMPLE, Recording, read_folder, write_folder
from softslide.pipeline.recordings.manifest import LABELS
from softslide.pipeline.recordings.slide_file import read_slide, write_slide


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return a_folder(tmp_path / "lab", one={}, two={}, three={}).root


def refused(root: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """The front door's one error on a folder that it refuses, or that has a recording which cannot be read."""
    assert softslide.main(["check", str(root)]) == 2
    out, err = capsys.readouterr()
    unreadable = [line for line in out.splitlines() if line.startswith("error: unreadable")]
    errors = unreadable or err.splitlines()
    assert len(errors) == 1, (out, err)
    return errors[0]


@pytest.mark.parametrize("accelerometers", [1, 2, 5])
def test_a_folder_comes_back_as_written(tmp_path: Path, accelerometers: int) -> None:
    sensor = a_sensor(accelerometers)
    written = Recording("one", np.arange(400) / RATE_HZ, stream(still(0.4), accelerometers=accelerometers))
    manifest = pd.DataFrame([{"recording": "one", "split": "calibration"}])
    write_folder(tmp_path / "lab", sensor, manifest, [written])
    folder = read_folder(tmp_path / "lab")
    assert folder.sensor == sensor
    assert list(folder.manifest.index) == ["one"]
    read = folder.load("one")
    np.testing.assert_array_equal(read.time_s, written.time_s)
    np.testing.assert_array_equal(read.volts, written.volts)
    assert read.volts.dtype == read.time_s.dtype == np.float64


@settings(max_examples=40)
@given(hnp.arrays(np.float64, (7, 3), elements=st.floats(-10, 10, allow_subnormal=False)), st.booleans())
def test_volts_survive_to_the_last_bit(tmp_path_factory, volts: np.ndarray, narrow: bool) -> None:
    path, channels = tmp_path_factory.mktemp("slide") / "s.parquet", SENSOR.channels
    volts = volts.astype(np.float32).astype(float) if narrow else volts
    write_slide(path, np.arange(7.0), volts, channels)
    np.testing.assert_array_equal(read_slide(path, channels)[1], volts)


def test_csv_slides_are_read_to_the_last_bit(root: Path) -> None:
    volts = read_folder(root).load("two").volts
    pq.read_table(root / "slides/two.parquet").to_pandas().to_csv(root / "slides/two.csv", index=False)
    edit_manifest(root, "file", 1, "slides/two.csv")
    np.testing.assert_array_equal(read_folder(root).load("two").volts, volts)


def test_labels_may_be_absent(tmp_path: Path) -> None:
    manifest = pd.DataFrame({"recording": ["one", "two"], "split": "test", "speed_mm_s": [np.nan, 20.0]})
    write_folder(tmp_path / "lab", SENSOR, manifest, (a_slide(name, 0.1) for name in ("one", "two")))
    folder = read_folder(tmp_path / "lab")
    assert set(LABELS) <= set(folder.manifest.columns)
    assert folder.manifest["direction_deg"].isna().all()
    assert len(folder.labelled()) == 0


def test_select_takes_splits_by_their_beginning(root: Path) -> None:
    edit_manifest(root, "split", 0, "test-fast")
    edit_manifest(root, "split", 1, "test")
    edit_manifest(root, "split", 2, "calibration")
    folder = read_folder(root)
    assert list(folder.select("test").manifest.index) == ["one", "two"]
    assert list(folder.select("calibration", "train").manifest.index) == ["three"]
    assert len(folder.select("no-such")) == 0


def edit_manifest(root: Path, column: str, row: int, value: str) -> None:
    table = pd.read_csv(root / "manifest.csv", dtype=str)
    table.loc[row, column] = value
    table.to_csv(root / "manifest.csv", index=False)


@pytest.mark.parametrize(
    ("column", "value", "says"),
    [
        ("direction_deg", "360", "[0, 360)"),
        ("direction_deg", "inf", "[0, 360)"),
        ("speed_mm_s", "0", "positive"),
        ("speed_mm_s", "inf", "positive"),
        ("offset_mm", "120", "crosses the chamber"),
        ("depth_mm", "-0.5", "negative"),
        ("pressure_mpa", "-1", "negative"),
        ("travel_mm", "0", "positive"),
        ("start_x_mm", "inf", "finite"),
        ("motion_end_s", "0.5", "motion_start_s"),
        ("motion_end_s", "30", "outside the recording"),
        ("motion_start_s", "-4", "outside the recording"),
        ("recording", "one", "differ"),
        ("recording", "", "given"),
        ("recording", "../two", "letters, digits"),
        ("recording", "=two", "letters, digits"),
        ("recording", "C:two", "no device of Windows"),
        ("file", "", "no file of the folder has such a name"),
        ("file", "slides/" + "a" * 5000, "no file of the folder has such a name"),
        ("file", "../lab/slides/two.parquet", "neither absolute nor with .."),
        ("file", "slides/../../lab/slides/two.parquet", "neither absolute nor with .."),
        ("file", "..\\lab\\two.parquet", "neither absolute nor with .."),
        ("file", "/dev/zero", "neither absolute nor with .."),
        ("file", "C:two.parquet", "neither absolute nor with .."),
        ("file", "slides/none.parquet", "no such file; put it there or take its row out of the manifest"),
    ],
)
def test_a_bad_cell_is_named(root: Path, capsys, column: str, value: str, says: str) -> None:
    edit_manifest(root, column, 1, value)
    message = refused(root, capsys)
    # A file that is not there is named itself.
    assert "none.parquet" in message if value.endswith("none.parquet") else "manifest.csv" in message
    assert column in message
    assert says in message
    assert "row 2" in message or "two" in message


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"recording,file,split\n", "no recordings"),
        (b"file,split\n", "'recording' is missing"),
        (b"recording,split\n", "'file' is missing"),
        (b"recording,file,split\na,b,c,d,e\n", "not a comma-separated table"),
    ],
)
def test_a_broken_manifest_is_refused(root: Path, capsys, content: bytes, says: str) -> None:
    """What the page of messages does not show."""
    (root / "manifest.csv").write_bytes(content)
    assert says in refused(root, capsys)


def edit_slide(root: Path, change) -> None:
    path = root / "slides/two.parquet"
    change(pq.read_table(path).to_pandas()).to_parquet(path, index=False)


def with_cell(column: str, row: int, value: float):
    def change(slide: pd.DataFrame) -> pd.DataFrame:
        slide.loc[row, column] = value
        return slide

    return change


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda s: s.drop(columns="a0_vy"), "'a0_vy' is missing"),
        (lambda s: s.drop(columns="time_s"), "'time_s' is missing"),
        (with_cell("a0_vz", 9, np.nan), "row 10, column a0_vz"),
        (with_cell("a0_vx", 0, np.inf), "row 1, column a0_vx"),
        (with_cell("time_s", 3, np.nan), "row 4, column time_s"),
        (lambda s: s.assign(a0_vx=["?" if n == 2 else "1.6" for n in range(len(s))]), "row 3, column a0_vx"),
        (lambda s: s.drop(index=range(50, 90)), "row 51, column time_s: a gap of 0.205"),
        (lambda s: s.drop(index=50), "a gap of 0.01"),
        (with_cell("time_s", 7, 0.28), "row 8, column time_s does not increase"),
        (lambda s: s[::-1], "does not increase"),
        (lambda s: s.assign(time_s=s.time_s * 2), "runs at 100 Hz, sensor.toml says sample_rate_hz = 200"),
        (lambda s: s.assign(time_s=s.time_s * 1.01), "runs at 198.02 Hz"),
        (lambda s: s[:0], "0 samples"),
    ],
)
def test_a_bad_sample_is_named(root: Path, capsys, change, says: str) -> None:
    edit_slide(root, change)
    message = refused(root, capsys)
    assert "two.parquet" in message
    assert says in message


@settings(max_examples=60)
@given(st.integers(50, 300), st.floats(10, 1e4), st.floats(0, 0.2), st.integers(0, 2**32 - 1))
def test_a_clock_may_jitter_but_not_lose_samples(samples, rate_hz, jitter, seed) -> None:
    random = np.random.default_rng(seed)
    time_s = (np.arange(samples) + random.uniform(-jitter, jitter, samples)) / rate_hz
    check_clock(Path("s"), time_s, rate_hz)
    for wrong in (np.delete(time_s, random.integers(1, samples - 1)), time_s * 1.5, time_s[::-1]):
        with pytest.raises(InputError):
            check_clock(Path("s"), wrong, rate_hz)


def test_an_absent_folder_is_refused(tmp_path: Path, root: Path, capsys) -> None:
    assert "none: no such file or folder" in refused(tmp_path / "none", capsys)
    for file in ("manifest.csv", "sensor.toml"):
        copy = shutil.copytree(root, tmp_path / f"without-{file}")
        (copy / file).unlink()
        assert "no such file" in refused(copy, capsys)


def test_nothing_half_written_is_left(tmp_path: Path) -> None:
    def broken():
        yield a_slide("one", 0.1)
        raise InputError("the source ends")

    manifest = pd.DataFrame({"recording": ["one", "two"], "split": "test"})
    for recordings in (
        broken(),
        *([a_slide(n, 0.1) for n in names] for names in (["one"], ["one", "three"])),
    ):
        with pytest.raises(InputError):
            write_folder(tmp_path / "lab", SENSOR, manifest, recordings)
        assert list(tmp_path.iterdir()) == []


def test_the_sample_is_well_and_covers_what_a_demo_needs() -> None:
    folder = read_folder(SAMPLE)
    assert all(np.isfinite(folder.load(name).volts).all() for name in folder.manifest.index)
    assert len(folder.labelled()) == len(folder) == 60
    calibration = folder.select("calibration").manifest
    for direction in (0, 90, 180, 270):
        lines = calibration[calibration.direction_deg == direction]
        assert lines.speed_mm_s.nunique() == 4
        assert lines.offset_mm.nunique() >= 7
    assert set(folder.select("test").manifest.split) == {"test", "test-depth", "test-diagonal", "test-fast"}
    assert sum(file.stat().st_size for file in SAMPLE.rglob("*.*")) < 12e6
