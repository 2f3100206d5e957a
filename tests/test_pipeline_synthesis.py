"""Synthetic slides: what they show is what their labels, the atlas and the laws of their parts say."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from article_skin import ATLAS, BOARD, FORCE, MIRRORED, SENSOR, exact, of_design
from front_door import refused
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import softslide
from softslide.features.errors import InputError
from softslide.pipeline.atlas.atlas import DEFAULT_SENSOR, Atlas, write_atlas
from softslide.pipeline.checks.report import checked
from softslide.pipeline.checks.zone_signs import sign_agreement
from softslide.pipeline.recordings.folder import Folder, read_folder
from softslide.pipeline.sensor import Accelerometer, design_hash
from softslide.pipeline.skin.solved_line import gravity
from softslide.pipeline.synthesis.board_gravity import in_tilted_sensor, upright
from softslide.pipeline.synthesis.distribution import SCALE_MM, SPLITS, Distribution
from softslide.pipeline.synthesis.electronics import ideal_electronics
from softslide.pipeline.synthesis.motion import Stroke
from softslide.pipeline.synthesis.paths.distribution import PathDistribution
from softslide.pipeline.synthesis.protocol import article_slides
from softslide.pipeline.synthesis.slide_plan import Slide, crossing
from softslide.pipeline.synthesis.specimen import Specimen
from softslide.pipeline.synthesis.synthesize import (
    noise_of,
    plan,
    record,
    sensor_of,
    synthesize,
    synthetic_slides,
)
from softslide.pipeline.synthesis.upsampling import upsampled
from softslide.pipeline.synthesis.viscoelastic_lag import standard_solid

HEIGHT = 7.0


def slide_over(direction, offset, speed, stroke=None, depth=0.5, **changes) -> Slide:
    line = crossing(direction, offset, SENSOR)
    assert line is not None
    start, way, _ = line
    motion = Stroke(**{"travel_mm": way, "speed_mm_s": speed, "ramp_s": 0.05, **(stroke or {})})
    return Slide(direction, offset, start, motion, depth, 0.035, HEIGHT, **changes)


def grams(slide: Slide, specimen: Specimen | None = None, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Time (n,) s and the only board's readings (n, 3) g."""
    recording = record(slide, specimen or exact(), ATLAS, np.random.default_rng(seed))
    return recording.time_s, (recording.volts - 1.65) / 0.8


def test_a_stroke_ramps_goes_and_turns():
    stroke = Stroke(40.0, 8.0, 0.3, back_mm=25.0, dwell_s=0.7)
    time = np.arange(-1, stroke.duration_s + 1, 1e-3)
    forth, back, moving = stroke.at(time)
    way = forth - back
    assert stroke.forth_s == pytest.approx(5.3)
    assert stroke.duration_s == pytest.approx(5.3 + 0.7 + 25 / 8 + 0.3)
    assert (way[time <= 0] == 0).all()
    assert way.max() == pytest.approx(40.0)
    assert way[-1] == pytest.approx(15.0)
    speed = np.abs(np.gradient(way, 1e-3))
    assert speed.max() == pytest.approx(8.0, rel=1e-6)
    assert np.abs(speed - moving).max() < 0.03
    assert np.abs(np.diff(speed)).max() / 1e-3 < 8.0 / 0.3 + 1e-6
    sudden = Stroke(40.0, 8.0, 0.0)
    assert sudden.at(np.array([0.0, 2.5, 5.0, 9.0]))[0] == pytest.approx([0, 20, 40, 40])


def test_the_lag_is_a_standard_solid_and_has_its_limits():
    time = np.arange(0, 4, 0.01)
    step = (time >= 1.0).astype(float)[:, None] + 2
    assert np.array_equal(standard_solid(step, 0.01, 0.0, 0.3), step)
    assert np.array_equal(standard_solid(step, 0.01, 0.4, 0.0), step)
    assert standard_solid(step, 0.01, 0.4, 1e-9) == pytest.approx(step)
    assert standard_solid(step, 0.01, 0.4, 1e9) == pytest.approx(2 + 0.6 * (step - 2), abs=1e-6)
    crept = standard_solid(step, 0.01, 0.4, 0.3)
    since = time - 0.995  # the jump is a straight line between two samples
    wanted = 3 - 0.4 * np.exp(-since / 0.3)
    assert crept[time >= 1, 0] == pytest.approx(wanted[time >= 1], abs=1e-4)
    ramp = standard_solid(time[:, None], 0.01, 0.4, 0.3)
    assert ramp[:, 0] == pytest.approx(time - 0.4 * 0.3 * (1 - np.exp(-time / 0.3)), abs=1e-12)


