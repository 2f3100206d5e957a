"""One map over heights of the skin: what slides show of it, the graph that takes a height, and what shows one."""

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import onnxruntime as ort
import pandas as pd
import pytest
import torch
from bump_map import bump_map
from bump_slides import as_recorded, at_rest
from calibration_slides import slides_of
from hypothesis import given
from hypothesis import strategies as st
from network_bundle import a_window, untrained
from small_bundle import resigned, write_bundle_of

from softslide.features.card import read_card
from softslide.features.errors import InputError
from softslide.features.height import HEIGHT_INPUT, HeightCalibration
from softslide.features.stream.conditioning import Conditioning
from softslide.models.cnn.height_input import with_height
from softslide.models.cnn.network import BEND_OUTPUTS
from softslide.models.export.bundle import read_graph
from softslide.models.export.formats import of_one_window
from softslide.models.export.gains import fit_gains, labelled_contacts
from softslide.models.graph.from_torch import export_graph
from softslide.models.registry import model_named
from softslide.models.response_map.calibrate import calibrate
from softslide.models.response_map.card import (
    calibrated_heights,
    contact_calibration,
    static_heights_mm,
)
from softslide.models.response_map.from_atlas import SensorSpread
from softslide.models.response_map.map import ResponseMap
from softslide.models.response_map.select import _Known, _shares_at_other_heights, calibrated_map
from softslide.models.response_map.slide_fit import CalibrationConfig
from softslide.models.response_map.slides import (
    CalibrationSlide,
    calibration_slides,
    main_height_mm,
    scatter_about,
)
from softslide.pipeline.recordings.derived_labels import recordings_to_learn_from, why_not_labelled
from softslide.pipeline.recordings.folder import SAMPLE, Folder, read_folder, write_folder
from softslide.pipeline.recordings.heights import (
    HEIGHT,
    LASER,
    alike_mpa,
    is_other,
    main_pressure_mpa,
    with_heights,
)
from softslide.pipeline.sensor import Accelerometer, Sensor
from softslide.serve.bundle import open_bundle
from softslide.serve.localizer import Localizer

SENSOR = Sensor(
    "bump", 500.0, (50.0, 50.0), 4.0, 6.0, 0.035, (5.0, 0.0), 5e-4, (Accelerometer("a0", 5.0, 0.0),)
)
MAIN_MM = 7.0
STATIC_V_PER_MM = 0.01  # of V_x
LINES = [(d, o) for d in (0.0, 90.0, 180.0, 270.0, 37.0, 142.0) for o in np.arange(-20.0, 21.0, 5.0)]


def over_heights() -> ResponseMap:
    """A map whose V_x grows by 12 % of itself a mm of height, and V_y by 4 %."""
    plain = bump_map()
    slope = (plain.coefficients[0] * np.array([0.12, 0.04])).astype(np.float16).astype(float)
    return replace(plain, height_mm=MAIN_MM, height_slope=slope, height_range_mm=(6.0, 8.0))


def heights_of(count: int) -> np.ndarray:
    return np.where(np.arange(count) % 3 == 0, 6.0, np.where(np.arange(count) % 3 == 1, 8.0, MAIN_MM))


@pytest.fixture(scope="module")
def slides() -> list[CalibrationSlide]:
    """Slides at three heights; most are at the middle one."""
    heights = heights_of(len(LINES))
    heights[:30] = MAIN_MM
    ones = np.ones(len(LINES))
    return slides_of(over_heights(), LINES, 3.0 * ones, ones, 1.4e-3, heights_mm=heights)


@pytest.fixture(scope="module")
def calibrated(slides: list[CalibrationSlide]) -> ResponseMap:
    truth = over_heights()
    # The design's change with height is another one, by 0.8.
    start = replace(truth, coefficients=0 * truth.coefficients, height_slope=truth.height_slope / 0.8)
    return calibrate(slides, start, False, CalibrationConfig())[0]


