"""Which slides to record: those after which the calibrated map misleads the estimates least.

Bayesian linear design (Chaloner and Verdinelli 1995). The unknowns u, standard normal, are how the sensor differs from
its design (the parameters of from_atlas.py) and the map's own residual (the penalties of calibrate.py, read as a
Gaussian prior). A slide is a linear observation of u with the noise of its blocks, its own gain, shift and static
output. What counts is the error in direction, log speed and offset that the map's remaining error causes on lines
anywhere over the skin: how a least-squares estimate answers to a wrong map (line_information.py).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from threadpoolctl import threadpool_limits

from softslide.features.stream.conditioning import Conditioning
from softslide.models.design.line_information import (
    ERRORS,
    LINE_SPEED_MM_S,
    STEPS,
    Line,
    criterion,
    draw_lines,
    exchanged,
    places,
    reading_variance,
    slopes,
    with_gain_prior,
    without_static,
)
from softslide.models.response_map.calibrate import (
    MAP_VARIANCE,
    PENALTY_NOISE_V,
    RIDGE,
    RIM_WEIGHT,
    part_weights,
    rim_gram,
    roughness,
)
from softslide.models.response_map.from_atlas import SensorSpread, prior_deviations
from softslide.models.response_map.map import PARTS, ResponseMap, knots, tensor_splines
from softslide.models.response_map.slide_fit import CalibrationConfig
from softslide.models.response_map.slides import STRETCH_MM
from softslide.pipeline.atlas.atlas import Atlas
from softslide.pipeline.sensor import Sensor

# Times the penalties of the calibration, where they stand for the residual's prior. On held-out lines 0.3 was best of
# 0.3, 1, 3 and 30, by about as much as chance (experiments/LOG.md).
RESIDUAL_STIFFNESS = 0.3
MODES = 40  # of the residual, the largest for each part
PLAN_LINES = 150  # that the errors are averaged over
ALONG_STEP_MM = 0.1  # of the difference along a line
PLACES_MM = 4.0  # between the places of a slide that are looked at
# How much more a slide may gain than when it was last looked at, as one that was chosen since is taken out again.
# 2, and places 2 mm apart, give plans as good in 2.7 times the time (experiments/LOG.md).
GAIN_RISES = 1.5
# Of exchanges; a second changes nothing on the sample's sensor or one of three accelerometers.
PLAN_SWEEPS = 1


@dataclass(frozen=True)
class Plan:
    """chosen: which candidates, the most useful first. deviations: (3,) standard deviations of the errors in direction
    (rad), log speed and offset (mm) that the map causes after these; before: without any slide."""

    chosen: list[int]
    deviations: np.ndarray
    before: np.ndarray


def plan_slides(
    candidates: pd.DataFrame,
    count: int,
    sensor: Sensor,
    atlas: Atlas,
    depth_mm: float,
    config: CalibrationConfig,
    spread: SensorSpread,
    progress: Callable[[Sequence[int]], Sequence[int]] = lambda steps: steps,
) -> Plan:
    """Chooses `count` of the candidates, rows with the manifest's labels."""
    unknowns = Unknowns(atlas, sensor, depth_mm, config.stiffened(RESIDUAL_STIFFNESS), spread)
    observations = [_observation(unknowns, row, config) for _, row in candidates.iterrows()]
    errors = _line_errors(unknowns, sensor, np.random.default_rng(0))

    def after(chosen: list[int]) -> np.ndarray:
        return _posterior(unknowns.size, observations, chosen)

    gains = np.full(len(observations), np.inf)

    def best(chosen: list[int]) -> tuple[int, float]:
        return _best(observations, errors, after(chosen), chosen, gains)

    # Of matrices this small one thread takes an eighth of the time of two.
    with threadpool_limits(1):
        chosen = exchanged(best, progress(range(count)), PLAN_SWEEPS)
    deviations = (np.sqrt(_variances(errors, after(some)).mean(axis=1)) for some in (chosen, []))
    return Plan(chosen, *deviations)


