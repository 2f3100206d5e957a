"""The localizing network: a small temporal CNN, and Levenberg-Marquardt against the response map, in one graph.

The CNN reads the slide so far in 64 equal bins of time and proposes a line (direction, offset), a speed and the
contact's place on the line, each with its standard deviation. The response map predicts what the accelerometers
would have shown; a few Levenberg-Marquardt steps move the proposal to where prediction and signal agree best, with the
proposal as a weak prior, and leave a covariance. Time enters only relative to the window's length, so every speed
looks alike.
"""

import math
from dataclasses import dataclass, field
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from features.window import WINDOW_BINS
from models.refinement import DEPTH, Refinement, RefinementConfig, for_each_axis

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
SILU_GAIN = 1.68  # keeps a normal input's mean square through silu, E silu(x)^2 = 0.355
LENGTH_MM = 10.0  # scale of offsets and places inside the network


@dataclass(frozen=True)
class NetworkConfig:
    """Sizes of the CNN, and the refinement.

    filters: of the three strided convolutions; hidden: of the two dense layers.
    """

    filters: tuple[int, int, int] = (24, 32, 40)
    hidden: tuple[int, int] = (96, 48)
    refinement: RefinementConfig = field(default_factory=RefinementConfig)


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
        # PyTorch's own start shrinks the signal threefold a layer; what reaches the head of many channels' network
        # is then too faint to learn a direction from.
        for layer in (self.conv1, self.conv2, self.conv3, self.dense1, self.dense2):
            nn.init.normal_(layer.weight, std=SILU_GAIN / math.sqrt(layer.weight[0].numel()))
            nn.init.zeros_(cast(Tensor, layer.bias))

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
        volts = volts * weight[:, :, None].expand(-1, -1, 3).reshape(-1, volts.shape[1], 1)
        tilt = volts.reshape(-1, volts.shape[1] // 3, 3, WINDOW_BINS)[:, :, :2]
        tilt = tilt.reshape(-1, self.refinement.channels, WINDOW_BINS)
        proposal, log_sd = self.proposal(tilt, elapsed_s, for_each_axis(weight))
        heading, state, covariance, misfit = self.refinement(volts, elapsed_s, weight, proposal, log_sd)
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
