"""The estimate, and how it is made of one row of the graph's output."""

import math
from collections.abc import Mapping
from enum import StrEnum
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from softslide.features.card import BENT, COVERAGE, HALF_WIDTH_SD, Card, Interval
from softslide.features.contact.places import Place
from softslide.features.stream.tracker import SlideState
from softslide.features.window import Window


class Contact(StrEnum):
    """What touches the skin: nothing, something that presses on one place, slides, or has stopped."""

    NONE = "none"
    PRESS = "press"
    SLIDE = "slide"
    STOPPED = "stopped"


class Reason(StrEnum):
    """Why an estimate is not valid; empty when it is.

    no_contact: nothing touches. unknown_zero: the static output is not known yet. too_early: the contact has not moved
    enough, or its output is weak. ambiguous: several places or headings explain the output. off_map: the contact is
    where the calibration does not reach, or its speed is outside the range. not_this_sensor: the output fits no contact
    on this skin. strength: what explains the output shows less than any contact does. drift: gravity's length changes
    with the output, as it does not on a skin that only tilts. dead_channel: an accelerometer is lost, frozen or
    clipped. skin_height: the static output shows the skin at a height that the calibration does not reach, as of
    another pressure. attitude: gravity shows the sensor turned from how it was calibrated. no_signal: no samples come.
    """

    NONE = ""
    NO_CONTACT = "no_contact"
    UNKNOWN_ZERO = "unknown_zero"
    TOO_EARLY = "too_early"
    AMBIGUOUS = "ambiguous"
    OFF_MAP = "off_map"
    NOT_THIS_SENSOR = "not_this_sensor"
    STRENGTH = "strength"
    DRIFT = "drift"
    DEAD_CHANNEL = "dead_channel"
    SKIN_HEIGHT = "skin_height"
    ATTITUDE = "attitude"
    NO_SIGNAL = "no_signal"


class Estimate(NamedTuple):
    """What is known at one moment. NaN: not estimated. lo and hi bound a 90 % interval.

    time_s: end of the last block. direction_deg: of the motion, in [0, 360), 0 along +x and 90 along +y; its lo and hi
    may lie outside that range. offset_mm: signed distance from the card's reference point to the line of motion,
    positive where the line lies to the left of the motion. depth_mm: of the indentation. x_mm, y_mm: the contact in the
    skin's plane, from the chamber's centre. valid: false where the model abstains.
    contact: what touches; reason: why the estimate is not valid. vx_mm_s, vy_mm_s: the velocity. misfit: reduced
    chi-square of the straight slide at constant speed.
    force_mn: of the skin on the object, normal to the flat skin; tangential_force_mn: the size of its part in the
    plane.
    accelerometers: number that the slide is read from, 0 without a slide. zero_shift_v, gain, turn_deg: the sensor's
    drift (features/stream/drift.py).
    places: where the contact may be, the likeliest first, while several places explain the output.
    skin_height_mm: of the inflated skin, as given or estimated from the static output, of bundles over heights
    (features/height.py).
    age_s: of the newest sample, where a live stream shows it; 0 of a recording.
    bent: of a valid straight slide, half-widths of the direction's, speed's and offset's intervals (deg, mm/s, mm) that
    hold for ways as well that bend, or change speed or depth, by less than shows; no part of a record.
    """

    time_s: float
    state: SlideState
    direction_deg: float = math.nan
    direction_lo_deg: float = math.nan
    direction_hi_deg: float = math.nan
    speed_mm_s: float = math.nan
    speed_lo_mm_s: float = math.nan
    speed_hi_mm_s: float = math.nan
    offset_mm: float = math.nan
    offset_lo_mm: float = math.nan
    offset_hi_mm: float = math.nan
    depth_mm: float = math.nan
    x_mm: float = math.nan
    y_mm: float = math.nan
    valid: bool = False
    accelerometers: int = 0
    zero_shift_v: float = math.nan
    gain: float = math.nan
    turn_deg: float = math.nan
    contact: Contact = Contact.NONE
    reason: Reason = Reason.NONE
    vx_mm_s: float = math.nan
    vy_mm_s: float = math.nan
    x_lo_mm: float = math.nan
    x_hi_mm: float = math.nan
    y_lo_mm: float = math.nan
    y_hi_mm: float = math.nan
    vx_lo_mm_s: float = math.nan
    vx_hi_mm_s: float = math.nan
    vy_lo_mm_s: float = math.nan
    vy_hi_mm_s: float = math.nan
    depth_lo_mm: float = math.nan
    depth_hi_mm: float = math.nan
    misfit: float = math.nan
    force_mn: float = math.nan
    force_lo_mn: float = math.nan
    force_hi_mn: float = math.nan
    tangential_force_mn: float = math.nan
    tangential_force_lo_mn: float = math.nan
    tangential_force_hi_mn: float = math.nan
    places: tuple[Place, ...] = ()
    skin_height_mm: float = math.nan
    age_s: float = 0.0
    bent: tuple[float, float, float] | None = None


# Of a record, as `serve` writes it.
RECORDED = tuple(name for name in Estimate._fields if name != "bent")


