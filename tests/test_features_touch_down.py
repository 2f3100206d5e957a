"""Contacts that come down and are lifted within a block, tracked along straight lines and circles."""

from dataclasses import replace

import numpy as np
import pytest
from dome_map import dome_map, surface_of

from softslide.features.contact.hypotheses import LocalErrors, update
from softslide.features.contact.touch_down import at_touch_down
from softslide.features.contact.track import Track
from softslide.features.contact.tracker import ContactTracker
from softslide.features.contact.tracking_config import TOUCH_DOWN
from softslide.features.stream.conditioning import Conditioning
from softslide.features.track_estimate import TOUCH_LIMITS
from softslide.models.response_map.card import contact_calibration

BLOCK_S = 0.02
RADIUS_MM, SPEED_MM_S = 6.0, 25.0
RESPONSE = dome_map(2, floor_v=4e-3)
SURFACE, CARD = surface_of(RESPONSE), contact_calibration(RESPONSE)
USABLE = np.ones(6, dtype=bool)
LOCAL = LocalErrors(0.42, 0.07)


def tracker(lag_blocks: int = 0) -> ContactTracker:
    return ContactTracker(SURFACE, CARD, Conditioning(), TOUCH_DOWN, lag_blocks)


def tracks_of(blocks: np.ndarray, usable: np.ndarray = USABLE) -> list[Track | None]:
    one = tracker()
    return [one.push(block, True, usable) for block in blocks]


def on_the_circle(time_s: np.ndarray, speed_mm_s: float = SPEED_MM_S) -> np.ndarray:
    """(n, 4): x, y, vx, vy at (n,) s since the touch."""
    angle = speed_mm_s / RADIUS_MM * time_s
    radial, along = np.stack([np.cos(angle), np.sin(angle)]), np.stack([-np.sin(angle), np.cos(angle)])
    return np.concatenate([RADIUS_MM * radial, speed_mm_s * along]).T


