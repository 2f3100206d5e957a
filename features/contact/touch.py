"""Hypotheses at a touch: where on the skin the output could come from.

A contact comes over the chamber's rim at full depth, or is pressed on anywhere inside, when its gain starts from
nothing. After the track has been lost it may be anywhere at full depth.
"""

from dataclasses import dataclass

import numpy as np

from softslide.features.contact.calibration import ContactCalibration
from softslide.features.contact.hypotheses import (
    ACCELERATION,
    CURVATURE,
    DEPTH,
    FRICTION,
    GAIN,
    HEADING,
    RESIDUAL,
    RISE,
    SPEED,
    Hypotheses,
    X,
    Y,
    expected,
    joined,
    placed,
    started,
)
from softslide.features.contact.response_surface import ResponseSurface

GRID_MM = 2.5
HEADINGS = 8
HEADING_SD = 0.35  # rad: nearly half the angle between two of them
SPEEDS_MM_S = (0.2, 40.0)
RIM_MM = (5.0, 9.0)  # outside and inside the chamber's edge, where a contact over the rim first shows
GATE = 18.0  # chi-square of a place for two channels
PLACE_SHARE = 0.1  # of the expected output, by which the nearest place of the grid may be off
PRESSED_SHARE = 0.08  # of the present output, by which a partial contact's shape differs from the whole one's
# Standard deviation of the friction along x and y where a contact was pressed on, 1: as large as where it slides
# (root mean square of 23 presses of the solver; most of it points outwards).
PRESSED_FRICTION = 0.2
SETTLING = 5  # iterations; ten of eleven places are then off by 0.06 mm or less (experiments/LOG.md)
PRESSED = 0.3  # prior probability that a touch is pressed on inside the skin


@dataclass(frozen=True)
class Onset:
    """What the last blocks show: level (C,) V and slope (C,) V/s of the subtracted output, and their standard
    deviations."""

    level: np.ndarray
    slope: np.ndarray
    level_sd: np.ndarray
    slope_sd: np.ndarray


def onset(recent: np.ndarray, block_s: float, noise_v: np.ndarray) -> Onset:
    """A line through the last blocks (m, C) V, read at the last one. noise_v: (C,) V of one block, infinite for a
    channel that is left out."""
    time = (np.arange(len(recent)) - len(recent) + 1.0) * block_s
    design = np.stack([np.ones_like(time), time], axis=1)
    covariance = np.linalg.inv(design.T @ design)
    level, slope = covariance @ design.T @ recent
    level_sd, slope_sd = np.sqrt(np.diag(covariance))[:, None] * noise_v
    return Onset(level, slope, level_sd, slope_sd)


def at_touch(
    seen: Onset, surface: ResponseSurface, calibration: ContactCalibration, most: int, anywhere: bool = False
) -> Hypotheses | None:
    """The most likely hypotheses, at most `most`; None if no place fits. anywhere: at full depth not only near the
    rim."""
    bank = joined([_over_rim(seen, surface, calibration, anywhere), _pressed_on(seen, surface, calibration)])
    if not len(bank):
        return None
    best = bank.likeliest(most)
    best.log_weight -= best.log_weight.max()
    return best


def at_rest(
    seen: Onset, surface: ResponseSurface, calibration: ContactCalibration, residual_v: float
) -> Hypotheses | None:
    """Whole contacts that rest where they were pressed on: where the map inside answers as the level; None if nowhere.

    residual_v: V, what the map leaves of an output as large as the level.
    """
    x, y = _inner_grid(calibration)
    response = surface.at(x, y)
    shown, slopes = response[:, 0, 0], response[:, 1:, 0]
    variance = seen.level_sd**2 + residual_v**2 + (slopes**2).sum(1) * (GRID_MM / 2) ** 2
    misfit = ((seen.level - shown) ** 2 / variance).sum(1)
    n = np.flatnonzero(misfit < GATE)
    if not len(n):
        return None
    state, sd = placed(x[n], y[n], surface.channels), _deviations(len(n), calibration, residual_v)
    state[:, SPEED] = 0.01
    sd[:, HEADING], sd[:, SPEED], sd[:, ACCELERATION] = 3.0, 0.05, 0.01
    sd[:, FRICTION] = PRESSED_FRICTION
    bank = started(state, sd, np.full(len(n), -np.log(len(n))), partial=False)
    _settle(bank, seen.level, seen.level_sd**2, surface)
    return bank


