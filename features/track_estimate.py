"""From a track to an estimate: intervals, what the contact does, and whether it may be believed.

Where the straight slide at constant speed, which the graph fits to the whole stroke, explains the output and agrees
with the track, it is the estimate: it knows more, and is sharper.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from softslide.features.angles import wrapped_deg
from softslide.features.card import HALF_WIDTH_SD
from softslide.features.contact.track import Track
from softslide.features.contact.tracker import StraightFit
from softslide.features.estimate import Contact, Estimate, Reason
from softslide.features.stream.tracker import SlideState


@dataclass(frozen=True)
class TrackLimits:
    """Chosen on synthetic paths (experiments/LOG.md).

    half_width, heading_width: 90 % half-widths over the filters' standard deviations; the filters neglect the map's
    curvature and keep only the likeliest hypotheses. place_mm, speed_mm_s, heading_deg: and never less than these.
    place_sd_mm, heading_sd_deg: largest standard deviations of a valid estimate. certain: least weight of the
    hypotheses near the best one. misfit: largest chi-square over its degrees of freedom. partial: largest weight of
    hypotheses that the contact is being pressed on or lifted, unless more channels than that has unknowns have followed
    it for partial_way_mm. evidence: least logarithm of the odds of a contact against a smooth signal of no known
    origin. triggers: the largest output since the touch, over the trigger, is at least that. way_mm: least way, and
    valid_way_mm: of a valid track. manoeuvres, straight_manoeuvres: most over the way, of a track and of one that a
    straight slide agrees with.
    stopped_mm_s: a contact slower than this has stopped; stopped_way_mm: its least way.
    agreement: largest squared Mahalanobis distance of the straight slide from the track, four degrees of freedom.
    stopping_s: for which a line is held while a contact seems to be slower than slow_share of the slide, or is lost;
    it rests once it is slower than creep_share, and has stopped for good after pause_s.
    press_mm_s, press_sd_mm: largest speed and standard deviation of the place of a valid press. straight_way_mm: least
    way of a straight slide. straight_log_odds: least logarithm of the odds of a straight slide that a track agrees with
    which is not valid itself, against a signal that no contact makes; way_log_odds: what each mm of way adds to it.
    sure_log_odds: evidence from which a track is sure: valid although the output has not moved on since the touch, and
    up to sure_certain and sure_heading_sd_deg. shared: share of the track's half-widths about its own estimate that the
    straight slide's intervals hold too; None: they stay as they are.
    """

    half_width: float = 1.9
    heading_width: float = 1.7
    place_mm: float = 0.03
    speed_mm_s: float = 0.02
    heading_deg: float = 0.3
    place_sd_mm: float = 1.6
    heading_sd_deg: float = 12.0
    certain: float = 0.97
    misfit: float = 2.2
    partial: float = 0.3
    partial_way_mm: float = 4.0
    evidence: float = -1.0
    triggers: float = 4.0
    way_mm: float = 1.5
    valid_way_mm: float = 1.5
    manoeuvres: float = math.inf
    straight_manoeuvres: float = math.inf
    stopped_mm_s: float = 0.15
    stopped_way_mm: float = 4.0
    press_mm_s: float = 0.3
    press_sd_mm: float = 1.0
    agreement: float = 25.0
    stopping_s: float = 0.3
    pause_s: float = 0.6
    slow_share: float = 0.5
    creep_share: float = 0.05
    straight_way_mm: float = 8.0
    straight_log_odds: float = -3.0
    way_log_odds: float = 1.0
    sure_log_odds: float = 5.0
    sure_certain: float = 0.8
    sure_heading_sd_deg: float = 16.0
    shared: float | None = 0.5


LIKELY = 9.49  # 95 % quantile of chi-square with four degrees of freedom

# Of a track from a touch anywhere, which is several times less sharp than the straight slide: its intervals would widen
# those until 98 % hold. Tracks with a wider heading were wrong at sharp bends, and so were straight slides that are
# less than likely; the evidence of a contact was -40 at least, that of other signals -140 at most. A track that needed
# a bend is wrong at the next one as often as it is right (experiments/LOG.md).
TOUCH_LIMITS = TrackLimits(
    heading_sd_deg=13.0,
    valid_way_mm=11.0,
    straight_way_mm=9.0,
    manoeuvres=0.3,
    straight_manoeuvres=0.8,
    shared=None,
    agreement=LIKELY,
    evidence=-60.0,
    straight_log_odds=-60.0,
    sure_log_odds=math.inf,
)


PARTIAL_UNKNOWNS = 3  # of a contact that is being pressed on or lifted: its place and its gain


def judged(
    track: Track,
    time_s: float,
    state: SlideState,
    reference_mm: tuple[float, float],
    map_depth_mm: float,
    limits: TrackLimits,
) -> Estimate:
    """The track as an estimate; `reason` says why it is not valid. map_depth_mm: the calibration's contact depth."""
    if pressed := _is_press(track, limits):
        track = track._replace(mean=np.array([*track.mean[:2], 0.0, 0.0]))
    x, y, vx, vy = track.mean.tolist()
    variance = np.maximum(track.covariance.diagonal(), 0.0)
    sd = np.sqrt(variance)
    speed, heading = math.hypot(vx, vy), math.atan2(vy, vx)
    cos, sin = math.cos(heading), math.sin(heading)
    along, across = np.array([cos, sin]), np.array([-sin, cos])
    velocity, place = track.covariance[2:, 2:], track.covariance[:2, :2]
    speed_sd = math.sqrt(max(along @ velocity @ along, 0.0))
    heading_sd = math.sqrt(max(across @ velocity @ across, 0.0)) / max(speed, 1e-3)
    from_reference = np.array([x - reference_mm[0], y - reference_mm[1]])
    lever_mm = float(along @ from_reference)
    offset_sd = math.sqrt(max(across @ place @ across, 0.0) + (lever_mm * min(heading_sd, 1.0)) ** 2)
    x_half, y_half, vx_half, vy_half = (limits.half_width * sd).tolist()
    vx_half, vy_half = vx_half + limits.speed_mm_s, vy_half + limits.speed_mm_s
    x_half, y_half = x_half + limits.place_mm, y_half + limits.place_mm
    speed_half = limits.half_width * speed_sd + limits.speed_mm_s
    heading_half = min(limits.heading_width * math.degrees(heading_sd) + limits.heading_deg, 180.0)
    offset, offset_half = float(across @ from_reference), limits.half_width * offset_sd + limits.place_mm
    contact = Contact.SLIDE
    lifted = track.evidence.channels > PARTIAL_UNKNOWNS and track.way_mm > limits.partial_way_mm
    if (track.partial > 0.5 and not lifted) or track.way_mm < limits.way_mm or track.evidence.one_press:
        contact = Contact.PRESS
    elif speed < limits.stopped_mm_s:
        contact = Contact.STOPPED
    degrees = math.degrees(heading) % 360.0
    depth, depth_half = map_depth_mm + track.depth_mm, limits.half_width * track.depth_sd_mm
    reason = _reason(track, math.hypot(sd[0], sd[1]), math.degrees(heading_sd), contact, lifted, limits)
    if reason is Reason.NONE and depth + depth_half < 0.0:
        # Less than a contact at all shows: what it explains is another object, or another amplitude.
        reason = Reason.STRENGTH
    if pressed:
        contact, reason = Contact.PRESS, Reason.NONE
        # It goes nowhere. How far it is pressed in shows as how far it is pressed on does; the force is how hard.
        degrees = offset = depth = math.nan
    return Estimate(
        time_s=time_s,
        state=state,
        direction_deg=0.0 if degrees == 360.0 else degrees,
        direction_lo_deg=degrees - heading_half,
        direction_hi_deg=degrees + heading_half,
        speed_mm_s=speed,
        speed_lo_mm_s=max(speed - speed_half, 0.0),
        speed_hi_mm_s=speed + speed_half,
        offset_mm=offset,
        offset_lo_mm=offset - offset_half,
        offset_hi_mm=offset + offset_half,
        depth_mm=depth,
        x_mm=x,
        y_mm=y,
        valid=reason is Reason.NONE,
        contact=contact,
        reason=reason,
        vx_mm_s=vx,
        vy_mm_s=vy,
        x_lo_mm=x - x_half,
        x_hi_mm=x + x_half,
        y_lo_mm=y - y_half,
        y_hi_mm=y + y_half,
        vx_lo_mm_s=vx - vx_half,
        vx_hi_mm_s=vx + vx_half,
        vy_lo_mm_s=vy - vy_half,
        vy_hi_mm_s=vy + vy_half,
        depth_lo_mm=depth - depth_half,
        depth_hi_mm=depth + depth_half,
        places=track.places,
    )


