"""Synthetic paths: the truth next to the volts is so, and the volts are what the atlas says of it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from article_skin import ATLAS, SENSOR, exact
from front_door import refused
from hypothesis import given, settings
from hypothesis import strategies as st

import softslide
from softslide.experiments.studies.partial_contact import pressed
from softslide.features.errors import InputError
from softslide.pipeline.recordings.folder import read_folder
from softslide.pipeline.recordings.truth import COLUMNS, read_truth
from softslide.pipeline.synthesis.distribution import Distribution
from softslide.pipeline.synthesis.motion import Stroke
from softslide.pipeline.synthesis.paths.contact_path import ContactPath, Timing
from softslide.pipeline.synthesis.paths.course import STEP_MM, Course
from softslide.pipeline.synthesis.paths.draw import KINDS, draw_path
from softslide.pipeline.synthesis.paths.partial_contact import partial_friction_parts, touch_depth_mm
from softslide.pipeline.synthesis.paths.response import path_response, path_truth
from softslide.pipeline.synthesis.paths.solved import solved_response
from softslide.pipeline.synthesis.slide_plan import Slide
from softslide.pipeline.synthesis.synthesize import record, synthesize

HEIGHT = 7.0


def drawn(kind: str, seed: int) -> ContactPath:
    return draw_path(0, ATLAS, SENSOR, Distribution(), np.random.default_rng(seed), kind=kind)


def test_a_straight_path_at_one_speed_is_a_slide() -> None:
    """The line synthesis, which goes by splines of the way, and the path's give the same volts."""
    travel, speed, ramp = 58.0, 3.0, 0.1
    slide = Slide(0.0, 7.25, (-29.0, 7.25), Stroke(travel, speed, ramp), 0.5, 0.035, HEIGHT)
    knot = np.arange(round(travel / STEP_MM) + 1)
    to_end = STEP_MM * np.minimum(knot, knot[-1] - knot)
    course = Course((-29.0, 7.25), np.zeros(len(knot) - 1), np.full(len(knot), 0.5))
    timing = Timing(np.minimum(speed, np.sqrt(2 * speed / ramp * to_end)))
    path = ContactPath(course, timing, HEIGHT, 0.035, "line", "line", "constant", 6.0, friction_mm=0.3)
    one, other = (record(plan, exact(), ATLAS, np.random.default_rng(0)) for plan in (slide, path))
    assert path.motion_end_s == pytest.approx(slide.motion_start_s + slide.stroke.duration_s, abs=1e-6)
    assert len(one.volts) == len(other.volts)
    assert np.ptp(one.volts, axis=0)[:2].min() > 0.2
    assert np.abs(one.volts - other.volts).max() < 2e-4
    # It would show: friction that does not get there.
    other = record(replace(path, friction_mm=50.0), exact(), ATLAS, np.random.default_rng(0))
    assert np.abs(one.volts - other.volts).max() > 1e-3


@settings(max_examples=25)
@given(kind=st.sampled_from(KINDS), seed=st.integers(0, 10_000))
def test_truth_is_consistent_for_every_kind(kind: str, seed: int) -> None:
    path = drawn(kind, seed)
    truth = path_truth(path, ATLAS)
    time = truth["time_s"].to_numpy()
    place, velocity = truth[["x_mm", "y_mm"]].to_numpy(), truth[["vx_mm_s", "vy_mm_s"]].to_numpy()
    touching = truth["contact"].to_numpy() == 1
    speed = np.hypot(*velocity.T)
    # Speed is the derivative of place: over any stretch of time the velocity's integral is the way between its ends.
    fine = np.arange(time[0], time[-1], 1e-3)
    moments = path.at(fine)
    middle = path.at(fine[:-1] + 5e-4).velocity_mm_s
    integral = moments.place_mm[0] + np.cumsum(middle * 1e-3, axis=0)
    assert np.abs(integral - moments.place_mm[1:]).max() < 0.02
    # Nothing touches before, after, or out of reach; and something does in between.
    assert not touching[[0, -1]].any()
    assert touching.any()
    assert not touching[(np.abs(place) > 28.0).any(axis=1)].any()
    assert not touching[truth["depth_mm"] < -1.05 * path.height_mm].any()
    # In one piece; only a curve may leave the skin at a corner of the chamber and come back.
    changes = int(np.abs(np.diff(touching.astype(int))).sum())
    assert changes == 2 or (path.shape not in ("line", "press") and changes % 2 == 0)
    moving = (time > path.motion_start_s) & (time < path.motion_end_s)
    assert (speed[~moving] == 0).all()
    assert speed.max() <= path.quickest_mm_s + 1e-9
    # And what is not touched is not tilted.
    values, _ = path_response(path, ATLAS, time)
    untouched = ~touching & (np.abs(place) < 25.0).all(axis=1)
    assert (values[untouched] == 0).all()
    assert np.isfinite(values).all()


