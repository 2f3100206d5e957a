"""Files altered at random, in every format that is read: taken, or refused in one line. Seeded."""

import io
import os
import resource
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from readers import CHANNELS, manifest, recording, slide

from softslide.experiments.configuration import configured
from softslide.features.errors import InputError
from softslide.models.registry import model_named
from softslide.pipeline.atlas import atlas as atlases
from softslide.pipeline.atlas.atlas import read_atlas, write_atlas
from softslide.pipeline.importers.import_map import read_map
from softslide.pipeline.importers.sources import find_sources
from softslide.pipeline.recordings.folder import SAMPLE, read_folder
from softslide.pipeline.recordings.slide_file import write_slide
from softslide.pipeline.recordings.truth import read_truth
from softslide.pipeline.sensor import read_sensor

WORDS = "nan inf -1 0 1e308 -1e308 1e999 1_0 0x7fffffff true [[x]] = # ] \" ' ; ,"
HOSTILE = [
    *(word.encode() for word in WORDS.split()),
    *(b"9" * 30, b"9" * 5000, b"[" * 300, b"{" * 300, b"," * 5000, b"../" * 20, b"\x1b[2J"),
    *(b"\0", b"\xff", b"\xef\xbb\xbf", b"\n", b"\r"),
]
# Memory that the whole test may add, and seconds after which a file counts as a hang.
MOST_KB = 400_000
HANG_S = 120


def configuration(path: Path) -> None:
    configured(model_named("trees").config(), path, "trees")


def atlas(path: Path) -> None:
    found = read_atlas(path)
    level = float(found.pressure_mpa[0])
    found.response(np.array([0.0, 3.0]), np.array([0.0, -2.0]), 30.0, float(found.depth_mm[0]), level)


CONFIGURATION = """trees = 150
least_leaf = 6
seed = 7
[conditioning]
rest_blocks = 1500
trigger_v = 0.005
block_s = 0.02
touch_axes = "xy"
"""
MAP = """sensor = "sensor.toml"
kind = "csv"
pattern = '(?P<name>x\\d+)_(?P<speed>[\\d.]+)\\.csv'
[time]
column = "t"
unit = "ms"
[channels]
a0_vx = { column = "x", unit = "mV" }
a0_vy = { column = "y", unit = "mV" }
a0_vz = { column = "z", unit = "counts", volts_per_count = 0.001 }
[labels]
speed_mm_s = { name = "speed", scale = 10.0 }
direction_deg = { value = 90.0 }
"""


def slides() -> dict[str, bytes]:
    """The same short slide in CSV and in Parquet."""
    time_s, place = np.arange(40) / 1000, io.BytesIO()
    volts = np.round(1.65 + np.random.default_rng(0).normal(0, 0.01, (40, 3)), 4)
    write_slide(place, time_s, volts, CHANNELS)
    rows = [",".join(("time_s", *CHANNELS))]
    rows += [f"{t:.3f},{x},{y},{z}" for t, (x, y, z) in zip(time_s, volts.tolist(), strict=True)]
    return {".csv": ("\n".join(rows) + "\n").encode(), ".parquet": place.getvalue()}


def small_atlas(folder: Path) -> bytes:
    whole, few = read_atlas(), slice(None, None, 12)
    small = replace(whole, x_mm=whole.x_mm[few], y_mm=whole.y_mm[few], valid=whole.valid[few, few])
    write_atlas(replace(small, parts=whole.parts[:, few, few]), folder / "a.npz")
    return (folder / "a.npz").read_bytes()


SLIDES = slides()
SENSOR = (SAMPLE / "sensor.toml").read_bytes()
MANIFEST = (SAMPLE / "manifest.csv").read_bytes().splitlines(keepends=True)[:8]
TRUTH = ["time_s,x_mm,y_mm,vx_mm_s,vy_mm_s,contact,depth_mm"]
TRUTH += [f"{k / 100:.2f},{k / 10:.1f},0.0,10.0,0.0,1,0.5" for k in range(30)]
# By format: a suffix, a sound file's content (or what makes it), and what reads it.
FORMATS: dict[str, tuple[str, Any, Callable[[Path], Any]]] = {
    "configuration": (".toml", CONFIGURATION.encode(), configuration),
    "sensor": (".toml", SENSOR, read_sensor),
    "map": (".toml", MAP.encode(), read_map),
    "manifest": (".csv", b"".join(MANIFEST), manifest),
    "truth": (".csv", "\n".join(TRUTH).encode() + b"\n", read_truth),
    **{f"slide in {suffix}": (suffix, content, slide) for suffix, content in SLIDES.items()},
    **{f"recording in {suffix}": (suffix, content, recording) for suffix, content in SLIDES.items()},
    "atlas": (".npz", small_atlas, atlas),
}


