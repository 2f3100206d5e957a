"""Forces: the card's map against the solver, a scale's readings, and what an estimate says of them."""

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
from small_bundle import write_small_bundle, write_table
from streams import a_sensor, pass_over, still, stream

from softslide.features.card import read_card, write_card
from softslide.features.contact.force_map import ForceMap
from softslide.features.errors import InputError
from softslide.features.estimate import Contact, Estimate
from softslide.features.force import PRESS_BEND, PRESS_SPREAD, ForceReader
from softslide.features.stream.tracker import SlideState
from softslide.models.cnn.fit import CnnConfig
from softslide.models.cnn.inversion import Inversion
from softslide.models.response_map.card import calibrated_forces, force_map
from softslide.models.response_map.select import calibrated_map
from softslide.pipeline.atlas.atlas import DEFAULT_SENSOR, Atlas, read_atlas
from softslide.pipeline.recordings.at_rest import conditioning_for
from softslide.pipeline.recordings.folder import SAMPLE, Folder, read_folder
from softslide.pipeline.recordings.windows import labelled_windows
from softslide.pipeline.sensor import read_sensor
from softslide.pipeline.skin.lines import Line
from softslide.pipeline.skin.solved_line import channels, skin_of, solve_line
from softslide.pipeline.synthesis.synthesize import synthesize
from softslide.serve.localizer import Localizer

HEIGHT_MM, DEPTH_MM = 7.1, 0.5
CHAMBER_MM = (50.0, 50.0)
# A line that is one of no atlas's: X forward along y = -8.3.
LINE = {
    "direction_deg": 0.0,
    "start_x_mm": -29.0,
    "start_y_mm": -8.3,
    "travel_mm": 58.0,
    "depth_mm": DEPTH_MM,
}


@pytest.fixture(scope="module")
def atlas() -> Atlas:
    return read_atlas()


@pytest.fixture(scope="module")
def forces(atlas: Atlas) -> ForceMap:
    return force_map(atlas, CHAMBER_MM, HEIGHT_MM, DEPTH_MM)


@pytest.fixture(scope="module")
def reader(forces: ForceMap) -> ForceReader:
    return ForceReader(forces)


def solved_mn(
    atlas: Atlas, x: np.ndarray, y: np.ndarray, direction_deg: np.ndarray | None, depth_mm: float
) -> np.ndarray:
    return 1e3 * atlas.force(x, y, direction_deg, depth_mm, atlas.pressure_at(HEIGHT_MM))


@pytest.mark.parametrize("depth_mm", [0.35, 0.5, 0.8])
def test_the_map_is_the_solved_force_at_any_place_and_heading(
    atlas: Atlas, reader: ForceReader, depth_mm: float
) -> None:
    """Over the skin as far as a ball's radius from the rim, where the clamp is felt; of the tangential force the error
    is judged next to the whole force, since it vanishes where slope and friction cancel."""
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-22.0, 22.0, (2, 300))
    direction = rng.uniform(0.0, 360.0, 300)
    solved = solved_mn(atlas, x, y, direction, depth_mm)
    read = reader.at(x, y, np.deg2rad(direction), depth_mm)
    size = np.linalg.norm(solved, axis=1)
    assert np.median(np.abs(read[:, 2] / solved[:, 2] - 1)) < 0.02
    assert np.median(np.linalg.norm(read - solved, axis=1) / size) < 0.05
    still_ = reader.at(x, y, None, depth_mm)
    pressed = solved_mn(atlas, x, y, None, depth_mm)
    assert np.median(np.linalg.norm(still_ - pressed, axis=1) / np.linalg.norm(pressed, axis=1)) < 0.05


def labelled(folder: Folder, readings_mn: list[float]) -> Folder:
    rows = folder.manifest.iloc[: len(readings_mn)].assign(**LINE, force_mn=readings_mn)
    return dataclasses.replace(folder, manifest=rows)


@pytest.fixture(scope="module")
def sample() -> Folder:
    return read_folder(SAMPLE)


