"""Calibration: a response map fitted to a sensor's labelled slides, with a map of its design (if any) as the prior.

P-splines (Eilers and Marx 1996): penalised least squares for the splines' coefficients. It alternates with each
slide's own gain and its shift along its line (the moment of start and the place of a stage are known to about 0.1 mm),
and with a lag common to all. The penalty on second differences keeps the friction parts, which few directions tell
apart, from following the noise.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.linalg import solveh_banded

from models.ranges import POSITIVE, check_ranges
from models.response_map.map import MARGIN_MM, PARTS, SPACING_MM, ResponseMap, knots, splines_at
from models.response_map.slides import LEAST_HEIGHTS_MM, CalibrationSlide, main_height_mm, several_heights
from pipeline.sensor import Sensor

# Variance of the map's own residual, which no averaging lessens, in units of a block's noise variance: on bench-a the
# residual is 0.86 mV beside a noise of 1.35 mV (residual_v in the card of a bundle), 0.4.
MAP_VARIANCE = 0.5
# So much of a stretch's output is never explained: one step of the article's converter.
LEAST_RESIDUAL_V = 5e-4
LEAST_DRIFT_V = 5e-4  # likewise the static output is never known better
RIM_MM = 1.5  # from this far beyond the chamber's edge on, the skin lies on the base and shows nothing
RIM_WEIGHT = 3.0  # of a rim point, one each mm; a stretch of 0.5 mm weighs at most 2
RIDGE, LEAST_RIDGE = (
    1e-3,
    1e-6,
)  # hold coefficients that no slide touches: share of the smoothing, and at least
PENALTY_NOISE_V = 1.35e-3  # a block's noise on the recordings that the penalties were chosen on
LEAST_DEPTHS_MM = 0.1  # what depths differ by at least; a gain of 2 % is worth as much
# Priors of the change with depth or height: of its factor on the design's, and of what it holds of the response itself,
# 1/mm.
CHANGE_SD = (0.5, 0.1)
OUTLIER = 4.0  # times the median residual: a slide beyond it has a wrong label
PRIOR_SLIDES = 4  # how many slides' worth the priors of gain and drift count
CLEAR = 0.3  # share of the largest peak below which a slide's gain is mostly noise
SHIFT_STEP_MM = 0.05  # of the central difference
SHRINKAGE = 0.1  # of the residuals' covariance; without it errors were the same within 0.02 deg
ITERATIONS = 2  # Gauss-Newton of two numbers that start within a few percent


@dataclass(frozen=True)
class CalibrationConfig:
    """Constants of the fit, chosen on held-out calibration lines (experiments/LOG.md).

    smooth_mean, smooth_friction: penalties on second differences, per V^2, for data in units of one block's noise.
    near_prior: penalty on the distance from an atlas's prior, likewise.
    gain_sd, shift_sd_mm: priors on each slide's own gain and place. untimed_sd_mm: on the place of a slide whose
        labels do not tell it, about the first guess of onset.py.
    day_gain_sd: of the gain from one day to another, of maps without a rim: of sensing elements of which nothing but
        recordings of one day is known.
    iterations: alternations of splines and slides.
    """

    smooth_mean: float = 0.1
    smooth_friction: float = 3.0
    near_prior: float = 0.01
    gain_sd: float = 0.03
    shift_sd_mm: float = 0.1
    untimed_sd_mm: float = 2.0
    day_gain_sd: float = 0.15
    iterations: int = 4

    def __post_init__(self) -> None:
        sizes = ("smooth_mean", "smooth_friction", "near_prior", "gain_sd", "shift_sd_mm", "untimed_sd_mm")
        check_ranges(self, **dict.fromkeys(sizes, POSITIVE), day_gain_sd=POSITIVE, iterations=(1, 1000))

    def stiffened(self, times: float) -> "CalibrationConfig":
        """The same with every penalty on the map so many times as large."""
        return replace(
            self,
            smooth_mean=times * self.smooth_mean,
            smooth_friction=times * self.smooth_friction,
            near_prior=times * self.near_prior,
        )


@dataclass(frozen=True)
class SlideFit:
    """A slide's own gain and shift along its line, and the residual (m, C) V beside the map."""

    gain: float
    shift_mm: float
    residual_v: np.ndarray

    @property
    def rms_v(self) -> float:
        """Root mean square of the residual."""
        return float(np.sqrt(np.mean(self.residual_v**2)))