def test_a_tilted_sensor_turns_every_board_s_gravity():
    random = np.random.default_rng(1)
    boards = Rotation.from_euler("ZYX", random.uniform(-0.6, 0.6, (40, 3)))
    matrices = boards.as_matrix()
    level = gravity(matrices)
    yaw = np.arctan2(matrices[:, 1, 0], matrices[:, 0, 0])
    for tilt in ((0.0, 0.0), (30.0, -20.0), (-70.0, 10.0)):
        up = upright(tilt)
        found = in_tilted_sensor(level[:, :2, None], yaw[:, None], up)[:, :, 0]
        wanted = np.einsum("bij,i->bj", matrices, up) * [-1, -1, 1]
        assert found == pytest.approx(wanted, abs=1e-12)
    on_its_side = in_tilted_sensor(np.zeros((1, 2, 1)), np.zeros((1, 1)), upright((90.0, 0.0)))
    assert on_its_side.ravel() == pytest.approx([1, 0, 0], abs=1e-12)
    with pytest.raises(ValueError, match="impossible together"):
        upright((60.0, 60.0))


def test_cubic_convolution_is_of_third_order():
    errors = []
    for factor in (4, 8, 16, 32):
        step = factor / 320
        slow = np.arange(-1, 320 // factor + 2) * step
        fast = upsampled(np.sin(2 * np.pi * slow)[None], factor)[0]
        errors.append(np.abs(fast - np.sin(2 * np.pi * np.arange(320) / 320)).max())
    rates = np.diff(np.log(errors)) / np.log(2)
    assert (rates > 2.7).all()
    assert np.array_equal(upsampled(np.array([[5.0, 1.0, 2.0, 7.0, 0.0]]), 3)[0, ::3], [1, 2])


@pytest.mark.parametrize("speed", [0.5, 4.0, 13.0, 60.0])
@pytest.mark.parametrize(("direction", "offset"), [(0.0, 3.0), (270.0, -9.0), (37.0, 6.0)])
def test_what_a_slide_shows_is_the_atlas_at_the_labelled_place(speed, direction, offset):
    slide = slide_over(direction, offset, speed, depth_slope=0.003)
    time, found = grams(slide)
    time, found = time[::7], found[::7]
    way = slide.stroke.at(time - slide.motion_start_s)[0]
    assert np.ptp(slide.depths(way)) > 0.1
    level = ATLAS.pressure_at(HEIGHT)
    answer = ATLAS.response(*slide.places(way), direction, slide.depths(way), level)[:, 0]
    wanted = ATLAS.static(level) + answer
    assert np.ptp(wanted[:, 0]) > 0.1
    assert np.abs(found - wanted)[:, :2].max() < 3e-4
    assert np.linalg.norm(found, axis=1) == pytest.approx(1, abs=1e-4)


@settings(max_examples=25)
@given(st.floats(0, 359.9), st.floats(-15, 15), st.floats(1, 30), st.floats(0.3, 1.1))
def test_zones_and_signs_are_the_article_s_on_every_line(direction, offset, speed, depth):
    slide = slide_over(direction, offset, speed, depth=depth)
    recording = record(slide, exact(), ATLAS, np.random.default_rng(0))
    labels = pd.Series(slide.labels())
    assert labels["motion_start_s"] + slide.stroke.forth_s == labels["motion_end_s"]
    agreements, _ = sign_agreement(recording, labels, SENSOR)
    agreement = agreements[0].diagonal()
    assert (agreement[~np.isnan(agreement)] > 0.5).all()
    angle = np.deg2rad(direction)
    for way in (0.0, slide.stroke.travel_mm):
        x, y = slide.places(np.array([way]))
        line = -np.sin(angle) * (x - 5.0) + np.cos(angle) * y
        assert line == pytest.approx(offset, abs=1e-9)


def test_a_slide_begins_and_ends_at_rest_and_one_that_stops_stays():
    _, through = grams(slide_over(0.0, 5.0, 10.0))
    assert through[-1] == pytest.approx(through[0], abs=1e-5)
    whole = crossing(0.0, 5.0, SENSOR)[1]
    _, stopped = grams(slide_over(0.0, 5.0, 10.0, {"travel_mm": 0.6 * whole}))
    assert np.abs(stopped[-1] - stopped[0]).max() > 0.05
    assert stopped[-1000:] == pytest.approx(np.broadcast_to(stopped[-1], (1000, 3)), abs=1e-5)


def test_friction_turns_with_the_motion():
    stroke = {"travel_mm": 40.0, "back_mm": 40.0, "dwell_s": 0.5}
    slide = slide_over(0.0, 5.0, 10.0, stroke, rest_after_s=0.5)
    time, found = grams(slide)
    way_back = slide.stroke.at(time - slide.motion_start_s)[1]
    late = (way_back > 3) & (way_back < 40)
    x, y = slide.places(slide.stroke.travel_mm - way_back[late][::20])
    level = ATLAS.pressure_at(HEIGHT)
    forth, back = (ATLAS.response(x, y, a, 0.5, level)[:, 0] + ATLAS.static(level)[0] for a in (0.0, 180.0))
    assert np.abs(found[late][::20] - back)[:, :2].max() < 5e-4
    assert np.abs(forth - back).max() > 0.01
    turn = (way_back > 0) & (way_back < 0.05)
    assert np.abs(np.diff(found[turn], axis=0)).max() < 1e-3


def test_lag_ripple_posture_and_vibration_each_leave_their_mark():
    slide = slide_over(0.0, 5.0, 10.0)
    time, plain = grams(slide)
    late = grams(slide, exact(delayed=1.0, tau_s=0.1))[1][:, 0]
    # A first-order lag is a delay of tau for what is slow.
    shifted = np.interp(time - 0.1, time, plain[:, 0])
    assert np.abs(late - plain[:, 0]).max() > 5 * np.abs(late - shifted).max()
    rippled = grams(slide, exact(ripple=0.01, ripple_hz=2.0))[1]
    rest = time < slide.motion_start_s
    level = ATLAS.pressure_at(HEIGHT)
    per_ripple = (ATLAS.static(1.01 * level) - ATLAS.static(level))[0, 0]
    assert np.ptp(rippled[rest, 0]) == pytest.approx(2 * per_ripple, rel=0.05)
    tilted = grams(replace(slide, posture_deg=(10.0, -5.0)))[1]
    assert tilted[0, 0] == pytest.approx(np.sin(np.arcsin(plain[0, 0]) + np.deg2rad(10)), abs=0.003)
    assert tilted[0, 1] == pytest.approx(np.sin(np.deg2rad(-5)), abs=0.001)
    shaken = grams(slide, exact(vibration_g=0.01, vibration_hz=100.0))[1] - plain
    rubbing = (time > 4) & (time < 6)
    assert np.abs(shaken[rest]).max() < 1e-6
    assert 0.001 < shaken[rubbing].std() < 0.1
    spectrum = np.abs(np.fft.rfft(shaken[rubbing, 2])) ** 2
    frequency = np.fft.rfftfreq(rubbing.sum(), 1e-3)
    assert (spectrum * frequency).sum() / spectrum.sum() == pytest.approx(100, abs=35)


def test_plans_keep_to_the_distribution_and_test_no_line_of_calibration():
    d = Distribution(height_mm=6.0, depth_mm=0.25)
    slides = [plan(n, 5, ATLAS, SENSOR, d) for n in range(200)]
    assert [s.split for s in slides[:10]] == list(SPLITS)
    assert all(0.5 <= s.stroke.speed_mm_s <= 13 and -17.5 <= s.offset_mm <= 17.5 for s in slides)
    assert all(0.5 <= rest <= 20 for s in slides for rest in (s.motion_start_s, s.rest_after_s))
    ends = np.array([s.depths(np.array([0, s.stroke.travel_mm])) for s in slides])
    assert 0.2 - 1e-9 <= ends.min() < ends.max() < 0.6
    assert 0.2 < np.mean(np.abs(np.diff(ends)) > 1e-6) < 0.6
    assert 0.02 < np.mean([s.stroke.back_mm > 0 for s in slides]) < 0.1
    assert all(s.height_mm == pytest.approx(6.0 * np.cbrt(s.pressure_mpa / 0.035)) for s in slides)
    angles = {split: {s.direction_deg for s in slides if s.split == split} for split in set(SPLITS)}
    assert angles["calibration"] == angles["test"] == {0.0, 90.0, 180.0, 270.0}
    assert len(angles["test-diagonal"]) == 20
    learned, asked = (
        np.array([s.offset_mm for s in slides if s.split == p]) for p in ("calibration", "test")
    )
    assert np.abs(learned[:, None] - asked).min() >= 0.1 - 1e-9


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("made") / "d"
    assert softslide.main(["synthesize", "--slides", "10", "--seed", "7", "--out", str(out)]) == 0
    return out


def test_a_folder_is_what_the_contract_says_and_what_was_yielded(folder):
    read = read_folder(folder)
    assert read.manifest["split"].tolist() == list(SPLITS)
    for slide, recording in synthetic_slides(3, 7):
        again = read.load(slide.name)
        assert np.array_equal(again.volts, recording.volts)
        assert np.allclose(again.time_s, recording.time_s)
        row = read.manifest.loc[slide.name]
        labels = {k: v for k, v in slide.labels().items() if isinstance(v, float)}
        assert all(float(row[k]) == pytest.approx(v) for k, v in labels.items())
    origin = json.loads((folder / "synthesis.json").read_text())
    assert origin["seed"] == 7
    assert origin["atlas_design"] == design_hash(read.sensor)
    assert "never measured" in origin["what"]
    assert "synthetic" in read.sensor.name
    assert [finding for finding in checked(read).findings if finding.level == "error"] == []


def test_the_same_seed_writes_the_same_files_and_another_others(folder, tmp_path):
    synthesize(tmp_path / "again", slides=10, seed=7)
    files = sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    assert len(files) == 13
    assert all((folder / file).read_bytes() == (tmp_path / "again" / file).read_bytes() for file in files)
    other = next(synthetic_slides(1, 8))[1].volts
    assert not np.array_equal(read_folder(folder).load("s00000").volts[:500], other[:500])


def two_boards(valid: bool = True) -> Atlas:
    """The article's board twice, at (-5, 0) and (5, 0), which the default atlas and its mirror image show."""
    sensor = replace(SENSOR, accelerometers=(Accelerometer("a0", -5.0, 0.0), Accelerometer("a1", 5.0, 0.0)))
    solved = ATLAS.valid.copy()
    if not valid:
        solved[10:40, 24] = False
    parts = np.concatenate([MIRRORED, BOARD, FORCE], axis=-1)
    statics = np.concatenate([ATLAS.statics * [-1, 1, 1], ATLAS.statics], axis=1)
    return of_design(sensor, parts=parts, statics=statics, valid=solved)


def test_several_boards_and_another_design(tmp_path):
    atlas = two_boards()
    sensor = sensor_of(atlas)
    assert [a.x_mm for a in sensor.accelerometers] == [-5.0, 5.0]
    assert sensor.reference_mm == (0.0, 0.0)
    write_atlas(atlas, tmp_path / "two.npz")
    made = synthesize(tmp_path / "d", slides=2, atlas=tmp_path / "two.npz", seed=1)
    recording = read_folder(made.root).load("s00000")
    assert recording.volts.shape[1] == 6
    slide = replace(plan(0, 1, atlas, sensor, Distribution()), gain=1.0, posture_deg=(0.0, 0.0))
    quiet = record(slide, Specimen(ideal_electronics(sensor)), atlas, noise_of(0, 1)).volts
    assert quiet[0, 0] - 1.65 == pytest.approx(1.65 - quiet[0, 3], abs=1e-3)
    assert np.corrcoef(recording.volts[:, 3], quiet[:, 3])[0, 1] > 0.8


def test_lines_that_were_not_solved_are_left_out():
    atlas = two_boards(valid=False)
    slides = [plan(n, 2, atlas, sensor_of(atlas), Distribution()) for n in range(20)]
    for n, slide in enumerate(slides):
        assert np.isfinite(
            record(slide, Specimen(ideal_electronics(sensor_of(atlas))), atlas, noise_of(n, 2)).volts
        ).all()
    unsolved = replace(atlas, valid=np.zeros_like(atlas.valid))
    with pytest.raises(InputError, match=r"over solved positions.*lower .skin. height_mm"):
        plan(0, 2, unsolved, sensor_of(atlas), Distribution())


def test_bad_arguments_are_one_line(tmp_path, capsys):
    other, file, out = tmp_path / "other.npz", tmp_path / "file", tmp_path / "d"
    write_atlas(two_boards(), other)
    file.write_text("")
    for arguments, words in (
        (f"--slides 0 --out {out}", "--slides 0: at least one"),
        (f"--slides 1 --seed -1 --out {out}", "--seed -1"),
        (f"--slides 1 --atlas no.npz --out {out}", "no.npz: no such file"),
        (f"--slides 1 --sensor no.toml --out {out}", "no.toml: no such file or folder"),
        (f"--slides 1 --atlas {other} --sensor {DEFAULT_SENSOR.resolve()} --out {out}", "another design"),
        (f"--slides 1 --out {file}", "a file of this name is in the way"),
        (f"--slides 1 --out {file / 'd'}", "cannot be written"),
    ):
        assert words in refused(capsys, "synthesize", *arguments.split())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "other.npz"]