def test_a_scale_gives_the_factor_and_narrows_the_interval(atlas: Atlas, sample: Folder) -> None:
    fitted = {"height_mm": HEIGHT_MM, "friction": 1.0}
    unread = calibrated_forces(sample, atlas, fitted, DEPTH_MM)
    assert unread.scale_readings == 0
    x = np.arange(-25.0, 25.0, 0.1)
    largest = solved_mn(atlas, x, np.full_like(x, -8.3), np.zeros_like(x), DEPTH_MM)[:, 2].max()
    widths = [unread.relative_sd]
    for count in (1, 4):
        readings = [1.4 * largest] * count
        read = calibrated_forces(labelled(sample, readings), atlas, fitted, DEPTH_MM)
        # The prior of no factor keeps a few percent of it.
        assert read.steps_mn[0] / unread.steps_mn[0] == pytest.approx(1.4, rel=0.03)
        assert read.scale_readings == count
        widths.append(read.relative_sd)
    assert widths == sorted(widths, reverse=True)
    assert widths[1] < 0.3 * widths[0]


def test_a_reading_without_its_line_is_not_used(atlas: Atlas, sample: Folder) -> None:
    folder = labelled(sample, [500.0])
    lost = dataclasses.replace(folder, manifest=folder.manifest.assign(start_x_mm=math.nan))
    assert calibrated_forces(lost, atlas, {"height_mm": HEIGHT_MM}, DEPTH_MM).scale_readings == 0


def test_a_laser_s_height_goes_before_the_fitted_one(atlas: Atlas, sample: Folder) -> None:
    measured = dataclasses.replace(sample, manifest=sample.manifest.assign(skin_height_mm=9.0))
    by_laser = calibrated_forces(measured, atlas, {"height_mm": 6.0}, DEPTH_MM)
    assert by_laser.steps_mn == pytest.approx(force_map(atlas, CHAMBER_MM, 9.0, DEPTH_MM).steps_mn)


def estimated(**values: float) -> Estimate:
    base = {"direction_deg": 0.0, "depth_mm": DEPTH_MM, "x_mm": 4.0, "y_mm": -8.3, "valid": True}
    return Estimate(1.0, SlideState.SLIDE, contact=Contact.SLIDE, **{**base, **values})


def test_an_estimate_carries_the_force_where_it_is(atlas: Atlas, reader: ForceReader) -> None:
    estimate = reader.with_force(estimated())
    x, y, z = solved_mn(atlas, np.array([4.0]), np.array([-8.3]), np.zeros(1), DEPTH_MM)[0]
    assert estimate.force_mn == pytest.approx(z, rel=0.03)
    assert estimate.tangential_force_mn == pytest.approx(math.hypot(x, y), abs=0.05 * z)
    assert estimate.force_lo_mn < estimate.force_mn < estimate.force_hi_mn
    assert estimate.tangential_force_lo_mn < estimate.tangential_force_mn < estimate.tangential_force_hi_mn
    vague = reader.with_force(estimated(x_lo_mm=2.0, x_hi_mm=6.0, y_lo_mm=-14.0, y_hi_mm=-2.0))
    assert vague.force_mn == estimate.force_mn
    assert vague.force_hi_mn - vague.force_lo_mn > estimate.force_hi_mn - estimate.force_lo_mn


def test_a_press_that_grows_has_a_part_of_the_force_and_a_wider_interval(reader: ForceReader) -> None:
    press = estimated()._replace(contact=Contact.PRESS)
    whole = reader.with_force(press)
    assert reader.with_force(press, 1.0) == whole
    part = reader.with_force(press, 0.5)
    assert 0.5 * whole.force_mn < part.force_mn < 0.7 * whole.force_mn
    width = [(e.force_hi_mn - e.force_lo_mn) / e.force_mn for e in (whole, part)]
    assert width[1] > width[0]
    assert reader.with_force(press, 0.0).force_mn == 0.0