def calibrate(
    slides: list[CalibrationSlide], prior: ResponseMap, informed: bool, config: CalibrationConfig
) -> tuple[ResponseMap, dict[str, float]]:
    """Fits the map.

    prior: where the fit starts and, if `informed` (it comes from an atlas), what it stays near.
    Returns the map, and its residual: `residual_v` (rms over the slides), `residual_share` (of each slide's largest
    output, median), `gain_sd`, `lag_s`, `slides`, `outliers`.
    """
    noise = np.sqrt(np.mean([s.rest_noise_v**2 for s in slides], axis=0))
    response = _over_heights(replace(prior, noise_v=noise), slides)
    gains, shifts = np.ones(len(slides)), np.zeros(len(slides))
    speeds = np.array([s.speed_mm_s.max() for s in slides])
    rms, means = np.empty(len(slides)), np.empty((len(slides), response.channels))
    residuals = [slide.volts for slide in slides]
    keep, timed = np.ones(len(slides), dtype=bool), np.array([s.timed for s in slides])
    for first in (True, *[False] * (config.iterations - 1)):
        kept = [slide for slide, k in zip(slides, keep, strict=True) if k]
        told = _telling(slides, response) & keep if first else keep
        response = _fit_splines(
            [slide for slide, k in zip(slides, told, strict=True) if k],
            gains[told],
            shifts[told],
            response,
            prior if informed else None,
            config,
        )
        if several_depths(kept):
            off_mm = np.array([slide.depth_mm - response.depth_mm for slide in kept])
            without = replace(response, depth_slope=np.zeros_like(prior.depth_slope))
            slope = _fitted_change(kept, gains[keep], shifts[keep], without, prior.depth_slope, off_mm)
            response = replace(response, depth_slope=slope)
        if response.height_slope is not None:
            design = (
                np.zeros_like(response.height_slope) if prior.height_slope is None else prior.height_slope
            )
            off_mm = np.array([slide.height_mm - response.height_mm for slide in kept])
            without = replace(response, height_slope=np.zeros_like(design))
            slope = _fitted_change(kept, gains[keep], shifts[keep], without, design, off_mm)
            response = replace(response, height_slope=slope)
        for i, slide in enumerate(slides):
            fit = fit_slide(slide, response, config, gains[i], shifts[i])
            gains[i], shifts[i], rms[i] = fit.gain, fit.shift_mm, fit.rms_v
            means[i], residuals[i] = fit.residual_v.mean(axis=0), fit.residual_v
        # A slide with wrong labels must not bend the map: it stands out by its residual.
        keep = rms < OUTLIER * np.median(rms)
        gains /= np.mean(gains[keep])
        # A shift that grows with the speed is a lag, where the labels say when the slide was where.
        lag = float(response.lag_s + _slope(speeds[keep & timed], shifts[keep & timed]))
        shifts -= (lag - response.lag_s) * speeds
        response = replace(response, lag_s=lag)
    peaks = np.array([np.abs(s.volts).max() for s in slides])
    clear = keep & (peaks > CLEAR * peaks.max())
    residual = float(np.sqrt(np.mean(rms[keep] ** 2)))
    gain_sd = float(_deviation(gains[clear] - 1, config.gain_sd))
    if not response.rim:
        gain_sd = float(np.hypot(gain_sd, config.day_gain_sd))
        response = replace(response, whitening=_whitening(residuals))
    drift = _deviation(means[keep], LEAST_DRIFT_V)
    response = replace(response, gain_sd=gain_sd, floor_v=residual, drift_v=drift)
    if several_depths(slides):
        farthest = max(abs(slide.depth_mm - response.depth_mm) for slide in slides)
        response = replace(response, depth_sd_mm=float(farthest))
    return response, {
        "slides": float(len(slides)),
        "outliers": float((~keep).sum()),
        "residual_v": residual,
        "residual_share": float(np.median(rms / peaks)),
        "gain_sd": response.gain_sd,
        "lag_s": float(response.lag_s),
    }


