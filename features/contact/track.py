"""A contact at one moment, as a bank of hypotheses has it: their mixture near the best one."""

import math
from typing import NamedTuple

import numpy as np

from softslide.features.contact.hypotheses import (
    DEPTH,
    GAIN,
    HEADING,
    MOTION,
    RESIDUAL,
    SPEED,
    Hypotheses,
    X,
    Y,
)
from softslide.features.contact.places import Place, likeliest_places

NEAR_MM = 2.5  # hypotheses this near the best one are of the same place


class ContactEvidence(NamedTuple):
    """What all of the output since the touch says of its being a contact.

    log_odds: of a contact against a signal that needs no map, forgotten as in `ContactTracker`. channels: that it is
    read from. triggers: the largest output, over the trigger. one_press: whether a press at one place, or a drift, may
    have made all of it. presses: whether then a press has made it, and neither a tilt of the device nor its pressure.
    """

    log_odds: float = 0.0
    channels: int = 0
    triggers: float = math.inf
    one_press: bool = False
    presses: bool = False


class Track(NamedTuple):
    """One moment. mean: (4,) x, y (mm), vx, vy (mm/s); covariance: (4, 4). certain: weight of the hypotheses near the
    best one. misfit: chi-square over its degrees of freedom. partial: weight of hypotheses that the contact is being
    pressed on or lifted. gain, depth_mm (off the map's): means; depth_sd_mm. way_mm: since the touch, at most 25.
    manoeuvres: how many it took over that way. residual: chi-square over C of the map's residual: what a contact at
    rest leaves stays so, and is no innovation. places: where the contact may be, while several are left.
    """

    mean: np.ndarray
    covariance: np.ndarray
    certain: float
    misfit: float
    partial: float
    gain: float
    depth_mm: float
    depth_sd_mm: float
    hypotheses: int
    way_mm: float
    manoeuvres: float = 0.0
    residual: float = 0.0
    places: tuple[Place, ...] = ()
    evidence: ContactEvidence = ContactEvidence()


def read(bank: Hypotheses, residual_v: float) -> Track:
    """The mixture of the hypotheses near the best one. residual_v: V, standard deviation of the map's residual."""
    return _mixture(bank, bank.state[:, MOTION], bank.covariance[:, MOTION, MOTION], residual_v)


def read_past(bank: Hypotheses, steps: int, residual_v: float) -> Track | None:
    """The same so many steps ago, from what was measured since; None where the likeliest does not go back so far."""
    if not 0 <= steps < bank.past.shape[1]:
        return None
    known = np.isfinite(bank.past[:, steps]).all(axis=1)
    if not known[bank.log_weight.argmax()]:
        return None
    bank = bank.take(known)
    return _mixture(bank, bank.past[:, steps], bank.past_covariance[:, steps], residual_v)


def _mixture(bank: Hypotheses, motion: np.ndarray, covariance: np.ndarray, residual_v: float) -> Track:
    """motion: (N, 4), each hypothesis's x, y, heading and speed; covariance: (N, 4, 4)."""
    weight, state = bank.weight, bank.state
    best = int(weight.argmax())
    cos, sin = np.cos(motion[:, HEADING]), np.sin(motion[:, HEADING])
    speed = motion[:, SPEED]
    mean = np.stack([motion[:, X], motion[:, Y], speed * cos, speed * sin], axis=1)
    near = np.hypot(*(mean[:, :2] - mean[best, :2]).T) < NEAR_MM
    certain = float(weight[near].sum())
    share = np.where(near, weight, 0.0) / certain
    slope = np.zeros((len(bank), 4, 4))
    slope[:, 0, 0] = slope[:, 1, 1] = 1.0
    slope[:, 2, 2], slope[:, 2, 3] = -speed * sin, cos
    slope[:, 3, 2], slope[:, 3, 3] = speed * cos, sin
    each = slope @ covariance @ slope.transpose(0, 2, 1)
    middle = share @ mean
    apart = mean - middle
    mixed = (share[:, None, None] * (each + apart[:, :, None] * apart[:, None])).sum(0)
    depth = state[:, DEPTH]
    depth_mm = float(share @ depth)
    variance = float(share @ (bank.covariance[:, DEPTH, DEPTH] + (depth - depth_mm) ** 2))
    return Track(
        middle,
        mixed,
        certain,
        float(share @ bank.misfit),
        float(weight @ bank.partial),
        float(share @ state[:, GAIN]),
        depth_mm,
        math.sqrt(max(variance, 0.0)),
        len(bank),
        float(share @ bank.age_mm),
        float(share @ bank.manoeuvres),
        float(share @ (state[:, RESIDUAL:] ** 2).mean(axis=1)) / residual_v**2,
        places=likeliest_places(mean[:, :2], weight, NEAR_MM),
    )


def moved_on(track: Track, elapsed_s: float) -> Track:
    """The same contact a moment later, going on as it goes."""
    slope = np.eye(4)
    slope[0, 2] = slope[1, 3] = elapsed_s
    return track._replace(mean=slope @ track.mean, covariance=slope @ track.covariance @ slope.T)