def altered(content: bytes, random: np.random.Generator) -> bytes:
    """One to three alterations: bits, bytes lost or repeated, an end cut off, something hostile put in."""
    for _ in range(random.integers(1, 4)):
        size = len(content)
        at, to = sorted(random.integers(0, size + 1, 2).tolist())
        to = min(to, at + 60)
        match int(random.integers(0, 6)):
            case 0 if size:
                place = int(random.integers(0, size))
                flipped = content[place] ^ (1 << int(random.integers(0, 8)))
                content = content[:place] + bytes([flipped]) + content[place + 1 :]
            case 1:
                content = content[:at] + content[to:]
            case 2:
                content = content[:to] + content[at:]
            case 3:
                content = content[:at]
            case _:
                word = HOSTILE[int(random.integers(0, len(HOSTILE)))]
                content = content[:at] + word + content[min(at + int(random.integers(0, 8)), size) :]
    return content


def hang(number: int, frame: object) -> None:
    raise TimeoutError(f"no answer within {HANG_S} s")


@pytest.mark.parametrize("count", [60, pytest.param(4000, marks=pytest.mark.long)])
@pytest.mark.parametrize("name", FORMATS)
def test_altered_files_are_taken_or_refused_in_one_line(tmp_path: Path, name: str, count: int) -> None:
    suffix, content, read = FORMATS[name]
    (tmp_path / "sensor.toml").write_bytes(SENSOR)
    content = content if isinstance(content, bytes) else content(tmp_path)
    path, refused = tmp_path / f"altered{suffix}", 0
    path.write_bytes(content)
    read(path)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    signal.signal(signal.SIGALRM, hang)
    random = np.random.default_rng(len(name))
    for n in range(count):
        path.write_bytes(altered(content, random))
        signal.alarm(HANG_S)
        said = ""
        try:
            read(path)
        except InputError as error:
            said = str(error)
        finally:
            signal.alarm(0)
        refused += bool(said)
        assert said.isprintable(), (n, said)
        assert len(said) < 1100, (n, said)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < MOST_KB
    assert refused > (400 if count == 4000 else 0)


@pytest.mark.parametrize("name", ["sensor.toml", "manifest.csv"])
def test_a_pipe_in_the_place_of_a_file_is_refused(tmp_path: Path, name: str) -> None:
    for other in ("sensor.toml", "manifest.csv"):
        (tmp_path / other).write_bytes((SAMPLE / other).read_bytes())
    (tmp_path / name).unlink()
    os.mkfifo(tmp_path / name)
    with pytest.raises(InputError, match="not a regular file"):
        read_folder(tmp_path)


def test_an_atlas_that_unpacks_beyond_any_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(atlases, "MOST_UNPACKED_BYTES", 100_000)
    with pytest.raises(InputError, match="more than any atlas"):
        read_atlas()


def test_a_map_s_pattern_takes_a_time_in_proportion_to_a_name(tmp_path: Path) -> None:
    """Matched by trial and error, this one would try 2^200 ways to divide the name."""
    (tmp_path / "sensor.toml").write_bytes((SAMPLE / "sensor.toml").read_bytes())
    (tmp_path / "map.toml").write_text(MAP.replace("(?P<name>x\\d+)", "(?P<name>(x+)+!)"))
    (tmp_path / f"{200 * 'x'}_1.csv").touch()
    signal.alarm(HANG_S)
    try:
        with pytest.raises(InputError, match="fits the map"):
            find_sources([tmp_path], read_map(tmp_path / "map.toml"))
    finally:
        signal.alarm(0)


def test_what_a_file_holds_does_not_reach_the_terminal(tmp_path: Path) -> None:
    """An escape sequence in a column's name would clear the screen, or write what was never said."""
    (tmp_path / "m.csv").write_text("recording,file,split\x1b[2J\u202e\nx,y,z\n")
    with pytest.raises(InputError, match="column 'split' is missing"):
        manifest(tmp_path / "m.csv")
    assert str(InputError("a\x1b[2J\u202e\nb")) == "a\\x1b[2J\\u202e\\nb"
    assert len(str(InputError("x" * 10**6))) < 1100