def _telling(slides: list[CalibrationSlide], response: ResponseMap) -> np.ndarray:
    """(n,) bool: the slides that the first map is fitted to. Where most have the map's height it is they alone: what
    the others differ by is then the change with height, and not in the map already."""
    every = np.ones(len(slides), dtype=bool)
    if response.height_slope is None:
        return every
    main = np.abs([slide.height_mm - response.height_mm for slide in slides]) <= LEAST_HEIGHTS_MM
    return main if main.mean() > 0.5 else every


def _over_heights(response: ResponseMap, slides: list[CalibrationSlide]) -> ResponseMap:
    """The map with the heights of the slides, where they have several."""
    if not several_heights(slides):
        return replace(response, height_slope=None)
    heights_mm = [slide.height_mm for slide in slides]
    slope = np.zeros_like(response.depth_slope) if response.height_slope is None else response.height_slope
    return replace(
        response,
        height_mm=main_height_mm(slides),
        height_slope=slope,
        height_range_mm=(min(heights_mm), max(heights_mm)),
    )


def _whitening(residuals_v: list[np.ndarray]) -> np.ndarray:
    """(C, C), symmetric: from residuals (m, C) V each to as large ones that are uncorrelated and equally large.

    The covariance is shrunk towards independent channels by SHRINKAGE of their mean variance (Ledoit and Wolf 2004), so
    that no combination of channels is held to be exact.
    """
    spread = np.mean([residual.T @ residual / len(residual) for residual in residuals_v], axis=0)
    size = float(np.trace(spread)) / len(spread)
    values, vectors = np.linalg.eigh(spread + SHRINKAGE * size * np.eye(len(spread)))
    return (vectors * np.sqrt(size / values)) @ vectors.T


def _slope(speeds: np.ndarray, shifts: np.ndarray) -> float:
    """Slope of shift over speed, s; 0 where few slides or nearly equal speeds do not tell."""
    return np.polyfit(speeds, shifts, 1)[0] if len(speeds) > 8 and np.ptp(speeds) > 1 else 0.0


def _deviation(errors: np.ndarray, prior_sd: float) -> np.ndarray:
    """Root mean square over slides (n, ...) -> (...), the prior counting as PRIOR_SLIDES further ones."""
    return np.sqrt((np.sum(errors**2, axis=0) + PRIOR_SLIDES * prior_sd**2) / (len(errors) + PRIOR_SLIDES))


def blank_map(sensor: Sensor, depth_mm: float, spacing_mm: float = SPACING_MM) -> ResponseMap:
    """A map without any response: the start of a fit from recordings alone."""
    k = knots(max(sensor.chamber_mm) / 2 + MARGIN_MM, spacing_mm)
    axes = len(sensor.touch_axes)
    channels = axes * len(sensor.accelerometers)
    return ResponseMap(
        np.zeros((PARTS, k, k, channels)),
        np.zeros((k, k, channels)),
        sensor.chamber_mm,
        sensor.reference_mm,
        depth_mm,
        axes=axes,
        rim=sensor.measures_gravity,
        spacing_mm=spacing_mm,
    )


def fit_slide(
    slide: CalibrationSlide,
    response: ResponseMap,
    config: CalibrationConfig,
    gain: float = 1.0,
    shift_mm: float = 0.0,
) -> SlideFit:
    """A slide's gain and shift given the map, by Gauss-Newton with priors, from the gain and shift given."""
    assert response.noise_v is not None
    noise = float(np.hypot(np.median(response.noise_v) / np.sqrt(slide.blocks), LEAST_RESIDUAL_V))
    shift_sd_mm = config.shift_sd_mm if slide.timed else config.untimed_sd_mm
    own = response.at_height(slide.height_mm)

    def model(at: float) -> np.ndarray:
        x, y = slide.place(at, response.lag_s)
        return own.response(x, y, slide.direction_rad, slide.depth_mm)

    for _ in range(ITERATIONS):
        volts = model(shift_mm)
        h = SHIFT_STEP_MM
        slope = gain * (model(shift_mm + h) - model(shift_mm - h)) / (2 * h)
        jacobian = np.stack([volts.ravel(), slope.ravel()], axis=1) / noise
        jacobian = np.vstack([jacobian, np.diag([1 / config.gain_sd, 1 / shift_sd_mm])])
        residuals = np.append(
            (slide.volts - gain * volts).ravel() / noise,
            [(1 - gain) / config.gain_sd, -shift_mm / shift_sd_mm],
        )
        step = np.linalg.lstsq(jacobian, residuals, rcond=None)[0]
        gain, shift_mm = gain + step[0], shift_mm + step[1]
    return SlideFit(gain, shift_mm, slide.volts - gain * model(shift_mm))


