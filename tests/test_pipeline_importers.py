"""A lab's files come in as they were written; broken ones leave nothing."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from front_door import refused as refused_command
from imported_lab import imported, refused
from lab_files import FORMATS, a_sensor, slide, write_lab, write_two_topics
from long_commands import contents

import softslide
from softslide.pipeline.checks.report import checked
from softslide.pipeline.importers.import_map import read_map, template
from softslide.pipeline.importers.readers.hdf5 import read_hdf5
from softslide.pipeline.importers.readers.registry import READERS
from softslide.pipeline.importers.run import import_recordings
from softslide.pipeline.recordings.folder import SAMPLE, read_folder
from softslide.pipeline.sensor import Accelerometer, write_sensor

HAPMAT = Path(__file__).parents[1].parent / "shared" / "recordings" / "hapmat"


def test_a_row_of_values_has_columns(tmp_path: Path) -> None:
    """A dataset of one row holds a value for every sample in each column, as MATLAB's of one column does."""
    with h5py.File(tmp_path / "row.h5", "w") as file:
        file["row"], file["column"] = np.array([[1.0, 2.0, 3.0]]), np.array([[1.0], [2.0], [3.0]])
        file["time"] = np.arange(4.0)
    for name, stored in (("row", False), ("column", True)):
        chunks = list(read_hdf5(tmp_path / "row.h5", ["time", f"{name}:2"], matlab=stored))
        np.testing.assert_array_equal(chunks[0].columns[f"{name}:2"], np.full(4, 3.0))


@pytest.mark.parametrize("name", FORMATS)
def test_a_format_comes_back_as_written(tmp_path: Path, name: str) -> None:
    form = FORMATS[name]
    folder = imported(write_lab(tmp_path, form), tmp_path / "out")
    assert list(folder.manifest.index) == ["one", "two"]
    for seed, recording in enumerate(("one", "two")):
        time_s, volts = slide(seed)
        read = folder.load(recording)
        np.testing.assert_allclose(read.time_s, time_s, rtol=0, atol=1e-15 if name == "tdms waveform" else 0)
        np.testing.assert_allclose(read.volts, volts, rtol=0, atol=form.tolerance_v)


def victim(folder: Path) -> Path:
    """The first slide's file; in a ROS 2 bag's folder its storage."""
    path = sorted((folder / "lab").iterdir())[0]
    return next(p for p in path.iterdir() if p.suffix in (".db3", ".mcap")) if path.is_dir() else path


@pytest.mark.parametrize("name", FORMATS)
def test_a_truncated_file_and_one_of_noise_are_refused(tmp_path: Path, capsys, name: str) -> None:
    map_path = write_lab(tmp_path, FORMATS[name])
    path = victim(tmp_path)
    content = path.read_bytes()
    for portion in (0.0, 0.03, 0.5, 0.9):
        path.write_bytes(content[: int(portion * len(content))])
        message = refused(map_path, capsys)
        assert path.name in message or path.parent.name in message
    path.write_bytes(np.random.default_rng(0).bytes(5000))
    refused(map_path, capsys)


def test_a_missing_axis_is_named(tmp_path: Path, capsys) -> None:
    map_path = write_lab(tmp_path, FORMATS["csv for each axis"])
    (tmp_path / "lab" / "two_y.csv").unlink()
    assert "no file of the part 'y'" in refused(map_path, capsys)


@pytest.mark.parametrize("name", ["csv", "csv for each axis", "hdf5", "ros 1", "ros 2"])
def test_two_imports_are_identical(tmp_path: Path, name: str) -> None:
    map_path = write_lab(tmp_path, FORMATS[name])
    for out in ("first", "second", "second"):
        imported(map_path, tmp_path / out)
    assert len(contents(tmp_path / "first")) == 5
    assert contents(tmp_path / "first") == contents(tmp_path / "second")


@pytest.mark.parametrize("kind", READERS)
def test_a_template_is_a_map(tmp_path: Path, capsys, kind: str) -> None:
    assert softslide.main(["import", "--map-template", kind]) == 0
    text = capsys.readouterr().out
    assert text == template(kind)
    write_lab(tmp_path, FORMATS["csv"])
    (tmp_path / "map.toml").write_text(text)
    assert read_map(tmp_path / "map.toml").kind == kind


def test_a_pattern_with_a_slash_sees_the_folders(tmp_path: Path) -> None:
    map_path = write_lab(tmp_path, FORMATS["csv"])
    for n, file in enumerate(sorted((tmp_path / "lab").iterdir())):
        (tmp_path / "lab" / f"day{n}").mkdir()
        file.rename(tmp_path / "lab" / f"day{n}" / f"run{file.suffix}")
    text = map_path.read_text().replace("(?P<recording>[a-z]+)", "(?P<recording>day./run)")
    map_path.write_text(text)
    assert list(imported(map_path, tmp_path / "out").manifest.index) == ["day0_run", "day1_run"]