@pytest.mark.long
def test_a_solved_press_s_force_grows_with_its_outputs_by_its_law() -> None:
    """At two places on the article's design, down from clear of the skin; the law is that of `ForceReader`."""
    sensor = read_sensor(DEFAULT_SENSOR)
    skin = skin_of(sensor)
    pressure, inflated = skin.inflate_to(HEIGHT_MM)
    face = sensor.skin_thickness_mm + sensor.indenter_diameter_mm / 2
    down = np.arange(face + 8.0, face - DEPTH_MM - 1e-9, -0.25)
    for place in ((-12.0, 7.0), (9.0, -11.0)):
        centres = np.column_stack([np.tile(place, (len(down), 1)), down])
        postures, forces = skin.slide(inflated, pressure, centres)
        tilts = np.array(
            [channels(skin, posture, inflated)[:2] for posture in postures if posture is not None]
        )
        assert len(tilts) == len(down)
        gain = tilts @ tilts[-1] / (tilts[-1] @ tilts[-1])
        seen = (gain > 0.1) & (gain < 0.95)
        assert seen.sum() > 5
        gain, share = gain[seen], forces[seen, 2] / forces[-1, 2]
        off = share / (gain * (1 + PRESS_BEND * (1 - gain))) - 1
        assert (np.abs(off) < PRESS_SPREAD * (1 - gain)).mean() > 0.8


def test_after_the_slide_it_is_the_largest_on_its_line(atlas: Atlas, reader: ForceReader) -> None:
    ended = reader.with_force(estimated(x_mm=26.0)._replace(state=SlideState.ENDED))
    x = np.arange(-25.0, 25.0, 0.1)
    solved = solved_mn(atlas, x, np.full_like(x, -8.3), np.zeros_like(x), DEPTH_MM)[:, 2]
    assert ended.force_mn == pytest.approx(solved.max(), rel=0.03)


@pytest.mark.parametrize("unknown", [{"valid": False}, {"x_mm": math.nan}])
def test_without_a_valid_place_there_is_no_force(reader: ForceReader, unknown: dict) -> None:
    assert math.isnan(reader.with_force(estimated(**unknown)).force_mn)


def test_a_bundle_carries_the_map_and_one_without_it_works_as_before(
    tmp_path: Path, forces: ForceMap
) -> None:
    volts = stream(still(0.6), pass_over(1.2), still(0.6))
    bundle = write_small_bundle(tmp_path / "old", a_sensor())
    old = Localizer.load(bundle).push(volts)
    assert all(math.isnan(estimate.force_mn) for estimate in old)
    size = (bundle / "model.json").stat().st_size
    write_card(dataclasses.replace(read_card(bundle / "model.json"), force=forces), bundle / "model.json")
    assert (bundle / "model.json").stat().st_size - size < 13_000
    new = Localizer.load(bundle).push(volts)
    assert any(estimate.force_mn > 100.0 for estimate in new)
    assert [e.force_mn > 0 for e in new] == [e.valid for e in new]
    fields = [name for name in Estimate._fields if "force" not in name]
    assert [[repr(getattr(e, f)) for f in fields] for e in new] == [
        [repr(getattr(e, f)) for f in fields] for e in old
    ]


OUT_OF_SHAPE = [{"coefficients": "AAAA"}, {"steps_mn": [1.0]}, {"steps_mn": 12 * [-1.0]}, {"knots": 3}]


@pytest.mark.parametrize("change", [*OUT_OF_SHAPE, {"relative_sd": 0.0}])
def test_a_force_map_out_of_shape_is_refused(
    tmp_path: Path, forces: ForceMap, change: dict[str, object]
) -> None:
    bundle = write_small_bundle(tmp_path / "bad", a_sensor())
    table = json.loads((bundle / "model.json").read_text())
    table["force"] = dataclasses.asdict(forces) | change
    table.pop("card_sha256")
    write_table(bundle, table)
    with pytest.raises(InputError, match="does not fit"):
        read_card(bundle / "model.json", unsigned=True)


