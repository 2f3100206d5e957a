"""The curve that a slide draws in the plane of V_x and V_y, resampled by its own length.

However fast or unevenly the contact moves, it draws the same curve: what is left is where it went.
"""

import numpy as np

ARC_POINTS = 16


def arc_curve(tilt: np.ndarray, points: int = ARC_POINTS) -> tuple[np.ndarray, np.ndarray]:
    """Points (..., 2, points) V at equal steps of arc length along the curve, and its length (...) V.

    tilt: (..., 2, N) V. With l_i = sum_{j <= i} |V_j - V_{j-1}|, the curve is read where l is k / (points - 1) of
    the whole, linear between the bins. A curve without length stays at its first point.
    """
    curve = _smoothed(tilt)
    steps = np.sqrt(np.square(np.diff(curve, axis=-1)).sum(axis=-2))
    length = np.concatenate([np.zeros_like(steps[..., :1]), np.cumsum(steps, axis=-1)], axis=-1)
    total = length[..., -1:]
    wanted = total * np.linspace(0.0, 1.0, points)
    passed = (length[..., None, :] <= wanted[..., :, None]).sum(axis=-1)
    lower = np.clip(passed - 1, 0, tilt.shape[-1] - 2)
    start = np.take_along_axis(length, lower, axis=-1)
    stretch = np.take_along_axis(steps, lower, axis=-1)
    share = np.where(stretch > 0, (wanted - start) / np.where(stretch > 0, stretch, 1.0), 0.0)
    share = np.clip(share, 0.0, 1.0)[..., None, :]
    here = np.take_along_axis(curve, lower[..., None, :], axis=-1)
    there = np.take_along_axis(curve, lower[..., None, :] + 1, axis=-1)
    return here + share * (there - here), total[..., 0]


def _smoothed(tilt: np.ndarray) -> np.ndarray:
    """Binomial mean over five bins, the ends held. Noise only ever lengthens a curve; this takes most of it away."""
    padded = np.concatenate([tilt[..., :1], tilt[..., :1], tilt, tilt[..., -1:], tilt[..., -1:]], axis=-1)
    bins = tilt.shape[-1]
    weights = (1 / 16, 4 / 16, 6 / 16, 4 / 16, 1 / 16)
    return sum((w * padded[..., k : k + bins] for k, w in enumerate(weights)), np.zeros_like(tilt))