def _deviations(count: int, calibration: ContactCalibration, residual_v: float) -> np.ndarray:
    """(count, n): standard deviations of whole contacts anywhere in a cell of the grid; of their motion none."""
    sd = np.zeros((count, RESIDUAL + len(calibration.noise_v)))
    sd[:, X] = sd[:, Y] = GRID_MM / 2
    sd[:, CURVATURE], sd[:, GAIN], sd[:, DEPTH] = 0.01, calibration.gain_sd, calibration.depth_sd_mm
    sd[:, RESIDUAL:] = residual_v
    return sd


def _settle(bank: Hypotheses, level: np.ndarray, variance: np.ndarray, surface: ResponseSurface) -> None:
    """Corrects and weighs hypotheses by a level (C,) V of that variance (C,) V^2, each linearized where it ends: an
    iterated extended Kalman filter (Bell and Cathey, IEEE Trans. Autom. Control 38, 1993). Over a cell of the grid the
    map bends."""
    first = bank.state
    for _ in range(SETTLING):
        shown, by_state = expected(bank, surface)
        crossed = bank.covariance @ by_state.transpose(0, 2, 1)
        spread = by_state @ crossed + np.diag(variance)
        gap = (level - shown)[:, :, None] + by_state @ (bank.state - first)[:, :, None]
        pull = np.linalg.solve(spread, gap)
        bank.state = first + (crossed @ pull)[:, :, 0]
    bank.log_weight -= 0.5 * ((gap * pull).sum((1, 2)) + np.linalg.slogdet(spread)[1])
    bank.covariance -= crossed @ np.linalg.solve(spread, crossed.transpose(0, 2, 1))


