"""The response map on the device: its spline surfaces and their slopes at many places in a few operations.

The map is that of `models/response_map/map.py`: V(x, y) = M + cos(a) Fx + sin(a) Fy + (d - d0) D, each a tensor product
of uniform cubic B-splines (de Boor, A Practical Guide to Splines, 1978, chapter IX).
"""

import numpy as np

PARTS = 4  # M, Fx, Fy, D
EDGE = 3  # cells without response around the map


class ResponseSurface:
    """coefficients: (4, K, K, C) V, splines of M, Fx, Fy (V) and D (V/mm); half_mm: they cover [-half_mm, half_mm];
    spacing_mm: of the knots."""

    def __init__(self, coefficients: np.ndarray, half_mm: float, spacing_mm: float) -> None:
        self.channels = coefficients.shape[3]
        self._half, self._spacing = half_mm, spacing_mm
        padded = np.pad(coefficients, ((0, 0), (EDGE, EDGE), (EDGE, EDGE), (0, 0)))
        self._cells = padded.shape[1] - 3
        # A row for each cell: what its 4 x 4 splines weigh, so that a place costs one look-up.
        rows = np.empty((self._cells, self._cells, 16, PARTS * self.channels))
        for n in range(16):
            i, j = divmod(n, 4)
            patch = padded[:, i : i + self._cells, j : j + self._cells]
            rows[:, :, n] = patch.transpose(1, 2, 0, 3).reshape(self._cells, self._cells, -1)
        self._rows = rows.reshape(self._cells**2, -1)

    def at(self, x_mm: np.ndarray, y_mm: np.ndarray) -> np.ndarray:
        """Places (N,), (N,) mm -> (N, 3, 4, C): value (V), slope along x and along y (V/mm) of M, Fx, Fy, D."""
        place = np.stack([x_mm, y_mm]) + self._half
        place = np.minimum(np.maximum(place / self._spacing + EDGE, 0.0), self._cells - 1e-6)
        cell = place.astype(np.intp)
        value, slope = _splines((place - cell)[..., None])
        slope /= self._spacing
        count = place.shape[1]
        basis = np.empty((count, 3, 4, 4))
        np.multiply(value[0, :, :, None], value[1, :, None], out=basis[:, 0])
        np.multiply(slope[0, :, :, None], value[1, :, None], out=basis[:, 1])
        np.multiply(value[0, :, :, None], slope[1, :, None], out=basis[:, 2])
        patch = self._rows[cell[0] * self._cells + cell[1]].reshape(count, 16, -1)
        return (basis.reshape(count, 3, 16) @ patch).reshape(count, 3, PARTS, self.channels)


# A cubic's coefficients (1, t, t2, t3) of the four B-splines over a cell, and of their derivatives.
_VALUE = np.array([[1.0, -3, 3, -1], [4, 0, -6, 3], [1, 3, 3, -3], [0, 0, 0, 1]]).T / 6
_SLOPE = np.array([[-3.0, 6, -3, 0], [0, -12, 9, 0], [3, 6, -9, 0], [0, 0, 3, 0]]).T / 6


def _splines(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The four splines at t (..., 1) in [0, 1) of a cell, and their derivatives by t -> (..., 4) each."""
    square = t * t
    powers = np.concatenate([np.ones_like(t), t, square, square * t], axis=-1)
    return powers @ _VALUE, powers @ _SLOPE
