"""Calibration: a response map fitted to a sensor's labelled slides, with a map of its design (if any) as the prior.

P-splines (Eilers and Marx 1996): penalised least squares for the splines' coefficients. It alternates with each
slide's own gain and its shift along its line (the moment of start and the place of a stage are known to about 0.1 mm),
and with a lag common to all. The penalty on second differences keeps the friction parts, which few directions
separate, from following the noise.

Slides of several contact depths, or of several heights of the skin, also show how the response changes with depth or
height. The lines of each are too few for a change that is free in place: held-out lines are predicted worse by it
(experiments/LOG.md). It has two numbers, one on the design's change and one on the response itself.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import compress
from typing import Any

import numpy as np
from scipy import sparse
from scipy.linalg import solveh_banded
from scipy.optimize import minimize

from softslide.models.response_map.from_atlas import DESIGN_DRIFT_V_S
from softslide.models.response_map.map import (
    PARTS,
    SPACING_MM,
    ResponseMap,
    half_of,
    knots,
    spline_grid,
    tensor_splines,
)
from softslide.models.response_map.slide_fit import (
    LEAST_RESIDUAL_V,
    SHIFT_STEP_MM,
    CalibrationConfig,
    SlideFit,
    fit_slide,
)
from softslide.models.response_map.slides import CalibrationSlide, at_height, main_height_mm, several
from softslide.pipeline.sensor import Sensor

USUAL_ZERO_V = 5e-4  # prior's median of a zero's error: one step of the article's converter
OUTLIER = 4.0  # times the median residual: a slide beyond it has a wrong label
PRIOR_SLIDES = 4  # how many slides' worth the prior of the gain counts
CLEAR = 0.3  # share of the largest peak below which a slide's gain is mostly noise
SHRINKAGE = 0.1  # of the residuals' covariance; without it errors were the same within 0.02 deg
# Variance of the map's own residual, which no averaging lessens, in units of a block's noise variance: on bench-a the
# residual is 0.86 mV, a block's noise 1.35 mV (residual_v in the card of a bundle), 0.4.
MAP_VARIANCE = 0.5
RIM_MM = 1.5  # from this far beyond the chamber's edge on, the skin lies on the base and shows nothing
RIM_WEIGHT = 3.0  # of a rim point, GRID_MM apart; a stretch of 0.5 mm weighs at most 2
# Hold coefficients that no slide touches: share of the smoothing, and at least.
RIDGE, LEAST_RIDGE = 1e-3, 1e-6
PENALTY_NOISE_V = 1.35e-3  # a block's noise on the recordings that the penalties were chosen on
# Parts of the residual as maps of benches and synthetic sensors have them (experiments/LOG.md): the level as a share of
# all, the share of a slide's largest output, the place (mm). Priors, of a factor so wide (its logarithm) that they
# decide where slides are few.
USUAL_LEVEL, USUAL_PARTS, PARTS_SPREAD = 0.4, (0.0025, 0.06), 2.0
# What a map changes with: ResponseMap has a NAME_slope and a NAME_mm of each, CalibrationSlide a NAME_mm.
COVARIATES = ("depth", "height")
# Priors of such a change: of its factor on the design's, and of what it holds of the response itself, 1/mm.
CHANGE_SD = (0.5, 0.1)


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
    fits = [SlideFit(slide, 1.0, 0.0, slide.volts) for slide in slides]
    speeds = np.array([s.speed_mm_s.max() for s in slides])
    timed = np.array([s.timed for s in slides])
    keep, fitted = np.ones(len(slides), dtype=bool), _first_slides(slides, response)
    designs = {name: getattr(response, f"{name}_slope") for name in COVARIATES if several(slides, name)}
    for _ in range(config.iterations):
        response = fit_splines(list(compress(fits, fitted)), response, prior if informed else None, config)
        response = _with_changes(response, list(compress(fits, keep)), designs)
        fits = [fit_slide(fit.slide, response, config, fit.gain, fit.shift_mm) for fit in fits]
        gains, shifts, rms = np.array([(fit.gain, fit.shift_mm, fit.rms_v) for fit in fits]).T
        # A slide with wrong labels must not bend the map: it stands out by its residual.
        fitted = keep = rms < OUTLIER * np.median(rms)
        gains /= np.mean(gains[keep])
        # A shift that grows with the speed is a lag, where the labels say when the slide was where.
        lag = float(response.lag_s + _slope(speeds[keep & timed], shifts[keep & timed]))
        shifts -= (lag - response.lag_s) * speeds
        response = replace(response, lag_s=lag)
        fits = [replace(f, gain=g, shift_mm=s) for f, g, s in zip(fits, gains, shifts, strict=True)]
    kept = list(compress(fits, keep))
    peaks = np.array([np.abs(s.volts).max() for s in slides])
    clear = keep & (peaks > CLEAR * peaks.max())
    residual = float(np.sqrt(np.mean(rms[keep] ** 2)))
    gain_sd = _gain_sd(gains[clear], config.gain_sd)
    if response.rim:
        weak_v, share = _growth(kept)
        response = _with_parts(replace(response, weak_floor_v=weak_v, floor_share=share), kept)
    else:
        gain_sd = float(np.hypot(gain_sd, config.day_gain_sd))
        response = replace(response, whitening=_whitening([fit.residual_v for fit in fits]))
    means = np.array([fit.residual_v.mean(axis=0) for fit in kept])
    lasts_s = np.array([len(fit.slide.volts) * fit.slide.step_s for fit in kept])
    zero_v, drift_v_s = zero_errors(means, lasts_s)
    response = replace(response, gain_sd=gain_sd, floor_v=residual, zero_v=zero_v, drift_v_s=drift_v_s)
    if "depth" in designs:
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


def zero_errors(means: np.ndarray, lasts_s: np.ndarray) -> np.ndarray:
    """(2, C): standard deviations of the zero's error at a slide's start (V) and of its drift (V/s), by likelihood.

    means: (n, C) V of slides' residuals: of a straight drift half of what it comes to. lasts_s: (n,) s, of the slides.
    """
    each = np.ones_like(lasts_s)
    shapes, usual = np.array([each, (lasts_s / 2) ** 2]), (USUAL_ZERO_V, DESIGN_DRIFT_V_S)
    return np.transpose([_likeliest(mean**2, shapes, each, usual, spread=PARTS_SPREAD) for mean in means.T])


def _growth(fits: list[SlideFit]) -> tuple[float, float]:
    """How the slides' residuals grow with the output, by likelihood: the standard deviation where there is none (V),
    and what is added in quadrature, as a share of the largest output of the channels."""
    size = np.concatenate([np.abs(fit.slide.volts).max(axis=1) for fit in fits])
    square = np.concatenate([(fit.residual_v**2).mean(axis=1) for fit in fits])
    rms_v = max(math.sqrt(square.mean()), LEAST_RESIDUAL_V)
    shapes, weight = np.square([np.ones_like(size), size]), np.full(len(size), 1.0 / len(size))
    weak_v, share = _likeliest(square, shapes, weight, [rms_v, rms_v / size.max()])
    return weak_v, share


def _likeliest(
    square: np.ndarray,
    shapes: np.ndarray,
    weight: np.ndarray,
    usual: Sequence[float],
    noise: np.ndarray | float = 0.0,
    spread: float = math.inf,
) -> list[float]:
    """Standard deviations of the k independent parts of a residual, by likelihood, from squares (n,) V^2 of it.

    shapes: (k, n), of each part's variance; noise: the variance that is known; weight: (n,) of an observation. usual:
    the prior's medians, whose logarithms it holds to within `spread`; the search begins there.
    """
    middle = np.log(usual)

    def unlikely(log_parts: np.ndarray) -> float:
        variance = noise + np.exp(2 * log_parts) @ shapes
        prior = np.sum(((log_parts - middle) / spread) ** 2)
        return float(prior + weight @ (np.log(variance) + square / variance))

    return np.exp(minimize(unlikely, middle, method="Nelder-Mead").x).tolist()


def _with_parts(response: ResponseMap, fits: list[SlideFit]) -> ResponseMap:
    """The map with the likeliest parts of its slides' residuals: `level_v`, `output_share`, `place_mm`.

    Along a slide residuals are alike, so that each counts as one observation.
    """
    each = []
    for fit in fits:
        slide, own = fit.slide, response.at(fit.slide.depth_mm, fit.slide.height_mm)
        ahead, behind = (slide.shown(own, fit.shift_mm - step) for step in (SHIFT_STEP_MM, -SHIFT_STEP_MM))
        change = fit.gain * (ahead - behind) / (2 * SHIFT_STEP_MM)
        even = np.ones_like(change)
        noise = slide.rest_noise_v / math.sqrt(slide.blocks) * even
        peak = np.abs(slide.volts).max()
        each.append([fit.residual_v, noise, even, peak * even, change, even / change.size**0.5])
    # All squared; a slide's weights add up to 1.
    square, noise, *shapes, weight = np.concatenate([np.reshape(one, (6, -1)) for one in each], axis=1) ** 2
    rms_v = max(math.sqrt(weight @ square / len(each)), LEAST_RESIDUAL_V)
    usual = [USUAL_LEVEL * rms_v, *USUAL_PARTS]
    level_v, output_share, place_mm = _likeliest(square, np.array(shapes), weight, usual, noise, PARTS_SPREAD)
    return replace(response, level_v=level_v, output_share=output_share, place_mm=place_mm)


def _over_heights(response: ResponseMap, slides: list[CalibrationSlide]) -> ResponseMap:
    """The map with the heights of the slides, where they have several."""
    if not several(slides, "height"):
        return replace(response, height_slope=None)
    heights_mm = [slide.height_mm for slide in slides]
    slope = np.zeros_like(response.depth_slope) if response.height_slope is None else response.height_slope
    return replace(
        response,
        height_mm=main_height_mm(slides),
        height_slope=slope,
        height_range_mm=(min(heights_mm), max(heights_mm)),
    )


def _first_slides(slides: list[CalibrationSlide], response: ResponseMap) -> np.ndarray:
    """(n,) bool: the slides that the first map is fitted to. Where most have the map's height it is they alone: what
    the others differ by is then the change with height, and not in the map already."""
    every = np.ones(len(slides), dtype=bool)
    if response.height_slope is None:
        return every
    main = at_height(slides, response.height_mm)
    return main if main.mean() > 0.5 else every


def _with_changes(response: ResponseMap, fits: list[SlideFit], designs: dict[str, np.ndarray]) -> ResponseMap:
    """The map with its change with those of COVARIATES that slides differ in. designs: the design's, by name.

    A change is c times the design's + b M, its two numbers c and b fitted by least squares, in V/mm.
    """
    noise = float(np.median(response.noise_v))
    still, flat = response.coefficients[0], np.zeros_like(response.depth_slope)
    for name, design in designs.items():
        without = _with_slope(response, name, flat)
        parts = [replace(without, coefficients=np.stack([part, flat, flat])) for part in (design, still)]
        # In units of a block's noise.
        normal = np.diag(1.0 / np.square(CHANGE_SD))
        right = np.array([1.0, 0.0]) / np.square(CHANGE_SD)
        for fit in fits:
            slide = fit.slide
            off_mm = getattr(slide, f"{name}_mm") - getattr(response, f"{name}_mm")
            known = slide.shown(without.at(slide.depth_mm, slide.height_mm), fit.shift_mm)
            rest = (slide.volts - fit.gain * known) / noise
            shown = np.stack([slide.shown(part, fit.shift_mm).ravel() for part in parts], axis=1)
            rows = fit.gain * off_mm / noise * shown
            weight = _weight(slide)
            normal += weight * rows.T @ rows
            right += weight * rows.T @ rest.ravel()
        factor, share = np.linalg.solve(normal, right)
        response = _with_slope(response, name, factor * design + share * still)
    return response


def _with_slope(response: ResponseMap, covariate: str, slope: np.ndarray) -> ResponseMap:
    """The map with another change (K, K, C) with a covariate, V/mm."""
    changed: dict[str, Any] = {f"{covariate}_slope": slope}
    return replace(response, **changed)


def _weight(slide: CalibrationSlide) -> float:
    """Of each of its stretches: one over the variance, in units of one block's noise, of the averaged noise and of the
    map's own residual."""
    return slide.weight / (1.0 / slide.blocks + MAP_VARIANCE)