@pytest.mark.parametrize("seed", range(4))
def test_each_kind_is_what_it_is_called(seed: int) -> None:
    def truth_of(kind: str) -> tuple[ContactPath, pd.DataFrame]:
        path = drawn(kind, seed)
        truth = path_truth(path, ATLAS)
        return path, truth[truth["contact"] == 1]

    path, line = truth_of("line")
    assert np.ptp(line["depth_mm"]) == 0
    heading = np.rad2deg(np.arctan2(line["vy_mm_s"], line["vx_mm_s"]))
    assert np.abs((heading - path.direction_deg + 180) % 360 - 180).max() < 1e-6
    angle = np.deg2rad(path.direction_deg)
    x, y = line["x_mm"] - SENSOR.reference_mm[0], line["y_mm"] - SENSOR.reference_mm[1]
    assert np.abs(-np.sin(angle) * x + np.cos(angle) * y - path.offset_mm).max() < 1e-6

    _, curve = truth_of("curve")
    heading = np.unwrap(np.arctan2(curve["vy_mm_s"], curve["vx_mm_s"]))
    assert np.ptp(heading) > np.deg2rad(10)

    _, fast = truth_of("speed")
    speed = np.hypot(fast["vx_mm_s"], fast["vy_mm_s"])
    assert speed.max() > 3 * speed.min()
    assert 4.0 < speed.max() < 7.5

    _, stop = truth_of("stop")
    rests = np.hypot(stop["vx_mm_s"], stop["vy_mm_s"]) == 0
    assert rests.sum() / 100 == pytest.approx(0.8, abs=0.02)

    _, back = truth_of("reverse")
    ends = back[["x_mm", "y_mm"]].to_numpy()[[0, -1]]
    assert ends[0] == pytest.approx(ends[1], abs=0.1)
    assert np.hypot(np.ptp(back["x_mm"]), np.ptp(back["y_mm"])) > 15

    for kind, end in (("touchdown", 0), ("lift", -1)):
        path, touch = truth_of(kind)
        assert touch["depth_mm"].iloc[end] < -0.5
        assert (touch[["x_mm", "y_mm"]].iloc[end].abs() < 25).all()
        low = touch[touch["depth_mm"] < 0.1]
        still = np.hypot(low["vx_mm_s"], low["vy_mm_s"]).max() == 0
        assert still == path.shape.endswith("vertical")

    _, depth = truth_of("depth")
    assert 0.3 < np.ptp(depth["depth_mm"]) <= 1.0
    assert (np.diff(depth["depth_mm"]) <= 0).all() or (np.diff(depth["depth_mm"]) >= 0).all()

    _, press = truth_of("press")
    assert (np.hypot(press["vx_mm_s"], press["vy_mm_s"]) == 0).all()
    assert press["depth_mm"].max() > 0.3
    assert np.isnan(path.labels()["direction_deg"])


