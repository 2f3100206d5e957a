"""Re-calibration: the gains of another day from one stroke or one press, and the bundle that carries them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from bump_map import bump_map
from calibration_slides import slides_of
from dome_map import dome_map
from front_door import refused
from network_bundle import write_network_bundle
from small_bundle import write_small_bundle
from touched_skin import SENSOR

from softslide import main
from softslide.features.stream.conditioning import Conditioning
from softslide.models.cnn.forward_model import TABLE
from softslide.models.export.bundle import read_graph
from softslide.models.export.gains import COMMON_SD, Press, fit_gains, labelled_contacts
from softslide.models.response_map.card import contact_calibration, response_of
from softslide.pipeline.recordings.folder import Recording, read_folder, write_folder
from softslide.serve.bundle import open_bundle

TRUE = np.array([1.12, 1.15, 1.18])
REST, SPEED = 200, 20.0


def write_day(folder: Path, pressed: bool) -> Path:
    """One stroke along y = 3, or one press at (4, -2), of the sensor with other gains and another zero."""
    response, count = dome_map(), 280
    if pressed:
        x, y = np.full(count, 4.0), np.full(count, -2.0)
    else:
        x, y = -14.0 + SPEED * np.arange(count) / 200.0, np.full(count, 3.0)
    volts = 190.0 + np.zeros((2 * REST + count, 3))
    volts[REST : REST + count] += TRUE * response.response(x, y, 0.0)
    volts += 1e-3 * np.random.default_rng(0).standard_normal(volts.shape)
    row = {
        "recording": "one",
        "split": "today",
        "start_x_mm": x[0],
        "start_y_mm": y[0],
        "motion_start_s": REST / 200.0,
        "motion_end_s": (REST + count - 1) / 200.0,
        "depth_mm": 0.5,
    }
    if not pressed:
        row |= {"direction_deg": 0.0, "speed_mm_s": SPEED, "offset_mm": 3.0, "travel_mm": x[-1] - x[0]}
    recording = Recording("one", np.arange(len(volts)) / 200.0, volts)
    write_folder(folder, SENSOR, pd.DataFrame([row]), [recording])
    return folder


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of the formula's map, with a network that was not trained."""
    folder, touch = tmp_path_factory.mktemp("bundle") / "model", Conditioning(touch_axes="xyz", onset="touch")
    contact = contact_calibration(dome_map())
    return write_network_bundle(folder, dome_map(), SENSOR, conditioning=touch, contact=contact)


def test_a_stroke_without_offset_and_moments_is_placed_by_its_signal(
    bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    day = write_day(tmp_path / "day", pressed=False)
    table = pd.read_csv(day / "manifest.csv")
    table[["offset_mm", "motion_start_s", "motion_end_s"]] = np.nan
    table.to_csv(day / "manifest.csv", index=False)
    words = ["recalibrate", "--model", bundle, "--recordings", day, "--out", tmp_path / "new"]
    assert main([str(word) for word in words]) == 0
    said = capsys.readouterr()
    found = json.loads(said.out)
    assert found["strokes"] == 1
    assert list(found["gain"].values()) == pytest.approx(TRUE, rel=0.05)
    assert "motion_start_s of 1" in said.err


@pytest.mark.parametrize("pressed", [False, True])
def test_one_stroke_or_press_renews_the_gains_of_map_and_graph(
    bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], pressed: bool
) -> None:
    before = {path.name: path.read_bytes() for path in bundle.iterdir()}
    day, out = write_day(tmp_path / "day", pressed), tmp_path / "new"
    assert main(["recalibrate", "--model", str(bundle), "--recordings", str(day), "--out", str(out)]) == 0
    report = json.loads(capsys.readouterr().out)
    gain = np.array(list(report["gain"].values()))
    assert (report["strokes"], report["presses"]) == (int(not pressed), int(pressed))
    # A press has shown one place of each channel; a stroke all of a line.
    np.testing.assert_allclose(gain, TRUE, atol=0.06 if pressed else 0.02)
    assert report["residual"] < 0.5 * report["residual_before"]
    # What opens has a graph and a card that belong together, and an example that it gives.
    card, _ = open_bundle(out)
    ratio = response_of(card).coefficients / np.where(
        dome_map().coefficients, dome_map().coefficients, np.nan
    )
    np.testing.assert_allclose(np.nanmedian(ratio, axis=(0, 1, 2)), gain, rtol=2e-3)
    old, new = (
        next(
            np.frombuffer(i.raw_data, np.float32) for i in read_graph(b).graph.initializer if i.name == TABLE
        )
        for b in (bundle, out)
    )
    columns = np.repeat(gain, 4)
    np.testing.assert_allclose(new.reshape(-1, 12), old.reshape(-1, 12) * columns, rtol=1e-3, atol=1e-6)
    assert card.provenance["recalibrations"][0]["data"]["slides"]
    assert {path.name: path.read_bytes() for path in bundle.iterdir()} == before


