"""The likeliest places of a recorded contact, on a grid (Viterbi, IEEE Trans. Inf. Theory 13, 1967)."""

import math
from typing import NamedTuple

import numpy as np

from softslide.features.contact.hypotheses import LocalErrors
from softslide.features.contact.response_surface import ResponseSurface

GRID_MM = 0.5
REACH = 3.0  # standard deviations of a step that are looked at


class Measured(NamedTuple):
    """A contact's blocks from the touch to the lift.

    volts: (m, C) V, subtracted, NaN where a block was not measured. variance: (C,) V^2 of a block's residual, alike
    everywhere. gain_sd: of the whole contact's gain. half_mm: half the sizes of the chamber.
    """

    volts: np.ndarray
    variance: np.ndarray
    block_s: float
    gain_sd: float
    half_mm: tuple[float, float]

    @property
    def known(self) -> np.ndarray:
        """(m,) bool: the blocks that were measured."""
        return np.isfinite(self.volts).all(axis=1)


def first_places(
    measured: Measured, surface: ResponseSurface, local: LocalErrors, step_mm: float
) -> np.ndarray:
    """The likeliest places (m, 2) mm on a grid, of a contact that goes step_mm from block to block."""
    axes = [np.arange(-h, h + GRID_MM / 2, GRID_MM) for h in measured.half_mm]
    x, y = (axis.ravel() for axis in np.meshgrid(*axes, indexing="ij"))
    response = surface.at(x, y)[:, :, 0]
    near = LocalErrors(math.hypot(local.place_mm, GRID_MM / 2), math.hypot(local.gain, measured.gain_sd))
    white, log_size = whitening(response[:, 0], response[:, 1:], measured.variance, near)
    shape = (len(axes[0]), len(axes[1]))
    total, came = np.zeros(shape), []
    for n, (volts, known) in enumerate(zip(measured.volts, measured.known, strict=True)):
        if n:
            # The way's square is the sum of its parts along x and y: the best one along each is found by itself.
            along_x, from_x = _nearest(total, step_mm)
            along_y, from_y = _nearest(along_x.T, step_mm)
            came.append((from_x, from_y.T))
            total = along_y.T
        if known:
            gap = white @ (volts - response[:, 0])[:, :, None]
            total = total + 0.5 * ((gap**2).sum((1, 2)) + log_size).reshape(shape)
    cell = divmod(int(total.argmin()), shape[1])
    cells = [cell]
    for from_x, from_y in reversed(came):
        column = int(from_y[cell])
        cell = (int(from_x[cell[0], column]), column)
        cells.append(cell)
    at = np.array(cells[::-1])
    return np.stack([axes[0][at[:, 0]], axes[1][at[:, 1]]], axis=1)


def _nearest(total: np.ndarray, step_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """For each row the least of the rows' totals and of half the squared way from them, and the row that has it."""
    reach, rows = math.ceil(REACH * step_mm / GRID_MM), len(total)
    padded = np.pad(total, ((reach, reach), (0, 0)), constant_values=np.inf)
    steps = np.arange(-reach, reach + 1)
    before = np.stack(
        [padded[reach + i : reach + i + rows] + 0.5 * (i * GRID_MM / step_mm) ** 2 for i in steps]
    )
    best = before.argmin(axis=0)
    return np.take_along_axis(before, best[None], axis=0)[0], np.arange(rows)[:, None] + steps[best]


def whitening(
    shown: np.ndarray, slopes: np.ndarray, variance: np.ndarray, local: LocalErrors
) -> tuple[np.ndarray, np.ndarray]:
    """What makes residuals white: matrices (k, C, C), and the logarithms (k,) of the covariances' determinants.

    shown: (k, C) V and slopes: (k, 2, C) V/mm, the response; variance: (C,) V^2, alike everywhere.
    """
    covariance = np.diag(variance) + local.place_mm**2 * (slopes.transpose(0, 2, 1) @ slopes)
    covariance = covariance + local.gain**2 * shown[:, :, None] * shown[:, None]
    factor = np.linalg.cholesky(covariance)
    return np.linalg.inv(factor), 2.0 * np.log(factor.diagonal(axis1=1, axis2=2)).sum(1)