def test_friction_follows_the_motion_and_stays_at_a_stop() -> None:
    """After a turn back, friction = -1 + 2 exp(-way / friction_mm)."""
    steps = 1000
    heading = np.repeat([0.0, np.pi], steps)
    course = Course((0.0, 0.0), heading, np.full(2 * steps + 1, 0.5))
    friction = course.friction(0.35)
    assert np.hypot(*friction[0]) == 0
    assert friction[steps, 0] == pytest.approx(1.0, abs=1e-6)
    back = STEP_MM * np.arange(steps + 1)
    assert friction[steps:, 0] == pytest.approx(2 * np.exp(-back / 0.35) - 1, abs=1e-6)
    assert np.abs(friction[:, 1]).max() < 1e-12
    timing = Timing(np.full(2 * steps + 1, 2.0), ((steps // 2, 0.8),))
    path = ContactPath(course, timing, HEIGHT, 0.035, "stop", "line", "stop", 6.0, friction_mm=0.35)
    stopped = path.motion_start_s + steps // 2 * STEP_MM / 2.0
    rest = path.at(stopped + np.linspace(0.001, 0.799, 9))
    assert np.ptp(rest.friction, axis=0).max() == 0
    assert (rest.velocity_mm_s == 0).all()
    assert np.ptp(rest.place_mm, axis=0).max() < 1e-9
    assert path.duration_s == pytest.approx(2.0 + 20.0 / 2.0 + 0.8 + 2.0)


def test_partial_contact_meets_the_atlas_and_the_untouched_skin() -> None:
    x, y = np.array([0.0, -8.0, 12.0]), np.array([0.0, 5.0, -10.0])
    shallowest = float(ATLAS.depth_mm[0])
    level = ATLAS.pressure_at(HEIGHT)
    for depth, below, within in ((shallowest, 0.0, 1e-12), (0.5, 0.0, 1e-12), (shallowest, 1e-6, 1e-6)):
        whole = ATLAS.friction_parts(x, y, depth, level)
        part = partial_friction_parts(ATLAS, x, y, np.full(3, depth - below), HEIGHT)
        assert part == pytest.approx(whole, abs=within)
    touch = touch_depth_mm(x, y, HEIGHT, ATLAS)
    assert touch[0] == pytest.approx(-HEIGHT)
    assert (partial_friction_parts(ATLAS, x, y, touch, HEIGHT) == 0).all()
    sizes = [
        np.abs(partial_friction_parts(ATLAS, x, y, touch + part * (shallowest - touch), HEIGHT)).sum()
        for part in np.linspace(0, 1, 9)
    ]
    assert (np.diff(sizes) > 0).all()
    # Beyond the edge of the chamber a sphere of 3 mm radius at 0.5 mm depth reaches sqrt(3^2 - 2.5^2) mm.
    edge = 25 + np.sqrt(3.0**2 - 2.5**2)
    assert touch_depth_mm(np.array([edge]), np.zeros(1), HEIGHT, ATLAS)[0] == pytest.approx(0.5)
    assert np.isinf(touch_depth_mm(np.array([28.1]), np.zeros(1), HEIGHT, ATLAS)[0])


@pytest.mark.long
def test_partial_contact_is_near_the_skins_own_solver() -> None:
    """Vertical presses, solved: within 8 % of the response at the atlas's shallowest depth."""
    for x, y in ((0.0, 0.0), (5.0, 6.0), (-8.0, 5.0), (12.0, -10.0), (2.0, -18.0)):
        press = pressed(SENSOR, HEIGHT, float(ATLAS.depth_mm[0]), x, y)
        assert press is not None
        place = (np.full(len(press.depth_mm), each) for each in (x, y))
        law = partial_friction_parts(ATLAS, *place, press.depth_mm, HEIGHT)[:, 0, :2]
        ends = [each / np.linalg.norm(each[-1]) for each in (law, press.tilt_g)]
        assert np.abs(ends[0] - ends[1]).max() < 0.08


@pytest.mark.parametrize(("kind", "rms", "largest"), [("line", 0.005, 0.03), ("touchdown", 0.03, 0.12)])
def test_a_path_read_from_the_atlas_is_near_the_solved_one(kind: str, rms: float, largest: float) -> None:
    """Apart by some thousandths of the largest tilt; touch-downs, whose atlas is a law, by a few times that."""
    path = drawn(kind, 1)
    time_s = np.arange(0, path.duration_s, 0.08)
    solved, speed = solved_response(SENSOR, path, ATLAS, time_s)
    read, same = path_response(path, ATLAS, time_s)
    assert np.array_equal(speed, same)
    gap = (solved - read)[:, :2] / np.abs(read[:, :2]).max()
    assert 1e-4 < np.sqrt((gap**2).mean()) < rms
    assert np.abs(gap).max() < largest


def test_a_folder_of_slides_and_paths(tmp_path: Path, capsys) -> None:
    """Splits, labels and truth are the contract's; the slides' bytes are those of a folder without paths."""
    for name, options in (("both", ["--slides", "2", "--paths", "10"]), ("lines", ["--slides", "2"])):
        assert softslide.main(["synthesize", *options, "--seed", "4", "--out", str(tmp_path / name)]) == 0
    synthesize(tmp_path / "again", seed=4, paths=10)
    both, lines, again = (tmp_path / name for name in ("both", "lines", "again"))
    for slide in ("s00000", "s00001"):
        one, same = (folder / f"slides/{slide}.parquet" for folder in (both, lines))
        assert one.read_bytes() == same.read_bytes()
        assert not (both / f"slides/{slide}.truth.csv").exists()
    for file in again.glob("slides/*"):
        assert file.read_bytes() == (both / "slides" / file.name).read_bytes()
    folder = read_folder(both)
    tracks = folder.select("track-")
    assert tracks.manifest["split"].tolist() == [f"track-{kind}" for kind in (*KINDS, "line")]
    line, press = tracks.manifest.loc["p00000"], tracks.manifest.loc["p00008"]
    assert line[["direction_deg", "speed_mm_s", "offset_mm", "depth_mm"]].notna().all()
    assert press[["direction_deg", "speed_mm_s", "offset_mm", "travel_mm"]].isna().all()
    assert (line["path"], line["law"]) == ("line", "constant")
    for name in tracks.manifest.index:
        recording = folder.load(name)
        truth = recording.truth
        assert truth is not None
        assert truth.columns.tolist() == list(COLUMNS)
        assert np.diff(truth["time_s"]) == pytest.approx(0.01)
        assert truth["time_s"].iloc[-1] == pytest.approx(recording.time_s[-1], abs=0.011)
    assert folder.load("s00000").truth is None
    for bad in ("--slides 0", "--slides 3 --paths -1", "--slides 3 --solved"):
        refused(capsys, "synthesize", *bad.split(), "--out", tmp_path / "none")
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda v: v.drop(columns="x_mm"), "column 'x_mm' is missing"),
        (lambda v: v.assign(contact=2), "row 1, contact is neither 0 nor 1"),
        (lambda v: v.assign(time_s=v["time_s"].where(v.index < 5, v["time_s"] + 1)), "row 6, time_s"),
        (lambda v: v.assign(vy_mm_s=-v["vy_mm_s"]), "vy_mm_s = .* where y_mm changes by"),
        (lambda v: v.assign(depth_mm="deep"), "row 1, column depth_mm is not a finite number"),
        (lambda v: v[:2], "2 rows"),
    ],
)
def test_truth_that_cannot_be_is_refused(tmp_path: Path, change, message: str) -> None:
    time = np.arange(200) / 100
    places = {"time_s": time, "x_mm": 3 * time, "y_mm": -2 * time}
    good = pd.DataFrame({**places, "vx_mm_s": 3.0, "vy_mm_s": -2.0, "contact": 1})
    path = tmp_path / "one.truth.csv"
    good.to_csv(path, index=False)
    assert len(read_truth(path)) == 200
    assert read_truth(path)["depth_mm"].isna().all()
    change(good).to_csv(path, index=False)
    with pytest.raises(InputError, match=message):
        read_truth(path)
