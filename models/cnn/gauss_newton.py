"""Gauss-Newton against the response map, as part of the network's graph.

A few steps move a proposal to where the map's prediction and the signal agree best, with the proposal as a weak prior,
and leave a covariance. Shapes are those of `models/cnn/forward_model.py`.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from softslide.features.window import WINDOW_BINS
from softslide.models.cnn.forward_model import BINS, PHASES, STATE, Prediction, WithConstants
from softslide.models.response_map.map import ResponseMap
from softslide.pipeline.ranges import POSITIVE, SHARE, SIZE, check_ranges

# The largest residual of a map that is off in place, as a share of how the output changes from bin to bin: a proposal
# that is far too slow makes a bin seem shorter than the map is off.
MOST_OFF = 0.2
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
# How a way may differ from a straight one at constant speed and depth: its curvature in 1/mm, the relative change of
# its speed in 1/s, the slope of its depth; standard deviations, and the probability that none of them does. The
# information of a window is taken for BEND_INFORMATION times what its residuals' covariance says: that is wide, since
# it allows for errors of the map that all windows share. Chosen on synthetic lines and paths (experiments/LOG.md).
BEND_SD = (0.02, 0.3, 0.05)
STRAIGHT = 0.3
BEND_INFORMATION = 20.0


@dataclass(frozen=True)
class RefinementConfig:
    """steps: of Gauss-Newton. The residual is not re-evaluated after the last step: the misfit is the reduced
        chi-square before it, which is large where the steps did not converge.
    trust: the proposal's standard deviations times this are the prior, but never less than least_prior (rad, log, mm,
        mm): so that a wrong proposal can be left.
    same_depth: prior probability that a slide has the calibration's contact depth; depth_sd_mm: standard deviation
        about it of those that do not. Where calibration slides have several depths, the map holds what is expected.
    cross_axis_sd: standard deviation of V_z's coupling into V_x and V_y after a change of the mounting's tilt.
    """

    steps: int = 3
    trust: float = 3.0
    least_prior: tuple[float, float, float, float] = (0.1, 0.1, 1.5, 2.0)
    same_depth: float = 0.9
    depth_sd_mm: float = 0.35
    cross_axis_sd: float = 0.02

    def __post_init__(self) -> None:
        check_ranges(self, steps=(1, 100), trust=POSITIVE, least_prior=POSITIVE, same_depth=SHARE)
        check_ranges(self, depth_sd_mm=POSITIVE, cross_axis_sd=SIZE)


class Refinement(WithConstants):
    """Gauss-Newton on (turn, log speed, offset, along, gain, depth) against the response map.

    Residuals are weighted by the inverse of their covariance: noise that falls with the number of blocks in a bin, the
    three parts of the map's own residual (`ResponseMap.level_v`, `output_share`, `place_mm`), the error of each
    channel's zero at the window's start, its straight drift since, and V_z's coupling into V_x and V_y of a tilted
    board (the ripple of the pressure). The last three are rank-one parts of a channel's covariance. Where the map's
    residuals are correlated between channels (`ResponseMap.whitening`), these are mixed first, as long as no
    accelerometer is dead. Maps without a rim have no error of the zero and no drift, since the static output is known
    just before a touch, but in each bin errors of place and gain, three rank-one parts of the covariance of the bin's
    channels.

    settled: whether variances become huge where the steps have not converged (maps without a rim); a bound takes them
    as they are.
    """

    def __init__(
        self, response: ResponseMap, block_s: float, config: RefinementConfig, settled: bool = True
    ) -> None:
        super().__init__()
        self.boards, self.axes = response.boards, response.axes
        self.predicted = Prediction(response)
        nuisance = (response.gain_sd, response.depth_sd_mm or config.depth_sd_mm)
        middle = (np.arange(BINS) + 0.5) / BINS
        constants = {
            "noise": response.noise_v.reshape(self.boards, self.axes, 1, 1) ** 2,
            "zero": response.zero_v.reshape(self.boards, self.axes, 1, 1) ** 2,
            "drift": response.drift_v_s.reshape(self.boards, self.axes, 1, 1) ** 2,
            "even": np.ones((1, BINS)),
            "middle": middle[None],
            "pooled": np.float32(pooling() @ np.linalg.inv(bin_means()).T),
            "rippled": pooling() @ (np.eye(BINS) - 1.0 / BINS),
            "ago": np.stack([np.zeros(BINS), 1.0 - middle]),
            "lag": np.stack([np.ones(BINS), np.full(BINS, response.lag_s)]),
            "looseness": np.log([*4 * (config.trust,), *nuisance])[:, None],
            "tightest": np.log([*config.least_prior, *nuisance])[:, None],
            "longest_step": np.array(LONGEST_STEP)[:, None],
            "each": np.eye(STATE, STATE + 1),
            "whole": np.eye(BINS),
            "change": np.asarray(np.gradient(np.eye(BINS), axis=0)).T,
            # (cos, sin) -> cos, -sin; sin, cos.
            "frame": np.array([[1.0, 0, 0, 1], [0, -1, 1, 0]]),
            "phases": PHASES[:, :1],
            "bend_precision": np.diag(np.square(BEND_SD) ** -1.0),
            "cycle": np.roll(np.eye(3), 1, axis=1),
            "uncycle": np.roll(np.eye(3), -1, axis=1),
        }
        self.mixes = response.whitening is not None
        if response.whitening is not None:
            unmixed = np.eye(response.channels)
            constants |= {"unmixed": unmixed, "mixing": response.whitening - unmixed}
        # In doubles: partial strokes leave the normal matrix nearly singular.
        self.hold(constants, torch.float64)
        self.block_s, self.cross_axis_sd = block_s, config.cross_axis_sd
        self.depth_mm = response.depth_mm
        self.depth_sd_mm = config.depth_sd_mm
        self.same_depth = 0.0 if response.depth_sd_mm else config.same_depth
        self.knows_depth = bool(np.any(response.depth_slope))
        self.steps = config.steps
        # Held-out cells show what the map leaves in full (models/response_map/select.py).
        self.level_v = response.level_v if response.rim else LEVEL_SHARE * response.floor_v
        self.output_share, self.place_mm = response.output_share, response.place_mm
        self.rim = response.rim
        # Splines of a small spacing and a gain that is hardly known: some early windows converge slowly.
        self.settled = settled and not response.rim

    def forward(
        self, volts: Tensor, elapsed_s: Tensor, weight: Tensor, proposal: Tensor, log_sd: Tensor
    ) -> tuple[Tensor, ...]:
        """volts (B, A, 3, 64) V, elapsed_s (B,) s, weight (B, A), proposal (B, 5) and log_sd (B, 4) as `Proposal` gives
        them -> columns (B, 1, 1, ., 1): heading (cos, sin), state (the turn from the proposal, log speed, offset mm,
        along mm, log gain, depth mm off the map's), its variance, misfit (where the map has a rim, of a slide of any
        gain), strain: the gain over the standard deviation that slides of the calibration's kind give it; of maps with
        a rim, `_bends`."""
        volts, elapsed_s, weight, proposal, log_sd = (
            given.double() for given in (volts, elapsed_s, weight, proposal, log_sd)
        )
        elapsed_s, weight = elapsed_s.reshape(-1, 1, 1, 1, 1), weight.reshape(-1, self.boards, 1, 1, 1)
        # What follows compares values at the bins' centres; a bin holds a mean, which is flatter than the signal.
        touch = (volts[:, :, : self.axes] @ self.pooled)[:, :, :, None]
        # A V_z that answers to a touch itself is coupled into no other axis.
        ripple = (volts[:, :, 2:] @ self.rippled)[:, :, None] if self.axes == 2 else None
        bin_mm = proposal[:, 2:3].reshape(-1, 1, 1, 1, 1).exp() * elapsed_s / BINS
        inverse = self._inverse_covariance(touch, ripple, elapsed_s, weight, bin_mm)
        measured = F.pad(touch, (0, 0, STATE, 0))
        time = elapsed_s * self.ago + self.lag
        pair, own = proposal.split((2, 3), 1)
        norm = (pair * pair).sum(1, keepdim=True).clamp(min=1e-12).sqrt()
        start = (pair / norm @ self.frame).reshape(-1, 1, 1, 2, 2)
        centre = F.pad(own, (1, 2)).reshape(-1, 1, 1, STATE, 1)
        log_sd = F.pad(log_sd, (0, 2)).reshape(-1, 1, 1, STATE, 1) + self.looseness
        precision = (-2.0 * torch.maximum(log_sd, self.tightest)).exp()
        mixing = self._mixing(weight) if self.mixes else None
        state, before, rows, gram, covariance, normal, move = (centre,) * 7
        for _ in range(self.steps):
            before = state
            rows = self.predicted(measured, start, state, time)
            if mixing is not None:
                rows = (mixing @ rows.reshape(-1, self.boards * self.axes, (STATE + 1) * BINS)).reshape(
                    -1, self.boards, self.axes, STATE + 1, BINS
                )
            gram = (
                self._products(rows @ inverse, rows)
                if self.rim
                else self._without_local_errors(rows, inverse)
            )
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
        bends = (self._bends(rows, inverse, before, time, gram, normal, precision),) if self.rim else ()
        if self.same_depth:
            state, variance = self._same_depth(state, covariance, variance)
        heading = start @ (state[..., :1, :] + self.phases).sin()
        return heading, state, variance, misfit, strain, *bends

    def _products(self, left: Tensor, right: Tensor) -> Tensor:
        """(B, A, X, N, 16), (B, A, X, M, 16) -> (B, 1, 1, N, M): products of rows, over all channels and bins.

        The right one is reshaped between its transposition and the product: some runtimes make one operation of these
        two, and have none for it in double precision.
        """
        size = self.boards * self.axes * BINS
        rows = left.permute(0, 3, 1, 2, 4).reshape(-1, 1, 1, left.shape[3], size)
        return rows @ right.permute(0, 1, 2, 4, 3).reshape(-1, 1, 1, size, right.shape[3])

    def _bends(
        self,
        rows: Tensor,
        inverse: Tensor,
        state: Tensor,
        time: Tensor,
        gram: Tensor,
        normal: Tensor,
        precision: Tensor,
    ) -> Tensor:
        """(B, 1, 1, 4, 1): the probability that the way is straight, at constant speed and depth; and if it is not, the
        standard deviations from the straight one's direction, log speed and offset, over those of the straight one.

        rows, gram, normal: of the last step, at `state`. The way differs by three numbers of `BEND_SD`, with the same
        end: Savage and Dickey's ratio for all three at once, as in `_same_depth`.
        """
        turn, offset, along, depth = (rows[..., k : k + 1, :] for k in (0, 2, 3, DEPTH))
        speed, left_mm, on_mm = state[..., 1:2, :].exp(), state[..., 2:3, :], state[..., 3:4, :]
        ago = time[..., 1:, :]
        back = speed * ago
        # The signal's change as friction turns, the contact staying where it is.
        friction = turn - (on_mm - back) * offset + left_mm * along
        bend = back * (0.5 * back * offset - friction)
        rows = torch.cat([rows, bend, 0.5 * speed * ago * ago * along, -back * depth], 3)
        both = BEND_INFORMATION * self._products(rows[..., STATE + 1 :, :] @ inverse, rows)
        shared, residual, own = both.split((STATE, 1, 3), 4)
        # The prior holds the state to the proposal, whatever the information is worth.
        diagonal = precision * self.each[:, :STATE]
        pulled = normal[..., STATE:] - gram[..., :STATE, STATE:]
        covariance = inverted(BEND_INFORMATION * gram[..., :STATE, :STATE] + diagonal)
        step = covariance @ (BEND_INFORMATION * gram[..., :STATE, STATE:] + pulled)
        carried = shared @ covariance
        left = own + self.bend_precision - (carried[..., None, :] * shared[:, :, :, None]).sum(5)
        # The cofactors of a symmetric matrix of three rows.
        once, twice = self.cycle @ left, self.uncycle @ left
        cofactors = (once @ self.uncycle) * (twice @ self.cycle) - (once @ self.cycle) * (
            twice @ self.uncycle
        )
        determinant = (left * cofactors)[..., :1, :].sum(4, keepdim=True)
        spread = cofactors / determinant
        gradient = residual - shared @ step
        found = spread @ gradient
        log_odds = (
            math.log(STRAIGHT / (1.0 - STRAIGHT) * math.prod(BEND_SD))
            + 0.5 * determinant.log()
            - 0.5 * (gradient * found).sum(3, keepdim=True)
        )
        moved = (carried * found).sum(3, keepdim=True)
        added = ((spread @ carried) * carried).sum(3, keepdim=True)
        variance = (covariance * self.each[:, :STATE]).sum(4)[:, :, :, None]
        wider = ((variance + added + moved * moved) / variance)[..., :3].clamp(min=1.0).sqrt()
        return torch.cat([probability(log_odds), wider.reshape(-1, 1, 1, 3, 1)], 3)

    def _mixing(self, weight: Tensor) -> Tensor:
        """(B, C, C): what channels are mixed by; with a dead accelerometer by nothing."""
        return self.unmixed + weight.amin((1, 2, 3, 4)).reshape(-1, 1, 1) * self.mixing

    def _without_local_errors(self, rows: Tensor, inverse: Tensor) -> Tensor:
        """The rows' products (B, 1, 1, 7, 7) where each bin's place and gain are off by errors of their own.

        inverse: (B, A, X, 1, 1). Each error adds the square of a row to the covariance of a bin's channels, and takes
        from its inverse what Sherman and Morrison's formula says.
        """
        channels = (rows * inverse.sqrt()).reshape(-1, self.boards * self.axes, STATE + 1, BINS)
        gram = (channels[:, :, :, None] * channels[:, :, None]).sum(1)
        for k, sd in LOCAL:
            row, column = gram[:, k : k + 1], gram[:, :, k : k + 1]
            gram = gram - column * row / (sd**-2 + row[:, :, k : k + 1])
        return gram.sum(3)[:, None, None]

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
        same = probability(log_odds - 0.5 * (widened.log() + off * off / widened))
        gain = same * column / spread
        shift = gain * off
        return state - shift, variance - gain * column + shift * shift

    def _inverse_covariance(
        self, touch: Tensor, ripple: Tensor | None, elapsed_s: Tensor, weight: Tensor, bin_mm: Tensor
    ) -> Tensor:
        """(B, A, X, 16, 16) 1/V^2 of each channel's residuals; zero for a dead accelerometer. Without a rim all bins
        are alike, (B, A, X, 1, 1).

        touch: (B, A, X, 1, 16) V. ripple: (B, A, 1, 1, 16) V, what each board's own V_z swings about its mean; None
        where V_z is among the X. bin_mm: the way in a bin, by the proposal's speed.
        """
        blocks = (elapsed_s / (self.block_s * BINS)).clamp(min=0.3)
        largest = (touch * touch).amax((1, 2, 3, 4), keepdim=True)
        variance = self.noise / blocks + self.level_v**2 + self.output_share**2 * largest
        if not self.rim:
            return weight / variance
        off = (self.place_mm / bin_mm).clamp(max=MOST_OFF) * (touch @ self.change)
        known = weight / (variance + off * off)
        inverse = _with_part(known * self.whole, self.even, self.zero)
        inverse = _with_part(inverse, elapsed_s * self.middle, self.drift)
        return inverse if ripple is None else _with_part(inverse, ripple, self.cross_axis_sd**2)


def _with_part(inverse: Tensor, shape: Tensor, variance: Tensor | float) -> Tensor:
    """The inverse (..., 16, 16) of a covariance to which a rank-one part is added, a shape (..., 1, 16) times an
    unknown of that variance: Sherman and Morrison's formula."""
    pulled = shape @ inverse
    square = (pulled * shape).sum(4, keepdim=True)
    return inverse - pulled.transpose(3, 4) * pulled * (variance / (1.0 + variance * square))


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


def probability(log_odds: Tensor) -> Tensor:
    """Of an event with these odds; some runtimes have no sigmoid in double precision."""
    return 1.0 / (1.0 + (-log_odds.clamp(-50.0, 50.0)).exp())


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
