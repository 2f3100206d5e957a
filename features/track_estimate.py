"""From a track to an estimate: intervals, what the contact does, and whether it may be believed."""

import math
from dataclasses import dataclass

import numpy as np

from softslide.features.contact.track import Track
from softslide.features.estimate import Contact, Estimate, Reason, bounded, bounded_direction
from softslide.features.stream.tracker import SlideState


@dataclass(frozen=True)
class TrackLimits:
    """Chosen on synthetic paths (experiments/LOG.md).

    half_width, heading_width: 90 % half-widths over the filters' standard deviations; the filters neglect the map's
    curvature and keep only the likeliest hypotheses. place_mm, speed_mm_s, heading_deg: and never less than these.
    place_sd_mm, heading_sd_deg: largest standard deviations of a valid estimate. certain: least weight of the
    hypotheses near the best one. misfit: largest chi-square over its degrees of freedom, of the innovations and of the
    map's residual. partial: largest weight of hypotheses that the contact is being pressed on or lifted, unless more
    channels than that has unknowns have followed it for partial_way_mm. evidence: least logarithm of the odds of a
    contact against a smooth signal of no known origin. triggers: the largest output since the touch, over the trigger,
    is at least that. way_mm: least way, and valid_way_mm: of a valid track. manoeuvres, straight_manoeuvres: most over
    the way, of a track and of one that a straight slide agrees with.
    stopped_mm_s: a contact slower than this has stopped; stopped_way_mm: its least way.
    agreement: largest squared Mahalanobis distance of the straight slide from the track, four degrees of freedom.
    stopping_s: for which a line is held while a contact seems to be slower than slow_share of the slide, or is lost;
    it rests once it is slower than rest_share, where it may stand still, and has stopped for good after pause_s.
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
    rest_share: float = 0.25
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
# less than likely; the evidence of a contact was -74 at least, that of other signals -129 at most. A track that needed
# a bend is wrong at the next one as often as it is right (experiments/LOG.md).
TOUCH_LIMITS = TrackLimits(
    heading_sd_deg=13.0,
    valid_way_mm=11.0,
    straight_way_mm=9.0,
    manoeuvres=0.3,
    straight_manoeuvres=0.8,
    shared=None,
    agreement=LIKELY,
    evidence=-80.0,
    straight_log_odds=-80.0,
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
    speed_half = limits.half_width * speed_sd + limits.speed_mm_s
    heading_half = min(limits.heading_width * math.degrees(heading_sd) + limits.heading_deg, 180.0)
    offset, offset_half = float(across @ from_reference), limits.half_width * offset_sd + limits.place_mm
    contact = Contact.SLIDE
    lifted = track.evidence.channels > PARTIAL_UNKNOWNS and track.way_mm > limits.partial_way_mm
    if (track.partial > 0.5 and not lifted) or track.way_mm < limits.way_mm or track.evidence.one_press:
        contact = Contact.PRESS
    elif speed < limits.stopped_mm_s:
        contact = Contact.STOPPED
    depth, depth_half = map_depth_mm + track.depth_mm, limits.half_width * track.depth_sd_mm
    reason = _reason(track, math.hypot(sd[0], sd[1]), math.degrees(heading_sd), contact, lifted, limits)
    if reason is Reason.NONE and depth + depth_half < 0.0:
        # Less than a contact at all shows: what it explains is another object, or another amplitude.
        reason = Reason.STRENGTH
    if pressed:
        contact, reason = Contact.PRESS, Reason.NONE
        # It goes nowhere. How far it is pressed in shows as how far it is pressed on does; the force is how hard.
        heading = offset = depth = math.nan
    known = bounded_direction(heading, heading_half) | bounded(
        speed_mm_s=(speed, speed_half),
        offset_mm=(offset, offset_half),
        depth_mm=(depth, depth_half),
        x_mm=(x, x_half + limits.place_mm),
        y_mm=(y, y_half + limits.place_mm),
        vx_mm_s=(vx, vx_half + limits.speed_mm_s),
        vy_mm_s=(vy, vy_half + limits.speed_mm_s),
    )
    known["speed_lo_mm_s"] = max(known["speed_lo_mm_s"], 0.0)
    return Estimate(
        time_s=time_s,
        state=state,
        valid=reason is Reason.NONE,
        contact=contact,
        reason=reason,
        places=track.places,
        **known,
    )


def _is_press(track: Track, limits: TrackLimits) -> bool:
    """Whether the track is a press without motion, at a place that is known. Since neither a tilt nor a change of
    pressure can have made it, it needs neither way nor evidence of a slide."""
    return (
        track.evidence.presses
        and float(np.hypot(*track.mean[2:])) < limits.press_mm_s
        and float(track.covariance[:2, :2].trace()) < limits.press_sd_mm**2
        and track.certain >= limits.certain
        and _misfit(track) <= limits.misfit
    )


def _misfit(track: Track) -> float:
    """Of the innovations or of what the map leaves of a contact at rest, whichever is larger."""
    return max(track.misfit, track.residual)


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
    if _misfit(track) > limits.misfit:
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