@dataclass(frozen=True)
class Rows:
    """How n readings of C channels follow from the unknowns: by parameter, (C, n, P) V, and by the mode of their own
    channel, (n, M) V, which is alike for all."""

    by_parameter: np.ndarray
    by_mode: np.ndarray

    def times(self, matrix: np.ndarray) -> np.ndarray:
        """(C n, K): these rows times a matrix (R, K), without the zeros for other channels' modes."""
        channels, _, parameters = self.by_parameter.shape
        own = matrix[parameters:].reshape(channels, self.by_mode.shape[1], -1)
        product = self.by_parameter @ matrix[:parameters] + self.by_mode @ own
        return product.reshape(-1, product.shape[-1])


class Unknowns:
    """A response that is the prior's mean map plus rows times u; `size` is the number R of unknowns u, standard normal.

    They are one for each parameter of the design, then MODES for each channel and part of the map.
    """

    def __init__(
        self, atlas: Atlas, sensor: Sensor, depth_mm: float, config: CalibrationConfig, spread: SensorSpread
    ) -> None:
        self.response, changes, self._lags_s = prior_deviations(atlas, sensor, depth_mm, spread)
        self._changes = changes.transpose(2, 3, 1, 4, 0).reshape(knots(self.response.half_mm) ** 2, -1)
        self._modes = [
            _modes(self.response, smooth, config.near_prior)
            for smooth in (config.smooth_mean, config.smooth_friction)
        ]
        self.size = len(changes) + self.response.channels * PARTS * MODES

    def rows(
        self, x_mm: np.ndarray, y_mm: np.ndarray, direction_rad: float, speed_mm_s: float
    ) -> tuple[Rows, np.ndarray, np.ndarray]:
        """Of contacts at (n,) places; the response there, (n, C) V, and its slope along the motion, (n, C) V/mm."""
        channels, parameters = self.response.channels, len(self._lags_s)
        weights = part_weights(direction_rad)
        splines = tensor_splines(x_mm, y_mm, self.response.half_mm)
        changes = (splines @ self._changes).reshape(len(x_mm), PARTS, channels, parameters)
        steps = ALONG_STEP_MM * np.array([[0.0], [1.0], [-1.0]])
        x, y = x_mm + steps * np.cos(direction_rad), y_mm + steps * np.sin(direction_rad)
        shown = self.response.response(x.ravel(), y.ravel(), direction_rad)
        volts, ahead, behind = shown.reshape(3, len(x_mm), -1)
        slope = (ahead - behind) / (2 * ALONG_STEP_MM)
        by_parameter = np.tensordot(weights, changes, (0, 1)) - speed_mm_s * slope[..., None] * self._lags_s
        mean, friction = (splines @ modes for modes in self._modes)
        by_mode = np.hstack([weights[0] * mean, weights[1] * friction, weights[2] * friction])
        return Rows(by_parameter.transpose(1, 0, 2), by_mode), volts, slope


def _modes(response: ResponseMap, smooth: float, near: float) -> np.ndarray:
    """(K^2, MODES) V: the residual's largest principal components, each times its standard deviation."""
    k, noise_v = knots(response.half_mm), float(np.median(response.noise_v))
    scale = (noise_v / PENALTY_NOISE_V) ** 2
    penalty = smooth * roughness(k) + (RIDGE * smooth + near) * np.eye(k * k)
    precision = scale * np.asarray(penalty) + RIM_WEIGHT * rim_gram(response).toarray()
    values, vectors = np.linalg.eigh(precision)
    return noise_v * vectors[:, :MODES] / np.sqrt(values[:MODES])


