"""Estimates from whole contacts: of a recorded circle, through the command, and where there is no contact."""

import json
from pathlib import Path

import numpy as np
import pytest
from small_bundle import write_small_bundle
from streams import write_csv
from touched_bundle import SPEED_MM_S, at_rest, circle, on_the_circle, outputs, write_touched_bundle
from touched_skin import RATE_HZ, SENSOR

import softslide
from softslide.features.angles import wrapped_deg
from softslide.features.errors import InputError
from softslide.features.stream.tracker import SlideState
from softslide.serve.localizer import Localizer
from softslide.serve.records import record
from softslide.serve.whole_contacts import whole_contacts


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_touched_bundle(tmp_path_factory.mktemp("touched") / "m")


def test_a_circle_is_followed_from_its_first_block_to_its_last(bundle: Path) -> None:
    """Two of them in one recording; what is not a contact stays as it is."""
    one = circle()
    volts = outputs(at_rest(1.5), one, at_rest(1.5), one, at_rest(1.0))
    localizer = Localizer.load(bundle)
    whole = whole_contacts(localizer, volts)
    live = Localizer.load(bundle).push(volts)
    assert len(whole) == len(live)
    contact_s = len(one) / RATE_HZ
    valid = 0
    for estimate, before in zip(whole, live, strict=True):
        assert (estimate.time_s, estimate.state) == (before.time_s, before.state)
        since_s = (estimate.time_s - 1.5) % (contact_s + 1.5)
        if estimate.time_s < 1.5 or since_s > contact_s + 0.04:
            assert repr(estimate) == repr(before)
            continue
        if not 0.06 < since_s < contact_s - 0.04:
            continue
        valid += estimate.valid
        x, y, vx, vy = on_the_circle(np.array([since_s]))[0]
        assert (estimate.x_mm, estimate.y_mm) == pytest.approx((x, y), abs=0.4)
        assert estimate.speed_mm_s == pytest.approx(SPEED_MM_S, rel=0.1)
        assert abs(wrapped_deg(estimate.direction_deg - float(np.degrees(np.arctan2(vy, vx))))) < 6.0
    assert valid > 0.95 * 2 * (contact_s - 0.1) / 0.02


def test_a_long_contact_is_estimated_in_pieces_without_a_seam(bundle: Path) -> None:
    volts = outputs(at_rest(1.5), circle(6.0), at_rest(1.0))
    whole = [e for e in whole_contacts(Localizer.load(bundle), volts) if 1.6 < e.time_s < 11.9]
    assert all(estimate.valid for estimate in whole)
    x, y = on_the_circle(np.array([e.time_s for e in whole]) - 1.5)[:, :2].T
    assert np.hypot([e.x_mm for e in whole] - x, [e.y_mm for e in whole] - y).max() < 0.5
    assert np.abs(np.diff([e.speed_mm_s for e in whole])).max() < 0.02 * SPEED_MM_S


def test_a_recording_that_ends_or_fails_within_the_contact(bundle: Path) -> None:
    """It is a contact as far as it goes: a tenth of a second without samples is bridged, then nothing is valid."""
    volts = outputs(at_rest(1.5), circle(0.7))
    assert whole_contacts(Localizer.load(bundle), volts)[-2].valid
    volts[-60:] = np.nan
    live = Localizer.load(bundle).push(volts)
    whole = whole_contacts(Localizer.load(bundle), volts)
    assert whole[-20].valid
    bridged = [e for e in whole if e.valid and e.time_s * RATE_HZ > len(volts) - 60]
    assert 0 < len(bridged) <= 6
    for estimate in bridged:
        x, y = on_the_circle(np.array([estimate.time_s - 1.5]))[0, :2]
        assert estimate.x_lo_mm < x < estimate.x_hi_mm
        assert estimate.y_lo_mm < y < estimate.y_hi_mm
    assert repr(whole[-1]) == repr(live[-1])


def test_the_command_writes_what_the_function_returns(
    bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    volts = outputs(at_rest(1.5), circle(), at_rest(1.0))
    path = write_csv(tmp_path / "circle.csv", volts, SENSOR.channels, RATE_HZ)
    assert softslide.main(["predict", "--model", str(bundle), "--whole-contact", str(path)]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    wanted = [record(estimate) for estimate in whole_contacts(Localizer.load(bundle), volts)]
    assert [{k: v for k, v in line.items() if k not in ("recording", "file")} for line in lines] == wanted
    assert any(line["valid"] and line["state"] == SlideState.SLIDE for line in lines)


def test_a_press_and_contacts_over_the_rim_are_not_paths(bundle: Path, tmp_path: Path) -> None:
    volts = outputs(at_rest(1.5), np.tile(circle()[40], (200, 1)), at_rest(1.0))
    assert not any(estimate.valid for estimate in whole_contacts(Localizer.load(bundle), volts))
    localizer = Localizer.load(write_small_bundle(tmp_path / "m", SENSOR))
    with pytest.raises(InputError, match="whole contacts"):
        whole_contacts(localizer, np.full((2000, 3), 1.65))
