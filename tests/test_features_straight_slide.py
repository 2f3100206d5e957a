"""Whether a track may be believed; a straight slide next to it: whether they agree, and intervals that hold both."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tracked_map import CLEAR

from softslide.features.angles import wrapped_deg
from softslide.features.card import HALF_WIDTH_SD
from softslide.features.contact.track import ContactEvidence
from softslide.features.estimate import Contact, Estimate, Reason, bounded, interval_ends, mixed_width
from softslide.features.straight_slide import apart, likely, stopped_on, with_track
from softslide.features.stream.tracker import SlideState
from softslide.features.track_estimate import LEAST_MM, TOUCH_LIMITS, TrackLimits, judged

QUANTITIES = ("speed_mm_s", "offset_mm", "x_mm", "y_mm", "vx_mm_s", "vy_mm_s")


def estimate(direction_deg: float, speed: float, place: float, half: float) -> Estimate:
    """Every interval is `half` to either side."""
    angle = np.radians(direction_deg)
    velocity = speed * float(np.cos(angle)), speed * float(np.sin(angle))
    values = zip(QUANTITIES, (speed, place, place, -place, *velocity), strict=True)
    known = bounded(direction_deg=(direction_deg, half), **{name: (value, half) for name, value in values})
    return Estimate(0.0, SlideState.SLIDE, valid=True, reason=Reason.NONE, **known)


def interval(of: Estimate, name: str) -> tuple[float, float]:
    low, high = interval_ends(name)
    return getattr(of, low), getattr(of, high)


@given(
    direction=st.floats(0.0, 359.9),
    turn=st.floats(-170.0, 170.0),
    place=st.floats(-15.0, 15.0),
    half=st.floats(0.1, 5.0),
    shared=st.sampled_from([0.0, 0.5, 1.0]),
)
def test_a_straight_slides_intervals_hold_what_the_track_says(
    direction: float, turn: float, place: float, half: float, shared: float
) -> None:
    """The estimate stays the straight slide's; a track far off makes its intervals wide, one that agrees does not."""
    straight = estimate(direction, 3.0, 1.0, 0.05)
    track = estimate((direction + turn) % 360, 4.0, place, half)
    both = with_track(straight, track, shared)
    for name in QUANTITIES:
        low, high = interval(both, name)
        value = getattr(track, name)
        assert getattr(both, name) == getattr(straight, name)
        assert low <= value - shared * half + 1e-9
        assert high >= value + shared * half - 1e-9
    apart = wrapped_deg(track.direction_deg - straight.direction_deg)
    assert both.direction_lo_deg <= straight.direction_deg + apart - shared * half + 1e-9
    assert both.direction_hi_deg >= straight.direction_deg + apart + shared * half - 1e-9


def test_a_track_that_agrees_leaves_the_straight_slides_intervals() -> None:
    """A sharp one, and a blunt one from a touch; along the line the place is as well known as the track knows it."""
    sharp = estimate(30.0, 3.0, 1.0, 0.5), estimate(30.0, 3.0, 1.0, 0.05), 0.5
    blunt = estimate(30.0, 20.0, 1.0, 0.5), estimate(33.0, 21.0, 1.3, 5.0), TOUCH_LIMITS.shared
    for straight, track, shared in (sharp, blunt):
        both = with_track(straight, track, shared)
        for name in ("direction_deg", "speed_mm_s", "offset_mm"):
            assert interval(both, name) == pytest.approx(interval(straight, name))
    assert both.x_hi_mm - both.x_mm > 4.0


@pytest.mark.parametrize("turn_deg", [0.0, 2.0, 5.0])
def test_a_track_that_is_near_widens_no_further_than_a_bend_allows(turn_deg: float) -> None:
    straight = estimate(30.0, 3.0, 1.0, 0.05)._replace(bent=(0.5, 0.3, 0.2))
    track = estimate(30.0 + turn_deg, 3.0, 1.0, 6.0)
    near, both = turn_deg <= 3.0, with_track(straight, track, 0.5)
    assert both.direction_hi_deg - 30.0 == pytest.approx(0.5 if near else turn_deg + 3.0)
    assert interval(both, "speed_mm_s") == pytest.approx((2.7, 3.3))
    assert interval(both, "offset_mm") == pytest.approx((0.8, 1.2))


@given(weight=st.floats(0.0, 1.0), wider=st.floats(1.0, 50.0))
def test_a_mixture_s_interval_holds_90_percent_of_it(weight: float, wider: float) -> None:
    width = HALF_WIDTH_SD * mixed_width(weight, wider)
    held = weight * math.erf(width / math.sqrt(2)) + (1 - weight) * math.erf(width / wider / math.sqrt(2))
    assert held == pytest.approx(0.9, abs=2e-4)


@given(since_s=st.floats(0.0, 2.0), off_mm=st.floats(0.0, 3.0))
def test_a_straight_slide_is_compared_where_it_was_when_the_track_was_clear(
    since_s: float, off_mm: float
) -> None:
    """A track of `since_s` ago agrees with the slide that was there then, as far as its own 0.3 mm allow."""
    straight = estimate(20.0, 3.0, 4.0, 0.5)._replace(misfit=1.0)
    velocity = np.array([straight.vx_mm_s, straight.vy_mm_s])
    then = np.array([straight.x_mm, straight.y_mm]) - since_s * velocity
    across = np.array([-velocity[1], velocity[0]]) / 3.0
    mean = np.concatenate([then + off_mm * across, velocity])
    track = CLEAR._replace(mean=mean, covariance=np.diag([0.09, 0.09, 0.01, 0.01]))
    limits = TrackLimits()
    farthest_mm = np.sqrt(limits.agreement * (0.09 + LEAST_MM**2))
    if abs(off_mm - farthest_mm) > 1e-6:
        assert (apart(straight, track, since_s, limits) <= limits.agreement) == (off_mm < farthest_mm)