def _is_press(track: Track, limits: TrackLimits) -> bool:
    """Whether the track is a press without motion, at a place that is known. Since neither a tilt nor a change of
    pressure can have made it, it needs neither way nor evidence of a slide."""
    return (
        track.evidence.presses
        and float(np.hypot(*track.mean[2:])) < limits.press_mm_s
        and float(track.covariance[:2, :2].trace()) < limits.press_sd_mm**2
        and track.certain >= limits.certain
        and track.misfit <= limits.misfit
    )


def is_sure(track: Track, limits: TrackLimits) -> bool:
    """Whether the evidence is clearly for a contact."""
    return track.evidence.log_odds >= limits.sure_log_odds


def _reason(
    track: Track,
    place_sd_mm: float,
    heading_sd_deg: float,
    contact: Contact,
    lifted: bool,
    limits: TrackLimits,
) -> Reason:
    if track.misfit > limits.misfit:
        return Reason.NOT_THIS_SENSOR
    if track.way_mm < limits.valid_way_mm or track.evidence.triggers < limits.triggers:
        return Reason.TOO_EARLY
    # A contact adds to the output: none has a negative gain.
    if track.evidence.log_odds < limits.evidence or track.gain <= 0.0:
        return Reason.NOT_THIS_SENSOR
    most_deg, certain = limits.heading_sd_deg, limits.certain
    if is_sure(track, limits):
        most_deg, certain = limits.sure_heading_sd_deg, limits.sure_certain
    unclear = place_sd_mm > limits.place_sd_mm or (
        heading_sd_deg > most_deg and contact is not Contact.STOPPED
    )
    # What one press at a place nearby shows as well is ambiguous.
    unclear = unclear or track.evidence.one_press or track.certain < certain
    unclear = unclear or track.manoeuvres > limits.manoeuvres
    # A signal that comes and rests fits a contact that has hardly moved.
    unclear = unclear or (contact is Contact.STOPPED and track.way_mm < limits.stopped_way_mm)
    if unclear or (track.partial > limits.partial and not lifted):
        return Reason.AMBIGUOUS
    return Reason.NONE


