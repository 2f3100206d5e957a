"""The path of a contact that has been recorded to its end: what follows a moment says as much of it as what came
before, which a live estimate does not have.

The likeliest places on a grid give a first curve, Gauss-Newton steps the likeliest one. How freely it bends and changes
speed is chosen by the evidence in Laplace's approximation (MacKay, Information Theory, Inference, and Learning
Algorithms, 2003, chapter 27). It is for maps of recordings alone, of contacts that come down and are lifted within a
block.
"""

import math
from dataclasses import dataclass, field
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from softslide.features.contact.hypotheses import LocalErrors
from softslide.features.contact.response_surface import ResponseSurface
from softslide.features.whole_contact.curve import Curve, curve_along
from softslide.features.whole_contact.first_places import Measured, first_places, whitening

LEAST_BLOCKS = 8
STEPS = 40  # of Gauss-Newton, at most
GAINED = 1e-3  # of the objective: a step that gains less is the last
DAMPING = (1e-6, 1e-2, 1e6)  # least, first and most, over the diagonal


class Steering(NamedTuple):
    """A prior of how a path goes on.

    curvature: standard deviation, 1/mm, of an Ornstein-Uhlenbeck process along the way, correlated over along_mm.
    speed: of the change of the speed's logarithm from knot to knot, 1/mm.
    """

    curvature: float
    along_mm: float
    speed: float


@dataclass(frozen=True)
class PathConfig:
    """Chosen on circles, S-curves and lines assembled from a pass and places that the map had not seen
    (experiments/LOG.md).

    local: errors of place and gain, independent from block to block. step_mm: standard deviation of the way from block
    to block along x and y, for the first places. averaged: blocks that these are averaged over; each is a start.
    knot_mm: way from one knot of the splines to the next. steerings: the likeliest is taken; the last one allows most.
    spread: reported standard deviations over those of the fit.
    """

    local: LocalErrors = field(default_factory=lambda: LocalErrors(0.42, 0.07))
    step_mm: float = 0.8
    averaged: tuple[float, ...] = (1.0, 3.0, 10.0)
    knot_mm: float = 2.0
    steerings: tuple[Steering, ...] = (
        Steering(0.02, 4.0, 0.01),
        Steering(0.1, 30.0, 0.01),
        Steering(0.3, 4.0, 0.01),
        Steering(0.3, 4.0, 0.1),
    )
    spread: float = 1.2


class WholePath(NamedTuple):
    """At the end of each of m blocks. mean: (m, 4) x, y (mm), vx, vy (mm/s); covariance: (m, 4, 4). misfit: chi-square
    over its degrees of freedom. way_mm: in all. gain: of the contact."""

    mean: np.ndarray
    covariance: np.ndarray
    misfit: float
    way_mm: float
    gain: float


def whole_path(measured: Measured, surface: ResponseSurface, config: PathConfig) -> WholePath | None:
    """The likeliest path; None where too few blocks were measured for one, or none fits."""
    if measured.known.sum() < LEAST_BLOCKS:
        return None
    places = first_places(measured, surface, config.local, config.step_mm)
    *others, freest = config.steerings
    starts = [curve_along(places, measured.block_s, each, config.knot_mm) for each in config.averaged]
    evidence = attrgetter("evidence")
    first = max((_fitted(measured, surface, each, freest, config) for each in starts), key=evidence)
    found = [first, *(_fitted(measured, surface, first.curve, each, config) for each in others)]
    best = max(found, key=evidence)
    return _at_block_ends(best, config.spread) if math.isfinite(best.evidence) else None


class _Fit(NamedTuple):
    """A curve, its parameters' covariance, its evidence and its misfit."""

    curve: Curve
    covariance: np.ndarray
    evidence: float
    misfit: float


class _Prior(NamedTuple):
    """The rows (r, 3 + 2 n) times a curve's parameters, less the values (r,), are white. log_size: logarithm of the
    rows' determinant, but for what all priors share."""

    rows: np.ndarray
    values: np.ndarray
    log_size: float


