"""Slides assembled from a grid of presses: each sample is one press, as measured, of the pass that the map names."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from front_door import refused

from softslide.features.angles import touch_channels
from softslide.features.errors import InputError
from softslide.pipeline.checks.report import checked, not_checked
from softslide.pipeline.importers.grid.assemble import import_grid
from softslide.pipeline.importers.grid.grid_map import read_grid_map
from softslide.pipeline.recordings.folder import Folder, read_folder
from softslide.pipeline.sensor import check_design, read_sensor

SIDE, PASSES = 13, 3
SENSOR = """
name = "a printed skin"
sample_rate_hz = 100.0
chamber_mm = [13.0, 13.0]
skin_thickness_mm = 8.0
indenter_diameter_mm = 10.0
pressure_mpa = 0.001
reference_mm = [0.0, 0.0]
adc_step_v = 0.1
[[accelerometer]]
name = "a0"
x_mm = 0.0
y_mm = 0.0
kind = "magnetometer"
unit = "uT"
"""
MAP = """
kind = "grid"
sensor = "sensor.toml"
pass = "pass"
depth = "z_mm"
surface_mm = 145.0
[[split]]
name = "calibration"
passes = [0, 1]
colour = "even"
[[split]]
name = "test"
passes = [2]
colour = "odd"
[[split]]
name = "track-circle"
passes = [2]
paths = "circles"
count = 3
""" + "".join(f'[channels.a0_v{axis}]\ncolumn = "m_{axis}"\nrest = "rest_{axis}"\n' for axis in "xyz")


def write_lab(root: Path, presses: pd.DataFrame) -> Path:
    (root / "sensor.toml").write_text(SENSOR)
    (root / "map.toml").write_text(MAP)
    presses.to_csv(root / "presses.csv", index=False)
    return root / "presses.csv"


def presses() -> pd.DataFrame:
    """A row a press; each change is a number of its own, so that a sample shows which press it is of."""
    random = np.random.default_rng(3)
    number = np.arange(PASSES * SIDE * SIDE)
    p, x, y = np.unravel_index(number, (PASSES, SIDE, SIDE))
    table = pd.DataFrame({"pass": p, "x_mm": x - 6.0, "y_mm": y - 6.0, "z_mm": 143.0})
    for k, axis in enumerate("xyz"):
        table[f"m_{axis}"] = 1000.0 + 100 * number + k
        table[f"rest_{axis}"] = np.round(random.normal(0.0, 2.0, len(table)), 1)
    return table


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> tuple[pd.DataFrame, Folder]:
    root = tmp_path_factory.mktemp("grid")
    source = write_lab(root, presses())
    import_grid(source, read_grid_map(root / "map.toml"), root / "out")
    return presses(), read_folder(root / "out")


def shown(folder: Folder, name: str, table: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """The rows of the presses that a slide's motion shows, and their times."""
    recording, row = folder.load(name), folder.manifest.loc[name]
    half = 0.5 / folder.sensor.sample_rate_hz
    moving = (recording.time_s > row.motion_start_s - half) & (recording.time_s < row.motion_end_s + half)
    # The first press is at the line's start: its rest is what all of the slide stands on.
    rows = table[table["pass"] == int(row["pass"])]
    exact = (recording.volts[moving, 0] - rows[["rest_x"]].to_numpy() - 1000.0) / 100
    number = np.round(exact).astype(int)
    pressed = (np.abs(exact - number) < 1e-6).all(axis=1) & np.isin(number, rows.index).all(axis=1)
    (found,) = number[pressed & (number[:, 0] == rows.index)]
    return found, recording.time_s[moving]


def test_every_sample_is_the_nearest_press_of_its_pass_and_colour(lab) -> None:
    table, folder = lab
    lines = folder.manifest[folder.manifest["direction_deg"].notna()]
    for name, row in lines.iloc[::9].iterrows():
        number, time_s = shown(folder, str(name), table)
        own = table[table["pass"] == int(row["pass"])]
        every = own[(own["x_mm"] + own["y_mm"]) % 2 == (row["split"] == "test")]
        assert np.isin(number, every.index).all()
        way = row.speed_mm_s * (time_s - row.motion_start_s)
        angle = np.deg2rad(row.direction_deg)
        start, course = row[["start_x_mm", "start_y_mm"]].to_numpy(float), [np.cos(angle), np.sin(angle)]
        places = start + way[:, None] * course
        far = np.linalg.norm(every[["x_mm", "y_mm"]].to_numpy() - places[:, None], axis=-1)
        found = np.linalg.norm(table.loc[number, ["x_mm", "y_mm"]].to_numpy() - places, axis=-1)
        np.testing.assert_allclose(found, far.min(axis=1), atol=1e-6)