def _fit_splines(
    slides: list[CalibrationSlide],
    gains: np.ndarray,
    shifts: np.ndarray,
    response: ResponseMap,
    prior: ResponseMap | None,
    config: CalibrationConfig,
) -> ResponseMap:
    """One penalised least-squares solution for M, Fx, Fy with the slides' gains and shifts held.

    Minimizes sum w |volts - g (M + cos Fx + sin Fy + (d - d0) D + (h - h0) H)|^2 + rim + penalties over
    the coefficients' distance from the prior's. The unknowns are in the order place, part: the normal matrix is then a
    band of a few hundred.
    """
    assert response.noise_v is not None
    k = response.coefficients.shape[1]
    size = k * k
    right = np.zeros((size, PARTS, response.channels))
    start = np.zeros_like(right) if prior is None else _by_place(prior.coefficients)
    depth_slope = response.depth_slope.reshape(size, -1)
    height_slope = None if response.height_slope is None else response.height_slope.reshape(size, -1)
    # Slides of one direction share their weights of M, Fx, Fy, so that their Gram matrices add up.
    grams: dict[float, sparse.csr_matrix] = {}
    for slide, gain, shift in zip(slides, gains, shifts, strict=True):
        place = slide.place(shift, response.lag_s)
        rows = tensor_splines(*place, response.half_mm, response.spacing_mm) * gain
        # One over the variance in units of one block's noise: of the averaged noise, and of the map's own residual.
        weight = slide.weight / (1.0 / slide.blocks + MAP_VARIANCE)
        parts = part_weights(slide.direction_rad)
        off_depth = slide.depth_mm - response.depth_mm
        off = off_depth * depth_slope
        if height_slope is not None:
            off = off + (slide.height_mm - response.height_mm) * height_slope
        known = rows @ (off + np.tensordot(parts, start, (0, 1)))
        right += weight * parts[:, None] * (rows.T @ (slide.volts - known))[:, None]
        before = grams.get(slide.direction_rad, sparse.csr_matrix((size, size)))
        grams[slide.direction_rad] = before + weight * (rows.T @ rows)
    outer = (np.outer(part_weights(direction), part_weights(direction)) for direction in grams)
    normal = sum(sparse.kron(gram, both) for gram, both in zip(grams.values(), outer, strict=True))
    # Penalties are per V^2; the data count in units of their noise.
    scale = (float(np.median(response.noise_v)) / PENALTY_NOISE_V) ** 2
    smooth = scale * np.array([config.smooth_mean, *[config.smooth_friction] * (PARTS - 1)])
    near = scale * (config.near_prior if prior is not None else LEAST_RIDGE)
    normal += sparse.kron(roughness(k), np.diag(smooth))
    if response.rim:
        rim = rim_gram(response)
        normal += sparse.kron(RIM_WEIGHT * rim, np.eye(PARTS))
        right -= RIM_WEIGHT * (rim @ start.reshape(size, -1)).reshape(start.shape)
    normal += sparse.kron(sparse.identity(size), np.diag(RIDGE * smooth + near))
    solution = start + _solved(normal, right.reshape(PARTS * size, -1)).reshape(start.shape)
    return replace(response, coefficients=solution.reshape(k, k, PARTS, -1).transpose(2, 0, 1, 3))


def several_depths(slides: list[CalibrationSlide]) -> bool:
    """Whether the slides' contact depths differ enough to tell how the response changes with depth."""
    return bool(np.ptp([slide.depth_mm for slide in slides]) > LEAST_DEPTHS_MM)