def test_a_configuration_file_changes_what_is_drawn(tmp_path, capsys):
    config = tmp_path / "deeper.toml"
    config.write_text(
        "height_mm = 8.0\npressure_share = [1.0, 1.0]\ndepth_mm = 0.9\nuneven = 0.0\nspeed_mm_s = [6.0, 6.5]\n"
        "offset_mm = [-3.0, 3.0]\nrest_s = [2.0, 2.1]\n[electronics]\nnoise = 0.0\nmains_g = [1e-6, 2e-6]\n"
    )

    def made(name: str, *further: str) -> Folder:
        out = tmp_path / name
        assert softslide.main(["synthesize", "--slides", "2", *further, "--out", str(out)]) == 0
        return read_folder(out)

    quiet, usual = made("quiet", "--config", str(config)), made("usual")
    table = quiet.manifest
    assert (table["depth_mm"] == 0.9).all()
    assert table["height_mm"].to_numpy(dtype=float) == pytest.approx([8.0, 8.0])
    assert table["speed_mm_s"].between(6.0, 6.5).all()
    assert table["offset_mm"].abs().max() <= 3.0 + SCALE_MM

    def noise_v(folder: Folder) -> float:
        start = folder.load("s00000").volts[:400]
        return float(np.std(np.diff(start, axis=0)))

    assert noise_v(quiet) < 0.3 * noise_v(usual)
    config.write_text("height = 8.0\n")
    said = refused(capsys, "synthesize", "--slides", 1, "--config", config, "--out", tmp_path / "x")
    assert "deeper.toml: unknown key 'height'" in said
    assert not (tmp_path / "x").exists()