def fit_splines(
    fits: list[SlideFit], response: ResponseMap, prior: ResponseMap | None, config: CalibrationConfig
) -> ResponseMap:
    """One penalised least-squares solution for M, Fx, Fy with the slides' gains and shifts held.

    Minimizes sum w |volts - g (M + cos Fx + sin Fy + (d - d0) D + (h - h0) H)|^2 + rim + penalties over
    the coefficients' distance from the prior's. The unknowns are in the order place, part: the normal matrix is then a
    band of a few hundred.
    """
    k = response.coefficients.shape[1]
    size = k * k
    right = np.zeros((size, PARTS, response.channels))
    start = np.zeros_like(right)
    if prior is not None:
        start = prior.coefficients.transpose(1, 2, 0, 3).reshape(right.shape)
    still = replace(response, coefficients=np.zeros_like(response.coefficients))
    # Slides of one direction share their weights of M, Fx, Fy, so that their Gram matrices add up.
    grams: dict[float, sparse.csr_matrix] = {}
    for fit in fits:
        slide, place = fit.slide, fit.slide.place(fit.shift_mm, response.lag_s)
        rows = tensor_splines(*place, response.half_mm, response.spacing_mm) * fit.gain
        weight, parts = _weight(slide), part_weights(slide.direction_rad)
        off = still.at(slide.depth_mm, slide.height_mm).coefficients[0].reshape(size, -1)
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


