"""The reference estimator: the response map inverted by least squares from many starts, with no network to help.

Slow (tens of milliseconds a window), but it owes nothing to training: what the network reaches is measured against
it, and both against the Cramer-Rao bound of the map.
"""

import math

import numpy as np
import torch
from torch import Tensor

from features.vector.energy import energy_clock, tilt_outputs
from models.cnn.gauss_newton import Refinement, RefinementConfig
from models.cnn.network import OUTPUTS, SlideNetwork
from models.response_map.map import ResponseMap
from pipeline.recordings.windows import LabelledWindows

STARTS = RefinementConfig(steps=15, trust=1.0, least_prior=(3.0, 1.5, 20.0, 25.0))
HEADINGS, OFFSETS_MM, LENGTHS_MM = 12, (-15.0, -5.0, 5.0, 15.0), (6.0, 9.0)
MISFIT = OUTPUTS.index("misfit")


class Inversion:
    """Least squares over direction, offset, speed, place, gain and depth from a fan of starts; the best fit wins."""

    def __init__(self, response: ResponseMap, block_s: float, config: RefinementConfig = STARTS) -> None:
        self._network = SlideNetwork(_Starts(), Refinement(response, block_s, config)).eval()
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
            rows.append(found[np.nanargmin(found[:, MISFIT])])
        return np.array(rows)


class _Starts(torch.nn.Module):
    """Stands where the proposal network does and hands out given starts, with no opinion on their worth."""

    starts: Tensor

    def forward(self, volts: Tensor, elapsed_s: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
        return self.starts, torch.zeros(len(self.starts), 4)


def _fan(elapsed_s: float, centre: float, width: float) -> Tensor:
    """Starts (n, 5): the contact is taken to pass the reference point where the signal's energy is centred."""
    rows = []
    for k in range(HEADINGS):
        a = 2 * math.pi * k / HEADINGS
        for offset in OFFSETS_MM:
            for length in LENGTHS_MM:
                speed = length / (width * elapsed_s)
                rows.append(
                    [math.cos(a), math.sin(a), math.log(speed), offset, speed * elapsed_s * (1 - centre)]
                )
    return torch.tensor(rows)


def cramer_rao(response: ResponseMap, block_s: float, windows: LabelledWindows) -> np.ndarray:
    """Least standard deviations (n, 3) that any unbiased estimate can have: direction deg, log speed, offset mm.

    The inverse Fisher information of the map at the true line, with gain and zero unknown within their spread, and the
    depth known. The place along the line is fitted: a window whose slide is over ends before its label does.
    """
    angle = np.radians(windows.direction_deg)
    truth = np.stack(
        [np.cos(angle), np.sin(angle), np.log(windows.speed_mm_s), windows.offset_mm, windows.along_mm],
        axis=1,
    )
    line, boards = torch.tensor(truth, dtype=torch.float32), windows.volts.shape[1] // 3

    def refined(steps: int, least_prior: tuple[float, float, float, float]) -> tuple[Tensor, ...]:
        config = RefinementConfig(steps=steps, trust=1.0, least_prior=least_prior, depth_sd_mm=1e-6)
        with torch.no_grad():
            columns = Refinement(response, block_s, config)(
                torch.tensor(windows.volts, dtype=torch.float32).unflatten(1, (boards, 3)),
                torch.tensor(windows.elapsed_s, dtype=torch.float32),
                torch.ones(len(truth), boards),
                line,
                torch.full((len(truth), 4), -20.0),
            )
        return tuple(column.flatten(1) for column in columns)

    _, state, _, _ = refined(8, (1e-4, 1e-4, 1e-3, 10.0))
    line = torch.cat([line[:, :4], state[:, 3:4].float()], 1)
    _, _, variance, _ = refined(1, (1e3, 1e3, 1e3, 1e3))
    sd = variance.sqrt().numpy()
    return np.stack([np.degrees(sd[:, 0]), sd[:, 1], sd[:, 2]], axis=1)