def _prior(splines: int, steering: Steering, gain_sd: float, knot_mm: float) -> _Prior:
    differences = np.diff(np.eye(splines), axis=0) / knot_mm
    # Each curvature less the one before, as far as that is kept, is independent of it.
    kept = math.exp(-knot_mm / steering.along_mm)
    white = np.eye(splines - 1) - kept * np.eye(splines - 1, k=-1)
    white[1:] /= math.sqrt(1.0 - kept**2)
    rows = np.zeros((2 * splines - 1, 3 + 2 * splines))
    rows[0, 2] = 1.0 / gain_sd
    rows[1:splines, 3 : 3 + splines] = differences / steering.speed
    rows[splines:, 3 + splines :] = white @ differences / steering.curvature
    values = np.zeros(len(rows))
    values[0] = 1.0 / gain_sd
    log_size = -(splines - 1) * math.log(steering.speed * steering.curvature)
    return _Prior(rows, values, log_size - 0.5 * (splines - 2) * math.log(1.0 - kept**2))


def _fitted(
    measured: Measured, surface: ResponseSurface, start: Curve, steering: Steering, config: PathConfig
) -> _Fit:
    """Steps of Levenberg and Marquardt from a curve to the likeliest one."""
    prior = _prior(len(start.heading), steering, measured.gain_sd, config.knot_mm)
    least, damping, most = DAMPING
    now = _linearized(measured, surface, start, prior, config.local)
    for _ in range(STEPS):
        normal = now.slope.T @ now.slope
        damped = normal + damping * np.diag(normal.diagonal())
        step = np.linalg.solve(damped, -now.slope.T @ now.gap)
        ahead = _linearized(measured, surface, now.curve.changed(step), prior, config.local)
        gained = now.objective - ahead.objective
        if gained > 0.0:
            now, damping = ahead, max(damping / 10.0, least)
        else:
            damping *= 10.0
        if 0.0 < gained < GAINED or damping > most:
            break
    normal = now.slope.T @ now.slope
    covariance = np.linalg.inv(normal)
    evidence = prior.log_size - now.objective - 0.5 * float(np.linalg.slogdet(normal)[1])
    count = measured.volts.size
    by_data, gap = now.slope[:count], now.gap[:count]
    freedom = max(
        measured.known.sum() * measured.volts.shape[1] - float(((by_data @ covariance) * by_data).sum()), 1.0
    )
    return _Fit(now.curve, covariance, evidence, float(gap @ gap) / freedom)


class _Linearized(NamedTuple):
    """gap: (r,), each of standard deviation 1, of the measurements, then of the prior; slope: (r, 3 + 2 n), its
    derivatives. objective: the posterior density's negative logarithm, but for a constant."""

    curve: Curve
    gap: np.ndarray
    slope: np.ndarray
    objective: float


def _linearized(
    measured: Measured, surface: ResponseSurface, curve: Curve, prior: _Prior, local: LocalErrors
) -> _Linearized:
    # A block's mean is the response at its middle.
    motion, by = (each[1::2] for each in curve.motion())
    response = surface.at(motion[:, 0], motion[:, 1])[:, :, 0]
    shown, slopes = response[:, 0], response[:, 1:]
    white, log_size = whitening(shown, slopes, measured.variance, local)
    expected = curve.gain * slopes.transpose(0, 2, 1) @ by[:, :2]
    expected[:, :, 2] += shown
    white = np.where(measured.known[:, None, None], white, 0.0)
    gap = (white @ np.nan_to_num(curve.gain * shown - measured.volts)[:, :, None]).ravel()
    gap = np.concatenate([gap, prior.rows @ curve.parameters - prior.values])
    slope = np.concatenate([(white @ expected).reshape(-1, by.shape[2]), prior.rows])
    return _Linearized(curve, gap, slope, 0.5 * float(gap @ gap + log_size[measured.known].sum()))


def _at_block_ends(fit: _Fit, spread: float) -> WholePath:
    motion, by = (each[2::2] for each in fit.curve.motion())
    covariance = spread**2 * (by @ fit.covariance @ by.transpose(0, 2, 1))
    way_mm = float(np.hypot(*motion[:, 2:].T).sum() * 2 * fit.curve.half_s)
    return WholePath(motion, covariance, fit.misfit, way_mm, fit.curve.gain)