@pytest.mark.parametrize("name", ["../../elsewhere", "=1+1", "a\\b"])
def test_a_name_that_leads_elsewhere_is_refused_before_anything_is_written(
    tmp_path: Path, capsys, name: str
) -> None:
    map_path = write_lab(tmp_path, FORMATS["csv"])
    (tmp_path / "elsewhere.parquet").write_bytes(b"kept")
    label = f"\n[labels.recording]\nname = 'recording'\nvalues = {{one = '{name}'}}\n"
    map_path.write_text(map_path.read_text() + label)
    assert "a name holds letters" in refused(map_path, capsys)
    assert (tmp_path / "elsewhere.parquet").read_bytes() == b"kept"


def test_labels_come_from_values_columns_names_and_a_sheet(tmp_path: Path) -> None:
    map_path = write_lab(tmp_path, FORMATS["csv"], ("x-slide-XF", "x-slide-XB"))
    for name in ("x-slide-XF", "x-slide-XB"):
        path = tmp_path / "lab" / f"{name}.csv"
        pd.read_csv(path).assign(depth=0.05).to_csv(path, index=False)
    (tmp_path / "sheet.csv").write_text("id;v cm/s;y\nx-slide-XF;0,25;-7,5\nx-slide-XB;0,4;\n")
    map_path.write_text(
        map_path.read_text().replace("(?P<recording>[a-z]+)", "x-slide-(?P<way>X[FB])")
        + '[sheet]\nfile = "sheet.csv"\nkey = "id"\ndelimiter = ";"\ndecimal = ","\n'
        '[labels]\nsplit = {value = "train"}\ndepth_mm = {column = "depth", scale = 10}\n'
        'direction_deg = {name = "way", values = {XF = 0, XB = 180}}\n'
        'speed_mm_s = {sheet = "v cm/s", scale = 10}\noffset_mm = {sheet = "y"}\n'
    )
    manifest = imported(map_path, tmp_path / "out").manifest
    assert list(manifest.index) == ["x-slide-XB", "x-slide-XF"]
    assert list(manifest.split) == ["train", "train"]
    assert list(manifest.depth_mm) == [0.5, 0.5]
    assert list(manifest.direction_deg) == [180, 0]
    assert list(manifest.speed_mm_s) == [4.0, 2.5]
    assert np.isnan(manifest.offset_mm["x-slide-XB"])
    assert manifest.offset_mm["x-slide-XF"] == -7.5


Z = 'column = "z"\n'


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('kind = "csv"', 'kind = "xls"', "kind is 'xls'"),
        ('kind = "csv"', 'kind = "csv"\ncolour = 1', "unknown key 'colour'"),
        ('kind = "csv"', "kind = 3", "kind is 3"),
        ('kind = "csv"', "", "kind is missing"),
        ("sensor.toml", "none.toml", "no such file"),
        ("[time]", "[times]", "unknown key 'times'"),
        ('column = "t"', "", "either column or rate_hz"),
        ('column = "t"', 'column = "clock"', "no column 'clock'"),
        ('column = "t"', 'column = "t"\nunit = "h"', "unit is 'h'"),
        ('column = "t"', 'column = "t"\nunit = "ms"', "100000 Hz"),
        ('column = "t"', 'column = "x"', "time does not increase"),
        ('column = "x"', 'column = "w"', "no column 'w'"),
        ("[channels.a0_vx]", "[channels.a9_vx]", "channels.a0_vx"),
        ("(?P<recording>[a-z]+)", "(?P<recording>[a-z+", "not a regular expression"),
        ("(?P<recording>[a-z]+)", "(?P<recording>[A-Z]+)", "fits the map"),
        ('column = "y"', 'column = "y"\nunit = "g"', "mix volts and accelerations"),
        ('column = "y"', 'column = "y"\nunit = "counts"', "volts_per_count"),
        (Z, Z + "[labels.speed_mm_s]\nvalue = -1\n", "positive"),
        (Z, Z + '[labels.speed_mm_s]\nvalue = "slow"\n', "no number"),
        (Z, Z + '[labels.speed_mm_s]\ncolumn = "x"\n', "label column 'x'"),
        (Z, Z + '[labels.speed_mm_s]\nname = "v"\n', "group 'v'"),
        (Z, Z + '[labels.speed_mm_s]\nsheet = "v"\n', "add [sheet]"),
        (Z, Z + "[labels.speed]\nvalue = 1\n", "labels.speed"),
        (Z, Z + '[labels.recording]\ncolumn = "x"\n', "a file holds one recording"),
        (Z, Z + '[sheet]\nfile = "no.csv"\n', "correct [sheet] in the map"),
        (Z, Z + '[boards.a0]\ncalibration = "no.csv"\n', "no.csv"),
        (Z, Z + '[boards.a0]\nflip = ["w"]\n', "flip is 'w'"),
        ('sheet = "slide"', 'sheet = "side"', "no sheet 'side' (it has Sheet, slide)"),
        ('kind = "xlsx"', 'kind = "csv"', '[xlsx] belongs to kind = "xlsx"'),
        ("acceleration.x", "acceleration_covariance", "holds many values a message"),
    ],
)
def test_a_bad_map_is_refused(tmp_path: Path, capsys, old: str, new: str, says: str) -> None:
    form = next(FORMATS[n] for n in ("csv", "xlsx", "ros 2 imu") if old in FORMATS[n].map_text())
    map_path = write_lab(tmp_path, form)
    map_path.write_text(form.map_text().replace(old, new))
    assert says in refused(map_path, capsys)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda t: t.assign(y=t.y.astype(object).where(t.index != 3, "overload")), "row 4 has a cell"),
        (lambda t: t.assign(y=t.y.where(t.index != 3)), "row 4 has a cell"),
        (lambda t: t.assign(y=[10**400 if n == 3 else n for n in t.index]), "row 4 has a cell"),
        (lambda t: t.drop(index=range(20, 60)), "row 21: a gap of 0.41 s"),
        (lambda t: t[::-1], "time does not increase"),
        (lambda t: t[:1], "1 samples"),
        (lambda t: t[:0], "0 samples"),
        (lambda t: t.drop(columns="z"), "no column 'z'"),
    ],
)
def test_bad_cells_are_named(tmp_path: Path, capsys, change, says: str) -> None:
    map_path = write_lab(tmp_path, FORMATS["csv"])
    path = tmp_path / "lab" / "one.csv"
    change(pd.read_csv(path)).to_csv(path, index=False)
    message = refused(map_path, capsys)
    assert "one.csv" in message
    assert says in message


