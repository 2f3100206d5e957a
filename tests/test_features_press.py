"""A press without motion: separated from a tilt of the device and from a change of its pressure, or not valid."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tracked_map import (
    BLOCK_S,
    INFLATION,
    TWO_BOARDS,
    bank_of,
    noisy_map,
    pressed,
    tracker,
    tracks_of,
    volts_along,
)

from softslide.features.contact.evidence import PRESS_ON_S, PRESS_S, beyond_device
from softslide.features.contact.hypotheses import GAIN, RISE, Y
from softslide.features.contact.touch import Onset, at_rest
from softslide.features.contact.track import Track
from softslide.features.estimate import Contact, Estimate, Reason
from softslide.features.stream.tracker import SlideState
from softslide.features.track_estimate import TrackLimits, judged
from softslide.models.response_map.card import contact_calibration

ON_S, HELD_S = 0.4, 1.5
RESPONSE = noisy_map(places=TWO_BOARDS)


def grown(level_v: np.ndarray, on_s: float = ON_S, held_s: float = HELD_S) -> np.ndarray:
    """Blocks (m, C) V that grow to a level within on_s and keep it, with noise of 1 mV."""
    share = np.clip(np.arange(round((0.3 + on_s + held_s) / BLOCK_S)) * BLOCK_S / on_s - 0.3 / on_s, 0.0, 1.0)
    noise = np.random.default_rng(0).normal(0.0, 1e-3, (len(share), len(level_v)))
    return share[:, None] * level_v + noise


def estimates(tracks: list[Track | None]) -> list[Estimate]:
    found = (t for t in tracks if t is not None)
    return [judged(t, 0.0, SlideState.SLIDE, (0.0, 0.0), 0.5, TrackLimits()) for t in found]


@given(
    st.lists(st.floats(-1.0, 1.0), min_size=2, max_size=8).filter(lambda v: len(v) % 2 == 0),
    st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)),
)
def test_nothing_is_left_of_a_tilt_and_of_a_change_of_pressure(
    inflation: list[float], amounts: tuple[float, float, float]
) -> None:
    share = beyond_device(np.array(inflation))
    assert share @ share == pytest.approx(share, abs=1e-9)
    tilt = np.tile(amounts[:2], len(inflation) // 2)
    assert np.abs(share @ (tilt + amounts[2] * np.array(inflation))).max() < 1e-6


def test_one_accelerometer_leaves_nothing_and_each_further_one_more() -> None:
    random = np.random.default_rng(1)
    ranks = [round(np.trace(beyond_device(random.normal(size=2 * n)))) for n in (1, 2, 3, 4)]
    assert ranks == [0, 1, 3, 5]
    # A pressure that moves no board, or all alike, takes no direction away.
    assert round(np.trace(beyond_device(np.zeros(4)))) == 2
    assert round(np.trace(beyond_device(np.array([0.3, -0.1, 0.3, -0.1])))) == 2


@pytest.mark.parametrize("place", [(12.0, 9.0), (-11.0, 7.0), (10.0, -8.0)])
def test_a_press_off_the_line_of_the_boards_is_found_where_it_is(place: tuple[float, float]) -> None:
    found = [e for e in estimates(tracks_of(RESPONSE, grown(pressed(RESPONSE, place)), INFLATION)) if e.valid]
    assert len(found) > 0.3 * HELD_S / BLOCK_S
    for each in found:
        assert each.contact is Contact.PRESS
        assert np.hypot(each.x_mm - place[0], each.y_mm - place[1]) < 1.0
        assert each.x_lo_mm < place[0] < each.x_hi_mm or each.y_lo_mm < place[1] < each.y_hi_mm
        assert each.vx_mm_s == each.vy_mm_s == each.speed_mm_s == 0.0
        directions = (each.direction_deg, each.direction_lo_deg)
        assert np.isnan([*directions, each.offset_mm, each.offset_hi_mm, each.depth_mm]).all()


PRESSURE, TILT = np.array(INFLATION), np.array([0.1, 0.06, 0.1, 0.06])
KNOWN_WITHIN_8_DEG = 4 * PRESSURE + [0.0, 0.01, 0.0, -0.01]


@pytest.mark.parametrize("level", [4 * PRESSURE, KNOWN_WITHIN_8_DEG, TILT, TILT + 3 * PRESSURE], ids=str)
def test_a_tilt_or_a_change_of_pressure_is_not_a_press(level: np.ndarray) -> None:
    assert not any(e.valid for e in estimates(tracks_of(RESPONSE, grown(level), INFLATION)))


def test_a_press_between_the_boards_looks_like_a_fall_of_the_pressure_and_is_not_valid() -> None:
    level = pressed(RESPONSE, (0.0, 0.0))
    lengths = np.linalg.norm(level) * np.linalg.norm(INFLATION)
    assert np.abs(level @ INFLATION) == pytest.approx(lengths, rel=1e-2)
    found = tracks_of(RESPONSE, grown(level), INFLATION)
    assert not any(e.valid for e in estimates(found))
    # It is followed there all the same: with other directions known it would be valid.
    along_y = tracks_of(RESPONSE, grown(level), (0.0, 0.02, 0.0, -0.02))
    assert any(e.valid for e in estimates(along_y))


@pytest.mark.parametrize(
    "step_mv", [(90, -92, -75, -19), (129, 0, -34, -68), (66, -1, -28, 132), (-5, 1, 52, -141)]
)
def test_a_step_along_a_direction_that_no_press_has_is_not_a_press(step_mv: tuple[float, ...]) -> None:
    """The residual takes up what no place explains, and the next blocks' innovations are as small as a press's."""
    tracks = [t for t in tracks_of(RESPONSE, grown(np.array(step_mv) / 1e3), INFLATION) if t is not None]
    assert any(e.valid for e in estimates([t._replace(residual=0.0) for t in tracks]))
    assert not any(e.valid for e in estimates(tracks))


@pytest.mark.parametrize("inflation", [(), INFLATION[:2]])
def test_without_what_the_pressure_does_or_with_one_board_no_press_is_valid(
    inflation: tuple[float, ...],
) -> None:
    response = noisy_map(places=TWO_BOARDS if not inflation else TWO_BOARDS[1:])
    found = estimates(tracks_of(response, grown(pressed(response, (12.0, 9.0))), inflation))
    assert found
    assert not any(e.valid for e in found)
    assert {e.reason for e in found} <= {Reason.AMBIGUOUS, Reason.TOO_EARLY, Reason.NOT_THIS_SENSOR}


@pytest.mark.parametrize("seconds", [9.0, 30.0])
def test_a_press_that_comes_on_slowly_is_not_valid(seconds: float) -> None:
    """A drift of single channels takes any direction, and goes on for longer than it takes to press something on. What
    drifts on is small next to what has drifted, and is not a press then either."""
    volts = grown(pressed(RESPONSE, (12.0, 9.0)), seconds, 0.2 * seconds)
    found = estimates(tracks_of(RESPONSE, volts, INFLATION))
    late = found[round((PRESS_ON_S + 1.0) / BLOCK_S) :]
    assert late
    assert not any(e.valid and e.contact is Contact.PRESS for e in late)


def test_a_press_that_still_grows_after_two_seconds_is_not_valid_before_it_rests() -> None:
    """A drift grows so long, too."""
    held_s = 3.0
    found = estimates(tracks_of(RESPONSE, grown(pressed(RESPONSE, (12.0, 9.0)), 3.0, held_s), INFLATION))
    of_press = [bool(e.valid and e.contact is Contact.PRESS) for e in found]
    grows = slice(round((PRESS_S + 0.3) / BLOCK_S), -round(held_s / BLOCK_S))
    assert len(of_press[grows]) > 20
    assert not any(of_press[grows])
    assert any(of_press[-round(1.0 / BLOCK_S) :])


@pytest.mark.parametrize("seed", range(8))
def test_where_a_contact_rests_is_found_closer_than_a_cell_of_the_grid(seed: int) -> None:
    """The true place is among the likely ones, with the gain of a whole contact, although the map bends over a cell."""
    response = noisy_map()
    place = np.random.default_rng(seed).uniform(-15.0, 15.0, 2)
    level, sd = pressed(response, tuple(place)), np.full(2, 4e-4)
    card = contact_calibration(response)
    bank = at_rest(Onset(level, np.zeros(2), sd, sd), card.surface(), card, 1e-3)
    assert bank is not None
    likely = bank.log_weight > bank.log_weight.max() - 6.0
    off_mm = np.hypot(*(bank.state[:, : Y + 1] - place).T)
    best = int(np.where(likely, off_mm, np.inf).argmin())
    assert off_mm[best] < 0.4
    assert abs(bank.state[best, GAIN] - 1.0) < 0.02


@pytest.mark.parametrize(
    ("place", "heading_deg"), [((2.4, 3.5), 0.0), ((9.0, 0.4), 90.0), ((0.0, 12.0), -90.0)]
)
def test_a_contact_that_is_pressed_on_and_slides_off_is_followed(
    place: tuple[float, float], heading_deg: float
) -> None:
    """Its friction builds up late: not in the first 0.1 mm, then within 0.25 mm."""
    response, heading = noisy_map(), np.radians(heading_deg)
    way_mm = 2.0 * BLOCK_S * np.arange(1.0, 350.0)
    path = np.array(place) + way_mm[:, None] * [np.cos(heading), np.sin(heading)]
    press = grown(pressed(response, place), 2 * ON_S)
    share = np.clip((way_mm - 0.1) / 0.25, 0.0, 1.0)[:, None]
    noise = np.random.default_rng(5).normal(0.0, response.noise_v, (len(path), response.channels))
    frictionless = np.array([pressed(response, tuple(each)) for each in path]) + noise
    slide = share * volts_along(response, path) + (1.0 - share) * frictionless
    tracks = tracks_of(response, np.concatenate([press, slide]))[len(press) :]
    pairs = zip(tracks, path, strict=True)
    off_mm = np.array([np.inf if t is None else np.hypot(*(t.mean[:2] - at)) for t, at in pairs])
    assert np.median(off_mm) < 0.5
    assert off_mm[-100:].max() < 1.0


def test_what_is_pressed_on_does_not_stand_still() -> None:
    tracked, bank = tracker(RESPONSE), bank_of(RESPONSE, 3)
    bank.state[:, GAIN] = 0.8
    bank.state[:, RISE] = 0.7, 0.0, 0.0
    bank.partial[:2] = True
    tracked._bank = bank
    tracked._doubt()
    rising, held, whole = bank.log_weight
    assert rising == pytest.approx(whole)
    assert held < whole