def test_a_distribution_that_cannot_be_is_refused():
    for kind, change, words in (
        (Distribution, {"speed_mm_s": (5.0, 1.0)}, "must rise"),
        (Distribution, {"rest_s": (0.0, 1.0)}, "must be positive"),
        (Distribution, {"stopping": 0.8, "turning": 0.3}, "at most 1"),
        (Distribution, {"stop_share": (0.0, 0.5)}, "stop_share"),
        (PathDistribution, {"speed_mm_s": (4.0, 2.0)}, "speed_mm_s is .*must rise"),
        (PathDistribution, {"radius_mm": (0.0, 2.0)}, "radius_mm is .*positive"),
    ):
        with pytest.raises(ValueError, match=words):
            kind(**change)
    with pytest.raises(InputError, match=r"outside the atlas's 5..9\.6 mm"):
        plan(0, 0, ATLAS, SENSOR, Distribution(height_mm=12.0))
    with pytest.raises(InputError, match="no line of offset"):
        plan(0, 0, ATLAS, SENSOR, Distribution(chord_mm=80.0))


def test_the_articles_protocol_is_its_512_slides() -> None:
    slides = article_slides(ATLAS, SENSOR, Distribution(), seed=0)
    table = pd.DataFrame([slide.labels() for slide in slides])
    assert len(table) == 512
    assert table["recording"].is_unique
    assert sorted(set(table["speed_mm_s"])) == [0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0]
    assert (table["depth_mm"] == 0.5).all()
    # Places of the lines: of X-slides y, of Y-slides x, from the accelerometer.
    board = SENSOR.accelerometers[0]
    by_direction = table[table["speed_mm_s"] == 1.0].groupby("direction_deg")
    for direction, rows in by_direction:
        along_x = direction in (0.0, 180.0)
        places = rows["start_y_mm"] - board.y_mm if along_x else board.x_mm - rows["start_x_mm"]
        assert sorted(places) == pytest.approx(np.arange(-25 if along_x else 0, 25.1, 2.5), abs=1e-12)
    assert len(by_direction) == 4
    angle = np.deg2rad(table["direction_deg"])
    dx, dy = table["start_x_mm"] - board.x_mm, table["start_y_mm"] - board.y_mm
    assert np.abs(-np.sin(angle) * dx + np.cos(angle) * dy - table["offset_mm"]).max() < 1e-9
    assert slides == article_slides(ATLAS, SENSOR, Distribution(), seed=0)
    assert slides != article_slides(ATLAS, SENSOR, Distribution(), seed=1)
    small = replace(SENSOR, chamber_mm=(30.0, 30.0))
    with pytest.raises(InputError, match="misses the chamber"):
        article_slides(ATLAS, small, Distribution(), 0)
