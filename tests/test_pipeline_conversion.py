"""Units, calibration, mounting and clocks: what a map says becomes the contract's volts on an even clock."""

import json
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from lab_files import FORMATS, RATE_HZ, a_sensor, slide, write_lab

from softslide.features.errors import InputError
from softslide.pipeline.importers.import_map import Board, Clock, Map, Signal, read_map
from softslide.pipeline.importers.readers.delimited import CsvLayout, read_delimited
from softslide.pipeline.importers.resampling import (
    ClockReport,
    Uneven,
    checked,
    kept,
    resampled,
    seconds,
    whole,
)
from softslide.pipeline.importers.run import import_recordings
from softslide.pipeline.importers.units import POSITIONS, converter, read_calibration
from softslide.pipeline.recordings.folder import read_folder

TURN_90 = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
quick = settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])


def a_map(unit: str = "V", board: Board | None = None, path: Path = Path("map.toml"), **signal) -> Map:
    channels = {f"a0_v{axis}": Signal(axis, unit, **signal) for axis in "xyz"}
    boards = {} if board is None else {"a0": board}
    return Map(path, "csv", a_sensor(), Clock(rate_hz=RATE_HZ), channels, boards=boards)


def in_chunks(time_s: np.ndarray, values: np.ndarray, cuts: list[int]):
    """The samples as a reader would hand them over, cut at the given places."""
    edges = [0, *sorted(cut % len(time_s) for cut in cuts), len(time_s)]
    for start, stop in pairwise(edges):
        if stop > start:
            yield time_s[start:stop], values[start:stop]


def joined(blocks) -> tuple[np.ndarray, np.ndarray]:
    times, values = zip(*blocks, strict=True)
    return np.concatenate(times), np.concatenate(values)


@pytest.mark.parametrize(
    ("unit", "raw", "extra"),
    [
        *(("V", 1.85, {}), ("mV", 1850.0, {}), ("g", 0.25, {}), ("m/s2", 0.25 * 9.80665, {})),
        ("counts", 1000.0, {"volts_per_count": 0.00185}),
        ("counts", 1100.0, {"volts_per_count": 0.00185, "zero_count": 100.0}),
    ],
)
def test_units_become_volts(unit: str, raw: float, extra: dict) -> None:
    np.testing.assert_allclose(converter(a_map(unit, **extra))(np.full((4, 3), raw)), 1.85, rtol=1e-14)


@quick
@given(volts=hnp.arrays(np.float64, (5, 3), elements=st.floats(-10, 10)))
def test_volts_that_need_nothing_keep_every_bit(volts: np.ndarray) -> None:
    np.testing.assert_array_equal(converter(a_map())(volts), volts)


def test_a_turned_and_flipped_board_comes_back_to_the_skins_axes() -> None:
    skin_g = np.random.default_rng(0).normal(0, 0.3, (6, 3))
    board_g = skin_g @ TURN_90 * [1, -1, 1]
    volts = converter(a_map("g", Board(turn_deg=90, flip=("y",))))(board_g)
    np.testing.assert_allclose((volts - 1.65) / 0.8, skin_g, atol=1e-14)


def six_positions(outputs_v: dict) -> pd.DataFrame:
    table = pd.DataFrame(outputs_v, index=["vx", "vy", "vz"]).T.rename_axis("position").reset_index()
    return table.assign(accelerometer="a0")


@quick
@given(seed=st.integers(0, 2**32 - 1))
def test_six_positions_undo_any_board(tmp_path: Path, seed: int) -> None:
    random = np.random.default_rng(seed)
    offset = 1.65 + random.uniform(-0.2, 0.2, 3)
    gain = np.diag(random.uniform(0.6, 1.0, 3)) + random.uniform(-0.03, 0.03, (3, 3))
    six_positions({name: offset + gain @ up for name, up in POSITIONS.items()}).to_csv(
        tmp_path / "six.csv", index=False
    )
    found = read_calibration(tmp_path / "six.csv", "a0")
    np.testing.assert_allclose(found.offset_v, offset, atol=1e-12)
    np.testing.assert_allclose(found.gain_v_per_g, gain, atol=1e-12)
    moved_g = random.normal(0, 0.5, (7, 3))
    convert = converter(a_map("V", Board(calibration="six.csv"), tmp_path / "map.toml"))
    np.testing.assert_allclose((convert(offset + moved_g @ gain.T) - 1.65) / 0.8, moved_g, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda t: t.drop(columns="vy"), "'vy' is missing"),
        (lambda t: t[:5], "one row for each"),
        (lambda t: t.assign(accelerometer="a9"), "one row for each"),
        (lambda t: t.assign(vz=1.65), "hardly responds to gravity"),
        (lambda t: t.assign(vx="?"), "not a number"),
    ],
)
def test_a_bad_six_position_file_is_refused(tmp_path: Path, change, says: str) -> None:
    change(six_positions(POSITIONS)).to_csv(tmp_path / "six.csv", index=False)
    with pytest.raises(InputError, match=says):
        read_calibration(tmp_path / "six.csv", "a0")


