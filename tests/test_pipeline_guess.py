"""A map guessed from a lab's files reads them as they were written, and a wrong map's message has the cure."""

import re
from pathlib import Path

import numpy as np
import pytest
from lab_files import FORMATS, a_sensor, slide, write_lab

import softslide
from softslide.features.errors import InputError
from softslide.features.units import STANDARD_GRAVITY
from softslide.pipeline.importers.guess import guess_map
from softslide.pipeline.importers.run import import_recordings
from softslide.pipeline.recordings.folder import SAMPLE, read_folder
from softslide.pipeline.sensor import write_sensor

GERMAN = "DAQ 9234; Prüfstand\nZeit;Beschl_x;Beschl_y;Beschl_z\nms;m/s²;m/s²;m/s²\n"


def german(folder: Path, count: int = 6) -> Path:
    """Slides of the sample as a spreadsheet in German saves them, labels in their names; returns the lab's folder."""
    sample = read_folder(SAMPLE)
    part = sample.sensor.accelerometers[0]
    for name, row in list(sample.manifest.iterrows())[:count]:
        recording = sample.load(name)
        a = (recording.volts - part.zero_g_v) / part.sensitivity_v_per_g * STANDARD_GRAVITY
        table = np.column_stack([1000 * recording.time_s, a])
        text = "".join(";".join(f"{v:.12g}" for v in line) + "\n" for line in table).replace(".", ",")
        words = f"dir{row.direction_deg:g}_v{row.speed_mm_s:g}_x{row.start_x_mm:g}_y{row.start_y_mm:g}"
        (folder / "lab" / row.split).mkdir(parents=True, exist_ok=True)
        (folder / "lab" / row.split / f"{name}_{words}_weg{row.travel_mm:g}.csv").write_text(
            GERMAN + text, encoding="cp1252"
        )
    write_sensor(folder / "sensor.toml", sample.sensor)
    return folder / "lab"


def test_the_guess_of_a_german_lab_imports_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lab = german(tmp_path)
    assert softslide.main(["import", "--guess", str(lab)]) == 0
    (tmp_path / "map.toml").write_text(capsys.readouterr().out)
    import_recordings(lab, tmp_path / "map.toml", tmp_path / "out")
    made, sample = read_folder(tmp_path / "out"), read_folder(SAMPLE)
    for name, row in made.manifest.iterrows():
        was = str(name).partition("_")[0]
        for label in ("split", "direction_deg", "speed_mm_s", "start_x_mm", "start_y_mm", "travel_mm"):
            assert row[label] == sample.manifest.loc[was, label]
        np.testing.assert_allclose(made.load(str(name)).volts, sample.load(was).volts, atol=1e-9)


@pytest.mark.parametrize("name", ["csv", "european csv", "csv with timestamps"])
def test_the_guess_of_a_format_reads_it_as_written(tmp_path: Path, name: str) -> None:
    write_lab(tmp_path, FORMATS[name])
    (tmp_path / "map.toml").write_text(guess_map([tmp_path / "lab"]))
    import_recordings(tmp_path / "lab", tmp_path / "map.toml", tmp_path / "out")
    for seed, recording in enumerate(("one", "two")):
        np.testing.assert_allclose(read_folder(tmp_path / "out").load(recording).volts, slide(seed)[1])


def test_what_is_unsure_is_marked(tmp_path: Path) -> None:
    rows = "".join(f"{0.001 * n:.3f},{np.sin(n)},{np.cos(n)},{1 + 0.1 * np.sin(3 * n)}\n" for n in range(100))
    (tmp_path / "a.csv").write_text("clock,ch1,ch2,ch3\n" + rows)
    text = guess_map([tmp_path / "a.csv"])
    for key in ("column = .ch1.", "unit = .g.", "value = .calibration."):
        assert re.search(rf"{key} +# unsure", text), key
    assert "# 1000 Hz by these times" in text


@pytest.mark.parametrize("words", ["", "only words\nand more\n", "1,2,3\n4,5,6\n"])
def test_no_table_is_no_guess(tmp_path: Path, words: str) -> None:
    (tmp_path / "a.csv").write_text(words)
    with pytest.raises(InputError, match=r"a\.csv"):
        guess_map([tmp_path / "a.csv"])


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('decimal = ","', "", '[csv] decimal = ","'),
        ("header_lines = 2", "", "[csv] header_lines = 2"),
        ("units_row = true", "", "[csv] units_row = true"),
        ('encoding = "latin-1"', "", '[csv] encoding = "cp1252"'),
        ('[time]\ncolumn = "t"', '[time]\ncolumn = "t"\nunit = "ms"', '[time] unit = "s"'),
        ('kind = "csv"', 'kind = "parquet"', 'the files there are of kind = "csv"'),
    ],
)
def test_a_wrong_map_is_told_the_right_line(tmp_path: Path, old: str, new: str, says: str) -> None:
    path = write_lab(tmp_path, FORMATS["european csv"])
    text = path.read_text()
    assert old in text
    text = text.replace(old, new)
    path.write_text(text.partition("[csv]")[0] if "parquet" in new else text)
    with pytest.raises(InputError, match=re.escape(says)):
        import_recordings(tmp_path / "lab", path, tmp_path / "out")


def test_a_sensor_with_a_byte_order_mark_is_read(tmp_path: Path) -> None:
    write_sensor(tmp_path / "plain.toml", a_sensor())
    (tmp_path / "bom.toml").write_bytes(b"\xef\xbb\xbf" + (tmp_path / "plain.toml").read_bytes())
    assert softslide.read_sensor(tmp_path / "bom.toml") == a_sensor()


def test_raw_files_are_read_as_their_import(
    tmp_path: Path, bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lab, map_path = german(tmp_path, 1), tmp_path / "map.toml"
    text = guess_map([lab])
    map_path.write_text(text.replace('"zones"', '"given"'))
    import_recordings(lab, map_path, tmp_path / "out")
    (raw,), (slide,) = lab.rglob("*.csv"), (tmp_path / "out" / "slides").iterdir()
    predict = ["predict", "--model", str(bundle)]
    assert softslide.main([*predict, str(slide)]) == 0
    wanted = capsys.readouterr().out
    assert softslide.main([*predict, "--map", str(map_path), str(raw)]) == 0
    found = capsys.readouterr().out
    assert found.partition('"time_s"')[2] == wanted.partition('"time_s"')[2] != ""
    map_path.write_text(text)
    assert softslide.main([*predict, "--map", str(map_path), str(raw)]) == 2
    assert 'signs = "zones" needs labelled slides' in capsys.readouterr().err
