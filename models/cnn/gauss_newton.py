"""Gauss-Newton against the response map, as part of the network's graph.

A few steps move a proposal to where the map's prediction and the signal agree best, with the proposal as a weak prior,
and leave a covariance. Shapes are those of `models/cnn/forward_model.py`.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from softslide.features.window import WINDOW_BINS
from softslide.models.cnn.forward_model import BINS, PHASES, STATE, Prediction
from softslide.models.response_map.map import ResponseMap
from softslide.pipeline.ranges import POSITIVE, SHARE, SIZE, check_ranges

PEAK_SHARE = 0.003  # the map's residual, as a share of the slide's largest output
FLOOR_SHARE = 0.6  # and of its residual in calibration, which the bins share (experiments/LOG.md)
# Of maps without a rim, whose residuals grow with the response's slope and size: standard deviations of each bin's
# place and gain, which all channels share, and the share of the calibration residual that is alike everywhere. Chosen
# on assembled slides of a pass and of places that the map had not seen; half and twice these change errors by 3 %
# (experiments/LOG.md).
PLACE_MM, BIN_GAIN, LEVEL_SHARE = 0.2, 0.05, 0.5
# Of offset, along and gain: index in the state, deviation.
LOCAL = ((2, PLACE_MM), (3, PLACE_MM), (4, BIN_GAIN))
# Variance of the depth's error over the one that noise explains: 1 and 4 on two benches' held-out lines.
DEPTH_VARIANCE = 2.0
GAIN, DEPTH = 4, 5  # places in the state
# Longest last step, in standard deviations, of an estimate that has converged. Of a real skin's windows those within it
# move by 0.007 at most in the next step, and by 1.4e-6 of their size when the proposal is rounded otherwise; some of
# the others move by several deviations (experiments/LOG.md).
SETTLED_SD = 0.03
# What each unit of the squared step beyond that adds to the variances: soon more than any limit of what is believed.
UNSETTLED = 1e6
LONGEST_STEP = (0.3, 0.4, 5.0, 6.0, 0.1, 0.5)  # of each number of the state


@dataclass(frozen=True)
class RefinementConfig:
    """steps: of Gauss-Newton. The residual is not re-evaluated after the last step: the misfit is the reduced
        chi-square before it, which is large where the steps did not converge.
    trust: the proposal's standard deviations times this are the prior, but never less than least_prior (rad, log, mm,
        mm): so that a wrong proposal can be left.
    same_depth: prior probability that a slide has the calibration's contact depth; depth_sd_mm: standard deviation
        about it of those that do not. Where calibration slides have several depths, the map holds what is expected.
    askew: standard deviation of V_z's coupling into V_x and V_y after a change of the mounting's tilt.
    lean_v: standard deviation, in V, of what a slow tilt of the sensor adds to every V_x, and to every V_y, by a
        slide's end; 0 for a sensor that does not tilt. An accelerometer off the skin measures it separately.
    """

    steps: int = 3
    trust: float = 3.0
    least_prior: tuple[float, float, float, float] = (0.1, 0.1, 1.5, 2.0)
    same_depth: float = 0.9
    depth_sd_mm: float = 0.35
    askew: float = 0.02
    lean_v: float = 0.0

    def __post_init__(self) -> None:
        check_ranges(self, steps=(1, 100), trust=POSITIVE, least_prior=POSITIVE, same_depth=SHARE)
        check_ranges(self, depth_sd_mm=POSITIVE, askew=SIZE, lean_v=SIZE)


class Refinement(nn.Module):
    """Gauss-Newton on (turn, log speed, offset, along, gain, depth) against the response map.

    Residuals are weighted by the inverse of their covariance: noise that falls with the number of blocks in a bin, a
    floor for the map's own residual, the drift of each channel's zero, and V_z's coupling into V_x and V_y of a tilted
    board (the ripple of the pressure). The last two are rank-one parts of a channel's covariance. Where the map's
    residuals are correlated between channels (`ResponseMap.whitening`), these are mixed first, as long as no
    accelerometer is dead. Maps without a rim have no drift, since the static output is known just before a touch, but
    in each bin errors of place and gain, three rank-one parts of the covariance of the bin's channels.

    settled: whether variances become huge where the steps have not converged (maps without a rim); a bound takes them
    as they are.
    """

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
    frame: Tensor
    phases: Tensor
    lean: Tensor
    mixing: Tensor
    unmixed: Tensor

    def __init__(
        self, response: ResponseMap, block_s: float, config: RefinementConfig, settled: bool = True
    ) -> None:
        super().__init__()
        assert response.noise_v is not None
        assert response.drift_v is not None
        self.boards, self.axes = response.boards, response.axes
        self.predicted = Prediction(response)
        nuisance = (response.gain_sd, response.depth_sd_mm or config.depth_sd_mm)
        middle = (np.arange(BINS) + 0.5) / BINS
        buffers = {
            "noise": response.noise_v.reshape(self.boards, self.axes, 1, 1) ** 2,
            "drift": response.drift_v.reshape(self.boards, self.axes, 1, 1) ** 2,
            "pooled": np.float32(pooling() @ np.linalg.inv(bin_means()).T),
            "rippled": pooling() @ (np.eye(BINS) - 1.0 / BINS),
            "ago": np.stack([np.zeros(BINS), 1.0 - middle]),
            "lag": np.stack([np.ones(BINS), np.full(BINS, response.lag_s)]),
            "looseness": np.log([*4 * (config.trust,), *nuisance])[:, None],
            "tightest": np.log([*config.least_prior, *nuisance])[:, None],
            "longest_step": np.array(LONGEST_STEP)[:, None],
            "each": np.eye(STATE, STATE + 1),
            "whole": np.eye(BINS),
            # (cos, sin) -> cos, -sin; sin, cos.
            "frame": np.array([[1.0, 0, 0, 1], [0, -1, 1, 0]]),
            "phases": PHASES[:, :1],
            "lean": config.lean_v * middle[:, None],
        }
        self.mixes = response.whitening is not None
        if response.whitening is not None:
            unmixed = np.eye(response.channels)
            buffers |= {"unmixed": unmixed, "mixing": response.whitening - unmixed}
        # In doubles: partial strokes leave the normal matrix nearly singular.
        for name, value in buffers.items():
            self.register_buffer(name, torch.tensor(value, dtype=torch.float64))
        self.block_s, self.floor_v, self.cross_axis_sd = block_s, response.floor_v, config.askew
        self.depth_mm = response.depth_mm
        self.depth_sd_mm = config.depth_sd_mm
        self.same_depth = 0.0 if response.depth_sd_mm else config.same_depth
        self.knows_depth = bool(np.any(response.depth_slope))
        self.steps = config.steps
        # Of elements that measure gravity; the others' maps have no rim.
        self.leans = config.lean_v > 0 and response.rim
        # Held-out cells show what the map leaves in full (models/response_map/select.py).
        self.floor_share = FLOOR_SHARE if response.rim else LEVEL_SHARE
        self.rim = response.rim
        # Splines of a small spacing and a gain that is hardly known: some early windows converge slowly.
        self.settled = settled and not response.rim

    def forward(
        self, volts: Tensor, elapsed_s: Tensor, weight: Tensor, proposal: Tensor, log_sd: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """volts (B, A, 3, 64) V, elapsed_s (B,) s, weight (B, A), proposal (B, 5) and log_sd (B, 4) as `Proposal` gives
        them -> columns (B, 1, 1, ., 1): heading (cos, sin), state (the turn from the proposal, log speed, offset mm,
        along mm, log gain, depth mm off the map's), its variance, misfit (where the map has a rim, of a slide of any
        gain), strain: the gain over the standard deviation that slides of the calibration's kind give it."""
        volts, elapsed_s, weight, proposal, log_sd = (
            given.double() for given in (volts, elapsed_s, weight, proposal, log_sd)
        )
        elapsed_s, weight = elapsed_s.reshape(-1, 1, 1, 1, 1), weight.reshape(-1, self.boards, 1, 1, 1)
        # What follows compares values at the bins' centres; a bin holds a mean, which is flatter than the signal.
        touch = (volts[:, :, : self.axes] @ self.pooled)[:, :, :, None]
        # A V_z that answers to a touch itself is coupled into no other axis.
        ripple = (volts[:, :, 2:] @ self.rippled)[:, :, None] if self.axes == 2 else None
        inverse = self._inverse_covariance(touch, ripple, elapsed_s, weight)
        measured = F.pad(touch, (0, 0, STATE, 0))
        time = elapsed_s * self.ago + self.lag
        pair, own = proposal.split((2, 3), 1)
        norm = (pair * pair).sum(1, keepdim=True).clamp(min=1e-12).sqrt()
        start = (pair / norm @ self.frame).reshape(-1, 1, 1, 2, 2)
        centre = F.pad(own, (1, 2)).reshape(-1, 1, 1, STATE, 1)
        log_sd = F.pad(log_sd, (0, 2)).reshape(-1, 1, 1, STATE, 1) + self.looseness
        precision = (-2.0 * torch.maximum(log_sd, self.tightest)).exp()
        mixing = self._mixing(weight) if self.mixes else None
        state, gram, covariance, normal, move = (centre,) * 5
        for _ in range(self.steps):
            rows = self.predicted(measured, start, state, time)
            if mixing is not None:
                rows = (mixing @ rows.reshape(-1, self.boards * self.axes, (STATE + 1) * BINS)).reshape(
                    -1, self.boards, self.axes, STATE + 1, BINS
                )
            if self.rim:
                gram = ((rows @ inverse) @ rows.transpose(3, 4)).sum((1, 2), keepdim=True)
            else:
                gram = self._without_local_errors(rows, inverse)
            if self.leans:
                gram = gram - self._leaning(rows, inverse)
            # The prior's part: it holds the state to the proposal.
            normal = gram[..., :STATE, :] + precision * (self.each - F.pad(state - centre, (STATE, 0)))
            covariance = inverted(normal[..., :STATE])
            move = covariance @ normal[..., STATE:]
            state = state + torch.maximum(torch.minimum(move, self.longest_step), -self.longest_step)
        variance = (covariance * self.each[:, :STATE]).sum(4, keepdim=True)
        # Of slides of the calibration's kind the estimated gain's variance is what the data took from the prior's.
        gain, left, prior = (of[..., GAIN : GAIN + 1, :] for of in (state, variance, 1.0 / precision))
        strain = gain.abs() / (prior - left).clamp(min=1e-12).sqrt()
        chi_square = gram[..., STATE:, STATE:]
        if self.rim:
            # It falls by so much, to second order, where the gain may be any.
            chi_square = (chi_square - strain * strain * left / prior).clamp(min=0.0)
        misfit = chi_square / (self.axes * BINS * weight.sum(1, keepdim=True)).clamp(min=1.0)
        if self.settled:
            # How far the last step went in standard deviations, squared (Newton's decrement).
            length = (move * normal[..., STATE:]).sum(3, keepdim=True)
            variance = variance + UNSETTLED * (length - SETTLED_SD**2).clamp(min=0)
        if self.same_depth:
            state, variance = self._same_depth(state, covariance, variance)
        heading = start @ (state[..., :1, :] + self.phases).sin()
        return heading, state, variance, misfit, strain

    def _mixing(self, weight: Tensor) -> Tensor:
        """(B, C, C): what channels are mixed by; with a dead accelerometer by nothing."""
        return self.unmixed + weight.amin((1, 2, 3, 4)).reshape(-1, 1, 1) * self.mixing

    def _leaning(self, rows: Tensor, inverse: Tensor) -> Tensor:
        """What the device's own slow turn takes from the rows' products: it leans all boards alike, a number for each
        axis, whose worth is not asked for."""
        along = inverse @ self.lean
        known = (self.lean * along).sum((1, 3), keepdim=True)
        leaning = (rows @ along).sum(1, keepdim=True)
        return (leaning @ (leaning / (1.0 + known)).transpose(3, 4)).sum(2, keepdim=True)

    def _without_local_errors(self, rows: Tensor, inverse: Tensor) -> Tensor:
        """The rows' products (B, 1, 1, 7, 7) where each bin's place and gain are off by errors of their own.

        inverse: (B, A, X, 1, 1). Each error adds the square of a row to the covariance of a bin's channels, and takes
        from its inverse what Sherman and Morrison's formula says.
        """
        channels = (rows * inverse.sqrt()).reshape(-1, self.boards * self.axes, STATE + 1, BINS)
        bins = channels.permute(0, 3, 2, 1)
        gram = bins @ bins.transpose(2, 3)
        for k, sd in LOCAL:
            column = gram[..., k : k + 1]
            gram = gram - column @ column.transpose(2, 3) / (sd**-2 + column[:, :, k : k + 1])
        return gram.sum(1)[:, None, None]

    def _same_depth(self, state: Tensor, covariance: Tensor, variance: Tensor) -> tuple[Tensor, Tensor]:
        """Averages two hypotheses: the calibration's depth, or one of its own. -> state, its variance.

        The odds are prior odds times the Savage-Dickey ratio, posterior over prior density at no difference; the
        state under "the same depth" is the free one conditioned on it. What the average then lies away from the free
        state counts as error in full, not by the odds: slides of another depth may be few, or all there are.
        """
        column = covariance[..., DEPTH:]
        spread = column[..., DEPTH:, :].clamp(min=1e-8)
        off = state[..., DEPTH:, :]
        # The covariance knows nothing of the map's own error; the evidence must stand above that as well.
        widened = DEPTH_VARIANCE * spread
        log_odds = math.log(self.same_depth / (1 - self.same_depth) * self.depth_sd_mm)
        same = torch.sigmoid(log_odds - 0.5 * (widened.log() + off * off / widened))
        gain = same * column / spread
        shift = gain * off
        return state - shift, variance - gain * column + shift * shift

    def _inverse_covariance(
        self, touch: Tensor, ripple: Tensor | None, elapsed_s: Tensor, weight: Tensor
    ) -> Tensor:
        """(B, A, X, 16, 16) 1/V^2 of each channel's residuals; zero for a dead accelerometer. Without a rim all bins
        are alike, (B, A, X, 1, 1).

        touch: (B, A, X, 1, 16) V. ripple: (B, A, 1, 1, 16) V, what each board's own V_z swings about its mean; None
        where V_z is among the X.
        """
        blocks = (elapsed_s / (self.block_s * BINS)).clamp(min=0.3)
        floor = (
            PEAK_SHARE**2 * (touch * touch).amax((1, 2, 3, 4), keepdim=True)
            + (self.floor_share * self.floor_v) ** 2
        )
        variance = self.noise / blocks + floor
        if not self.rim:
            return weight / variance
        drifting = self.drift / (variance + BINS * self.drift)
        if ripple is None:
            return weight / variance * (self.whole - drifting)
        swing = ripple.transpose(3, 4)
        picked = self.cross_axis_sd**2 / (variance + self.cross_axis_sd**2 * (ripple @ swing))
        return weight / variance * (self.whole - drifting - picked * (swing @ ripple))


def inverted(normal: Tensor) -> Tensor:
    """The inverses of symmetric positive definite matrices (..., n, n), in operators that every runtime has.

    Sweeping a symmetric matrix on all its pivots gives minus its inverse (J. H. Goodnight, 1979). The diagonal is
    scaled to 1 before. Each sweep here takes 2 too much from its diagonal element, which no other sweep reads.
    """
    size = normal.shape[-1]
    unit = torch.tensor(np.eye(size), dtype=normal.dtype)
    diagonal = normal * unit
    scale = (diagonal.sum(-1, keepdim=True) * diagonal.sum(-2, keepdim=True)).rsqrt()
    swept = normal * scale
    for k in range(size):
        column, row = swept[..., :, k : k + 1], swept[..., k : k + 1, :]
        pivot = column[..., k : k + 1, :]
        swept = swept - (column + unit[:, k : k + 1]) / pivot * (row + unit[k : k + 1])
    return -(swept + 2.0 * unit) * scale


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