@pytest.mark.long
def test_the_force_of_estimated_slides_is_the_solved_one_on_held_out_lines(
    tmp_path: Path, atlas: Atlas
) -> None:
    """Synthetic slides: the map calibrated on their calibration lines, test lines estimated by inverting it, and the
    force where the estimate says, next to the solved one where the object is. The height is fitted: that alone
    is 5 % of the force here; one slide with a scale takes it away."""
    folder = synthesize(tmp_path / "made", slides=60, seed=3)
    config = CnnConfig()
    calibration = folder.select("calibration")
    conditioning = conditioning_for(calibration, config.conditioning)
    found = calibrated_map(calibration, atlas, conditioning, config.calibration, config.spread)
    fitted = calibrated_forces(found.folder, atlas, found.summary, found.response.depth_mm)
    weighed = _weighed(found.folder, atlas)
    by_scale = calibrated_forces(weighed, atlas, found.summary, found.response.depth_mm)
    windows = labelled_windows(folder.select("test"), found.conditioning, (0.4, 0.5, 0.6, 0.7, 0.8))
    inversion = Inversion(found.response, found.conditioning.block_s)
    rows = inversion.predict(windows.volts, windows.elapsed_s).astype(float)
    row = dict(zip(inversion.outputs, rows.T, strict=True))
    angle = np.arctan2(row["direction_sin"], row["direction_cos"])
    place = _place(angle, row["offset_mm"], row["along_mm"], folder)
    true_angle = np.deg2rad(windows.direction_deg)
    true_place = _place(true_angle, windows.offset_mm, windows.along_mm, folder)
    labels = folder.manifest.loc[windows.recording]
    solved = np.array(
        [
            1e3 * atlas.force(x[None], y[None], a, d, atlas.pressure_at(h))[0]
            for x, y, a, d, h in zip(
                *true_place, windows.direction_deg, windows.depth_mm, labels["height_mm"], strict=True
            )
        ]
    )
    believed = row["misfit"] < 2.0
    assert believed.mean() > 0.8
    for forces in (fitted, by_scale):
        read = ForceReader(forces).at(*place, angle, row["depth_mm"])
        off = np.abs(read[:, 2] / solved[:, 2] - 1)[believed]
        size = np.linalg.norm(solved, axis=1)[believed]
        in_plane = np.abs(np.hypot(*read.T[:2]) - np.hypot(*solved.T[:2]))[believed] / size
        assert (off < 1.645 * forces.relative_sd).mean() > 0.85
        assert np.median(in_plane) < 0.05
    assert np.median(off) < 0.05


def _weighed(folder: Folder, atlas: Atlas) -> Folder:
    """The folder with the largest normal force of its first slide along x, as solved."""
    table = folder.manifest.assign(force_mn=math.nan)
    slide = table.index[table["direction_deg"] == 0.0][0]
    row = table.loc[slide]
    x = row["start_x_mm"] + np.arange(0.0, row["travel_mm"], 0.2)
    level = atlas.pressure_at(row["height_mm"])
    solved = atlas.force(x, np.full_like(x, row["start_y_mm"]), 0.0, row["depth_mm"], level)
    table.loc[slide, "force_mn"] = 1e3 * np.nanmax(solved[:, 2])
    return dataclasses.replace(folder, manifest=table)


def _place(
    angle: np.ndarray, offset_mm: np.ndarray, along_mm: np.ndarray, folder: Folder
) -> tuple[np.ndarray, np.ndarray]:
    x, y = folder.sensor.reference_mm
    return (
        x - offset_mm * np.sin(angle) + along_mm * np.cos(angle),
        y + offset_mm * np.cos(angle) + along_mm * np.sin(angle),
    )


@pytest.mark.long
def test_another_mesh_gives_the_force_within_five_percent(reader: ForceReader) -> None:
    """One line solved with elements of 2 mm, two layers of them, instead of 2.5 mm and one."""
    sensor = read_sensor(DEFAULT_SENSOR)
    finer = dataclasses.replace(sensor, mesh=dataclasses.replace(sensor.mesh, size_mm=2.0, layers=2))
    along = np.arange(-27.5, 27.6, 1.25)
    pressure, inflated = skin_of(finer).inflate_to(HEIGHT_MM)
    values, _ = solve_line(finer, Line(0, 1, -8.3), along, DEPTH_MM, pressure, inflated)
    solved = 1e3 * values[:, -3:]
    over = np.isfinite(solved[:, 2]) & (np.abs(along) < 22.0)
    read = reader.at(along, np.full_like(along, -8.3), np.zeros_like(along), DEPTH_MM)
    off = np.abs(read[over, 2] / solved[over, 2] - 1)
    in_plane = np.abs(np.hypot(*read[over].T[:2]) - np.hypot(*solved[over].T[:2]))
    in_plane /= np.linalg.norm(solved[over], axis=1)
    assert np.median(off) < 0.05
    assert np.median(in_plane) < 0.05