def circle(count: int, gain: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Blocks (n, C) V of a circle, and the truth at their ends (n, 4)."""
    begin_s = BLOCK_S * np.arange(count)
    return blocks_along(on_the_circle(begin_s + BLOCK_S / 2)[:, :2], gain), on_the_circle(begin_s + BLOCK_S)


def bent_line(count: int) -> np.ndarray:
    """Blocks (n, C) V of a line that turns by 60 degrees within 4 mm, 14 mm from its start, and back 6 mm later."""
    way_mm = SPEED_MM_S * BLOCK_S * (np.arange(count) + 0.5)
    heading = np.radians(np.interp(way_mm, [14.0, 18.0, 24.0, 28.0], [0.0, 60.0, 60.0, 0.0]))
    steps = SPEED_MM_S * BLOCK_S * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return blocks_along(np.array([-13.0, -6.0]) + np.cumsum(steps, axis=0))


def blocks_along(place: np.ndarray, gain: float = 1.0) -> np.ndarray:
    """Blocks (n, C) V at places (n, 2), each off by its own place and gain as the tracker expects."""
    draw = np.random.default_rng(5)
    middle = place + 0.2 * draw.standard_normal(place.shape)
    volts = gain * SURFACE.at(*middle.T)[:, 0, 0] * (1 + 0.03 * draw.standard_normal((len(place), 1)))
    noisy: np.ndarray = volts + 2e-3 * draw.standard_normal(volts.shape)
    return noisy


@pytest.mark.parametrize(("gain", "dead"), [(1.0, False), (1.15, False), (1.0, True)])
def test_a_circle_is_followed_from_its_touch(gain: float, dead: bool) -> None:
    """On another day's gain too, and with one of two sensing elements."""
    blocks, truth = circle(80, gain)
    usable = USABLE.copy()
    if dead:
        usable[3:], blocks[:, 3:] = False, 9.9
    found = tracks_of(blocks, usable)
    assert found[1] is None
    late = [(track.mean, true) for track, true in zip(found[30:], truth[30:], strict=True) if track]
    assert len(late) == 50
    said, true = np.array(late).transpose(1, 0, 2)
    assert np.median(np.hypot(*(said - true)[:, :2].T)) < 0.5
    heading = np.angle(np.exp(1j * (np.arctan2(*said[:, :1:-1].T) - np.arctan2(*true[:, :1:-1].T))))
    assert np.median(np.abs(np.degrees(heading))) < 8.0
    assert np.median(np.abs(np.hypot(*said[:, 2:].T) / SPEED_MM_S - 1)) < 0.08


def test_a_lifted_contact_stays_where_it_was_before_its_last_block() -> None:
    """The last block may show a part of it."""
    one, (blocks, _) = tracker(), circle(60)
    tracks = [one.push(block, True, USABLE) for block in blocks]
    one.push(0.4 * blocks[-1], True, USABLE)
    after = [one.push(np.zeros(6), touched, USABLE) for touched in (True, True, False, False)]
    assert all(track is tracks[-1] for track in after[:3])
    assert after[3] is None


def test_evidence_is_for_a_contact_and_against_a_smooth_signal() -> None:
    """Waves of each channel as large as the circle's outputs; also of the past that a lag reads."""
    blocks, _ = circle(80)
    random = np.random.default_rng(2)
    time_s = BLOCK_S * np.arange(len(blocks))[:, None]
    noise = 1e-3 * random.standard_normal(blocks.shape)
    waves = 0.1 * np.sin(2 * np.pi * (0.5 * time_s + random.random(6))) + noise
    for shown, least, most in (
        (blocks, TOUCH_LIMITS.evidence, np.inf),
        (waves, -np.inf, TOUCH_LIMITS.evidence),
    ):
        one = tracker(lag_blocks=9)
        tracks = [one.push(block, True, USABLE) for block in shown]
        assert tracks[-1] is not None
        assert least < tracks[-1].evidence.log_odds < most
        past = one.past(5)
        assert past is not None
        assert past.evidence == tracks[-1].evidence


@pytest.mark.parametrize("speed_mm_s", [10.0, 25.0])
def test_on_a_smooth_skin_a_contact_has_its_evidence(speed_mm_s: float) -> None:
    """Where the map leaves far less than its calibration did, a smooth signal predicts nearly as well."""
    place = on_the_circle(BLOCK_S * (np.arange(120) + 0.5), speed_mm_s)
    volts = SURFACE.at(*place[:, :2].T)[:, 0, 0]
    volts = volts + 1e-3 * np.random.default_rng(4).standard_normal(volts.shape)
    log_odds = [track.evidence.log_odds for track in tracks_of(volts) if track is not None]
    assert min(log_odds) > TOUCH_LIMITS.evidence
    assert log_odds[-1] > -30.0


def test_bends_are_counted_and_a_circle_needs_none() -> None:
    """A track that needed a bend is not believed: the next one shows 2 mm late."""
    turned = [track.manoeuvres for track in tracks_of(bent_line(56)) if track]
    assert max(turned[:25]) < TOUCH_LIMITS.manoeuvres < max(turned)
    held = [track.manoeuvres for track in tracks_of(circle(60)[0]) if track]
    assert np.median(held) < TOUCH_LIMITS.manoeuvres


def test_errors_of_place_and_gain_add_their_own_covariance() -> None:
    """One linear update, against the Kalman gain with the whole covariance of the measurement."""
    level = SURFACE.at(np.array([2.0]), np.array([-1.0]))[0, 0, 0]
    variance = np.full(6, 1e-5)
    before = at_touch_down(level, variance, SURFACE, CARD, LOCAL).take(slice(0, 1))
    response = SURFACE.at(*before.state[:, :2].T)[0, :, 0]
    shown, slopes = response[0], response[1:]
    whole = np.diag(variance) + 0.3**2 * slopes.T @ slopes + 0.05**2 * np.outer(shown, shown)
    prior = before.covariance[0, :2, :2]
    after = before.take(slice(None))
    after.covariance[:, 2:], after.covariance[:, :, 2:] = 0.0, 0.0
    update(after, level, variance, SURFACE, BLOCK_S, LocalErrors(0.3, 0.05))
    wanted = np.linalg.inv(np.linalg.inv(prior) + slopes @ np.linalg.inv(whole) @ slopes.T)
    np.testing.assert_allclose(after.covariance[0, :2, :2], wanted, rtol=1e-6)


def test_places_are_found_by_the_first_output_whatever_its_gain() -> None:
    card = replace(CARD, gain_sd=0.15)
    for place in ((8.0, -3.0), (-5.0, 10.0)):
        level = 1.1 * SURFACE.at(*np.array([place]).T)[0, 0, 0]
        bank = at_touch_down(level, np.full(6, 1e-5), SURFACE, card, LOCAL)
        assert np.hypot(*(bank.state[0, :2] - place)) < 1.0
        assert len({tuple(heading) for heading in bank.state[:, 2:4]}) == 24