@cache
def interval_ends(name: str) -> tuple[str, str]:
    """Names of the ends of a quantity's interval: x_lo_mm and x_hi_mm of x_mm."""
    quantity, unit = name.split("_", 1)
    return f"{quantity}_lo_{unit}", f"{quantity}_hi_{unit}"


def bounded(**quantities: tuple[float, float]) -> dict[str, Any]:
    """Fields of an estimate: of each quantity, given as its value and its interval's half-width, value and ends."""
    known = {}
    for name, (value, half) in quantities.items():
        low, high = interval_ends(name)
        known[name], known[low], known[high] = value, value - half, value + half
    return known


def bounded_direction(angle_rad: float, half_deg: float) -> dict[str, Any]:
    """The same of the direction."""
    degrees = math.degrees(angle_rad) % 360.0
    # An angle just below 0 is rounded to 360.
    return bounded(direction_deg=(degrees, half_deg)) | {"direction_deg": degrees % 360.0}


_NO_INTERVAL = Interval(math.nan, math.nan)
MIXED_STEPS = 16  # of bisection: 1e-4 of a width


def decode(
    row: np.ndarray, card: Card, window: Window, state: SlideState, time_s: float, width_s: float
) -> Estimate:
    """The estimate of a row (K,) of the graph, in the card's order of outputs.

    time_s: the estimate's. width_s: the window's energy width, read where the graph gives the logarithm of speed
    times width (`log_speed_width`). With direction a, offset o and distance s along the line from the foot of the
    perpendicular: x = x_ref - o sin(a) + s cos(a), y = y_ref + o cos(a) + s sin(a).
    """
    value = dict(zip(card.outputs, row.tolist(), strict=True))
    direction = math.atan2(value["direction_sin"], value["direction_cos"])
    log_speed = value["log_speed"] if "log_speed" in value else value["log_speed_width"] - math.log(width_s)
    offset, along = value["offset_mm"], value.get("along_mm", math.nan)
    direction_sd, speed_sd = value.get("direction_sd_deg", 0.0), value.get("log_speed_sd", 0.0)
    depth, strain = value.get("depth_mm", math.nan), value.get("strain", 0.0)
    direction_half, speed_half, offset_half, depth_half = (
        card.intervals.get(name, _NO_INTERVAL).half_width(sd, strain)
        for name, sd in (
            ("direction_deg", direction_sd),
            ("log_speed", speed_sd),
            ("offset_mm", value.get("offset_sd_mm", 0.0)),
            ("depth_mm", value.get("depth_sd_mm", math.nan)),
        )
    )
    # Clamped, so that exp cannot overflow whatever a graph answers.
    speed_factor = math.exp(min(speed_half, 50.0))
    speed = math.exp(min(max(log_speed, -50.0), 50.0))
    cos, sin = math.cos(direction), math.sin(direction)
    limits = card.validity
    reason = Reason.NONE
    if not (math.isfinite(direction + log_speed + offset) and value.get("misfit", 0.0) <= limits.misfit):
        reason = Reason.NOT_THIS_SENSOR
    elif direction_sd > limits.direction_sd_deg or speed_sd > limits.log_speed_sd:
        reason = Reason.AMBIGUOUS
    elif not (limits.speed_mm_s[0] <= speed <= limits.speed_mm_s[1] and abs(offset) <= limits.offset_mm):
        reason = Reason.OFF_MAP
    elif max(float(window.volts.max()), -float(window.volts.min())) < limits.peak_v:
        reason = Reason.TOO_EARLY
    return Estimate(
        time_s=time_s,
        state=state,
        speed_mm_s=speed,
        speed_lo_mm_s=speed / speed_factor,
        speed_hi_mm_s=speed * speed_factor,
        x_mm=card.reference_mm[0] - offset * sin + along * cos,
        y_mm=card.reference_mm[1] + offset * cos + along * sin,
        valid=reason is Reason.NONE,
        contact=Contact.SLIDE,
        reason=reason,
        vx_mm_s=speed * cos,
        vy_mm_s=speed * sin,
        misfit=value.get("misfit", math.nan),
        bent=_bent(value, direction_half, speed * speed_half, offset_half) if reason is Reason.NONE else None,
        **bounded_direction(direction, direction_half),
        **bounded(offset_mm=(offset, offset_half), depth_mm=(depth, depth_half)),
    )


def _bent(value: Mapping[str, float], *half: float) -> tuple[float, float, float] | None:
    """`Estimate.bent`, where the graph says how probable a straight slide is, whose half-widths are given."""
    if not math.isfinite(straight := value.get("straight", math.nan)):
        return None
    direction, speed, offset = (
        width * mixed_width(straight, value[name]) for width, name in zip(half, BENT, strict=True)
    )
    return direction, speed, offset


def mixed_width(weight: float, wider: float) -> float:
    """A 90 % interval's half-width over the one of a centred normal distribution, which has this weight in a mixture
    with another, so many times as wide (1 or more)."""
    wider = max(wider, 1.0)
    least, most = 1.0, wider
    for _ in range(MIXED_STEPS):
        middle = math.sqrt(least * most)
        z = middle * HALF_WIDTH_SD / math.sqrt(2.0)
        held = weight * math.erf(z) + (1.0 - weight) * math.erf(z / wider)
        least, most = (middle, most) if held < COVERAGE else (least, middle)
    return most
