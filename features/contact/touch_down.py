"""Hypotheses where a contact comes down anywhere within a block.

Nothing is known of such a skin but its recordings. What its map leaves is white from block to block and grows with the
response's slope and size: an error of place and one of gain that all channels share, and a part that is alike
everywhere. The first blocks show the place; each place gets a fan of headings and speeds, and the next steps decide
between them.
"""

import math

import numpy as np

from softslide.features.contact.calibration import ContactCalibration
from softslide.features.contact.hypotheses import (
    ACCELERATION,
    CURVATURE,
    FRICTION,
    GAIN,
    HEADING,
    SPEED,
    Hypotheses,
    LocalErrors,
    X,
    Y,
    placed,
    started,
)
from softslide.features.contact.response_surface import ResponseSurface
from softslide.features.contact.tracking_config import TINY

GRID_MM = 1.25
PLACES = 16  # at most, and not less likely than the best by more than PLACE_ODDS
PLACE_ODDS = 8.0  # logarithm
HEADINGS = 8
SPEEDS_MM_S = (8.0, 20.0, 45.0)
SPEED_SHARE = 0.4  # standard deviation of each of these
START_CURVATURE = 0.12  # 1/mm, standard deviation


def at_touch_down(
    volts: np.ndarray,
    variance: np.ndarray,
    surface: ResponseSurface,
    calibration: ContactCalibration,
    local: LocalErrors,
) -> Hypotheses:
    """The likeliest places, each with a fan of headings and speeds.

    volts: (C,) V, what the touch shows; variance: (C,) V^2 of a step's residual, infinite for a dead channel.
    """
    axes = [np.arange(-h, h + GRID_MM / 2, GRID_MM) for h in calibration.chamber_half_mm]
    x, y = (axis.ravel() for axis in np.meshgrid(*axes, indexing="ij"))
    use = np.isfinite(variance)
    response = surface.at(x, y)[:, :, 0][..., use]
    shown, slopes = response[:, 0], response[:, 1:]
    place = local.place_mm**2 + (GRID_MM / 2) ** 2
    spread = np.diag(variance[use]) + place * (slopes.transpose(0, 2, 1) @ slopes)
    spread = spread + calibration.gain_sd**2 * shown[:, :, None] * shown[:, None]
    gap = volts[use] - shown
    off = 0.5 * (
        (gap * np.linalg.solve(spread, gap[..., None])[..., 0]).sum(1) + np.linalg.slogdet(spread)[1]
    )
    places = np.argsort(off, kind="stable")[:PLACES]
    places = places[off[places] < off[places[0]] + PLACE_ODDS]
    at, turn, speed = (
        axis.ravel() for axis in np.meshgrid(places, np.arange(HEADINGS), SPEEDS_MM_S, indexing="ij")
    )
    heading = turn * 2 * np.pi / HEADINGS
    state = placed(x[at], y[at], surface.channels)
    state[:, HEADING], state[:, SPEED] = heading, speed
    state[:, FRICTION] = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    sd = np.full(state.shape, TINY)
    sd[:, X] = sd[:, Y] = GRID_MM / 2
    sd[:, HEADING], sd[:, SPEED] = math.pi / HEADINGS, SPEED_SHARE * speed
    sd[:, ACCELERATION], sd[:, CURVATURE], sd[:, GAIN] = 0.01, START_CURVATURE, calibration.gain_sd
    return started(state, sd, off[places[0]] - off[at], partial=False)
