"""A straight slide next to the track of the contact: whether they agree, and what is estimated where it stops.

Where the straight slide at constant speed, which the graph fits to the whole stroke, explains the output and agrees
with the track, it is the estimate: it knows more, and is sharper.
"""

import math

import numpy as np

from softslide.features.angles import wrapped_deg
from softslide.features.card import HALF_WIDTH_SD
from softslide.features.contact.track import Track
from softslide.features.contact.tracker import StraightFit
from softslide.features.estimate import Contact, Estimate, Reason, bounded, interval_ends
from softslide.features.stream.tracker import SlideState
from softslide.features.track_estimate import (
    HALF_WIDTH,
    LEAST_MM,
    LEAST_MM_S,
    STOPPED_MM_S,
    TRIGGERS,
    TrackLimits,
)

WAY_LOG_ODDS = 1.0  # what each mm of way adds to the log odds of a straight slide
# A line is held for STOPPING_S while a contact seems to be slower than SLOW_SHARE of the slide, or is lost; it rests
# once it is slower than REST_SHARE, where it may stand still, and has stopped for good after PAUSE_S.
STOPPING_S, PAUSE_S = 0.3, 0.6
SLOW_SHARE, REST_SHARE = 0.5, 0.25


def apart(straight: Estimate, track: Track, since_s: float, limits: TrackLimits) -> float:
    """The squared Mahalanobis distance of a straight slide, as it was `since_s` ago, from the track; infinite
    where the way is short."""
    if track.way_mm < limits.straight_way_mm:
        return math.inf
    velocity = np.array([straight.vx_mm_s, straight.vy_mm_s])
    place = np.array([straight.x_mm, straight.y_mm]) - since_s * velocity
    off = np.concatenate([place, velocity]) - track.mean
    # The floors of the intervals, as standard deviations: both read the same blocks.
    floor = np.array([LEAST_MM, LEAST_MM, LEAST_MM_S, LEAST_MM_S])
    spread = track.covariance + np.diag(floor**2)
    return float(off @ np.linalg.solve(spread, off))


def likely(track: Track, distance: float, limits: TrackLimits) -> bool:
    """Whether a straight slide is likely at a distance, as of `apart`, from a track that is not valid itself.

    The odds are of a contact against a signal that none makes, which seldom agrees with a straight slide for long, and
    is often weak.
    """
    further_mm = track.way_mm - limits.straight_way_mm
    log_odds = track.evidence.log_odds - 0.5 * distance + WAY_LOG_ODDS * further_mm
    return (
        log_odds >= limits.straight_log_odds
        and track.evidence.triggers >= TRIGGERS
        and track.manoeuvres <= limits.straight_manoeuvres
    )


def explains(straight: Estimate) -> bool:
    """Whether a straight slide fits the output as well as those of the calibration do, be it sharp or not."""
    return straight.reason in (Reason.NONE, Reason.AMBIGUOUS)


def crosses(straight: Estimate, tracked: Estimate, limits: TrackLimits) -> bool:
    """Whether the straight slide goes another way than the track, further than a valid heading may err."""
    return abs(wrapped_deg(straight.direction_deg - tracked.direction_deg)) > limits.heading_sd_deg


def straight_fit(straight: Estimate, elapsed_s: float, map_depth_mm: float) -> StraightFit:
    """The straight slide as a hypothesis for the tracker. elapsed_s: that it was fitted to; map_depth_mm: the
    calibration's contact depth."""
    known = math.isfinite(straight.depth_mm)
    return StraightFit(
        x_mm=straight.x_mm,
        y_mm=straight.y_mm,
        heading=math.radians(straight.direction_deg),
        speed_mm_s=straight.speed_mm_s,
        depth_mm=straight.depth_mm - map_depth_mm if known else 0.0,
        place_sd_mm=(straight.offset_hi_mm - straight.offset_mm) / HALF_WIDTH_SD,
        heading_sd=math.radians(straight.direction_hi_deg - straight.direction_deg) / HALF_WIDTH_SD,
        speed_sd=math.log(straight.speed_hi_mm_s / straight.speed_mm_s) / HALF_WIDTH_SD,
        depth_sd_mm=(straight.depth_hi_mm - straight.depth_mm) / HALF_WIDTH_SD if known else 0.0,
        way_mm=straight.speed_mm_s * elapsed_s,
    )