def _observation(unknowns: Unknowns, row: pd.Series, config: CalibrationConfig) -> tuple[Rows, np.ndarray]:
    """A slide's rows and the covariance (C n, C n) V^2 of its noise, at places PLACES_MM apart."""
    response = unknowns.response
    direction = float(np.deg2rad(row["direction_deg"]))
    along = np.arange(PLACES_MM / 2, row["travel_mm"], PLACES_MM)
    x = row["start_x_mm"] + along * np.cos(direction)
    y = row["start_y_mm"] + along * np.sin(direction)
    inside = np.maximum(np.abs(x), np.abs(y)) < response.half_mm
    x, y = x[inside], y[inside]
    rows, volts, slope = unknowns.rows(x, y, direction, float(row["speed_mm_s"]))
    blocks = max(1.0, STRETCH_MM / row["speed_mm_s"] / Conditioning.block_s)
    # As the calibration weighs a stretch, for the stretches between two places.
    variance = np.median(response.noise_v) ** 2 * (1 / blocks + MAP_VARIANCE) * STRETCH_MM / PLACES_MM
    static = np.repeat(np.diag(np.broadcast_to(response.zero_v, response.channels)), len(x), axis=0)
    own = np.column_stack([config.gain_sd * volts.T.ravel(), config.shift_sd_mm * slope.T.ravel(), static])
    noise = variance * np.eye(volts.size) + own @ own.T
    return Rows(rows.by_parameter.astype(np.float32), rows.by_mode.astype(np.float32)), noise.astype(
        np.float32
    )


def _line_errors(unknowns: Unknowns, sensor: Sensor, random: np.random.Generator) -> np.ndarray:
    """(3, L, R): the errors in direction (rad), log speed and offset (mm) that each unknown causes on lines drawn."""
    lines = draw_lines(sensor.chamber_mm, sensor.reference_mm, PLAN_LINES, random)
    return np.stack([_line_error(unknowns, line) for line in lines], axis=1)


def _line_error(unknowns: Unknowns, line: Line) -> np.ndarray:
    """(3, R) for one line: least squares over direction, log speed, offset, place, gain and static output."""
    response = unknowns.response
    jacobian, variance = slopes(response, line), reading_variance(float(np.median(response.noise_v)))
    weighted = without_static(jacobian, response.zero_v, variance) / variance
    information = np.einsum("ncj,nck->jk", weighted, jacobian)
    by_channel = weighted.transpose(2, 1, 0).reshape(len(STEPS), -1)
    answer = np.linalg.solve(with_gain_prior(information), by_channel)[:ERRORS]
    x, y = places(response.reference_mm, line.direction_rad, line.offset_mm, line.along_mm)
    rows, *_ = unknowns.rows(x, y, line.direction_rad, LINE_SPEED_MM_S)
    return answer @ rows.times(np.eye(unknowns.size))


Observations = list[tuple[Rows, np.ndarray]]


def _posterior(size: int, observations: Observations, chosen: Sequence[int]) -> np.ndarray:
    """Covariance (R, R) of the unknowns after these slides."""
    covariance = np.eye(size)
    for one in chosen:
        rows, noise = observations[one]
        shown = rows.times(covariance)
        covariance -= shown.T @ cho_solve(cho_factor(rows.times(shown.T) + noise), shown)
    return covariance


def _variances(errors: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """(3, L): of the errors that the unknowns still cause."""
    return np.einsum("qlr,rs,qls->ql", errors, covariance, errors, optimize=True)


def _best(
    observations: Observations,
    errors: np.ndarray,
    covariance: np.ndarray,
    taken: Sequence[int],
    gains: np.ndarray,
) -> tuple[int, float]:
    """The slide that, added to those already in `covariance`, leaves the least criterion; and that.

    gains: by how much each lowered the criterion when it was last looked at, inf at first; renewed in place. A slide
    gains less the more others there are, so that those that gained least need no look (Minoux 1978).
    """
    flat = np.asarray(errors.reshape(-1, errors.shape[-1]), np.float32)
    known = np.asarray(covariance, np.float32)
    carried = known @ flat.T
    variances = np.einsum("rt,tr->t", carried, flat)
    now = float(criterion(variances.reshape(errors.shape[:2]).T))
    best = -1
    for one in np.argsort(-gains, kind="stable"):
        if one in taken:
            continue
        if best >= 0 and GAIN_RISES * gains[one] < gains[best]:
            break
        rows, noise = observations[one]
        shown = rows.times(carried)
        noisy = np.linalg.cholesky(rows.times(rows.times(known).T) + noise)
        less = np.square(solve_triangular(noisy, shown, lower=True, check_finite=False)).sum(axis=0)
        gains[one] = now - float(criterion((variances - less).reshape(errors.shape[:2]).T))
        if best < 0 or gains[one] > gains[best]:
            best = int(one)
    return best, now - float(gains[best])