def test_what_is_for_reporting_is_fitted_only_where_it_is_named(
    bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    day = write_day(tmp_path / "day", pressed=True)
    table = pd.read_csv(day / "manifest.csv").assign(split="test-day")
    table.to_csv(day / "manifest.csv", index=False)
    words = ("recalibrate", "--model", bundle, "--recordings", day, "--out", tmp_path / "new")
    assert "--split is needed: every recording" in refused(capsys, *words)
    assert main([*map(str, words), "--split", "test"]) == 0
    assert json.loads(capsys.readouterr().out)["presses"] == 1


@pytest.mark.parametrize(
    ("labels", "stands"),
    [
        ({}, True),
        ({"speed_mm_s": 0.0, "direction_deg": 90.0}, True),
        ({"travel_mm": 0.0}, True),
        ({"travel_mm": 40.0}, False),
        ({"direction_deg": 90.0}, False),
        ({"speed_mm_s": 5.0}, False),
    ],
)
def test_a_contact_that_moves_is_not_taken_for_a_press(
    tmp_path: Path, labels: dict[str, float], stands: bool
) -> None:
    """A path of its own kind has a start and a travel, and neither direction nor speed."""
    folder = read_folder(write_day(tmp_path / "day", pressed=True))
    folder = replace(folder, manifest=folder.manifest.assign(**labels))
    _, presses, left_out = labelled_contacts(folder, Conditioning(touch_axes="xyz", onset="touch"), {})
    assert (len(presses), left_out) == ((1, []) if stands else (0, ["one"]))


def test_gains_fall_back_to_the_prior_where_nothing_shows() -> None:
    response = dome_map()
    dark = dome_map(coefficients=response.coefficients * np.array([1.0, 1.0, 0.0]))
    shown = dark.response(np.array([4.0]), np.array([5.0]), 0.0)[0]
    gains = fit_gains(dark, [], [Press((4.0, 5.0), 0.5, 1.15 * shown)])
    assert gains.gain[:2] == pytest.approx([1.15, 1.15], abs=0.03)
    # A channel that shows nothing follows what all share, and is known by its own spread alone.
    assert gains.gain[2] == pytest.approx(1.13, abs=0.03)
    assert gains.sd[:2].max() < gains.sd[2] < COMMON_SD


def test_accelerometers_gains_are_found_along_one_stroke() -> None:
    response, true = bump_map(), np.array([0.9, 0.95])
    (slide,) = slides_of(response, [(30.0, 4.0)], [4.0], [1.0])
    slide.volts[:] *= true
    gains = fit_gains(response, [slide], [])
    np.testing.assert_allclose(gains.gain, true, atol=0.01)
    assert gains.residual_v < 0.1 * gains.before_v
    assert (gains.sd > response.gain_sd).all()
    assert (fit_gains(response, [slide] * 4, []).sd < 0.6 * response.gain_sd).all()


def test_what_cannot_be_renewed_is_refused_in_one_line(
    bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    day = write_day(tmp_path / "day", False)
    small = write_small_bundle(tmp_path / "small", SENSOR)
    for model, extra, reason in (
        (small, [], "holds no response map"),
        (bundle, ["--split", "tomorrow"], "label one"),
    ):
        words = ("recalibrate", "--model", model, "--recordings", day, "--out", tmp_path / "o", *extra)
        assert reason in refused(capsys, *words)
    assert not (tmp_path / "o").exists()