@quick
@given(samples=st.integers(2, 120), cuts=st.lists(st.integers(0, 200), max_size=5), seed=st.integers(0, 999))
def test_an_even_clock_keeps_every_bit_however_it_is_cut(samples: int, cuts: list[int], seed: int) -> None:
    time_s, volts = slide(seed, samples)
    time_s = time_s + np.random.default_rng(seed).uniform(-0.02, 0.02, samples) / RATE_HZ
    read = joined(kept([in_chunks(time_s, volts, cuts)], RATE_HZ))
    np.testing.assert_array_equal(read[0], time_s)
    np.testing.assert_array_equal(read[1], volts)


@quick
@given(
    st.integers(40, 200), st.integers(1, 3), st.lists(st.integers(0, 200), max_size=5), st.integers(0, 999)
)
def test_resampling_is_exact_on_a_ramp_and_independent_of_the_cuts(samples, streams, cuts, seed) -> None:
    random = np.random.default_rng(seed)
    sources = []
    for _ in range(streams):
        keep = np.sort(random.choice(samples, int(0.95 * samples), replace=False))
        time_s = ((np.arange(samples) + random.uniform(-0.3, 0.3, samples)) / RATE_HZ)[keep]
        sources.append((time_s, np.column_stack([3 * time_s - 1])))
    whole_blocks = joined(resampled([in_chunks(*s, []) for s in sources], Path("s"), RATE_HZ, 1.0))
    time_s, values = joined(resampled([in_chunks(*s, cuts) for s in sources], Path("s"), RATE_HZ, 1.0))
    np.testing.assert_array_equal(time_s, whole_blocks[0])
    np.testing.assert_array_equal(values, whole_blocks[1])
    np.testing.assert_allclose(np.diff(time_s), 1 / RATE_HZ, rtol=1e-9)
    assert time_s[0] == max(s[0][0] for s in sources)
    assert min(s[0][-1] for s in sources) - time_s[-1] < 1.06 / RATE_HZ
    # A sample within 5 % of a step of the grid is taken as it is.
    np.testing.assert_allclose(values, np.tile(3 * time_s[:, None] - 1, streams), atol=3 * 0.051 / RATE_HZ)


def test_one_lost_sample_leaves_the_others_as_they_were() -> None:
    time_s, volts = slide(0)
    lost = np.delete(np.arange(250), 77)
    with pytest.raises(Uneven):
        joined(kept([in_chunks(time_s[lost], volts[lost], [])], RATE_HZ))
    grid, values = joined(resampled([in_chunks(time_s[lost], volts[lost], [50])], Path("s"), RATE_HZ, 0.1))
    np.testing.assert_allclose(grid, time_s, atol=1e-12)
    np.testing.assert_array_equal(values[lost], volts[lost])
    np.testing.assert_allclose(values[77], (volts[76] + volts[78]) / 2, atol=1e-12)


def test_streams_that_end_apart_are_refused() -> None:
    time_s, volts = slide(0)
    short = in_chunks(time_s[:200], volts[:200], [])
    with pytest.raises(InputError, match="streams end"):
        joined(resampled([in_chunks(time_s, volts, []), short], Path("s"), RATE_HZ, 0.1))


def test_the_largest_gap_is_reported_or_refused(tmp_path: Path) -> None:
    map_path = write_lab(tmp_path, FORMATS["csv"])
    path = tmp_path / "lab" / "one.csv"
    pd.read_csv(path).drop(index=range(20, 25)).to_csv(path, index=False)
    done = import_recordings([tmp_path / "lab"], map_path, tmp_path / "out")
    assert done.notes == ("resampled 1 of 2 recordings onto 100 Hz; largest gap 0.06 s, in one",)
    report = json.loads((tmp_path / "out" / "import.json").read_text())["recordings"]
    assert [entry["resampled"] for entry in report] == [True, False]
    assert report[0]["largest_gap_s"] == pytest.approx(0.06)
    assert len(read_folder(tmp_path / "out").load("one").time_s) == 250
    report, late = ClockReport(), (np.r_[0:0.2:0.01, 0.25], np.zeros((21, 1)))
    with pytest.raises(InputError, match="row 21: a gap"):
        list(checked(iter([late]), path, Clock("t", max_gap_s=0.05), report))


