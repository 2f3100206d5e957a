"""How a map changes with contact depth and with the skin's height, from slides at several of them.

The lines of each depth or height are too few for a change that is free in place: held-out lines are predicted worse by
it (experiments/LOG.md). It has two numbers, one on the design's change and one on the response itself.
"""

from dataclasses import replace

import numpy as np

from models.response_map.map import ResponseMap
from models.response_map.slides import LEAST_HEIGHTS_MM, CalibrationSlide, main_height_mm, several_heights
from models.response_map.spline_fit import MAP_VARIANCE

LEAST_DEPTHS_MM = 0.1  # what depths differ by at least; a gain of 2 % is worth as much
# Priors of the change with depth or height: of its factor on the design's, and of what it holds of the response itself,
# 1/mm.
CHANGE_SD = (0.5, 0.1)


def several_depths(slides: list[CalibrationSlide]) -> bool:
    """Whether the slides' contact depths differ enough to tell how the response changes with depth."""
    return bool(np.ptp([slide.depth_mm for slide in slides]) > LEAST_DEPTHS_MM)


def over_heights(response: ResponseMap, slides: list[CalibrationSlide]) -> ResponseMap:
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


def first_slides(slides: list[CalibrationSlide], response: ResponseMap) -> np.ndarray:
    """(n,) bool: the slides that the first map is fitted to. Where most have the map's height it is they alone: what
    the others differ by is then the change with height, and not in the map already."""
    every = np.ones(len(slides), dtype=bool)
    if response.height_slope is None:
        return every
    main = np.abs([slide.height_mm - response.height_mm for slide in slides]) <= LEAST_HEIGHTS_MM
    return main if main.mean() > 0.5 else every


def with_changes(
    response: ResponseMap,
    slides: list[CalibrationSlide],
    gains: np.ndarray,
    shifts: np.ndarray,
    prior: ResponseMap,
) -> ResponseMap:
    """The map with its change with depth and with height fitted to slides of several. prior: with the design's."""
    if several_depths(slides):
        off_mm = np.array([slide.depth_mm - response.depth_mm for slide in slides])
        without = replace(response, depth_slope=np.zeros_like(prior.depth_slope))
        slope = _fitted_change(slides, gains, shifts, without, prior.depth_slope, off_mm)
        response = replace(response, depth_slope=slope)
    if response.height_slope is not None:
        flat = np.zeros_like(response.height_slope)
        design = flat if prior.height_slope is None else prior.height_slope
        off_mm = np.array([slide.height_mm - response.height_mm for slide in slides])
        without = replace(response, height_slope=flat)
        slope = _fitted_change(slides, gains, shifts, without, design, off_mm)
        response = replace(response, height_slope=slope)
    return response


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
    map's.
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