def test_a_map_over_heights_is_that_of_each(calibrated: ResponseMap) -> None:
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(-18.0, 19.0, 3.0), np.arange(-18.0, 19.0, 3.0)))
    assert (calibrated.height_mm, calibrated.height_range_mm) == (MAIN_MM, (6.0, 8.0))
    for height_mm in (6.0, 7.4, 8.0):
        wanted, without = (
            m.response(x, y, 0.7) for m in (over_heights().at(height_mm=height_mm), over_heights())
        )
        error = np.abs(calibrated.at(height_mm=height_mm).response(x, y, 0.7) - wanted)
        assert np.sqrt(np.mean(error**2)) < 1.5e-3
        if height_mm != 7.4:
            assert np.sqrt(np.mean((wanted - without) ** 2)) > 3e-3


def test_the_main_height_is_that_of_most_slides_however_a_laser_reads_it() -> None:
    read_mm = [6.41, 6.43, *np.linspace(6.98, 7.02, 5), 7.71, 7.72]
    ones = np.ones(len(read_mm))
    slides = slides_of(over_heights(), LINES[: len(read_mm)], 3.0 * ones, ones, heights_mm=np.array(read_mm))
    assert main_height_mm(slides) == pytest.approx(7.0)


def test_slides_of_one_height_are_fitted_as_if_none_were_known(slides: list[CalibrationSlide]) -> None:
    alike = [slide for slide in slides if slide.height_mm == MAIN_MM]
    unknown = [replace(slide, height_mm=math.nan) for slide in alike]
    blank = replace(bump_map(), coefficients=0 * bump_map().coefficients)
    one, other = (
        calibrate(each, blank, False, CalibrationConfig(iterations=1))[0] for each in (alike, unknown)
    )
    assert one.height_slope is None
    np.testing.assert_array_equal(one.coefficients, other.coefficients)


@pytest.fixture(scope="module")
def plain() -> bytes:
    """A graph of the map at its main height; exporting takes seconds."""
    return export_graph(untrained(over_heights()), 1).SerializeToString()


@pytest.fixture(scope="module")
def graph(plain: bytes) -> bytes:
    """Of the map over heights."""
    return with_height(onnx.load_model_from_string(plain), over_heights()).SerializeToString()


def test_a_graph_is_that_of_the_height_it_is_given(graph: bytes) -> None:
    response = over_heights()
    session = ort.InferenceSession(graph)
    assert [node.name for node in session.get_inputs()] == ["volts", "elapsed_s", "weight"]
    for off_mm in (None, 0.0, -0.6, 0.9):
        given = {} if off_mm is None else {HEIGHT_INPUT: np.full(1, off_mm, np.float32)}
        row = session.run(None, a_window() | given)[0]
        own = response.at(height_mm=MAIN_MM + (off_mm or 0.0))
        with torch.no_grad():
            wanted = untrained(own)(*(torch.tensor(value) for value in a_window().values())).numpy()
        # The table of a height is rounded to half precision where it is exported by itself, which moves the odds of a
        # straight way the most.
        limit = np.full(row.shape[1], 5e-3 if off_mm else 1e-4)
        if off_mm:
            limit[[name in BEND_OUTPUTS for name in untrained(own).outputs]] = 0.05
        assert (np.abs(row - wanted) <= limit * (1.0 + np.abs(wanted))).all()


def test_a_graph_as_c_is_for_the_main_height(tmp_path: Path, graph: bytes) -> None:
    (tmp_path / "model.onnx").write_bytes(graph)
    inputs = of_one_window(read_graph(tmp_path)).graph.input
    assert {value.name for value in inputs} == {"volts", "elapsed_s", "weight"}


@pytest.fixture(scope="module")
def heights() -> HeightCalibration:
    found = calibrated_heights(over_heights())
    assert found is not None
    return found


