"""What the static output shows of the skin's height: a law for each thing that changes it."""

import math
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from dome_map import dome_map
from small_bundle import write_small_bundle
from streams import RATE_HZ, a_sensor
from touched_skin import SENSOR
from tracked_map import TWO_BOARDS, noisy_map

from softslide.features.contact.calibration import ContactCalibration, encoded
from softslide.features.estimate import Reason
from softslide.features.height import HeightCalibration
from softslide.features.rest_height import LEAST_OFF_MM, RestHeight, rest_height
from softslide.features.stream.conditioning import Conditioning
from softslide.models.response_map.card import contact_calibration
from softslide.models.response_map.slides import LEAST_RECORDINGS, scatter_about, static_scatter
from softslide.pipeline.recordings.folder import SAMPLE, read_folder
from softslide.serve.localizer import Localizer

# Volts of 0.8 V/g about 1.65 V; two boards that lean over by 5 degrees, away from each other, as the chamber's do.
LEVEL = np.array([1.65, 1.65, 2.45])
LEAN_V = 0.07
RISE_V_PER_MM = 0.01


def rise_of(boards: int) -> np.ndarray:
    """(3 A,) V/mm"""
    signs = np.array([-1.0, 1.0])[2 - boards :]
    return np.concatenate([[sign * RISE_V_PER_MM, 0.0, 0.0] for sign in signs])


def statics_of(boards: int) -> np.ndarray:
    return np.tile(LEVEL, boards) + LEAN_V / RISE_V_PER_MM * rise_of(boards)


def leaning(static_v: np.ndarray, x_deg: float, y_deg: float) -> np.ndarray:
    """(3 A,) V: the same of a device that leans over towards x and then y."""
    (cx, sx), (cy, sy) = ((np.cos(a), np.sin(a)) for a in np.radians([x_deg, y_deg]))
    turn = np.array([[1, 0, 0], [0, cy, sy], [0, -sy, cy]]) @ np.array([[cx, 0, sx], [0, 1, 0], [-sx, 0, cx]])
    return (1.65 + (static_v - 1.65).reshape(-1, 3) @ turn.T).ravel()


def scattered(boards: int, tilt_deg: float, count: int = 60) -> np.ndarray:
    """(n, 3 A) V: statics of slides, the device's tilt drawn anew for each."""
    random = np.random.default_rng(7)
    turned = [leaning(statics_of(boards), *(tilt_deg * random.standard_normal(2))) for _ in range(count)]
    return np.array(turned) + random.normal(0.0, 3e-4, (count, 3 * boards))


def calibration(boards: int, tilt_deg: float) -> ContactCalibration:
    statics = scattered(boards, tilt_deg)
    places = TWO_BOARDS[:boards]
    touch = [c for c in range(3 * boards) if c % 3 < 2]
    rise = tuple(rise_of(boards)[touch].tolist())
    found = scatter_about(np.ones((len(statics), 1)), statics)
    return contact_calibration(noisy_map(places=places), rise, found)


def judge(boards: int, tilt_deg: float, heights: HeightCalibration | None = None) -> RestHeight:
    accelerometers = [asdict(a) for a in a_sensor(boards).accelerometers]
    return RestHeight(calibration(boards, tilt_deg), heights, accelerometers, 1.0)


@pytest.mark.parametrize("tilt_deg", [0.0, 1.0])
def test_two_accelerometers_notice_a_height_however_the_device_stands(tilt_deg: float) -> None:
    height = judge(2, tilt_deg)
    for off_mm in (-0.6, 0.5):
        for lean_deg in ((0.0, 0.0), (3.0, -2.0)):
            static = leaning(statics_of(2) + off_mm * rise_of(2), *lean_deg)
            assert height.off_mm(static) == pytest.approx(off_mm, abs=0.1)
            assert height.is_other(static)


def test_a_tilt_or_a_gain_common_to_all_is_not_a_height() -> None:
    height = judge(2, 0.0)
    for static in (leaning(statics_of(2), 4.0, 0.0), 1.65 + 1.05 * (statics_of(2) - 1.65)):
        assert abs(height.off_mm(static)) < LEAST_OFF_MM / 2
        assert not height.is_other(static)


@pytest.mark.parametrize(("boards", "tilt_deg"), [(1, 0.0), (1, 1.0), (2, 0.0), (2, 1.0)])
def test_a_static_output_that_scatters_as_in_the_calibration_is_not_a_height(
    boards: int, tilt_deg: float
) -> None:
    height = judge(boards, tilt_deg)
    assert not any(height.is_other(static) for static in scattered(boards, tilt_deg, 400))


def test_one_accelerometer_notices_a_height_where_nothing_else_moves_its_output() -> None:
    """A tilt that scatters in the calibration, another gain and another mounting are not a height."""
    height, higher = judge(1, 0.0), statics_of(1) + 0.6 * rise_of(1)
    assert height.is_other(higher)
    assert not judge(1, 1.0).is_other(higher)
    assert not height.is_other(1.65 + 1.05 * (statics_of(1) - 1.65))
    remounted = leaning(statics_of(1), 1.0, 1.0)
    assert math.isnan(height.off_mm(remounted))
    assert not height.is_other(remounted)


def six_to_eight_mm() -> HeightCalibration:
    flat, scale_v = encoded(np.zeros((4, 4, 1)))
    return HeightCalibration(flat, scale_v, 4, 7.0, 6.0, 8.0)


