"""Trains the proposal network on synthetic windows of a calibrated map."""

import math
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor
from torch.nn.utils import clip_grad_norm_

from softslide.models.cnn.network import LENGTH_MM, NetworkConfig, Proposal
from softslide.models.cnn.training_windows import WindowSource
from softslide.models.graph.packing import rounded, rounded_weights
from softslide.pipeline.ranges import SEED, check_ranges


@dataclass(frozen=True)
class TrainingConfig:
    """steps of batch windows each; rate: AdamW's peak learning rate, cosine to zero; average: the decay of the
    moving average of the weights that is kept."""

    steps: int = 10_000
    batch: int = 128
    rate: float = 3e-3
    average: float = 0.998
    seed: int = 0

    def __post_init__(self) -> None:
        check_ranges(
            self,
            steps=(1, 10_000_000),
            batch=(2, 65_536),
            rate=(1e-9, 1.0),
            average=(0.0, 0.999999),
            seed=SEED,
        )


def train_proposal(
    source: WindowSource,
    network: NetworkConfig,
    config: TrainingConfig,
    start: Proposal | None = None,
    progress: Callable[[int, float], None] = lambda step, loss: None,
    judge: Callable[[int, Proposal], None] | None = None,
) -> Proposal:
    """The trained network, its weights rounded to 8 bits, its other constants to half precision.

    Seeded: the same configuration gives the same weights on the same machine.

    start: a network to start from. progress: called with the step and the loss, now and then.
    judge: called after each third of the steps but the last, with the number of thirds and the network as it stands.
    """
    thirds = {config.steps // 3: 1, 2 * config.steps // 3: 2}
    torch.manual_seed(config.seed)
    generator = torch.Generator().manual_seed(config.seed)
    proposal = start or Proposal(source.response.channels, source.response.boards, network)
    averaged = torch.optim.swa_utils.AveragedModel(
        proposal,
        avg_fn=lambda mean, new, count: (
            mean + (new - mean) * (1 - min(config.average, float(1 - 1 / (count + 1))))
        ),
    )
    kept = cast(Proposal, averaged.module)
    optimizer = torch.optim.AdamW(proposal.parameters(), lr=config.rate, weight_decay=1e-4)
    for step in range(config.steps):
        rate = config.rate * min(1.0, (step + 1) / 200) * 0.5 * (1 + math.cos(math.pi * step / config.steps))
        for group in optimizer.param_groups:
            group["lr"] = rate
        batch = source.draw(config.batch, generator)
        proposed, log_sd = proposal(batch.volts, batch.elapsed_s, batch.weight)
        loss = likelihood_loss(proposed, log_sd, batch.targets)
        optimizer.zero_grad()
        loss.backward()
        clip_grad_norm_(proposal.parameters(), 1.0)
        optimizer.step()
        averaged.update_parameters(proposal)
        if step % 50 == 0:
            progress(step, loss.item())
        if judge is not None and step + 1 in thirds:
            judge(thirds[step + 1], deepcopy(kept))
    with torch.no_grad():
        for values in kept.parameters():
            values.copy_(rounded(values) if values.dim() == 1 else rounded_weights(values))
    return kept.eval()


def likelihood_loss(proposal: Tensor, log_sd: Tensor, targets: Tensor) -> Tensor:
    """Mean negative log likelihood of direction, log speed, offset and place, each with its own deviation.

    The direction's squared error is 2 (1 - cos of the angle between), which has no seam at 360 degrees.
    """
    norm = (proposal[:, :2] ** 2).sum(1).clamp(min=1e-6).sqrt()
    aligned = (proposal[:, :2] * targets[:, :2]).sum(1) / norm
    squared = torch.cat([2 * (1 - aligned)[:, None], (proposal[:, 2:5] - targets[:, 2:5]) ** 2], 1)
    scale = torch.tensor([1.0, 1.0, LENGTH_MM, LENGTH_MM]).log()
    loss = squared * torch.exp(-2 * log_sd) / 2 + (log_sd - scale)
    return loss.mean() + 0.1 * ((norm - 1) ** 2).mean()