def test_gains_scale_the_change_with_height(heights: HeightCalibration) -> None:
    scaled = calibrated_heights(over_heights().scaled(np.array([1.1, 0.9])))
    assert scaled is not None
    np.testing.assert_allclose(scaled.splines(2), heights.splines(2) * [1.1, 0.9], rtol=2e-3, atol=1e-6)


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory, graph: bytes, heights: HeightCalibration) -> Path:
    off_mm = heights_of(40) - MAIN_MM
    scatter = np.random.default_rng(0).normal(0.0, 1e-3, (len(off_mm), 3))
    statics = (
        np.array([resting(MAIN_MM + off).mean(axis=0) for off in off_mm[:3]])[np.arange(40) % 3] + scatter
    )
    static = scatter_about(np.column_stack([np.ones_like(off_mm), off_mm]), statics)
    contact = contact_calibration(over_heights(), tuple(static.v_per_mm[:2].tolist()), static)
    cards = {"heights": heights, "contact": contact, "intervals": {}}
    outputs = untrained(over_heights()).outputs
    out = tmp_path_factory.mktemp("heights") / "m"
    return write_bundle_of(out, graph, a_window(), SENSOR, model="cnn", outputs=outputs, **cards)


def resting(height_mm: float) -> np.ndarray:
    """Three seconds at rest, the skin at a height."""
    signal = at_rest(SENSOR, 3.0) + np.array([0.05 + height_mm * STATIC_V_PER_MM, 0.0, 0.0])
    return as_recorded(SENSOR, signal, seed=3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"height_mm": 9.0}, "not among"),
        ({"lowest_mm": 8.0}, "do not rise"),
        ({"knots": 5}, "not like the one of contact"),
    ],
)
def test_a_card_of_impossible_heights_is_refused(
    bundle: Path, tmp_path: Path, change: dict[str, object], message: str
) -> None:
    card = json.loads((bundle / "model.json").read_text())
    del card["card_sha256"]
    (tmp_path / "model.json").write_text(json.dumps(card | {"heights": card["heights"] | change}))
    with pytest.raises(InputError, match=message):
        read_card(tmp_path / "model.json", unsigned=True)


def test_a_graph_that_takes_no_height_is_refused_where_its_card_has_several(
    bundle: Path, plain: bytes, tmp_path: Path
) -> None:
    mine = Path(shutil.copytree(bundle, tmp_path / "m"))
    resigned(mine, plain)
    with pytest.raises(InputError, match="takes no height"):
        open_bundle(mine)


def test_a_stream_is_read_at_the_height_it_shows_or_is_given(bundle: Path) -> None:
    assert read_card(bundle / "model.json").heights is not None
    localizer = Localizer.load(bundle)
    assert localizer.push(resting(7.6))[-1].skin_height_mm == pytest.approx(7.6, abs=0.1)
    off_mm = localizer._inputs[HEIGHT_INPUT]
    assert off_mm == pytest.approx(0.6, abs=0.1)
    localizer.reset()
    assert math.isnan(localizer.read().skin_height_mm)
    assert off_mm == 0.0
    given = Localizer.load(bundle, 6.5)
    assert given.push(resting(7.6))[-1].skin_height_mm == 6.5
    assert given._inputs[HEIGHT_INPUT] == pytest.approx(-0.5)
    with pytest.raises(InputError, match="the bundle is for 6"):
        Localizer.load(bundle, 5.0)


def test_a_tracker_does_not_depend_on_an_earlier_stream(bundle: Path) -> None:
    fresh, used = Localizer.load(bundle), Localizer.load(bundle)
    for height_mm in (7.04, 7.01):
        used._take_height(height_mm)
    used.reset()
    for localizer in (fresh, used):
        localizer._take_height(7.035)
    x, y = np.array([3.0]), np.array([4.0])
    trackers = (each._contact._tracker for each in (fresh, used))
    one, other = (tracker._surface.at(x, y) for tracker in trackers if tracker is not None)
    np.testing.assert_array_equal(one, other)