def same_line(straight: Estimate, line: Estimate) -> bool:
    """Whether two straight slides go the same way, at one speed and distance: each is within what the other allows."""
    turn = wrapped_deg(straight.direction_deg - line.direction_deg)
    turn_half = (
        straight.direction_hi_deg - straight.direction_lo_deg + line.direction_hi_deg - line.direction_lo_deg
    ) / 2
    offset_half = (straight.offset_hi_mm - straight.offset_lo_mm + line.offset_hi_mm - line.offset_lo_mm) / 2
    faster = abs(math.log(straight.speed_mm_s / line.speed_mm_s))
    return (
        abs(turn) <= turn_half
        and abs(straight.offset_mm - line.offset_mm) <= offset_half
        and faster
        <= math.log(straight.speed_hi_mm_s / straight.speed_lo_mm_s * line.speed_hi_mm_s / line.speed_lo_mm_s)
        / 2
    )


def stops_on(
    line: Estimate, track: Estimate, elapsed_s: float, longest_mm: float, limits: TrackLimits
) -> bool:
    """Whether a track is of a contact that slows down or rests on a line that it agreed with until `elapsed_s` ago.

    longest_mm: how far it would be along the line, had it gone on.

    A stop is quicker than the skin, whose creep shows as a motion: until it is over, a track that has lost the contact
    says nothing against the line.
    """
    along_mm, across_mm = _on_line(line, track)
    half_mm = math.hypot(
        line.offset_hi_mm - line.offset_mm, track.x_hi_mm - track.x_mm, track.y_hi_mm - track.y_mm
    )
    near_mm = math.sqrt(limits.agreement) * half_mm / HALF_WIDTH
    if abs(across_mm) > near_mm or not -near_mm <= along_mm <= longest_mm + near_mm:
        return False
    if track.reason in (Reason.NONE, Reason.AMBIGUOUS) and may_rest(track):
        return True
    slow = track.speed_mm_s < SLOW_SHARE * line.speed_mm_s
    return elapsed_s <= STOPPING_S and (slow or track.reason is Reason.NOT_THIS_SENSOR)


def may_rest(track: Estimate) -> bool:
    """Whether a contact may have come to rest."""
    return track.speed_mm_s < STOPPED_MM_S or track.speed_lo_mm_s <= 0.0


def rests(track: Estimate, line: Estimate) -> bool:
    """Whether it has: a track that is still a quarter as fast as the slide has only lost the speed."""
    slow_mm_s = max(STOPPED_MM_S, REST_SHARE * line.speed_mm_s)
    return may_rest(track) and track.speed_mm_s < slow_mm_s


def stopped_on(line: Estimate, track: Estimate, ended: bool) -> Estimate:
    """The track of a contact that stops on a line: the line with its direction and distance, and how far it went.

    ended: the stop is no pause, so that the slide has ended. Then, and until the contact rests, the speed is the
    slide's.
    """
    along_mm, _ = _on_line(line, track)
    angle = math.radians(line.direction_deg)
    now = {"x_mm": line.x_mm + along_mm * math.cos(angle), "y_mm": line.y_mm + along_mm * math.sin(angle)}
    at_rest = ended or rests(track, line)
    if at_rest:
        now |= {"vx_mm_s": 0.0, "vy_mm_s": 0.0, "speed_mm_s": 0.0}
    changed = bounded(**{name: (value, _half(track, name)) for name, value in now.items()})
    for name in ("direction_deg", "offset_mm", "depth_mm", *(["speed_mm_s"] if ended or not at_rest else [])):
        changed |= {each: getattr(line, each) for each in (name, *interval_ends(name))}
    return track._replace(
        state=SlideState.ENDED if ended else track.state,
        valid=True,
        reason=Reason.NONE,
        contact=Contact.STOPPED if at_rest else Contact.SLIDE,
        places=(),
        **changed,
    )