def roughness(k: int) -> sparse.spmatrix:
    """Penalty matrix (K^2, K^2): squared second differences of neighbouring coefficients along x and along y."""
    second = sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(k - 2, k))
    bend, line = second.T @ second, sparse.identity(k)
    return sparse.kron(bend, line) + sparse.kron(line, bend)


def rim_gram(response: ResponseMap) -> sparse.csr_matrix:
    """Gram matrix (K^2, K^2) of the splines at points of the rim, GRID_MM apart, where the response is zero."""
    x, y = spline_grid(response.half_mm)
    rim = (np.abs(x) > response.chamber_mm[0] / 2 + RIM_MM) | (
        np.abs(y) > response.chamber_mm[1] / 2 + RIM_MM
    )
    rows = tensor_splines(x[rim], y[rim], response.half_mm, response.spacing_mm)
    return rows.T @ rows


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
    """Slope of shift over speed, s; 0 of few slides or nearly equal speeds."""
    return np.polyfit(speeds, shifts, 1)[0] if len(speeds) > 8 and np.ptp(speeds) > 1 else 0.0


def _gain_sd(gains: np.ndarray, prior_sd: float) -> float:
    """Standard deviation of slides' gains (n,) about 1, the prior's counting as PRIOR_SLIDES further ones."""
    square = np.sum((gains - 1) ** 2) + PRIOR_SLIDES * prior_sd**2
    return float(np.sqrt(square / (len(gains) + PRIOR_SLIDES)))


def blank_map(sensor: Sensor, depth_mm: float, spacing_mm: float = SPACING_MM) -> ResponseMap:
    """A map without any response: the start of a fit from recordings alone."""
    k = knots(half_of(sensor.chamber_mm), spacing_mm)
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
