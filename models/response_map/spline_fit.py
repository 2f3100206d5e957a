"""The splines of a map from slides whose gains and shifts are known: penalised least squares in a banded matrix."""

from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.linalg import solveh_banded

from models.response_map.config import CalibrationConfig
from models.response_map.map import PARTS, SPACING_MM, ResponseMap, knots, splines_at
from models.response_map.slides import CalibrationSlide

# Variance of the map's own residual, which no averaging lessens, in units of a block's noise variance: on bench-a the
# residual is 0.86 mV beside a noise of 1.35 mV (residual_v in the card of a bundle), 0.4.
MAP_VARIANCE = 0.5
RIM_MM = 1.5  # from this far beyond the chamber's edge on, the skin lies on the base and shows nothing
RIM_WEIGHT = 3.0  # of a rim point, one each mm; a stretch of 0.5 mm weighs at most 2
# Hold coefficients that no slide touches: share of the smoothing, and at least.
RIDGE, LEAST_RIDGE = 1e-3, 1e-6
PENALTY_NOISE_V = 1.35e-3  # a block's noise on the recordings that the penalties were chosen on


def fit_splines(
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
