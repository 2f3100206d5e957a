"""What the sensor would have shown for a line, a speed, a place on it, a gain and a depth, with derivatives.

The response map as part of the network's graph, written in few, large operators: at this size they cost more than
the arithmetic. Shapes: B windows, A accelerometers, X axes of each that answer to a touch (V_x and V_y, or all three).
What is one for a window has the shape (B, 1, 1, ., .), what each such channel has of its own (B, A, X, ., .).
"""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from softslide.models.graph.packing import rounded
from softslide.models.response_map.map import ResponseMap

# Of time in a window: its own in fours; residuals of finer ones are correlated (experiments/LOG.md).
BINS = 16
STATE = 6  # numbers in the state: turn rad, log speed, offset mm, along mm, log gain, depth mm
# The map's coefficients in an exported graph: (cells, 4 C), the four parts of a channel side by side.
TABLE = "refinement.predicted.table"
EDGE = 3  # zero coefficients around the map's
# Any cubic is a sum of the cubes of t + these; ONNX Runtime cubes several times as fast as it takes other powers.
SHIFTS = (-1.5, -0.5, 0.5, 1.5)
# The sine of an angle plus these is its rotation: cos, -sin; sin, cos.
PHASES = np.array([[0.5, 1.0], [0.0, 0.5]]) * np.pi


class WithConstants(nn.Module):
    """A module whose constants are attributes by the names under which it holds them."""

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Tensor: ...

    def hold(self, constants: Mapping[str, Any], dtype: torch.dtype, persistent: bool = True) -> None:
        """Holds arrays by name. persistent: whether they are a part of the saved state."""
        for name, value in constants.items():
            self.register_buffer(name, torch.tensor(value, dtype=dtype), persistent)


class Prediction(WithConstants):
    """The measured signal less what the map predicts, and the prediction's derivatives."""

    def __init__(self, response: ResponseMap) -> None:
        super().__init__()
        self.boards, self.axes = response.boards, response.axes
        table, cells = patch_table(np.concatenate([response.coefficients, response.depth_slope[None]]))
        corner = np.array(response.reference_mm) + response.half_mm
        spacing_mm = response.spacing_mm
        path, path_ones = path_and_factors(spacing_mm)
        constants = {
            "first": (corner / spacing_mm + 1 + EDGE)[:, None],
            "stride": np.array([[cells, 1.0]]),
            "weights": np.float32(spline_weights(spacing_mm)),
            "shifts": np.array(SHIFTS),
            "phases": PHASES,
            "path": path,
            "path_ones": path_ones,
            "signals": signal_mixture(),
            "products": products(),
        }
        self.hold(constants, torch.float64)
        self.register_buffer("table", rounded(torch.tensor(table, dtype=torch.float32)))
        self.hold({"patch": [cells * i + j for i in range(-1, 3) for j in range(-1, 3)]}, torch.int64)
        self.last_cell, self.corners = cells - 3.001, (cells + 1, (cells + 1) * (cells - 3))

    def forward(self, measured: Tensor, start: Tensor, state: Tensor, time: Tensor) -> Tensor:
        """Derivatives of the predicted signal by the six numbers of the state, and the residual: (B, A, X, 7, 16) V.

        measured: (B, A, X, 7, 16) V, the signal in its last row. start: (B, 1, 1, 2, 2), the proposal's directions
        forward and left as columns. time: (B, 1, 1, 2, 16), ones, and how many seconds before the window's end the
        contact was where a bin's signal answers to.
        """
        turn, log_speed, place, gain, depth = state.split((1, 1, 2, 1, 1), 3)
        frame = start @ (turn + self.phases).sin()
        line = self.path @ torch.cat([log_speed.exp(), place], 3) + self.path_ones
        motion, factors = (line.reshape(-1, 1, 1, 10, 2) @ time).split((2, 8), 3)
        basis = self._basis(frame @ motion + self.first)
        # Of M, Fx, Fy, D and their slopes: the signal, its change with depth and by friction, its slopes on and left.
        heading = F.pad(frame[..., :1], (0, 0, 1, 0), value=1.0)
        mixed = heading * (torch.cat([heading, depth], 3) * gain.exp()).transpose(3, 4)
        mixture = (mixed.reshape(-1, 1, 1, 1, 12) @ self.signals).reshape(-1, 1, 1, 8, 12)
        return self.products @ (factors * (mixture @ basis)) + measured

    def _basis(self, place: Tensor) -> Tensor:
        """M, Fx, Fy, D (fastest) as value, slope along x, slope along y at places (B, 1, 1, 2, 16) in cells of the
        table -> (B, A, X, 12, 16) V, V/mm."""
        place = place.clamp(1.0, self.last_cell)
        cell = place.floor()
        cubes = ((place - cell)[..., None] + self.shifts) ** 3
        across, up = (cubes @ self.weights).split(1, 3)
        # What is no number is looked up somewhere, and remains none.
        corner = (self.stride @ cell).long().clamp(*self.corners).reshape(-1, BINS, 1)
        coefficients = F.embedding(corner + self.patch, self.table).double()
        basis = (across * up).reshape(-1, BINS, 3, 16) @ coefficients
        return (
            basis.reshape(-1, BINS, 3, self.boards, self.axes, 4)
            .permute(0, 3, 4, 2, 5, 1)
            .reshape(-1, self.boards, self.axes, 12, BINS)
        )


