"""The localizing network: a small temporal CNN, and Levenberg-Marquardt against the response map, in one graph.

The CNN reads the slide so far in 64 equal bins of time and proposes a line (direction, offset), a speed and the
contact's place on the line, each with its standard deviation. The response map predicts what the accelerometers
would have shown; a few Levenberg-Marquardt steps move the proposal to where prediction and signal agree best, with the
proposal as a weak prior, and leave a covariance. Time enters only relative to the window's length, so every speed
looks alike.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from features.window import WINDOW_BINS
from models.response_map import SPACING_MM, ResponseMap

OUTPUTS = (
    "direction_cos",
    "direction_sin",
    "log_speed",
    "offset_mm",
    "along_mm",
    "direction_sd_deg",
    "log_speed_sd",
    "offset_sd_mm",
    "misfit",
)
DEPTH_OUTPUT = "depth_mm"  # a further column where an atlas says how depth shows
PEAK_SHARE = 0.003  # what the map leaves over, as a share of the slide's largest output
DOUBT = 9.0  # variance of the depth's error over the one that noise explains, on held-out lines
BINS = 32  # of time in the refinement: a window's bins in pairs, which loses nothing and halves the work
DEPTH = 5  # place of the depth in the refinement's state
LENGTH_MM = 10.0  # scale of offsets and places inside the network


_Point = tuple[Tensor, Tensor, Tensor, Tensor, Tensor]  # cost, chi-square, state, normal matrix, right side


@dataclass(frozen=True)
class NetworkConfig:
    """Sizes of the CNN, and the refinement.

    filters: of the three strided convolutions; hidden: of the two dense layers.
    steps: Levenberg-Marquardt steps. trust: the proposal's standard deviations times this are the refinement's
        prior, but never less than least_prior (rad, mm, log, mm): a proposal that is wrong must not hold it back.
    same_depth: prior probability that a slide has the calibration's contact depth; depth_sd_mm: standard deviation
        about it of those that do not.
    """

    filters: tuple[int, int, int] = (24, 32, 40)
    hidden: tuple[int, int] = (96, 48)
    steps: int = 3
    trust: float = 3.0
    least_prior: tuple[float, float, float, float] = (0.1, 1.5, 0.1, 2.0)
    same_depth: float = 0.9
    depth_sd_mm: float = 0.35


class Proposal(nn.Module):
    """The temporal CNN: (B, C, 64) V, (B,) s, (B, C) weights -> proposal (B, 5) and log standard deviations (B, 4).

    Proposal: direction cos, sin, log speed, offset mm, along mm; deviations: direction rad, log speed, offset mm,
    along mm.
    """

    bins: Tensor

    def __init__(self, channels: int, config: NetworkConfig) -> None:
        super().__init__()
        f, h = config.filters, config.hidden
        self.conv1 = nn.Conv1d(channels, f[0], 5, stride=2, padding=2)
        self.conv2 = nn.Conv1d(f[0], f[1], 5, stride=2, padding=2)
        self.conv3 = nn.Conv1d(f[1], f[2], 3, stride=2, padding=1)
        self.dense1 = nn.Linear(WINDOW_BINS // 8 * f[2] + 3 + channels, h[0])
        self.dense2 = nn.Linear(h[0], h[1])
        self.head = nn.Linear(h[1], 9)
        self.register_buffer("bins", (torch.arange(WINDOW_BINS) + 0.5) / WINDOW_BINS)

    def forward(self, volts: Tensor, elapsed_s: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
        energy = (volts * volts).sum(1)
        peak = (energy.amax(1, keepdim=True) + 1e-9).sqrt()
        share = energy / (energy.sum(1, keepdim=True) + 1e-9)
        centre = (share * self.bins).sum(1, keepdim=True)
        width = ((share * (self.bins - centre) ** 2).sum(1) + 1e-4).sqrt()
        h = F.silu(self.conv1(volts / peak[:, :, None]))
        h = F.silu(self.conv2(h))
        h = F.silu(self.conv3(h)).flatten(1)
        scales = torch.stack([peak[:, 0].log() + 3, 0.3 * elapsed_s.log(), width.log() + 1.5], 1)
        h = F.silu(self.dense1(torch.cat([h, scales, weight], 1)))
        h = F.silu(self.dense2(h))
        raw = self.head(h)
        # The signal's own time scale carries the speed: what is left to learn is a length.
        log_speed = raw[:, 2] + 2.5 - (width * elapsed_s).log()
        proposal = torch.stack(
            [raw[:, 0], raw[:, 1], log_speed, LENGTH_MM * raw[:, 3], LENGTH_MM * raw[:, 4]], 1
        )
        scale = torch.tensor([0.0, 0.0, math.log(LENGTH_MM), math.log(LENGTH_MM)])
        return proposal, (raw[:, 5:] - 2).clamp(-6.5, 2.0) + scale


class Refinement(nn.Module):
    """Levenberg-Marquardt on (direction, offset, log speed, along, gain, depth) against the response map.

    Residuals are whitened: by noise that falls with the number of blocks a bin holds, by a floor for what the map
    leaves over, and by the slow wander of each channel's zero (a rank-one part of each channel's covariance).
    """

    coefficients: Tensor
    depth_slope: Tensor
    centres: Tensor
    noise: Tensor
    drift: Tensor
    bins: Tensor
    nuisance_sd: Tensor
    least_prior: Tensor
    longest_step: Tensor

    def __init__(self, response: ResponseMap, block_s: float, config: NetworkConfig) -> None:
        super().__init__()
        assert response.noise_v is not None
        assert response.drift_v is not None
        k = response.coefficients.shape[1]
        stacked = torch.tensor(response.coefficients, dtype=torch.float32)
        depth = torch.tensor(response.depth_slope, dtype=torch.float32)
        self.register_buffer("coefficients", stacked)
        self.register_buffer("depth_slope", depth.reshape(k, -1))
        self.register_buffer("centres", -response.half_mm + SPACING_MM * (torch.arange(k) - 1.0))
        self.register_buffer("noise", torch.tensor(response.noise_v, dtype=torch.float32))
        self.register_buffer("drift", torch.tensor(response.drift_v, dtype=torch.float32))
        self.register_buffer("bins", (torch.arange(BINS) + 0.5) / BINS)
        self.reference = response.reference_mm
        self.block_s, self.lag_s, self.floor_v = block_s, response.lag_s, response.floor_v
        self.depth_mm, self.same_depth = response.depth_mm, config.same_depth
        self.knows_depth = bool(np.any(response.depth_slope))
        self.register_buffer("nuisance_sd", torch.tensor([response.gain_sd, config.depth_sd_mm]))
        self.register_buffer("least_prior", torch.tensor(config.least_prior))
        self.register_buffer("longest_step", torch.tensor([0.3, 5.0, 0.4, 6.0, 0.1, 0.5]))
        self.steps, self.trust = config.steps, config.trust
        # In doubles: partial strokes leave the normal matrix nearly singular, and whether a step is taken back
        # must not hang on a rounding error that another runtime makes differently.
        self.double()

    def forward(
        self, volts: Tensor, elapsed_s: Tensor, weight: Tensor, proposal: Tensor, log_sd: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """-> heading (B, 2: cos, sin), state (B, 6: -, offset mm, log speed, along mm, log gain, depth mm off the
        map's), its covariance (B, 6, 6), misfit (B,)."""
        volts, elapsed_s, weight, proposal, log_sd = (
            given.double() for given in (volts, elapsed_s, weight, proposal, log_sd)
        )
        volts = volts.reshape(volts.shape[0], volts.shape[1], BINS, WINDOW_BINS // BINS).mean(3)
        norm = (proposal[:, :2] ** 2).sum(1, keepdim=True).clamp(min=1e-12).sqrt()
        start = proposal[:, :2] / norm
        # State, relative to the proposal: turn rad, offset mm, log speed, along mm, log gain, depth mm.
        centre = F.pad(proposal[:, [3, 2, 4]], (1, 2))
        own = torch.maximum(log_sd[:, [0, 2, 1, 3]].exp() * self.trust, self.least_prior)
        prior_sd = torch.cat([own, self.nuisance_sd.expand(own.shape[0], 2)], 1)
        precision = prior_sd**-2
        scale, shrink = self._whitening(volts, elapsed_s, weight)
        best = torch.zeros_like(prior_sd)
        trial, damping = best, torch.full_like(best[:, :1], 1e-3)
        for step in range(self.steps + 1):
            value, rows = self._predict(start, centre, trial, elapsed_s)
            gap = (volts - value) * scale[:, :, None]
            gap = gap - shrink[:, :, None] * gap.mean(2, keepdim=True)
            chi2 = (gap * gap).sum((1, 2))
            rows = rows * scale[:, None, :, None]
            rows = (rows - shrink[:, None, :, None] * rows.mean(3, keepdim=True)).flatten(2)
            cost = chi2[:, None] + (precision * trial * trial).sum(1, keepdim=True)
            normal = rows @ rows.transpose(1, 2) + torch.diag_embed(precision)
            right = (rows @ gap.flatten(1)[:, :, None])[:, :, 0] - precision * trial
            if step == 0:
                held = (cost, chi2[:, None], best, normal, right)
            else:
                # Levenberg-Marquardt: what did not help is taken back, and tried again with a shorter step.
                better = cost < held[0]
                fresh = (cost, chi2[:, None], trial, normal, right)
                held = _either(better, fresh, held)
                damping = torch.where(better, damping * 0.1, damping * 30.0)
            if step < self.steps:
                move, _ = solve(held[3], held[4], damping)
                trial = held[2] + torch.maximum(torch.minimum(move, self.longest_step), -self.longest_step)
        _, chi2, best, normal, right = held
        _, covariance = solve(normal, right, torch.zeros_like(damping))
        best, covariance = self._same_depth(best, covariance)
        heading, state = turned(start, best[:, :1]), centre + best
        misfit = chi2[:, 0] / (weight.sum(1) * BINS).clamp(min=1.0)
        return heading.float(), state.float(), covariance.float(), misfit.float()

    def _same_depth(self, state: Tensor, covariance: Tensor) -> tuple[Tensor, Tensor]:
        """Averages two hypotheses: the calibration's depth, or one of its own. -> state (B, 6), covariance.

        The odds are prior odds times the Savage-Dickey ratio, posterior over prior density at no difference; the
        state under "the same depth" is the free one conditioned on it.
        """
        variance = covariance[:, DEPTH, DEPTH].clamp(min=1e-8)
        off = state[:, DEPTH]
        # The covariance knows nothing of the map's own error; the evidence must stand above that as well.
        doubtful = DOUBT * variance
        log_odds = (
            math.log(self.same_depth / (1 - self.same_depth))
            + self.nuisance_sd[1].log()
            - 0.5 * doubtful.log()
            - 0.5 * off * off / doubtful
        )
        same = torch.sigmoid(log_odds)[:, None]
        gain = covariance[:, :, DEPTH] / variance[:, None]
        shift = gain * off[:, None]
        reduction = gain[:, :, None] * covariance[:, None, DEPTH]
        between = (same * (1 - same))[:, :, None] * shift[:, :, None] * shift[:, None]
        return state - same * shift, covariance - same[:, :, None] * reduction + between

    def _whitening(self, volts: Tensor, elapsed_s: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
        """Weights (B, C) of the residuals, and the share (B, C) of a channel's mean residual that its zero explains."""
        blocks = (elapsed_s / (self.block_s * BINS)).clamp(min=0.3)
        peak = volts.abs().amax((1, 2))
        floor = (0.4 * self.floor_v) ** 2 + (PEAK_SHARE * peak) ** 2
        sigma = (self.noise**2 / blocks[:, None] + floor[:, None]).sqrt()
        wander = (self.drift / sigma) ** 2 * BINS
        return weight / sigma, 1 - (1 + wander).rsqrt()

    def _predict(
        self, start: Tensor, centre: Tensor, trial: Tensor, elapsed_s: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Predicted bins (B, C, 64) V and their derivatives (B, 6, C, 64) at a trial state."""
        heading, state = turned(start, trial[:, :1]), centre + trial
        cos, sin = heading[:, :1], heading[:, 1:]
        offset, speed, along = state[:, 1:2], state[:, 2:3].clamp(-5.0, 7.0).exp(), state[:, 3:4]
        behind = speed * (elapsed_s[:, None] * (1 - self.bins) + self.lag_s)
        s = along - behind
        x = self.reference[0] - offset * sin + s * cos
        y = self.reference[1] + offset * cos + s * sin
        basis, slope = splines((torch.stack([x, y], 1)[..., None] - self.centres) / SPACING_MM)
        turn = torch.cat([torch.ones_like(cos), cos, sin], 1)
        surface = torch.einsum("bp,pijc->bijc", turn, self.coefficients)
        b, k, channels = s.shape[0], surface.shape[1], surface.shape[3]
        flat = surface.reshape(b, k, k * channels)
        across = torch.stack([basis[:, 0], slope[:, 0]], 1) @ flat[:, None]
        across = across.reshape(b, 2, BINS, k, channels)
        by, dy = basis[:, 1, :, :, None], slope[:, 1, :, :, None]
        volts = (across[:, 0] * by).sum(2).transpose(1, 2)
        along_x = (across[:, 1] * by).sum(2).transpose(1, 2) / SPACING_MM
        along_y = (across[:, 0] * dy).sum(2).transpose(1, 2) / SPACING_MM
        deep = (basis[:, 0] @ self.depth_slope).reshape(b, BINS, k, channels)
        deep = (deep * by).sum(2).transpose(1, 2)
        gain = state[:, 4:5, None].exp()
        value = volts + state[:, 5:6, None] * deep
        forward = gain * (cos[:, :, None] * along_x + sin[:, :, None] * along_y)
        left = gain * (cos[:, :, None] * along_y - sin[:, :, None] * along_x)
        rows = torch.stack(
            [
                s[:, None] * left - offset[:, :, None] * forward,
                left,
                -behind[:, None] * forward,
                forward,
                gain * value,
                gain * deep,
            ],
            1,
        )
        return gain * value, rows


def _either(better: Tensor, fresh: _Point, held: _Point) -> _Point:
    """For each window of the batch the fresh point where it is better (B, 1), else the one held."""
    cost, chi2, state, normal, right = (
        torch.where(better if new.dim() == 2 else better[:, :, None], new, old)
        for new, old in zip(fresh, held, strict=True)
    )
    return cost, chi2, state, normal, right


def splines(z: Tensor) -> tuple[Tensor, Tensor]:
    """Uniform cubic B-spline and its derivative at signed distances z from the centres, in spacings."""
    size = z.abs()
    outer, inner = (2 - size).relu(), (1 - size).relu()
    outer2, inner2 = outer * outer, inner * inner
    value = (outer2 * outer - 4 * inner2 * inner) / 6
    return value, z.sign() * (2 * inner2 - 0.5 * outer2)


def turned(heading: Tensor, angle: Tensor) -> Tensor:
    """A heading (B, 2: cos, sin) turned by an angle (B, 1) rad."""
    cos, sin = angle.cos(), angle.sin()
    x, y = heading[:, :1], heading[:, 1:]
    return torch.cat([x * cos - y * sin, x * sin + y * cos], 1)


def solve(normal: Tensor, right: Tensor, damping: Tensor) -> tuple[Tensor, Tensor]:
    """x = (A + d diag A)^-1 b and that inverse, for symmetric positive definite A (B, n, n), by Gauss-Jordan.

    Written out because ONNX has no solver; with A scaled to a unit diagonal no pivoting is needed.
    """
    n = normal.shape[-1]
    scale = normal.diagonal(dim1=1, dim2=2).rsqrt()
    eye = torch.eye(n, dtype=normal.dtype)
    scaled = normal * scale[:, :, None] * scale[:, None, :] + eye * damping[:, :, None]
    work = torch.cat([scaled, eye.expand(normal.shape[0], n, n)], 2)
    for k in range(n):
        row = work[:, k : k + 1] / work[:, k : k + 1, k : k + 1]
        work = work - (work[:, :, k : k + 1] - eye[:, k : k + 1]) @ row
    inverse = work[:, :, n:] * scale[:, :, None] * scale[:, None, :]
    return (inverse @ right[:, :, None])[:, :, 0], inverse


class SlideNetwork(nn.Module):
    """The exported graph: window, duration and weights in; the row of `OUTPUTS` out."""

    def __init__(self, proposal: nn.Module, refinement: Refinement) -> None:
        super().__init__()
        self.proposal, self.refinement = proposal, refinement

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the graph's columns."""
        return (*OUTPUTS, DEPTH_OUTPUT) if self.refinement.knows_depth else OUTPUTS

    def forward(self, volts: Tensor, elapsed_s: Tensor, weight: Tensor) -> Tensor:
        """volts (B, 3 A, 64) V, elapsed_s (B,) s, weight (B, A) -> (B, K), the columns that `outputs` names."""
        b, accelerometers = weight.shape
        weight = weight.repeat_interleave(2, 1)
        tilt = volts.reshape(b, accelerometers, 3, WINDOW_BINS)[:, :, :2].flatten(1, 2) * weight[:, :, None]
        proposal, log_sd = self.proposal(tilt, elapsed_s, weight)
        heading, state, covariance, misfit = self.refinement(tilt, elapsed_s, weight, proposal, log_sd)
        sd = covariance.diagonal(dim1=1, dim2=2).clamp(min=0).sqrt()
        columns = [
            heading,
            state[:, 2:3],
            state[:, 1:2],
            state[:, 3:4],
            sd[:, :1] * (180 / math.pi),
            sd[:, 2:3],
            sd[:, 1:2],
            misfit[:, None],
        ]
        if self.refinement.knows_depth:
            columns.append(state[:, DEPTH : DEPTH + 1] + self.refinement.depth_mm)
        return torch.cat(columns, 1)
