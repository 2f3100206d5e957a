"""Gauss-Newton against the response map, as part of the network's graph.

The map predicts what the accelerometers would have shown for a line, a speed, a place on it, a gain and a depth; a few
steps move a proposal to where prediction and signal agree best, with the proposal as a weak prior, and leave a
covariance. Written in few, large operators: at this size they cost more than the arithmetic.

Shapes: B windows, A accelerometers, C = 2 A tilt channels. What is one for a window has the shape (B, 1, 1, ., .), what
each tilt channel has of its own (B, A, 2, ., .).
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from features.window import WINDOW_BINS
from models.packing import rounded
from models.response_map import SPACING_MM, ResponseMap

PEAK_SHARE = 0.003  # what the map leaves over, as a share of the slide's largest output
FLOOR_SHARE = 0.6  # and of what it left over in calibration, most of which bins hold alike
DOUBT = 2.0  # variance of the depth's error over the one that noise explains, on held-out lines
BINS = (
    16  # of time in the refinement: a window's bins in fours; what the map leaves over is alike in neighbours
)
STATE = 6  # numbers in the state: turn rad, log speed, offset mm, along mm, log gain, depth mm
DEPTH = 5  # place of the depth among them
EDGE = 3  # zero coefficients around the map's
LONGEST_STEP = (0.3, 0.4, 5.0, 6.0, 0.1, 0.5)
SHIFTS = (-1.5, -0.5, 0.5, 1.5)  # of the cubes that make up the splines


@dataclass(frozen=True)
class RefinementConfig:
    """steps: of Gauss-Newton. The last one's end is not looked at: the misfit is the one before it, and tells what
    had not converged.
    trust: the proposal's standard deviations times this are the prior, but never less
    than least_prior (rad, log, mm, mm): a proposal that is wrong must not hold it back.

    same_depth: prior probability that a slide has the calibration's contact depth; depth_sd_mm: standard deviation
        about it of those that do not.
    askew: standard deviation of what V_x and V_y pick up of V_z, where the device stands otherwise than it did.
    lean_v: standard deviation of what the device's own slow turn adds to every V_x, and to every V_y, by a slide's
        end, V; 0 for a device that stands still. An accelerometer off the skin tells it from the skin's answer.
    """

    steps: int = 3
    trust: float = 3.0
    least_prior: tuple[float, float, float, float] = (0.1, 0.1, 1.5, 2.0)
    same_depth: float = 0.9
    depth_sd_mm: float = 0.35
    askew: float = 0.01
    lean_v: float = 0.0

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise ValueError(f"steps is {self.steps}; take at least one")


class Refinement(nn.Module):
    """Gauss-Newton on (turn, log speed, offset, along, gain, depth) against the response map.

    Residuals are weighed by the inverse of their covariance: noise that falls with the number of blocks a bin holds,
    a floor for what the map leaves over, the slow wander of each channel's zero, and what a board that stands askew
    picks up of its own V_z (the ripple of the pressure; each a rank-one part of a channel's covariance).
    """

    table: Tensor
    patch: Tensor
    first: Tensor
    stride: Tensor
    weights: Tensor
    shifts: Tensor
    noise: Tensor
    drift: Tensor
    pooled: Tensor
    rippled: Tensor
    ago: Tensor
    lag: Tensor
    looseness: Tensor
    tightest: Tensor
    longest_step: Tensor
    each: Tensor
    whole: Tensor
    quarter: Tensor
    phases: Tensor
    path: Tensor
    path_ones: Tensor
    signals: Tensor
    products: Tensor
    lean: Tensor

    def __init__(self, response: ResponseMap, block_s: float, config: RefinementConfig) -> None:
        super().__init__()
        assert response.noise_v is not None
        assert response.drift_v is not None
        self.boards = response.channels // 2
        table, cells = patch_table(np.concatenate([response.coefficients, response.depth_slope[None]]))
        corner = np.array(response.reference_mm) + response.half_mm
        nuisance = (response.gain_sd, config.depth_sd_mm)
        path, path_ones = path_and_factors()
        middle = (np.arange(BINS) + 0.5) / BINS
        quarter = np.array([[1.0, 0, 0, 1], [0, -1, 1, 0]])
        buffers = {
            "first": (corner / SPACING_MM + 1 + EDGE)[:, None],
            "stride": np.array([[cells, 1.0]]),
            "weights": np.float32(spline_weights()),
            "shifts": np.array(SHIFTS),
            "noise": response.noise_v.reshape(self.boards, 2, 1, 1) ** 2,
            "drift": response.drift_v.reshape(self.boards, 2, 1, 1) ** 2,
            "pooled": np.float32(pooling() @ np.linalg.inv(bin_means()).T),
            "rippled": pooling() @ (np.eye(BINS) - 1.0 / BINS),
            "ago": np.stack([np.zeros(BINS), 1.0 - middle]),
            "lag": np.stack([np.ones(BINS), np.full(BINS, response.lag_s)]),
            "looseness": np.log([*4 * (config.trust,), *nuisance])[:, None],
            "tightest": np.log([*config.least_prior, *nuisance])[:, None],
            "longest_step": np.array(LONGEST_STEP)[:, None],
            "each": np.eye(STATE, STATE + 1),
            "whole": np.eye(BINS),
            "quarter": quarter,
            "phases": np.array([[0.5, 1.0], [0.0, 0.5]]) * np.pi,
            "path": path,
            "path_ones": path_ones,
            "signals": signal_mixture(),
            "products": products(),
            "lean": config.lean_v * middle[:, None],
        }
        # In doubles: partial strokes leave the normal matrix nearly singular.
        for name, value in buffers.items():
            self.register_buffer(name, torch.tensor(value, dtype=torch.float64))
        self.register_buffer("table", rounded(torch.tensor(table, dtype=torch.float32)))
        self.register_buffer(
            "patch", torch.tensor([cells * i + j for i in range(-1, 3) for j in range(-1, 3)])
        )
        self.last_cell, self.corners = cells - 3.001, (cells + 1, (cells + 1) * (cells - 3))
        self.block_s, self.floor_v, self.askew = block_s, response.floor_v, config.askew
        self.depth_mm = response.depth_mm
        self.depth_sd_mm, self.same_depth = config.depth_sd_mm, config.same_depth
        self.knows_depth = bool(np.any(response.depth_slope))
        self.steps = config.steps
        self.leans = config.lean_v > 0

    def forward(
        self, volts: Tensor, elapsed_s: Tensor, weight: Tensor, proposal: Tensor, log_sd: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """volts (B, A, 3, 64) V, elapsed_s (B,) s, weight (B, A), proposal (B, 5) and log_sd (B, 4) as `Proposal` gives
        them -> columns (B, 1, 1, ., 1): heading (cos, sin), state (the turn from the proposal, log speed, offset mm,
        along mm, log gain, depth mm off the map's), its variance, misfit."""
        volts, elapsed_s, weight, proposal, log_sd = (
            given.double() for given in (volts, elapsed_s, weight, proposal, log_sd)
        )
        elapsed_s, weight = elapsed_s.reshape(-1, 1, 1, 1, 1), weight.reshape(-1, self.boards, 1, 1, 1)
        # What follows compares values at the bins' centres; a bin holds a mean, which is flatter than the signal.
        tilt = (volts[:, :, :2] @ self.pooled)[:, :, :, None]
        inverse = self._inverse_covariance(
            tilt, (volts[:, :, 2:] @ self.rippled)[:, :, None], elapsed_s, weight
        )
        measured = F.pad(tilt, (0, 0, STATE, 0))
        time = elapsed_s * self.ago + self.lag
        pair, own = proposal.split((2, 3), 1)
        norm = (pair * pair).sum(1, keepdim=True).clamp(min=1e-12).sqrt()
        start = (pair / norm @ self.quarter).reshape(-1, 1, 1, 2, 2)
        centre = F.pad(own, (1, 2)).reshape(-1, 1, 1, STATE, 1)
        log_sd = F.pad(log_sd, (0, 2)).reshape(-1, 1, 1, STATE, 1) + self.looseness
        precision = (-2.0 * torch.maximum(log_sd, self.tightest)).exp()
        state, gram, covariance = centre, centre, centre
        for _ in range(self.steps):
            rows = self._rows(measured, start, state, time)
            gram = ((rows @ inverse) @ rows.transpose(3, 4)).sum((1, 2), keepdim=True)
            if self.leans:
                gram = gram - self._leaning(rows, inverse)
            # The prior's part: it holds the state to the proposal.
            normal = gram[..., :STATE, :] + precision * (self.each - F.pad(state - centre, (STATE, 0)))
            covariance = inverted(normal[..., :STATE])
            move = covariance @ normal[..., STATE:]
            state = state + torch.maximum(torch.minimum(move, self.longest_step), -self.longest_step)
        misfit = gram[..., STATE:, STATE:] / (2 * BINS * weight.sum(1, keepdim=True)).clamp(min=1.0)
        state, variance = self._same_depth(state, covariance)
        heading = start @ (state[..., :1, :] + self.phases[:, :1]).sin()
        return heading, state, variance, misfit

    def _leaning(self, rows: Tensor, inverse: Tensor) -> Tensor:
        """What the device's own slow turn takes from the rows' products: it leans all boards alike, a number for each
        axis, whose worth is not asked for."""
        along = inverse @ self.lean
        told = (self.lean * along).sum((1, 3), keepdim=True)
        leaning = (rows @ along).sum(1, keepdim=True)
        return (leaning @ (leaning / (1.0 + told)).transpose(3, 4)).sum(2, keepdim=True)

    def _same_depth(self, state: Tensor, covariance: Tensor) -> tuple[Tensor, Tensor]:
        """Averages two hypotheses: the calibration's depth, or one of its own. -> state, its variance.

        The odds are prior odds times the Savage-Dickey ratio, posterior over prior density at no difference; the
        state under "the same depth" is the free one conditioned on it. What the average then lies away from the free
        state counts as error in full, not by the odds: slides of another depth may be few, or all there are.
        """
        column = covariance[..., DEPTH:]
        spread = column[..., DEPTH:, :].clamp(min=1e-8)
        off = state[..., DEPTH:, :]
        # The covariance knows nothing of the map's own error; the evidence must stand above that as well.
        doubtful = DOUBT * spread
        log_odds = math.log(self.same_depth / (1 - self.same_depth) * self.depth_sd_mm)
        same = torch.sigmoid(log_odds - 0.5 * (doubtful.log() + off * off / doubtful))
        gain = same * column / spread
        shift = gain * off
        variance = (covariance * self.each[:, :STATE]).sum(4, keepdim=True) - gain * column + shift * shift
        return state - shift, variance

    def _inverse_covariance(self, tilt: Tensor, ripple: Tensor, elapsed_s: Tensor, weight: Tensor) -> Tensor:
        """(B, A, 2, 16, 16) 1/V^2 of each channel's residuals; zero for a dead accelerometer.

        tilt: (B, A, 2, 1, 16) V. ripple: (B, A, 1, 1, 16) V, what each board's own V_z swings about its mean.
        """
        blocks = (elapsed_s / (self.block_s * BINS)).clamp(min=0.3)
        floor = (
            PEAK_SHARE**2 * (tilt * tilt).amax((1, 2, 3, 4), keepdim=True) + (FLOOR_SHARE * self.floor_v) ** 2
        )
        variance = self.noise / blocks + floor
        wander = self.drift / (variance + BINS * self.drift)
        swing = ripple.transpose(3, 4)
        picked = self.askew**2 / (variance + self.askew**2 * (ripple @ swing))
        return weight / variance * (self.whole - wander - picked * (swing @ ripple))

    def _rows(self, measured: Tensor, start: Tensor, state: Tensor, time: Tensor) -> Tensor:
        """Derivatives of the predicted signal by the six numbers of the state, and the residual: (B, A, 2, 7, 16) V.

        measured: (B, A, 2, 7, 16) V, the signal in its last row. start: (B, 1, 1, 2, 2), the proposal's directions
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
        mixed = heading @ (torch.cat([heading, depth], 3) * gain.exp()).transpose(3, 4)
        mixture = (mixed.reshape(-1, 1, 1, 1, 12) @ self.signals).reshape(-1, 1, 1, 8, 12)
        return self.products @ (factors * (mixture @ basis)) + measured

    def _basis(self, place: Tensor) -> Tensor:
        """M, Fx, Fy, D (fastest) as value, slope along x, slope along y at places (B, 1, 1, 2, 16) in cells of the
        table -> (B, A, 2, 12, 16) V, V/mm."""
        place = place.clamp(1.0, self.last_cell)
        cell = place.floor()
        cubes = ((place - cell)[..., None] + self.shifts) ** 3
        across, up = (cubes @ self.weights).split(1, 3)
        # What is no number is looked up somewhere, and remains none.
        corner = (self.stride @ cell).long().clamp(*self.corners).reshape(-1, BINS, 1)
        coefficients = F.embedding(corner + self.patch, self.table).double()
        basis = (across * up).reshape(-1, BINS, 3, 16) @ coefficients
        return (
            basis.reshape(-1, BINS, 3, self.boards, 2, 4)
            .permute(0, 3, 4, 2, 5, 1)
            .reshape(-1, self.boards, 2, 12, BINS)
        )


def inverted(normal: Tensor) -> Tensor:
    """The inverses of matrices (..., n, n). ONNX has no operator for it; ONNX Runtime brings one of its own."""
    if not torch.onnx.is_in_onnx_export():
        return torch.linalg.inv(normal)
    return torch.onnx.ops.symbolic(
        "com.microsoft::Inverse", (normal,), dtype=normal.dtype, shape=normal.shape, version=1
    )


def patch_table(parts: np.ndarray) -> tuple[np.ndarray, int]:
    """Spline coefficients (4, K, K, C) of M, Fx, Fy, D as rows of a table, (K + 2 EDGE)^2 x 4 C, and K + 2 EDGE.

    The edge is zero: off the map nothing answers, and whatever lies there may be read.
    """
    padded = np.pad(parts, ((0, 0), (EDGE, EDGE), (EDGE, EDGE), (0, 0))).transpose(1, 2, 3, 0)
    return padded.reshape(-1, padded.shape[2] * padded.shape[3]), len(padded)


def pooling() -> np.ndarray:
    """(64, 16): a window's bins -> means of fours."""
    return np.repeat(np.eye(BINS), WINDOW_BINS // BINS, axis=0) * BINS / WINDOW_BINS


def bin_means() -> np.ndarray:
    """(16, 16): a smooth signal's values at the centres of bins -> its means over them, f + f'' / 24 in bins."""
    second = np.zeros((BINS, BINS))
    for k in range(BINS):
        middle = min(max(k, 1), BINS - 2)
        second[k, middle - 1 : middle + 2] = 1.0, -2.0, 1.0
    return np.eye(BINS) + second / 24.0


def spline_weights() -> np.ndarray:
    """(2, 4, 48), for x and for y: (t + SHIFTS)^3 within a cell -> what each of a patch's 4 x 4 coefficients (the last
    axis, y fastest) weighs by this coordinate in the surface's value, its slope along x and along y (1/mm; 3 x 16)."""
    powers = np.array([[math.comb(3, n) * shift ** (3 - n) for shift in SHIFTS] for n in range(4)])
    value = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6
    slope = np.zeros((4, 4))
    slope[:3] = np.arange(1, 4)[:, None] * value[1:] / SPACING_MM
    across = np.repeat(np.stack([value, slope, value], axis=1), 4, axis=2)
    up = np.tile(np.stack([value, value, slope], axis=1), (1, 1, 4))
    return np.linalg.solve(powers, np.stack([across, up]).reshape(2, 4, 48))


def path_and_factors() -> tuple[np.ndarray, np.ndarray]:
    """(20, 3) and (20, 1): speed mm/s, offset and along mm -> what takes (1, seconds ago) to (10, 16).

    The contact's place forward and to the left, in cells of the table; then the factors of the signals that
    `signal_mixture` gives.
    """
    speed, offset, along = range(3)
    by_state, ones = np.zeros((10, 2, 3)), np.zeros((10, 2, 1))
    by_state[0, 0, along], by_state[0, 1, speed], by_state[1, 0, offset] = 1, -1, 1
    by_state[:2] /= SPACING_MM
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