def patch_table(parts: np.ndarray) -> tuple[np.ndarray, int]:
    """Spline coefficients (4, K, K, C) of M, Fx, Fy, D as rows of a table, (K + 2 EDGE)^2 x 4 C, and K + 2 EDGE.

    The edge is zero: off the map nothing answers, and whatever lies there may be read.
    """
    padded = np.pad(parts, ((0, 0), (EDGE, EDGE), (EDGE, EDGE), (0, 0))).transpose(1, 2, 3, 0)
    return padded.reshape(-1, padded.shape[2] * padded.shape[3]), len(padded)


def spline_weights(spacing_mm: float) -> np.ndarray:
    """(2, 4, 48), for x and for y: (t + SHIFTS)^3 within a cell -> what each of a patch's 4 x 4 coefficients (the last
    axis, y fastest) weighs by this coordinate in the surface's value, its slope along x and along y (1/mm; 3 x 16)."""
    powers = np.array([[math.comb(3, n) * shift ** (3 - n) for shift in SHIFTS] for n in range(4)])
    value = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6
    slope = np.zeros((4, 4))
    slope[:3] = np.arange(1, 4)[:, None] * value[1:] / spacing_mm
    across = np.repeat(np.stack([value, slope, value], axis=1), 4, axis=2)
    up = np.tile(np.stack([value, value, slope], axis=1), (1, 1, 4))
    return np.linalg.solve(powers, np.stack([across, up]).reshape(2, 4, 48))


def path_and_factors(spacing_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """(20, 3) and (20, 1): speed mm/s, offset and along mm -> what takes (1, seconds ago) to (10, 16).

    The contact's place forward and to the left, in cells of the table; then the factors of the signals that
    `signal_mixture` gives.
    """
    speed, offset, along = range(3)
    by_state, ones = np.zeros((10, 2, 3)), np.zeros((10, 2, 1))
    by_state[0, 0, along], by_state[0, 1, speed], by_state[1, 0, offset] = 1, -1, 1
    by_state[:2] /= spacing_mm
    # s times the slope to the left, less the offset times the slope forward; the slope forward by log speed.
    by_state[2, 0, along], by_state[2, 1, speed] = 1, -1
    by_state[3, 0, offset], by_state[4, 1, speed] = -1, -1
    ones[5:, 0] = 1
    return by_state.reshape(20, 3), ones.reshape(20, 1)


def signal_mixture() -> np.ndarray:
    """(12, 96): what (1, cos, sin) x (1, cos, sin, depth) times the gain make of the basis.

    Rows of the mixture (8, 12): the signal's slope to the left; its slope forward, twice; these two again; the
    signal M + cos Fx + sin Fy + depth D; D; the friction's change with the heading, cos Fy - sin Fx.
    """
    one, cos, sin = range(3)
    _, fx, fy, d = range(4)
    left, forward, signal, deep, friction = range(5)
    mixture = np.zeros((3, 4, 5, 3, 4))
    for part in range(4):
        # Each part of the basis has its factor at its own place in (1, cos, sin, depth).
        mixture[sin, part, left, 1, part], mixture[cos, part, left, 2, part] = -1, 1
        mixture[cos, part, forward, 1, part] = mixture[sin, part, forward, 2, part] = 1
        mixture[one, part, signal, 0, part] = 1
    mixture[one, 0, deep, 0, d] = 1
    mixture[one, cos, friction, 0, fy], mixture[one, sin, friction, 0, fx] = 1, -1
    return mixture[:, :, [left, forward, forward, left, forward, signal, deep, friction]].reshape(12, 96)


def products() -> np.ndarray:
    """(7, 8): signals times their factors -> derivatives by turn, log speed, offset, along, gain and depth; and the
    signal's negative, which leaves the residual where the measured one is added."""
    rows = np.zeros((7, 8))
    rows[0, [0, 1, 7]] = 1
    rows[range(1, 6), [2, 3, 4, 5, 6]] = 1
    rows[6, 5] = -1
    return rows
