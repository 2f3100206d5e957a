"""Levenberg-Marquardt against the response map, as part of the network's graph.

The map predicts what the accelerometers would have shown for a line, a speed, a place on it, a gain and a depth; a few
steps move a proposal to where prediction and signal agree best, with the proposal as a weak prior, and leave a
covariance. Written in few, large operators: at this size they cost more than the arithmetic.
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
DOUBT = 9.0  # variance of the depth's error over the one that noise explains, on held-out lines
BINS = 32  # of time in the refinement: a window's bins in pairs, which loses nothing and halves the work
STATE = 6  # numbers in the state
DEPTH = 5  # place of the depth among them
EDGE = 3  # zero coefficients around the map's
FIRST_DAMPING = 1e-3


@dataclass(frozen=True)
class RefinementConfig:
    """steps: of Levenberg-Marquardt. checked: whether the last one, too, is taken back where it does not help, which
    costs an evaluation more. Without it the misfit is the one before that step, and tells what had not converged.
    trust: the proposal's standard deviations times this are the prior, but never less
    than least_prior (rad, mm, log, mm): a proposal that is wrong must not hold it back.

    same_depth: prior probability that a slide has the calibration's contact depth; depth_sd_mm: standard deviation
        about it of those that do not.
    askew: standard deviation of what V_x and V_y pick up of V_z, where the device stands otherwise than it did.
    lean_v: standard deviation of what the device's own slow turn adds to every V_x, and to every V_y, by a slide's
        end, V; 0 for a device that stands still. An accelerometer off the skin tells it from the skin's answer.
    """

    steps: int = 3
    checked: bool = False
    trust: float = 3.0
    least_prior: tuple[float, float, float, float] = (0.1, 1.5, 0.1, 2.0)
    same_depth: float = 0.9
    depth_sd_mm: float = 0.35
    askew: float = 0.01
    lean_v: float = 0.0

    def __post_init__(self) -> None:
        if self.steps + self.checked < 1:
            raise ValueError(f"steps is {self.steps}; take at least one")


class Refinement(nn.Module):
    """Levenberg-Marquardt on (direction, offset, log speed, along, gain, depth) against the response map.

    Residuals are weighed by the inverse of their covariance: noise that falls with the number of blocks a bin holds,
    a floor for what the map leaves over, the slow wander of each channel's zero, and what a board that stands askew
    picks up of its own V_z (the ripple of the pressure; each a rank-one part of a channel's covariance).
    """

    table: Tensor
    first: Tensor
    noise: Tensor
    drift: Tensor
    ago: Tensor
    nuisance_precision: Tensor
    order: Tensor
    sd_order: Tensor
    each: Tensor
    whole: Tensor
    least_prior: Tensor
    longest_step: Tensor
    powers: Tensor
    weights: Tensor
    stride: Tensor
    patch: Tensor
    signals: Tensor
    quarter: Tensor
    lean: Tensor
    centres: Tensor

    def __init__(self, response: ResponseMap, block_s: float, config: RefinementConfig) -> None:
        super().__init__()
        assert response.noise_v is not None
        assert response.drift_v is not None
        parts = np.concatenate([response.coefficients, response.depth_slope[None]])
        table, cells = patch_table(parts)
        corner = np.array(response.reference_mm) + response.half_mm
        nuisance = np.array([0, 0, 0, 0, response.gain_sd**-2, config.depth_sd_mm**-2])
        buffers = {
            "first": (corner / SPACING_MM + 1 + EDGE)[:, None],
            "noise": response.noise_v,
            "drift": response.drift_v,
            "ago": 1 - (np.arange(BINS) + 0.5) / BINS,
            "nuisance_precision": nuisance[:, None],
            "least_prior": np.array(config.least_prior)[:, None],
            "longest_step": np.array([0.3, 5.0, 0.4, 6.0, 0.1, 0.5])[:, None],
            "each": np.eye(STATE, STATE + 1),
            "whole": np.eye(2),
            "powers": np.arange(4.0),
            "weights": spline_weights(),
            "stride": np.array([[cells, 1.0]]),
            "signals": signal_mixture(),
            "quarter": np.array([[0.0, -1.0], [1.0, 0.0]]),
            "lean": config.lean_v * (np.arange(BINS)[:, None] + 0.5) / BINS,
            "centres": np.linalg.inv(bin_means()).T,
        }
        # In doubles: partial strokes leave the normal matrix nearly singular, and whether a step is taken back
        # must not hang on a rounding error that another runtime makes differently.
        for name, value in buffers.items():
            self.register_buffer(name, torch.tensor(value, dtype=torch.float64))
        # Direction cos, sin, offset, log speed, along; and deviations of turn, offset, log speed, along.
        self.register_buffer("order", torch.tensor([0, 1, 3, 2, 4]))
        self.register_buffer("sd_order", torch.tensor([0, 2, 1, 3]))
        self.register_buffer("table", rounded(torch.tensor(table, dtype=torch.float32)))
        self.register_buffer("patch", torch.tensor([cells * i + j for i in range(4) for j in range(4)]))
        self.channels, self.last_cell = response.channels, cells - 3.001
        self.block_s, self.lag_s, self.floor_v = block_s, response.lag_s, response.floor_v
        self.depth_mm = response.depth_mm
        self.depth_sd_mm, self.same_depth = config.depth_sd_mm, config.same_depth
        self.knows_depth = bool(np.any(response.depth_slope))
        self.steps, self.checked = config.steps, config.checked
        self.trust, self.askew = config.trust, config.askew
        self.leans = config.lean_v > 0

    def forward(
        self, volts: Tensor, elapsed_s: Tensor, weight: Tensor, proposal: Tensor, log_sd: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """volts (B, 3 A, 64) V, elapsed_s (B,) s, weight (B, A), proposal (B, 5) and log_sd (B, 4) as `Proposal` gives
        them -> heading (B, 2: cos, sin), state (B, 6: -, offset mm, log speed, along mm, log gain, depth mm off the
        map's), its covariance (B, 6, 6), misfit (B,)."""
        volts, elapsed_s, weight, proposal, log_sd = (
            given.double() for given in (volts, elapsed_s, weight, proposal, log_sd)
        )
        bins = volts.reshape(-1, self.channels // 2, 3, BINS, WINDOW_BINS // BINS).mean(4)
        tilt = bins[:, :, :2].reshape(-1, self.channels, BINS)
        # What follows compares values at the bins' centres; a bin holds a mean, which is flatter than the signal.
        inverse = self._inverse_covariance(tilt, bins[:, :, 2:], elapsed_s, weight)
        tilt = tilt @ self.centres
        if self.leans:
            # The device's own slow turn leans all boards alike: a number for each axis, whose worth is not asked for.
            along_lean = inverse @ self.lean
            told = (self.lean * along_lean).sum((2, 3)).reshape(-1, self.channels // 2, 2).sum(1)
            lean_share = (1.0 / (1.0 + told))[:, :, None]
        cos, sin, own = proposal.index_select(1, self.order)[:, :, None].split((1, 1, 3), 1)
        norm = (cos * cos + sin * sin).clamp(min=1e-12).sqrt()
        start = self._rotation(cos, sin) / norm
        ago_s = elapsed_s[:, None, None] * self.ago + self.lag_s
        # State, relative to the proposal: turn rad, offset mm, log speed, along mm, log gain, depth mm.
        centre = F.pad(own, (0, 0, 1, 2))
        sd = torch.maximum(
            log_sd.index_select(1, self.sd_order).exp()[:, :, None] * self.trust, self.least_prior
        )
        precision = F.pad(sd**-2, (0, 0, 0, 2)) + self.nuisance_precision
        trial, damping = 0.0 * centre, torch.tensor(FIRST_DAMPING, dtype=torch.float64)
        best, held = trial, trial
        for step in range(self.steps + self.checked):
            rows = self._rows(tilt, start, centre + trial, ago_s)
            off = self.each - F.pad(trial, (STATE, 0))
            gram = ((rows @ inverse) @ rows.transpose(2, 3)).sum(1) + off.transpose(1, 2) @ (precision * off)
            if self.leans:
                leaning = (rows @ along_lean).reshape(-1, self.channels // 2, 2, STATE + 1).sum(1)
                gram = gram - leaning.transpose(1, 2) @ (lean_share * leaning)
            if step == 0:
                held = gram
            else:
                # Levenberg-Marquardt: what did not help is taken back, and tried again with a shorter step.
                better = gram[:, STATE:, STATE:] < held[:, STATE:, STATE:]
                held = torch.where(better, gram, held)
                best = torch.where(better, trial, best)
                damping = torch.where(better, 0.1 * damping, 30.0 * damping)
            if step < self.steps:
                move = solve(held, damping)
                trial = best + torch.maximum(torch.minimum(move, self.longest_step), -self.longest_step)
        covariance = inverted(held[:, :STATE, :STATE])
        chi2 = held[:, STATE, STATE] - (precision * best * best).sum((1, 2))
        misfit = chi2 / (2 * weight.sum(1) * BINS).clamp(min=1.0)
        best = best if self.checked else trial
        best, covariance = self._same_depth(best[:, :, 0], covariance)
        turn = best[:, :1, None]
        heading = (start @ self._rotation(turn.cos(), turn.sin()))[:, :, 0]
        return heading.float(), (centre[:, :, 0] + best).float(), covariance.float(), misfit.float()

    def _same_depth(self, state: Tensor, covariance: Tensor) -> tuple[Tensor, Tensor]:
        """Averages two hypotheses: the calibration's depth, or one of its own. -> state (B, 6), covariance.

        The odds are prior odds times the Savage-Dickey ratio, posterior over prior density at no difference; the
        state under "the same depth" is the free one conditioned on it. What the average then lies away from the free
        state counts as error in full, not by the odds: slides of another depth may be few, or all there are.
        """
        variance = covariance[:, DEPTH, DEPTH].clamp(min=1e-8)
        off = state[:, DEPTH]
        # The covariance knows nothing of the map's own error; the evidence must stand above that as well.
        doubtful = DOUBT * variance
        log_odds = (
            math.log(self.same_depth / (1 - self.same_depth))
            + math.log(self.depth_sd_mm)
            - 0.5 * doubtful.log()
            - 0.5 * off * off / doubtful
        )
        same = torch.sigmoid(log_odds)[:, None]
        gain = covariance[:, :, DEPTH] / variance[:, None]
        shift = same * gain * off[:, None]
        reduction = gain[:, :, None] * covariance[:, None, DEPTH]
        between = shift[:, :, None] * shift[:, None]
        return state - shift, covariance - same[:, :, None] * reduction + between

    def _inverse_covariance(
        self, tilt: Tensor, vertical: Tensor, elapsed_s: Tensor, weight: Tensor
    ) -> Tensor:
        """(B, C, 32, 32) 1/V^2 of each channel's residuals; zero for a dead accelerometer.

        vertical: (B, A, 1, 32) V, each board's own V_z.
        """
        blocks = (elapsed_s / (self.block_s * BINS)).clamp(min=0.3)
        peak = tilt.abs().amax((1, 2))
        floor = (0.4 * self.floor_v) ** 2 + (PEAK_SHARE * peak) ** 2
        variance = self.noise**2 / blocks[:, None] + floor[:, None]
        wander = self.drift**2 / (variance + BINS * self.drift**2)
        ripple = vertical - vertical.mean(3, keepdim=True)
        size = for_each_axis((ripple * ripple).sum((2, 3)))
        picked = self.askew**2 / (variance + self.askew**2 * size)
        outer = for_each_axis(ripple.transpose(2, 3) @ ripple)
        whole = torch.eye(BINS, dtype=torch.float64)
        shape = whole - wander[:, :, None, None] - picked[:, :, None, None] * outer
        trusted = for_each_axis(weight) / variance
        return trusted[:, :, None, None] * shape

    def _rotation(self, cos: Tensor, sin: Tensor) -> Tensor:
        """(B, 1, 1) each -> (B, 2, 2)."""
        return cos * self.whole + sin * self.quarter

    def _rows(self, tilt: Tensor, start: Tensor, state: Tensor, ago_s: Tensor) -> Tensor:
        """Derivatives of the predicted signal by the six numbers of the state, and the residual: (B, C, 7, 32) V.

        start: (B, 2, 2), the proposal's directions forward and left as columns. ago_s: (B, 1, 32) s, how long before
        the window's end the contact was where a bin's signal answers to.
        """
        turn, offset, log_speed, along, gain, depth = state.split(1, 1)
        frame = start @ self._rotation(turn.cos(), turn.sin())
        forward, left = frame.split(1, 2)
        behind = log_speed.clamp(-5.0, 7.0).exp() * ago_s
        s = along - behind
        place = (forward * s + left * offset) / SPACING_MM + self.first
        basis = self._basis(place)
        # Of M, Fx, Fy, D and their slopes: the signal, its change with depth and by friction, its slopes on and left.
        heading = F.pad(forward, (0, 0, 1, 0), value=1.0)
        mixed = heading @ (torch.cat([heading, depth], 1) * gain.exp()).transpose(1, 2)
        mixture = (mixed.reshape(-1, 1, 12) @ self.signals).reshape(-1, 1, 5, 12)
        value, deep, friction, ahead, aside = (mixture @ basis).split(1, 2)
        s, behind, offset = s[:, :, None], behind[:, :, None], offset[:, :, None]
        rows = [s * aside - offset * ahead + friction, aside, -behind * ahead, ahead, value, deep]
        return torch.cat([*rows, tilt[:, :, None] - value], 2)

    def _basis(self, place: Tensor) -> Tensor:
        """M, Fx, Fy, D (fastest) as value, slope along x, slope along y at places (B, 2, 32) in cells of the table ->
        (B, C, 12, 32) V, V/mm."""
        place = place.clamp(1.0, self.last_cell)
        cell = place.floor()
        across, up = (((place - cell)[..., None] ** self.powers) @ self.weights).split(1, 1)
        weights = across.reshape(-1, BINS, 3, 4, 1) * up.reshape(-1, BINS, 3, 1, 4)
        corner = (self.stride @ (cell - 1.0)).long().reshape(-1, BINS, 1)
        coefficients = F.embedding(corner + self.patch, self.table).double()
        basis = weights.reshape(-1, BINS, 3, 16) @ coefficients
        return (
            basis.reshape(-1, BINS, 3, self.channels, 4)
            .permute(0, 3, 2, 4, 1)
            .reshape(-1, self.channels, 12, BINS)
        )


def patch_table(parts: np.ndarray) -> tuple[np.ndarray, int]:
    """Spline coefficients (4, K, K, C) of M, Fx, Fy, D as rows of a table, (K + 2 EDGE)^2 x 4 C, and K + 2 EDGE.

    The edge is zero: off the map nothing answers, and whatever lies there may be read.
    """
    padded = np.pad(parts, ((0, 0), (EDGE, EDGE), (EDGE, EDGE), (0, 0))).transpose(1, 2, 3, 0)
    return padded.reshape(-1, padded.shape[2] * padded.shape[3]), len(padded)


def bin_means() -> np.ndarray:
    """(32, 32): a smooth signal's values at the centres of bins -> its means over them, f + f'' / 24 in bins."""
    second = np.zeros((BINS, BINS))
    for k in range(BINS):
        middle = min(max(k, 1), BINS - 2)
        second[k, middle - 1 : middle + 2] = 1.0, -2.0, 1.0
    return np.eye(BINS) + second / 24.0


def spline_weights() -> np.ndarray:
    """(2, 4, 12), for x and for y: 1, t, t^2, t^3 within a cell -> weights of its four cubic B-splines.

    Four each for the surface's value, its slope along x and its slope along y (1/mm).
    """
    value = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6
    slope = np.zeros((4, 4))
    slope[:3] = np.arange(1, 4)[:, None] * value[1:] / SPACING_MM
    return np.stack([np.hstack([value, slope, value]), np.hstack([value, value, slope])])


def signal_mixture() -> np.ndarray:
    """(12, 60): what (1, cos, sin) x (1, cos, sin, depth) times the gain make of the basis.

    Rows of the mixture (5, 12): the signal M + cos Fx + sin Fy + depth D; D; the friction's change with the heading,
    cos Fy - sin Fx; the signal's slope forward; its slope to the left.
    """
    one, cos, sin = range(3)
    _, fx, fy, d = range(4)
    mixture = np.zeros((3, 4, 5, 3, 4))
    for part in range(4):
        # Each part of the basis has its factor at its own place in (1, cos, sin, depth).
        mixture[one, part, 0, 0, part] = 1
        mixture[cos, part, 3, 1, part] = mixture[sin, part, 3, 2, part] = 1
        mixture[sin, part, 4, 1, part], mixture[cos, part, 4, 2, part] = -1, 1
    mixture[one, 0, 1, 0, d] = 1
    mixture[one, cos, 2, 0, fy], mixture[one, sin, 2, 0, fx] = 1, -1
    return mixture.reshape(12, 60)


def for_each_axis(of_board: Tensor) -> Tensor:
    """(B, A, ...) -> (B, C, ...), each accelerometer's value for its two tilt channels."""
    return of_board.unsqueeze(2).expand(-1, -1, 2, *of_board.shape[2:]).flatten(1, 2)


def solve(gram: Tensor, damping: Tensor) -> Tensor:
    """x (B, n, 1) of (A + d diag A) x = b, for gram (B, n + 1, n + 1) = [[A, b], [b', c]] and damping d (B, 1, 1)."""
    n = gram.shape[-1] - 1
    work = gram[:, :n]
    return _eliminated(work * (1.0 + damping * torch.eye(n, n + 1, dtype=gram.dtype)), n)


def inverted(normal: Tensor) -> Tensor:
    """The inverse of symmetric positive definite matrices (B, n, n)."""
    n = normal.shape[-1]
    eye = torch.diag_embed(torch.ones_like(normal[:, 0]))
    return _eliminated(torch.cat([normal, eye], 2), n)


def _eliminated(work: Tensor, n: int) -> Tensor:
    """[A | B] (B, n, n + m) -> A^-1 B (B, n, m) by Gauss-Jordan: ONNX has no solver; A is positive definite, so that no
    pivot need be sought."""
    eye = torch.eye(n, dtype=work.dtype)
    for k in range(n):
        row = work[:, k : k + 1]
        work = work - (work[:, :, k : k + 1] - eye[:, k : k + 1]) @ (row / row[:, :, k : k + 1])
    return work[:, :, n:]
