"""A lab's files come in as they were written; broken ones leave nothing; an interrupted import goes on."""

import json
import shutil
import tracemalloc
import zipfile
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import pandas as pd
import pytest
from front_door import refused as refused_command
from lab_files import FORMATS, a_sensor, slide, write_lab, write_two_topics
from long_commands import contents
from mcap.writer import CompressionType, Writer

import softslide
from softslide.features.errors import InputError
from softslide.pipeline.checks.report import checked
from softslide.pipeline.importers import run
from softslide.pipeline.importers.import_map import read_map, template
from softslide.pipeline.importers.readers import chunk, matlab
from softslide.pipeline.importers.readers.hdf5 import read_hdf5
from softslide.pipeline.importers.readers.mcap_log import TOPIC, read_mcap
from softslide.pipeline.importers.readers.registry import READERS
from softslide.pipeline.importers.readers.workbook import ExcelLayout, read_workbook
from softslide.pipeline.importers.resume import Journal
from softslide.pipeline.importers.run import import_recordings
from softslide.pipeline.importers.sources import find_sources
from softslide.pipeline.recordings.folder import SAMPLE, read_folder
from softslide.pipeline.sensor import Accelerometer, write_sensor

HAPMAT = Path(__file__).parents[1].parent / "shared" / "recordings" / "hapmat"


def imported(map_path: Path, out: Path, source: Path | None = None):
    """The folder that an import makes, read back."""
    import_recordings([source or map_path.parent / "lab"], map_path, out)
    folder = read_folder(out)
    for name in folder.manifest.index:
        folder.load(name)
    return folder