@pytest.mark.parametrize(("boards", "tilt_deg"), [(1, 0.0), (2, 0.0), (2, 1.0)])
def test_the_static_output_shows_the_height(boards: int, tilt_deg: float) -> None:
    """Of two accelerometers however the device stands; of one where it stands as in the calibration."""
    height, rest, rise = judge(boards, tilt_deg, six_to_eight_mm()), statics_of(boards), rise_of(boards)
    assert height.shows
    lean_deg = (2.0, -1.0) if boards > 1 else (0.0, 0.0)
    for off_mm in (-1.0, 0.3, 1.0):
        static = leaning(rest + off_mm * rise, *lean_deg)
        assert height.height_mm(static) == pytest.approx(7.0 + off_mm, abs=0.15)
    # A little beyond what it was calibrated at, and far beyond.
    assert height.height_mm(rest + 1.15 * rise) == 8.0
    assert math.isnan(height.height_mm(rest + 2.5 * rise))
    # The zeros of one have shifted.
    assert math.isnan(height.height_mm(rest + 0.3 * rise + np.pad([0.0, 0.02, -0.02], (0, 3 * boards - 3))))


def test_a_magnetometer_shows_the_height_by_all_its_outputs() -> None:
    rest, rise = np.array([0.2, -0.1, 3.0]), np.array([0.0, 0.01, -0.2])
    off_mm = np.tile([-1.0, 0.0, 1.0], 10)
    statics = rest + off_mm[:, None] * rise + np.random.default_rng(5).normal(0.0, 1e-3, (30, 3))
    found = scatter_about(np.column_stack([np.ones(30), off_mm]), statics)
    contact = contact_calibration(dome_map(), tuple(found.v_per_mm.tolist()), found)
    height = RestHeight(contact, six_to_eight_mm(), [asdict(a) for a in SENSOR.accelerometers], 1.0)
    assert height.height_mm(rest + 0.6 * rise) == pytest.approx(7.6, abs=0.05)
    assert height.is_other(rest + 2.0 * rise)


def test_one_accelerometer_whose_tilt_scatters_shows_no_height_nor_does_a_bundle_of_one_height() -> None:
    for height in (judge(1, 1.0, six_to_eight_mm()), judge(1, 0.0)):
        assert not height.shows
        assert math.isnan(height.height_mm(statics_of(1)))


def test_heights_of_the_calibration_are_not_another() -> None:
    height = judge(2, 0.0, six_to_eight_mm())
    beyond = [height.is_other(statics_of(2) + off_mm * rise_of(2)) for off_mm in (-1.5, -0.9, 0.9, 1.5)]
    assert beyond == [True, False, False, True]


def test_too_few_recordings_show_no_scatter() -> None:
    folder = read_folder(SAMPLE).select("calibration")
    some = replace(folder, manifest=folder.manifest.iloc[: LEAST_RECORDINGS - 1])
    assert static_scatter(some, Conditioning()) is None
    found = static_scatter(folder, Conditioning())
    assert found is not None
    assert found.mean_v == pytest.approx([1.7, 1.65, 2.45], abs=0.05)


def resting(boards: int, off_mm: float) -> np.ndarray:
    """(n, 3 A) V: two seconds at rest, then two of a signal as of a contact."""
    time_s = np.arange(round(4.0 * RATE_HZ)) / RATE_HZ
    volts = statics_of(boards) + off_mm * rise_of(boards) + np.zeros((len(time_s), 3 * boards))
    volts[:, 0] += 0.08 * np.clip(time_s - 2.0, 0.0, 1.0)
    return volts + np.random.default_rng(3).normal(0.0, 2e-3, volts.shape)


def test_no_estimate_is_valid_at_another_height_and_an_old_card_does_not_look(tmp_path: Path) -> None:
    contact = calibration(2, 0.0)
    old = replace(contact, static_v=(), static_covariance_v2=())
    new, before = (
        Localizer.load(write_small_bundle(tmp_path / name, a_sensor(2), contact=each))
        for name, each in (("new", contact), ("old", old))
    )
    found = new.push(resting(2, 0.6))
    assert not any(e.valid for e in found)
    assert {e.reason for e in found if e.time_s > 1.1} == {Reason.SKIN_HEIGHT}
    new.reset()
    assert Reason.SKIN_HEIGHT not in {e.reason for e in new.push(resting(2, 0.0))}
    assert rest_height(old, None, [], 1.0) is None
    assert Reason.SKIN_HEIGHT not in {e.reason for e in before.push(resting(2, 0.6))}


@pytest.mark.parametrize(
    "change",
    [
        {"static_v": (1.7, 1.65, 2.4)},
        {"static_v": (math.nan,) * 6},
        {"static_covariance_v2": ()},
        {"static_covariance_v2": tuple(map(tuple, np.ones((6, 6))))},
        {"static_covariance_v2": tuple(map(tuple, -np.eye(6)))},
        {"static_covariance_v2": tuple(map(tuple, np.triu(np.ones((6, 6)))))},
    ],
)
def test_a_static_output_that_cannot_be_is_refused(change: dict[str, object]) -> None:
    whole = asdict(calibration(2, 0.0))
    with pytest.raises(ValueError, match="contact"):
        ContactCalibration(**{**whole, **change})