def apart(straight: Estimate, track: Track, since_s: float, limits: TrackLimits) -> float:
    """The squared Mahalanobis distance of a straight slide, as it was `since_s` ago, from the track; infinite
    where the way is short."""
    if track.way_mm < limits.straight_way_mm:
        return math.inf
    velocity = np.array([straight.vx_mm_s, straight.vy_mm_s])
    place = np.array([straight.x_mm, straight.y_mm]) - since_s * velocity
    off = np.concatenate([place, velocity]) - track.mean
    # The floors of the intervals, as standard deviations: both read the same blocks.
    floor = np.array([limits.place_mm, limits.place_mm, limits.speed_mm_s, limits.speed_mm_s])
    spread = track.covariance + np.diag(floor**2)
    return float(off @ np.linalg.solve(spread, off))


def likely(track: Track, distance: float, limits: TrackLimits) -> bool:
    """Whether a straight slide is likely at a distance, as of `apart`, from a track that is not valid itself.

    The odds are of a contact against a signal that none makes, which seldom agrees with a straight slide for long, and
    is often weak.
    """
    further_mm = track.way_mm - limits.straight_way_mm
    log_odds = track.evidence.log_odds - 0.5 * distance + limits.way_log_odds * further_mm
    return (
        log_odds >= limits.straight_log_odds
        and track.evidence.triggers >= limits.triggers
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
    near_mm = math.sqrt(limits.agreement) * half_mm / limits.half_width
    if abs(across_mm) > near_mm or not -near_mm <= along_mm <= longest_mm + near_mm:
        return False
    if track.reason in (Reason.NONE, Reason.AMBIGUOUS) and rests(track, line, limits):
        return True
    slow = track.speed_mm_s < limits.slow_share * line.speed_mm_s
    return elapsed_s <= limits.stopping_s and (slow or track.reason is Reason.NOT_THIS_SENSOR)


def rests(track: Estimate, line: Estimate, limits: TrackLimits) -> bool:
    """Whether a contact that slid along the line has come to rest, creep apart, as far as its track shows."""
    creep_mm_s = max(limits.stopped_mm_s, limits.creep_share * line.speed_mm_s)
    return track.speed_mm_s < creep_mm_s or track.speed_lo_mm_s <= 0.0


def stopped_on(line: Estimate, track: Estimate, limits: TrackLimits, ended: bool) -> Estimate:
    """The track of a contact that stops on a line: the line with its direction and distance, and how far it went.

    ended: the stop is no pause, so that the slide has ended. Then, and until the contact rests, the speed is the
    slide's.
    """
    along_mm, _ = _on_line(line, track)
    angle = math.radians(line.direction_deg)
    now = {"x_mm": line.x_mm + along_mm * math.cos(angle), "y_mm": line.y_mm + along_mm * math.sin(angle)}
    at_rest = ended or rests(track, line, limits)
    if at_rest:
        now |= {"vx_mm_s": 0.0, "vy_mm_s": 0.0, "speed_mm_s": 0.0}
    changed: dict[str, Any] = {}
    for name, value in now.items():
        low, high = _ends(name)
        half = (getattr(track, high) - getattr(track, low)) / 2
        changed |= {name: value, low: value - half, high: value + half}
    for name in ("direction_deg", "offset_mm", "depth_mm", *(["speed_mm_s"] if ended or not at_rest else [])):
        changed |= {each: getattr(line, each) for each in (name, *_ends(name))}
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


def _ends(name: str) -> tuple[str, str]:
    """Names of the interval of a quantity, x_lo_mm and x_hi_mm of x_mm."""
    quantity, unit = name.split("_", 1)
    return f"{quantity}_lo_{unit}", f"{quantity}_hi_{unit}"


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
    across = (straight.offset_hi_mm - straight.offset_lo_mm) / 2
    along_x, along_y = (tracked.x_hi_mm - tracked.x_lo_mm) / 2, (tracked.y_hi_mm - tracked.y_lo_mm) / 2
    x_half, y_half = math.hypot(across * sin, along_x * cos), math.hypot(across * cos, along_y * sin)
    if math.isnan(straight.depth_lo_mm):
        straight = straight._replace(depth_lo_mm=tracked.depth_lo_mm, depth_hi_mm=tracked.depth_hi_mm)
    speed_half = (straight.speed_hi_mm_s - straight.speed_lo_mm_s) / 2
    turn_half = straight.speed_mm_s * math.radians(straight.direction_hi_deg - straight.direction_lo_deg) / 2
    vx_half, vy_half = (
        math.hypot(speed_half * cos, turn_half * sin),
        math.hypot(speed_half * sin, turn_half * cos),
    )
    straight = straight._replace(
        contact=Contact.SLIDE,
        x_lo_mm=straight.x_mm - x_half,
        x_hi_mm=straight.x_mm + x_half,
        y_lo_mm=straight.y_mm - y_half,
        y_hi_mm=straight.y_mm + y_half,
        vx_lo_mm_s=straight.vx_mm_s - vx_half,
        vx_hi_mm_s=straight.vx_mm_s + vx_half,
        vy_lo_mm_s=straight.vy_mm_s - vy_half,
        vy_hi_mm_s=straight.vy_mm_s + vy_half,
    )
    if shared is None:
        return straight
    wider = {}
    bent = dict(zip(_BENT, straight.bent or (), strict=False))
    for name in ("direction_deg", "speed_mm_s", "offset_mm", "x_mm", "y_mm", "vx_mm_s", "vy_mm_s"):
        low, high = _ends(name)
        value, apart = getattr(straight, name), getattr(tracked, name) - getattr(straight, name)
        if name == "direction_deg":
            apart = wrapped_deg(apart)
        half = shared * (getattr(tracked, high) - getattr(tracked, low)) / 2
        room = bent.get(name, math.inf) if abs(apart) <= half else math.inf
        wider[low] = min(getattr(straight, low), max(value + apart - half, value - room))
        wider[high] = max(getattr(straight, high), min(value + apart + half, value + room))
    return straight._replace(**wider)