def test_a_table_without_rows_is_refused_whatever_the_map_says(tmp_path: Path, capsys) -> None:
    map_path = write_lab(tmp_path, FORMATS["csv"])
    (tmp_path / "lab" / "one.csv").write_text("t,x,y,z\n")
    text = map_path.read_text()
    for changed in (
        text.replace('column = "t"', "rate_hz = 100"),
        f'{text}[labels.depth_mm]\ncolumn = "x"\n',
    ):
        map_path.write_text(changed)
        assert "0 samples, at least two are needed" in refused(map_path, capsys)


def test_two_topics_with_clocks_of_their_own_share_one(tmp_path: Path) -> None:
    map_path = write_lab(tmp_path, FORMATS["ros 2"], ())
    write_two_topics(tmp_path / "lab" / "one", lag_s=0.003)
    parts = (Accelerometer("a0", -8.0, 0.0), Accelerometer("a1", 8.0, 0.0))
    write_sensor(tmp_path / "sensor.toml", replace(a_sensor(), accelerometers=parts))
    text = map_path.read_text().replace("/skin", "/left")
    for axis in "xyz":
        text += f'[channels.a1_v{axis}]\ncolumn = "/right.vector.{axis}"\n'
    map_path.write_text(text)
    recording = imported(map_path, tmp_path / "out").load("one")
    time_s, volts = slide(0)
    # The grid starts with the later stream: its samples stay, the other's are read off a straight line.
    np.testing.assert_array_equal(recording.volts[:, 3:], volts[:-1])
    line = np.column_stack([np.interp(time_s[:-1] + 0.003, time_s, column) for column in volts.T])
    np.testing.assert_allclose(recording.volts[:, :3], line, atol=1e-6)
    np.testing.assert_allclose(np.diff(recording.time_s), 0.01, atol=1e-12)


def test_usage_and_an_output_that_cannot_be_are_refused(tmp_path: Path, capsys) -> None:
    map_path = write_lab(tmp_path, FORMATS["csv"])
    for out in (map_path, map_path / "out"):
        refused_command(capsys, "import", tmp_path / "lab", "--map", map_path, "--out", out)
    assert map_path.read_text() == FORMATS["csv"].map_text()
    for arguments in ("x", "x --out y", "--map-template xls", "", f"x --map {tmp_path / 'm'} --out o"):
        refused_command(capsys, "import", *arguments.split())


