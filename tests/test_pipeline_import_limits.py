"""Files that are larger than they look, or lead elsewhere, are refused before they are read."""

import tracemalloc
import zipfile
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import pytest
from imported_lab import refused
from lab_files import FORMATS, write_lab
from mcap.writer import CompressionType, Writer

from softslide.features.errors import InputError
from softslide.pipeline.importers.readers import chunk, matlab
from softslide.pipeline.importers.readers.hdf5 import read_hdf5
from softslide.pipeline.importers.readers.mcap_log import TOPIC, read_mcap
from softslide.pipeline.importers.readers.workbook import ExcelLayout, read_workbook


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