def earlier(straight: Estimate, since_s: float) -> Estimate:
    """A straight slide as it was so long ago."""
    x_mm, y_mm = straight.x_mm - since_s * straight.vx_mm_s, straight.y_mm - since_s * straight.vy_mm_s
    return straight._replace(x_mm=x_mm, y_mm=y_mm)


def _half(estimate: Estimate, name: str) -> float:
    """Half-width of the interval of a quantity."""
    low, high = interval_ends(name)
    width: float = getattr(estimate, high) - getattr(estimate, low)
    return width / 2


def _on_line(line: Estimate, track: Estimate) -> tuple[float, float]:
    """How far (mm) a track is along a line from where the line was fitted, and across it to the left."""
    angle = math.radians(line.direction_deg)
    cos, sin = math.cos(angle), math.sin(angle)
    dx, dy = track.x_mm - line.x_mm, track.y_mm - line.y_mm
    return dx * cos + dy * sin, dy * cos - dx * sin


_BENT = ("direction_deg", "speed_mm_s", "offset_mm")  # `Estimate.bent`


def with_track(straight: Estimate, tracked: Estimate, shared: float | None) -> Estimate:
    """The straight slide's estimate, with intervals of place and velocity.

    Across the line the offset's interval holds; along it the track's own, which the straight slide only narrows.
    A slide that bends or changes speed a little fits a straight one too: each interval is widened until it holds the
    track's estimate and the share `shared` of its half-width on either side, unless that is None; but where the track's
    estimate is nearer than that, by no more than what the window leaves of bends and changes (`Estimate.bent`).
    """
    angle = math.radians(straight.direction_deg)
    cos, sin = abs(math.cos(angle)), abs(math.sin(angle))
    across = _half(straight, "offset_mm")
    along_x, along_y = _half(tracked, "x_mm"), _half(tracked, "y_mm")
    if math.isnan(straight.depth_lo_mm):
        straight = straight._replace(depth_lo_mm=tracked.depth_lo_mm, depth_hi_mm=tracked.depth_hi_mm)
    speed_half = _half(straight, "speed_mm_s")
    turn_half = straight.speed_mm_s * math.radians(_half(straight, "direction_deg"))
    known = bounded(
        x_mm=(straight.x_mm, math.hypot(across * sin, along_x * cos)),
        y_mm=(straight.y_mm, math.hypot(across * cos, along_y * sin)),
        vx_mm_s=(straight.vx_mm_s, math.hypot(speed_half * cos, turn_half * sin)),
        vy_mm_s=(straight.vy_mm_s, math.hypot(speed_half * sin, turn_half * cos)),
    )
    straight = straight._replace(contact=Contact.SLIDE, **known)
    if shared is None:
        return straight
    wider = {}
    bent = dict(zip(_BENT, straight.bent or (), strict=False))
    for name in ("direction_deg", "speed_mm_s", "offset_mm", "x_mm", "y_mm", "vx_mm_s", "vy_mm_s"):
        low, high = interval_ends(name)
        value, apart = getattr(straight, name), getattr(tracked, name) - getattr(straight, name)
        if name == "direction_deg":
            apart = wrapped_deg(apart)
        half = shared * _half(tracked, name)
        room = bent.get(name, math.inf) if abs(apart) <= half else math.inf
        wider[low] = min(getattr(straight, low), max(value + apart - half, value - room))
        wider[high] = max(getattr(straight, high), min(value + apart + half, value + room))
    return straight._replace(**wider)