def test_no_press_is_of_both_calibration_and_test(lab) -> None:
    table, folder = lab
    used = {
        split: {n for name in rows.index for n in shown(folder, str(name), table)[0].tolist()}
        for split, rows in folder.manifest.groupby("split")
    }
    assert used["calibration"]
    assert used["test"]
    assert not used["calibration"] & (used["test"] | used["track-circle"])


def test_lines_take_all_sixteen_lattice_directions(lab) -> None:
    _, folder = lab
    for split in ("calibration", "test"):
        directions = folder.manifest.loc[folder.manifest["split"] == split, "direction_deg"].unique()
        assert len(directions) == 16


def test_labels_and_truth_say_where_the_contact_is(lab) -> None:
    _, folder = lab
    line = folder.manifest[folder.manifest["split"] == "test"].iloc[0]
    assert line.depth_mm == 2.0
    angle = np.deg2rad(line.direction_deg)
    assert line.offset_mm == pytest.approx(-np.sin(angle) * line.start_x_mm + np.cos(angle) * line.start_y_mm)
    circle = folder.load("track-circle-0000")
    assert circle.truth is not None
    on = circle.truth[circle.truth["contact"] == 1]
    middle = on[["x_mm", "y_mm"]].mean()
    radius = np.hypot(on["x_mm"] - middle["x_mm"], on["y_mm"] - middle["y_mm"])
    assert np.ptp(radius) < 0.05 * radius.mean() + 0.2
    assert np.hypot(on["vx_mm_s"], on["vy_mm_s"]).std() < 1e-3


def test_the_folder_says_what_it_is_and_check_is_silent(lab) -> None:
    _, folder = lab
    assert folder.sensor.origin == "assembled"
    assert [f.line() for f in checked(folder).findings] == []
    assert any("accelerometers alone" in line for line in not_checked(folder.sensor))


def test_a_slide_that_lacks_a_press_is_left_out_and_noted(tmp_path: Path) -> None:
    table = presses().drop(index=SIDE * SIDE // 2)  # the middle of pass 0
    source = write_lab(tmp_path, table)
    folder, notes = import_grid(source, read_grid_map(tmp_path / "map.toml"), tmp_path / "out")
    assert any("calibration: left out" in note for note in notes)
    assert json.loads((tmp_path / "out" / "import.json").read_text())["notes"] == notes
    assert all(np.isfinite(folder.load(str(name)).volts).all() for name in folder.manifest.index[::20])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda t: t.drop(columns="m_z"), "column 'm_z' is missing"),
        (lambda t: pd.concat([t, t.iloc[:1]]), "comes twice in pass 0"),
        (lambda t: t.assign(x_mm=t["x_mm"].where(t.index != 5, -5.5)), "off the grid"),
        (lambda t: t.assign(m_x=t["m_x"].where(t.index != 7)), "row 8, column m_x is not a finite number"),
        (lambda t: t[t["pass"] < 2], "no pass 2"),
    ],
)
def test_a_bad_grid_is_refused_in_one_line(tmp_path: Path, capsys, change, says: str) -> None:
    source, out = write_lab(tmp_path, change(presses())), tmp_path / "out"
    assert says in refused(capsys, "import", source, "--map", tmp_path / "map.toml", "--out", out)
    assert not out.exists()


def test_a_magnetometer_answers_on_three_axes_and_has_neither_design_nor_base(tmp_path: Path) -> None:
    write_lab(tmp_path, presses())
    path = tmp_path / "sensor.toml"
    sensor = read_sensor(path)
    assert sensor.touch_axes == "xyz"
    assert touch_channels(3, sensor.touch_axes).tolist() == [0, 1, 2]
    with pytest.raises(InputError, match="magnetometer"):
        check_design(sensor)
    path.write_text(f"{path.read_text()}\n[base]\nzero_g_v = 1.5\n")
    with pytest.raises(InputError, match=r"has a \[base\], and a grid of presses none"):
        read_grid_map(tmp_path / "map.toml")
