"""The Cramer-Rao bound of a response map (Kay 1993, chapter 3): what no unbiased estimate of a line can beat."""

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from softslide.models.cnn.gauss_newton import Refinement, RefinementConfig
from softslide.models.response_map.map import ResponseMap
from softslide.pipeline.recordings.windows import LabelledWindows

KNOWN_MM = 1e-6


def cramer_rao(response: ResponseMap, block_s: float, windows: LabelledWindows) -> np.ndarray:
    """Least standard deviations (n, 3) that any unbiased estimate can have: direction deg, log speed, offset mm.

    The inverse Fisher information of the map at the true line, with the depth known, and gain and zero unknown within
    their spread. The place along the line is fitted: a slide that has ended stands still while its label moves on.
    """
    angle = np.radians(windows.direction_deg)
    truth = np.stack(
        [np.cos(angle), np.sin(angle), np.log(windows.speed_mm_s), windows.offset_mm, windows.along_mm],
        axis=1,
    )
    line, boards = torch.tensor(truth, dtype=torch.float32), windows.volts.shape[1] // 3
    response = replace(response, depth_sd_mm=KNOWN_MM)

    def refined(steps: int, least_prior: tuple[float, float, float, float]) -> tuple[Tensor, ...]:
        config = RefinementConfig(steps=steps, trust=1.0, least_prior=least_prior)
        with torch.no_grad():
            columns = Refinement(response, block_s, config, settled=False)(
                torch.tensor(windows.volts, dtype=torch.float32).unflatten(1, (boards, 3)),
                torch.tensor(windows.elapsed_s, dtype=torch.float32),
                torch.ones(len(truth), boards),
                line,
                torch.full((len(truth), 4), -20.0),
            )
        return tuple(column.flatten(1) for column in columns)

    # First the place alone, the rest of the line held at its label; then the information there, with no prior on it.
    _, state, *_ = refined(8, (1e-4, 1e-4, 1e-3, 10.0))
    line = torch.cat([line[:, :4], state[:, 3:4].float()], 1)
    _, _, variance, *_ = refined(1, (1e3, 1e3, 1e3, 1e3))
    sd = variance.sqrt().numpy()
    return np.stack([np.degrees(sd[:, 0]), sd[:, 1], sd[:, 2]], axis=1)
