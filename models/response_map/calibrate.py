"""Calibration: a response map fitted to a sensor's labelled slides, with a map of its design (if any) as the prior.

P-splines (Eilers and Marx 1996): penalised least squares for the splines' coefficients. It alternates with each
slide's own gain and its shift along its line (the moment of start and the place of a stage are known to about 0.1 mm),
and with a lag common to all. The penalty on second differences keeps the friction parts, which few directions tell
apart, from following the noise.
"""

from dataclasses import replace

import numpy as np

from models.response_map.changes import first_slides, over_heights, several_depths, with_changes
from models.response_map.config import CalibrationConfig
from models.response_map.map import MARGIN_MM, PARTS, SPACING_MM, ResponseMap, knots
from models.response_map.slide_fit import fit_slide
from models.response_map.slides import CalibrationSlide
from models.response_map.spline_fit import fit_splines
from pipeline.sensor import Sensor

LEAST_DRIFT_V = 5e-4  # the static output is never known better: one step of the article's converter
OUTLIER = 4.0  # times the median residual: a slide beyond it has a wrong label
PRIOR_SLIDES = 4  # how many slides' worth the priors of gain and drift count
CLEAR = 0.3  # share of the largest peak below which a slide's gain is mostly noise
SHRINKAGE = 0.1  # of the residuals' covariance; without it errors were the same within 0.02 deg


def calibrate(
    slides: list[CalibrationSlide], prior: ResponseMap, informed: bool, config: CalibrationConfig
) -> tuple[ResponseMap, dict[str, float]]:
    """Fits the map.

    prior: where the fit starts and, if `informed` (it comes from an atlas), what it stays near.
    Returns the map, and its residual: `residual_v` (rms over the slides), `residual_share` (of each slide's largest
    output, median), `gain_sd`, `lag_s`, `slides`, `outliers`.
    """
    noise = np.sqrt(np.mean([s.rest_noise_v**2 for s in slides], axis=0))
    response = over_heights(replace(prior, noise_v=noise), slides)
    gains, shifts = np.ones(len(slides)), np.zeros(len(slides))
    speeds = np.array([s.speed_mm_s.max() for s in slides])
    rms, means = np.empty(len(slides)), np.empty((len(slides), response.channels))
    residuals = [slide.volts for slide in slides]
    keep, timed = np.ones(len(slides), dtype=bool), np.array([s.timed for s in slides])
    for first in (True, *[False] * (config.iterations - 1)):
        kept = [slide for slide, k in zip(slides, keep, strict=True) if k]
        told = first_slides(slides, response) & keep if first else keep
        response = fit_splines(
            [slide for slide, k in zip(slides, told, strict=True) if k],
            gains[told],
            shifts[told],
            response,
            prior if informed else None,
            config,
        )
        response = with_changes(response, kept, gains[keep], shifts[keep], prior)
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
