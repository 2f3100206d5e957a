"""docs/messages.md: wrong input, and what is said. `python tests/test_docs_messages.py` writes the page."""

import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "worlds")]

from readers import manifest, recording, slide  # noqa: E402

from softslide.command_line import with_option  # noqa: E402
from softslide.features.errors import InputError  # noqa: E402
from softslide.features.units import impossible_output  # noqa: E402
from softslide.pipeline.recordings.folder import SAMPLE  # noqa: E402
from softslide.pipeline.sensor import read_sensor  # noqa: E402
from softslide.serve.bundle import open_bundle  # noqa: E402
from softslide.serve.stream.framing import framing_of  # noqa: E402

PAGE = ROOT / "docs" / "messages.md"
SENSOR = (SAMPLE / "sensor.toml").read_text()
MANIFEST = (
    "recording,file,split,direction_deg,speed_mm_s,offset_mm\nr1,slides/r1.parquet,calibration,{},2.0,5.0\n"
)
ROW = MANIFEST.format(0)
CSV = "time_s,a0_vx,a0_vy,a0_vz\n0.000,1.65,1.65,2.45\n0.001,1.65,1.65,2.45\n0.002,1.65,1.65,2.45\n"
HEAD = """# What is said of wrong input

Each line is what the command prints after its name, with exit status 2: the file, the place, what is wrong, what to do.
Made by `python tests/test_docs_messages.py`; the tests check that it is what the code says.

| wrong input | message |
|---|---|
"""


def stream(path: Path) -> None:
    list(framing_of("csv", 3).read(path.read_bytes()))


def sensor_with(old: str, new: str) -> bytes:
    assert old in SENSOR
    return SENSOR.replace(old, new, 1).encode()


# What was done, the file's name, its content, and what reads it.
CASES: list[tuple[str, str, bytes, Callable[[Path], object]]] = [
    ("a manifest separated by semicolons", "manifest.csv", ROW.replace(",", ";").encode(), manifest),
    ("saved by a spreadsheet as UTF-16", "manifest.csv", ROW.encode("utf-16"), manifest),
    ("saved in Windows' cp1252", "manifest.csv", MANIFEST.format("0°").encode("cp1252"), manifest),
    ("an Excel workbook by that name", "manifest.csv", b"PK\x03\x04...", manifest),
    ("an empty manifest", "manifest.csv", b"", manifest),
    ("a column twice", "manifest.csv", b"recording,file,split,split\nr1,a,b,c\n", manifest),
    ("a column is missing", "manifest.csv", b"recording,file\nr1,a\n", manifest),
    ("a misspelt label", "manifest.csv", ROW.replace("speed_mm_s", "speed_mms").encode(), manifest),
    ("a text for a number", "manifest.csv", MANIFEST.format("east").encode(), manifest),
    ("an angle out of range", "manifest.csv", MANIFEST.format(400).encode(), manifest),
    ("zero bytes from a bad disk", "manifest.csv", ROW.encode() + b"\0" * 9, manifest),
    ("an unknown key", "sensor.toml", sensor_with("chamber_mm", "chamber_cm"), read_sensor),
    ("no number", "sensor.toml", sensor_with("sample_rate_hz = 1000.0", "sample_rate_hz = nan"), read_sensor),
    ("a quoted number", "sensor.toml", sensor_with("_hz = 1000.0", '_hz = "1 kHz"'), read_sensor),
    ("no TOML", "sensor.toml", b"name: my-sensor\n", read_sensor),
    ("an empty slide", "slides/r1.parquet", b"", slide),
    ("a slide cut short", "slides/r1.parquet", b"PAR1\x15\x04", slide),
    ("a text in a slide's cell", "slides/r1.csv", CSV.replace("1.65", "#REF!", 1).encode(), slide),
    ("a slide's column is missing", "slides/r1.csv", CSV.replace("a0_vz", "vz").encode(), slide),
    ("a lost sample", "slide.csv", (CSV + "0.009,1.65,1.65,2.45\n").encode(), recording),
    ("time that runs back", "slide.csv", (CSV + "0.001,1.65,1.65,2.45\n").encode(), recording),
    ("another rate", "slide.csv", CSV.replace("0.00", "0.01").replace("0.010", "0.000").encode(), recording),
    ("another kind of file", "slide.xlsx", b"PK\x03\x04", recording),
    ("an altered bundle", "my-model/model.json", b"{}", lambda path: open_bundle(path.parent)),
    ("words in a stream", "standard input", b"1,2,3\nERROR 7\n", stream),
    ("a control sequence in a stream", "standard input", b"1,2,3\n\x1b[2J\n", stream),
    ("too many numbers in a line", "standard input", b"1,2,3\n1,2,3,4,5\n", stream),
]
# Outputs at rest in another unit, as check and import say it.
UNITS = {
    "millivolts taken for volts": 1000.0 * np.array([1.65, 1.65, 2.45]),
    "g taken for volts": np.array([0.0, 0.0, 1.0]),
    "counts of a converter taken for volts": np.array([2048.0, 2048.0, 3041.0]),
}


def said(folder: Path, name: str, content: bytes, read: Callable[[Path], object]) -> str:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    try:
        read(path)
    except InputError as error:
        return with_option(error).replace(f"{folder}/", "")
    return ""


def page(folder: Path) -> str:
    rows = []
    for number, (what, name, content, read) in enumerate(CASES):
        message = said(folder / str(number), name, content, read)
        rows.append((what, f"{name}: {message}" if name == "standard input" else message))
    part = read_sensor(SAMPLE / "sensor.toml").accelerometers[0]
    rows += [(what, f"{part.name}: {impossible_output(rest, asdict(part))}") for what, rest in UNITS.items()]
    return HEAD + "".join(f"| {what} | `{message.replace('|', chr(92) + '|')}` |\n" for what, message in rows)


def test_the_page_is_what_the_code_says(tmp_path: Path) -> None:
    assert PAGE.read_text(encoding="utf-8") == page(tmp_path)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case[0])
def test_wrong_input_is_one_line_with_its_file(tmp_path: Path, case) -> None:  # type: ignore[no-untyped-def]
    message = said(tmp_path, *case[1:])
    assert message
    assert message.isprintable()
    assert case[1] == "standard input" or Path(case[1]).name in message


if __name__ == "__main__":
    from tempfile import TemporaryDirectory

    with TemporaryDirectory() as scratch:
        PAGE.write_text(page(Path(scratch)), encoding="utf-8")
