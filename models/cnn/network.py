"""The localizing network: a small temporal CNN, and Gauss-Newton against the response map, in one graph.

The CNN reads the slide so far in 64 equal bins of time and proposes a line (direction, offset), a speed and the
contact's place on the line, each with its standard deviation. The response map predicts what the accelerometers
would have shown; a few Gauss-Newton steps move the proposal to where prediction and signal agree best, with the
proposal as a weak prior, and leave a covariance. Time enters only relative to the window's length, so every speed
looks alike.
"""

import math
from dataclasses import dataclass, field
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from softslide.features.card import BENT
from softslide.features.window import WINDOW_BINS
from softslide.models.cnn.forward_model import WithConstants
from softslide.models.cnn.gauss_newton import DEPTH, Refinement, RefinementConfig
from softslide.pipeline.ranges import check_ranges

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
    "strain",
)
# Further columns of maps with a rim, and where it is known how depth shows.
BEND_OUTPUTS = ("straight", *BENT)
DEPTH_OUTPUTS = ("depth_mm", "depth_sd_mm")
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

    def __post_init__(self) -> None:
        check_ranges(self, filters=(1, 1024), hidden=(1, 4096))


class Proposal(WithConstants):
    """The temporal CNN: (B, C, 64) V, (B,) s, (B, A) weights -> proposal (B, 5) and log standard deviations (B, 4).

    Proposal: direction cos, sin, log speed, offset mm, along mm; deviations: direction rad, log speed, offset mm,
    along mm.
    """

    def __init__(self, channels: int, boards: int, config: NetworkConfig) -> None:
        super().__init__()
        f, h = config.filters, config.hidden
        self.conv1 = nn.Conv1d(channels, f[0], 5, stride=2, padding=2)
        self.conv2 = nn.Conv1d(f[0], f[1], 5, stride=2, padding=2)
        self.conv3 = nn.Conv1d(f[1], f[2], 3, stride=2, padding=1)
        self.dense1 = nn.Linear(WINDOW_BINS // 8 * f[2] + 3 + boards, h[0])
        self.dense2 = nn.Linear(h[0], h[1])
        self.head = nn.Linear(h[1], 9)
        constants = {
            "bins": [(n + 0.5) / WINDOW_BINS for n in range(WINDOW_BINS)],
            "scale": [1.0, 0.3, 1.0],
            "middle": [3.0, 0.0, 1.5],
            "unit": [1.0, 1.0, 1.0, LENGTH_MM, LENGTH_MM],
            "usual": [0.0, 0.0, 2.5, 0.0, 0.0],
            "speed_alone": [0.0, 0.0, 1.0, 0.0, 0.0],
            "usual_sd": [-2.0, -2.0, math.log(LENGTH_MM) - 2.0, math.log(LENGTH_MM) - 2.0],
        }
        self.hold(constants, torch.float32, persistent=False)
        # PyTorch's own start shrinks the signal threefold a layer; what reaches the head of many channels' network
        # is then too faint to learn a direction from.
        for layer in (self.conv1, self.conv2, self.conv3, self.dense1, self.dense2):
            nn.init.normal_(layer.weight, std=SILU_GAIN / math.sqrt(layer.weight[0].numel()))
            nn.init.zeros_(cast(Tensor, layer.bias))

    def forward(self, volts: Tensor, elapsed_s: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
        elapsed_s = elapsed_s[:, None, None]
        energy = (volts * volts).sum(1, keepdim=True)
        peak = energy.amax(2, keepdim=True).clamp(min=1e-9).sqrt()
        share = energy / energy.sum(2, keepdim=True).clamp(min=1e-9)
        centre = (share * self.bins).sum(2, keepdim=True)
        width = ((share * (self.bins - centre) ** 2).sum(2, keepdim=True) + 1e-4).sqrt()
        h = F.silu(self.conv1(volts / peak))
        h = F.silu(self.conv2(h))
        h = F.silu(self.conv3(h)).flatten(1)
        scales = torch.cat([peak, elapsed_s, width], 1)[:, :, 0].log() * self.scale + self.middle
        h = F.silu(self.dense1(torch.cat([h, scales, weight], 1)))
        h = F.silu(self.dense2(h))
        raw, log_sd = self.head(h).split((5, 4), 1)
        # The signal's own time scale carries the speed: what is left to learn is a length.
        log_s = (width * elapsed_s).log()[:, :, 0] * self.speed_alone
        return raw * self.unit + self.usual - log_s, log_sd.clamp(-4.5, 4.0) + self.usual_sd


class SlideNetwork(WithConstants):
    """The exported graph: window, duration and weights in; the row of `OUTPUTS` out."""

    def __init__(self, proposal: nn.Module, refinement: Refinement) -> None:
        super().__init__()
        self.proposal, self.refinement = proposal, refinement
        self.hold({"sd_unit": [[180.0 / math.pi], [1.0], [1.0]]}, torch.float64)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the graph's columns."""
        bends = BEND_OUTPUTS if self.refinement.rim else ()
        return (*OUTPUTS, *bends, *(DEPTH_OUTPUTS if self.refinement.knows_depth else ()))

    def forward(self, volts: Tensor, elapsed_s: Tensor, weight: Tensor) -> Tensor:
        """volts (B, 3 A, 64) V, elapsed_s (B,) s, weight (B, A) -> (B, K), the columns that `outputs` names."""
        boards, axes = self.refinement.boards, self.refinement.axes
        volts = volts.reshape(-1, boards, 3, WINDOW_BINS) * weight[:, :, None, None]
        touch = volts[:, :, :axes].reshape(-1, axes * boards, WINDOW_BINS)
        proposal, log_sd = self.proposal(touch, elapsed_s, weight)
        heading, state, variance, *judged = self.refinement(volts, elapsed_s, weight, proposal, log_sd)
        sd = variance[..., :3, :].clamp(min=0).sqrt() * self.sd_unit
        columns = [heading, state[..., 1:4, :], sd, *judged]
        if self.refinement.knows_depth:
            depth_sd = variance[..., DEPTH:, :].clamp(min=0).sqrt()
            columns += [state[..., DEPTH:, :] + self.refinement.depth_mm, depth_sd]
        return torch.cat(columns, 3).reshape(-1, len(self.outputs)).float()