@pytest.mark.parametrize(
    ("log_odds", "distance", "way_mm", "triggers", "expected"),
    [
        (0.0, 2.0, 9.0, 8.0, True),
        (0.0, 24.0, 9.0, 8.0, False),  # far from the track
        (-8.0, 2.0, 9.0, 8.0, False),  # a smooth signal of no known origin is likelier
        (-8.0, 2.0, 16.0, 8.0, True),  # such signals seldom fit a straight slide for so long
        (9.0, 0.0, 20.0, 3.9, False),  # hardly more than the trigger
    ],
)
def test_a_straight_slide_next_to_a_track_that_is_not_valid_needs_odds(
    log_odds: float, distance: float, way_mm: float, triggers: float, expected: bool
) -> None:
    track = CLEAR._replace(way_mm=way_mm, evidence=ContactEvidence(log_odds, triggers=triggers))
    assert likely(track, distance, TrackLimits()) is expected


@pytest.mark.parametrize(("manoeuvres", "without_rim"), [(0.7, True), (0.9, False)])
def test_without_a_rim_a_straight_slide_is_not_believed_next_to_a_bent_track(
    manoeuvres: float, without_rim: bool
) -> None:
    track = CLEAR._replace(way_mm=15.0, manoeuvres=manoeuvres)
    assert likely(track, 2.0, TOUCH_LIMITS) is without_rim
    assert likely(track, 2.0, TrackLimits())


@given(st.integers(-180, 179), st.integers(-5, 5))
def test_whole_turns_do_not_change_a_wrapped_angle(angle: int, turns: int) -> None:
    assert wrapped_deg(float(angle + 360 * turns)) == angle
    assert wrapped_deg(np.array([angle + 360.0 * turns])) == [angle]


def estimated(limits: TrackLimits = TrackLimits(), **changes: object) -> Estimate:  # noqa: B008
    """Of a clear track with changes."""
    return judged(CLEAR._replace(**changes), 1.0, SlideState.SLIDE, (0.0, 0.0), 0.5, limits)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("channels", "way_mm", "valid"), [(4, 10.0, True), (2, 10.0, False), (4, 2.0, False)]
)
def test_a_lift_is_valid_where_two_accelerometers_have_followed_the_contact(
    channels: int, way_mm: float, valid: bool
) -> None:
    """Place and gain are three numbers, an accelerometer shows two."""
    lifted = estimated(partial=0.6, way_mm=way_mm, evidence=ContactEvidence(10.0, channels))
    assert lifted.valid is valid
    assert lifted.contact is (Contact.SLIDE if valid else Contact.PRESS)


SHALLOW = [(-0.3, 9.0, Reason.NONE), (-1.5, 9.0, Reason.STRENGTH)]


@pytest.mark.parametrize(
    ("depth_mm", "triggers", "reason"), [*SHALLOW, (0.0, 4.1, Reason.NONE), (0.0, 3.9, Reason.TOO_EARLY)]
)
def test_what_shows_less_than_any_contact_or_hardly_more_than_the_trigger_is_not_valid(
    depth_mm: float, triggers: float, reason: Reason
) -> None:
    """The calibration's contacts are 0.5 mm deep: one that is 1.5 mm less deep does not touch."""
    found = estimated(depth_mm=depth_mm, evidence=ContactEvidence(10.0, triggers=triggers))
    assert (found.valid, found.reason) == (reason is Reason.NONE, reason)


@pytest.mark.parametrize(
    ("way_mm", "manoeuvres", "valid"), [(15.0, 0.1, True), (15.0, 0.5, False), (10.0, 0.1, False)]
)
def test_without_a_rim_a_bent_or_short_track_is_not_believed(
    way_mm: float, manoeuvres: float, valid: bool
) -> None:
    track = {"way_mm": way_mm, "manoeuvres": manoeuvres, "covariance": np.diag([0.09, 0.09, 1.0, 1.0])}
    track["mean"] = np.array([1.0, 2.0, 20.0, 5.0])
    assert estimated(TOUCH_LIMITS, **track).valid is valid
    assert estimated(**track).valid


QUARTER = [(8.0, 0.1, 0.3, True), (8.0, 0.1, 5.0, True), (8.0, 1.5, 3.0, True), (8.0, 2.9, 3.5, False)]
# And a slow one below what a stopped contact shows.
SLOW = [(0.4, 0.14, 0.5, True), (0.4, 0.16, 0.5, False)]


@pytest.mark.parametrize(("slide", "speed", "half", "at_rest"), [*QUARTER, (8.0, 1.5, 0.5, False), *SLOW])
def test_a_slide_rests_once_its_track_is_a_quarter_as_fast(
    slide: float, speed: float, half: float, at_rest: bool
) -> None:
    """A track that has lost the speed, 2.9 +- 3.5 mm/s of a slide of 8, does not show that it has stopped."""
    line, track = estimate(30.0, slide, 1.0, 0.05), estimate(30.0, speed, 1.0, half)
    stopped = stopped_on(line, track, ended=False)
    assert (stopped.valid, stopped.contact is Contact.STOPPED) == (True, at_rest)
    assert (stopped.speed_mm_s, stopped.vx_mm_s) == ((0.0, 0.0) if at_rest else (slide, track.vx_mm_s))
    assert stopped_on(line, track, ended=True).speed_mm_s == slide
