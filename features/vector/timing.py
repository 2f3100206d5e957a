"""Times between the extremes of two outputs: times the speed, distances along the slide."""

from itertools import combinations

import numpy as np

EXTREMES = ("vx_min", "vx_max", "vy_min", "vy_max")
INTERVALS = tuple(combinations(range(len(EXTREMES)), 2))
INTERVAL_NAMES = tuple(f"{EXTREMES[a]}_to_{EXTREMES[b]}" for a, b in INTERVALS)


def intervals(moments: np.ndarray) -> np.ndarray:
    """Signed times (..., 6) between the moments (..., 4) of EXTREMES, in INTERVAL_NAMES order, in the moments' unit."""
    return np.stack([moments[..., b] - moments[..., a] for a, b in INTERVALS], axis=-1)