def _fitted_change(
    slides: list[CalibrationSlide],
    gains: np.ndarray,
    shifts: np.ndarray,
    without: ResponseMap,
    design: np.ndarray,
    off_mm: np.ndarray,
) -> np.ndarray:
    """The map's change (K, K, C) V/mm with depth or height, c times the design's + b M, its two numbers c and b fitted
    to slides of several by least squares.

    without: the map without this change. design: (K, K, C) V/mm. off_mm: (n,), each slide's depth or height less the
    map's. The lines of each depth are too few for a change that is free in place: held-out lines are predicted worse by
    it (experiments/LOG.md).
    """
    assert without.noise_v is not None
    still, flat = without.coefficients[0], np.zeros_like(design)
    parts = [replace(without, coefficients=np.stack([part, flat, flat])) for part in (design, still)]
    # In units of a block's noise.
    noise = float(np.median(without.noise_v))
    normal, right = (
        np.diag(1.0 / np.square(CHANGE_SD)),
        np.array([1.0, 0.0]) / np.square(CHANGE_SD),
    )
    for slide, gain, shift, off in zip(slides, gains, shifts, off_mm.tolist(), strict=True):
        place, a = slide.place(shift, without.lag_s), slide.direction_rad
        known = without.at_height(slide.height_mm).response(*place, a, slide.depth_mm)
        rest = (slide.volts - gain * known) / noise
        rows = gain * off / noise * np.stack([part.response(*place, a).ravel() for part in parts], axis=1)
        weight = slide.weight / (1.0 / slide.blocks + MAP_VARIANCE)
        normal += weight * rows.T @ rows
        right += weight * rows.T @ rest.ravel()
    factor, share = np.linalg.solve(normal, right)
    return factor * design + share * still


def roughness(k: int) -> sparse.spmatrix:
    """Penalty matrix (K^2, K^2): squared second differences of neighbouring coefficients along x and along y."""
    second = sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(k - 2, k))
    bend, line = second.T @ second, sparse.identity(k)
    return sparse.kron(bend, line) + sparse.kron(line, bend)


def rim_gram(response: ResponseMap) -> sparse.csr_matrix:
    """Gram matrix (K^2, K^2) of the splines at points of the rim, one each mm, where the response is zero."""
    grid = np.arange(-response.half_mm, response.half_mm + 0.5, 1.0)
    x, y = (axis.ravel() for axis in np.meshgrid(grid, grid, indexing="ij"))
    rim = (np.abs(x) > response.chamber_mm[0] / 2 + RIM_MM) | (
        np.abs(y) > response.chamber_mm[1] / 2 + RIM_MM
    )
    rows = tensor_splines(x[rim], y[rim], response.half_mm, response.spacing_mm)
    return rows.T @ rows


def tensor_splines(
    x_mm: np.ndarray, y_mm: np.ndarray, half_mm: float, spacing_mm: float = SPACING_MM
) -> sparse.csr_matrix:
    """Values of the tensor-product splines at points (n,): rows (n, K^2), 16 entries each."""
    (i, across), (j, up) = (splines_at(place, half_mm, spacing_mm) for place in (x_mm, y_mm))
    k = knots(half_mm, spacing_mm)
    columns, values = k * i[:, :, None] + j[:, None, :], across[:, :, None] * up[:, None, :]
    begins = 16 * np.arange(len(i) + 1)
    return sparse.csr_matrix((values.ravel(), columns.ravel(), begins), shape=(len(i), k * k))


def _by_place(coefficients: np.ndarray) -> np.ndarray:
    """(3, K, K, C) -> (K^2, 3, C)."""
    parts, k, _, channels = coefficients.shape
    return coefficients.transpose(1, 2, 0, 3).reshape(k * k, parts, channels)


def part_weights(direction_rad: float) -> np.ndarray:
    """Weights (3,) of M, Fx, Fy for a motion's direction."""
    return np.array([1.0, np.cos(direction_rad), np.sin(direction_rad)])


def _solved(normal: sparse.spmatrix, right: np.ndarray) -> np.ndarray:
    """x (n, C) of A x = b, A symmetric, positive definite and banded."""
    upper = sparse.triu(normal).tocoo()
    band = int((upper.col - upper.row).max())
    stored = np.zeros((band + 1, upper.shape[0]))
    stored[band + upper.row - upper.col, upper.col] = upper.data
    return solveh_banded(stored, right, overwrite_ab=True, check_finite=False)
