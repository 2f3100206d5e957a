"""The reference estimator: the response map inverted by least squares from many starts (multi-start), no network.

Slow (tens of milliseconds a window), but it owes nothing to training: what the network reaches is measured against
it, and both against the Cramer-Rao bound of the map (cramer_rao.py).
"""

import math
from itertools import product

import numpy as np
import torch
from torch import Tensor

from softslide.features.vector.energy import energy_clock, tilt_outputs
from softslide.models.cnn.gauss_newton import Refinement, RefinementConfig
from softslide.models.cnn.network import OUTPUTS, SlideNetwork
from softslide.models.response_map.map import ResponseMap

# Wide priors: a start must find its way from anywhere on the skin.
STARTS = RefinementConfig(steps=15, trust=1.0, least_prior=(3.0, 1.5, 20.0, 25.0))
# A fan of 96 starts. LENGTHS_MM: guesses of speed times energy width.
HEADINGS, OFFSETS_MM, LENGTHS_MM = 12, (-15.0, -5.0, 5.0, 15.0), (6.0, 9.0)
MISFIT, STRAIN, DIRECTION_SD = (OUTPUTS.index(name) for name in ("misfit", "strain", "direction_sd_deg"))
# Deviation beyond which a start has not converged (gauss_newton.py), and what puts it behind all others.
WIDEST_DEG, NEVER = 60.0, 1e6


class Inversion:
    """Least squares over direction, offset, speed, place, gain and depth from a fan of starts; the best fit wins."""

    def __init__(self, response: ResponseMap, block_s: float) -> None:
        self._network = SlideNetwork(_Starts(), Refinement(response, block_s, STARTS)).eval()
        self.outputs = self._network.outputs

    def predict(self, volts: np.ndarray, elapsed_s: np.ndarray) -> np.ndarray:
        """Rows (n, K) of `OUTPUTS` for windows volts (n, 3 A, 64) V, elapsed_s (n,) s."""
        centre, width = energy_clock(tilt_outputs(volts))
        rows = []
        for window, elapsed, c, w in zip(volts, elapsed_s, centre, width, strict=True):
            starts = _fan(float(elapsed), float(c), float(w))
            count = len(starts)
            self._network.proposal.starts = starts
            with torch.no_grad():
                found = self._network(
                    torch.tensor(window, dtype=torch.float32).expand(count, -1, -1),
                    torch.full((count,), float(elapsed)),
                    torch.ones(count, len(window) // 3),
                ).numpy()
            # A misfit is of any gain (gauss_newton.py): what a gain costs that no slide has comes on top.
            strained = found[:, STRAIN] ** 2 / len(window)
            # A start that has not converged may lie where the map is steep, and errors of place explain anything.
            misfit = found[:, MISFIT] + strained + np.where(found[:, DIRECTION_SD] > WIDEST_DEG, NEVER, 0.0)
            rows.append(found[np.nanargmin(misfit)])
        return np.array(rows)


class _Starts(torch.nn.Module):
    """Stands where the proposal network does and hands out given starts, with no opinion on their worth."""

    starts: Tensor

    def forward(self, volts: Tensor, elapsed_s: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
        return self.starts, torch.zeros(len(self.starts), 4)


def _fan(elapsed_s: float, centre: float, width: float) -> Tensor:
    """Starts (n, 5): the contact is taken to pass the reference point where the signal's energy is centred."""
    rows = []
    for k, offset, length in product(range(HEADINGS), OFFSETS_MM, LENGTHS_MM):
        a, speed = 2 * math.pi * k / HEADINGS, length / (width * elapsed_s)
        rows.append([math.cos(a), math.sin(a), math.log(speed), offset, speed * elapsed_s * (1 - centre)])
    return torch.tensor(rows)