def _grid(half_mm: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    axes = [np.arange(-h - RIM_MM[0], h + RIM_MM[0] + 1e-6, GRID_MM) for h in half_mm]
    x, y = np.meshgrid(*axes, indexing="ij")
    return x.ravel(), y.ravel()


def _inner_grid(calibration: ContactCalibration) -> tuple[np.ndarray, np.ndarray]:
    """Where a contact may be pressed on: off the chamber's edge."""
    half_mm = calibration.chamber_half_mm
    x, y = _grid(half_mm)
    inner = (np.abs(x) < half_mm[0] - GRID_MM) & (np.abs(y) < half_mm[1] - GRID_MM)
    return x[inner], y[inner]


def _over_rim(
    seen: Onset, surface: ResponseSurface, calibration: ContactCalibration, anywhere: bool
) -> Hypotheses:
    """Contacts at full depth: the place from the level, the speed along each heading from the slope."""
    half_mm, floor_v = calibration.chamber_half_mm, calibration.floor_v
    x, y = (np.tile(axis, HEADINGS) for axis in _grid(half_mm))
    heading = np.repeat(np.arange(HEADINGS) * 2 * np.pi / HEADINGS, len(x) // HEADINGS)
    motion = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    response = surface.at(x, y)
    raw = (
        response[:, :, 0] + motion[:, None, :1] * response[:, :, 1] + motion[:, None, 1:] * response[:, :, 2]
    )
    shown, slopes = raw[:, 0], raw[:, 1:]
    along = (motion[:, :, None] * slopes).sum(1)
    variance = (
        seen.level_sd**2 + floor_v**2 + (slopes**2).sum(1) * (GRID_MM / 2) ** 2 + (PLACE_SHARE * shown) ** 2
    )
    misfit = ((seen.level - shown) ** 2 / variance).sum(1)
    precision = (along**2 / seen.slope_sd**2).sum(1) + 1e-12
    speed = (along * seen.slope / seen.slope_sd**2).sum(1) / precision
    # A slope is no better known than the map's own slope is over a cell of the grid.
    coarse = (0.3 * seen.slope) ** 2 + (0.15 * speed * np.abs(along).max(1))[:, None] ** 2
    off_slope = ((seen.slope - speed[:, None] * along) ** 2 / (seen.slope_sd**2 + coarse)).sum(1)
    inside = np.minimum(half_mm[0] - np.abs(x), half_mm[1] - np.abs(y))
    nearer_x = half_mm[0] - np.abs(x) < half_mm[1] - np.abs(y)
    inward = np.where(nearer_x, -np.sign(x) * motion[:, 0], -np.sign(y) * motion[:, 1])
    possible = (misfit < GATE) & (speed > SPEEDS_MM_S[0] / 2) & (speed < 1.5 * SPEEDS_MM_S[1])
    if not anywhere:
        possible &= (inside < RIM_MM[1]) & (inward > -0.2)
    n = np.flatnonzero(possible)
    speed = np.clip(speed[n], *SPEEDS_MM_S)
    state, sd = placed(x[n], y[n], surface.channels), _deviations(len(n), calibration, floor_v)
    state[:, HEADING], state[:, SPEED], state[:, FRICTION] = heading[n], speed, motion[n]
    sd[:, HEADING] = HEADING_SD
    sd[:, SPEED] = np.minimum(precision[n] ** -0.5, speed) + 0.3 * speed
    sd[:, ACCELERATION] = 0.005 * speed**2 + 0.01
    bank = started(state, sd, -0.5 * (misfit + off_slope)[n], partial=False)
    # The friction has the direction of the motion.
    turned = np.stack([-motion[n, 1], motion[n, 0]], axis=1) * HEADING_SD**2
    bank.covariance[:, FRICTION, HEADING] = bank.covariance[:, HEADING, FRICTION] = turned
    bank.covariance[:, FRICTION, FRICTION] += turned[:, :, None] * turned[:, None] / HEADING_SD**2
    return bank


def _pressed_on(seen: Onset, surface: ResponseSurface, calibration: ContactCalibration) -> Hypotheses:
    """Contacts that are still being pressed on: the gain from the level, no motion yet."""
    floor_v = calibration.floor_v
    x, y = _inner_grid(calibration)
    shown = surface.at(x, y)[:, 0, 0]
    use = np.isfinite(seen.level_sd)
    size = (shown[:, use] ** 2).sum(1) + 1e-12
    gain, rise = (shown[:, use] @ each[use] / size for each in (seen.level, seen.slope))
    rise_sd = np.sqrt(shown[:, use] ** 2 @ seen.slope_sd[use] ** 2) / size
    variance = seen.level_sd**2 + floor_v**2 + (PRESSED_SHARE * np.abs(seen.level).max()) ** 2
    misfit = ((seen.level - gain[:, None] * shown) ** 2 / variance).sum(1)
    n = np.flatnonzero((gain > 0.005) & (gain < 1.1) & (misfit < GATE))
    state, sd = placed(x[n], y[n], surface.channels), _deviations(len(n), calibration, floor_v)
    state[:, SPEED], state[:, GAIN], state[:, RISE] = 0.01, gain[n], rise[n]
    sd[:, HEADING], sd[:, SPEED], sd[:, ACCELERATION] = 3.0, 1.0, 0.01
    sd[:, FRICTION] = PRESSED_FRICTION
    sd[:, GAIN], sd[:, RISE] = 0.3 * gain[n] + 0.05, np.hypot(0.3 * rise[n], rise_sd[n])
    # The prior is shared among the places that fit.
    log_prior = np.log(PRESSED) - np.log(max(len(n), 1) / 30)
    return started(state, sd, log_prior - 0.5 * misfit[n], partial=True)