@pytest.mark.skipif(not HAPMAT.is_dir(), reason="the shared recordings are not next to this checkout")
def test_a_real_accelerometer_comes_in(tmp_path: Path) -> None:
    map_path = write_lab(tmp_path, FORMATS["csv"])
    shutil.rmtree(tmp_path / "lab")
    text = map_path.read_text().replace("(?P<recording>[a-z]+)", "").replace('"t"', '"time"')
    for axis in "xyz":
        text = text.replace(f'column = "{axis}"', f'column = "accel_{axis}"\nunit = "g"')
    map_path.write_text(text)
    folder = imported(map_path, tmp_path / "out", HAPMAT)
    assert list(folder.manifest.index) == ["Paper 1", "Wood 1"]
    source = pd.read_csv(HAPMAT / "Wood 1.csv")
    recording = folder.load("Wood 1")
    np.testing.assert_array_equal(recording.time_s, source["time"])
    felt_g = source[["accel_x", "accel_y", "accel_z"]]
    np.testing.assert_allclose((recording.volts - 1.65) / 0.8, felt_g, atol=1e-12)
    assert json.loads((tmp_path / "out" / "import.json").read_text())["recordings"][0]["resampled"] is False
    findings = checked(folder).findings
    assert {finding.level for finding in findings} == {"warning"}
    assert ("gravity", "Wood 1") in {(finding.kind, finding.recording) for finding in findings}


@pytest.fixture(scope="module")
def sample_as_csv(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight slides of the sample as a lab would have them: delimited text and a sheet."""
    folder = tmp_path_factory.mktemp("sample")
    sample = read_folder(SAMPLE)
    chosen = sample.manifest[sample.manifest.split.str.startswith("test")].sort_values("motion_end_s")[:8]
    (folder / "lab").mkdir()
    for name in chosen.index:
        recording = sample.load(str(name))
        table = pd.DataFrame({"t": recording.time_s} | dict(zip("xyz", recording.volts.T, strict=True)))
        table.to_csv(folder / "lab" / f"{name}.csv", index=False)
    chosen.drop(columns="file").to_csv(folder / "sheet.csv")
    shutil.copyfile(SAMPLE / "sensor.toml", folder / "sensor.toml")
    labels = [label for label in chosen.columns if label not in ("file", "pressure_mpa")]
    text = FORMATS["csv"].map_text().replace("[a-z]+", "a[0-9]+")
    text += '[sheet]\nfile = "sheet.csv"\n'
    text += "".join(f'[labels.{label}]\nsheet = "{label}"\n' for label in labels)
    (folder / "map.toml").write_text(text)
    return folder


def test_inverted_outputs_are_flipped_and_said(sample_as_csv: Path, tmp_path: Path) -> None:
    text = (sample_as_csv / "map.toml").read_text()
    straight = imported(sample_as_csv / "map.toml", tmp_path / "straight")
    sample = read_folder(SAMPLE)
    for name, row in straight.manifest.iterrows():
        np.testing.assert_array_equal(straight.load(name).volts, sample.load(name).volts)
        np.testing.assert_array_equal(straight.load(name).time_s, sample.load(name).time_s)
        recorded = sample.manifest.loc[name].drop("pressure_mpa")
        pd.testing.assert_series_equal(row.drop("pressure_mpa"), recorded)
    wrong = text + '[boards.a0]\nflip = ["y"]\n'
    mended = tmp_path / "mended"
    for signs in ("given", "zones"):
        path = sample_as_csv / f"{signs}.toml"
        path.write_text(wrong.replace("\n[time]", f'signs = "{signs}"\n[time]', 1))
        done = import_recordings([sample_as_csv / "lab"], path, mended)
        note = next(note for note in done.notes if "inverted" in note)
        assert note.startswith("flipped a0_vy" if signs == "zones" else "not flipped a0_vy")
        assert "8 of 8 labelled slides" in note or "7 of 7" in note
    for name in straight.manifest.index:
        flipped = read_folder(mended).load(name).volts
        np.testing.assert_allclose(flipped, straight.load(name).volts, atol=1e-12)


def test_a_stage_with_another_clock_is_aligned_on_the_onset(sample_as_csv: Path, tmp_path: Path) -> None:
    sheet = pd.read_csv(sample_as_csv / "sheet.csv")
    text = (sample_as_csv / "map.toml").read_text().replace('column = "t"', 'column = "t"\nalign = "onset"')
    path = sample_as_csv / "late.toml"
    path.write_text(text.replace("sheet.csv", "late.csv"))
    # The stage's clock runs from 1.5 s behind to 1.5 s ahead over the day.
    drift = np.linspace(-1.5, 1.5, len(sheet))
    late = sheet.assign(motion_start_s=sheet.motion_start_s + drift, motion_end_s=sheet.motion_end_s + drift)
    late.to_csv(sample_as_csv / "late.csv", index=False)
    manifest = imported(path, tmp_path / "out").manifest
    error_mm = (manifest.motion_start_s - sheet.set_index("recording").motion_start_s) * manifest.speed_mm_s
    assert error_mm.abs().median() < 2.5
    report = json.loads((tmp_path / "out" / "import.json").read_text())["recordings"]
    shift = pd.Series({entry["recording"]: entry["shift_s"] for entry in report})
    assert np.corrcoef(shift[sheet.recording], drift)[0, 1] < -0.7
