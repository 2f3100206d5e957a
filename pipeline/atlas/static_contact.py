"""Skin height (mm), and place (mm), depth (mm) and force (N) of a resting contact, from static readings (g).

    height = height_by_atlas(static_g, atlas)
    press = find_indentation(subtracted_g, atlas, atlas.pressure_at(height))
    doubt = indentation_doubt(subtracted_g, atlas, atlas.pressure_at(height), press)

Readings are volts over `sensitivity_v_per_g`: `static_g` of the untouched skin, less `zero_g_v`; `subtracted_g` of the
touched skin, less the untouched one's. The article gives a formula for the height (section 5.1,
`height_by_formula`) and none for the place of a press.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq, least_squares

from softslide.features.errors import InputError
from softslide.pipeline.atlas.atlas import Atlas

# What a reading of a press errs by: the mean of 0.2 s of an accelerometer that drifts by 1 mg in a minute, and the
# share of the largest reading that a fitted design leaves (models/response_map/from_atlas.py).
READING_G = 0.002
MODEL_SHARE = 0.05
# Of the grid that the doubt is read from.
PLACE_MM, DEPTHS = 0.5, 5


def height_by_formula(static_g: float, board_mm: float, half_width_mm: float) -> float:
    """The article's height (mm): parabolic skin, h = D^2 tan(beta) / (2 x0), sin(beta) = V_x / (g k).

    Args:
        static_g: the untouched accelerometer's reading along x, V_x / k. board_mm: its x0, not zero.
        half_width_mm: D, half the chamber's width.

    Raises:
        InputError: the board is at the centre, where the skin is level at any height; or no tilt has this sine.
    """
    if board_mm == 0:
        raise InputError("the accelerometer is at the chamber's centre, level at any height")
    if not -1 < static_g < 1:
        raise InputError(
            f"a static output of {static_g:g} g is not a tilt; check zero_g_v and sensitivity_v_per_g"
        )
    return half_width_mm**2 * math.tan(math.asin(static_g)) / (2 * board_mm)


def height_by_atlas(static_g: np.ndarray, atlas: Atlas) -> float:
    """The height (mm) whose solved static readings fit readings (boards, 2) along x and y best, in g.

    Raises:
        InputError: the readings lie outside the heights that the atlas was solved for.
    """
    static_g = np.asarray(static_g, float)
    directions = atlas.static(float(atlas.pressure_mpa[-1]))[:, :2]
    directions = directions / np.linalg.norm(directions)
    wanted = float((directions * static_g).sum())

    def excess(pressure: float) -> float:
        return float((directions * atlas.static(pressure)[:, :2]).sum()) - wanted

    low, high = float(atlas.pressure_mpa[0]), float(atlas.pressure_mpa[-1])
    if len(atlas.pressure_mpa) == 1 or excess(low) > 0 or excess(high) < 0:
        raise InputError(
            f"a static tilt of {wanted:.3f} g lies outside the atlas's heights "
            f"{atlas.height_mm[0]:.3g}..{atlas.height_mm[-1]:.3g} mm; simulate the design at others"
        )
    return atlas.height(brentq(excess, low, high, xtol=1e-9))


@dataclass(frozen=True)
class Indentation:
    """A resting contact: its place, depth below the flat skin's face and normal force.

    misfit_g: norm of the residual.
    """

    x_mm: float
    y_mm: float
    depth_mm: float
    force_n: float
    misfit_g: float


def find_indentation(subtracted_g: np.ndarray, atlas: Atlas, pressure_level: float) -> Indentation:
    """The contact whose readings are nearest to subtracted readings (boards, 3) in g.

    pressure_level: effective, MPa (`Atlas.pressure_at`). At each of up to five depths the best grid point starts a
    bounded least-squares fit of x, y and depth; the fit with the least residual is returned. One accelerometer's two
    tilts cannot determine three unknowns, so with one board the depth rests on its weak z reading.

    Raises:
        InputError: the readings have another shape than the atlas's boards.
    """
    wanted = np.asarray(subtracted_g, float)
    if wanted.shape != (atlas.boards, 3):
        raise InputError(f"readings of shape {wanted.shape} for {atlas.boards} boards; give (boards, 3)")
    grid_x, grid_y = (v.ravel() for v in np.meshgrid(atlas.x_mm, atlas.y_mm, indexing="ij"))
    reach = np.array(atlas.meta["reach_mm"])

    def misfit(place: np.ndarray) -> np.ndarray:
        found = atlas.response(place[:1], place[1:2], None, place[2:3], pressure_level)[0]
        return np.nan_to_num(found - wanted, nan=1.0).ravel()

    ends = []
    margin = 1e-9
    for depth in _depths(atlas):
        table = atlas.response(grid_x, grid_y, None, float(depth), pressure_level)
        errors = np.nan_to_num(((table - wanted) ** 2).sum(axis=(1, 2)), nan=np.inf)
        start = np.array([grid_x[errors.argmin()], grid_y[errors.argmin()], depth])
        low = np.array([*-reach, atlas.depth_mm[0] - margin])
        high = np.array([*reach, atlas.depth_mm[-1] + margin])
        inner = np.clip(start, low + 1e-9 * (high - low), high - 1e-9 * (high - low))
        ends.append(least_squares(misfit, inner, bounds=(low, high), x_scale=[1.0, 1.0, 0.2], xtol=1e-10))
    best = min(ends, key=lambda end: end.cost)
    x, y, depth = best.x
    depth = float(np.clip(depth, atlas.depth_mm[0], atlas.depth_mm[-1]))
    force = atlas.force(np.array([x]), np.array([y]), None, depth, pressure_level)[0, 2]
    return Indentation(float(x), float(y), depth, float(force), math.sqrt(2 * best.cost))


@dataclass(frozen=True)
class Doubt:
    """How well readings determine a press: what holds 90 % of its posterior.

    radius_mm: about its place. depth_mm, force_n: intervals.
    """

    radius_mm: float
    depth_mm: tuple[float, ...]
    force_n: tuple[float, ...]


def indentation_doubt(
    subtracted_g: np.ndarray, atlas: Atlas, pressure_level: float, found: Indentation
) -> Doubt:
    """The doubt of an indentation that `find_indentation` found in the same readings (boards, 3) in g.

    Every place of a grid and every depth of the atlas is as likely before; a reading errs by READING_G and by
    MODEL_SHARE of the largest.
    """
    wanted = np.asarray(subtracted_g, float)
    reach = atlas.meta["reach_mm"]
    x, y = (
        axis.ravel()
        for axis in np.meshgrid(*(np.arange(-r, r + PLACE_MM / 2, PLACE_MM) for r in reach), indexing="ij")
    )
    depths = _depths(atlas)
    variance = READING_G**2 + (MODEL_SHARE * np.abs(wanted).max()) ** 2
    off, force = np.empty((2, len(depths), len(x)))
    for n, depth in enumerate(depths):
        response = atlas.response(x, y, None, float(depth), pressure_level)
        off[n] = np.nan_to_num(((response - wanted) ** 2).sum(axis=(1, 2)), nan=np.inf)
        force[n] = atlas.force(x, y, None, float(depth), pressure_level)[:, 2]
    weight = np.exp(-0.5 * (off - off.min()) / variance)
    weight /= weight.sum()
    away = np.broadcast_to(np.hypot(x - found.x_mm, y - found.y_mm), off.shape)
    (radius,) = _quantiles(away, weight, 0.9)
    return Doubt(
        max(radius, PLACE_MM),
        _quantiles(np.broadcast_to(depths[:, None], off.shape), weight, 0.05, 0.95),
        _quantiles(np.nan_to_num(force), weight, 0.05, 0.95),
    )


def _depths(atlas: Atlas) -> np.ndarray:
    return np.linspace(atlas.depth_mm[0], atlas.depth_mm[-1], DEPTHS if len(atlas.depth_mm) > 1 else 1)


def _quantiles(values: np.ndarray, weight: np.ndarray, *shares: float) -> tuple[float, ...]:
    """Of values with weights of the same shape, that sum to 1."""
    return tuple(np.quantile(values, shares, weights=weight, method="inverted_cdf").tolist())
