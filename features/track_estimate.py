"""From a track to an estimate: intervals, what the contact does, and whether it may be believed."""

import math
from dataclasses import dataclass

import numpy as np

from softslide.features.contact.track import Track
from softslide.features.estimate import Contact, Estimate, Reason, bounded, bounded_direction
from softslide.features.stream.tracker import SlideState

# All limits are chosen on synthetic paths (experiments/LOG.md).
#
# 90 % half-widths over the filters' standard deviations, which neglect the map's curvature and keep only the likeliest
# hypotheses; and never less than these.
HALF_WIDTH, HEADING_WIDTH = 1.9, 1.7
LEAST_MM, LEAST_MM_S, LEAST_DEG = 0.03, 0.02, 0.3
# Of a valid estimate: largest standard deviation of the place; least weight of the hypotheses near the best one;
# largest chi-square over its degrees of freedom, of the innovations and of the map's residual; the largest output since
# the touch, over the trigger, is at least TRIGGERS.
PLACE_SD_MM, CERTAIN, MISFIT, TRIGGERS = 1.6, 0.97, 2.2, 4.0
# Largest weight of hypotheses that the contact is being pressed on or lifted, unless more channels than that has
# unknowns, its place and its gain, have followed it for PARTIAL_WAY_MM.
PARTIAL, PARTIAL_UNKNOWNS, PARTIAL_WAY_MM = 0.3, 3, 4.0
SLIDE_WAY_MM = 1.5  # least way of a slide; what has gone less is a press
# A contact slower than this has stopped; its least way.
STOPPED_MM_S, STOPPED_WAY_MM = 0.15, 4.0
# Of a valid press: largest speed and standard deviation of the place.
PRESS_MM_S, PRESS_SD_MM = 0.3, 1.0
# Where the evidence is clear, a track is valid up to these.
SURE_CERTAIN, SURE_HEADING_SD_DEG = 0.8, 16.0


@dataclass(frozen=True)
class TrackLimits:
    """What differs between contacts over a rim and ones that come down anywhere.

    heading_sd_deg: largest standard deviation of a valid estimate. evidence: least logarithm of the odds of a contact
    against a smooth signal of no known origin. valid_way_mm: least way of a valid track. manoeuvres,
    straight_manoeuvres: most over the way, of a track and of one that a straight slide agrees with.
    agreement: largest squared Mahalanobis distance of the straight slide from the track, four degrees of freedom.
    straight_way_mm: least way of a straight slide. straight_log_odds: least logarithm of the odds of a straight slide
    that a track agrees with which is not valid itself, against a signal that no contact makes.
    sure_log_odds: evidence from which a track is sure: valid although the output has not moved on since the touch, and
    up to SURE_CERTAIN and SURE_HEADING_SD_DEG. shared: share of the track's half-widths about its own estimate that the
    straight slide's intervals hold too; None: they stay as they are.
    """

    heading_sd_deg: float = 12.0
    evidence: float = -1.0
    valid_way_mm: float = 1.5
    manoeuvres: float = math.inf
    straight_manoeuvres: float = math.inf
    agreement: float = 25.0
    straight_way_mm: float = 8.0
    straight_log_odds: float = -3.0
    sure_log_odds: float = 5.0
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


def judged(
    track: Track,
    time_s: float,
    state: SlideState,
    reference_mm: tuple[float, float],
    map_depth_mm: float,
    limits: TrackLimits,
) -> Estimate:
    """The track as an estimate; `reason` says why it is not valid. map_depth_mm: the calibration's contact depth."""
    if pressed := _is_press(track):
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
    x_half, y_half, vx_half, vy_half = (HALF_WIDTH * sd).tolist()
    speed_half = HALF_WIDTH * speed_sd + LEAST_MM_S
    heading_half = min(HEADING_WIDTH * math.degrees(heading_sd) + LEAST_DEG, 180.0)
    offset, offset_half = float(across @ from_reference), HALF_WIDTH * offset_sd + LEAST_MM
    contact = Contact.SLIDE
    lifted = track.evidence.channels > PARTIAL_UNKNOWNS and track.way_mm > PARTIAL_WAY_MM
    if (track.partial > 0.5 and not lifted) or track.way_mm < SLIDE_WAY_MM or track.evidence.one_press:
        contact = Contact.PRESS
    elif speed < STOPPED_MM_S:
        contact = Contact.STOPPED
    depth, depth_half = map_depth_mm + track.depth_mm, HALF_WIDTH * track.depth_sd_mm
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
        x_mm=(x, x_half + LEAST_MM),
        y_mm=(y, y_half + LEAST_MM),
        vx_mm_s=(vx, vx_half + LEAST_MM_S),
        vy_mm_s=(vy, vy_half + LEAST_MM_S),
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


def _is_press(track: Track) -> bool:
    """Whether the track is a press without motion, at a place that is known. Since neither a tilt nor a change of
    pressure can have made it, it needs neither way nor evidence of a slide."""
    return (
        track.evidence.presses
        and float(np.hypot(*track.mean[2:])) < PRESS_MM_S
        and float(track.covariance[:2, :2].trace()) < PRESS_SD_MM**2
        and track.certain >= CERTAIN
        and _misfit(track) <= MISFIT
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
    if _misfit(track) > MISFIT:
        return Reason.NOT_THIS_SENSOR
    if track.way_mm < limits.valid_way_mm or track.evidence.triggers < TRIGGERS:
        return Reason.TOO_EARLY
    # A contact adds to the output: none has a negative gain.
    if track.evidence.log_odds < limits.evidence or track.gain <= 0.0:
        return Reason.NOT_THIS_SENSOR
    most_deg, certain = limits.heading_sd_deg, CERTAIN
    if is_sure(track, limits):
        most_deg, certain = SURE_HEADING_SD_DEG, SURE_CERTAIN
    unclear = place_sd_mm > PLACE_SD_MM or (heading_sd_deg > most_deg and contact is not Contact.STOPPED)
    # What one press at a place nearby shows as well is ambiguous.
    unclear = unclear or track.evidence.one_press or track.certain < certain
    unclear = unclear or track.manoeuvres > limits.manoeuvres
    # A signal that comes and rests fits a contact that has hardly moved.
    unclear = unclear or (contact is Contact.STOPPED and track.way_mm < STOPPED_WAY_MM)
    if unclear or (track.partial > PARTIAL and not lifted):
        return Reason.AMBIGUOUS
    return Reason.NONE