def test_no_column_of_a_lab_is_taken_for_a_height_or_a_weight() -> None:
    """Synthetic recordings have `height_mm`; it is what was drawn, and not known to a calibration."""
    folder = read_folder(SAMPLE).select("calibration")
    table = folder.manifest.iloc[:2].assign(height_mm=["6.0", "8.0"], calibration_weight="none")
    learnt = recordings_to_learn_from(replace(folder, manifest=table), True)
    slides = calibration_slides(learnt, Conditioning())
    assert [slide.weight for slide in slides] == [1.0, 1.0]
    assert all(math.isnan(slide.height_mm) for slide in slides)


def test_heights_follow_from_readings_and_pressures() -> None:
    folder = read_folder(SAMPLE)
    table = folder.manifest.iloc[:4].assign(pressure_mpa=[0.035, 0.035, 0.028, 0.044])
    unread = with_heights(replace(folder, manifest=table)).manifest[HEIGHT]
    np.testing.assert_allclose(unread, 7.5 * np.cbrt(table["pressure_mpa"] / 0.035))
    readings = {LASER: ["", "7.1", "6.4", ""]}
    read = with_heights(replace(folder, manifest=table.assign(**readings))).manifest[HEIGHT]
    assert list(read[:3]) == pytest.approx([7.1, 7.1, 6.4])
    power = math.log(7.1 / 6.4) / math.log(0.035 / 0.028)
    assert read.iloc[3] == pytest.approx(7.1 * (0.044 / 0.035) ** power)
    assert HEIGHT not in with_heights(replace(folder, manifest=table.iloc[:2])).manifest
    # What is not a height is left out.
    few = table.iloc[:3].assign(**{LASER: ["7.1", "0", "-1"]})
    found = with_heights(replace(folder, manifest=few)).manifest[HEIGHT]
    np.testing.assert_allclose(found, 7.1 * np.cbrt(few["pressure_mpa"] / 0.035))


@pytest.mark.parametrize(("readings_mm", "several"), [((6.4, 7.1, 7.8), True), ((7.0, 7.1, 7.15), False)])
def test_a_laser_shows_several_heights_where_no_pressure_is_noted(
    readings_mm: tuple[float, ...], several: bool
) -> None:
    folder = read_folder(SAMPLE).select("calibration")
    table = folder.manifest.iloc[:9].assign(pressure_mpa=np.nan, **{LASER: np.repeat(readings_mm, 3)})
    folder = replace(folder, manifest=table)
    learned = recordings_to_learn_from(folder, True).manifest
    assert len(learned) == 9
    assert (HEIGHT in learned) is several
    if several:
        assert list(learned[HEIGHT]) == pytest.approx(np.repeat(readings_mm, 3))
    assert len(recordings_to_learn_from(folder)) == (3 if several else 9)


@given(seed=st.integers(0, 1000), off=st.floats(0.001, 0.019))
def test_a_gauge_that_reads_one_pressure_unevenly_shows_one_pressure(seed: int, off: float) -> None:
    """Three of eight recordings are at another; the others' readings are up to 1.9 % off."""
    folder = read_folder(SAMPLE)
    random = np.random.default_rng(seed)
    read_mpa = np.r_[np.full(3, 0.028), 0.035 * (1 + random.uniform(-off, off, 5))]
    random.shuffle(read_mpa)
    folder = replace(folder, manifest=folder.manifest.iloc[:8].assign(pressure_mpa=read_mpa))
    main_mpa, pressures = main_pressure_mpa(folder), folder.manifest["pressure_mpa"]
    # No choice has more of them within the 2 % that a regulator holds.
    assert (~is_other(pressures, main_mpa)).sum() == max((~is_other(pressures, p)).sum() for p in pressures)
    assert sorted(alike_mpa(pressures).unique()) == [0.028, pytest.approx(0.035, rel=off)]


def test_a_model_over_heights_learns_from_every_pressure() -> None:
    folder = read_folder(SAMPLE).select("calibration")
    pressures = np.where(np.arange(len(folder)) % 4 == 0, 0.028, 0.035)
    folder = replace(folder, manifest=folder.manifest.assign(pressure_mpa=pressures))
    assert len(recordings_to_learn_from(folder, True)) == len(folder)
    assert not why_not_labelled(folder, True)
    assert len(recordings_to_learn_from(folder)) == (pressures == 0.035).sum()