@pytest.mark.parametrize(
    ("raw", "unit", "expected"),
    [
        (np.array([1_700_000_000_000_000_001, 1_700_000_000_010_000_001]), "ns", 0.01),
        (np.array([1_700_000_000_000_000, 1_700_000_000_010_000]), "us", 0.01),
        (np.array([5.0, 15.0]), "ms", 0.01),
        (np.array(["2026-03-01T00:00:00.000001Z", "2026-03-01T00:00:00.010001Z"], object), "timestamp", 0.01),
        (np.array(["2026-03-01 00:00:00", "2026-03-01 00:00:00.01"], object), "timestamp", 0.01),
        (np.array(["2026-03-01T00:00", "2026-03-01T00:01"], "datetime64[s]"), "s", 60.0),
    ],
)
def test_times_lose_nothing(raw: np.ndarray, unit: str, expected: float) -> None:
    unit = "timestamp" if raw.dtype.kind == "M" else unit
    assert seconds(raw, unit, whole(raw, unit)[0])[1] == expected


NUMBERS = hnp.arrays(np.float64, (6, 3), elements=st.floats(-1e6, 1e6))


@quick
@given(st.sampled_from(",;\t|"), st.booleans(), st.integers(0, 4), st.booleans(), NUMBERS)
def test_text_of_any_layout_keeps_every_bit(
    tmp_path, delimiter, comma, header_lines, units_row, volts
) -> None:
    layout = CsvLayout(delimiter, "," if comma and delimiter != "," else ".", header_lines, units_row)
    table = pd.DataFrame(volts, columns=["x", "y", "z"])
    text = table.to_csv(sep=delimiter, decimal=layout.decimal, index=False)
    names, body = text.split("\n", 1)
    units = delimiter.join("VVV") + "\n" if units_row else ""
    (tmp_path / "any.csv").write_text("made by a DAQ\n" * header_lines + f"{names}\n{units}{body}")
    (chunk,) = read_delimited(tmp_path / "any.csv", ["z", "x", "y"], layout)
    np.testing.assert_array_equal(np.column_stack([chunk.columns[c] for c in "xyz"]), volts)


KEYS = "kind time channels labels sheet csv boards signs pattern a0 unit"
keys = st.sampled_from(KEYS.split())
leaves = (
    st.integers() | st.floats() | st.booleans() | st.text(max_size=5) | st.sampled_from(["csv", "V", "s"])
)
values = st.recursive(
    leaves, lambda v: st.lists(v, max_size=2) | st.dictionaries(keys, v, max_size=3), max_leaves=6
)


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(changes=st.dictionaries(keys, values, min_size=1, max_size=4))
def test_any_map_is_read_or_refused_in_one_line(tmp_path: Path, changes: dict) -> None:
    if not (tmp_path / "map.toml").exists():
        write_lab(tmp_path, FORMATS["csv"], ())
    channels = {f"a0_v{axis}": {"column": axis} for axis in "xyz"}
    sound = {"kind": "csv", "sensor": "sensor.toml", "time": {"column": "t"}, "channels": channels}
    (tmp_path / "map.toml").write_text(tomli_w.dumps(sound | changes))
    try:
        read_map(tmp_path / "map.toml")
    except InputError as error:
        assert "\n" not in str(error)  # noqa: PT017


LARGE = """
import sys
from pathlib import Path
from softslide.pipeline.importers.import_map import read_map
from softslide.pipeline.importers.run import import_recordings

root = Path(sys.argv[1])
import_recordings([root / "lab"], root / "map.toml", root / "out")
status = Path("/proc/self/status").read_text()
print(int(status.split("VmHWM:")[1].split()[0]) / 1024)
"""


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the peak of memory is in Linux's /proc")
@pytest.mark.parametrize("name", ["csv", "parquet", "hdf5", "tdms", "mat 7.3"])
def test_a_large_file_needs_no_more_memory_than_a_chunk(tmp_path: Path, name: str) -> None:
    peaks = []
    for samples in (2_100_000, 12_000_000):
        root = tmp_path / str(samples)
        write_lab(root, FORMATS[name], ())
        FORMATS[name].write(root / "lab", "one", *slide(0, samples))
        run = subprocess.run([sys.executable, "-c", LARGE, root], capture_output=True, text=True, check=True)
        peaks.append(float(run.stdout))
    assert peaks[1] < 1000
    assert peaks[1] - peaks[0] < 150
