"""Interpolating splines along one axis of a grid, and the grid's bounds."""

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from softslide.features.errors import InputError


def fit_axis(grid: np.ndarray, values: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Knots, coefficients and degree of the interpolating spline along an axis; constant over one point."""
    if len(grid) == 1:
        return np.array([grid[0] - 1e6, grid[0] + 1e6]), values, 0
    spline = make_interp_spline(grid, values, k=min(3, len(grid) - 1), axis=axis)
    return spline.t, np.moveaxis(spline.c, 0, axis), spline.k


def along(grid: np.ndarray, values: np.ndarray, at: float) -> np.ndarray:
    """One-dimensional spline through values (n, ...), at one place."""
    return BSpline(*fit_axis(grid, values, 0))(at)


def check_inside(name: str, values: np.ndarray, grid: np.ndarray, unit: str) -> None:
    """Raises InputError where a value lies outside a grid; a grid of one point admits that point alone."""
    margin = 1e-6 * max(1.0, abs(grid[-1])) if unit == "mm" else 1e-6 * grid[-1]
    low, high = float(np.min(values, initial=np.inf)), float(np.max(values, initial=-np.inf))
    if values.size and not (low >= grid[0] - margin and high <= grid[-1] + margin):
        wrong = low if not low >= grid[0] - margin else high
        raise InputError(f"{name} {wrong:g} lies outside the atlas's {grid[0]:.4g}..{grid[-1]:.4g} {unit}")