def test_both_kinds_of_map_are_judged_on_held_out_lines() -> None:
    """Thirty slides at another height: the true map over heights is better than their own map, a wrong one is not."""
    lines = LINES[:30]
    others = slides_of(
        over_heights(), lines, *3.0 * np.ones((1, 30)), np.ones(30), 1.4e-3, heights_mm=np.full(30, 8.0)
    )
    main = slides_of(over_heights(), LINES[:2], [3.0, 3.0], [1.0, 1.0], 1.4e-3, heights_mm=[MAIN_MM] * 2)
    used = [replace(s, recording=f"m{n}") for n, s in enumerate(main * 20)] + others
    names = np.array([s.recording for s in others])
    right = over_heights()
    wrong = replace(right, height_slope=-3 * right.height_slope)
    known = _Known(None, SENSOR, SensorSpread(), CalibrationConfig(iterations=1))
    shares = [_shares_at_other_heights(used, [(m, names)], known) for m in (right, wrong)]
    assert shares[0]["map_over_heights"] < shares[0]["map_a_height"]
    assert shares[1]["map_a_height"] < shares[1]["map_over_heights"]
    assert shares[0]["map_a_height"] == shares[1]["map_a_height"]
    # Of heights all over a range none has a map of its own: even a wrong one over heights leaves no slide out.
    spread = [replace(s, height_mm=s.height_mm + 0.02 * n) for n, s in enumerate(others)]
    assert _shares_at_other_heights(used[: -len(others)] + spread, [(wrong, names)], known) == {}


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    """The sample's fastest calibration slides; some once more, of a skin 1 mm higher, which answers and tilts more."""
    folder = read_folder(SAMPLE).select("calibration")
    fastest = folder.manifest.loc[folder.manifest["speed_mm_s"].nlargest(28).index]
    again = fastest.iloc[::4].assign(pressure_mpa=0.05, **{LASER: 8.0}).rename(index="{}-higher".format)
    recordings = [folder.load(str(name)) for name in fastest.index]
    for one in recordings[::4]:
        rest = one.volts[one.time_s < fastest["motion_start_s"][one.name]].mean(axis=0)
        volts = rest + [0.01, 0.0, 0.0] + 1.15 * (one.volts - rest)
        recordings.append(replace(one, name=f"{one.name}-higher", volts=volts))
    table = pd.concat([fastest.assign(**{LASER: 7.0}), again])
    return write_folder(tmp_path_factory.mktemp("heights") / "lab", folder.sensor, table, recordings)


def test_recordings_at_two_heights_make_one_map(lab: Folder) -> None:
    cnn = model_named("cnn").config()
    conditioning, config = replace(cnn.conditioning, delayed=0.1), replace(cnn.calibration, iterations=2)
    found = calibrated_map(recordings_to_learn_from(lab, True), None, conditioning, config, cnn.spread)
    assert found.slides == 35
    assert found.response.height_mm == 7.0
    here, there = (found.response.at(height_mm=h).coefficients[0] for h in (7.0, 8.0))
    assert (here * there).sum() / (here**2).sum() == pytest.approx(1.15, abs=0.04)
    contact = found.contact(None)
    shown_mm = static_heights_mm(found.folder, found.conditioning, contact, found.heights)
    heights = np.array([shown_mm[name] for name in found.folder.manifest.index])
    np.testing.assert_allclose(heights, found.folder.manifest[HEIGHT], atol=0.2)
    # Strokes of another day at the other height show no other gains.
    again = replace(lab, manifest=lab.manifest[lab.manifest[LASER].astype(float) == 8.0])
    shown_mm = static_heights_mm(again, found.conditioning, contact, found.heights)
    strokes, _, _ = labelled_contacts(again, found.conditioning, shown_mm)
    gains = fit_gains(found.response, strokes, []).gain
    np.testing.assert_allclose(gains, 1.0, atol=0.03)