def refused(map_path: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """The front door's one line; nothing is left next to the sources."""
    root = map_path.parent
    before = sorted(root.iterdir())
    said = refused_command(capsys, "import", root / "lab", "--map", map_path, "--out", root / "out")
    assert sorted(root.iterdir()) == before
    return said


def test_what_unpacks_to_too_much_is_refused_before_it_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    map_path = write_lab(tmp_path, FORMATS["mat"])
    monkeypatch.setattr(matlab, "MOST_UNPACKED_BYTES", 5_000)
    monkeypatch.setattr(matlab.scipy.io, "loadmat", lambda *_, **__: pytest.fail("it was read"))
    assert "unpacks to more than 0.005 MB; save the variables" in refused(map_path, capsys)


@pytest.mark.parametrize("name", ["parquet", "hdf5", "tdms", "mat"])
def test_more_samples_than_a_recording_has_are_refused(
    tmp_path: Path, capsys, monkeypatch, name: str
) -> None:
    map_path = write_lab(tmp_path, FORMATS[name])
    monkeypatch.setattr(chunk, "MOST_SAMPLES", 100)
    assert "says it holds 250 samples; 100 at most are read: record shorter" in refused(map_path, capsys)


@pytest.mark.parametrize(
    ("shape", "made", "column", "says"),
    [
        ((10**12,), {"chunks": (1000,)}, "x", "says it holds 1000000000000 samples"),
        (
            (20_000_000,),
            {"chunks": (1000,)},
            "x",
            "stores 0 bytes for 160 MB, so most of it was never written",
        ),
        (
            (1 << 24,),
            {"chunks": (1 << 24,), "compression": "gzip"},
            "x",
            "chunks of 134 MB, and 67.1 at most",
        ),
        ((1, 1 << 27), {"chunks": (1, 1000)}, "x:2", "says it holds 134217728 samples"),
        ((10,), {"dtype": "S5000"}, "x", "values of 5000 bytes; name a dataset of numbers"),
    ],
)
def test_an_hdf5_dataset_that_is_larger_than_it_looks_is_refused(tmp_path, shape, made, column, says) -> None:
    with h5py.File(tmp_path / "x.h5", "w") as file:
        dataset = file.create_dataset("x", shape, **{"dtype": "f8", **made})
        if "compression" in made:
            dataset[:10] = 1.0
    with pytest.raises(InputError, match=f"x.h5: .*{says}"):
        next(read_hdf5(tmp_path / "x.h5", [column]))


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_an_mcap_chunk_that_unpacks_to_more_than_any_is_refused(tmp_path: Path, compression) -> None:
    path = tmp_path / "x.mcap"
    for padding in (0, 70 << 20):
        with path.open("wb") as file:
            writer = Writer(file, 1 << 30, compression)
            writer.start()
            channel = writer.register_channel(TOPIC, "json", writer.register_schema("x", "jsonschema", b"{}"))
            writer.add_message(channel, 0, b'{"t": 0}' + padding * b" ", 0)
            writer.finish()
        if not padding:
            assert len(next(read_mcap(path, ["t"]))) == 1
    with pytest.raises(InputError, match=r"x.mcap: a chunk unpacks to .* and 67.1 at most are read"):
        next(read_mcap(path, ["t"]))


def workbook_with(path: Path, part: str, old: bytes, new: bytes, **further: bytes) -> None:
    """A workbook of two columns and five rows, of which one part is changed; further: parts to add, by their names."""
    book = openpyxl.Workbook()
    for row in (["t", "x"], *([k, 1.0] for k in range(5))):
        book.active.append(row)
    book.save(path)
    with zipfile.ZipFile(path) as packed:
        parts = {name: packed.read(name) for name in packed.namelist()}
    assert old in parts[part]
    parts |= {part: parts[part].replace(old, new, 1)} | further
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in parts.items():
            packed.writestr(name, content)


def test_parts_of_a_workbook_are_limited_by_what_they_are(tmp_path: Path) -> None:
    path, end = tmp_path / "x.xlsx", b"</styleSheet>"
    workbook_with(path, "xl/styles.xml", end, end + b" " * (5 << 20))
    with pytest.raises(InputError, match=r"x.xlsx: xl/styles.xml unpacks to 5.25 MB, more than is read"):
        next(read_workbook(path, ["t"], ExcelLayout()))
    texts = b'<sst xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"/>' + b" " * (65 << 20)
    place, kind = "xl/worksheets/other.xml", b"application/vnd.openxmlformats-officedocument.spreadsheetml."
    named = b'<Override PartName="/%s" ContentType="%ssharedStrings+xml"/></Types>' % (place.encode(), kind)
    workbook_with(path, "[Content_Types].xml", b"</Types>", named, **{place: texts})
    with pytest.raises(InputError, match=r"x.xlsx: xl/worksheets/other.xml unpacks to 68.2 MB"):
        next(read_workbook(path, ["t"], ExcelLayout()))


def test_a_far_cell_of_a_workbook_takes_no_memory(tmp_path: Path) -> None:
    path, sheet, end = tmp_path / "x.xlsx", "xl/worksheets/sheet1.xml", b"</sheetData>"
    row = b'<row r="%d"><c r="B%d"><v>1</v></c><c r="XFD%d"><v>1</v></c></row>'
    workbook_with(path, sheet, end, b"".join(row % (k, k, k) for k in range(8, 308)) + end)
    tracemalloc.start()
    try:
        (rows,) = read_workbook(path, ["t", "x"], ExcelLayout())
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()
    np.testing.assert_array_equal(rows.columns["t"], [*range(5), *[np.nan] * 301])
    np.testing.assert_array_equal(rows.columns["x"], [*[1.0] * 5, np.nan, *[1.0] * 300])
    workbook_with(path, sheet, end, b'<row r="1048577"><c r="A1048577"><v>1</v></c></row>' + end)
    with pytest.raises(InputError, match=r"x.xlsx: has rows beyond 1048576, the last of a sheet"):
        list(read_workbook(path, ["t"], ExcelLayout()))


@pytest.mark.parametrize("kind", ["external", "virtual"])
def test_data_in_other_files_are_not_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    map_path = write_lab(tmp_path, FORMATS["hdf5"])
    (tmp_path / "secret").write_bytes(np.arange(3000.0).tobytes())
    for path in (tmp_path / "lab").glob("*.h5"):
        with h5py.File(path, "r+") as file:
            shape = file["daq/v"].shape
            del file["daq/v"]
            if kind == "external":
                place = [(str(tmp_path / "secret"), 0, h5py.h5f.UNLIMITED)]
                file.create_dataset("daq/v", shape, float, external=place)
            else:
                layout = h5py.VirtualLayout(shape, float)
                layout[:] = h5py.VirtualSource(tmp_path / "other.h5", "v", shape)
                file.create_virtual_dataset("daq/v", layout)
    assert "lies in other files" in refused(map_path, capsys)


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


def test_an_interrupted_import_resumes(tmp_path: Path, monkeypatch) -> None:
    map_path = write_lab(tmp_path, FORMATS["csv"], ("one", "two", "three"))
    read, begun = run.write_even, []

    def interrupted(source, *rest):
        begun.append(source.name)
        if len(begun) == 3:
            raise KeyboardInterrupt
        return read(source, *rest)

    monkeypatch.setattr(run, "write_even", interrupted)
    with pytest.raises(KeyboardInterrupt):
        imported(map_path, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    monkeypatch.setattr(run, "write_even", read)
    done = import_recordings([tmp_path / "lab"], map_path, tmp_path / "out")
    assert done.resumed == 2
    imported(map_path, tmp_path / "afresh")
    assert contents(tmp_path / "out") == contents(tmp_path / "afresh")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["afresh", "lab", "map.toml", "out", "sensor.toml"]


@pytest.mark.parametrize("last", ["write_manifest", "shutil.rmtree"])
def test_an_import_interrupted_as_it_ends_loses_nothing(tmp_path: Path, monkeypatch, last: str) -> None:
    """Before its folder is there, or after; slides that are read anew do not reach into a folder that is whole."""
    map_path = write_lab(tmp_path, FORMATS["csv"], ("one", "two"))

    def interrupted(*rest, **more):
        raise KeyboardInterrupt

    def import_interrupted_at(name: str) -> None:
        with monkeypatch.context() as patch:
            patch.setattr(f"softslide.pipeline.importers.run.{name}", interrupted)
            with pytest.raises(KeyboardInterrupt):
                imported(map_path, tmp_path / "out")

    import_interrupted_at(last)
    assert (tmp_path / "out").exists() is (last == "shutil.rmtree")
    assert import_recordings([tmp_path / "lab"], map_path, tmp_path / "out").resumed == 2
    import_interrupted_at("shutil.rmtree")
    before = contents(tmp_path / "out")
    FORMATS["csv"].write(tmp_path / "lab", "one", *slide(7, 300))
    import_interrupted_at("_finish")
    assert contents(tmp_path / "out") == before


@pytest.mark.parametrize(
    "left", [{}, {"one.parquet": b"PAR1"}, {"one.parquet": b"PAR1", "one.json": b'{"map"'}]
)
def test_what_a_killed_import_leaves_does_not_stop_the_next(tmp_path: Path, left: dict[str, bytes]) -> None:
    map_path = write_lab(tmp_path, FORMATS["csv"])
    imported(map_path, tmp_path / "out")
    before = contents(tmp_path / "out")
    (tmp_path / ".out.partial" / "raw").mkdir(parents=True)
    for name, content in left.items():
        (tmp_path / ".out.partial" / "raw" / name).write_bytes(content)
    imported(map_path, tmp_path / "out")
    assert contents(tmp_path / "out") == before
    assert not (tmp_path / ".out.partial").exists()


@pytest.mark.parametrize("change", ["map", "source"])
def test_what_another_map_or_source_made_is_done_again(tmp_path: Path, monkeypatch, change) -> None:
    map_path = write_lab(tmp_path, FORMATS["csv"])

    def interrupted(*rest):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(run, "_finish", interrupted)
        with pytest.raises(KeyboardInterrupt):
            imported(map_path, tmp_path / "out")
    if change == "map":
        map_path.write_text(map_path.read_text() + '[labels.split]\nvalue = "test"\n')
    else:
        FORMATS["csv"].write(tmp_path / "lab", "one", *slide(7, 300))
    done = import_recordings([tmp_path / "lab"], map_path, tmp_path / "out")
    assert done.resumed == (0 if change == "map" else 1)
    folder = read_folder(tmp_path / "out")
    assert len(folder.load("one").time_s) == (250 if change == "map" else 300)


def test_a_note_of_another_map_is_gone_before_the_slide_is_written_anew(tmp_path: Path) -> None:
    mapping = read_map(write_lab(tmp_path, FORMATS["csv"]))
    (job, _), journal = find_sources([tmp_path / "lab"], mapping), Journal(tmp_path / "work", mapping)
    journal.add(job, {})
    journal.slide(job.name).touch()
    assert journal.find(job) is not None
    assert Journal(tmp_path / "work", replace(mapping, signs="zones")).find(job) is None
    assert journal.find(job) is None


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
